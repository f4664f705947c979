//! Stored paths of a drive, of the SYNTRON TS.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Paths, and the mechanics that their positions are counted in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PathTableMessage {
    /// Turns of the motor.
    pub motor_turns: u16,
    /// Travel of the mechanics in those turns.
    pub travel: u16,
    /// Unit of travel and positions, which the drive does not store: `deg` or `mm`.
    pub unit: String,
    /// Paths that are not empty.
    pub paths: Vec<PathRow>,
}

/// A path: a motion, and the one that follows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PathRow {
    /// Number, 1 to 32.
    pub number: u8,
    /// `speed`, `single` or `auto`; `none` for an empty path.
    pub kind: String,
    /// `absolute`, `from-last-end` or `from-here`.
    pub end: String,
    /// Position, in the unit of the mechanics.
    pub position: f64,
    /// Speed of the motor, rpm.
    pub speed: u16,
    /// Time from rest to the speed, ms.
    pub acceleration_ms: u16,
    /// Time from the speed to rest, ms.
    pub deceleration_ms: u16,
    /// Rounding of both ends of the ramps, ms.
    pub s_ms: u16,
    /// Time before the next path, ms.
    pub delay_ms: u16,
    /// Number of the path that follows; 0 for none.
    pub next: u8,
    /// True if it ends the path that runs when it is triggered.
    pub interrupts: bool,
}

/// `POST /api/v1/axes/{id}/paths`: what loading a table would change, and where its paths lead. Nothing is sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanPaths {
    /// Paths of the drive, as they were read.
    pub drive: PathTableMessage,
    /// Paths that it is to have. Those that are left out stay.
    pub wanted: PathTableMessage,
    /// Path whose run on the motor model is shown; 0 for none.
    #[serde(default)]
    pub path: u8,
}

/// A plan for paths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PathPlan {
    /// Courses of the paths, for each that no other one leads to.
    pub chains: Vec<String>,
    /// Findings: errors that a drive refuses, and others that may be intended.
    pub findings: Vec<PathFindingMessage>,
    /// Differences.
    pub changes: Vec<PathChangeMessage>,
    /// Raw values by parameter, to be written in this order: each by `POST /api/v1/axes/{id}/parameters`. Empty if a
    /// finding is an error.
    pub writes: Vec<BTreeMap<String, i64>>,
    /// The run on the motor model; empty without one.
    pub preview: Vec<PreviewPointMessage>,
}

/// A finding of the check of paths.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PathFindingMessage {
    /// Number of the path; 0 for the mechanics.
    pub path: u8,
    /// True for what the drive refuses, or cannot do.
    pub is_error: bool,
    /// The finding in words.
    pub text: String,
}

/// A difference.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PathChangeMessage {
    /// Number of the path; 0 for the mechanics.
    pub path: u8,
    /// Name of the field.
    pub field: String,
    /// Value of the drive, in words.
    pub from: String,
    /// New value.
    pub to: String,
}

/// A point of a run on the motor model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewPointMessage {
    /// Time from the trigger, s.
    pub time: f64,
    /// Position in the unit of the mechanics.
    pub position: f64,
    /// Speed of the motor, rpm.
    pub speed: f64,
}
