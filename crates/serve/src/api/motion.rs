//! Leases, commands, stops.

use axum::Json;
use axum::extract::{Extension, Path, Request, State};
use polepair_core::time::Instant;
use polepair_link::clock;

use super::ApiResult;
use super::input::{JsonBody, parse_index, parse_json, read_body};
use crate::app_state::{SharedAppState, lease_session, rest_session};
use crate::auth::Caller;
use crate::bench::PendingReply;
use crate::message::{
    AcquireLease, CommandOutcome, CommandRequest, DismissAbsent, DismissStop, DriveLogView,
    ErrorBody, GatewayError, LeaseAction, LeaseEpoch, LeaseGrant, RawRequest, RecordDriveLog,
    StopReport, StopRequest,
};

/// Take an axis
///
/// The lease ends after 1.5 s unless it is renewed, and its end stops the motions under it.
#[utoipa::path(post, path = "/api/v1/axes/{id}/lease", operation_id = "take", tag = "motion",
    params(("id" = u16, Path)), request_body = AcquireLease, responses(
    (status = 200, body = LeaseGrant),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn acquire_lease(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(AcquireLease { take }): JsonBody<AcquireLease>,
) -> ApiResult<LeaseGrant> {
    let act = if take { LeaseAction::TakeOver } else { LeaseAction::Take };
    require_grant(
        state.bench.request_lease(parse_index(&id)?, &rest_session(&caller), act, 0).await,
    )
}

/// Keep an axis
#[utoipa::path(post, path = "/api/v1/axes/{id}/lease/renew", operation_id = "renew", tag = "motion",
    params(("id" = u16, Path)), request_body = LeaseEpoch, responses(
    (status = 200, body = LeaseGrant),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn renew_lease(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(LeaseEpoch { epoch }): JsonBody<LeaseEpoch>,
) -> ApiResult<LeaseGrant> {
    require_grant(
        state
            .bench
            .request_lease(parse_index(&id)?, &rest_session(&caller), LeaseAction::Renew, epoch)
            .await,
    )
}

/// Give an axis back
#[utoipa::path(delete, path = "/api/v1/axes/{id}/lease", operation_id = "give_back", tag = "motion",
    params(("id" = u16, Path)), request_body = LeaseEpoch, responses(
    (status = 200, body = ()),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn release_lease(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(LeaseEpoch { epoch }): JsonBody<LeaseEpoch>,
) -> ApiResult<()> {
    let given = state
        .bench
        .request_lease(parse_index(&id)?, &rest_session(&caller), LeaseAction::Drop, epoch)
        .await;
    given.map(|_| Json(()))
}

fn require_grant(granted: Result<Option<LeaseGrant>, GatewayError>) -> ApiResult<LeaseGrant> {
    granted?.map(Json).ok_or_else(|| GatewayError::new("gateway.lease", "the lease has ended"))
}

/// Have an axis do something, at most once
///
/// An id that was received before returns the earlier outcome, and sends nothing. A command that is too old, of another
/// epoch, or locked is refused; nothing is sent then either.
#[utoipa::path(post, path = "/api/v1/axes/{id}/commands", tag = "motion",
    params(("id" = u16, Path)), request_body = CommandRequest, responses(
    (status = 200, body = CommandOutcome),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn command(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(request): JsonBody<CommandRequest>,
) -> ApiResult<CommandOutcome> {
    let since = clock::now();
    let reply = state.bench.command(parse_index(&id)?, &rest_session(&caller), request);
    await_outcome(&state, since, reply).await
}

/// Record in the drive's own control loop, and have it do something meanwhile
///
/// All variables of a point are of one instant. The command is given as soon as the recording runs; without one,
/// nothing moves. The answer comes when the points have been read.
#[utoipa::path(post, path = "/api/v1/axes/{id}/drive-log", tag = "motion",
    params(("id" = u16, Path)), request_body = RecordDriveLog, responses(
    (status = 200, body = DriveLogView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn record_in_drive(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(wanted): JsonBody<RecordDriveLog>,
) -> ApiResult<DriveLogView> {
    let id = parse_index(&id)?;
    let session = lease_session(&state, &caller, id, wanted.epoch);
    state.bench.record_in_drive(id, &session, wanted).await.map(Json)
}

/// Send a request in the protocol's own text, at most once
///
/// No limits apply, and the text may move the motor or write its permanent memory. It needs the scope `raw`, which a
/// token has only if it is written beside it, and which the server grants only if it is started with it.
#[utoipa::path(post, path = "/api/v1/axes/{id}/raw", tag = "motion",
    params(("id" = u16, Path)), request_body = RawRequest, responses(
    (status = 200, body = CommandOutcome),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn raw(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(request): JsonBody<RawRequest>,
) -> ApiResult<CommandOutcome> {
    let since = clock::now();
    let (id, session) =
        (parse_index(&id)?, lease_session(&state, &caller, parse_index(&id)?, request.epoch));
    await_outcome(&state, since, state.bench.raw(id, &session, request)).await
}

/// Waits for the outcome. A refusal by the gateway itself is an error of HTTP as well.
async fn await_outcome(
    state: &SharedAppState,
    since: Instant,
    reply: PendingReply<CommandOutcome>,
) -> ApiResult<CommandOutcome> {
    let outcome = reply.await?;
    state.metrics.commands.observe(clock::now().since(since).as_secs_f64());
    match outcome.error {
        Some(refused) if refused.code.starts_with("gateway.") && !outcome.replayed => Err(refused),
        _ => Ok(Json(outcome)),
    }
}

/// Stop axes, also those that other clients command
///
/// All of them, and motion is locked until it is released, where no axes are named. Needs no lease, and
/// ends those of the axes that stop. This is not a certified safety function: hard-wire STO and
/// emergency stop.
#[utoipa::path(post, path = "/api/v1/stop", tag = "motion", request_body = StopRequest, responses(
    (status = 200, body = StopReport),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn stop(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> ApiResult<StopReport> {
    let body = read_body(request).await?;
    // Without a body it is everything.
    let request = if body.is_empty() { StopRequest::default() } else { parse_json(&body)? };
    let since = clock::now();
    let stopped = state.bench.stop(&rest_session(&caller), &request).await?;
    state.metrics.stops.observe(clock::now().since(since).as_secs_f64());
    Ok(Json(stopped))
}

/// Clear the pending stop of an axis without measured standstill
///
/// For clients that know more than the server: the drive is gone, another master has it, something else turns its
/// shaft; or, for the holder of the lease, to command the axis on although it may be turning. The journal keeps the
/// session.
#[utoipa::path(post, path = "/api/v1/axes/{id}/dismiss", tag = "motion",
    params(("id" = u16, Path)), request_body = DismissStop,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn dismiss(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(dismiss): JsonBody<DismissStop>,
) -> ApiResult<()> {
    let (id, epoch) = (parse_index(&id)?, dismiss.epoch);
    let session = lease_session(&state, &caller, id, epoch);
    state.bench.dismiss(id, &session, dismiss).await.map(Json)
}

/// Owe a drive that is not there its stop no more
///
/// For a drive whose stop was pending when the previous server ended and that does not answer any more. The journal
/// keeps the session.
#[utoipa::path(post, path = "/api/v1/dismiss", tag = "motion", request_body = DismissAbsent,
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn dismiss_absent(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    JsonBody(dismiss): JsonBody<DismissAbsent>,
) -> ApiResult<()> {
    state.bench.dismiss_absent(&rest_session(&caller), dismiss).await.map(Json)
}

/// Let motion again after everything was stopped
#[utoipa::path(post, path = "/api/v1/release", tag = "motion",
    responses((status = 200, body = ()), (status = "default", body = ErrorBody)))]
pub(super) async fn release(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
) -> ApiResult<()> {
    state.bench.release(&rest_session(&caller), state.bench.lock_count()).await.map(Json)
}
