//! One axis on Modbus, driven from its profile alone.
//!
//! Profile spaces: 0 holding registers, 1 coils, 2 discrete inputs, 3 input registers. In plans,
//! `send FUNCTION INDEX VALUE`: functions 05, 06 and 10 write the value at the index, 01 to 04 read
//! so many from it.

use super::encoding::{decode, encode, registers};
use super::request::{Answer, Ask, COILS_MAX, Request, WORDS_MAX};
use super::text::{self, Said};
use super::wire::{BROADCAST, Function, RequestPdu, Space};
use super::{ascii, rtu};
use crate::axis::Driver;
use crate::error::{Failure, Unsupported};
use crate::explain::Raw;
use crate::profile::{AxisKind, Parameter, Profile, Watchdog};
use crate::station::Class;

/// What is known of a Modbus drive of which nothing is known.
pub static GENERIC: Profile = Profile {
    name: "modbus",
    family: "modbus",
    protocol: "modbus",
    title: "Modbus device",
    source: "MODBUS Application Protocol Specification V1.1b3",
    axis: AxisKind::Rotary,
    parameters: &[],
    faults: &[],
    signals: &[],
    plans: &[],
    identity: None,
    ram: None,
    reach: &[],
    optional: &[],
    watchdog: Watchdog::None,
    reply_timeout_ms: super::host::REPLY_TIMEOUT_MS,
    caution: "Nothing is known of this drive: registers can be read and written by number only.",
};

/// The driver of one station.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    profile: &'static Profile,
    unit: u8,
}

impl Axis {
    /// The station `address`, which is a product of `profile`. Only the low byte counts.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        Self { profile, unit: address as u8 }
    }

    fn request(&self, ask: Ask, class: Class) -> Result<Request, Unsupported> {
        if self.unit == BROADCAST && ask.function().reads().is_some() {
            return Err(Unsupported::Forbidden("a broadcast brings no answer: it cannot read"));
        }
        Ok(Request { unit: self.unit, ask, class })
    }
}

impl Driver for Axis {
    type Request = Request;
    type Answer = Answer;

    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        u32::from(self.unit)
    }

    fn read(&self, parameter: &Parameter) -> Result<Request, Unsupported> {
        let space = Space::of_number(parameter.space).ok_or(Unsupported::NoSuchParameter)?;
        let count = if space.is_bits() { 1 } else { registers(parameter.encoding) };
        self.request(Ask::Read { space, start: parameter.index, count }, Class::Idempotent)
    }

    fn write(&self, parameter: &Parameter, raw: i64, class: Class) -> Result<Request, Unsupported> {
        match Space::of_number(parameter.space) {
            Some(Space::Coil) => {
                self.request(Ask::WriteCoil { address: parameter.index, on: raw != 0 }, class)
            }
            Some(Space::Holding) => {
                let pair = encode(parameter.encoding, raw).ok_or(Unsupported::BadArgument)?;
                let ask = match registers(parameter.encoding) {
                    1 => Ask::WriteRegister { address: parameter.index, value: pair[0] },
                    _ => two(parameter.index, pair),
                };
                self.request(ask, class)
            }
            Some(Space::Discrete | Space::Input) => {
                Err(Unsupported::Forbidden("inputs can only be read"))
            }
            None => Err(Unsupported::NoSuchParameter),
        }
    }

    fn send(&self, function: u8, index: u16, value: i64) -> Result<Request, Unsupported> {
        let word = || {
            let right = (-32_768..=65_535).contains(&value);
            if right { Ok(value as u16) } else { Err(Unsupported::BadArgument) }
        };
        let function = Function::of_code(function);
        if let Some(space) = function.reads() {
            let most = if space.is_bits() { COILS_MAX } else { space.read_max() };
            let count = word()?;
            if !(1..=most).contains(&count) {
                return Err(Unsupported::BadArgument);
            }
            return self.request(Ask::Read { space, start: index, count }, Class::Idempotent);
        }
        let ask = match function {
            Function::WriteCoil => Ask::WriteCoil { address: index, on: value != 0 },
            Function::WriteRegister => Ask::WriteRegister { address: index, value: word()? },
            Function::WriteRegisters => {
                let mut words = [0; WORDS_MAX];
                words[0] = word()?;
                Ask::WriteRegisters { start: index, count: 1, words }
            }
            _ => return Err(Unsupported::Forbidden("no such Modbus function in plans")),
        };
        self.request(ask, Class::Never)
    }

    fn parse(&self, text: &str) -> Result<Request, Unsupported> {
        let said = text::parse(text, Some(self.profile)).map_err(|_| Unsupported::BadText)?;
        let ask = ask_of(&said).ok_or(Unsupported::BadText)?;
        let reads = said.function.reads().is_some();
        self.request(ask, if reads { Class::Idempotent } else { Class::Never })
    }

    /// A frame of RTU, or of ASCII where it begins with a colon.
    fn decode(&self, frame: &Raw<'_>) -> Result<Request, Unsupported> {
        let mut plain = [0; ADU_MAX];
        let (_, pdu) = match frame.bytes {
            [b':', characters @ ..] => unpacked(characters, &mut plain),
            bytes => rtu::open(bytes).ok(),
        }
        .filter(|(unit, _)| frame.id.is_none() && *unit == self.unit)
        .ok_or(Unsupported::BadBytes)?;
        let ask = RequestPdu::parse(pdu).ok().and_then(|pdu| ask_of_pdu(&pdu));
        let ask = ask.ok_or(Unsupported::BadBytes)?;
        let reads = ask.function().reads().is_some();
        self.request(ask, if reads { Class::Idempotent } else { Class::Never })
    }

    fn answer(&mut self, parameter: Option<&Parameter>, answer: &Answer) -> Result<i64, Failure> {
        let reads = answer.function.reads();
        match (parameter, reads) {
            (Some(_), Some(space)) if space.is_bits() => Ok(i64::from(answer.words[0] & 1)),
            (Some(parameter), Some(_)) => {
                if answer.count != registers(parameter.encoding) {
                    return Err(Failure::Misbehaved);
                }
                Ok(decode(parameter.encoding, [answer.words[0], answer.words[1]]))
            }
            (Some(parameter), None) if answer.function == Function::WriteRegister => {
                Ok(decode(parameter.encoding, [answer.words[0], 0]))
            }
            _ => Ok(answer.raw()),
        }
    }
}

fn two(start: u16, pair: [u16; 2]) -> Ask {
    let mut words = [0; WORDS_MAX];
    words[..2].copy_from_slice(&pair);
    Ask::WriteRegisters { start, count: 2, words }
}

/// The request of a text; `None` when it carries more than a request holds.
/// Bytes of a frame at most, LRC or CRC included.
const ADU_MAX: usize = 256;

/// The unit and the PDU of an ASCII frame behind its colon, whose LRC agrees.
fn unpacked<'a>(characters: &[u8], plain: &'a mut [u8; ADU_MAX]) -> Option<(u8, &'a [u8])> {
    let digits = characters.strip_suffix(b"\r\n")?;
    let (pairs, []) = digits.as_chunks::<2>() else { return None };
    let bytes = plain.get_mut(..pairs.len())?;
    for (byte, [high, low]) in bytes.iter_mut().zip(pairs) {
        *byte = ascii::nibble(*high)? << 4 | ascii::nibble(*low)?;
    }
    ascii::open(&plain[..pairs.len()]).ok()
}

/// What a request on the wire asks, as far as a host asks such things.
fn ask_of_pdu(pdu: &RequestPdu<'_>) -> Option<Ask> {
    Some(match *pdu {
        RequestPdu::Read { space, start, count } => Ask::Read { space, start, count },
        RequestPdu::WriteCoil { address, on } => Ask::WriteCoil { address, on },
        RequestPdu::WriteRegister { address, value } => Ask::WriteRegister { address, value },
        RequestPdu::WriteCoils { start, count, bits: given } => {
            let mut bits = [0; COILS_MAX as usize / 8];
            bits.get_mut(..given.len())?.copy_from_slice(given);
            Ask::WriteCoils { start, count, bits }
        }
        RequestPdu::WriteRegisters { start, words: given } => {
            let (pairs, _) = given.as_chunks::<2>();
            let mut words = [0; WORDS_MAX];
            let its = words.get_mut(..pairs.len())?;
            its.iter_mut().zip(pairs).for_each(|(word, pair)| *word = u16::from_be_bytes(*pair));
            Ask::WriteRegisters { start, count: pairs.len() as u8, words }
        }
        RequestPdu::Unknown { .. } => return None,
    })
}

fn ask_of(said: &Said) -> Option<Ask> {
    let (start, count) = (said.start, said.count);
    if let Some(space) = said.function.reads() {
        return Some(Ask::Read { space, start, count });
    }
    match said.function {
        Function::WriteCoil => Some(Ask::WriteCoil { address: start, on: said.words[0] != 0 }),
        Function::WriteRegister => {
            Some(Ask::WriteRegister { address: start, value: said.words[0] })
        }
        Function::WriteCoils => {
            let mut bits = [0; COILS_MAX as usize / 8];
            for (at, &word) in said.words.iter().enumerate().take(usize::from(count)) {
                bits[at / 8] |= (word as u8 & 1) << (at % 8);
            }
            Some(Ask::WriteCoils { start, count, bits })
        }
        _ if usize::from(count) > WORDS_MAX => None,
        _ => {
            let mut words = [0; WORDS_MAX];
            words.copy_from_slice(&said.words[..WORDS_MAX]);
            Some(Ask::WriteRegisters { start, count: count as u8, words })
        }
    }
}
