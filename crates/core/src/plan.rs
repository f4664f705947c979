//! A verb as data: a short table of steps, as in the manuals.
//!
//! The lane's executor runs every plan, a rehearsal prints it without sending, and tests compare it with
//! its manual. Steps name parameters of the profile, or the protocol's function, index and value. So plans
//! have the same form for every protocol, and can be written in TOML.

use crate::axis::Command;
use crate::parameter_id::ParameterId;
use crate::units::Unit;
use crate::verb::Verb;

pub use crate::verb::Argument;

/// Steps that a plan may have at most.
pub const STEPS_MAX: usize = 64;

/// The steps that carry out a verb.
#[derive(Debug)]
pub struct Plan {
    /// The verb.
    pub verb: Verb,
    /// Chapter of the manual with this sequence.
    pub source: &'static str,
    /// Steps, in order.
    pub steps: &'static [Step],
    /// Steps after a failure behind the first step, or after a cancelled plan, if more than reads were
    /// sent.
    pub undo: &'static [Step],
}

impl Plan {
    /// Start and end of the last wait: steps that only read and wait.
    fn last_wait(&self) -> Option<(usize, usize)> {
        let last = self.steps.iter().rposition(is_wait_step)?;
        let sent =
            self.steps[..last].iter().rposition(Step::may_change_drive).map_or(0, |at| at + 1);
        let first = sent + self.steps[sent..].iter().position(is_wait_step)?;
        Some((first, last + 1))
    }

    /// The steps before the last wait: all that a stop sends to its drive (STOP-7).
    #[must_use]
    pub fn before_wait(&self) -> &'static [Step] {
        &self.steps[..self.last_wait().map_or(self.steps.len(), |(first, _)| first)]
    }

    /// The steps after the last wait: what a stop sends once the motor is at rest.
    #[must_use]
    pub fn after_wait(&self) -> &'static [Step] {
        &self.steps[self.last_wait().map_or(self.steps.len(), |(_, end)| end)..]
    }
}

fn is_wait_step(step: &Step) -> bool {
    step.is_wait()
}

/// One step.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Step {
    /// Writes a parameter.
    Write(ParameterId, Operand),
    /// Writes neighbouring parameters with one request, in the order of their places.
    WriteTogether(&'static [(ParameterId, Operand)]),
    /// Reads a parameter first and writes it only if it differs. For values in flash: the write,
    /// if any, is announced and counted.
    Ensure(ParameterId, i64),
    /// Reads a parameter, so that the axis' state has a fresh value.
    Read(ParameterId),
    /// Reads a parameter and writes it with some of its bits changed.
    WriteBits {
        /// The parameter.
        id: ParameterId,
        /// The bits that change.
        mask: i64,
        /// Their new values.
        raw: i64,
    },
    /// Reads a parameter and writes its value to another: target := actual.
    Copy {
        /// Read from here.
        from: ParameterId,
        /// Written there.
        to: ParameterId,
    },
    /// Ends the plan with `NotReady { hint }` unless the parameter passes the test.
    Require {
        /// The parameter to read.
        read: ParameterId,
        /// The test.
        test: ParameterTest,
        /// Remedy for people.
        hint: &'static str,
    },
    /// Leaves out the next steps if the parameter passes the test.
    Skip {
        /// The parameter to read.
        read: ParameterId,
        /// The test.
        test: ParameterTest,
        /// Number of steps.
        count: u8,
    },
    /// Leaves out the next steps if the command's argument is negative, or if it is not. For drives whose direction is
    /// a bit of its own.
    SkipBySign {
        /// The argument; one that the command does not give is not negative.
        argument: Argument,
        /// True to leave them out where it is negative.
        if_negative: bool,
        /// Number of steps.
        count: u8,
    },
    /// Skips the next steps if the drive does not have the parameter: for objects that a standard leaves
    /// optional.
    SkipIfMissing {
        /// The parameter to read.
        read: ParameterId,
        /// Number of steps.
        count: u8,
    },
    /// Ends the plan with `Faulted` if the masked parameter is not zero.
    NoFault {
        /// The parameter to read.
        read: ParameterId,
        /// Bits that are faults; all ones for a code.
        mask: i64,
    },
    /// Reads a parameter again and again until it passes the test.
    Until {
        /// The parameter to read.
        read: ParameterId,
        /// The test.
        test: ParameterTest,
        /// Time limit of the step.
        within_ms: u32,
        /// Giving up ends the plan; else it goes on.
        required: bool,
    },
    /// Waits for standstill of the motor, by measured values ([`judge`](crate::judge)).
    Standstill {
        /// Time limit of the step.
        within_ms: u32,
    },
    /// Waits until the drive was seen to search its reference and passes the test.
    Homed {
        /// The parameter to read.
        read: ParameterId,
        /// Passed when the search is over.
        test: ParameterTest,
        /// Time limit of the step.
        within_ms: u32,
    },
    /// Waits until the last motion has ended, and compares the position with its target
    /// ([`judge`](crate::judge)).
    Arrival {
        /// The drive's own report that the motion is over. `None` for the signals
        /// [`Reached`](crate::profile::Signal::Reached) and [`Moving`](crate::profile::Signal::Moving).
        flag: Option<(ParameterId, ParameterTest)>,
        /// Time limit of the step.
        within_ms: u32,
    },
    /// Sends the protocol's own function, index and value: a request that is not a parameter.
    Send {
        /// TMCL opcode, Modbus function code.
        function: u8,
        /// TMCL type (low byte) and motor or bank (high byte), Modbus register.
        index: u16,
        /// The value.
        operand: Operand,
        /// The parameter whose scale the argument has.
        like: Option<ParameterId>,
    },
    /// Has the drive keep the parameter's present value over power-off (TMCL STAP).
    Store(ParameterId),
    /// Waits.
    Wait {
        /// Length of the wait, ms.
        ms: u32,
    },
}

/// Plan of a wait for the arrival, unless the profile has a flag of its own for it.
pub static ARRIVAL: Plan = Plan {
    verb: Verb::Reached,
    source: "",
    steps: &[Step::Arrival { flag: None, within_ms: 600_000 }],
    undo: &[],
};

impl Step {
    /// Returns whether it waits for something that is read again and again.
    #[must_use]
    pub const fn is_wait(&self) -> bool {
        matches!(self, Self::Until { .. }) || self.is_judged()
    }

    /// Returns whether it waits for a motion to end, which measured values decide.
    #[must_use]
    pub const fn is_judged(&self) -> bool {
        matches!(self, Self::Standstill { .. } | Self::Homed { .. } | Self::Arrival { .. })
    }

    /// The values that it takes from constants and arguments, each with the parameter that gives the scale.
    pub fn operands(&self) -> impl Iterator<Item = (Operand, Option<ParameterId>)> + '_ {
        let (one, together): (_, &[_]) = match *self {
            Self::Write(id, operand) => (Some((operand, Some(id))), &[]),
            Self::Send { operand, like, .. } => (Some((operand, like)), &[]),
            Self::WriteTogether(writes) => (None, writes),
            _ => (None, &[]),
        };
        one.into_iter().chain(together.iter().map(|(id, operand)| (*operand, Some(*id))))
    }

    /// Returns whether the argument of a command leaves out the steps behind this one.
    #[must_use]
    pub fn skips(&self, command: &Command) -> bool {
        let Self::SkipBySign { argument, if_negative, .. } = *self else { return false };
        command.argument(argument).is_some_and(|value| value < 0.0) == if_negative
    }

    /// Returns whether it may change something in the drive.
    #[must_use]
    pub const fn may_change_drive(&self) -> bool {
        use Step::{Copy, Ensure, Send, Store, Write, WriteBits, WriteTogether};
        matches!(
            self,
            Write(..)
                | WriteTogether(_)
                | Ensure(..)
                | WriteBits { .. }
                | Copy { .. }
                | Send { .. }
                | Store(_)
        )
    }
}

/// Masked comparison.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ParameterTest {
    /// Bits that count; all ones for a number.
    pub mask: i64,
    /// The comparison.
    pub compare: Compare,
    /// With what.
    pub value: i64,
}

impl ParameterTest {
    /// Returns whether `raw` passes the test.
    #[must_use]
    pub const fn passes(&self, raw: i64) -> bool {
        let masked = raw & self.mask;
        match self.compare {
            Compare::Equal => masked == self.value,
            Compare::NotEqual => masked != self.value,
            Compare::Within => masked.saturating_abs() <= self.value,
            Compare::Above => masked > self.value,
            Compare::Among => 0 <= masked && masked < 63 && self.value >> masked & 1 == 1,
        }
    }
}

/// Comparison of a test.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Compare {
    /// Equal.
    Equal,
    /// Not equal.
    NotEqual,
    /// Magnitude at most the value.
    Within,
    /// Greater than the value.
    Above,
    /// One of several numbers from 0 to 62: bit n of the value means n.
    Among,
}

/// Source of a step's value.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Operand {
    /// A raw constant.
    Constant(i64),
    /// The command's argument, scaled; the plan cannot run without it.
    Argument(Argument),
    /// The magnitude of the command's argument, scaled.
    Magnitude(Argument),
    /// The command's argument, scaled; the step is left out when the caller gave none.
    OptionalArgument(Argument),
    /// The time in which the command's acceleration reaches the speed, for drives that take ramp times. The
    /// step is skipped when the command has no acceleration.
    ///
    /// With raw arguments, the argument is the time itself.
    OptionalRampTime {
        /// The acceleration or deceleration.
        argument: Argument,
        /// The speed at the end of the ramp.
        speed: RampSpeed,
    },
}

impl Operand {
    /// Returns whether the step is left out where the command lacks the argument.
    #[must_use]
    pub const fn is_optional(self) -> bool {
        matches!(self, Self::OptionalArgument(_) | Self::OptionalRampTime { .. })
    }

    /// Returns whether a command without that argument has no value for it.
    #[must_use]
    pub fn requires(self, which: Argument) -> bool {
        matches!(self, Self::Argument(own) | Self::Magnitude(own) if own == which)
    }

    /// The argument of the command that the value comes from.
    #[must_use]
    pub const fn argument(self) -> Option<Argument> {
        match self {
            Self::Constant(_) => None,
            Self::Argument(argument)
            | Self::Magnitude(argument)
            | Self::OptionalArgument(argument)
            | Self::OptionalRampTime { argument, .. } => Some(argument),
        }
    }
}

/// The speed that the time of a ramp leads to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RampSpeed {
    /// A constant speed, rpm.
    Fixed(u16),
    /// The velocity that the command carries, or this one where it carries none, rpm.
    VelocityOr(u16),
}

impl RampSpeed {
    /// The speed, rad/s, for a command of that velocity, rad/s.
    #[must_use]
    pub fn of(self, velocity: Option<f64>) -> f64 {
        match self {
            Self::Fixed(rpm) => rpm_si(rpm),
            Self::VelocityOr(rpm) => velocity.map_or(rpm_si(rpm), f64::abs),
        }
    }
}

fn rpm_si(rpm: u16) -> f64 {
    f64::from(rpm) * Unit::Rpm.si_factor()
}
