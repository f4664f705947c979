//! The position of a message's parts in the frame of each encapsulation.

use crate::error::WireError;
use crate::medium::Frame;
use crate::proto::tml::serial;
use crate::proto::tml::technocan::{self, MessageClass};
use crate::proto::tml::tmlcan;
use crate::proto::tml::wire::{DATA_WORDS_MAX, IdCode, Instruction, Message};

/// First byte and the byte after the last; equal for a field of the identifier.
pub(super) type ByteRange = (u16, u16);

const IN_IDENTIFIER: ByteRange = (0, 0);

/// A message with the places of its parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParsedFrame {
    /// Addressee, if the frame has one.
    pub to: Option<IdCode>,
    /// Sender, if TechnoCAN has it outside the instruction.
    pub sender: Option<u8>,
    /// TechnoCAN's class.
    pub class: Option<MessageClass>,
    /// TakeData with the sender's identifier, as the manual prints it.
    pub misprinted: bool,
    /// The instruction.
    pub instruction: Instruction,
    /// The length byte.
    pub length: Option<u8>,
    /// The ID code.
    pub id_code_range: ByteRange,
    /// The opcode, or the part of it in the data.
    pub opcode_range: ByteRange,
    /// Data words.
    pub word_ranges: [ByteRange; DATA_WORDS_MAX],
    /// The checksum's place and value.
    pub checksum: Option<(u16, u8)>,
}

impl ParsedFrame {
    fn from_message(message: Message) -> Self {
        Self {
            to: Some(message.to),
            sender: None,
            class: None,
            misprinted: false,
            instruction: message.instruction,
            length: None,
            id_code_range: IN_IDENTIFIER,
            opcode_range: IN_IDENTIFIER,
            word_ranges: word_ranges_from(0),
            checksum: None,
        }
    }

    /// Byte range of `count` data words from `first` on.
    pub fn words_range(&self, first: usize, count: usize) -> ByteRange {
        let last = (first + count).clamp(1, DATA_WORDS_MAX) - 1;
        (self.word_ranges[first.min(DATA_WORDS_MAX - 1)].0, self.word_ranges[last].1)
    }
}

/// Words one behind the other from a byte on.
fn word_ranges_from(from: u16) -> [ByteRange; DATA_WORDS_MAX] {
    [word_range(0, from), word_range(1, from), word_range(2, from), word_range(3, from)]
}

fn word_range(n: u16, from: u16) -> (u16, u16) {
    (from + 2 * n, from + 2 * n + 2)
}

/// Parses a frame of a serial line. A frame whose sum alone is wrong is explained nevertheless.
pub(super) fn parse_serial(bytes: &[u8]) -> Result<ParsedFrame, (WireError, Option<ParsedFrame>)> {
    let locate = |message| ParsedFrame {
        length: bytes.first().copied(),
        id_code_range: (1, 3),
        opcode_range: (3, 5),
        word_ranges: word_ranges_from(5),
        checksum: bytes.split_last().map(|(sum, body)| (body.len() as u16, *sum)),
        ..ParsedFrame::from_message(message)
    };
    match serial::decode(bytes) {
        Ok(message) => Ok(locate(message)),
        Err(error @ WireError::Checksum { computed, .. }) => {
            let mut mended = [0; serial::FRAME_MAX];
            let body = &mut mended[..bytes.len()];
            body.copy_from_slice(bytes);
            body[bytes.len() - 1] = computed as u8;
            Err((error, serial::decode(body).ok().map(locate)))
        }
        Err(error) => Err((error, None)),
    }
}

/// A CAN frame with 29 bits.
pub(super) fn parse_tmlcan(frame: &Frame) -> Result<ParsedFrame, (WireError, Option<ParsedFrame>)> {
    tmlcan::decode(frame).map(ParsedFrame::from_message).map_err(|error| (error, None))
}

/// A CAN frame with 11 bits.
pub(super) fn parse_technocan(
    frame: &Frame,
) -> Result<ParsedFrame, (WireError, Option<ParsedFrame>)> {
    let content = technocan::decode(frame).map_err(|error| (error, None))?;
    let to = content.to.unwrap_or_default();
    let parsed = ParsedFrame {
        to: content.to,
        sender: content.sender,
        class: Some(content.class),
        misprinted: content.misprinted(),
        opcode_range: (0, 2),
        word_ranges: word_ranges_from(2),
        ..ParsedFrame::from_message(Message { to, instruction: content.instruction })
    };
    Ok(match content.class {
        MessageClass::Synchronisation => ParsedFrame { opcode_range: IN_IDENTIFIER, ..parsed },
        // Counter and time share the last two bytes.
        MessageClass::Pvt => {
            ParsedFrame { opcode_range: (7, 8), word_ranges: word_ranges_from(0), ..parsed }
        }
        // The sender's word shrank to bits of the second byte.
        MessageClass::TakeData => {
            let [_, a, b, c] = word_ranges_from(0);
            ParsedFrame { word_ranges: [(1, 2), a, b, c], ..parsed }
        }
        MessageClass::TakeData2 | MessageClass::Pong => {
            ParsedFrame { opcode_range: (0, 1), word_ranges: word_ranges_from(1), ..parsed }
        }
        _ => parsed,
    })
}
