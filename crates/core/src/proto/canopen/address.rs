//! Objects by their number: `0x2030:1`, `2030h:1`, `0x2030:1:u16`.

use super::explain::CanopenDissector;
use super::sdo::AbortCode;
use super::sdo::ObjectIndex;
use crate::explain::{AddressNotation, FieldValue, TextError};
use crate::profile::{
    Access, Encoding, Parameter, ParameterAddress, Persistence, parse_address_number,
    parse_encoding,
};

/// Objects of a node's second axis lie so far above those of the first (CiA 402-1: up to eight axes).
const AXIS_STEP: u16 = 0x800;
/// The objects of the first axis, and those of all.
const FIRST_AXIS: core::ops::Range<u16> = 0x6000..0x6800;
const EVERY_AXIS: core::ops::Range<u16> = 0x6000..0xA000;

/// Offset of the objects of a node's axis from those of the first axis, which is 0 or 1.
pub const fn axis_offset(sub_axis: u8) -> u16 {
    sub_axis.saturating_sub(1) as u16 * AXIS_STEP
}

/// Which axis of a node an object is of, from 0; `None` for an object of the node.
pub fn axis_number(index: u16) -> Option<u16> {
    EVERY_AXIS.contains(&index).then(|| (index - FIRST_AXIS.start) / AXIS_STEP)
}

/// The index of an object of the first axis where it is of the axis that lies `offset` above. Objects
/// of the node have one index for all axes.
pub const fn axis_index(index: u16, offset: u16) -> u16 {
    match index {
        0x6000..0x6800 => index + offset,
        _ => index,
    }
}

fn parse_parts<'a>(
    text: &'a str,
    index: u32,
    parts: impl Iterator<Item = &'a str>,
) -> Result<ParameterAddress, TextError> {
    let expected = "an index, 0x1 to 0xFFFF";
    let index = u16::try_from(index).ok().filter(|index| *index > 0);
    let mut address = ParameterAddress::new(index.ok_or(TextError { at: 0, expected })?, 0);
    let mut has_sub = false;
    for part in parts {
        let wrong = |expected| TextError { at: part_offset(part, text), expected };
        let encoding = parse_encoding(part.trim()).filter(|encoding| is_object_type(*encoding));
        match (encoding, has_sub, address.encoding) {
            (Some(encoding), _, None) => address.encoding = Some(encoding),
            (None, false, None) => {
                let sub = parse_address_number(part.trim()).and_then(|sub| u8::try_from(sub).ok());
                address.space = sub.ok_or(wrong("a sub-index, 0 to 255, or a type"))?;
                has_sub = true;
            }
            (None, true, None) => return Err(wrong(EXPECTED_TYPE)),
            (_, _, Some(_)) => return Err(wrong("the end of the address")),
        }
    }
    if EVERY_AXIS.contains(&address.index) && !FIRST_AXIS.contains(&address.index) {
        let first = FIRST_AXIS.start + (address.index - FIRST_AXIS.start) % AXIS_STEP;
        address.like = Some((first, address.space));
    }
    Ok(address)
}

fn part_offset(part: &str, text: &str) -> usize {
    part.as_ptr() as usize - text.as_ptr() as usize
}

const EXPECTED_TYPE: &str = "a type: u8, i8, u16, i16, u32, i32, u64, i64, f32, f64, str or bytes";

const fn is_object_type(encoding: Encoding) -> bool {
    !matches!(encoding, Encoding::Bit | Encoding::Fixed)
}

/// Writes an address: `2030h:1`; without a sub-index where it is 0.
fn write(address: &ParameterAddress, out: &mut dyn core::fmt::Write) -> core::fmt::Result {
    match address.space {
        0 => write!(out, "{:04X}h", address.index),
        sub => write!(out, "{:04X}h:{sub}", address.index),
    }
}

impl AddressNotation for CanopenDissector {
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let mut parts = text.split(':');
        let index = parts.next()?.trim();
        let is_hex = index.starts_with("0x") || index.starts_with("0X");
        // A word such as "each" is none.
        let has_digit = index.bytes().any(|c| c.is_ascii_digit());
        let ends_so = has_digit && index.ends_with(['h', 'H']);
        if !is_hex && !ends_so {
            return None;
        }
        let index = parse_address_number(index)?;
        Some(parse_parts(text, index, parts))
    }

    fn address_example(&self) -> &'static str {
        "0x2030:1:u16"
    }

    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        // A caller that gives no room gets no text.
        let _ = write(address, out);
    }

    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        let plain = address.describe(Encoding::AnyLength);
        let ObjectIndex { index, .. } = ObjectIndex { index: address.index, sub: address.space };
        Parameter {
            moves: !matches!(index, 0x1000..=0x1F50 | 0x1F52..=0x1FFF),
            persistence: match index {
                // Store and restore parameters; program download.
                0x1010 | 0x1011 | 0x1F50 => Persistence::Always,
                _ => Persistence::Volatile,
            },
            access: match plain.encoding {
                Encoding::AnyLength => Access::Read,
                _ => Access::ReadWrite,
            },
            ..plain
        }
    }

    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let number = |name| field(name).and_then(FieldValue::integer);
        number("index") == Some(address.index.into()) && number("sub") == Some(address.space.into())
    }

    fn refuses_blocks(&self, code: u32) -> bool {
        AbortCode(code) == AbortCode::SPECIFIER
    }
}

#[cfg(test)]
mod tests {
    use super::CanopenDissector;
    use crate::explain::AddressNotation as _;
    use crate::profile::{Encoding, ParameterAddress};

    const DISSECTOR: CanopenDissector = CanopenDissector;

    fn read(text: &str) -> ParameterAddress {
        DISSECTOR.parse_address(text).expect(text).expect(text)
    }

    #[test]
    fn addresses_are_read_in_both_notations() {
        for text in ["0x2030:1", "2030h:1", "2030h:01", "0x2030:0x1", " 2030h : 1 "] {
            let text = text.trim();
            assert_eq!(read(text), ParameterAddress::new(0x2030, 1), "{text}");
        }
        assert_eq!(read("0x2030"), ParameterAddress::new(0x2030, 0));
        assert_eq!(read("0x2030:1:u16").encoding, Some(Encoding::U16));
        assert_eq!(read("1008h:str").encoding, Some(Encoding::Text));
        assert_eq!(read("0x6864:0:i32").like, Some((0x6064, 0)));
        assert_eq!(read("0x9FFF").like, Some((0x67FF, 0)));
        assert_eq!(read("0x6064").like, None);
    }

    #[test]
    fn a_text_that_is_no_address_is_refused() {
        for text in ["max current", "2030", "beach", "", "h", "0x"] {
            assert_eq!(DISSECTOR.parse_address(text), None, "{text}");
        }
        for text in ["0x12345", "0x0", "0x2030:256", "0x2030:1:u7", "0x2030:1:u8:1", "2030h:1:2"] {
            assert!(DISSECTOR.parse_address(text).unwrap().is_err(), "{text}");
        }
    }

    #[test]
    fn communication_moves_nothing() {
        assert!(!DISSECTOR.describe_address(&read("0x1018:1")).moves);
        assert!(DISSECTOR.describe_address(&read("0x1F51:1")).moves);
        assert!(DISSECTOR.describe_address(&read("0x2030:1:u16")).moves);
    }
}
