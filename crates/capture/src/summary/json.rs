//! A summary for programs.

use serde_json::{Map, Value, json};

use super::show::{MOMENTS, Manner};
use super::{Spread, Summary, Who};
use crate::session::Outcome;
use crate::stamp::Stamp;

/// The summary as one JSON object. Times are seconds since 1970, spans and latencies seconds.
#[must_use]
pub fn json(summary: &Summary, manner: &Manner) -> Value {
    json!({
        "frames": summary.frames,
        "wrong": summary.wrong,
        "begin": time(summary.span.map(|(first, _)| first)),
        "seconds": seconds(summary.length_ns()),
        "links": links(summary, manner),
        "axes": axes(summary, manner),
        "kinds": kinds(summary),
        "requests": requests(summary),
        "values": values(summary),
        "faults": faults(summary),
        "odd": odd(summary),
        "moments": moments(summary),
        "left_out": summary.beyond,
        "clean": summary.is_clean(),
    })
}

fn links(summary: &Summary, manner: &Manner) -> Vec<Value> {
    let spent = summary.length_ns() as f64 / 1e9;
    let link = |(name, link): (&&str, &super::Link)| {
        let peak = link.load.peak_per_s(summary.length_ns());
        let rate = manner.rate(name, link);
        let mean = (spent > 0.0).then(|| link.load.bits() as f64 / spent);
        let share = |bits: Option<f64>| Some(bits? / f64::from(rate?.0));
        json!({
            "link": name,
            "frames": link.frames,
            "bytes": link.bytes,
            "protocols": link.protocols,
            "bit_rate": rate.map(|(rate, _)| rate),
            "bit_rate_stated": rate.map(|(_, stated)| stated),
            "bits_per_s": mean,
            "peak_bits_per_s": peak,
            "load": share(mean),
            "peak_load": share(Some(peak)),
        })
    };
    summary.links.iter().map(link).collect()
}

fn axes(summary: &Summary, manner: &Manner) -> Vec<Value> {
    let end = summary.span.map(|(_, last)| last);
    let axis = |(who, axis): (&Who, &super::Axis)| {
        let states = axis.states.iter().map(|(what, states)| {
            let spent = states.until(end);
            let spent = spent.iter().map(|(state, ns)| ((*state).to_owned(), seconds(*ns)));
            let changes: Vec<Value> = states
                .changes
                .iter()
                .map(|(at, to)| json!({"time": time(*at), "to": to}))
                .collect();
            let told = json!({
                "changes": states.count,
                "first": changes,
                "seconds": spent.collect::<Map<String, Value>>(),
                "last": states.now.map(|(state, _)| state),
            });
            ((*what).to_owned(), told)
        });
        owned(
            *who,
            json!({
                "frames": axis.frames,
                "begin": time(axis.span.map(|(first, _)| first)),
                "end": time(axis.span.map(|(_, last)| last)),
                "profile": manner.product(*who, axis),
                "states": states.collect::<Map<String, Value>>(),
            }),
        )
    };
    summary.axes.iter().map(axis).collect()
}

fn kinds(summary: &Summary) -> Vec<Value> {
    let kind = |kind: &super::Kind| {
        owned(
            kind.who,
            json!({
                "kind": kind.kind,
                "id": kind.id.map(|(id, _)| id),
                "extended": kind.id.map(|(_, extended)| extended),
                "frames": kind.count,
                "regular": kind.is_regular(),
                "period": spread(&kind.gaps),
            }),
        )
    };
    summary.kinds().into_iter().map(kind).collect()
}

fn requests(summary: &Summary) -> Vec<Value> {
    let request = |((who, op), requests): (&(Who, &str), &super::Requests)| {
        let outcomes = super::OUTCOMES.map(|outcome| {
            let outcome: Outcome = outcome;
            (outcome.word().to_owned(), json!(requests.ended(outcome)))
        });
        owned(
            *who,
            json!({
                "op": op,
                "count": requests.count(),
                "outcomes": Map::from_iter(outcomes),
                "retries": requests.retries,
                "latency": spread(&requests.latency),
                "slowest": Some(requests.slowest).filter(|number| *number > 0),
            }),
        )
    };
    summary.requests.iter().map(request).collect()
}

fn values(summary: &Summary) -> Vec<Value> {
    let value = |((who, name), values): (&(Who, &str), &super::Values)| {
        owned(
            *who,
            json!({
                "name": name,
                "count": values.count,
                "least": values.range.map(|(least, _)| least),
                "most": values.range.map(|(_, most)| most),
                "last": values.last,
                "exact": values.exact,
                "unit": values.unit,
                "quality": values.quality.map(|quality| quality.word()),
            }),
        )
    };
    summary.values.iter().map(value).collect()
}

fn faults(summary: &Summary) -> Vec<Value> {
    let fault = |((who, code), fault): (&(Who, u32), &super::FaultSeen)| {
        owned(
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
    };
    summary.faults.iter().map(fault).collect()
}

fn odd(summary: &Summary) -> Map<String, Value> {
    summary.moments.counts().map(|(kind, count)| (kind.word().to_owned(), json!(count))).collect()
}

fn moments(summary: &Summary) -> Vec<Value> {
    let moment = |moment: &super::Moment| {
        owned(
            moment.who,
            json!({
                "kind": moment.kind.word(),
                "number": Some(moment.number).filter(|number| *number > 0),
                "time": time(moment.time),
                "last": time(moment.last),
                "count": moment.count,
                "text": moment.text,
            }),
        )
    };
    summary.moments.oddest(MOMENTS).into_iter().map(moment).collect()
}

/// What somebody has, with who that is in front.
fn owned(who: Who, rest: Value) -> Value {
    let mut all = Map::new();
    all.insert("link".into(), json!(who.link));
    all.insert("protocol".into(), json!(Some(who.protocol).filter(|word| !word.is_empty())));
    all.insert("axis".into(), json!(who.axis));
    if let Value::Object(rest) = rest {
        all.extend(rest);
    }
    Value::Object(all)
}

fn spread(spread: &Spread) -> Value {
    if spread.count() == 0 {
        return Value::Null;
    }
    json!({
        "count": spread.count(),
        "mean": spread.mean() / 1e9,
        "min": seconds(spread.least()),
        "p1": seconds(spread.quantile(0.01)),
        "median": seconds(spread.median()),
        "p99": seconds(spread.quantile(0.99)),
        "max": seconds(spread.most()),
    })
}

fn seconds(ns: u64) -> Value {
    json!(ns as f64 / 1e9)
}

fn time(stamp: Option<Stamp>) -> Value {
    json!(stamp.map(|stamp| stamp.0 as f64 / 1e9))
}
