//! Journal, metrics and API description of the gateway.

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::header;
use axum::response::IntoResponse;
use serde::Deserialize;

use super::{ApiResult, openapi_json};
use crate::app_state::SharedAppState;
use crate::journal::RECORDS_MAX;
use crate::message::{ErrorBody, GatewayError, JournalRecord};

/// Which records.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JournalQuery {
    after: Option<u64>,
    count: Option<usize>,
}

/// Journal of actions, with their sessions
///
/// At most 1,000 records after the one of that number.
#[utoipa::path(get, path = "/api/v1/journal", tag = "gateway",
    params(("after" = Option<u64>, Query), ("count" = Option<usize>, Query)), responses(
    (status = 200, body = Vec<JournalRecord>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn journal(
    State(state): State<SharedAppState>,
    which: Result<Query<JournalQuery>, QueryRejection>,
) -> ApiResult<Vec<JournalRecord>> {
    let Query(which) =
        which.map_err(|error| GatewayError::new("gateway.request", error.body_text()))?;
    let count = which.count.unwrap_or(RECORDS_MAX);
    let journal = std::sync::Arc::clone(&state.journal);
    let read = tokio::task::spawn_blocking(move || journal.records(which.after, count));
    read.await.map_err(|error| GatewayError::new("gateway.busy", error.to_string()))?.map(Json)
}

/// This description
#[utoipa::path(get, path = "/api/v1/openapi.json", tag = "gateway",
    responses((status = 200, body = Object)))]
pub(super) async fn openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], openapi_json())
}

/// Counters for Prometheus
#[utoipa::path(get, path = "/metrics", tag = "gateway",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub(super) async fn metrics(State(state): State<SharedAppState>) -> impl IntoResponse {
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], state.metrics.to_openmetrics(&state.bench.snapshot()))
}
