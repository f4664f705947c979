//! One aligned line a frame, for people.

use std::io::Write as _;

use polepair_core::explain::Direction;

use crate::decoder::Event;
use crate::explained::REMOTE_REQUEST;
use crate::stamp::Stamp;

/// Columns that bytes take before a line grows beyond the rest: nine bytes with spaces.
const BYTES_WIDTH: usize = 26;

/// How lines are written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Style {
    /// With ANSI colours.
    pub colour: bool,
}

/// Writes frames as text. Times are shown from the first frame on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Text {
    style: Style,
    first: Option<Stamp>,
    link_width: usize,
    protocol_width: usize,
}

impl Text {
    /// A writer that has written nothing.
    #[must_use]
    pub fn new(style: Style) -> Self {
        Self { style, ..Self::default() }
    }

    /// Appends one line.
    pub fn write(&mut self, event: &Event<'_>, out: &mut Vec<u8>) {
        self.time(event.time, out);
        let protocol = event.protocol.unwrap_or("?");
        self.link_width = self.link_width.max(event.link.len());
        self.protocol_width = self.protocol_width.max(protocol.len());
        let (links, protocols) = (self.link_width, self.protocol_width);
        let arrow = self.arrow(event.direction);
        // Writing into a Vec cannot fail.
        let _ = write!(out, "{:links$} {arrow} {protocol:protocols$}  ", event.link);
        self.bytes(event, out);
        self.meaning(event, out);
        out.push(b'\n');
    }

    fn time(&mut self, time: Option<Stamp>, out: &mut Vec<u8>) {
        let Some(time) = time else { return };
        let since = time.since(*self.first.get_or_insert(time));
        let (open, close) = self.pair("2");
        let (seconds, micros) = (since / 1_000_000_000, since % 1_000_000_000 / 1000);
        let _ = write!(out, "{open}{seconds:>4}.{micros:06}{close}  ");
    }

    fn arrow(&self, direction: Option<Direction>) -> &'static str {
        match (direction, self.style.colour) {
            (Some(Direction::ToDrive), false) => ">",
            (Some(Direction::ToHost), false) => "<",
            (Some(Direction::ToDrive), true) => "\x1b[36m>\x1b[0m",
            (Some(Direction::ToHost), true) => "\x1b[33m<\x1b[0m",
            (None, _) => " ",
        }
    }

    fn bytes(&self, event: &Event<'_>, out: &mut Vec<u8>) {
        let start = out.len();
        if let Some(id) = event.id {
            let digits = if event.extended { 8 } else { 3 };
            let _ = write!(out, "{id:0digits$X}#{}", if event.remote { "R" } else { "" });
        }
        spaced_hex(out, event.bytes);
        let width = out.len() - start;
        out.resize(out.len() + BYTES_WIDTH.saturating_sub(width) + 2, b' ');
    }

    fn meaning(&self, event: &Event<'_>, out: &mut Vec<u8>) {
        let explained = event.explained;
        if event.echo {
            out.extend_from_slice(b"echo: ");
        }
        match (explained.text.as_str(), explained.kind.as_str(), event.protocol) {
            ("", "", None) if event.remote => out.extend_from_slice(REMOTE_REQUEST.as_bytes()),
            ("", "", None) => out.extend_from_slice(b"not a frame of any known protocol"),
            ("", kind, _) => out.extend_from_slice(kind.as_bytes()),
            (text, ..) => out.extend_from_slice(text.as_bytes()),
        }
        if let Some(wrong) = event.wrong {
            let (open, close) = self.pair("31");
            let gap =
                if explained.text.is_empty() && explained.kind.is_empty() { "" } else { "  " };
            let _ = write!(out, "{gap}{open}! {wrong}{close}");
        }
    }

    fn pair(&self, code: &str) -> (String, &'static str) {
        if self.style.colour { (format!("\x1b[{code}m"), "\x1b[0m") } else { (String::new(), "") }
    }
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
