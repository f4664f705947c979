//! Who stands beside a motor and knows what its axis is owed, whatever the bench believes.

#[cfg(test)]
mod tests;

use std::time::Duration;

use polepair_core::drives::bench::Truth;
use polepair_core::time::Instant;
use polepair_serve::message::StopClass;

use crate::drives::Kind;

/// A powered motor that is faster turns, rad/s: above what any drive's stop takes for standing.
const TURNS: f64 = 1.0;
/// An axis that is owed a stop has executed it so long after its wire is well.
const ARRIVES: Duration = Duration::from_secs(3);
/// The hand looks at its link so often at least; an alarm may be as late, and a little.
const NOTICED: Duration = Duration::from_millis(250);
/// The stop of a lease's holder raises no alarm for so long, while it goes well.
const HOLDER_WAITS: Duration = Duration::from_secs(2);
/// So long a rest is none between two turns of a motor that swings.
const RESTS: Duration = Duration::from_millis(60);
/// Whoever says STOP is answered within so long.
pub const ANSWERED: Duration = Duration::from_millis(10_300);

/// An invariant that was found broken, and how.
pub type Found = (&'static str, String);

/// What is known of one axis.
#[derive(Debug)]
pub struct Watch {
    /// What it is.
    pub kind: &'static Kind,
    /// The wire that it is on.
    pub wire: usize,
    /// What is true of its motor.
    pub truth: Truth,
    /// Since when it turns by its drive's power; `None` where it does not.
    turns_since: Option<Instant>,
    /// Since when it stands.
    stands_since: Option<Instant>,
    /// Since when it is owed a stop, by what was said and what the bench told of its lease.
    pub owed: Option<Instant>,
    /// The holder of its lease said that stop, and nobody else since.
    by_holder: bool,
    /// The epoch of its lease, while somebody has it.
    pub epoch: Option<u64>,
    /// Since when that lease is held, and when its holder last had it move.
    held_since: Instant,
    moves_since: Instant,
    /// The epoch under which it was last told to move.
    pub moved: Option<u64>,
    /// Commands under way that move it.
    pub open: u32,
    /// When it was last told to stop, by whomever: what a stop writes may look like motion.
    pub stopped_at: Instant,
    /// Until when something may still be executed whose outcome is unknown.
    pub unknown_until: Instant,
    /// The alarm as the bench shows it, since when; `None` where benches have none.
    alarm: Option<Option<Instant>>,
    /// A stop that was acknowledged, and what had been started by then.
    promised: Option<(Instant, u64)>,
    told: Vec<&'static str>,
}

impl Watch {
    /// An axis that stands.
    pub fn new(kind: &'static Kind, wire: usize) -> Self {
        Self {
            kind,
            wire,
            truth: Truth::default(),
            turns_since: None,
            stands_since: Some(Instant::ZERO),
            owed: None,
            by_holder: false,
            epoch: None,
            held_since: Instant::ZERO,
            moves_since: Instant::ZERO,
            moved: None,
            open: 0,
            stopped_at: Instant::ZERO,
            unknown_until: Instant::ZERO,
            alarm: None,
            promised: None,
            told: Vec::new(),
        }
    }

    /// Whether it turns by its drive's power.
    pub fn turns(&self) -> bool {
        self.turns_since.is_some()
    }

    /// It is to stand from now on.
    pub fn is_owed(&mut self, now: Instant) {
        self.stopped_at = now;
        if std::mem::take(&mut self.by_holder) {
            // From now on it is owed with its alarm.
            self.owed = None;
        }
        self.owed.get_or_insert(now);
    }

    /// The same, by whoever says that lease is theirs: what they have it do next ends it.
    pub fn is_owed_to_holder(&mut self, epoch: u64, now: Instant) {
        if self.epoch == Some(epoch) && self.owed.is_none() {
            (self.owed, self.by_holder) = (Some(now), true);
        }
    }

    /// Somebody else has its lease, or nobody.
    pub fn leased(&mut self, epoch: Option<u64>, now: Instant) {
        if self.epoch.is_some() && self.epoch != epoch {
            self.stopped_at = now;
            if self.moved == self.epoch {
                self.is_owed(now);
            }
        }
        if self.epoch != epoch {
            self.held_since = now;
        }
        self.epoch = epoch;
    }

    /// Whoever has that lease has it move.
    pub fn is_to_move(&mut self, epoch: u64, now: Instant) {
        if self.epoch == Some(epoch) {
            self.moves_since = now;
            if self.by_holder {
                self.owed = None;
            }
        }
    }

    /// A command that moves it was done under its lease: it is commanded again.
    pub fn is_commanded(&mut self, said: Instant) {
        if self.owed.is_some_and(|owed| owed < said) && self.epoch.is_some() {
            self.owed = None;
        }
    }

    /// How far a stop came, as somebody was told.
    pub fn told_stopped(&mut self, class: StopClass, now: Instant) -> Option<Found> {
        let speed = self.truth.velocity;
        match class {
            StopClass::Standing if self.turns() => {
                Some(("G5", format!("told `standing`, and turns at {speed:.2} rad/s")))
            }
            StopClass::Acknowledged => {
                self.promised.get_or_insert((now, self.truth.starts));
                None
            }
            _ => None,
        }
    }

    /// Takes what is true now, and tells what is broken. `alarm` is whether the bench says that it is
    /// owed a stop, `None` where benches say no such thing; `dismissed` that somebody ended the debt.
    pub fn look(
        &mut self,
        now: Instant,
        truth: Truth,
        well: Option<Instant>,
        alarm: Option<bool>,
        dismissed: bool,
    ) -> Vec<Found> {
        self.truth = truth;
        let (fast, powered) = (truth.velocity.abs() > TURNS, truth.enabled);
        self.turns_since = (fast && powered).then(|| self.turns_since.unwrap_or(now));
        self.stands_since = (!fast).then(|| self.stands_since.unwrap_or(now));
        if self.turns() && (self.epoch.is_none() || self.moved != self.epoch) {
            self.is_owed(now);
        }
        let mut found = Vec::new();
        self.look_at_alarm(now, well, alarm, dismissed, &mut found);
        let rests = self.stands_since.is_some_and(|since| now.since(since) >= RESTS);
        if rests && !matches!(self.alarm, Some(Some(_))) {
            self.owed = None;
        }
        if dismissed {
            self.owed = None;
        }
        let ramp = Duration::from_millis(u64::from(self.kind.ramp_ms));
        if let (Some(owed), Some(well), Some(turns)) = (self.owed, well, self.turns_since)
            && now.since(owed.max(well)) > ARRIVES + ramp
            && now.since(turns) > ramp
        {
            let (owed, well) = (now.since(owed).as_secs_f64(), now.since(well).as_secs_f64());
            let speed = truth.velocity;
            found.push((
                "G1",
                format!("owed a stop for {owed:.2} s, its wire well for {well:.2} s, it turns at {speed:.2} rad/s"),
            ));
        }
        if let Some((at, starts)) = self.promised
            && (now.since(at) > ramp || !self.turns() || truth.starts != starts)
        {
            self.promised = None;
            if self.turns() && truth.starts == starts {
                found.push((
                    "G6",
                    format!(
                        "told `acknowledged` {ramp:?} ago, and turns on at {:.2} rad/s",
                        truth.velocity
                    ),
                ));
            }
        }
        // Each is told once an axis.
        found.retain(|(invariant, _)| !self.told.contains(invariant));
        self.told.extend(found.iter().map(|(invariant, _)| *invariant));
        found
    }

    /// The server has ended, and named this axis as not seen standing, or did not. It may turn where it was
    /// named and its wire was well too late for the stop to be carried out.
    pub fn is_left(&self, now: Instant, named: bool, well: Option<Instant>) -> Option<Found> {
        let ramp = Duration::from_millis(u64::from(self.kind.ramp_ms));
        let late = well.is_none_or(|well| now.since(well) <= ARRIVES + ramp);
        if !self.turns() || named && late {
            return None;
        }
        let speed = self.truth.velocity;
        let told = if named { "told of" } else { "not told of" };
        Some(("G1", format!("the server ended, and it turns at {speed:.2} rad/s, {told}")))
    }

    fn look_at_alarm(
        &mut self,
        now: Instant,
        well: Option<Instant>,
        alarm: Option<bool>,
        dismissed: bool,
        found: &mut Vec<Found>,
    ) {
        let Some(alarm) = alarm else { return };
        let before = self.alarm.flatten();
        let since = alarm.then(|| before.unwrap_or(now));
        self.alarm = Some(since);
        let speed = self.truth.velocity;
        // Who held its lease when the alarm began said that stop, and has it move again.
        let goes_on = before.is_some_and(|before| {
            self.epoch.is_some() && self.held_since <= before && self.moves_since >= before
        });
        if before.is_some() && since.is_none() && self.turns() && !dismissed && !goes_on {
            found.push(("G4", format!("the alarm ended, and it turns at {speed:.2} rad/s")));
        }
        let noticed = if self.by_holder { HOLDER_WAITS + NOTICED } else { NOTICED };
        if let (Some(owed), Some(turns), None) = (self.owed, self.turns_since, since)
            && now.since(owed.max(turns)) > noticed
        {
            let owed = now.since(owed).as_secs_f64();
            let what =
                format!("no alarm, owed a stop for {owed:.2} s, it turns at {speed:.2} rad/s");
            found.push(("G2", what));
        }
        if let (Some(stands), Some(well), Some(since)) = (self.stands_since, well, since)
            && now.since(stands.max(well).max(since)) > ARRIVES + ARRIVES
        {
            let stands = now.since(stands).as_secs_f64();
            found.push(("G3", format!("the alarm is on, though it stands for {stands:.2} s")));
        }
    }
}
