//! The text log of BUSMASTER: lines of stars with the settings, then a line a frame, such as
//! `12:34:56:7890 Rx 1 0x581 s 8 43 41 60 00 37 02 00 00`.

use polepair_core::explain::Direction;

use super::ReadError;
use super::lines::{LineFormat, ParsedLine};
use super::words::next_word;
use crate::date;
use crate::record::{ID_MASK, Record, RecordData, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

const DAY_NS: u64 = 86_400_000_000_000;
const START: &str = "***START DATE AND TIME ";

/// Origin of the times of lines.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
enum TimeBase {
    /// Midnight.
    #[default]
    System,
    /// The start of the log.
    Absolute,
    /// The line before.
    Relative,
}

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct BusmasterReader {
    base: TimeBase,
    decimal: bool,
    /// Midnight before the log began, and its start.
    midnight: u64,
    start_time: u64,
    last: u64,
    link: String,
}

impl LineFormat for BusmasterReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let line = std::str::from_utf8(line).map_err(|_| ReadError("the line is not text"))?;
        let line = line.trim_start_matches('\u{FEFF}').trim();
        if line.is_empty() || line.trim_start_matches('-').starts_with("***") {
            self.parse_header(line);
            return Ok(ParsedLine::Nothing);
        }
        let mut words = line.split_ascii_whitespace();
        let clock = words.next().and_then(|word| parse_clock(word, self.base));
        let time = clock.ok_or(ReadError("expected a time"))?;
        let direction = match next_word(&mut words) {
            "Rx" => Direction::ToHost,
            "Tx" => Direction::ToDrive,
            _ => return Ok(ParsedLine::Skipped("events that are not CAN frames")),
        };
        // Files that SavvyCAN writes may count channels from 0.
        let channel = words.next().and_then(|word| word.parse::<u32>().ok());
        let channel = channel.ok_or(ReadError("expected a channel after the direction"))?;
        let frame = self.parse_frame(&mut words)?;
        let time = self.place(time);
        self.link.clear();
        let _ = std::fmt::Write::write_fmt(
            &mut self.link,
            format_args!("can{}", channel.saturating_sub(1)),
        );
        Ok(ParsedLine::Record(Record {
            time: Some(time),
            link: &self.link,
            direction: Some(direction),
            data: frame,
            offset: 0,
        }))
    }
}

impl BusmasterReader {
    fn parse_header(&mut self, line: &str) {
        match line {
            "***DEC***" => self.decimal = true,
            "***HEX***" => self.decimal = false,
            "***SYSTEM MODE***" => self.base = TimeBase::System,
            "***ABSOLUTE MODE***" => self.base = TimeBase::Absolute,
            "***RELATIVE MODE***" => self.base = TimeBase::Relative,
            _ => {
                let start = line.strip_prefix(START).map(|text| text.trim_end_matches('*'));
                if let Some((midnight, time)) = start.and_then(parse_start) {
                    (self.midnight, self.start_time, self.last) = (midnight, time, time);
                }
            }
        }
    }

    /// The moment of a line.
    fn place(&mut self, since: u64) -> Timestamp {
        self.last = match self.base {
            TimeBase::Absolute => self.start_time.saturating_add(since),
            TimeBase::Relative => self.last.saturating_add(since),
            TimeBase::System => {
                let mut time = self.midnight.saturating_add(since);
                // The clock of the day begins anew at midnight.
                while self.midnight > 0 && time.saturating_add(DAY_NS / 2) < self.last {
                    self.midnight += DAY_NS;
                    time += DAY_NS;
                }
                time
            }
        };
        Timestamp(self.last)
    }

    fn parse_frame<'w>(
        &self,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<RecordData<'static>, ReadError> {
        let radix = if self.decimal { 10 } else { 16 };
        let id = next_word(words);
        let digits = id.strip_prefix("0x").unwrap_or(id);
        let id = u32::from_str_radix(digits, radix)
            .map_err(|_| ReadError("expected an identifier; names of messages are not read"))?;
        let kind = next_word(words);
        let (extended, remote) = match kind {
            "s" => (false, false),
            "x" => (true, false),
            "sr" => (false, true),
            "xr" => (true, true),
            _ => return Err(ReadError("expected s, x, sr or xr after the identifier")),
        };
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(ReadError("the identifier is too great"));
        }
        let length = words.next().and_then(|word| word.parse::<u8>().ok());
        let length = length.filter(|n| *n <= 8).ok_or(ReadError("expected a length of 0 to 8"))?;
        let mut bytes = [0; 8];
        for byte in bytes.iter_mut().take(if remote { 0 } else { usize::from(length) }) {
            let word = words.next().ok_or(ReadError("it has fewer bytes than its length says"))?;
            *byte = u8::from_str_radix(word, radix).map_err(|_| ReadError("expected bytes"))?;
        }
        Ok(RecordData::Frame(classic_frame(id, extended, remote, length, &bytes)))
    }
}

/// Hours, minutes, seconds and tenths of milliseconds, in nanoseconds: `12:34:56:7890`. A time of the day with three
/// digits has milliseconds, as SavvyCAN writes it; BUSMASTER itself always writes four.
fn parse_clock(word: &str, base: TimeBase) -> Option<u64> {
    let mut parts = word.split(':');
    let mut next = || parts.next()?.parse::<u64>().ok();
    let (hours, minutes, seconds, fraction) = (next()?, next()?, next()?, next()?);
    let minutes = hours.checked_mul(60)?.checked_add(minutes)?;
    let seconds = minutes.checked_mul(60)?.checked_add(seconds)?;
    let is_ms = base == TimeBase::System && word.rsplit(':').next().is_some_and(|d| d.len() == 3);
    let unit_ns = if is_ms { 1_000_000 } else { 100_000 };
    seconds.checked_mul(1_000_000_000)?.checked_add(fraction.checked_mul(unit_ns)?)
}

/// Day, month, year, hour, minute, second and milliseconds: `27:11:2026 12:34:56:123`. Returns the midnight
/// before it, and the moment.
fn parse_start(text: &str) -> Option<(u64, u64)> {
    let (day, clock) = text.trim().split_once(' ')?;
    let [day, month, year] = split_numbers(day)?[..] else { return None };
    let [hour, minute, second, ms] = split_numbers(clock)?[..] else { return None };
    let midnight = date::from_calendar([year, month, day], [0; 3], 0)?.0;
    let ns = u32::from(ms.min(999)) * 1_000_000;
    Some((midnight, date::from_calendar([year, month, day], [hour, minute, second], ns)?.0))
}

fn split_numbers(text: &str) -> Option<Vec<u16>> {
    text.split([':', '.']).map(|part| part.parse().ok()).collect()
}
