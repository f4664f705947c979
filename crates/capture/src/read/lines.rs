//! Formats with one line for each record.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::{CapturePosition, Damage, FormatReader, ReadError, RecordSink};
use crate::record::{Record, RecordData};
use crate::timestamp::Timestamp;

/// Bytes that a line may have at most; a longer one is damaged.
pub(crate) const LINE_MAX: usize = 1 << 16;
pub(super) const TOO_LONG: ReadError = ReadError("it is longer than 65536 bytes");

/// The content of a line.
pub(super) enum ParsedLine<'a> {
    /// A record.
    Record(Record<'a>),
    /// A header, a comment, or an empty line.
    Nothing,
    /// An object that the reader does not read, by its kind.
    Skipped(&'static str),
}

/// A line in the form that nearly all lines of a format have, with its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct UsualLine {
    pub time: Timestamp,
    pub data: UsualData,
    /// Length with its end, bytes.
    pub bytes: usize,
}

/// Data of such a line.
#[derive(Clone, Copy, Debug)]
pub(super) enum UsualData {
    /// A CAN frame.
    Frame(Frame),
    /// The first of these bytes, which a serial line carried.
    Serial(Direction, [u8; UsualData::SERIAL_MAX], u8),
}

impl UsualData {
    /// Bytes of a usual line of a serial line; requests and answers of most drives are no longer.
    pub const SERIAL_MAX: usize = 16;

    /// The data and the sender of a record.
    pub fn record_parts(&self) -> (Option<Direction>, RecordData<'_>) {
        match self {
            Self::Frame(frame) => (None, RecordData::Frame(*frame)),
            Self::Serial(direction, bytes, len) => {
                (Some(*direction), RecordData::Bytes(&bytes[..usize::from(*len)]))
            }
        }
    }
}

impl<'a> From<Option<Record<'a>>> for ParsedLine<'a> {
    fn from(record: Option<Record<'a>>) -> Self {
        record.map_or(Self::Nothing, Self::Record)
    }
}

/// Reads one line of a format.
pub(super) trait LineFormat: core::fmt::Debug + Send {
    /// Parses one line.
    fn parse_line<'a>(&'a mut self, line: &'a [u8]) -> Result<ParsedLine<'a>, ReadError>;

    /// Data of the lines before, which is complete now that another line follows or the capture ends.
    fn take_pending(&mut self, next: Option<&[u8]>) -> Option<Record<'_>> {
        let _ = next;
        None
    }

    /// The line at the head of these bytes, where it has the form that nearly all have.
    fn parse_usual(&mut self, bytes: &[u8]) -> Option<UsualLine> {
        let _ = bytes;
        None
    }

    /// Returns whether lines of a serial line in that form need no state of the lines before; they are records from
    /// then on.
    fn begin_serial_lines(&mut self) -> bool {
        false
    }

    /// The link of the last line of that form.
    fn usual_link(&self) -> &str {
        "-"
    }
}

/// Cuts bytes into numbered lines.
#[derive(Debug)]
pub(super) struct LineReader<L> {
    format: L,
    /// The byte that ends a line.
    end: u8,
    line_number: u64,
    /// Bytes in front of the line.
    offset: u64,
    /// The rest of this line is left out.
    skipping: bool,
}

impl<L: LineFormat> LineReader<L> {
    pub(super) fn new(format: L) -> Self {
        Self { format, end: b'\n', line_number: 0, offset: 0, skipping: false }
    }

    /// Cuts lines at this byte.
    pub(super) fn with_end(self, end: u8) -> Self {
        Self { end, ..self }
    }

    fn read_line(&mut self, line: &[u8], taker: &mut dyn RecordSink) {
        self.line_number += 1;
        if let Some(record) = self.format.take_pending(Some(line)) {
            taker.handle_record(&Record { offset: self.offset, ..record });
        }
        let read = if line.len() > LINE_MAX { Err(TOO_LONG) } else { self.format.parse_line(line) };
        match read {
            Ok(ParsedLine::Nothing) => {}
            Ok(ParsedLine::Skipped(kind)) => taker.handle_skipped(kind),
            Ok(ParsedLine::Record(record)) => {
                taker.handle_record(&Record { offset: self.offset, ..record })
            }
            Err(reason) => taker.handle_damage(Damage {
                position: CapturePosition::Line(self.line_number),
                reason,
            }),
        }
    }
}

impl<L: LineFormat> FormatReader for LineReader<L> {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        let mut used = 0;
        loop {
            let rest = &bytes[used..];
            let usual = if self.skipping { None } else { self.format.parse_usual(rest) };
            let len = if let Some(UsualLine { time, data, bytes }) = usual {
                self.line_number += 1;
                let (direction, data) = data.record_parts();
                taker.handle_record(&Record {
                    time: Some(time),
                    link: self.format.usual_link(),
                    direction,
                    data,
                    offset: self.offset,
                });
                bytes
            } else {
                let Some(end) = memchr::memchr(self.end, rest) else { break };
                if !(core::mem::take(&mut self.skipping)) {
                    self.read_line(&rest[..end], taker)
                }
                end + 1
            };
            self.offset += len as u64;
            used += len;
        }
        let rest = &bytes[used..];
        if ended && !rest.is_empty() && !self.skipping {
            self.read_line(rest, taker);
        } else if rest.len() > LINE_MAX && !self.skipping {
            self.read_line(rest, taker);
            self.skipping = true;
        }
        if ended || self.skipping {
            self.offset += rest.len() as u64;
            used = bytes.len();
        }
        if ended && let Some(record) = self.format.take_pending(None) {
            taker.handle_record(&Record { offset: self.offset, ..record });
        }
        used
    }

    fn begin_serial_lines(&mut self) -> bool {
        self.format.begin_serial_lines()
    }

    fn skip_lines(&mut self, lines: u64, bytes: u64) -> bool {
        let between = !self.skipping;
        if between {
            self.line_number += lines;
            self.offset += bytes;
        }
        between
    }
}
