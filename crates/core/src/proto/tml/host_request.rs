//! Requests of a host, and whether they are answered.
//!
//! Sources: TML communication manual, chapter 3 (messages of type A, B and C); the vendor's help pages for
//! the shorter requests.

use super::host::{SCIBR_OPCODE, baud_of_code};
use super::online::OnlineMessage;
use super::rules::is_request;
use super::wire::{IdCode, Instruction, Message};
use crate::explain::Effect;
use crate::profile::Profile;
use crate::station::{LineChange, RequestClass};

/// Address of the ID code to which a drive sends by itself (both firmware families).
pub const MASTERID: u16 = 0x0927;
/// The low status register: it is read when only the fact of a reply counts.
pub const SRL: u16 = 0x090E;

/// A request on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostRequest {
    /// Message and addressee. In requests the host fills in itself as the sender.
    pub message: Message,
    /// True if it may be sent again.
    pub class: RequestClass,
    /// Confirmation.
    pub confirmation: Confirmation,
}

/// Confirmation of an instruction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Confirmation {
    /// Proof that the drive took it: its acknowledgement, or on wires without one a question behind
    /// it. An assignment is read back.
    Proof,
    /// Nothing: it is done when it is sent, or acknowledged where the wire does so. For the points
    /// of a stream, which prove themselves by their counter.
    None,
    /// [`Proof`](Self::Proof) with MASTERID set first, because the drive will send unsolicited messages.
    MasterFirst,
}

/// A drive's reply, after the host's checks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// An instruction was taken; the value that it assigned, zero if none. To a group, or without
    /// proof: it was sent.
    Accepted(u32),
    /// A value of one or two words.
    Value {
        /// Address of the value.
        address: u16,
        /// 32 bits, or the 16 of a word.
        value: u32,
        /// True for 32 bits.
        long: bool,
    },
    /// The firmware's name: `514L`.
    Version([u8; 4]),
    /// A question to a group has ended; number of axes that replied.
    GroupAnswered(u8),
}

impl HostRequest {
    /// An instruction with the class that its opcode has by itself.
    #[must_use]
    pub const fn of(message: Message) -> Self {
        Self { message, class: class_of(&message.instruction), confirmation: Confirmation::Proof }
    }

    /// Held to another class.
    #[must_use]
    pub const fn with_class(mut self, class: RequestClass) -> Self {
        self.class = class;
        self
    }

    /// With something else than proof.
    #[must_use]
    pub const fn with_confirmation(mut self, with: Confirmation) -> Self {
        self.confirmation = with;
        self
    }
}

impl crate::station::Request for HostRequest {
    /// A variable that the motor follows counts as motion, by its profile.
    fn effect(&self, profile: &'static Profile) -> Effect {
        let instruction = &self.message.instruction;
        let assigned = assigned_variable(instruction).map(|(address, ..)| address);
        let written = assigned.or(masked_variable(instruction).map(|(address, ..)| address));
        let known = written.and_then(|a| profile.parameters.iter().find(|p| p.index == a));
        let by_class = Effect::from_class(self.class);
        match known {
            Some(_) if self.class != RequestClass::Stop => {
                by_class.combine(Effect::from_write(known))
            }
            _ => by_class,
        }
    }

    fn class(&self) -> RequestClass {
        self.class
    }

    fn line_change(&self) -> Option<LineChange> {
        let instruction = &self.message.instruction;
        Some(match instruction.opcode {
            SCIBR_OPCODE => LineChange::Baud(baud_of_code(instruction.word(0))),
            // SCIBR and CANBR of a variable, and AXISID, ADDGRID and REMGRID in both forms.
            0x0920 => LineChange::Baud(None),
            0x0804 | 0x0904 => LineChange::BitRate,
            0x0801 | 0x0901 | 0x0840 | 0x0940 | 0x0880 | 0x0980 => LineChange::Address,
            _ => return None,
        })
    }
}

/// Class of an instruction, which decides its treatment if its execution is unknown.
pub(super) const fn class_of(instruction: &Instruction) -> RequestClass {
    match instruction.opcode {
        // AXISOFF, STOP, STOP0 to STOP2; END and ABORT, so that no program goes on to move it.
        0x0001 | 0x1C02 | 0x0002 | 0x0104 | 0x0144 | 0x0184 | 0x01C4 => RequestClass::Stop,
        0x0000 => RequestClass::Idempotent,
        opcode if is_request(opcode) => RequestClass::Idempotent,
        opcode => match assigned_variable(instruction) {
            Some((address, ..)) if !is_reference(address) => RequestClass::ReadBack,
            _ if opcode & 0xFC00 == 0x5800 || opcode == 0x5C00 => RequestClass::ReadBack,
            _ => RequestClass::NoRetry,
        },
    }
}

/// Variables that the motor follows as soon as they are written: external and test references.
const fn is_reference(address: u16) -> bool {
    matches!(
        address,
        0x022F | 0x0232 | 0x0281 | 0x0282 | 0x02A8 | 0x02A9 | 0x02AE | 0x02AF | 0x0312
    )
}

/// Address, value and width of the variable that an instruction assigns at once.
#[must_use]
pub(super) const fn assigned_variable(instruction: &Instruction) -> Option<(u16, u32, bool)> {
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

/// Address, AND mask and OR mask of an instruction that changes a variable's bits (`SRB`, `SRBL`).
#[must_use]
pub(super) const fn masked_variable(instruction: &Instruction) -> Option<(u16, u16, u16)> {
    let opcode = instruction.opcode;
    let page = if opcode & 0x0200 == 0 { 0x0200 } else { 0x0800 };
    match opcode & 0xFC00 {
        0x5800 => Some((page | opcode & 0x1FF, instruction.word(0), instruction.word(1))),
        0x5C00 if opcode == 0x5C00 => {
            Some((instruction.word(0), instruction.word(1), instruction.word(2)))
        }
        _ => None,
    }
}

/// The instruction that assigns a word or a long to a variable in data memory, the shortest form.
#[must_use]
pub const fn assign_instruction(address: u16, value: u32, long: bool) -> Instruction {
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

/// Question in an instruction, if it is one.
pub(super) fn query_of(instruction: &Instruction) -> Option<OnlineMessage> {
    OnlineMessage::parse(instruction).filter(OnlineMessage::is_request)
}

/// True for a question that several axes may answer.
pub(super) const fn is_group_query(question: &OnlineMessage) -> bool {
    matches!(question, OnlineMessage::GiveMeData2 { .. } | OnlineMessage::Ping { .. })
}

/// Tag that distinguishes a question's reply from others of the same axis: the address, or one that no variable has.
pub(super) const fn answer_tag(question: &OnlineMessage) -> u16 {
    match question {
        OnlineMessage::GiveMeData { cell, .. } | OnlineMessage::GiveMeData2 { cell, .. } => {
            cell.address
        }
        OnlineMessage::GetData { address, .. } => *address,
        OnlineMessage::GetVersion { .. } => 0xFFFF,
        OnlineMessage::GetChecksum { .. } => 0xFFFE,
        _ => 0xFFFD,
    }
}

/// Answer in a message.
pub(super) const fn answer_of(message: &OnlineMessage) -> Option<Answer> {
    Some(match *message {
        OnlineMessage::TakeData { cell, value, .. } => {
            Answer::Value { address: cell.address, value, long: cell.long }
        }
        OnlineMessage::TakeData2 { address, value, long, .. }
        | OnlineMessage::GotData { address, value, long, .. } => {
            Answer::Value { address, value, long }
        }
        OnlineMessage::TakeVersion { version } | OnlineMessage::Pong { version, .. } => {
            Answer::Version(version)
        }
        OnlineMessage::TakeChecksum { sum, .. } => {
            Answer::Value { address: 0, value: sum as u32, long: false }
        }
        _ => return None,
    })
}

/// A request with the sender's ID code in its place.
pub(super) fn with_sender(instruction: &Instruction, own: IdCode) -> Instruction {
    let mut words = instruction.padded();
    words[0] = own.word();
    let count = instruction.data().len().max(1);
    Instruction::new(instruction.opcode, &words[..count]).unwrap_or(*instruction)
}
