//! Judges by measurements whether a motion ended as its command asked.
//!
//! A drive's own flag (target reached, motion complete, path idle) only gives the time for a measurement. A motion
//! arrived if a position was measured within the window of its target, and a motor is at standstill if several readings
//! of its speed or position show it. [`MotionJudge`] is a value: it takes observations and returns verdicts. It has no
//! clock and sends nothing; the lane feeds it, for every protocol and every profile.
//!
//! Why: MOVE-10.

mod speed;
mod tolerance;

use core::time::Duration;

use crate::time::Instant;
pub use speed::{STANDSTILL_LINEAR, STANDSTILL_ROTARY, SpeedJudge, SpeedVerdict};
pub use tolerance::Tolerance;

/// Shortest time at rest after which a motion counts as ended, though the drive does not report its end.
const REST_MIN: Duration = Duration::from_millis(300);
/// Least rest that ends a homing, which pauses at switches and turns round.
const HOMING_REST_MIN: Duration = Duration::from_secs(5);
/// A motor that received a start may rest this long before it moves: brakes open, axes synchronise.
const START_MAX: Duration = Duration::from_secs(2);
/// Time for which a set flag may be left over from an earlier motion.
const STALE_FLAG_MAX: Duration = Duration::from_millis(300);
/// Time between the first and the last reading that mean standstill.
// Static friction holds a servo that is returning to its set-point for 60 ms and more before it breaks loose.
const STANDSTILL_SPAN: Duration = Duration::from_millis(100);
/// Readings of the speed that mean standstill, at least: one alone may be taken at a change of direction.
const STANDSTILL_READINGS_MIN: u32 = 3;
/// Time for a fault to appear after a motion ended elsewhere without another reason.
const LATE_FAULT_MAX: Duration = Duration::from_millis(900);
/// A turning motor goes on for the time of the start; what its drive counts from lags behind or leads.
const START_SLACK: f64 = 2.0;
/// Time for which a position may be unreadable after the drive reported the end of its motion.
const UNREADABLE_MAX: Duration = Duration::from_secs(5);

/// The end that a motion is to have.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum MotionGoal {
    /// A position. A relative move has two if it is not known what the drive counts from: its position,
    /// or its last target. None if neither is known.
    Position([Option<i64>; 2]),
    /// The drive's reference position.
    Reference,
    /// Standstill.
    Standstill,
    /// The end of whatever the drive does.
    Idle,
}

/// Values that were measured, or reported, after a command was started. `None` for values that were not read now.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Observation {
    /// Actual position, raw.
    pub position: Option<i64>,
    /// Actual speed, as the number that the raw value is.
    pub speed: Option<f64>,
    /// The drive's own report: true means that the motion is over.
    pub flag: Option<bool>,
    /// The drive's own report that its motor moves.
    pub moving: Option<bool>,
    /// Code of a fault that stops the drive; zero for none.
    pub fault: Option<u32>,
    /// The motor has power.
    pub enabled: Option<bool>,
    /// The positive and the negative limit hold the axis.
    pub positive_limit: Option<bool>,
    /// State of the negative limit.
    pub negative_limit: Option<bool>,
    /// Something holds the axis that this host did not send.
    pub halted: Option<bool>,
    /// The drive detected a stall.
    pub stalled: Option<bool>,
    /// Mode of operation, raw.
    pub mode: Option<i64>,
}

/// A limit that holds an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LimitEnd {
    /// The positive end.
    Positive,
    /// The negative end.
    Negative,
    /// The drive does not report which.
    Either,
}

/// Reason why a motion ended elsewhere than at its target.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum EndReason {
    /// A limit switch, or a limit of the drive.
    Limit(LimitEnd),
    /// Another master halted it.
    Halted,
    /// Another master set this mode of operation.
    Mode(i64),
    /// The drive detected a stall.
    Stalled,
    /// The motion was not seen to start.
    NotStarted,
    /// The drive reports none of these.
    Unknown,
}

/// Verdict on a motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotionVerdict {
    /// The motion continues, as far as is known.
    Pending,
    /// The motion ended elsewhere: reasons have to be read before the next verdict.
    Examine,
    /// The goal was measured.
    Arrived,
    /// The motion ended elsewhere.
    Ended(EndReason),
    /// The drive has this fault.
    Faulted(u32),
    /// The motor lost its power.
    PowerLost,
    /// The motion is over by the drive's own report, and no reading would prove its position.
    Unconfirmed,
}

/// The judge of one motion of one axis.
#[derive(Clone, Copy, Debug)]
pub struct MotionJudge {
    goal: MotionGoal,
    tolerance: Tolerance,
    /// Position before the command.
    start: Option<i64>,
    /// The flag before the command.
    flag_before: Option<bool>,
    /// Time at which that was read.
    start_at: Option<Instant>,
    /// True if the axis was at standstill before the command.
    stood_before: bool,
    /// The motion before it was not known to be over when the command was given.
    follows_motion: bool,
    /// Speed before the command, counts per second.
    speed_before: f64,
    /// The last request of the start was acknowledged, or its goal is waited for.
    since: Option<Instant>,
    started: bool,
    flag: Option<bool>,
    flag_since: Option<Instant>,
    flag_at: Option<Instant>,
    position: Option<i64>,
    position_at: Option<Instant>,
    /// The position that was not left since.
    anchor: Option<(i64, Instant)>,
    speed_at: Option<Instant>,
    /// Time since which the speed is below standstill, and the number of readings.
    slow_since: Option<Instant>,
    slow_readings: u32,
    /// The drive has no position, no speed.
    lacks_position: bool,
    lacks_speed: bool,
    was_enabled: bool,
    last: Observation,
    mode_before: Option<i64>,
    /// A fault code that the drive had before the command; some keep the last one for ever.
    fault_before: u32,
    /// The drive's own last target before the command.
    target_before: Option<i64>,
    is_relative: bool,
    /// Additional window, for an axis that turned when it was started.
    slack: f64,
    /// The reasons of an end were read since.
    examined_at: Option<Instant>,
}

impl MotionJudge {
    /// A judge of a motion that was not started yet.
    #[must_use]
    pub const fn new(goal: MotionGoal, tolerance: Tolerance) -> Self {
        const NOTHING: Observation = Observation {
            position: None,
            speed: None,
            flag: None,
            moving: None,
            fault: None,
            enabled: None,
            positive_limit: None,
            negative_limit: None,
            halted: None,
            stalled: None,
            mode: None,
        };
        Self {
            goal,
            tolerance,
            start: None,
            flag_before: None,
            start_at: None,
            stood_before: false,
            follows_motion: false,
            speed_before: 0.0,
            since: None,
            started: false,
            flag: None,
            flag_since: None,
            flag_at: None,
            position: None,
            position_at: None,
            anchor: None,
            speed_at: None,
            slow_since: None,
            slow_readings: 0,
            lacks_position: false,
            lacks_speed: false,
            was_enabled: false,
            last: NOTHING,
            mode_before: None,
            fault_before: 0,
            target_before: None,
            is_relative: false,
            slack: 0.0,
            examined_at: None,
        }
    }

    /// The end that the motion is to have.
    #[must_use]
    pub const fn goal(&self) -> MotionGoal {
        self.goal
    }

    /// Sets the goal, once the position before the start is known.
    pub const fn set_goal(&mut self, goal: MotionGoal) {
        self.goal = goal;
    }

    /// Tolerances of positions and speeds.
    #[must_use]
    pub const fn tolerance(&self) -> &Tolerance {
        &self.tolerance
    }

    /// Sets the greatest distance from the target.
    pub const fn set_window(&mut self, window: f64) {
        self.tolerance.window = window;
    }

    /// Position before the command.
    #[must_use]
    pub const fn start(&self) -> Option<i64> {
        self.start
    }

    /// The last position that was read.
    #[must_use]
    pub const fn position(&self) -> Option<i64> {
        self.position
    }

    /// The drive's own report, as it was read last.
    #[must_use]
    pub const fn flag(&self) -> Option<bool> {
        self.flag
    }

    /// The motion was seen to start.
    #[must_use]
    pub const fn has_started(&self) -> bool {
        self.started
    }

    /// The drive has no position, so that no arrival can be measured.
    pub const fn mark_without_position(&mut self) {
        self.lacks_position = true;
    }

    /// The drive has no speed.
    pub const fn mark_without_speed(&mut self) {
        self.lacks_speed = true;
    }

    /// The drive's own last target before the command.
    #[must_use]
    pub const fn target_before(&self) -> Option<i64> {
        self.target_before
    }

    /// The motion before this one is not known to be over.
    pub const fn mark_follows_motion(&mut self) {
        self.follows_motion = true;
    }

    /// Takes the drive's own last target before the command.
    pub const fn set_target_before(&mut self, target: i64) {
        self.target_before = Some(target);
    }

    /// The fault code that the drive had before the command.
    pub const fn set_fault_before(&mut self, code: u32) {
        self.fault_before = code;
    }

    /// The motor had power when the motion was waited for.
    pub const fn mark_enabled(&mut self) {
        self.was_enabled = true;
    }

    /// Takes values that were read before the start.
    pub fn observe_before(&mut self, now: Instant, seen: &Observation) {
        if seen.position.is_some() {
            self.start_at = Some(now);
        }
        self.start = seen.position.or(self.start);
        self.position = seen.position.or(self.position);
        self.flag_before = self.reported_end(seen).or(self.flag_before);
        self.fault_before = seen.fault.unwrap_or(self.fault_before);
        if let (Some(speed), Some(slow)) = (seen.speed, self.tolerance.standstill) {
            self.stood_before = speed.abs() <= slow;
            let counts = if slow > 0.0 { speed.abs() / slow * self.tolerance.drift } else { 0.0 };
            self.speed_before = if self.stood_before { 0.0 } else { counts };
        }
    }

    /// The start was acknowledged, or its goal is waited for from now on.
    pub fn begin(&mut self, now: Instant) {
        if self.since.is_some() {
            return;
        }
        self.since = Some(now);
        // A relative move of a turning motor counts from somewhere between the reading and the start.
        if let Some(at) = self.start_at.filter(|_| self.is_relative) {
            self.slack = START_SLACK * self.speed_before * now.since(at).as_secs_f64();
        }
    }

    /// The target was counted from where the axis was before the command.
    pub const fn mark_relative(&mut self) {
        self.is_relative = true;
    }

    /// Returns whether what decides the goal was read at `since` or later.
    #[must_use]
    pub fn is_current(&self, since: Instant) -> bool {
        let decides = match self.goal {
            MotionGoal::Position(_) if !self.lacks_position => self.position_at,
            _ => self.position_at.max(self.speed_at).max(self.flag_at),
        };
        decides.is_some_and(|at| at >= since)
    }

    /// Reasons of an end were read.
    pub fn mark_examined(&mut self, now: Instant) {
        self.examined_at.get_or_insert(now);
    }

    /// Takes values that were read after the start.
    pub fn observe(&mut self, now: Instant, seen: &Observation) {
        self.begin(now);
        if let Some(flag) = self.reported_end(seen) {
            self.started |= !flag;
            self.flag_at = Some(now);
            if self.flag != Some(flag) || self.flag_since.is_none() {
                self.flag_since = Some(now);
            }
            self.flag = Some(flag);
        }
        if let Some(position) = seen.position {
            self.observe_position(now, position);
        }
        if let Some(speed) = seen.speed {
            self.observe_speed(now, speed);
        }
        seen.mode.into_iter().for_each(|mode| self.observe_mode(mode));
        self.was_enabled |= seen.enabled == Some(true);
        let last = &mut self.last;
        *last = Observation {
            position: seen.position.or(last.position),
            speed: seen.speed.or(last.speed),
            flag: seen.flag.or(last.flag),
            moving: seen.moving.or(last.moving),
            fault: seen.fault.or(last.fault),
            enabled: seen.enabled.or(last.enabled),
            positive_limit: seen.positive_limit.or(last.positive_limit),
            negative_limit: seen.negative_limit.or(last.negative_limit),
            halted: seen.halted.or(last.halted),
            // Reading such a flag clears it in some drives.
            stalled: Some(last.stalled == Some(true) || seen.stalled == Some(true)),
            mode: seen.mode.or(last.mode),
        };
    }

    /// Records a mode reading of any request. The first after the start is the mode of the motion; a wait for its end
    /// may begin later.
    pub fn observe_mode(&mut self, mode: i64) {
        if self.since.is_some() {
            self.mode_before.get_or_insert(mode);
        }
    }

    /// The drive's own report that the motion is over. A motor may stand where no target was reached.
    fn reported_end(&self, seen: &Observation) -> Option<bool> {
        let stands = seen.moving.map(|moving| !moving);
        match self.goal {
            MotionGoal::Standstill => stands.or(seen.flag),
            _ => seen.flag.or(stands),
        }
    }

    fn observe_position(&mut self, now: Instant, position: i64) {
        let start = *self.start.get_or_insert(position);
        // More than noise: an encoder at rest flickers by a step.
        self.started |= self.tolerance.distance(start, position).abs() > self.tolerance.noise;
        let stays = self.anchor.is_some_and(|(anchor, _)| {
            self.tolerance.distance(anchor, position).abs() <= self.tolerance.noise
        });
        if !stays {
            self.anchor = Some((position, now));
        }
        (self.position, self.position_at) = (Some(position), Some(now));
    }

    fn observe_speed(&mut self, now: Instant, speed: f64) {
        let slow = speed.abs() <= self.tolerance.standstill.unwrap_or(0.0);
        if slow {
            self.slow_since.get_or_insert(now);
            self.slow_readings = self.slow_readings.saturating_add(1);
        } else {
            (self.slow_since, self.slow_readings) = (None, 0);
            // A servo that holds its position reports small speeds as well.
            self.started |= self.anchor.is_none() && self.lacks_position;
        }
        self.speed_at = Some(now);
    }

    /// Returns whether speeds and positions have shown standstill for `span`; if positions alone have to show it, for
    /// longer where they are coarse.
    fn rests(&self, span: Duration) -> bool {
        let slow = standing_time(self.slow_since, self.speed_at);
        let still = standing_time(self.anchor.map(|(_, since)| since), self.position_at);
        let slow_enough =
            self.slow_readings >= STANDSTILL_READINGS_MIN && slow.is_some_and(|slow| slow >= span);
        if self.lacks_position {
            return slow_enough;
        }
        let Some(still) = still else { return false };
        slow_enough && still >= span || still >= self.tolerance.coarse_span(span)
    }

    /// Returns whether the axis is at its target, by the last position.
    #[must_use]
    pub fn is_at_target(&self) -> bool {
        let MotionGoal::Position(targets) = self.goal else { return false };
        let Some(position) = self.position.filter(|_| self.position_at.is_some()) else {
            return false;
        };
        let window = self.tolerance.window + self.slack;
        debug_assert!(window >= 0.0);
        targets.into_iter().flatten().any(|target| self.distance_to(position, target) <= window)
    }

    fn distance_to(&self, position: i64, target: i64) -> f64 {
        self.tolerance.distance(position, target).abs()
    }

    /// The target: of two, the nearer one to where the axis is.
    #[must_use]
    pub fn target(&self) -> Option<i64> {
        let MotionGoal::Position([first, second]) = self.goal else { return None };
        match (first, second, self.position) {
            (Some(a), Some(b), Some(position))
                if self.distance_to(position, b) < self.distance_to(position, a) =>
            {
                Some(b)
            }
            (first, second, _) => first.or(second),
        }
    }

    /// Verdict at `now`.
    #[must_use]
    pub fn verdict(&self, now: Instant) -> MotionVerdict {
        if self.goal != MotionGoal::Standstill
            && let Some(verdict) = self.judge_power()
        {
            return verdict;
        }
        match self.goal {
            MotionGoal::Position(_) => self.judge_position(now),
            MotionGoal::Reference => self.judge_reference(now),
            MotionGoal::Standstill => self.judge_standstill(),
            MotionGoal::Idle => self.judge_idle(),
        }
    }

    /// Faults and lost power, which end every motion.
    fn judge_power(&self) -> Option<MotionVerdict> {
        let lost =
            self.last.enabled == Some(false) && (self.was_enabled || self.examined_at.is_some());
        let is_new = |code: &u32| *code != 0 && (lost || *code != self.fault_before);
        match (self.last.fault.filter(is_new), lost) {
            (Some(code), _) => Some(MotionVerdict::Faulted(code)),
            // The fault may appear a moment after the power is gone.
            (None, true) if self.examined_at.is_some() => Some(MotionVerdict::PowerLost),
            (None, true) => Some(MotionVerdict::Examine),
            (None, false) => None,
        }
    }

    fn waited(&self, now: Instant) -> Duration {
        self.since.map_or(Duration::ZERO, |since| now.since(since))
    }

    /// Time for which the flag has been set.
    fn flagged(&self, now: Instant) -> Option<Duration> {
        self.flag_since.filter(|_| self.flag == Some(true)).map(|since| now.since(since))
    }

    fn judge_position(&self, now: Instant) -> MotionVerdict {
        let MotionGoal::Position(targets) = self.goal else { return MotionVerdict::Pending };
        let flagged = self.flagged(now);
        if self.lacks_position || targets == [None; 2] {
            return self.judge_without_position(now);
        }
        let Some(position_at) = self.position_at else {
            let over = flagged.is_some_and(|flagged| flagged >= UNREADABLE_MAX);
            return if over { MotionVerdict::Unconfirmed } else { MotionVerdict::Pending };
        };
        let at_target = self.is_at_target();
        // A flag from before this position was read belongs to it; one from after it may be of the next
        // motion.
        if at_target
            && self.flag == Some(true)
            && self.flag_since.is_some_and(|at| at <= position_at)
        {
            return MotionVerdict::Arrived;
        }
        // Without a flag that agrees, rest decides.
        let rest = self.tolerance.motion_rest();
        if !self.rests(rest) {
            return MotionVerdict::Pending;
        }
        if at_target {
            return MotionVerdict::Arrived;
        }
        let reported = flagged.is_some_and(|flagged| flagged >= STALE_FLAG_MAX);
        let is_over = self.started && (self.flag != Some(false) || self.left_start())
            || reported
            || self.waited(now) >= START_MAX;
        self.conclude(now, is_over)
    }

    /// The verdict of a motion that is over elsewhere than at its goal.
    fn conclude(&self, now: Instant, is_over: bool) -> MotionVerdict {
        let Some(examined_at) = self.examined_at.filter(|_| is_over) else {
            return if is_over { MotionVerdict::Examine } else { MotionVerdict::Pending };
        };
        match self.end_reason() {
            // A drive may detect later why its motor stopped.
            EndReason::Unknown | EndReason::NotStarted
                if now.since(examined_at) < LATE_FAULT_MAX =>
            {
                MotionVerdict::Pending
            }
            reason => MotionVerdict::Ended(reason),
        }
    }

    /// Returns whether the axis is, or was, elsewhere than before the command.
    fn left_start(&self) -> bool {
        self.start
            .zip(self.position)
            .is_some_and(|(start, position)| self.has_moved(start, position))
    }

    fn has_moved(&self, start: i64, position: i64) -> bool {
        self.tolerance.distance(start, position).abs() > self.tolerance.noise
    }

    /// The end of a motion of which no position can be known.
    fn judge_without_position(&self, now: Instant) -> MotionVerdict {
        let rests = self.rests(REST_MIN);
        let over = match self.flagged(now) {
            Some(flagged) => self.started || flagged >= STALE_FLAG_MAX,
            None if self.flag == Some(false) => false,
            None => rests && (self.started || self.waited(now) >= START_MAX),
        };
        let nothing = self.flag.is_none() && self.lacks_position && self.lacks_speed;
        if over || nothing { MotionVerdict::Unconfirmed } else { MotionVerdict::Pending }
    }

    fn judge_reference(&self, now: Instant) -> MotionVerdict {
        let started = self.started || self.left_start();
        let flagged = self.flagged(now);
        if flagged.is_some() && started {
            return MotionVerdict::Arrived;
        }
        let ignored = flagged.is_some_and(|flagged| flagged >= STALE_FLAG_MAX);
        let stuck = self.flag != Some(true) && self.rests(HOMING_REST_MIN);
        self.conclude(now, ignored || stuck)
    }

    fn judge_standstill(&self) -> MotionVerdict {
        if self.rests(STANDSTILL_SPAN) {
            return MotionVerdict::Arrived;
        }
        // Nothing can be measured: the drive's own report is all there is.
        if self.lacks_position && self.lacks_speed && self.flag != Some(false) {
            MotionVerdict::Unconfirmed
        } else {
            MotionVerdict::Pending
        }
    }

    fn judge_idle(&self) -> MotionVerdict {
        let measured = !(self.lacks_position && self.lacks_speed);
        let rests = self.rests(STANDSTILL_SPAN);
        match self.flag {
            Some(true) if rests || !measured => MotionVerdict::Arrived,
            None if self.rests(REST_MIN) => MotionVerdict::Arrived,
            None if !measured => MotionVerdict::Unconfirmed,
            _ => MotionVerdict::Pending,
        }
    }

    fn end_reason(&self) -> EndReason {
        // A homing runs into its limit switch on purpose.
        if let Some(end) = self.limit().filter(|_| self.goal != MotionGoal::Reference) {
            return EndReason::Limit(end);
        }
        if self.last.halted == Some(true) {
            return EndReason::Halted;
        }
        if self.last.stalled == Some(true) {
            return EndReason::Stalled;
        }
        if let (Some(before), Some(mode)) = (self.mode_before, self.last.mode)
            && before != mode
        {
            return EndReason::Mode(mode);
        }
        if self.started && self.left_start() { EndReason::Unknown } else { EndReason::NotStarted }
    }

    /// The limit that holds the axis on its way.
    fn limit(&self) -> Option<LimitEnd> {
        let (positive, negative) =
            (self.last.positive_limit == Some(true), self.last.negative_limit == Some(true));
        let way = self.position.zip(self.target()).map(|(at, to)| self.tolerance.distance(at, to));
        match (positive, negative) {
            (true, true) => Some(LimitEnd::Either),
            (true, false) if way.is_none_or(|way| way > 0.0) => Some(LimitEnd::Positive),
            (false, true) if way.is_none_or(|way| way < 0.0) => Some(LimitEnd::Negative),
            _ => None,
        }
    }

    /// Returns whether values after a start that was not acknowledged prove that the drive executed it.
    #[must_use]
    pub fn proves_start(&self) -> bool {
        // That motion changes the position by itself, and had perhaps not cleared the flag yet.
        if self.follows_motion {
            return false;
        }
        let flag_fell = self.flag_before == Some(true) && self.flag == Some(false);
        flag_fell || self.stood_before && self.goes_to_target()
    }

    /// Returns whether the axis went towards its target, and farther than one that counts as standing may drift.
    fn goes_to_target(&self) -> bool {
        let (Some(start), Some(position)) = (self.start, self.position) else { return false };
        let elapsed = self.position_at.zip(self.start_at).map(|(at, from)| at.since(from));
        let drift = self.tolerance.drift * elapsed.map_or(0.0, |elapsed| elapsed.as_secs_f64());
        let way = self.tolerance.distance(start, position);
        let towards = self
            .target()
            .is_none_or(|to| (self.tolerance.distance(start, to) > 0.0) == (way > 0.0));
        towards && way.abs() > self.tolerance.noise + drift
    }
}

fn standing_time(since: Option<Instant>, last: Option<Instant>) -> Option<Duration> {
    since.zip(last).map(|(since, last)| last.since(since))
}

#[cfg(test)]
mod tests;
