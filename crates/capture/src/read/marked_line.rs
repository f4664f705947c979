//! Lines of columns: a time, the direction as a word or an arrow, a port, then bytes. Terminal programs, Modbus
//! masters and serial sniffers print them, each in an order of its own:
//!
//! ```text
//! [RTU]>Tx > 12:48:40:433 - 1E 02 00 00 00 10 7A 69        QModMaster
//! 11/27/2026 12:34:56.789 [TX] - 01 03 00 33 00 01 74 05   Docklight
//! [12:34:56][D][uart_debug:114]: >>> 01:03:00:33           ESPHome
//! [12:34:56.789]OUT→◇01 03 00 33 00 01 74 05 □             SSCOM
//! ```
//! Every word before the bytes must be known, so that prose with two digits in it is no data.

use polepair_core::explain::Direction;

use super::byte_text::{is_trailer, parse_bytes};
use super::line_time::split_time;
use super::text::RawLine;
use crate::record::NO_LINK;
use crate::timestamp::Timestamp;

/// Words of a direction, in lower case.
const SENT: [&str; 14] = [
    "tx",
    "txd",
    "send",
    "sent",
    "sending",
    "transmit",
    "transmitted",
    "out",
    "write",
    "written",
    "request",
    "query",
    "发",
    "发送",
];
const RECEIVED: [&str; 13] = [
    "rx",
    "rxd",
    "recv",
    "receive",
    "received",
    "receiving",
    "in",
    "read",
    "response",
    "reply",
    "answer",
    "接收",
    "收",
];
/// Arrows, the longest first. They often are mere punctuation: a word in the same line counts.
const ARROWS: [(&str, Direction); 12] = [
    ("-->", Direction::ToDrive),
    ("<--", Direction::ToHost),
    (">>>", Direction::ToDrive),
    ("<<<", Direction::ToHost),
    ("->", Direction::ToDrive),
    ("<-", Direction::ToHost),
    (">>", Direction::ToDrive),
    ("<<", Direction::ToHost),
    ("→", Direction::ToDrive),
    ("←", Direction::ToHost),
    (">", Direction::ToDrive),
    ("<", Direction::ToHost),
];
/// Words that state nothing about the bytes.
const FILLERS: [&str; 15] = [
    "debug", "info", "trace", "verbose", "data", "bytes", "hex", "frame", "raw", "modbus", "rtu",
    "tcp", "ascii", "serial", "uart",
];
/// Signs between columns.
const SIGNS: [char; 9] = [' ', '\t', ':', '|', ',', ';', '=', '◇', '◆'];
/// The longest text in brackets that is skipped.
const BRACKET_MAX: usize = 40;

/// Columns before the bytes.
#[derive(Debug, Default)]
pub(super) struct MarkedLine<'t> {
    time: Option<Timestamp>,
    /// The port, where the line names it.
    link: Option<&'t str>,
    direction: Option<Direction>,
    arrow: Option<Direction>,
    /// Stated number of bytes.
    count: Option<usize>,
}

impl<'t> MarkedLine<'t> {
    /// Parses a line, and puts its bytes into `bytes`. `None` where a word is not known, or where the direction or
    /// the bytes are missing.
    pub fn parse(text: &'t str, bytes: &mut Vec<u8>) -> Option<Self> {
        let mut found = Self::default();
        let mut rest = text;
        loop {
            rest = rest.trim_start_matches(SIGNS);
            let Some(after) = found.take_column(rest) else { break };
            rest = after;
        }
        found.direction()?;
        bytes.clear();
        let is_prefixed = rest.starts_with("0x");
        let after = parse_bytes(rest, bytes)?;
        // A number alone may be a counter: `RX: 12`.
        let is_data = bytes.len() > 1 || found.time.is_some() || is_prefixed;
        let is_whole = found.count.is_none_or(|count| count == bytes.len());
        (is_data && is_whole && is_trailer(after)).then_some(found)
    }

    fn direction(&self) -> Option<Direction> {
        self.direction.or(self.arrow)
    }

    /// The line without its bytes.
    pub fn raw_line(&self) -> RawLine<'t> {
        self.raw_line_on(self.link.unwrap_or(NO_LINK))
    }

    /// The line without its bytes, of another link.
    pub fn raw_line_on<'l>(&self, link: &'l str) -> RawLine<'l> {
        RawLine { time: self.time, link, direction: self.direction(), can: None }
    }

    /// Takes one column off the text, and returns what follows it.
    fn take_column(&mut self, text: &'t str) -> Option<&'t str> {
        if let Some((direction, after)) = split_direction(text) {
            // Two different ones in one line are no direction: the line is refused.
            self.direction.is_none_or(|known| known == direction).then_some(())?;
            self.direction = Some(direction);
            return Some(after);
        }
        if let Some((arrow, direction)) = ARROWS.iter().find(|(arrow, _)| text.starts_with(arrow)) {
            self.arrow = Some(*direction);
            return Some(&text[arrow.len()..]);
        }
        if self.time.is_none()
            && let Some((time, after)) = split_time(text)
            // Three bytes with colons are no time of day, if nothing follows them.
            && !after.is_empty()
        {
            self.time = Some(time);
            return Some(after);
        }
        if let Some(after) = text.strip_prefix('-') {
            return Some(after);
        }
        if text.starts_with(['[', '(']) {
            return self.take_bracket(text);
        }
        let end =
            text.find(|c: char| c.is_whitespace() || ":,|=".contains(c)).unwrap_or(text.len());
        let (word, after) = text.split_at(end);
        if is_port(word) {
            self.link = Some(word);
            return Some(after);
        }
        let lower = word.to_lowercase();
        FILLERS.contains(&lower.as_str()).then_some(after)
    }

    /// `[TX]`, `[RTU]`, `(8 bytes)`. Two digits could be a byte, and are not skipped.
    fn take_bracket(&mut self, text: &'t str) -> Option<&'t str> {
        let end = text.find([']', ')']).filter(|end| *end <= BRACKET_MAX)?;
        let (inner, after) = (text[1..end].trim(), &text[end + 1..]);
        if let Some((direction, "")) = split_direction(inner) {
            self.direction.is_none_or(|known| known == direction).then_some(())?;
            self.direction = Some(direction);
            return Some(after);
        }
        let count = inner.split(' ').next()?;
        if let Ok(count) = count.parse::<usize>() {
            self.direction?;
            self.count = Some(count);
            return Some(after);
        }
        if is_port(inner) {
            self.link = Some(inner);
        }
        let is_byte = inner.len() == 2 && inner.bytes().all(|c| c.is_ascii_hexdigit());
        (!is_byte && !inner.is_empty()).then_some(after)
    }
}

/// A word of direction at the start of a text.
pub(super) fn split_direction(text: &str) -> Option<(Direction, &str)> {
    let end = text.find(|c: char| !c.is_alphabetic()).unwrap_or(text.len());
    let (word, after) = text.split_at(end);
    let lower = word.to_lowercase();
    let is_end = !after.starts_with(|c: char| c.is_alphanumeric() || c == '_');
    let direction = match () {
        () if SENT.contains(&lower.as_str()) => Direction::ToDrive,
        () if RECEIVED.contains(&lower.as_str()) => Direction::ToHost,
        () => return None,
    };
    is_end.then_some((direction, after))
}

/// `COM3`, `ttyUSB0`, `/dev/ttyS1`.
fn is_port(word: &str) -> bool {
    let number = word.strip_prefix("COM").unwrap_or_default();
    let is_com = !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit());
    is_com
        || word.starts_with("/dev/")
        || word.strip_prefix("tty").is_some_and(|name| name.len() > 1)
}
