//! Values that are words of decimal digits, each with a meaning of its own.

use core::fmt;

use super::Parameter;

/// A decimal digit of a value, or some neighbours, with a meaning of its own.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DigitField {
    /// Name of the meaning.
    pub name: &'static str,
    /// Number of digits.
    pub places: u32,
    /// Greatest value, from 0.
    pub max: i64,
    /// Names of values.
    pub values: &'static [(i64, &'static str)],
}

impl DigitField {
    const fn modulus(&self) -> i64 {
        10_i64.pow(self.places)
    }

    /// The name of a value; `None` for a number.
    #[must_use]
    pub fn word(&self, value: i64) -> Option<&'static str> {
        self.values.iter().find(|(known, _)| *known == value).map(|(_, word)| *word)
    }
}

impl fmt::Display for DigitDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value(field, value) => {
                write!(f, "{} is {value}, and has 0 to {}", field.name, field.max)
            }
            Self::Surplus(digits) => write!(f, "it has no place for the digits {digits}"),
        }
    }
}

/// Reason why digits have no meaning.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DigitDefect {
    /// A field has this value, which is too great.
    Value(&'static DigitField, i64),
    /// These digits are to the left of the last field.
    Surplus(i64),
}

impl Parameter {
    /// The values of its digits, from the right.
    pub fn split_digits(&self, raw: i64) -> impl Iterator<Item = (&'static DigitField, i64)> {
        let mut rest = raw;
        self.digits.iter().map(move |field| {
            let value = rest % field.modulus();
            rest /= field.modulus();
            (field, value)
        })
    }

    /// The first of its digits, from the right, that has no meaning.
    #[must_use]
    pub fn digit_defect(&self, raw: i64) -> Option<DigitDefect> {
        if self.digits.is_empty() {
            return None;
        }
        let wrong = self.split_digits(raw).find(|(field, value)| !(0..=field.max).contains(value));
        let modulus: i64 = self.digits.iter().map(DigitField::modulus).product();
        match wrong {
            Some((field, value)) => Some(DigitDefect::Value(field, value)),
            None if raw / modulus != 0 => Some(DigitDefect::Surplus(raw / modulus)),
            None => None,
        }
    }
}
