//! EMCY: start and end of a node's fault (CiA 301, 7.2.7).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// An emergency.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Emergency {
    /// Error code; 0 when all errors are gone.
    pub code: u16,
    /// Object 1001h; 0 in the short form.
    pub register: u8,
    /// The manufacturer's own; zeros in the short form.
    pub vendor: [u8; 5],
}

impl Emergency {
    /// The frame of `node`, as the standard has it.
    #[must_use]
    pub fn emit(self, node: u8) -> Frame {
        let [low, high] = self.code.to_le_bytes();
        let [a, b, c, d, e] = self.vendor;
        Frame::standard(Self::id(node), &[low, high, self.register, a, b, c, d, e])
    }

    /// The frame of `node` with the code alone, as the TS drive sends it (manual, 3.5.2).
    #[must_use]
    pub fn emit_short(self, node: u8) -> Frame {
        Frame::standard(Self::id(node), &self.code.to_le_bytes())
    }

    fn id(node: u8) -> u16 {
        cob::EMCY | u16::from(node)
    }

    /// Reads the data of a frame in either form.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: neither two bytes nor eight.
    pub const fn parse(data: &[u8]) -> Result<Self, WireError> {
        match *data {
            [low, high] => {
                Ok(Self { code: u16::from_le_bytes([low, high]), register: 0, vendor: [0; 5] })
            }
            [low, high, register, a, b, c, d, e] => Ok(Self {
                code: u16::from_le_bytes([low, high]),
                register,
                vendor: [a, b, c, d, e],
            }),
            _ => Err(super::wrong_length(8, data)),
        }
    }
}

/// The standard's text for the upper byte of a code, the most specific one (CiA 301, table 26). Drives with
/// codes of their own (the TS) mean something else.
#[must_use]
pub const fn class_text(code: u16) -> &'static str {
    match (code >> 8) as u8 {
        0x00 => "no error",
        0x10 => "generic error",
        0x20 => "current",
        0x21 => "current, input side",
        0x22 => "current inside the device",
        0x23 => "current, output side",
        0x30 => "voltage",
        0x31 => "mains voltage",
        0x32 => "voltage inside the device",
        0x33 => "output voltage",
        0x40 => "temperature",
        0x41 => "ambient temperature",
        0x42 => "device temperature",
        0x50 => "device hardware",
        0x60 => "device software",
        0x61 => "internal software",
        0x62 => "user software",
        0x63 => "data set",
        0x70 => "additional modules",
        0x80 => "monitoring",
        0x81 => "communication",
        0x82 => "protocol error",
        0x90 => "external error",
        0xF0 => "additional functions",
        0xFF => "device specific",
        _ => "unknown class",
    }
}
