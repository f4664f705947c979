//! Units of the numbers.

use core::fmt;

use crate::explain::NumberStyle;
use crate::proto::thruster::wire::CommandWord;

/// A raw number with its unit.
pub(super) struct MeasuredNumber(pub i64, pub CountUnit);

impl fmt::Display for MeasuredNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(raw, CountUnit { unit, .. }) = *self;
        let digits = self.1.style().text_of(raw).ok_or(fmt::Error)?;
        f.write_str(digits.as_str())?;
        if unit.is_empty() { Ok(()) } else { write!(f, " {unit}") }
    }
}

/// Unit of a number.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CountUnit {
    /// Unit; empty for none.
    pub unit: &'static str,
    /// The raw number counts tenths of it.
    pub tenths: bool,
}

impl CountUnit {
    pub(super) const fn in_units(unit: &'static str) -> Self {
        Self { unit, tenths: false }
    }

    pub(super) const fn in_tenths(unit: &'static str) -> Self {
        Self { unit, tenths: true }
    }

    /// Style of a raw number in it.
    #[must_use]
    pub const fn style(self) -> NumberStyle {
        if self.tenths { NumberStyle::Tenths } else { NumberStyle::Whole }
    }

    /// Unit of a command's value.
    #[must_use]
    pub const fn of_command(command: CommandWord) -> Self {
        match command {
            CommandWord::TC => Self::in_units("%"),
            CommandWord::VC | CommandWord::QV => RPM,
            CommandWord::QC => AMPERE,
            CommandWord::QP => VOLT,
            CommandWord::QT | CommandWord::EQ => CELSIUS,
            CommandWord::CB => Self::in_units("kbit/s"),
            CommandWord::ST => MS,
            CommandWord::LA | CommandWord::LR | CommandWord::QA | CommandWord::QR => DEGREE,
            _ => Self::in_units(""),
        }
    }
}

pub(super) const RPM: CountUnit = CountUnit::in_units("rpm");
pub(super) const MS: CountUnit = CountUnit::in_units("ms");
pub(super) const CELSIUS: CountUnit = CountUnit::in_units("degC");
pub(super) const VOLT: CountUnit = CountUnit::in_tenths("V");
pub(super) const AMPERE: CountUnit = CountUnit::in_tenths("A");
pub(super) const DEGREE: CountUnit = CountUnit::in_tenths("deg");
