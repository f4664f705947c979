//! Activity of one axis: states, requests, values, faults.

use super::{Histogram, OUTCOMES};
use crate::session::{
    ChangeNotice, ExchangeNotice, ExchangeOutcome, FaultNotice, InternedName, Quality,
};
use crate::timestamp::Timestamp;

/// Changes of a state that are kept with their times: the first ones.
const CHANGES_MAX: usize = 12;
/// States whose time is added up, for each sort of state.
const STATES_MAX: usize = 32;
/// Sorts of states of an axis: `nmt`, `power`, `mode` and the like.
const KINDS_MAX: usize = 16;

/// An axis, node or station.
#[derive(Clone, Debug, Default)]
pub struct AxisSummary {
    /// Number of its frames, and of the host's to it.
    pub frames: u64,
    /// Times of the first and of the last.
    pub span: Option<(Timestamp, Timestamp)>,
    /// States, by kind.
    pub states: Vec<(InternedName, StateHistory)>,
}

/// One sort of state over time.
#[derive(Clone, Debug, Default)]
pub struct StateHistory {
    /// The first changes, with their times.
    pub changes: Vec<(Option<Timestamp>, InternedName)>,
    /// Number of frames.
    pub count: u64,
    /// Time in each state, ns; the last one lasts to the end of the capture.
    pub durations: Vec<(InternedName, u64)>,
    /// The state now, and since when.
    pub current: Option<(InternedName, Option<Timestamp>)>,
}

impl AxisSummary {
    pub(super) fn add_frame(&mut self, time: Option<Timestamp>) {
        self.frames += 1;
        if let Some(time) = time {
            self.span.get_or_insert((time, time)).1 = time;
        }
    }

    pub(super) fn add_change(&mut self, change: &ChangeNotice, time: Option<Timestamp>) {
        let at = self.states.iter().position(|(what, _)| *what == change.what);
        let at = at.unwrap_or_else(|| {
            if self.states.len() < KINDS_MAX {
                self.states.push((change.what, StateHistory::default()));
            }
            self.states.len() - 1
        });
        self.states[at].1.add_change(change, time);
    }
}

impl StateHistory {
    fn add_change(&mut self, change: &ChangeNotice, time: Option<Timestamp>) {
        self.close_state(time);
        if self.current.is_none() && !change.from.is_empty() {
            self.open_state(change.from);
        }
        self.open_state(change.to);
        self.count += 1;
        if self.changes.len() < CHANGES_MAX {
            self.changes.push((time, change.to));
        }
        self.current = Some((change.to, time));
    }

    fn open_state(&mut self, state: InternedName) {
        let known = self.durations.iter().any(|(name, _)| *name == state);
        if !known && self.durations.len() < STATES_MAX {
            self.durations.push((state, 0));
        }
    }

    fn close_state(&mut self, time: Option<Timestamp>) {
        let Some((state, Some(since))) = self.current else { return };
        let spent = time.map_or(0, |time| time.since(since));
        if let Some((_, sum)) = self.durations.iter_mut().find(|(name, _)| *name == state) {
            *sum += spent;
        }
    }

    /// Time in each state if the capture ends at `end`, ns.
    #[must_use]
    pub fn durations_until(&self, end: Option<Timestamp>) -> Vec<(InternedName, u64)> {
        let mut all = self.clone();
        all.close_state(end);
        all.durations
    }
}

/// Requests of one sort to one axis.
#[derive(Clone, Debug, Default)]
pub struct RequestSummary {
    /// Number of ended in each way, in the order of [`ExchangeOutcome`].
    pub outcomes: [u64; OUTCOMES.len()],
    /// Number of repetitions.
    pub retries: u64,
    /// Nanoseconds to the answer.
    pub latency: Histogram,
    /// The frame of the slowest answer.
    pub slowest: u64,
}

impl RequestSummary {
    pub(super) fn add(&mut self, exchange: &ExchangeNotice, number: u64) {
        let at = OUTCOMES.iter().position(|outcome| *outcome == exchange.outcome);
        debug_assert!(at.is_some(), "every outcome has a count");
        if let Some(at) = at {
            self.outcomes[at] += 1;
        }
        self.retries += u64::from(exchange.retries);
        if let Some(ns) = exchange.latency() {
            if ns >= self.latency.max() {
                self.slowest = exchange.answered.map_or(number, |(number, _)| number);
            }
            self.latency.add(ns);
        }
    }

    /// All of them.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.outcomes.iter().sum()
    }

    /// Number of requests with that outcome.
    #[must_use]
    pub fn count_of(&self, outcome: ExchangeOutcome) -> u64 {
        let at = OUTCOMES.iter().position(|other| *other == outcome);
        at.map_or(0, |at| self.outcomes[at])
    }
}

/// Values of one name.
#[derive(Clone, Debug, Default)]
pub struct ValueSummary {
    /// Count.
    pub count: u64,
    /// The smallest and the greatest.
    pub range: Option<(f64, f64)>,
    /// The last one.
    pub last: f64,
    /// Last raw value.
    pub exact: Option<i64>,
    /// Their unit.
    pub unit: InternedName,
    /// The worst that any of them is.
    pub quality: Option<Quality>,
}

impl ValueSummary {
    pub(super) fn add(
        &mut self,
        value: f64,
        exact: Option<i64>,
        unit: InternedName,
        quality: Quality,
    ) {
        self.count += 1;
        let (min, max) = self.range.unwrap_or((value, value));
        self.range = Some((min.min(value), max.max(value)));
        (self.last, self.exact, self.unit) = (value, exact, unit);
        self.quality = self.quality.max(Some(quality));
    }
}

/// A fault.
#[derive(Clone, Debug, Default)]
pub struct FaultSummary {
    /// Description in words.
    pub text: InternedName,
    /// Usual cause; empty if no profile has it.
    pub cause: InternedName,
    /// Remedy; empty if no profile has it.
    pub remedy: InternedName,
    /// Count.
    pub count: u64,
    /// Number and time of its first frame.
    pub first: Option<(u64, Option<Timestamp>)>,
    /// Time of the last arrival.
    pub last: Option<Timestamp>,
    /// True if it is gone.
    pub gone: bool,
}

impl FaultSummary {
    pub(super) fn add(&mut self, fault: &FaultNotice, number: u64, time: Option<Timestamp>) {
        (self.text, self.cause, self.remedy) = (fault.text, fault.cause, fault.remedy);
        self.gone = fault.gone;
        if !fault.gone {
            self.count += 1;
            self.first = self.first.or(Some((number, time)));
            self.last = time.or(self.last);
        }
    }
}
