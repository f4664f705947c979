//! Messages that drives send by themselves, and the events that are made from them.

use super::Reading;
use crate::profile::{ParameterAddress, ParameterId, Signal};
use crate::station::AxisIndex;
use crate::time::Instant;

/// A value that a drive sent by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DriveReport {
    /// A signal's value, where no parameter has it.
    Signal(Signal, i64),
    /// A parameter's raw value.
    Parameter(ParameterId, i64),
    /// The raw value at an address that the profile does not name.
    Address(ParameterAddress, i64),
    /// A change of its network state.
    Presence(Presence),
}

/// Network state of a drive, as the drive reports it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Presence {
    /// It restarted: cached values are invalid, and it is disarmed.
    Restarted,
    /// It accepts settings and sends no process data.
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

    /// Whether cached values of the drive become invalid.
    #[must_use]
    pub const fn invalidates_state(self) -> bool {
        matches!(self, Self::Restarted | Self::Gone)
    }
}

/// An event of an axis; see [`Axes::enable_events`](super::Axes::enable_events).
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct AxisEvent {
    /// When it arrived, or was found out.
    pub at: Instant,
    /// Whom it concerns.
    pub axis: AxisIndex,
    /// The event.
    pub kind: AxisEventKind,
}

/// One thing that happened to an axis.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum AxisEventKind {
    /// The drive sent a signal's value by itself. Flags and codes are reported when they change.
    Signal(Signal, Reading),
    /// The drive sent the value of a parameter that is not a signal: raw, and in SI. The SI value is NaN
    /// while a parameter that the scale depends on has never been read.
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
    /// The drive's network state changed.
    Presence(Presence),
    /// Motion commands are let through from now on, or no longer.
    Armed(bool),
    /// Number of events, of any axis, that were dropped because the queue was full.
    Missed(u32),
}

/// Most values in one message.
pub const REPORTS_MAX: usize = 4;
