//! One frame as a datagram: a MessagePack map with the fields of python-can's `Message`. python-can is the
//! only specification of the format. Keys have any order, and unknown keys are skipped.

use polepair_core::medium::Frame;

/// The longest datagram taken. One of a classic frame has 176 bytes at most, one of 64 bytes of
/// CAN FD 232.
pub const DATAGRAM_MAX: usize = 512;
/// Values that one datagram may hold, those of foreign keys counted.
const VALUES_MAX: usize = 256;

/// Content of a datagram.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum UnpackedDatagram {
    /// A frame.
    Frame(Frame),
    /// The report of an error on the wire.
    ErrorFrame,
}

/// Bytes between the values, in python-can's order: keys, and values that are alike in every classic frame.
const STAMP: &[u8; 12] = b"\x8B\xA9timestamp\xCB";
const ID: &[u8; 15] = b"\xAEarbitration_id";
const EXTENDED: &[u8; 15] = b"\xAEis_extended_id";
const REMOTE: &[u8; 16] = b"\xAFis_remote_frame";
const LENGTH: &[u8; 29] = b"\xAEis_error_frame\xC2\xA7channel\xC0\xA3dlc";
const DATA: &[u8; 6] = b"\xA4data\xC4";
const END: &[u8; 46] = b"\xA5is_fd\xC2\xAEbitrate_switch\xC2\xB5error_state_indicator\xC2";

/// Writes `frame` as sent at `wall_ns` (nanoseconds since 1970) and returns the length.
pub fn pack(frame: &Frame, wall_ns: u64, out: &mut [u8; DATAGRAM_MAX]) -> usize {
    let mut writer = MsgpackWriter { out, len: 0 };
    writer.push(STAMP);
    writer.push(&(wall_ns as f64 / 1e9).to_be_bytes());
    writer.push(ID);
    writer.push_unsigned(frame.id);
    writer.push(EXTENDED);
    writer.push(&[bool_byte(frame.extended)]);
    writer.push(REMOTE);
    writer.push(&[bool_byte(frame.remote)]);
    writer.push(LENGTH);
    writer.push(&[frame.len.min(8)]);
    writer.push(DATA);
    let data = if frame.remote { &[] } else { frame.bytes() };
    writer.push(&[data.len() as u8]);
    writer.push(data);
    writer.push(END);
    writer.len
}

const fn bool_byte(set: bool) -> u8 {
    0xC2 | set as u8
}

struct MsgpackWriter<'a> {
    out: &'a mut [u8; DATAGRAM_MAX],
    len: usize,
}

impl MsgpackWriter<'_> {
    fn push(&mut self, bytes: &[u8]) {
        self.out[self.len..self.len + bytes.len()].copy_from_slice(bytes);
        self.len += bytes.len();
    }

    /// Appends an integer in the shortest form, as python-can writes it.
    fn push_unsigned(&mut self, value: u32) {
        let bytes = value.to_be_bytes();
        match value {
            0..=0x7F => self.push(&bytes[3..]),
            0x80..=0xFF => self.push(&[0xCC, bytes[3]]),
            0x100..=0xFFFF => self.push(&[0xCD, bytes[2], bytes[3]]),
            _ => {
                self.push(&[0xCE]);
                self.push(&bytes);
            }
        }
    }
}

/// Reads a datagram. `None` when it is damaged, is something else, or carries what classic CAN
/// cannot (CAN FD).
#[must_use]
pub fn unpack(datagram: &[u8]) -> Option<UnpackedDatagram> {
    parse_usual(datagram).or_else(|| parse_any_order(datagram))?.validate()
}

/// Parses a datagram in the order and the forms in which python-can and this program write; otherwise `None`. Five
/// times as fast as a search for every key.
fn parse_usual(datagram: &[u8]) -> Option<MessageFields<'_>> {
    let rest = datagram.strip_prefix(STAMP)?.get(8..)?.strip_prefix(ID)?;
    let (id, rest) = match *rest {
        [id @ 0..=0x7F, ref rest @ ..] => (id.into(), rest),
        [0xCC, id, ref rest @ ..] => (id.into(), rest),
        [0xCD, high, low, ref rest @ ..] => (u16::from_be_bytes([high, low]).into(), rest),
        [0xCE, a, b, c, d, ref rest @ ..] => (u32::from_be_bytes([a, b, c, d]).into(), rest),
        _ => return None,
    };
    let (extended, rest) = parse_bool(rest.strip_prefix(EXTENDED)?)?;
    let (remote, rest) = parse_bool(rest.strip_prefix(REMOTE)?)?;
    let (&len, rest) = rest.strip_prefix(LENGTH)?.split_first()?;
    let (&count, rest) = rest.strip_prefix(DATA)?.split_first()?;
    let data = rest.strip_suffix(END)?;
    let usual = len <= 0x7F && data.len() == usize::from(count);
    let (id, len) = (Some(id), Some(len.into()));
    usual.then_some(MessageFields { id, extended, remote, error: false, fd: false, len, data })
}

fn parse_bool(bytes: &[u8]) -> Option<(bool, &[u8])> {
    let (&byte, rest) = bytes.split_first()?;
    (byte & !1 == 0xC2).then_some((byte == 0xC3, rest))
}

/// With keys in any order, some missing and others besides.
fn parse_any_order(datagram: &[u8]) -> Option<MessageFields<'_>> {
    let mut reader = MsgpackReader { rest: datagram, values: 0 };
    let MsgpackValue::Map(pairs) = reader.read_value()? else { return None };
    let mut fields = MessageFields::default();
    for _ in 0..pairs {
        let MsgpackValue::Text(key) = reader.read_value()? else { return None };
        let value = reader.read_value()?;
        if !fields.set_field(key, value)? {
            reader.skip(value)?;
        }
    }
    reader.rest.is_empty().then_some(fields)
}

/// Fields of the map, with python-can's defaults for missing ones.
struct MessageFields<'a> {
    id: Option<u64>,
    extended: bool,
    remote: bool,
    error: bool,
    fd: bool,
    len: Option<u64>,
    data: &'a [u8],
}

impl Default for MessageFields<'_> {
    fn default() -> Self {
        Self {
            id: None,
            extended: true,
            remote: false,
            error: false,
            fd: false,
            len: None,
            data: &[],
        }
    }
}

impl<'a> MessageFields<'a> {
    /// True when the key was one of ours, `None` when its value is not of the type it must have.
    fn set_field(&mut self, key: &[u8], value: MsgpackValue<'a>) -> Option<bool> {
        let position = match key {
            b"is_extended_id" => &mut self.extended,
            b"is_remote_frame" => &mut self.remote,
            b"is_error_frame" => &mut self.error,
            b"is_fd" => &mut self.fd,
            b"arbitration_id" => {
                self.id = Some(value.unsigned()?);
                return Some(true);
            }
            b"dlc" => {
                self.len = if value == MsgpackValue::Nil { None } else { Some(value.unsigned()?) };
                return Some(true);
            }
            b"data" => {
                self.data = value.bytes()?;
                return Some(true);
            }
            _ => return Some(false),
        };
        let MsgpackValue::Bool(set) = value else { return None };
        *position = set;
        Some(true)
    }

    fn validate(&self) -> Option<UnpackedDatagram> {
        if self.error {
            return Some(UnpackedDatagram::ErrorFrame);
        }
        let id = u32::try_from(self.id?).ok()?;
        let len = u8::try_from(self.len.unwrap_or(self.data.len() as u64)).ok()?;
        let highest = if self.extended { 0x1FFF_FFFF } else { 0x7FF };
        let data_len = if self.remote { 0 } else { usize::from(len) };
        if self.fd || id > highest || len > 8 || self.data.len() != data_len {
            return None;
        }
        let mut frame =
            Frame { id, extended: self.extended, remote: self.remote, len, data: [0; 8] };
        frame.data[..data_len].copy_from_slice(self.data);
        Some(UnpackedDatagram::Frame(frame))
    }
}

/// A value, or the head of one that holds others.
#[derive(Clone, Copy, PartialEq, Debug)]
enum MsgpackValue<'a> {
    Nil,
    Bool(bool),
    Unsigned(u64),
    Text(&'a [u8]),
    Binary(&'a [u8]),
    Array(usize),
    Map(usize),
    /// Negative and real numbers, and extensions: nothing that a frame needs.
    Other,
}

impl<'a> MsgpackValue<'a> {
    fn unsigned(self) -> Option<u64> {
        if let MsgpackValue::Unsigned(value) = self { Some(value) } else { None }
    }

    fn bytes(self) -> Option<&'a [u8]> {
        match self {
            MsgpackValue::Nil => Some(&[]),
            MsgpackValue::Binary(bytes) | MsgpackValue::Text(bytes) => Some(bytes),
            _ => None,
        }
    }
}

struct MsgpackReader<'a> {
    rest: &'a [u8],
    values: usize,
}

impl<'a> MsgpackReader<'a> {
    fn read_bytes(&mut self, len: usize) -> Option<&'a [u8]> {
        let (consumed, rest) = self.rest.split_at_checked(len)?;
        self.rest = rest;
        Some(consumed)
    }

    /// A big-endian number of `width` bytes.
    fn read_uint(&mut self, width: usize) -> Option<u64> {
        Some(self.read_bytes(width)?.iter().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
    }

    fn read_len(&mut self, width: usize) -> Option<usize> {
        usize::try_from(self.read_uint(width)?).ok()
    }

    fn read_value(&mut self) -> Option<MsgpackValue<'a>> {
        self.values += 1;
        if self.values > VALUES_MAX {
            return None;
        }
        let head = self.read_bytes(1)?[0];
        let low = usize::from(head);
        Some(match head {
            0x00..=0x7F => MsgpackValue::Unsigned(head.into()),
            0x80..=0x8F => MsgpackValue::Map(low & 0x0F),
            0x90..=0x9F => MsgpackValue::Array(low & 0x0F),
            0xA0..=0xBF => MsgpackValue::Text(self.read_bytes(low & 0x1F)?),
            0xC0 => MsgpackValue::Nil,
            0xC2 | 0xC3 => MsgpackValue::Bool(head == 0xC3),
            0xC4..=0xC6 => {
                let len = self.read_len(1 << (head - 0xC4))?;
                MsgpackValue::Binary(self.read_bytes(len)?)
            }
            0xCC..=0xCF => MsgpackValue::Unsigned(self.read_uint(1 << (head - 0xCC))?),
            0xD0..=0xD3 => signed_value(self.read_uint(1 << (head - 0xD0))?, 8 << (head - 0xD0)),
            0xD9..=0xDB => {
                let len = self.read_len(1 << (head - 0xD9))?;
                MsgpackValue::Text(self.read_bytes(len)?)
            }
            0xDC | 0xDD => MsgpackValue::Array(self.read_len(2 << (head - 0xDC))?),
            0xDE | 0xDF => MsgpackValue::Map(self.read_len(2 << (head - 0xDE))?),
            0xE0..=0xFF => MsgpackValue::Other,
            _ => {
                let len = self.opaque_len(head)?;
                self.read_bytes(len)?;
                MsgpackValue::Other
            }
        })
    }

    /// Length of a real number or an extension, its type included.
    fn opaque_len(&mut self, head: u8) -> Option<usize> {
        match head {
            0xC7..=0xC9 => self.read_len(1 << (head - 0xC7))?.checked_add(1),
            0xCA => Some(4),
            0xCB => Some(8),
            0xD4..=0xD8 => Some((1 << (head - 0xD4)) + 1),
            _ => None,
        }
    }

    /// Passes over what `item` holds.
    fn skip(&mut self, item: MsgpackValue<'_>) -> Option<()> {
        let mut left = child_count(item)?;
        while left > 0 {
            let item = self.read_value()?;
            left = (left - 1).checked_add(child_count(item)?)?;
        }
        Some(())
    }
}

fn child_count(item: MsgpackValue<'_>) -> Option<usize> {
    match item {
        MsgpackValue::Array(count) => Some(count),
        MsgpackValue::Map(count) => count.checked_mul(2),
        _ => Some(0),
    }
}

/// A signed integer of `bits` bits, if it is not negative.
fn signed_value<'a>(value: u64, bits: u32) -> MsgpackValue<'a> {
    if value >> (bits - 1) == 0 { MsgpackValue::Unsigned(value) } else { MsgpackValue::Other }
}
