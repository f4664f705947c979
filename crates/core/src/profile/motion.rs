//! Parameters of motions: what judges their end, and how axes follow each other.

use crate::parameter_id::ParameterId;
use crate::plan::ParameterTest;

/// Parameters and rules for judging the end of a motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MotionRules {
    /// Greatest distance from the target of a motor that has arrived.
    pub window: Option<ParameterId>,
    /// Base of a relative move.
    pub relative_from: RelativeBase,
    /// Passed while something holds the motor on its way: a halt bit, a stop register.
    pub halted: Option<(ParameterId, ParameterTest)>,
    /// Passed after the drive detected a stall. It is read only after a motion ended elsewhere, because
    /// reading such a flag clears it in some drives.
    pub stalled: Option<(ParameterId, ParameterTest)>,
    /// Passed while the drive will not power its motor: a fault, an inhibit. The parameter is that of the signal
    /// `enabled`.
    pub unpowered: Option<(ParameterId, ParameterTest)>,
    /// Parameters for following another axis.
    pub coupling: Option<CouplingParameters>,
}

/// Parameters by which axes of a bus follow each other. The first is the master's, the others are the follower's.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CouplingParameters {
    /// Number of the axis that the master sends its position to.
    pub follower: ParameterId,
    /// Position of the master as it was received last.
    pub master_position: ParameterId,
    /// Counts of the follower for a count of the master.
    pub ratio: ParameterId,
    /// Numerator of the ratio.
    pub numerator: ParameterId,
    /// Denominator of the ratio.
    pub denominator: ParameterId,
    /// Address of the table of a cam.
    pub cam: ParameterId,
}

impl MotionRules {
    /// Rules of a drive without such parameters.
    pub const NONE: Self = Self {
        window: None,
        relative_from: RelativeBase::Either,
        halted: None,
        stalled: None,
        unpowered: None,
        coupling: None,
    };
}

/// The position that a relative move counts from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RelativeBase {
    /// The actual position of the motor.
    Actual,
    /// The last target, whether it was reached or not.
    Target,
    /// Not documented: one of both.
    Either,
}
