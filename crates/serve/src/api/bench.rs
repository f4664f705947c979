//! The list of links and axes, and acts on simulated drives.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::ApiResult;
use super::input::{JsonBody, parse_index};
use crate::app_state::{SharedAppState, rest_session};
use crate::auth::Caller;
use crate::message::{BenchView, ErrorBody, SetTimeScale, SimulationAction};

/// Links and axes of the gateway
///
/// Links, axes, and the commands of each.
#[utoipa::path(get, path = "/api/v1/bench", operation_id = "bench", tag = "bench", responses(
    (status = 200, body = BenchView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
) -> Json<BenchView> {
    Json(state.bench_view(&caller))
}

/// Meddle with a simulated drive
///
/// `drive` counts the axes of the link from 0. 409 where it is a real one.
#[utoipa::path(post, path = "/api/v1/simulation/{link}/{drive}", operation_id = "act", tag = "simulation",
    params(("link" = u16, Path), ("drive" = u16, Path)), request_body = SimulationAction, responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn apply_action(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path((link, drive)): Path<(String, String)>,
    JsonBody(act): JsonBody<SimulationAction>,
) -> ApiResult<()> {
    state
        .bench
        .apply_action(&rest_session(&caller), parse_index(&link)?, parse_index(&drive)?, &act)
        .await
        .map(Json)
}

/// Set how fast simulated time passes
#[utoipa::path(post, path = "/api/v1/simulation/pace", operation_id = "pace", tag = "simulation",
    request_body = SetTimeScale,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn set_time_scale(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    JsonBody(pace): JsonBody<SetTimeScale>,
) -> ApiResult<()> {
    state.bench.set_time_scale(&rest_session(&caller), pace).await.map(Json)
}
