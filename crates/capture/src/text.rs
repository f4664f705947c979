//! Output as text: one aligned line for each frame, with its notices below.

mod batch_lines;

use std::io::Write as _;

use polepair_core::escape::{EscapedText, is_plain};
use polepair_core::explain::Direction;

use crate::byte_changes::{ByteChanges, meaning_text};
use crate::decoder::DecodedFrame;
use crate::line_buffer::LineBuffer;
use crate::line_layout::{LineLayout, protocol_word};
use crate::number_text;
use crate::session::{
    AnomalyNotice, ChangeNotice, ExchangeNotice, ExchangeOutcome, FaultNotice, SessionNotice,
    SignalNotice, is_frame_anomaly,
};
use crate::timestamp::Timestamp;

/// Columns that bytes take before a line grows beyond the rest: nine bytes with spaces.
const BYTES_WIDTH: usize = 26;

/// Style of lines.
#[derive(Clone, Copy, Debug, Default)]
pub struct TextStyle {
    /// With ANSI colours.
    pub colour: bool,
    /// A `'` behind each byte that differs from the last frame of its kind; in colour these
    /// bytes are underlined anyway.
    pub marks: bool,
    /// Notices to print.
    pub notices: NoticeLevel,
}

/// Level of notices to print.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum NoticeLevel {
    /// Nothing: frames alone.
    None,
    /// Anomalies, faults, changes of states, and response times.
    #[default]
    Events,
    /// Values too.
    All,
}

/// Writes frames as text. Times are shown from the first frame on.
#[derive(Clone, Debug, Default)]
pub struct FrameTextWriter {
    style: TextStyle,
    layout: LineLayout,
    changes: ByteChanges,
    buffer: LineBuffer,
}

const OFF: &[u8] = b"\x1b[0m";
const DIM: &str = "2";
const RED: &str = "31";
const YELLOW: &str = "33";
const CYAN: &str = "36";

impl FrameTextWriter {
    /// A writer that has written nothing.
    #[must_use]
    pub fn new(style: TextStyle) -> Self {
        Self { style, ..Self::default() }
    }

    /// Appends one line, and one for each notice that is shown below it.
    pub fn write(&mut self, event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
        out.reserve(LINE_ROOM);
        let start = out.len();
        self.layout.include(event.time, event.link, event.protocol);
        self.write_time(event.time, out);
        let head = out.len();
        append_padded(event.link, self.layout.link_width, out);
        out.push(b' ');
        self.write_arrow(event.direction, out);
        out.push(b' ');
        append_padded(protocol_word(event.protocol), self.layout.protocol_width, out);
        out.extend_from_slice(b"  ");
        let hidden = self.write_bytes(event, out);
        let column = out.len() - head - hidden - self.hidden_arrow_len(event.direction);
        let column = column + if head > start { TIME_WIDTH } else { 0 };
        self.write_meaning(event, out);
        out.push(b'\n');
        if self.style.notices != NoticeLevel::None {
            let news =
                |notice: &&SessionNotice| event.defect.is_none() || !is_frame_anomaly(notice);
            event.notices.iter().filter(news).for_each(|one| self.write_notice(one, column, out));
        }
    }

    /// A frame that is not shown; times count from the first, shown or not.
    pub fn skip_frame(&mut self, event: &DecodedFrame<'_>) {
        self.layout.first = self.layout.first.or(event.time);
    }

    /// Appends what conversations leave open, which is no frame.
    pub fn write_open_notices(&mut self, event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
        for notice in event.notices.iter().filter(|_| self.style.notices != NoticeLevel::None) {
            let begin = out.len();
            append_padded(event.link, 0, out);
            let named = out.len();
            self.write_notice(notice, 1, out);
            if out.len() == named {
                out.truncate(begin);
            }
        }
    }

    fn write_time(&self, time: Option<Timestamp>, out: &mut Vec<u8>) {
        let Some(time) = time else { return };
        let since = time.since(self.layout.first.unwrap_or(time));
        self.begin_colour(DIM, out);
        number_text::append_padded(since / 1_000_000_000, 4, b' ', out);
        out.push(b'.');
        number_text::append_padded(since % 1_000_000_000 / 1000, 6, b'0', out);
        self.end_colour(out);
        out.extend_from_slice(b"  ");
    }

    fn write_arrow(&self, direction: Option<Direction>, out: &mut Vec<u8>) {
        out.extend_from_slice(match (direction, self.style.colour) {
            (Some(Direction::ToDrive), false) => b">",
            (Some(Direction::ToHost), false) => b"<",
            (Some(Direction::ToDrive), true) => b"\x1b[36m>\x1b[0m",
            (Some(Direction::ToHost), true) => b"\x1b[33m<\x1b[0m",
            (None, _) => b" ",
        });
    }

    fn hidden_arrow_len(&self, direction: Option<Direction>) -> usize {
        const COLOUR: usize = 9;
        if self.style.colour && direction.is_some() { COLOUR } else { 0 }
    }

    /// Appends identifier and bytes; returns the number of characters that take no column.
    fn write_bytes(&mut self, event: &DecodedFrame<'_>, out: &mut Vec<u8>) -> usize {
        let start = out.len();
        if let Some(id) = event.id {
            let digits = id.to_be_bytes().map(number_text::hex_digits);
            let digits = &digits.as_flattened()[if event.extended { 0 } else { 5 }..];
            out.extend_from_slice(digits);
            out.extend_from_slice(if event.remote { b"#R" } else { b"#" });
            if event.remote_len > 0 {
                out.push(b'0' + event.remote_len.min(8));
            }
        }
        let TextStyle { colour, marks, .. } = self.style;
        let mask = if colour || marks { self.changes.update(event) } else { 0 };
        let mut hidden = 0;
        for (at, byte) in event.bytes.iter().enumerate() {
            let changed = at < 64 && mask >> at & 1 == 1;
            let [high, low] = number_text::hex_digits(*byte);
            if changed && colour {
                out.extend_from_slice(b"\x1b[4m");
                out.extend_from_slice(&[high, low]);
                out.extend_from_slice(OFF);
                out.push(b' ');
                hidden += 8;
            } else {
                out.extend_from_slice(&[high, low, if changed { b'\'' } else { b' ' }]);
            }
        }
        // Behind the last byte there is nothing but a mark.
        if !event.bytes.is_empty() && out.ends_with(b" ") {
            out.pop();
        }
        let width = out.len() - start - hidden;
        out.resize(out.len() + BYTES_WIDTH.saturating_sub(width) + 2, b' ');
        hidden
    }

    fn write_meaning(&self, event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
        if event.echo {
            out.extend_from_slice(b"echo: ");
        }
        let bare = event.explanation.text.is_empty() && event.explanation.kind.is_empty();
        if !(bare && event.defect.is_some() && event.protocol.is_some()) {
            let begin = out.len();
            out.extend_from_slice(meaning_text(event).as_bytes());
            escape_tail(begin, out);
        }
        if let Some(wrong) = event.defect {
            out.extend_from_slice(if bare { b"" } else { b"  " });
            self.begin_colour(RED, out);
            // Writing into a Vec cannot fail.
            let _ = write!(out, "! {wrong}");
            self.end_colour(out);
        }
        let latency = latency_of(event.notices);
        if let Some(ns) = latency.filter(|_| self.style.notices != NoticeLevel::None) {
            self.begin_colour(DIM, out);
            out.extend_from_slice(b"  (");
            DurationText(ns).append_to(out);
            out.push(b')');
            self.end_colour(out);
        }
    }

    /// Appends a line for a notice that is shown by itself.
    fn write_notice(&self, notice: &SessionNotice, column: usize, out: &mut Vec<u8>) {
        let all = self.style.notices == NoticeLevel::All;
        let colour = match notice {
            SessionNotice::Anomaly(_) => YELLOW,
            SessionNotice::Fault(fault) if !fault.gone => RED,
            SessionNotice::Fault(_) | SessionNotice::Change(_) => CYAN,
            SessionNotice::Signal(_) if all => DIM,
            SessionNotice::Exchange(exchange)
                if all && exchange.outcome != ExchangeOutcome::Done =>
            {
                DIM
            }
            SessionNotice::Signal(_) | SessionNotice::Exchange(_) => return,
        };
        out.resize(out.len() + column, b' ');
        self.begin_colour(colour, out);
        let begin = out.len();
        let _ = write!(out, "{}", NoticeText(notice));
        escape_tail(begin, out);
        self.end_colour(out);
        out.push(b'\n');
    }

    fn begin_colour(&self, code: &str, out: &mut Vec<u8>) {
        if self.style.colour {
            out.extend_from_slice(b"\x1b[");
            out.extend_from_slice(code.as_bytes());
            out.push(b'm');
        }
    }

    fn end_colour(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(if self.style.colour { OFF } else { b"" });
    }
}

/// Time of the exchange that a frame ends, ns.
fn latency_of(notices: &[SessionNotice]) -> Option<u64> {
    notices.iter().find_map(|notice| match notice {
        SessionNotice::Exchange(exchange) => exchange.latency(),
        _ => None,
    })
}

/// Bytes that a line mostly needs at most.
const LINE_ROOM: usize = 256;
/// Columns of a time and the marks behind it.
const TIME_WIDTH: usize = 13;

/// Nanoseconds as a person reads them: `812 us`, `2.10 ms`, `1.50 s`.
#[derive(Clone, Copy, Debug)]
pub struct DurationText(pub u64);

impl DurationText {
    /// Appends it.
    pub(crate) fn append_to(self, out: &mut Vec<u8>) {
        let DurationParts { whole, rest, decimals, unit } = self.parts();
        number_text::append_unsigned(whole, out);
        if decimals > 0 {
            out.push(b'.');
            number_text::append_padded(rest, decimals, b'0', out);
        }
        out.extend_from_slice(unit);
    }

    /// Three digits that count: the number before the point, the one behind it and its digits, and the unit.
    pub(crate) fn parts(self) -> DurationParts {
        let (size, unit): (u64, &[u8]) = match self.0 {
            0..1000 => (1, b" ns"),
            1000..1_000_000 => (1_000, b" us"),
            1_000_000..1_000_000_000 => (1_000_000, b" ms"),
            _ => (1_000_000_000, b" s"),
        };
        let (whole, rest) = (self.0 / size, self.0 % size);
        let decimals = match whole {
            _ if size == 1 => 0,
            0..10 => 2,
            10..100 => 1,
            _ => 0,
        };
        let power = [1, 10, 100][decimals];
        let mut shown = whole * power + (2 * rest * power + size) / (2 * size);
        // Half of the last digit is rounded as the nearest binary number is, by the standard library.
        if 2 * rest * power % (2 * size) == size {
            let digits = format!("{:.decimals$}", self.0 as f64 / size as f64).replace('.', "");
            shown = digits.parse().unwrap_or(shown);
        }
        DurationParts { whole: shown / power, rest: shown % power, decimals, unit }
    }
}

/// Digits of a duration.
pub(crate) struct DurationParts {
    pub whole: u64,
    pub rest: u64,
    pub decimals: usize,
    pub unit: &'static [u8],
}

impl core::fmt::Display for DurationText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let mut text = Vec::new();
        self.append_to(&mut text);
        f.write_str(&String::from_utf8_lossy(&text))
    }
}

/// A number with at most four decimals, none where it needs none.
#[derive(Clone, Copy, Debug)]
pub struct NumberText(pub f64);

impl core::fmt::Display for NumberText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let rounded = (self.0 * 1e4).round() / 1e4;
        let small = rounded == 0.0 || self.0.abs() >= 1e15;
        if small { write!(f, "{}", self.0) } else { write!(f, "{rounded}") }
    }
}

/// A notice in one line.
#[derive(Clone, Copy, Debug)]
pub struct NoticeText<'a>(pub &'a SessionNotice);

impl core::fmt::Display for NoticeText<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            SessionNotice::Signal(SignalNotice { axis, name, value, unit, .. }) => {
                let gap = if unit.is_empty() { "" } else { " " };
                write!(f, "= axis {axis} {name} {}{gap}{unit}", NumberText(*value))
            }
            SessionNotice::Exchange(ExchangeNotice {
                axis,
                op,
                outcome,
                requested,
                retries,
                ..
            }) => {
                write!(
                    f,
                    "? {op}{} of frame {}: {}",
                    axis_suffix(*axis),
                    requested.0,
                    outcome.as_str()
                )?;
                if *retries > 0 { write!(f, ", {retries} retries") } else { Ok(()) }
            }
            SessionNotice::Change(ChangeNotice { axis, what, from, to }) => {
                write!(f, "-{} {what}: ", axis_suffix(*axis))?;
                if from.is_empty() { f.write_str(to) } else { write!(f, "{from} -> {to}") }
            }
            SessionNotice::Fault(FaultNotice { axis, code, text, gone: true, .. }) => {
                write!(f, "- axis {axis} fault 0x{code:X} is gone: {text}")
            }
            SessionNotice::Fault(FaultNotice { axis, code, text, remedy, .. }) => {
                write!(f, "! axis {axis} fault 0x{code:X}: {}", text.trim_end_matches('.'))?;
                if remedy.is_empty() { Ok(()) } else { write!(f, "; try: {remedy}") }
            }
            SessionNotice::Anomaly(AnomalyNotice { kind, axis, text, .. }) => {
                write!(f, "! {}{}: {text}", kind.as_str(), axis_suffix(*axis))
            }
        }
    }
}

fn axis_suffix(axis: Option<u32>) -> String {
    axis.map_or_else(String::new, |axis| format!(" axis {axis}"))
}

fn append_padded(text: &str, width: usize, out: &mut Vec<u8>) {
    let begin = out.len();
    out.extend_from_slice(text.as_bytes());
    escape_tail(begin, out);
    out.resize(out.len() + width.saturating_sub(out.len() - begin), b' ');
}

/// Escapes the control characters of the text from `begin` on: a file may name its links as it likes.
fn escape_tail(begin: usize, out: &mut Vec<u8>) {
    if !is_plain(&out[begin..]) {
        let tail = String::from_utf8_lossy(&out.split_off(begin)).into_owned();
        out.extend_from_slice(EscapedText(&tail).to_string().as_bytes());
    }
}

/// Appends bytes as `01 0A FF`.
pub fn append_spaced_hex(out: &mut Vec<u8>, bytes: &[u8]) {
    for (at, byte) in bytes.iter().enumerate() {
        if at > 0 {
            out.push(b' ');
        }
        crate::jsonl::write_hex(out, core::slice::from_ref(byte));
    }
}

#[cfg(test)]
mod tests;
