//! A path that is streamed point by point: what its job asks next, and what an answer makes of it.
//!
//! Why: MOVE-4.

use alloc::boxed::Box;
use alloc::collections::VecDeque;

use super::execute::Next;
use super::job::Asked;
use super::slot::Slot;
use crate::error::{Failure, Outcome, Unsupported};
use crate::station::Request;
use crate::stream::{
    Buffer, POINTS_MAX, PathKind, PathParameters, PathStatus, PathStep, Point, RawPoint,
};
use crate::time::Instant;
use core::time::Duration;

/// How often the drive's buffer is looked at: seldom enough for a line that points nearly fill, and
/// often enough for clocks that differ by a thousandth.
const LOOK: Duration = Duration::from_secs(1);
/// After the last point's time the drive must be through within so long.
const GRACE: Duration = Duration::from_secs(2);
/// Times a point that was lost on the way is sent again; its number makes that harmless.
const RESENDS_MAX: u8 = 3;
/// Room in a buffer whose drive does not tell.
const ROOM_MIN: i64 = 2;

/// A path under way.
#[derive(Debug)]
pub struct Path {
    kind: PathKind,
    parameters: PathParameters,
    points: VecDeque<Point>,
    /// No more points will be fed.
    complete: bool,
    stage: Stage,
    buffer: Box<Buffer>,
    few: u8,
    /// Where the last point sent ends, raw.
    end: i64,
    /// When the drive's buffer is looked at next.
    look_at: Instant,
    /// The drive's counter less ours, once known.
    offset: Option<u32>,
    resends: u8,
    /// How it ends once the drive was told to stop.
    failing: Option<Outcome>,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Stage {
    /// What scales and the buffer's size depend on.
    Learn(u8),
    Prepare(u8),
    Fill,
    Run,
    /// A point may be lost: does the drive's counter have it?
    Doubt(i64, u64),
    Stop,
}

impl Path {
    pub fn new(kind: PathKind, parameters: PathParameters) -> Self {
        Self {
            kind,
            parameters,
            points: VecDeque::with_capacity(POINTS_MAX),
            complete: false,
            stage: Stage::Learn(0),
            buffer: Box::new(Buffer::new(1, 0)),
            few: 1,
            end: 0,
            look_at: Instant::ZERO,
            offset: None,
            resends: 0,
            failing: None,
        }
    }

    /// Takes as many points as there is room for, and tells how many.
    pub fn feed(&mut self, points: &[Point], complete: bool) -> usize {
        let room = POINTS_MAX - self.points.len();
        let taken = points.len().min(room);
        self.points.extend(&points[..taken]);
        self.complete |= complete && taken == points.len();
        taken
    }

    /// The request that comes next.
    pub fn next<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        match self.stage {
            Stage::Learn(n) => self.learn(n, slot),
            Stage::Prepare(number) => {
                let step = PathStep::Prepare { number, kind: self.kind, few: self.few };
                match slot.driver.path(step) {
                    Some(Ok(request)) => Ok((request, Asked::Send(request.class()))),
                    Some(Err(reason)) => Err(self.refuse(reason)),
                    None => {
                        self.stage = Stage::Fill;
                        self.next(now, slot)
                    }
                }
            }
            Stage::Fill => self.fill(slot),
            Stage::Run => self.run(now, slot),
            Stage::Doubt(..) => self.look(slot),
            Stage::Stop => self.send(slot, PathStep::Stop),
        }
    }

    fn learn<R: Request, A: Copy + 'static>(
        &mut self,
        n: u8,
        slot: &Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        let PathParameters { position, velocity, time, room, .. } = self.parameters;
        let factor = [position, velocity, time].into_iter().find_map(|id| slot.missing(id));
        let (id, asked) = match (factor, n) {
            (Some(id), _) => (id, Asked::Factor(id)),
            (None, 0) => (room, Asked::Read(room)),
            (None, _) => (position, Asked::Read(position)),
        };
        match slot.read(id) {
            Ok(request) => Ok((*request, asked)),
            Err(reason) => Err(self.refuse(reason)),
        }
    }

    fn fill<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        let fed_up = self.complete && self.points.is_empty();
        if self.buffer.is_filled() || fed_up && self.buffer.sent() > 0 {
            return self.send(slot, PathStep::Start);
        }
        if fed_up {
            return Err(Next::End(Outcome::Done(0)));
        }
        if self.points.is_empty() {
            return Err(Next::Hungry);
        }
        self.point(slot)
    }

    fn run<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        let may_send = self.buffer.may_send();
        if !self.points.is_empty() && now >= may_send && now < self.look_at {
            return self.point(slot);
        }
        if now >= self.look_at {
            return self.look(slot);
        }
        let until = match (self.points.is_empty(), self.complete) {
            (false, _) => may_send.min(self.look_at),
            (true, _) => self.look_at,
        };
        Err(Next::Sleep(until))
    }

    fn look<R: Request, A: Copy + 'static>(&self, slot: &Slot<R, A>) -> Result<(R, Asked), Next> {
        let id = self.parameters.status;
        match slot.read(id) {
            Ok(request) => Ok((*request, Asked::Read(id))),
            Err(reason) => Err(Next::End(Outcome::NotDone(Failure::Impossible(reason)))),
        }
    }

    fn send<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &Slot<R, A>,
        step: PathStep,
    ) -> Result<(R, Asked), Next> {
        match slot.driver.path(step) {
            Some(Ok(request)) => Ok((request, Asked::Send(request.class()))),
            Some(Err(reason)) => Err(self.refuse(reason)),
            None => Err(self.refuse(Unsupported::NoPlan)),
        }
    }

    /// The next point, as the drive counts it.
    fn point<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &Slot<R, A>,
    ) -> Result<(R, Asked), Next> {
        let Some((raw, _)) = self.raw(slot) else {
            return Err(self.refuse(Unsupported::BadArgument));
        };
        self.send(slot, PathStep::Point(self.kind, raw))
    }

    fn raw<R: Request, A: Copy + 'static>(&self, slot: &Slot<R, A>) -> Option<(RawPoint, u64)> {
        let point = self.points.front()?;
        let PathParameters { position, velocity, time, .. } = self.parameters;
        let raw_time = slot.to_raw(time, point.time)?;
        let raw = RawPoint {
            distance: slot.to_raw(position, point.position)? - self.end,
            velocity: slot.to_raw(velocity, point.velocity)?,
            time: raw_time,
            number: self.buffer.sent(),
        };
        let time_ns = slot.to_si(time, raw_time)? * 1e9;
        Some((raw, time_ns as u64))
    }

    /// Ends it for a reason of the caller's; the drive comes to rest first if it moves.
    fn refuse(&mut self, reason: Unsupported) -> Next {
        self.fail(Failure::Impossible(reason))
    }

    fn fail(&mut self, failure: Failure) -> Next {
        let outcome = match self.stage {
            Stage::Learn(_) | Stage::Prepare(_) | Stage::Fill => Outcome::NotDone(failure),
            _ => Outcome::Unknown(failure),
        };
        if self.failing.is_some() || self.stage == Stage::Stop {
            return Next::End(self.failing.unwrap_or(outcome));
        }
        if matches!(outcome, Outcome::NotDone(_)) {
            return Next::End(outcome);
        }
        (self.failing, self.stage) = (Some(outcome), Stage::Stop);
        Next::Go
    }

    /// What an answer makes of it.
    pub fn answered<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut Slot<R, A>,
        asked: Asked,
        raw: Result<i64, Failure>,
    ) -> Next {
        match (self.stage, raw) {
            (Stage::Stop, _) => Next::End(self.failing.unwrap_or(Outcome::Done(0))),
            (Stage::Learn(n), _) => self.learned(n, slot, asked, raw),
            (Stage::Prepare(n), Ok(_)) => {
                self.stage = Stage::Prepare(n + 1);
                Next::Go
            }
            (Stage::Fill | Stage::Run, Ok(raw)) if asked == Asked::Read(self.parameters.status) => {
                self.looked(now, slot, raw)
            }
            (Stage::Fill, Ok(_)) if self.started() => {
                self.buffer.begin(now);
                self.stage = Stage::Run;
                Next::Go
            }
            (Stage::Fill | Stage::Run, Ok(_)) => self.sent(slot),
            (Stage::Doubt(..), Ok(raw)) => self.found(now, slot, raw),
            (Stage::Fill, Err(Failure::Silent)) if self.started() => {
                self.stage = Stage::Run;
                self.fail(Failure::Silent)
            }
            (Stage::Fill | Stage::Run, Err(Failure::Silent)) if matches!(asked, Asked::Send(_)) => {
                self.doubt(slot)
            }
            (_, Err(failure)) => self.fail(failure),
        }
    }

    /// What was asked in the stage of filling was to start.
    fn started(&self) -> bool {
        self.buffer.is_filled() || self.complete && self.points.is_empty()
    }

    fn learned<R: Request, A: Copy + 'static>(
        &mut self,
        n: u8,
        slot: &mut Slot<R, A>,
        asked: Asked,
        raw: Result<i64, Failure>,
    ) -> Next {
        match (asked, raw) {
            (Asked::Factor(id), Ok(_)) => slot.tried(id),
            (_, Ok(raw)) if n == 0 => {
                let room = raw.clamp(ROOM_MIN, POINTS_MAX as i64) as u32;
                self.few = (room / 2).clamp(1, 15) as u8;
                *self.buffer = Buffer::new(room, self.few.into());
                self.stage = Stage::Learn(1);
            }
            (_, Ok(raw)) => {
                self.end = raw;
                self.stage = Stage::Prepare(0);
            }
            (_, Err(failure)) => return self.fail(failure),
        }
        Next::Go
    }

    /// The point at the front is on its way.
    fn sent<R: Request, A: Copy + 'static>(&mut self, slot: &Slot<R, A>) -> Next {
        if let Some((raw, time_ns)) = self.raw(slot) {
            self.end += raw.distance;
            self.buffer.send(time_ns);
            self.points.pop_front();
        }
        self.resends = 0;
        Next::Go
    }

    /// Nobody knows whether the point arrived; the drive's counter does.
    fn doubt<R: Request, A: Copy + 'static>(&mut self, slot: &Slot<R, A>) -> Next {
        if self.offset.is_none() || self.resends >= RESENDS_MAX {
            return self.fail(Failure::Silent);
        }
        match self.raw(slot) {
            Some((raw, time_ns)) => {
                self.resends += 1;
                self.stage = Stage::Doubt(raw.distance, time_ns);
                Next::Go
            }
            None => self.fail(Failure::Silent),
        }
    }

    fn found<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut Slot<R, A>,
        raw: i64,
    ) -> Next {
        let status = slot.driver.path_status(raw);
        let sent = self.buffer.sent();
        let (has, wants) = (self.taken(&status, sent + 1), self.taken(&status, sent));
        self.stage = if self.buffer.ends() == Instant::FAR { Stage::Fill } else { Stage::Run };
        match (has, wants) {
            (true, _) => self.sent(slot),
            (_, true) => Next::Go,
            _ => self.looked(now, slot, raw),
        }
    }

    /// Whether the drive's counter stands where it does after so many points.
    fn taken(&self, status: &PathStatus, count: u32) -> bool {
        self.offset == Some(status.offset(count))
    }

    fn looked<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slot: &mut Slot<R, A>,
        raw: i64,
    ) -> Next {
        const LOST: &str = "the drive missed a point (its integrity counter stands still) and was \
                            stopped: check the line, and stream again from where it stands";
        const DRY: &str = "the drive ran out of points and stopped: feed them faster, or give each \
                           more time";
        let status = slot.driver.path_status(raw);
        let sent = self.buffer.sent();
        let offset = status.offset(sent);
        let known = *self.offset.get_or_insert(offset);
        self.look_at = now + LOOK;
        if status.ran_dry {
            return self.fail(Failure::NotReady { hint: DRY });
        }
        if status.lost || known != offset {
            return self.fail(Failure::NotReady { hint: LOST });
        }
        if status.empty && !self.complete {
            return self.fail(Failure::NotReady { hint: DRY });
        }
        if self.complete && self.points.is_empty() {
            return self.ending(now, &status);
        }
        self.buffer.correct(now, &status);
        Next::Go
    }

    /// All points are sent: it is through when the last one's time is over and none is left.
    fn ending(&mut self, now: Instant, status: &PathStatus) -> Next {
        let end = self.buffer.ends();
        if status.empty && now >= end {
            return Next::End(Outcome::Done(self.buffer.sent().into()));
        }
        if now > end + GRACE {
            return self.fail(Failure::NotReached);
        }
        self.look_at = if end > now { end } else { now + LOOK / 50 };
        Next::Go
    }
}
