//! Requests and results of the host end, as small values.

use super::explain::write_effect;
use super::wire::{Function, RequestPdu, Space, WRITE_BITS_MAX, WireFormat, words};
use super::{ascii, device_id, rtu, tcp};
use crate::explain::Effect;
use crate::profile::Profile;
use crate::station::{self, RequestClass};

/// Registers that a request or an answer carries inline.
pub const WORDS_MAX: usize = 16;
/// Coils that a request writes.
pub const COILS_MAX: u16 = 256;

const _: () = assert!(COILS_MAX <= WRITE_BITS_MAX);

/// One request to one station, or to all.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct HostRequest {
    /// Station address; 0 is every station, which none answers.
    pub unit: u8,
    /// Content.
    pub body: RequestBody,
    /// Class, set by the driver: whether it may be sent again, and whether it is a stop.
    pub class: RequestClass,
}

/// Content of a request.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum RequestBody {
    /// 01 to 04.
    Read {
        /// Address space.
        space: Space,
        /// First address.
        start: u16,
        /// Number of registers or bits.
        count: u16,
    },
    /// 05.
    WriteCoil {
        /// Address of the coil, from 0.
        address: u16,
        /// On or off.
        on: bool,
    },
    /// 06.
    WriteRegister {
        /// Address of the register, from 0.
        address: u16,
        /// New value.
        value: u16,
    },
    /// 0F.
    WriteCoils {
        /// First address.
        start: u16,
        /// Number of bits, at most [`COILS_MAX`].
        count: u16,
        /// Eight to a byte, lowest address in bit 0.
        bits: [u8; COILS_MAX as usize / 8],
    },
    /// 10.
    WriteRegisters {
        /// First address.
        start: u16,
        /// Number of valid `words`, at most [`WORDS_MAX`].
        count: u8,
        /// The values.
        words: [u16; WORDS_MAX],
    },
    /// 17: writes, then reads.
    ReadWriteRegisters {
        /// First address to read.
        read_start: u16,
        /// Number of registers to read.
        read_count: u16,
        /// First address to write.
        start: u16,
        /// Number of valid `words`, at most [`WORDS_MAX`].
        count: u8,
        /// The values.
        words: [u16; WORDS_MAX],
    },
    /// 43/14: the text of an object of the device identification.
    DeviceId {
        /// Identifier of the object of the device identification.
        object: u8,
        /// Index of the seven bytes of it that the answer contains.
        part: u16,
    },
}

impl RequestBody {
    /// Function code.
    #[must_use]
    #[inline]
    pub const fn function(&self) -> Function {
        match *self {
            Self::Read { space, .. } => space.read_function(),
            Self::WriteCoil { .. } => Function::WriteCoil,
            Self::WriteRegister { .. } => Function::WriteRegister,
            Self::WriteCoils { .. } => Function::WriteCoils,
            Self::WriteRegisters { .. } => Function::WriteRegisters,
            Self::ReadWriteRegisters { .. } => Function::ReadWriteRegisters,
            Self::DeviceId { .. } => Function::Unknown(device_id::FUNCTION),
        }
    }

    /// Returns whether it only reads.
    #[must_use]
    pub const fn is_read(&self) -> bool {
        matches!(self, Self::Read { .. } | Self::DeviceId { .. })
    }

    /// Calls `with` with the PDU.
    pub fn with_pdu<T>(&self, with: impl FnOnce(RequestPdu<'_>) -> T) -> T {
        match *self {
            Self::Read { space, start, count } => with(RequestPdu::Read { space, start, count }),
            Self::WriteCoil { address, on } => with(RequestPdu::WriteCoil { address, on }),
            Self::WriteRegister { address, value } => {
                with(RequestPdu::WriteRegister { address, value })
            }
            Self::WriteCoils { start, count, ref bits } => {
                let count = count.min(COILS_MAX);
                let bits = &bits[..usize::from(count).div_ceil(8)];
                with(RequestPdu::WriteCoils { start, count, bits })
            }
            Self::WriteRegisters { start, count, ref words } => {
                let (data, len) = word_bytes(words, count);
                with(RequestPdu::WriteRegisters { start, words: &data[..len] })
            }
            Self::ReadWriteRegisters { read_start, read_count, start, count, ref words } => {
                let (data, len) = word_bytes(words, count);
                let words = &data[..len];
                with(RequestPdu::ReadWriteRegisters { read_start, read_count, start, words })
            }
            Self::DeviceId { object, .. } => {
                let (function, data) = (device_id::FUNCTION, device_id::request_data(object));
                with(RequestPdu::Unknown { function, data: &data })
            }
        }
    }

    /// The text of the requested object in the data of a reply. A device without the object lists others.
    pub(super) fn device_text<'a>(&self, data: &'a [u8]) -> Option<&'a [u8]> {
        let Self::DeviceId { object, .. } = self else { return None };
        device_id::objects(data)?.find_map(|(found, text)| (found == *object).then_some(text))
    }

    /// Bytes of data in a good reply to a request that reads registers or bits.
    #[inline]
    pub(super) const fn reply_data_len(&self) -> Option<u16> {
        match *self {
            Self::Read { space, count, .. } => Some(space.reply_bytes(count) as u16),
            Self::ReadWriteRegisters { read_count, .. } => Some(2 * read_count),
            _ => None,
        }
    }

    /// First address, and the field that a good reply repeats: the value or the count.
    #[must_use]
    #[inline]
    pub const fn reply_fields(&self) -> (u16, u16) {
        match *self {
            Self::Read { start, count, .. } => (start, count),
            Self::WriteCoil { address, on } => (address, if on { 0xFF00 } else { 0 }),
            Self::WriteRegister { address, value } => (address, value),
            Self::WriteCoils { start, count, .. } => (start, count),
            Self::WriteRegisters { start, count, .. } => (start, count as u16),
            Self::ReadWriteRegisters { read_start, read_count, .. } => (read_start, read_count),
            Self::DeviceId { object, .. } => (device_id::access_code(object) as u16, 0),
        }
    }
}

/// The bytes of `count` words, and how many they are.
fn word_bytes(words: &[u16; WORDS_MAX], count: u8) -> ([u8; 2 * WORDS_MAX], usize) {
    let mut data = [0; 2 * WORDS_MAX];
    for (pair, word) in data.as_chunks_mut::<2>().0.iter_mut().zip(words) {
        *pair = word.to_be_bytes();
    }
    (data, 2 * usize::from(count).min(WORDS_MAX))
}

impl HostRequest {
    /// Writes the frame and returns its length.
    #[inline]
    pub fn emit(&self, format: WireFormat, out: &mut [u8]) -> usize {
        // Reads are the most frequent request, so they are checked first.
        if let (WireFormat::Rtu, RequestBody::Read { space, start, count }) = (format, self.body) {
            return rtu::emit_request(self.unit, &RequestPdu::Read { space, start, count }, out);
        }
        self.emit_any(format, out)
    }

    /// Header of the request as that transaction.
    pub(super) const fn tcp_header(&self, transaction: u16) -> tcp::Header {
        tcp::Header { transaction, unit: self.unit }
    }

    #[inline(never)]
    fn emit_any(&self, format: WireFormat, out: &mut [u8]) -> usize {
        self.body.with_pdu(|pdu| match format {
            WireFormat::Rtu => rtu::emit_request(self.unit, &pdu, out),
            WireFormat::Ascii => ascii::emit(self.unit, out, |out| pdu.emit(out)),
            WireFormat::Tcp => tcp::emit(self.tcp_header(0), out, |out| pdu.emit(out)),
        })
    }
}

impl station::Request for HostRequest {
    fn effect(&self, profile: &'static Profile) -> Effect {
        let (space, start, count) = match self.body {
            _ if self.class == RequestClass::Stop => return Effect::NOTHING,
            RequestBody::Read { .. } | RequestBody::DeviceId { .. } => return Effect::NOTHING,
            RequestBody::WriteCoil { address, .. } => (Space::Coil, address, 1),
            RequestBody::WriteCoils { start, count, .. } => (Space::Coil, start, count),
            RequestBody::WriteRegister { address, .. } => (Space::Holding, address, 1),
            RequestBody::WriteRegisters { start, count, .. }
            | RequestBody::ReadWriteRegisters { start, count, .. } => {
                (Space::Holding, start, count.into())
            }
        };
        write_effect(Some(profile), space, start, count)
    }

    fn class(&self) -> RequestClass {
        self.class
    }
}

/// A station's reply that is not a refusal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Answer {
    /// Station address.
    pub unit: u8,
    /// Function.
    pub function: Function,
    /// First requested address.
    pub start: u16,
    /// Bits or registers read or written.
    pub count: u16,
    /// Values of a read, up to [`WORDS_MAX`] words; bits are sixteen to a word, the lowest address in bit
    /// 0. For a
    /// single write, the repeated value, 0 or 1 for a coil. For longer reads see
    /// [`SerialHost::payload`](super::host::SerialHost::payload).
    pub words: [u16; WORDS_MAX],
}

impl Answer {
    /// To be filled in.
    pub(super) const BLANK: Self =
        Self { unit: 0, function: Function::Unknown(0), start: 0, count: 0, words: [0; WORDS_MAX] };

    /// Makes a blank the good answer to a request, with the data of a read.
    #[inline]
    pub(super) fn fill(&mut self, request: &HostRequest, data: &[u8]) {
        self.unit = request.unit;
        self.function = request.body.function();
        (self.start, self.count) = request.body.reply_fields();
        match request.body {
            RequestBody::Read { space, .. } if space.is_bits() => {
                for (at, &byte) in data.iter().enumerate().take(2 * WORDS_MAX) {
                    self.words[at / 2] |= u16::from(byte) << (8 * (at % 2));
                }
            }
            RequestBody::Read { count: 1, .. } => {
                self.words.iter_mut().zip(words(data)).take(1).for_each(|(to, word)| *to = word);
            }
            RequestBody::Read { .. } | RequestBody::ReadWriteRegisters { .. } => {
                self.words.iter_mut().zip(words(data)).for_each(|(index, word)| *index = word);
            }
            RequestBody::WriteCoil { on, .. } => (self.count, self.words[0]) = (1, on.into()),
            RequestBody::WriteRegister { value, .. } => (self.count, self.words[0]) = (1, value),
            RequestBody::WriteCoils { .. } | RequestBody::WriteRegisters { .. } => {}
            RequestBody::DeviceId { part, .. } => {
                self.count = 4;
                self.words[..4].copy_from_slice(&device_id::part_words(data, part));
            }
        }
    }

    /// The answer as one number, the first register highest, as far as 64 bits reach; bits with the
    /// lowest address in bit 0; the value written, or how many.
    #[must_use]
    pub fn raw(&self) -> i64 {
        match self.function.read_space() {
            Some(space) if space.is_bits() => {
                let len = usize::from(self.count).div_ceil(16).min(4);
                self.words[..len].iter().rev().fold(0, |raw, &word| raw << 16 | i64::from(word))
            }
            Some(_) => self.number(),
            None if self.function == Function::ReadWriteRegisters => self.number(),
            None if self.function == Function::Unknown(device_id::FUNCTION) => self.number(),
            None if matches!(self.function, Function::WriteCoil | Function::WriteRegister) => {
                i64::from(self.words[0])
            }
            None => i64::from(self.count),
        }
    }

    fn number(&self) -> i64 {
        let len = usize::from(self.count).min(4);
        self.words[..len].iter().fold(0, |raw, &word| raw << 16 | i64::from(word))
    }
}
