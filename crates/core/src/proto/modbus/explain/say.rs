//! Numbers as text, written by hand: no `core::fmt` on the way of a frame.

use crate::explain::Sink;
use crate::profile::Parameter;

const DIGITS_MAX: usize = 24;
/// Decimals of a scaled value.
const DECIMALS: i64 = 1000;

pub(super) fn decimal(value: i64, sink: &mut dyn Sink) {
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
    say(&buffer[at..], sink);
}

pub(super) fn hexadecimal(value: u64, digits: usize, sink: &mut dyn Sink) {
    let mut buffer = [b'0'; DIGITS_MAX];
    buffer[1] = b'x';
    let end = 2 + digits.min(16);
    for (place, slot) in buffer[2..end].iter_mut().rev().enumerate() {
        *slot = b"0123456789ABCDEF"[(value >> (4 * place) & 0xF) as usize];
    }
    say(&buffer[..end], sink);
}

/// A parameter's value in its unit, or its name; raw where the scale hangs on other parameters.
pub(super) fn scaled(parameter: &'static Parameter, raw: i64, sink: &mut dyn Sink) {
    if let Some((_, name)) = parameter.values.iter().find(|(value, _)| *value == raw) {
        decimal(raw, sink);
        sink.text(" (");
        sink.text(name);
        sink.text(")");
        return;
    }
    let scale = &parameter.scale;
    if scale.times.is_some() || scale.over.is_some() {
        decimal(raw, sink);
        sink.text(" raw");
        return;
    }
    real(raw as f64 * scale.factor, sink);
    let unit = parameter.unit.symbol();
    if !unit.is_empty() {
        sink.text(" ");
        sink.text(unit);
    }
}

/// At most three decimals, none where they are zero.
fn real(value: f64, sink: &mut dyn Sink) {
    let thousandths = libm::round(value * DECIMALS as f64) as i64;
    let (whole, part) = (thousandths / DECIMALS, (thousandths % DECIMALS).abs());
    if thousandths < 0 && whole == 0 {
        sink.text("-");
    }
    decimal(whole, sink);
    if part != 0 {
        let digits =
            [b'0' + (part / 100) as u8, b'0' + (part / 10 % 10) as u8, b'0' + (part % 10) as u8];
        let len = digits.iter().rposition(|&digit| digit != b'0').map_or(0, |at| at + 1);
        sink.text(".");
        say(&digits[..len], sink);
    }
}

fn say(characters: &[u8], sink: &mut dyn Sink) {
    sink.text(core::str::from_utf8(characters).unwrap_or(""));
}
