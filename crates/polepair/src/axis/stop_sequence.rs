//! A stop and its progress: sent, acknowledged step by step, and confirmed by standstill.
//!
//! Standstill is confirmed by measured values, by the rule of [`judge`](polepair_core::judge). Only values that
//! were read after the reply to the last step count. Earlier readings and values of the trajectory do not.
//!
//! Why: STOP-7.

mod requests;
mod standstill;

use std::time::Duration;

use super::{LocalAxis, RunningRequest};
use crate::error::Error;
use crate::url::AxisNumber;
use polepair_core::axis::{AxisStatus, StopPart, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::judge::{MotionGoal, MotionJudge, MotionVerdict, Observation, Tolerance};
use polepair_core::plan::Step;
use polepair_core::profile::{ParameterId, RamMode, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

/// Interval of the checks of standstill.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
const POLL_INTERVAL_MAX: Duration = Duration::from_secs(2);
/// For so long a motor that brakes is looked at without a rest.
const BRAKING_TIME: Duration = Duration::from_secs(2);
/// After that the pause is so many times what a reading took: a motor that turns on takes 5 % of its wire.
const PAUSE_FACTOR: u32 = 19;
/// Two positions at this distance in time are compared: a difference that these speeds give is none. A servo
/// that holds its position is never quite still.
const POSITION_SPAN: Duration = Duration::from_millis(100);
const HOLDING_SPEED_RAD: f64 = 0.05;
const HOLDING_SPEED_M: f64 = 0.001;
/// With a speed that means standstill, two positions may differ by this number of raw steps, or by this
/// multiple of the speed limit of standstill.
const POSITION_DITHER: u64 = 2;
const SLOW_FACTOR: f64 = 2.0;
/// Time after which a stop is repeated if speed and position contradict each other.
const RESEND_AFTER: Duration = Duration::from_secs(1);
/// Time limit for the standstill after an executed stop.
pub(super) const STANDSTILL_WAIT_MAX: Duration = Duration::from_secs(5);
/// So long a group's drives, which do not tell the same, are asked whether they stand.
const GROUP_WAIT_MAX: Duration = Duration::from_secs(10);

/// The stop of one axis, for those who wait for nothing: they look again and again.
#[derive(Debug)]
pub struct StopSequence {
    started_at: Instant,
    /// A program of the drive goes on.
    keep_program: bool,
    stage: StopStage,
    progress: StopProgress,
    elapsed: Duration,
    trouble: Option<Error>,
    /// Whether a check of standstill is repeated after a missing reply.
    retries: bool,
}

/// How far a stop is known to have come.
#[derive(Clone, PartialEq, Debug)]
pub enum StopProgress {
    /// It is on the wire.
    Sent,
    /// The drive answered all of it.
    Acknowledged,
    /// Standstill was measured after the drive's reply.
    Standstill,
    /// The drive answered all of it, and measures nothing by which it could be seen to stand.
    Unobservable,
    /// It could not be sent, or was not confirmed; why.
    Failed(Error),
}

/// What is known of a motor whose stop was carried out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Standstill {
    /// Standstill by measured speed, or by two positions.
    Observed,
    /// The drive reports neither.
    Unobservable,
    /// The stop was sent to a group, and no drive confirms it on this wire.
    Unconfirmed,
}

#[derive(Debug)]
enum StopStage {
    /// Reads whether the writes of a stop go to RAM, before the stop is repeated.
    CheckingRamMode(RunningRequest, RamMode),
    /// Sees to it.
    SettingRamMode(RunningRequest),
    Sending(RunningRequest),
    Observing(StandstillMonitor),
    /// Sends the final requests at standstill.
    Releasing(RunningRequest, StopProgress),
    Ended,
}

impl StopSequence {
    /// Sends it.
    #[must_use]
    pub fn begin(axis: &LocalAxis) -> Self {
        Self::begin_with(axis, false)
    }

    /// The same; `keep_program` lets a program of the drive go on, which may move the motor again.
    pub(super) fn begin_with(axis: &LocalAxis, keep_program: bool) -> Self {
        let mut stopping = Self { keep_program, ..Self::new(axis) };
        stopping.send_stop(axis, false);
        stopping
    }

    /// Repeats the stop to a drive without a reply, or after a lost link: each request once, so that a
    /// missing drive uses the wire for one request only. A drive that would write permanent memory, because
    /// it has restarted, is set to RAM first.
    #[must_use]
    pub fn resend(axis: &LocalAxis) -> Self {
        Self::resend_with(axis, false)
    }

    /// The same, as [`begin_with`](Self::begin_with).
    pub(super) fn resend_with(axis: &LocalAxis, keep_program: bool) -> Self {
        let mut stopping = Self { keep_program, ..Self::new(axis) };
        match axis.stop_ram_mode() {
            Some(ram) => match axis.start_ram_mode_read(ram.parameter) {
                Ok(running) => stopping.stage = StopStage::CheckingRamMode(running, ram),
                Err(error) => stopping.fail(error),
            },
            None => stopping.send_stop(axis, true),
        }
        stopping
    }

    /// Of one that was carried out elsewhere: is it seen to stand?
    fn observe_executed(axis: &LocalAxis) -> Self {
        let (mut stopping, now) = (Self::new(axis).with_retries(), axis.connection().now());
        stopping.set_progress(StopProgress::Acknowledged, now);
        stopping.start_observing(axis, now);
        stopping
    }

    /// For who waits for this axis alone: an answer that is lost is asked for again.
    pub(super) fn with_retries(mut self) -> Self {
        self.retries = true;
        self
    }

    fn start_observing(&mut self, axis: &LocalAxis, now: Instant) {
        self.stage = StopStage::Observing(StandstillMonitor {
            single_attempt: !self.retries,
            ..StandstillMonitor::new(axis, now)
        });
    }

    fn new(axis: &LocalAxis) -> Self {
        let (started_at, stage) = (axis.connection().now(), StopStage::Ended);
        Self {
            started_at,
            keep_program: false,
            stage,
            progress: StopProgress::Sent,
            elapsed: Duration::ZERO,
            trouble: None,
            retries: false,
        }
    }

    fn send_stop(&mut self, axis: &LocalAxis, once: bool) {
        let halt = StopPart::Halt { keep_program: self.keep_program };
        match axis.start_stop(halt, once) {
            Ok(running) => self.stage = StopStage::Sending(running),
            Err(error) => self.fail(error),
        }
    }

    fn fail(&mut self, error: Error) {
        (self.progress, self.stage) = (StopProgress::Failed(error), StopStage::Ended);
    }

    /// How far it has come.
    #[must_use]
    pub fn progress(&self) -> &StopProgress {
        &self.progress
    }

    /// The reason why it does not proceed: the drive became silent after its reply, or reports standstill
    /// while its position changes.
    #[must_use]
    pub fn trouble(&self) -> Option<&Error> {
        match &self.stage {
            StopStage::Observing(watch) => watch.mismatch.as_ref(),
            _ => self.trouble.as_ref(),
        }
    }

    /// How long that took.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// Whether it has ended, and this was reported for long enough.
    #[must_use]
    pub fn is_expired(&self, axis: &LocalAxis, reported_at: Duration) -> bool {
        let age = axis.connection().now().since(self.started_at);
        matches!(self.progress, StopProgress::Standstill | StopProgress::Unobservable)
            && age > self.elapsed + reported_at
    }

    /// Whether something of it is still to be answered: nothing that moves is to be sent meanwhile.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        !matches!(self.stage, StopStage::Observing(_) | StopStage::Ended)
    }

    /// Whether nothing of it is on the wire yet: its drive is asked something else first.
    #[must_use]
    pub fn is_held_back(&self) -> bool {
        matches!(self.stage, StopStage::CheckingRamMode(..) | StopStage::SettingRamMode(_))
    }

    /// Whether nothing more will be known without a repetition.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.stage, StopStage::Ended)
    }

    /// Whether the drive answered all of it, and the motor still turned at the last reading.
    #[must_use]
    pub fn is_seen_turning(&self) -> bool {
        matches!(&self.stage, StopStage::Observing(watch) if watch.is_turning || watch.mismatch.is_some())
    }

    /// Speed of the motor at the last reading, if it turns: in a unit of the drive, the same for all
    /// readings.
    pub(super) fn rate(&self) -> Option<f64> {
        match &self.stage {
            StopStage::Observing(watch) if watch.is_turning => watch.rate,
            _ => None,
        }
    }

    /// Looks how far it has come. Waits for nothing.
    pub fn poll(&mut self, axis: &LocalAxis, now: Instant) {
        self.step(axis, now);
    }

    /// Waits for its end, at most so long.
    pub fn wait(&mut self, axis: &LocalAxis, at_most: Duration) {
        let end = axis.connection().now() + at_most;
        while !self.has_ended() {
            let left = end.since(axis.connection().now());
            if left.is_zero() {
                return;
            }
            // What it comes to is looked at below.
            let _ = match &mut self.stage {
                StopStage::CheckingRamMode(running, _)
                | StopStage::SettingRamMode(running)
                | StopStage::Sending(running)
                | StopStage::Releasing(running, _) => running.wait(left),
                StopStage::Observing(StandstillMonitor {
                    in_flight: Some((running, ..)), ..
                }) => running.wait(left),
                StopStage::Observing(watch) => {
                    axis.sleep(watch.next_poll.since(axis.connection().now()).min(left));
                    Ok(None)
                }
                StopStage::Ended => Ok(None),
            };
            self.step(axis, axis.connection().now());
        }
    }

    fn step(&mut self, axis: &LocalAxis, now: Instant) {
        match std::mem::replace(&mut self.stage, StopStage::Ended) {
            StopStage::CheckingRamMode(mut running, ram) => match running.poll() {
                Ok(None) => self.stage = StopStage::CheckingRamMode(running, ram),
                Ok(Some(raw)) if raw == ram.ram => self.send_stop(axis, false),
                Ok(Some(_)) => match axis.start_write(ram.parameter, ram.ram, false) {
                    Ok(running) => self.stage = StopStage::SettingRamMode(running),
                    Err(_) => self.send_stop(axis, false),
                },
                // It answers: to stop is worth a write to its memory.
                Err(error) if !is_communication_error(&error) => self.send_stop(axis, false),
                Err(error) => self.fail(error),
            },
            StopStage::SettingRamMode(mut running) => match running.poll() {
                Ok(None) => self.stage = StopStage::SettingRamMode(running),
                Err(error) if is_communication_error(&error) => self.fail(error),
                Ok(Some(_)) | Err(_) => self.send_stop(axis, false),
            },
            StopStage::Sending(mut running) => match running.poll() {
                Ok(None) => self.stage = StopStage::Sending(running),
                Ok(Some(_)) => {
                    // Where nobody answers it, it may have been lost.
                    let index = axis.index;
                    if axis.connection().with_axes(|axes, _| axes.is_confirmed(index)) {
                        self.set_progress(StopProgress::Acknowledged, now);
                    }
                    self.start_observing(axis, now);
                    self.step(axis, now);
                }
                Err(error) => self.fail(error),
            },
            StopStage::Observing(mut watch) => match watch.poll(axis, now) {
                Ok(None) => self.stage = StopStage::Observing(watch),
                Ok(Some(class)) => self.start_release(axis, class, now),
                Err(error) => self.trouble = Some(error),
            },
            StopStage::Releasing(mut running, class) => match running.poll() {
                Ok(None) => self.stage = StopStage::Releasing(running, class),
                Ok(Some(_)) => self.set_progress(class, now),
                Err(error) => self.trouble = Some(error),
            },
            StopStage::Ended => {}
        }
    }

    fn set_progress(&mut self, class: StopProgress, now: Instant) {
        (self.progress, self.elapsed) = (class, now.since(self.started_at));
    }

    /// Sends the final requests at standstill.
    fn start_release(&mut self, axis: &LocalAxis, class: StopProgress, now: Instant) {
        let plan = axis.profile().plan(Verb::Stop);
        if plan.is_none_or(|plan| plan.after_wait().is_empty()) {
            return self.set_progress(class, now);
        }
        match axis.start_stop(StopPart::Release, false) {
            Ok(running) => self.stage = StopStage::Releasing(running, class),
            Err(error) => self.trouble = Some(error),
        }
    }
}

/// Measurements of a motor after a stop, which [`MotionJudge`] judges.
#[derive(Debug)]
struct StandstillMonitor {
    since: Instant,
    /// Made once the units of the readings are known.
    judge: Option<Box<MotionJudge>>,
    /// Sources that the drive has; one that it turns out to lack is taken out.
    speed_source: Option<ParameterId>,
    position_source: Option<ParameterId>,
    in_flight: Option<(RunningRequest, Instant, StandstillSource)>,
    /// A drive that is silent is asked once.
    single_attempt: bool,
    next_poll: Instant,
    /// The last speed, raw, and whether it means that the motor turns.
    speed: Option<(i64, bool)>,
    /// The first of the positions that are compared, and when it was asked for.
    position: Option<(Instant, i64)>,
    /// The motor turned at the last reading.
    is_turning: bool,
    /// Speed and position contradict each other.
    mismatch: Option<Error>,
    /// How fast the motor turns, or how far the position went in a second.
    rate: Option<f64>,
    /// Parameters that were read because a unit depends on them.
    factors_read: usize,
}

/// A source for standstill.
#[derive(Clone, Copy, PartialEq, Debug)]
enum StandstillSource {
    Speed(ParameterId),
    Position(ParameterId),
    /// A parameter that the unit of either depends on.
    Factor(ParameterId),
}

impl StandstillSource {
    fn parameter(self) -> ParameterId {
        match self {
            Self::Speed(id) | Self::Position(id) | Self::Factor(id) => id,
        }
    }
}

impl StandstillMonitor {
    fn new(axis: &LocalAxis, now: Instant) -> Self {
        let parameter = |signal| axis.profile().signal(signal).map(|source| source.parameter);
        Self {
            since: now,
            judge: None,
            speed_source: parameter(Signal::Velocity),
            position_source: parameter(Signal::Position),
            in_flight: None,
            single_attempt: true,
            next_poll: now,
            speed: None,
            position: None,
            is_turning: false,
            mismatch: None,
            rate: None,
            factors_read: 0,
        }
    }

    /// The next source to read: speed and position in turn, factors of their units before.
    fn next_source(&self, axis: &LocalAxis) -> Option<StandstillSource> {
        let sources = [self.speed_source, self.position_source];
        if self.judge.is_none() {
            let unread = |id: ParameterId| axis.unread_factor(id, self.factors_read);
            if let Some(factor) = sources.into_iter().flatten().find_map(unread) {
                return Some(StandstillSource::Factor(factor));
            }
        }
        let speed = self.speed_source.map(StandstillSource::Speed);
        let position = self.position_source.map(StandstillSource::Position);
        match self.speed {
            Some(_) => position.or(speed),
            None => speed.or(position),
        }
    }

    fn judge(&mut self, axis: &LocalAxis) -> Option<&mut MotionJudge> {
        if self.judge.is_none() {
            let mut judge = MotionJudge::new(MotionGoal::Standstill, axis.tolerance()?);
            if self.position_source.is_none() {
                judge.mark_without_position();
            }
            if self.speed_source.is_none() {
                judge.mark_without_speed();
            }
            self.judge = Some(Box::new(judge));
        }
        self.judge.as_deref_mut()
    }

    /// What is known when it is; an error when the drive answers no longer.
    fn poll(&mut self, axis: &LocalAxis, now: Instant) -> Result<Option<StopProgress>, Error> {
        let Some(source) = self.next_source(axis) else {
            return Ok(Some(StopProgress::Unobservable));
        };
        let Some((running, requested_at, source)) = &mut self.in_flight else {
            if now >= self.next_poll {
                self.start_reading(axis, source, now);
            }
            return Ok(None);
        };
        let (requested_at, source) = (*requested_at, *source);
        let read = match running.poll() {
            Ok(None) => return Ok(None),
            Ok(Some(raw)) => Ok(raw),
            Err(error) => Err(error),
        };
        self.in_flight = None;
        let rest = now.since(requested_at) * PAUSE_FACTOR;
        self.next_poll = now
            + match now.since(self.since) < BRAKING_TIME {
                true => POLL_INTERVAL,
                false => rest.clamp(POLL_INTERVAL, POLL_INTERVAL_MAX),
            };
        match read {
            Ok(raw) => {
                let stands = self.evaluate(axis, source, raw, (requested_at, now));
                if self.speed_source.is_none() && matches!(source, StandstillSource::Position(_)) {
                    // Positions that are nearer in time show nothing.
                    self.next_poll = self.next_poll.max(requested_at + POSITION_SPAN);
                }
                Ok(stands.then_some(StopProgress::Standstill))
            }
            Err(error) if is_communication_error(&error) => Err(error),
            Err(error) => {
                let differ = matches!(failure_of(&error), Some(Failure::NotReady { .. }));
                if !differ || now.since(self.since) >= GROUP_WAIT_MAX {
                    self.drop_source(source);
                    self.next_poll = now;
                }
                Ok(None)
            }
        }
    }

    fn start_reading(&mut self, axis: &LocalAxis, source: StandstillSource, now: Instant) {
        match axis.start_standstill_read(source.parameter(), self.single_attempt) {
            Ok(running) => self.in_flight = Some((running, now, source)),
            Err(Error::Unsupported { why: Unsupported::Busy, .. }) => {
                self.next_poll = now + POLL_INTERVAL;
            }
            Err(_) => self.drop_source(source),
        }
    }

    /// The drive does not report it.
    fn drop_source(&mut self, source: StandstillSource) {
        match source {
            StandstillSource::Factor(_) => self.factors_read += 1,
            StandstillSource::Speed(_) => {
                self.speed_source = None;
                self.judge.iter_mut().for_each(|judge| judge.mark_without_speed());
            }
            StandstillSource::Position(_) => {
                self.position_source = None;
                self.judge.iter_mut().for_each(|judge| judge.mark_without_position());
            }
        }
    }

    /// Decides standstill by a new value.
    fn evaluate(
        &mut self,
        axis: &LocalAxis,
        source: StandstillSource,
        raw: i64,
        (requested_at, reported_at): (Instant, Instant),
    ) -> bool {
        let mut seen = Observation::default();
        match source {
            StandstillSource::Factor(_) => {
                self.factors_read += 1;
                return false;
            }
            StandstillSource::Speed(id) => {
                let number = axis.parameter(id).map_or(0.0, |p| p.encoding.number(raw));
                seen.speed = Some(number);
                let is_fast = axis.tolerance().and_then(|tolerance| tolerance.standstill);
                let is_fast = is_fast.is_some_and(|slow| number.abs() > slow);
                self.speed = Some((raw, is_fast));
                (self.is_turning, self.rate) = (is_fast, Some(number.abs()));
            }
            StandstillSource::Position(id) => {
                seen.position = Some(raw);
                self.compare_positions(axis, id, raw, (requested_at, reported_at));
                // The next reading is a speed again.
                self.speed = self.speed.filter(|_| self.speed_source.is_none());
            }
        }
        let Some(judge) = self.judge(axis) else { return false };
        judge.observe(reported_at, &seen);
        judge.verdict(reported_at) == MotionVerdict::Arrived
    }

    /// Compares a position with the one before: a motor whose speed means standstill may turn all the same.
    fn compare_positions(
        &mut self,
        axis: &LocalAxis,
        id: ParameterId,
        raw: i64,
        (requested_at, reported_at): (Instant, Instant),
    ) {
        let (since, first) = *self.position.get_or_insert((requested_at, raw));
        if requested_at.since(since) < POSITION_SPAN {
            return;
        }
        self.position = Some((requested_at, raw));
        // No longer than this lies between them, so that they are not called faster than they are.
        let over = reported_at.since(since);
        let slow = axis.standstill_speed().unwrap_or(0.0) * SLOW_FACTOR;
        let moved =
            raw.abs_diff(first) > POSITION_DITHER && axis.has_drifted(id, (first, raw), over, slow);
        match self.speed {
            Some((speed, false)) => {
                let mismatch = || axis.speed_mismatch_error(speed, (id, first, raw), over);
                self.mismatch = moved.then(mismatch);
            }
            Some(_) => self.mismatch = None,
            None => {
                self.is_turning = moved;
                self.rate = moved.then(|| raw.abs_diff(first) as f64 / over.as_secs_f64());
            }
        }
    }
}

fn failure_of(error: &Error) -> Option<Failure> {
    let Error::Failed { outcome, .. } = error else { return None };
    outcome.failure()
}

/// Whether a request failed without a reply, so that a repetition may succeed.
fn is_communication_error(error: &Error) -> bool {
    use Failure::{AnsweredTwice, Cancelled, LinkDown, Misbehaved, Silent};
    let failed = matches!(
        failure_of(error),
        Some(Silent | Misbehaved | AnsweredTwice | Cancelled | LinkDown)
    );
    failed || matches!(error, Error::Link(_))
}
