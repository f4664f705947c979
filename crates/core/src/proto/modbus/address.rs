//! Registers and bits by number: `0x33`, `R 51`, `IR 3`, `C 5`, `DI 2`, `0x20:i32:le`.

use super::ModbusDissector;
use super::wire::{Function, Space};
use crate::explain::{AddressNotation, FieldValue, TextError};
use crate::profile::{
    Access, Encoding, Parameter, ParameterAddress, parse_address_number, parse_encoding,
};

/// Words before a number, with the space that they mean.
const SPACES: [(&str, Space); 14] = [
    ("R", Space::Holding),
    ("HR", Space::Holding),
    ("holding", Space::Holding),
    ("register", Space::Holding),
    ("holding register", Space::Holding),
    ("input register", Space::Input),
    ("discrete input", Space::Discrete),
    ("IR", Space::Input),
    ("input", Space::Input),
    ("C", Space::Coil),
    ("coil", Space::Coil),
    ("DI", Space::Discrete),
    ("discrete", Space::Discrete),
    ("bit", Space::Discrete),
];

fn parse_parts<'a>(
    text: &'a str,
    place: (Space, u32),
    parts: impl Iterator<Item = &'a str>,
) -> Result<ParameterAddress, TextError> {
    let (space, number) = place;

    let expected = "a number, 0 to 65535";
    let index = u16::try_from(number).map_err(|_| TextError { at: 0, expected })?;
    let mut address = ParameterAddress::new(index, space_number(space));
    let mut has_order = false;
    for part in parts {
        let at = part.as_ptr() as usize - text.as_ptr() as usize;
        let word = part.trim();
        let low_first = match word {
            _ if word.eq_ignore_ascii_case("le") => Some(true),
            _ if word.eq_ignore_ascii_case("be") => Some(false),
            _ => None,
        };
        match (low_first, address.encoding) {
            (None, None) if !has_order => {
                let encoding = parse_encoding(word).filter(|known| is_register_type(*known));
                let expected = "a type: u16, i16, u32, i32, u64, i64, f32 or f64";
                address.encoding = Some(encoding.ok_or(text_error(expected, at))?);
            }
            (Some(low_first), Some(encoding)) if !has_order => {
                let ordered = if low_first { low_word_first(encoding) } else { Some(encoding) };
                let expected = "no word order: this type has one register";
                address.encoding = Some(ordered.ok_or(text_error(expected, at))?);
                has_order = true;
            }
            (Some(_), None) => {
                return Err(text_error("a type before the word order, such as i32:le", at));
            }
            _ => return Err(text_error("the end of the address", at)),
        }
    }
    if space.is_bits() && address.encoding.is_some() {
        return Err(TextError { at: 0, expected: "no type: it is one bit" });
    }
    Ok(address)
}

const fn text_error(expected: &'static str, at: usize) -> TextError {
    TextError { at, expected }
}

const fn is_register_type(encoding: Encoding) -> bool {
    use Encoding as E;
    matches!(
        encoding,
        E::U16 | E::I16 | E::U32 | E::I32 | E::U48 | E::I48 | E::U64 | E::I64 | E::F32 | E::F64
    )
}

const fn low_word_first(encoding: Encoding) -> Option<Encoding> {
    Some(match encoding {
        Encoding::U32 => Encoding::U32LowFirst,
        Encoding::I32 => Encoding::I32LowFirst,
        Encoding::U48 => Encoding::U48LowFirst,
        Encoding::I48 => Encoding::I48LowFirst,
        Encoding::U64 => Encoding::U64LowFirst,
        Encoding::I64 => Encoding::I64LowFirst,
        Encoding::F32 => Encoding::F32LowFirst,
        Encoding::F64 => Encoding::F64LowFirst,
        _ => return None,
    })
}

const fn space_number(space: Space) -> u8 {
    match space {
        Space::Holding => 0,
        Space::Coil => 1,
        Space::Discrete => 2,
        Space::Input => 3,
    }
}

/// Writes an address: `R 51`.
fn write(address: &ParameterAddress, out: &mut dyn core::fmt::Write) -> core::fmt::Result {
    let word = match Space::of_number(address.space) {
        Some(Space::Coil) => "C",
        Some(Space::Discrete) => "DI",
        Some(Space::Input) => "IR",
        _ => "R",
    };
    write!(out, "{word} {}", address.index)
}

/// The space that a function reads or writes.
const fn function_space(function: Function) -> Option<Space> {
    match function {
        Function::WriteCoil | Function::WriteCoils => Some(Space::Coil),
        Function::WriteRegister | Function::WriteRegisters | Function::ReadWriteRegisters => {
            Some(Space::Holding)
        }
        other => other.read_space(),
    }
}

impl AddressNotation for ModbusDissector {
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let mut parts = text.split(':');
        let first = parts.next()?.trim();
        let (space, number) = match first.rsplit_once([' ', '\t']) {
            Some((word, number)) => {
                let word = word.trim_end();
                let known = SPACES.iter().find(|(name, _)| name.eq_ignore_ascii_case(word))?;
                (known.1, number)
            }
            None if first.starts_with("0x") || first.starts_with("0X") => (Space::Holding, first),
            None => return None,
        };
        let number = parse_address_number(number)?;
        Some(parse_parts(text, (space, number), parts))
    }

    fn address_example(&self) -> &'static str {
        "0x33:u16"
    }

    /// Data model numbers, which begin at 1 behind a digit for the table: five or six digits (MAP 4.3, and
    /// the "Modicon convention" of manuals).
    fn manual_address(&self, text: &str) -> Option<ParameterAddress> {
        let is_number = matches!(text.len(), 5 | 6) && text.bytes().all(|c| c.is_ascii_digit());
        let (table, number) = is_number.then(|| text.split_at(1))?;
        let space = match table {
            "0" => Space::Coil,
            "1" => Space::Discrete,
            "3" => Space::Input,
            "4" => Space::Holding,
            _ => return None,
        };
        let index = number.parse::<u32>().ok()?.checked_sub(1)?;
        Some(ParameterAddress::new(u16::try_from(index).ok()?, space_number(space)))
    }

    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        // A caller that gives no room gets no text.
        let _ = write(address, out);
    }

    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        let space = Space::of_number(address.space).unwrap_or(Space::Holding);
        let default = if space.is_bits() { Encoding::Bit } else { Encoding::U16 };
        let writable = matches!(space, Space::Holding | Space::Coil);
        Parameter {
            access: if writable { Access::ReadWrite } else { Access::Read },
            moves: writable,
            ..address.describe(default)
        }
    }

    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let number = |name| field(name).and_then(FieldValue::integer);
        let Some(first) = number("start").or_else(|| number("register")) else { return false };
        let function = number("function").and_then(|code| u8::try_from(code).ok());
        let space = function.and_then(|code| function_space(Function::of_code(code)));
        space.is_some_and(|space| Space::of_number(address.space) == Some(space))
            && (first..first + number("count").unwrap_or(1)).contains(&address.index.into())
    }
}

#[cfg(test)]
mod tests {
    use super::ModbusDissector;
    use crate::explain::AddressNotation as _;
    use crate::profile::{Encoding, ParameterAddress};

    const DISSECTOR: ModbusDissector = ModbusDissector(crate::proto::modbus::wire::WireFormat::Rtu);

    #[test]
    fn registers_and_bits_are_read() {
        let read = |text: &str| DISSECTOR.parse_address(text).expect(text).expect(text);
        for text in ["0x33", "R 51", "r 0x33", "HR 51", "register 33h"] {
            assert_eq!(read(text), ParameterAddress::new(0x33, 0), "{text}");
        }
        assert_eq!(read("C 5"), ParameterAddress::new(5, 1));
        assert_eq!(read("DI 2"), ParameterAddress::new(2, 2));
        assert_eq!(read("IR 3"), ParameterAddress::new(3, 3));
        assert_eq!(read("0x20:i32").encoding, Some(Encoding::I32));
        assert_eq!(read("0x20:i32:be").encoding, Some(Encoding::I32));
        assert_eq!(read("0x20:f32:le").encoding, Some(Encoding::F32LowFirst));
    }

    #[test]
    fn a_name_that_is_no_register_is_refused() {
        for text in ["51", "internal speed", "Fn_33", "R", "R x", ""] {
            assert_eq!(DISSECTOR.parse_address(text), None, "{text}");
        }
        for text in [
            "0x10000",
            "R 51:u8",
            "R 51:le",
            "R 51:u16:le",
            "C 5:u16",
            "R 1:u32:le:be",
            "R 1:i32:9",
        ] {
            assert!(DISSECTOR.parse_address(text).unwrap().is_err(), "{text}");
        }
    }
}
