//! Registers: names and meanings of their bits.
//!
//! Sources: the vendor's help pages for MER and AAR, the TML communication manual for SRL and SRH; the bit
//! names of the others come from the vendor's register tables in public tools.

mod settings;
mod status;

/// A register with named bits.
#[derive(Debug)]
pub struct Register {
    /// Name in the language.
    pub name: &'static str,
    /// Purpose.
    pub about: &'static str,
    /// Bits of the register, the highest first; reserved ones are left out.
    pub bits: &'static [RegisterField],
}

/// A bit, or several that belong together.
#[derive(Clone, Copy, Debug)]
pub struct RegisterField {
    /// The highest of them.
    pub high: u8,
    /// The lowest of them.
    pub low: u8,
    /// The vendor's name; empty where it has none.
    pub name: &'static str,
    /// Meaning of each value, from 0 on; empty for none.
    pub values: &'static [&'static str],
}

impl RegisterField {
    /// Their value in the whole register.
    #[must_use]
    pub const fn value_in(&self, register: u32) -> u32 {
        let width = self.high - self.low + 1;
        (register >> self.low) & ((1 << width) - 1)
    }

    /// Meaning of the value; empty for none.
    #[must_use]
    pub fn meaning(&self, register: u32) -> &'static str {
        self.values.get(self.value_in(register) as usize).copied().unwrap_or("")
    }
}

impl Register {
    /// The fields of a value that are not zero, or whose zero has a meaning.
    pub fn shown_fields(&'static self, value: u32) -> impl Iterator<Item = &'static RegisterField> {
        self.bits
            .iter()
            .filter(move |bits| bits.value_in(value) != 0 || !bits.meaning(value).is_empty())
    }
}

/// The register of that name, letter case ignored.
#[must_use]
pub fn find_register(name: &str) -> Option<&'static Register> {
    registers().find(|register| register.name.eq_ignore_ascii_case(name))
}

/// All registers with named bits.
pub fn registers() -> impl Iterator<Item = &'static Register> {
    status::REGISTERS.iter().chain(settings::REGISTERS)
}

/// A bit with a meaning when it is set.
const fn flag(bit: u8, name: &'static str, meaning: &'static [&'static str; 2]) -> RegisterField {
    RegisterField { high: bit, low: bit, name, values: meaning }
}

/// Bits that are a number.
const fn field(
    high: u8,
    low: u8,
    name: &'static str,
    values: &'static [&'static str],
) -> RegisterField {
    RegisterField { high, low, name, values }
}
