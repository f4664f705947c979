//! BLF, the binary log of Vector's tools: a header, then objects. Most objects are in compressed
//! containers; an object may begin in one container and end in the next.

use flate2::{Decompress, FlushDecompress, Status};
use polepair_core::convert::ascii_text;
use polepair_core::convert::tail;
use polepair_core::explain::Direction;

use super::{BLOCK_MAX, CapturePosition, Damage, FormatReader, ReadError, RecordSink};
use crate::date;
use crate::record::{CanErrorFrame, CanRecord, EXTENDED_FLAG, ID_MASK, Record, classic_frame};
use crate::timestamp::Timestamp;

/// Every object begins with these.
pub(crate) const SIGNATURE: &[u8; 4] = b"LOBJ";
/// Bytes of an object's first header: signature, its size, version, the object's size, its kind.
pub(crate) const OBJECT_HEAD: usize = 16;
/// Bytes of the header behind the first: flags, client, version, time.
pub(crate) const TIME_HEAD: usize = 16;
/// Bytes of a container's header behind the first.
pub(crate) const CONTAINER_HEAD: usize = 16;
/// Default length of a file's header, bytes.
pub(crate) const FILE_HEAD: usize = 144;
/// Offset of the start time in the file's header.
pub(crate) const BEGIN_AT: usize = 40;
/// Bytes that a container may unpack to: a hundred times what those are that are written.
const CONTAINER_MAX: usize = 1 << 24;
/// Greatest expansion of one byte by DEFLATE.
const RATIO_MAX: usize = 1032;
/// Bytes between objects that are padding, and no damage.
const PADDING_MAX: usize = 8;

/// Kinds of objects.
pub(crate) mod kind {
    pub(crate) const MESSAGE: u32 = 1;
    pub(crate) const CONTAINER: u32 = 10;
    pub(crate) const ERROR: u32 = 2;
    pub(crate) const ERROR_EXT: u32 = 73;
    pub(crate) const DRIVER_ERROR: u32 = 31;
    pub(crate) const DRIVER_ERROR_EXT: u32 = 74;
    pub(crate) const FD_ERROR_64: u32 = 104;
    /// An end of the file's index, and reserved kinds: nothing is lost with them.
    pub(crate) const BOOKKEEPING: [u32; 6] = [0, 26, 27, 28, 108, 115];
    pub(crate) const MESSAGE_2: u32 = 86;
    pub(crate) const FD: u32 = 100;
    pub(crate) const FD_64: u32 = 101;
}

/// Compression of a container.
pub(crate) const DEFLATE: u16 = 2;
/// Times count in steps of 10 us; else in nanoseconds.
pub(crate) const TENS_OF_MICROSECONDS: u32 = 1;
/// Flags of a message.
pub(crate) const SENT: u8 = 1;
pub(crate) const REMOTE: u8 = 0x80;

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// The reader of such files.
#[derive(Debug, Default)]
pub(super) struct BlfReader {
    start_time: Option<Timestamp>,
    /// Bytes of the file taken so far.
    offset: u64,
    /// Unpacked bytes of an object that goes on in the next container.
    tail: Vec<u8>,
    resyncing: bool,
    /// Sum of the announced unpacked sizes, if containers are not to be unpacked.
    size_only: Option<u64>,
}

/// Sum of the announced unpacked sizes of a file's containers, which unpacking enforces.
pub(super) fn unpacked_size(bytes: &[u8]) -> u64 {
    let mut blf = BlfReader { size_only: Some(0), ..BlfReader::default() };
    blf.read(bytes, true, &mut NullSink);
    blf.size_only.unwrap_or(0)
}

/// Takes nothing.
struct NullSink;

impl RecordSink for NullSink {
    fn handle_record(&mut self, _: &Record<'_>) {}
    fn handle_damage(&mut self, _: Damage) {}
    fn handle_skipped(&mut self, _: &'static str) {}
}

/// The first header of an object.
#[derive(Clone, Copy)]
struct ObjectHeader {
    header_len: usize,
    version: u16,
    size: usize,
    kind: u32,
}

impl ObjectHeader {
    fn parse(bytes: &[u8]) -> Option<Self> {
        let version = u16_at(bytes, 6)?;
        let head = usize::from(u16_at(bytes, 4)?);
        let (size, kind) = (u32_at(bytes, 8)? as usize, u32_at(bytes, 12)?);
        let sound = bytes.starts_with(SIGNATURE) && head >= OBJECT_HEAD && size >= head;
        (sound && size <= BLOCK_MAX).then_some(Self { header_len: head, version, size, kind })
    }
}

impl FormatReader for BlfReader {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        let mut used = 0;
        if self.start_time.is_none() {
            match self.read_file_header(bytes) {
                Some(count) => used = count,
                None if ended => {
                    self.report_damage("the file's header is cut off or damaged", taker);
                    return bytes.len();
                }
                None => return 0,
            }
            self.offset = used as u64;
        }
        while let Some(step) = self.read_object(&bytes[used..], ended, taker) {
            used += step;
            self.offset += step as u64;
        }
        if ended && !self.tail.is_empty() {
            self.tail.clear();
            self.report_damage("the last object is cut off", taker);
        }
        used
    }
}

impl BlfReader {
    /// Reads the file's header. Without a start time, times count from 0.
    fn read_file_header(&mut self, bytes: &[u8]) -> Option<usize> {
        // The stated size, within reason: a damaged one must not swallow the file.
        let size = (u32_at(bytes, 4)? as usize).clamp(BEGIN_AT + 16, 4096);
        let header = bytes.get(..size)?;
        let (date, time) = (
            [header_word(0, header), header_word(1, header), header_word(3, header)],
            [header_word(4, header), header_word(5, header), header_word(6, header)],
        );
        let begin =
            date::from_calendar(date, time, u32::from(header_word(7, header).min(999)) * 1_000_000);
        // Without a date the times count from zero; the differences between them stay right.
        self.start_time = Some(begin.unwrap_or(Timestamp(0)));
        Some(size)
    }

    /// Takes one object of the file, or a damaged part; `None` when more bytes are needed.
    fn read_object(
        &mut self,
        bytes: &[u8],
        ended: bool,
        taker: &mut dyn RecordSink,
    ) -> Option<usize> {
        if bytes.len() < OBJECT_HEAD {
            return self.read_end(bytes, ended, taker);
        }
        let Some(head) = ObjectHeader::parse(bytes) else {
            return Some(self.skip_damage(bytes, taker));
        };
        let Some(object) = bytes.get(..head.size) else {
            return self.read_end(bytes, ended, taker);
        };
        self.resyncing = false;
        match head.kind {
            kind::CONTAINER => self.read_container(&object[head.header_len..], taker),
            _ => self.read_frame(object, head, taker),
        }
        Some(head.size)
    }

    /// Skips padding, or bytes that are no object, to where the next may begin.
    fn skip_damage(&mut self, bytes: &[u8], taker: &mut dyn RecordSink) -> usize {
        let next = memchr::memmem::find(&bytes[1..], SIGNATURE).map(|at| at + 1);
        // Objects are padded to four bytes, which some writers count in the size and others do not.
        let padding = next.is_some_and(|at| at < PADDING_MAX) && !bytes.starts_with(SIGNATURE);
        if !padding && !core::mem::replace(&mut self.resyncing, true) {
            self.report_damage("the object's header is damaged", taker);
        }
        debug_assert!(bytes.len() >= SIGNATURE.len());
        // The last bytes may be the begin of a signature that the next piece completes.
        next.unwrap_or(bytes.len() - SIGNATURE.len() + 1)
    }

    fn read_end(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> Option<usize> {
        if !ended || bytes.is_empty() {
            return None;
        }
        // A rest that is shorter than a signature may be padding.
        if !self.resyncing && bytes.len() >= SIGNATURE.len() {
            self.report_damage("the last object is cut off", taker);
            // A program that crashed leaves its last container open; what it has packed so far is whole.
            self.salvage_container(bytes, taker);
        }
        Some(bytes.len())
    }

    /// Reads the intact part of a truncated container.
    fn salvage_container(&mut self, bytes: &[u8], taker: &mut dyn RecordSink) {
        if let Some(head) = ObjectHeader::parse(bytes).filter(|head| head.kind == kind::CONTAINER) {
            let rest = tail(bytes, head.header_len);
            self.unpack_container(rest, taker);
            self.tail.clear();
        }
    }

    fn read_container(&mut self, body: &[u8], taker: &mut dyn RecordSink) {
        if !self.unpack_container(body, taker) {
            self.report_damage("the container cannot be unpacked to its end", taker);
            self.tail.clear();
        }
    }

    /// Unpacks a container and takes the objects that are whole. False when it is damaged.
    fn unpack_container(&mut self, body: &[u8], taker: &mut dyn RecordSink) -> bool {
        let (Some(method), Some(size)) = (u16_at(body, 0), u32_at(body, 8)) else { return false };
        let packed = tail(body, CONTAINER_HEAD);
        // An object may begin in one container and end in the next.
        let mut plain = core::mem::take(&mut self.tail);
        let whole = match method {
            0 => {
                plain.extend_from_slice(packed);
                true
            }
            DEFLATE => match &mut self.size_only {
                Some(weight) => {
                    *weight += checked_size(packed, size).unwrap_or(0) as u64;
                    return true;
                }
                None => inflate(packed, size, &mut plain),
            },
            _ => false,
        };
        let used = self.read_objects(&plain, taker);
        plain.drain(..used);
        self.tail = plain;
        whole
    }

    /// Takes the whole objects of an unpacked container.
    fn read_objects(&mut self, bytes: &[u8], taker: &mut dyn RecordSink) -> usize {
        let mut used = 0;
        loop {
            let rest = &bytes[used..];
            if rest.len() < OBJECT_HEAD {
                return used;
            }
            let Some(head) = ObjectHeader::parse(rest) else {
                used += self.skip_damage(rest, taker);
                continue;
            };
            let Some(object) = rest.get(..head.size) else { return used };
            self.resyncing = false;
            self.read_frame(object, head, taker);
            used += head.size;
        }
    }

    fn read_frame(&self, object: &[u8], head: ObjectHeader, taker: &mut dyn RecordSink) {
        let Some(shape) = body_parser(head.kind) else {
            // Statistics of the writer are no content; anything else that is left out is reported.
            if !kind::BOOKKEEPING.contains(&head.kind) {
                taker.handle_skipped(kind_name(head.kind));
            }
            return;
        };
        let body = tail(object, head.header_len);
        match self.object_time(object, head).zip(shape(body)) {
            Some((time, BlfFrame { channel, sent, record, bytes, len })) => {
                let mut padded = [0; FD_MAX];
                let bytes = match padded.get_mut(..len).filter(|_| len > bytes.len()) {
                    None => bytes,
                    Some(whole) => {
                        whole[..bytes.len()].copy_from_slice(bytes);
                        whole
                    }
                };
                let mut name = [0; 16];
                let link = link_name(channel, &mut name);
                let direction =
                    sent.map(|sent| if sent { Direction::ToDrive } else { Direction::ToHost });
                taker.handle_record(&Record {
                    time: Some(time),
                    link,
                    direction,
                    data: record.with_bytes(bytes),
                    offset: self.offset,
                });
            }
            None => self.report_damage("the object is shorter than its kind", taker),
        }
    }

    fn object_time(&self, object: &[u8], head: ObjectHeader) -> Option<Timestamp> {
        let flags = u32_at(object, OBJECT_HEAD)?;
        if !matches!(head.version, 1 | 2) {
            return None;
        }
        let ticks = u64::from_le_bytes(*object.get(OBJECT_HEAD + 8..)?.first_chunk()?);
        let ns = if flags == TENS_OF_MICROSECONDS { ticks.checked_mul(10_000)? } else { ticks };
        Some(Timestamp(self.start_time?.0.checked_add(ns)?))
    }

    fn report_damage(&self, reason: &'static str, taker: &mut dyn RecordSink) {
        taker.handle_damage(Damage {
            position: CapturePosition::Byte(self.offset),
            reason: ReadError(reason),
        });
    }
}

fn header_word(n: usize, header: &[u8]) -> u16 {
    let at = BEGIN_AT + 2 * n;
    u16::from_le_bytes([header[at], header[at + 1]])
}

/// Fields of an object.
struct BlfFrame<'a> {
    channel: u16,
    sent: Option<bool>,
    record: CanRecord,
    bytes: &'a [u8],
    /// Length of the data. Zeros at its end need not be among `bytes`.
    len: usize,
}

impl<'a> BlfFrame<'a> {
    /// An error frame.
    const fn error(channel: u16, error: CanErrorFrame) -> Self {
        Self { channel, sent: None, record: CanRecord::Error(error), bytes: &[], len: 0 }
    }

    /// A frame with all its bytes.
    const fn new(channel: u16, sent: bool, record: CanRecord, bytes: &'a [u8]) -> Self {
        Self { channel, sent: Some(sent), record, bytes, len: bytes.len() }
    }
}

type BodyParser = fn(&[u8]) -> Option<BlfFrame<'_>>;

/// Parser of objects of that kind; `None` for those without traffic.
fn body_parser(kind: u32) -> Option<BodyParser> {
    match kind {
        kind::MESSAGE | kind::MESSAGE_2 => Some(parse_message),
        kind::ERROR | kind::ERROR_EXT => Some(parse_error),
        kind::DRIVER_ERROR | kind::DRIVER_ERROR_EXT => Some(parse_driver_error),
        kind::FD_ERROR_64 => Some(parse_fd_error_64),
        kind::FD => Some(parse_fd),
        kind::FD_64 => Some(parse_fd_64),
        _ => None,
    }
}

/// Name of the objects of a kind that is not read.
fn kind_name(kind: u32) -> &'static str {
    match kind {
        3 => "overload frames",
        4 => "bus statistics",
        6..=8 | 65 | 72 => "variables and texts",
        9 | 92 | 96 => "triggers, comments and markers",
        11..=25 | 46..=50 | 57..=63 => "LIN objects",
        44 | 51 => "clock objects",
        71 | 113 | 120 => "Ethernet frames",
        90 => "serial events",
        91 => "driver overruns",
        _ => "objects of other kinds",
    }
}

fn parse_message(body: &[u8]) -> Option<BlfFrame<'_>> {
    let (flags, len) = (*body.get(2)?, *body.get(3)?);
    let bytes = body.get(8..16)?;
    let (id, extended) = split_identifier(u32_at(body, 4)?);
    let shape = CanRecord::Frame(classic_frame(id, extended, flags & REMOTE != 0, len, bytes));
    Some(BlfFrame::new(u16_at(body, 0)?, flags & SENT != 0, shape, bytes))
}

fn parse_error(body: &[u8]) -> Option<BlfFrame<'_>> {
    let error = CanErrorFrame { class: CanErrorFrame::BUS_ERROR, ..CanErrorFrame::default() };
    Some(BlfFrame::error(u16_at(body, 0)?, error))
}

/// The error counters of a controller. The code and the state register behind them are not documented.
fn parse_driver_error(body: &[u8]) -> Option<BlfFrame<'_>> {
    let error = CanErrorFrame::from_counters(*body.get(2)?, *body.get(3)?);
    Some(BlfFrame::error(u16_at(body, 0)?, error))
}

fn parse_fd_error_64(body: &[u8]) -> Option<BlfFrame<'_>> {
    let error = CanErrorFrame { class: CanErrorFrame::BUS_ERROR, ..CanErrorFrame::default() };
    Some(BlfFrame::error(u16::from(*body.first()?), error))
}

fn parse_fd(body: &[u8]) -> Option<BlfFrame<'_>> {
    let (flags, code) = (*body.get(2)?, *body.get(3)?);
    let (id, extended) = split_identifier(u32_at(body, 4)?);
    let (fd, len) = (*body.get(13)?, *body.get(14)?);
    let bytes = body.get(20..)?.get(..usize::from(len.min(64)))?;
    let shape = match fd & 1 {
        0 => CanRecord::Frame(classic_frame(id, extended, flags & REMOTE != 0, code, bytes)),
        _ => CanRecord::Fd { id, extended, flags: fd >> 1 & 3 },
    };
    Some(BlfFrame::new(u16_at(body, 0)?, flags & SENT != 0, shape, bytes))
}

fn parse_fd_64(body: &[u8]) -> Option<BlfFrame<'_>> {
    let (channel, code, len) = (*body.first()?, *body.get(1)?, *body.get(2)?);
    let (id, extended) = split_identifier(u32_at(body, 4)?);
    let flags = u32_at(body, 12)?;
    let sent = *body.get(34)? == 1;
    // Zeros at the end of the data need not be stored.
    let stored = body.get(40..)?;
    let len = usize::from(len).min(FD_MAX);
    let bytes = &stored[..stored.len().min(len)];
    let shape = match flags >> 12 & 1 {
        0 => CanRecord::Frame(classic_frame(id, extended, flags & 0x10 != 0, code, bytes)),
        _ => CanRecord::Fd { id, extended, flags: (flags >> 13 & 3) as u8 },
    };
    Some(BlfFrame { len, ..BlfFrame::new(u16::from(channel), sent, shape, bytes) })
}

fn split_identifier(word: u32) -> (u32, bool) {
    (word & ID_MASK, word & EXTENDED_FLAG != 0)
}

/// `can0` for Vector's channel 1.
fn link_name(channel: u16, name: &mut [u8; 16]) -> &str {
    use std::io::Write as _;
    let mut rest = &mut name[..];
    // Sixteen bytes hold every such name.
    let _ = write!(rest, "can{}", channel.saturating_sub(1));
    let left = rest.len();
    ascii_text(&name[..16 - left])
}

/// Announced unpacked size of a container, if it is possible and permitted.
fn checked_size(packed: &[u8], size: u32) -> Option<usize> {
    let size = size as usize;
    // Deflate packs no better than 1,032 to 1: a larger stated size is a bomb.
    (size <= CONTAINER_MAX && size <= packed.len() * RATIO_MAX).then_some(size)
}

/// Unpacks an object of `size` bytes. False if it has another size, or the bytes are damaged.
fn inflate(packed: &[u8], size: u32, plain: &mut Vec<u8>) -> bool {
    let Some(size) = checked_size(packed, size) else { return false };
    let mut inflater = Decompress::new(true);
    let before = plain.len();
    // Whatever is in it, no more than that comes out.
    debug_assert!(size <= CONTAINER_MAX);
    plain.resize(before + size, 0);
    let status = inflater.decompress(packed, &mut plain[before..], FlushDecompress::Finish);
    let came = inflater.total_out() as usize;
    plain.truncate(before + came);
    matches!(status, Ok(Status::StreamEnd)) && came == size
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}
