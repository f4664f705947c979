//! ASC, the text log of Vector's tools: a date, the base of the numbers, a line an event.

use polepair_core::explain::Direction;

use super::ReadError;
use super::lines::{LineFormat, ParsedLine};
use super::words::next_word;
use crate::date;
use crate::record::{
    CanErrorFrame, CanRecord, ID_MASK, Record, STANDARD_MAX, classic_frame, fd_len_from_dlc,
};
use crate::timestamp::Timestamp;

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct AscReader {
    start_time: Timestamp,
    decimal: bool,
    /// Times count from the line before.
    relative: bool,
    last_offset: u64,
    link: String,
    bytes: Vec<u8>,
}

impl LineFormat for AscReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let line = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line).trim_ascii();
        if !line.first().is_some_and(|c| c.is_ascii_digit() || *c == b'-') {
            self.parse_header(&String::from_utf8_lossy(line));
            return Ok(ParsedLine::Nothing);
        }
        let line = std::str::from_utf8(line).map_err(|_| ReadError("the line is not text"))?;
        let mut words = line.split_ascii_whitespace();
        let time = words
            .next()
            .and_then(|word| self.parse_time(word))
            .ok_or(ReadError("expected a time"))?;
        let (channel, direction, shape) = match self.parse_event(&mut words)? {
            AscLine::Frame(event) => event,
            AscLine::Nothing => return Ok(ParsedLine::Nothing),
            AscLine::Skipped(kind) => return Ok(ParsedLine::Skipped(kind)),
        };
        self.link.clear();
        // Vector counts channels from 1, Linux its interfaces from 0.
        let _ = std::fmt::Write::write_fmt(&mut self.link, format_args!("can{}", channel - 1));
        let data = shape.with_bytes(&self.bytes);
        let record = Record { time: Some(time), link: &self.link, direction, data, offset: 0 };
        Ok(ParsedLine::Record(record))
    }
}

type AscEvent = (u32, Option<Direction>, CanRecord);

/// Rest of a line behind the time.
enum AscLine {
    Frame(AscEvent),
    Nothing,
    /// An object that is not read, by its kind.
    Skipped(&'static str),
}

impl AscReader {
    fn parse_header(&mut self, line: &str) {
        let lower = line.to_ascii_lowercase();
        if let Some(date) = lower.strip_prefix("date ") {
            self.start_time = date::parse_verbose(date).unwrap_or(self.start_time);
        } else if lower.starts_with("base ") {
            self.decimal = lower.contains("dec");
            self.relative = lower.contains("relative");
        }
    }

    fn parse_time(&mut self, word: &str) -> Option<Timestamp> {
        let since = Timestamp::parse(word.as_bytes())?.0;
        self.last_offset = if self.relative { self.last_offset.checked_add(since)? } else { since };
        Some(Timestamp(self.start_time.0.checked_add(self.last_offset)?))
    }

    /// Parses what follows the time.
    fn parse_event<'w>(
        &mut self,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<AscLine, ReadError> {
        let first = next_word(words);
        match first {
            "CANFD" => return self.parse_fd(words).map(AscLine::Frame),
            "CAN" => return Ok(parse_status(words)),
            "Start" | "Begin" | "End" => return Ok(AscLine::Nothing),
            _ => {}
        }
        let Ok(channel @ 1..) = first.parse::<u32>() else {
            return Ok(AscLine::Skipped("events that are not CAN frames"));
        };
        let second = next_word(words);
        if second.eq_ignore_ascii_case("ErrorFrame") {
            let error =
                CanErrorFrame { class: CanErrorFrame::BUS_ERROR, ..CanErrorFrame::default() };
            return Ok(AscLine::Frame((channel, None, CanRecord::Error(error))));
        }
        let direction = next_word(words);
        if !matches!(direction, "Rx" | "Tx" | "TxRq") {
            let statistic = second.starts_with("Statistic");
            let kind = if statistic { "bus statistics" } else { "events that are not CAN frames" };
            return Ok(AscLine::Skipped(kind));
        }
        let (id, extended) = self.parse_id(second)?;
        let remote = match words.next() {
            Some("d") => false,
            Some("r") => true,
            _ => return Err(ReadError("expected d or r after the direction")),
        };
        let count = words.next().map_or(Ok(0), |word| self.parse_length(word));
        // A remote request may have no length.
        let count = if remote { count.unwrap_or(0) } else { count? };
        self.bytes.clear();
        if !remote {
            self.parse_bytes(count.min(8), words)?;
        }
        let frame = classic_frame(id, extended, remote, count.min(8) as u8, &self.bytes);
        Ok(AscLine::Frame((channel, parse_direction(direction), CanRecord::Frame(frame))))
    }

    /// `CANFD channel Rx id [name] brs esi code length bytes…`, also for classic frames.
    fn parse_fd<'w>(
        &mut self,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<AscEvent, ReadError> {
        let channel = words.next().and_then(|word| word.parse::<u32>().ok()).filter(|n| *n > 0);
        let channel = channel.ok_or(ReadError("expected a channel after CANFD"))?;
        let direction = parse_direction(next_word(words));
        let word = next_word(words);
        if word.eq_ignore_ascii_case("ErrorFrame") {
            let error =
                CanErrorFrame { class: CanErrorFrame::BUS_ERROR, ..CanErrorFrame::default() };
            return Ok((channel, direction, CanRecord::Error(error)));
        }
        let (id, extended) = self.parse_id(word)?;
        // A message's name may stand before the two flags.
        let mut flag = next_word(words);
        if !matches!(flag, "0" | "1") {
            flag = next_word(words);
        }
        let esi = next_word(words);
        let code = words.next().and_then(|word| u8::from_str_radix(word, 16).ok());
        let code = code.ok_or(ReadError("expected a length code"))?;
        let count = words.next().map_or(Ok(0), |word| self.parse_length(word))?;
        self.bytes.clear();
        self.parse_bytes(count.min(FD_MAX), words)?;
        if count == 0 && code > 0 {
            // A code without bytes means that they were not stored or that it is a remote request.
            let frame = classic_frame(id, extended, true, fd_len_from_dlc(code).min(8), &[]);
            return Ok((channel, direction, CanRecord::Frame(frame)));
        }
        let flags = u8::from(flag == "1") | u8::from(esi == "1") << 1;
        Ok((channel, direction, CanRecord::Fd { id, extended, flags }))
    }

    fn parse_id(&self, word: &str) -> Result<(u32, bool), ReadError> {
        let digits = word.strip_suffix(['x', 'X']);
        let radix = if self.decimal { 10 } else { 16 };
        let id = u32::from_str_radix(digits.unwrap_or(word), radix)
            .map_err(|_| ReadError("expected an identifier; names of messages are not read"))?;
        let extended = digits.is_some();
        let limit = if extended { ID_MASK } else { STANDARD_MAX };
        if id > limit { Err(ReadError("the identifier is too great")) } else { Ok((id, extended)) }
    }

    /// A length, which is hexadecimal as the other numbers are.
    fn parse_length(&self, word: &str) -> Result<usize, ReadError> {
        let radix = if self.decimal || word.len() > 1 { 10 } else { 16 };
        usize::from_str_radix(word, radix).map_err(|_| ReadError("expected a length"))
    }

    fn parse_bytes<'w>(
        &mut self,
        count: usize,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<(), ReadError> {
        let radix = if self.decimal { 10 } else { 16 };
        for _ in 0..count {
            let word = words.next().ok_or(ReadError("it has fewer bytes than its length says"))?;
            let byte = u8::from_str_radix(word, radix).map_err(|_| ReadError("expected bytes"))?;
            self.bytes.push(byte);
        }
        Ok(())
    }
}

fn parse_direction(word: &str) -> Option<Direction> {
    match word {
        "Rx" => Some(Direction::ToHost),
        "Tx" => Some(Direction::ToDrive),
        _ => None,
    }
}

/// `1 Status:chip status error passive - TxErr: 132 RxErr: 0`, behind the word CAN.
fn parse_status<'w>(words: &mut impl Iterator<Item = &'w str>) -> AscLine {
    let channel = words.next().and_then(|word| word.parse::<u32>().ok()).filter(|n| *n > 0);
    let text = words.collect::<Vec<_>>().join(" ");
    let (Some(channel), Some((_, state))) = (channel, text.split_once("Status:chip status "))
    else {
        return AscLine::Skipped("events that are not CAN frames");
    };
    let state = state.to_ascii_lowercase();
    let mut error = match () {
        () if state.starts_with("bus off") => {
            CanErrorFrame { class: CanErrorFrame::BUS_OFF, ..CanErrorFrame::default() }
        }
        () if state.starts_with("error passive") => {
            CanErrorFrame::from_state(CanErrorFrame::PASSIVE)
        }
        () if state.starts_with("warning") => CanErrorFrame::from_state(CanErrorFrame::WARNING),
        () if state.starts_with("error active") => CanErrorFrame::from_state(CanErrorFrame::ACTIVE),
        () => return AscLine::Skipped("events that are not CAN frames"),
    };
    if let (Some(transmit), Some(receive)) =
        (error_counter("txerr:", &state), error_counter("rxerr:", &state))
    {
        error.class |= CanErrorFrame::COUNTERS;
        (error.data[6], error.data[7]) = (transmit, receive);
    }
    AscLine::Frame((channel, None, CanRecord::Error(error)))
}

fn error_counter(name: &str, state: &str) -> Option<u8> {
    let (_, after) = state.split_once(name)?;
    Some(after.split_ascii_whitespace().next()?.parse::<u32>().ok()?.min(255) as u8)
}
