//! Requests that change something: leases, commands, stops, acts, login.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::GatewayError;
use crate::scope::Scope;

/// Validity of a command that states none.
pub const DEFAULT_TTL_MS: f64 = 500.0;

/// `POST /api/v1/axes/{id}/lease`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AcquireLease {
    /// Take it over from another client: the journal records it, and the axis is stopped.
    #[serde(default)]
    pub take: bool,
}

/// A lease that was given or renewed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeaseGrant {
    /// Epoch that commands must carry.
    pub epoch: u64,
    /// When it ends unless it is renewed.
    pub expires_ms: f64,
    /// The server's time when it granted the lease. Commands carry it, plus the time since, as `issued_ms`.
    #[serde(default)]
    pub server_ms: f64,
}

/// `POST /api/v1/axes/{id}/lease/renew`, `DELETE /api/v1/axes/{id}/lease`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseEpoch {
    /// Epoch of the caller's lease.
    pub epoch: u64,
}

/// `POST /api/v1/axes/{id}/commands`; on the WebSocket with `axis` beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CommandRequest {
    /// The client's, new for each command (a UUID): one that was seen is not carried out again.
    pub id: String,
    /// Time of the command, by the server's clock: `server_ms` of the lease, the bench or a `pong`, plus the
    /// time since.
    pub issued_ms: f64,
    /// Validity of the command.
    #[serde(default = "ttl_ms")]
    pub ttl_ms: f64,
    /// Epoch of the caller's lease.
    pub epoch: u64,
    /// Verb of the command: a word of [`VerbInfo::verb`](super::VerbInfo::verb).
    pub verb: String,
    /// With what.
    #[serde(default)]
    pub arguments: CommandArguments,
}

/// `POST /api/v1/axes/{id}/raw`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRequest {
    /// Key of the request, as [`CommandRequest::id`].
    pub id: String,
    /// Time of the request, as [`CommandRequest::issued_ms`].
    pub issued_ms: f64,
    /// Validity of the request, as [`CommandRequest::ttl_ms`].
    #[serde(default = "ttl_ms")]
    pub ttl_ms: f64,
    /// Epoch of the caller's lease.
    pub epoch: u64,
    /// A request in the protocol's own text: `GAP 1`, `read 0x1000`. No limits stand for it.
    pub text: String,
}

const fn ttl_ms() -> f64 {
    DEFAULT_TTL_MS
}

/// Arguments of a command, in SI.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CommandArguments {
    /// Target or distance: rad, m, or a ratio.
    pub target: Option<f64>,
    /// Speed per second, in the unit of the target.
    pub velocity: Option<f64>,
    /// Acceleration per second squared.
    pub acceleration: Option<f64>,
    /// Deceleration per second squared.
    pub deceleration: Option<f64>,
    /// N·m, or a ratio.
    pub torque: Option<f64>,
    /// Seconds.
    pub jerk_time: Option<f64>,
    /// Seconds.
    pub period: Option<f64>,
    /// Number of a path that is stored in the drive.
    pub path: Option<f64>,
}

/// The result of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CommandOutcome {
    /// The client's id.
    pub id: String,
    /// True if the drive did it.
    pub outcome: OutcomeKind,
    /// Reply of the drive to a raw request, as it was on the wire.
    #[serde(default)]
    pub value: Option<i64>,
    /// The reason of a failure, or of an unknown result.
    #[schema(required)]
    pub error: Option<GatewayError>,
    /// The id was used before; this is its first result, and nothing was sent now.
    pub replayed: bool,
}

/// Outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutcomeKind {
    /// The drive did it.
    Done,
    /// The drive did not execute it, and will not.
    NotDone,
    /// The drive may have executed it, or executed a part: the error has the known facts, such as the end of a motion.
    Unknown,
}

/// `POST /api/v1/stop`. What of it can be read is obeyed, and the reply names the rest.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, from = "serde_json::Map<String, serde_json::Value>")]
pub struct StopRequest {
    /// Which; `null` stops all of them and locks motion.
    pub axes: Option<Vec<u16>>,
    /// For the journal.
    pub reason: String,
    /// Unreadable parts: keys and axes as they were written.
    #[serde(skip)]
    #[schema(ignore)]
    pub unreadable: Vec<String>,
}

impl From<serde_json::Map<String, serde_json::Value>> for StopRequest {
    fn from(fields: serde_json::Map<String, serde_json::Value>) -> Self {
        use serde_json::Value;
        let mut request = Self::default();
        for (key, value) in fields {
            match (key.as_str(), value) {
                ("axes", Value::Null) => {}
                ("axes", Value::Array(axes)) => {
                    let known = request.axes.get_or_insert_default();
                    for axis in axes {
                        match axis_index(&axis) {
                            Some(id) => known.push(id),
                            None => request.unreadable.push(format!("axis {axis}")),
                        }
                    }
                }
                ("axes", other) => match axis_index(&other) {
                    Some(id) => request.axes = Some(vec![id]),
                    None => {
                        request.axes = Some(Vec::new());
                        request.unreadable.push(format!("axes {other}"));
                    }
                },
                ("reason", Value::String(reason)) => request.reason = reason,
                (_, value) => request.unreadable.push(format!("{key:?}: {value}")),
            }
        }
        request
    }
}

/// The index of an axis: a whole number, however it is written.
fn axis_index(value: &serde_json::Value) -> Option<u16> {
    let number = value.as_f64()?;
    (number.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&number))
        .then_some(number as u16)
}

/// Result of a stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StopReport {
    /// Each axis.
    pub axes: Vec<AxisStopReport>,
    /// Targets that a stop of all axes did not reach.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unreached: Vec<UnreachedTarget>,
    /// Parts of the request that could not be executed: axes that do not exist, unreadable words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<GatewayError>,
}

/// A target that a stop of everything did not reach: an axis that is absent, or all of a link that is not open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UnreachedTarget {
    /// Index among the links.
    pub link: u16,
    /// Connection string of the link.
    pub url: String,
    /// The number of an axis of it that is not there; none where the link is not open: how many motors
    /// it has is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<u32>,
    /// The reason.
    pub error: GatewayError,
}

/// Result of the stop of one axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisStopReport {
    /// Index among the axes.
    pub id: u16,
    /// Certain progress of the stop.
    pub class: StopClass,
    /// After how long that was certain, from the moment that the server took the stop.
    pub ms: f64,
    /// The stop did not slow the motor, so that a quick stop was sent.
    #[serde(default)]
    pub quick: bool,
    /// Error of the stop, if there was one.
    #[schema(required)]
    pub error: Option<GatewayError>,
}

/// Certain progress of a stop. From `sent` on each includes those before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StopClass {
    /// Nothing left. As an answer: and nothing will, because the drive has no stop.
    Failed,
    /// The time limit is over, or the link is lost: standstill is not confirmed. The stop is pending and
    /// repeated, see [`AxisState::pending_stop`](super::AxisState::pending_stop).
    Pending,
    /// The stop was sent. As an answer: to a group, whose drives confirm nothing on this wire.
    Sent,
    /// The drive answered all of it. As an answer: and it has nothing by which it could be seen
    /// standing.
    Acknowledged,
    /// Standstill was measured, by readings that were requested after the drive had acknowledged the stop.
    Standing,
}

/// `POST /api/v1/axes/{id}/dismiss`: clears the pending stop of an axis without confirmed standstill.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DismissStop {
    /// Why not.
    pub reason: DismissReason,
    /// Epoch of the caller's lease, for `taken_over`.
    #[serde(default)]
    pub epoch: u64,
    /// For the journal; may be empty.
    #[serde(default)]
    pub note: String,
}

/// `POST /api/v1/dismiss`: clears the pending stop of a missing drive, left by the previous server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DismissAbsent {
    /// The connection string of its link, as the list of links or the server's first lines have it.
    pub link: String,
    /// Address on that link.
    pub number: u32,
    /// The reason. `taken_over` is for present axes only.
    pub reason: DismissReason,
    /// For the journal; may be empty.
    #[serde(default)]
    pub note: String,
}

/// The reason for clearing a pending stop without confirmed standstill.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DismissReason {
    /// The drive was taken away, or has no supply.
    DriveGone,
    /// Another master commands it.
    OtherMaster,
    /// Something else turns its shaft: water a propeller, a load.
    TurnedByLoad,
    /// The holder of the lease continues, and knows that the motor may turn.
    TakenOver,
}

/// `POST /api/v1/simulation/{link}/{drive}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulationAction {
    /// A word of [`AxisInfo::acts`](super::AxisInfo::acts).
    pub act: String,
    /// Value of the act, for acts that take one.
    #[serde(default)]
    pub value: Option<f64>,
}

/// `POST /api/v1/simulation/pace`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetTimeScale {
    /// Number of times faster than real motors.
    pub time_scale: f64,
}

/// `POST /api/v1/login`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// The token.
    pub token: String,
}

impl std::fmt::Debug for Login {
    /// Tokens are never shown.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Login")
    }
}

/// Proof that the server has a token, without the token.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Proof {
    /// 64 hexadecimal digits: BLAKE3, keyed with the first token of the server's file, of
    /// `polepair proof 1`, a line feed, the 32 bytes of the challenge, and the `IP:PORT` at which the
    /// connection ends.
    pub proof: String,
}

/// The identity of the caller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SessionInfo {
    /// Scopes of the caller.
    pub scopes: Vec<Scope>,
}
