//! The interface of axes for the layers above.

use super::{AxisEvent, AxisStatus, Command, RehearsalStep, StopPart, UnmetWait};
use crate::error::{Outcome, Unsupported};
use crate::explain::RawFrame;
use crate::lane::{MemoryBlock, MemoryTransfer, TransferKind};
use crate::profile::{AddressRole, NoScale, Parameter, ParameterId, Profile};
use crate::program::{MemoryRules, ProgramCommand};
use crate::station::{AxisIndex, Counters, RequestClass, Ticket};
use crate::stream::cyclic::{CycleStatistics, CyclicConfig};
use crate::stream::{PathKind, Point};
use crate::time::Instant;

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

    /// A parameter of an axis: one of its profile, or one that was [added](Self::add_parameter).
    fn parameter(&self, axis: AxisIndex, id: ParameterId) -> Option<&'static Parameter> {
        self.profile(axis)?.parameter(id)
    }

    /// Gives an axis a parameter that its profile does not have, and tells its id; one that it has
    /// already keeps its id. `None` when the axis has too many.
    fn add_parameter(
        &mut self,
        axis: AxisIndex,
        parameter: &'static Parameter,
    ) -> Option<ParameterId> {
        let _ = (axis, parameter);
        None
    }

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
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, parameter, block);
        Err(Unsupported::NoPlan)
    }

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
    ) -> Result<(), Unsupported> {
        let _ = (now, ticket, axis, parameter, size, block);
        Err(Unsupported::NoPlan)
    }

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

    /// Shows what [`send_text`](Self::send_text) would send. Nothing is sent. Tells what the request would
    /// be held to, and whether it [moves bytes](crate::station::Request::moves_bytes).
    ///
    /// # Errors
    /// [`Unsupported::BadText`] when it is no text of the protocol.
    fn rehearse_text(
        &self,
        axis: AxisIndex,
        text: &str,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(RequestClass, bool), Unsupported> {
        let _ = (axis, text, show);
        Err(Unsupported::BadText)
    }

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

    /// The parameter, and its raw value, with which a drive sends these by itself every `interval_ms`;
    /// with none of them, sends nothing more. `None` where it does not send one of them.
    fn report_setting(
        &self,
        axis: AxisIndex,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        let _ = (axis, parameters, interval_ms);
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
