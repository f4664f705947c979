//! What a host is asked to say, and what of it is answered.
//!
//! Sources: TML communication manual, chapter 3 (messages of type A, B and C); the vendor's help
//! pages for the shorter requests.

use super::online::Online;
use super::rules::is_request;
use super::wire::{IdCode, Instruction, Message};
use crate::station::Class;

/// Where a drive keeps the ID code of whom it speaks to unasked (both firmware families).
pub const MASTERID: u16 = 0x0927;
/// The low status register: what a drive is asked for when only its answer counts.
pub const SRL: u16 = 0x090E;

/// Something to be said on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ask {
    /// What is said, and to whom. In requests the host fills in the sender: itself.
    pub message: Message,
    /// Whether it may be sent again.
    pub class: Class,
    /// What comes with it.
    pub with: With,
}

/// What comes with an instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum With {
    /// Proof that the drive took it: its acknowledgement, or on wires without one a question behind
    /// it. An assignment is read back.
    Proof,
    /// Nothing: it is done when it is sent, or acknowledged where the wire does so. For the points
    /// of a stream, which prove themselves by their counter.
    Nothing,
    /// As [`Proof`](Self::Proof), but MASTERID is set first, because the drive will speak unasked.
    Master,
}

/// What a drive says, after the host's checks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// An instruction was taken; the value that it assigned, zero if none. To a group, or without
    /// proof: it was sent.
    Taken(u32),
    /// A value of so many words.
    Value {
        /// Where it was read.
        address: u16,
        /// 32 bits, or the 16 of a word.
        value: u32,
        /// It has 32 bits.
        long: bool,
    },
    /// The firmware's name: `514L`.
    Version([u8; 4]),
    /// A question to a group is over; so many axes answered.
    Gathered(u8),
}

impl Ask {
    /// An instruction with the class that its opcode has by itself.
    #[must_use]
    pub const fn of(message: Message) -> Self {
        Self { message, class: class(&message.instruction), with: With::Proof }
    }

    /// Held to another class.
    #[must_use]
    pub const fn held_to(mut self, class: Class) -> Self {
        self.class = class;
        self
    }

    /// With something else than proof.
    #[must_use]
    pub const fn with(mut self, with: With) -> Self {
        self.with = with;
        self
    }
}

impl crate::station::Request for Ask {
    fn class(&self) -> Class {
        self.class
    }
}

/// What may be done with an instruction whose fate is unknown.
pub(super) const fn class(instruction: &Instruction) -> Class {
    match instruction.opcode {
        // AXISOFF, STOP, STOP0 to STOP2; END and ABORT, so that no program goes on to move it.
        0x0001 | 0x1C02 | 0x0002 | 0x0104 | 0x0144 | 0x0184 | 0x01C4 => Class::Stop,
        0x0000 => Class::Idempotent,
        opcode if is_request(opcode) => Class::Idempotent,
        opcode => match assigned(instruction) {
            Some((address, ..)) if !moves(address) => Class::Confirm,
            _ if opcode & 0xFC00 == 0x5800 || opcode == 0x5C00 => Class::Confirm,
            _ => Class::Never,
        },
    }
}

/// Variables that the motor follows as soon as they are written: external and test references.
const fn moves(address: u16) -> bool {
    matches!(
        address,
        0x022F | 0x0232 | 0x0281 | 0x0282 | 0x02A8 | 0x02A9 | 0x02AE | 0x02AF | 0x0312
    )
}

/// Address, value and width of what an instruction assigns to a variable at once.
#[must_use]
pub(super) const fn assigned(instruction: &Instruction) -> Option<(u16, u32, bool)> {
    let opcode = instruction.opcode;
    let page = if opcode & 0x0200 == 0 { 0x0200 } else { 0x0800 };
    let short = page | opcode & 0x1FF;
    match opcode & 0xFC00 {
        0x2000 => Some((short, instruction.word(0) as u32, false)),
        0x2400 => Some((short, instruction.long(0), true)),
        _ => match opcode {
            0x9004 => Some((instruction.word(0), instruction.word(1) as u32, false)),
            0x9005 => Some((instruction.word(0), instruction.long(1), true)),
            _ => None,
        },
    }
}

/// The instruction that assigns a word or a long to a variable in data memory, the shortest form.
#[must_use]
pub const fn assignment(address: u16, value: u32, long: bool) -> Instruction {
    let short = match address {
        0x0200..=0x03FF => Some(0x2000),
        0x0800..=0x09FF => Some(0x2200),
        _ => None,
    };
    let [low, high] = super::wire::low_first(value);
    match (short, long) {
        (Some(base), false) => Instruction::of(base | address & 0x1FF, [low]),
        (Some(base), true) => Instruction::of(base | 0x0400 | address & 0x1FF, [low, high]),
        (None, false) => Instruction::of(0x9004, [address, low]),
        (None, true) => Instruction::of(0x9005, [address, low, high]),
    }
}

/// GiveMeData for a variable in data memory; the host fills in the sender.
#[must_use]
pub const fn give_me_data(address: u16, long: bool) -> Instruction {
    Instruction::of(if long { 0xB005 } else { 0xB004 }, [0, address])
}

/// What an instruction asks, if it does.
pub(super) fn question(instruction: &Instruction) -> Option<Online> {
    Online::parse(instruction).filter(Online::is_request)
}

/// True for a question that several axes may answer.
pub(super) const fn gathers(question: &Online) -> bool {
    matches!(question, Online::GiveMeData2 { .. } | Online::Ping { .. })
}

/// What tells a question's answer from others' of the same axis: the address, or one that no
/// variable has.
pub(super) const fn tag(question: &Online) -> u16 {
    match question {
        Online::GiveMeData { cell, .. } | Online::GiveMeData2 { cell, .. } => cell.address,
        Online::GetData { address, .. } => *address,
        Online::GetVersion { .. } => 0xFFFF,
        Online::GetChecksum { .. } => 0xFFFE,
        _ => 0xFFFD,
    }
}

/// What an answer says.
pub(super) const fn answer(said: &Online) -> Option<Answer> {
    Some(match *said {
        Online::TakeData { cell, value, .. } => {
            Answer::Value { address: cell.address, value, long: cell.long }
        }
        Online::TakeData2 { address, value, long, .. }
        | Online::GotData { address, value, long, .. } => Answer::Value { address, value, long },
        Online::TakeVersion { version } | Online::Pong { version, .. } => Answer::Version(version),
        Online::TakeChecksum { sum, .. } => {
            Answer::Value { address: 0, value: sum as u32, long: false }
        }
        _ => return None,
    })
}

/// A request with the sender's ID code in its place.
pub(super) fn signed(instruction: &Instruction, own: IdCode) -> Instruction {
    let mut words = instruction.padded();
    words[0] = own.word();
    let count = instruction.data().len().max(1);
    Instruction::new(instruction.opcode, &words[..count]).unwrap_or(*instruction)
}
