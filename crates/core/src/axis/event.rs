//! Messages that drives send by themselves, and the events that are made from them.

use super::Reading;
use crate::profile::{ParameterAddress, ParameterId, Signal};
use crate::station::AxisIndex;
use crate::time::Instant;

/// What a drive told unasked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DriveReport {
    /// A signal's value, where no parameter has it.
    Signal(Signal, i64),
    /// A parameter's raw value.
    Parameter(ParameterId, i64),
    /// The raw value at an address that the profile does not name.
    Address(ParameterAddress, i64),
    /// How it takes part in its network from now on.
    Presence(Presence),
}

/// How a drive takes part in its network, as it says by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Presence {
    /// It has just started: what was learnt of it no longer holds, and it is disarmed.
    Restarted,
    /// It takes settings; what it sends by itself rests.
    Preparing,
    /// It takes part in everything.
    Operating,
    /// It obeys nothing but the network's management.
    Halted,
    /// It is there no more: as [`Restarted`](Self::Restarted).
    Gone,
}

impl Presence {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Restarted => "restarted",
            Self::Preparing => "preparing",
            Self::Operating => "operating",
            Self::Halted => "halted",
            Self::Gone => "gone",
        }
    }

    /// Whether what was learnt of it no longer holds.
    #[must_use]
    pub const fn invalidates_state(self) -> bool {
        matches!(self, Self::Restarted | Self::Gone)
    }
}

/// What happened to an axis, for those who listen; see [`Axes::enable_events`](super::Axes::enable_events).
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct AxisEvent {
    /// When it arrived, or was found out.
    pub at: Instant,
    /// Whom it concerns.
    pub axis: AxisIndex,
    /// What it is.
    pub kind: AxisEventKind,
}

/// One thing that happened to an axis.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum AxisEventKind {
    /// The drive sent a signal's value unasked. Flags and codes are told when they change.
    Signal(Signal, Reading),
    /// The drive sent the value of a parameter unasked that no signal tells: raw, and in SI, which
    /// is NaN while a parameter that the scale depends on was never read.
    Parameter(ParameterId, i64, f64),
    /// The drive sent the raw value at an address unasked that the profile does not name.
    Address(ParameterAddress, i64),
    /// The drive now has this fault code, or this bit of its fault word; or it has it no more.
    Fault {
        /// As in [`Fault::code`](crate::profile::Fault::code), or the whole word where the profile
        /// knows nothing of it.
        code: u32,
        /// Whether it appeared, or was cleared.
        appeared: bool,
    },
    /// How the drive takes part in its network from now on.
    Presence(Presence),
    /// Motion commands are let through from now on, or no longer.
    Armed(bool),
    /// So many changes of any axis were thrown away, because nobody took them in time.
    Missed(u32),
}

/// Things that one message may tell.
pub const REPORTS_MAX: usize = 4;
