//! What one axis did: states, requests, values, faults.

use super::{OUTCOMES, Spread};
use crate::decoder::Event;
use crate::session::{Change, Exchange, Fault, Name, Outcome, Quality, Signal};
use crate::stamp::Stamp;

/// Changes of a state that are kept with their times: the first ones.
const CHANGES_MAX: usize = 12;
/// States whose time is added up, for each sort of state.
const STATES_MAX: usize = 32;
/// Sorts of states of an axis: `nmt`, `power`, `mode` and the like.
const SORTS_MAX: usize = 16;

/// An axis, node or station.
#[derive(Clone, Debug, Default)]
pub struct Axis {
    /// Its frames, and the host's to it.
    pub frames: u64,
    /// When the first came, and the last.
    pub span: Option<(Stamp, Stamp)>,
    /// Its states, by sort.
    pub states: Vec<(Name, States)>,
}

/// One sort of state over time.
#[derive(Clone, Debug, Default)]
pub struct States {
    /// The first changes, with their times.
    pub changes: Vec<(Option<Stamp>, Name)>,
    /// How many there were.
    pub count: u64,
    /// How long it was in each state, ns; the last one lasts to the end of the capture.
    pub spent: Vec<(Name, u64)>,
    /// The state now, and since when.
    pub now: Option<(Name, Option<Stamp>)>,
}

impl Axis {
    pub(super) fn frame(&mut self, event: &Event<'_>) {
        self.frames += 1;
        if let Some(time) = event.time {
            self.span.get_or_insert((time, time)).1 = time;
        }
    }

    pub(super) fn change(&mut self, change: &Change, time: Option<Stamp>) {
        let at = self.states.iter().position(|(what, _)| *what == change.what);
        let at = at.unwrap_or_else(|| {
            if self.states.len() < SORTS_MAX {
                self.states.push((change.what, States::default()));
            }
            self.states.len() - 1
        });
        self.states[at].1.change(change, time);
    }
}

impl States {
    fn change(&mut self, change: &Change, time: Option<Stamp>) {
        self.leave(time);
        if self.now.is_none() && !change.from.is_empty() {
            self.enter(change.from);
        }
        self.enter(change.to);
        self.count += 1;
        if self.changes.len() < CHANGES_MAX {
            self.changes.push((time, change.to));
        }
        self.now = Some((change.to, time));
    }

    fn enter(&mut self, state: Name) {
        let known = self.spent.iter().any(|(name, _)| *name == state);
        if !known && self.spent.len() < STATES_MAX {
            self.spent.push((state, 0));
        }
    }

    fn leave(&mut self, time: Option<Stamp>) {
        let Some((state, Some(since))) = self.now else { return };
        let spent = time.map_or(0, |time| time.since(since));
        if let Some((_, sum)) = self.spent.iter_mut().find(|(name, _)| *name == state) {
            *sum += spent;
        }
    }

    /// How long it was in each state when the capture ends at `end`, ns.
    #[must_use]
    pub fn until(&self, end: Option<Stamp>) -> Vec<(Name, u64)> {
        let mut all = self.clone();
        all.leave(end);
        all.spent
    }
}

/// Requests of one sort to one axis.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// How many ended in each way, in the order of [`Outcome`].
    pub outcomes: [u64; OUTCOMES.len()],
    /// How often one was sent again.
    pub retries: u64,
    /// Nanoseconds to the answer.
    pub latency: Spread,
    /// The frame of the slowest answer.
    pub slowest: u64,
}

impl Requests {
    pub(super) fn take(&mut self, exchange: &Exchange, number: u64) {
        let at = OUTCOMES.iter().position(|outcome| *outcome == exchange.outcome).unwrap_or(0);
        self.outcomes[at] += 1;
        self.retries += u64::from(exchange.retries);
        if let Some(ns) = exchange.latency() {
            if ns >= self.latency.most() {
                self.slowest = exchange.answered.map_or(number, |(number, _)| number);
            }
            self.latency.take(ns);
        }
    }

    /// All of them.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.outcomes.iter().sum()
    }

    /// Those that ended in a way.
    #[must_use]
    pub fn ended(&self, outcome: Outcome) -> u64 {
        let at = OUTCOMES.iter().position(|other| *other == outcome);
        at.map_or(0, |at| self.outcomes[at])
    }
}

/// Values of one name.
#[derive(Clone, Debug, Default)]
pub struct Values {
    /// How many.
    pub count: u64,
    /// The smallest and the greatest.
    pub range: Option<(f64, f64)>,
    /// The last one.
    pub last: f64,
    /// The last one as it stood on the wire.
    pub exact: Option<i64>,
    /// Their unit.
    pub unit: Name,
    /// The worst that any of them is.
    pub quality: Option<Quality>,
}

impl Values {
    pub(super) fn take(&mut self, signal: &Signal) {
        self.count += 1;
        let (least, most) = self.range.unwrap_or((signal.value, signal.value));
        self.range = Some((least.min(signal.value), most.max(signal.value)));
        (self.last, self.exact, self.unit) = (signal.value, signal.exact, signal.unit);
        self.quality = self.quality.max(Some(signal.quality));
    }
}

/// A fault.
#[derive(Clone, Debug, Default)]
pub struct FaultSeen {
    /// In words.
    pub text: Name,
    /// Why it usually happens; empty where no profile says.
    pub cause: Name,
    /// What to do; empty where no profile says.
    pub remedy: Name,
    /// How often it came.
    pub count: u64,
    /// The frame that told it first, and when.
    pub first: Option<(u64, Option<Stamp>)>,
    /// When it came last.
    pub last: Option<Stamp>,
    /// It is there no more.
    pub gone: bool,
}

impl FaultSeen {
    pub(super) fn take(&mut self, fault: &Fault, number: u64, time: Option<Stamp>) {
        (self.text, self.cause, self.remedy) = (fault.text, fault.cause, fault.remedy);
        self.gone = fault.gone;
        if !fault.gone {
            self.count += 1;
            self.first = self.first.or(Some((number, time)));
            self.last = time.or(self.last);
        }
    }
}
