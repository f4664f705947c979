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

use super::rules::WireRule;
use super::tmlcan::word_count;
use super::wire::{DATA_WORDS_MAX, IdCode, Instruction, Message};
use crate::error::WireError;
use crate::medium::Frame;

/// The highest axis ID that has identifiers of its own.
pub const AXIS_MAX: u8 = 31;
/// Groups 1 to 5 have a bit in the identifier.
pub const GROUP_MASK: u8 = 0x1F;
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
pub enum MessageClass {
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

impl MessageClass {
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

    /// Offset that is added to the axis or group ID, or the whole identifier without one.
    const fn base(self) -> u16 {
        const BASES: [u16; 9] =
            [0x000, SYNCHRONISATION, 0x040, 0x100, 0x100, 0x120, 0x140, 0x160, BROADCAST];
        BASES[self as usize]
    }

    /// The class of an identifier; only the data distinguishes PONG from TakeData2. `None` for CANopen's
    /// identifiers and unused ones.
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

/// Content of a frame. TechnoCAN leaves out some fields of the other wires.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FrameContent {
    /// Class of the message.
    pub class: MessageClass,
    /// Addressee. `None` for TakeData2 and PONG, whose identifier is the sender's, and for
    /// [`misprinted`](Self::misprinted) TakeData.
    pub to: Option<IdCode>,
    /// Sender, if the class has it.
    pub sender: Option<u8>,
    /// The whole instruction, with the fields that the class leaves out.
    pub instruction: Instruction,
}

impl FrameContent {
    /// TakeData as the manual's example 2 prints it: the identifier is the sender's (165) and not
    /// the destination's (163). Real drives send the destination's.
    #[must_use]
    pub fn misprinted(&self) -> bool {
        self.class == MessageClass::TakeData && self.to.is_none()
    }

    /// Converts the frame to a message, if it has an addressee.
    #[must_use]
    pub fn message(&self) -> Option<Message> {
        Some(Message { to: self.to?, instruction: self.instruction })
    }
}

/// The number of an axis ID in identifiers.
///
/// # Errors
/// [`WireRule::TechnoCanAxis`] for a multiple of 32.
#[inline]
pub const fn axis_number(id: u8) -> Result<u8, WireRule> {
    match id % 32 {
        0 => Err(WireRule::TechnoCanAxis),
        number => Ok(number),
    }
}

/// Returns whether another axis may act on messages to this axis ID: it is above 31, and not the default 255, which is
/// known to act as 31.
#[must_use]
pub const fn is_ambiguous(id: u8) -> bool {
    id > AXIS_MAX && id != 255
}

/// The class that carries a message.
///
/// # Errors
/// The rule that forbids it: [`WireRule::GiveMeDataToGroup`], [`WireRule::TechnoCanWords`].
#[inline]
pub fn class_of(message: &Message) -> Result<MessageClass, WireRule> {
    let Message { to, instruction } = message;
    let opcode = instruction.opcode;
    let class = match opcode & 0xFC00 {
        _ if to.group => group_class(*to, opcode)?,
        TAKE_DATA => return Ok(MessageClass::TakeData),
        TAKE_DATA_2 if opcode & 0x200 == 0 => return Ok(MessageClass::TakeData2),
        TAKE_DATA_2 if opcode & 0xFF00 == PONG && opcode != PONG => return Ok(MessageClass::Pong),
        _ if to.host => MessageClass::Host,
        // Before the count of words: a point has four, and its own way of packing them.
        _ if is_point(instruction) => return Ok(MessageClass::Pvt),
        _ => MessageClass::Normal,
    };
    if instruction.word_count() > WORDS_MAX {
        return Err(WireRule::TechnoCanWords);
    }
    Ok(class)
}

/// The frame that carries a message.
///
/// # Errors
/// The rule that forbids it, beside those of [`class_of`]: [`WireRule::TechnoCanAxis`],
/// [`WireRule::TechnoCanGroups`].
#[inline]
pub fn encode(message: &Message) -> Result<Frame, WireRule> {
    let class = class_of(message)?;
    let Message { to, instruction } = message;
    let count = instruction.word_count() as u8;
    let (number, (data, len)) = match class {
        MessageClass::Group if to.id & !GROUP_MASK != 0 => return Err(WireRule::TechnoCanGroups),
        MessageClass::Group => (to.id, plain_payload(count, instruction)),
        MessageClass::Synchronisation => (0, (0, 0)),
        MessageClass::Broadcast => (0, plain_payload(count, instruction)),
        MessageClass::Normal | MessageClass::Host => {
            (axis_number(to.id)?, plain_payload(count, instruction))
        }
        MessageClass::Pvt => (axis_number(to.id)?, (pack_point(instruction), 8)),
        MessageClass::TakeData => {
            (axis_number(to.id)?, (pack_take_data(*to, instruction)?, 2 * count))
        }
        MessageClass::TakeData2 | MessageClass::Pong => {
            let sender = axis_number(instruction.opcode as u8)?;
            (sender, (pack_take_data_2(instruction)?, 2 * count + 1))
        }
    };
    debug_assert!(number <= GROUP_MASK);
    let id = u32::from(class.base() | u16::from(number));
    Ok(Frame { id, extended: false, remote: false, len, data: data.to_le_bytes() })
}

fn plain_payload(count: u8, instruction: &Instruction) -> (u64, u8) {
    (instruction.packed() << 16 | u64::from(instruction.opcode), 2 * count + 2)
}

/// Decodes a frame.
///
/// # Errors
/// [`WireError::Identifier`] for an identifier that is not TechnoCAN's, or a remote request;
/// [`WireError::Short`], [`WireError::Long`] and [`WireError::Count`] for data that its class does not
/// have.
#[inline]
pub fn decode(frame: &Frame) -> Result<FrameContent, WireError> {
    let foreign = WireError::Identifier { found: frame.id };
    if frame.extended || frame.remote {
        return Err(foreign);
    }
    let class = MessageClass::of_id(frame.id).ok_or(foreign)?;
    let number = frame.id as u8 & 0x1F;
    let (data, len) = (u64::from_le_bytes(frame.data), frame.len);
    let (to, instruction) = match class {
        MessageClass::Group => (IdCode::groups(number), decode_plain(data, len)?),
        MessageClass::Normal => (IdCode::axis(number), decode_plain(data, len)?),
        MessageClass::Host => (IdCode::host_at(number), decode_plain(data, len)?),
        MessageClass::Broadcast => (IdCode::BROADCAST, decode_plain(data, len)?),
        MessageClass::Synchronisation => {
            check_len(len, 0, 0)?;
            (IdCode::BROADCAST, Instruction::of(SYNCHRONISE, []))
        }
        MessageClass::Pvt => {
            check_len(len, 8, 8)?;
            (IdCode::axis(number), unpack_point(data))
        }
        MessageClass::TakeData => return unpack_take_data(data, len, number),
        MessageClass::TakeData2 | MessageClass::Pong => {
            return unpack_take_data_2(data, len, number);
        }
    };
    Ok(FrameContent { class, to: Some(to), sender: None, instruction })
}

fn group_class(to: IdCode, opcode: u16) -> Result<MessageClass, WireRule> {
    match opcode & 0xFE00 {
        0xB000 => Err(WireRule::GiveMeDataToGroup),
        _ if !to.is_broadcast() => Ok(MessageClass::Group),
        _ if opcode == SYNCHRONISE => Ok(MessageClass::Synchronisation),
        _ => Ok(MessageClass::Broadcast),
    }
}

/// PVTP with its point in the data words.
#[inline]
fn is_point(instruction: &Instruction) -> bool {
    instruction.opcode & 0xFF80 == PVTP && instruction.word_count() == 4
}

/// Opcode and data words, all low byte first.
#[inline]
fn decode_plain(data: u64, len: u8) -> Result<Instruction, WireError> {
    check_len(len, 2, 8)?;
    let count = word_count(len)? - 1;
    Ok(Instruction::from_packed(data as u16, data >> 16, count))
}

/// The first three data words as they are; the last gives nine bits of time and takes the counter
/// from the opcode.
#[inline]
const fn pack_point(instruction: &Instruction) -> u64 {
    let last = instruction.word(3) & 0x1FF | (instruction.opcode & 0x7F) << 9;
    instruction.packed() & 0xFFFF_FFFF_FFFF | (last as u64) << 48
}

#[inline]
const fn unpack_point(data: u64) -> Instruction {
    let last = (data >> 48) as u16;
    let words = data & 0x01FF_FFFF_FFFF_FFFF;
    Instruction::from_packed(PVTP | last >> 9, words, DATA_WORDS_MAX)
}

/// The sender's word shrinks to five bits; the destination's H takes a bit of the opcode's byte.
#[inline]
const fn pack_take_data(to: IdCode, instruction: &Instruction) -> Result<u64, WireRule> {
    if instruction.word_count() < 2 {
        return Err(WireRule::Incomplete);
    }
    let sender = match axis_number((instruction.word(0) >> 4) as u8) {
        Ok(number) => number,
        Err(rule) => return Err(rule),
    };
    let flags = (sender as u16) << 11 | (to.host as u16) << 10;
    let head = flags | instruction.opcode & 0x3FF;
    Ok(instruction.packed() & !0xFFFF | head as u64)
}

#[inline]
fn unpack_take_data(data: u64, len: u8, number: u8) -> Result<FrameContent, WireError> {
    check_len(len, 4, 8)?;
    let head = data as u16;
    let sender = (head >> 11) as u8;
    let to = IdCode { group: false, id: number, host: head & 0x400 != 0 };
    let words = data & !0xFFFF | u64::from(IdCode::axis(sender).word());
    Ok(FrameContent {
        class: MessageClass::TakeData,
        to: (sender != number || to.host).then_some(to),
        sender: Some(sender),
        instruction: Instruction::from_packed(TAKE_DATA | head & 0x3FF, words, word_count(len)?),
    })
}

/// Bit 7 of the first byte is VT, bit 6 P; then data words.
#[inline]
const fn pack_take_data_2(instruction: &Instruction) -> Result<u64, WireRule> {
    if instruction.word_count() > WORDS_MAX {
        return Err(WireRule::TechnoCanWords);
    }
    let pong = instruction.opcode & 0x200 != 0;
    let wide = !pong && instruction.opcode & 0x100 != 0;
    Ok(instruction.packed() << 8 | (wide as u64) << 7 | (pong as u64) << 6)
}

#[inline]
fn unpack_take_data_2(data: u64, len: u8, number: u8) -> Result<FrameContent, WireError> {
    check_len(len, 1, 7)?;
    let flags = data as u8;
    // Six bits are reserved; with one of them set it is another protocol's frame.
    if flags & 0x3F != 0 {
        return Err(WireError::Unexpected { at: 0, found: flags });
    }
    let (class, kind) = match flags {
        flags if flags & 0x40 != 0 => (MessageClass::Pong, PONG),
        0x80 => (MessageClass::TakeData2, TAKE_DATA_2 | 0x100),
        _ => (MessageClass::TakeData2, TAKE_DATA_2),
    };
    let opcode = kind | u16::from(number);
    let instruction = Instruction::from_packed(opcode, data >> 8, word_count(len - 1)?);
    Ok(FrameContent { class, to: None, sender: Some(number), instruction })
}

#[inline]
fn check_len(len: u8, min: u8, max: u8) -> Result<(), WireError> {
    let found = len.into();
    match len {
        len if len < min => Err(WireError::Short { need: min.into(), found }),
        len if len > max => Err(WireError::Long { need: max.into(), found }),
        _ => Ok(()),
    }
}
