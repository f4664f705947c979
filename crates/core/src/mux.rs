//! Several lanes on one CAN wire: every frame is offered to each, stops of any go first.
//!
//! A lane takes what its protocol's identifiers say is meant for it; which identifiers are whose is
//! settled before the lanes are made. All storage is made when the mux is made.
//!
//! Why: BUS-3.

use alloc::boxed::Box;
use alloc::vec::Vec;

use crate::axis::{AnyLane, Axes, Command, News, Part, Rehearsed, State, StopPart};
use crate::error::{Outcome, Unsupported};
use crate::explain::Raw;
use crate::lane::{Piece, Transfer, TransferKind};
use crate::medium::{Can, CanLine, Frame};
use crate::profile::{ParameterId, Profile, Readdress};
use crate::program::{MemoryRules, Order};
use crate::station::{AxisIndex, Counters, LineEvent, Station, Ticket, Timed};
use crate::stream::cyclic::{Account, Following};
use crate::stream::{PathKind, Point};
use crate::time::{Instant, earliest};

#[cfg(test)]
mod tests;

const APART: &str = "axes that follow one beat must be of one protocol, on one wire";

/// A lane whose host and drivers are erased.
pub type BoxedLane = Box<dyn AnyLane<Can>>;

/// Several lanes that share a CAN wire, as one set of axes: those of the first lane come first, and
/// those that joined later last.
pub struct Mux {
    lanes: Vec<BoxedLane>,
    /// Of each axis its lane, and its place there.
    places: Vec<(usize, AxisIndex)>,
    /// The lane that may send next, so that none starves.
    turn: usize,
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
        let axes: usize = lanes.iter().map(|lane| lane.axes()).sum();
        let agreed = lanes.iter().all(|lane| lane.line() == line);
        if !agreed || axes > 256 {
            return None;
        }
        let of = |(n, lane): (usize, &BoxedLane)| {
            (0..=u8::MAX).map(AxisIndex).take(lane.axes()).map(move |axis| (n, axis))
        };
        let places = lanes.iter().enumerate().flat_map(of).collect();
        Some(Self { lanes, places, turn: 0 })
    }

    /// The lane of an axis, and the axis' place in it.
    fn place(&self, axis: AxisIndex) -> Option<(usize, AxisIndex)> {
        self.places.get(usize::from(axis.0)).copied()
    }

    /// The lane that all these axes are in, and their places in it.
    fn places(&self, axes: &[AxisIndex]) -> Option<(usize, Vec<AxisIndex>)> {
        let all: Vec<_> = axes.iter().map(|axis| self.place(*axis)).collect::<Option<_>>()?;
        let (first, _) = *all.first()?;
        let together = all.iter().all(|(n, _)| *n == first);
        together.then(|| (first, all.into_iter().map(|(_, axis)| axis).collect()))
    }

    fn of(&self, axis: AxisIndex) -> Option<(&dyn AnyLane<Can>, AxisIndex)> {
        let (n, axis) = self.place(axis)?;
        Some((&*self.lanes[n], axis))
    }

    fn of_mut(
        &mut self,
        axis: AxisIndex,
    ) -> Result<(&mut dyn AnyLane<Can>, AxisIndex), Unsupported> {
        let (n, axis) = self.place(axis).ok_or(Unsupported::NoSuchAxis)?;
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
        self.lanes.iter_mut().for_each(|lane| lane.handle_input(now, frame));
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.lanes.iter_mut().for_each(|lane| lane.handle_line(now, event));
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        for step in 0..self.lanes.len() {
            let n = (self.turn + step) % self.lanes.len();
            if let Some(len) = self.lanes[n].poll_transmit(now, out) {
                self.turn = n + 1;
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

impl Axes for Mux {
    fn axes(&self) -> usize {
        self.places.len()
    }

    fn address(&self, axis: AxisIndex) -> Option<u32> {
        let (lane, axis) = self.of(axis)?;
        lane.address(axis)
    }

    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile> {
        let (lane, axis) = self.of(axis)?;
        lane.profile(axis)
    }

    fn is_confirmed(&self, axis: AxisIndex) -> bool {
        self.of(axis).is_none_or(|(lane, axis)| lane.is_confirmed(axis))
    }

    fn state(&self, axis: AxisIndex) -> Option<&State> {
        let (lane, axis) = self.of(axis)?;
        lane.state(axis)
    }

    fn arm(&mut self, axis: AxisIndex, armed: bool) {
        if let Ok((lane, axis)) = self.of_mut(axis) {
            lane.arm(axis, armed);
        }
    }

    fn command(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.command(now, ticket, axis, command)
    }

    fn stop(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        part: StopPart,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.stop(now, ticket, axis, part)
    }

    fn send_once(&mut self, ticket: Ticket) {
        self.lanes.iter_mut().for_each(|lane| lane.send_once(ticket));
    }

    fn read(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.read(now, ticket, axis, parameter)
    }

    fn write(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.write(now, ticket, axis, parameter, raw, keep)
    }

    fn raw(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.raw(now, ticket, axis, text)
    }

    fn raw_frame(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        frame: &Raw<'_>,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.raw_frame(now, ticket, axis, frame)
    }

    fn stream(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: PathKind,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.stream(now, ticket, axis, kind)
    }

    fn feed(&mut self, ticket: Ticket, points: &[Point], complete: bool) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.feed(ticket, points, complete))
    }

    fn follow(
        &mut self,
        now: Instant,
        ticket: Ticket,
        following: &Following<'_>,
    ) -> Result<(), Unsupported> {
        let (n, axes) = self.places(following.axes).ok_or(Unsupported::Forbidden(APART))?;
        self.lanes[n].follow(now, ticket, &Following { axes: &axes, ..*following })
    }

    fn feed_cycles(&mut self, ticket: Ticket, setpoints: &[f64], complete: bool) -> Option<usize> {
        self.lanes.iter_mut().find_map(|lane| lane.feed_cycles(ticket, setpoints, complete))
    }

    fn account(&self, axis: AxisIndex) -> Option<&Account> {
        let (lane, axis) = self.of(axis)?;
        lane.account(axis)
    }

    fn cycle_ns(&self, axes: &[AxisIndex]) -> Option<u64> {
        let (n, axes) = self.places(axes)?;
        self.lanes[n].cycle_ns(&axes)
    }

    fn memory(&self, axis: AxisIndex) -> Option<&'static MemoryRules> {
        let (lane, axis) = self.of(axis)?;
        lane.memory(axis)
    }

    fn transfer(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        kind: TransferKind,
        pieces: &[Piece],
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.transfer(now, ticket, axis, kind, pieces)
    }

    fn transferred(&self, axis: AxisIndex) -> Option<&Transfer> {
        let (lane, axis) = self.of(axis)?;
        lane.transferred(axis)
    }

    fn order(
        &mut self,
        now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        order: Order,
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of_mut(axis)?;
        lane.order(now, ticket, axis, order)
    }

    fn poll_part(&mut self, ticket: Ticket) -> Option<Part> {
        self.lanes.iter_mut().find_map(|lane| lane.poll_part(ticket))
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        self.lanes.iter_mut().find_map(|lane| lane.poll_outcome())
    }

    fn readdresses(
        &self,
        axis: AxisIndex,
        parameter: ParameterId,
        raw: i64,
    ) -> Result<Option<Readdress>, Unsupported> {
        let (lane, axis) = self.of(axis).ok_or(Unsupported::NoSuchAxis)?;
        lane.readdresses(axis, parameter, raw)
    }

    fn unlearnt(&self, axis: AxisIndex, n: usize) -> Option<ParameterId> {
        let (lane, axis) = self.of(axis)?;
        lane.unlearnt(axis, n)
    }

    fn listen(&mut self, on: bool) {
        self.lanes.iter_mut().for_each(|lane| lane.listen(on));
    }

    fn poll_news(&mut self, now: Instant) -> Option<News> {
        let first = |(n, lane): (usize, &mut BoxedLane)| Some((n, lane.poll_news(now)?));
        let (n, news) = self.lanes.iter_mut().enumerate().find_map(first)?;
        let place = self.places.iter().position(|place| *place == (n, news.axis))?;
        Some(News { axis: AxisIndex(place as u8), ..news })
    }

    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(Rehearsed<'_>),
    ) -> Result<(), Unsupported> {
        let (lane, axis) = self.of(axis).ok_or(Unsupported::NoSuchAxis)?;
        lane.rehearse(axis, command, show)
    }

    fn lacks(&self, axis: AxisIndex, parameter: ParameterId) -> bool {
        self.of(axis).is_some_and(|(lane, axis)| lane.lacks(axis, parameter))
    }

    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64> {
        let (lane, axis) = self.of(axis)?;
        lane.to_si(axis, parameter, raw)
    }

    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64> {
        let (lane, axis) = self.of(axis)?;
        lane.to_raw(axis, parameter, si)
    }

    fn counters(&self) -> Counters {
        self.lanes.iter().map(|lane| lane.counters()).fold(Counters::default(), Counters::plus)
    }

    fn heard(&self, axis: AxisIndex) -> Counters {
        self.of(axis).map_or(Counters::default(), |(lane, axis)| lane.heard(axis))
    }

    fn join(&mut self, lane: usize, profile: &'static Profile, address: u32) -> Option<AxisIndex> {
        let axis = AxisIndex(u8::try_from(self.places.len()).ok()?);
        let own = self.lanes.get_mut(lane)?.join(0, profile, address)?;
        self.places.push((lane, own));
        Some(axis)
    }

    fn may_join(&self, lane: usize, address: u32) -> bool {
        self.lanes.get(lane).is_some_and(|lane| lane.may_join(0, address))
    }

    fn keeps_alive(&self) -> bool {
        self.lanes.iter().any(|lane| lane.keeps_alive())
    }

    fn disturbed(&mut self, now: Instant) {
        self.lanes.iter_mut().for_each(|lane| lane.disturbed(now));
    }
}
