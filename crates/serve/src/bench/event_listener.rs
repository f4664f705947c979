//! The event listener of a link: a thread that receives what drives send unsolicited.

use std::sync::Arc;
use std::time::Duration;

use polepair::events::{Event, EventKind, Events};
use polepair_core::axis::Presence;
use polepair_core::time::Instant;

use super::context::BenchContext;
use super::telemetry::{Telemetry, WatchTarget};
use super::wire::BenchWire;
use crate::message::telemetry::Sample;

/// Between two looks whether the bench closes.
const CLOSE_CHECK_INTERVAL: Duration = Duration::from_millis(100);
/// Time in which simultaneous events are gathered.
const GATHER: Duration = Duration::from_millis(2);
/// Events that are taken before anything else is done.
const AT_ONCE_MAX: usize = 8192;

/// Listener of an opened connection string, with all of its wires.
pub(super) struct DriveEventListener {
    pub events: Events,
    /// The number of its first axis.
    pub base: u16,
    /// Index of that axis on the link.
    pub first: usize,
    /// For each axis, when the bench's time began on its wire.
    pub time_origins: Vec<Instant>,
    pub wires: Vec<Arc<BenchWire>>,
    pub telemetry: Arc<Telemetry>,
    pub context: Arc<BenchContext>,
    /// Events that were lost so far.
    pub lost: u64,
}

impl DriveEventListener {
    /// Listens until the bench closes.
    pub fn run(mut self) {
        while !self.context.is_closing() {
            if let Some(event) = self.events.next(CLOSE_CHECK_INTERVAL) {
                self.handle_event(&event);
                // One wake-up for all that comes about now.
                polepair_link::clock::sleep_until(polepair_link::clock::now() + GATHER);
            }
            self.poll_events();
        }
    }

    /// Takes what has happened.
    pub fn poll_events(&mut self) {
        for _ in 0..AT_ONCE_MAX {
            let Some(event) = self.events.poll() else { break };
            self.handle_event(&event);
        }
        let lost = self.events.lost();
        if lost > self.lost {
            let axes = self.base..self.base + self.time_origins.len() as u16;
            axes.for_each(|axis| self.telemetry.record_loss(axis, lost - self.lost));
            self.lost = lost;
        }
    }

    fn handle_event(&self, event: &Event) {
        let index = event.index.checked_sub(self.first).filter(|_| event.axis.is_some());
        let (what, value) = match &event.kind {
            EventKind::Presence(Presence::Restarted) => {
                let its = index.and_then(|n| Some((self.base + n as u16, self.wires.get(n)?)));
                return its.into_iter().for_each(|(id, wire)| wire.record_restart(id));
            }
            EventKind::Signal { signal, reading } => (WatchTarget::Signal(*signal), reading.value),
            EventKind::Parameter { parameter, value, .. } => {
                (WatchTarget::Parameter(*parameter), *value)
            }
            EventKind::LinkLost { .. } | EventKind::LinkBack => {
                return self.wires.iter().for_each(|wire| wire.wake_worker());
            }
            _ => return,
        };
        let Some((index, zero)) = index.and_then(|n| Some((n, self.time_origins.get(n)?))) else {
            return;
        };
        let sample = Sample { t_us: event.at.since(*zero).as_micros() as u64, value };
        self.telemetry.push(self.base + index as u16, what, sample);
    }
}
