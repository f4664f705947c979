//! Observes a drive directly: invariants of its motor after every event, independent of its host.
//!
//! Why: SWARM-1.

#[cfg(test)]
mod tests;

use polepair_core::plant::TICK_S;
use polepair_core::time::Instant;
use polepair_drives::surroundings::{GroundTruth, ServoBounds};

/// The loops of a drive may overshoot a speed by this share of the step to it, and by a speed in rad/s. A PI loop that
/// is critically damped overshoots a step by e⁻² of it (`Gains::tuned`): its answer to a step is 1 - e^-ωt (1 - ωt),
/// which is greatest at ωt = 2. The step may be from as fast the other way: a set-point that stops at once, as AXISON
/// has it on an axis that is on, leaves the motor's speed to the loops.
const OVERSHOOT: (f64, f64) = (0.136, 5.0);
/// Time, ms, after which nothing of that is left: e^-ωt (ωt - 1) at 120 rad/s is below 0.04.
const SETTLED_MS: u32 = 40;
/// And a current by this share.
const RIPPLE: f64 = 0.05;
/// Tolerance for rounding.
const ROUNDING: f64 = 1e-6;
/// Greatest excess of a new ramp's first speed over its set-point, rad/s.
const LEAD: f64 = 0.1;
/// Greatest deviation of a motor from the path of a move, rad.
const STRAY_MAX: f64 = 0.3;
/// Looks at speed and current are so far apart, ms, that the loops have settled between them.
const CHECK_INTERVAL_MS: u32 = 10;
/// Time after the end of a ticket by which its last byte has arrived, ms: pieces pause on the way, and a drive may wait
/// for silence.
const LANDED_MS: u32 = 200;
/// Slower than this a motor rests, rad/s; after so long a rest, ms, nothing of an earlier move is
/// to come.
const REST: (f64, u32) = (0.05, 300);

/// Violated invariant, and a description.
pub type MotionViolation = (&'static str, String);

/// Observations of one drive.
#[derive(Debug, Default)]
pub struct MotionObserver {
    last_check: Option<(Instant, GroundTruth)>,
    /// Nothing that may set the motor going is open since then.
    quiet_since: Option<Instant>,
    /// Starts of the motor when the last frame had arrived.
    settled_starts: Option<u64>,
    /// Unrepeatable requests executed by then, and the verbs requested since, each of which may be executed once.
    settled_executions: Option<u64>,
    pending_verbs: u64,
    /// True if the link was lost, and the axis was not armed since.
    link_lost: bool,
    rest_since: Option<Instant>,
    /// Between where a move began and where it ends, rad.
    path: Option<(f64, f64)>,
    /// Ranges of the recent speeds: since then, and before that.
    recent_speeds: [Option<SpeedRange>; 2],
}

/// Between which speeds a motor turned, rad/s, since an instant.
#[derive(Clone, Copy, Debug)]
struct SpeedRange {
    since: Instant,
    low: f64,
    high: f64,
}

impl MotionObserver {
    /// Records a verb that starts the motor, by `by` rad from its present position.
    pub fn record_verb(&mut self, now: Instant, truth: &GroundTruth, by: Option<f64>) {
        // A motor that was held back goes to its set-point first.
        let lag = truth.setpoint.map_or(0.0, |setpoint| setpoint.position - truth.position);
        let rested = lasts_long(self.rest_since, now)
            && lasts_long(self.quiet_since, now)
            && lag.abs() < STRAY_MAX / 2.0;
        let to = by.filter(|_| rested).map(|by| truth.position + by);
        self.path = to.map(|to| (truth.position.min(to), truth.position.max(to)));
        self.pending_verbs += 1;
        self.link_lost = false;
        self.quiet_since = None;
    }

    /// Records that `count` frames of the host were received twice: their requests may be executed twice.
    pub fn record_duplicates(&mut self, count: u64) {
        self.pending_verbs += count;
        self.path = self.path.filter(|_| count == 0);
    }

    /// The link was lost: the axis is disarmed.
    pub fn record_link_lost(&mut self) {
        self.link_lost = true;
    }

    /// Returns whether the motor has been at rest since then.
    pub fn rested_since(&self, then: Instant) -> bool {
        self.rest_since.is_some_and(|since| since <= then)
    }

    /// Records that the drive lost its supply, or may have executed a request of no host.
    pub fn invalidate(&mut self) {
        *self = Self { link_lost: self.link_lost, ..Self::default() };
    }

    /// Checks the drive. `going` is true if a verb is open which may start its motor.
    pub fn check(
        &mut self,
        now: Instant,
        truth: GroundTruth,
        going: bool,
    ) -> Option<MotionViolation> {
        self.record_speed(now, truth.velocity);
        let found = self.check_starts(now, &truth, going).or_else(|| self.check_path(&truth));
        let found = found.or_else(|| self.check_bounds(now, &truth));
        if truth.velocity.abs() > REST.0 {
            self.rest_since = None;
        } else {
            self.rest_since.get_or_insert(now);
        }
        let due = self.last_check.is_none_or(|(at, before)| {
            now >= at.plus_ms(CHECK_INTERVAL_MS) || !same_conditions(&before, &truth)
        });
        if due {
            self.last_check = Some((now, truth));
        }
        found
    }

    /// Notes how fast the motor turns.
    fn record_speed(&mut self, now: Instant, velocity: f64) {
        let fresh = SpeedRange { since: now, low: velocity, high: velocity };
        let range = match self.recent_speeds[0] {
            Some(range) if now < range.since.plus_ms(SETTLED_MS) => range,
            before => {
                self.recent_speeds[1] = before.filter(|b| now < b.since.plus_ms(2 * SETTLED_MS));
                fresh
            }
        };
        let (low, high) = (range.low.min(velocity), range.high.max(velocity));
        self.recent_speeds[0] = Some(SpeedRange { low, high, ..range });
    }

    /// Highest recent speed against that direction, rad/s.
    fn speed_against(&self, direction: f64) -> f64 {
        let ranges = self.recent_speeds.iter().flatten();
        let speeds = ranges.map(|range| if direction < 0.0 { range.high } else { -range.low });
        speeds.fold(0.0, f64::max)
    }

    /// Each verb is executed once at most, and nothing is once all have ended.
    fn check_starts(
        &mut self,
        now: Instant,
        truth: &GroundTruth,
        going: bool,
    ) -> Option<MotionViolation> {
        let executed = self.settled_executions.map_or(0, |before| truth.unrepeatable - before);
        if executed > self.pending_verbs {
            let requested = self.pending_verbs;
            self.settled_executions = None;
            return Some(("I2", format!("{executed} executions of {requested} verbs")));
        }
        if going {
            (self.quiet_since, self.settled_starts) = (None, None);
            return None;
        }
        let quiet = *self.quiet_since.get_or_insert(now);
        if now < quiet.plus_ms(LANDED_MS) {
            return None;
        }
        (self.settled_executions, self.pending_verbs) = (Some(truth.unrepeatable), 0);
        let before = self.settled_starts.replace(truth.starts)?;
        (before != truth.starts).then(|| {
            if self.link_lost {
                ("I6", "the motor was set going after the link was lost".into())
            } else {
                ("I4", "the motor was set going when nobody waited for it".into())
            }
        })
    }

    /// A move from rest stays between where it begins and where it ends.
    fn check_path(&mut self, truth: &GroundTruth) -> Option<MotionViolation> {
        let (from, to) = self.path?;
        if !truth.enabled && self.rest_since.is_none() {
            self.path = None; // it coasts
            return None;
        }
        if (from - STRAY_MAX..=to + STRAY_MAX).contains(&truth.position) {
            return None;
        }
        self.path = None;
        let here = truth.position;
        Some(("I14", format!("at {here:.3} rad on the way between {from:.3} and {to:.3}")))
    }

    /// Speed, gain of speed and current are what the drive is held to: the set-point's exactly, the
    /// motor's as well as its loops can.
    fn check_bounds(&self, now: Instant, truth: &GroundTruth) -> Option<MotionViolation> {
        let (at, before) = self.last_check?;
        let (was, is) = (before.setpoint?, truth.setpoint?);
        if now < at.plus_ms(CHECK_INTERVAL_MS) || !same_conditions(&before, truth) {
            return None;
        }
        let ServoBounds { velocity, acceleration, current } = truth.bounds;
        let (requested, asked_before) = (is.velocity.abs(), was.velocity.abs());
        if requested > velocity.max(asked_before) + ROUNDING {
            return Some(("I14", format!("set to {requested:.2} rad/s, held to {velocity:.2}")));
        }
        let (turns, turned) = (truth.velocity.abs(), before.velocity.abs());
        // A drive may start its ramp anew from the motor, as fast as that is.
        let (seconds, slowest) = (now.since(at).as_secs_f64(), asked_before.max(turned));
        if requested - slowest > acceleration * (seconds + TICK_S) + LEAD {
            let (gain, ms) = ((requested - slowest) / seconds, seconds * 1e3);
            let what = format!("set to {gain:.1} rad/s² for {ms:.1} ms, held to {acceleration:.1}");
            return Some(("I14", what));
        }
        let top = velocity.max(requested).max(asked_before).max(turned);
        let step = top + self.speed_against(truth.velocity);
        if turns > top + OVERSHOOT.0 * step + OVERSHOOT.1 {
            let lag = is.position - truth.position;
            let what = format!(
                "turns at {turns:.2} rad/s, held to {velocity:.2}, set to {requested:.2} and {lag:.3} rad behind"
            );
            return Some(("I14", what));
        }
        let drawn = truth.current.abs();
        let over = drawn > current * (1.0 + RIPPLE) + ROUNDING;
        over.then(|| ("I14", format!("draws {drawn:.2} A, held to {current:.2}")))
    }
}

fn lasts_long(since: Option<Instant>, now: Instant) -> bool {
    since.is_some_and(|at| now >= at.plus_ms(REST.1))
}

/// Returns whether the drive is held to the same as before, and does the same: a ramp may start anew from a motor that
/// is faster than its set-point.
fn same_conditions(before: &GroundTruth, truth: &GroundTruth) -> bool {
    before.bounds == truth.bounds
        && before.enabled == truth.enabled
        && before.starts == truth.starts
}
