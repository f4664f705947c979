//! The summary as JSON.

use serde_json::{Map, Value, json};

use super::summary_text::{BURSTS_SHOWN, SummaryStyle};
use super::{AxisKey, Histogram, Summary};
use crate::read::ReadStatistics;
use crate::session::ExchangeOutcome;
use crate::timestamp::Timestamp;

/// Places that could not be read, which are listed.
const DAMAGE_SHOWN: usize = 5;

/// The summary as one JSON object. `left_out` counts the places of the file that could not be read, and notices of more
/// kinds than are counted.
/// Times are seconds since 1970, spans and latencies seconds.
#[must_use]
pub fn to_json(summary: &Summary, manner: &SummaryStyle, reading: &ReadStatistics) -> Value {
    let skipped = |(kind, count): &(&'static str, u64)| json!({ "kind": kind, "count": count });
    json!({
        "frames": summary.frames,
        "wrong": summary.defective,
        "begin": time(summary.span.map(|(first, _)| first)),
        "seconds": seconds(summary.length_ns()),
        "links": links(summary, manner),
        "axes": axes(summary, manner),
        "kinds": kinds(summary),
        "requests": requests(summary),
        "values": values(summary),
        "faults": faults(summary),
        "odd": anomaly_counts(summary),
        "moments": anomaly_bursts(summary),
        "left_out": reading.damaged + summary.dropped,
        "damage": reading.damage.iter().take(DAMAGE_SHOWN).map(ToString::to_string).collect::<Vec<_>>(),
        "skipped": reading.skipped.iter().map(skipped).collect::<Vec<_>>(),
        "clean": summary.is_clean(),
    })
}

fn links(summary: &Summary, manner: &SummaryStyle) -> Vec<Value> {
    let spent = summary.length_ns() as f64 / 1e9;
    summary
        .links
        .iter()
        .map(|(name, link)| {
            let peak = link.load.peak_per_s(summary.length_ns());
            let rate = manner.rate(name, link);
            let mean = (spent > 0.0).then(|| link.load.bits() as f64 / spent);
            json!({
                "link": name,
                "frames": link.frames,
                "bytes": link.bytes,
                "protocols": link.protocols,
                "bit_rate": rate.map(|(rate, _)| rate),
                "bit_rate_stated": rate.map(|(_, stated)| stated),
                "bits_per_s": mean,
                "peak_bits_per_s": peak,
                "load": load_share(mean, rate),
                "peak_load": load_share(Some(peak), rate),
            })
        })
        .collect()
}

fn load_share(bits: Option<f64>, rate: Option<(u32, bool)>) -> Option<f64> {
    Some(bits? / f64::from(rate?.0))
}

fn axes(summary: &Summary, manner: &SummaryStyle) -> Vec<Value> {
    let end = summary.span.map(|(_, last)| last);
    summary
        .axes
        .iter()
        .map(|(who, axis)| {
            let states = axis.states.iter().map(|(what, states)| {
                let spent = states.durations_until(end);
                let spent = spent.iter().map(|(state, ns)| ((*state).to_owned(), seconds(*ns)));
                let changes: Vec<Value> = states
                    .changes
                    .iter()
                    .map(|(at, to)| json!({"time": time(*at), "to": to}))
                    .collect();
                let value = json!({
                    "changes": states.count,
                    "first": changes,
                    "seconds": spent.collect::<Map<String, Value>>(),
                    "last": states.current.map(|(state, _)| state),
                });
                ((*what).to_owned(), value)
            });
            with_owner(
                *who,
                json!({
                    "frames": axis.frames,
                    "begin": time(axis.span.map(|(first, _)| first)),
                    "end": time(axis.span.map(|(_, last)| last)),
                    "profile": manner.product(*who, axis),
                    "states": states.collect::<Map<String, Value>>(),
                }),
            )
        })
        .collect()
}

fn kinds(summary: &Summary) -> Vec<Value> {
    summary
        .kinds()
        .into_iter()
        .map(|kind| {
            with_owner(
                kind.who,
                json!({
                    "kind": kind.kind,
                    "id": kind.id.map(|(id, _)| id),
                    "extended": kind.id.map(|(_, extended)| extended),
                    "frames": kind.count,
                    "regular": kind.is_regular(),
                    "period": histogram(&kind.gaps),
                }),
            )
        })
        .collect()
}

fn requests(summary: &Summary) -> Vec<Value> {
    summary
        .requests
        .iter()
        .map(|((who, op), requests)| {
            let outcomes = super::OUTCOMES.map(|outcome| {
                let outcome: ExchangeOutcome = outcome;
                (outcome.as_str().to_owned(), json!(requests.count_of(outcome)))
            });
            with_owner(
                *who,
                json!({
                    "op": op,
                    "count": requests.count(),
                    "outcomes": Map::from_iter(outcomes),
                    "retries": requests.retries,
                    "latency": histogram(&requests.latency),
                    "slowest": Some(requests.slowest).filter(|number| *number > 0),
                }),
            )
        })
        .collect()
}

fn values(summary: &Summary) -> Vec<Value> {
    summary
        .values
        .iter()
        .map(|((who, name), values)| {
            with_owner(
                *who,
                json!({
                    "name": name,
                    "count": values.count,
                    "least": values.range.map(|(min, _)| min),
                    "most": values.range.map(|(_, max)| max),
                    "last": values.last,
                    "exact": values.exact,
                    "unit": values.unit,
                    "quality": values.quality.map(|quality| quality.as_str()),
                }),
            )
        })
        .collect()
}

fn faults(summary: &Summary) -> Vec<Value> {
    summary
        .faults
        .iter()
        .map(|((who, code), fault)| {
            with_owner(
                *who,
                json!({
                    "code": code,
                    "text": fault.text,
                    "cause": fault.cause,
                    "remedy": fault.remedy,
                    "count": fault.count,
                    "number": fault.first.map(|(number, _)| number),
                    "time": time(fault.first.and_then(|(_, time)| time)),
                    "last": time(fault.last),
                    "gone": fault.gone,
                }),
            )
        })
        .collect()
}

fn anomaly_counts(summary: &Summary) -> Map<String, Value> {
    summary
        .anomalies
        .counts()
        .map(|(kind, count)| (kind.as_str().to_owned(), json!(count)))
        .collect()
}

fn anomaly_bursts(summary: &Summary) -> Vec<Value> {
    summary
        .anomalies
        .most_notable(BURSTS_SHOWN)
        .into_iter()
        .map(|moment| {
            with_owner(
                moment.who,
                json!({
                    "kind": moment.kind.as_str(),
                    "number": Some(moment.number).filter(|number| *number > 0),
                    "time": time(moment.time),
                    "last": time(moment.last),
                    "count": moment.count,
                    "text": moment.text,
                }),
            )
        })
        .collect()
}

/// A value with its axis in front.
fn with_owner(who: AxisKey, rest: Value) -> Value {
    let mut all = Map::new();
    all.insert("link".into(), json!(who.link));
    all.insert("protocol".into(), json!(Some(who.protocol).filter(|word| !word.is_empty())));
    all.insert("axis".into(), json!(who.axis));
    if let Value::Object(rest) = rest {
        all.extend(rest);
    }
    Value::Object(all)
}

fn histogram(spread: &Histogram) -> Value {
    if spread.count() == 0 {
        return Value::Null;
    }
    json!({
        "count": spread.count(),
        "mean": spread.mean() / 1e9,
        "min": seconds(spread.min()),
        "p1": seconds(spread.quantile(0.01)),
        "median": seconds(spread.median()),
        "p99": seconds(spread.quantile(0.99)),
        "max": seconds(spread.max()),
    })
}

fn seconds(ns: u64) -> Value {
    json!(ns as f64 / 1e9)
}

fn time(stamp: Option<Timestamp>) -> Value {
    json!(stamp.map(|stamp| stamp.0 as f64 / 1e9))
}
