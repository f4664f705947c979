//! Looking for drives on a link, and taking them in.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::input::{Input, number};
use super::{Answer, Shared, by_rest};
use crate::message::{ErrorBody, LookOrder, LookView, TakeIn, TakenIn};
use crate::session::Caller;

/// The look for drives that is under way on a link, or the last one
#[utoipa::path(get, path = "/api/v1/links/{id}/look", operation_id = "look", tag = "look",
    params(("id" = u16, Path)), responses(
    (status = 200, body = LookView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(State(gate): State<Shared>, Path(id): Path<String>) -> Answer<LookView> {
    gate.bench.look_told(number(&id)?).map(Json)
}

/// Look for drives on a link
///
/// By reads only. It answers when it has begun; `look` on the WebSocket tells how far it is. 409
/// (`gateway.look`) while another look is under way, or an axis of the link is commanded, armed,
/// powered, turning or being stopped. Until its end nobody gets an axis of the link; any stop there
/// breaks it off.
#[utoipa::path(post, path = "/api/v1/links/{id}/look", operation_id = "begin_look", tag = "look",
    params(("id" = u16, Path)), request_body = LookOrder, responses(
    (status = 200, body = LookView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn begin(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(order): Input<LookOrder>,
) -> Answer<LookView> {
    gate.bench.look(number(&id)?, &by_rest(&caller), order).await.map(Json)
}

/// Break a look off
#[utoipa::path(delete, path = "/api/v1/links/{id}/look", operation_id = "break_look_off",
    tag = "look", params(("id" = u16, Path)), responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn break_off(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> Answer<()> {
    gate.bench.break_look_off(number(&id)?, &by_rest(&caller)).map(Json)
}

/// Make axes of drives that were found
///
/// They come behind all other axes, which go on as they were. A drive that clashes with another is
/// not taken in.
#[utoipa::path(post, path = "/api/v1/links/{id}/look/take", operation_id = "take_in", tag = "look",
    params(("id" = u16, Path)), request_body = TakeIn, responses(
    (status = 200, body = TakenIn),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn take_in(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(take): Input<TakeIn>,
) -> Answer<TakenIn> {
    gate.bench.take_in(number(&id)?, &by_rest(&caller), &take).await.map(Json)
}
