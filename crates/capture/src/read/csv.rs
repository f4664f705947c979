//! Tables with commas. The first line has the names of the columns, which identify the program that wrote the table:
//!
//! - python-can: `timestamp,arbitration_id,extended,remote,error,dlc,data`, with data in base 64.
//! - SavvyCAN (GVRET): `Time Stamp,ID,Extended,Dir,Bus,LEN,D1,…`, with times in microseconds.
//! - Saleae Logic: `Time [s],Value,…` and `name,type,start_time,duration,data,…`, a byte of a UART a line.
//! - all others with [named columns](NamedTable).

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use polepair_core::explain::Direction;

use super::ReadError;
use super::gbk;
use super::lines::{LineFormat, ParsedLine};
use super::table::NamedTable;
use crate::record::{
    CanErrorFrame, CanRecord, ID_MASK, Record, RecordData, STANDARD_MAX, classic_frame,
};
use crate::timestamp::Timestamp;

/// Columns of python-can that are read.
const PYTHON_CAN: [&str; 7] =
    ["timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data"];
/// Columns of SavvyCAN before the data. Older versions have no direction.
const GVRET: [&str; 6] = ["time stamp", "id", "extended", "dir", "bus", "len"];
/// Columns of Saleae's two programs.
const SALEAE_BYTES: [&str; 2] = ["time [s]", "value"];
const SALEAE_TABLE: [&str; 4] = ["name", "type", "start_time", "data"];
/// Bytes of the longest CAN FD frame.
const FD_MAX: usize = 64;

/// First words of a table's head, in lower case.
const HEADERS: [&[u8]; 4] = [b"timestamp,", b"time stamp,", b"time [s],", b"name,type,start_time"];

/// Returns whether a line is the head of a table.
pub(crate) fn is_header(line: &[u8]) -> bool {
    let begins = |header: &&[u8]| {
        line.get(..header.len()).is_some_and(|start| start.eq_ignore_ascii_case(header))
    };
    HEADERS.iter().any(begins) || NamedTable::from_header(&gbk::decode(line)).is_some()
}

/// Program that wrote the table, and its columns.
#[derive(Clone, Copy, Debug)]
enum CsvDialect {
    PythonCan([Option<usize>; PYTHON_CAN.len()]),
    Gvret([Option<usize>; GVRET.len()]),
    SaleaeBytes([Option<usize>; SALEAE_BYTES.len()]),
    SaleaeTable([Option<usize>; SALEAE_TABLE.len()]),
    Named(NamedTable),
}

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct CsvReader {
    dialect: Option<CsvDialect>,
    link: String,
    bytes: Vec<u8>,
}

impl LineFormat for CsvReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let text = gbk::decode(line);
        let line = text.trim_start_matches('\u{FEFF}').trim();
        match self.dialect {
            _ if line.is_empty() => Ok(ParsedLine::Nothing),
            // Loggers describe themselves above the names.
            None if line.starts_with('#') => Ok(ParsedLine::Nothing),
            None => {
                self.dialect = Some(CsvDialect::from_header(line)?);
                Ok(ParsedLine::Nothing)
            }
            Some(CsvDialect::PythonCan(places)) => self.parse_python_can(select(line, places)),
            Some(CsvDialect::Gvret(places)) => self.parse_gvret(line, places),
            Some(CsvDialect::SaleaeBytes(places)) => {
                let [time, value] = select(line, places);
                self.parse_byte("uart", time, value)
            }
            Some(CsvDialect::SaleaeTable(places)) => {
                let [name, kind, time, data] = select(line, places);
                match kind {
                    "data" => self.parse_byte(name, time, data),
                    _ => Ok(ParsedLine::Skipped("rows of other kinds")),
                }
            }
            Some(CsvDialect::Named(table)) => {
                let row = table.parse_row(line, &mut self.bytes)?;
                Ok(ParsedLine::Record(row.with_bytes(&self.bytes)))
            }
        }
    }
}

impl CsvDialect {
    fn from_header(line: &str) -> Result<Self, ReadError> {
        let lower = line.to_ascii_lowercase();
        let python_can = locate(&lower, PYTHON_CAN);
        if let [Some(_), Some(_), .., Some(_), Some(_)] = python_can {
            return Ok(Self::PythonCan(python_can));
        }
        let gvret = locate(&lower, GVRET);
        if let [Some(_), Some(_), Some(_), _, Some(_), Some(_)] = gvret {
            return Ok(Self::Gvret(gvret));
        }
        let bytes = locate(&lower, SALEAE_BYTES);
        if let [Some(_), Some(_)] = bytes {
            return Ok(Self::SaleaeBytes(bytes));
        }
        let table = locate(&lower, SALEAE_TABLE);
        if let [Some(_), Some(_), Some(_), Some(_)] = table {
            return Ok(Self::SaleaeTable(table));
        }
        let named = NamedTable::from_header(line).map(Self::Named);
        named.ok_or(ReadError("the first line names no columns with the identifier and the data"))
    }
}

/// The places of columns in a first line.
fn locate<const N: usize>(header: &str, names: [&str; N]) -> [Option<usize>; N] {
    names.map(|name| header.split(',').position(|word| unquoted(word) == name))
}

/// The words of a line in these places.
fn select<const N: usize>(line: &str, places: [Option<usize>; N]) -> [&str; N] {
    places.map(|place| place.and_then(|at| line.split(',').nth(at)).map_or("", unquoted))
}

fn unquoted(word: &str) -> &str {
    word.trim().trim_matches('"').trim()
}

impl CsvReader {
    fn parse_python_can(
        &mut self,
        [time, id, extended, remote, error, dlc, data]: [&str; PYTHON_CAN.len()],
    ) -> Result<ParsedLine<'_>, ReadError> {
        let time = Timestamp::parse(time.as_bytes()).ok_or(ReadError("expected seconds"))?;
        let id = parse_id(id)?;
        let (extended, remote) = (parse_bool(extended), parse_bool(remote));
        let dlc = dlc.parse::<u8>().map_err(|_| ReadError("expected a length"))?;
        self.bytes.clear();
        BASE64
            .decode_vec(data, &mut self.bytes)
            .map_err(|_| ReadError("the data is not base 64"))?;
        let error = parse_bool(error);
        let shape = build_python_can_frame(id, extended, remote, error, dlc, &mut self.bytes)?;
        let data = shape.with_bytes(&self.bytes);
        let (time, link) = (Some(time), "can0");
        Ok(ParsedLine::Record(Record { time, link, direction: None, data, offset: 0 }))
    }

    fn parse_gvret(
        &mut self,
        line: &str,
        places: [Option<usize>; GVRET.len()],
    ) -> Result<ParsedLine<'_>, ReadError> {
        let [time, id, extended, direction, bus, length] = select(line, places);
        let micros: u64 = time.parse().map_err(|_| ReadError("expected microseconds"))?;
        let ns = micros.checked_mul(1000).ok_or(ReadError("the time is too great"))?;
        let id = parse_id(id)?;
        let bus: u32 = bus.parse().map_err(|_| ReadError("expected the number of a bus"))?;
        let length = length.parse::<u8>().map_err(|_| ReadError("expected a length"))?;
        let direction = match direction {
            "Tx" => Some(Direction::ToDrive),
            "Rx" => Some(Direction::ToHost),
            _ => None,
        };
        let first = places[GVRET.len() - 1].map_or(0, |at| at + 1);
        self.bytes.clear();
        for word in line.split(',').skip(first).take(usize::from(length)).map(unquoted) {
            let byte = u8::from_str_radix(word, 16).map_err(|_| ReadError("expected bytes"))?;
            self.bytes.push(byte);
        }
        let shape = build_frame(id, parse_bool(extended), false, length, &mut self.bytes)?;
        self.link.clear();
        let _ = std::fmt::Write::write_fmt(&mut self.link, format_args!("can{bus}"));
        let data = shape.with_bytes(&self.bytes);
        let (time, link) = (Some(Timestamp(ns)), &*self.link);
        Ok(ParsedLine::Record(Record { time, link, direction, data, offset: 0 }))
    }

    /// A byte of a UART.
    fn parse_byte(
        &mut self,
        name: &str,
        time: &str,
        value: &str,
    ) -> Result<ParsedLine<'_>, ReadError> {
        let time = parse_seconds(time).ok_or(ReadError("expected seconds"))?;
        let digits = value.strip_prefix("0x").filter(|digits| digits.len() <= 2);
        let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        let byte = byte.ok_or(ReadError("expected a byte such as 0x1F: export in hexadecimal"))?;
        self.bytes.clear();
        self.bytes.push(byte);
        self.link.clear();
        let (name, direction) = split_analyzer(name);
        self.link.extend(name.chars().map(|c| if c.is_whitespace() { '_' } else { c }));
        let (time, link, data) = (Some(time), &*self.link, RecordData::Bytes(&self.bytes));
        Ok(ParsedLine::Record(Record { time, link, direction, data, offset: 0 }))
    }
}

/// The link and the direction of an analyzer by its name: `Async Serial [TX]`, `RX`. Two analyzers that differ in this
/// word alone listen to one link.
fn split_analyzer(name: &str) -> (&str, Option<Direction>) {
    let bare = name.trim_end_matches(']');
    let (link, word) = bare.rsplit_once([' ', '[', '_', '-']).unwrap_or(("", bare));
    let direction = match word.to_ascii_uppercase().as_str() {
        "TX" => Direction::ToDrive,
        "RX" => Direction::ToHost,
        _ => return (name, None),
    };
    let link = link.trim_end_matches([' ', '[', '_', '-']);
    (if link.is_empty() { "uart" } else { link }, Some(direction))
}

/// A frame of python-can with these bytes, which are cut to its length.
pub(super) fn build_python_can_frame(
    id: u32,
    extended: bool,
    remote: bool,
    error: bool,
    dlc: u8,
    bytes: &mut Vec<u8>,
) -> Result<CanRecord, ReadError> {
    if !error {
        return build_frame(id, extended, remote, dlc, bytes);
    }
    let frame = classic_frame(0, false, false, 8, bytes);
    let class = if id == 0 { CanErrorFrame::BUS_ERROR } else { id & ID_MASK };
    Ok(CanRecord::Error(CanErrorFrame { class, data: frame.data }))
}

/// A frame with these bytes, which are cut to its length.
fn build_frame(
    id: u32,
    extended: bool,
    remote: bool,
    length: u8,
    bytes: &mut Vec<u8>,
) -> Result<CanRecord, ReadError> {
    if id > if extended { ID_MASK } else { STANDARD_MAX } {
        return Err(ReadError("the identifier is too great"));
    }
    if !remote && bytes.len() < usize::from(length) {
        return Err(ReadError("it has fewer bytes than its length says"));
    }
    bytes.truncate(usize::from(length));
    match usize::from(length) {
        0..=8 => Ok(CanRecord::Frame(classic_frame(id, extended, remote, length, bytes))),
        9..=FD_MAX => Ok(CanRecord::Fd { id, extended, flags: 0 }),
        _ => Err(ReadError("a CAN FD frame has at most 64 bytes")),
    }
}

/// Seconds, which Saleae may write with an exponent.
fn parse_seconds(text: &str) -> Option<Timestamp> {
    Timestamp::parse(text.as_bytes()).or_else(|| {
        let ns = (text.parse::<f64>().ok()? * 1e9).round();
        (0.0..9.2e18).contains(&ns).then_some(Timestamp(ns as u64))
    })
}

fn parse_id(text: &str) -> Result<u32, ReadError> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    u32::from_str_radix(digits, 16).map_err(|_| ReadError("expected an identifier"))
}

fn parse_bool(word: &str) -> bool {
    matches!(word, "1" | "True" | "true")
}
