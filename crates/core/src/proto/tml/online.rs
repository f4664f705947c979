//! Instructions that are exchanged on-line, as values: requests for data, replies, clock synchronisation,
//! points of a path.
//!
//! Sources: TML communication manual, chapters 3 to 5, for GiveMeData, TakeData, GiveMeData2, TakeData2,
//! synchronisation, master time and PVTP; captures of real drives for the rest.

use super::wire::{IdCode, Instruction, low_first, operand_address, short_operand};

/// A memory of the drive; its number is in bits 3 and 2 of the opcode.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum MemorySpace {
    /// `pm`: TML programs.
    Program,
    /// `dm`: variables, parameters, registers.
    #[default]
    Data,
    /// `spi`: the EEPROM with programs and the set-up table.
    Spi,
}

impl MemorySpace {
    /// Name in the language.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Program => "pm",
            Self::Data => "dm",
            Self::Spi => "spi",
        }
    }

    const fn of_bits(bits: u16) -> Option<Self> {
        match bits & 3 {
            0 => Some(Self::Program),
            1 => Some(Self::Data),
            2 => Some(Self::Spi),
            _ => None,
        }
    }
}

/// A place of 16 or 32 bits in a memory.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Cell {
    /// Memory space.
    pub memory: MemorySpace,
    /// Address, that of the lower word.
    pub address: u16,
    /// 32 bits.
    pub long: bool,
}

impl Cell {
    /// A variable of 16 bits.
    #[must_use]
    pub const fn short(address: u16) -> Self {
        Self { memory: MemorySpace::Data, address, long: false }
    }

    /// A variable of 32 bits.
    #[must_use]
    pub const fn long(address: u16) -> Self {
        Self { memory: MemorySpace::Data, address, long: true }
    }
}

/// A point of a path with position, velocity and time.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct PvtPoint {
    /// Position, counts: 24 bits.
    pub position: i32,
    /// Velocity, counts per slow-loop period, 16.16; the wire carries the upper 24 bits.
    pub velocity: i32,
    /// Time since the point before, slow-loop periods: 9 bits.
    pub time: u16,
    /// Integrity counter: 7 bits.
    pub counter: u8,
}

impl PvtPoint {
    /// Furthest position, either way, counts.
    pub const POSITION_MAX: i32 = 0x7F_FFFF;
    /// Longest time to a point, slow-loop periods.
    pub const TIME_MAX: u16 = 0x1FF;
    /// Value at which the counter wraps.
    pub const COUNTER_MAX: u8 = 0x7F;

    /// Returns whether all values fit into the wire's bits; a point needs a time above 0.
    #[must_use]
    pub const fn fits(&self) -> bool {
        self.position.unsigned_abs() <= Self::POSITION_MAX as u32
            && self.time >= 1
            && self.time <= Self::TIME_MAX
            && self.counter <= Self::COUNTER_MAX
    }

    const fn parse(instruction: &Instruction) -> Self {
        let [low, middle, high, time] = instruction.padded();
        let position = (low as u32) << 8 | ((middle & 0xFF00) as u32) << 16;
        let velocity = (high as u32) << 16 | ((middle & 0xFF) as u32) << 8;
        Self {
            position: position.cast_signed() >> 8,
            velocity: velocity.cast_signed(),
            time: time & Self::TIME_MAX,
            counter: (instruction.opcode & 0x7F) as u8,
        }
    }

    /// Bits that do not fit are lost; see [`fits`](Self::fits).
    const fn emit(&self) -> Instruction {
        let (position, velocity) = (self.position.cast_unsigned(), self.velocity.cast_unsigned());
        let middle = (position >> 8) as u16 & 0xFF00 | (velocity >> 8) as u16 & 0xFF;
        Instruction::of(
            code::PVTP | (self.counter & Self::COUNTER_MAX) as u16,
            [position as u16, middle, (velocity >> 16) as u16, self.time & Self::TIME_MAX],
        )
    }
}

/// A point of a path with position and time.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct PtPoint {
    /// Position, counts.
    pub position: i32,
    /// Time since the point before, slow-loop periods.
    pub time: u16,
    /// Integrity counter: 7 bits.
    pub counter: u8,
}

/// An instruction that is exchanged on-line.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum OnlineMessage {
    /// Reads a value from one axis.
    GiveMeData {
        /// Receiver of the reply.
        sender: IdCode,
        /// Requested cell.
        cell: Cell,
    },
    /// Reads a value from axes; may be sent to groups.
    GiveMeData2 {
        /// Receiver of the replies.
        sender: IdCode,
        /// Requested cell.
        cell: Cell,
    },
    /// Answers [`GiveMeData`](Self::GiveMeData).
    TakeData {
        /// Axis that replies.
        sender: IdCode,
        /// Requested cell.
        cell: Cell,
        /// Value; 16 bits are not sign-extended.
        value: u32,
    },
    /// Answers [`GiveMeData2`](Self::GiveMeData2), or comes unasked.
    TakeData2 {
        /// Axis ID of the drive that sends it.
        sender: u8,
        /// Address of the value in data memory.
        address: u16,
        /// 32 bits.
        long: bool,
        /// The value; 16 bits are not sign-extended.
        value: u32,
    },
    /// Reads a variable by its short address.
    GetData {
        /// Receiver of the reply.
        sender: IdCode,
        /// The variable.
        address: u16,
        /// 32 bits.
        long: bool,
    },
    /// Answers [`GetData`](Self::GetData).
    GotData {
        /// Axis that replies.
        sender: IdCode,
        /// The variable.
        address: u16,
        /// 32 bits.
        long: bool,
        /// Value; 16 bits are not sign-extended.
        value: u32,
    },
    /// Reads the firmware's version.
    GetVersion {
        /// Receiver of the reply.
        sender: IdCode,
    },
    /// Reply to [`GetVersion`](Self::GetVersion) with three digits and a letter, without the F that firmware
    /// names begin with. It does not name its sender.
    TakeVersion {
        /// `514L`.
        version: [u8; 4],
    },
    /// Finds axes: each replies.
    Ping {
        /// Receiver of the replies.
        sender: IdCode,
        /// \[I\] Word of unknown meaning; 07D0 was seen.
        word: u16,
    },
    /// Answers [`Ping`](Self::Ping).
    Pong {
        /// Axis ID of the drive that answers.
        sender: u8,
        /// Version, as in [`TakeVersion`](Self::TakeVersion).
        version: [u8; 4],
    },
    /// Reads the sum of a memory's words.
    GetChecksum {
        /// Receiver of the reply.
        sender: IdCode,
        /// Memory space.
        memory: MemorySpace,
        /// First address.
        start: u16,
        /// Last address.
        end: u16,
    },
    /// Reply to [`GetChecksum`](Self::GetChecksum). It does not name its sender.
    TakeChecksum {
        /// Memory space.
        memory: MemorySpace,
        /// The sum of all words, modulo 65536.
        sum: u16,
    },
    /// Everybody latches its time.
    Synchronisation,
    /// The master's time at the last synchronisation, slow-loop periods.
    MasterTime(u32),
    /// Makes the axis the time master, which synchronises all others at this period, in slow loops; 0 ends it.
    SetSync(u32),
    /// The next point of a PVT path.
    Pvt(PvtPoint),
    /// The next point of a PT path.
    Pt(PtPoint),
}

mod code {
    pub const GIVE_ME_DATA: u16 = 0xB000;
    pub const GIVE_ME_DATA_2: u16 = 0xB200;
    pub const TAKE_DATA: u16 = 0xB400;
    pub const TAKE_DATA_2: u16 = 0xD400;
    pub const GET_DATA: u16 = 0xA000;
    pub const GOT_DATA: u16 = 0xA800;
    pub const LONG_DATA: u16 = 0x0400;
    pub const VERSION: u16 = 0xD801;
    pub const PING: u16 = 0xD600;
    /// The memory is in bits 6 and 5.
    pub const CHECKSUM: u16 = 0xDA10;
    pub const SYNCHRONISATION: u16 = 0x1000;
    pub const MASTER_TIME: u16 = 0x1401;
    pub const SET_SYNC: u16 = 0x1404;
    pub const PVTP: u16 = 0x1800;
    pub const PTP: u16 = 0xC800;
}

impl OnlineMessage {
    /// Reads an instruction. `None` when it is not one of these, or has other data words than they
    /// have.
    #[must_use]
    pub fn parse(instruction: &Instruction) -> Option<Self> {
        let count = instruction.data().len();
        match (instruction.opcode >> 8, count) {
            (0x10, 0) if instruction.opcode == code::SYNCHRONISATION => Some(Self::Synchronisation),
            (0x14, 2) => Self::parse_time(instruction),
            (0x18, 4) if instruction.opcode & 0x80 == 0 => {
                Some(Self::Pvt(PvtPoint::parse(instruction)))
            }
            (0xA0..=0xAF, _) => Self::parse_short(instruction, count),
            (0xB0..=0xB7, _) => Self::parse_cell(instruction, count),
            (0xC8, 3) if instruction.opcode & 0x80 == 0 => Some(Self::Pt(PtPoint {
                position: instruction.long(0).cast_signed(),
                time: instruction.word(2),
                counter: (instruction.opcode & 0x7F) as u8,
            })),
            (0xD4 | 0xD5, _) => Self::parse_take_data_2(instruction, count),
            (0xD6 | 0xD8 | 0xDA, _) => Self::parse_service(instruction, count),
            _ => None,
        }
    }

    /// The instruction.
    #[must_use]
    pub fn emit(&self) -> Instruction {
        match *self {
            Self::GiveMeData { sender, cell } => {
                Instruction::of(code::GIVE_ME_DATA | cell_bits(cell), [sender.word(), cell.address])
            }
            Self::GiveMeData2 { sender, cell } => Instruction::of(
                code::GIVE_ME_DATA_2 | cell_bits(cell),
                [sender.word(), cell.address],
            ),
            Self::TakeData { sender, cell, value } => {
                let opcode = code::TAKE_DATA | cell_bits(cell);
                with_value(opcode, &[sender.word(), cell.address], cell.long, value)
            }
            Self::TakeData2 { sender, address, long, value } => {
                let opcode = code::TAKE_DATA_2 | u16::from(long) << 8 | u16::from(sender);
                with_value(opcode, &[address], long, value)
            }
            Self::GetData { sender, address, long } => {
                Instruction::of(code::GET_DATA | short_bits(address, long), [sender.word()])
            }
            Self::GotData { sender, address, long, value } => {
                let opcode = code::GOT_DATA | short_bits(address, long);
                with_value(opcode, &[sender.word()], long, value)
            }
            Self::GetVersion { sender } => Instruction::of(code::VERSION, [sender.word()]),
            Self::TakeVersion { version } => Instruction::of(code::VERSION, pack_letters(version)),
            Self::Ping { sender, word } => Instruction::of(code::PING, [sender.word(), word]),
            Self::Pong { sender, version } => {
                Instruction::of(code::PING | u16::from(sender), pack_letters(version))
            }
            Self::GetChecksum { sender, memory, start, end } => {
                Instruction::of(checksum_opcode(memory), [sender.word(), start, end])
            }
            Self::TakeChecksum { memory, sum } => Instruction::of(checksum_opcode(memory), [sum]),
            Self::Synchronisation => Instruction::of(code::SYNCHRONISATION, []),
            Self::MasterTime(time) => Instruction::of(code::MASTER_TIME, low_first(time)),
            Self::SetSync(period) => Instruction::of(code::SET_SYNC, low_first(period)),
            Self::Pvt(point) => point.emit(),
            Self::Pt(point) => {
                let [low, high] = low_first(point.position.cast_unsigned());
                let opcode = code::PTP | u16::from(point.counter & PvtPoint::COUNTER_MAX);
                Instruction::of(opcode, [low, high, point.time])
            }
        }
    }

    /// Returns whether drives reply to it with data (type B).
    #[must_use]
    pub const fn is_request(&self) -> bool {
        matches!(
            self,
            Self::GiveMeData { .. }
                | Self::GiveMeData2 { .. }
                | Self::GetData { .. }
                | Self::GetVersion { .. }
                | Self::Ping { .. }
                | Self::GetChecksum { .. }
        )
    }

    /// Receiver of the reply to a request.
    #[must_use]
    pub const fn reply_to(&self) -> Option<IdCode> {
        match *self {
            Self::GiveMeData { sender, .. }
            | Self::GiveMeData2 { sender, .. }
            | Self::GetData { sender, .. }
            | Self::GetVersion { sender }
            | Self::Ping { sender, .. }
            | Self::GetChecksum { sender, .. } => Some(sender),
            _ => None,
        }
    }

    /// Axis ID of the drive that replied, if the reply has it.
    #[must_use]
    pub const fn answered_by(&self) -> Option<u8> {
        match *self {
            Self::TakeData { sender, .. } | Self::GotData { sender, .. } => Some(sender.id),
            Self::TakeData2 { sender, .. } | Self::Pong { sender, .. } => Some(sender),
            _ => None,
        }
    }

    /// Returns whether this can be the reply to `request`, sent to `to`: kind, place and sender agree as far as both
    /// have them.
    #[must_use]
    pub fn answers(&self, request: &Self, to: IdCode) -> bool {
        match (*request, *self) {
            (Self::GiveMeData { cell: requested, .. }, Self::TakeData { sender, cell, .. }) => {
                requested == cell && is_addressed(sender.id, to.group, to.id)
            }
            (
                Self::GiveMeData2 { cell: requested, .. },
                Self::TakeData2 { sender, address, long, .. },
            ) => {
                requested.address == address
                    && requested.long == long
                    && is_addressed(sender, to.group, to.id)
            }
            (
                Self::GetData { address: wanted, long: wide, .. },
                Self::GotData { sender, address, long, .. },
            ) => wanted == address && wide == long && is_addressed(sender.id, to.group, to.id),
            (Self::GetVersion { .. }, Self::TakeVersion { .. }) => true,
            (Self::Ping { .. }, Self::Pong { sender, .. }) => is_addressed(sender, to.group, to.id),
            (Self::GetChecksum { memory: memory_space, .. }, Self::TakeChecksum { memory, .. }) => {
                memory_space == memory
            }
            _ => false,
        }
    }

    fn parse_time(instruction: &Instruction) -> Option<Self> {
        match instruction.opcode {
            code::MASTER_TIME => Some(Self::MasterTime(instruction.long(0))),
            code::SET_SYNC => Some(Self::SetSync(instruction.long(0))),
            _ => None,
        }
    }

    fn parse_short(instruction: &Instruction, count: usize) -> Option<Self> {
        let long = instruction.opcode & code::LONG_DATA != 0;
        let address = operand_address(instruction.opcode);
        let sender = IdCode::from_word(instruction.word(0))?;
        let answer = instruction.opcode & 0x0800 != 0;
        match (answer, count) {
            (false, 1) => Some(Self::GetData { sender, address, long }),
            (true, n) if n == 2 + usize::from(long) => {
                Some(Self::GotData { sender, address, long, value: instruction.long(1) })
            }
            _ => None,
        }
    }

    fn parse_cell(instruction: &Instruction, count: usize) -> Option<Self> {
        let Instruction { opcode, .. } = *instruction;
        if opcode & 0x01F2 != 0 {
            return None;
        }
        let long = opcode & 1 != 0;
        let memory = MemorySpace::of_bits(opcode >> 2)?;
        let sender = IdCode::from_word(instruction.word(0))?;
        let cell = Cell { memory, address: instruction.word(1), long };
        match (opcode & 0xFE00, count) {
            (code::GIVE_ME_DATA, 2) => Some(Self::GiveMeData { sender, cell }),
            (code::GIVE_ME_DATA_2, 2) => Some(Self::GiveMeData2 { sender, cell }),
            (code::TAKE_DATA, n) if n == 3 + usize::from(long) => {
                Some(Self::TakeData { sender, cell, value: instruction.long(2) })
            }
            _ => None,
        }
    }

    fn parse_take_data_2(instruction: &Instruction, count: usize) -> Option<Self> {
        let long = instruction.opcode & 0x100 != 0;
        (count == 2 + usize::from(long)).then(|| Self::TakeData2 {
            sender: instruction.opcode as u8,
            address: instruction.word(0),
            long,
            value: instruction.long(1),
        })
    }

    fn parse_service(instruction: &Instruction, count: usize) -> Option<Self> {
        let sender = IdCode::from_word(instruction.word(0));
        match (instruction.opcode, count) {
            (code::VERSION, 1) => Some(Self::GetVersion { sender: sender? }),
            (code::VERSION, 2) => Some(Self::TakeVersion { version: version_letters(instruction) }),
            (code::PING, 2) => Some(Self::Ping { sender: sender?, word: instruction.word(1) }),
            (0xD601..=0xD6FF, 2) => Some(Self::Pong {
                sender: instruction.opcode as u8,
                version: version_letters(instruction),
            }),
            (opcode, n) if opcode & 0xFF9F == code::CHECKSUM => {
                let memory = MemorySpace::of_bits(opcode >> 5)?;
                let (start, end) = (instruction.word(1), instruction.word(2));
                match n {
                    1 => Some(Self::TakeChecksum { memory, sum: instruction.word(0) }),
                    3 => Some(Self::GetChecksum { sender: sender?, memory, start, end }),
                    _ => None,
                }
            }
            _ => None,
        }
    }
}

fn version_letters(instruction: &Instruction) -> [u8; 4] {
    let ([a, b], [c, d]) = (instruction.word(0).to_be_bytes(), instruction.word(1).to_be_bytes());
    [a, b, c, d]
}

fn is_addressed(id: u8, to_group: bool, to_id: u8) -> bool {
    to_group || to_id == 0 || to_id == id
}

const fn cell_bits(cell: Cell) -> u16 {
    (cell.memory as u16) << 2 | cell.long as u16
}

/// The operand of a short request. An address outside both pages is cut into them: see
/// [`short_operand`].
fn short_bits(address: u16, long: bool) -> u16 {
    let operand = short_operand(address).unwrap_or(address & 0x1FF);
    operand | if long { code::LONG_DATA } else { 0 }
}

const fn checksum_opcode(memory: MemorySpace) -> u16 {
    code::CHECKSUM | (memory as u16) << 5
}

const fn pack_letters([a, b, c, d]: [u8; 4]) -> [u16; 2] {
    [u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d])]
}

/// `head` with the value behind it, at most four words together.
fn with_value(opcode: u16, head: &[u16], long: bool, value: u32) -> Instruction {
    let mut words = [0; 4];
    let count = head.len();
    words[..count].copy_from_slice(head);
    let value = low_first(value);
    words[count] = value[0];
    if long {
        words[count + 1] = value[1];
    }
    Instruction::from_padded(opcode, words, count + 1 + usize::from(long))
}
