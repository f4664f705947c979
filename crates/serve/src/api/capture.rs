//! Uploaded captures: stored as files, decoded on threads that answer no other requests.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, Request, State};
use serde::Deserialize;

use super::input::read_body;
use super::{ApiResult, run_blocking};
use crate::app_state::SharedAppState;
use crate::message::{CapturePage, ErrorBody, ExplainedField, GatewayError, OpenedCapture};

/// Frames of a page, if the request has no count.
const PAGE_FRAMES: usize = 200;

/// Name of a capture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CaptureQuery {
    #[serde(default)]
    name: String,
}

/// Which page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CapturePageQuery {
    #[serde(default)]
    from: u64,
    count: Option<usize>,
    filter: Option<String>,
}

/// Take a capture in
///
/// The file as it is, at most 64 MiB. It is kept until newer ones push it out.
#[utoipa::path(post, path = "/api/v1/captures", tag = "captures",
    params(("name" = Option<String>, Query)),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"), responses(
    (status = 200, body = OpenedCapture),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn open(
    State(state): State<SharedAppState>,
    named: Result<Query<CaptureQuery>, QueryRejection>,
    request: Request,
) -> ApiResult<OpenedCapture> {
    let Query(CaptureQuery { name }) = named.map_err(|error| request_error(error.body_text()))?;
    // Before its bytes come, so that no more of them lie here than there are places.
    let permit = Arc::clone(&state.uploads).try_acquire_owned().map_err(|_| {
        GatewayError::new("gateway.busy", "too many captures are being uploaded").hint("try again")
    })?;
    let bytes = read_body(request).await?;
    let opened = run_blocking(&state, move |state| {
        let opened = state.bench.open_capture(&name, bytes.into());
        drop(permit);
        opened
    });
    opened.await.map(Json)
}

/// Read a capture's frames
///
/// At most 1,000 from the one of that number on.
#[utoipa::path(get, path = "/api/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path), ("from" = Option<u64>, Query), ("count" = Option<usize>, Query),
        ("filter" = Option<String>, Query)), responses(
    (status = 200, body = CapturePage),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn page(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
    page: Result<Query<CapturePageQuery>, QueryRejection>,
) -> ApiResult<CapturePage> {
    let Query(CapturePageQuery { from, count, filter }) =
        page.map_err(|error| request_error(error.body_text()))?;
    let count = count.unwrap_or(PAGE_FRAMES);
    let page = run_blocking(&state, move |state| {
        state.bench.capture_page(&id, from, count, filter.as_deref())
    });
    page.await.map(Json)
}

/// Take a frame of a capture apart
#[utoipa::path(get, path = "/api/v1/captures/{id}/frames/{n}", tag = "captures",
    params(("id" = String, Path), ("n" = u64, Path)), responses(
    (status = 200, body = Vec<ExplainedField>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn frame(
    State(state): State<SharedAppState>,
    Path((id, n)): Path<(String, String)>,
) -> ApiResult<Vec<ExplainedField>> {
    let n =
        n.parse().map_err(|_| GatewayError::new("gateway.missing", format!("no frame {n:?}")))?;
    run_blocking(&state, move |state| state.bench.explain_captured(&id, n)).await.map(Json)
}

fn request_error(what: String) -> GatewayError {
    GatewayError::new("gateway.request", what)
}
