//! Numbers as text without `core::fmt`, for speed.

use crate::convert::ascii_text;
use crate::explain::{ExplainSink, ShortText};
use crate::profile::{Encoding, Parameter};

const DIGITS_MAX: usize = 24;
/// Decimals of a scaled value.
const DECIMALS: i64 = 1000;

pub(super) fn write_decimal(value: i64, sink: &mut dyn ExplainSink) {
    let mut buffer = [0; DIGITS_MAX];
    let mut at = DIGITS_MAX;
    let mut rest = value.unsigned_abs();
    loop {
        at -= 1;
        buffer[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if value < 0 {
        at -= 1;
        buffer[at] = b'-';
    }
    write_ascii(&buffer[at..], sink);
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

/// A parameter's value in its unit, or its name; raw where the scale hangs on other parameters.
pub(super) fn write_scaled(parameter: &'static Parameter, raw: i64, sink: &mut dyn ExplainSink) {
    if let Some((_, name)) = parameter.values.iter().find(|(value, _)| *value == raw) {
        write_decimal(raw, sink);
        sink.text(" (");
        sink.text(name);
        sink.text(")");
        return;
    }
    let scale = &parameter.scale;
    if !scale.is_constant() {
        write_decimal(raw, sink);
        sink.text(" raw");
        return;
    }
    let value = parameter.encoding.number(raw) * scale.factor;
    // Fixed decimals are for what counts in steps.
    if parameter.encoding.is_real() || value.abs() > STEPS_MAX {
        let text = match parameter.encoding {
            Encoding::F32 | Encoding::F32LowFirst => {
                ShortText::from_display(format_args!("{:e}", value as f32))
            }
            _ => ShortText::from_display(format_args!("{value:e}")),
        };
        sink.text(text.as_str());
    } else {
        write_real(value, sink);
    }
    let unit = parameter.unit.symbol();
    if !unit.is_empty() {
        sink.text(" ");
        sink.text(unit);
    }
}

/// Beyond this thousandths do not fit the integer that they are counted in.
const STEPS_MAX: f64 = 9.0e12;

/// At most three decimals, none where they are zero.
fn write_real(value: f64, sink: &mut dyn ExplainSink) {
    let thousandths = libm::round(value * DECIMALS as f64) as i64;
    let (whole, part) = (thousandths / DECIMALS, (thousandths % DECIMALS).abs());
    if thousandths < 0 && whole == 0 {
        sink.text("-");
    }
    write_decimal(whole, sink);
    if part != 0 {
        let digits =
            [b'0' + (part / 100) as u8, b'0' + (part / 10 % 10) as u8, b'0' + (part % 10) as u8];
        let len = digits.iter().rposition(|&digit| digit != b'0').map_or(0, |at| at + 1);
        sink.text(".");
        write_ascii(&digits[..len], sink);
    }
}

fn write_ascii(characters: &[u8], sink: &mut dyn ExplainSink) {
    sink.text(ascii_text(characters));
}
