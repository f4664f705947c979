//! Numbers as multiples of 1e-9, so that nanoseconds and integers of a wire are exact.

/// One, in billionths.
const ONE: i128 = 1_000_000_000;
/// Units of time that a number may end in, in billionths of a second.
const UNITS: [(&str, i128); 7] = [
    ("s", ONE),
    ("ms", 1_000_000),
    ("us", 1000),
    ("µs", 1000),
    ("ns", 1),
    ("min", 60 * ONE),
    ("h", 3600 * ONE),
];

/// A whole number.
pub(super) fn from_integer(value: impl Into<i128>) -> i128 {
    value.into() * ONE
}

/// A real number.
pub(super) fn from_real(value: f64) -> i128 {
    (value * ONE as f64).round() as i128
}

/// A number as a person writes it, and whether it has a unit of time: `-5`, `0x602`, `2.5ms`.
pub(super) fn parse(text: &str) -> Option<(i128, bool)> {
    let (sign, digits) = match text.as_bytes().first()? {
        b'-' => (-1, &text[1..]),
        b'+' => (1, &text[1..]),
        _ => (1, text),
    };
    if let Some(hex) = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        return Some((sign * from_integer(u64::from_str_radix(hex, 16).ok()?), false));
    }
    let end = digits.find(|c| !is_decimal_char(c)).unwrap_or(digits.len());
    let value = parse_decimal(&digits[..end])?;
    match &digits[end..] {
        "" => Some((sign * value, false)),
        unit => {
            let (_, scale) = UNITS.iter().find(|(name, _)| *name == unit)?;
            Some((sign * (value.checked_mul(*scale)? / ONE), true))
        }
    }
}

fn is_decimal_char(c: char) -> bool {
    c.is_ascii_digit() || c == '.'
}

fn parse_decimal(text: &str) -> Option<i128> {
    let (before, after) = text.split_once('.').unwrap_or((text, ""));
    if before.is_empty() || !is_all_digits(before) || !is_all_digits(after) {
        return None;
    }
    let fraction: String = after.chars().chain("000000000".chars()).take(9).collect();
    let before: u64 = before.parse().ok()?;
    Some(from_integer(before) + fraction.parse::<i128>().ok()?)
}

fn is_all_digits(part: &str) -> bool {
    part.bytes().all(|c| c.is_ascii_digit())
}

/// Ranges of which one has to hold a number; both ends belong to them.
#[derive(Clone, Debug, Default)]
pub(super) struct NumberRanges(pub Vec<(i128, i128)>);

impl NumberRanges {
    pub(super) fn single(least: i128, most: i128) -> Self {
        Self(vec![(least, most)])
    }

    pub(super) fn contains(&self, value: i128) -> bool {
        self.0.iter().any(|(least, most)| (*least..=*most).contains(&value))
    }
}
