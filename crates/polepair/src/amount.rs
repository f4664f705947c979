//! Values on their way to and from a drive.

use crate::error::Error;
use crate::quantity;
use polepair_core::profile::Parameter;
use polepair_core::units::{Quantity, Unit};
use std::fmt;

/// A value that a caller gives: a number, or text with or without a unit.
#[derive(Clone, PartialEq, Debug)]
pub enum Amount {
    /// For a parameter in the parameter's own unit, for a motion in SI.
    Number(f64),
    /// `1.2 A`, `60 rpm`, or one of the parameter's words.
    Text(String),
}

impl From<f64> for Amount {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<i32> for Amount {
    fn from(number: i32) -> Self {
        Self::Number(number.into())
    }
}

impl From<&str> for Amount {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Amount {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// What a given amount means for a parameter.
pub(crate) enum Meant {
    /// A raw value.
    Raw(i64),
    /// An SI value.
    Si(f64),
}

impl Amount {
    pub(crate) fn for_parameter(&self, parameter: &Parameter) -> Result<Meant, Error> {
        match self {
            Self::Number(number) => finite(*number).map(|n| Meant::Si(n * parameter.unit.si())),
            Self::Text(text) => {
                let word =
                    parameter.values.iter().find(|(_, word)| word.eq_ignore_ascii_case(text));
                if let Some((raw, _)) = word {
                    return Ok(Meant::Raw(*raw));
                }
                let measure = quantity::parse(text).map_err(|error| worded(error, parameter))?;
                measure.in_unit(parameter.unit).map(Meant::Si)
            }
        }
    }

    pub(crate) fn in_si(&self, wanted: Quantity) -> Result<f64, Error> {
        match self {
            Self::Number(number) => finite(*number),
            Self::Text(text) => quantity::parse(text)?.si(wanted),
        }
    }
}

/// The complaint with the words that the parameter knows.
fn worded(error: Error, parameter: &Parameter) -> Error {
    if parameter.values.is_empty() {
        return error;
    }
    let words: Vec<&str> = parameter.values.iter().map(|(_, word)| *word).collect();
    let hint = format!("`{}` can be {}", parameter.name, words.join(", "));
    Error::usage("E217", error.to_string(), hint)
}

fn finite(number: f64) -> Result<f64, Error> {
    if number.is_finite() {
        return Ok(number);
    }
    Err(Error::usage("E217", format!("{number} is no finite number"), ""))
}

/// A value that was read.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Value {
    /// As it lies in the drive.
    pub raw: i64,
    /// In [`unit`](Self::unit); NaN when a parameter that the scale depends on cannot be read.
    pub value: f64,
    /// The unit that the profile shows it in.
    pub unit: Unit,
    /// The value's name, where it has one.
    pub word: Option<&'static str>,
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(word) = self.word {
            return f.write_str(word);
        }
        // Scales are decimal: what binary arithmetic adds behind nine digits is not the drive's.
        let rounded = (self.value * 1e9).round() / 1e9;
        let shown = if self.value.abs() < 1e6 { rounded } else { self.value };
        write!(f, "{shown}")?;
        match self.unit.symbol() {
            "" => Ok(()),
            symbol => write!(f, " {symbol}"),
        }
    }
}
