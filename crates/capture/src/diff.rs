//! Compares the behaviour of two captures: axes, frame types and rates, states, faults, anomalies, values,
//! response times. It does not compare bytes or times.

use std::collections::{BTreeMap, BTreeSet};

use crate::session::InternedName;
use crate::summary::{
    AxisKey, AxisSummary, FaultSummary, FrameKind, IndexedMap, RequestSummary, Summary,
    ValueSummary, axis_label,
};
use crate::text::{DurationText, NumberText};

/// Frames of a kind, or requests, from which on rates and latencies are compared.
const COUNT_MIN: u64 = 10;
/// Factors of the tolerance for a latency's median, and for its 99th percentile.
const MEDIAN_TIMES: f64 = 2.5;
const TAIL_TIMES: f64 = 5.0;
/// Latencies that differ by less are the same, ns.
const LATENCY_MIN_NS: u64 = 500_000;
/// Factor by which anomalies may be more frequent.
const ANOMALY_FACTOR: f64 = 2.0;

/// One thing that differs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// Kind of the difference: `axis`, `frames`, `rate`, `state`, `fault`, `odd`, `value`, `latency`.
    pub kind: &'static str,
    /// Subject, with its owner.
    pub subject: String,
    /// Value in the first capture.
    pub a: String,
    /// Value in the second.
    pub b: String,
}

/// Differences between `a` and `b`. Rates, and ranges of values, may differ by `tolerance` (0.2 for a fifth).
#[must_use]
pub fn diff(a: &Summary, b: &Summary, tolerance: f64) -> Vec<Difference> {
    // A machine's only link may have another name in another capture.
    let alone = a.links.len() == 1 && b.links.len() == 1;
    let mut compared =
        SummaryComparison { a, b, single_link: alone, tolerance, differences: Vec::new() };
    compared.compare_axes();
    compared.compare_kinds();
    compared.compare_states();
    compared.compare_faults();
    compared.compare_anomalies();
    compared.compare_values();
    compared.compare_latencies();
    compared.differences
}

struct SummaryComparison<'s> {
    a: &'s Summary,
    b: &'s Summary,
    single_link: bool,
    tolerance: f64,
    differences: Vec<Difference>,
}

impl<'s> SummaryComparison<'s> {
    fn axis_key(&self, who: AxisKey) -> AxisKey {
        if self.single_link { AxisKey { link: "", ..who } } else { who }
    }

    fn push(&mut self, what: &'static str, of: String, a: String, b: String) {
        self.differences.push(Difference { kind: what, subject: of, a, b });
    }

    /// Something of one capture beside that of the other.
    fn compare_maps<K: Ord, V>(
        &mut self,
        maps: [BTreeMap<K, V>; 2],
        mut compare: impl FnMut(&mut Self, &K, Option<&V>, Option<&V>),
    ) {
        let keys: BTreeSet<&K> = maps.iter().flat_map(BTreeMap::keys).collect();
        for key in keys {
            compare(self, key, maps[0].get(key), maps[1].get(key));
        }
    }

    fn map_both<K: Ord, V>(
        &self,
        map: impl Fn(&'s Summary) -> BTreeMap<K, V>,
    ) -> [BTreeMap<K, V>; 2] {
        [map(self.a), map(self.b)]
    }

    fn compare_axes(&mut self) {
        let maps = self.map_both(|s| {
            s.axes.iter().map(|(w, axis)| (self.axis_key(*w), axis.frames)).collect()
        });
        self.compare_maps(maps, |all, who, a, b| {
            if a.is_none() || b.is_none() {
                all.push("axis", axis_label(*who), frame_count_text(a), frame_count_text(b));
            }
        });
    }

    fn compare_kinds(&mut self) {
        let maps =
            self.map_both(|s| s.kinds().into_iter().map(|k| (self.kind_key(k), k)).collect());
        self.compare_maps(maps, |all, (who, kind, id), a, b| {
            // Reported already: the axis is missing.
            if is_axis_missing(&all.a.axes, all, who) || is_axis_missing(&all.b.axes, all, who) {
                return;
            }
            let id = id.map_or_else(String::new, |(id, _)| format!(" {id:03X}h"));
            let of = format!("{}  {kind}{id}", axis_label(*who));
            match (a, b) {
                (Some(a), Some(b)) => all.compare_rate(of, a, b),
                (a, b) => all.push(
                    "frames",
                    of,
                    frame_count_text(a.map(|a| &a.count)),
                    frame_count_text(b.map(|b| &b.count)),
                ),
            }
        });
    }

    fn kind_key(&self, kind: &FrameKind) -> (AxisKey, InternedName, Option<(u32, bool)>) {
        (self.axis_key(kind.who), kind.kind, kind.id)
    }

    fn compare_rate(&mut self, of: String, a: &FrameKind, b: &FrameKind) {
        let rate = |kind: &FrameKind, summary: &Summary| {
            if kind.is_regular() {
                1e9 / kind.gaps.median().max(1) as f64
            } else {
                kind.count as f64 * 1e9 / summary.length_ns().max(1) as f64
            }
        };
        let rates = (rate(a, self.a), rate(b, self.b));
        // The rate of a few frames depends on where the capture was cut.
        let enough = a.count.max(b.count) >= COUNT_MIN;
        if enough && relative_gap(rates.0, rates.1) > self.tolerance {
            self.push("rate", of, rate_text(rates.0), rate_text(rates.1));
        }
    }

    fn compare_states(&mut self) {
        let maps = self.map_both(|s| {
            let each = s.axes.iter().flat_map(|(who, axis)| {
                axis.states.iter().map(|(what, states)| ((self.axis_key(*who), *what), states))
            });
            let reached = each.map(|(key, states)| {
                let names: BTreeSet<InternedName> =
                    states.durations.iter().map(|(name, _)| *name).collect();
                (key, names)
            });
            reached.collect()
        });
        self.compare_maps(maps, |all, (who, what), a, b| {
            let none = BTreeSet::new();
            let (a, b) = (a.unwrap_or(&none), b.unwrap_or(&none));
            if a != b {
                all.push(
                    "state",
                    format!("{}  {what}", axis_label(*who)),
                    names_only_in(a, b),
                    names_only_in(b, a),
                );
            }
        });
    }

    fn compare_faults(&mut self) {
        let maps = self.map_both(|s| {
            let each = s.faults.iter();
            each.map(|((who, code), fault)| ((self.axis_key(*who), *code), fault)).collect()
        });
        self.compare_maps(maps, |all, (who, code), a, b| {
            if let (Some(fault), None) | (None, Some(fault)) = (a, b) {
                let of = format!("{}  0x{code:X} {}", axis_label(*who), fault.text);
                all.push("fault", of, fault_times_text(a), fault_times_text(b));
            }
        });
    }

    fn compare_anomalies(&mut self) {
        let maps = self.map_both(|s| {
            let each = s.anomalies.by_axis();
            each.map(|(kind, who, count)| ((kind, self.axis_key(who)), count)).collect()
        });
        let lengths = [self.a, self.b].map(|summary| summary.length_ns().max(1) as f64);
        self.compare_maps(maps, |all, (kind, who), a, b| {
            let counts = [a, b].map(|count| count.copied().unwrap_or(0));
            let [one, other] = [0, 1].map(|n| counts[n] as f64 / lengths[n]);
            // By time, because captures have different lengths.
            if counts.contains(&0) || one.max(other) > one.min(other) * ANOMALY_FACTOR {
                let of = format!("{}  {}", axis_label(*who), kind.as_str());
                all.push("odd", of, times_text(counts[0]), times_text(counts[1]));
            }
        });
    }

    fn compare_values(&mut self) {
        let maps = self.map_both(|s| {
            s.values
                .iter()
                .map(|((who, name), values)| ((self.axis_key(*who), *name), values))
                .collect()
        });
        self.compare_maps(maps, |all, (who, name), a, b| {
            let same = match (a, b) {
                (Some(a), Some(b)) => all.same_range(a, b),
                _ => false,
            };
            if !same {
                all.push(
                    "value",
                    format!("{}  {name}", axis_label(*who)),
                    range_text(a),
                    range_text(b),
                );
            }
        });
    }

    /// A constant value has to be the same, a changing one needs about the same range.
    fn same_range(&self, a: &ValueSummary, b: &ValueSummary) -> bool {
        let (Some((least_a, most_a)), Some((least_b, most_b))) = (a.range, b.range) else {
            return a.range == b.range;
        };
        let span = (most_a - least_a).max(most_b - least_b);
        let slack = span * self.tolerance;
        (least_a - least_b).abs() <= slack && (most_a - most_b).abs() <= slack
    }

    fn compare_latencies(&mut self) {
        let maps = self.map_both(|s| {
            s.requests.iter().map(|((who, op), one)| ((self.axis_key(*who), *op), one)).collect()
        });
        self.compare_maps(maps, |all, (who, op), a, b| {
            let (Some(a), Some(b)) = (a, b) else { return };
            if has_few_replies(a) || has_few_replies(b) {
                return;
            }
            for (share, word, more) in [(0.5, "median", MEDIAN_TIMES), (0.99, "p99", TAIL_TIMES)] {
                let (one, other) = (a.latency.quantile(share), b.latency.quantile(share));
                let far = relative_gap(one as f64, other as f64) > all.tolerance * more;
                // Half a millisecond is the noise of an operating system, however large its share.
                if far && one.abs_diff(other) >= LATENCY_MIN_NS {
                    let of = format!("{}  {op} {word}", axis_label(*who));
                    all.push(
                        "latency",
                        of,
                        DurationText(one).to_string(),
                        DurationText(other).to_string(),
                    );
                }
            }
        });
    }
}

fn has_few_replies(requests: &RequestSummary) -> bool {
    requests.latency.count() < COUNT_MIN
}

fn fault_times_text(seen: Option<&&FaultSummary>) -> String {
    seen.map_or_else(|| "none".to_owned(), |seen| times_text(seen.count))
}

fn names_only_in(names: &BTreeSet<InternedName>, other: &BTreeSet<InternedName>) -> String {
    let names: Vec<InternedName> = names.difference(other).copied().collect();
    if names.is_empty() { "none besides".to_owned() } else { names.join(", ") }
}

fn rate_text(rate: f64) -> String {
    format!("{rate:.1}/s")
}

fn is_axis_missing(
    map: &IndexedMap<AxisKey, AxisSummary>,
    all: &SummaryComparison<'_>,
    who: &AxisKey,
) -> bool {
    who.axis.is_some() && !map.keys().any(|known| all.axis_key(*known) == *who)
}

/// Relative difference, as a share of the smaller one.
fn relative_gap(one: f64, other: f64) -> f64 {
    one.max(other) / one.min(other).max(f64::MIN_POSITIVE) - 1.0
}

fn frame_count_text(count: Option<&u64>) -> String {
    match count {
        None => "none".to_owned(),
        Some(1) => "1 frame".to_owned(),
        Some(count) => format!("{count} frames"),
    }
}

fn times_text(count: u64) -> String {
    match count {
        0 => "none".to_owned(),
        1 => "once".to_owned(),
        count => format!("{count} times"),
    }
}

fn range_text(values: Option<&&ValueSummary>) -> String {
    let Some(ValueSummary { range: Some((min, max)), unit, .. }) = values else {
        return "none".to_owned();
    };
    let gap = if unit.is_empty() { "" } else { " " };
    let (number_text, most) = (NumberText(*min), NumberText(*max));
    if number_text.0 == most.0 {
        format!("{number_text}{gap}{unit}")
    } else {
        format!("{number_text} to {most}{gap}{unit}")
    }
}

#[cfg(test)]
mod tests;
