//! The eyes on one wire: a thread that asks for what is shown, whenever the desk has nothing to do.
//! It asks one thing at a time, so that a command waits behind one question at most.

use std::sync::Arc;
use std::time::Duration;

use polepair::Axis;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use serde_json::json;

use super::clash::Watch;
use super::desk::Desk;
use super::look::Searcher;
use super::open::Link;
use super::shared::{Event, Shared};
use super::telemetry::{Telemetry, What};
use super::wire::{StopThese, Wire};
use crate::message::telemetry::Sample;
use crate::message::{Deed, Refused};

/// How often an axis is asked for its state.
const STATE_EVERY: Duration = Duration::from_millis(100);
/// How long an axis that does not answer is left alone.
const PATIENCE: Duration = Duration::from_secs(1);
/// How far ahead an axis that turns is kept from leaving its limits.
const AHEAD: Duration = Duration::from_millis(200);
/// Between two looks whether there is anything to do.
const IDLE: Duration = Duration::from_millis(20);
/// Watched values that are asked for between two addresses of a look for drives.
const DUE_AT_ONCE_MAX: usize = 16;

/// What looks at a wire.
pub(super) struct Eyes {
    wire: Arc<Wire>,
    desk: Arc<Desk>,
    shared: Arc<Shared>,
    telemetry: Arc<Telemetry>,
    axes: Vec<Looked>,
    /// Whose turn it is.
    turn: usize,
    /// Questions take half of the time at most.
    rest_until: Instant,
    others: Watch,
    search: Searcher,
}

/// An axis, and what is still to be asked of it.
struct Looked {
    id: u16,
    axis: Axis,
    /// Parameters that signals read.
    ids: Vec<ParameterId>,
    to_ask: Vec<ParameterId>,
    next: Instant,
    /// Its drive is still to be had to watch this host.
    unwatched: bool,
}

impl Eyes {
    pub fn new(link: &Link, shared: &Arc<Shared>, telemetry: &Arc<Telemetry>) -> Self {
        let mut eyes = Self {
            axes: Vec::new(),
            wire: Arc::clone(&link.wire),
            desk: Arc::clone(&link.desk),
            shared: Arc::clone(shared),
            telemetry: Arc::clone(telemetry),
            turn: 0,
            rest_until: Instant::ZERO,
            others: Watch::default(),
            search: Searcher::new(link, shared),
        };
        eyes.grow();
        eyes
    }

    /// Looks at axes that joined, too.
    fn grow(&mut self) {
        let looked = |(id, axis): &(u16, Axis)| Looked {
            id: *id,
            ids: ids(axis),
            axis: axis.clone(),
            to_ask: Vec::new(),
            next: Instant::ZERO,
            unwatched: true,
        };
        let known = self.axes.len();
        if known < self.wire.axes.len() {
            self.axes.extend(self.wire.axes.iter().skip(known).map(looked));
        }
    }

    /// Looks until the bench closes.
    pub fn run(mut self) {
        while !self.shared.is_closing() {
            if self.desk.work() {
                continue;
            }
            if self.look() {
                // Between two addresses whatever is due goes on.
                for _ in 0..DUE_AT_ONCE_MAX {
                    if !self.desk.work() && !self.sample() {
                        break;
                    }
                }
                self.ask();
                continue;
            }
            let watched = self.sample();
            // Who watches more than the wire can carry does not keep states from being asked for; a
            // command comes before either.
            if watched && (self.desk.work() || self.shared.now() < self.rest_until) {
                continue;
            }
            let now = self.shared.now();
            if now < self.rest_until {
                self.desk.wait(self.rest_until.since(now).min(self.idle()));
            } else if self.ask() {
                self.rest_until = self.shared.now() + self.shared.now().since(now);
            } else if !watched {
                self.desk.wait(self.idle());
            }
        }
        // What is left is told that it comes too late.
        while self.desk.work() {}
    }

    /// Asks the next address of a look for drives. False when nobody looks.
    pub fn look(&mut self) -> bool {
        let looks = self.search.step();
        if looks && let Some(first) = self.axes.first() {
            // What an address asked in vain may still say is nobody's clash.
            self.others.pass_over(first.axis.connection().with(|axes, _| axes.counters()));
        }
        looks
    }

    /// Asks for what somebody watches and the drive does not send, once, if it is due: what waits
    /// longest first, so that all come where the wire cannot carry all. False when nothing is.
    pub fn sample(&mut self) -> bool {
        self.grow();
        let Some((now, zero)) = self.wire.time() else { return false };
        let now_us = now.since(zero).as_micros() as u64;
        let sources = self.axes.iter().flat_map(|looked| {
            self.telemetry.of(looked.id).into_iter().map(move |source| (looked, source))
        });
        let due = sources.filter_map(|(looked, source)| {
            let due = source.due(now_us)?;
            (due <= now).then_some((due, looked, source))
        });
        let Some((_, looked, source)) = due.min_by_key(|(due, ..)| *due) else { return false };
        source.asked(now);
        if let Some((at, value)) = looked.ask(source.what) {
            let t_us = at.since(zero).as_micros() as u64;
            source.answered(Sample { t_us, value });
        }
        true
    }

    /// How long nothing is due.
    fn idle(&self) -> Duration {
        let Some((now, zero)) = self.wire.time() else { return IDLE };
        let now_us = now.since(zero).as_micros() as u64;
        let sources = self.axes.iter().flat_map(|looked| self.telemetry.of(looked.id));
        let due = sources.filter_map(|source| source.due(now_us)).min();
        due.map_or(IDLE, |due| due.since(now).min(IDLE))
    }

    /// Asks one thing of the axis whose turn it is. False when none is to be asked.
    fn ask(&mut self) -> bool {
        let now = self.shared.now();
        self.look_for_others(now);
        for id in self.wire.take_restarted() {
            let its = self.axes.iter_mut().filter(|looked| looked.id == id);
            its.for_each(|looked| looked.unwatched = true);
        }
        let unwatched = |looked: &&mut Looked| looked.unwatched && now >= looked.next;
        for looked in self.axes.iter_mut().filter(unwatched) {
            if looked.watch_host(now, &self.wire, &self.shared) {
                return true;
            }
        }
        for _ in 0..self.axes.len() {
            self.turn = (self.turn + 1) % self.axes.len();
            let looked = &mut self.axes[self.turn];
            if looked.to_ask.is_empty() && now >= looked.next {
                looked.to_ask.clone_from(&looked.ids);
                looked.next = now + STATE_EVERY;
            }
            let stale = loop {
                match looked.to_ask.pop() {
                    Some(id) if looked.is_fresh(id) => {}
                    found => break found,
                }
            };
            if let Some(id) = stale {
                looked.read(id, now);
                self.hold_back();
                return true;
            }
        }
        false
    }

    /// Tells of somebody else on the wire.
    fn look_for_others(&mut self, now: Instant) {
        let Some(first) = self.axes.first() else { return };
        let counters = || first.axis.connection().with(|axes, _| axes.counters());
        if let Some(news) = self.others.look(counters, now) {
            self.wire.show_clash(news);
            self.shared.tell(Event::Bench);
        }
    }

    /// Stops an axis that is about to leave the limits that a file sets it.
    fn hold_back(&self) {
        let axis = &self.axes[self.turn].axis;
        if !axis.has_ends() || !axis.state().armed || axis.turns() != Some(true) {
            return;
        }
        let reason = match axis.leaving(AHEAD) {
            Ok(None) => return,
            Ok(Some(reason)) => reason,
            Err(error) => error.to_string(),
        };
        let (axes, since, report) = (vec![(self.turn, 0)], self.shared.now(), None);
        let who = super::shared::SERVER.into();
        self.wire.stop(StopThese { axes, who, reason, since, report });
    }
}

/// What signals read, each once; the most telling is asked first, being last.
fn ids(axis: &Axis) -> Vec<ParameterId> {
    let mut ids = Vec::new();
    let plain = axis.profile().signals.iter().filter(|source| source.signal != Signal::Time);
    for source in plain {
        if !ids.contains(&source.parameter) {
            ids.push(source.parameter);
        }
    }
    ids.reverse();
    ids
}

impl Looked {
    /// What is watched, as it is now; `None` where it is not told.
    fn ask(&self, what: What) -> Option<(Instant, f64)> {
        let (at, value) = match what {
            What::Signal(signal) => {
                let reading = self.axis.signals(&[signal]).ok()?[0];
                (reading.at?, reading.value)
            }
            What::Parameter(id) => {
                let raw = self.axis.read(id).ok()?;
                (self.axis.connection().now(), self.axis.value(id, raw).ok()?.value)
            }
        };
        value.is_finite().then_some((at, value))
    }

    /// Whether all that a parameter tells was sent or asked for just now.
    fn is_fresh(&self, id: ParameterId) -> bool {
        let (state, now) = (self.axis.state(), self.axis.connection().now());
        let mut its = self.axis.profile().signals.iter().filter(|s| s.parameter == id);
        its.all(|s| state.reading(s.signal).at.is_some_and(|at| now.since(at) < STATE_EVERY / 2))
    }

    /// Has its drive watch this host's heartbeat, where the link sends one. False where nothing was
    /// asked.
    fn watch_host(&mut self, now: Instant, wire: &Wire, shared: &Shared) -> bool {
        let (watched, failed) = match self.axis.watch_host() {
            Ok(None) => {
                self.unwatched = false;
                return false;
            }
            Ok(Some(watched)) => (Ok(watched), false),
            Err(error) => {
                let silent = matches!(&error, polepair::Error::Failed { outcome, .. }
                    if matches!(outcome.failure(), Some(Failure::Silent | Failure::LinkDown)));
                (Err(error), silent)
            }
        };
        if failed {
            self.next = now + PATIENCE;
            return true;
        }
        self.unwatched = false;
        let (told, own, detail) = match watched {
            Ok([found, is]) => {
                let detail = json!({ "was": found.to_string(), "is": is.to_string() });
                (is.to_string(), found != is, detail)
            }
            Err(error) => {
                let told = format!("not known: {error}");
                (told, false, json!({ "error": Refused::from(error) }))
            }
        };
        tracing::info!(axis = self.id, "{}: its own watchdog is {told}", self.axis.label());
        shared.noted_by_server(Deed::Watchdog, self.id, detail);
        let place = wire.axes.iter().position(|(id, _)| *id == self.id);
        place.filter(|_| own).into_iter().for_each(|place| wire.note_watch(place, true));
        true
    }

    fn read(&mut self, id: ParameterId, now: Instant) {
        let Err(error) = self.axis.read(id) else { return };
        let polepair::Error::Failed { outcome, .. } = error else {
            return self.ids.retain(|other| *other != id);
        };
        match outcome {
            Outcome::NotDone(Failure::Refused { .. } | Failure::Impossible(_)) => {
                self.ids.retain(|other| *other != id);
            }
            _ if matches!(outcome.failure(), Some(Failure::Silent | Failure::LinkDown)) => {
                self.to_ask.clear();
                self.next = now + PATIENCE;
            }
            _ => {}
        }
    }
}
