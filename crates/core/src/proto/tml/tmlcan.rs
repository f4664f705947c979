//! TMLCAN: TML on CAN with 29-bit identifiers (TML communication manual, chapter 4).
//!
//! ```text
//! bit  28 … 22         21  20 … 13  12 … 10  9  8 … 0
//!      opcode 15 … 9   G   ID       0 0 0    H  opcode 8 … 0
//! ```
//! The data are the instruction's data words, low byte first. Nothing is added and nothing lost.

use super::wire::{IdCode, Instruction, Message};
use crate::error::WireError;
use crate::medium::Frame;

/// Identifier bits that are zero in every message: 12 to 10, and what a 29-bit identifier lacks.
const ZEROS: u32 = 0xE000_1C00;

/// The frame that carries a message.
#[must_use]
#[inline]
pub fn encode(message: &Message) -> Frame {
    let Message { to, instruction } = message;
    let opcode = u32::from(instruction.opcode);
    let id = (opcode & 0xFE00) << 13
        | u32::from(to.group) << 21
        | u32::from(to.id) << 13
        | u32::from(to.host) << 9
        | opcode & 0x1FF;
    debug_assert_eq!(id & ZEROS, 0);
    let data = instruction.packed().to_le_bytes();
    Frame { id, extended: true, remote: false, len: 2 * instruction.word_count() as u8, data }
}

/// Reads the message that a frame carries.
///
/// # Errors
/// [`WireError::Identifier`] for 11 bits, a remote request or bits that must be zero;
/// [`WireError::Count`] for an odd number of data bytes.
#[inline]
pub fn decode(frame: &Frame) -> Result<Message, WireError> {
    if !frame.extended || frame.remote || frame.id & ZEROS != 0 {
        return Err(WireError::Identifier { found: frame.id });
    }
    let opcode = (frame.id >> 13 & 0xFE00 | frame.id & 0x1FF) as u16;
    let to = IdCode {
        group: frame.id >> 21 & 1 != 0,
        id: (frame.id >> 13) as u8,
        host: frame.id >> 9 & 1 != 0,
    };
    let words = u64::from_le_bytes(frame.data);
    let instruction = Instruction::from_packed(opcode, words, word_count(frame.len)?);
    Ok(Message { to, instruction })
}

/// Data words in `len` bytes of a frame.
#[inline]
pub(super) const fn word_count(len: u8) -> Result<usize, WireError> {
    if !len.is_multiple_of(2) || len > 8 {
        return Err(WireError::Count { at: 0, found: len as u16 });
    }
    Ok(len as usize / 2)
}
