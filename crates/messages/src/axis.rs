//! State and parameters of an axis.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{CommandOutcome, CommandRequest, GatewayError, StopClass};

/// The last known state of an axis, with the ages of its values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisState {
    /// Index among the axes.
    pub id: u16,
    /// Mode of operation in words; `null` while not known.
    #[schema(required)]
    pub mode: Option<String>,
    /// The motor is powered; `null` while not known.
    #[schema(required)]
    pub enabled: Option<bool>,
    /// True if motion commands are allowed.
    pub armed: bool,
    /// True if it moves; `null` if unknown.
    #[schema(required)]
    pub moving: Option<bool>,
    /// Every signal that was read.
    pub signals: Vec<SignalValue>,
    /// Faults and warnings that stand.
    pub faults: Vec<ActiveFault>,
    /// The client with the lease; `null` if there is none.
    #[schema(required)]
    pub lease: Option<LeaseView>,
    /// The pending stop; `null` if there is none. User interfaces show it in red: standstill is not
    /// confirmed, and cutting the supply stops the motor.
    #[schema(required)]
    pub pending_stop: Option<PendingStopView>,
    /// Display of the drive's own panel, where it has one.
    #[schema(required)]
    pub panel: Option<PanelView>,
}

/// A signal's last value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SignalValue {
    /// Name of the signal.
    pub signal: String,
    /// SI; flags are 0 or 1. `null` where it cannot be scaled.
    #[schema(required)]
    pub value: Option<f64>,
    /// SI unit; empty for flags, codes and modes.
    pub unit: String,
    /// Age of the value when this was sent, ms.
    pub age_ms: f64,
}

/// A fault, in words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ActiveFault {
    /// The drive's code.
    pub code: u32,
    /// Name of the fault.
    pub name: String,
    /// The manual's short name; as `name` where there is none.
    pub symbol: String,
    /// Usual cause of the fault.
    pub cause: String,
    /// Remedy of the fault.
    pub remedy: String,
    /// The drive goes on.
    pub warning: bool,
}

/// The lease of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeaseView {
    /// The session, as in [`Welcome::session`](super::Welcome::session).
    pub owner: String,
    /// Goes up with each new owner.
    pub epoch: u64,
    /// When it ends unless it is renewed.
    pub expires_ms: f64,
}

/// A pending stop: the standstill of the axis is not confirmed since the stop. The server repeats the stop
/// until then: at once when the link opens or the drive replies again, else at intervals of up to 2 s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PendingStopView {
    /// Since when.
    pub since_ms: f64,
    /// Why it is to stand.
    pub why: StopCause,
    /// The session that sent it; `server` for the server itself.
    pub by: String,
    /// Certain progress of the stop so far: `failed` (nothing left yet), `sent` or `acknowledged`.
    pub class: StopClass,
    /// Number of times that it was sent.
    pub attempts: u32,
    /// Why the last one was not confirmed; `null` while nothing is known to be wrong with it.
    #[schema(required)]
    pub error: Option<GatewayError>,
}

/// Why an axis is to stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StopCause {
    /// A client sent STOP, or the server did, to keep the axis within its limits.
    Stop,
    /// The lease ended under which it was set in motion.
    LeaseEnded,
    /// The link was lost while the axis moved.
    LinkLost,
    /// The server ends while it may move.
    ServerEnds,
    /// The stop was pending when the previous server ended, by the journal.
    ServerBefore,
}

/// A drive's own panel.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PanelView {
    /// Text on the display.
    pub shows: String,
    /// Keys of the panel: acts of [`AxisInfo::acts`](super::AxisInfo::acts) that press them.
    pub keys: Vec<String>,
}

/// A parameter, without its value: `GET /api/v1/axes/{id}/parameters`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterInfo {
    /// The word users type.
    pub name: String,
    /// Designation in the manual.
    pub symbol: String,
    /// The part of the manual or of the name that it belongs to; may be empty.
    pub group: String,
    /// Description; may be empty.
    pub about: String,
    /// The unit that its value has here and is written in; empty without one.
    pub unit: String,
    /// Least value; `null` where the scale is not known yet.
    #[schema(required)]
    pub min: Option<f64>,
    /// Greatest value; likewise.
    #[schema(required)]
    pub max: Option<f64>,
    /// From the factory, where known.
    #[schema(required)]
    pub default: Option<f64>,
    /// True if it can be read.
    pub readable: bool,
    /// True if it can be written.
    pub writable: bool,
    /// A write goes to permanent memory by itself.
    pub kept: bool,
    /// Writing it may move the motor.
    pub moves: bool,
    /// Words for values; empty where it has none.
    pub words: Vec<String>,
    /// The raw value of each word.
    pub word_values: Vec<i64>,
    /// Least raw value.
    pub raw_min: i64,
    /// Greatest raw value.
    pub raw_max: i64,
    /// Raw value from the factory, where known.
    #[schema(required)]
    pub raw_default: Option<i64>,
    /// Persistence of a written value: `volatile`, `storable`, `always`, `unless-ram`.
    pub persistence: String,
    /// `number`, `text` or `bytes`.
    #[serde(default)]
    pub kind: String,
}

/// An item of a drive's device information: `GET /api/v1/axes/{id}/device`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DeviceDetailView {
    /// Name of the detail: `device name`, `firmware`.
    pub name: String,
    /// Value of the detail.
    pub text: String,
}

/// The program in a module's memory: `GET /api/v1/axes/{id}/program`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ProgramView {
    /// Instructions of the program, from address 0 on.
    pub instructions: Vec<ProgramLine>,
}

/// An instruction of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ProgramLine {
    /// Address of the instruction.
    pub address: u16,
    /// The name that jumps to it have in these texts; `null` where none goes there.
    #[schema(required)]
    pub label: Option<String>,
    /// The instruction, as the module's language writes it: `MVP ABS, 0, 1000`.
    pub text: String,
}

/// State of a module's program: `GET /api/v1/axes/{id}/program/state`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ProgramState {
    /// True if it runs.
    pub running: bool,
    /// The address of the next instruction.
    pub counter: u16,
}

/// A parameter read just now: `GET /api/v1/axes/{id}/parameters/{name}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterReading {
    /// Name of the parameter.
    pub name: String,
    /// Value in [`ParameterInfo::unit`]; none for text and bytes.
    #[schema(required)]
    pub value: Option<f64>,
    /// Raw value of the drive; none for text and bytes.
    #[schema(required)]
    pub raw: Option<i64>,
    /// Unit of the value.
    pub unit: String,
    /// The value's word, where it has one.
    #[schema(required)]
    pub word: Option<String>,
    /// Value as text, with no more digits than the drive has. Bytes are in hexadecimal.
    pub text: String,
    /// Designation in the manual: `AP 6`, `1018h:1`.
    pub symbol: String,
    /// `number`, `text` or `bytes`.
    pub kind: String,
}

/// `POST /api/v1/axes/{id}/parameters`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WriteParameters {
    /// Values by name of the parameter.
    pub values: BTreeMap<String, ParameterInput>,
    /// Also put them into permanent memory.
    #[serde(default)]
    pub keep: bool,
    /// Return the changes, and write nothing: needs no lease.
    #[serde(default)]
    pub dry_run: bool,
    /// Numbers are as they lie in the drive.
    #[serde(default)]
    pub raw: bool,
    /// Epoch of the caller's lease.
    #[serde(default)]
    pub epoch: u64,
}

/// `GET /api/v1/axes/{id}/watchdog`, and the answer to its `POST`: what the drive does by itself when
/// its host falls silent, read just now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WatchdogView {
    /// Behaviour of drives of its family, in words.
    pub rule: String,
    /// Setting of the watchdog.
    pub set: WatchdogMode,
    /// State of the watchdog in words.
    pub text: String,
    /// Time of silence after which it stops, ms; `null` where it does not, or where that is not known.
    #[schema(required)]
    pub after_ms: Option<f64>,
    /// The parameter that is written to set it; `null` where the drive has none that can be set.
    #[schema(required)]
    pub parameter: Option<String>,
    /// Caution before it is set; may be empty.
    pub caution: String,
}

/// Setting of a drive's own watchdog.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WatchdogMode {
    /// The drive has none: it continues its last command.
    None,
    /// The drive has a watchdog that is off.
    Off,
    /// The drive stops after a silence.
    On,
    /// The drive watches a heartbeat that is not this host's.
    Other,
    /// The drive notices a silence, and does nothing then.
    NoReaction,
    /// The watchdog can be set, and the drive does not report its setting.
    Untold,
}

/// `POST /api/v1/axes/{id}/watchdog`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetWatchdog {
    /// Time without a message of the host after which it stops, ms; `null` and 0 are never.
    #[schema(required)]
    pub after_ms: Option<f64>,
    /// Epoch of the caller's lease.
    #[serde(default)]
    pub epoch: u64,
}

/// `POST /api/v1/axes/{id}/drive-log`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordDriveLog {
    /// Variables: signals by their words, or parameters by name.
    pub variables: Vec<String>,
    /// Points a second.
    pub rate: f64,
    /// Length of the recording.
    pub seconds: f64,
    /// Accept a layout of the drive's memory that no public source states.
    #[serde(default)]
    pub inferred: bool,
    /// Command that is given when the recording runs.
    #[serde(default)]
    pub command: Option<CommandRequest>,
    /// Command that is given when the points are taken, before they are read, which takes seconds on a slow line.
    #[serde(default)]
    pub afterwards: Option<CommandRequest>,
    /// Epoch of the caller's lease.
    pub epoch: u64,
}

/// A recording that a drive has made in its own control loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DriveLogView {
    /// Time from one point to the next, s.
    pub interval_s: f64,
    /// The variables, each with as many values.
    pub variables: Vec<DriveLogVariable>,
    /// Outcome of the command; `null` without one, and if it was not there when the recording had been read.
    #[schema(required)]
    pub outcome: Option<CommandOutcome>,
}

/// Values of a variable in a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DriveLogVariable {
    /// Name of the parameter.
    pub name: String,
    /// Unit of the values: SI, or empty for the drive's own numbers.
    pub unit: String,
    /// A value for each point; `null` where its scale is not known.
    pub values: Vec<Option<f64>>,
}

/// A value of a write request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum ParameterInput {
    /// A number in the parameter's unit; a raw number with [`WriteParameters::raw`].
    Number(f64),
    /// With a unit (`1.2 A`), or a word.
    Text(String),
}

/// A line of the plan that writing parameters is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterChange {
    /// Name of the parameter.
    pub name: String,
    /// Present value of the drive; `null` if it cannot be read.
    #[schema(required)]
    pub from: Option<f64>,
    /// New value.
    pub to: f64,
    /// `from` in words, with unit, and the drive's own number where that is another one: `10 A (100)`. Empty without
    /// `from`, and from a server that is older than this field.
    #[serde(default)]
    pub from_text: String,
    /// `to` in words, as `from_text`.
    #[serde(default)]
    pub to_text: String,
    /// Unit of both.
    pub unit: String,
    /// The two differ.
    pub changed: bool,
}
