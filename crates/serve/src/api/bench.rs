//! The bench, and what can be done to a simulated one.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::input::{Input, number};
use super::{Answer, Shared, by_rest};
use crate::message::{Act, BenchView, ErrorBody, Pace};
use crate::session::Caller;

/// What there is
///
/// Links, axes, what each can be told.
#[utoipa::path(get, path = "/api/v1/bench", operation_id = "bench", tag = "bench", responses(
    (status = 200, body = BenchView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
) -> Json<BenchView> {
    Json(of(&gate, &caller))
}

/// The bench as a caller sees it.
pub(crate) fn of(gate: &Shared, caller: &Caller) -> BenchView {
    BenchView { scopes: caller.scopes.iter().collect(), ..gate.bench.snapshot() }
}

/// Meddle with a simulated drive
///
/// `drive` counts the axes of the link from 0. 409 where it is a real one.
#[utoipa::path(post, path = "/api/v1/simulation/{link}/{drive}", tag = "simulation",
    params(("link" = u16, Path), ("drive" = u16, Path)), request_body = Act, responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn act(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path((link, drive)): Path<(String, String)>,
    Input(act): Input<Act>,
) -> Answer<()> {
    gate.bench.act(&by_rest(&caller), number(&link)?, number(&drive)?, &act).await.map(Json)
}

/// Set how fast simulated time passes
#[utoipa::path(post, path = "/api/v1/simulation/pace", tag = "simulation", request_body = Pace,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn pace(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Input(pace): Input<Pace>,
) -> Answer<()> {
    gate.bench.pace(&by_rest(&caller), pace).await.map(Json)
}
