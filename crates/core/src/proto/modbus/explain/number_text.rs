//! Numbers as text without `core::fmt`, for speed.

use crate::convert::ascii_text;
use crate::explain::{Decimal, ExplainSink, NumberPlace, NumberStyle, ShortText};
use crate::profile::{Encoding, Parameter};

const DIGITS_MAX: usize = 24;

pub(super) fn write_decimal(value: i64, sink: &mut dyn ExplainSink) {
    sink.text(Decimal::of(value).as_str());
}

pub(super) fn write_hex(value: u64, digits: usize, sink: &mut dyn ExplainSink) {
    let mut buffer = [b'0'; DIGITS_MAX];
    buffer[1] = b'x';
    let end = 2 + digits.min(16);
    for (index, slot) in buffer[2..end].iter_mut().rev().enumerate() {
        *slot = b"0123456789ABCDEF"[(value >> (4 * index) & 0xF) as usize];
    }
    write_ascii(&buffer[..end], sink);
}

/// Writes a number as it is in the frame.
pub(super) fn write_raw(raw: i64, place: Option<NumberPlace>, sink: &mut dyn ExplainSink) {
    match place {
        Some(place) => sink.number(raw, NumberStyle::Whole, place),
        None => write_decimal(raw, sink),
    }
}

/// A parameter's value in its unit, or its name; raw where the scale hangs on other parameters.
pub(super) fn write_scaled(
    parameter: &'static Parameter,
    raw: i64,
    place: Option<NumberPlace>,
    sink: &mut dyn ExplainSink,
) {
    if let Some((_, name)) = parameter.values.iter().find(|(value, _)| *value == raw) {
        write_decimal(raw, sink);
        sink.text(" (");
        sink.text(name);
        sink.text(")");
        return;
    }
    let scale = &parameter.scale;
    if !scale.is_constant() {
        write_raw(raw, place, sink);
        sink.text(" raw");
        return;
    }
    let value = parameter.encoding.number(raw) * scale.factor;
    // Fixed decimals are for what counts in steps.
    let style = NumberStyle::Scaled(scale.factor);
    let is_plain = parameter.encoding.number(raw).total_cmp(&(raw as f64)).is_eq();
    let digits = style.text_of(raw).filter(|_| is_plain && !parameter.encoding.is_real());
    match (digits, place) {
        (Some(_), Some(place)) => sink.number(raw, style, place),
        (Some(digits), None) => sink.text(digits.as_str()),
        (None, _) => {
            let text = match parameter.encoding {
                Encoding::F32 | Encoding::F32LowFirst => {
                    ShortText::from_display(format_args!("{:e}", value as f32))
                }
                _ => ShortText::from_display(format_args!("{value:e}")),
            };
            sink.text(text.as_str());
        }
    }
    let unit = parameter.unit.symbol();
    if !unit.is_empty() {
        sink.text(" ");
        sink.text(unit);
    }
}

fn write_ascii(characters: &[u8], sink: &mut dyn ExplainSink) {
    sink.text(ascii_text(characters));
}

/// Writes how many more there are than were shown.
pub(super) fn write_more(count: usize, sink: &mut dyn ExplainSink) {
    if count > 0 {
        sink.text(" and ");
        write_decimal(count as i64, sink);
        sink.text(" more");
    }
}

/// Writes the active lines, counted from 1 as the TS manual V2 §2.3 does; at most `max` by number.
pub(super) fn write_bits(bits: &[u8], count: u16, max: usize, sink: &mut dyn ExplainSink) {
    let on = |at: &u16| bits.get(usize::from(at / 8)).is_some_and(|byte| byte >> (at % 8) & 1 == 1);
    let all = (0..count).filter(on).count();
    for (nth, at) in (0..count).filter(on).take(max).enumerate() {
        sink.text(if nth > 0 { " " } else { "on: " });
        write_decimal(i64::from(at) + 1, sink);
    }
    if all == 0 {
        sink.text("all off");
    }
    write_more(all.saturating_sub(max), sink);
}
