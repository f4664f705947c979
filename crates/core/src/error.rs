//! Errors by their source: bytes, drive, caller.
//!
//! They contain no heap strings. Errors of the operating system are `LinkError` of the link crate; errors
//! of files name file and line in the crate that reads them.

use crate::judge::EndReason;
use crate::profile::ParameterId;
use crate::verb::Argument;

/// A frame that violates its protocol.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum WireError {
    /// Fewer bytes than the shortest frame, or than the length that the frame announces.
    Short {
        /// Bytes needed.
        need: u16,
        /// Bytes found.
        found: u16,
    },
    /// More bytes than the frame has use for.
    Long {
        /// Bytes needed.
        need: u16,
        /// Bytes found.
        found: u16,
    },
    /// A check over the frame does not agree: sum, LRC or CRC.
    Checksum {
        /// Computed check.
        computed: u32,
        /// Check in the frame.
        found: u32,
    },
    /// A byte that the protocol does not allow there.
    Unexpected {
        /// Offset in the frame.
        at: u16,
        /// The byte found.
        found: u8,
    },
    /// A count or length field that contradicts the frame or the protocol's limits.
    Count {
        /// Offset in the frame.
        at: u16,
        /// The value found.
        found: u16,
    },
    /// A CAN identifier that is not the protocol's, or has bits set that must be zero.
    Identifier {
        /// The identifier found.
        found: u32,
    },
}

impl core::fmt::Display for WireError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Short { need, found } => {
                let missing = need.saturating_sub(found);
                write!(f, "length: needed {need} bytes, found {found}: {missing} missing")
            }
            Self::Long { need, found } => {
                write!(f, "length: {need} bytes are the whole frame, found {found}")
            }
            Self::Checksum { computed, found } => {
                let digits = if computed.max(found) > 0xFF { 4 } else { 2 };
                write!(f, "checksum: computed {computed:0digits$X}, found {found:0digits$X}")
            }
            Self::Unexpected { at, found } => write!(f, "byte {at}: unexpected {found:02X}"),
            Self::Count { at, found } => write!(f, "byte {at}: impossible count {found}"),
            Self::Identifier { found } => {
                let digits = if found > 0x7FF { 8 } else { 3 };
                write!(f, "identifier {found:0digits$X}: not one of this protocol's")
            }
        }
    }
}

/// Reason why a request that was sent failed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Failure {
    /// No reply within the time limit, retries included.
    Silent,
    /// The drive refused, with its own code (TMCL status, Modbus exception, abort code).
    Refused {
        /// The code, in the protocol's numbers.
        code: u32,
    },
    /// Something answered, but broke the protocol or answered another question.
    Misbehaved,
    /// The drive's address answers each question twice, so that two drives have it and no answer can be
    /// believed. The request was not sent.
    AnsweredTwice,
    /// The drive executed the command, but the condition of a wait step was not met in time.
    NotReached,
    /// A `Require` step found the drive not ready; the profile's hint has the remedy.
    NotReady {
        /// Remedy for people.
        hint: &'static str,
    },
    /// The drive reports a fault.
    Faulted {
        /// The fault, in the drive's own code or bits.
        code: u32,
    },
    /// The motor lost power during a wait, and the drive reports no fault.
    PowerLost,
    /// The drive answered with fewer bytes than a value of this type has: the object is of another type, such as
    /// an array, whose first entry is the number of its entries.
    WrongSize {
        /// Bytes of the answer.
        found: u8,
        /// Bytes of the type.
        need: u8,
    },
    /// The motion ended elsewhere than at its target, by the measured position.
    Elsewhere(EndReason),
    /// The motion is over by the drive's own report, and nothing that the drive reports shows where the
    /// motor is.
    Unconfirmed,
    /// The drive went into another mode while something was waited for.
    ModeChanged {
        /// The mode, in the drive's numbers.
        mode: i64,
    },
    /// The words in the drive's memory from the first address to the last are not those that they
    /// should be.
    Differs {
        /// First address.
        start: u32,
        /// Last address.
        end: u32,
    },
    /// A stop, a newer command or the end of the link cut it short.
    Cancelled,
    /// The link went down.
    LinkDown,
    /// A value that was read from the drive (a scale, a mode) rules out the rest of the command. The step
    /// in question was not sent.
    Impossible(Unsupported),
}

/// A request that cannot be carried out. Nothing was sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Unsupported {
    /// No axis of that index on this lane.
    NoSuchAxis,
    /// The profile has no such parameter.
    NoSuchParameter,
    /// The profile has no plan for this verb.
    NoPlan,
    /// The parameter can only be read.
    ReadOnly(ParameterId),
    /// The parameter can only be written.
    WriteOnly(ParameterId),
    /// The value is outside the limits, in the drive's raw numbers.
    OutOfRange {
        /// The parameter that would have been written.
        parameter: ParameterId,
        /// The value, raw.
        value: i64,
        /// Least raw value allowed.
        min: i64,
        /// Greatest raw value allowed.
        max: i64,
    },
    /// The command lacks a value that its plan needs.
    MissingArgument(Argument),
    /// A value is not a finite number.
    BadArgument,
    /// A motion command for an axis that is not armed.
    NotArmed,
    /// The axis is moving on another command, or the lane's job table is full.
    Busy,
    /// Text that is not of the protocol's language.
    BadText,
    /// Bytes that are no request of the protocol to this axis.
    BadBytes,
    /// The protocol's rules forbid it; the text names the rule.
    Forbidden(&'static str),
}

/// Outcome of a ticket. Every ticket has exactly one outcome.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// The drive did it. The value is the last one read or echoed, raw.
    Done(i64),
    /// The request was not executed and never will be.
    NotDone(Failure),
    /// A plan of several steps did not come to its end, and steps before were executed.
    Partly(Failure, Extent),
    /// Unknown: the request was sent and no reply came, so the drive may have executed it.
    Unknown(Failure),
}

impl Outcome {
    /// Why it was not done, or not all of it; `None` for [`Done`](Self::Done).
    #[must_use]
    pub const fn failure(self) -> Option<Failure> {
        match self {
            Self::Done(_) => None,
            Self::NotDone(failure) | Self::Partly(failure, _) | Self::Unknown(failure) => {
                Some(failure)
            }
        }
    }

    /// The outcome with another reason; [`Done`](Self::Done) stays.
    #[must_use]
    pub const fn with_failure(self, failure: Failure) -> Self {
        match self {
            Self::Done(_) => self,
            Self::NotDone(_) => Self::NotDone(failure),
            Self::Partly(_, extent) => Self::Partly(failure, extent),
            Self::Unknown(_) => Self::Unknown(failure),
        }
    }
}

/// Progress of a plan. Each mask has one bit per step, bit 0 for the first; only steps that can change
/// the drive count. A plan has at most [`STEPS_MAX`](crate::plan::STEPS_MAX) steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Extent {
    /// Steps that the drive acknowledged, or that were read back.
    pub done: u64,
    /// Steps that were sent without a reply: the drive may or may not have executed them.
    pub unknown: u64,
    /// Steps that were answered with no, or were read back and are not there.
    pub refused: u64,
    /// The steps of the plan's undoing were all acknowledged afterwards.
    pub rolled_back: bool,
}

impl Extent {
    /// The outcome of a plan that failed at this point for this reason.
    #[must_use]
    pub const fn outcome(self, failure: Failure) -> Outcome {
        match (self.done, self.unknown) {
            (0, 0) => Outcome::NotDone(failure),
            (0, _) => Outcome::Unknown(failure),
            _ => Outcome::Partly(failure, self),
        }
    }
}

/// Exit codes of the command line; scripts rely on them.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[repr(u8)]
pub enum Exit {
    /// All done.
    Ok = 0,
    /// A negative result: a difference, a move that was not reached.
    Negative = 1,
    /// The request cannot be carried out; nothing was sent.
    Usage = 2,
    /// No adapter, no permission, or the link went away.
    Adapter = 3,
    /// No reply.
    NoReply = 4,
    /// An answer that is corrupt or to another question.
    Corrupt = 5,
    /// The drive refused the request.
    Refused = 6,
    /// Done in part.
    Partial = 7,
    /// The drive reports a fault.
    DriveFault = 8,
    /// The drive reports that it is done, and nothing was measured that shows it.
    Unconfirmed = 9,
    /// Ctrl-C.
    Interrupted = 130,
}

/// Exception of Python and C for an error. All derive from `PolepairError`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Exception {
    /// No reply.
    NoReply,
    /// The drive refused the request.
    Refused,
    /// The drive reports a fault.
    DriveFault,
    /// The answer was corrupt or to another question.
    ProtocolError,
    /// The request is impossible; nothing was sent.
    Unsupported,
    /// None of these: a link that cannot be opened, a move that did not arrive, a stop between.
    PolepairError,
}

impl Exception {
    /// The class's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoReply => "NoReply",
            Self::Refused => "Refused",
            Self::DriveFault => "DriveFault",
            Self::ProtocolError => "ProtocolError",
            Self::Unsupported => "Unsupported",
            Self::PolepairError => "PolepairError",
        }
    }
}
