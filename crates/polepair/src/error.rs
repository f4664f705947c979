//! Errors by their source, each with a constant code, an exit code and a suggestion.
//!
//! [`outcome_class`] is the only table from the result of a lane ([`Outcome`], [`Failure`]) to exit code,
//! exception and error code. The command line and the bindings use it.

use crate::{FileError, NoReplyDetails};
pub use polepair_core::error::{Exception, Exit};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::judge::EndReason;
use polepair_link::{Cause, LinkError};
use std::borrow::Cow;
use std::fmt;

/// Class of an outcome for user interfaces.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct OutcomeClass {
    /// Exit code of the command line.
    pub exit: Exit,
    /// Exception of the bindings.
    pub exception: Exception,
    /// Stable code.
    pub code: &'static str,
    /// True if the drive executed it; `None` if unknown, or executed in part.
    pub executed: Option<bool>,
}

/// The table: what an outcome means. `None` for [`Outcome::Done`].
///
/// ```
/// use polepair::error::{Exit, outcome_class};
/// use polepair_core::error::{Failure, Outcome};
/// let lost = outcome_class(Outcome::Unknown(Failure::Silent)).unwrap();
/// assert_eq!((lost.exit, lost.executed), (Exit::NoReply, None));
/// assert!(outcome_class(Outcome::Done(0)).is_none());
/// ```
#[must_use]
pub fn outcome_class(outcome: Outcome) -> Option<OutcomeClass> {
    let (failure, executed) = match outcome {
        Outcome::Done(_) => return None,
        // The motion was executed; it is its end that was not as commanded.
        Outcome::NotDone(failure @ (Failure::Elsewhere(_) | Failure::Unconfirmed)) => {
            (failure, Some(true))
        }
        Outcome::NotDone(failure) => (failure, Some(false)),
        // Neither yes nor no: the error's text has the progress.
        Outcome::Partly(failure, _) | Outcome::Unknown(failure) => (failure, None),
    };
    let (exit, exception, code) = match failure {
        Failure::Silent => (Exit::NoReply, Exception::NoReply, "E401"),
        Failure::Misbehaved | Failure::WrongSize { .. } => {
            (Exit::Corrupt, Exception::ProtocolError, "E501")
        }
        Failure::AnsweredTwice => (Exit::Corrupt, Exception::ProtocolError, "E502"),
        Failure::Refused { .. } => (Exit::Refused, Exception::Refused, "E601"),
        Failure::NotReady { .. } => (Exit::Refused, Exception::Refused, "E602"),
        Failure::Faulted { .. } => (Exit::DriveFault, Exception::DriveFault, "E801"),
        Failure::NotReached => (Exit::Negative, Exception::PolepairError, "E101"),
        Failure::Elsewhere(EndReason::Halted | EndReason::Mode(_)) => {
            (Exit::Negative, Exception::PolepairError, "E102")
        }
        Failure::Elsewhere(_) => (Exit::Negative, Exception::PolepairError, "E106"),
        Failure::Unconfirmed => (Exit::Unconfirmed, Exception::PolepairError, "E901"),
        Failure::Differs { .. } => (Exit::Negative, Exception::PolepairError, "E103"),
        Failure::PowerLost | Failure::ModeChanged { .. } => {
            (Exit::Negative, Exception::PolepairError, "E102")
        }
        Failure::Cancelled => (Exit::Negative, Exception::PolepairError, "E102"),
        Failure::LinkDown => (Exit::Adapter, Exception::PolepairError, "E313"),
        Failure::Impossible(why) => (Exit::Usage, Exception::Unsupported, unsupported_code(why)),
        // Outcomes of later versions of the core.
        _ => (Exit::Corrupt, Exception::ProtocolError, "E500"),
    };
    Some(OutcomeClass { exit, exception, code, executed })
}

const fn unsupported_code(why: Unsupported) -> &'static str {
    match why {
        Unsupported::NoSuchAxis => "E212",
        Unsupported::NoSuchParameter => "E213",
        Unsupported::ReadOnly(_) => "E214",
        Unsupported::WriteOnly(_) => "E215",
        Unsupported::OutOfRange { .. } => "E216",
        Unsupported::BadArgument => "E217",
        Unsupported::NoPlan => "E218",
        Unsupported::NotArmed => "E219",
        Unsupported::Busy => "E220",
        Unsupported::BadText | Unsupported::BadBytes => "E221",
        Unsupported::Forbidden(_) => "E222",
        _ => "E299",
    }
}

/// Remedy of `E219`.
pub(crate) const ARMING_HINT: &str = "what may move a motor needs an armed axis: `--arm` on the \
     command line, `axis.armed()` in a program";

/// Whatever goes wrong, by blame.
#[derive(Clone, PartialEq, Debug)]
#[non_exhaustive]
pub enum Error {
    /// The caller's words: a connection string, a name, a value. Nothing was sent.
    Usage {
        /// Stable code.
        code: &'static str,
        /// Description, in a sentence without full stop.
        what: String,
        /// Remedy to try; may be empty.
        hint: String,
    },
    /// A file: a profile, a rack, `polepair.toml`.
    File(FileError),
    /// The operating system: no such port, no permission, unplugged.
    Link(LinkError),
    /// The caller asked for what this drive cannot do. Nothing was sent.
    Unsupported {
        /// Request, with the reason.
        what: String,
        /// Function that is not supported.
        why: Unsupported,
        /// Remedy to try; may be empty.
        hint: String,
    },
    /// The drive, or the wire to it.
    Failed {
        /// The request and its result.
        what: String,
        /// Text about the execution; empty for reads, and if `what` states it.
        execution: String,
        /// Outcome of the request: never [`Outcome::Done`].
        outcome: Outcome,
        /// Frames received instead of a reply, if it ended in [`Failure::Silent`].
        received: Box<NoReplyDetails>,
        /// The motor was started, or was moving, and cannot be stopped from here.
        may_turn: bool,
        /// Remedy to try; may be empty.
        hint: String,
    },
    /// A gateway refused a request, or reports its result.
    Gateway {
        /// Stable code: the library's (`E401`) or the gateway's own (`gateway.lease`).
        code: Cow<'static, str>,
        /// Description and state of the motor, in a sentence without full stop.
        what: String,
        /// The description with whether a drive executed the request, if that is in doubt.
        sentence: String,
        /// Remedy to try; may be empty.
        hint: String,
        /// True if a drive executed the request; `None` if unknown, or executed in part.
        executed: Option<bool>,
        /// The motor was started, or was moving, and the gateway cannot stop it.
        may_turn: bool,
        /// The exit code.
        exit: Exit,
        /// Exception of the bindings.
        exception: Exception,
    },
    /// A motion ended before it was stopped: a fault, a motor that stopped or lost its power, a position limit.
    MotionEnded {
        /// Stable code.
        code: &'static str,
        /// Reading, in a sentence without full stop.
        what: String,
        /// Cause, in a sentence; may be empty.
        why: String,
        /// Remedy to try; may be empty.
        hint: String,
        /// The exit code.
        exit: Exit,
    },
    /// The wait was interrupted; the request continues.
    Interrupted {
        /// Condition of the wait.
        what: String,
    },
}

impl Error {
    /// An error about the caller's words.
    pub(crate) fn usage(
        code: &'static str,
        what: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Usage { code, what: what.into(), hint: hint.into() }
    }

    fn outcome_class(&self) -> OutcomeClass {
        let of = |exit, exception, code, executed| OutcomeClass { exit, exception, code, executed };
        match self {
            Self::Usage { code, .. } => of(Exit::Usage, Exception::Unsupported, code, Some(false)),
            Self::File(_) => of(Exit::Usage, Exception::PolepairError, "E230", Some(false)),
            Self::Link(error) => {
                let code = link_code(error.cause());
                of(Exit::Adapter, Exception::PolepairError, code, Some(false))
            }
            Self::Unsupported { why, .. } => {
                of(Exit::Usage, Exception::Unsupported, unsupported_code(*why), Some(false))
            }
            Self::Failed { outcome, .. } => outcome_class(*outcome).unwrap_or(of(
                Exit::Corrupt,
                Exception::ProtocolError,
                "E500",
                None,
            )),
            Self::Gateway { executed, exit, exception, .. } => {
                of(*exit, *exception, "gateway", *executed)
            }
            Self::MotionEnded { code, exit, .. } => {
                let exception = match exit {
                    Exit::DriveFault => Exception::DriveFault,
                    _ => Exception::PolepairError,
                };
                of(*exit, exception, code, Some(true))
            }
            Self::Interrupted { .. } => {
                of(Exit::Interrupted, Exception::PolepairError, "E130", None)
            }
        }
    }

    /// A code that stays the same over versions; its first digit is the exit code.
    #[must_use]
    pub fn code(&self) -> &str {
        match self {
            Self::Gateway { code, .. } => code,
            _ => self.outcome_class().code,
        }
    }

    /// The exit code of the command line.
    #[must_use]
    pub fn exit(&self) -> Exit {
        self.outcome_class().exit
    }

    /// Exception of the bindings.
    #[must_use]
    pub fn exception(&self) -> Exception {
        self.outcome_class().exception
    }

    /// Returns whether the drive executed the request; `None` if unknown, or executed in part ([`Outcome::Partly`]).
    #[must_use]
    pub fn executed(&self) -> Option<bool> {
        self.outcome_class().executed
    }

    /// The error of a repeated request: the earlier one may have been executed.
    pub(crate) fn after_earlier_attempt(self) -> Self {
        use polepair_core::error::Failure::{Cancelled, LinkDown, Misbehaved, Silent};
        match self {
            Self::Failed {
                what,
                execution: _,
                outcome: Outcome::NotDone(failure),
                may_turn,
                received,
                hint,
            } if matches!(failure, Silent | Misbehaved | Cancelled | LinkDown) => {
                let outcome = Outcome::Unknown(failure);
                let execution_text = "an earlier attempt may have been executed".to_owned();
                Self::Failed { what, execution: execution_text, outcome, may_turn, received, hint }
            }
            other => other,
        }
    }

    /// The error of a stop without confirmed standstill.
    pub(crate) fn with_unseen_motor(mut self) -> Self {
        if let Self::Failed { may_turn, .. } | Self::Gateway { may_turn, .. } = &mut self {
            *may_turn = true;
        }
        self
    }

    /// Returns whether the motor may still turn, and nothing can stop it from here but to cut its supply.
    #[must_use]
    pub const fn may_turn(&self) -> bool {
        matches!(self, Self::Failed { may_turn: true, .. } | Self::Gateway { may_turn: true, .. })
    }

    /// Description, and the progress of a plan that was executed in part; whether anything else was executed is left to
    /// [`executed`](Self::executed).
    #[must_use]
    pub fn brief(&self) -> String {
        let output = match self {
            Self::Failed { what, outcome, .. } if !matches!(outcome, Outcome::Partly(..)) => {
                what.clone()
            }
            Self::Gateway { what, .. } => return what.clone(),
            _ => self.sentence(),
        };
        if self.may_turn() { format!("{output}; {MAY_TURN}") } else { output }
    }

    /// Description and progress, without the state of the motor.
    #[must_use]
    pub fn sentence(&self) -> String {
        match self {
            Self::Usage { what, .. }
            | Self::Unsupported { what, .. }
            | Self::MotionEnded { what, .. } => what.clone(),
            Self::File(error) => error.to_string(),
            Self::Link(error) => error.to_string(),
            Self::Failed { what, execution, .. } if execution.is_empty() => what.clone(),
            Self::Failed { what, execution, .. } => {
                format!("{what}; {execution}")
            }
            Self::Gateway { sentence, .. } => sentence.clone(),
            Self::Interrupted { what } => format!("{what}: interrupted"),
        }
    }

    /// Remedy to try; may be empty.
    #[must_use]
    pub fn hint(&self) -> &str {
        match self {
            Self::Usage { hint, .. }
            | Self::Unsupported { hint, .. }
            | Self::Failed { hint, .. }
            | Self::MotionEnded { hint, .. }
            | Self::Gateway { hint, .. } => hint,
            Self::Link(error) => error.hint(),
            Self::File(_) | Self::Interrupted { .. } => "",
        }
    }
}

const fn link_code(cause: Cause) -> &'static str {
    match cause {
        Cause::Permission => "E310",
        Cause::NotFound => "E311",
        Cause::Busy => "E312",
        Cause::Gone => "E313",
        Cause::Refused => "E314",
        Cause::Unreachable => "E315",
        Cause::Unsuitable => "E316",
        Cause::Stalled => "E317",
        Cause::Down => "E319",
        Cause::Closed => "E322",
        _ => "E318",
    }
}

impl fmt::Display for Error {
    /// One sentence, with the execution if there was something to execute.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence())?;
        // A gateway's sentence has it already.
        if self.may_turn() && !matches!(self, Self::Gateway { .. }) {
            write!(f, "; {MAY_TURN}")
        } else {
            Ok(())
        }
    }
}

/// Text for a motor that was started, or was moving, and is not reachable.
pub const MAY_TURN: &str = "the motor may still turn: cut its supply";

impl std::error::Error for Error {}

impl From<FileError> for Error {
    fn from(error: FileError) -> Self {
        Self::File(error)
    }
}

impl From<LinkError> for Error {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}
