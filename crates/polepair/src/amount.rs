//! Values of parameters, converted between drive and user.

use crate::error::Error;
use crate::quantity;
use polepair_core::profile::{BitName, Encoding, Parameter, Scale, bit_names, same_name};
use polepair_core::units::Unit;
use std::fmt::{self, Write as _};

/// A value that a caller gives: a number, or text with or without a unit.
#[derive(Clone, PartialEq, Debug)]
pub enum Amount {
    /// For a parameter in the parameter's own unit, for a motion in SI.
    Number(f64),
    /// `1.2 A`, `60 rpm`, or one of the parameter's words.
    Text(String),
    /// The drive's own number in digits, as the maker's manual and programs state it: `12` for 1.2 A where the
    /// drive counts tenths. Real variables, TML's fixed ones too, have a fraction.
    Own(String),
    /// A number that could be in the parameter's unit or the drive's own, because it was written behind the maker's
    /// symbol. It is accepted where both are the same.
    Either(f64),
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

/// Meaning of an amount for a parameter.
pub(crate) enum ResolvedAmount {
    /// A raw value.
    Raw(i64),
    /// An SI value.
    Si(f64),
    /// An SI value that must have this raw value.
    Either { si: f64, own: Option<i64> },
}

impl ResolvedAmount {
    /// The raw value, where `convert` makes one of an SI value.
    ///
    /// # Errors
    /// `unknown_scale` where it cannot; [`Error::Usage`] `E217` for a number with two meanings.
    pub(crate) fn into_raw(
        self,
        parameter: &Parameter,
        unit: Unit,
        convert: impl FnOnce(f64) -> Option<i64>,
        unknown_scale: impl FnOnce() -> Error,
    ) -> Result<i64, Error> {
        match self {
            Self::Raw(raw) => Ok(raw),
            Self::Si(si) => convert(si).ok_or_else(unknown_scale),
            Self::Either { si, own } => match (convert(si), own) {
                // Where both readings give the same bytes there is nothing to ask.
                (Some(raw), Some(own)) if raw == own => Ok(raw),
                _ => Err(two_meanings(si / unit.si_factor(), parameter, unit)),
            },
        }
    }
}

/// A value to be written.
#[derive(Clone, PartialEq, Debug)]
pub enum WriteValue {
    /// A number in the parameter's unit, text with a unit, or a word.
    Amount(Amount),
    /// The drive's own number.
    Raw(i64),
}

impl fmt::Display for Amount {
    /// Formats the amount as the caller gave it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) | Self::Either(number) => number.fmt(f),
            Self::Text(text) | Self::Own(text) => f.write_str(text),
        }
    }
}

impl fmt::Display for WriteValue {
    /// Formats the value as the caller gave it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Amount(amount) => amount.fmt(f),
            Self::Raw(raw) => write!(f, "{raw} raw"),
        }
    }
}

impl Amount {
    /// Resolves the amount for a parameter whose value is shown in `unit`.
    pub(crate) fn resolve(
        &self,
        parameter: &Parameter,
        unit: Unit,
    ) -> Result<ResolvedAmount, Error> {
        match self {
            Self::Number(number) => {
                require_finite(*number).map(|n| ResolvedAmount::Si(n * unit.si_factor()))
            }
            Self::Text(text) => {
                let word =
                    parameter.values.iter().find(|(_, word)| word.eq_ignore_ascii_case(text));
                if let Some((raw, _)) = word {
                    return Ok(ResolvedAmount::Raw(*raw));
                }
                let plain = parameter.scale == Scale::ONE && unit == Unit::None;
                if plain && !parameter.encoding.is_real() {
                    // A float has not the digits of 64 bits.
                    if let Some(whole) = parse_whole(text) {
                        let raw = raw_of_whole(parameter.encoding, whole);
                        return raw.map(ResolvedAmount::Raw).ok_or_else(|| out_of_bits(text));
                    }
                }
                let measure =
                    quantity::parse(text).map_err(|error| with_word_hint(error, parameter))?;
                measure.in_unit(unit).map(ResolvedAmount::Si)
            }
            Self::Own(text) => own_raw(parameter, text).map(ResolvedAmount::Raw),
            Self::Either(number) => {
                let si = require_finite(*number)? * unit.si_factor();
                let parts = own_fraction(parameter.encoding);
                let own = match parts {
                    None if number.fract() != 0.0 => None,
                    parts => parameter.encoding.raw(number * parts.unwrap_or(1.0)),
                };
                Ok(ResolvedAmount::Either { si, own })
            }
        }
    }

    /// Interprets the amount for a parameter that the caller wrote as `written`. Behind our name a bare number is in
    /// the parameter's unit. Behind the maker's symbol or a number (`AP 6`, `CSPD`, `0x6083`), text without a unit is
    /// the drive's own number, because that is what the maker's manual and programs write there. A number is accepted
    /// there where it means the same in both: reading the symbol gives a number in the unit.
    pub(crate) fn for_written_name(self, written: &str, name: &str, symbol: &str) -> Self {
        if same_name(written, name) && !same_name(written, symbol) {
            return self;
        }
        match self {
            Self::Number(number) => Self::Either(number),
            Self::Text(text) if is_bare_number(&text) => Self::Own(text),
            other => other,
        }
    }

    /// The SI value of an amount for a value that is shown in `unit`: a number is SI, text has a unit. Zero
    /// needs none.
    pub(crate) fn in_si(&self, unit: Option<Unit>) -> Result<f64, Error> {
        let text = match self {
            Self::Number(number) | Self::Either(number) => return require_finite(*number),
            Self::Text(text) | Self::Own(text) => text,
        };
        let measure = quantity::parse(text)?;
        match unit {
            Some(unit) => measure.with_unit(unit),
            None => Ok(measure.si),
        }
    }
}

/// The complaint with the words that the parameter knows.
fn with_word_hint(error: Error, parameter: &Parameter) -> Error {
    if parameter.values.is_empty() {
        return error;
    }
    let words: Vec<&str> = parameter.values.iter().map(|(_, word)| *word).collect();
    let hint = format!("`{}` can be {}", parameter.name, words.join(", "));
    Error::usage("E217", error.to_string(), hint)
}

/// The error for a number that the drive and its user would understand differently.
fn two_meanings(number: f64, parameter: &Parameter, unit: Unit) -> Error {
    let (name, symbol) = (parameter.name, parameter.symbol);
    let meant = match unit.symbol() {
        "" => format!("`{name}`"),
        unit => format!("{number} {unit}"),
    };
    let what = format!("is {number} for `{symbol}` the drive's own number, or {meant}?");
    let hint = match unit.symbol() {
        "" => format!("write {number} for `{name}`, or \"{number}\" for the drive's own number"),
        unit => format!("write \"{number} {unit}\", or \"{number}\" for the drive's own number"),
    };
    Error::usage("E217", what, hint)
}

fn is_bare_number(text: &str) -> bool {
    quantity::parse(text).is_ok_and(|measure| measure.quantity.is_none())
}

/// The raw value of the drive's own number in digits.
fn own_raw(parameter: &Parameter, text: &str) -> Result<i64, Error> {
    let encoding = parameter.encoding;
    if let Some(parts) = own_fraction(encoding) {
        let number = quantity::parse(text)?.si * parts;
        return encoding.raw(number).ok_or_else(|| misfit_error(parameter, &text));
    }
    // Half a raw step cannot be written, and rounding it would be a guess.
    let whole = parse_whole(text).ok_or_else(|| {
        let what = format!("`{}` is a whole number in the drive, {text} is not", parameter.symbol);
        let hint = match parameter.unit.symbol() {
            "" => String::new(),
            unit => format!("write {text}{unit}, or {text} for `{}`", parameter.name),
        };
        Error::usage("E217", what, hint)
    })?;
    raw_of_whole(encoding, whole).ok_or_else(|| out_of_bits(text))
}

/// Number of parts the maker's own number is divided into, where it has a fraction.
fn own_fraction(encoding: Encoding) -> Option<f64> {
    match encoding {
        Encoding::Fixed => Some(65_536.0),
        encoding if encoding.is_real() => Some(1.0),
        _ => None,
    }
}

/// A whole number, decimal or hexadecimal.
fn parse_whole(text: &str) -> Option<i128> {
    let (sign, digits) = match text.trim().strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.trim()),
    };
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    let (digits, radix) = hex.map_or((digits, 10), |digits| (digits, 16));
    let right = !digits.is_empty() && digits.chars().all(|c| c.is_digit(radix));
    let magnitude = right.then(|| i128::from_str_radix(digits, radix).ok()).flatten()?;
    Some(sign * magnitude)
}

fn raw_of_whole(encoding: Encoding, whole: i128) -> Option<i64> {
    match encoding {
        Encoding::U64 | Encoding::U64LowFirst => u64::try_from(whole).ok().map(u64::cast_signed),
        _ => i64::try_from(whole).ok(),
    }
}

/// The error for a number that the parameter's encoding cannot hold.
pub(crate) fn misfit_error(parameter: &Parameter, number: &dyn fmt::Display) -> Error {
    let (encoding, name) = (parameter.encoding, parameter.name);
    let into = match (encoding.is_real(), encoding.size()) {
        (true, 4) => "a 32-bit float (1.2e-38 to 3.4e38)".to_owned(),
        (true, _) => "a 64-bit float".to_owned(),
        (false, bytes) => format!("{} bits", u32::from(bytes) * 8),
    };
    Error::usage("E216", format!("`{name}`: {number} does not fit into {into}"), "")
}

fn out_of_bits(text: &str) -> Error {
    Error::usage("E216", format!("{text} does not fit 64 bits"), "")
}

/// A raw value as a number, without sign where its type has none.
#[must_use]
pub fn format_raw(encoding: Encoding, raw: i64) -> String {
    match encoding {
        Encoding::U64 | Encoding::U64LowFirst | Encoding::AnyLength => {
            raw.cast_unsigned().to_string()
        }
        _ => raw.to_string(),
    }
}

fn require_finite(number: f64) -> Result<f64, Error> {
    if number.is_finite() {
        return Ok(number);
    }
    Err(Error::usage("E217", format!("{number} is no finite number"), ""))
}

/// A value that was read.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Value {
    /// Raw value of the drive.
    pub raw: i64,
    /// Value in [`unit`](Self::unit); NaN if a parameter that the scale depends on cannot be read.
    pub value: f64,
    /// Difference from the value of the next raw number; 0 if unknown.
    pub step: f64,
    /// The unit that the profile shows it in.
    pub unit: Unit,
    /// The value's name, where it has one.
    pub word: Option<&'static str>,
    /// Names of its bits, where they have such.
    pub bits: &'static [BitName],
    /// Encoding of the raw value on the wire.
    pub encoding: Encoding,
    /// The value is the raw one: it has neither unit nor scale.
    pub is_raw: bool,
}

impl Value {
    /// The raw value as a number, without sign where its type has none.
    #[must_use]
    pub fn raw_text(&self) -> String {
        format_raw(self.encoding, self.raw)
    }

    /// The value with the drive's own number behind it, where that is another one: `1.2 A (12)`.
    #[must_use]
    pub fn text_with_own(&self) -> String {
        let text = self.to_string();
        if self.word.is_none() && bit_names(self.bits, self.raw).next().is_some() {
            return text;
        }
        let own = match own_fraction(self.encoding) {
            None => self.raw_text(),
            // The last of five digits is less than half a part.
            Some(parts) if self.encoding == Encoding::Fixed => {
                let hundred_thousandths = self.encoding.number(self.raw) / parts * 1e5;
                debug_assert!(parts > 0.0);
                (hundred_thousandths.round() / 1e5).to_string()
            }
            Some(parts) => (self.encoding.number(self.raw) / parts).to_string(),
        };
        if text == own { text } else { format!("{text} ({own})") }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(word) = self.word {
            return f.write_str(word);
        }
        let mut names = bit_names(self.bits, self.raw);
        if let Some(first) = names.next() {
            write!(f, "0x{:04X} ({first}", self.raw)?;
            names.try_for_each(|name| write!(f, ", {name}"))?;
            return f.write_char(')');
        }
        if self.is_raw && !self.encoding.is_real() {
            return f.write_str(&self.raw_text());
        }
        match decimals(self.step) {
            // Neither a negative zero nor trailing zeros without meaning.
            Some(digits) => {
                let power = 10_f64.powi(digits);
                write!(f, "{}", (self.value * power).round() / power + 0.0)?;
            }
            None => write!(f, "{}", self.value)?,
        }
        match self.unit.symbol() {
            "" => Ok(()),
            symbol => write!(f, " {symbol}"),
        }
    }
}

/// Decimals that distinguish a value from its neighbours: as many as the step has, if it is a decimal fraction itself,
/// otherwise as many as its size needs. More would come from the arithmetic, not from the drive.
fn decimals(step: f64) -> Option<i32> {
    const DECIMALS_MAX: i32 = 4;
    if !(1e-12..1e12).contains(&step) {
        return None;
    }
    let needed = (-step.log10()).ceil().max(0.0) as i32;
    Some(
        (0..=DECIMALS_MAX)
            .find(|digits| {
                let scaled = step * 10_f64.powi(*digits);
                (scaled - scaled.round()).abs() < 1e-6 && scaled >= 0.5
            })
            .unwrap_or(needed),
    )
}

#[cfg(test)]
mod tests {
    use super::Value;
    use polepair_core::profile::Encoding;
    use polepair_core::units::Unit;

    #[test]
    fn no_more_digits_than_the_drive_has() {
        let shown = |value: f64, step: f64| {
            let (unit, encoding) = (Unit::Degree, Encoding::I32);
            let value =
                Value { raw: 0, value, step, unit, word: None, bits: &[], encoding, is_raw: false };
            value.to_string()
        };
        assert_eq!(shown(1760.80078125, 360.0 / 4096.0), "1760.8 deg");
        assert_eq!(shown(0.087_890_625, 360.0 / 4096.0), "0.09 deg");
        assert_eq!(shown(-0.036, 0.036), "-0.036 deg");
        assert_eq!(shown(0.1 + 0.2, 0.1), "0.3 deg");
        assert_eq!(shown(-0.0, 0.1), "0 deg");
        assert_eq!(shown(1234567.0, 1.0), "1234567 deg");
    }
}
