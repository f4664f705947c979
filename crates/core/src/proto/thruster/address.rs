//! Values by letters (`QV`), and internal parameters by type (`SP 12`).

use super::explain::ThrusterDissector;
use super::rules::{class_of, is_stored};
use super::wire::{CommandKind, CommandWord, Request, Width};
use crate::explain::{AddressNotation, FieldValue, TextError};
use crate::profile::{
    Access, Encoding, Parameter, ParameterAddress, Persistence, parse_address_number,
    parse_encoding,
};
use crate::station::RequestClass;

/// The space of commands' values, and that of internal parameters.
const COMMANDS: u8 = 0;
const INTERNAL: u8 = 1;

const fn is_value_type(encoding: Encoding) -> bool {
    use Encoding as E;
    matches!(encoding, E::I16 | E::U16 | E::I32 | E::U32)
}

/// Writes an address: `QV`, `SP 12`.
fn write(address: &ParameterAddress, out: &mut dyn core::fmt::Write) -> core::fmt::Result {
    match address.space {
        COMMANDS => write!(out, "{}", CommandWord(address.index).letters().as_str()),
        _ => write!(out, "SP {}", address.index),
    }
}

impl AddressNotation for ThrusterDissector {
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let mut parts = text.split(':');
        let place = parts.next()?.trim();
        let mut address = match place.split_once([' ', '\t']) {
            Some((word, number)) => {
                let command = CommandWord::parse(word)?;
                if !matches!(command, CommandWord::SP | CommandWord::RP) {
                    return None;
                }
                let Ok(index) = u16::try_from(parse_address_number(number.trim())?) else {
                    return Some(Err(TextError { at: 0, expected: "a type, 0 to 65535" }));
                };
                ParameterAddress::new(index, INTERNAL)
            }
            None => {
                let command = CommandWord::parse(place)?;
                // An order is carried out when it is sent: it cannot be read.
                if !matches!(command.definition()?.0, CommandKind::Query | CommandKind::Set) {
                    return None;
                }
                ParameterAddress::new(command.0, COMMANDS)
            }
        };
        if let Some(word) = parts.next() {
            let at = word.as_ptr() as usize - text.as_ptr() as usize;
            let encoding = parse_encoding(word.trim()).filter(|known| is_value_type(*known));
            if encoding.is_none() || parts.next().is_some() {
                return Some(Err(TextError { at, expected: "a type: i16, u16, i32 or u32" }));
            }
            address.encoding = encoding;
        }
        Some(Ok(address))
    }

    fn address_example(&self) -> &'static str {
        "SP 12"
    }

    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        // A caller that gives no room gets no text.
        let _ = write(address, out);
    }

    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        if address.space != COMMANDS {
            let plain = address.describe(Encoding::I32);
            return Parameter { persistence: Persistence::Always, ..plain };
        }
        let command = CommandWord(address.index);
        let default = match command.width() {
            Width::Signed => Encoding::I16,
            Width::Long => Encoding::I32,
            Width::Unsigned | Width::Absolute => Encoding::U32,
        };
        let written = Request { command, sub: 0, data: Some(1) };
        let reads = matches!(command.definition(), Some((CommandKind::Query, _)));
        Parameter {
            access: if reads { Access::Read } else { Access::Write },
            moves: !reads && class_of(&written) == RequestClass::NoRetry,
            persistence: if is_stored(&written) {
                Persistence::Always
            } else {
                Persistence::Volatile
            },
            ..address.describe(default)
        }
    }

    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let command = match field("command") {
            Some(FieldValue::Text(letters)) => CommandWord::parse(letters),
            _ => None,
        };
        let sub = field("sub").and_then(FieldValue::integer);
        match (address.space, command) {
            (0, Some(command)) => command.0 == address.index,
            (_, Some(CommandWord::SP | CommandWord::RP)) => sub == Some(address.index.into()),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ThrusterDissector;
    use crate::explain::AddressNotation as _;
    use crate::profile::{Access, ParameterAddress};
    use crate::proto::thruster::wire::CommandWord;

    const DISSECTOR: ThrusterDissector = ThrusterDissector;

    #[test]
    fn letters_and_internal_parameters_are_read() {
        let read = |text: &str| DISSECTOR.parse_address(text).expect(text).expect(text);
        assert_eq!(read("qv"), ParameterAddress::new(CommandWord::QV.0, 0));
        assert_eq!(read("SP 12"), ParameterAddress::new(12, 1));
        assert_eq!(read("RP 0x0C"), ParameterAddress::new(12, 1));
        assert_eq!(DISSECTOR.describe_address(&read("QV")).access, Access::Read);
        assert!(DISSECTOR.describe_address(&read("SP 12")).moves);
    }

    #[test]
    fn orders_are_no_values() {
        for text in ["LS", "XX", "QV 1", "speed", ""] {
            assert_eq!(DISSECTOR.parse_address(text), None, "{text}");
        }
        assert!(DISSECTOR.parse_address("SP 70000").unwrap().is_err());
    }
}
