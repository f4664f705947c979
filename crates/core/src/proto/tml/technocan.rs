//! TechnoCAN: TML on CAN with 11-bit identifiers that CANopen leaves free (TML communication manual,
//! chapter 5).
//!
//! ```text
//! 001…01F  Group            opcode, up to three data words, all low byte first; id = group mask
//! 020      Synchronisation  nothing
//! 041…05F  PVT              a PVT point in eight bytes; id + axis
//! 101…11F  TakeData2        VT and P bits, data words; id + axis that sends, not whom it is for
//! 121…13F  Normal           as Group; id + axis
//! 141…15F  Host             as Group; id + axis that has the host on its RS-232 port
//! 161…17F  TakeData         opcode 9…0, the sender's axis and H in two bytes, data words; id + axis
//! 200      Broadcast        as Group
//! ```
//! Axis IDs are 1 to 31: 255, the drives' default, acts as 31, others above 31 as what remains
//! modulo 32. A multiple of 32 has no identifier: 100, TakeData2 of axis 0, is CANopen's TIME.

use super::rules::Rule;
use super::tmlcan::{low_bytes_first, words};
use super::wire::{IdCode, Instruction, Message};
use crate::error::WireError;
use crate::medium::Frame;

/// The highest axis ID that has identifiers of its own.
pub const AXIS_MAX: u8 = 31;
/// Groups 1 to 5 have a bit in the identifier.
pub const GROUPS: u8 = 0x1F;
/// Data words of a message other than PVT and TakeData.
pub const WORDS_MAX: usize = 3;

const SYNCHRONISATION: u16 = 0x020;
const BROADCAST: u16 = 0x200;
const SYNCHRONISE: u16 = 0x1000;
const PVTP: u16 = 0x1800;
const TAKE_DATA: u16 = 0xB400;
const TAKE_DATA_2: u16 = 0xD400;
const PONG: u16 = 0xD600;

/// The classes of messages, PONG apart from TakeData2 with which it shares identifiers.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Class {
    /// To groups.
    Group,
    /// Synchronisation, to everybody.
    Synchronisation,
    /// A PVT point, to one axis.
    Pvt,
    /// The answer to GiveMeData2, or unasked.
    TakeData2,
    /// The answer to PING.
    Pong,
    /// To one axis.
    Normal,
    /// An answer to the host behind an axis.
    Host,
    /// The answer to GiveMeData.
    TakeData,
    /// To everybody.
    Broadcast,
}

impl Class {
    /// The manual's word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Group => "Group",
            Self::Synchronisation => "Synchronisation",
            Self::Pvt => "PVT",
            Self::TakeData2 => "TakeData2",
            Self::Pong => "PONG",
            Self::Normal => "Normal",
            Self::Host => "Host",
            Self::TakeData => "TakeData",
            Self::Broadcast => "Broadcast",
        }
    }

    /// What is added to the axis or group ID, or the identifier where there is none.
    const fn base(self) -> u16 {
        match self {
            Self::Group => 0x000,
            Self::Synchronisation => SYNCHRONISATION,
            Self::Pvt => 0x040,
            Self::TakeData2 | Self::Pong => 0x100,
            Self::Normal => 0x120,
            Self::Host => 0x140,
            Self::TakeData => 0x160,
            Self::Broadcast => BROADCAST,
        }
    }

    /// The class of an identifier; PONG is told from TakeData2 by the data alone. `None` for
    /// CANopen's identifiers and those that nobody uses.
    #[must_use]
    #[inline]
    pub const fn of_id(id: u32) -> Option<Self> {
        let numbered = id & 0x1F != 0;
        match id >> 5 {
            0x0 if numbered => Some(Self::Group),
            0x1 if !numbered => Some(Self::Synchronisation),
            0x2 if numbered => Some(Self::Pvt),
            0x8 if numbered => Some(Self::TakeData2),
            0x9 if numbered => Some(Self::Normal),
            0xA if numbered => Some(Self::Host),
            0xB if numbered => Some(Self::TakeData),
            0x10 if !numbered => Some(Self::Broadcast),
            _ => None,
        }
    }
}

/// What a frame carries. TechnoCAN leaves out some of what the other wires say.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Heard {
    /// Its class.
    pub class: Class,
    /// Whom it is for. `None` for TakeData2 and PONG, whose identifier is the sender's, and for
    /// [`misprinted`](Self::misprinted) TakeData.
    pub to: Option<IdCode>,
    /// Who sent it, where the class says so.
    pub sender: Option<u8>,
    /// The whole instruction, with what the class leaves out filled in.
    pub instruction: Instruction,
}

impl Heard {
    /// TakeData as the manual's example 2 prints it: the identifier is the sender's (165) and not
    /// the destination's (163). Real drives send the destination's.
    #[must_use]
    pub fn misprinted(&self) -> bool {
        self.class == Class::TakeData && self.to.is_none()
    }

    /// As a message, where the frame says whom it is for.
    #[must_use]
    pub fn message(&self) -> Option<Message> {
        Some(Message { to: self.to?, instruction: self.instruction })
    }
}

/// The number that stands for an axis ID in identifiers.
///
/// # Errors
/// [`Rule::TechnoCanAxis`] for a multiple of 32.
#[inline]
pub const fn axis_number(id: u8) -> Result<u8, Rule> {
    match id % 32 {
        0 => Err(Rule::TechnoCanAxis),
        number => Ok(number),
    }
}

/// Whether another axis may act on what is sent to this axis ID: it is above 31, and not the
/// default 255, which is known to act as 31.
#[must_use]
pub const fn is_ambiguous(id: u8) -> bool {
    id > AXIS_MAX && id != 255
}

/// The class that carries a message.
///
/// # Errors
/// The rule that forbids it: [`Rule::GiveMeDataToGroup`], [`Rule::TechnoCanWords`].
#[inline]
pub fn class_of(message: &Message) -> Result<Class, Rule> {
    let Message { to, instruction } = message;
    let opcode = instruction.opcode;
    let class = match opcode & 0xFC00 {
        _ if to.group => grouped(*to, opcode)?,
        TAKE_DATA => return Ok(Class::TakeData),
        TAKE_DATA_2 if opcode & 0x200 == 0 => return Ok(Class::TakeData2),
        TAKE_DATA_2 if opcode & 0xFF00 == PONG && opcode != PONG => return Ok(Class::Pong),
        _ if to.host => Class::Host,
        _ if is_point(instruction) => return Ok(Class::Pvt),
        _ => Class::Normal,
    };
    if instruction.data().len() > WORDS_MAX {
        return Err(Rule::TechnoCanWords);
    }
    Ok(class)
}

/// The frame that carries a message.
///
/// # Errors
/// The rule that forbids it, beside those of [`class_of`]: [`Rule::TechnoCanAxis`],
/// [`Rule::TechnoCanGroups`].
#[inline]
pub fn encode(message: &Message) -> Result<Frame, Rule> {
    let class = class_of(message)?;
    let Message { to, instruction } = message;
    let number = match class {
        Class::Group if to.id & !GROUPS != 0 => return Err(Rule::TechnoCanGroups),
        Class::Group => to.id,
        Class::Synchronisation | Class::Broadcast => 0,
        Class::TakeData2 | Class::Pong => axis_number(instruction.opcode as u8)?,
        _ => axis_number(to.id)?,
    };
    let (data, len) = match class {
        Class::Synchronisation => ([0; 8], 0),
        Class::Pvt => packed_point(instruction),
        Class::TakeData => packed_take_data(*to, instruction)?,
        Class::TakeData2 | Class::Pong => packed_take_data_2(instruction)?,
        _ => with_opcode(instruction),
    };
    let id = u32::from(class.base() | u16::from(number));
    Ok(Frame { id, extended: false, remote: false, len, data })
}

/// Reads what a frame carries.
///
/// # Errors
/// [`WireError::Identifier`] for an identifier that is not TechnoCAN's, or a remote request;
/// [`WireError::Short`], [`WireError::Long`] and [`WireError::Count`] for data that its class does
/// not have.
#[inline]
pub fn decode(frame: &Frame) -> Result<Heard, WireError> {
    let foreign = WireError::Identifier { found: frame.id };
    if frame.extended || frame.remote {
        return Err(foreign);
    }
    let class = Class::of_id(frame.id).ok_or(foreign)?;
    let number = frame.id as u8 & 0x1F;
    let plain = |to: IdCode| {
        let instruction = plain_instruction(frame)?;
        Ok(Heard { class, to: Some(to), sender: None, instruction })
    };
    match class {
        Class::Group => plain(IdCode::groups(number)),
        Class::Normal => plain(IdCode::axis(number)),
        Class::Host => plain(IdCode::host_at(number)),
        Class::Broadcast => plain(IdCode::BROADCAST),
        Class::Synchronisation => {
            within(frame.len, 0, 0)?;
            let instruction = Instruction::of(SYNCHRONISE, []);
            Ok(Heard { class, to: Some(IdCode::BROADCAST), sender: None, instruction })
        }
        Class::Pvt => {
            within(frame.len, 8, 8)?;
            let instruction = opened_point(frame.data);
            Ok(Heard { class, to: Some(IdCode::axis(number)), sender: None, instruction })
        }
        Class::TakeData => opened_take_data(frame, number),
        Class::TakeData2 | Class::Pong => opened_take_data_2(frame, number),
    }
}

fn grouped(to: IdCode, opcode: u16) -> Result<Class, Rule> {
    match opcode & 0xFE00 {
        0xB000 => Err(Rule::GiveMeDataToGroup),
        _ if !to.is_broadcast() => Ok(Class::Group),
        _ if opcode == SYNCHRONISE => Ok(Class::Synchronisation),
        _ => Ok(Class::Broadcast),
    }
}

/// PVTP with its point in the data words.
#[inline]
fn is_point(instruction: &Instruction) -> bool {
    instruction.opcode & 0xFF80 == PVTP && instruction.data().len() == 4
}

/// Opcode and data words, all low byte first.
#[inline]
fn with_opcode(instruction: &Instruction) -> ([u8; 8], u8) {
    let (data, len) = low_bytes_first(instruction);
    let whole = u64::from_le_bytes(data) << 16 | u64::from(instruction.opcode);
    (whole.to_le_bytes(), len + 2)
}

#[inline]
fn plain_instruction(frame: &Frame) -> Result<Instruction, WireError> {
    within(frame.len, 2, 8)?;
    let whole = u64::from_le_bytes(frame.data);
    let even = frame.len.is_multiple_of(2);
    if !even {
        return Err(WireError::Count { at: 0, found: frame.len.into() });
    }
    words(whole as u16, (whole >> 16).to_le_bytes(), frame.len - 2)
}

/// The first three data words as they are; the last gives nine bits of time and takes the counter
/// from the opcode.
#[inline]
fn packed_point(instruction: &Instruction) -> ([u8; 8], u8) {
    let time = instruction.word(3) & 0x1FF | (instruction.opcode & 0x7F) << 9;
    let [a, b, c, _] = instruction.padded();
    (low_bytes_first(&Instruction::of(PVTP, [a, b, c, time])).0, 8)
}

#[inline]
fn opened_point(data: [u8; 8]) -> Instruction {
    let [.., low, high] = data;
    let last = u16::from_le_bytes([low, high]);
    let word = |at: usize| u16::from_le_bytes([data[at], data[at + 1]]);
    Instruction::of(PVTP | last >> 9, [word(0), word(2), word(4), last & 0x1FF])
}

/// The sender's word shrinks to five bits; the destination's H takes a bit of the opcode's byte.
#[inline]
fn packed_take_data(to: IdCode, instruction: &Instruction) -> Result<([u8; 8], u8), Rule> {
    let [sender, a, b, c] = instruction.padded();
    let count = instruction.data().len();
    if count < 2 {
        return Err(Rule::Incomplete);
    }
    let sender = axis_number((sender >> 4) as u8)?;
    let flags = sender << 3 | u8::from(to.host) << 2 | (instruction.opcode >> 8) as u8 & 3;
    let head = Instruction::of(
        TAKE_DATA,
        [u16::from_le_bytes([instruction.opcode as u8, flags]), a, b, c],
    );
    Ok((low_bytes_first(&head).0, 2 * count as u8))
}

#[inline]
fn opened_take_data(frame: &Frame, number: u8) -> Result<Heard, WireError> {
    within(frame.len, 4, 8)?;
    let flags = frame.data[1];
    let sender = flags >> 3;
    let opcode = TAKE_DATA | u16::from_le_bytes([frame.data[0], flags & 3]);
    let mut data = frame.data;
    [data[0], data[1]] = IdCode::axis(sender).word().to_le_bytes();
    let to = IdCode { group: false, id: number, host: flags & 4 != 0 };
    Ok(Heard {
        class: Class::TakeData,
        to: (sender != number || to.host).then_some(to),
        sender: Some(sender),
        instruction: words(opcode, data, frame.len)?,
    })
}

/// Bit 7 of the first byte is VT, bit 6 P; then data words.
#[inline]
fn packed_take_data_2(instruction: &Instruction) -> Result<([u8; 8], u8), Rule> {
    let pong = instruction.opcode & 0x200 != 0;
    let wide = !pong && instruction.opcode & 0x100 != 0;
    let count = instruction.data().len();
    if count > WORDS_MAX {
        return Err(Rule::TechnoCanWords);
    }
    let (data, len) = low_bytes_first(instruction);
    let whole = u64::from_le_bytes(data) << 8 | u64::from(wide) << 7 | u64::from(pong) << 6;
    Ok((whole.to_le_bytes(), len + 1))
}

#[inline]
fn opened_take_data_2(frame: &Frame, number: u8) -> Result<Heard, WireError> {
    within(frame.len, 1, 7)?;
    let flags = frame.data[0];
    if flags & 0x3F != 0 {
        return Err(WireError::Unexpected { at: 0, found: flags });
    }
    let (class, kind) = match flags {
        flags if flags & 0x40 != 0 => (Class::Pong, PONG),
        0x80 => (Class::TakeData2, TAKE_DATA_2 | 0x100),
        _ => (Class::TakeData2, TAKE_DATA_2),
    };
    let data = (u64::from_le_bytes(frame.data) >> 8).to_le_bytes();
    let instruction = words(kind | u16::from(number), data, frame.len - 1)?;
    Ok(Heard { class, to: None, sender: Some(number), instruction })
}

#[inline]
fn within(len: u8, least: u8, most: u8) -> Result<(), WireError> {
    let found = len.into();
    match len {
        len if len < least => Err(WireError::Short { need: least.into(), found }),
        len if len > most => Err(WireError::Long { need: most.into(), found }),
        _ => Ok(()),
    }
}
