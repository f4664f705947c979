//! One aligned line a frame, for people, and below it what its conversation tells.

mod plain;

use std::io::Write as _;

use polepair_core::explain::Direction;

use crate::changes::{Changes, meaning};
use crate::decoder::Event;
use crate::page::Page;
use crate::put;
use crate::session::{Change, Exchange, Fault, Notice, Odd, Outcome, Signal, is_of_frame};
use crate::stamp::Stamp;

/// Columns that bytes take before a line grows beyond the rest: nine bytes with spaces.
const BYTES_WIDTH: usize = 26;

/// How lines are written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Style {
    /// With ANSI colours.
    pub colour: bool,
    /// A `'` behind each byte that is not what it was in the last frame of its kind; in colour these
    /// bytes are underlined anyway.
    pub marks: bool,
    /// What is told of conversations.
    pub notices: Notices,
}

/// What is told of conversations.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Notices {
    /// Nothing: frames alone.
    None,
    /// What is odd, faults, changes of states, and how long answers took.
    #[default]
    Events,
    /// Values too.
    All,
}

/// Writes frames as text. Times are shown from the first frame on.
#[derive(Clone, Debug, Default)]
pub struct Text {
    style: Style,
    head: Head,
    changes: Changes,
    page: Page,
}

/// How far lines have come: the time they count from, and how wide their first columns are.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Head {
    first: Option<Stamp>,
    link_width: usize,
    protocol_width: usize,
}

impl Head {
    /// A frame's line follows.
    pub fn see(&mut self, event: &Event<'_>) {
        self.first = self.first.or(event.time);
        self.link_width = self.link_width.max(event.link.len());
        self.protocol_width = self.protocol_width.max(word(event.protocol).len());
    }
}

/// A protocol's name, or a question mark.
fn word(protocol: Option<&'static str>) -> &'static str {
    protocol.unwrap_or("?")
}

const OFF: &[u8] = b"\x1b[0m";
const DIM: &str = "2";
const RED: &str = "31";
const YELLOW: &str = "33";
const CYAN: &str = "36";

impl Text {
    /// A writer that has written nothing.
    #[must_use]
    pub fn new(style: Style) -> Self {
        Self { style, ..Self::default() }
    }

    /// Appends one line, and one for each notice that is shown below it.
    pub fn write(&mut self, event: &Event<'_>, out: &mut Vec<u8>) {
        out.reserve(LINE_ROOM);
        let start = out.len();
        self.head.see(event);
        self.time(event.time, out);
        let head = out.len();
        padded(event.link, self.head.link_width, out);
        out.push(b' ');
        self.arrow(event.direction, out);
        out.push(b' ');
        padded(word(event.protocol), self.head.protocol_width, out);
        out.extend_from_slice(b"  ");
        let hidden = self.bytes(event, out);
        let column = out.len() - head - hidden - self.hidden_arrow(event.direction);
        let column = column + if head > start { TIME_WIDTH } else { 0 };
        self.meaning(event, out);
        out.push(b'\n');
        if self.style.notices != Notices::None {
            let news = |notice: &&Notice| event.wrong.is_none() || !is_of_frame(notice);
            event.notices.iter().filter(news).for_each(|one| self.notice(one, column, out));
        }
    }

    /// A frame that is not shown; times count from the first, shown or not.
    pub fn skip(&mut self, event: &Event<'_>) {
        self.head.first = self.head.first.or(event.time);
    }

    /// Appends what conversations leave open, which is no frame.
    pub fn ending(&mut self, event: &Event<'_>, out: &mut Vec<u8>) {
        for notice in event.notices.iter().filter(|_| self.style.notices != Notices::None) {
            out.extend_from_slice(event.link.as_bytes());
            self.notice(notice, 1, out);
        }
    }

    fn time(&self, time: Option<Stamp>, out: &mut Vec<u8>) {
        let Some(time) = time else { return };
        let since = time.since(self.head.first.unwrap_or(time));
        self.open(DIM, out);
        put::filled(since / 1_000_000_000, 4, b' ', out);
        out.push(b'.');
        put::filled(since % 1_000_000_000 / 1000, 6, b'0', out);
        self.close(out);
        out.extend_from_slice(b"  ");
    }

    fn arrow(&self, direction: Option<Direction>, out: &mut Vec<u8>) {
        out.extend_from_slice(match (direction, self.style.colour) {
            (Some(Direction::ToDrive), false) => b">",
            (Some(Direction::ToHost), false) => b"<",
            (Some(Direction::ToDrive), true) => b"\x1b[36m>\x1b[0m",
            (Some(Direction::ToHost), true) => b"\x1b[33m<\x1b[0m",
            (None, _) => b" ",
        });
    }

    fn hidden_arrow(&self, direction: Option<Direction>) -> usize {
        const COLOUR: usize = 9;
        if self.style.colour && direction.is_some() { COLOUR } else { 0 }
    }

    /// Appends identifier and bytes; tells how many of the characters take no column.
    fn bytes(&mut self, event: &Event<'_>, out: &mut Vec<u8>) -> usize {
        let start = out.len();
        if let Some(id) = event.id {
            let digits = id.to_be_bytes().map(put::hex);
            let digits = &digits.as_flattened()[if event.extended { 0 } else { 5 }..];
            out.extend_from_slice(digits);
            out.extend_from_slice(if event.remote { b"#R" } else { b"#" });
            if event.wanted > 0 {
                out.push(b'0' + event.wanted.min(8));
            }
        }
        let Style { colour, marks, .. } = self.style;
        let mask = if colour || marks { self.changes.take(event) } else { 0 };
        let mut hidden = 0;
        for (at, byte) in event.bytes.iter().enumerate() {
            let changed = at < 64 && mask >> at & 1 == 1;
            let [high, low] = put::hex(*byte);
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
        // Behind the last byte nothing but a mark stands.
        if !event.bytes.is_empty() && out.ends_with(b" ") {
            out.pop();
        }
        let width = out.len() - start - hidden;
        out.resize(out.len() + BYTES_WIDTH.saturating_sub(width) + 2, b' ');
        hidden
    }

    fn meaning(&self, event: &Event<'_>, out: &mut Vec<u8>) {
        if event.echo {
            out.extend_from_slice(b"echo: ");
        }
        let bare = event.explained.text.is_empty() && event.explained.kind.is_empty();
        if !(bare && event.wrong.is_some() && event.protocol.is_some()) {
            out.extend_from_slice(meaning(event).as_bytes());
        }
        if let Some(wrong) = event.wrong {
            out.extend_from_slice(if bare { b"" } else { b"  " });
            self.open(RED, out);
            // Writing into a Vec cannot fail.
            let _ = write!(out, "! {wrong}");
            self.close(out);
        }
        let exchange = event.notices.iter().find_map(|notice| match notice {
            Notice::Exchange(exchange) => exchange.latency(),
            _ => None,
        });
        if let Some(ns) = exchange.filter(|_| self.style.notices != Notices::None) {
            self.open(DIM, out);
            let _ = write!(out, "  ({})", Span(ns));
            self.close(out);
        }
    }

    /// Appends a line for a notice that is shown by itself.
    fn notice(&self, notice: &Notice, column: usize, out: &mut Vec<u8>) {
        let all = self.style.notices == Notices::All;
        let colour = match notice {
            Notice::Odd(_) => YELLOW,
            Notice::Fault(fault) if !fault.gone => RED,
            Notice::Fault(_) | Notice::Change(_) => CYAN,
            Notice::Signal(_) if all => DIM,
            Notice::Exchange(exchange) if all && exchange.outcome != Outcome::Done => DIM,
            Notice::Signal(_) | Notice::Exchange(_) => return,
        };
        out.resize(out.len() + column, b' ');
        self.open(colour, out);
        let _ = write!(out, "{}", Told(notice));
        self.close(out);
        out.push(b'\n');
    }

    fn open(&self, code: &str, out: &mut Vec<u8>) {
        if self.style.colour {
            out.extend_from_slice(b"\x1b[");
            out.extend_from_slice(code.as_bytes());
            out.push(b'm');
        }
    }

    fn close(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(if self.style.colour { OFF } else { b"" });
    }
}

/// Bytes that a line mostly needs at most.
const LINE_ROOM: usize = 256;
/// Columns of a time and what is behind it.
const TIME_WIDTH: usize = 13;

/// Nanoseconds as a person reads them: `812 us`, `2.10 ms`, `1.50 s`.
#[derive(Clone, Copy, Debug)]
pub struct Span(pub u64);

impl core::fmt::Display for Span {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let ns = self.0 as f64;
        match self.0 {
            0..1000 => write!(f, "{} ns", self.0),
            1000..1_000_000 => write!(f, "{:.*} us", decimals(ns / 1e3), ns / 1e3),
            1_000_000..1_000_000_000 => write!(f, "{:.*} ms", decimals(ns / 1e6), ns / 1e6),
            _ => write!(f, "{:.*} s", decimals(ns / 1e9), ns / 1e9),
        }
    }
}

/// A number with at most four decimals, none where it needs none.
#[derive(Clone, Copy, Debug)]
pub struct Real(pub f64);

impl core::fmt::Display for Real {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let rounded = (self.0 * 1e4).round() / 1e4;
        let small = rounded == 0.0 || self.0.abs() >= 1e15;
        if small { write!(f, "{}", self.0) } else { write!(f, "{rounded}") }
    }
}

/// Decimals for three digits that count.
fn decimals(value: f64) -> usize {
    match value {
        ..10.0 => 2,
        ..100.0 => 1,
        _ => 0,
    }
}

/// A notice in one line.
#[derive(Clone, Copy, Debug)]
pub struct Told<'a>(pub &'a Notice);

impl core::fmt::Display for Told<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Notice::Signal(Signal { axis, name, value, unit, .. }) => {
                let gap = if unit.is_empty() { "" } else { " " };
                write!(f, "= axis {axis} {name} {}{gap}{unit}", Real(*value))
            }
            Notice::Exchange(Exchange { axis, op, outcome, asked, retries, .. }) => {
                write!(f, "? {op}{} of frame {}: {}", of(*axis), asked.0, outcome.word())?;
                if *retries > 0 { write!(f, ", {retries} retries") } else { Ok(()) }
            }
            Notice::Change(Change { axis, what, from, to }) => {
                write!(f, "-{} {what}: ", of(*axis))?;
                if from.is_empty() { f.write_str(to) } else { write!(f, "{from} -> {to}") }
            }
            Notice::Fault(Fault { axis, code, text, gone: true, .. }) => {
                write!(f, "- axis {axis} fault 0x{code:X} is gone: {text}")
            }
            Notice::Fault(Fault { axis, code, text, remedy, .. }) => {
                write!(f, "! axis {axis} fault 0x{code:X}: {}", text.trim_end_matches('.'))?;
                if remedy.is_empty() { Ok(()) } else { write!(f, "; try: {remedy}") }
            }
            Notice::Odd(Odd { kind, axis, text, .. }) => {
                write!(f, "! {}{}: {text}", kind.word(), of(*axis))
            }
        }
    }
}

fn of(axis: Option<u32>) -> String {
    axis.map_or_else(String::new, |axis| format!(" axis {axis}"))
}

fn padded(text: &str, width: usize, out: &mut Vec<u8>) {
    out.extend_from_slice(text.as_bytes());
    out.resize(out.len() + width.saturating_sub(text.len()), b' ');
}

/// Appends bytes as `01 0A FF`.
pub fn spaced_hex(out: &mut Vec<u8>, bytes: &[u8]) {
    for (at, byte) in bytes.iter().enumerate() {
        if at > 0 {
            out.push(b' ');
        }
        crate::jsonl::hex(out, core::slice::from_ref(byte));
    }
}

#[cfg(test)]
mod tests;
