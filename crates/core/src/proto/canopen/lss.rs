//! Layer setting services: node-ID and bit rate by the four numbers of object 1018h (CiA 305).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// One of the four numbers that name a device, in the order of object 1018h.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum IdentityNumber {
    /// Vendor-ID, sub-index 1.
    Vendor,
    /// Product code, sub-index 2.
    Product,
    /// Revision number, sub-index 3.
    Revision,
    /// Serial number, sub-index 4.
    Serial,
}

impl IdentityNumber {
    /// All of them, in order.
    pub const ALL: [Self; 4] = [Self::Vendor, Self::Product, Self::Revision, Self::Serial];

    /// The one of that place, the upper six bits left out.
    const fn from_place(index: u8) -> Self {
        Self::ALL[(index & 3) as usize]
    }
}

/// A number of the identification, or a bound of one, as the identify service names them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum IdentifyBound {
    /// Vendor-ID.
    Vendor,
    /// Product code.
    Product,
    /// Least revision.
    RevisionLow,
    /// Greatest revision.
    RevisionHigh,
    /// Least serial number.
    SerialLow,
    /// Greatest serial number; a node that matches all six bounds replies.
    SerialHigh,
}

const BOUNDS: [IdentifyBound; 6] = [
    IdentifyBound::Vendor,
    IdentifyBound::Product,
    IdentifyBound::RevisionLow,
    IdentifyBound::RevisionHigh,
    IdentifyBound::SerialLow,
    IdentifyBound::SerialHigh,
];

/// From the master.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LssRequest {
    /// All devices: true to configuration, false back to waiting.
    SwitchGlobal(bool),
    /// The device of these four numbers to configuration; the last one is answered.
    SwitchSelective(IdentityNumber, u32),
    /// Take that node-ID; 255 is none.
    SetNode(u8),
    /// Take that bit rate: table, index.
    SetBitTiming(u8, u8),
    /// Activates the set bit rate: silence before and after, ms.
    ActivateBitTiming(u16),
    /// Keep node-ID and bit rate over power-off.
    Store,
    /// Reads a number.
    Inquire(IdentityNumber),
    /// Reads the node-ID.
    InquireNode,
    /// Nodes that match all bounds reply.
    Identify(IdentifyBound, u32),
    /// Nodes without node-ID reply.
    IdentifyUnconfigured,
    /// Nodes without node-ID that match in the bits from `bit` up reply.
    FastScan {
        /// The number so far.
        number: u32,
        /// Lowest bit that counts, 31 to 0; 128 begins anew.
        bit: u8,
        /// Number of the identity that is compared.
        sub: IdentityNumber,
        /// Number of the identity that follows.
        next: IdentityNumber,
    },
    /// None that the standard has.
    Other(u8),
}

/// From a device.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LssReply {
    /// The node with these four numbers is in configuration now.
    Selected,
    /// Answer to [`LssRequest::SetNode`]: 0 is done, else the error and the maker's own.
    SetNode(u8, u8),
    /// Answer to [`LssRequest::SetBitTiming`].
    SetBitTiming(u8, u8),
    /// Answer to [`LssRequest::Store`].
    Store(u8, u8),
    /// A number.
    Number(IdentityNumber, u32),
    /// The node-ID.
    Node(u8),
    /// The node fits, or agrees.
    Identified,
    /// The node has no node-ID.
    Unconfigured,
    /// None that the standard has.
    Other(u8),
}

/// Bit rates of the standard's table 0, by index, in kbit/s; 0 where none is.
pub const KBIT_PER_S: [u16; 10] = [1000, 800, 500, 250, 125, 0, 50, 20, 10, 0];

/// [`LssRequest::FastScan`]'s bit for a new scan: all nodes without node-ID reply.
pub const FAST_SCAN_BEGIN: u8 = 128;

impl LssRequest {
    /// The eight bytes.
    #[must_use]
    pub fn bytes(self) -> [u8; 8] {
        match self {
            Self::SwitchGlobal(on) => two_byte_body(0x04, [on.into(), 0]),
            Self::SwitchSelective(number, value) => value_body(0x40 + number as u8, value),
            Self::SetNode(node) => two_byte_body(0x11, [node, 0]),
            Self::SetBitTiming(table, index) => two_byte_body(0x13, [table, index]),
            Self::ActivateBitTiming(ms) => two_byte_body(0x15, ms.to_le_bytes()),
            Self::Store => two_byte_body(0x17, [0; 2]),
            Self::Inquire(number) => two_byte_body(0x5A + number as u8, [0; 2]),
            Self::InquireNode => two_byte_body(0x5E, [0; 2]),
            Self::Identify(bound, value) => value_body(0x46 + bound as u8, value),
            Self::IdentifyUnconfigured => two_byte_body(0x4C, [0; 2]),
            Self::FastScan { number, bit, sub, next } => {
                let [_, a, b, c, d, ..] = value_body(0x51, number);
                [0x51, a, b, c, d, bit, sub as u8, next as u8]
            }
            Self::Other(specifier) => two_byte_body(specifier, [0; 2]),
        }
    }

    /// The frame.
    #[must_use]
    pub fn emit(self) -> Frame {
        Frame::standard(cob::LSS_REQUEST, &self.bytes())
    }

    /// Reads the data of a frame.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: eight bytes are all.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let bytes @ [specifier, a, b, ..] = as_eight_bytes(data)?;
        Ok(match specifier {
            0x04 => Self::SwitchGlobal(a != 0),
            0x40..=0x43 => {
                Self::SwitchSelective(IdentityNumber::from_place(specifier), value_of_body(bytes))
            }
            0x11 => Self::SetNode(a),
            0x13 => Self::SetBitTiming(a, b),
            0x15 => Self::ActivateBitTiming(u16::from_le_bytes([a, b])),
            0x17 => Self::Store,
            0x5A..=0x5D => Self::Inquire(IdentityNumber::from_place(specifier - 0x5A)),
            0x5E => Self::InquireNode,
            0x46..=0x4B => {
                Self::Identify(BOUNDS[usize::from(specifier - 0x46)], value_of_body(bytes))
            }
            0x4C => Self::IdentifyUnconfigured,
            0x51 => Self::FastScan {
                number: value_of_body(bytes),
                bit: bytes[5],
                sub: IdentityNumber::from_place(bytes[6]),
                next: IdentityNumber::from_place(bytes[7]),
            },
            other => Self::Other(other),
        })
    }
}

impl LssReply {
    /// The eight bytes.
    #[must_use]
    pub fn bytes(self) -> [u8; 8] {
        match self {
            Self::Selected => two_byte_body(0x44, [0; 2]),
            Self::SetNode(error, own) => two_byte_body(0x11, [error, own]),
            Self::SetBitTiming(error, own) => two_byte_body(0x13, [error, own]),
            Self::Store(error, own) => two_byte_body(0x17, [error, own]),
            Self::Number(number, value) => value_body(0x5A + number as u8, value),
            Self::Node(node) => two_byte_body(0x5E, [node, 0]),
            Self::Identified => two_byte_body(0x4F, [0; 2]),
            Self::Unconfigured => two_byte_body(0x50, [0; 2]),
            Self::Other(specifier) => two_byte_body(specifier, [0; 2]),
        }
    }

    /// The frame.
    #[must_use]
    pub fn emit(self) -> Frame {
        Frame::standard(cob::LSS_REPLY, &self.bytes())
    }

    /// Reads the data of a frame.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: eight bytes are all.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let bytes @ [specifier, a, b, ..] = as_eight_bytes(data)?;
        Ok(match specifier {
            0x44 => Self::Selected,
            0x11 => Self::SetNode(a, b),
            0x13 => Self::SetBitTiming(a, b),
            0x17 => Self::Store(a, b),
            0x5A..=0x5D => {
                Self::Number(IdentityNumber::from_place(specifier - 0x5A), value_of_body(bytes))
            }
            0x5E => Self::Node(a),
            0x4F => Self::Identified,
            0x50 => Self::Unconfigured,
            other => Self::Other(other),
        })
    }
}

const fn two_byte_body(specifier: u8, [a, b]: [u8; 2]) -> [u8; 8] {
    [specifier, a, b, 0, 0, 0, 0, 0]
}

const fn value_body(specifier: u8, value: u32) -> [u8; 8] {
    let [a, b, c, d] = value.to_le_bytes();
    [specifier, a, b, c, d, 0, 0, 0]
}

const fn value_of_body([_, a, b, c, d, ..]: [u8; 8]) -> u32 {
    u32::from_le_bytes([a, b, c, d])
}

fn as_eight_bytes(data: &[u8]) -> Result<[u8; 8], WireError> {
    data.try_into().map_err(|_| super::wrong_length(8, data))
}
