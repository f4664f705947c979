//! Text formats with one record a line: candump's log and screen output, serial logs, data only, and lines
//! that other programs print.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::digits::StampPrefix;
use super::lines::{LINE_MAX, LineFormat, ParsedLine, UsualLine};
use super::tool_log::{self, ToolLine, parse_tool_line};
use super::words::{HEX, split_word};
use super::{ReadError, candump, digits, serial_log};
use crate::record::{CanRecord, Record, RecordData, STANDARD_MAX};
use crate::timestamp::Timestamp;

/// The reader of such lines.
#[derive(Debug, Default)]
pub(super) struct TextReader {
    scratch: Vec<u8>,
    context: LineContext,
    /// The line without colours.
    plain: Vec<u8>,
    /// Times are differences to the line before.
    delta: bool,
    /// The sum of the differences so far.
    elapsed: u64,
    /// A record was read.
    has_records: bool,
    /// A line of another program was read: its other lines are text.
    is_tool_log: bool,
    /// The last record is an error frame, which may be explained on the next line.
    after_error: bool,
}

/// Lines that hold no data.
const TEXT_LINES: &str = "lines of text";

impl TextReader {
    /// A reader of a log whose times are absolute, or differences.
    pub(super) fn new(delta: bool) -> Self {
        Self { delta, ..Self::default() }
    }
}

impl LineFormat for TextReader {
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError> {
        let after_error = core::mem::take(&mut self.after_error);
        // candump -e explains an error frame on a line of its own.
        if after_error && line.starts_with(b"\t") {
            return Ok(ParsedLine::Nothing);
        }
        let line = if line.contains(&ESCAPE) {
            strip_colours(line, &mut self.plain);
            &self.plain
        } else {
            line
        };
        // Prose between frames is damage in a capture, and normal in a program's log or above the first frame.
        let may_be_text = self.is_tool_log || !self.has_records;
        match parse_any_line(line, &mut self.scratch) {
            Ok(None) => Ok(ParsedLine::Nothing),
            Ok(Some(LogLine::Repeated)) => Ok(ParsedLine::Skipped("repeated lines")),
            Ok(Some(LogLine::Record(mut record, is_tool))) => {
                self.has_records = true;
                self.is_tool_log |= is_tool;
                self.after_error = matches!(record.data, RecordData::Error(_));
                if let Some(time) = record.time.filter(|_| self.delta) {
                    self.elapsed = self.elapsed.saturating_add(time.0);
                    record.time = Some(Timestamp(self.elapsed));
                }
                Ok(ParsedLine::Record(record))
            }
            Err(_) if may_be_text && is_prose(line) => Ok(ParsedLine::Skipped(TEXT_LINES)),
            Err(error) => Err(error),
        }
    }

    fn parse_usual(&mut self, bytes: &[u8]) -> Option<UsualLine> {
        parse_usual_line(bytes, &mut self.context)
    }

    fn usual_link(&self) -> &str {
        self.context.link()
    }
}

/// Times in a row, none less than the one before, after which they count as absolute.
const RISES: usize = 16;

/// Returns whether the times of a log are differences: the first is 0, and a later one is less than the one before.
/// `None` while there are too few lines to decide.
pub(super) fn detect_deltas(head: &[u8], enough: bool) -> Option<bool> {
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
    /// Data that another line has as well.
    Repeated,
}

/// Reads one line. `None` for an empty line, a `#` or `;` comment, or one that repeats another. The bytes of
/// a serial line are put into `scratch`.
///
/// # Errors
/// The fault of the line, in words.
pub fn parse_log_line<'a>(
    line: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Result<Option<Record<'a>>, ReadError> {
    Ok(match parse_any_line(line, scratch)? {
        Some(LogLine::Record(record, _)) => Some(record),
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
        Some(b'(') => match (parse_stamped(line, scratch), before_comment(line)) {
            (Err(_), Some(data)) => return parse_any_line(data, scratch),
            (parsed, _) => Ok(parsed?),
        },
        Some(_) => parse_unstamped(line, scratch),
    };
    match parsed {
        Ok(parsed) => Ok(Some(LogLine::Record(parsed.with_bytes(scratch), false))),
        Err(_) if let Some(data) = before_comment(line) => parse_any_line(data, scratch),
        // Last, because the forms of programs are loose and would take a damaged line of the exact forms.
        Err(error) => match parse_tool_line(line, scratch) {
            Some(ToolLine::Record(record)) => Ok(Some(LogLine::Record(record, true))),
            Some(ToolLine::Repeated) => Ok(Some(LogLine::Repeated)),
            None => Err(error),
        },
    }
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
struct RawLine<'a> {
    time: Option<Timestamp>,
    link: &'a str,
    direction: Option<Direction>,
    /// `None` for bytes of a serial line.
    can: Option<CanRecord>,
}

impl<'a> RawLine<'a> {
    fn with_bytes(self, bytes: &'a [u8]) -> Record<'a> {
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

/// A line of candump's log in its usual form, `(1700000000.000500) can0 30B#5443000000000005`, at the
/// head of `bytes`; `None` for all others. Its link is that of `before` from then on. This is the way that
/// millions of lines go.
#[inline]
pub(super) fn parse_usual_line(bytes: &[u8], before: &mut LineContext) -> Option<UsualLine> {
    let (stamp, rest) = bytes.split_first_chunk::<20>()?;
    let time = Timestamp(digits::parse_stamp(stamp, &mut before.stamp_prefix)?.checked_mul(1000)?);
    // The name is compared as one word: a capture of one bus has the same name on a million lines.
    if before.after_link(rest).is_none() {
        let name = rest.get(..LINK_MAX)?.split(|c| *c == b' ').next()?;
        before.set_link(std::str::from_utf8(name).ok().filter(|name| !name.contains(is_blank))?);
    }
    let frame = before.after_link(rest)?;
    let (id, extended, text) = match frame {
        [a, b, c, b'#', data @ ..] => (parse_id(&[*a, *b, *c])?, false, data),
        _ => {
            let (id, data) = frame.split_first_chunk::<8>()?;
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
    Some(UsualLine { time, frame, bytes: bytes.len() - text.len() + count + 1 })
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
    let (link, rest) = split_word(&line[close + 1..]);
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
        _ => {
            !first.contains(&b'#')
                && (split_word(after).0.contains(&b'#') || candump::is_screen_line(after))
        }
    };
    let (link, rest) = if named { (first, after) } else { (&b"-"[..], line) };
    let (direction, can) = parse_body(rest, scratch)?;
    Ok(RawLine { time: None, link: link_name(link)?, direction, can })
}

/// Seconds, or with `candump -tA` a date and a time: `2026-11-27 12:34:56.123456`.
fn parse_stamp_text(text: &[u8]) -> Option<Timestamp> {
    Timestamp::parse(text).or_else(|| {
        let (date, clock) = std::str::from_utf8(text).ok()?.split_once(' ')?;
        let (clock, ns) = tool_log::parse_clock(clock)?;
        crate::date::from_calendar(tool_log::parse_date(date)?, clock, ns)
    })
}

fn link_name(link: &[u8]) -> Result<&str, ReadError> {
    std::str::from_utf8(link).map_err(|_| ReadError("the link's name is not text"))
}

/// Parses the data into `scratch`; `None` for bytes of a serial line.
fn parse_body(
    rest: &[u8],
    scratch: &mut Vec<u8>,
) -> Result<(Option<Direction>, Option<CanRecord>), ReadError> {
    let (direction, can) = if rest.contains(&b'#') {
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
    use super::{LineContext, Record, RecordData, parse_log_line, parse_usual_line};

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
        ] {
            let (mut scratch, bytes) = (Vec::new(), format!("{line}{NEXT}"));
            let quick = parse_usual_line(bytes.as_bytes(), &mut before).expect(line);
            let quick_record = Record {
                time: Some(quick.time),
                link: before.link(),
                direction: None,
                data: RecordData::Frame(quick.frame),
                offset: 0,
            };
            let slow = parse_log_line(line.as_bytes(), &mut scratch).expect(line);
            assert_eq!(Some(quick_record), slow, "{line}");
            assert_eq!(quick.bytes, line.len() + 1);
        }
        for line in [
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
