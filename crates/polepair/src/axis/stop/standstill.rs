//! Standstill of a motor after a stop: its readings, and their evidence.
//!
//! Standstill is confirmed by measured values, by the rule of [`judge`](polepair_core::judge). Only values that
//! were read after the reply to the last step of the stop count. Earlier readings and values of the trajectory
//! do not.
//!
//! Why: STOP-7.

use std::time::Duration;

use super::attempt::is_communication_error;
use super::{Standstill, StopProgress, failure_of};
use crate::axis::{LocalAxis, RunningRequest};
use crate::error::Error;
use crate::url::AxisNumber;
use polepair_core::axis::{AxisStatus, Refusal, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::judge::{MotionGoal, MotionJudge, MotionVerdict, Observation, Tolerance};
use polepair_core::plan::Step;
use polepair_core::profile::{ParameterId, Profile, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

/// Interval of the checks of standstill.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
const POLL_INTERVAL_MAX: Duration = Duration::from_secs(2);
/// Time for which a motor that brakes is read without a pause.
const BRAKING_TIME: Duration = Duration::from_secs(2);
/// After that the pause is this multiple of the time of a reading: a motor that turns on takes 5 % of its wire.
// After two seconds of braking the readings take 5 % of the wire, as repetitions do.
const PAUSE_FACTOR: u32 = 19;
/// Two positions at this distance in time are compared: a difference that these speeds give is none. A servo
/// that holds its position is never quite still.
const POSITION_SPAN: Duration = Duration::from_millis(100);
const HOLDING_SPEED_RAD: f64 = 0.05;
const HOLDING_SPEED_M: f64 = 0.001;
/// With a speed that means standstill, two positions may differ by this number of raw steps, or by this
/// multiple of the speed limit of standstill.
// Either reading may be one step off.
const POSITION_DITHER: u64 = 2;
const SLOW_FACTOR: f64 = 2.0;
/// Time limit for the standstill after an executed stop.
pub(super) const STANDSTILL_WAIT_MAX: Duration = Duration::from_secs(5);
/// Time for which a value that the drive refuses now is awaited, if another one confirms standstill too.
const UNREADABLE_MAX: Duration = Duration::from_secs(1);
/// Time for which the drives of a group, which do not report the same, are asked for standstill.
const GROUP_WAIT_MAX: Duration = Duration::from_secs(10);

/// Measurements of a motor after a stop, which [`MotionJudge`] judges.
#[derive(Debug)]
pub(super) struct StandstillMonitor {
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
    /// The source that was read last: speed and position are read in turn.
    last_source: Option<StandstillSource>,
    /// Why a source could not be read, since when, and that it is the speed.
    unreadable: Option<(Error, Instant)>,
    /// The motor turned at the last reading.
    is_turning: bool,
    /// Speed and position contradict each other.
    mismatch: Option<Error>,
    /// Speed of the motor, or change of its position in a second, and the time of the reading.
    rate: Option<(f64, Instant)>,
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
    /// A monitor of a stop that the drive replied to just now. `retries`: a missing reply is asked for again.
    pub fn new(axis: &LocalAxis, now: Instant, retries: bool) -> Self {
        Self {
            since: now,
            judge: None,
            speed_source: signal_parameter(Signal::Velocity, axis.profile),
            position_source: signal_parameter(Signal::Position, axis.profile),
            in_flight: None,
            single_attempt: !retries,
            next_poll: now,
            speed: None,
            position: None,
            last_source: None,
            unreadable: None,
            is_turning: false,
            mismatch: None,
            rate: None,
            factors_read: 0,
        }
    }

    /// Time at which the drive replied to the stop.
    pub fn since(&self) -> Instant {
        self.since
    }

    /// Returns whether the motor turned at the last reading.
    pub fn is_seen_turning(&self) -> bool {
        self.is_turning || self.mismatch.is_some()
    }

    /// Reason why the state is unknown now: speed and position contradict each other, or the drive refuses them.
    pub fn trouble(&self) -> Option<&Error> {
        self.mismatch.as_ref().or(self.unreadable.as_ref().map(|(error, _)| error))
    }

    /// Measured rate, as [`StopAttempt::rate`](super::attempt::StopAttempt::rate).
    pub fn rate(&self) -> Option<(f64, Instant)> {
        self.rate.filter(|_| self.is_turning)
    }

    /// Waits for the reading under way, or until the next is due, at most for this time.
    pub fn wait(&mut self, axis: &LocalAxis, at_most: Duration) {
        match &mut self.in_flight {
            Some((running, ..)) => drop(running.wait(at_most)),
            None => axis.sleep(self.next_poll.since(axis.connection.now()).min(at_most)),
        }
    }

    /// The next source to read: speed and position in turn, factors of their units before.
    fn next_source(&self, axis: &LocalAxis) -> Option<StandstillSource> {
        // Factors first: without them neither a speed nor a position has a unit to be judged by.
        let sources = [self.speed_source, self.position_source];
        if self.judge.is_none() {
            let sources = sources.into_iter().flatten();
            let mut factors = sources.filter_map(|id| axis.unread_factor(id, self.factors_read));
            if let Some(factor) = factors.next() {
                return Some(StandstillSource::Factor(factor));
            }
        }
        let speed = self.speed_source.map(StandstillSource::Speed);
        let position = self.position_source.map(StandstillSource::Position);
        match self.last_source {
            // In turns, because both have to show standstill where a drive reports both.
            Some(StandstillSource::Speed(_)) => position.or(speed),
            _ => speed.or(position),
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

    /// Progress once it is known; an error when the drive does not answer any more.
    pub fn poll(&mut self, axis: &LocalAxis, now: Instant) -> Result<Option<StopProgress>, Error> {
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
        debug_assert!(self.in_flight.is_some(), "an answer belongs to a reading");
        self.in_flight = None;
        // By the time that this reading took: a slow wire gets longer pauses by itself.
        let rest = now.since(requested_at) * PAUSE_FACTOR;
        self.next_poll = now
            + if now.since(self.since) < BRAKING_TIME {
                POLL_INTERVAL
            } else {
                rest.clamp(POLL_INTERVAL, POLL_INTERVAL_MAX)
            };
        match read {
            Ok(raw) => {
                let stands = self.evaluate(axis, source, raw, requested_at, now);
                if self.speed_source.is_none() && matches!(source, StandstillSource::Position(_)) {
                    // Positions that are nearer in time show nothing.
                    self.next_poll = self.next_poll.max(requested_at + POSITION_SPAN);
                }
                Ok(stands.then_some(StopProgress::Standstill))
            }
            // Silence is no evidence of rest; the caller decides whether to ask again.
            Err(error) if is_communication_error(&error) => Err(error),
            Err(error) => {
                self.handle_unreadable(axis, source, error, now);
                Ok(None)
            }
        }
    }

    /// The drive replied, but not with a value. An object that it does not have is not read again.
    fn handle_unreadable(
        &mut self,
        axis: &LocalAxis,
        source: StandstillSource,
        error: Error,
        now: Instant,
    ) {
        // "Not now" keeps the reading; only "no such object" drops it (STOP-21).
        let is_missing = match failure_of(&error) {
            // The drives of a group differ.
            Some(Failure::NotReady { .. }) => now.since(self.since) >= GROUP_WAIT_MAX,
            Some(Failure::Refused { code }) => {
                let refusal = axis.connection.with_axes(|axes, _| axes.refusal(axis.index, code));
                refusal == Refusal::Missing
            }
            _ => true,
        };
        if is_missing || matches!(source, StandstillSource::Factor(_)) {
            self.drop_source(source);
            self.next_poll = now;
            return;
        }
        if matches!(source, StandstillSource::Speed(_)) {
            (self.speed, self.is_turning, self.rate) = (None, false, None);
        } else {
            (self.position, self.mismatch) = (None, None);
        }
        self.last_source = Some(source);
        if failure_of(&error).is_some_and(|failure| matches!(failure, Failure::NotReady { .. })) {
            return;
        }
        // The first reason stays: what follows it is often a consequence.
        let (_, since) = self.unreadable.get_or_insert((axis.unreadable_error(error), now));
        // The other one is enough, if the drive reports it.
        let tells_other = match source {
            StandstillSource::Speed(_) => self.position.is_some(),
            _ => self.speed.is_some(),
        };
        if tells_other && now.since(*since) >= UNREADABLE_MAX {
            self.unreadable = None;
            self.drop_source(source);
        }
    }

    fn start_reading(&mut self, axis: &LocalAxis, source: StandstillSource, now: Instant) {
        match axis.start_standstill_read(source.parameter(), self.single_attempt) {
            Ok(running) => self.in_flight = Some((running, now, source)),
            Err(Error::Unsupported { why: Unsupported::Busy, .. }) => {
                // Another caller's command is under way on this axis; its reply comes first.
                self.next_poll = now + POLL_INTERVAL;
            }
            // The profile does not let it be read at all, and will not later.
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
        requested_at: Instant,
        reported_at: Instant,
    ) -> bool {
        let mut seen = Observation::default();
        if !matches!(source, StandstillSource::Factor(_)) {
            self.last_source = Some(source);
        }
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
                (self.is_turning, self.rate) = (is_fast, Some((number.abs(), reported_at)));
            }
            StandstillSource::Position(id) => {
                seen.position = Some(raw);
                self.compare_positions(axis, id, raw, requested_at, reported_at);
            }
        }
        let Some(judge) = self.judge(axis) else { return false };
        debug_assert!(reported_at >= requested_at, "a reply comes after its request");
        judge.observe(reported_at, &seen);
        judge.verdict(reported_at) == MotionVerdict::Arrived
    }

    /// Compares a position with the one before: a motor whose speed means standstill may turn all the same.
    fn compare_positions(
        &mut self,
        axis: &LocalAxis,
        id: ParameterId,
        raw: i64,
        requested_at: Instant,
        reported_at: Instant,
    ) {
        let (since, first) = *self.position.get_or_insert((requested_at, raw));
        // A pair that is nearer in time agrees even where the motor turns slowly.
        if requested_at.since(since) < POSITION_SPAN {
            return;
        }
        self.position = Some((requested_at, raw));
        // No longer than this lies between them, so that they are not called faster than they are.
        let over = reported_at.since(since);
        let slow = axis.standstill_speed().unwrap_or(0.0) * SLOW_FACTOR;
        let moved =
            raw.abs_diff(first) > POSITION_DITHER && axis.has_drifted(id, first, raw, over, slow);
        match self.speed {
            // A tachometer that hangs reports 0 rpm while its position runs (STOP-7).
            Some((speed, false)) => {
                self.mismatch =
                    moved.then(|| axis.speed_mismatch_error(speed, id, first, raw, over));
            }
            Some(_) => self.mismatch = None,
            None => {
                // Without a tachometer the position is the only evidence of the speed.
                self.is_turning = moved;
                let rate = raw.abs_diff(first) as f64 / over.as_secs_f64();
                self.rate = moved.then_some((rate, reported_at));
            }
        }
    }
}

fn signal_parameter(signal: Signal, axis_profile: &Profile) -> Option<ParameterId> {
    axis_profile.signal(signal).map(|source| source.parameter)
}

impl LocalAxis {
    /// Returns whether the last read velocity exceeds the standstill limit of the drive's stop; `None` without a
    /// reading.
    #[must_use]
    pub fn is_turning(&self) -> Option<bool> {
        self.is_turning_in(&self.state())
    }

    pub(in crate::axis) fn is_turning_in(&self, state: &AxisStatus) -> Option<bool> {
        let reading = state.reading(Signal::Velocity);
        reading.at?;
        let id = self.profile.signal(Signal::Velocity)?.parameter;
        let speed = self.parameter(id)?.encoding.number(reading.raw).abs();
        let slow = self.tolerance().and_then(|tolerance| tolerance.standstill);
        // Without a known limit of standstill every speed but zero counts as turning.
        Some(speed > slow.unwrap_or(0.0))
    }

    /// Evidence on a motor without measurable standstill: of one drive its acknowledgement of the stop, of a group
    /// none.
    pub(super) fn unobserved(&self) -> Standstill {
        if AxisNumber(self.number).is_group() {
            Standstill::Unconfirmed
        } else {
            Standstill::Unobservable
        }
    }

    /// Time limit of the motor's standstill after a stop or a quick stop.
    pub(super) fn standstill_timeout(&self, verb: Verb) -> Duration {
        let steps = self.profile.plan(verb).map_or(&[][..], |plan| plan.steps);
        let waits = steps.iter().filter_map(|step| match step {
            Step::Until { within_ms, .. } | Step::Standstill { within_ms } => {
                Some(Duration::from_millis((*within_ms).into()))
            }
            _ => None,
        });
        // A profile whose own plan waits longer knows its motor's ramp better.
        waits.fold(self.connection.scale_timeout(STANDSTILL_WAIT_MAX), Duration::max)
    }

    /// The device is no known drive, and nothing shows what its motor does.
    pub(super) fn unidentified_error(&self) -> Error {
        Error::Failed {
            what: format!(
                "{} did not say what it is: it took the stop of its protocol, and its standstill is not confirmed",
                self.label()
            ),
            execution: String::new(),
            outcome: Outcome::Unknown(Failure::Silent),
            may_turn: true,
            received: Box::default(),
            hint: "look at the motor; select the drive by `?profile=`".to_owned(),
        }
    }

    /// The motor still turns after this time.
    pub(super) fn not_at_rest_error(&self, after: Duration) -> Error {
        let what = format!("is not at standstill after {} s", after.as_secs());
        self.still_turning_error(&what, "give its ramp more time, or cut its power")
    }

    /// The speed means standstill, but two positions differ.
    fn speed_mismatch_error(
        &self,
        speed: i64,
        id: ParameterId,
        from: i64,
        to: i64,
        over: Duration,
    ) -> Error {
        let reported =
            |id, raw| match self.raw_to_si(id, raw).and_then(|_| self.value(id, raw).ok()) {
                Some(value) => value.to_string(),
                None => raw.to_string(),
            };
        let velocity = self.profile.signal(Signal::Velocity);
        let speed = velocity.map_or_else(String::new, |source| reported(source.parameter, speed));
        let (from, to, ms) = (reported(id, from), reported(id, to), over.as_millis());
        let what = format!(
            "reports a speed of {speed}, but its position went from {from} to {to} in {ms} ms"
        );
        self.still_turning_error(&what, "cut its power; then check why its speed is not measured")
    }

    /// Error of a drive that replied to the stop, and cannot report now whether its motor turns.
    fn unreadable_error(&self, error: Error) -> Error {
        match error {
            Error::Failed { what, execution, received, hint, .. } => Error::Failed {
                what,
                execution,
                outcome: Outcome::Unknown(Failure::Silent),
                may_turn: true,
                received,
                hint,
            },
            other => other,
        }
    }

    fn still_turning_error(&self, what: &str, hint: &str) -> Error {
        Error::Failed {
            what: format!("{} received a stop, but {what}", self.label()),
            execution: String::new(),
            outcome: Outcome::Unknown(Failure::NotReached),
            may_turn: true,
            received: Box::default(),
            hint: hint.to_owned(),
        }
    }

    fn raw_to_si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        self.connection.with_axes(|axes, _| axes.to_si(self.index, id, raw))
    }

    /// Returns whether a motor went further in that time than one that holds its place, or turns at that speed.
    fn has_drifted(&self, id: ParameterId, from: i64, to: i64, over: Duration, speed: f64) -> bool {
        let holds = match self.parameter(id).map(|parameter| parameter.unit) {
            Some(Unit::Millimetre) => HOLDING_SPEED_M,
            _ => HOLDING_SPEED_RAD,
        };
        let execution = self
            .raw_to_si(id, from)
            .zip(self.raw_to_si(id, to))
            .map(|(from, to)| (to - from).abs());
        // Without a scale nothing shows that the steps are small ones, so the motor counts as turning.
        execution.is_none_or(|went| went > holds.max(speed) * over.as_secs_f64())
    }

    /// The nth parameter that the scale of this one depends on, while that is not known.
    fn unread_factor(&self, id: ParameterId, nth: usize) -> Option<ParameterId> {
        let factors = self.parameter(id)?.scale.inputs(self.profile);
        factors.filter(|_| self.raw_to_si(id, 0).is_none()).nth(nth)
    }

    /// Tolerances of positions and speeds of this axis.
    fn tolerance(&self) -> Option<Tolerance> {
        self.connection.with_axes(|axes, _| axes.tolerance(self.index))
    }

    /// The greatest speed that means standstill, rad/s or m/s.
    fn standstill_speed(&self) -> Option<f64> {
        let speed = self.profile.signal(Signal::Velocity)?.parameter;
        let one = self.raw_to_si(speed, self.parameter(speed)?.encoding.raw(1.0)?)?;
        Some((self.tolerance()?.standstill? * one).abs())
    }
}
