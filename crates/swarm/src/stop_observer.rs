//! An observer that knows the truth of a motor and its pending stop, whatever the bench believes.

#[cfg(test)]
mod tests;

use std::time::Duration;

use polepair_core::time::Instant;
use polepair_drives::surroundings::GroundTruth;
use polepair_serve::message::StopClass;

use crate::drives::DriveKind;

/// A powered motor that is faster turns, rad/s: above what any drive's stop takes for standing.
const TURNING_SPEED: f64 = 1.0;
/// A shaft is at its target if it is so near, rad: the window of 0.5 deg, and what a servo swings.
const ARRIVAL_WINDOW: f64 = 0.03;
/// Time in which an axis with a pending stop has executed it, once its wire works.
const STOP_ARRIVAL: Duration = Duration::from_secs(3);
/// Longest interval at which the command worker checks its link; an alarm may be as late, and a little.
const ALARM_DELAY: Duration = Duration::from_millis(250);
/// Time without an alarm that a stop of the lease's holder has while it goes well.
const HOLDER_STOP_GRACE: Duration = Duration::from_secs(2);
/// Shortest rest that is no turning point of a swinging motor.
const REST_MIN: Duration = Duration::from_millis(60);
/// Longest time to the reply of a stop.
pub const STOP_REPLY_MAX: Duration = Duration::from_millis(10_300);

/// An invariant that was found broken, and how.
pub type StopViolation = (&'static str, String);

/// Knowledge about one axis.
#[derive(Debug)]
pub struct StopObserver {
    /// Kind of the drive.
    pub kind: &'static DriveKind,
    /// The wire that it is on.
    pub wire: usize,
    /// True state of its motor.
    pub truth: GroundTruth,
    /// Since when it turns by its drive's power; `None` where it does not.
    turning_since: Option<Instant>,
    /// Time since which it is at standstill.
    standing_since: Option<Instant>,
    /// Time since which a stop is pending, by the requests and the bench's reports on its lease.
    pub stop_pending_since: Option<Instant>,
    /// True if the holder of its lease requested that stop, and no other client since.
    asked_by_holder: bool,
    /// Epoch of its lease, while a client holds it.
    pub epoch: Option<u64>,
    /// Since when that lease is held, and when its holder last had it move.
    lease_since: Instant,
    moved_at: Instant,
    /// Epoch of its last motion command.
    pub moved_epoch: Option<u64>,
    /// Commands under way that move it.
    pub open_commands: u32,
    /// Time of its last stop of any client: what a stop writes may look like motion.
    pub stopped_at: Instant,
    /// True if its drive lost its supply, or steps: positions have another origin since.
    pub counts_anew: bool,
    /// Commanded target, rad, and the time at which that was done; `None` once anything else may have moved it.
    pub target: Option<(f64, Instant)>,
    /// Time until which a command of unknown outcome may still be executed.
    pub unknown_until: Instant,
    /// The alarm as the bench shows it, since when; `None` where benches have none.
    alarm: Option<Option<Instant>>,
    /// A stop that was acknowledged, and what had been started by then.
    acknowledged_stop: Option<(Instant, u64)>,
    reported: Vec<&'static str>,
}

impl StopObserver {
    /// Creates the observer of an axis at standstill.
    pub fn new(kind: &'static DriveKind, wire: usize) -> Self {
        Self {
            kind,
            wire,
            truth: GroundTruth::default(),
            turning_since: None,
            standing_since: Some(Instant::ZERO),
            stop_pending_since: None,
            asked_by_holder: false,
            epoch: None,
            lease_since: Instant::ZERO,
            moved_at: Instant::ZERO,
            moved_epoch: None,
            open_commands: 0,
            stopped_at: Instant::ZERO,
            counts_anew: false,
            target: None,
            unknown_until: Instant::ZERO,
            alarm: None,
            acknowledged_stop: None,
            reported: Vec::new(),
        }
    }

    /// Returns whether it turns by its drive's power.
    pub fn is_turning(&self) -> bool {
        self.turning_since.is_some()
    }

    /// Requires standstill from now on.
    pub fn require_stop(&mut self, now: Instant) {
        self.stopped_at = now;
        self.target = None;
        if std::mem::take(&mut self.asked_by_holder) {
            // From now on its stop is pending together with its alarm.
            self.stop_pending_since = None;
        }
        self.stop_pending_since.get_or_insert(now);
    }

    /// [`require_stop`](Self::require_stop) by the holder of that lease: its next motion command ends it.
    pub fn require_holder_stop(&mut self, epoch: u64, now: Instant) {
        if self.epoch == Some(epoch) && self.stop_pending_since.is_none() {
            (self.stop_pending_since, self.asked_by_holder) = (Some(now), true);
        }
    }

    /// Records the new holder of its lease, or none.
    pub fn record_lease(&mut self, epoch: Option<u64>, now: Instant) {
        if self.epoch.is_some() && self.epoch != epoch {
            self.stopped_at = now;
            if self.moved_epoch == self.epoch {
                self.require_stop(now);
            }
        }
        if self.epoch != epoch {
            self.lease_since = now;
            self.target = None;
        }
        self.epoch = epoch;
    }

    /// Records a motion command of the holder of that lease.
    pub fn record_motion_order(&mut self, epoch: u64, now: Instant) {
        if self.epoch == Some(epoch) {
            self.moved_at = now;
            if self.asked_by_holder {
                self.stop_pending_since = None;
            }
        }
    }

    /// A command that moves it was done under its lease: it is commanded again.
    pub fn record_motion_done(&mut self, sent_at: Instant) {
        if self.stop_pending_since.is_some_and(|pending| pending < sent_at) && self.epoch.is_some()
        {
            self.stop_pending_since = None;
        }
    }

    /// Checks a report of arrival to a client that asked at that time.
    pub fn check_arrival(&self, asked_at: Instant) -> Option<StopViolation> {
        let (target, since) =
            self.target.filter(|_| self.unknown_until < asked_at && !self.counts_anew)?;
        let position = self.truth.position;
        let is_elsewhere = (position - target).abs() > ARRIVAL_WINDOW;
        (since < asked_at && is_elsewhere)
            .then(|| ("G13", format!("told `arrived` at {target:.3} rad, and is at {position:.3}")))
    }

    /// Checks the reported class of a stop.
    pub fn check_stop_report(&mut self, class: StopClass, now: Instant) -> Option<StopViolation> {
        let speed = self.truth.velocity;
        match class {
            StopClass::Standing if self.is_turning() => {
                Some(("G5", format!("told `standing`, and turns at {speed:.2} rad/s")))
            }
            StopClass::Acknowledged => {
                self.acknowledged_stop.get_or_insert((now, self.truth.starts));
                None
            }
            _ => None,
        }
    }

    /// Takes the present truth, and returns violations. `alarm` is whether the bench reports a pending stop, `None`
    /// where benches report none; `dismissed` that a client dismissed it.
    pub fn check(
        &mut self,
        now: Instant,
        truth: GroundTruth,
        well: Option<Instant>,
        alarm: Option<bool>,
        dismissed: bool,
    ) -> Vec<StopViolation> {
        self.truth = truth;
        let (fast, powered) = (truth.velocity.abs() > TURNING_SPEED, truth.enabled);
        self.turning_since = (fast && powered).then(|| self.turning_since.unwrap_or(now));
        self.standing_since = (!fast).then(|| self.standing_since.unwrap_or(now));
        if self.is_turning() && (self.epoch.is_none() || self.moved_epoch != self.epoch) {
            self.require_stop(now);
        }
        let mut found = Vec::new();
        self.check_alarm(now, well, alarm, dismissed, &mut found);
        let rests = self.standing_since.is_some_and(|since| now.since(since) >= REST_MIN);
        if rests && !matches!(self.alarm, Some(Some(_))) {
            self.stop_pending_since = None;
        }
        if dismissed {
            self.stop_pending_since = None;
        }
        let ramp = Duration::from_millis(u64::from(self.kind.ramp_ms));
        if let (Some(pending), Some(well), Some(turns)) =
            (self.stop_pending_since, well, self.turning_since)
            && now.since(pending.max(well)) > STOP_ARRIVAL + ramp
            && now.since(turns) > ramp
        {
            let (outstanding, well) =
                (now.since(pending).as_secs_f64(), now.since(well).as_secs_f64());
            let speed = truth.velocity;
            found.push((
                "G1",
                format!(
                    "its stop is pending for {outstanding:.2} s, its wire well for {well:.2} s, \
                     it turns at {speed:.2} rad/s"
                ),
            ));
        }
        if let Some((at, starts)) = self.acknowledged_stop
            && (now.since(at) > ramp || !self.is_turning() || truth.starts != starts)
        {
            self.acknowledged_stop = None;
            if self.is_turning() && truth.starts == starts {
                found.push((
                    "G6",
                    format!(
                        "told `acknowledged` {ramp:?} ago, and turns on at {:.2} rad/s",
                        truth.velocity
                    ),
                ));
            }
        }
        // Each is reported once an axis.
        found.retain(|(invariant, _)| !self.reported.contains(invariant));
        self.reported.extend(found.iter().map(|(invariant, _)| *invariant));
        found
    }

    /// The server has ended, and named this axis as not seen standing, or did not. It may turn where it was
    /// named and its wire was well too late for the stop to be carried out.
    pub fn check_after_shutdown(
        &self,
        now: Instant,
        named: bool,
        well: Option<Instant>,
    ) -> Option<StopViolation> {
        let ramp = Duration::from_millis(u64::from(self.kind.ramp_ms));
        let late = well.is_none_or(|well| now.since(well) <= STOP_ARRIVAL + ramp);
        if !self.is_turning() || named && late {
            return None;
        }
        let speed = self.truth.velocity;
        let output = if named { "told of" } else { "not told of" };
        Some(("G1", format!("the server ended, and it turns at {speed:.2} rad/s, {output}")))
    }

    fn check_alarm(
        &mut self,
        now: Instant,
        well: Option<Instant>,
        alarm: Option<bool>,
        dismissed: bool,
        found: &mut Vec<StopViolation>,
    ) {
        let Some(alarm) = alarm else { return };
        let before = self.alarm.flatten();
        let since = alarm.then(|| before.unwrap_or(now));
        self.alarm = Some(since);
        let speed = self.truth.velocity;
        // The holder of its lease at the begin of the alarm requested that stop, and has it move again.
        let goes_on = before.is_some_and(|before| {
            self.epoch.is_some() && self.lease_since <= before && self.moved_at >= before
        });
        if before.is_some() && since.is_none() && self.is_turning() && !dismissed && !goes_on {
            found.push(("G4", format!("the alarm ended, and it turns at {speed:.2} rad/s")));
        }
        let noticed =
            if self.asked_by_holder { HOLDER_STOP_GRACE + ALARM_DELAY } else { ALARM_DELAY };
        if let (Some(pending), Some(turns), None) =
            (self.stop_pending_since, self.turning_since, since)
            && now.since(pending.max(turns)) > noticed
        {
            let outstanding = now.since(pending).as_secs_f64();
            let what = format!(
                "no alarm, its stop is pending for {outstanding:.2} s, it turns at {speed:.2} rad/s"
            );
            found.push(("G2", what));
        }
        if let (Some(stands), Some(well), Some(since)) = (self.standing_since, well, since)
            && now.since(stands.max(well).max(since)) > STOP_ARRIVAL + STOP_ARRIVAL
        {
            let stands = now.since(stands).as_secs_f64();
            found.push(("G3", format!("the alarm is on, though it stands for {stands:.2} s")));
        }
    }
}
