//! Where in a frame of each encapsulation a message's parts stand.

use crate::error::WireError;
use crate::medium::Frame;
use crate::proto::tml::serial;
use crate::proto::tml::technocan::{self, Class};
use crate::proto::tml::tmlcan;
use crate::proto::tml::wire::{DATA_WORDS_MAX, IdCode, Instruction, Message};

/// First byte and the byte after the last; equal for what stands in the identifier.
pub(super) type Range = (u16, u16);

const IN_IDENTIFIER: Range = (0, 0);

/// A message with the places of its parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    /// Whom it is for, where the frame says so.
    pub to: Option<IdCode>,
    /// Who sent it, where TechnoCAN says so outside the instruction.
    pub sender: Option<u8>,
    /// TechnoCAN's class.
    pub class: Option<Class>,
    /// TakeData with the sender's identifier, as the manual prints it.
    pub misprinted: bool,
    /// What it says.
    pub instruction: Instruction,
    /// The length byte.
    pub length: Option<u8>,
    /// The ID code.
    pub code: Range,
    /// The opcode, or what is left of it.
    pub opcode: Range,
    /// Data words.
    pub words: [Range; DATA_WORDS_MAX],
    /// The checksum's place and value.
    pub sum: Option<(u16, u8)>,
}

impl Said {
    fn of(message: Message) -> Self {
        Self {
            to: Some(message.to),
            sender: None,
            class: None,
            misprinted: false,
            instruction: message.instruction,
            length: None,
            code: IN_IDENTIFIER,
            opcode: IN_IDENTIFIER,
            words: pairs(0),
            sum: None,
        }
    }

    /// The places of data words from `first` on, so many.
    pub fn span(&self, first: usize, count: usize) -> Range {
        let last = (first + count).clamp(1, DATA_WORDS_MAX) - 1;
        (self.words[first.min(DATA_WORDS_MAX - 1)].0, self.words[last].1)
    }
}

/// Words one behind the other from a byte on.
fn pairs(from: u16) -> [Range; DATA_WORDS_MAX] {
    let at = |n: u16| (from + 2 * n, from + 2 * n + 2);
    [at(0), at(1), at(2), at(3)]
}

/// A frame of a serial line. A frame whose sum alone is wrong says something all the same.
pub(super) fn serial(bytes: &[u8]) -> Result<Said, (WireError, Option<Said>)> {
    let place = |message| Said {
        length: bytes.first().copied(),
        code: (1, 3),
        opcode: (3, 5),
        words: pairs(5),
        sum: bytes.split_last().map(|(sum, body)| (body.len() as u16, *sum)),
        ..Said::of(message)
    };
    match serial::decode(bytes) {
        Ok(message) => Ok(place(message)),
        Err(error @ WireError::Checksum { computed, .. }) => {
            let mut mended = [0; serial::FRAME_MAX];
            let body = &mut mended[..bytes.len()];
            body.copy_from_slice(bytes);
            body[bytes.len() - 1] = computed as u8;
            Err((error, serial::decode(body).ok().map(place)))
        }
        Err(error) => Err((error, None)),
    }
}

/// A CAN frame with 29 bits.
pub(super) fn tmlcan(frame: &Frame) -> Result<Said, (WireError, Option<Said>)> {
    tmlcan::decode(frame).map(Said::of).map_err(|error| (error, None))
}

/// A CAN frame with 11 bits.
pub(super) fn technocan(frame: &Frame) -> Result<Said, (WireError, Option<Said>)> {
    let heard = technocan::decode(frame).map_err(|error| (error, None))?;
    let to = heard.to.unwrap_or_default();
    let said = Said {
        to: heard.to,
        sender: heard.sender,
        class: Some(heard.class),
        misprinted: heard.misprinted(),
        opcode: (0, 2),
        words: pairs(2),
        ..Said::of(Message { to, instruction: heard.instruction })
    };
    Ok(match heard.class {
        Class::Synchronisation => Said { opcode: IN_IDENTIFIER, ..said },
        // Counter and time share the last two bytes.
        Class::Pvt => Said { opcode: (7, 8), words: pairs(0), ..said },
        // The sender's word shrank to bits of the second byte.
        Class::TakeData => {
            let [_, a, b, c] = pairs(0);
            Said { words: [(1, 2), a, b, c], ..said }
        }
        Class::TakeData2 | Class::Pong => Said { opcode: (0, 1), words: pairs(1), ..said },
        _ => said,
    })
}
