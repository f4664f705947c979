//! Bytes of a capture file in, records out: whatever the format, however the bytes are cut.
//!
//! ```text
//!   bytes     pieces of a file, of stdin, of a file that still grows
//!    └ unpack gzip or Zstandard, by the first bytes
//!       └ FormatReader   one for each format: takes whole records off the head of the bytes
//! ```
//! Damage is named by its place and skipped; reading goes on where the format lets it.

mod asc;
mod attached;
pub(crate) mod blf;
mod busmaster;
mod byte_text;
mod candump;
mod crtd;
mod csv;
mod decompress;
mod detect;
mod digits;
mod gbk;
mod hex_dump;
mod jsonl;
mod line_scan;
mod line_time;
mod lines;
pub(crate) mod link_type;
mod log_traits;
mod marked_line;
mod pcap;
mod pcapng;
mod printed_frame;
mod program;
mod serial_log;
#[cfg(feature = "sqlite")]
mod sqlite;
#[cfg(not(feature = "sqlite"))]
#[path = "read/sqlite_left_out.rs"]
mod sqlite;
mod table;
mod tcp;
mod text;
mod tool_log;
mod trc;
mod utf16;
mod words;

use core::fmt;

use crate::format::{CaptureFormat, Compression, HEAD_MAX, UnsupportedFile};
use crate::record::Record;
use decompress::Decompressor;
pub use decompress::unpack_bounded;
pub use line_scan::LineScan;
#[cfg(test)]
pub(crate) use lines::LINE_MAX;
use lines::LineReader;
use log_traits::LogTraits;
#[cfg(test)]
pub(crate) use text::parse_log_line;
use utf16::Utf16Decoder;

/// Damaged places that are remembered one by one; more are only counted.
pub const DAMAGE_MAX: usize = 100;
/// Bytes that one record, or one compressed block of records, may have.
pub(crate) const BLOCK_MAX: usize = 1 << 26;

/// Reason why a part of a capture could not be read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ReadError(pub &'static str);

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

/// Position in a capture.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum CapturePosition {
    /// The line of that number, from 1.
    Line(u64),
    /// The byte of that number, from 0; of the unpacked bytes, if the file is compressed.
    Byte(u64),
    /// The row of that number, from 1, of a database.
    Row(u64),
}

impl fmt::Display for CapturePosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(number) => write!(f, "line {number}"),
            Self::Byte(number) => write!(f, "byte {number}"),
            Self::Row(number) => write!(f, "row {number}"),
        }
    }
}

/// A part of a capture that could not be read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Damage {
    /// Start of the damage.
    pub position: CapturePosition,
    /// Reason of the damage.
    pub reason: ReadError,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.position, self.reason)
    }
}

/// Takes what a capture holds.
pub(crate) trait RecordSink {
    /// Takes a record.
    fn handle_record(&mut self, record: &Record<'_>);
    /// Takes note of a part that cannot be read.
    fn handle_damage(&mut self, damage: Damage);
    /// Counts an object that is intact and not read, by its kind.
    fn handle_skipped(&mut self, kind: &'static str);
    /// Takes a remark on how records are read.
    fn handle_note(&mut self, note: &'static str) {
        let _ = note;
    }
}

/// The reader of one format.
pub(crate) trait FormatReader: fmt::Debug + Send {
    /// Reads the complete records at the head of `bytes` and returns the number of their bytes. When the capture has
    /// `ended`, no more follow: an incomplete record is damage.
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize;

    /// Returns whether usual lines of serial lines are records by themselves, here; they are read from then on.
    fn begin_serial_lines(&mut self) -> bool {
        false
    }

    /// Skips lines and bytes that were read elsewhere. False if that is impossible: the position is not between lines.
    fn skip_lines(&mut self, lines: u64, bytes: u64) -> bool {
        let _ = (lines, bytes);
        false
    }
}

/// Reads a capture in pieces, cut anywhere. Memory stays bounded however long the capture is.
#[derive(Debug, Default)]
pub struct CaptureReader {
    compression: CompressionState,
    plain: PlainReader,
}

/// True if a capture is compressed.
#[derive(Debug)]
enum CompressionState {
    /// First bytes, too few to detect a format.
    Undetected(Vec<u8>),
    Plain,
    Compressed(Box<Decompressor>),
}

impl Default for CompressionState {
    fn default() -> Self {
        Self::Undetected(Vec::new())
    }
}

/// Uncompressed bytes, and their reader.
#[derive(Debug, Default)]
struct PlainReader {
    options: ReadOptions,
    source: Option<(CaptureFormat, Box<dyn FormatReader>)>,
    /// The decoder of a text that is not UTF-8.
    utf16: Option<Utf16Decoder>,
    /// Bytes that wait for more.
    pending: Vec<u8>,
    /// Bytes that came in all.
    received_bytes: u64,
    statistics: ReadStatistics,
}

/// Origin of the times of a text log. Other formats state it themselves.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub enum LogTimes {
    /// Detected: differences if the first time is 0 and one of the next is less than the one before.
    #[default]
    Detect,
    /// One moment for all lines.
    Absolute,
    /// The line before: `candump -td`.
    Delta,
}

/// Options of reading a capture. By default everything is detected.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct ReadOptions {
    /// The format; detected from the first bytes if it is not stated.
    pub format: Option<CaptureFormat>,
    /// Origin of the times of a text log.
    pub times: LogTimes,
}

impl From<Option<CaptureFormat>> for ReadOptions {
    fn from(format: Option<CaptureFormat>) -> Self {
        Self { format, ..Self::default() }
    }
}

impl LogTimes {
    /// Properties of a log with this head; `None` while there are too few lines.
    fn detect_head(self, format: CaptureFormat, head: &[u8], enough: bool) -> Option<LogTraits> {
        if format != CaptureFormat::Text {
            return Some(LogTraits::default());
        }
        let found = LogTraits::detect(head, enough)?;
        Some(match self {
            Self::Detect => found,
            Self::Absolute => LogTraits { has_delta_times: false, ..found },
            Self::Delta => LogTraits { has_delta_times: true, ..found },
        })
    }
}

/// Counts of read and unreadable records.
#[derive(Clone, Debug, Default)]
pub struct ReadStatistics {
    /// Records read.
    pub records: u64,
    /// Places that could not be read.
    pub damaged: u64,
    /// The first of them.
    pub damage: Vec<Damage>,
    /// Objects that are intact and not read: their kind, and how many.
    pub skipped: Vec<(&'static str, u64)>,
    /// A file of a kind that is recognised and not read. Nothing of it is read.
    pub unsupported: Option<&'static UnsupportedFile>,
    /// Times of the text log are differences to the line before.
    pub has_delta_times: bool,
    /// Remarks on how records are read, each once.
    pub notes: Vec<&'static str>,
    /// Program that the first lines of a text name.
    pub program: Option<&'static str>,
}

/// Passes records on and counts.
struct CountingSink<'a> {
    statistics: &'a mut ReadStatistics,
    out: &'a mut dyn FnMut(&Record<'_>),
}

impl RecordSink for CountingSink<'_> {
    fn handle_record(&mut self, record: &Record<'_>) {
        self.statistics.records += 1;
        (self.out)(record);
    }

    fn handle_damage(&mut self, damage: Damage) {
        self.statistics.add_damage(damage);
    }

    fn handle_skipped(&mut self, kind: &'static str) {
        self.statistics.add_skipped(kind);
    }

    fn handle_note(&mut self, note: &'static str) {
        self.statistics.add_note(note);
    }
}

impl ReadStatistics {
    /// Counts an object that is not read.
    fn add_skipped(&mut self, kind: &'static str) {
        match self.skipped.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => *count += 1,
            None => self.skipped.push((kind, 1)),
        }
    }

    fn add_note(&mut self, note: &'static str) {
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Takes note of a damaged place.
    pub(crate) fn add_damage(&mut self, damage: Damage) {
        self.damaged += 1;
        // All are counted, the first are kept: a file of noise has millions.
        if self.damage.len() < DAMAGE_MAX {
            self.damage.push(damage);
        }
    }
}

impl CaptureReader {
    /// A reader with these options.
    #[must_use]
    pub fn new(options: ReadOptions) -> Self {
        let plain = PlainReader { options, ..PlainReader::default() };
        Self { plain, ..Self::default() }
    }

    /// The format, once it is detected.
    #[must_use]
    pub fn format(&self) -> Option<CaptureFormat> {
        self.plain.source.as_ref().map(|(format, _)| *format)
    }

    /// Statistics of the read and unreadable records so far.
    #[must_use]
    pub fn statistics(&self) -> &ReadStatistics {
        &self.plain.statistics
    }

    /// Takes a piece of the capture and gives every record that it completes.
    pub fn feed(&mut self, piece: &[u8], out: &mut dyn FnMut(&Record<'_>)) {
        match &mut self.compression {
            CompressionState::Plain => self.plain.feed(piece, false, out),
            CompressionState::Compressed(unpack) => {
                unpack.feed(piece, &mut |piece| self.plain.feed(piece, false, out));
            }
            CompressionState::Undetected(head) => {
                head.extend_from_slice(piece);
                if head.len() >= Compression::HEAD {
                    self.detect_compression(out);
                }
            }
        }
    }

    /// Records that lines, each a record, were read elsewhere. False if that is impossible: the position is not between
    /// lines of a log.
    pub(crate) fn skip_lines(&mut self, lines: u64, bytes: u64) -> bool {
        let plain = &mut self.plain;
        let whole = matches!(self.compression, CompressionState::Plain) && plain.pending.is_empty();
        let Some((CaptureFormat::Text, source)) = plain.source.as_mut().filter(|_| whole) else {
            return false;
        };
        let between = source.skip_lines(lines, bytes);
        if between {
            plain.received_bytes += bytes;
            plain.statistics.records += lines;
        }
        between
    }

    /// Returns whether usual lines of serial lines may be read elsewhere from here on.
    pub(crate) fn begin_serial_lines(&mut self) -> bool {
        self.plain.source.as_mut().is_some_and(|(_, source)| source.begin_serial_lines())
    }

    /// Bytes that came so far, unpacked.
    pub(crate) const fn received_bytes(&self) -> u64 {
        self.plain.received_bytes
    }

    /// Ends the capture: what waits for more is damage.
    pub fn finish(&mut self, out: &mut dyn FnMut(&Record<'_>)) {
        if matches!(self.compression, CompressionState::Undetected(_)) {
            self.detect_compression(out);
        }
        if let CompressionState::Compressed(unpack) = &mut self.compression {
            let ended = unpack.finish(&mut |piece| self.plain.feed(piece, false, out));
            if let Err(reason) = ended {
                let capture_position = CapturePosition::Byte(self.plain.received_bytes);
                self.plain.statistics.add_damage(Damage { position: capture_position, reason });
            }
        }
        self.plain.feed(&[], true, out);
    }

    /// Goes on with the first bytes, now that there are enough of them.
    fn detect_compression(&mut self, out: &mut dyn FnMut(&Record<'_>)) {
        let CompressionState::Undetected(head) = core::mem::take(&mut self.compression) else {
            return;
        };
        self.compression = Compression::detect(&head).map_or(CompressionState::Plain, |packing| {
            CompressionState::Compressed(Box::new(Decompressor::new(packing)))
        });
        self.feed(&head, out);
    }
}

impl PlainReader {
    fn feed(&mut self, piece: &[u8], ended: bool, out: &mut dyn FnMut(&Record<'_>)) {
        match &mut self.utf16 {
            Some(decoder) => {
                let text = decoder.decode(piece);
                self.feed_plain(&text, ended, out);
            }
            None => self.feed_plain(piece, ended, out),
        }
    }

    fn feed_plain(&mut self, piece: &[u8], ended: bool, out: &mut dyn FnMut(&Record<'_>)) {
        self.received_bytes += piece.len() as u64;
        let Self { options, source, pending, statistics, utf16, .. } = self;
        let ReadOptions { format: stated_format, times } = *options;
        let mut taker = CountingSink { statistics, out };
        // The common case: a whole piece without a rest before it needs no copy.
        if let (Some((_, source)), true) = (&mut *source, pending.is_empty()) {
            let used = source.read(piece, ended, &mut taker);
            pending.extend_from_slice(&piece[used..]);
            return;
        }
        pending.extend_from_slice(piece);
        if source.is_none() && utf16.is_none() {
            *utf16 = Utf16Decoder::detect(pending);
            if let Some(decoder) = utf16 {
                *pending = decoder.decode(pending);
            }
        }
        if source.is_none() {
            let head = &pending[..pending.len().min(HEAD_MAX)];
            if stated_format.is_none() && taker.statistics.unsupported.is_none() {
                // Before the formats, whose loose text forms would take parts of a foreign file.
                taker.statistics.unsupported = UnsupportedFile::detect(head);
            }
            if taker.statistics.unsupported.is_some() {
                pending.clear();
                return;
            }
            // Not decided by the first bytes alone: more may come in the next piece.
            let Some(format) = stated_format.or_else(|| CaptureFormat::detect(head, ended)) else {
                return;
            };
            let whole = ended || pending.len() >= HEAD_MAX;
            let Some(found) = times.detect_head(format, head, whole) else { return };
            taker.statistics.has_delta_times = found.has_delta_times;
            found.notes().for_each(|note| taker.handle_note(note));
            taker.statistics.program = program::find_name(head);
            *source = Some((format, open_format(format, found, line_end(head))));
        }
        if let Some((_, source)) = source {
            let used = source.read(pending, ended, &mut taker);
            pending.drain(..used);
        }
    }
}

/// The byte that ends the lines of a text: serial CAN adapters end them with a carriage return alone.
fn line_end(head: &[u8]) -> u8 {
    if head.contains(&b'\r') && !head.contains(&b'\n') { b'\r' } else { b'\n' }
}

/// Reads a text in any form that a capture may have, and passes its first record on. `None` where it has none.
pub fn read_first_record<T>(text: &str, take: impl FnOnce(&Record<'_>) -> T) -> Option<T> {
    let (mut take, mut taken) = (Some(take), None);
    let mut reader = CaptureReader::default();
    let mut out = |record: &Record<'_>| {
        if let Some(take) = take.take() {
            taken = Some(take(record));
        }
    };
    reader.feed(text.as_bytes(), &mut out);
    reader.finish(&mut out);
    taken
}

fn open_format(format: CaptureFormat, head: LogTraits, end: u8) -> Box<dyn FormatReader> {
    match format {
        CaptureFormat::Text => Box::new(LineReader::new(text::TextReader::new(head)).with_end(end)),
        CaptureFormat::Asc => Box::new(LineReader::new(asc::AscReader::default())),
        CaptureFormat::Trc => Box::new(LineReader::new(trc::TrcReader::default())),
        CaptureFormat::Csv => Box::new(LineReader::new(csv::CsvReader::default())),
        CaptureFormat::Busmaster => {
            Box::new(LineReader::new(busmaster::BusmasterReader::default()))
        }
        CaptureFormat::Crtd => Box::new(LineReader::new(crtd::CrtdReader::default())),
        CaptureFormat::Jsonl => Box::new(LineReader::new(jsonl::JsonlReader::default())),
        CaptureFormat::Pcap => Box::new(pcap::PcapReader::default()),
        CaptureFormat::Pcapng => Box::new(pcapng::PcapngReader::default()),
        CaptureFormat::Blf => Box::new(blf::BlfReader::default()),
        CaptureFormat::Sqlite => Box::new(sqlite::SqliteReader::default()),
    }
}

#[cfg(test)]
mod tests;
