//! The bench as a whole: `GET /api/v1/bench`, and `bench` on the WebSocket.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{GatewayError, ScanView, SearchView};
use crate::scope::Scope;

/// Links and axes of the gateway, and their capabilities. Values are in [`AxisState`](super::AxisState).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BenchView {
    /// The server's version.
    pub version: String,
    /// The server's time at this reply.
    #[serde(default)]
    pub server_ms: f64,
    /// Scopes of the caller.
    pub scopes: Vec<Scope>,
    /// Every link, in the order of the command line.
    pub links: Vec<LinkView>,
    /// Every axis, in order of links, then addresses; behind them those that were taken in later.
    pub axes: Vec<AxisInfo>,
    /// Addresses at which more than one drive answers.
    pub clashes: Vec<Clash>,
    /// The last scan of each scanned link.
    pub looks: Vec<ScanView>,
    /// The last search of ports; `null` before the first.
    #[serde(default)]
    #[schema(required)]
    pub search: Option<SearchView>,
    /// Motion is locked since a stop of everything; `null` while it is not.
    #[schema(required)]
    pub lock: Option<MotionLock>,
    /// Number of times faster than real motors the simulated ones live; `null` where none is simulated.
    #[schema(required)]
    pub time_scale: Option<f64>,
}

/// A link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LinkView {
    /// Index among the links.
    pub id: u16,
    /// Connection string of the link.
    pub url: String,
    /// `serial` or `can`.
    pub medium: String,
    /// The drives on it live in this process.
    pub simulated: bool,
    /// True if it works.
    pub state: LinkState,
    /// Why it is not open; `null` while it is.
    #[schema(required)]
    pub error: Option<GatewayError>,
    /// Since when it is not, in milliseconds since 1970; `null` while it is open.
    #[schema(required)]
    pub since_ms: Option<f64>,
    /// Axes of its connection string that did not answer when it was opened, or are other drives than stated:
    /// they are no axes of the bench, and nothing stops them from here.
    #[serde(default)]
    pub absent: Vec<AbsentAxis>,
    /// Numbers of missing drives with a pending stop of the previous server: they may turn, and are stopped
    /// as soon as they reply.
    #[serde(default)]
    pub pending_stops: Vec<u32>,
    /// Load of the wire, 0 to 1; `null` if unknown.
    #[schema(required)]
    pub load: Option<f64>,
    /// Counters since it was opened.
    pub counters: Vec<LinkCounter>,
}

/// True if a link works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// The link is open.
    Open,
    /// The link was lost; its axes are disarmed.
    Lost,
    /// The link could not be opened so far, and is retried. Its axes are unknown.
    NotOpen,
}

/// An axis that was not there when its link was opened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AbsentAxis {
    /// The drive's address on the wire.
    pub number: u32,
    /// Why it is none of the bench.
    pub error: GatewayError,
}

/// Something counted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LinkCounter {
    /// Name of the counter in `snake_case`: `sent`, `received`, `errors`, `retries`.
    pub name: String,
    /// Value of the counter.
    pub count: u64,
}

/// An axis and its verbs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisInfo {
    /// Index among the axes.
    pub id: u16,
    /// The link that it is on.
    pub link: u16,
    /// Address on the link.
    pub number: u32,
    /// Name in a rack or in `polepair.toml`; empty without one.
    pub name: String,
    /// Label for people.
    pub label: String,
    /// The protocol's word.
    pub protocol: String,
    /// The product's full name.
    pub drive: String,
    /// The profile's word.
    pub profile: String,
    /// True if it is simulated in this process.
    pub simulated: bool,
    /// `rotary`, `linear` or `ratio`.
    pub kind: String,
    /// Reaction of the drive when its host falls silent, in a sentence.
    pub watchdog: String,
    /// Time after which it stops by itself, ms; `null` if it does not, or a parameter has the time.
    #[schema(required)]
    pub watchdog_ms: Option<u32>,
    /// The parameter with this time; `null` if there is none.
    #[schema(required)]
    pub watchdog_parameter: Option<String>,
    /// Checks before the first motion; may be empty.
    pub caution: String,
    /// Verbs of the axis.
    pub verbs: Vec<VerbInfo>,
    /// Limits that are known without asking the drive.
    pub limits: Vec<LimitInfo>,
    /// Signals of the axis.
    pub signals: Vec<SignalInfo>,
    /// Example of a parameter's address as a number: `0x2030:1:u16`.
    pub address_example: String,
    /// The module keeps a program, whose instructions `/api/v1/axes/{id}/program` lists.
    pub has_program: bool,
    /// Recorder in the drive's own control loop; `null` without one.
    #[schema(required)]
    pub drive_log: Option<DriveLogInfo>,
    /// Acts on the axis, where it is simulated.
    pub acts: Vec<SimulationActionInfo>,
}

/// Recorder in a drive, which `/api/v1/axes/{id}/drive-log` uses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DriveLogInfo {
    /// Points a second that it can take, the most first. Others that divide its loops are possible.
    pub rates: Vec<f64>,
    /// Points of a recording of a signal and its target at most.
    pub points: u32,
    /// No public source states the layout of its memory.
    pub inferred: bool,
}

/// A verb of an axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct VerbInfo {
    /// Name of the verb: `enable`, `velocity`, `move-to`.
    pub verb: String,
    /// Arguments of the verb.
    pub arguments: Vec<ArgumentInfo>,
    /// True if it powers or moves the motor.
    pub moves: bool,
}

/// An argument of a verb.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ArgumentInfo {
    /// A field of [`CommandArguments`](super::CommandArguments).
    pub name: String,
    /// SI unit of the argument.
    pub unit: String,
    /// The verb does not go without.
    pub required: bool,
}

/// A limit of an axis, in SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LimitInfo {
    /// Limited quantity: `position`, `velocity`, `acceleration`, `torque`, `current`.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Least value; `null` without one.
    #[schema(required)]
    pub min: Option<f64>,
    /// Greatest value; `null` without one.
    #[schema(required)]
    pub max: Option<f64>,
}

/// A signal of an axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SignalInfo {
    /// Name of the signal: `position`, `velocity`, `fault`.
    pub signal: String,
    /// SI unit; empty for flags, codes and modes.
    pub unit: String,
    /// The drive sends it unasked.
    pub pushed: bool,
}

/// Something that can be done to a simulated drive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SimulationActionInfo {
    /// Name of the act, for [`SimulationAction`](super::SimulationAction).
    pub act: String,
    /// Effect of the act, in a sentence.
    pub about: String,
    /// Unit of its value; `null` where it takes none.
    #[schema(required)]
    pub unit: Option<String>,
    /// True if its value is 1 or 0.
    #[serde(default)]
    pub flag: bool,
}

/// More on a wire than should be: another master, or several drives at one address.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Clash {
    /// The link.
    pub link: u16,
    /// The observation, in a sentence.
    pub message: String,
}

/// The lock of motion: client and time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MotionLock {
    /// The session that stopped everything.
    pub by: String,
    /// Since when.
    pub at_ms: f64,
    /// The client's reason; may be empty.
    pub reason: String,
}
