//! The interface of axes for the layers above.

use super::{
    AxisEvent, AxisStatus, Command, MotionReport, Refusal, RehearsalStep, StopPart, TextRehearsal,
    UnmetWait,
};
use crate::error::{Outcome, Unsupported};
use crate::explain::RawFrame;
use crate::judge::Tolerance;
use crate::profile::{AddressRole, NoScale, Parameter, ParameterId, Profile};
use crate::program::{MemoryBlock, MemoryRules, MemoryTransfer, ProgramCommand, TransferKind};
use crate::station::{AxisIndex, Counters, Ticket};
use crate::stream::cyclic::{CycleStatistics, CyclicConfig};
use crate::stream::{PathKind, Point};
use crate::time::Instant;

/// The reply of one drive of a group.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct GroupAnswer {
    /// Ticket of the request.
    pub ticket: Ticket,
    /// The drive's address on the wire.
    pub address: u32,
    /// Raw value.
    pub raw: i64,
}

/// Axes of a wire: their drives, parameters and states.
pub trait AxisDirectory {
    /// Number of axes.
    fn axis_count(&self) -> usize;

    /// The drive's address of an axis.
    fn address(&self, axis: AxisIndex) -> Option<u32>;

    /// The profile of an axis' product.
    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile>;

    /// The last known state of an axis.
    fn state(&self, axis: AxisIndex) -> Option<&AxisStatus>;

    /// A parameter of an axis: one of its profile, or one that was [added](Self::add_parameter).
    fn parameter(&self, axis: AxisIndex, id: ParameterId) -> Option<&'static Parameter>;

    /// Adds a parameter that the profile does not have to an axis, and returns its ID. A parameter that was
    /// added before keeps its ID. `None` when the axis has too many parameters.
    fn add_parameter(
        &mut self,
        axis: AxisIndex,
        parameter: &'static Parameter,
    ) -> Option<ParameterId>;

    /// Returns whether the drive replies to requests that change something; see
    /// [`Host`](crate::station::Host::CONFIRMED).
    fn is_confirmed(&self, axis: AxisIndex) -> bool;

    /// Meaning of a refusal with this code.
    fn refusal(&self, axis: AxisIndex, code: u32) -> Refusal;

    /// Returns whether the drive has reported that it does not have this [optional](Profile::optional) parameter. It is
    /// not read again until the drive restarts; plans leave out the steps that use it, and values that it scales stay
    /// raw.
    fn lacks_parameter(&self, axis: AxisIndex, parameter: ParameterId) -> bool;

    /// Adds an axis after all existing ones, which keep their indices, states and requests. `lane` is the
    /// number of the lane on a wire with several, otherwise 0. Returns `None` where the axis cannot be
    /// added: no such lane, a lane that does not support it or is busy, an address in use by an axis or by
    /// the host, or 256 axes.
    fn add_axis(
        &mut self,
        lane: usize,
        profile: &'static Profile,
        address: u32,
    ) -> Option<AxisIndex>;

    /// Returns whether an axis of that address could be added, apart from the limit on the number of axes.
    fn can_add_axis(&self, lane: usize, address: u32) -> bool;
}

/// Reads and writes of raw values, and the outcomes of all requests.
pub trait AxisRequests {
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

    /// Writes a raw value to a parameter. After a time-out the parameter is read back before the outcome is
    /// reported. Permanent memory is written only with `keep`: without it, a drive that would write to
    /// flash is first switched to RAM.
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

    /// Returns how a write of a parameter changes the address of the drive at once, if it does.
    ///
    /// # Errors
    /// [`Unsupported::Forbidden`] for an address at which no host could reach the drive any more.
    fn address_change(
        &self,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported>;

    /// A parameter that must be read before all that a drive sends by itself is understood: the n-th
    /// of those that are not known yet, to be read in this order.
    fn unread_prerequisite(&self, axis: AxisIndex, n: usize) -> Option<ParameterId>;

    /// The parameter, and its raw value, with which a drive sends these by itself every `interval_ms`;
    /// with none of them, sends nothing more. `None` where it does not send one of them.
    fn report_setting(
        &self,
        axis: AxisIndex,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)>;

    /// Sends the request of `ticket`, which was submitted just now, only once, even if the drive is silent.
    fn disable_retries(&mut self, ticket: Ticket);

    /// Returns the next reply of a drive of a group under `ticket`. Replies come before the outcome, in the
    /// order of the drives' addresses.
    fn poll_group_answer(&mut self, ticket: Ticket) -> Option<GroupAnswer>;

    /// The next outcome.
    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)>;
}

/// Conversion between raw values and SI.
pub trait AxisScales {
    /// SI value of a raw one, by the scale of its parameter. `None` while a parameter that the
    /// scale depends on was never read.
    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64>;

    /// Raw value of an SI one, rounded to the nearest. `None` as with [`to_si`](Self::to_si).
    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64>;

    /// The raw value of a parameter that others are scaled by, if it was read and believed.
    fn scale_input(&self, axis: AxisIndex, parameter: ParameterId) -> Option<i64>;

    /// Why a parameter has no unit, as far as is known: what scales it is missing, zero, or contradicts
    /// itself. Its SI value is then the raw one.
    fn scale_error(&self, axis: AxisIndex, parameter: ParameterId) -> Option<NoScale>;

    /// Visits the other axes of the line with the profile of this one, without groups.
    fn visit_axes_alike(&self, axis: AxisIndex, visit: &mut dyn FnMut(AxisIndex)) {
        let _ = (axis, visit);
    }

    /// Gives an axis that no request may read, the drives of a group on RS-485, the scales of the
    /// [axes alike](Self::visit_axes_alike), where these agree.
    fn adopt_scales(&mut self, axis: AxisIndex) {
        let _ = axis;
    }
}

/// Verbs, stops, and what became of them.
pub trait AxisCommands {
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

    /// Starts a part of a stop or a quick stop. Its outcome is `Done` only if every step was answered.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn stop(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
        part: StopPart,
    ) -> Result<(), Unsupported>;

    /// Lists the requests that a command would send, step by step, without sending them.
    ///
    /// # Errors
    /// [`Unsupported`], the same as from the command itself.
    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported>;

    /// The test of the last wait step that timed out.
    fn unmet_wait(&self, axis: AxisIndex) -> Option<UnmetWait>;

    /// Report of the last motion: of a group, that of the n-th drive that answered.
    fn motion_report(&self, axis: AxisIndex, n: usize) -> Option<MotionReport>;

    /// Tolerances of positions and speeds of the axis, as far as its units are known.
    fn tolerance(&self, axis: AxisIndex) -> Option<Tolerance>;
}

/// Requests in the protocol's own text and bytes.
pub trait AxisText {
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

    /// Shows what [`send_text`](super::AxisText::send_text) would send, without sending it.
    ///
    /// # Errors
    /// [`Unsupported::BadText`] when the text is not valid in the protocol.
    fn rehearse_text(
        &self,
        axis: AxisIndex,
        text: &str,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<TextRehearsal, Unsupported>;

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
    ) -> Result<(), Unsupported>;
}

/// Parameters of any length: text and bytes.
pub trait AxisData {
    /// Reads a parameter of any length, text or bytes: see [`poll_bytes`](Self::poll_bytes).
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn read_data(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        block: bool,
        max: u16,
    ) -> Result<(), Unsupported>;

    /// Writes a parameter of any length, text or bytes, `size` of them: see
    /// [`feed_bytes`](Self::feed_bytes).
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn write_data(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        size: u32,
        block: bool,
    ) -> Result<(), Unsupported>;

    /// Reads bytes of a long value that the protocol's own request under `ticket` is reading, and returns how
    /// many; see [`send_text`](super::AxisText::send_text). The drive continues as the bytes are read; the request ends
    /// with the last one. `None` when there is no such request, or it has not started.
    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize>;

    /// Feeds bytes of a long value that the protocol's own request under `ticket` is writing, and returns
    /// how many were taken. `None` when there is no such request, or it has not started.
    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize>;
}

/// Motions that are streamed point by point, or cycle by cycle.
pub trait AxisPaths {
    /// Starts a path that is streamed point by point from the present position; see
    /// [`feed_points`](Self::feed_points). Its outcome under `ticket` has the number of points, when all
    /// points are used.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn start_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported>;

    /// Feeds points to the path of `ticket`, as many as there is room for, and returns how many were taken.
    /// `complete` marks the last of them as the end of the path; its velocity should be zero. `None` when
    /// that path has ended.
    fn feed_points(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize>;

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
    ) -> Result<(), Unsupported>;

    /// Feeds set-points in SI units for the next cycles: the set-points of one cycle side by side, in the
    /// order of the axes. Takes as many whole cycles as there is room for, and returns how many. `complete`
    /// marks the last one as the end of the motion; it must be at rest. `None` when there is no such
    /// motion.
    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize>;

    /// Statistics of the present or the last cyclic motion of an axis.
    fn cycle_statistics(&self, axis: AxisIndex) -> Option<&CycleStatistics>;

    /// Longest time that one cycle of these axes occupies their wire, ns; zero without timing.
    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64>;
}

/// Programs in the memory of drives.
pub trait AxisPrograms {
    /// The rules of the program memory of an axis; `None` where it takes no programs.
    fn memory_rules(&self, axis: AxisIndex) -> Option<&'static MemoryRules>;

    /// Writes, verifies or reads words of an axis' memory. Its outcome under `ticket` has the number of
    /// words; [`last_transfer`](Self::last_transfer) has the details. Nothing is written while the axis
    /// has power or its program runs. Until it ends, commands that would power the axis are refused.
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
    ) -> Result<(), Unsupported>;

    /// The axis' transfer that is under way, or its last one.
    fn last_transfer(&self, axis: AxisIndex) -> Option<&MemoryTransfer>;

    /// Sends a program command to an axis. A command that could move the motor needs an armed axis. A
    /// command that ends a program has the priority of a stop.
    ///
    /// # Errors
    /// [`Unsupported`]: nothing is sent.
    fn send_program_command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: ProgramCommand,
    ) -> Result<(), Unsupported>;
}

/// The wire that axes share: counters, events, and loans.
pub trait AxisTraffic {
    /// Counters of the wire so far.
    fn counters(&self) -> Counters;

    /// Counts of frames received during the last request of that axis that timed out.
    fn silence_counters(&self, axis: AxisIndex) -> Counters;

    /// Starts or ends the recording of events for [`poll_axis_event`](Self::poll_axis_event). States that
    /// exist when recording starts are not reported as events.
    fn enable_events(&mut self, on: bool);

    /// Returns the next event while [`enable_events`](Self::enable_events) is on: messages that drives sent
    /// by themselves, faults, and the loss of arming. `now` is the time of events that have none of their
    /// own.
    fn poll_axis_event(&mut self, now: Instant) -> Option<AxisEvent>;

    /// Returns whether the host sends by itself to keep drives alive or synchronised. The wire cannot be lent then.
    fn sends_keepalive(&self) -> bool;

    /// Ends a loan of the wire: the silent time before the next frame starts anew.
    fn handle_resume(&mut self, now: Instant);
}

/// Axes as the upper layers use them. Protocol, family and medium are erased.
pub trait Axes:
    AxisDirectory
    + AxisRequests
    + AxisScales
    + AxisCommands
    + AxisText
    + AxisData
    + AxisPaths
    + AxisPrograms
    + AxisTraffic
{
}

impl<T> Axes for T where
    T: AxisDirectory
        + AxisRequests
        + AxisScales
        + AxisCommands
        + AxisText
        + AxisData
        + AxisPaths
        + AxisPrograms
        + AxisTraffic
{
}

/// A lane with its host erased: what connections and simulated worlds hold.
pub trait AnyLane<M: crate::medium::Medium>: Axes + crate::station::Station<M> + Send {}

impl<M: crate::medium::Medium, T: Axes + crate::station::Station<M> + Send> AnyLane<M> for T {}
