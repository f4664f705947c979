//! Tables of CAN frames by the names of their columns, in whatever order: of loggers (CANedge, CLX000), of adapters'
//! programs (ZLG, CANalyst-II, IXXAT), and of scripts.
//!
//! ```text
//! TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes
//! Index,System Time,Channel,Direction,ID,Type,Format,DLC,Data
//! "Time","Identifier (hex)","Format","Flags","Data (hex)"
//! ```

use polepair_core::explain::Direction;

use super::ReadError;
use super::line_time::split_time;
use super::marked_line::split_direction;
use super::printed_frame::{CHANNELS, parse_id};
use super::text::RawLine;
use super::words::parse_hex;
use crate::date;
use crate::record::{CanRecord, ID_MASK, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// Names of columns without spaces and units, in lower case, the preferred first.
const TIMES: [&str; 8] = [
    "timestampepoch",
    "abstime",
    "systemtime",
    "系统时间",
    "time",
    "timestamp",
    "timeoffset",
    "relativetime",
];
const IDS: [&str; 9] =
    ["id", "canid", "identifier", "frameid", "messageid", "msgid", "arbitrationid", "id号", "帧id"];
const LENGTHS: [&str; 7] = ["datalength", "dlc", "len", "length", "datalen", "size", "长度"];
const DATA: [&str; 6] = ["databytes", "data", "payload", "bytes", "candata", "数据"];
const FIRST_BYTES: [&str; 8] = ["d0", "data0", "byte0", "b0", "d1", "data1", "byte1", "b1"];
const DIRECTIONS: [&str; 6] = ["dir", "direction", "rx/tx", "tx/rx", "传输方向", "方向"];
const CHANNEL: [&str; 8] =
    ["buschannel", "canchannel", "channel", "bus", "ch", "chn", "can通道", "通道"];
const FORMATS: [&str; 8] =
    ["ide", "extended", "ext", "format", "idformat", "type", "帧格式", "帧类型"];
const KINDS: [&str; 6] = ["rtr", "remote", "type", "frametype", "flags", "帧类型"];

/// Unit of integer times.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum TimeUnit {
    Unknown,
    Seconds,
    Milliseconds,
    Microseconds,
}

/// Base of identifiers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum NumberBase {
    /// Shown by the digits, or not certain.
    Unknown,
    Hexadecimal,
    Decimal,
}

/// Columns of a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct NamedTable {
    separator: char,
    time: Option<(usize, TimeUnit)>,
    id: (usize, NumberBase),
    length: Option<usize>,
    /// The first column of data, and whether it has all of it.
    data: (usize, bool),
    direction: Option<usize>,
    channel: Option<usize>,
    format: Option<usize>,
    kind: Option<usize>,
}

impl NamedTable {
    /// The columns of a first line; `None` where it names no identifier or no data.
    pub fn from_header(header: &str) -> Option<Self> {
        let separator = [';', '\t', ','].into_iter().find(|sign| header.contains(*sign))?;
        let names: Vec<(String, String)> = header.split(separator).map(split_unit).collect();
        let find = |wanted: &[&str]| {
            wanted.iter().find_map(|name| names.iter().position(|(column, _)| column == name))
        };
        let id = find(&IDS)?;
        let time = find(&TIMES);
        let data = find(&DATA).map(|at| (at, true));
        let data = data.or_else(|| find(&FIRST_BYTES).map(|at| (at, false)))?;
        let is_logger = names.iter().any(|(name, _)| name == "timestampepoch")
            || header.starts_with("Timestamp;Type;ID;Length;Data");
        let base = match names[id].1.as_str() {
            unit if is_logger || unit.starts_with("hex") => NumberBase::Hexadecimal,
            unit if unit.starts_with("dec") => NumberBase::Decimal,
            _ => NumberBase::Unknown,
        };
        let unit = |at: usize| match names[at].1.as_str() {
            "s" | "sec" | "seconds" => TimeUnit::Seconds,
            "ms" => TimeUnit::Milliseconds,
            "us" | "µs" | "μs" => TimeUnit::Microseconds,
            _ => TimeUnit::Unknown,
        };
        let length = find(&LENGTHS).filter(|at| *at != data.0);
        if !data.1 && length.is_none() {
            return None;
        }
        Some(Self {
            separator,
            time: time.map(|at| (at, unit(at))),
            id: (id, base),
            length,
            data,
            direction: find(&DIRECTIONS),
            channel: find(&CHANNEL),
            format: find(&FORMATS),
            kind: find(&KINDS),
        })
    }

    /// Parses a row, and puts its bytes into `bytes`.
    ///
    /// # Errors
    /// A cell that cannot be read, or is not certain.
    pub fn parse_row(
        &self,
        line: &str,
        bytes: &mut Vec<u8>,
    ) -> Result<RawLine<'static>, ReadError> {
        let cells: Vec<&str> = line.split(self.separator).map(unquote).collect();
        let cell = |at: Option<usize>| at.and_then(|at| cells.get(at)).copied().unwrap_or("");
        let (id, is_long) = self.parse_id(cell(Some(self.id.0)))?;
        let (format, kind) = (cell(self.format).to_lowercase(), cell(self.kind).to_lowercase());
        let extended = match format.as_str() {
            "1" | "9" | "true" | "x" | "扩展帧" => true,
            _ if format.starts_with("ext") || format.starts_with('扩') => true,
            _ => is_long,
        };
        if !extended && id > STANDARD_MAX {
            return Err(ReadError("the identifier is too great for a standard frame"));
        }
        let is_remote_word = kind.starts_with("rem") || kind == "rtr" || kind.starts_with("远程");
        let is_flag = self.kind.is_some() && self.kind != self.format && kind == "1";
        let remote = is_remote_word || is_flag;
        let length = cell(self.length);
        let length = match length.strip_prefix("0x").unwrap_or(length) {
            "" => None,
            digits => Some(digits.parse::<usize>().map_err(|_| ReadError("expected a length"))?),
        };
        bytes.clear();
        if !remote {
            self.parse_data(&cells, length, bytes)?;
        }
        let len = length.unwrap_or(bytes.len());
        if !remote && bytes.len() != len {
            return Err(ReadError("the number of its bytes is not its length"));
        }
        let can = match len {
            0..=8 => CanRecord::Frame(classic_frame(id, extended, remote, len as u8, bytes)),
            9..=64 => CanRecord::Fd { id, extended, flags: 0 },
            _ => return Err(ReadError("a CAN FD frame has at most 64 bytes")),
        };
        let time = self.time.and_then(|(at, unit)| parse_time(cell(Some(at)), unit));
        let direction = parse_direction(cell(self.direction));
        // The loggers of CSS Electronics mark what they sent themselves in the type.
        let is_sent = self.direction.is_none() && matches!(kind.as_str(), "8" | "9");
        let direction = direction.or_else(|| is_sent.then_some(Direction::ToDrive));
        let link = parse_channel(cell(self.channel));
        Ok(RawLine { time, link, direction, can: Some(can) })
    }

    fn parse_id(&self, word: &str) -> Result<(u32, bool), ReadError> {
        let digits = word.trim_start_matches("0x");
        let id = match self.id.1 {
            NumberBase::Unknown => parse_id(word),
            NumberBase::Hexadecimal => {
                u32::from_str_radix(digits, 16).ok().map(|id| (id, id > STANDARD_MAX))
            }
            NumberBase::Decimal => word.parse().ok().map(|id| (id, id > STANDARD_MAX)),
        };
        id.filter(|(id, _)| *id <= ID_MASK).ok_or(ReadError(
            "expected an identifier in hexadecimal: 0x601, 601, or 00000601; the column may be named \"ID (hex)\"",
        ))
    }

    fn parse_data(
        &self,
        cells: &[&str],
        length: Option<usize>,
        bytes: &mut Vec<u8>,
    ) -> Result<(), ReadError> {
        let (first, is_whole) = self.data;
        if is_whole {
            let text = cells.get(first).copied().unwrap_or("");
            let text = text.trim_start_matches(['x', '|']).trim();
            return text
                .split([' ', '-', ':', ','])
                .filter(|word| !word.is_empty())
                .try_for_each(|word| parse_hex(word.trim_start_matches("0x").as_bytes(), bytes));
        }
        let words = cells.iter().skip(first).take(length.unwrap_or(0));
        words.copied().try_for_each(|word| {
            let digits = word.strip_prefix("0x").unwrap_or(word);
            // One digit, or three, could be decimal.
            let byte = u8::from_str_radix(digits, 16).ok().filter(|_| digits.len() == 2);
            bytes.push(byte.ok_or(ReadError("expected bytes of two hexadecimal digits"))?);
            Ok(())
        })
    }
}

/// A column's name without spaces, and its unit: `Time [s]`, `ID (hex)`.
fn split_unit(column: &str) -> (String, String) {
    let lower = unquote(column.trim_start_matches('\u{FEFF}')).to_lowercase();
    let (name, unit) = lower.split_once(['[', '(']).unwrap_or((&lower, ""));
    let name = name.chars().filter(|c| !c.is_whitespace() && !"_-.".contains(*c)).collect();
    (name, unit.trim_end_matches([']', ')']).trim().to_owned())
}

fn unquote(cell: &str) -> &str {
    cell.trim().trim_matches('"').trim()
}

/// A time; `None` where its unit is not known.
fn parse_time(cell: &str, unit: TimeUnit) -> Option<Timestamp> {
    let scaled = |divisor: u64| {
        let seconds = Timestamp::parse(cell.as_bytes())?;
        Some(Timestamp(seconds.0 / divisor))
    };
    match unit {
        TimeUnit::Seconds => scaled(1),
        TimeUnit::Milliseconds => scaled(1000),
        TimeUnit::Microseconds => scaled(1_000_000),
        TimeUnit::Unknown => {
            let time = split_time(cell).filter(|(_, rest)| rest.is_empty()).map(|(time, _)| time);
            time.or_else(|| parse_compact(cell))
        }
    }
}

/// `20200107T120000123`.
fn parse_compact(cell: &str) -> Option<Timestamp> {
    let (day, clock) = cell.split_once('T')?;
    let number = |text: &str, at: usize, len: usize| text.get(at..at + len)?.parse::<u16>().ok();
    let date = [number(day, 0, 4)?, number(day, 4, 2)?, number(day, 6, 2)?];
    let time = [number(clock, 0, 2)?, number(clock, 2, 2)?, number(clock, 4, 2)?];
    let ms = number(clock, 6, 3).unwrap_or(0);
    date::from_calendar(date, time, u32::from(ms) * 1_000_000)
}

fn parse_direction(cell: &str) -> Option<Direction> {
    match cell {
        // CANedge.
        "0" => Some(Direction::ToHost),
        "1" => Some(Direction::ToDrive),
        _ => split_direction(cell).map(|(direction, _)| direction),
    }
}

/// The name of a bus that is counted from 0 on Linux; other programs' numbers are kept.
fn parse_channel(cell: &str) -> &'static str {
    let digits = cell.trim_start_matches(|c: char| c.is_ascii_alphabetic());
    let number = digits.parse::<usize>().ok();
    number.and_then(|number| CHANNELS.get(number).copied()).unwrap_or("can0")
}

#[cfg(test)]
mod tests {
    use super::NamedTable;

    #[test]
    fn a_table_needs_an_identifier_and_data() {
        assert!(NamedTable::from_header("Time,ID,Data").is_some());
        assert!(NamedTable::from_header("ID,Data Bytes").is_some());
        assert!(NamedTable::from_header("ID;D0;D1;D2").is_none(), "no length");
        assert!(NamedTable::from_header("Time,Speed,Torque").is_none());
        assert!(NamedTable::from_header("a sentence, with id, and data").is_none());
    }
}
