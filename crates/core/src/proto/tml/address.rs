//! Memory by its address: `@0x03B0`, `@0x0228:i32`, `pm@0x4000`, `spi@0x4000`.

use super::explain::TmlDissector;
use crate::explain::{AddressNotation, ExplainSink, FieldValue, TextError};
use crate::profile::{
    Access, Encoding, Parameter, ParameterAddress, parse_address_number, parse_encoding,
};

/// The memories, by their words in TML and as [`Parameter::space`].
const MEMORIES: [(&str, u8); 3] = [("dm", 0), ("pm", 1), ("spi", 2)];

const fn is_variable_type(encoding: Encoding) -> bool {
    use Encoding as E;
    matches!(encoding, E::I16 | E::U16 | E::I32 | E::U32 | E::Fixed)
}

/// Writes an address: `@0x0228`, `pm@0x4000`.
fn write(address: &ParameterAddress, out: &mut dyn core::fmt::Write) -> core::fmt::Result {
    let memory = match MEMORIES.iter().find(|(_, space)| *space == address.space) {
        Some((_, 0)) | None => "",
        Some((word, _)) => word,
    };
    write!(out, "{memory}@0x{:04X}", address.index)
}

impl AddressNotation for TmlDissector {
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let (memory, place) = text.trim().split_once('@')?;
        let known = MEMORIES.iter().find(|(word, _)| word.eq_ignore_ascii_case(memory.trim()));
        let space = if memory.trim().is_empty() { 0 } else { known?.1 };
        let mut parts = place.split(':');
        let number = parse_address_number(parts.next()?.trim())?;
        let Ok(index) = u16::try_from(number) else {
            return Some(Err(TextError { at: 0, expected: "an address, 0 to 0xFFFF" }));
        };
        let mut address = ParameterAddress::new(index, space);
        if let Some(word) = parts.next() {
            let at = word.as_ptr() as usize - text.as_ptr() as usize;
            let encoding = parse_encoding(word.trim()).filter(|known| is_variable_type(*known));
            if encoding.is_none() || parts.next().is_some() {
                let expected = "a type: i16, u16, i32, u32 or fixed";
                return Some(Err(TextError { at, expected }));
            }
            address.encoding = encoding;
        }
        Some(Ok(address))
    }

    fn address_example(&self) -> &'static str {
        "@0x0228:i32"
    }

    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        // A caller that gives no room gets no text.
        let _ = write(address, out);
    }

    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        let data = address.space == 0;
        Parameter {
            access: if data { Access::ReadWrite } else { Access::Read },
            moves: data,
            ..address.describe(Encoding::I16)
        }
    }

    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let number = |name| field(name).and_then(FieldValue::integer);
        number("address") == Some(address.index.into())
    }

    fn explain_parameter(&self, parameter: &Parameter, sink: &mut dyn ExplainSink) {
        super::explain::names::explain_reach(parameter, sink);
    }
}

#[cfg(test)]
mod tests {
    use crate::explain::AddressNotation as _;
    use crate::profile::{Encoding, ParameterAddress};

    use crate::proto::tml::explain::SERIAL as DISSECTOR;

    #[test]
    fn memory_is_read_by_address() {
        let read = |text: &str| DISSECTOR.parse_address(text).expect(text).expect(text);
        assert_eq!(read("@0x03B0"), ParameterAddress::new(0x3B0, 0));
        assert_eq!(read("@03B0h"), ParameterAddress::new(0x3B0, 0));
        assert_eq!(read("dm@0x228:i32").encoding, Some(Encoding::I32));
        assert_eq!(read("pm@0x4000"), ParameterAddress::new(0x4000, 1));
        assert_eq!(read("SPI@0x4000").space, 2);
        assert_eq!(read("@0x2A8:fixed").encoding, Some(Encoding::Fixed));
    }

    #[test]
    fn a_text_that_is_no_address_is_refused() {
        for text in ["APOS", "0x228", "rom@0x1", "@", "@x"] {
            assert_eq!(DISSECTOR.parse_address(text), None, "{text}");
        }
        for text in ["@0x10000", "@0x228:f32", "@0x228:i16:i32"] {
            assert!(DISSECTOR.parse_address(text).unwrap().is_err(), "{text}");
        }
    }
}
