//! Parameters by their number: `AP 6`, `AP 6.2` (motor 2), `GP 66`, `GP 0.3` (bank 3), `IO 0.1` (port 0
//! of bank 1), `CO 3.2` (coordinate 3 of motor 2).

use super::explain::TmclDissector;
use super::opcode::Opcode;
use crate::explain::{AddressNotation, FieldValue, TextError};
use crate::profile::{
    Access, Encoding, Parameter, ParameterAddress, Persistence, parse_address_number,
    parse_encoding,
};

/// Space of a parameter: axis parameters of the axis' own motor or of a named one, a bank of the global
/// parameters, a bank of inputs and outputs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Space {
    /// GAP and SAP of the axis' own motor.
    Axis,
    /// GAP and SAP, with the motor.
    Motor(u8),
    /// GGP and SGP, with the bank.
    Global(u8),
    /// GIO and SIO, with the bank.
    Io(u8),
    /// Reply to RFS STATUS.
    Search,
    /// GCO and SCO of the axis' own motor.
    OwnCoordinate,
    /// GCO and SCO, with the motor.
    Coordinate(u8),
}

const IO: u8 = 0x40;
const SEARCH: u8 = 0x60;
const OWN_COORDINATE: u8 = 0x6F;
const COORDINATE: u8 = 0x70;
const MOTOR: u8 = 0x80;
/// Motors have four bits where a parameter's number takes the others.
const MOTOR_MAX: u8 = 15;
const BANK_MAX: u8 = 31;

impl Space {
    /// Address space of a number in [`Parameter::space`].
    #[must_use]
    pub const fn of_number(number: u8) -> Self {
        match number {
            0 => Self::Axis,
            MOTOR.. => Self::Motor(number - MOTOR),
            COORDINATE.. => Self::Coordinate(number - COORDINATE),
            OWN_COORDINATE => Self::OwnCoordinate,
            SEARCH.. => Self::Search,
            IO.. => Self::Io(number - IO),
            _ => Self::Global(number - 1),
        }
    }

    /// Number for [`Parameter::space`].
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Axis => 0,
            Self::Motor(motor) => MOTOR + motor,
            Self::Global(bank) => 1 + bank,
            Self::Io(bank) => IO + bank,
            Self::Search => SEARCH,
            Self::OwnCoordinate => OWN_COORDINATE,
            Self::Coordinate(motor) => COORDINATE + motor,
        }
    }
}

fn is_word(name: &str, word: &str) -> bool {
    word.eq_ignore_ascii_case(name)
}

/// Writes an address: `AP 6`, `AP 6.2`.
fn write(address: &ParameterAddress, out: &mut dyn core::fmt::Write) -> core::fmt::Result {
    let (word, part) = match Space::of_number(address.space) {
        Space::Axis => ("AP", None),
        Space::Motor(motor) => ("AP", Some(motor)),
        Space::Global(bank) => ("GP", Some(bank).filter(|bank| *bank != 0)),
        Space::Io(bank) => ("IO", Some(bank).filter(|bank| *bank != 0)),
        Space::OwnCoordinate => ("CO", None),
        Space::Coordinate(motor) => ("CO", Some(motor)),
        Space::Search => return out.write_str("RFS STATUS"),
    };
    match part {
        None => write!(out, "{word} {}", address.index),
        Some(part) => write!(out, "{word} {}.{part}", address.index),
    }
}

/// With this global parameter a module starts its program, which may move a motor, at power-up (TMCL reference,
/// SGP 77).
const AUTO_START: u16 = 77;

impl AddressNotation for TmclDissector {
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let mut parts = text.split(':');
        let (word, place) = parts.next()?.trim().split_once([' ', '\t'])?;
        let space: fn(u8) -> Space = match () {
            () if is_word("AP", word) => Space::Motor,
            () if is_word("GP", word) => Space::Global,
            () if is_word("IO", word) => Space::Io,
            () if is_word("CO", word) => Space::Coordinate,
            () => return None,
        };
        let (number, part) = match place.trim().split_once('.') {
            Some((number, part)) => (number, Some(parse_address_number(part)?)),
            None => (place.trim(), None),
        };
        let number = parse_address_number(number)?;
        let of_motor = matches!(space(0), Space::Motor(_) | Space::Coordinate(_));
        let max = if of_motor { MOTOR_MAX } else { BANK_MAX };
        let part = match part {
            None if space(0) == Space::Motor(0) => Some(Space::Axis),
            None if space(0) == Space::Coordinate(0) => Some(Space::OwnCoordinate),
            part => u8::try_from(part.unwrap_or(0)).ok().filter(|part| *part <= max).map(space),
        };
        let (Ok(index), Some(part)) = (u8::try_from(number), part) else {
            let expected = "a number, 0 to 255, and behind a point motor 0 to 15 or bank 0 to 31";
            return Some(Err(TextError { at: text.len() - text.trim_start().len(), expected }));
        };
        let mut address = ParameterAddress::new(index.into(), part.number());
        if let Space::Motor(_) = part {
            address.like = Some((index.into(), 0));
        }
        if let Some(word) = parts.next() {
            let at = word.as_ptr() as usize - text.as_ptr() as usize;
            let encoding = parse_encoding(word.trim());
            let whole = encoding.filter(|known| matches!(known, Encoding::U32 | Encoding::I32));
            if whole.is_none() || parts.next().is_some() {
                return Some(Err(TextError { at, expected: "a type: i32 or u32" }));
            }
            address.encoding = whole;
        }
        Some(Ok(address))
    }

    fn address_example(&self) -> &'static str {
        "AP 6"
    }

    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        // A caller that gives no room gets no text.
        let _ = write(address, out);
    }

    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        let plain = address.describe(Encoding::I32);
        match Space::of_number(address.space) {
            Space::Global(bank) => Parameter {
                moves: bank == 0 && address.index == AUTO_START,
                persistence: match bank {
                    0 if address.index < 128 => Persistence::Always,
                    2 => Persistence::Storable,
                    _ => Persistence::Volatile,
                },
                ..plain
            },
            // Ports are read and written by banks of their own: 0 digital inputs, 1 analog, 2 outputs.
            Space::Io(bank) => Parameter {
                access: if bank == 2 { Access::ReadWrite } else { Access::Read },
                ..plain
            },
            Space::Axis | Space::Motor(_) => plain,
            Space::OwnCoordinate | Space::Coordinate(_) => Parameter { moves: false, ..plain },
            Space::Search => Parameter { access: Access::Read, ..plain },
        }
    }

    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let number = |name| field(name).and_then(FieldValue::integer);
        let opcode = number("opcode").and_then(|opcode| u8::try_from(opcode).ok());
        let (Some(opcode), Some(part)) = (opcode.map(Opcode::from), number("motor")) else {
            return false;
        };
        let of_opcode = match (opcode, Space::of_number(address.space)) {
            // Which motor the axis is, only the axis knows.
            (Opcode::Gap | Opcode::Sap | Opcode::Stap | Opcode::Rsap, Space::Axis) => {
                return number("type") == Some(address.index.into());
            }
            (Opcode::Gap | Opcode::Sap | Opcode::Stap | Opcode::Rsap, Space::Motor(motor)) => motor,
            (Opcode::Ggp | Opcode::Sgp | Opcode::Stgp | Opcode::Rsgp, Space::Global(bank)) => bank,
            (Opcode::Gio | Opcode::Sio, Space::Io(bank)) => bank,
            (Opcode::Gco | Opcode::Sco, Space::OwnCoordinate) => {
                return number("type") == Some(address.index.into());
            }
            (Opcode::Gco | Opcode::Sco, Space::Coordinate(motor)) => motor,
            _ => return false,
        };
        i64::from(of_opcode) == part && number("type") == Some(address.index.into())
    }
}

#[cfg(test)]
mod tests {
    use super::{OWN_COORDINATE, SEARCH, Space, TmclDissector};
    use crate::explain::AddressNotation as _;
    use crate::profile::{Encoding, ParameterAddress};

    const DISSECTOR: TmclDissector = TmclDissector;

    #[test]
    fn parameters_of_motors_and_banks_are_read() {
        let read = |text: &str| DISSECTOR.parse_address(text).expect(text).expect(text);
        assert_eq!(read("AP 207"), ParameterAddress::new(207, 0));
        let like = Some((6, 0));
        for motor in [0, 2] {
            let address = ParameterAddress::new(6, Space::Motor(motor).number());
            assert_eq!(read(&alloc::format!("ap 6.{motor}")), ParameterAddress { like, ..address });
        }
        assert_eq!(read("GP 66"), ParameterAddress::new(66, 1));
        assert_eq!(read("GP 0.3"), ParameterAddress::new(0, 4));
        let coordinate = ParameterAddress::new(3, Space::Coordinate(2).number());
        assert_eq!(read("CO 3.2"), coordinate);
        assert_eq!(read("CO 3"), ParameterAddress::new(3, Space::OwnCoordinate.number()));
        assert_eq!(read("IO 0.1"), ParameterAddress::new(0, Space::Io(1).number()));
        assert_eq!(read("AP 6:u32").encoding, Some(Encoding::U32));
    }

    #[test]
    fn spaces_have_numbers_of_their_own() {
        for number in (0..=SEARCH).chain(OWN_COORDINATE..=u8::MAX) {
            assert_eq!(Space::of_number(number).number(), number);
        }
    }

    #[test]
    fn a_name_that_is_no_parameter_is_refused() {
        for text in ["AP", "AP x", "max current", "6", "GP 1.x"] {
            assert_eq!(DISSECTOR.parse_address(text), None, "{text}");
        }
        for text in ["AP 256", "AP 6.16", "GP 1.32", "AP 6:u16", "AP 6:i32:le"] {
            assert!(DISSECTOR.parse_address(text).unwrap().is_err(), "{text}");
        }
    }
}
