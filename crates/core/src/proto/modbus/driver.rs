//! One axis on Modbus, driven by its profile.
//!
//! Profile spaces: 0 holding registers, 1 coils, 2 discrete inputs, 3 input registers. In plans, `send
//! FUNCTION INDEX VALUE`: functions 05, 06 and 10 write the value at the index, 01 to 04 read this number
//! of items from it.

use super::encoding::{REGISTERS_MAX, decode, encode, register_count};
use super::host_request::{Answer, COILS_MAX, HostRequest, RequestBody, WORDS_MAX};
use super::text::{self, ParsedRequest};
use super::wire::{BROADCAST, Exception, Function, RequestPdu, Space};
use super::{ascii, device_id, rtu, tcp};
use crate::axis::{AnswerDecoder, Driver, Refusal, RequestEncoder, WriteRules};
use crate::error::{Failure, Unsupported};
use crate::explain::RawFrame;
use crate::profile::{AxisKind, MotionRules, Parameter, Profile, Watchdog};
use crate::proto::{GROUP, sub_axis, with_sub_axis};
use crate::station::RequestClass;

/// Profile of an unknown Modbus drive.
pub static GENERIC: Profile = Profile {
    name: "modbus",
    family: "modbus",
    protocol: "modbus",
    title: "Modbus device",
    source: "MODBUS Application Protocol Specification V1.1b3",
    axis: AxisKind::Rotary,
    motors: 1,
    further_motors: &[],
    lists_motors: false,
    parameters: &[],
    faults: &[],
    signals: &[],
    plans: &[],
    identity: None,
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: super::host::REPLY_TIMEOUT_MS,
    multiple_writes: false,
    line: None,
    caution: "Nothing is known of this drive: registers can be read and written by number only.",
};

/// The driver of one station.
#[derive(Clone, Copy, Debug)]
pub struct ModbusDriver {
    profile: &'static Profile,
    unit: u8,
    /// The motor behind the unit; 0 where none is stated. Each has a profile of its own.
    motor: u8,
}

impl ModbusDriver {
    /// The station `address`, which is a product of `profile`. Only the low byte counts, and that of [`GROUP`] is
    /// the broadcast.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        Self { profile, unit: address as u8, motor: sub_axis(address) }
    }

    fn new_request(
        &self,
        request: RequestBody,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        if self.unit == BROADCAST && request.is_read() {
            return Err(Unsupported::Forbidden("a broadcast brings no answer: it cannot read"));
        }
        Ok(HostRequest { unit: self.unit, body: request, class })
    }
}

impl RequestEncoder for ModbusDriver {
    type Request = HostRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        let space = Space::of_number(parameter.space).ok_or(Unsupported::NoSuchParameter)?;
        let count = if space.is_bits() { 1 } else { register_count(parameter.encoding) };
        self.new_request(
            RequestBody::Read { space, start: parameter.index, count },
            RequestClass::Idempotent,
        )
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        match Space::of_number(parameter.space) {
            Some(Space::Coil) => self.new_request(
                RequestBody::WriteCoil { address: parameter.index, on: raw != 0 },
                class,
            ),
            Some(Space::Holding) => {
                let words = encode(parameter.encoding, raw).ok_or(Unsupported::BadArgument)?;
                let request = match register_count(parameter.encoding) {
                    1 if !self.profile.multiple_writes => {
                        RequestBody::WriteRegister { address: parameter.index, value: words[0] }
                    }
                    count => write_registers(parameter.index, &words[..usize::from(count)]),
                };
                self.new_request(request, class)
            }
            Some(Space::Discrete | Space::Input) => {
                Err(Unsupported::Forbidden("inputs can only be read"))
            }
            None => Err(Unsupported::NoSuchParameter),
        }
    }

    fn write_together_request(
        &self,
        writes: &[(&Parameter, i64)],
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        const NEIGHBOURS: Unsupported = Unsupported::Forbidden(
            "only holding registers one behind the other are written together",
        );
        let (mut words, mut count) = ([0; WORDS_MAX], 0);
        let first = writes.first().map_or(0, |(parameter, _)| usize::from(parameter.index));
        for (parameter, raw) in writes {
            let len = usize::from(register_count(parameter.encoding));
            let is_next = usize::from(parameter.index) == first + count
                && Space::of_number(parameter.space) == Some(Space::Holding);
            let place = words.get_mut(count..count + len).filter(|_| is_next && len > 0);
            let place = place.ok_or(NEIGHBOURS)?;
            let encoded = encode(parameter.encoding, *raw).ok_or(Unsupported::BadArgument)?;
            place.copy_from_slice(&encoded[..len]);
            count += len;
        }
        let body = RequestBody::WriteRegisters { start: first as u16, count: count as u8, words };
        self.new_request(body, class)
    }

    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let function = Function::of_code(function);
        if let Some(space) = function.read_space() {
            let max = if space.is_bits() { COILS_MAX } else { space.read_max() };
            let count = word_value(value)?;
            if !(1..=max).contains(&count) {
                return Err(Unsupported::BadArgument);
            }
            return self.new_request(
                RequestBody::Read { space, start: index, count },
                RequestClass::Idempotent,
            );
        }
        let request = match function {
            Function::WriteCoil => RequestBody::WriteCoil { address: index, on: value != 0 },
            Function::WriteRegister if self.profile.multiple_writes => {
                write_registers(index, &[word_value(value)?])
            }
            Function::WriteRegister => {
                RequestBody::WriteRegister { address: index, value: word_value(value)? }
            }
            Function::WriteRegisters => {
                let mut words = [0; WORDS_MAX];
                words[0] = word_value(value)?;
                RequestBody::WriteRegisters { start: index, count: 1, words }
            }
            _ => return Err(Unsupported::Forbidden("no such Modbus function in plans")),
        };
        self.new_request(request, RequestClass::NoRetry)
    }

    fn parse_request(&self, text: &str) -> Result<HostRequest, Unsupported> {
        let parsed = text::parse(text, Some(self.profile)).map_err(|_| Unsupported::BadText)?;
        let request = body_of_text(&parsed).ok_or(Unsupported::BadText)?;
        self.new_request(
            request,
            if request.is_read() { RequestClass::Idempotent } else { RequestClass::NoRetry },
        )
    }

    /// A frame of RTU, of ASCII where it begins with a colon, or of TCP without a valid check sum.
    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<HostRequest, Unsupported> {
        let mut plain = [0; ADU_MAX];
        let (_, pdu) = match frame.bytes {
            [b':', characters @ ..] => unpack_ascii(characters, &mut plain),
            bytes => rtu::decode(bytes)
                .or_else(|_| tcp::decode(bytes).map(|(header, pdu)| (header.unit, pdu)))
                .ok(),
        }
        .filter(|(unit, _)| frame.id.is_none() && *unit == self.unit)
        .ok_or(Unsupported::BadBytes)?;
        let request = RequestPdu::parse(pdu).ok().and_then(|pdu| body_of_pdu(&pdu));
        let request = request.ok_or(Unsupported::BadBytes)?;
        self.new_request(
            request,
            if request.is_read() { RequestClass::Idempotent } else { RequestClass::NoRetry },
        )
    }
}

impl AnswerDecoder for ModbusDriver {
    type Answer = Answer;

    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Answer,
    ) -> Result<i64, Failure> {
        let reads = answer.function.read_space();
        match (parameter, reads) {
            (Some(_), Some(space)) if space.is_bits() => Ok(i64::from(answer.words[0] & 1)),
            (Some(parameter), Some(_)) => {
                if answer.count != register_count(parameter.encoding) {
                    return Err(Failure::Misbehaved);
                }
                Ok(decode(parameter.encoding, first_words(answer)))
            }
            (Some(parameter), None) if answer.function == Function::WriteRegister => {
                Ok(decode(parameter.encoding, first_words(answer)))
            }
            _ => Ok(answer.raw()),
        }
    }

    /// Exception 02: a drive without the option that has the register.
    fn refusal(&self, code: u32) -> Refusal {
        match u8::try_from(code).map(Exception::of_code) {
            Ok(Exception::IllegalAddress) => Refusal::Missing,
            Ok(Exception::Acknowledge) => Refusal::Accepted,
            Ok(Exception::DeviceBusy) => Refusal::Busy,
            _ => Refusal::Final,
        }
    }
}

impl WriteRules for ModbusDriver {}

impl Driver for ModbusDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        if self.is_group() { GROUP } else { with_sub_axis(self.unit.into(), self.motor) }
    }

    /// Unit 0 is every station, and none of them answers (MSL 2.1).
    fn is_group(&self) -> bool {
        self.unit == BROADCAST
    }
}

fn word_value(value: i64) -> Result<u16, Unsupported> {
    let right = (-32_768..=65_535).contains(&value);
    if right { Ok(value as u16) } else { Err(Unsupported::BadArgument) }
}

fn write_registers(start: u16, values: &[u16]) -> RequestBody {
    let mut words = [0; WORDS_MAX];
    words[..values.len()].copy_from_slice(values);
    RequestBody::WriteRegisters { start, count: values.len() as u8, words }
}

/// The first registers of an answer.
fn first_words(answer: &Answer) -> [u16; REGISTERS_MAX] {
    let mut words = [0; REGISTERS_MAX];
    words.copy_from_slice(&answer.words[..REGISTERS_MAX]);
    words
}

/// The request of a text; `None` when it carries more than a request holds.
/// Bytes of a frame at most, LRC or CRC included.
const ADU_MAX: usize = 256;

/// Unit and PDU of an ASCII frame after its colon, with a valid LRC.
fn unpack_ascii<'a>(characters: &[u8], plain: &'a mut [u8; ADU_MAX]) -> Option<(u8, &'a [u8])> {
    let digits = characters.strip_suffix(b"\r\n")?;
    let (pairs, []) = digits.as_chunks::<2>() else { return None };
    let bytes = plain.get_mut(..pairs.len())?;
    for (byte, [high, low]) in bytes.iter_mut().zip(pairs) {
        *byte = ascii::hex_value(*high)? << 4 | ascii::hex_value(*low)?;
    }
    ascii::decode(&plain[..pairs.len()]).ok()
}

/// The request of a PDU, as far as hosts send such requests.
fn body_of_pdu(pdu: &RequestPdu<'_>) -> Option<RequestBody> {
    Some(match *pdu {
        RequestPdu::Read { space, start, count } => RequestBody::Read { space, start, count },
        RequestPdu::WriteCoil { address, on } => RequestBody::WriteCoil { address, on },
        RequestPdu::WriteRegister { address, value } => {
            RequestBody::WriteRegister { address, value }
        }
        RequestPdu::WriteCoils { start, count, bits: given } => {
            let mut bits = [0; COILS_MAX as usize / 8];
            bits.get_mut(..given.len())?.copy_from_slice(given);
            RequestBody::WriteCoils { start, count, bits }
        }
        RequestPdu::WriteRegisters { start, words: given } => {
            let (words, count) = held_words(given)?;
            RequestBody::WriteRegisters { start, count, words }
        }
        RequestPdu::ReadWriteRegisters { read_start, read_count, start, words: given } => {
            let (words, count) = held_words(given)?;
            RequestBody::ReadWriteRegisters { read_start, read_count, start, count, words }
        }
        RequestPdu::Unknown { function: device_id::FUNCTION, data } => match *data {
            [device_id::MEI_TYPE, code, object] if code == device_id::access_code(object) => {
                RequestBody::DeviceId { object, part: 0 }
            }
            _ => return None,
        },
        RequestPdu::Unknown { .. } => return None,
    })
}

/// The words of a PDU, and how many they are; `None` for more than a request holds.
fn held_words(given: &[u8]) -> Option<([u16; WORDS_MAX], u8)> {
    let (pairs, _) = given.as_chunks::<2>();
    let mut words = [0; WORDS_MAX];
    let its = words.get_mut(..pairs.len())?;
    its.iter_mut().zip(pairs).for_each(|(word, pair)| *word = u16::from_be_bytes(*pair));
    Some((words, pairs.len() as u8))
}

fn body_of_text(parsed: &ParsedRequest) -> Option<RequestBody> {
    let (start, count) = (parsed.start, parsed.count);
    if let Some(space) = parsed.function.read_space() {
        return Some(RequestBody::Read { space, start, count });
    }
    match parsed.function {
        Function::Unknown(device_id::FUNCTION) => {
            Some(RequestBody::DeviceId { object: start as u8, part: count })
        }
        Function::WriteCoil => {
            Some(RequestBody::WriteCoil { address: start, on: parsed.words[0] != 0 })
        }
        Function::WriteRegister => {
            Some(RequestBody::WriteRegister { address: start, value: parsed.words[0] })
        }
        Function::WriteCoils => {
            let mut bits = [0; COILS_MAX as usize / 8];
            for (at, &word) in parsed.words.iter().enumerate().take(usize::from(count)) {
                bits[at / 8] |= (word as u8 & 1) << (at % 8);
            }
            Some(RequestBody::WriteCoils { start, count, bits })
        }
        _ if usize::from(count) > WORDS_MAX => None,
        _ => {
            let mut words = [0; WORDS_MAX];
            words.copy_from_slice(&parsed.words[..WORDS_MAX]);
            let count = count as u8;
            Some(match parsed.read {
                None => RequestBody::WriteRegisters { start, count, words },
                Some((read_start, read_count)) => {
                    RequestBody::ReadWriteRegisters { read_start, read_count, start, count, words }
                }
            })
        }
    }
}
