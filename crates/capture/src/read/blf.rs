//! BLF, the binary log of Vector's tools: a header, then objects; most stand in compressed
//! containers, and one may begin in a container and end in the next.

use flate2::{Decompress, FlushDecompress, Status};
use polepair_core::explain::Direction;

use super::{BLOCK_MAX, Bad, Damage, Place, Source, Taker};
use crate::date;
use crate::record::{EXTENDED_FLAG, ErrorFrame, ID_MASK, Record, Shape, classic};
use crate::stamp::Stamp;

/// Every object begins with these.
pub(crate) const SIGNATURE: &[u8; 4] = b"LOBJ";
/// Bytes of an object's first header: signature, its size, version, the object's size, its kind.
pub(crate) const OBJECT_HEAD: usize = 16;
/// Bytes of the header behind the first: flags, client, version, time.
pub(crate) const TIME_HEAD: usize = 16;
/// Bytes of a container's header behind the first.
pub(crate) const CONTAINER_HEAD: usize = 16;
/// Bytes of a file's header, if it does not say so itself.
pub(crate) const FILE_HEAD: usize = 144;
/// Where the file's header holds the time of its beginning.
pub(crate) const BEGIN_AT: usize = 40;
/// Bytes that a container may unpack to: a hundred times what those are that are written.
const CONTAINER_MAX: usize = 1 << 24;
/// DEFLATE makes no more than so many bytes of one.
const RATIO_MAX: usize = 1032;
/// Bytes between objects that are padding, and no damage.
const PADDING_MAX: usize = 8;

/// Kinds of objects.
pub(crate) mod kind {
    pub(crate) const MESSAGE: u32 = 1;
    pub(crate) const CONTAINER: u32 = 10;
    pub(crate) const ERROR: u32 = 2;
    pub(crate) const ERROR_EXT: u32 = 73;
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

/// The reader of such files.
#[derive(Debug, Default)]
pub(super) struct Blf {
    begin: Option<Stamp>,
    /// Bytes of the file taken so far.
    taken: u64,
    /// Unpacked bytes of an object that goes on in the next container.
    tail: Vec<u8>,
    lost: bool,
    /// Containers are not unpacked, but what they say that they unpack to is added up.
    weighs: Option<u64>,
}

/// What the containers of a file unpack to, by their own word, which is held to when they are unpacked.
pub(super) fn weight(bytes: &[u8]) -> u64 {
    let mut blf = Blf { weighs: Some(0), ..Blf::default() };
    blf.read(bytes, true, &mut Nobody);
    blf.weighs.unwrap_or(0)
}

/// Takes nothing.
struct Nobody;

impl Taker for Nobody {
    fn record(&mut self, _: &Record<'_>) {}
    fn damage(&mut self, _: Damage) {}
}

/// The first header of an object.
#[derive(Clone, Copy)]
struct Head {
    head: usize,
    version: u16,
    size: usize,
    kind: u32,
}

impl Head {
    fn read(bytes: &[u8]) -> Option<Self> {
        let version = u16_at(bytes, 6)?;
        let head = usize::from(u16_at(bytes, 4)?);
        let (size, kind) = (u32_at(bytes, 8)? as usize, u32_at(bytes, 12)?);
        let sound = bytes.starts_with(SIGNATURE) && head >= OBJECT_HEAD && size >= head;
        (sound && size <= BLOCK_MAX).then_some(Self { head, version, size, kind })
    }
}

impl Source for Blf {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize {
        let mut used = 0;
        if self.begin.is_none() {
            match self.open(bytes) {
                Some(count) => used = count,
                None if ended => {
                    self.damage("the file's header is cut off or damaged", taker);
                    return bytes.len();
                }
                None => return 0,
            }
            self.taken = used as u64;
        }
        while let Some(step) = self.object(&bytes[used..], ended, taker) {
            used += step;
            self.taken += step as u64;
        }
        if ended && !self.tail.is_empty() {
            self.tail.clear();
            self.damage("the last object is cut off", taker);
        }
        used
    }
}

impl Blf {
    /// Takes the file's header. One that tells no time counts from 0.
    fn open(&mut self, bytes: &[u8]) -> Option<usize> {
        let size = (u32_at(bytes, 4)? as usize).clamp(BEGIN_AT + 16, 4096);
        let header = bytes.get(..size)?;
        let word = |n: usize| u16_at(header, BEGIN_AT + 2 * n).unwrap_or(0);
        let (date, time) = ([word(0), word(1), word(3)], [word(4), word(5), word(6)]);
        let begin = date::moment(date, time, u32::from(word(7).min(999)) * 1_000_000);
        self.begin = Some(begin.unwrap_or(Stamp(0)));
        Some(size)
    }

    /// Takes one object of the file, or what is lost; `None` when more bytes are needed.
    fn object(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> Option<usize> {
        if bytes.len() < OBJECT_HEAD {
            return self.end(bytes, ended, taker);
        }
        let Some(head) = Head::read(bytes) else { return Some(self.skip(bytes, taker)) };
        let Some(object) = bytes.get(..head.size) else { return self.end(bytes, ended, taker) };
        self.lost = false;
        match head.kind {
            kind::CONTAINER => self.container(&object[head.head..], taker),
            _ => self.event(object, head, taker),
        }
        Some(head.size)
    }

    /// Passes over padding, or over what is no object, to where the next may begin.
    fn skip(&mut self, bytes: &[u8], taker: &mut dyn Taker) -> usize {
        let next = memchr::memmem::find(&bytes[1..], SIGNATURE).map(|at| at + 1);
        let padding = next.is_some_and(|at| at < PADDING_MAX) && !bytes.starts_with(SIGNATURE);
        if !padding && !core::mem::replace(&mut self.lost, true) {
            self.damage("the object's header is damaged", taker);
        }
        next.unwrap_or(bytes.len() - SIGNATURE.len() + 1)
    }

    fn end(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> Option<usize> {
        if !ended || bytes.is_empty() {
            return None;
        }
        // What is shorter than a signature may be padding.
        if !self.lost && bytes.len() >= SIGNATURE.len() {
            self.damage("the last object is cut off", taker);
            self.rescue(bytes, taker);
        }
        Some(bytes.len())
    }

    /// What a container that is cut off still holds.
    fn rescue(&mut self, bytes: &[u8], taker: &mut dyn Taker) {
        if let Some(head) = Head::read(bytes).filter(|head| head.kind == kind::CONTAINER) {
            let rest = bytes.get(head.head..).unwrap_or_default();
            self.unpack(rest, taker);
            self.tail.clear();
        }
    }

    fn container(&mut self, body: &[u8], taker: &mut dyn Taker) {
        if !self.unpack(body, taker) {
            self.damage("the container cannot be unpacked to its end", taker);
            self.tail.clear();
        }
    }

    /// Unpacks a container and takes the objects that are whole. False when it is damaged.
    fn unpack(&mut self, body: &[u8], taker: &mut dyn Taker) -> bool {
        let (Some(method), Some(size)) = (u16_at(body, 0), u32_at(body, 8)) else { return false };
        let packed = body.get(CONTAINER_HEAD..).unwrap_or_default();
        let mut plain = core::mem::take(&mut self.tail);
        let whole = match method {
            0 => {
                plain.extend_from_slice(packed);
                true
            }
            DEFLATE => match &mut self.weighs {
                Some(weight) => {
                    *weight += unpacked(packed, size).unwrap_or(0) as u64;
                    return true;
                }
                None => inflate(packed, size, &mut plain),
            },
            _ => false,
        };
        let used = self.objects(&plain, taker);
        plain.drain(..used);
        self.tail = plain;
        whole
    }

    /// Takes the whole objects of an unpacked container.
    fn objects(&mut self, bytes: &[u8], taker: &mut dyn Taker) -> usize {
        let mut used = 0;
        loop {
            let rest = &bytes[used..];
            if rest.len() < OBJECT_HEAD {
                return used;
            }
            let Some(head) = Head::read(rest) else {
                used += self.skip(rest, taker);
                continue;
            };
            let Some(object) = rest.get(..head.size) else { return used };
            self.lost = false;
            self.event(object, head, taker);
            used += head.size;
        }
    }

    fn event(&self, object: &[u8], head: Head, taker: &mut dyn Taker) {
        let Some(shape) = kind_of(head.kind) else { return };
        let body = object.get(head.head..).unwrap_or_default();
        match self.time(object, head).zip(shape(body)) {
            Some((time, Found { channel, sent, shape, bytes })) => {
                let mut name = [0; 16];
                let link = link(channel, &mut name);
                let direction = sent.map(|sent| match sent {
                    true => Direction::ToDrive,
                    false => Direction::ToHost,
                });
                taker.record(&Record {
                    time: Some(time),
                    link,
                    direction,
                    data: shape.with(bytes),
                    at: self.taken,
                });
            }
            None => self.damage("the object is shorter than its kind", taker),
        }
    }

    fn time(&self, object: &[u8], head: Head) -> Option<Stamp> {
        let flags = u32_at(object, OBJECT_HEAD)?;
        if !matches!(head.version, 1 | 2) {
            return None;
        }
        let ticks = u64::from_le_bytes(*object.get(OBJECT_HEAD + 8..)?.first_chunk()?);
        let ns = if flags == TENS_OF_MICROSECONDS { ticks.checked_mul(10_000)? } else { ticks };
        Some(Stamp(self.begin?.0.checked_add(ns)?))
    }

    fn damage(&self, reason: &'static str, taker: &mut dyn Taker) {
        taker.damage(Damage { place: Place::Byte(self.taken), reason: Bad(reason) });
    }
}

/// What an object says.
struct Found<'a> {
    channel: u16,
    sent: Option<bool>,
    shape: Shape,
    bytes: &'a [u8],
}

type Parse = fn(&[u8]) -> Option<Found<'_>>;

/// How an object of that kind is read; `None` for what is no traffic.
fn kind_of(kind: u32) -> Option<Parse> {
    match kind {
        kind::MESSAGE | kind::MESSAGE_2 => Some(message),
        kind::ERROR | kind::ERROR_EXT => Some(error),
        kind::FD => Some(fd),
        kind::FD_64 => Some(fd_64),
        _ => None,
    }
}

fn message(body: &[u8]) -> Option<Found<'_>> {
    let (flags, len) = (*body.get(2)?, *body.get(3)?);
    let bytes = body.get(8..16)?;
    let (id, extended) = identifier(u32_at(body, 4)?);
    let shape = Shape::Frame(classic(id, extended, flags & REMOTE != 0, len, bytes));
    Some(Found { channel: u16_at(body, 0)?, sent: Some(flags & SENT != 0), shape, bytes })
}

fn error(body: &[u8]) -> Option<Found<'_>> {
    let error = ErrorFrame { class: ErrorFrame::BUS_ERROR, ..ErrorFrame::default() };
    Some(Found { channel: u16_at(body, 0)?, sent: None, shape: Shape::Error(error), bytes: &[] })
}

fn fd(body: &[u8]) -> Option<Found<'_>> {
    let (flags, code) = (*body.get(2)?, *body.get(3)?);
    let (id, extended) = identifier(u32_at(body, 4)?);
    let (fd, len) = (*body.get(13)?, *body.get(14)?);
    let bytes = body.get(20..)?.get(..usize::from(len.min(64)))?;
    let shape = match fd & 1 {
        0 => Shape::Frame(classic(id, extended, flags & REMOTE != 0, code, bytes)),
        _ => Shape::Fd { id, extended, flags: fd >> 1 & 3 },
    };
    Some(Found { channel: u16_at(body, 0)?, sent: Some(flags & SENT != 0), shape, bytes })
}

fn fd_64(body: &[u8]) -> Option<Found<'_>> {
    let (channel, code, len) = (*body.first()?, *body.get(1)?, *body.get(2)?);
    let (id, extended) = identifier(u32_at(body, 4)?);
    let flags = u32_at(body, 12)?;
    let sent = *body.get(34)? == 1;
    let bytes = body.get(40..)?.get(..usize::from(len.min(64)))?;
    let shape = match flags >> 12 & 1 {
        0 => Shape::Frame(classic(id, extended, flags & 0x10 != 0, code, bytes)),
        _ => Shape::Fd { id, extended, flags: (flags >> 13 & 3) as u8 },
    };
    Some(Found { channel: u16::from(channel), sent: Some(sent), shape, bytes })
}

fn identifier(word: u32) -> (u32, bool) {
    (word & ID_MASK, word & EXTENDED_FLAG != 0)
}

/// `can0` for Vector's channel 1.
fn link(channel: u16, name: &mut [u8; 16]) -> &str {
    use std::io::Write as _;
    let mut rest = &mut name[..];
    // Sixteen bytes hold every such name.
    let _ = write!(rest, "can{}", channel.saturating_sub(1));
    let left = rest.len();
    std::str::from_utf8(&name[..16 - left]).unwrap_or_default()
}

/// The bytes that a container says it unpacks to, where that can be and is let.
fn unpacked(packed: &[u8], size: u32) -> Option<usize> {
    let size = size as usize;
    (size <= CONTAINER_MAX && size <= packed.len() * RATIO_MAX).then_some(size)
}

/// Unpacks what is `size` bytes long. False when it is not, or the bytes are damaged.
fn inflate(packed: &[u8], size: u32, plain: &mut Vec<u8>) -> bool {
    let Some(size) = unpacked(packed, size) else { return false };
    let mut inflater = Decompress::new(true);
    let before = plain.len();
    // Whatever is in it, no more than that comes out.
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
