//! The oddest moments: what matters most and is rarest. A burst of one thing is one moment.

use std::collections::BTreeMap;

use super::Who;
use crate::session::Oddity;
use crate::stamp::Stamp;

/// One thing that comes again within this time goes on, ns.
const BURST_NS: u64 = 1_000_000_000;
/// Things that are told apart; further ones are counted by their sort alone.
const THINGS_MAX: usize = 1024;
/// Moments of one thing that are kept: those with the most in them.
const KEPT_MAX: usize = 10;

/// A moment: one thing, once or several times in a row.
#[derive(Clone, PartialEq, Debug)]
pub struct Moment {
    /// What sort of thing.
    pub kind: Oddity,
    /// Whose.
    pub who: Who,
    /// The frame that told it first, and when; 0 at the end of the capture.
    pub number: u64,
    /// When.
    pub time: Option<Stamp>,
    /// When it came last.
    pub last: Option<Stamp>,
    /// How often.
    pub count: u64,
    /// What was said first.
    pub text: String,
}

/// One sort of thing of one axis.
#[derive(Clone, Debug, Default)]
struct Thing {
    kept: Vec<Moment>,
    open: Option<Moment>,
    bursts: u64,
}

/// Oddities as they come.
#[derive(Clone, Debug, Default)]
pub struct Moments {
    things: BTreeMap<(Oddity, Who), Thing>,
    counts: BTreeMap<Oddity, u64>,
}

impl Moments {
    /// Takes an oddity.
    pub fn take(&mut self, moment: Moment) {
        *self.counts.entry(moment.kind).or_default() += 1;
        let key = (moment.kind, moment.who);
        if self.things.len() == THINGS_MAX && !self.things.contains_key(&key) {
            return;
        }
        let thing = self.things.entry(key).or_default();
        match &mut thing.open {
            Some(open) if goes_on(open, &moment) => {
                open.count += 1;
                open.last = moment.time.or(open.last);
            }
            _ => {
                thing.bursts += 1;
                let ended = thing.open.replace(moment);
                thing.keep(ended);
            }
        }
    }

    /// How often each sort came.
    pub fn counts(&self) -> impl ExactSizeIterator<Item = (Oddity, u64)> {
        self.counts.iter().map(|(kind, count)| (*kind, *count))
    }

    /// How often each sort came, axis by axis.
    pub fn by_axis(&self) -> impl Iterator<Item = (Oddity, Who, u64)> {
        self.things.iter().map(|((kind, who), thing)| (*kind, *who, thing.count()))
    }

    /// The oddest so many, in the order of time.
    #[must_use]
    pub fn oddest(&self, most: usize) -> Vec<&Moment> {
        let mut bursts = BTreeMap::<Oddity, u64>::new();
        for ((kind, _), thing) in &self.things {
            *bursts.entry(*kind).or_default() += thing.bursts;
        }
        let mut ranked: Vec<(f64, &Moment)> = Vec::new();
        for thing in self.things.values() {
            let mut moments: Vec<&Moment> = thing.kept.iter().chain(&thing.open).collect();
            moments.sort_by_key(|moment| (core::cmp::Reverse(moment.count), moment.number));
            for (nth, moment) in moments.into_iter().enumerate() {
                let rarity = 1.0 + (bursts[&moment.kind] as f64).ln();
                // The same thing again says less than another would.
                let score = f64::from(moment.kind.weight()) / rarity / (1.0 + 0.5 * nth as f64);
                ranked.push((score, moment));
            }
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.number.cmp(&b.1.number)));
        let mut oddest: Vec<&Moment> = ranked.into_iter().take(most).map(|(_, one)| one).collect();
        oddest.sort_by_key(|moment| (moment.number == 0, moment.time, moment.number));
        oddest
    }
}

impl Thing {
    fn keep(&mut self, moment: Option<Moment>) {
        let Some(moment) = moment else { return };
        self.kept.push(moment);
        if self.kept.len() > KEPT_MAX {
            let fewest = self.kept.iter().map(|kept| kept.count).min();
            let at = self.kept.iter().rposition(|kept| Some(kept.count) == fewest);
            at.map(|at| self.kept.remove(at));
        }
    }

    fn count(&self) -> u64 {
        self.kept.iter().chain(&self.open).map(|moment| moment.count).sum()
    }
}

fn goes_on(open: &Moment, next: &Moment) -> bool {
    match (open.last.or(open.time), next.time) {
        (Some(last), Some(time)) => time.since(last) <= BURST_NS,
        _ => true,
    }
}
