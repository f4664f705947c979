//! Text formats with one record a line: candump's log and screen output, serial logs, data only, and lines
//! that other programs print.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::attached::{AttachedLine, AttachedLines};
use super::digits::StampPrefix;
use super::line_time::split_time;
use super::lines::{LINE_MAX, LineFormat, ParsedLine, UsualData, UsualLine};
use super::log_traits::LogTraits;
use super::printed_frame::MINUTE_MS;
use super::tool_log::{ToolLine, parse_tool_line, unwrap_line};
use super::words::{HEX, split_word};
use super::{ReadError, candump, digits, serial_log};
use crate::record::{CanRecord, NO_LINK, Record, RecordData, STANDARD_MAX};
use crate::timestamp::Timestamp;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct TextReader {
    scratch: Vec<u8>,
    context: LineContext,
    /// The line without colours.
    plain: Vec<u8>,
    head: LogTraits,
    /// The sum of the differences so far.
    elapsed: u64,
    /// A record was read.
    has_records: bool,
    /// A line of another program was read: its other lines are text.
    is_tool_log: bool,
    /// The last record is an error frame, which may be explained on the next line.
    after_error: bool,
    minutes: AdapterClock,
    attached: AttachedLines,
}

/// Times of a serial CAN adapter, which begin again each minute.
#[derive(Debug, Default)]
struct AdapterClock {
    minutes: u64,
    last_ms: u32,
}

impl AdapterClock {
    fn unwrap_time(&mut self, ms: u32) -> Timestamp {
        self.minutes += u64::from(ms < self.last_ms);
        self.last_ms = ms;
        Timestamp((self.minutes * u64::from(MINUTE_MS) + u64::from(ms)) * 1_000_000)
    }
}

/// Lines that hold no data.
const TEXT_LINES: &str = "lines of text";

impl TextReader {
    /// A reader of a log with this head.
    pub(super) fn new(head: LogTraits) -> Self {
        Self { head, ..Self::default() }
    }

    /// Returns whether a line of a serial line is a record by itself, as it is.
    fn has_plain_lines(&self) -> bool {
        !self.head.has_delta_times && !self.head.is_of_drive && !self.attached.has_pending()
    }

    /// Returns whether a line of another program was read.
    pub(super) fn is_tool_log(&self) -> bool {
        self.is_tool_log
    }
}

impl LineFormat for TextReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let after_error = core::mem::take(&mut self.after_error);
        // candump -e explains an error frame on a line of its own.
        if after_error && line.starts_with(b"\t") {
            return Ok(ParsedLine::Nothing);
        }
        if !self.head.has_delta_times
            && let Some((time, direction)) =
                parse_serial_line(line, &mut self.context, &mut self.scratch)
        {
            self.has_records = true;
            let raw = RawLine { time: Some(time), link: self.context.link(), direction, can: None };
            return Ok(ParsedLine::Record(self.head.orient(raw.with_bytes(&self.scratch))));
        }
        // The byte order mark that Windows editors write.
        let line = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line);
        let line = if line.contains(&ESCAPE) {
            strip_colours(line, &mut self.plain);
            &self.plain
        } else {
            line
        };
        match self.attached.parse(line, &mut self.scratch)? {
            None => {}
            Some(AttachedLine::Nothing) => return Ok(ParsedLine::Nothing),
            Some(AttachedLine::Bytes(raw)) => {
                (self.has_records, self.is_tool_log) = (true, true);
                let direction =
                    raw.direction.filter(|_| self.head.has_answers || raw.time.is_some());
                let raw = RawLine { direction, ..raw };
                let record = raw.with_bytes(&self.scratch);
                return Ok(ParsedLine::Record(self.head.orient(record)));
            }
        }
        // Prose between frames is damage in a capture, and normal in a program's log or above the first frame.
        let may_be_text = self.is_tool_log || !self.has_records;
        match parse_any_line(line, &mut self.scratch) {
            Ok(None) => Ok(ParsedLine::Nothing),
            Ok(Some(LogLine::Repeated)) => Ok(ParsedLine::Skipped("repeated lines")),
            Ok(Some(LogLine::InMinute(record, ms))) => {
                (self.has_records, self.is_tool_log) = (true, true);
                let time = Some(self.minutes.unwrap_time(ms));
                Ok(ParsedLine::Record(Record { time, ..record }))
            }
            Ok(Some(LogLine::Record(mut record, is_tool))) => {
                self.has_records = true;
                self.is_tool_log |= is_tool;
                self.after_error = matches!(record.data, RecordData::Error(_));
                if let Some(time) = record.time.filter(|_| self.head.has_delta_times) {
                    self.elapsed = self.elapsed.saturating_add(time.0);
                    record.time = Some(Timestamp(self.elapsed));
                }
                Ok(ParsedLine::Record(self.head.orient(record)))
            }
            Err(_) if may_be_text && is_prose(line) => Ok(ParsedLine::Skipped(TEXT_LINES)),
            Err(error) => Err(error),
        }
    }

    fn take_pending(&mut self, next: Option<&[u8]>) -> Option<Record<'_>> {
        let raw = self.attached.take_block(next, &mut self.scratch)?;
        (self.has_records, self.is_tool_log) = (true, true);
        // Without answers beside them, the bytes may be of both sides.
        let direction = raw.direction.filter(|_| self.head.has_answers);
        let record = RawLine { direction, ..raw }.with_bytes(&self.scratch);
        Some(self.head.orient(record))
    }

    fn parse_usual(&mut self, bytes: &[u8]) -> Option<UsualLine> {
        let takes_serial = self.has_plain_lines();
        let line = parse_usual_line(bytes, &mut self.context)?;
        if matches!(line.data, UsualData::Serial(..)) {
            self.has_records |= takes_serial;
            return takes_serial.then_some(line);
        }
        Some(line)
    }

    fn begin_serial_lines(&mut self) -> bool {
        let is_plain = self.has_plain_lines();
        self.has_records |= is_plain;
        is_plain
    }

    fn usual_link(&self) -> &str {
        self.context.link()
    }
}

/// The control character that begins a colour.
const ESCAPE: u8 = 0x1B;

/// Removes the colours of a terminal: `ESC [ … m`.
fn strip_colours(line: &[u8], plain: &mut Vec<u8>) {
    plain.clear();
    let mut parts = line.split(|c| *c == ESCAPE);
    plain.extend_from_slice(parts.next().unwrap_or_default());
    for part in parts {
        let end = part.iter().position(u8::is_ascii_alphabetic).map_or(part.len(), |at| at + 1);
        plain.extend_from_slice(&part[end..]);
    }
}

/// Returns whether a line is text without data: no frame, and no two bytes one after the other.
fn is_prose(line: &[u8]) -> bool {
    let is_byte =
        |word: &[u8]| matches!(word, [a, b] if a.is_ascii_hexdigit() && b.is_ascii_hexdigit());
    let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
    line.first() != Some(&b'(')
        && !line.contains(&b'#')
        && !words.iter().any(|word| candump::is_length(word))
        && !words.windows(2).any(|pair| pair.iter().all(|word| is_byte(word)))
}

/// One line of a log.
enum LogLine<'a> {
    /// A record, and whether another program printed it as a line of its own kind.
    Record(Record<'a>, bool),
    /// A record of a serial CAN adapter, with the milliseconds of the minute.
    InMinute(Record<'a>, u32),
    /// Data that another line has as well.
    Repeated,
}

/// Reads one line. `None` for an empty line, a `#` or `;` comment, or one that repeats another. The bytes of
/// a serial line are put into `scratch`.
///
/// # Errors
/// The fault of the line, in words.
#[cfg(test)]
pub(crate) fn parse_log_line<'a>(
    line: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Result<Option<Record<'a>>, ReadError> {
    Ok(match parse_any_line(line, scratch)? {
        Some(LogLine::Record(record, _)) => Some(record),
        Some(LogLine::InMinute(record, ms)) => {
            Some(Record { time: Some(Timestamp(u64::from(ms) * 1_000_000)), ..record })
        }
        Some(LogLine::Repeated) | None => None,
    })
}

fn parse_any_line<'a>(
    line: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Result<Option<LogLine<'a>>, ReadError> {
    if line.len() > LINE_MAX {
        return Err(super::lines::TOO_LONG);
    }
    // The byte order mark that Windows editors write.
    let line = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(line).trim_ascii();
    let parsed = match line.first() {
        None | Some(b'#' | b';') => return Ok(None),
        Some(b'/') if line.starts_with(b"//") => return Ok(None),
        Some(b'(') => parse_stamped(line, scratch),
        Some(_) => parse_unstamped(line, scratch),
    };
    match parsed {
        Ok(parsed) => Ok(Some(LogLine::Record(parsed.with_bytes(scratch), false))),
        Err(_) if let Some(data) = before_comment(line) => parse_any_line(data, scratch),
        // With a time in parentheses it is a damaged line of a log of candump's form.
        Err(error) if line[0] == b'(' => Err(error),
        // Last, because the forms of programs are loose and would take a damaged line of the exact forms.
        Err(error) => parse_foreign_line(line, scratch).ok_or(error).map(Some),
    }
}

/// A line of another program, or one that another program wrapped.
fn parse_foreign_line<'a>(line: &'a [u8], scratch: &'a mut Vec<u8>) -> Option<LogLine<'a>> {
    if let Some((time, message)) = unwrap_line(line) {
        return parse_message(time, message, scratch);
    }
    Some(match parse_tool_line(line, scratch) {
        Some(ToolLine::Record(raw)) => LogLine::Record(raw.with_bytes(scratch), true),
        Some(ToolLine::InMinute(raw, ms)) => LogLine::InMinute(raw.with_bytes(scratch), ms),
        Some(ToolLine::Repeated) => LogLine::Repeated,
        // A line of ours with another time in front of it.
        None => {
            let (time, message) = split_time(std::str::from_utf8(line).ok()?)?;
            return parse_message(Some(time), message.as_bytes(), scratch);
        }
    })
}

/// A line inside another one, which has a time if the inner line has none.
fn parse_message<'a>(
    time: Option<Timestamp>,
    message: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Option<LogLine<'a>> {
    Some(match parse_any_line(message, scratch).ok()?? {
        LogLine::Record(record, _) => {
            LogLine::Record(Record { time: record.time.or(time), ..record }, true)
        }
        LogLine::InMinute(record, _) if time.is_some() => {
            LogLine::Record(Record { time, ..record }, true)
        }
        other => other,
    })
}

/// The part of a line before `//`, as manuals annotate their frames. A path or the address of a link has none behind
/// a space or a byte.
fn before_comment(line: &[u8]) -> Option<&[u8]> {
    let at = memchr::memmem::find(line, b"//")?;
    let data = &line[..at];
    let is_comment = data.last().is_some_and(|c| c.is_ascii_whitespace() || c.is_ascii_hexdigit());
    is_comment.then_some(data.trim_ascii_end())
}

/// A line whose data is in the buffer for bytes.
pub(super) struct RawLine<'a> {
    pub time: Option<Timestamp>,
    pub link: &'a str,
    pub direction: Option<Direction>,
    /// `None` for bytes of a serial line.
    pub can: Option<CanRecord>,
}

impl Default for RawLine<'_> {
    fn default() -> Self {
        Self { time: None, link: NO_LINK, direction: None, can: None }
    }
}

impl<'a> RawLine<'a> {
    /// The line as a record.
    pub(super) fn with_bytes(self, bytes: &'a [u8]) -> Record<'a> {
        let data = self.can.map_or(RecordData::Bytes(bytes), |can| can.with_bytes(bytes));
        let Self { time, link, direction, .. } = self;
        Record { time, link, direction, data, offset: 0 }
    }
}

/// Parts of the previous line that the next one mostly repeats: its link, and its time but for 100 s.
#[derive(Debug, Default)]
pub(super) struct LineContext {
    stamp_prefix: StampPrefix,
    link: String,
    link_changes: u64,
    /// The name and the space behind it: the first eight bytes, and which of them count.
    link_prefix: (u64, u64),
}

impl LineContext {
    fn set_link(&mut self, name: &str) {
        let mut bytes = [0; 8];
        let spaced = name.bytes().chain([b' ']);
        bytes.iter_mut().zip(spaced).for_each(|(to, from)| *to = from);
        let mask = if name.len() >= 7 { u64::MAX } else { (1 << (8 * (name.len() + 1))) - 1 };
        self.link_prefix = (u64::from_le_bytes(bytes), mask);
        self.link.clear();
        self.link.push_str(name);
        self.link_changes += 1;
    }

    /// The link; it has none before the first line.
    pub(super) fn link(&self) -> &str {
        &self.link
    }

    /// Number of changes of the link.
    pub(super) const fn link_changes(&self) -> u64 {
        self.link_changes
    }

    /// Rest behind the link, which is the link from then on.
    #[inline]
    fn split_link<'a>(&mut self, rest: &'a [u8]) -> Option<&'a [u8]> {
        // The name is compared as one word: a capture of one bus has the same name on a million lines.
        if self.after_link(rest).is_none() {
            let name = rest.get(..LINK_MAX)?.split(|c| *c == b' ').next()?;
            self.set_link(std::str::from_utf8(name).ok().filter(|name| !name.contains(is_blank))?);
        }
        self.after_link(rest)
    }

    /// Rest behind the link, if it is the same.
    #[inline]
    fn after_link<'a>(&self, rest: &'a [u8]) -> Option<&'a [u8]> {
        let ((head, mask), len) = (self.link_prefix, self.link.len());
        if u64::from_le_bytes(*rest.first_chunk()?) & mask != head {
            return None;
        }
        let same =
            len < 8 || (rest.starts_with(self.link.as_bytes()) && rest[len..].starts_with(b" "));
        rest.get(len + 1..).filter(|_| same && len > 0)
    }
}

/// A line of candump's log in its usual form, `(1700000000.000500) can0 30B#5443000000000005`, or of a serial
/// log, `(1700000000.000500) tty0 > 01 03 10 2E 00 02 A0 C2`, at the head of `bytes`; `None` for all others. Its
/// link is that of `before` from then on. This is the way that millions of lines go.
#[inline]
pub(super) fn parse_usual_line(bytes: &[u8], before: &mut LineContext) -> Option<UsualLine> {
    let (stamp, rest) = bytes.split_first_chunk::<20>()?;
    let time = Timestamp(digits::parse_stamp(stamp, &mut before.stamp_prefix)?.checked_mul(1000)?);
    let content = before.split_link(rest)?;
    if let [b'>' | b'<', ..] = content {
        let (data, rest) = parse_serial(content)?;
        return Some(UsualLine { time, data, bytes: bytes.len() - rest.len() });
    }
    let (frame, rest) = parse_frame(content)?;
    let data = UsualData::Frame(frame);
    Some(UsualLine { time, data, bytes: bytes.len() - rest.len() })
}

/// A frame, and what is behind its line.
#[inline]
fn parse_frame(content: &[u8]) -> Option<(Frame, &[u8])> {
    let (id, extended, text) = match content {
        [a, b, c, b'#', data @ ..] => (parse_id(&[*a, *b, *c])?, false, data),
        _ => {
            let (id, data) = content.split_first_chunk::<8>()?;
            (digits::parse_hex(*id)?, true, data.strip_prefix(b"#")?)
        }
    };
    let limit = if extended { crate::record::ID_MASK } else { STANDARD_MAX };
    let (data, count) = digits::parse_hex_line(text.first_chunk()?)?;
    if id > limit {
        return None;
    }
    debug_assert!(count <= 16, "a classic frame has at most eight bytes");
    let frame = Frame { id, extended, remote: false, len: (count / 2) as u8, data };
    Some((frame, &text[count + 1..]))
}

/// Bytes of a serial line with their direction, and what is behind their line. Apart, so that the way of frames stays
/// short.
#[inline(never)]
fn parse_serial(content: &[u8]) -> Option<(UsualData, &[u8])> {
    let (mark, text) = content.split_first()?;
    let direction = if *mark == b'>' { Direction::ToDrive } else { Direction::ToHost };
    let (mut bytes, mut len) = ([0; UsualData::SERIAL_MAX], 0);
    let rest = parse_spaced_bytes(text, |some| {
        bytes.get_mut(len..len + some.len())?.copy_from_slice(some);
        len += some.len();
        Some(())
    })?;
    let rest = rest.strip_prefix(b"\n").filter(|_| len > 0)?;
    Some((UsualData::Serial(direction, bytes, len as u8), rest))
}

/// A line of a serial log with any number of bytes, which are put into `bytes`: its time and its direction.
fn parse_serial_line(
    line: &[u8],
    before: &mut LineContext,
    bytes: &mut Vec<u8>,
) -> Option<(Timestamp, Option<Direction>)> {
    let (stamp, rest) = line.split_first_chunk::<20>()?;
    let time = Timestamp(digits::parse_stamp(stamp, &mut before.stamp_prefix)?.checked_mul(1000)?);
    let (direction, digits) = match before.split_link(rest)? {
        [b'>', digits @ ..] => (Direction::ToDrive, digits),
        [b'<', digits @ ..] => (Direction::ToHost, digits),
        _ => return None,
    };
    bytes.clear();
    let rest = parse_spaced_bytes(digits, |some| {
        bytes.extend_from_slice(some);
        Some(())
    })?;
    (rest.is_empty() && !bytes.is_empty()).then_some((time, Some(direction)))
}

/// Gives bytes that are each behind a space, and returns what is behind them; `None` for other digits, or if some bytes
/// are not taken.
#[inline]
fn parse_spaced_bytes(text: &[u8], mut take: impl FnMut(&[u8]) -> Option<()>) -> Option<&[u8]> {
    let mut rest = text;
    while let Some((four, after)) = rest.split_first_chunk()
        && let Some(bytes) = digits::parse_four_spaced(four)
    {
        take(&bytes)?;
        rest = after;
    }
    while let [b' ', high, low, after @ ..] = rest {
        let (high, low) = (HEX[usize::from(*high)], HEX[usize::from(*low)]);
        if (high | low) >= 16 {
            return None;
        }
        take(&[high << 4 | low])?;
        rest = after;
    }
    Some(rest)
}

fn is_blank(c: char) -> bool {
    c.is_ascii_whitespace()
}

/// Bytes in which a link's name ends in usual lines.
const LINK_MAX: usize = 24;

fn parse_id(text: &[u8]) -> Option<u32> {
    let (mut sum, mut bad) = (0, 0);
    for c in text {
        let digit = HEX[usize::from(*c)];
        bad |= digit;
        sum = sum << 4 | u32::from(digit & 0xF);
    }
    (bad < 16).then_some(sum)
}

fn parse_stamped<'a>(line: &'a [u8], scratch: &mut Vec<u8>) -> Result<RawLine<'a>, ReadError> {
    let close =
        line.iter().position(|c| *c == b')').ok_or(ReadError("the time stamp has no end"))?;
    let time = parse_stamp_text(line[1..close].trim_ascii())
        .ok_or(ReadError("the time stamp is not seconds with decimals"))?;
    let after = line[close + 1..].trim_ascii_start();
    // Programs with one bus leave its name out.
    let (link, rest) =
        if is_frame(after) { (NO_LINK.as_bytes(), after) } else { split_word(after) };
    let link = link_name(link)?;
    if link.is_empty() {
        return Err(ReadError("no link follows the time stamp"));
    }
    let (direction, can) = parse_body(rest, scratch)?;
    Ok(RawLine { time: Some(time), link, direction, can })
}

/// Data alone, as `polepair encode` prints it, or after the name of a link.
fn parse_unstamped<'a>(line: &'a [u8], scratch: &mut Vec<u8>) -> Result<RawLine<'a>, ReadError> {
    let (first, after) = split_word(line);
    let named = match after.first() {
        Some(b'>' | b'<') => !matches!(first, b">" | b"<"),
        _ => !is_frame(line) && is_frame(after) && !is_logger_name(first),
    };
    let (link, rest) = if named { (first, after) } else { (NO_LINK.as_bytes(), line) };
    let (direction, can) = parse_body(rest, scratch)?;
    Ok(RawLine { time: None, link: link_name(link)?, direction, can })
}

/// Seconds, or with `candump -tA` a date and a time: `2026-11-27 12:34:56.123456`.
fn parse_stamp_text(text: &[u8]) -> Option<Timestamp> {
    Timestamp::parse(text).or_else(|| {
        let text = std::str::from_utf8(text).ok()?;
        split_time(text).filter(|(_, rest)| rest.is_empty()).map(|(time, _)| time)
    })
}

/// Returns whether a word is a level of a logger, or its name behind that: `DEBUG:canopen.network:sent`.
fn is_logger_name(word: &[u8]) -> bool {
    let level = word.split(|c| *c == b':').next().unwrap_or(word);
    matches!(level, b"DEBUG" | b"INFO" | b"WARNING" | b"TRACE")
}

/// Returns whether a text is a CAN frame as candump writes it to a log or on the screen. Its first word decides: a `#`
/// further on is a comment, or a byte as text.
fn is_frame(text: &[u8]) -> bool {
    split_word(text).0.contains(&b'#') || candump::is_screen_line(text)
}

fn link_name(link: &[u8]) -> Result<&str, ReadError> {
    std::str::from_utf8(link).map_err(|_| ReadError("the link's name is not text"))
}

/// Parses the data into `scratch`; `None` for bytes of a serial line.
fn parse_body(
    rest: &[u8],
    scratch: &mut Vec<u8>,
) -> Result<(Option<Direction>, Option<CanRecord>), ReadError> {
    let (direction, can) = if split_word(rest).0.contains(&b'#') {
        candump::parse_log(rest, scratch)?
    } else if candump::is_screen_line(rest) {
        candump::parse_screen(rest, scratch)?
    } else {
        return Ok((serial_log::parse_data(rest, scratch)?, None));
    };
    Ok((direction, Some(can)))
}

#[cfg(test)]
mod tests {
    use super::{
        LineContext, Record, RecordData, parse_log_line, parse_serial_line, parse_usual_line,
    };

    #[test]
    fn a_line_needs_no_time() {
        let read = |line: &[u8]| {
            let mut scratch = Vec::new();
            let record = parse_log_line(line, &mut scratch).expect("a line").expect("not empty");
            (record.link.to_owned(), record.direction.is_some(), record.time.is_some())
        };
        let expected = |link: &str, directed: bool| (link.to_owned(), directed, false);
        assert_eq!(read(b"ttyUSB0 > 01 02"), expected("ttyUSB0", true));
        assert_eq!(read(b"> 01 02"), expected("-", true));
        assert_eq!(read(b"01 02"), expected("-", false));
        assert_eq!(read(b"can0 001#0102"), expected("can0", false));
        assert_eq!(read(b"001#0102"), expected("-", false));
        assert_eq!(read(b"  can0  123   [2]  01 02"), expected("can0", false));
    }

    #[test]
    fn serial_lines_are_read_as_by_the_general_way() {
        let mut before = LineContext::default();
        for (line, quick) in [
            ("(1700000000.000500) ttyUSB0 > 01 03 10 2E 00 02 A0 C2", true),
            ("(1700000000.999999) ttyUSB0 < 01 03 04 1e f6 00 13 5D E4", true),
            ("(1700000000.999999) a < 01 03 04 1e f6 00 13 5D E4", true),
            ("(1700000000.999999) a-long-name-of-a-line < 01 03 04", true),
            ("(1700000000.000001) tty0 > 0103102E0002A0C2 00 00 00", false),
            ("(1700000000.000001) tty0 > 01  03 10 2E 00 02 A0 C2", false),
            ("(1700000000.000001) tty0 > 01 03 10 2E 00 02 A0 C2 ", false),
            ("(1700000000.000001) tty0 01 03 10 2E 00 02 A0 C2 00", false),
            ("(1700000000.000001) tty0 > 01 03 10 2E 00 02 A0 C2 // read", false),
            ("(1700000000.000001) tty0 > :010310000001EB 01 02 03", false),
            ("(1700000000.0001) tty0 > 01 03 10 2E 00 02 A0 C2", false),
        ] {
            let (mut scratch, mut bytes) = (Vec::new(), Vec::new());
            let found = parse_serial_line(line.as_bytes(), &mut before, &mut bytes);
            assert_eq!(found.is_some(), quick, "{line}");
            let Some((time, direction)) = found else { continue };
            let slow = parse_log_line(line.as_bytes(), &mut scratch).expect(line).expect(line);
            let link = before.link();
            let data = RecordData::Bytes(&bytes);
            assert_eq!(Record { time: Some(time), link, direction, data, offset: 0 }, slow);
        }
    }

    /// The fast path for millions of lines gives the same result as the general one, or none.
    #[test]
    fn the_quick_way_reads_as_the_slow_one() {
        /// Text behind a line, long enough for the fast path.
        const NEXT: &str = "\n(1700000000.000500) can0 123#0011223344556677\n";
        let mut before = LineContext::default();
        for line in [
            "(1700000000.000500) can0 30B#5443000000000005",
            "(1700000000.999999) vcan12 0400A05E#3412",
            "(1700000000.000001) c 123#",
            "(1700000000.000001) can0 7ff#aAbB",
            "(1700000000.000001) interface 7ff#aAbB01",
            "(1700000000.000001) interfact 7ff#aAbB01",
            "(1700000000.000001) interfa 7ff#aAbB01",
            "(1700000000.000500) tty0 > 01 03 10 2E 00 02 a0 C2",
            "(1700000000.000500) /dev/ttyUSB0 < 05",
            "(1700000000.000500) tty0 < 00 11 22 33 44 55 66 77 88 99 AA BB CC DD EE FF",
        ] {
            let (mut scratch, bytes) = (Vec::new(), format!("{line}{NEXT}"));
            let quick = parse_usual_line(bytes.as_bytes(), &mut before).expect(line);
            let (direction, data) = quick.data.record_parts();
            let time = Some(quick.time);
            let quick_record = Record { time, link: before.link(), direction, data, offset: 0 };
            let slow = parse_log_line(line.as_bytes(), &mut scratch).expect(line);
            assert_eq!(Some(quick_record), slow, "{line}");
            assert_eq!(quick.bytes, line.len() + 1);
        }
        for line in [
            "(1700000000.000500) tty0 >",
            "(1700000000.000500) tty0 > 1",
            "(1700000000.000500) tty0 > 01 2",
            "(1700000000.000500) tty0 > 01 2G",
            "(1700000000.000500) tty0 > 01  02",
            "(1700000000.000500) tty0 > 01\r",
            "(1700000000.000500) tty0 01 02 03 04 05",
            "(1700000000.000500) tty0 < 00 11 22 33 44 55 66 77 88 99 AA BB CC DD EE FF 00",
            "(1700000000.000500) can0 30B#R",
            "(1700000000.000500) can0 30B#1",
            "(1700000000.000500) can0 30B#11 T",
            "(1700000000.000500) can0 30B#11\r",
            "(1700000000.000500) can0 830#11",
            "(1700000000.000500) can0 20000004#11",
            "(1700000000.000500) can0 30B##111",
            "(1700000000.000500) can0 30B#1G",
            "(1700000000.000500) can0 30B#001122334455667788",
            "(170000000x.000500) can0 30B#11",
            "(1700000000 000500) can0 30B#11",
            "(1700000000.0005)",
            "(1700000000.000500) can0",
            "(1700000000.000500)  30B#11",
        ] {
            let bytes = format!("{line}{NEXT}");
            assert!(parse_usual_line(bytes.as_bytes(), &mut before).is_none(), "{line}");
            let unended = parse_usual_line(line.as_bytes(), &mut before);
            assert!(unended.is_none(), "{line}, which has no end");
        }
    }
}
