//! A stop, and how far it is known to have come.

use std::time::Duration;

use super::{Axis, Running};
use crate::error::Error;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Step;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

/// Readings of what a stop waits for that prove that its steps before were answered: the first may
/// have been asked for before the stop.
const PROOF: u32 = 2;

/// The stop of one axis, for those who wait for nothing: they look again and again.
#[derive(Debug)]
pub struct Stopping {
    begun: Instant,
    running: Option<Running>,
    class: Class,
    took: Duration,
    last: Option<Instant>,
    readings: u32,
}

/// How far a stop is known to have come.
#[derive(Clone, PartialEq, Debug)]
pub enum Class {
    /// It is on the wire.
    Sent,
    /// The drive said that it took it.
    Acknowledged,
    /// The motor stands.
    Still,
    /// It could not be sent, or was not confirmed; why.
    Failed(Error),
}

impl Stopping {
    /// Sends it.
    #[must_use]
    pub fn begin(axis: &Axis) -> Self {
        let begun = axis.connection().now();
        let (running, class) = match axis.start(Command::new(Verb::Stop)) {
            Ok(running) => (Some(running), Class::Sent),
            Err(error) => (None, Class::Failed(error)),
        };
        Self { begun, running, class, took: Duration::ZERO, last: None, readings: 0 }
    }

    /// How far it has come.
    #[must_use]
    pub fn class(&self) -> &Class {
        &self.class
    }

    /// How long that took.
    #[must_use]
    pub fn took(&self) -> Duration {
        self.took
    }

    /// Whether the motor stands, and has been told to for so long.
    #[must_use]
    pub fn is_over(&self, axis: &Axis, told: Duration) -> bool {
        let age = axis.connection().now().since(self.begun);
        self.class == Class::Still && age > self.took + told
    }

    /// Whether its end is not known yet.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        self.running.is_some()
    }

    /// Notes that the motor stands, by a velocity read at `at`: where the drive's stop waits for
    /// nothing, that is how it is known.
    pub fn stands(&mut self, at: Instant) {
        let ended = self.begun + self.took;
        if self.class == Class::Acknowledged && self.running.is_none() && at > ended {
            self.class = Class::Still;
            self.took = at.since(self.begun);
        }
    }

    /// Looks how far it has come.
    pub fn look(&mut self, axis: &Axis, now: Instant) {
        let Some(running) = &mut self.running else { return };
        let ended = running.poll();
        self.ended(axis, now, ended);
    }

    /// Waits for its end, at most so long.
    pub fn settle(&mut self, axis: &Axis, at_most: Duration) {
        let Some(running) = &mut self.running else { return };
        let ended = running.wait(at_most);
        self.ended(axis, axis.connection().now(), ended);
    }

    fn ended(&mut self, axis: &Axis, now: Instant, ended: Result<Option<i64>, Error>) {
        self.took = now.since(self.begun);
        let waits = waited_for(axis);
        match ended {
            Ok(None) => return self.watch(axis, &waits),
            Ok(Some(_)) if waits.is_empty() => self.class = Class::Acknowledged,
            Ok(Some(_)) => self.class = Class::Still,
            Err(error) => self.class = Class::Failed(error),
        }
        self.running = None;
    }

    /// What a stop waits for is read once all that it sends was answered.
    fn watch(&mut self, axis: &Axis, waits: &[ParameterId]) {
        let state = axis.state();
        let signals = axis.profile().signals.iter();
        let read = signals.filter(|source| waits.contains(&source.parameter));
        let last = read.filter_map(|source| state.reading(source.signal).at).max();
        if last > self.last && last > Some(self.begun) {
            self.last = last;
            self.readings += 1;
        }
        if self.class == Class::Sent && self.readings >= PROOF {
            self.class = Class::Acknowledged;
        }
    }
}

impl Axis {
    /// Whether the last velocity that was read is more than what the drive's stop takes for standing;
    /// `None` where none was read.
    #[must_use]
    pub fn turns(&self) -> Option<bool> {
        let reading = self.state().reading(Signal::Velocity);
        reading.at?;
        let source = self.profile.signal(Signal::Velocity).map(|found| found.parameter);
        let plan = self.profile.plan(Verb::Stop);
        let steps = plan.map_or(&[][..], |plan| plan.steps);
        let standing = steps.iter().find_map(|step| match step {
            Step::Until { read, test, .. } if Some(*read) == source => Some(test),
            _ => None,
        });
        Some(standing.map_or(reading.raw != 0, |test| !test.passes(reading.raw)))
    }
}

/// What the drive's stop waits for; nothing where being told is all that can be known.
fn waited_for(axis: &Axis) -> Vec<ParameterId> {
    let plan = axis.profile().plan(Verb::Stop);
    let steps = plan.map_or(&[][..], |plan| plan.steps);
    let waits = steps.iter().filter_map(|step| match step {
        Step::Until { read, .. } => Some(*read),
        _ => None,
    });
    waits.collect()
}
