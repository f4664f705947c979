//! ASC, the text log of Vector's tools: a date, the base of the numbers, a line an event.

use polepair_core::explain::Direction;

use super::Bad;
use super::lines::Line;
use crate::date;
use crate::record::{ErrorFrame, ID_MASK, Record, STANDARD_MAX, Shape, classic, fd_length};
use crate::stamp::Stamp;

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct Asc {
    begin: Stamp,
    decimal: bool,
    /// Times count from the line before.
    relative: bool,
    last: u64,
    link: String,
    bytes: Vec<u8>,
}

impl Line for Asc {
    fn line<'a>(&'a mut self, line: &'a [u8]) -> Result<Option<Record<'a>>, Bad> {
        let line = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line).trim_ascii();
        if !line.first().is_some_and(|c| c.is_ascii_digit() || *c == b'-') {
            self.header(&String::from_utf8_lossy(line));
            return Ok(None);
        }
        let line = std::str::from_utf8(line).map_err(|_| Bad("the line is not text"))?;
        let mut words = line.split_ascii_whitespace();
        let time = words.next().and_then(|word| self.time(word)).ok_or(Bad("expected a time"))?;
        let Some(data) = self.event(&mut words)? else { return Ok(None) };
        let (channel, direction, shape) = data;
        self.link.clear();
        // Vector counts channels from 1, Linux its interfaces from 0.
        let _ = std::fmt::Write::write_fmt(&mut self.link, format_args!("can{}", channel - 1));
        let data = shape.with(&self.bytes);
        Ok(Some(Record { time: Some(time), link: &self.link, direction, data, at: 0 }))
    }
}

type Event = (u32, Option<Direction>, Shape);

impl Asc {
    fn header(&mut self, line: &str) {
        let lower = line.to_ascii_lowercase();
        if let Some(date) = lower.strip_prefix("date ") {
            self.begin = date::in_words(date).unwrap_or(self.begin);
        } else if lower.starts_with("base ") {
            self.decimal = lower.contains("dec");
            self.relative = lower.contains("relative");
        }
    }

    fn time(&mut self, word: &str) -> Option<Stamp> {
        let since = Stamp::parse(word.as_bytes())?.0;
        self.last = if self.relative { self.last.checked_add(since)? } else { since };
        Some(Stamp(self.begin.0.checked_add(self.last)?))
    }

    /// What follows the time; `None` for what is no frame: statistics, triggers, other buses.
    fn event<'w>(
        &mut self,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<Option<Event>, Bad> {
        let first = words.next().unwrap_or_default();
        if first == "CANFD" {
            return self.fd(words).map(Some);
        }
        let Ok(channel @ 1..) = first.parse::<u32>() else { return Ok(None) };
        let second = words.next().unwrap_or_default();
        if second.eq_ignore_ascii_case("ErrorFrame") {
            let error = ErrorFrame { class: ErrorFrame::BUS_ERROR, ..ErrorFrame::default() };
            return Ok(Some((channel, None, Shape::Error(error))));
        }
        let direction = words.next().unwrap_or_default();
        if !matches!(direction, "Rx" | "Tx" | "TxRq") {
            return Ok(None);
        }
        let (id, extended) = self.id(second)?;
        let remote = match words.next() {
            Some("d") => false,
            Some("r") => true,
            _ => return Err(Bad("expected d or r after the direction")),
        };
        let count = words.next().map_or(Ok(0), |word| self.count(word));
        // A remote request may say no length.
        let count = if remote { count.unwrap_or(0) } else { count? };
        self.bytes.clear();
        if !remote {
            self.bytes(count.min(8), words)?;
        }
        let frame = classic(id, extended, remote, count.min(8) as u8, &self.bytes);
        Ok(Some((channel, way(direction), Shape::Frame(frame))))
    }

    /// `CANFD channel Rx id [name] brs esi code length bytes…`, also for classic frames.
    fn fd<'w>(&mut self, words: &mut impl Iterator<Item = &'w str>) -> Result<Event, Bad> {
        let channel = words.next().and_then(|word| word.parse::<u32>().ok()).filter(|n| *n > 0);
        let channel = channel.ok_or(Bad("expected a channel after CANFD"))?;
        let direction = way(words.next().unwrap_or_default());
        let word = words.next().unwrap_or_default();
        if word.eq_ignore_ascii_case("ErrorFrame") {
            let error = ErrorFrame { class: ErrorFrame::BUS_ERROR, ..ErrorFrame::default() };
            return Ok((channel, direction, Shape::Error(error)));
        }
        let (id, extended) = self.id(word)?;
        // A message's name may stand before the two flags.
        let mut flag = words.next().unwrap_or_default();
        if !matches!(flag, "0" | "1") {
            flag = words.next().unwrap_or_default();
        }
        let esi = words.next().unwrap_or_default();
        let code = words.next().and_then(|word| u8::from_str_radix(word, 16).ok());
        let code = code.ok_or(Bad("expected a length code"))?;
        let count = words.next().map_or(Ok(0), |word| self.count(word))?;
        self.bytes.clear();
        self.bytes(count.min(FD_MAX), words)?;
        if count == 0 && code > 0 {
            // Without bytes, a code says that they were not kept or that it is a remote request.
            let frame = classic(id, extended, true, fd_length(code).min(8), &[]);
            return Ok((channel, direction, Shape::Frame(frame)));
        }
        let flags = u8::from(flag == "1") | u8::from(esi == "1") << 1;
        Ok((channel, direction, Shape::Fd { id, extended, flags }))
    }

    fn id(&self, word: &str) -> Result<(u32, bool), Bad> {
        let digits = word.strip_suffix(['x', 'X']);
        let radix = if self.decimal { 10 } else { 16 };
        let id = u32::from_str_radix(digits.unwrap_or(word), radix)
            .map_err(|_| Bad("expected an identifier; names of messages are not read"))?;
        let extended = digits.is_some();
        let limit = if extended { ID_MASK } else { STANDARD_MAX };
        if id > limit { Err(Bad("the identifier is too great")) } else { Ok((id, extended)) }
    }

    /// A length, which is hexadecimal as the other numbers are.
    fn count(&self, word: &str) -> Result<usize, Bad> {
        let radix = if self.decimal || word.len() > 1 { 10 } else { 16 };
        usize::from_str_radix(word, radix).map_err(|_| Bad("expected a length"))
    }

    fn bytes<'w>(
        &mut self,
        count: usize,
        words: &mut impl Iterator<Item = &'w str>,
    ) -> Result<(), Bad> {
        let radix = if self.decimal { 10 } else { 16 };
        for _ in 0..count {
            let word = words.next().ok_or(Bad("it has fewer bytes than its length says"))?;
            let byte = u8::from_str_radix(word, radix).map_err(|_| Bad("expected bytes"))?;
            self.bytes.push(byte);
        }
        Ok(())
    }
}

fn way(word: &str) -> Option<Direction> {
    match word {
        "Rx" => Some(Direction::ToHost),
        "Tx" => Some(Direction::ToDrive),
        _ => None,
    }
}
