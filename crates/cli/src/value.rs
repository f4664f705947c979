//! Parses the values of options, and prints numbers with units.

use std::ops::RangeInclusive;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use polepair_capture::CaptureFormat;
use polepair_core::profile::Parameter;
use polepair_core::units::Unit;

pub use polepair::quantity::{format_amount, format_number};
pub use polepair_capture::plural;

/// A span of time in seconds, with its unit: `2s`, `500ms`, `1min`; `0` needs none.
///
/// # Errors
/// The fault of the text, in words.
pub fn parse_span(text: &str) -> Result<f64, String> {
    let measure =
        polepair::quantity::parse(text).map_err(|error| duration_error(error.to_string()))?;
    if measure.quantity.is_none() && measure.si != 0.0 {
        return Err(duration_error("a time needs its unit".to_owned()));
    }
    let seconds =
        measure.in_unit(Unit::Second).map_err(|error| duration_error(error.to_string()))?;
    if (0.0..=1e6).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(duration_error("not a span of time".to_owned()))
    }
}

fn duration_error(why: String) -> String {
    format!("{why}; write 100ms, 5s or 1min")
}

/// A raw value in the parameter's own unit, where no other parameter scales it.
pub fn in_own_unit(parameter: &Parameter, raw: i64) -> Option<f64> {
    let scale = parameter.scale;
    scale.is_constant().then_some(raw as f64 * scale.factor)
}

/// The name of a raw value, if it has one.
pub fn value_name(parameter: &Parameter, raw: i64) -> Option<&'static str> {
    parameter.values.iter().find(|(value, _)| *value == raw).map(|(_, name)| *name)
}

/// A whole number, also as `0x1F`.
pub fn parse_whole(text: &str) -> Option<i64> {
    match text.strip_prefix("0x") {
        Some(digits) => i64::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

/// Reads the word of a capture format.
pub fn capture_format() -> impl TypedValueParser<Value = CaptureFormat> {
    PossibleValuesParser::new(CaptureFormat::names())
        .map(|word| CaptureFormat::from_name(&word).unwrap_or(CaptureFormat::Text))
}

/// A range of a drive's memory: FIRST-LAST.
pub fn parse_memory(text: &str) -> std::result::Result<RangeInclusive<u16>, String> {
    let address = |text: &str| parse_whole(text).and_then(|number| u16::try_from(number).ok());
    let range =
        text.split_once('-').and_then(|(first, last)| Some(address(first)?..=address(last)?));
    let range = range.filter(|range| !range.is_empty());
    range.ok_or_else(|| "the memory is FIRST-LAST: 0x8270-0x87FF".to_owned())
}

#[cfg(test)]
mod tests {
    use super::{parse_memory, parse_span};

    #[test]
    fn ranges_of_memory() {
        assert_eq!(parse_memory("0x8270-0x87FF"), Ok(0x8270..=0x87FF));
        assert!(parse_memory("0x87FF-0x8270").is_err() && parse_memory("70000-70001").is_err());
    }

    #[test]
    fn spans() {
        assert_eq!(parse_span("500ms"), Ok(0.5));
        assert_eq!(parse_span("0"), Ok(0.0));
        for text in ["100", "2 rpm", "1,5s", "-1s"] {
            let output = parse_span(text).expect_err(text);
            assert!(output.ends_with("; write 100ms, 5s or 1min"), "{output}");
        }
        assert!(parse_span("-1s").is_err() && parse_span("2 rpm").is_err());
    }
}
