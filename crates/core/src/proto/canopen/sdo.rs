//! Service data: one object read or written, in eight bytes, in segments of seven, or in blocks of
//! up to 127 such segments (CiA 301, 7.2.4).
//!
//! ```text
//! byte 0             1  2     3          4 … 7
//!      specifier     index    sub-index  data, or size
//! ```
//! Bits that the standard reserves do not count.

use crate::error::WireError;
use crate::medium::Frame;

use super::cob;

/// Bytes that a segment carries.
pub const SEGMENT: usize = 7;
/// Segments that a block has at most.
pub const BLOCK_MAX: u8 = 127;

/// One entry of a node's dictionary.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct ObjectIndex {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl ObjectIndex {
    /// The object of that index and sub-index.
    #[must_use]
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

/// Up to four bytes that lie in the first frame itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ExpeditedData {
    /// The bytes, the first one lowest.
    pub bits: u32,
    /// Number of bytes, 1 to 4; 0 when the frame does not state it.
    pub len: u8,
}

impl ExpeditedData {
    /// The bytes; all four if the frame does not state their number.
    #[must_use]
    pub const fn bytes(&self) -> ([u8; 4], usize) {
        let len = if self.len == 0 { 4 } else { self.len as usize };
        (self.bits.to_le_bytes(), len)
    }
}

/// Up to seven bytes of a longer value.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Segment {
    /// Alternates from one segment to the next, beginning with false.
    pub toggle: bool,
    /// None follows.
    pub last: bool,
    /// Number of valid bytes.
    pub len: u8,
    /// The bytes.
    pub data: [u8; SEGMENT],
}

impl Segment {
    /// The bytes that count.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.len).min(SEGMENT)]
    }
}

/// A segment of a block. Only the earlier frames show whether a frame is one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BlockSegment {
    /// 1 to 127 within the block.
    pub number: u8,
    /// None follows.
    pub last: bool,
    /// The bytes; the end of the transfer states how many of the last ones are valid.
    pub data: [u8; SEGMENT],
}

impl BlockSegment {
    /// Reads the eight bytes.
    #[inline]
    #[must_use]
    pub const fn of([head, a, b, c, d, e, f, g]: [u8; 8]) -> Self {
        Self { number: head & 0x7F, last: head & 0x80 != 0, data: [a, b, c, d, e, f, g] }
    }

    /// The eight bytes.
    #[inline]
    #[must_use]
    pub const fn bytes(self) -> [u8; 8] {
        let [a, b, c, d, e, f, g] = self.data;
        [self.number & 0x7F | (self.last as u8) << 7, a, b, c, d, e, f, g]
    }
}

/// From the client, the host.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SdoRequest {
    /// Write up to four bytes.
    Write(ObjectIndex, ExpeditedData),
    /// Write what follows in segments; the size, if known.
    WriteLong(ObjectIndex, Option<u32>),
    /// Part of a write.
    WriteSegment(Segment),
    /// Read.
    Read(ObjectIndex),
    /// Requests the next part of a read; toggle.
    ReadSegment(bool),
    /// Write what follows in blocks.
    WriteBlock {
        /// Object to write.
        object: ObjectIndex,
        /// The client can compute the check.
        crc: bool,
        /// Size, if known.
        size: Option<u32>,
    },
    /// All blocks are written.
    WriteBlockEnd {
        /// Bytes of the last segment that do not count.
        unused: u8,
        /// The check over everything, if both can compute it.
        crc: u16,
    },
    /// Read in blocks.
    ReadBlock {
        /// Object to read.
        object: ObjectIndex,
        /// The client can compute the check.
        crc: bool,
        /// Segments of a block, 1 to 127.
        segments: u8,
        /// The server may answer as to [`SdoRequest::Read`] when there are no more bytes than this; 0 is
        /// never.
        threshold: u8,
    },
    /// Begin with the first block.
    ReadBlockStart,
    /// Acknowledges segments of this block that arrived in order.
    ReadBlockAck {
        /// The last one that did; 0 is none.
        arrived: u8,
        /// Segments of the next block.
        segments: u8,
    },
    /// Everything arrived and the check agrees.
    ReadBlockEnd,
    /// The transfer is over.
    Abort(ObjectIndex, AbortCode),
    /// None that the standard has.
    Other(u8),
}

/// From the server, the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SdoReply {
    /// Written, or ready for segments. The last four bytes are reserved; the TS repeats the data.
    Written(ObjectIndex, u32),
    /// A segment was taken; toggle.
    WrittenSegment(bool),
    /// The value, up to four bytes.
    Value(ObjectIndex, ExpeditedData),
    /// The value follows in segments; the size, if known.
    ValueLong(ObjectIndex, Option<u32>),
    /// Part of a read.
    ValueSegment(Segment),
    /// Ready for blocks.
    WriteBlockReady {
        /// Written object.
        object: ObjectIndex,
        /// The server can compute the check.
        crc: bool,
        /// Segments of a block, 1 to 127.
        segments: u8,
    },
    /// Acknowledges segments of this block that arrived in order.
    WriteBlockAck {
        /// The last one that did; 0 is none.
        arrived: u8,
        /// Segments of the next block.
        segments: u8,
    },
    /// Everything arrived and the check agrees.
    WriteBlockDone,
    /// The value follows in blocks.
    ReadBlockReady {
        /// Read object.
        object: ObjectIndex,
        /// The server can compute the check.
        crc: bool,
        /// Size, if known.
        size: Option<u32>,
    },
    /// All blocks are sent.
    ReadBlockEnd {
        /// Bytes of the last segment that do not count.
        unused: u8,
        /// The check over everything, if both can compute it.
        crc: u16,
    },
    /// The transfer is over.
    Abort(ObjectIndex, AbortCode),
    /// None that the standard has.
    Other(u8),
}

impl SdoRequest {
    /// Reads eight bytes of which [`BlockSegment`]s were sorted out.
    #[inline]
    #[must_use]
    pub const fn of(bytes: [u8; 8]) -> Self {
        let word = FrameWord(u64::from_le_bytes(bytes));
        let head = bytes[0];
        match head >> 5 {
            0 => Self::WriteSegment(word.segment()),
            1 if head & 2 != 0 => Self::Write(word.object(), word.expedited_data()),
            1 => Self::WriteLong(word.object(), word.size(head & 1 != 0)),
            2 => Self::Read(word.object()),
            3 => Self::ReadSegment(word.toggle()),
            4 => Self::Abort(word.object(), AbortCode(word.upper())),
            5 => match head & 3 {
                0 => Self::ReadBlock {
                    object: word.object(),
                    crc: head & 4 != 0,
                    segments: bytes[4],
                    threshold: bytes[5],
                },
                1 => Self::ReadBlockEnd,
                2 => Self::ReadBlockAck { arrived: bytes[1], segments: bytes[2] },
                _ => Self::ReadBlockStart,
            },
            6 if head & 1 == 0 => Self::WriteBlock {
                object: word.object(),
                crc: head & 4 != 0,
                size: word.size(head & 2 != 0),
            },
            6 => Self::WriteBlockEnd { unused: head >> 2 & 7, crc: word.crc() },
            _ => Self::Other(head),
        }
    }

    /// The eight bytes.
    #[inline(always)] // With a known variant only a shift or two remain.
    #[must_use]
    pub const fn bytes(self) -> [u8; 8] {
        let word = match self {
            Self::Write(object, short) => FrameWord::with_data(0x22, object, short),
            Self::WriteLong(object, size) => FrameWord::with_size(0x20, 1, object, size),
            Self::WriteSegment(segment) => return segment_bytes(segment),
            Self::Read(object) => FrameWord::new(0x40, object, 0),
            Self::ReadSegment(toggle) => FrameWord(0x60 | (toggle as u64) << 4),
            Self::WriteBlock { object, crc, size } => {
                FrameWord::with_size(0xC0 | (crc as u8) << 2, 2, object, size)
            }
            Self::WriteBlockEnd { unused, crc } => FrameWord::block_end(unused, crc),
            Self::ReadBlock { object, crc, segments, threshold } => {
                let upper = segments as u32 | (threshold as u32) << 8;
                FrameWord::new(0xA0 | (crc as u8) << 2, object, upper)
            }
            Self::ReadBlockStart => FrameWord(0xA3),
            Self::ReadBlockAck { arrived, segments } => FrameWord::block_ack(arrived, segments),
            Self::ReadBlockEnd => FrameWord(0xA1),
            Self::Abort(object, abort) => FrameWord::new(0x80, object, abort.0),
            Self::Other(head) => FrameWord(head as u64),
        };
        word.0.to_le_bytes()
    }

    /// The frame to `node`.
    #[inline]
    #[must_use]
    pub const fn emit(self, node: u8) -> Frame {
        frame(cob::SDO_REQUEST, node, self.bytes())
    }

    /// The object that it concerns, if it names one.
    #[must_use]
    pub const fn object(self) -> Option<ObjectIndex> {
        match self {
            Self::Write(object, _)
            | Self::WriteLong(object, _)
            | Self::Read(object)
            | Self::WriteBlock { object, .. }
            | Self::ReadBlock { object, .. }
            | Self::Abort(object, _) => Some(object),
            _ => None,
        }
    }
}

impl SdoReply {
    /// Reads eight bytes of which [`BlockSegment`]s were sorted out.
    #[inline]
    #[must_use]
    pub const fn of(bytes: [u8; 8]) -> Self {
        let word = FrameWord(u64::from_le_bytes(bytes));
        let head = bytes[0];
        match head >> 5 {
            0 => Self::ValueSegment(word.segment()),
            1 => Self::WrittenSegment(word.toggle()),
            2 if head & 2 != 0 => Self::Value(word.object(), word.expedited_data()),
            2 => Self::ValueLong(word.object(), word.size(head & 1 != 0)),
            3 => Self::Written(word.object(), word.upper()),
            4 => Self::Abort(word.object(), AbortCode(word.upper())),
            5 => match head & 3 {
                0 => Self::WriteBlockReady {
                    object: word.object(),
                    crc: head & 4 != 0,
                    segments: bytes[4],
                },
                1 => Self::WriteBlockDone,
                2 => Self::WriteBlockAck { arrived: bytes[1], segments: bytes[2] },
                _ => Self::Other(head),
            },
            6 if head & 1 == 0 => Self::ReadBlockReady {
                object: word.object(),
                crc: head & 4 != 0,
                size: word.size(head & 2 != 0),
            },
            6 => Self::ReadBlockEnd { unused: head >> 2 & 7, crc: word.crc() },
            _ => Self::Other(head),
        }
    }

    /// The eight bytes.
    #[inline(always)] // With a known variant only a shift or two remain.
    #[must_use]
    pub const fn bytes(self) -> [u8; 8] {
        let word = match self {
            Self::Written(object, echo) => FrameWord::new(0x60, object, echo),
            Self::WrittenSegment(toggle) => FrameWord(0x20 | (toggle as u64) << 4),
            Self::Value(object, short) => FrameWord::with_data(0x42, object, short),
            Self::ValueLong(object, size) => FrameWord::with_size(0x40, 1, object, size),
            Self::ValueSegment(segment) => return segment_bytes(segment),
            Self::WriteBlockReady { object, crc, segments } => {
                FrameWord::new(0xA0 | (crc as u8) << 2, object, segments as u32)
            }
            Self::WriteBlockAck { arrived, segments } => FrameWord::block_ack(arrived, segments),
            Self::WriteBlockDone => FrameWord(0xA1),
            Self::ReadBlockReady { object, crc, size } => {
                FrameWord::with_size(0xC0 | (crc as u8) << 2, 2, object, size)
            }
            Self::ReadBlockEnd { unused, crc } => FrameWord::block_end(unused, crc),
            Self::Abort(object, abort) => FrameWord::new(0x80, object, abort.0),
            Self::Other(head) => FrameWord(head as u64),
        };
        word.0.to_le_bytes()
    }

    /// The frame from `node`.
    #[inline]
    #[must_use]
    pub const fn emit(self, node: u8) -> Frame {
        frame(cob::SDO_REPLY, node, self.bytes())
    }

    /// The object that it concerns, if it names one.
    #[must_use]
    pub const fn object(self) -> Option<ObjectIndex> {
        match self {
            Self::Written(object, _)
            | Self::Value(object, _)
            | Self::ValueLong(object, _)
            | Self::WriteBlockReady { object, .. }
            | Self::ReadBlockReady { object, .. }
            | Self::Abort(object, _) => Some(object),
            _ => None,
        }
    }
}

/// The value in `reply`, if it is the complete reply to a [`SdoRequest::Read`]. Both are compared as numbers,
/// because nearly every reply is of this kind.
#[inline]
#[must_use]
pub const fn read_answer(request: [u8; 8], reply: [u8; 8]) -> Option<(ObjectIndex, ExpeditedData)> {
    let (frame_word, statement) =
        (FrameWord(u64::from_le_bytes(request)), FrameWord(u64::from_le_bytes(reply)));
    // Specifier 2 with the bit for data in the frame itself, and the very object.
    let wanted = frame_word.0 as u32 | 0x02;
    if statement.0 as u32 & 0xFFFF_FFE2 == wanted {
        Some((statement.object(), statement.expedited_data()))
    } else {
        None
    }
}

/// The eight bytes that `data` must be.
///
/// # Errors
/// [`WireError::Short`]: the standard has no shorter one. A [`Frame`] holds zeros behind its data,
/// so who is lenient takes its eight bytes as they are.
pub fn as_eight_bytes(data: &[u8]) -> Result<[u8; 8], WireError> {
    data.try_into().map_err(|_| super::wrong_length(8, data))
}

/// Eight bytes as one number: a load, shifts, a store.
#[derive(Clone, Copy)]
struct FrameWord(u64);

impl FrameWord {
    #[inline]
    const fn new(head: u8, object: ObjectIndex, upper: u32) -> Self {
        let multiplexer = (object.index as u64) << 8 | (object.sub as u64) << 24;
        Self(head as u64 | multiplexer | (upper as u64) << 32)
    }

    /// Bit `flag` of `head` is set if there is a size.
    #[inline]
    const fn with_size(head: u8, flag: u8, object: ObjectIndex, size: Option<u32>) -> Self {
        match size {
            Some(size) => Self::new(head | flag, object, size),
            None => Self::new(head, object, 0),
        }
    }

    #[inline]
    const fn with_data(head: u8, object: ObjectIndex, short: ExpeditedData) -> Self {
        let size = match short.len {
            1..=4 => (4 - short.len) << 2 | 1,
            _ => 0,
        };
        Self::new(head | size, object, short.bits)
    }

    const fn block_ack(arrived: u8, segments: u8) -> Self {
        Self(0xA2 | (arrived as u64) << 8 | (segments as u64) << 16)
    }

    const fn block_end(unused: u8, crc: u16) -> Self {
        Self(0xC1 | (unused as u64 & 7) << 2 | (crc as u64) << 8)
    }

    #[inline]
    const fn object(self) -> ObjectIndex {
        ObjectIndex { index: (self.0 >> 8) as u16, sub: (self.0 >> 24) as u8 }
    }

    #[inline]
    const fn upper(self) -> u32 {
        (self.0 >> 32) as u32
    }

    #[inline]
    const fn expedited_data(self) -> ExpeditedData {
        let head = self.0 as u8;
        let len = if head & 1 != 0 { 4 - (head >> 2 & 3) } else { 0 };
        ExpeditedData { bits: self.upper(), len }
    }

    const fn size(self, indicated: bool) -> Option<u32> {
        if indicated { Some(self.upper()) } else { None }
    }

    const fn toggle(self) -> bool {
        self.0 & 0x10 != 0
    }

    const fn crc(self) -> u16 {
        (self.0 >> 8) as u16
    }

    const fn segment(self) -> Segment {
        let [head, a, b, c, d, e, f, g] = self.0.to_le_bytes();
        Segment {
            toggle: self.toggle(),
            last: head & 1 != 0,
            len: SEGMENT as u8 - (head >> 1 & 7),
            data: [a, b, c, d, e, f, g],
        }
    }
}

const fn segment_bytes(segment: Segment) -> [u8; 8] {
    let Segment { toggle, last, len, data: [a, b, c, d, e, f, g] } = segment;
    let unused = SEGMENT as u8 - if len > SEGMENT as u8 { SEGMENT as u8 } else { len };
    [(toggle as u8) << 4 | unused << 1 | last as u8, a, b, c, d, e, f, g]
}

#[inline]
const fn frame(function: u16, node: u8, data: [u8; 8]) -> Frame {
    Frame { id: (function | node as u16) as u32, extended: false, remote: false, len: 8, data }
}

/// Check sum of a block transfer: x¹⁶ + x¹² + x⁵ + 1 from 0 (CiA 301, 7.2.4.3.16). Start with `crc` 0; for
/// data in pieces, continue with the result of the piece before.
#[must_use]
pub const fn crc(mut crc: u16, data: &[u8]) -> u16 {
    let mut at = 0;
    while at < data.len() {
        crc = crc << 8 ^ CRC[((crc >> 8) as u8 ^ data[at]) as usize];
        at += 1;
    }
    crc
}

const CRC: [u16; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x8000 != 0 { crc << 1 ^ 0x1021 } else { crc << 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// Reason why a transfer was aborted.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct AbortCode(pub u32);

impl AbortCode {
    /// Toggle bit not alternated.
    pub const TOGGLE: Self = Self(0x0503_0000);
    /// SDO protocol timed out.
    pub const TIMEOUT: Self = Self(0x0504_0000);
    /// Specifier not valid or unknown.
    pub const SPECIFIER: Self = Self(0x0504_0001);
    /// Invalid block size.
    pub const BLOCK_SIZE: Self = Self(0x0504_0002);
    /// Invalid sequence number.
    pub const SEQUENCE: Self = Self(0x0504_0003);
    /// CRC error.
    pub const CRC: Self = Self(0x0504_0004);
    /// Out of memory.
    pub const MEMORY: Self = Self(0x0504_0005);
    /// Unsupported access to an object.
    pub const ACCESS: Self = Self(0x0601_0000);
    /// Attempt to read a write-only object.
    pub const WRITE_ONLY: Self = Self(0x0601_0001);
    /// Attempt to write a read-only object.
    pub const READ_ONLY: Self = Self(0x0601_0002);
    /// Object does not exist.
    pub const NO_OBJECT: Self = Self(0x0602_0000);
    /// Object cannot be mapped to the PDO.
    pub const NOT_MAPPABLE: Self = Self(0x0604_0041);
    /// The mapped objects would exceed the PDO.
    pub const PDO_LENGTH: Self = Self(0x0604_0042);
    /// General parameter incompatibility.
    pub const INCOMPATIBLE: Self = Self(0x0604_0043);
    /// General internal incompatibility.
    pub const INTERNAL: Self = Self(0x0604_0047);
    /// Access failed due to a hardware error.
    pub const HARDWARE: Self = Self(0x0606_0000);
    /// Length does not match.
    pub const LENGTH: Self = Self(0x0607_0010);
    /// Length too high.
    pub const TOO_LONG: Self = Self(0x0607_0012);
    /// Length too low.
    pub const TOO_SHORT: Self = Self(0x0607_0013);
    /// Sub-index does not exist.
    pub const NO_SUB: Self = Self(0x0609_0011);
    /// Invalid value.
    pub const VALUE: Self = Self(0x0609_0030);
    /// Value too high.
    pub const TOO_HIGH: Self = Self(0x0609_0031);
    /// Value too low.
    pub const TOO_LOW: Self = Self(0x0609_0032);
    /// Maximum less than minimum.
    pub const MIN_MAX: Self = Self(0x0609_0036);
    /// Resource not available.
    pub const RESOURCE: Self = Self(0x060A_0023);
    /// General error.
    pub const GENERAL: Self = Self(0x0800_0000);
    /// Data cannot be transferred or stored.
    pub const NOT_STORED: Self = Self(0x0800_0020);
    /// Refused because of local control.
    pub const LOCAL: Self = Self(0x0800_0021);
    /// Refused because of the present device state.
    pub const STATE: Self = Self(0x0800_0022);
    /// No object dictionary is there.
    pub const NO_DICTIONARY: Self = Self(0x0800_0023);
    /// No data available.
    pub const NO_DATA: Self = Self(0x0800_0024);

    /// Meaning (CiA 301, table 22); `None` for a code that the standard does not have.
    #[must_use]
    pub const fn text(self) -> Option<&'static str> {
        Some(match self {
            Self::TOGGLE => "toggle bit not alternated",
            Self::TIMEOUT => "SDO protocol timed out",
            Self::SPECIFIER => "command specifier not valid or unknown",
            Self::BLOCK_SIZE => "invalid block size",
            Self::SEQUENCE => "invalid sequence number",
            Self::CRC => "CRC error",
            Self::MEMORY => "out of memory",
            Self::ACCESS => "unsupported access to an object",
            Self::WRITE_ONLY => "attempt to read a write-only object",
            Self::READ_ONLY => "attempt to write a read-only object",
            Self::NO_OBJECT => "object does not exist",
            Self::NOT_MAPPABLE => "object cannot be mapped to the PDO",
            Self::PDO_LENGTH => "the mapped objects would exceed the PDO's length",
            Self::INCOMPATIBLE => "parameters do not fit together",
            Self::INTERNAL => "incompatible inside the device",
            Self::HARDWARE => "access failed due to a hardware error",
            Self::LENGTH => "data type does not match: wrong length",
            Self::TOO_LONG => "data type does not match: too long",
            Self::TOO_SHORT => "data type does not match: too short",
            Self::NO_SUB => "sub-index does not exist",
            Self::VALUE => "invalid value",
            Self::TOO_HIGH => "value too high",
            Self::TOO_LOW => "value too low",
            Self::MIN_MAX => "maximum is less than minimum",
            Self::RESOURCE => "resource not available: no SDO connection",
            Self::GENERAL => "general error",
            Self::NOT_STORED => "data cannot be transferred or stored",
            Self::LOCAL => "data cannot be transferred or stored: local control",
            Self::STATE => "data cannot be transferred or stored in the present device state",
            Self::NO_DICTIONARY => "no object dictionary is present",
            Self::NO_DATA => "no data available",
            _ => return None,
        })
    }
}
