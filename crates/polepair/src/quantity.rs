//! Numbers with units: `90 deg`, `60rpm`, `1.2 A`, `0x10`.

use crate::error::Error;
use crate::spelling;
use polepair_core::units::{Quantity, Unit};

/// A number and its unit, if one was given.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Measure {
    /// The number in SI: rad, m, rad/s, N·m, A, V, s, 1; °C for temperatures. Without a unit, the
    /// number as it was written.
    pub si: f64,
    /// Measured quantity; `None` without a unit.
    pub quantity: Option<Quantity>,
    /// True for linear values, in m; false for rotation, in rad, and all else.
    pub linear: bool,
}

/// Units besides those of [`Unit`], with their quantity and SI value.
const MORE_UNITS: [(&str, Quantity, f64); 30] = {
    use core::f64::consts::PI;
    [
        ("°", Quantity::Position, PI / 180.0),
        ("degrees", Quantity::Position, PI / 180.0),
        ("turns", Quantity::Position, 2.0 * PI),
        ("rev", Quantity::Position, 2.0 * PI),
        ("m", Quantity::Position, 1.0),
        ("cm", Quantity::Position, 1e-2),
        ("um", Quantity::Position, 1e-6),
        ("µm", Quantity::Position, 1e-6),
        ("rad/s", Quantity::Velocity, 1.0),
        ("deg/s", Quantity::Velocity, PI / 180.0),
        ("turn/s", Quantity::Velocity, 2.0 * PI),
        ("m/s", Quantity::Velocity, 1.0),
        ("rad/s2", Quantity::Acceleration, 1.0),
        ("rad/s²", Quantity::Acceleration, 1.0),
        ("deg/s2", Quantity::Acceleration, PI / 180.0),
        ("turn/s2", Quantity::Acceleration, 2.0 * PI),
        ("m/s2", Quantity::Acceleration, 1.0),
        ("N·m", Quantity::Torque, 1.0),
        ("N*m", Quantity::Torque, 1.0),
        ("mNm", Quantity::Torque, 1e-3),
        ("Ncm", Quantity::Torque, 1e-2),
        ("mA", Quantity::Current, 1e-3),
        ("mV", Quantity::Voltage, 1e-3),
        ("kV", Quantity::Voltage, 1e3),
        ("°C", Quantity::Temperature, 1.0),
        ("us", Quantity::Time, 1e-6),
        ("µs", Quantity::Time, 1e-6),
        ("min", Quantity::Time, 60.0),
        ("h", Quantity::Time, 3600.0),
        ("kbaud", Quantity::BitRate, 1e3),
    ]
};

/// The units of linear motion.
const LINEAR_UNITS: [&str; 9] = ["mm", "m", "cm", "um", "µm", "m/s", "mm/s", "m/s2", "mm/s2"];

/// A number with at most six digits that matter, without trailing zeros.
#[must_use]
pub fn format_number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { value.to_string() };
    }
    let digits = (5 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    let text = if digits > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A number with at most six digits that matter, and its unit.
#[must_use]
pub fn format_amount(value: f64, unit: &str) -> String {
    let number = format_number(value);
    if unit.is_empty() { number } else { format!("{number} {unit}") }
}

/// Reads a number with or without a unit. A unit's letter case is ignored where that is no
/// ambiguity.
///
/// ```
/// use polepair::quantity::parse;
/// use polepair_core::units::Quantity;
/// assert_eq!(parse("1200 mA").unwrap().si, 1.2);
/// assert_eq!(parse("60rpm").unwrap().quantity, Some(Quantity::Velocity));
/// assert_eq!(parse("-0x10").unwrap().si, -16.0);
/// assert!(parse("3 rmp").unwrap_err().to_string().contains("`rpm`"));
/// ```
///
/// # Errors
/// [`Error::Usage`] `E217` for a text that is no number, is not finite, or has an unknown unit.
pub fn parse(text: &str) -> Result<Measure, Error> {
    let text = text.trim();
    if let Some(number) = crate::toml_file::parse_number(text) {
        #[allow(clippy::cast_precision_loss, reason = "people write few digits")]
        return Ok(Measure { si: number as f64, quantity: None, linear: false });
    }
    let (number, unit) = split_number(text);
    if let Some(point) = with_decimal_point(number, unit) {
        let what = format!("`{text}` has a comma for its decimal point");
        return Err(Error::usage("E217", what, format!("write `{point}`")));
    }
    let si = number.parse::<f64>().ok().filter(|n| n.is_finite()).ok_or_else(|| {
        let what = format!("`{text}` does not begin with a number");
        Error::usage("E217", what, "write a number and a unit, such as `90 deg` or `1.2 A`")
    })?;
    if unit.is_empty() {
        return Ok(Measure { si, quantity: None, linear: false });
    }
    let (symbol, quantity, factor) = find_unit(unit).ok_or_else(|| {
        let near = spelling::suggestion(unit, known_symbols());
        Error::usage("E217", format!("`{unit}` is not a unit{near}"), known_units_text())
    })?;
    let linear = LINEAR_UNITS.contains(&symbol);
    Ok(Measure { si: si * factor, quantity: Some(quantity), linear })
}

impl Measure {
    /// The SI value for something that is shown in `unit`: a number without a unit is taken to be
    /// in `unit`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` when it measures something else: another quantity, or what turns
    /// where something goes along a line.
    pub fn in_unit(self, unit: Unit) -> Result<f64, Error> {
        match self.quantity {
            None => Ok(self.si * unit.si_factor()),
            Some(_) => self.si(unit),
        }
    }

    /// The SI value for a quantity that is shown in `unit`. A unit is required, except for zero.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` without a unit; as [`in_unit`](Self::in_unit).
    pub fn with_unit(self, unit: Unit) -> Result<f64, Error> {
        if self.quantity.is_none() && self.si != 0.0 {
            let hint = match unit {
                Unit::None => {
                    "give the drive's own number (--raw), or state unit and scale in the \
                               profile"
                        .to_owned()
                }
                unit => format!("write `{} {}`, or a number in SI", self.si, unit.symbol()),
            };
            return Err(Error::usage("E217", format!("`{}` has no unit", self.si), hint));
        }
        self.si(unit)
    }

    /// [`in_unit`](Self::in_unit) that takes a number without a unit as SI.
    ///
    /// # Errors
    /// As [`in_unit`](Self::in_unit).
    pub fn si(self, unit: Unit) -> Result<f64, Error> {
        match self.quantity {
            None => Ok(self.si),
            Some(quantity) if quantity != unit.quantity() => Err(mismatch_error(quantity, unit)),
            Some(_) if self.linear != unit.is_linear() => {
                let what = if unit.is_linear() {
                    "the axis is linear, but the value is an angle"
                } else {
                    "the axis is rotary, but the value is a length"
                };
                Err(Error::usage("E217", what, format!("it is measured in {}", unit.symbol())))
            }
            Some(_) => Ok(self.si),
        }
    }
}

fn mismatch_error(found: Quantity, wanted: Unit) -> Error {
    let (what, hint) = match wanted.quantity() {
        Quantity::Plain => (
            format!("this has no unit, but {} was given", quantity_name(found)),
            "write the number alone".to_owned(),
        ),
        quantity => (
            format!(
                "{} is wanted, but {} was given",
                quantity_name(quantity),
                quantity_name(found)
            ),
            format!("write it in {0}, such as `10 {0}`", wanted.symbol()),
        ),
    };
    Error::usage("E217", what, hint)
}

fn quantity_name(quantity: Quantity) -> String {
    let name = format!("{quantity:?}").to_lowercase();
    let article = if name.starts_with(['a', 'i']) { "an" } else { "a" };
    format!("{article} {name}")
}

/// A number that was written with one decimal comma, with a point.
fn with_decimal_point(number: &str, rest: &str) -> Option<String> {
    let rest = rest.strip_prefix(',')?;
    let decimals = rest.starts_with(|c: char| c.is_ascii_digit());
    (decimals && !rest.contains(',') && !number.contains('.')).then(|| format!("{number}.{rest}"))
}

/// The number at the head, and the rest.
fn split_number(text: &str) -> (&str, &str) {
    let mut end = 0;
    let bytes = text.as_bytes();
    while end < bytes.len() {
        let exponent = matches!(bytes[end], b'e' | b'E')
            && end > 0
            && text[end + 1..]
                .trim_start_matches(['+', '-'])
                .starts_with(|c: char| c.is_ascii_digit());
        let sign = matches!(bytes[end], b'+' | b'-')
            && (end == 0 || matches!(bytes[end - 1], b'e' | b'E'));
        if !(bytes[end].is_ascii_digit() || bytes[end] == b'.' || exponent || sign) {
            break;
        }
        end += 1;
    }
    (&text[..end], text[end..].trim())
}

fn unit_table() -> impl Iterator<Item = (&'static str, Quantity, f64)> {
    let named = Unit::ALL.into_iter().filter(|unit| *unit != Unit::None);
    named.map(|unit| (unit.symbol(), unit.quantity(), unit.si_factor())).chain(MORE_UNITS)
}

fn find_unit(text: &str) -> Option<(&'static str, Quantity, f64)> {
    let exact = unit_table().find(|(symbol, ..)| *symbol == text);
    exact.or_else(|| {
        let mut same = unit_table().filter(|(symbol, ..)| symbol.eq_ignore_ascii_case(text));
        let first = same.next()?;
        same.all(|(_, quantity, si)| (quantity, si) == (first.1, first.2)).then_some(first)
    })
}

fn known_symbols() -> Vec<&'static str> {
    unit_table().map(|(symbol, ..)| symbol).collect()
}

fn known_units_text() -> String {
    format!("units are {}", known_symbols().join(", "))
}

#[cfg(test)]
mod tests {
    use super::{format_number, parse};
    use polepair_core::units::{Quantity, Unit};

    #[test]
    fn a_decimal_comma_is_reported_with_the_point() {
        for (text, point) in [("1,5rad", "1.5rad"), ("-0,5 A", "-0.5 A"), ("2,5", "2.5")] {
            let error = parse(text).expect_err(text);
            assert_eq!(
                (error.code(), error.hint()),
                ("E217", &*format!("write `{point}`")),
                "{error}"
            );
            // Its unit may stand apart.
            let same = |text: &str| parse(&text.replace(' ', "")).map(|found| found.si).ok();
            assert_eq!(same(point), same(&text.replace(',', ".")));
        }
        assert!(!parse("1,000,5").expect_err("no number").hint().contains("1.000"));
    }

    #[test]
    fn another_quantity_is_reported_with_an_example() {
        let error = parse("5 V").and_then(|five| five.si(Unit::Rpm)).expect_err("no speed");
        assert_eq!(error.hint(), "write it in rpm, such as `10 rpm`");
    }

    #[test]
    fn numbers_and_units_are_distinguished() {
        for (text, si, quantity) in [
            ("90 deg", core::f64::consts::FRAC_PI_2, Some(Quantity::Position)),
            ("-1.5e3 mA", -1.5, Some(Quantity::Current)),
            ("5 %", 0.05, Some(Quantity::Ratio)),
            ("2 m/s", 2.0, Some(Quantity::Velocity)),
            ("60RPM", core::f64::consts::TAU, Some(Quantity::Velocity)),
            ("10", 10.0, None),
            ("1e-3", 0.001, None),
        ] {
            let measure = parse(text).unwrap();
            assert!((measure.si - si).abs() < 1e-9, "{text}: {measure:?}");
            assert_eq!(measure.quantity, quantity, "{text}");
        }
    }

    #[test]
    fn a_text_that_is_no_measure_is_refused() {
        for text in ["", "fast", "3 parsecs", "nan", "inf rpm", "1e999 rpm", "--3"] {
            assert_eq!(parse(text).unwrap_err().code(), "E217", "{text}");
        }
    }

    #[test]
    fn a_unit_must_measure_what_is_wanted() {
        assert!((parse("3000").unwrap().in_unit(Unit::Rpm).unwrap() - 314.159).abs() < 0.001);
        assert!(parse("3 A").unwrap().in_unit(Unit::Rpm).is_err());
        assert!(parse("3 A").unwrap().si(Unit::Rpm).is_err());
        assert!(parse("3 mm").unwrap().in_unit(Unit::Degree).is_err());
        assert!(parse("90 deg").unwrap().in_unit(Unit::Millimetre).is_err());
        assert!(parse("2 m/s").unwrap().in_unit(Unit::MillimetrePerSecond).is_ok());
        assert!(parse("3 A").unwrap().in_unit(Unit::None).is_err());
    }

    #[test]
    fn numbers_are_short() {
        let shown = [(350.0, "350"), (0.1 + 0.2, "0.3"), (1e6, "1000000"), (-0.0001, "-0.0001")];
        for (value, text) in shown {
            assert_eq!(format_number(value), text);
        }
    }
}
