//! The common vocabulary of all axes: verbs, signals, and the drivers that translate them.

use core::time::Duration;

use crate::error::{Failure, Unsupported};
use crate::explain::RawFrame;
use crate::plan::{Argument, ParameterTest};
use crate::profile::{AddressRole, Parameter, ParameterId, Profile};
use crate::program::{MemoryRules, ProgramCommand, TransferStep};
use crate::station::{Request, RequestClass};
use crate::stream::cyclic::{SetpointCommand as CycleOrder, SetpointKind};
use crate::stream::{PathParameters, PathStatus, PathStep};

mod axes;
mod event;
mod rehearsal;
mod status;
mod verb;

pub use axes::{AnyLane, Axes, GroupAnswer};
pub use event::{AxisEvent, AxisEventKind, DriveReport, Presence, REPORTS_MAX};
pub use rehearsal::{RehearsalAction, RehearsalStep};
pub use status::{AxisStatus, ProgramEnd, Reading};
pub use verb::Verb;

/// A part of what stops an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StopPart {
    /// All that takes motion out of the drive: it stops the motor, and ends the drive's own program,
    /// which would move it again, unless that is to be kept.
    Halt {
        /// A program of the drive goes on.
        keep_program: bool,
    },
    /// What is told once the motor stands: [`Plan::after_wait`](crate::plan::Plan::after_wait).
    Release,
}

/// A verb with its arguments, in SI: rad or m, rad/s, rad/s², N·m (1 on ratio axes), s. An argument
/// that the caller leaves out is `None`; the plan decides whether it can do without.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Command {
    /// What to do.
    pub verb: Verb,
    /// Where to, or how far.
    pub target: Option<f64>,
    /// How fast.
    pub velocity: Option<f64>,
    /// How quickly.
    pub acceleration: Option<f64>,
    /// How quickly to slow down, where that is another than the acceleration.
    pub deceleration: Option<f64>,
    /// With how much torque.
    pub torque: Option<f64>,
    /// How long the acceleration takes to build up.
    pub jerk_time: Option<f64>,
    /// How often.
    pub period: Option<f64>,
    /// How long its motion may take, ms, where that is not for the plan to say.
    pub limit_ms: Option<u32>,
    /// Arguments are the drive's own numbers where its scale reads zero; else they are in SI as always.
    /// An acceleration of a drive that is told the time of its ramps is that time.
    pub raw: bool,
    /// A stop leaves the drive's own program running.
    pub keep_program: bool,
}

/// A value that a step waited for, and the one that came.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UnmetWait {
    /// The parameter.
    pub parameter: ParameterId,
    /// What was waited for.
    pub test: ParameterTest,
    /// The last value, raw.
    pub value: i64,
}

impl Command {
    /// The argument of that kind, if the caller gave one.
    #[must_use]
    pub const fn argument(&self, which: Argument) -> Option<f64> {
        match which {
            Argument::Target => self.target,
            Argument::Velocity => self.velocity,
            Argument::Acceleration => self.acceleration,
            Argument::Deceleration => self.deceleration,
            Argument::Torque => self.torque,
            Argument::JerkTime => self.jerk_time,
            Argument::Period => self.period,
        }
    }

    /// The same with so long for its motion, instead of what the plan allows.
    #[must_use]
    pub fn limited(self, within: Duration) -> Self {
        let limit_ms = u32::try_from(within.as_millis()).unwrap_or(u32::MAX);
        Self { limit_ms: Some(limit_ms), ..self }
    }

    /// A verb without arguments.
    #[must_use]
    pub const fn new(verb: Verb) -> Self {
        Self {
            verb,
            target: None,
            velocity: None,
            acceleration: None,
            deceleration: None,
            torque: None,
            jerk_time: None,
            period: None,
            limit_ms: None,
            raw: false,
            keep_program: false,
        }
    }
}

const ONLY_NUMBERS: &str = "all values of this protocol are numbers";

/// What tells whether a drive executed a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ExecutionProof {
    /// The parameter that shows its effect.
    pub parameter: ParameterId,
    /// Passed by the parameter once the request is executed.
    pub executed: ParameterTest,
    /// The parameter that shows faults.
    pub fault_parameter: ParameterId,
    /// Its bits that are faults; while one is set nothing is sent again.
    pub fault_mask: i64,
}

/// One protocol's translation between parameters and requests, for one axis. No queue, no clock, no
/// executor: those are the lane's. A family overrides what its drive does differently.
pub trait Driver {
    /// The protocol's request.
    type Request: Request;
    /// The protocol's answer.
    type Answer: Copy + 'static;

    /// What is known of the product.
    fn profile(&self) -> &'static Profile;

    /// The drive's address on the wire, as events name it.
    fn address(&self) -> u32;

    /// The request that reads a parameter: always the same one, so a lane asks for it once.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol cannot; access was already checked.
    fn read_request(&self, parameter: &Parameter) -> Result<Self::Request, Unsupported>;

    /// The request that writes a raw value. `class` is what the lane holds the write to; the
    /// request must answer it from [`Request::class`].
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol cannot; access and range were already checked.
    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<Self::Request, Unsupported>;

    /// The request that reads a parameter of any length, text or bytes, whose bytes the host hands out
    /// as they arrive ([`Host::poll_bytes`](crate::station::Host::poll_bytes)).
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has no such values.
    fn data_read_request(
        &self,
        parameter: &Parameter,
        block: bool,
    ) -> Result<Self::Request, Unsupported> {
        let _ = (parameter, block);
        Err(Unsupported::Forbidden(ONLY_NUMBERS))
    }

    /// The request that writes `size` bytes to a parameter of any length
    /// ([`Host::feed_bytes`](crate::station::Host::feed_bytes)).
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has no such values.
    fn data_write_request(
        &self,
        parameter: &Parameter,
        size: u32,
        block: bool,
    ) -> Result<Self::Request, Unsupported> {
        let _ = (parameter, size, block);
        Err(Unsupported::Forbidden(ONLY_NUMBERS))
    }

    /// The request for a [`Send`](crate::plan::Step::Send) step.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has no such function.
    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<Self::Request, Unsupported>;

    /// The same, where a request carries more of the command than one value: a target and how fast
    /// to get there.
    ///
    /// # Errors
    /// As [`function_request`](Self::function_request), or what is wrong with the command's other arguments.
    fn command_request(
        &self,
        command: &Command,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<Self::Request, Unsupported> {
        let _ = command;
        self.function_request(function, index, value)
    }

    /// Whether a parameter is read before it is written, because it is a part of what is written.
    fn reads_before_write(&self, parameter: &Parameter) -> bool {
        let _ = parameter;
        false
    }

    /// Whether a setting that a fresh reading proves not written is written again. Only a protocol whose
    /// manual asks for it says yes.
    fn may_rewrite(&self, parameter: &Parameter) -> bool {
        let _ = parameter;
        false
    }

    /// The readings that tell whether the drive executed a [`Send`](crate::plan::Step::Send) step that
    /// was not acknowledged. `None` where none can, or where the step may start a motion: it is then
    /// never sent again.
    fn execution_proof(&self, function: u8, index: u16, value: i64) -> Option<ExecutionProof> {
        let _ = (function, index, value);
        None
    }

    /// The request that keeps a parameter's present value over power-off.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has none.
    fn store_request(&self, parameter: &Parameter) -> Result<Self::Request, Unsupported> {
        let _ = parameter;
        Err(Unsupported::NoPlan)
    }

    /// The request that `text`, in the protocol's own language, means for this drive.
    ///
    /// # Errors
    /// [`Unsupported::BadText`] when it is not of that language.
    fn parse_request(&self, text: &str) -> Result<Self::Request, Unsupported>;

    /// The request that a frame of the protocol is, if a host sends this drive such requests. The
    /// class comes of what it asks, as for [`parse_request`](Self::parse_request).
    ///
    /// # Errors
    /// [`Unsupported::BadBytes`] when it is no such frame, or is for another drive.
    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<Self::Request, Unsupported>;

    /// The raw value in an answer. `parameter` is what was read or written, if it was one.
    ///
    /// # Errors
    /// [`Failure::Refused`] with the drive's code, [`Failure::Misbehaved`].
    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Self::Answer,
    ) -> Result<i64, Failure>;

    /// Whether a refusal of that code says that the drive has no such parameter, which is no fault of
    /// the request.
    fn is_missing_parameter(&self, code: u32) -> bool {
        let _ = code;
        false
    }

    /// Takes what the drive said unasked, and tells what it is about.
    fn decode_unsolicited(&mut self, answer: &Self::Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        let _ = answer;
        [None; REPORTS_MAX]
    }

    /// The parameter, and its raw value, with which the drive sends these by itself every `interval_ms`;
    /// with none of them, sends nothing more. `None` where it does not send one of them.
    fn report_setting(
        &self,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        let _ = (parameters, interval_ms);
        None
    }

    /// What a parameter decides of how the drive is reached, where a write of it acts at once: the
    /// answer to the next request then comes from, or goes to, another address.
    fn address_role(&self, parameter: &Parameter) -> Option<AddressRole> {
        let _ = parameter;
        None
    }

    /// A parameter that must be read before all that the drive sends by itself is understood, the
    /// n-th of those that are not known yet, in the order in which they are to be read.
    fn unread_prerequisite(&self, n: usize) -> Option<ParameterId> {
        let _ = n;
        None
    }

    /// What a path that is streamed to this drive needs; `None` where it takes none.
    fn path_parameters(&self) -> Option<PathParameters> {
        None
    }

    /// A request of such a path; `None` beyond the last preparation.
    fn path_request(&self, step: PathStep) -> Option<Result<Self::Request, Unsupported>> {
        let _ = step;
        None
    }

    /// What the drive's status of its buffer says.
    fn decode_path_status(&self, raw: i64) -> PathStatus {
        let _ = raw;
        PathStatus::default()
    }

    /// The parameter that is commanded cycle by cycle; `None` where the drive is not ready for that.
    fn setpoint_parameter(&self, setpoint: SetpointKind) -> Option<ParameterId> {
        let _ = setpoint;
        None
    }

    /// Brings a drive its set-point, raw, for the next [`sync_request`](Self::sync_request). Nobody answers it.
    fn setpoint_request(
        &self,
        setpoint: SetpointKind,
        raw: i64,
        command: CycleOrder,
    ) -> Option<Self::Request> {
        let _ = (setpoint, raw, command);
        None
    }

    /// The request that makes all drives of the wire take over what they were brought.
    fn sync_request(&self) -> Option<Self::Request> {
        None
    }

    /// Bits that a cycle of this drive takes of the wire at most, and apart from it the beat for all.
    fn cycle_bits(&self) -> (u32, u32) {
        (0, 0)
    }

    /// What is to be known of the memory that programs of this drive lie in; `None` where it takes
    /// none.
    fn memory_rules(&self) -> Option<&'static MemoryRules> {
        None
    }

    /// A request of a transfer; `None` where the drive takes no programs.
    fn transfer_request(&self, step: TransferStep) -> Option<Result<Self::Request, Unsupported>> {
        let _ = step;
        None
    }

    /// What tells the drive such an order; `None` where it takes none.
    fn program_request(&self, command: ProgramCommand) -> Option<Self::Request> {
        let _ = command;
        None
    }

    /// Whether an answer to [`ProgramCommand::QueryProgram`] says that a program runs.
    fn is_program_running(&self, raw: i64) -> bool {
        let _ = raw;
        false
    }

    /// True when the address names several drives. Each of them answers a read.
    fn is_group(&self) -> bool {
        false
    }
}
