//! The unified vocabulary: what any axis can be told, what it tells, and who translates.

use core::time::Duration;

use crate::error::{Failure, Outcome, Unsupported};
use crate::explain::RawFrame;
use crate::lane::{MemoryBlock, MemoryTransfer, TransferKind};
use crate::plan::{Argument, ParameterTest};
use crate::profile::{AddressRole, NoScale, Parameter, ParameterId, Profile};
use crate::program::{MemoryRules, ProgramCommand, TransferStep};
use crate::station::{AxisIndex, Counters, Request, RequestClass, Ticket};
use crate::stream::cyclic::{
    CycleStatistics, CyclicConfig, SetpointCommand as CycleOrder, SetpointKind,
};
use crate::stream::{PathKind, PathParameters, PathStatus, PathStep, Point};
use crate::time::Instant;

mod event;
mod rehearsal;
mod status;
mod verb;

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
    /// With how much torque.
    pub torque: Option<f64>,
    /// How long the acceleration takes to build up.
    pub jerk_time: Option<f64>,
    /// How often.
    pub period: Option<f64>,
    /// How long its motion may take, ms, where that is not for the plan to say.
    pub limit_ms: Option<u32>,
    /// Arguments are the drive's own numbers where its scale reads zero; else they are in SI as always.
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
            torque: None,
            jerk_time: None,
            period: None,
            limit_ms: None,
            raw: false,
            keep_program: false,
        }
    }
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

/// What one drive of a group answered.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct GroupAnswer {
    /// What was asked.
    pub ticket: Ticket,
    /// The drive's address on the wire.
    pub address: u32,
    /// Its value, raw.
    pub raw: i64,
}

/// What the layers above hold: protocol, family and medium are erased.
pub trait Axes {
    /// How many axes there are.
    fn axis_count(&self) -> usize;
    /// The drive's address of an axis.
    fn address(&self, axis: AxisIndex) -> Option<u32>;
    /// What is known of the product.
    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile>;
    /// What is known of the axis.
    fn state(&self, axis: AxisIndex) -> Option<&AxisStatus>;

    /// Whether its drive answers what changes something; see [`Host`](crate::station::Host::CONFIRMED).
    fn is_confirmed(&self, axis: AxisIndex) -> bool {
        let _ = axis;
        true
    }

    /// Lets motion commands through, or no longer.
    fn set_armed(&mut self, axis: AxisIndex, armed: bool);

    /// Starts a verb. It ends in one outcome under `ticket`.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported>;

    /// Starts a part of what stops an axis. Its outcome is `Done` only if every step was answered.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn stop(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        part: StopPart,
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, part);
        Err(Unsupported::NoPlan)
    }

    /// Has what was just asked for under `ticket` put on the wire once, however silent the drive is.
    fn disable_retries(&mut self, ticket: Ticket) {
        let _ = ticket;
    }

    /// Reads a parameter, raw.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn read_parameter(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported>;

    /// Writes a parameter, raw. After silence it is read back before the outcome is told. Permanent
    /// memory is left alone unless `keep` asks for it: a drive that would write it is first told
    /// not to.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn write_parameter(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported>;

    /// Sends a request in the protocol's own text.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn send_text(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported>;

    /// Sends a request in the protocol's own bytes: a whole frame, with its identifier on CAN.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn send_frame(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        frame: &RawFrame<'_>,
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, frame);
        Err(Unsupported::BadBytes)
    }

    /// Begins a path that is streamed point by point from where the axis stands; see
    /// [`feed_points`](Self::feed_points). It ends in one outcome under `ticket`: the number of points, when all
    /// are used up.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn start_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, kind);
        Err(Unsupported::NoPlan)
    }

    /// Takes points of the path under `ticket`, as many as there is room for, and tells how many.
    /// `complete` says that the last of them ends the path; it should be one at rest. `None` when
    /// that path has ended.
    fn feed_points(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize> {
        let _ = (ticket, points, complete);
        None
    }

    /// Gives several axes of one wire, each made ready by its verb before, a set-point cycle by
    /// cycle; see [`feed_cycles`](Self::feed_cycles). It ends in one outcome under `ticket`: the
    /// number of cycles. One that fails, or is stopped, stops all and disarms them.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn start_cyclic(
        &mut self,
        now: Instant,
        ticket: Ticket,
        following: &CyclicConfig<'_>,
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, following);
        Err(Unsupported::NoPlan)
    }

    /// Takes set-points in SI for the cycles to come, those of a cycle side by side in the order of
    /// the axes, as many whole cycles as there is room for, and tells how many. `complete` says that
    /// the last of them ends the motion; it must be one at rest. `None` when there is no such motion.
    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize> {
        let _ = (ticket, setpoints, complete);
        None
    }

    /// How the present, or the last, cyclic motion of an axis went.
    fn cycle_statistics(&self, axis: AxisIndex) -> Option<&CycleStatistics> {
        let _ = axis;
        None
    }

    /// What a cycle of those axes takes of their one wire at most, ns; zero without timing.
    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64> {
        let _ = axes;
        None
    }

    /// What is to be known of the memory that programs of an axis lie in; `None` where it takes none.
    fn memory_rules(&self, axis: AxisIndex) -> Option<&'static MemoryRules> {
        let _ = axis;
        None
    }

    /// Writes, verifies or reads words of an axis' memory. It ends in one outcome under `ticket`: how
    /// many words; [`last_transfer`](Self::last_transfer) tells more. Nothing is written while the axis
    /// has power or its program runs; until it ends, what would power the axis is refused.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn start_transfer(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: TransferKind,
        pieces: &[MemoryBlock],
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, kind, pieces);
        Err(Unsupported::NoPlan)
    }

    /// The axis' transfer that is under way, or its last one.
    fn last_transfer(&self, axis: AxisIndex) -> Option<&MemoryTransfer> {
        let _ = axis;
        None
    }

    /// Tells an axis an order about its programs. One that could move the motor needs an armed axis;
    /// one that ends a program overtakes everything, as a stop does.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn send_program_command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: ProgramCommand,
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, command);
        Err(Unsupported::NoPlan)
    }

    /// What the next drive of a group answered under `ticket`; it comes before the outcome, in the
    /// order of the drives' addresses.
    fn poll_group_answer(&mut self, _ticket: Ticket) -> Option<GroupAnswer> {
        None
    }

    /// Takes bytes of a long value that the protocol's own request reads under `ticket`, and tells
    /// how many; see [`send_text`](Self::send_text). The drive sends on as they are taken, and the request ends
    /// when all are. `None` when there is no such request, or it has not begun.
    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        let _ = (ticket, out);
        None
    }

    /// Gives bytes of a long value that the protocol's own request writes under `ticket`, and tells
    /// how many were taken. `None` when there is no such request, or it has not begun.
    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        let _ = (ticket, bytes);
        None
    }

    /// The next outcome.
    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)>;

    /// What a write of a parameter changes at once of how the drive is reached, if it does.
    ///
    /// # Errors
    /// [`Unsupported::Forbidden`] for an address at which nobody could talk with it any more.
    fn address_change(
        &self,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported>;

    /// A parameter that must be read before all that a drive sends by itself is understood: the n-th
    /// of those that are not known yet, to be read in this order.
    fn unread_prerequisite(&self, axis: AxisIndex, n: usize) -> Option<ParameterId> {
        let _ = (axis, n);
        None
    }

    /// Begins, or ends, to keep what happens for [`poll_axis_event`](Self::poll_axis_event). What is so already
    /// when it begins is not news.
    fn enable_events(&mut self, _on: bool) {}

    /// The next thing that happened while [`enable_events`](Self::enable_events) is on: what drives said unasked,
    /// and faults and the loss of arming whoever found them. `now` stamps what has no time of its own.
    fn poll_axis_event(&mut self, now: Instant) -> Option<AxisEvent> {
        let _ = now;
        None
    }

    /// Shows, step by step, what a command would send. Nothing is sent.
    ///
    /// # Errors
    /// [`Unsupported`] as the command itself would give.
    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported>;

    /// Whether the drive was asked for a parameter and said that it has none such: one of those that
    /// its profile calls [optional](Profile::optional). It is not asked again until it restarts, what
    /// a plan does with it is left out, and what it scales is raw.
    fn lacks_parameter(&self, axis: AxisIndex, parameter: ParameterId) -> bool {
        let _ = (axis, parameter);
        false
    }

    /// What the last step that waited in vain was waiting for.
    fn unmet_wait(&self, axis: AxisIndex) -> Option<UnmetWait> {
        let _ = axis;
        None
    }

    /// The raw value of a parameter that others are scaled by, if it was read and believed.
    fn scale_input(&self, axis: AxisIndex, parameter: ParameterId) -> Option<i64> {
        let _ = (axis, parameter);
        None
    }

    /// Why a parameter has no unit, as far as is known: what scales it is missing, zero, or contradicts
    /// itself. Its SI value is then the raw one.
    fn scale_error(&self, axis: AxisIndex, parameter: ParameterId) -> Option<NoScale> {
        let _ = (axis, parameter);
        None
    }

    /// SI value of a raw one, by the scale of its parameter. `None` while a parameter that the
    /// scale depends on was never read.
    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64>;

    /// Raw value of an SI one, rounded to the nearest. `None` as with [`to_si`](Self::to_si).
    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64>;

    /// What happened on the wire so far.
    fn counters(&self) -> Counters;

    /// What came while the last request of that axis that ended in silence was on the wire.
    fn silence_counters(&self, _axis: AxisIndex) -> Counters {
        Counters::default()
    }

    /// Takes one more axis in, behind all that there are: those keep their places, states and
    /// requests. Of several lanes on a wire it goes to the one of that number, 0 for one alone.
    /// `None` where no axis can be added: no such lane, a lane that does not know how or has other
    /// things to do on its wire just now, an address that is an axis or the host's own, or 256 axes.
    fn add_axis(
        &mut self,
        lane: usize,
        profile: &'static Profile,
        address: u32,
    ) -> Option<AxisIndex> {
        let _ = (lane, profile, address);
        None
    }

    /// Whether one of that address could join now, but for the number of axes.
    fn can_add_axis(&self, _lane: usize, _address: u32) -> bool {
        false
    }

    /// Whether the wire must not be lent: the host speaks by itself to keep drives alive or in step.
    fn sends_keepalive(&self) -> bool {
        false
    }

    /// Somebody else had the wire until now: the silence before a frame begins anew.
    fn handle_resume(&mut self, _now: Instant) {}
}

/// A lane with its host erased: what connections and simulated worlds hold.
pub trait AnyLane<M: crate::medium::Medium>: Axes + crate::station::Station<M> + Send {}

impl<M: crate::medium::Medium, T: Axes + crate::station::Station<M> + Send> AnyLane<M> for T {}
