//! Lines that other programs print: debug output of Modbus, TMCL and CAN libraries, and bytes in their
//! notations.
//!
//! A line may begin with a date or a time, and with the words of a logger. What counts is a known marker with
//! bytes after it, or a CAN frame. Examples are in docs/reference/capture-formats.md.

use polepair_core::explain::Direction;

use super::candump;
use super::words::{parse_hex, parse_hex_digit};
use crate::date;
use crate::record::{CanRecord, ID_MASK, Record, RecordData, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// Content of a line of another program.
pub(super) enum ToolLine<'a> {
    /// Data.
    Record(Record<'a>),
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

/// Parses a line of another program. `None` where it has no data. Serial bytes are put into `scratch`.
pub(super) fn parse_tool_line<'a>(
    line: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Option<ToolLine<'a>> {
    let line = std::str::from_utf8(line).ok()?.trim();
    let (time, text) = split_time(line);
    scratch.clear();
    if let Some(record) = parse_python_can(text) {
        return Some(ToolLine::Record(record));
    }
    if let Some((direction, data)) = parse_frame_token(text, scratch) {
        let data = data.with_bytes(scratch);
        return Some(ToolLine::Record(Record { time, link: "-", direction, data, offset: 0 }));
    }
    if let Some((id, data)) = split_id(text) {
        parse_bytes(data, scratch).filter(|rest| rest.is_empty() && scratch.len() <= 8)?;
        let data = RecordData::Frame(classic_frame(id, false, false, scratch.len() as u8, scratch));
        return Some(ToolLine::Record(Record {
            time,
            link: "-",
            direction: None,
            data,
            offset: 0,
        }));
    }
    // Programs disagree about capital letters, also between their own versions.
    let lower = text.to_ascii_lowercase();
    if let Some(at) = REPEATED.iter().find_map(|marker| find_marker(&lower, marker)) {
        let bytes = parse_bytes(&text[at..], scratch).is_some() && scratch.len() >= BYTES_MIN;
        return bytes.then_some(ToolLine::Repeated);
    }
    let direction = parse_decoded(text, scratch)
        .or_else(|| parse_brackets(text, scratch))
        .or_else(|| parse_marked(text, &lower, scratch))
        .or_else(|| parse_bare(text, scratch))?;
    let data = RecordData::Bytes(scratch);
    Some(ToolLine::Record(Record { time, link: "-", direction, data, offset: 0 }))
}

/// Splits off a date and a time, a time of day, or seconds in brackets at the start of a line.
fn split_time(line: &str) -> (Option<Timestamp>, &str) {
    let open = line.strip_prefix('[').unwrap_or(line);
    let (first, rest) = split_at_space(open);
    if let Some(date) = parse_date(first) {
        let (clock, rest) = split_at_space(rest);
        if let Some((clock, ns)) = parse_clock(clock.trim_end_matches([']', 'Z'])) {
            return (date::from_calendar(date, clock, ns), rest);
        }
    }
    if let Some((date, clock)) = first.split_once('T')
        && let (Some(date), Some((clock, ns))) =
            (parse_date(date), parse_clock(clock.trim_end_matches([']', 'Z'])))
    {
        return (date::from_calendar(date, clock, ns), rest);
    }
    if let Some((clock, ns)) = parse_clock(first.trim_end_matches(']')) {
        return (date::from_calendar([1970, 1, 1], clock, ns), rest);
    }
    if open.len() < line.len() && ends_bracket(first) && first.contains('.') {
        let time = Timestamp::parse(first.trim_end_matches(']').as_bytes());
        return (time, if time.is_some() { rest } else { line });
    }
    (None, line)
}

fn ends_bracket(word: &str) -> bool {
    word.ends_with(']')
}

/// `2026-11-27`.
pub(super) fn parse_date(word: &str) -> Option<[u16; 3]> {
    let mut parts = word.split('-');
    let date =
        [parts.next()?.parse().ok()?, parts.next()?.parse().ok()?, parts.next()?.parse().ok()?];
    (parts.next().is_none() && word.len() == 10).then_some(date)
}

/// `12:34:56.789`, also with a comma, or without decimals.
pub(super) fn parse_clock(word: &str) -> Option<([u16; 3], u32)> {
    let (clock, decimals) = word.split_once(['.', ',']).unwrap_or((word, ""));
    let mut parts = clock.split(':');
    let clock =
        [parts.next()?.parse().ok()?, parts.next()?.parse().ok()?, parts.next()?.parse().ok()?];
    if parts.next().is_some() || !decimals.bytes().all(|c| c.is_ascii_digit()) {
        return None;
    }
    let digits = decimals.bytes().chain(core::iter::repeat(b'0')).take(9);
    Some((clock, digits.fold(0, |ns, digit| ns * 10 + u32::from(digit - b'0'))))
}

fn split_at_space(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// A message as python-can prints it: `Timestamp: 1.5  ID: 0601  S Rx  DL: 8  40 41 …  Channel: can0`.
fn parse_python_can(text: &str) -> Option<Record<'_>> {
    let begin = text.find("Timestamp:")?;
    let mut words = text[begin..].split_ascii_whitespace().peekable();
    words.next();
    let time = Timestamp::parse(words.next()?.as_bytes())?;
    words.next().filter(|word| *word == "ID:")?;
    let id = u32::from_str_radix(words.next()?, 16).ok()?;
    let (mut extended, mut remote, mut direction) = (false, false, None);
    loop {
        match words.next()? {
            "X" => extended = true,
            "R" => remote = true,
            "Rx" => direction = Some(Direction::ToHost),
            "Tx" => direction = Some(Direction::ToDrive),
            // Error and CAN FD frames have no place in a classic frame.
            "E" | "F" => return None,
            "DL:" | "DLC:" => break,
            _ => {}
        }
    }
    let length: u8 = words.next()?.parse().ok().filter(|length| *length <= 8)?;
    let mut bytes = [0; 8];
    if !remote {
        for byte in &mut bytes[..usize::from(length)] {
            *byte = u8::from_str_radix(words.next().filter(|word| word.len() == 2)?, 16).ok()?;
        }
    }
    let link = text.rsplit_once("Channel:").map_or("-", |(_, name)| name.trim());
    let link = if link.is_empty() { "-" } else { link };
    // A longer number in that column is not an identifier.
    if id > if extended { ID_MASK } else { STANDARD_MAX } {
        return None;
    }
    let data = RecordData::Frame(classic_frame(id, extended, remote, length, &bytes));
    Some(Record { time: Some(time), link, direction, data, offset: 0 })
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

/// Returns whether text after the bytes is one that the libraries append, and not the rest of other data.
fn is_trailer(rest: &str) -> bool {
    let first = rest.chars().next();
    first.is_none_or(|c| matches!(c, '(' | '<' | '>' | '[' | '\'' | '"'))
        || ["old_data", "extra", "addr", "bytes"].iter().any(|word| rest.starts_with(word))
}

/// The text up to a gap of two spaces.
fn first_column(text: &str) -> &str {
    text.split_once("  ").map_or(text, |(column, _)| column)
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

/// Parses bytes: `01 03`, `0x1 0x3`, `01,03`, `b'\x01\x03'`. Returns the text after them; `None` where
/// there are none.
fn parse_bytes<'t>(text: &'t str, bytes: &mut Vec<u8>) -> Option<&'t str> {
    let text = text.trim_start();
    let quoted = text.strip_prefix('b').unwrap_or(text);
    if let Some(quote) = quoted.chars().next().filter(|c| matches!(c, '\'' | '"' | '\\')) {
        return parse_escapes(quoted, quote, bytes);
    }
    const SEPARATORS: [char; 5] = [' ', ',', '\t', '-', ':'];
    let mut rest = text;
    while !rest.is_empty() {
        let (word, after) = rest.split_at(rest.find(SEPARATORS).unwrap_or(rest.len()));
        let number = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X"));
        let digits = number.unwrap_or(word).as_bytes();
        if !digits.iter().all(u8::is_ascii_hexdigit) {
            break;
        }
        match digits {
            [digit] if number.is_some() => bytes.push(parse_hex_digit(*digit).ok()?),
            [_, ..] if digits.len().is_multiple_of(2) => parse_hex(digits, bytes).ok()?,
            _ => break,
        }
        rest = after.trim_start_matches(SEPARATORS);
    }
    (!bytes.is_empty()).then_some(rest)
}

/// Parses the bytes of a Python literal, `\x01\x03A\r`, up to the closing quote.
fn parse_escapes<'t>(text: &'t str, quote: char, bytes: &mut Vec<u8>) -> Option<&'t str> {
    let quoted = quote != '\\';
    let mut chars = if quoted { &text[quote.len_utf8()..] } else { text }.chars();
    while let Some(c) = chars.next() {
        let byte = match c {
            _ if quoted && c == quote => return Some(chars.as_str().trim_start()),
            '\\' => match chars.next()? {
                'x' => {
                    let digits = chars.as_str().get(..2)?;
                    chars = chars.as_str()[2..].chars();
                    u8::from_str_radix(digits, 16).ok()?
                }
                'r' => b'\r',
                'n' => b'\n',
                't' => b'\t',
                other => u8::try_from(other).ok()?,
            },
            _ => u8::try_from(c).ok()?,
        };
        bytes.push(byte);
    }
    // Without quotes, the end of the line ends the bytes.
    (!quoted).then_some("")
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
            Some(ToolLine::Record(record)) => {
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
