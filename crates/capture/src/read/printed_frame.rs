//! CAN frames in lines of other programs: python-can's messages, columns of an identifier, a length and bytes, names
//! before each number, and the ASCII protocol of serial CAN adapters (slcan).

use polepair_core::explain::Direction;

use super::line_time::split_time;
use super::marked_line::split_direction;
use super::text::RawLine;
use super::words::parse_hex_digit;
use crate::record::{CanErrorFrame, CanRecord, ID_MASK, NO_LINK, STANDARD_MAX, classic_frame};
use crate::timestamp::Timestamp;

/// Bytes of the longest CAN FD frame.
const FD_MAX: u8 = 64;
/// Flag of an extended identifier in numbers of Linux.
const EXTENDED_BIT: u32 = 0x8000_0000;
/// Milliseconds after which the times of serial CAN adapters begin again.
pub(super) const MINUTE_MS: u32 = 60_000;
/// Columns before an identifier.
const COLUMNS_MAX: usize = 6;
/// Names of the channels that other programs number.
pub(super) const CHANNELS: [&str; 10] =
    ["can0", "can1", "can2", "can3", "can4", "can5", "can6", "can7", "can8", "can9"];

/// A message as python-can prints it: `Timestamp: 1.5  ID: 0601  S Rx  DL: 8  40 41 …  Channel: can0`.
pub(super) fn parse_python_can<'a>(text: &'a str, bytes: &mut Vec<u8>) -> Option<RawLine<'a>> {
    let begin = text.find("Timestamp:")?;
    let mut words = text[begin..].split_ascii_whitespace().peekable();
    words.next();
    let time = Timestamp::parse(words.next()?.as_bytes())?;
    words.next().filter(|word| *word == "ID:")?;
    let id = u32::from_str_radix(words.next()?, 16).ok()?;
    let (mut extended, mut remote, mut direction) = (false, false, None);
    let (mut is_error, mut fd, mut flags) = (false, false, 0);
    loop {
        match words.next()? {
            "X" => extended = true,
            "R" => remote = true,
            "Rx" => direction = Some(Direction::ToHost),
            "Tx" => direction = Some(Direction::ToDrive),
            "E" => is_error = true,
            "F" => fd = true,
            "BS" => flags |= 1,
            "EI" => flags |= 2,
            "DL:" | "DLC:" => break,
            _ => {}
        }
    }
    let max = if fd { FD_MAX } else { 8 };
    let length: u8 = words.next()?.parse().ok().filter(|length| *length <= max)?;
    bytes.clear();
    for _ in 0..if remote { 0 } else { length } {
        let word = words.next().filter(|word| word.len() == 2)?;
        bytes.push(u8::from_str_radix(word, 16).ok()?);
    }
    let link = text.rsplit_once("Channel:").map_or(NO_LINK, |(_, name)| name.trim());
    let link = if link.is_empty() { NO_LINK } else { link };
    // A longer number in that column is not an identifier.
    if id > if extended { ID_MASK } else { STANDARD_MAX } {
        return None;
    }
    let record = match () {
        () if is_error => {
            let class = if id == 0 { CanErrorFrame::BUS_ERROR } else { id };
            let data = classic_frame(0, false, false, 8, bytes).data;
            CanRecord::Error(CanErrorFrame { class, data })
        }
        () if fd => CanRecord::Fd { id, extended, flags },
        () => CanRecord::Frame(classic_frame(id, extended, remote, length, bytes)),
    };
    let direction = direction.filter(|_| !is_error);
    Some(RawLine { time: Some(time), link, direction, can: Some(record) })
}

/// A frame that a line holds, without the data's place.
#[derive(Debug, Default)]
pub(super) struct PrintedFrame<'t> {
    pub time: Option<Timestamp>,
    pub link: Option<&'t str>,
    pub direction: Option<Direction>,
    /// The time of a serial CAN adapter, which begins again each minute.
    pub minute_ms: Option<u32>,
    id: u32,
    extended: bool,
    remote: bool,
    len: u8,
    bytes: [u8; 8],
}

impl<'t> PrintedFrame<'t> {
    pub fn record(&self) -> CanRecord {
        let bytes = &self.bytes[..usize::from(self.len)];
        CanRecord::Frame(classic_frame(self.id, self.extended, self.remote, self.len, bytes))
    }

    /// Parses a line in any of these forms but python-can's. `None` where it has none of them.
    pub fn parse(text: &'t str) -> Option<Self> {
        Self::parse_named(text).or_else(|| Self::parse_columns(text)).or_else(|| {
            let (time, rest) = split_time(text).map_or((None, text), |(t, rest)| (Some(t), rest));
            Some(Self { time, ..Self::parse_slcan(rest)? })
        })
    }

    /// `Standard ID: 0x601  DLC: 8  Data: 0x40 0x41 …`, as libraries for Arduino print it.
    fn parse_named(text: &'t str) -> Option<Self> {
        let (time, rest) = split_time(text).map_or((None, text), |(t, rest)| (Some(t), rest));
        let lower = rest.to_ascii_lowercase();
        let (id, after_id) = named_word(&lower, &["id"])?;
        let (id, extended) = parse_id(id)?;
        let (length, after_length) = named_word(after_id, &["dlc", "dl", "len", "length"])?;
        let length: u8 = length.parse().ok().filter(|length| *length <= 8)?;
        let mut found = Self { time, id, len: length, ..Self::default() };
        found.extended = extended || lower.contains("extended");
        found.remote = lower.contains("remote");
        found.direction = split_direction(rest).map(|(direction, _)| direction);
        if !found.remote && length > 0 {
            let (_, data) = split_name(after_length, &["data", "bytes", "payload"])?;
            let mut words = data.split([' ', ',', '\t']).filter(|word| !word.is_empty());
            for byte in &mut found.bytes[..usize::from(length)] {
                *byte = parse_byte(words.next()?.trim_matches(['[', ']']))?;
            }
            words.next().is_none_or(|word| !is_byte(word)).then_some(())?;
        }
        Some(found)
    }

    /// An identifier, a length, and just as many bytes, with columns before and after them that are known: times,
    /// numbers, channels and directions. Kvaser CanKing, CANHacker and libraries for Arduino print such lines.
    fn parse_columns(text: &'t str) -> Option<Self> {
        let (time, rest) = split_time(text).map_or((None, text), |(t, rest)| (Some(t), rest));
        let mut found = Self { time, ..Self::default() };
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let at = words.iter().take(COLUMNS_MAX).position(|word| parse_id(word).is_some())?;
        words[..at].iter().all(|word| found.take_column_before(word)).then_some(())?;
        (found.id, found.extended) = parse_id(words[at])?;
        let (mut length, mut rest) = words[at + 1..].split_first()?;
        if found.take_flag(length) {
            (length, rest) = rest.split_first()?;
        }
        let digits = length.trim_matches(['[', ']']);
        found.len = digits.parse().ok().filter(|len| *len <= 8 && digits.len() == 1)?;
        let (data, after) =
            rest.split_at_checked(if found.remote { 0 } else { found.len.into() })?;
        for (byte, word) in found.bytes.iter_mut().zip(data) {
            *byte = parse_byte(word)?;
        }
        for word in after {
            if word.starts_with(['\'', '"', '|', ';', '#', '/']) {
                break;
            }
            found.take_column_after(word)?;
        }
        Some(found)
    }

    fn take_column_before(&mut self, word: &'t str) -> bool {
        let digits = word.strip_prefix("CH").or_else(|| word.strip_prefix("ch")).unwrap_or(word);
        if let Ok(channel) = digits.parse::<usize>()
            && let Some(name) = CHANNELS.get(channel)
        {
            self.link = Some(name);
            return true;
        }
        if let Some((direction, "" | ":")) = split_direction(word) {
            self.direction = Some(direction);
            return true;
        }
        if self.time.is_none()
            && let Some((time, "")) = split_time(word)
        {
            self.time = Some(time);
            return true;
        }
        let is_link = word.starts_with("can") || word.starts_with("vcan");
        if is_link {
            self.link = Some(word);
        }
        // `17)` counts the lines.
        let number = word.strip_suffix(')').is_some_and(|n| n.bytes().all(|c| c.is_ascii_digit()));
        is_link || number || word == "-"
    }

    /// A flag between the identifier and the length.
    fn take_flag(&mut self, word: &str) -> bool {
        match word {
            "X" | "x" | "Ext" | "EXT" => self.extended = true,
            "R" | "r" | "RTR" => self.remote = true,
            "S" | "s" | "Std" | "STD" | "d" | "D" => {}
            _ => match split_direction(word) {
                Some((direction, "")) => self.direction = Some(direction),
                _ => return false,
            },
        }
        true
    }

    fn take_column_after(&mut self, word: &str) -> Option<()> {
        match word {
            "R" => self.direction = Some(Direction::ToHost),
            "T" => self.direction = Some(Direction::ToDrive),
            _ if word.contains('.') && self.time.is_none() => {
                self.time = Some(Timestamp::parse(word.as_bytes())?);
            }
            _ => {
                self.direction = Some(split_direction(word).filter(|(_, rest)| rest.is_empty())?.0);
            }
        }
        Some(())
    }

    /// `t6018404160…`: the kind, the identifier, the length, the bytes, and on some adapters the milliseconds of a
    /// minute.
    fn parse_slcan(line: &'t str) -> Option<Self> {
        let mut digits = line.bytes();
        let kind = digits.next()?;
        let (id_digits, remote) = match kind {
            b't' => (3, false),
            b'T' => (8, false),
            b'r' => (3, true),
            b'R' => (8, true),
            _ => return None,
        };
        let mut number = |count: usize| {
            (0..count).try_fold(0_u32, |sum, _| {
                Some(sum << 4 | u32::from(parse_hex_digit(digits.next()?).ok()?))
            })
        };
        let extended = id_digits == 8;
        let id = number(id_digits)?;
        let len = number(1).filter(|len| *len <= 8)? as u8;
        let mut found = Self { id, extended, remote, len, ..Self::default() };
        if !remote {
            for byte in &mut found.bytes[..usize::from(len)] {
                *byte = number(2)? as u8;
            }
        }
        let end = 2 + id_digits + if remote { 0 } else { 2 * usize::from(len) };
        if line.len() > end {
            let ms = number(4).filter(|ms| line.len() == end + 4 && *ms < MINUTE_MS)?;
            found.minute_ms = Some(ms);
        }
        (id <= if extended { ID_MASK } else { STANDARD_MAX }).then_some(found)
    }
}

/// The value behind one of these names, and what follows it.
fn named_word<'t>(text: &'t str, names: &[&str]) -> Option<(&'t str, &'t str)> {
    let (_, value) = split_name(text, names)?;
    let end = value.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(value.len());
    Some(value.split_at(end))
}

/// The text before and after a name with a colon or an equals sign.
fn split_name<'t>(text: &'t str, names: &[&str]) -> Option<(&'t str, &'t str)> {
    names.iter().find_map(|name| {
        let mut from = 0;
        while let Some(at) = text[from..].find(name).map(|at| at + from) {
            let after = text[at + name.len()..].trim_start();
            let is_word = !text[..at].ends_with(|c: char| c.is_alphanumeric());
            if let Some(value) = after.strip_prefix([':', '=']).filter(|_| is_word) {
                return Some((&text[..at], value.trim_start()));
            }
            from = at + name.len();
        }
        None
    })
}

/// An identifier, and whether it is extended. `None` where its base is not certain: a number of four decimal digits
/// could be either.
pub(super) fn parse_id(word: &str) -> Option<(u32, bool)> {
    let prefixed = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X"));
    let suffixed = word.strip_suffix(['h', 'H']);
    let digits = prefixed.or(suffixed).unwrap_or(word);
    if digits.is_empty() || !digits.bytes().all(|c| c.is_ascii_hexdigit()) {
        return None;
    }
    let is_decimal = digits.bytes().all(|c| c.is_ascii_digit());
    let is_certain = prefixed.or(suffixed).is_some()
        || matches!(digits.len(), 3 | 8)
        || digits.len() > 3 && (digits.starts_with('0') || !is_decimal);
    let id = u32::from_str_radix(digits, 16).ok().filter(|_| is_certain && digits.len() <= 8)?;
    let flagged = id & EXTENDED_BIT != 0;
    let id = id & !EXTENDED_BIT;
    (id <= ID_MASK).then_some((id, flagged || id > STANDARD_MAX))
}

/// A byte of one or two hexadecimal digits.
pub(super) fn parse_byte(word: &str) -> Option<u8> {
    let digits = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X")).unwrap_or(word);
    u8::from_str_radix(digits, 16).ok().filter(|_| matches!(digits.len(), 1 | 2))
}

fn is_byte(word: &str) -> bool {
    parse_byte(word).is_some()
}

#[cfg(test)]
mod tests {
    use super::PrintedFrame;
    use crate::record::CanRecord;

    fn read(line: &str) -> String {
        let Some(found) = PrintedFrame::parse(line) else { return "nothing".to_owned() };
        let CanRecord::Frame(frame) = found.record() else { panic!("a frame") };
        let remote = if frame.remote { "R" } else { "" };
        let extended = if frame.extended { "x" } else { "" };
        let direction = found.direction.map_or_else(String::new, |it| format!(" {it:?}"));
        let time = found.time.map_or_else(String::new, |time| format!(" {time}"));
        let link = found.link.unwrap_or("-");
        let (id, bytes) = (frame.id, frame.bytes());
        format!("{link} {id:X}{extended}{remote} {bytes:02X?}{direction}{time}")
    }

    #[test]
    fn frames_in_the_lines_of_other_programs() {
        for (line, expected) in [
            (
                " 0    00000601         3  40  41  60     154.266550 R",
                "can0 601 [40, 41, 60] ToHost 154.26655",
            ),
            (
                " 1    0400A05E  X      2  34  12         1.500000 T",
                "can1 400A05Ex [34, 12] ToDrive 1.5",
            ),
            ("601 3 40 41 0", "- 601 [40, 41, 00]"),
            ("8400A05E 2 34 12", "- 400A05Ex [34, 12]"),
            ("12.345   601  3  40 41 60", "- 601 [40, 41, 60] 12.345"),
            ("1) 12:34:56.5 Rx 0601 3 40 41 60", "- 601 [40, 41, 60] ToHost 45296.5"),
            ("17) Rx 0601 3 40 41 60", "- 601 [40, 41, 60] ToHost"),
            ("CH1 Tx 0x601 Std 2 40 41", "can1 601 [40, 41] ToDrive"),
            ("Standard ID: 0x601       DLC: 3  Data: 0x40 0x41 0x60", "- 601 [40, 41, 60]"),
            ("Extended ID: 0x0400A05E  DLC: 2  Data: 0x34 0x12", "- 400A05Ex [34, 12]"),
            ("Standard ID: 0x601       DLC: 2  REMOTE REQUEST FRAME", "- 601R [00, 00]"),
            ("12.5 RX id=0x581 len=2 data=[4B,41]", "- 581 [4B, 41] ToHost 12.5"),
            ("t60134041AB", "- 601 [40, 41, AB]"),
            ("t60134041AB1388", "- 601 [40, 41, AB]"),
            ("T0400A05E23412", "- 400A05Ex [34, 12]"),
            ("r6018", "- 601R [00, 00, 00, 00, 00, 00, 00, 00]"),
            // A length that does not agree, an identifier in an unknown base, a time beyond a minute.
            ("601 3 40 41", "nothing"),
            ("601 2 40 41 60", "nothing"),
            ("1537 2 40 41", "nothing"),
            ("Standard ID: 0x601  DLC: 2  Data: 0x40 0x41 0x60", "nothing"),
            ("t60134041ABFFFF", "nothing"),
            ("t60194041AB", "nothing"),
        ] {
            assert_eq!(read(line), expected.trim_end(), "{line}");
        }
    }
}
