//! Scans a link, and adds the found drives.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::ApiResult;
use super::input::{JsonBody, parse_index};
use crate::app_state::{SharedAppState, rest_session};
use crate::auth::Caller;
use crate::message::{AddDrives, AddedAxes, ErrorBody, ScanRequest, ScanView};

/// The look for drives that is under way on a link, or the last one
#[utoipa::path(get, path = "/api/v1/links/{id}/look", operation_id = "look", tag = "look",
    params(("id" = u16, Path)), responses(
    (status = 200, body = ScanView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<ScanView> {
    state.bench.scan_view(parse_index(&id)?).map(Json)
}

/// Look for drives on a link
///
/// Only reads are sent. The reply comes when the scan has begun; `look` on the WebSocket reports its progress. 409
/// (`gateway.look`) during another scan, or while an axis of the link is commanded, armed, powered, turning or being
/// stopped. Until its end no client gets an axis of the link; any stop there ends it.
#[utoipa::path(post, path = "/api/v1/links/{id}/look", operation_id = "begin_look", tag = "look",
    params(("id" = u16, Path)), request_body = ScanRequest, responses(
    (status = 200, body = ScanView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn start(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(request): JsonBody<ScanRequest>,
) -> ApiResult<ScanView> {
    state.bench.start_scan(parse_index(&id)?, &rest_session(&caller), request).await.map(Json)
}

/// Break a look off
#[utoipa::path(delete, path = "/api/v1/links/{id}/look", operation_id = "break_look_off",
    tag = "look", params(("id" = u16, Path)), responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn cancel(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> ApiResult<()> {
    state.bench.cancel_scan(parse_index(&id)?, &rest_session(&caller)).map(Json)
}

/// Make axes of drives that were found
///
/// They come behind all other axes, which go on as they were. A drive that clashes with another is
/// not taken in.
#[utoipa::path(post, path = "/api/v1/links/{id}/look/take", operation_id = "take_in", tag = "look",
    params(("id" = u16, Path)), request_body = AddDrives, responses(
    (status = 200, body = AddedAxes),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn add_drives(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(take): JsonBody<AddDrives>,
) -> ApiResult<AddedAxes> {
    state.bench.add_drives(parse_index(&id)?, &rest_session(&caller), &take).await.map(Json)
}
