//! Parameters by number, in the notation of their protocol.

use super::{Access, Certainty, Encoding, ObjectKey, Parameter, Persistence, Scale};
use crate::units::Unit;

/// A parameter by its number: `0x2030:1:u16`, `R 51`, `AP 6`, `@0x03B0`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ParameterAddress {
    /// Index, as in [`Parameter::index`].
    pub index: u16,
    /// Space, as in [`Parameter::space`].
    pub space: u8,
    /// The type, where the text gives one.
    pub encoding: Option<Encoding>,
    /// Another index and space whose description applies to this one as well: the parameter of a module's
    /// first motor, the object of a node's first axis.
    pub like: Option<ObjectKey>,
}

impl ParameterAddress {
    /// An address without a type.
    #[must_use]
    pub const fn new(index: u16, space: u8) -> Self {
        Self { index, space, encoding: None, like: None }
    }

    /// A parameter of which nothing is known but its address. A write may do anything.
    #[must_use]
    pub const fn describe(&self, default: Encoding) -> Parameter {
        let encoding = match self.encoding {
            Some(encoding) => encoding,
            None => default,
        };
        let (min, max) = encoding.raw_range();
        Parameter {
            name: "",
            symbol: "",
            about: "",
            space: self.space,
            index: self.index,
            encoding,
            unit: Unit::None,
            scale: match encoding {
                Encoding::Fixed => Scale { factor: 1.0 / 65_536.0, ..Scale::ONE },
                Encoding::TensAndThousandths => Scale { factor: 0.001, ..Scale::ONE },
                _ => Scale::ONE,
            },
            min,
            max,
            default: None,
            access: Access::ReadWrite,
            persistence: Persistence::Volatile,
            certainty: Certainty::Undocumented,
            moves: true,
            section: "",
            values: &[],
            digits: &[],
            bits: &[],
        }
    }
}

/// The encoding that a type's word means, such as `u16`.
#[must_use]
pub fn parse_encoding(word: &str) -> Option<Encoding> {
    ENCODING_WORDS
        .iter()
        .find(|(name, _)| name.eq_ignore_ascii_case(word))
        .map(|(_, encoding)| *encoding)
}

/// The word of an encoding's type.
#[must_use]
pub fn encoding_word(encoding: Encoding) -> Option<&'static str> {
    ENCODING_WORDS.iter().find(|(_, known)| *known == encoding).map(|(word, _)| *word)
}

const ENCODING_WORDS: [(&str, Encoding); 16] = [
    ("bit", Encoding::Bit),
    ("u8", Encoding::U8),
    ("i8", Encoding::I8),
    ("u16", Encoding::U16),
    ("i16", Encoding::I16),
    ("u32", Encoding::U32),
    ("i32", Encoding::I32),
    ("u48", Encoding::U48),
    ("i48", Encoding::I48),
    ("u64", Encoding::U64),
    ("i64", Encoding::I64),
    ("f32", Encoding::F32),
    ("f64", Encoding::F64),
    ("fixed", Encoding::Fixed),
    ("str", Encoding::Text),
    ("bytes", Encoding::Bytes),
];

/// A number as addresses have it: decimal, `0x33`, or `33h`.
#[must_use]
pub fn parse_address_number(text: &str) -> Option<u32> {
    let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let hex = hex.or_else(|| text.strip_suffix('h').or_else(|| text.strip_suffix('H')));
    let (digits, radix) = hex.map_or((text, 10), |digits| (digits, 16));
    let right = !digits.is_empty() && digits.bytes().all(|c| c.is_ascii_hexdigit());
    right.then(|| u32::from_str_radix(digits, radix).ok()).flatten()
}
