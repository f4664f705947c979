//! Output as JSON lines: one object for each frame, fields always in the same order.

use polepair_core::explain::Direction;

use crate::decoder::DecodedFrame;
use crate::explanation::{Explanation, ExplanationField, ExplanationValue, REMOTE_REQUEST};
use crate::number_text;
use crate::session::{FaultNotice, SessionNotice};
use crate::timestamp::Timestamp;

/// Appends one line: `{"time":…,"link":…,"direction":…,"protocol":…,"bytes":…,"id":…,"extended":…,
/// "kind":…,"axis":…,"fields":{…},"text":…,"ok":…,"error":…,"number":…}`, and `"notices":[…]` for notices of the
/// conversation at this frame.
///
/// `id` and `extended` are null for what did not come from a CAN bus. A field that occurs several
/// times in a frame is an array.
pub fn write_frame(event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
    out.extend_from_slice(b"{\"time\":");
    write_or_null(out, event.time, write_timestamp);
    write_key(out, "link");
    write_string(out, event.link);
    write_key(out, "direction");
    out.extend_from_slice(match event.direction {
        Some(Direction::ToDrive) => b"\"tx\"",
        Some(Direction::ToHost) => b"\"rx\"",
        None => b"null",
    });
    write_key(out, "protocol");
    write_string_or_null(out, event.protocol);
    write_key(out, "bytes");
    out.push(b'"');
    write_hex(out, event.bytes);
    out.push(b'"');
    write_key(out, "id");
    write_or_null(out, event.id, write_unsigned);
    write_key(out, "extended");
    write_or_null(out, event.id.map(|_| event.extended), write_bool);
    if event.remote {
        write_key(out, "remote");
        write_unsigned(out, event.remote_len);
    }
    write_meaning(event, out);
    write_key(out, "number");
    write_unsigned(out, event.number);
    if !event.notices.is_empty() {
        write_key(out, "notices");
        write_list(out, event.notices.iter(), write_notice);
    }
    out.extend_from_slice(b"}\n");
}

/// Appends a notice of a conversation as an object: `{"notice":"odd",…}`.
pub fn write_notice(out: &mut Vec<u8>, notice: &SessionNotice) {
    match notice {
        SessionNotice::Signal(signal) => {
            begin_notice(out, "signal", Some(signal.axis));
            write_words(out, &[("name", signal.name)]);
            write_key(out, "value");
            write_real(out, signal.value);
            write_key(out, "exact");
            write_or_null(out, signal.exact, |out, exact| number_text::append_signed(exact, out));
            write_words(out, &[("unit", signal.unit), ("quality", signal.quality.as_str())]);
            write_key(out, "request");
            write_or_null(out, signal.request, write_unsigned);
        }
        SessionNotice::Exchange(exchange) => {
            begin_notice(out, "exchange", exchange.axis);
            write_words(out, &[("op", exchange.op), ("outcome", exchange.outcome.as_str())]);
            write_key(out, "asked");
            write_unsigned(out, exchange.requested.0);
            write_key(out, "answered");
            write_or_null(out, exchange.answered.map(|(number, _)| number), write_unsigned);
            write_key(out, "latency");
            write_or_null(out, exchange.latency().map(|ns| ns as f64 / 1e9), write_real);
            write_key(out, "retries");
            write_unsigned(out, exchange.retries);
        }
        SessionNotice::Change(change) => {
            begin_notice(out, "change", change.axis);
            write_words(out, &[("what", change.what), ("from", change.from), ("to", change.to)]);
        }
        SessionNotice::Fault(fault) => {
            begin_notice(out, "fault", Some(fault.axis));
            write_key(out, "code");
            write_unsigned(out, fault.code);
            let FaultNotice { text, cause, remedy, gone, .. } = fault;
            write_words(out, &[("text", text), ("cause", cause), ("remedy", remedy)]);
            write_key(out, "gone");
            write_bool(out, *gone);
        }
        SessionNotice::Anomaly(anomaly) => {
            begin_notice(out, "odd", anomaly.axis);
            write_words(out, &[("kind", anomaly.kind.as_str()), ("text", &anomaly.text)]);
            write_key(out, "time");
            write_or_null(out, anomaly.time, write_timestamp);
        }
    }
    out.push(b'}');
}

fn begin_notice(out: &mut Vec<u8>, word: &str, axis: Option<u32>) {
    out.extend_from_slice(b"{\"notice\":");
    write_string(out, word);
    write_key(out, "axis");
    write_or_null(out, axis, write_unsigned);
}

fn write_words(out: &mut Vec<u8>, pairs: &[(&str, &str)]) {
    for (name, text) in pairs {
        write_key(out, name);
        write_string(out, text);
    }
}

fn write_meaning(event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
    let explained = event.explanation;
    write_key(out, "kind");
    write_string_or_null(out, Some(explained.kind.as_str()).filter(|kind| !kind.is_empty()));
    write_key(out, "axis");
    write_or_null(out, explained.axis, write_unsigned);
    write_key(out, "fields");
    write_fields(out, explained);
    write_key(out, "text");
    out.push(b'"');
    if event.echo {
        out.extend_from_slice(b"echo: ");
    }
    if event.remote && explained.text.is_empty() {
        out.extend_from_slice(REMOTE_REQUEST.as_bytes());
    }
    write_escaped(out, &explained.text);
    out.push(b'"');
    write_key(out, "ok");
    write_bool(out, event.defect.is_none());
    write_key(out, "error");
    match event.defect {
        None => out.extend_from_slice(b"null"),
        Some(wrong) => write_string(out, &wrong.to_string()),
    }
}

/// Appends the fields as an object.
pub fn write_fields(out: &mut Vec<u8>, explained: &Explanation) {
    out.push(b'{');
    let items: Vec<ExplanationField<'_>> = explained.fields().collect();
    for (at, item) in items.iter().enumerate() {
        if items[..at].iter().any(|earlier| earlier.name == item.name) {
            continue;
        }
        if at > 0 {
            out.push(b',');
        }
        write_string(out, item.name);
        out.push(b':');
        let same = items[at..].iter().filter(|other| other.name == item.name);
        if same.clone().count() == 1 {
            write_value(out, &item.value);
        } else {
            write_list(out, same.map(|item| item.value), |out, item| write_value(out, &item));
        }
    }
    out.push(b'}');
}

fn write_value(out: &mut Vec<u8>, item: &ExplanationValue<'_>) {
    match *item {
        ExplanationValue::Int(value) => number_text::append_signed(value, out),
        ExplanationValue::Hex(value, _) => number_text::append_unsigned(value, out),
        ExplanationValue::Real(value) => write_real(out, value),
        ExplanationValue::Text(text) => write_string(out, text),
        ExplanationValue::Words(words) => {
            let words =
                words.chunks(2).map(|w| w.iter().fold(0, |sum, b| sum << 8 | u32::from(*b)));
            write_list(out, words, write_unsigned);
        }
    }
}

fn write_list<T>(
    out: &mut Vec<u8>,
    items: impl Iterator<Item = T>,
    each: impl Fn(&mut Vec<u8>, T),
) {
    out.push(b'[');
    for (at, item) in items.enumerate() {
        if at > 0 {
            out.push(b',');
        }
        each(out, item);
    }
    out.push(b']');
}

fn write_key(out: &mut Vec<u8>, name: &str) {
    out.extend_from_slice(b",\"");
    out.extend_from_slice(name.as_bytes());
    out.extend_from_slice(b"\":");
}

fn write_or_null<T>(out: &mut Vec<u8>, value: Option<T>, write: impl Fn(&mut Vec<u8>, T)) {
    match value {
        Some(value) => write(out, value),
        None => out.extend_from_slice(b"null"),
    }
}

fn write_unsigned(out: &mut Vec<u8>, value: impl Into<u64>) {
    number_text::append_unsigned(value.into(), out);
}

fn write_bool(out: &mut Vec<u8>, value: bool) {
    out.extend_from_slice(if value { b"true" } else { b"false" });
}

/// Seconds, as [`Timestamp`] shows them.
fn write_timestamp(out: &mut Vec<u8>, time: Timestamp) {
    const NS: u64 = 1_000_000_000;
    number_text::append_unsigned(time.0 / NS, out);
    out.push(b'.');
    number_text::append_padded(time.0 % NS, 9, b'0', out);
    // One decimal stays at least.
    let zeros = out.iter().rev().take(8).take_while(|digit| **digit == b'0').count();
    out.truncate(out.len() - zeros);
}

fn write_string_or_null(out: &mut Vec<u8>, text: Option<&str>) {
    match text {
        Some(text) => write_string(out, text),
        None => out.extend_from_slice(b"null"),
    }
}

/// Appends a real number; JSON knows none that are not finite, which become `null`.
pub fn write_real(out: &mut Vec<u8>, value: f64) {
    write_or_null(out, Some(value).filter(|value| value.is_finite()), |out, value| {
        number_text::append_real(value, out)
    });
}

/// Appends a quoted JSON string.
pub fn write_string(out: &mut Vec<u8>, text: &str) {
    out.push(b'"');
    write_escaped(out, text);
    out.push(b'"');
}

fn write_escaped(out: &mut Vec<u8>, text: &str) {
    let mut rest = text.as_bytes();
    while let Some(at) = find_escape(rest) {
        out.extend_from_slice(&rest[..at]);
        match rest[at] {
            b'"' => out.extend_from_slice(b"\\\""),
            b'\\' => out.extend_from_slice(b"\\\\"),
            b'\n' => out.extend_from_slice(b"\\n"),
            b'\r' => out.extend_from_slice(b"\\r"),
            b'\t' => out.extend_from_slice(b"\\t"),
            byte => {
                let [high, low] =
                    number_text::hex_digits(byte).map(|digit| digit.to_ascii_lowercase());
                out.extend_from_slice(&[b'\\', b'u', b'0', b'0', high, low]);
            }
        }
        rest = &rest[at + 1..];
    }
    out.extend_from_slice(rest);
}

/// A one in each byte.
const ONES: u64 = 0x0101_0101_0101_0101;

/// Position of the first byte that JSON needs escaped.
fn find_escape(text: &[u8]) -> Option<usize> {
    let is = |eight: u64, byte: u8| bytes_below(eight ^ (u64::from(byte) * ONES), 1);
    let started_at = 8 * text
        .as_chunks::<8>()
        .0
        .iter()
        .take_while(|eight| {
            let eight = u64::from_le_bytes(**eight);
            bytes_below(eight, 0x20) | is(eight, b'"') | is(eight, b'\\') == 0
        })
        .count();
    text[started_at..]
        .iter()
        .position(|byte| matches!(byte, b'"' | b'\\' | 0..0x20))
        .map(|at| started_at + at)
}

/// The uppermost bit of each byte below `limit`, and perhaps of some behind it.
fn bytes_below(eight: u64, limit: u64) -> u64 {
    eight.wrapping_sub(limit * ONES) & !eight & (0x80 * ONES)
}

/// Appends bytes as hexadecimal digits without spaces.
pub fn write_hex(out: &mut Vec<u8>, bytes: &[u8]) {
    bytes.iter().for_each(|byte| out.extend_from_slice(&number_text::hex_digits(*byte)));
}
