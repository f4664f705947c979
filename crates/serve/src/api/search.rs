//! Searches ports for drives of unknown protocol and rate.

use axum::Json;
use axum::extract::{Extension, State};

use super::input::JsonBody;
use super::{ApiResult, run_blocking};
use crate::app_state::{SharedAppState, rest_session};
use crate::auth::Caller;
use crate::message::{ErrorBody, SearchRequest, SearchView};

/// The search of ports that is under way, or the last one
#[utoipa::path(get, path = "/api/v1/search", operation_id = "search", tag = "look", responses(
    (status = 200, body = SearchView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(State(state): State<SharedAppState>) -> ApiResult<SearchView> {
    state.bench.search_view().map(Json)
}

/// Search ports for drives
///
/// Only reads are sent, with all protocols and the usual rates, on ports of the server's machine that no link uses. The
/// reply comes when the search has begun; `search` on the WebSocket reports its progress. 409 (`gateway.look`) during
/// another search, and for a port that a link uses.
#[utoipa::path(post, path = "/api/v1/search", operation_id = "begin_search", tag = "look",
    request_body = SearchRequest, responses(
    (status = 200, body = SearchView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn start(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    JsonBody(request): JsonBody<SearchRequest>,
) -> ApiResult<SearchView> {
    let session = rest_session(&caller);
    // Ports are listed first, which reads files of the system.
    run_blocking(&state, move |app| app.bench.start_search(&session, &request)).await.map(Json)
}

/// Break a search off
#[utoipa::path(delete, path = "/api/v1/search", operation_id = "break_search_off", tag = "look",
    responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn cancel(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
) -> ApiResult<()> {
    state.bench.cancel_search(&rest_session(&caller)).map(Json)
}
