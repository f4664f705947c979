//! The common vocabulary of all axes: verbs, signals, and the drivers that translate them.

use core::time::Duration;

use crate::convert::saturating;
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

pub use crate::verb::Verb;
pub use axes::{
    AnyLane, Axes, AxisCommands, AxisData, AxisDirectory, AxisPaths, AxisPrograms, AxisRequests,
    AxisScales, AxisText, AxisTraffic, GroupAnswer,
};
pub use event::{AxisEvent, AxisEventKind, DriveReport, Presence, REPORTS_MAX};
pub use rehearsal::{RehearsalAction, RehearsalStep, TextRehearsal};
pub use status::{AxisStatus, Emergency, MotionReport, ProgramEnd, Reading};

/// A part of an axis' stop.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StopPart {
    /// All that takes motion out of the drive: it stops the motor, and ends the drive's own program,
    /// which would move it again, unless the command keeps it.
    Halt,
    /// The steps after the motor has come to rest: [`Plan::after_wait`](crate::plan::Plan::after_wait).
    Release,
}

/// A verb with its arguments, in SI: rad or m, rad/s, rad/s², N·m (1 on ratio axes), s. An argument
/// that the caller leaves out is `None`; the plan decides whether it can do without.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Command {
    /// The action.
    pub verb: Verb,
    /// Target position, or distance of a relative move.
    pub target: Option<f64>,
    /// Velocity.
    pub velocity: Option<f64>,
    /// Acceleration.
    pub acceleration: Option<f64>,
    /// Deceleration, if it differs from the acceleration.
    pub deceleration: Option<f64>,
    /// With how much torque.
    pub torque: Option<f64>,
    /// Jerk time: the time in which the acceleration builds up.
    pub jerk_time: Option<f64>,
    /// Cycle period.
    pub period: Option<f64>,
    /// Number of a path that is stored in the drive: the one to run, or the one that a move overwrites.
    pub path: Option<f64>,
    /// Time limit of the motion, ms. Replaces the limit of the plan.
    pub limit_ms: Option<u32>,
    /// Arguments are raw drive values where the drive's scale reads zero; otherwise they are in SI units.
    /// For a drive that takes ramp times, a raw acceleration is the ramp time.
    pub raw: bool,
    /// A stop leaves the drive's own program running.
    pub keep_program: bool,
}

/// The test of a wait step that timed out, and the last value that was read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UnmetWait {
    /// The parameter.
    pub parameter: ParameterId,
    /// The test that did not pass.
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
            Argument::Path => self.path,
        }
    }

    /// Returns this command with a time limit for its motion, in place of the plan's limit.
    #[must_use]
    pub fn limited(self, within: Duration) -> Self {
        let limit_ms = saturating(within.as_millis());
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
            path: None,
            limit_ms: None,
            raw: false,
            keep_program: false,
        }
    }
}

/// Readings that show whether a drive executed a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ExecutionProof {
    /// The parameter that shows its effect.
    pub parameter: ParameterId,
    /// Passed by the parameter once the request is executed.
    pub executed: ParameterTest,
    /// The parameter that shows faults.
    pub fault_parameter: ParameterId,
    /// Bits that are faults; while one is set nothing is sent again.
    pub fault_mask: i64,
}

/// Meaning of a refusal for its request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal {
    /// The request was not executed and will not be.
    Final,
    /// The drive does not have the parameter. This is not an error of the request.
    Missing,
    /// The drive is busy with another request; this one was not executed and may be sent again.
    Busy,
    /// The drive accepted the request and is not done with it yet.
    Accepted,
    /// The drive stores requests as instructions of a program, this one too. It was not executed.
    Stored,
}

/// The requests of a protocol to one drive.
pub trait RequestEncoder {
    /// The protocol's request.
    type Request: Request;

    /// Returns the request that reads a parameter. It is always the same request for a parameter, so a
    /// lane calls this once.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol cannot read it. The caller has already checked the access.
    fn read_request(&self, parameter: &Parameter) -> Result<Self::Request, Unsupported>;

    /// Returns the request that writes a raw value. `class` is the class of the write;
    /// [`Request::class`] of the result must return it.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol cannot write it. The caller has already checked access and range.
    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<Self::Request, Unsupported>;

    /// Returns the request that writes neighbouring parameters at once.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has none, or they are no neighbours. The caller has already checked access and
    /// ranges.
    fn write_together_request(
        &self,
        writes: &[(&Parameter, i64)],
        class: RequestClass,
    ) -> Result<Self::Request, Unsupported> {
        let _ = (writes, class);
        Err(Unsupported::Forbidden("this protocol writes one parameter with each request"))
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

    /// Builds a request that carries more of the command than one value: a target and its speed.
    ///
    /// # Errors
    /// As [`function_request`](Self::function_request), or the fault of the command's other arguments.
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

    /// Parses a frame of the protocol as a request to this drive. The class follows from its content, as in
    /// [`parse_request`](Self::parse_request).
    ///
    /// # Errors
    /// [`Unsupported::BadBytes`] when it is not a request, or is addressed to another drive.
    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<Self::Request, Unsupported>;
}

/// The replies of a drive, and its unsolicited messages.
pub trait AnswerDecoder {
    /// The protocol's answer.
    type Answer: Copy + 'static;

    /// Returns the raw value in a reply. `parameter` is the parameter that was read or written, if any.
    ///
    /// # Errors
    /// [`Failure::Refused`] with the drive's code, [`Failure::Misbehaved`].
    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Self::Answer,
    ) -> Result<i64, Failure>;

    /// Meaning of a refusal with this code for the request.
    fn refusal(&self, code: u32) -> Refusal {
        let _ = code;
        Refusal::Final
    }

    /// Returns whether a reply repeats neither the parameter nor anything else that distinguishes it from the reply to
    /// another read, so that a duplicated reply can be taken for the next one.
    fn has_anonymous_replies(&self) -> bool {
        false
    }

    /// Processes a message that the drive sent by itself, and returns the values in it.
    fn decode_unsolicited(&mut self, answer: &Self::Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        let _ = answer;
        [None; REPORTS_MAX]
    }

    /// A parameter that must be read before all that the drive sends by itself is understood, the
    /// n-th of those that are not known yet, in the order in which they are to be read.
    fn unread_prerequisite(&self, n: usize) -> Option<ParameterId> {
        let _ = n;
        None
    }
}

/// Particular effects of a write to a drive.
pub trait WriteRules {
    /// Returns whether a parameter is read before a write, because the write changes only a part of it.
    fn reads_before_write(&self, parameter: &Parameter) -> bool {
        let _ = parameter;
        false
    }

    /// Returns whether a setting is written again after a new reading has shown that the first write had no effect.
    /// True only for protocols whose manual asks for it.
    fn may_rewrite(&self, parameter: &Parameter) -> bool {
        let _ = parameter;
        false
    }

    /// Returns the readings that show whether the drive executed a [`Send`](crate::plan::Step::Send) step
    /// that was not acknowledged. `None` where no reading can show it, or where the step may start a
    /// motion: such a step is never sent again.
    fn execution_proof(&self, function: u8, index: u16, value: i64) -> Option<ExecutionProof> {
        let _ = (function, index, value);
        None
    }

    /// The role of a parameter in addressing the drive, where a write takes effect at once: the reply to
    /// the next request then comes from, or goes to, another address.
    fn address_role(&self, parameter: &Parameter) -> Option<AddressRole> {
        let _ = parameter;
        None
    }
}

/// Parameters of any length: text and bytes.
pub trait DataDriver: RequestEncoder {
    /// Returns the request that reads a parameter of any length (text or bytes). The host delivers the
    /// bytes as they arrive ([`HostData::poll_bytes`](crate::station::HostData::poll_bytes)).
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has no such values.
    fn data_read_request(
        &self,
        parameter: &Parameter,
        block: bool,
        max: u16,
    ) -> Result<Self::Request, Unsupported>;

    /// The request that writes `size` bytes to a parameter of any length
    /// ([`HostData::feed_bytes`](crate::station::HostData::feed_bytes)).
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has no such values.
    fn data_write_request(
        &self,
        parameter: &Parameter,
        size: u32,
        block: bool,
    ) -> Result<Self::Request, Unsupported>;
}

/// Paths that are streamed point by point.
pub trait PathDriver: RequestEncoder {
    /// The parameters of a streamed path; `None` where the drive takes no paths.
    fn path_parameters(&self) -> Option<PathParameters>;

    /// A request of such a path; `None` beyond the last preparation.
    fn path_request(&self, step: PathStep) -> Option<Result<Self::Request, Unsupported>>;

    /// Decodes the drive's buffer status.
    fn decode_path_status(&self, raw: i64) -> PathStatus;
}

/// Set-points cycle by cycle.
pub trait CyclicDriver: RequestEncoder {
    /// The parameter that is commanded cycle by cycle; `None` where the drive is not ready for that.
    fn setpoint_parameter(&self, setpoint: SetpointKind) -> Option<ParameterId>;

    /// Returns the request that sends a raw set-point for the next [`sync_request`](Self::sync_request). The
    /// drive does not reply to it.
    fn setpoint_request(
        &self,
        setpoint: SetpointKind,
        raw: i64,
        command: CycleOrder,
    ) -> Option<Self::Request>;

    /// The request that makes all drives of the wire apply their prepared values.
    fn sync_request(&self) -> Option<Self::Request>;

    /// Bits that a cycle of this drive takes of the wire at most, and apart from it the beat for all.
    fn cycle_bits(&self) -> (u32, u32);
}

/// The program that a drive runs by itself.
pub trait ProgramDriver: RequestEncoder {
    /// Returns the request for a program command; `None` where the drive has no such command.
    fn program_request(&self, command: ProgramCommand) -> Option<Self::Request>;

    /// Returns whether the reply to [`ProgramCommand::QueryProgram`] means that a program is running.
    fn is_program_running(&self, raw: i64) -> bool;
}

/// The program memory of a drive.
pub trait MemoryDriver: RequestEncoder {
    /// The rules of the drive's program memory.
    fn memory_rules(&self) -> &'static MemoryRules;

    /// The request of a step of a transfer.
    ///
    /// # Errors
    /// [`Unsupported`] when the protocol has none for the step.
    fn transfer_request(&self, step: TransferStep) -> Result<Self::Request, Unsupported>;
}

/// Values that a drive sends by itself at an interval that the host sets.
pub trait ReportDriver {
    /// The parameter, and its raw value, with which the drive sends these by itself every `interval_ms`;
    /// with none of them, sends nothing more. `None` where it does not send one of them.
    fn report_setting(
        &self,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)>;
}

/// One protocol's translation between parameters and requests, for one axis. No queue, no clock, no
/// executor: those are the lane's. A family overrides what its drive does differently.
pub trait Driver: RequestEncoder + AnswerDecoder + WriteRules {
    /// The profile of the product.
    fn profile(&self) -> &'static Profile;

    /// The drive's address on the wire, as events name it.
    fn address(&self) -> u32;

    /// True when the address names several drives. Each of them answers a read.
    fn is_group(&self) -> bool {
        false
    }

    /// Parameters of any length: text and bytes. `None` if the drive has none.
    fn data(&self) -> Option<&dyn DataDriver<Request = Self::Request>> {
        None
    }

    /// Paths that are streamed point by point. `None` if the drive has none.
    fn paths(&self) -> Option<&dyn PathDriver<Request = Self::Request>> {
        None
    }

    /// Set-points cycle by cycle. `None` if the drive has none.
    fn cycles(&self) -> Option<&dyn CyclicDriver<Request = Self::Request>> {
        None
    }

    /// The program that a drive runs by itself. `None` if the drive has none.
    fn programs(&self) -> Option<&dyn ProgramDriver<Request = Self::Request>> {
        None
    }

    /// The program memory of a drive. `None` if the drive has none.
    fn memory(&self) -> Option<&dyn MemoryDriver<Request = Self::Request>> {
        None
    }

    /// Values that a drive sends by itself at an interval that the host sets. `None` if the drive has none.
    fn reports(&self) -> Option<&dyn ReportDriver> {
        None
    }
}
