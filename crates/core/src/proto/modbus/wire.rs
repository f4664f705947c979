//! The Modbus protocol data unit: function codes, exceptions, requests and replies.
//!
//! Source: MODBUS Application Protocol Specification V1.1b3 (here "MAP"), chapters 4.1, 6 and 7. A PDU is
//! the function code with its data, without station address and checksum. Numbers are big-endian; a byte
//! has eight bits, the lowest address in bit 0. Parsing borrows, and writing uses the caller's buffer:
//! nothing is allocated.

use super::device_id;
use crate::error::WireError;

pub use super::function::Function;

/// Longest PDU, bytes (MAP 4.1: 256 − address − CRC).
pub const PDU_MAX: usize = 253;
/// Most bits that one request reads (MAP 6.1, 6.2).
pub const READ_BITS_MAX: u16 = 2000;
/// Most registers that one request reads (MAP 6.3, 6.4).
pub const READ_WORDS_MAX: u16 = 125;
/// Most coils that one request writes (MAP 6.11).
pub const WRITE_BITS_MAX: u16 = 1968;
/// Most registers that one request writes (MAP 6.12).
pub const WRITE_WORDS_MAX: u16 = 123;
/// Most registers that a request writes that reads too (MAP 6.17).
pub const READ_WRITE_WORDS_MAX: u16 = 121;
/// The station address that every station obeys and none answers.
pub const BROADCAST: u8 = 0;
/// Set in the function code of an exception reply.
pub const EXCEPTION_BIT: u8 = 0x80;

const COIL_ON: u16 = 0xFF00;

/// Encoding of bytes on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WireFormat {
    /// Binary with CRC.
    Rtu,
    /// Hexadecimal characters with LRC.
    Ascii,
    /// Binary behind a header, without a check sum.
    Tcp,
}

/// An address space of a station. The numbers are those of a profile's `space`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Space {
    /// Holding registers, read and written; profile space 0.
    Holding,
    /// Coils, read and written; profile space 1.
    Coil,
    /// Discrete inputs, read only; profile space 2.
    Discrete,
    /// Input registers, read only; profile space 3.
    Input,
}

impl Space {
    /// The space of a profile's number.
    #[must_use]
    pub const fn of_number(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Holding),
            1 => Some(Self::Coil),
            2 => Some(Self::Discrete),
            3 => Some(Self::Input),
            _ => None,
        }
    }

    /// A profile's number for the space.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Holding => 0,
            Self::Coil => 1,
            Self::Discrete => 2,
            Self::Input => 3,
        }
    }

    /// True where an address is one bit, false where it is a 16-bit register.
    #[must_use]
    pub const fn is_bits(self) -> bool {
        matches!(self, Self::Coil | Self::Discrete)
    }

    /// The function that reads it.
    #[must_use]
    #[inline(always)]
    pub const fn read_function(self) -> Function {
        match self {
            Self::Holding => Function::ReadHoldingRegisters,
            Self::Coil => Function::ReadCoils,
            Self::Discrete => Function::ReadDiscreteInputs,
            Self::Input => Function::ReadInputRegisters,
        }
    }

    /// The space that a function code reads.
    #[must_use]
    #[inline]
    pub const fn of_read_code(code: u8) -> Option<Self> {
        match code {
            0x01 => Some(Self::Coil),
            0x02 => Some(Self::Discrete),
            0x03 => Some(Self::Holding),
            0x04 => Some(Self::Input),
            _ => None,
        }
    }

    /// Most that one request reads.
    #[must_use]
    pub const fn read_max(self) -> u16 {
        if self.is_bits() { READ_BITS_MAX } else { READ_WORDS_MAX }
    }

    /// Data bytes of a reply that carries `count` of it.
    #[must_use]
    pub const fn reply_bytes(self, count: u16) -> usize {
        if self.is_bits() { (count as usize).div_ceil(8) } else { count as usize * 2 }
    }
}

/// Reason why a station refuses a request (MAP 7).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Exception {
    /// 01.
    IllegalFunction,
    /// 02.
    IllegalAddress,
    /// 03.
    IllegalValue,
    /// 04.
    DeviceFailure,
    /// 05.
    Acknowledge,
    /// 06.
    DeviceBusy,
    /// 07, of older editions of the standard.
    NegativeAcknowledge,
    /// 08.
    MemoryParity,
    /// 0A.
    GatewayPath,
    /// 0B.
    GatewayTarget,
    /// Any other.
    Unknown(u8),
}

impl Exception {
    /// The exception of a code.
    #[must_use]
    pub const fn of_code(code: u8) -> Self {
        match code {
            0x01 => Self::IllegalFunction,
            0x02 => Self::IllegalAddress,
            0x03 => Self::IllegalValue,
            0x04 => Self::DeviceFailure,
            0x05 => Self::Acknowledge,
            0x06 => Self::DeviceBusy,
            0x07 => Self::NegativeAcknowledge,
            0x08 => Self::MemoryParity,
            0x0A => Self::GatewayPath,
            0x0B => Self::GatewayTarget,
            code => Self::Unknown(code),
        }
    }

    /// The code on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::IllegalFunction => 0x01,
            Self::IllegalAddress => 0x02,
            Self::IllegalValue => 0x03,
            Self::DeviceFailure => 0x04,
            Self::Acknowledge => 0x05,
            Self::DeviceBusy => 0x06,
            Self::NegativeAcknowledge => 0x07,
            Self::MemoryParity => 0x08,
            Self::GatewayPath => 0x0A,
            Self::GatewayTarget => 0x0B,
            Self::Unknown(code) => code,
        }
    }

    /// Meaning of the code.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::IllegalFunction => "illegal function: the drive does not know this function code",
            Self::IllegalAddress => "illegal data address: the drive has no such register or coil",
            Self::IllegalValue => "illegal data value: the value, count or length is not allowed",
            Self::DeviceFailure => "device failure: the drive could not do it",
            Self::Acknowledge => "acknowledge: accepted, still being carried out",
            Self::DeviceBusy => "device busy: try again later",
            Self::NegativeAcknowledge => "negative acknowledge: the drive cannot do this now",
            Self::MemoryParity => "memory parity error in the drive",
            Self::GatewayPath => "gateway path unavailable",
            Self::GatewayTarget => "gateway target failed to respond",
            Self::Unknown(_) => "unknown exception",
        }
    }
}

/// A request PDU.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RequestPdu<'a> {
    /// 01 to 04: reads `count` bits or registers from `start` on.
    Read {
        /// Address space.
        space: Space,
        /// First address.
        start: u16,
        /// Number of bits or registers, 1 to [`Space::read_max`].
        count: u16,
    },
    /// 05: one coil.
    WriteCoil {
        /// Address of the coil, from 0.
        address: u16,
        /// On (FF00) or off (0000).
        on: bool,
    },
    /// 06: one holding register.
    WriteRegister {
        /// Address of the register, from 0.
        address: u16,
        /// New value.
        value: u16,
    },
    /// 0F: several coils.
    WriteCoils {
        /// First address.
        start: u16,
        /// Number of bits, 1 to [`WRITE_BITS_MAX`].
        count: u16,
        /// Eight to a byte, lowest address in bit 0.
        bits: &'a [u8],
    },
    /// 10: several holding registers.
    WriteRegisters {
        /// First address.
        start: u16,
        /// Big-endian words, 1 to [`WRITE_WORDS_MAX`].
        words: &'a [u8],
    },
    /// 17: several holding registers, then the values of others, or of the same.
    ReadWriteRegisters {
        /// First address to read.
        read_start: u16,
        /// Number of registers to read, 1 to [`READ_WORDS_MAX`].
        read_count: u16,
        /// First address to write.
        start: u16,
        /// Big-endian words to write, 1 to [`READ_WRITE_WORDS_MAX`].
        words: &'a [u8],
    },
    /// A function without a variant here.
    Unknown {
        /// Function code.
        function: u8,
        /// Whatever follows.
        data: &'a [u8],
    },
}

impl<'a> RequestPdu<'a> {
    /// Reads a PDU. Offsets in errors count from the function code.
    ///
    /// # Errors
    /// [`WireError`]: lengths, counts beyond the standard's limits, coil values other than FF00
    /// and 0000.
    pub fn parse(pdu: &'a [u8]) -> Result<Self, WireError> {
        let (&code, data) = pdu.split_first().ok_or(WireError::Short { need: 1, found: 0 })?;
        let function = Function::of_code(code);
        match function {
            Function::WriteCoil => Self::parse_write_coil(pdu),
            Function::WriteRegister => {
                check_len(pdu, 5)?;
                Ok(Self::WriteRegister { address: word(pdu, 1), value: word(pdu, 3) })
            }
            Function::WriteCoils => Self::parse_write_coils(pdu),
            Function::WriteRegisters => Self::parse_write_registers(pdu),
            Function::ReadWriteRegisters => Self::parse_read_write(pdu),
            Function::Unknown(function) => Ok(Self::Unknown { function, data }),
            _ => match function.read_space() {
                Some(space) => Self::parse_read(space, pdu),
                None => Ok(Self::Unknown { function: code, data }),
            },
        }
    }

    /// Writes the PDU and returns its length. Counts are not checked, so that invalid requests can be tested.
    /// `out` must hold [`PDU_MAX`] bytes, or the length of the PDU.
    #[inline(always)]
    pub fn emit(&self, out: &mut [u8]) -> usize {
        let code = self.function().code();
        match *self {
            Self::Read { start, count, .. } => emit_pair(out, code, start, count),
            Self::WriteCoil { address, on } => {
                emit_pair(out, code, address, if on { COIL_ON } else { 0 })
            }
            Self::WriteRegister { address, value } => emit_pair(out, code, address, value),
            Self::WriteCoils { start, count, bits } => emit_block(out, code, start, count, bits),
            Self::WriteRegisters { start, words } => {
                emit_block(out, code, start, (words.len() / 2) as u16, words)
            }
            Self::ReadWriteRegisters { read_start, read_count, start, words } => {
                emit_pair(out, code, read_start, read_count);
                // The write has the form of function 10, without a code of its own.
                let len = emit_block(&mut out[4..], 0, start, (words.len() / 2) as u16, words);
                out[4] = read_count as u8;
                4 + len
            }
            Self::Unknown { data, .. } => {
                out[0] = code;
                out[1..=data.len()].copy_from_slice(data);
                1 + data.len()
            }
        }
    }

    /// Function and two words, where there is nothing else: reads and single writes.
    #[inline(always)]
    pub(super) const fn as_short(&self) -> Option<(u8, u16, u16)> {
        let (first, second) = match *self {
            Self::Read { start, count, .. } => (start, count),
            Self::WriteCoil { address, on } => (address, if on { COIL_ON } else { 0 }),
            Self::WriteRegister { address, value } => (address, value),
            _ => return None,
        };
        Some((self.function().code(), first, second))
    }

    /// Function code.
    #[must_use]
    #[inline(always)]
    pub const fn function(&self) -> Function {
        match *self {
            Self::Read { space, .. } => space.read_function(),
            Self::WriteCoil { .. } => Function::WriteCoil,
            Self::WriteRegister { .. } => Function::WriteRegister,
            Self::WriteCoils { .. } => Function::WriteCoils,
            Self::WriteRegisters { .. } => Function::WriteRegisters,
            Self::ReadWriteRegisters { .. } => Function::ReadWriteRegisters,
            Self::Unknown { function, .. } => Function::Unknown(function),
        }
    }

    /// Length of the PDU that answers it, exceptions apart; `None` where the standard is not
    /// followed here.
    #[must_use]
    pub const fn reply_len(&self) -> Option<usize> {
        match *self {
            Self::Read { space, count, .. } => Some(2 + space.reply_bytes(count)),
            Self::ReadWriteRegisters { read_count, .. } => Some(2 + 2 * read_count as usize),
            Self::Unknown { .. } => None,
            _ => Some(5),
        }
    }

    fn parse_read(space: Space, pdu: &[u8]) -> Result<Self, WireError> {
        check_len(pdu, 5)?;
        let count = count_within(pdu, 3, space.read_max())?;
        Ok(Self::Read { space, start: word(pdu, 1), count })
    }

    fn parse_write_coil(pdu: &[u8]) -> Result<Self, WireError> {
        check_len(pdu, 5)?;
        match word(pdu, 3) {
            0 => Ok(Self::WriteCoil { address: word(pdu, 1), on: false }),
            COIL_ON => Ok(Self::WriteCoil { address: word(pdu, 1), on: true }),
            found => Err(WireError::Count { at: 3, found }),
        }
    }

    fn parse_write_coils(pdu: &'a [u8]) -> Result<Self, WireError> {
        let bits = block_data(pdu)?;
        let count = count_within(pdu, 3, WRITE_BITS_MAX)?;
        if bits.len() != usize::from(count).div_ceil(8) {
            return Err(WireError::Count { at: 5, found: bits.len() as u16 });
        }
        Ok(Self::WriteCoils { start: word(pdu, 1), count, bits })
    }

    fn parse_write_registers(pdu: &'a [u8]) -> Result<Self, WireError> {
        let words = block_data(pdu)?;
        let count = count_within(pdu, 3, WRITE_WORDS_MAX)?;
        if words.len() != usize::from(count) * 2 {
            return Err(WireError::Count { at: 5, found: words.len() as u16 });
        }
        Ok(Self::WriteRegisters { start: word(pdu, 1), words })
    }

    fn parse_read_write(pdu: &'a [u8]) -> Result<Self, WireError> {
        if pdu.len() < 10 {
            return Err(WireError::Short { need: 10, found: pdu.len() as u16 });
        }
        let read_count = count_within(pdu, 3, READ_WORDS_MAX)?;
        let count = count_within(pdu, 7, READ_WRITE_WORDS_MAX)?;
        check_len(pdu, 10 + usize::from(pdu[9]))?;
        let words = &pdu[10..];
        if words.len() != usize::from(count) * 2 {
            return Err(WireError::Count { at: 9, found: words.len() as u16 });
        }
        Ok(Self::ReadWriteRegisters {
            read_start: word(pdu, 1),
            read_count,
            start: word(pdu, 5),
            words,
        })
    }
}

/// A reply PDU.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ReplyPdu<'a> {
    /// 01 to 04: values of a read.
    Read {
        /// From where.
        space: Space,
        /// Bits eight to a byte, or big-endian words.
        data: &'a [u8],
    },
    /// 05, the request again.
    WroteCoil {
        /// Address of the coil, from 0.
        address: u16,
        /// On or off.
        on: bool,
    },
    /// 06, the request again.
    WroteRegister {
        /// Address of the register, from 0.
        address: u16,
        /// New value.
        value: u16,
    },
    /// 0F or 10: where and how many.
    Wrote {
        /// True for coils (0F), false for registers (10).
        coils: bool,
        /// First address.
        start: u16,
        /// Number of registers or bits.
        count: u16,
    },
    /// 17: the values of the registers that were read.
    ReadWritten {
        /// Big-endian words.
        data: &'a [u8],
    },
    /// A refusal.
    Exception {
        /// The function refused.
        function: u8,
        /// Exception of the station.
        exception: Exception,
    },
    /// A function without a variant here.
    Unknown {
        /// Function code.
        function: u8,
        /// Whatever follows.
        data: &'a [u8],
    },
}

impl<'a> ReplyPdu<'a> {
    /// Reads a PDU. Offsets in errors count from the function code.
    ///
    /// # Errors
    /// [`WireError`]: lengths and counts that contradict each other.
    #[inline]
    pub fn parse(pdu: &'a [u8]) -> Result<Self, WireError> {
        let (&code, data) = pdu.split_first().ok_or(WireError::Short { need: 1, found: 0 })?;
        match Space::of_read_code(code) {
            Some(space) => Self::parse_read(space, data),
            None => Self::parse_other(code, pdu, data),
        }
    }

    fn parse_other(code: u8, pdu: &'a [u8], data: &'a [u8]) -> Result<Self, WireError> {
        if code & EXCEPTION_BIT != 0 {
            check_len(pdu, 2)?;
            let exception = Exception::of_code(pdu[1]);
            return Ok(Self::Exception { function: code & !EXCEPTION_BIT, exception });
        }
        let function = Function::of_code(code);
        if let Function::Unknown(function) = function {
            return Ok(Self::Unknown { function, data });
        }
        if function == Function::ReadWriteRegisters {
            return match Self::parse_read(Space::Holding, data)? {
                Self::Read { data, .. } => Ok(Self::ReadWritten { data }),
                other => Ok(other),
            };
        }
        check_len(pdu, 5)?;
        let (first, second) = (word(pdu, 1), word(pdu, 3));
        match function {
            Function::WriteCoil if second != 0 && second != COIL_ON => {
                Err(WireError::Count { at: 3, found: second })
            }
            Function::WriteCoil => Ok(Self::WroteCoil { address: first, on: second != 0 }),
            Function::WriteRegister => Ok(Self::WroteRegister { address: first, value: second }),
            function => {
                let coils = matches!(function, Function::WriteCoils);
                Ok(Self::Wrote { coils, start: first, count: second })
            }
        }
    }

    /// Writes the PDU and returns its length. `out` must hold [`PDU_MAX`] bytes, or the length of the PDU.
    pub fn emit(&self, out: &mut [u8]) -> usize {
        match *self {
            Self::Read { space, data } => emit_data(out, space.read_function(), data),
            Self::ReadWritten { data } => emit_data(out, Function::ReadWriteRegisters, data),
            Self::WroteCoil { address, on } => RequestPdu::WriteCoil { address, on }.emit(out),
            Self::WroteRegister { address, value } => {
                RequestPdu::WriteRegister { address, value }.emit(out)
            }
            Self::Wrote { coils, start, count } => {
                let function = if coils { Function::WriteCoils } else { Function::WriteRegisters };
                emit_pair(out, function.code(), start, count)
            }
            Self::Exception { function, exception } => {
                out[0] = function | EXCEPTION_BIT;
                out[1] = exception.code();
                2
            }
            Self::Unknown { function, data } => RequestPdu::Unknown { function, data }.emit(out),
        }
    }

    #[inline]
    fn parse_read(space: Space, data: &'a [u8]) -> Result<Self, WireError> {
        let (&count, data) = data.split_first().ok_or(WireError::Short { need: 2, found: 1 })?;
        check_len(data, usize::from(count))?;
        if count == 0 || (!space.is_bits() && count % 2 != 0) {
            return Err(WireError::Count { at: 1, found: u16::from(count) });
        }
        Ok(Self::Read { space, data })
    }
}

/// Length of a frame by its head.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AnnouncedLength {
    /// This many bytes.
    Bytes(usize),
    /// The head is incomplete.
    More,
    /// The length of this function is not known.
    Unknown,
    /// No PDU begins like this.
    Never,
}

/// The length of the request PDU that begins with `head` (MAP 6), also of functions that stations only refuse.
#[must_use]
pub fn request_span(head: &[u8]) -> AnnouncedLength {
    let Some(&code) = head.first() else { return AnnouncedLength::More };
    match code {
        0x01..=0x06 | 0x08 => AnnouncedLength::Bytes(5),
        0x07 | 0x0B | 0x0C | 0x11 => AnnouncedLength::Bytes(1),
        0x0F | 0x10 => counted_span(head, 5, 0, WRITE_WORDS_MAX as usize * 2),
        0x14 | 0x15 => counted_span(head, 1, 1, 0xFB),
        0x16 => AnnouncedLength::Bytes(7),
        0x17 => counted_span(head, 9, 1, READ_WRITE_WORDS_MAX as usize * 2),
        0x18 => AnnouncedLength::Bytes(3),
        0x2B => AnnouncedLength::Bytes(4),
        0 | 0x80.. => AnnouncedLength::Never,
        _ => AnnouncedLength::Unknown,
    }
}

/// The length of the reply PDU that begins with `head`.
#[must_use]
pub fn reply_span(head: &[u8]) -> AnnouncedLength {
    let Some(&code) = head.first() else { return AnnouncedLength::More };
    match code {
        0x01..=0x04 | 0x0C | 0x11 | 0x14 | 0x15 | 0x17 => counted_span(head, 1, 0, 251),
        0x05 | 0x06 | 0x08 | 0x0B | 0x0F | 0x10 => AnnouncedLength::Bytes(5),
        0x07 => AnnouncedLength::Bytes(2),
        0x16 => AnnouncedLength::Bytes(7),
        device_id::FUNCTION => device_id::reply_span(head),
        0 | 0x80 => AnnouncedLength::Never,
        0x81.. => AnnouncedLength::Bytes(2),
        _ => AnnouncedLength::Unknown,
    }
}

/// The 16-bit word at an offset.
#[must_use]
#[inline]
pub fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

/// The words that lie in `bytes`, big-endian.
#[inline]
pub fn words(bytes: &[u8]) -> impl Iterator<Item = u16> + '_ {
    bytes.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair))
}

fn counted_span(head: &[u8], at: usize, min: usize, max: usize) -> AnnouncedLength {
    match head.get(at).map(|&count| usize::from(count)) {
        None => AnnouncedLength::More,
        Some(count) if count < min || count > max => AnnouncedLength::Never,
        Some(count) => AnnouncedLength::Bytes(at + 1 + count),
    }
}

#[inline]
fn check_len(bytes: &[u8], need: usize) -> Result<(), WireError> {
    let (need, found) = (need as u16, bytes.len() as u16);
    match found.cmp(&need) {
        core::cmp::Ordering::Less => Err(WireError::Short { need, found }),
        core::cmp::Ordering::Equal => Ok(()),
        core::cmp::Ordering::Greater => Err(WireError::Long { need, found }),
    }
}

fn count_within(pdu: &[u8], at: usize, max: u16) -> Result<u16, WireError> {
    let found = word(pdu, at);
    let right = (1..=max).contains(&found);
    if right { Ok(found) } else { Err(WireError::Count { at: at as u16, found }) }
}

/// The data of a PDU that carries start, count, byte count and data.
fn block_data(pdu: &[u8]) -> Result<&[u8], WireError> {
    if pdu.len() < 6 {
        return Err(WireError::Short { need: 6, found: pdu.len() as u16 });
    }
    check_len(pdu, 6 + usize::from(pdu[5]))?;
    Ok(&pdu[6..])
}

#[inline(always)]
fn emit_pair(out: &mut [u8], code: u8, first: u16, second: u16) -> usize {
    let ([a, b], [c, d]) = (first.to_be_bytes(), second.to_be_bytes());
    out[..5].copy_from_slice(&[code, a, b, c, d]);
    5
}

fn emit_data(out: &mut [u8], function: Function, data: &[u8]) -> usize {
    out[0] = function.code();
    out[1] = data.len() as u8;
    out[2..2 + data.len()].copy_from_slice(data);
    2 + data.len()
}

fn emit_block(out: &mut [u8], code: u8, start: u16, count: u16, data: &[u8]) -> usize {
    emit_pair(out, code, start, count);
    out[5] = data.len() as u8;
    out[6..6 + data.len()].copy_from_slice(data);
    6 + data.len()
}
