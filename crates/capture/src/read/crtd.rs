//! CRTD, the text log of the Open Vehicle Monitoring System: `1542473901.020305 1R11 7DF 02 01 0C`. A record
//! type is the number of a bus, R or T, and the bits of the identifier; types that begin with C are comments
//! and events.

use polepair_core::explain::Direction;

use super::ReadError;
use super::lines::{LineFormat, ParsedLine};
use super::words::next_word;
use crate::record::{ID_MASK, Record, RecordData, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct CrtdReader {
    link: String,
}

/// A record type: the bus from 1, whether it was sent, and whether its identifier has 29 bits.
fn parse_kind(word: &str) -> Option<(u32, bool, bool)> {
    let at = word.find(|c: char| !c.is_ascii_digit())?;
    let bus = if at == 0 { 1 } else { word[..at].parse().ok().filter(|n| *n > 0)? };
    let (sent, extended) = match &word[at..] {
        "R11" => (false, false),
        "R29" => (false, true),
        "T11" => (true, false),
        "T29" => (true, true),
        _ => return None,
    };
    Some((bus, sent, extended))
}

/// Returns whether a line is one of such a log.
pub(crate) fn is_line(line: &[u8]) -> bool {
    let Ok(line) = std::str::from_utf8(line) else { return false };
    let mut words = line.split_ascii_whitespace();
    let time = words.next().filter(|word| word.contains('.'));
    let kind = next_word(&mut words);
    let comment = matches!(kind.trim_start_matches(|c: char| c.is_ascii_digit()), "CXX" | "CEV");
    time.is_some_and(|word| Timestamp::parse(word.as_bytes()).is_some())
        && (comment || parse_kind(kind).is_some())
}

impl LineFormat for CrtdReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let line = std::str::from_utf8(line).map_err(|_| ReadError("the line is not text"))?;
        let mut words = line.trim_start_matches('\u{FEFF}').split_ascii_whitespace();
        let Some(time) = words.next() else { return Ok(ParsedLine::Nothing) };
        let time = Timestamp::parse(time.as_bytes()).ok_or(ReadError("expected seconds"))?;
        let kind = words.next().ok_or(ReadError("no record type follows the time"))?;
        let Some((bus, sent, extended)) = parse_kind(kind) else {
            return Ok(ParsedLine::Skipped("comments and events"));
        };
        let id = words.next().and_then(|word| u32::from_str_radix(word, 16).ok());
        let id = id.ok_or(ReadError("expected an identifier"))?;
        if id > if extended { ID_MASK } else { STANDARD_MAX } {
            return Err(ReadError("the identifier is too great"));
        }
        let (mut bytes, mut length) = ([0; 8], 0);
        for word in words {
            let byte = bytes.get_mut(length).ok_or(ReadError("a CAN frame has at most 8 bytes"))?;
            *byte = u8::from_str_radix(word, 16).map_err(|_| ReadError("expected bytes"))?;
            length += 1;
        }
        self.link.clear();
        let _ = std::fmt::Write::write_fmt(&mut self.link, format_args!("can{}", bus - 1));
        let direction = if sent { Direction::ToDrive } else { Direction::ToHost };
        let frame = classic_frame(id, extended, false, length as u8, &bytes);
        Ok(ParsedLine::Record(Record {
            time: Some(time),
            link: &self.link,
            direction: Some(direction),
            data: RecordData::Frame(frame),
            offset: 0,
        }))
    }
}
