//! Properties of a log that its first lines show, and that all lines have in common.

use polepair_core::explain::Direction;
use polepair_core::proto::modbus::rtu;

use super::attached::INDENTATION;
use super::lines::{LineFormat as _, ParsedLine};
use super::text::TextReader;
use crate::record::{Record, RecordData};
use crate::timestamp::Timestamp;

/// Properties of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LogTraits {
    /// Times are differences to the line before.
    pub has_delta_times: bool,
    /// Indented lines of a dump are the answers.
    pub has_answers: bool,
    /// A drive's side wrote the log: the requests are what it received.
    pub is_of_drive: bool,
}

impl LogTraits {
    /// The properties of a log with these first bytes; `None` while there are too few lines to decide.
    pub fn detect(head: &[u8], enough: bool) -> Option<Self> {
        let end =
            if enough { head.len() } else { memchr::memrchr(b'\n', head).map_or(0, |at| at + 1) };
        let whole = &head[..end];
        let has_delta_times = detect_deltas(head, enough)?;
        let has_answers = whole.split(|c| *c == b'\n').any(|line| {
            line.strip_prefix(INDENTATION).is_some_and(|line| line.starts_with(b"00000000 "))
        });
        let found = Self { has_delta_times, has_answers, is_of_drive: false };
        let sides = ModbusSides::count(whole, found);
        // A log of one side has directed lines of a program; a few of them must be seen before it is decided.
        if !enough && (1..DIRECTED_MIN).contains(&sides.directed) {
            return None;
        }
        Some(Self { is_of_drive: sides.reversed > 0 && sides.usual == 0, ..found })
    }

    /// Remarks for a person.
    pub fn notes(self) -> impl Iterator<Item = &'static str> {
        let of_drive = "the log is a drive's own: what it received are the requests";
        let answers = "the indented lines of the dump are the answers";
        let drive = self.is_of_drive.then_some(of_drive);
        drive.into_iter().chain(self.has_answers.then_some(answers))
    }

    /// A record as the host would have written it.
    pub fn orient(self, record: Record<'_>) -> Record<'_> {
        let direction = record.direction.map(|direction| match direction {
            Direction::ToDrive if self.is_of_drive => Direction::ToHost,
            Direction::ToHost if self.is_of_drive => Direction::ToDrive,
            direction => direction,
        });
        Record { direction, ..record }
    }
}

/// Directed lines that are looked at before a growing log is read.
const DIRECTED_MIN: u32 = 4;

/// Modbus frames by their sender, which their length shows.
#[derive(Default)]
struct ModbusSides {
    directed: u32,
    /// Requests of the host and answers of the drive.
    usual: u32,
    /// Requests that were received and answers that were sent.
    reversed: u32,
}

impl ModbusSides {
    fn count(lines: &[u8], head: LogTraits) -> Self {
        let (mut found, mut reader) = (Self::default(), TextReader::new(head));
        for line in lines.split(|c| *c == b'\n') {
            if let Some(record) = reader.take_pending(Some(line)) {
                found.observe(&record);
            }
            if let Ok(ParsedLine::Record(record)) = reader.parse_line(line) {
                found.observe(&record);
            }
            // A log of our own has the directions of the host.
            if found.directed > 0 && !reader.is_tool_log() {
                return Self::default();
            }
        }
        found
    }

    fn observe(&mut self, record: &Record<'_>) {
        let (RecordData::Bytes(bytes), Some(direction)) = (&record.data, record.direction) else {
            return;
        };
        self.directed += 1;
        match modbus_sender(bytes) {
            Some(sender) if sender == direction => self.usual += 1,
            Some(_) => self.reversed += 1,
            None => {}
        }
    }
}

/// The direction of a Modbus frame whose length shows it: a read request has 8 bytes, its answer as many as its third
/// byte counts.
fn modbus_sender(bytes: &[u8]) -> Option<Direction> {
    let pdu_and_unit = match bytes {
        [_, _, 0, 0, high, low, rest @ ..]
            if usize::from(u16::from_be_bytes([*high, *low])) == rest.len() =>
        {
            rest
        }
        _ if rtu::crc_matches(bytes) => bytes.get(..bytes.len().checked_sub(2)?)?,
        _ => return None,
    };
    let ([_, function, count, ..], len) = (pdu_and_unit, pdu_and_unit.len()) else { return None };
    let counted = 3 + usize::from(*count) == len;
    match function {
        1..=4 if len == 6 && !counted => Some(Direction::ToDrive),
        1..=4 if counted && len != 6 => Some(Direction::ToHost),
        15 | 16 if len == 6 => Some(Direction::ToHost),
        15 | 16 if pdu_and_unit.get(6).is_some_and(|n| 7 + usize::from(*n) == len) => {
            Some(Direction::ToDrive)
        }
        _ => None,
    }
}

/// Times in a row, none less than the one before, after which they count as absolute.
const RISES: usize = 16;

/// Returns whether the times of a log are differences: the first is 0, and a later one is less than the one before.
/// `None` while there are too few lines to decide.
fn detect_deltas(head: &[u8], enough: bool) -> Option<bool> {
    let (mut last, mut rises) = (None, 0);
    let whole =
        if enough { head.len() } else { memchr::memrchr(b'\n', head).map_or(0, |at| at + 1) };
    for line in head[..whole].split(|c| *c == b'\n') {
        let line = line.trim_ascii_start();
        let Some(end) = line.iter().position(|c| *c == b')').filter(|_| line.starts_with(b"("))
        else {
            continue;
        };
        let Some(time) = Timestamp::parse(line[1..end].trim_ascii()) else { continue };
        match last {
            // Times that begin with zero may be differences (`candump -td`) or count from the start (`-tz`).
            None if time.0 > 0 => return Some(false),
            None => {}
            Some(last) if time < last => return Some(true),
            Some(last) => rises += usize::from(time > last),
        }
        if rises >= RISES {
            return Some(false);
        }
        last = Some(time);
    }
    // Without a single time there is nothing to wait for.
    (enough || (last.is_none() && whole > 0)).then_some(false)
}
