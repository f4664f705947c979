//! The ears on a link: a thread that takes what drives send by themselves, as it arrives.

use std::sync::Arc;
use std::time::Duration;

use polepair::events::{Event, Events, Kind};
use polepair_core::axis::Presence;
use polepair_core::time::Instant;

use super::shared::Shared;
use super::telemetry::{Telemetry, What};
use super::wire::Wire;
use crate::message::telemetry::Sample;

/// Between two looks whether the bench closes.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How long those that came together are gathered.
const GATHER: Duration = Duration::from_millis(2);
/// Events that are taken before anything else is done.
const AT_ONCE_MAX: usize = 8192;

/// What hears an opened connection string, whatever wires it has.
pub(super) struct Ears {
    pub events: Events,
    /// The number of its first axis.
    pub base: u16,
    /// That axis' place on the link.
    pub first: usize,
    /// For each axis, when the bench's time began on its wire.
    pub zeros: Vec<Instant>,
    pub wires: Vec<Arc<Wire>>,
    pub telemetry: Arc<Telemetry>,
    pub shared: Arc<Shared>,
    /// Events that were lost so far.
    pub lost: u64,
}

impl Ears {
    /// Listens until the bench closes.
    pub fn run(mut self) {
        while !self.shared.is_closing() {
            if let Some(event) = self.events.next(LOOK_EVERY) {
                self.take(&event);
                // One wake-up for all that comes about now.
                polepair_link::clock::sleep_until(polepair_link::clock::now() + GATHER);
            }
            self.turn();
        }
    }

    /// Takes what has happened.
    pub fn turn(&mut self) {
        for _ in 0..AT_ONCE_MAX {
            let Some(event) = self.events.poll() else { break };
            self.take(&event);
        }
        let lost = self.events.lost();
        if lost > self.lost {
            let axes = self.base..self.base + self.zeros.len() as u16;
            axes.for_each(|axis| self.telemetry.missed(axis, lost - self.lost));
            self.lost = lost;
        }
    }

    fn take(&self, event: &Event) {
        let place = event.place.checked_sub(self.first).filter(|_| event.axis.is_some());
        let (what, value) = match &event.kind {
            Kind::Presence(Presence::Restarted) => {
                let its = place.and_then(|n| Some((self.base + n as u16, self.wires.get(n)?)));
                return its.into_iter().for_each(|(id, wire)| wire.note_restart(id));
            }
            Kind::Signal { signal, reading } => (What::Signal(*signal), reading.value),
            Kind::Parameter { parameter, value, .. } => (What::Parameter(*parameter), *value),
            Kind::LinkLost { .. } | Kind::LinkBack => {
                return self.wires.iter().for_each(|wire| wire.call());
            }
            _ => return,
        };
        let Some((place, zero)) = place.and_then(|n| Some((n, self.zeros.get(n)?))) else {
            return;
        };
        let sample = Sample { t_us: event.at.since(*zero).as_micros() as u64, value };
        self.telemetry.push(self.base + place as u16, what, sample);
    }
}
