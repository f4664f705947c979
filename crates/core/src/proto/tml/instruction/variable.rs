//! Variables by name and by address, from a profile's table in the order of addresses.

use crate::profile::{Encoding, Parameter, Profile};

/// Type of a variable.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum VariableKind {
    /// 16 bits, signed or not.
    Word,
    /// 16 bits, signed.
    Int,
    /// 16 bits, unsigned.
    Uint,
    /// 32 bits of any kind.
    Double,
    /// 32 bits, signed.
    Long,
    /// 32 bits, unsigned.
    Ulong,
    /// 32 bits, the lower 16 a fraction.
    Fixed,
}

impl VariableKind {
    /// 32 bits.
    #[must_use]
    pub const fn is_long(self) -> bool {
        matches!(self, Self::Double | Self::Long | Self::Ulong | Self::Fixed)
    }

    /// The vendor's word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Word => "16 bits",
            Self::Int => "INT",
            Self::Uint => "UINT",
            Self::Double => "32 bits",
            Self::Long => "LONG",
            Self::Ulong => "ULONG",
            Self::Fixed => "FIXED",
        }
    }

    /// The type for a profile's encoding.
    #[must_use]
    pub const fn of(encoding: Encoding) -> Self {
        match encoding {
            Encoding::I16 | Encoding::I8 => Self::Int,
            Encoding::U16 | Encoding::U8 | Encoding::Bit => Self::Uint,
            Encoding::U32 | Encoding::U32LowFirst => Self::Ulong,
            Encoding::Fixed => Self::Fixed,
            // A profile of this protocol has no others.
            _ => Self::Long,
        }
    }
}

/// Address and type of a variable.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Variable {
    /// Address, that of the lower word.
    pub address: u16,
    /// Type.
    pub kind: VariableKind,
}

/// Name of a parameter in the language.
#[must_use]
pub const fn symbol(parameter: &Parameter) -> &'static str {
    if parameter.symbol.is_empty() { parameter.name } else { parameter.symbol }
}

/// The variable of that name, letter case ignored.
#[must_use]
pub fn find_by_name(profile: Option<&'static Profile>, name: &str) -> Option<Variable> {
    let mut parameters = profile?.parameters.iter();
    let found = parameters.find(|p| symbol(p).eq_ignore_ascii_case(name))?;
    Some(Variable { address: found.index, kind: VariableKind::of(found.encoding) })
}

/// The variables that begin at an address; of names that share it the described one comes first.
pub fn at_address(
    profile: Option<&'static Profile>,
    address: u16,
) -> impl Iterator<Item = &'static Parameter> {
    let parameters = profile.map_or(&[][..], |profile| profile.parameters);
    let first = parameters.partition_point(|p| p.index < address);
    parameters[first..].iter().take_while(move |p| p.index == address)
}

/// The name of a 16- or 32-bit variable at an address, as a form can be written with it.
#[must_use]
pub fn name_at_address(
    profile: Option<&'static Profile>,
    address: u16,
    long: bool,
) -> Option<&'static Parameter> {
    at_address(profile, address)
        .find(|p| VariableKind::of(p.encoding).is_long() == long && is_variable_name(symbol(p)))
}

fn is_variable_name(text: &str) -> bool {
    !text.is_empty()
        && !text.as_bytes()[0].is_ascii_digit()
        && text.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_')
}
