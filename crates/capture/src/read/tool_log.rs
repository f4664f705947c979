//! Lines that other programs print: debug output of Modbus, TMCL and CAN libraries, and bytes in their
//! notations.
//!
//! A line may begin with a date or a time, and with the words of a logger. What counts is a known marker with
//! bytes after it, a CAN frame, or [columns](MarkedLine) that are all known. Examples are in
//! docs/reference/capture-formats.md.

use polepair_core::explain::Direction;

use super::byte_text::{first_column, is_trailer, parse_bytes};
use super::line_time::split_time;
use super::marked_line::MarkedLine;
use super::printed_frame::{PrintedFrame, parse_python_can};
use super::text::RawLine;
use super::{candump, gbk};
use crate::record::{CanRecord, NO_LINK, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// Content of a line of another program.
pub(super) enum ToolLine<'a> {
    /// Data.
    Record(RawLine<'a>),
    /// Data with the milliseconds of a minute, from which the time follows.
    InMinute(RawLine<'a>, u32),
    /// Data that another line has as well.
    Repeated,
}

/// Markers before bytes, in lower case, and the direction of these bytes. pyserial, pymodbus,
/// minimalmodbus and PyTrinamic print them.
const MARKERS: [(&str, Direction); 18] = [
    ("tmcl_request:", Direction::ToDrive),
    ("tmcl_reply:", Direction::ToHost),
    ("bytes back):", Direction::ToDrive),
    ("response from instrument:", Direction::ToHost),
    ("sending:", Direction::ToDrive),
    ("send:", Direction::ToDrive),
    ("sent:", Direction::ToDrive),
    ("receiving:", Direction::ToHost),
    ("received:", Direction::ToHost),
    ("recv:", Direction::ToHost),
    ("request:", Direction::ToDrive),
    ("response:", Direction::ToHost),
    ("reply:", Direction::ToHost),
    ("answer:", Direction::ToHost),
    ("write:", Direction::ToDrive),
    ("read:", Direction::ToHost),
    ("tx:", Direction::ToDrive),
    ("rx:", Direction::ToHost),
];
/// Markers of bytes that pymodbus prints twice.
const REPEATED: [&str; 2] = ["processing:", "handling data:"];
/// Fewest bytes after a marker that count as data.
const BYTES_MIN: usize = 2;

/// Parses a line of another program. `None` where it has no data. Its bytes are put into `scratch`.
pub(super) fn parse_tool_line<'a>(line: &'a [u8], scratch: &mut Vec<u8>) -> Option<ToolLine<'a>> {
    let Ok(line) = std::str::from_utf8(line) else { return parse_foreign_text(line, scratch) };
    let line = line.trim();
    scratch.clear();
    if let Some(message) = parse_python_can(line, scratch) {
        return Some(ToolLine::Record(message));
    }
    let (time, text) = split_time(line).map_or((None, line), |(time, rest)| (Some(time), rest));
    let raw = RawLine { time, ..RawLine::default() };
    if let Some((direction, can)) = parse_frame_token(text, scratch) {
        return Some(ToolLine::Record(RawLine { direction, can: Some(can), ..raw }));
    }
    scratch.clear();
    if let Some((id, data)) = split_id(text)
        && parse_bytes(data, scratch).is_some_and(str::is_empty)
        && scratch.len() <= 8
    {
        let frame = classic_frame(id, false, false, scratch.len() as u8, scratch);
        return Some(ToolLine::Record(RawLine { can: Some(CanRecord::Frame(frame)), ..raw }));
    }
    if let Some(found) = PrintedFrame::parse(line) {
        let (link, direction, can) =
            (found.link.unwrap_or(NO_LINK), found.direction, found.record());
        let raw = RawLine { time: found.time, link, direction, can: Some(can) };
        return Some(match found.minute_ms.filter(|_| found.time.is_none()) {
            Some(ms) => ToolLine::InMinute(raw, ms),
            None => ToolLine::Record(raw),
        });
    }
    // Programs disagree about capital letters, also between their own versions.
    let lower = text.to_ascii_lowercase();
    scratch.clear();
    if let Some(at) = REPEATED.iter().find_map(|marker| find_marker(&lower, marker)) {
        let bytes = parse_bytes(&text[at..], scratch).is_some() && scratch.len() >= BYTES_MIN;
        return bytes.then_some(ToolLine::Repeated);
    }
    let direction = parse_decoded(line, scratch).or_else(|| parse_brackets(text, scratch));
    if direction.is_none()
        && let Some(found) = MarkedLine::parse(line, scratch)
    {
        return Some(ToolLine::Record(found.raw_line()));
    }
    let direction = direction
        .or_else(|| parse_marked(text, &lower, scratch))
        .or_else(|| parse_bare(text, scratch))?;
    Some(ToolLine::Record(RawLine { direction, ..raw }))
}

/// A line with columns that is not UTF-8.
fn parse_foreign_text<'a>(line: &[u8], scratch: &mut Vec<u8>) -> Option<ToolLine<'a>> {
    let found = MarkedLine::parse(gbk::decode(line).trim(), scratch)?.raw_line_on(NO_LINK);
    Some(ToolLine::Record(found))
}

/// The message of a line that another program wrapped: a quoted line, one of a mail, or one of a system log, with the
/// time of the wrapping.
pub(super) fn unwrap_line(line: &[u8]) -> Option<(Option<Timestamp>, &[u8])> {
    if let [b'"', inner @ .., b'"'] = line
        && !inner.contains(&b'"')
    {
        return Some((None, inner));
    }
    if let Some(quoted) = line.strip_prefix(b"> ").filter(|quoted| quoted.starts_with(b"(")) {
        return Some((None, quoted));
    }
    let (time, rest) = split_time(std::str::from_utf8(line).ok()?)?;
    Some((Some(time), split_origin(rest)?.as_bytes()))
}

/// The message behind `host program[123]: `.
fn split_origin(text: &str) -> Option<&str> {
    let (origin, message) = text.split_once("]: ")?;
    let (names, number) = origin.rsplit_once('[')?;
    let is_number = !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit());
    (is_number && names.split(' ').count() <= 2).then_some(message)
}

fn split_at_space(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// The first word of the form `IDENTIFIER#DATA`, with the words of data after it.
fn parse_frame_token(text: &str, scratch: &mut Vec<u8>) -> Option<(Option<Direction>, CanRecord)> {
    let hash = text.find('#')?;
    let before = &text.as_bytes()[..hash];
    let begin = before.iter().rposition(|c| !c.is_ascii_hexdigit() && *c != b'x');
    let token = &text[begin.map_or(0, |at| at + 1)..];
    candump::parse_log(first_column(token).as_bytes(), scratch).ok()
}

/// An identifier of three digits and bytes of two digits: `60C  40 02 65`.
fn split_id(text: &str) -> Option<(u32, &str)> {
    let (first, rest) = split_at_space(text);
    let digits = first.strip_prefix("0x").unwrap_or(first);
    if digits.len() != 3 || rest.is_empty() {
        return None;
    }
    let id = u32::from_str_radix(digits, 16).ok().filter(|id| *id <= STANDARD_MAX)?;
    Some((id, rest))
}

/// The end of a marker that begins a word.
fn find_marker(lower: &str, marker: &str) -> Option<usize> {
    let mut from = 0;
    while let Some(at) = lower[from..].find(marker).map(|at| at + from) {
        let before = lower[..at].bytes().next_back();
        // `tx:` inside `ctx:` is none.
        if !before.is_some_and(|c| c.is_ascii_alphanumeric()) {
            return Some(at + marker.len());
        }
        from = at + marker.len();
    }
    None
}

/// Bytes after a marker.
fn parse_marked(text: &str, lower: &str, scratch: &mut Vec<u8>) -> Option<Option<Direction>> {
    for (marker, direction) in MARKERS {
        let Some(at) = find_marker(lower, marker) else { continue };
        scratch.clear();
        let rest = parse_bytes(&text[at..], scratch);
        if rest.is_some_and(is_trailer) && scratch.len() >= BYTES_MIN {
            return Some(Some(direction));
        }
    }
    scratch.clear();
    None
}

/// A line of `polepair decode`: `0.000000  ttyUSB0 > tmcl  01 06 01 00 00 00 00 00 08  GAP 1, 0`.
fn parse_decoded(text: &str, scratch: &mut Vec<u8>) -> Option<Option<Direction>> {
    let (before, after, direction) = match (text.split_once(" > "), text.split_once(" < ")) {
        (Some((before, after)), None) => (before, after, Direction::ToDrive),
        (None, Some((before, after))) => (before, after, Direction::ToHost),
        _ => return None,
    };
    let (_, bytes) = after.trim_start().split_once("  ")?;
    scratch.clear();
    let rest = parse_bytes(first_column(bytes.trim_start()), scratch)?;
    (rest.is_empty() && before.contains("  ")).then_some(Some(direction))
}

/// libmodbus: `[01][03]` for sent bytes, `<01><03>` for received ones.
fn parse_brackets(text: &str, scratch: &mut Vec<u8>) -> Option<Option<Direction>> {
    let (open, close, direction) = match text.chars().next()? {
        '[' => ('[', ']', Direction::ToDrive),
        '<' => ('<', '>', Direction::ToHost),
        _ => return None,
    };
    scratch.clear();
    for part in text.split_terminator(close) {
        let digits = part.strip_prefix(open).filter(|digits| digits.len() == 2)?;
        scratch.push(u8::from_str_radix(digits, 16).ok()?);
    }
    (scratch.len() >= BYTES_MIN).then_some(Some(direction))
}

/// Bytes alone that are marked as such, `0x01 0x03`, or a byte of sigrok's UART decoder.
fn parse_bare(text: &str, scratch: &mut Vec<u8>) -> Option<Option<Direction>> {
    scratch.clear();
    if let Some(at) = text.find("uart-") {
        let byte = text[at..].split_once(": ")?.1.trim();
        scratch.push(u8::from_str_radix(byte, 16).ok().filter(|_| byte.len() == 2)?);
        return Some(None);
    }
    let marked = text.starts_with("0x") || text.starts_with("\\x") || text.starts_with("b'");
    (marked && parse_bytes(text, scratch)?.is_empty()).then_some(None)
}

#[cfg(test)]
mod tests {
    use super::{ToolLine, parse_tool_line};
    use crate::record::RecordData;

    /// The line in the words of a log, or a description of its other kind.
    fn read(line: &str) -> String {
        let mut scratch = Vec::new();
        match parse_tool_line(line.as_bytes(), &mut scratch) {
            None => "nothing".to_owned(),
            Some(ToolLine::Repeated) => "repeated".to_owned(),
            Some(ToolLine::InMinute(..)) => "a time within a minute".to_owned(),
            Some(ToolLine::Record(raw)) => {
                let record = raw.with_bytes(&scratch);
                let way = match record.direction {
                    None => "?",
                    Some(polepair_core::explain::Direction::ToDrive) => ">",
                    Some(polepair_core::explain::Direction::ToHost) => "<",
                };
                let data = match record.data {
                    RecordData::Bytes(bytes) => format!("{bytes:02X?}"),
                    RecordData::Frame(f) => format!("{:X} {:02X?}", f.id, f.bytes()),
                    other => format!("{other:?}"),
                };
                let time = record.time.map_or_else(|| "-".to_owned(), |time| time.to_string());
                format!("{time} {} {way} {data}", record.link)
            }
        }
    }

    #[test]
    fn debug_lines_of_libraries() {
        for (line, expected) in [
            ("SEND: 0x1 0x3 0x0 0x2", "- - > [01, 03, 00, 02]"),
            (
                "2026-11-27 12:34:56,500 DEBUG logging:103 recv: 0x1 0x83 0x2 old_data:  addr=None",
                "1795782896.5 - < [01, 83, 02]",
            ),
            ("DEBUG:pymodbus:Processing: 0x1 0x83 0x2", "repeated"),
            (
                "MinimalModbus debug mode. Will write to instrument (expecting 7 bytes back): 01 03 84 0A (4 bytes)",
                "- - > [01, 03, 84, 0A]",
            ),
            (
                "MinimalModbus debug mode. Response from instrument: 01 03 02 (3 bytes), roundtrip time: 12.3 ms.",
                "- - < [01, 03, 02]",
            ),
            (
                "MinimalModbus debug mode. Response from instrument: b'\\x01\\x03A\\r' (4 bytes)",
                "- - < [01, 03, 41, 0D]",
            ),
            ("MinimalModbus debug mode. Clearing serial buffers for port COM3", "nothing"),
            ("[01][03][C4][0B]", "- - > [01, 03, C4, 0B]"),
            ("<01><03><C4>", "- - < [01, 03, C4]"),
            ("Waiting for a confirmation...", "nothing"),
            ("Opening /dev/ttyUSB0 at 9600 bauds (N, 8, 1)", "nothing"),
            (
                "TMCL_Request: 01,06,01,00,00000000,08 -> GAP(type=1, idx=0, value=0x00000000)",
                "- - > [01, 06, 01, 00, 00, 00, 00, 00, 08]",
            ),
            ("TMCL_Reply:   02,01,64,06,000002C7,36", "- - < [02, 01, 64, 06, 00, 00, 02, C7, 36]"),
            ("[1659693849.478014] Sending: 10 02 02", "1659693849.478014 - > [10, 02, 02]"),
            ("Tx: 01 03 00", "- - > [01, 03, 00]"),
            ("12:00:01.5 Rx:01-03-02", "43201.5 - < [01, 03, 02]"),
            ("0x01 0x03", "- - ? [01, 03]"),
            ("12-34 uart-1: 4B", "- - ? [4B]"),
        ] {
            assert_eq!(read(line), expected, "{line}");
        }
    }

    #[test]
    fn can_frames_in_lines_of_libraries() {
        for (line, expected) in [
            (
                "Timestamp: 1700000000.000500    ID: 0581    S Rx                DL:  8    43 41 60 00 \
                 37 02 00 00     'CA`.7...'  Channel: can0",
                "1700000000.0005 can0 < 581 [43, 41, 60, 00, 37, 02, 00, 00]",
            ),
            (
                "DEBUG can.socketcan.tx: sending: Timestamp:        0.000000    ID: 0400a05e    X Tx  \
                 DLC:  2    34 12",
                "0.0 - > 400A05E [34, 12]",
            ),
            (
                "[ INFO] [1700000000.5]: sent 601#4041600000000000",
                "- - ? 601 [40, 41, 60, 00, 00, 00, 00, 00]",
            ),
            ("60C  40 02 65", "- - ? 60C [40, 02, 65]"),
            ("81#0011", "- - ? 81 [00, 11]"),
            ("60C  40 02 65 00 00 00 00 00 00", "nothing"),
            ("see issue #12", "nothing"),
        ] {
            assert_eq!(read(line), expected, "{line}");
        }
    }
}
