//! One JSON object a frame, fields always in the same order.

use polepair_core::explain::Direction;

use crate::decoder::Event;
use crate::explained::{Explained, Item, ItemValue, REMOTE_REQUEST};
use crate::put;
use crate::session::{Fault, Notice};
use crate::stamp::Stamp;

/// Appends one line: `{"time":…,"link":…,"direction":…,"protocol":…,"bytes":…,"id":…,"extended":…,
/// "kind":…,"axis":…,"fields":{…},"text":…,"ok":…,"error":…,"number":…}`, and `"notices":[…]` where
/// the conversation tells something at this frame.
///
/// `id` and `extended` are null for what did not come from a CAN bus. A field that occurs several
/// times in a frame is an array.
pub fn write(event: &Event<'_>, out: &mut Vec<u8>) {
    out.extend_from_slice(b"{\"time\":");
    maybe(out, event.time, stamp);
    key(out, "link");
    string(out, event.link);
    key(out, "direction");
    out.extend_from_slice(match event.direction {
        Some(Direction::ToDrive) => b"\"tx\"",
        Some(Direction::ToHost) => b"\"rx\"",
        None => b"null",
    });
    key(out, "protocol");
    string_or_null(out, event.protocol);
    key(out, "bytes");
    out.push(b'"');
    hex(out, event.bytes);
    out.push(b'"');
    key(out, "id");
    maybe(out, event.id, unsigned);
    key(out, "extended");
    maybe(out, event.id.map(|_| event.extended), flag);
    if event.remote {
        key(out, "remote");
        unsigned(out, event.wanted);
    }
    meaning(event, out);
    key(out, "number");
    unsigned(out, event.number);
    if !event.notices.is_empty() {
        key(out, "notices");
        list(out, event.notices.iter(), notice);
    }
    out.extend_from_slice(b"}\n");
}

/// Appends what a conversation tells, as an object: `{"notice":"odd",…}`.
pub fn notice(out: &mut Vec<u8>, notice: &Notice) {
    let begin = |out: &mut Vec<u8>, word, axis: Option<u32>| {
        out.extend_from_slice(b"{\"notice\":");
        string(out, word);
        key(out, "axis");
        maybe(out, axis, unsigned);
    };
    match notice {
        Notice::Signal(signal) => {
            begin(out, "signal", Some(signal.axis));
            words(out, &[("name", signal.name)]);
            key(out, "value");
            real(out, signal.value);
            key(out, "exact");
            maybe(out, signal.exact, |out, exact| put::signed(exact, out));
            words(out, &[("unit", signal.unit), ("quality", signal.quality.word())]);
            key(out, "request");
            maybe(out, signal.request, unsigned);
        }
        Notice::Exchange(exchange) => {
            begin(out, "exchange", exchange.axis);
            words(out, &[("op", exchange.op), ("outcome", exchange.outcome.word())]);
            key(out, "asked");
            unsigned(out, exchange.asked.0);
            key(out, "answered");
            maybe(out, exchange.answered.map(|(number, _)| number), unsigned);
            key(out, "latency");
            maybe(out, exchange.latency().map(|ns| ns as f64 / 1e9), real);
            key(out, "retries");
            unsigned(out, exchange.retries);
        }
        Notice::Change(change) => {
            begin(out, "change", change.axis);
            words(out, &[("what", change.what), ("from", change.from), ("to", change.to)]);
        }
        Notice::Fault(fault) => {
            begin(out, "fault", Some(fault.axis));
            key(out, "code");
            unsigned(out, fault.code);
            let Fault { text, cause, remedy, gone, .. } = fault;
            words(out, &[("text", text), ("cause", cause), ("remedy", remedy)]);
            key(out, "gone");
            flag(out, *gone);
        }
        Notice::Odd(odd) => {
            begin(out, "odd", odd.axis);
            words(out, &[("kind", odd.kind.word()), ("text", &odd.text)]);
            key(out, "time");
            maybe(out, odd.time, stamp);
        }
    }
    out.push(b'}');
}

fn words(out: &mut Vec<u8>, pairs: &[(&str, &str)]) {
    for (name, text) in pairs {
        key(out, name);
        string(out, text);
    }
}

fn meaning(event: &Event<'_>, out: &mut Vec<u8>) {
    let explained = event.explained;
    key(out, "kind");
    string_or_null(out, Some(explained.kind.as_str()).filter(|kind| !kind.is_empty()));
    key(out, "axis");
    maybe(out, explained.axis, unsigned);
    key(out, "fields");
    fields(out, explained);
    key(out, "text");
    out.push(b'"');
    if event.echo {
        out.extend_from_slice(b"echo: ");
    }
    if event.remote && explained.text.is_empty() {
        out.extend_from_slice(REMOTE_REQUEST.as_bytes());
    }
    escaped(out, &explained.text);
    out.push(b'"');
    key(out, "ok");
    flag(out, event.wrong.is_none());
    key(out, "error");
    match event.wrong {
        None => out.extend_from_slice(b"null"),
        Some(wrong) => string(out, &wrong.to_string()),
    }
}

/// Appends the fields as an object.
pub fn fields(out: &mut Vec<u8>, explained: &Explained) {
    out.push(b'{');
    let items: Vec<Item<'_>> = explained.items().collect();
    for (at, item) in items.iter().enumerate() {
        if items[..at].iter().any(|earlier| earlier.name == item.name) {
            continue;
        }
        if at > 0 {
            out.push(b',');
        }
        string(out, item.name);
        out.push(b':');
        let same = items[at..].iter().filter(|other| other.name == item.name);
        if same.clone().count() == 1 {
            value(out, &item.value);
        } else {
            list(out, same.map(|item| item.value), |out, item| value(out, &item));
        }
    }
    out.push(b'}');
}

fn value(out: &mut Vec<u8>, item: &ItemValue<'_>) {
    match *item {
        ItemValue::Int(value) => put::signed(value, out),
        ItemValue::Hex(value, _) => put::unsigned(value, out),
        ItemValue::Real(value) => real(out, value),
        ItemValue::Text(text) => string(out, text),
        ItemValue::Words(words) => {
            let words =
                words.chunks(2).map(|w| w.iter().fold(0, |sum, b| sum << 8 | u32::from(*b)));
            list(out, words, unsigned);
        }
    }
}

fn list<T>(out: &mut Vec<u8>, items: impl Iterator<Item = T>, each: impl Fn(&mut Vec<u8>, T)) {
    out.push(b'[');
    for (at, item) in items.enumerate() {
        if at > 0 {
            out.push(b',');
        }
        each(out, item);
    }
    out.push(b']');
}

fn key(out: &mut Vec<u8>, name: &str) {
    out.extend_from_slice(b",\"");
    out.extend_from_slice(name.as_bytes());
    out.extend_from_slice(b"\":");
}

fn maybe<T>(out: &mut Vec<u8>, value: Option<T>, write: impl Fn(&mut Vec<u8>, T)) {
    match value {
        Some(value) => write(out, value),
        None => out.extend_from_slice(b"null"),
    }
}

fn unsigned(out: &mut Vec<u8>, value: impl Into<u64>) {
    put::unsigned(value.into(), out);
}

fn flag(out: &mut Vec<u8>, value: bool) {
    out.extend_from_slice(if value { b"true" } else { b"false" });
}

/// Seconds, as [`Stamp`] shows them.
fn stamp(out: &mut Vec<u8>, time: Stamp) {
    const NS: u64 = 1_000_000_000;
    put::unsigned(time.0 / NS, out);
    out.push(b'.');
    put::filled(time.0 % NS, 9, b'0', out);
    // One decimal stays at least.
    let zeros = out.iter().rev().take(8).take_while(|digit| **digit == b'0').count();
    out.truncate(out.len() - zeros);
}

fn string_or_null(out: &mut Vec<u8>, text: Option<&str>) {
    match text {
        Some(text) => string(out, text),
        None => out.extend_from_slice(b"null"),
    }
}

/// Appends a real number; JSON knows none that are not finite, which become `null`.
pub fn real(out: &mut Vec<u8>, value: f64) {
    maybe(out, Some(value).filter(|value| value.is_finite()), |out, value| put::real(value, out));
}

/// Appends a quoted JSON string.
pub fn string(out: &mut Vec<u8>, text: &str) {
    out.push(b'"');
    escaped(out, text);
    out.push(b'"');
}

fn escaped(out: &mut Vec<u8>, text: &str) {
    let mut rest = text.as_bytes();
    while let Some(at) = odd(rest) {
        out.extend_from_slice(&rest[..at]);
        match rest[at] {
            b'"' => out.extend_from_slice(b"\\\""),
            b'\\' => out.extend_from_slice(b"\\\\"),
            b'\n' => out.extend_from_slice(b"\\n"),
            b'\r' => out.extend_from_slice(b"\\r"),
            b'\t' => out.extend_from_slice(b"\\t"),
            byte => {
                let [high, low] = put::hex(byte).map(|digit| digit.to_ascii_lowercase());
                out.extend_from_slice(&[b'\\', b'u', b'0', b'0', high, low]);
            }
        }
        rest = &rest[at + 1..];
    }
    out.extend_from_slice(rest);
}

/// Where the first byte is that JSON does not take as it is.
fn odd(text: &[u8]) -> Option<usize> {
    const ONES: u64 = 0x0101_0101_0101_0101;
    // The uppermost bit of a byte below `limit`, and perhaps of some behind it.
    let below = |eight: u64, limit: u64| eight.wrapping_sub(limit * ONES) & !eight & (0x80 * ONES);
    let is = |eight: u64, byte: u8| below(eight ^ (u64::from(byte) * ONES), 1);
    let plain = |eight: &&[u8; 8]| {
        let eight = u64::from_le_bytes(**eight);
        below(eight, 0x20) | is(eight, b'"') | is(eight, b'\\') == 0
    };
    let begun = 8 * text.as_chunks::<8>().0.iter().take_while(plain).count();
    let escaped = |byte: &u8| matches!(byte, b'"' | b'\\' | 0..0x20);
    text[begun..].iter().position(escaped).map(|at| begun + at)
}

/// Appends bytes as hexadecimal digits without spaces.
pub fn hex(out: &mut Vec<u8>, bytes: &[u8]) {
    bytes.iter().for_each(|byte| out.extend_from_slice(&put::hex(*byte)));
}
