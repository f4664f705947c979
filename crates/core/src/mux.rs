//! Several lanes on one CAN wire: every frame is offered to each, and stops of any lane are sent first.
//!
//! A lane accepts frames with the identifiers of its protocol. The assignment of identifiers is decided
//! before the lanes are made. All memory is allocated when the mux is made.
//!
//! Why: BUS-3.

use alloc::boxed::Box;
use alloc::vec::Vec;

use crate::axis::Refusal;
use crate::axis::{
    AnyLane, AxisCommands, AxisData, AxisDirectory, AxisEvent, AxisPaths, AxisPrograms,
    AxisRequests, AxisScales, AxisStatus, AxisText, AxisTraffic, Command, GroupAnswer,
    MotionReport, RehearsalStep, StopPart, TextRehearsal, UnmetWait,
};
use crate::error::{Outcome, Unsupported};
use crate::explain::RawFrame;
use crate::judge::Tolerance;
use crate::medium::{Can, CanLine, Frame};
use crate::profile::{AddressRole, NoScale, Parameter, ParameterId, Profile};
use crate::program::{MemoryBlock, MemoryRules, MemoryTransfer, ProgramCommand, TransferKind};
use crate::station::{AxisIndex, Counters, LineEvent, Station, Ticket, Timed};
use crate::stream::cyclic::{CycleStatistics, CyclicConfig};
use crate::stream::{PathKind, Point};
use crate::time::{Instant, earliest};

const DIFFERENT_WIRES: &str = "axes that follow one beat must be of one protocol, on one wire";

/// A lane with its host and driver types erased.
pub type BoxedLane = Box<dyn AnyLane<Can>>;

/// Several lanes that share a CAN wire, as one set of axes: those of the first lane come first, and
/// those that joined later last.
pub struct Mux {
    lanes: Vec<BoxedLane>,
    /// Lane and index of each axis.
    locations: Vec<(usize, AxisIndex)>,
    /// The lane that may send next, so that none starves.
    next_lane: usize,
}

impl core::fmt::Debug for Mux {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Mux").field("lanes", &self.lanes.len()).finish_non_exhaustive()
    }
}

impl Mux {
    /// The lanes of one wire. `None` without a lane, when they do not agree on the bit rate, or
    /// when they have more axes than an [`AxisIndex`] can name.
    pub fn new(lanes: impl IntoIterator<Item = BoxedLane>) -> Option<Self> {
        let lanes: Vec<BoxedLane> = lanes.into_iter().collect();
        let line = lanes.first()?.line();
        let axes: usize = lanes.iter().map(|lane| lane.axis_count()).sum();
        let agreed = lanes.iter().all(|lane| lane.line() == line);
        // An axis has a number of eight bits on its connection.
        if !agreed || axes > 256 {
            return None;
        }
        let places = lanes
            .iter()
            .enumerate()
            .flat_map(|(n, lane)| {
                (0..=u8::MAX).map(AxisIndex).take(lane.axis_count()).map(move |axis| (n, axis))
            })
            .collect();
        Some(Self { lanes, locations: places, next_lane: 0 })
    }

    /// The lane of an axis, and the axis' place in it.
    fn locate(&self, axis: AxisIndex) -> Option<(usize, AxisIndex)> {
        self.locations.get(usize::from(axis.0)).copied()
    }

    /// The lane that all these axes are in, and their places in it.
    fn locate_all(&self, axes: &[AxisIndex]) -> Option<(usize, Vec<AxisIndex>)> {
        let all: Vec<_> = axes.iter().map(|axis| self.locate(*axis)).collect::<Option<_>>()?;
        let (first, _) = *all.first()?;
        let together = all.iter().all(|(n, _)| *n == first);
        together.then(|| (first, all.into_iter().map(|(_, axis)| axis).collect()))
    }

    fn lane_of(&self, axis: AxisIndex) -> Option<(&dyn AnyLane<Can>, AxisIndex)> {
        let (n, axis) = self.locate(axis)?;
        Some((&*self.lanes[n], axis))
    }

    fn lane_of_mut(
        &mut self,
        axis: AxisIndex,
    ) -> Result<(&mut dyn AnyLane<Can>, AxisIndex), Unsupported> {
        let (n, axis) = self.locate(axis).ok_or(Unsupported::NoSuchAxis)?;
        Ok((&mut *self.lanes[n], axis))
    }
}

impl Timed for Mux {
    fn handle_timeout(&mut self, now: Instant) {
        for lane in &mut self.lanes {
            if lane.poll_timeout().is_some_and(|due| due <= now) {
                lane.handle_timeout(now);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.lanes.iter().map(|lane| lane.poll_timeout()).fold(None, earliest)
    }
}

impl Station<Can> for Mux {
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        // All of them: identifiers of several protocols overlap, and each lane decides for itself.
        self.lanes.iter_mut().for_each(|lane| lane.handle_input(now, frame));
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.lanes.iter_mut().for_each(|lane| lane.handle_line(now, event));
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        for step in 0..self.lanes.len() {
            let n = (self.next_lane + step) % self.lanes.len();
            if let Some(len) = self.lanes[n].poll_transmit(now, out) {
                // In turns: a busy lane must not keep the others from the bus.
                self.next_lane = n + 1;
                return Some(len);
            }
        }
        None
    }

    fn line(&self) -> CanLine {
        // A mux is never without a lane.
        self.lanes.first().map_or(CanLine { bit_rate: 0 }, |lane| lane.line())
    }
}

impl AxisDirectory for Mux {
    fn axis_count(&self) -> usize {
        self.locations.len()
    }

    fn address(&self, axis: AxisIndex) -> Option<u32> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.address(axis)
    }

    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.profile(axis)
    }

    fn state(&self, axis: AxisIndex) -> Option<&AxisStatus> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.state(axis)
    }

    fn parameter(&self, axis: AxisIndex, id: ParameterId) -> Option<&'static Parameter> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.parameter(axis, id)
    }

    fn add_parameter(
        &mut self,
        axis: AxisIndex,
        parameter: &'static Parameter,
    ) -> Option<ParameterId> {
        let (lane, axis) = self.lane_of_mut(axis).ok()?;
        lane.add_parameter(axis, parameter)
    }

    fn is_confirmed(&self, axis: AxisIndex) -> bool {
        self.lane_of(axis).is_none_or(|(lane, axis)| lane.is_confirmed(axis))
    }

    fn refusal(&self, axis: AxisIndex, code: u32) -> Refusal {
        self.lane_of(axis).map_or(Refusal::Final, |(lane, axis)| lane.refusal(axis, code))
    }

    fn lacks_parameter(&self, axis: AxisIndex, parameter: ParameterId) -> bool {
        self.lane_of(axis).is_some_and(|(lane, axis)| lane.lacks_parameter(axis, parameter))
    }

    fn add_axis(
        &mut self,
        lane: usize,
        profile: &'static Profile,
        address: u32,
    ) -> Option<AxisIndex> {
        let axis = AxisIndex(u8::try_from(self.locations.len()).ok()?);
        let own = self.lanes.get_mut(lane)?.add_axis(0, profile, address)?;
        self.locations.push((lane, own));
        Some(axis)
    }

    fn can_add_axis(&self, lane: usize, address: u32) -> bool {
        self.lanes.get(lane).is_some_and(|lane| lane.can_add_axis(0, address))
    }
}

impl AxisRequests for Mux {
    fn read_parameter(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.read_parameter(now, ticket, axis, parameter)
    }

    fn write_parameter(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.write_parameter(now, ticket, axis, parameter, raw, keep)
    }

    fn address_change(
        &self,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported> {
        let (lane, axis) = self.lane_of(axis).ok_or(Unsupported::NoSuchAxis)?;
        lane.address_change(axis, parameter, raw)
    }

    fn unread_prerequisite(&self, axis: AxisIndex, n: usize) -> Option<ParameterId> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.unread_prerequisite(axis, n)
    }

    fn report_setting(
        &self,
        axis: AxisIndex,
        parameters: &[ParameterId],
        interval_ms: u16,
    ) -> Option<(ParameterId, i64)> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.report_setting(axis, parameters, interval_ms)
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.lanes.iter_mut().for_each(|lane| lane.disable_retries(ticket));
    }

    fn poll_group_answer(&mut self, ticket: Ticket) -> Option<GroupAnswer> {
        self.lanes.iter_mut().find_map(|lane| lane.poll_group_answer(ticket))
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        self.lanes.iter_mut().find_map(|lane| lane.poll_outcome())
    }
}

impl AxisScales for Mux {
    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.to_si(axis, parameter, raw)
    }

    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.to_raw(axis, parameter, si)
    }

    fn scale_input(&self, axis: AxisIndex, parameter: ParameterId) -> Option<i64> {
        self.lane_of(axis).and_then(|(lane, axis)| lane.scale_input(axis, parameter))
    }

    fn scale_error(&self, axis: AxisIndex, parameter: ParameterId) -> Option<NoScale> {
        self.lane_of(axis).and_then(|(lane, axis)| lane.scale_error(axis, parameter))
    }

    fn visit_axes_alike(&self, axis: AxisIndex, visit: &mut dyn FnMut(AxisIndex)) {
        let Some((n, local)) = self.locate(axis) else { return };
        self.lanes[n].visit_axes_alike(local, &mut |alike| {
            let place = self.locations.iter().position(|location| *location == (n, alike));
            if let Some(index) = place.and_then(|at| u8::try_from(at).ok()) {
                visit(AxisIndex(index));
            }
        });
    }

    fn adopt_scales(&mut self, axis: AxisIndex) {
        if let Ok((lane, axis)) = self.lane_of_mut(axis) {
            lane.adopt_scales(axis);
        }
    }
}

impl AxisCommands for Mux {
    fn set_armed(&mut self, axis: AxisIndex, armed: bool) {
        if let Ok((lane, axis)) = self.lane_of_mut(axis) {
            lane.set_armed(axis, armed);
        }
    }

    fn command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.command(now, ticket, axis, command)
    }

    fn stop(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
        part: StopPart,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.stop(now, ticket, axis, command, part)
    }

    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of(axis).ok_or(Unsupported::NoSuchAxis)?;
        lane.rehearse(axis, command, show)
    }

    fn unmet_wait(&self, axis: AxisIndex) -> Option<UnmetWait> {
        self.lane_of(axis).and_then(|(lane, axis)| lane.unmet_wait(axis))
    }

    fn motion_report(&self, axis: AxisIndex, n: usize) -> Option<MotionReport> {
        self.lane_of(axis).and_then(|(lane, axis)| lane.motion_report(axis, n))
    }

    fn tolerance(&self, axis: AxisIndex) -> Option<Tolerance> {
        self.lane_of(axis).and_then(|(lane, axis)| lane.tolerance(axis))
    }
}

impl AxisText for Mux {
    fn send_text(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.send_text(now, ticket, axis, text)
    }

    fn rehearse_text(
        &self,
        axis: AxisIndex,
        text: &str,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<TextRehearsal, Unsupported> {
        let (lane, axis) = self.lane_of(axis).ok_or(Unsupported::NoSuchAxis)?;
        lane.rehearse_text(axis, text, show)
    }

    fn send_frame(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        frame: &RawFrame<'_>,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.send_frame(now, ticket, axis, frame)
    }
}

impl AxisData for Mux {
    fn read_data(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        block: bool,
        max: u16,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.read_data(now, ticket, axis, parameter, block, max)
    }

    fn write_data(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        size: u32,
        block: bool,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.write_data(now, ticket, axis, parameter, size, block)
    }

    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.poll_bytes(ticket, out))
    }

    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.feed_bytes(ticket, bytes))
    }
}

impl AxisPaths for Mux {
    fn start_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.start_path(now, ticket, axis, kind)
    }

    fn feed_points(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.feed_points(ticket, points, complete))
    }

    fn start_cyclic(
        &mut self,
        now: Instant,
        ticket: Ticket,
        following: &CyclicConfig<'_>,
    ) -> Result<(), Unsupported> {
        let (n, axes) =
            self.locate_all(following.axes).ok_or(Unsupported::Forbidden(DIFFERENT_WIRES))?;
        self.lanes[n].start_cyclic(now, ticket, &CyclicConfig { axes: &axes, ..*following })
    }

    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.feed_cycles(ticket, setpoints, complete))
    }

    fn cycle_statistics(&self, axis: AxisIndex) -> Option<&CycleStatistics> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.cycle_statistics(axis)
    }

    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64> {
        let (n, axes) = self.locate_all(axes)?;
        self.lanes[n].cycle_ns(&axes)
    }
}

impl AxisPrograms for Mux {
    fn memory_rules(&self, axis: AxisIndex) -> Option<&'static MemoryRules> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.memory_rules(axis)
    }

    fn start_transfer(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: TransferKind,
        pieces: &[MemoryBlock],
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.start_transfer(now, ticket, axis, kind, pieces)
    }

    fn last_transfer(&self, axis: AxisIndex) -> Option<&MemoryTransfer> {
        let (lane, axis) = self.lane_of(axis)?;
        lane.last_transfer(axis)
    }

    fn send_program_command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: ProgramCommand,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.lane_of_mut(axis)?;
        lane.send_program_command(now, ticket, axis, command)
    }
}

impl AxisTraffic for Mux {
    fn counters(&self) -> Counters {
        self.lanes.iter().map(|lane| lane.counters()).fold(Counters::default(), Counters::plus)
    }

    fn silence_counters(&self, axis: AxisIndex) -> Counters {
        self.lane_of(axis).map_or(Counters::default(), |(lane, axis)| lane.silence_counters(axis))
    }

    fn enable_events(&mut self, on: bool) {
        self.lanes.iter_mut().for_each(|lane| lane.enable_events(on));
    }

    fn poll_axis_event(&mut self, now: Instant) -> Option<AxisEvent> {
        let (n, event) = self
            .lanes
            .iter_mut()
            .enumerate()
            .find_map(|(n, lane)| Some((n, lane.poll_axis_event(now)?)))?;
        let index = self.locations.iter().position(|position| *position == (n, event.axis))?;
        Some(AxisEvent { axis: AxisIndex(index as u8), ..event })
    }

    fn sends_keepalive(&self) -> bool {
        self.lanes.iter().any(|lane| lane.sends_keepalive())
    }

    fn handle_resume(&mut self, now: Instant) {
        self.lanes.iter_mut().for_each(|lane| lane.handle_resume(now));
    }
}
