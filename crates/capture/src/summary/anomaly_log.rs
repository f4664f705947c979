//! The most unusual moments, by severity and rarity. A burst of one kind is one moment.

use std::collections::BTreeMap;

use super::AxisKey;
use crate::session::AnomalyKind;
use crate::timestamp::Timestamp;

/// One thing that comes again within this time goes on, ns.
const BURST_NS: u64 = 1_000_000_000;
/// Limit of distinguished anomalies; further ones are counted by their kind alone.
const SERIES_MAX: usize = 1024;
/// Moments of one thing that are kept: those with the most in them.
const BURSTS_MAX: usize = 10;

/// A moment: one thing, once or several times in a row.
#[derive(Clone, PartialEq, Debug)]
pub struct AnomalyBurst {
    /// Kind of the anomaly.
    pub kind: AnomalyKind,
    /// Axis.
    pub who: AxisKey,
    /// Number and time of its first frame; 0 at the end of the capture.
    pub number: u64,
    /// Time.
    pub time: Option<Timestamp>,
    /// Time of the last arrival.
    pub last: Option<Timestamp>,
    /// Count.
    pub count: u64,
    /// First text.
    pub text: String,
}

/// One sort of thing of one axis.
#[derive(Clone, Debug, Default)]
struct AnomalySeries {
    stored: Vec<AnomalyBurst>,
    current: Option<AnomalyBurst>,
    burst_count: u64,
}

/// Oddities as they come.
#[derive(Clone, Debug, Default)]
pub struct AnomalyLog {
    series: BTreeMap<(AnomalyKind, AxisKey), AnomalySeries>,
    counts: BTreeMap<AnomalyKind, u64>,
}

impl AnomalyLog {
    /// Takes an oddity.
    pub fn add(&mut self, moment: AnomalyBurst) {
        *self.counts.entry(moment.kind).or_default() += 1;
        let key = (moment.kind, moment.who);
        if self.series.len() == SERIES_MAX && !self.series.contains_key(&key) {
            return;
        }
        let thing = self.series.entry(key).or_default();
        match &mut thing.current {
            Some(open) if continues(open, &moment) => {
                open.count += 1;
                open.last = moment.time.or(open.last);
            }
            _ => {
                thing.burst_count += 1;
                let ended = thing.current.replace(moment);
                thing.store_burst(ended);
            }
        }
    }

    /// Count of each kind.
    pub fn counts(&self) -> impl ExactSizeIterator<Item = (AnomalyKind, u64)> {
        self.counts.iter().map(|(kind, count)| (*kind, *count))
    }

    /// Count of each kind, axis by axis.
    pub fn by_axis(&self) -> impl Iterator<Item = (AnomalyKind, AxisKey, u64)> {
        self.series.iter().map(|((kind, who), thing)| (*kind, *who, thing.total()))
    }

    /// The most notable ones, at most `max`, in the order of time.
    #[must_use]
    pub fn most_notable(&self, max: usize) -> Vec<&AnomalyBurst> {
        let mut bursts = BTreeMap::<AnomalyKind, u64>::new();
        for ((kind, _), thing) in &self.series {
            *bursts.entry(*kind).or_default() += thing.burst_count;
        }
        let mut ranked: Vec<(f64, &AnomalyBurst)> = Vec::new();
        for thing in self.series.values() {
            let mut moments: Vec<&AnomalyBurst> =
                thing.stored.iter().chain(&thing.current).collect();
            moments.sort_by_key(|moment| (core::cmp::Reverse(moment.count), moment.number));
            for (nth, moment) in moments.into_iter().enumerate() {
                let rarity = 1.0 + (bursts[&moment.kind] as f64).ln();
                // A repetition of the same kind is less notable than another kind.
                let score = f64::from(moment.kind.severity()) / rarity / (1.0 + 0.5 * nth as f64);
                ranked.push((score, moment));
            }
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.number.cmp(&b.1.number)));
        let mut oddest: Vec<&AnomalyBurst> =
            ranked.into_iter().take(max).map(|(_, one)| one).collect();
        oddest.sort_by_key(|moment| (moment.number == 0, moment.time, moment.number));
        oddest
    }
}

impl AnomalySeries {
    fn store_burst(&mut self, moment: Option<AnomalyBurst>) {
        let Some(moment) = moment else { return };
        self.stored.push(moment);
        if self.stored.len() > BURSTS_MAX {
            let fewest = self.stored.iter().map(|anomaly_burst| anomaly_burst.count).min();
            let at =
                self.stored.iter().rposition(|anomaly_burst| Some(anomaly_burst.count) == fewest);
            at.map(|at| self.stored.remove(at));
        }
    }

    fn total(&self) -> u64 {
        self.stored.iter().chain(&self.current).map(|moment| moment.count).sum()
    }
}

fn continues(open: &AnomalyBurst, next: &AnomalyBurst) -> bool {
    match (open.last.or(open.time), next.time) {
        (Some(last), Some(time)) => time.since(last) <= BURST_NS,
        _ => true,
    }
}
