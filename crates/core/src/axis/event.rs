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
    /// Code of a message that reports an error (CiA 301, 7.2.7: emergency). The drive may go on all the same: only
    /// its state shows whether it does.
    Emergency(u32),
}

/// Network state of a drive, as the drive reports it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Presence {
    /// The drive restarted: cached values are invalid, and it is disarmed.
    Restarted,
    /// The drive accepts settings and sends no process data.
    Preparing,
    /// The drive is operational: all services work.
    Operating,
    /// The drive obeys only the network's management.
    Halted,
    /// The drive left the network: treated as [`Restarted`](Self::Restarted).
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

    /// Returns whether cached values of the drive become invalid.
    #[must_use]
    pub const fn invalidates_state(self) -> bool {
        matches!(self, Self::Restarted | Self::Gone)
    }
}

/// An event of an axis; see [`AxisTraffic::enable_events`](super::AxisTraffic::enable_events).
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct AxisEvent {
    /// Time of arrival or of detection.
    pub at: Instant,
    /// The axis.
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
        /// Code as in [`Fault::code`](crate::profile::Fault::code), or the whole word if the profile does not know it.
        code: u32,
        /// True if it appeared, or was cleared.
        appeared: bool,
    },
    /// The drive's network state changed.
    Presence(Presence),
    /// Motion commands are allowed from now on, or no longer.
    Armed(bool),
    /// Number of events, of any axis, that were dropped because the queue was full.
    Missed(u32),
}

/// Most values in one message.
pub const REPORTS_MAX: usize = 4;
