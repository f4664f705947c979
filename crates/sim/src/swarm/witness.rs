//! Who stands beside a drive and sees all that it does: what must hold of its motor after every
//! event, whatever its host believes.
//!
//! Why: SWARM-1.

#[cfg(test)]
mod tests;

use polepair_core::drives::bench::{Bounds, Truth};
use polepair_core::plant::TICK_S;
use polepair_core::time::Instant;

/// The loops of a drive may overshoot a speed by this share of the step to it, and by so many rad/s. A PI
/// loop that is critically damped overshoots a step by e⁻² of it (`Gains::tuned`): its answer to a step is
/// 1 - e^-ωt (1 - ωt), which is greatest at ωt = 2. The step may be from as fast the other way: a set-point
/// that stops at once, as AXISON has it on an axis that is on, leaves the motor's speed to the loops.
const OVERSHOOT: (f64, f64) = (0.136, 5.0);
/// After so long, ms, nothing of that is left: e^-ωt (ωt - 1) at 120 rad/s is below 0.04.
const SETTLED_MS: u32 = 40;
/// And a current by this share.
const RIPPLE: f64 = 0.05;
/// What rounding may add.
const ROUNDING: f64 = 1e-6;
/// A ramp that starts anew from the motor starts so much, rad/s, above its set-point.
const LEAD: f64 = 0.1;
/// A motor may leave the way of a move by so much, rad.
const STRAY_MAX: f64 = 0.3;
/// Looks at speed and current are so far apart, ms, that the loops have settled between them.
const STRIDE_MS: u32 = 10;
/// So long after a ticket has ended the last byte of it has landed: pieces pause on the way, and a
/// drive may wait for silence.
const LANDED_MS: u32 = 200;
/// Slower than this a motor rests, rad/s; after so long a rest, ms, nothing of an earlier move is
/// to come.
const REST: (f64, u32) = (0.05, 300);

/// What is wrong, and which invariant it breaks.
pub type Found = (&'static str, String);

/// What was seen of one drive.
#[derive(Debug, Default)]
pub struct Witness {
    seen: Option<(Instant, Truth)>,
    /// Nothing that may set the motor going is open since then.
    quiet: Option<Instant>,
    /// What had set the motor going when the last of it had landed.
    landed: Option<u64>,
    /// What is not repeatable and had been executed by then, and the verbs asked since, each of
    /// which may be executed once.
    executed: Option<u64>,
    asked: u64,
    /// The link was lost, and nobody armed the axis since.
    lost: bool,
    rests: Option<Instant>,
    /// Between where a move began and where it ends, rad.
    way: Option<(f64, f64)>,
    /// How fast it turned lately: since then, and before that.
    lately: [Option<Range>; 2],
}

/// Between which speeds a motor turned, rad/s, since an instant.
#[derive(Clone, Copy, Debug)]
struct Range {
    since: Instant,
    low: f64,
    high: f64,
}

impl Witness {
    /// A verb is asked that sets the motor going, `by` so many rad from where it is now.
    pub fn asked(&mut self, now: Instant, truth: &Truth, by: Option<f64>) {
        let long = |since: Option<Instant>| since.is_some_and(|at| now >= at.plus_ms(REST.1));
        // A motor that was held back goes to its set-point first.
        let lag = truth.setpoint.map_or(0.0, |setpoint| setpoint.position - truth.position);
        let rested = long(self.rests) && long(self.quiet) && lag.abs() < STRAY_MAX / 2.0;
        let to = by.filter(|_| rested).map(|by| truth.position + by);
        self.way = to.map(|to| (truth.position.min(to), truth.position.max(to)));
        self.asked += 1;
        self.lost = false;
        self.quiet = None;
    }

    /// So many frames of the host were taken twice: whatever they asked may be done twice.
    pub fn doubled(&mut self, count: u64) {
        self.asked += count;
        self.way = self.way.filter(|_| count == 0);
    }

    /// The link was lost: the axis is disarmed.
    pub fn lost(&mut self) {
        self.lost = true;
    }

    /// Whether the motor has been at rest since then.
    pub fn rested_since(&self, then: Instant) -> bool {
        self.rests.is_some_and(|since| since <= then)
    }

    /// The drive lost its supply, or may have done what nobody asked for.
    pub fn forget(&mut self) {
        *self = Self { lost: self.lost, ..Self::default() };
    }

    /// Looks at the drive. `going` says that a verb is open which may set its motor going.
    pub fn look(&mut self, now: Instant, truth: Truth, going: bool) -> Option<Found> {
        self.note(now, truth.velocity);
        let found = self.started(now, &truth, going).or_else(|| self.strayed(&truth));
        let found = found.or_else(|| self.beyond(now, &truth));
        if truth.velocity.abs() > REST.0 {
            self.rests = None;
        } else {
            self.rests.get_or_insert(now);
        }
        let due = self
            .seen
            .is_none_or(|(at, before)| now >= at.plus_ms(STRIDE_MS) || !alike(&before, &truth));
        if due {
            self.seen = Some((now, truth));
        }
        found
    }

    /// Notes how fast the motor turns.
    fn note(&mut self, now: Instant, velocity: f64) {
        let fresh = Range { since: now, low: velocity, high: velocity };
        let range = match self.lately[0] {
            Some(range) if now < range.since.plus_ms(SETTLED_MS) => range,
            before => {
                self.lately[1] = before.filter(|b| now < b.since.plus_ms(2 * SETTLED_MS));
                fresh
            }
        };
        let (low, high) = (range.low.min(velocity), range.high.max(velocity));
        self.lately[0] = Some(Range { low, high, ..range });
    }

    /// How fast it turned lately against that direction, rad/s.
    fn against(&self, direction: f64) -> f64 {
        let ranges = self.lately.iter().flatten();
        let speeds = ranges.map(|range| if direction < 0.0 { range.high } else { -range.low });
        speeds.fold(0.0, f64::max)
    }

    /// Each verb is executed once at most, and nothing is once all have ended.
    fn started(&mut self, now: Instant, truth: &Truth, going: bool) -> Option<Found> {
        let executed = self.executed.map_or(0, |before| truth.unrepeatable - before);
        if executed > self.asked {
            let asked = self.asked;
            self.executed = None;
            return Some(("I2", format!("{executed} executions of {asked} verbs")));
        }
        if going {
            (self.quiet, self.landed) = (None, None);
            return None;
        }
        let quiet = *self.quiet.get_or_insert(now);
        if now < quiet.plus_ms(LANDED_MS) {
            return None;
        }
        (self.executed, self.asked) = (Some(truth.unrepeatable), 0);
        let before = self.landed.replace(truth.starts)?;
        (before != truth.starts).then(|| match self.lost {
            true => ("I6", "the motor was set going after the link was lost".into()),
            false => ("I4", "the motor was set going when nobody waited for it".into()),
        })
    }

    /// A move from rest stays between where it begins and where it ends.
    fn strayed(&mut self, truth: &Truth) -> Option<Found> {
        let (from, to) = self.way?;
        if !truth.enabled && self.rests.is_none() {
            self.way = None; // it coasts
            return None;
        }
        if (from - STRAY_MAX..=to + STRAY_MAX).contains(&truth.position) {
            return None;
        }
        self.way = None;
        let here = truth.position;
        Some(("I14", format!("at {here:.3} rad on the way between {from:.3} and {to:.3}")))
    }

    /// Speed, gain of speed and current are what the drive is held to: the set-point's exactly, the
    /// motor's as well as its loops can.
    fn beyond(&self, now: Instant, truth: &Truth) -> Option<Found> {
        let (at, before) = self.seen?;
        let (was, is) = (before.setpoint?, truth.setpoint?);
        if now < at.plus_ms(STRIDE_MS) || !alike(&before, truth) {
            return None;
        }
        let Bounds { velocity, acceleration, current } = truth.bounds;
        let (asked, asked_before) = (is.velocity.abs(), was.velocity.abs());
        if asked > velocity.max(asked_before) + ROUNDING {
            return Some(("I14", format!("set to {asked:.2} rad/s, held to {velocity:.2}")));
        }
        let (turns, turned) = (truth.velocity.abs(), before.velocity.abs());
        // A drive may start its ramp anew from the motor, as fast as that is.
        let (seconds, slowest) = (now.since(at).as_secs_f64(), asked_before.max(turned));
        if asked - slowest > acceleration * (seconds + TICK_S) + LEAD {
            let (gain, ms) = ((asked - slowest) / seconds, seconds * 1e3);
            let what = format!("set to {gain:.1} rad/s² for {ms:.1} ms, held to {acceleration:.1}");
            return Some(("I14", what));
        }
        let top = velocity.max(asked).max(asked_before).max(turned);
        let step = top + self.against(truth.velocity);
        if turns > top + OVERSHOOT.0 * step + OVERSHOOT.1 {
            let lag = is.position - truth.position;
            let what = format!(
                "turns at {turns:.2} rad/s, held to {velocity:.2}, set to {asked:.2} and {lag:.3} rad behind"
            );
            return Some(("I14", what));
        }
        let drawn = truth.current.abs();
        let over = drawn > current * (1.0 + RIPPLE) + ROUNDING;
        over.then(|| ("I14", format!("draws {drawn:.2} A, held to {current:.2}")))
    }
}

/// Whether the drive is held to the same as before, and does the same: a ramp may start anew from a
/// motor that is faster than its set-point.
fn alike(before: &Truth, truth: &Truth) -> bool {
    before.bounds == truth.bounds
        && before.enabled == truth.enabled
        && before.starts == truth.starts
}
