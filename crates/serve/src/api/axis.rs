//! State and parameters of an axis.

use axum::Json;
use axum::extract::{Extension, Path, State};

use super::input::{JsonBody, parse_index};
use super::{ApiResult, run_blocking};
use crate::app_state::{SharedAppState, lease_session};
use crate::auth::Caller;
use crate::bench;
use crate::message::{
    AxisState, DeviceDetailView, ErrorBody, GatewayError, ParameterChange, ParameterInfo,
    ParameterReading, PathPlan, PathTableMessage, PlanPaths, ProgramState, ProgramView,
    SetWatchdog, SignalValue, WatchdogView, WriteParameters,
};

/// Signals of one question.
const SIGNALS_MAX: usize = 64;

/// Last known state of an axis
///
/// Nothing is asked of the drive.
#[utoipa::path(get, path = "/api/v1/axes/{id}", operation_id = "axis", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = AxisState),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn show(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<AxisState> {
    state.bench.axis_state(parse_index(&id)?).map(Json)
}

/// Read signals now
///
/// Words with commas between them: `position,velocity`. The result has the same order.
#[utoipa::path(get, path = "/api/v1/axes/{id}/signals/{words}", tag = "axis",
    params(("id" = u16, Path), ("words" = String, Path)), responses(
    (status = 200, body = Vec<SignalValue>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn signals(
    State(state): State<SharedAppState>,
    Path((id, words)): Path<(String, String)>,
) -> ApiResult<Vec<SignalValue>> {
    let words: Vec<&str> = words.split(',').take(SIGNALS_MAX + 1).collect();
    if words.len() > SIGNALS_MAX {
        let what = format!("at most {SIGNALS_MAX} signals are read at once");
        return Err(GatewayError::new("gateway.request", what));
    }
    state.bench.read_signals(parse_index(&id)?, &words).await.map(Json)
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
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<Vec<ParameterInfo>> {
    state.bench.parameters(parse_index(&id)?).map(Json)
}

/// Read a parameter now
///
/// The name, the symbol, or the address of the parameter, such as `0x2030:1:u16`.
#[utoipa::path(get, path = "/api/v1/axes/{id}/parameters/{name}", tag = "axis",
    params(("id" = u16, Path), ("name" = String, Path)), responses(
    (status = 200, body = ParameterReading),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn parameter(
    State(state): State<SharedAppState>,
    Path((id, name)): Path<(String, String)>,
) -> ApiResult<ParameterReading> {
    state.bench.read_parameter(parse_index(&id)?, &name).await.map(Json)
}

/// Ask a drive for its name, versions and motors now
#[utoipa::path(get, path = "/api/v1/axes/{id}/device", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = Vec<DeviceDetailView>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn device(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<Vec<DeviceDetailView>> {
    state.bench.read_device(parse_index(&id)?).await.map(Json)
}

/// Read the stored paths of a drive
///
/// Some hundred requests: on a slow line this takes seconds.
#[utoipa::path(get, path = "/api/v1/axes/{id}/paths", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = PathTableMessage),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn paths(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<PathTableMessage> {
    state.bench.read_paths(parse_index(&id)?).await.map(Json)
}

/// See what loading paths would change, and where they lead
///
/// Nothing is sent to the drive. The answer has the writes that load them.
#[utoipa::path(post, path = "/api/v1/axes/{id}/paths", tag = "axis",
    params(("id" = u16, Path)), request_body = PlanPaths, responses(
    (status = 200, body = PathPlan),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn plan_paths(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
    JsonBody(wanted): JsonBody<PlanPaths>,
) -> ApiResult<PathPlan> {
    parse_index(&id)?;
    run_blocking(&state, move |_| bench::paths::plan_paths(&wanted)).await.map(Json)
}

/// Read the program in a module's memory
///
/// A request for each instruction: of a long program this takes seconds on a slow line.
#[utoipa::path(get, path = "/api/v1/axes/{id}/program", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = ProgramView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn program(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<ProgramView> {
    state.bench.read_program(parse_index(&id)?).await.map(Json)
}

/// Ask a module where its program is
#[utoipa::path(get, path = "/api/v1/axes/{id}/program/state", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = ProgramState),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn program_state(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<ProgramState> {
    state.bench.program_state(parse_index(&id)?).await.map(Json)
}

/// Write parameters, or see what would change
///
/// Limits are checked before anything is sent. Needs the axis' lease unless it is a dry run.
#[utoipa::path(post, path = "/api/v1/axes/{id}/parameters", tag = "axis",
    params(("id" = u16, Path)), request_body = WriteParameters, responses(
    (status = 200, body = Vec<ParameterChange>),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn write(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(wanted): JsonBody<WriteParameters>,
) -> ApiResult<Vec<ParameterChange>> {
    let id = parse_index(&id)?;
    let session = lease_session(&state, &caller, id, wanted.epoch);
    state.bench.write_parameters(id, &session, wanted).await.map(Json)
}

/// Reaction of a drive when its host falls silent
///
/// Read just now.
#[utoipa::path(get, path = "/api/v1/axes/{id}/watchdog", tag = "axis",
    params(("id" = u16, Path)), responses(
    (status = 200, body = WatchdogView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn watchdog(
    State(state): State<SharedAppState>,
    Path(id): Path<String>,
) -> ApiResult<WatchdogView> {
    state.bench.watchdog(parse_index(&id)?).await.map(Json)
}

/// Have a drive stop by itself when its host falls silent, or no more
///
/// Needs the axis' lease. Nothing moves by it.
#[utoipa::path(post, path = "/api/v1/axes/{id}/watchdog", tag = "axis",
    params(("id" = u16, Path)), request_body = SetWatchdog, responses(
    (status = 200, body = WatchdogView),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn set_watchdog(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
    JsonBody(wanted): JsonBody<SetWatchdog>,
) -> ApiResult<WatchdogView> {
    let id = parse_index(&id)?;
    let session = lease_session(&state, &caller, id, wanted.epoch);
    state.bench.set_watchdog(id, &session, wanted).await.map(Json)
}
