//! A path that is streamed point by point: the next request of its job, and the processing of its reply.
//!
//! Why: MOVE-4.

use alloc::boxed::Box;
use alloc::collections::VecDeque;

use super::execute::JobState;
use super::job::InFlight;
use super::slot::AxisSlot;
use crate::error::{Failure, Outcome, Unsupported};
use crate::station::Request;
use crate::stream::{
    BufferModel, POINTS_MAX, PathKind, PathParameters, PathStatus, PathStep, Point, RawPoint,
};
use crate::time::Instant;
use core::time::Duration;

/// Interval of reading the drive's buffer: seldom enough for a line that points nearly fill, and often enough for
/// clocks that differ by a thousandth.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Time after the last point within which the drive must have finished.
const GRACE: Duration = Duration::from_secs(2);
/// Times a point that was lost on the way is sent again; its number makes that harmless.
const RESENDS_MAX: u8 = 3;
/// Assumed room of a buffer whose drive does not report it.
const ROOM_MIN: i64 = 2;

/// A path under way.
#[derive(Debug)]
pub struct PathStream {
    kind: PathKind,
    parameters: PathParameters,
    points: VecDeque<Point>,
    /// No more points will be fed.
    complete: bool,
    stage: PathStage,
    buffer_model: Box<BufferModel>,
    low_mark: u8,
    /// End of the last sent point, raw.
    end_position: i64,
    /// Time of the next read of the drive's buffer status.
    next_status: Instant,
    /// The drive's counter less ours, once known.
    counter_offset: Option<u32>,
    resends: u8,
    /// Outcome once the drive was stopped.
    failure_outcome: Option<Outcome>,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum PathStage {
    /// Reads the parameters that set the scales and the buffer's size.
    Learn(u8),
    Prepare(u8),
    Fill,
    Run,
    /// A point may be lost: does the drive's counter have it?
    Verify(i64, u64),
    Stop,
}

impl PathStream {
    pub fn new(kind: PathKind, parameters: PathParameters) -> Self {
        Self {
            kind,
            parameters,
            points: VecDeque::with_capacity(POINTS_MAX),
            complete: false,
            stage: PathStage::Learn(0),
            buffer_model: Box::new(BufferModel::new(1, 0)),
            low_mark: 1,
            end_position: 0,
            next_status: Instant::ZERO,
            counter_offset: None,
            resends: 0,
            failure_outcome: None,
        }
    }

    /// Takes as many points as there is room for, and returns how many.
    pub fn feed(&mut self, points: &[Point], complete: bool) -> usize {
        let capacity = POINTS_MAX - self.points.len();
        let consumed = points.len().min(capacity);
        self.points.extend(&points[..consumed]);
        // "The last" holds once the last one is in the queue.
        self.complete |= complete && consumed == points.len();
        consumed
    }

    /// The request that comes next.
    pub fn next_request<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        match self.stage {
            PathStage::Learn(n) => self.learn_request(n, slot),
            PathStage::Prepare(number) => {
                let step = PathStep::Prepare { number, kind: self.kind, low_mark: self.low_mark };
                match slot.driver.paths().and_then(|paths| paths.path_request(step)) {
                    Some(Ok(request)) => Ok((request, InFlight::Send(request.class()))),
                    Some(Err(reason)) => Err(self.fail_unsupported(reason)),
                    None => {
                        self.stage = PathStage::Fill;
                        self.next_request(now, slot)
                    }
                }
            }
            PathStage::Fill => self.fill_request(slot),
            PathStage::Run => self.run_request(now, slot),
            PathStage::Verify(..) => self.status_request(slot),
            PathStage::Stop => self.step_request(slot, PathStep::Stop),
        }
    }

    fn learn_request<R: Request, A: Copy + 'static>(
        &mut self,
        n: u8,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        let PathParameters { position, velocity, time, capacity, .. } = self.parameters;
        let factor = [position, velocity, time].into_iter().find_map(|id| slot.missing_factor(id));
        let (id, in_flight) = match (factor, n) {
            (Some(id), _) => (id, InFlight::Factor(id)),
            (None, 0) => (capacity, InFlight::Read(capacity)),
            (None, _) => (position, InFlight::Read(position)),
        };
        match slot.read_request(id) {
            Ok(request) => Ok((*request, in_flight)),
            Err(reason) => Err(self.fail_unsupported(reason)),
        }
    }

    fn fill_request<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        // The motion begins with a full buffer, so that a pause of the caller does not end it.
        let fed_up = self.complete && self.points.is_empty();
        if self.buffer_model.is_filled() || fed_up && self.buffer_model.sent() > 0 {
            return self.step_request(slot, PathStep::Start);
        }
        if fed_up {
            return Err(JobState::Ended(Outcome::Done(0)));
        }
        if self.points.is_empty() {
            return Err(JobState::NeedsPoints);
        }
        self.point_request(slot)
    }

    fn run_request<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        let may_send = self.buffer_model.next_send_at();
        // A status that is due goes first: it is what notices a lost point.
        if !self.points.is_empty() && now >= may_send && now < self.next_status {
            return self.point_request(slot);
        }
        if now >= self.next_status {
            return self.status_request(slot);
        }
        let until = match (self.points.is_empty(), self.complete) {
            (false, _) => may_send.min(self.next_status),
            (true, _) => self.next_status,
        };
        Err(JobState::Sleeping(until))
    }

    fn status_request<R: Request, A: Copy + 'static>(
        &self,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        let id = self.parameters.status;
        match slot.read_request(id) {
            Ok(request) => Ok((*request, InFlight::Read(id))),
            Err(reason) => Err(JobState::Ended(Outcome::NotDone(Failure::Impossible(reason)))),
        }
    }

    fn step_request<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
        step: PathStep,
    ) -> Result<(R, InFlight), JobState> {
        match slot.driver.paths().and_then(|paths| paths.path_request(step)) {
            Some(Ok(request)) => Ok((request, InFlight::Send(request.class()))),
            Some(Err(reason)) => Err(self.fail_unsupported(reason)),
            None => Err(self.fail_unsupported(Unsupported::NoPlan)),
        }
    }

    /// The next point, as the drive counts it.
    fn point_request<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
    ) -> Result<(R, InFlight), JobState> {
        let Some((raw, _)) = self.raw_point(slot) else {
            return Err(self.fail_unsupported(Unsupported::BadArgument));
        };
        self.step_request(slot, PathStep::Point(self.kind, raw))
    }

    fn raw_point<R: Request, A: Copy + 'static>(
        &self,
        slot: &AxisSlot<R, A>,
    ) -> Option<(RawPoint, u64)> {
        let point = self.points.front()?;
        let PathParameters { position, velocity, time, .. } = self.parameters;
        let raw_time = slot.to_raw(time, point.time)?;
        let raw = RawPoint {
            // From the rounded end of the last point, so that rounding does not add up along the path.
            distance: slot.to_raw(position, point.position)? - self.end_position,
            velocity: slot.to_raw(velocity, point.velocity)?,
            time: raw_time,
            number: self.buffer_model.sent(),
        };
        let time_ns = slot.to_si(time, raw_time)? * 1e9;
        Some((raw, time_ns as u64))
    }

    /// Ends it for a reason of the caller's; the drive comes to rest first if it moves.
    fn fail_unsupported(&mut self, reason: Unsupported) -> JobState {
        self.fail(Failure::Impossible(reason))
    }

    fn fail(&mut self, failure: Failure) -> JobState {
        let outcome = match self.stage {
            PathStage::Learn(_) | PathStage::Prepare(_) | PathStage::Fill => {
                Outcome::NotDone(failure)
            }
            _ => Outcome::Unknown(failure),
        };
        if self.failure_outcome.is_some() || self.stage == PathStage::Stop {
            return JobState::Ended(self.failure_outcome.unwrap_or(outcome));
        }
        if matches!(outcome, Outcome::NotDone(_)) {
            return JobState::Ended(outcome);
        }
        // A drive with points in its buffer moves on without its host: it gets a stop first.
        (self.failure_outcome, self.stage) = (Some(outcome), PathStage::Stop);
        JobState::Ready
    }

    /// Processes a reply.
    pub fn handle_answer<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut AxisSlot<R, A>,
        in_flight: InFlight,
        raw: Result<i64, Failure>,
    ) -> JobState {
        match (self.stage, raw) {
            (PathStage::Stop, _) => {
                JobState::Ended(self.failure_outcome.unwrap_or(Outcome::Done(0)))
            }
            (PathStage::Learn(n), _) => self.handle_learned(n, slot, in_flight, raw),
            (PathStage::Prepare(n), Ok(_)) => {
                self.stage = PathStage::Prepare(n + 1);
                JobState::Ready
            }
            (PathStage::Fill | PathStage::Run, Ok(raw))
                if in_flight == InFlight::Read(self.parameters.status) =>
            {
                self.handle_status(now, slot, raw)
            }
            (PathStage::Fill, Ok(_)) if self.is_starting() => {
                self.buffer_model.start(now);
                self.stage = PathStage::Run;
                JobState::Ready
            }
            (PathStage::Fill | PathStage::Run, Ok(_)) => self.mark_point_sent(slot),
            (PathStage::Verify(..), Ok(raw)) => self.handle_verification(now, slot, raw),
            (PathStage::Fill, Err(Failure::Silent)) if self.is_starting() => {
                self.stage = PathStage::Run;
                self.fail(Failure::Silent)
            }
            (PathStage::Fill | PathStage::Run, Err(Failure::Silent))
                if matches!(in_flight, InFlight::Send(_)) =>
            {
                self.verify_point(slot)
            }
            (_, Err(failure)) => self.fail(failure),
        }
    }

    /// Returns whether the pending request, sent while the buffer fills, starts the path.
    fn is_starting(&self) -> bool {
        self.buffer_model.is_filled() || self.complete && self.points.is_empty()
    }

    fn handle_learned<R: Request, A: Copy + 'static>(
        &mut self,
        n: u8,
        slot: &mut AxisSlot<R, A>,
        in_flight: InFlight,
        raw: Result<i64, Failure>,
    ) -> JobState {
        match (in_flight, raw) {
            (InFlight::Factor(id), Ok(_)) => slot.count_attempt(id),
            (_, Ok(raw)) if n == 0 => {
                // A buffer that claims to be empty or endless is a misread register.
                let capacity = raw.clamp(ROOM_MIN, POINTS_MAX as i64) as u32;
                self.low_mark = (capacity / 2).clamp(1, 15) as u8;
                *self.buffer_model = BufferModel::new(capacity, self.low_mark.into());
                self.stage = PathStage::Learn(1);
            }
            (_, Ok(raw)) => {
                self.end_position = raw;
                self.stage = PathStage::Prepare(0);
            }
            (_, Err(failure)) => return self.fail(failure),
        }
        JobState::Ready
    }

    /// The point at the front is on its way.
    fn mark_point_sent<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
    ) -> JobState {
        if let Some((raw, time_ns)) = self.raw_point(slot) {
            debug_assert!(!self.points.is_empty(), "the point that was sent is still the first");
            self.end_position += raw.distance;
            self.buffer_model.record_sent(time_ns);
            self.points.pop_front();
        }
        self.resends = 0;
        JobState::Ready
    }

    /// Handles a point without a reply: the drive's counter shows whether the point arrived.
    fn verify_point<R: Request, A: Copy + 'static>(&mut self, slot: &AxisSlot<R, A>) -> JobState {
        // Without an earlier status nothing shows which number the drive waits for.
        if self.counter_offset.is_none() || self.resends >= RESENDS_MAX {
            return self.fail(Failure::Silent);
        }
        match self.raw_point(slot) {
            Some((raw, time_ns)) => {
                self.resends += 1;
                self.stage = PathStage::Verify(raw.distance, time_ns);
                JobState::Ready
            }
            None => self.fail(Failure::Silent),
        }
    }

    fn handle_verification<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut AxisSlot<R, A>,
        raw: i64,
    ) -> JobState {
        let Some(paths) = slot.driver.paths() else {
            return self.fail_unsupported(Unsupported::NoPlan);
        };
        let status = paths.decode_path_status(raw);
        let sent = self.buffer_model.sent();
        let (has, wants) =
            (self.counter_matches(&status, sent + 1), self.counter_matches(&status, sent));
        self.stage = if self.buffer_model.ends_at() == Instant::FAR_FUTURE {
            PathStage::Fill
        } else {
            PathStage::Run
        };
        match (has, wants) {
            (true, _) => self.mark_point_sent(slot),
            (_, true) => JobState::Ready,
            _ => self.handle_status(now, slot, raw),
        }
    }

    /// Returns whether the drive's counter has the value that follows from this number of points.
    fn counter_matches(&self, status: &PathStatus, count: u32) -> bool {
        self.counter_offset == Some(status.offset(count))
    }

    fn handle_status<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut AxisSlot<R, A>,
        raw: i64,
    ) -> JobState {
        const POINT_LOST: &str = "the drive missed a point (its integrity counter stands still) and was \
                            stopped: check the line, and stream again from where it stands";
        const UNDERRUN: &str = "the drive ran out of points and stopped: feed them faster, or give each \
                           more time";
        let Some(paths) = slot.driver.paths() else {
            return self.fail_unsupported(Unsupported::NoPlan);
        };
        let status = paths.decode_path_status(raw);
        let sent = self.buffer_model.sent();
        let offset = status.offset(sent);
        // The counter starts wherever the last path left it; from then on it must keep step with the points.
        let known = *self.counter_offset.get_or_insert(offset);
        debug_assert!(self.stage != PathStage::Stop);
        self.next_status = now + STATUS_INTERVAL;
        if status.underrun {
            return self.fail(Failure::NotReady { hint: UNDERRUN });
        }
        if status.lost || known != offset {
            return self.fail(Failure::NotReady { hint: POINT_LOST });
        }
        if status.empty && !self.complete {
            return self.fail(Failure::NotReady { hint: UNDERRUN });
        }
        if self.complete && self.points.is_empty() {
            let state = self.check_end(now, &status);
            // An empty buffer only means that the position must be read.
            if let JobState::Ended(Outcome::Done(_)) = state {
                slot.expect_position(now, self.end_position);
            }
            return state;
        }
        self.buffer_model.correct_clock(now, &status);
        JobState::Ready
    }

    /// All points are sent: it is through when the last one's time is over and none is left.
    fn check_end(&mut self, now: Instant, status: &PathStatus) -> JobState {
        let end = self.buffer_model.ends_at();
        if status.empty && now >= end {
            return JobState::Ended(Outcome::Done(self.buffer_model.sent().into()));
        }
        if now > end + GRACE {
            return self.fail(Failure::NotReached);
        }
        // Fifty times a second once the path should be over: the caller waits for the answer now.
        self.next_status = if end > now { end } else { now + STATUS_INTERVAL / 50 };
        JobState::Ready
    }
}
