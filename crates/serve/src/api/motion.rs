//! Leases, commands, stops.

use axum::Json;
use axum::extract::{Extension, Path, State};
use polepair_core::time::Instant;
use polepair_link::clock;

use super::input::{Input, number};
use super::{Answer, Shared, by_lease, by_rest};
use crate::bench::Reply;
use crate::message::{
    CommandOrder, DismissAbsent, DismissStop, Epoch, ErrorBody, LeaseAct, LeaseGranted, Outcome,
    RawOrder, Refused, StopOrder, Stopped, TakeLease,
};
use crate::session::Caller;

/// Take an axis
///
/// The lease ends after 1.5 s unless it is renewed, and its end stops what was set in motion under it.
#[utoipa::path(post, path = "/api/v1/axes/{id}/lease", tag = "motion",
    params(("id" = u16, Path)), request_body = TakeLease, responses(
    (status = 200, body = LeaseGranted),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn take(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(TakeLease { take }): Input<TakeLease>,
) -> Answer<LeaseGranted> {
    let act = if take { LeaseAct::TakeOver } else { LeaseAct::Take };
    granted(gate.bench.lease(number(&id)?, &by_rest(&caller), act, 0).await)
}

/// Keep an axis
#[utoipa::path(post, path = "/api/v1/axes/{id}/lease/renew", tag = "motion",
    params(("id" = u16, Path)), request_body = Epoch, responses(
    (status = 200, body = LeaseGranted),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn renew(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(Epoch { epoch }): Input<Epoch>,
) -> Answer<LeaseGranted> {
    granted(gate.bench.lease(number(&id)?, &by_rest(&caller), LeaseAct::Renew, epoch).await)
}

/// Give an axis back
#[utoipa::path(delete, path = "/api/v1/axes/{id}/lease", tag = "motion",
    params(("id" = u16, Path)), request_body = Epoch, responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn give_back(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(Epoch { epoch }): Input<Epoch>,
) -> Answer<()> {
    let given = gate.bench.lease(number(&id)?, &by_rest(&caller), LeaseAct::Drop, epoch).await;
    given.map(|_| Json(()))
}

fn granted(granted: Result<Option<LeaseGranted>, Refused>) -> Answer<LeaseGranted> {
    let ended = || Refused::new("gateway.lease", "the lease has ended");
    granted?.map(Json).ok_or_else(ended)
}

/// Have an axis do something, at most once
///
/// An id that was seen returns what came of it then, and sends nothing. What is too old, of another
/// epoch, or locked is refused; nothing is sent then either.
#[utoipa::path(post, path = "/api/v1/axes/{id}/commands", tag = "motion",
    params(("id" = u16, Path)), request_body = CommandOrder, responses(
    (status = 200, body = Outcome),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn command(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(order): Input<CommandOrder>,
) -> Answer<Outcome> {
    let since = clock::now();
    let reply = gate.bench.command(number(&id)?, &by_rest(&caller), order);
    carried_out(&gate, since, reply).await
}

/// Send a request in the protocol's own text, at most once
///
/// No limits stand for it, and it may move the motor or write its permanent memory: so it needs the
/// scope `raw`, which no token has unless somebody writes it beside one, and which the server does not
/// grant unless it is started so.
#[utoipa::path(post, path = "/api/v1/axes/{id}/raw", tag = "motion",
    params(("id" = u16, Path)), request_body = RawOrder, responses(
    (status = 200, body = Outcome),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn raw(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(order): Input<RawOrder>,
) -> Answer<Outcome> {
    let since = clock::now();
    let (id, session) = (number(&id)?, by_lease(&gate, &caller, number(&id)?, order.epoch));
    carried_out(&gate, since, gate.bench.raw(id, &session, order)).await
}

/// Waits for what comes of it. What the gateway itself refused is an error of HTTP as well.
async fn carried_out(gate: &Shared, since: Instant, reply: Reply<Outcome>) -> Answer<Outcome> {
    let outcome = reply.await?;
    gate.metrics.commands.observe(clock::now().since(since).as_secs_f64());
    match outcome.error {
        Some(refused) if refused.code.starts_with("gateway.") && !outcome.replayed => Err(refused),
        _ => Ok(Json(outcome)),
    }
}

/// Stop axes, whoever commands them
///
/// All of them, and motion is locked until it is released, where no axes are named. Needs no lease, and
/// ends those of the axes that stop. This is not a certified safety function: hard-wire STO and
/// emergency stop.
#[utoipa::path(post, path = "/api/v1/stop", tag = "motion", request_body = StopOrder, responses(
    (status = 200, body = Stopped),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn stop(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Input(order): Input<StopOrder>,
) -> Answer<Stopped> {
    let since = clock::now();
    let stopped = gate.bench.stop(&by_rest(&caller), &order).await?;
    gate.metrics.stops.observe(clock::now().since(since).as_secs_f64());
    Ok(Json(stopped))
}

/// Owe an axis its stop no more, though nobody saw it stand
///
/// For who knows better than the server: the drive is gone, another master has it, something else turns
/// its shaft; or, by whoever holds its lease, to command it on though it may be turning. The journal
/// keeps who said so.
#[utoipa::path(post, path = "/api/v1/axes/{id}/dismiss", tag = "motion",
    params(("id" = u16, Path)), request_body = DismissStop,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn dismiss(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(dismiss): Input<DismissStop>,
) -> Answer<()> {
    let (id, epoch) = (number(&id)?, dismiss.epoch);
    let session = by_lease(&gate, &caller, id, epoch);
    gate.bench.dismiss(id, &session, dismiss).await.map(Json)
}

/// Owe a drive that is not there its stop no more
///
/// For a drive that the server before owed a stop when it ended and that does not answer any more. The
/// journal keeps who said so.
#[utoipa::path(post, path = "/api/v1/dismiss", tag = "motion", request_body = DismissAbsent,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn dismiss_absent(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Input(dismiss): Input<DismissAbsent>,
) -> Answer<()> {
    gate.bench.dismiss_absent(&by_rest(&caller), dismiss).await.map(Json)
}

/// Let motion again after everything was stopped
#[utoipa::path(post, path = "/api/v1/release", tag = "motion",
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn release(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
) -> Answer<()> {
    gate.bench.release(&by_rest(&caller), gate.bench.locks()).await.map(Json)
}
