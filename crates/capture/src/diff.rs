//! What differs between two captures in behaviour: who was there, what was said how often, states,
//! faults, oddities, values, and how long answers took. Neither bytes nor times are compared.

use std::collections::{BTreeMap, BTreeSet};

use crate::session::Name;
use crate::summary::{Kind, Requests, Summary, Values, Who, named};
use crate::text::{Real, Span};

/// Frames of a kind, or requests, from which on rates and latencies are compared.
const ENOUGH: u64 = 10;
/// A latency's median may differ by so many times the tolerance, and its 99th percentile by so many.
const MEDIAN_TIMES: f64 = 2.5;
const TAIL_TIMES: f64 = 5.0;
/// Latencies that differ by less are the same, ns.
const LATENCY_MIN_NS: u64 = 500_000;
/// Oddities may be so many times as frequent.
const ODD_TIMES: f64 = 2.0;

/// One thing that differs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Difference {
    /// What sort of thing: `axis`, `frames`, `rate`, `state`, `fault`, `odd`, `value`, `latency`.
    pub what: &'static str,
    /// Whose, and which.
    pub of: String,
    /// In the first capture.
    pub a: String,
    /// In the second.
    pub b: String,
}

/// What differs between `a` and `b`. Rates, and ranges of values, may differ by `tolerance` (0.2 for
/// a fifth).
#[must_use]
pub fn diff(a: &Summary, b: &Summary, tolerance: f64) -> Vec<Difference> {
    // A machine's only link may have another name in another capture.
    let alone = a.links.len() == 1 && b.links.len() == 1;
    let mut compared = Compared { a, b, alone, tolerance, found: Vec::new() };
    compared.axes();
    compared.kinds();
    compared.states();
    compared.faults();
    compared.oddities();
    compared.values();
    compared.latencies();
    compared.found
}

struct Compared<'s> {
    a: &'s Summary,
    b: &'s Summary,
    alone: bool,
    tolerance: f64,
    found: Vec<Difference>,
}

impl<'s> Compared<'s> {
    fn who(&self, who: Who) -> Who {
        if self.alone { Who { link: "", ..who } } else { who }
    }

    fn differs(&mut self, what: &'static str, of: String, a: String, b: String) {
        self.found.push(Difference { what, of, a, b });
    }

    /// Something of one capture beside that of the other.
    fn each<K: Ord, V>(
        &mut self,
        maps: [BTreeMap<K, V>; 2],
        mut compare: impl FnMut(&mut Self, &K, Option<&V>, Option<&V>),
    ) {
        let keys: BTreeSet<&K> = maps.iter().flat_map(BTreeMap::keys).collect();
        for key in keys {
            compare(self, key, maps[0].get(key), maps[1].get(key));
        }
    }

    fn both<K: Ord, V>(&self, map: impl Fn(&'s Summary) -> BTreeMap<K, V>) -> [BTreeMap<K, V>; 2] {
        [map(self.a), map(self.b)]
    }

    fn axes(&mut self) {
        let maps =
            self.both(|s| s.axes.iter().map(|(w, axis)| (self.who(*w), axis.frames)).collect());
        self.each(maps, |all, who, a, b| {
            if a.is_none() || b.is_none() {
                all.differs("axis", named(*who), frames(a), frames(b));
            }
        });
    }

    fn kinds(&mut self) {
        type Key = (Who, Name, Option<(u32, bool)>);
        let key = |kind: &Kind| -> Key { (self.who(kind.who), kind.kind, kind.id) };
        let maps = self.both(|s| s.kinds().into_iter().map(|k| (key(k), k)).collect());
        self.each(maps, |all, (who, kind, id), a, b| {
            let missing = |map: &BTreeMap<Who, crate::summary::Axis>| {
                who.axis.is_some() && !map.keys().any(|known| all.who(*known) == *who)
            };
            // Told already: the axis is missing.
            if missing(&all.a.axes) || missing(&all.b.axes) {
                return;
            }
            let id = id.map_or_else(String::new, |(id, _)| format!(" {id:03X}h"));
            let of = format!("{}  {kind}{id}", named(*who));
            match (a, b) {
                (Some(a), Some(b)) => all.rate(of, a, b),
                (a, b) => all.differs(
                    "frames",
                    of,
                    frames(a.map(|a| &a.count)),
                    frames(b.map(|b| &b.count)),
                ),
            }
        });
    }

    fn rate(&mut self, of: String, a: &Kind, b: &Kind) {
        let rate = |kind: &Kind, summary: &Summary| match kind.is_regular() {
            true => 1e9 / kind.gaps.median().max(1) as f64,
            false => kind.count as f64 * 1e9 / summary.length_ns().max(1) as f64,
        };
        let rates = (rate(a, self.a), rate(b, self.b));
        let enough = a.count.max(b.count) >= ENOUGH;
        if enough && apart(rates.0, rates.1) > self.tolerance {
            let shown = |rate| format!("{rate:.1}/s");
            self.differs("rate", of, shown(rates.0), shown(rates.1));
        }
    }

    fn states(&mut self) {
        let states = |s: &'s Summary| {
            let each = s.axes.iter().flat_map(|(who, axis)| {
                axis.states.iter().map(|(what, states)| ((self.who(*who), *what), states))
            });
            let reached = each.map(|(key, states)| {
                let names: BTreeSet<Name> = states.spent.iter().map(|(name, _)| *name).collect();
                (key, names)
            });
            reached.collect()
        };
        let maps = self.both(states);
        self.each(maps, |all, (who, what), a, b| {
            let none = BTreeSet::new();
            let (a, b) = (a.unwrap_or(&none), b.unwrap_or(&none));
            if a != b {
                let alone = |names: &BTreeSet<Name>, other: &BTreeSet<Name>| {
                    let names: Vec<Name> = names.difference(other).copied().collect();
                    if names.is_empty() { "none besides".to_owned() } else { names.join(", ") }
                };
                all.differs("state", format!("{}  {what}", named(*who)), alone(a, b), alone(b, a));
            }
        });
    }

    fn faults(&mut self) {
        let maps = self.both(|s| {
            let each = s.faults.iter();
            each.map(|((who, code), fault)| ((self.who(*who), *code), fault)).collect()
        });
        self.each(maps, |all, (who, code), a, b| {
            if let (Some(fault), None) | (None, Some(fault)) = (a, b) {
                let of = format!("{}  0x{code:X} {}", named(*who), fault.text);
                let shown = |seen: Option<&&crate::summary::FaultSeen>| {
                    seen.map_or_else(|| "none".to_owned(), |seen| times(seen.count))
                };
                all.differs("fault", of, shown(a), shown(b));
            }
        });
    }

    fn oddities(&mut self) {
        let maps = self.both(|s| {
            let each = s.moments.by_axis();
            each.map(|(kind, who, count)| ((kind, self.who(who)), count)).collect()
        });
        let lengths = [self.a, self.b].map(|summary| summary.length_ns().max(1) as f64);
        self.each(maps, |all, (kind, who), a, b| {
            let counts = [a, b].map(|count| count.copied().unwrap_or(0));
            let [one, other] = [0, 1].map(|n| counts[n] as f64 / lengths[n]);
            if counts.contains(&0) || one.max(other) > one.min(other) * ODD_TIMES {
                let of = format!("{}  {}", named(*who), kind.word());
                all.differs("odd", of, times(counts[0]), times(counts[1]));
            }
        });
    }

    fn values(&mut self) {
        let maps = self.both(|s| {
            s.values.iter().map(|((who, name), values)| ((self.who(*who), *name), values)).collect()
        });
        self.each(maps, |all, (who, name), a, b| {
            let same = match (a, b) {
                (Some(a), Some(b)) => all.alike(a, b),
                _ => false,
            };
            if !same {
                all.differs("value", format!("{}  {name}", named(*who)), range(a), range(b));
            }
        });
    }

    /// A value that stood still has to be the same, one that moved about the same range.
    fn alike(&self, a: &Values, b: &Values) -> bool {
        let (Some((least_a, most_a)), Some((least_b, most_b))) = (a.range, b.range) else {
            return a.range == b.range;
        };
        let span = (most_a - least_a).max(most_b - least_b);
        let slack = span * self.tolerance;
        (least_a - least_b).abs() <= slack && (most_a - most_b).abs() <= slack
    }

    fn latencies(&mut self) {
        let maps = self.both(|s| {
            s.requests.iter().map(|((who, op), one)| ((self.who(*who), *op), one)).collect()
        });
        self.each(maps, |all, (who, op), a, b| {
            let (Some(a), Some(b)) = (a, b) else { return };
            let few = |requests: &Requests| requests.latency.count() < ENOUGH;
            if few(a) || few(b) {
                return;
            }
            for (share, word, more) in [(0.5, "median", MEDIAN_TIMES), (0.99, "p99", TAIL_TIMES)] {
                let (one, other) = (a.latency.quantile(share), b.latency.quantile(share));
                let far = apart(one as f64, other as f64) > all.tolerance * more;
                if far && one.abs_diff(other) >= LATENCY_MIN_NS {
                    let of = format!("{}  {op} {word}", named(*who));
                    all.differs("latency", of, Span(one).to_string(), Span(other).to_string());
                }
            }
        });
    }
}

/// By what share of the smaller the greater is more.
fn apart(one: f64, other: f64) -> f64 {
    one.max(other) / one.min(other).max(f64::MIN_POSITIVE) - 1.0
}

fn frames(count: Option<&u64>) -> String {
    match count {
        None => "none".to_owned(),
        Some(1) => "1 frame".to_owned(),
        Some(count) => format!("{count} frames"),
    }
}

fn times(count: u64) -> String {
    match count {
        0 => "none".to_owned(),
        1 => "once".to_owned(),
        count => format!("{count} times"),
    }
}

fn range(values: Option<&&Values>) -> String {
    let Some(Values { range: Some((least, most)), unit, .. }) = values else {
        return "none".to_owned();
    };
    let gap = if unit.is_empty() { "" } else { " " };
    let (least, most) = (Real(*least), Real(*most));
    if least.0 == most.0 {
        format!("{least}{gap}{unit}")
    } else {
        format!("{least} to {most}{gap}{unit}")
    }
}

#[cfg(test)]
mod tests;
