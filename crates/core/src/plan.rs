//! A verb as data: a short table of steps, as in the manuals.
//!
//! The lane's executor runs every plan, a rehearsal prints it without sending, and tests compare it with
//! its manual. Steps name parameters of the profile, or the protocol's function, index and value. So plans
//! have the same form for every protocol, and can be written in TOML.

use crate::axis::Verb;
use crate::profile::ParameterId;
use crate::units::Unit;

/// Steps that a plan may have at most.
pub const STEPS_MAX: usize = 64;

/// How a verb is carried out.
#[derive(Debug)]
pub struct Plan {
    /// The verb.
    pub verb: Verb,
    /// Where the recipe stands in the manual.
    pub source: &'static str,
    /// What to do, in order.
    pub steps: &'static [Step],
    /// What to do when a step after the first fails, or the plan is cut short, and more than
    /// questions were sent.
    pub undo: &'static [Step],
}

impl Plan {
    /// Where what is waited for last begins and ends: steps between that only read and wait.
    fn last_wait(&self) -> Option<(usize, usize)> {
        let waits = |step: &Step| matches!(step, Step::Until { .. });
        let last = self.steps.iter().rposition(waits)?;
        let sent =
            self.steps[..last].iter().rposition(Step::may_change_drive).map_or(0, |at| at + 1);
        let first = sent + self.steps[sent..].iter().position(waits)?;
        Some((first, last + 1))
    }

    /// The steps before those that only wait: all that a stop has to tell its drive (STOP-7).
    #[must_use]
    pub fn before_wait(&self) -> &'static [Step] {
        &self.steps[..self.last_wait().map_or(self.steps.len(), |(first, _)| first)]
    }

    /// The steps behind what is waited for last: what a stop tells its drive once the motor stands.
    #[must_use]
    pub fn after_wait(&self) -> &'static [Step] {
        &self.steps[self.last_wait().map_or(self.steps.len(), |(_, end)| end)..]
    }
}

/// One step.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Step {
    /// Writes a parameter.
    Write(ParameterId, Operand),
    /// Reads a parameter first and writes it only if it differs. For what goes to flash: the write,
    /// if any, is announced and counted.
    Ensure(ParameterId, i64),
    /// Reads a parameter, so that the axis' state has a fresh value.
    Read(ParameterId),
    /// Reads a parameter and writes what was read to another: target := actual.
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
        /// What to do about it, for people.
        hint: &'static str,
    },
    /// Leaves out the next steps if the parameter passes the test.
    Skip {
        /// The parameter to read.
        read: ParameterId,
        /// The test.
        test: ParameterTest,
        /// How many steps.
        count: u8,
    },
    /// Leaves out the next steps if the drive refuses to tell the parameter: for what not every
    /// drive of a standard has.
    SkipIfMissing {
        /// The parameter to read.
        read: ParameterId,
        /// How many steps.
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
        /// Give up after so long.
        within_ms: u32,
        /// Giving up ends the plan; else it goes on.
        required: bool,
    },
    /// Sends what is no parameter: the protocol's own function, index and value.
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
        /// So long.
        ms: u32,
    },
}

impl Step {
    /// Whether it may change something in the drive.
    #[must_use]
    pub const fn may_change_drive(&self) -> bool {
        use Step::{Copy, Ensure, Send, Store, Write};
        matches!(self, Write(..) | Ensure(..) | Copy { .. } | Send { .. } | Store(_))
    }
}

/// Masked comparison.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ParameterTest {
    /// Bits that count; all ones for a number.
    pub mask: i64,
    /// How they are compared.
    pub compare: Compare,
    /// With what.
    pub value: i64,
}

impl ParameterTest {
    /// Whether `raw` passes.
    #[must_use]
    pub const fn passes(&self, raw: i64) -> bool {
        let masked = raw & self.mask;
        match self.compare {
            Compare::Equal => masked == self.value,
            Compare::NotEqual => masked != self.value,
            Compare::Within => masked.saturating_abs() <= self.value,
            Compare::Among => 0 <= masked && masked < 63 && self.value >> masked & 1 == 1,
        }
    }
}

/// How a test compares.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Compare {
    /// Equal.
    Equal,
    /// Not equal.
    NotEqual,
    /// Magnitude at most the value.
    Within,
    /// One of several numbers from 0 to 62: bit n of the value stands for n.
    Among,
}

/// Where a step's value comes from.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Operand {
    /// A raw constant.
    Constant(i64),
    /// The command's argument, scaled; the plan cannot run without it.
    Argument(Argument),
    /// The command's argument, scaled; the step is left out when the caller gave none.
    OptionalArgument(Argument),
    /// The time in which an acceleration that the command carries reaches a speed, for drives that
    /// are told the time of their ramps. The step is left out when the caller gave no acceleration.
    ///
    /// Where the command's arguments are raw numbers, the argument is that time itself.
    OptionalRampTime {
        /// The acceleration or deceleration.
        argument: Argument,
        /// The speed at the end of the ramp.
        speed: RampSpeed,
    },
}

impl Operand {
    /// The argument of the command that the value comes from.
    #[must_use]
    pub const fn argument(self) -> Option<Argument> {
        match self {
            Self::Constant(_) => None,
            Self::Argument(argument)
            | Self::OptionalArgument(argument)
            | Self::OptionalRampTime { argument, .. } => Some(argument),
        }
    }
}

/// The speed that the time of a ramp leads to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RampSpeed {
    /// The same speed always, rpm.
    Fixed(u16),
    /// The velocity that the command carries, or this one where it carries none, rpm.
    VelocityOr(u16),
}

impl RampSpeed {
    /// The speed, rad/s, for a command of that velocity, rad/s.
    #[must_use]
    pub fn of(self, velocity: Option<f64>) -> f64 {
        let of_rpm = |rpm: u16| f64::from(rpm) * Unit::Rpm.si_factor();
        match self {
            Self::Fixed(rpm) => of_rpm(rpm),
            Self::VelocityOr(rpm) => velocity.map_or(of_rpm(rpm), f64::abs),
        }
    }
}

/// What a command carries.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Argument {
    /// Where to go, or how far.
    Target,
    /// How fast.
    Velocity,
    /// How quickly to get there.
    Acceleration,
    /// How quickly to slow down, where that is another than the acceleration.
    Deceleration,
    /// With how much torque.
    Torque,
    /// How long the acceleration takes to build up.
    JerkTime,
    /// How often.
    Period,
}
