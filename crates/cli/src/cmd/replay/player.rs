//! Replays frames to one wire: sends each at its time, and receives meanwhile.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use polepair::frame_bits;
use polepair::wire::AnyLink;
use polepair_core::convert::saturating;
use polepair_core::explain::{Direction, Dissector, FrameBoundary, Impact, RawFrame};
use polepair_core::medium::{Frame, Medium, SerialLine};
use polepair_core::stream::cyclic::DurationHistogram;
use polepair_core::time::Instant;
use polepair_link::{Cause, LinkError, LinkIo, Received, clock};

use super::feed::FrameBatches;
use super::selector::ReplayFrame;
use crate::interrupt;
use crate::tap_queue::UnitBuf;

/// Time from the beginning of a replay to its first frame, ms.
const LEAD_MS: u32 = 20;
/// Time of listening after the last frame, ms.
const LINGER_MS: u32 = 200;
/// Longest time in which a wire accepts nothing.
const STALL_MAX: Duration = Duration::from_secs(1);
/// Interval of checking for the end during a wait, ms: a lost wire ends the others too.
const POLL_MS: u32 = 50;
/// Units that are read between two late frames.
const LATE_UNITS_MAX: usize = 64;

/// Pace of a replay.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum ReplayPace {
    /// Factor of the recorded speed.
    Recorded(f64),
    /// Each frame as soon as the one before is through and answered, but no later than recorded.
    Fast,
}

/// Result of a replay.
#[derive(Debug, Default)]
pub struct ReplayResult {
    pub sent: u64,
    pub received: u64,
    /// Delays of frames, against the recorded times.
    pub lateness: DurationHistogram,
    /// Axes that received frames which may move them, and whether such a frame had an unknown receiver.
    pub moved_axes: BTreeSet<u32>,
    pub moved_unknown: bool,
    /// Frames that the link has no form for, and the first reason.
    pub unsent: u64,
    pub trouble: Option<LinkError>,
    /// The link is gone, or takes nothing.
    pub ended_by: Option<LinkError>,
}

/// State shared by all wires of a replay.
#[derive(Clone)]
pub struct ReplayControl {
    pub pace: ReplayPace,
    /// True once all wires must end.
    pub halt: Arc<AtomicBool>,
}

impl ReplayControl {
    fn is_over(&self) -> bool {
        self.halt.load(Ordering::Relaxed) || interrupt::was_interrupted()
    }

    /// Plays a wire until its frames, or patience, end. `rate` is its bits a second, if it has such.
    pub fn play_wire(&self, link: AnyLink, rate: Option<u32>, items: FrameBatches) -> ReplayResult {
        match link {
            AnyLink::Serial(link) => WirePlayer::new(self, link, rate).run(items),
            AnyLink::Can(link) => WirePlayer::new(self, link, rate).run(items),
        }
    }
}

/// Units of a medium for a player.
trait ReplayMedium: Medium {
    fn from_unit(unit: &UnitBuf) -> Option<&Self::Unit>;
    /// Time of a unit on a wire of that rate, ns.
    fn duration_ns(unit: &Self::Unit, rate: u32) -> u64;
    /// Takes received bytes; returns whether they complete a reply.
    fn completes_answer(
        by: &dyn Dissector,
        received: &Self::Unit,
        request: &Self::Unit,
        so_far: &mut Vec<u8>,
    ) -> bool;
}

impl ReplayMedium for polepair_core::medium::Stream {
    fn from_unit(unit: &UnitBuf) -> Option<&[u8]> {
        match unit {
            UnitBuf::Bytes(bytes) => Some(bytes),
            UnitBuf::Frame(_) => None,
        }
    }

    fn duration_ns(unit: &[u8], rate: u32) -> u64 {
        SerialLine::new_8n1(rate).characters_ns(saturating(unit.len()))
    }

    fn completes_answer(
        by: &dyn Dissector,
        received: &[u8],
        _: &[u8],
        so_far: &mut Vec<u8>,
    ) -> bool {
        so_far.extend_from_slice(received);
        loop {
            match by.find_frame(so_far, Some(Direction::ToHost), false) {
                FrameBoundary::Frame(_) | FrameBoundary::Corrupt(_) => return true,
                FrameBoundary::Skip(count) if (1..=so_far.len()).contains(&count) => {
                    so_far.drain(..count);
                }
                FrameBoundary::Skip(_) | FrameBoundary::Incomplete => return false,
            }
        }
    }
}

impl ReplayMedium for polepair_core::medium::Can {
    fn from_unit(unit: &UnitBuf) -> Option<&Frame> {
        match unit {
            UnitBuf::Frame(frame) => Some(frame),
            UnitBuf::Bytes(_) => None,
        }
    }

    fn duration_ns(frame: &Frame, rate: u32) -> u64 {
        u64::from(frame_bits(frame)) * 1_000_000_000 / u64::from(rate.max(1))
    }

    fn completes_answer(
        by: &dyn Dissector,
        received: &Frame,
        request: &Frame,
        _: &mut Vec<u8>,
    ) -> bool {
        by.is_answer_to(&raw_frame(received), &raw_frame(request))
    }
}

fn raw_frame(frame: &Frame) -> RawFrame<'_> {
    RawFrame { bytes: Frame::bytes(frame), id: Some(frame.id), extended: frame.extended }
}

struct WirePlayer<'a, M: ReplayMedium> {
    control: &'a ReplayControl,
    link: Box<dyn LinkIo<M>>,
    rate: Option<u32>,
    buffer: M::Buffer,
    result: ReplayResult,
}

/// Reason why the replay of a wire ends.
enum PlayEnd {
    Halted,
    LinkGone(LinkError),
}

impl From<LinkError> for PlayEnd {
    fn from(error: LinkError) -> Self {
        Self::LinkGone(error)
    }
}

impl<'a, M: ReplayMedium> WirePlayer<'a, M> {
    fn new(control: &'a ReplayControl, link: Box<dyn LinkIo<M>>, rate: Option<u32>) -> Self {
        Self { control, link, rate, buffer: M::buffer(), result: ReplayResult::default() }
    }

    fn run(mut self, items: FrameBatches) -> ReplayResult {
        match self.play_all(items) {
            Ok(()) | Err(PlayEnd::Halted) => {}
            Err(PlayEnd::LinkGone(error)) => {
                // The other wires end as well: half of a replay is another sequence of commands.
                self.control.halt.store(true, Ordering::Relaxed);
                self.result.ended_by = Some(error);
            }
        }
        self.result
    }

    fn play_all(&mut self, items: FrameBatches) -> Result<(), PlayEnd> {
        let begin = self.link.now().plus_ms(LEAD_MS);
        // When the last one went out, its moment in the capture, and it itself.
        let mut before: Option<(Instant, ReplayFrame)> = None;
        for item in items.iter().flatten() {
            let due = match (self.control.pace, before.take()) {
                (ReplayPace::Recorded(speed), _) => begin.plus_ns((item.at as f64 / speed) as u64),
                (ReplayPace::Fast, None) => begin,
                (ReplayPace::Fast, Some((sent, last))) => {
                    self.wait_through(sent, &last, item.at)?
                }
            };
            // Received while it waits: a full buffer of the adapter would lose replies.
            self.receive_until(due)?;
            let Some(unit) = M::from_unit(&item.unit) else { continue };
            self.send(unit)?;
            let now = self.link.now();
            if let ReplayPace::Recorded(_) = self.control.pace {
                self.result.lateness.record(now.since(due).as_nanos() as u64);
            }
            // Counted when it was sent, not when it was read: what was not sent moved nothing.
            self.count_moved(&item);
            before = Some((now, item));
        }
        let end = self.link.now().plus_ms(LINGER_MS);
        self.receive_until(end)
    }

    fn count_moved(&mut self, item: &ReplayFrame) {
        if item.effect.impact >= Impact::Motion {
            // A missing number, or 0, means all axes.
            let axis = item.axis.filter(|axis| *axis > 0);
            self.result.moved_unknown |= axis.is_none();
            self.result.moved_axes.extend(axis);
        }
    }

    /// Waits until the last frame is through the wire and answered, but no longer than was waited
    /// when it was recorded. When the next one may go.
    fn wait_through(
        &mut self,
        sent: Instant,
        last: &ReplayFrame,
        next: u64,
    ) -> Result<Instant, PlayEnd> {
        let Some(unit) = M::from_unit(&last.unit) else { return Ok(sent) };
        // The link takes a frame sooner than the wire has carried it.
        let through = sent.plus_ns(self.rate.map_or(0, |rate| M::duration_ns(unit, rate)));
        let latest = sent.plus_ns(next.saturating_sub(last.at)).max(through);
        let Some(by) = last.answer_dissector else { return Ok(through) };
        let mut so_far = Vec::new();
        loop {
            match self.receive(latest)? {
                None => return Ok(latest),
                Some(len) => {
                    let received = M::unit(std::borrow::Borrow::borrow(&self.buffer), len);
                    if M::completes_answer(by, received, unit, &mut so_far) {
                        return Ok(through);
                    }
                }
            }
        }
    }

    /// Receives units until then.
    fn receive_until(&mut self, until: Instant) -> Result<(), PlayEnd> {
        let mut late = 0;
        while self.receive(until)?.is_some() && late < LATE_UNITS_MAX {
            late += usize::from(self.link.now() >= until);
        }
        Ok(())
    }

    /// Length of the received unit; `None` at `until`.
    fn receive(&mut self, until: Instant) -> Result<Option<usize>, PlayEnd> {
        loop {
            if self.control.is_over() {
                return Err(PlayEnd::Halted);
            }
            let scan = until.min(self.link.now().plus_ms(POLL_MS));
            match self.link.receive(std::borrow::BorrowMut::borrow_mut(&mut self.buffer), scan)? {
                Received::Bytes { len, .. } => {
                    self.result.received += 1;
                    return Ok(Some(len));
                }
                Received::TimedOut if scan == until => return Ok(None),
                Received::TimedOut | Received::Line { .. } | Received::Woken => {}
            }
        }
    }

    /// Sends, however long that takes the wire; a unit that the link cannot carry is counted.
    fn send(&mut self, unit: &M::Unit) -> Result<(), PlayEnd> {
        let give_up = self.link.now() + clock::scale_timeout(STALL_MAX);
        self.link.wait_writable(give_up)?;
        loop {
            match self.link.send(unit) {
                Ok(()) => {
                    self.result.sent += 1;
                    return Ok(());
                }
                Err(error) if error.cause() == Cause::Unsuitable => {
                    self.result.unsent += 1;
                    self.result.trouble.get_or_insert(error);
                    return Ok(());
                }
                // A frame was not sent at all. Of bytes a part may have been.
                Err(error)
                    if error.cause() == Cause::Stalled
                        && M::KIND == polepair_core::medium::MediumKind::Can
                        && self.link.now() < give_up
                        && !self.control.is_over() => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
}
