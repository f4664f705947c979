//! An axis: its state and its parameters.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::input::{Input, number};
use super::{Answer, Shared, by_lease};
use crate::message::{
    AxisState, Change, ErrorBody, ParameterInfo, ParameterRead, Refused, SetWatchdog, SignalValue,
    WatchdogTold, WriteParameters,
};
use crate::session::Caller;

/// Signals of one question.
const SIGNALS_MAX: usize = 64;

/// What is known of an axis
///
/// Nothing is asked of the drive.
#[utoipa::path(get, path = "/api/v1/axes/{id}", operation_id = "axis", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = AxisState),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(State(gate): State<Shared>, Path(id): Path<String>) -> Answer<AxisState> {
    gate.bench.axis(number(&id)?).map(Json)
}

/// Read signals now
///
/// Words with commas between them: `position,velocity`. What is read stands in this order.
#[utoipa::path(get, path = "/api/v1/axes/{id}/signals/{words}", tag = "axis",
    params(("id" = u16, Path), ("words" = String, Path)), responses(
    (status = 200, body = Vec<SignalValue>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn signals(
    State(gate): State<Shared>,
    Path((id, words)): Path<(String, String)>,
) -> Answer<Vec<SignalValue>> {
    let words: Vec<&str> = words.split(',').take(SIGNALS_MAX + 1).collect();
    if words.len() > SIGNALS_MAX {
        let what = format!("at most {SIGNALS_MAX} signals are read at once");
        return Err(Refused::new("gateway.request", what));
    }
    gate.bench.read_signals(number(&id)?, &words).await.map(Json)
}

/// Which parameters an axis has
///
/// Names, units, limits; no values.
#[utoipa::path(get, path = "/api/v1/axes/{id}/parameters", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = Vec<ParameterInfo>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn parameters(
    State(gate): State<Shared>,
    Path(id): Path<String>,
) -> Answer<Vec<ParameterInfo>> {
    gate.bench.parameters(number(&id)?).map(Json)
}

/// Read a parameter now
#[utoipa::path(get, path = "/api/v1/axes/{id}/parameters/{name}", tag = "axis",
    params(("id" = u16, Path), ("name" = String, Path)), responses(
    (status = 200, body = ParameterRead),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn parameter(
    State(gate): State<Shared>,
    Path((id, name)): Path<(String, String)>,
) -> Answer<ParameterRead> {
    gate.bench.read_parameter(number(&id)?, &name).await.map(Json)
}

/// Write parameters, or see what would change
///
/// Limits are checked before anything is sent. Needs the axis' lease unless it is a dry run.
#[utoipa::path(post, path = "/api/v1/axes/{id}/parameters", tag = "axis",
    params(("id" = u16, Path)), request_body = WriteParameters, responses(
    (status = 200, body = Vec<Change>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn write(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(wanted): Input<WriteParameters>,
) -> Answer<Vec<Change>> {
    let id = number(&id)?;
    let session = by_lease(&gate, &caller, id, wanted.epoch);
    gate.bench.apply(id, &session, wanted).await.map(Json)
}

/// What a drive does by itself when its host falls silent
///
/// Read just now.
#[utoipa::path(get, path = "/api/v1/axes/{id}/watchdog", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = WatchdogTold),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn watchdog(
    State(gate): State<Shared>,
    Path(id): Path<String>,
) -> Answer<WatchdogTold> {
    gate.bench.watchdog(number(&id)?).await.map(Json)
}

/// Have a drive stop by itself when its host falls silent, or no more
///
/// Needs the axis' lease. Nothing moves by it.
#[utoipa::path(post, path = "/api/v1/axes/{id}/watchdog", tag = "axis",
    params(("id" = u16, Path)), request_body = SetWatchdog, responses(
    (status = 200, body = WatchdogTold),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn set_watchdog(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    Input(wanted): Input<SetWatchdog>,
) -> Answer<WatchdogTold> {
    let id = number(&id)?;
    let session = by_lease(&gate, &caller, id, wanted.epoch);
    gate.bench.set_watchdog(id, &session, wanted).await.map(Json)
}
