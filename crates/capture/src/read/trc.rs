//! TRC, the text log of PEAK's tools, versions 1.0 to 1.3 and 2.0, 2.1.

use polepair_core::explain::Direction;

use super::ReadError;
use super::lines::{LineFormat, ParsedLine};
use crate::date;
use crate::record::{
    CanErrorFrame, CanRecord, ID_MASK, Record, STANDARD_MAX, classic_frame, fd_len_from_dlc,
};
use crate::timestamp::Timestamp;

/// Columns of the versions that do not name them, in the letters of those that do: `N`umber,
/// `O`ffset in milliseconds, `B`us, `d`irection, `I`dentifier, `R`eserved, `l`ength, `D`ata.
const COLUMNS: [(&str, &str); 6] = [
    ("1.0", "NOIlD"),
    ("1.1", "NOdIlD"),
    ("1.2", "NOBdIlD"),
    ("1.3", "NOBdIRlD"),
    ("2.0", "NOTIdlD"),
    ("2.1", "NOTBIdRLD"),
];

/// The reader of such lines.
#[derive(Debug)]
pub(super) struct TrcReader {
    start_time: Timestamp,
    columns: Vec<u8>,
    link: String,
    bytes: Vec<u8>,
}

impl Default for TrcReader {
    fn default() -> Self {
        let columns = COLUMNS[0].1.as_bytes().to_vec();
        Self { start_time: Timestamp(0), columns, link: String::new(), bytes: Vec::new() }
    }
}

impl LineFormat for TrcReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let line = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line).trim_ascii();
        match line {
            [] => Ok(ParsedLine::Nothing),
            [b';', header @ ..] => {
                self.parse_header(&String::from_utf8_lossy(header));
                Ok(ParsedLine::Nothing)
            }
            _ => {
                let line =
                    std::str::from_utf8(line).map_err(|_| ReadError("the line is not text"))?;
                self.parse_record(line)
            }
        }
    }
}

/// The words of a line, by column.
#[derive(Default)]
struct TrcColumns<'a> {
    offset: &'a str,
    kind: &'a str,
    bus: &'a str,
    id: &'a str,
    direction: &'a str,
    length: &'a str,
    /// The length is a code.
    is_code: bool,
    data: &'a str,
}

impl TrcReader {
    fn parse_header(&mut self, line: &str) {
        let Some((key, value)) = line.trim().split_once('=') else { return };
        let value = value.trim();
        match key.trim() {
            "$FILEVERSION" => {
                let known = COLUMNS.iter().rev().find(|(version, _)| value >= *version);
                self.columns = known.unwrap_or(&COLUMNS[0]).1.as_bytes().to_vec();
            }
            "$STARTTIME" => {
                let begin = value.parse().ok().and_then(date::from_ole_days);
                self.start_time = begin.unwrap_or(self.start_time);
            }
            "$COLUMNS" => {
                let letters = value.split(',').filter_map(|word| word.trim().bytes().next());
                self.columns = letters.collect();
            }
            _ => {}
        }
    }

    fn split_columns<'a>(&self, mut line: &'a str) -> TrcColumns<'a> {
        let mut found = TrcColumns { bus: "1", ..TrcColumns::default() };
        for column in &self.columns {
            line = line.trim_ascii_start();
            if *column == b'D' {
                found.data = line;
                break;
            }
            let (word, rest) =
                line.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((line, ""));
            line = rest;
            match column {
                b'O' => found.offset = word,
                b'T' => found.kind = word,
                b'B' => found.bus = word,
                b'I' => found.id = word,
                b'd' => found.direction = word,
                b'l' => found.length = word,
                b'L' => (found.length, found.is_code) = (word, true),
                _ => {}
            }
        }
        found
    }

    fn parse_record<'a>(&'a mut self, line: &'a str) -> Result<ParsedLine<'a>, ReadError> {
        let columns = self.split_columns(line);
        let time = self.parse_time(columns.offset).ok_or(ReadError("expected milliseconds"))?;
        // PEAK counts buses from 1, Linux its interfaces from 0.
        let bus = columns.bus.parse::<u32>().ok().filter(|n| *n > 0);
        let bus = bus.ok_or(ReadError("expected the number of a bus"))? - 1;
        self.link.clear();
        let _ = std::fmt::Write::write_fmt(&mut self.link, format_args!("can{bus}"));
        let direction = match columns.direction {
            "Rx" => Some(Direction::ToHost),
            "Tx" => Some(Direction::ToDrive),
            _ => None,
        };
        let shape = match (columns.kind, columns.direction) {
            ("EV", _) => return Ok(ParsedLine::Skipped("user events")),
            ("ST", _) => CanRecord::Error(status_frame(columns.data)?),
            ("EC", _) => {
                let [receive, transmit] = parse_status(columns.data)?;
                CanRecord::Error(CanErrorFrame::from_counters(transmit, receive))
            }
            ("ER", _) | (_, "Error") => CanRecord::Error(error_frame(CanErrorFrame::BUS_ERROR, 0)),
            (_, "Warng") => CanRecord::Error(warning_frame(columns.data)),
            _ if columns.id == "FFFFFFFF" => CanRecord::Error(warning_frame(columns.data)),
            _ => self.parse_frame(&columns)?,
        };
        let direction = direction.filter(|_| !matches!(shape, CanRecord::Error(_)));
        let data = shape.with_bytes(&self.bytes);
        let record = Record { time: Some(time), link: &self.link, direction, data, offset: 0 };
        Ok(ParsedLine::Record(record))
    }

    fn parse_time(&self, word: &str) -> Option<Timestamp> {
        let (whole, rest) = word.split_once('.').unwrap_or((word, ""));
        let ms = whole.parse::<u64>().ok()?;
        let digits = rest.bytes().chain(std::iter::repeat(b'0')).take(6);
        let ns = digits.fold(0, |sum, digit| sum * 10 + u64::from(digit.wrapping_sub(b'0').min(9)));
        let since = ms.checked_mul(1_000_000)?.checked_add(ns)?;
        Some(Timestamp(self.start_time.0.checked_add(since)?))
    }

    fn parse_frame(&mut self, columns: &TrcColumns<'_>) -> Result<CanRecord, ReadError> {
        let extended = columns.id.len() > 4;
        let id =
            u32::from_str_radix(columns.id, 16).map_err(|_| ReadError("expected an identifier"))?;
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(ReadError("the identifier is too great"));
        }
        let length = columns.length.parse::<u8>().map_err(|_| ReadError("expected a length"))?;
        let length = if columns.is_code { fd_len_from_dlc(length.min(15)) } else { length };
        let fd = matches!(columns.kind, "FD" | "FB" | "FE" | "BI");
        if columns.kind == "RR" || columns.data.starts_with("RTR") {
            return Ok(CanRecord::Frame(classic_frame(id, extended, true, length, &[])));
        }
        self.bytes.clear();
        let mut words = columns.data.split_ascii_whitespace();
        for _ in 0..length.min(if fd { 64 } else { 8 }) {
            let word = words.next().ok_or(ReadError("it has fewer bytes than its length says"))?;
            let byte = u8::from_str_radix(word, 16).map_err(|_| ReadError("expected bytes"))?;
            self.bytes.push(byte);
        }
        let brs = u8::from(matches!(columns.kind, "FB" | "BI"));
        let flags = brs | u8::from(matches!(columns.kind, "FE" | "BI")) << 1;
        Ok(if fd {
            CanRecord::Fd { id, extended, flags }
        } else {
            CanRecord::Frame(classic_frame(id, extended, false, length, &self.bytes))
        })
    }
}

/// The bytes of a status row.
fn parse_status<const N: usize>(data: &str) -> Result<[u8; N], ReadError> {
    let mut words = data.split_ascii_whitespace();
    let mut bytes = [0; N];
    for byte in &mut bytes {
        let word = words.next().and_then(|word| u8::from_str_radix(word, 16).ok());
        *byte = word.ok_or(ReadError("expected the bytes of a status"))?;
    }
    Ok(bytes)
}

/// A status of PEAK's hardware, a bit each: 4 warning, 8 passive, 10h bus off, 40000h passive too.
fn status_frame(data: &str) -> Result<CanErrorFrame, ReadError> {
    let status = u32::from_be_bytes(parse_status(data)?);
    Ok(match status {
        0 => CanErrorFrame::from_state(CanErrorFrame::ACTIVE),
        _ if status & 0x10 != 0 => error_frame(CanErrorFrame::BUS_OFF, 0),
        _ if status & 0x4_0008 != 0 => CanErrorFrame::from_state(CanErrorFrame::PASSIVE),
        _ if status & 0x4 != 0 => CanErrorFrame::from_state(CanErrorFrame::WARNING),
        _ if status & 0x42 != 0 => CanErrorFrame::from_state(0x01),
        _ => error_frame(CanErrorFrame::BUS_ERROR, 0),
    })
}

fn error_frame(class: u32, detail: u8) -> CanErrorFrame {
    CanErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] }
}

/// State in a warning's last words: the bus is light, heavy or off, a queue is full.
fn warning_frame(text: &str) -> CanErrorFrame {
    match () {
        () if has_word("BUSOFF", text) => error_frame(0x40, 0),
        () if has_word("BUSHEAVY", text) || has_word("BUSPASSIVE", text) => {
            error_frame(CanErrorFrame::CONTROLLER_CLASS, 0x30)
        }
        () if has_word("BUSLIGHT", text) => error_frame(CanErrorFrame::CONTROLLER_CLASS, 0x0C),
        () if has_word("QOVERRUN", text) || has_word("OVERRUN", text) => {
            error_frame(CanErrorFrame::CONTROLLER_CLASS, 0x01)
        }
        () => error_frame(CanErrorFrame::BUS_ERROR, 0),
    }
}

fn has_word(word: &str, text: &str) -> bool {
    text.split_ascii_whitespace().any(|other| other.starts_with(word))
}
