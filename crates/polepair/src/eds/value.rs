//! Values of EDS files: decimal, hexadecimal, octal, `$NODEID+0x180`, text.

use super::object_types::DataType;
use std::fmt;

/// A value of a file.
#[derive(Clone, PartialEq, Debug)]
pub enum Literal {
    /// A whole number.
    Integer {
        /// The number, or the offset to the node-ID.
        value: i64,
        /// The node-ID is added.
        plus_node: bool,
        /// True if it was written in hexadecimal.
        hex: bool,
    },
    /// Other values, unchanged: real numbers, text, bytes.
    Text(String),
}

/// A whole number and how it was written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ParsedInteger {
    pub(super) value: i64,
    pub(super) hex: bool,
    /// A leading zero makes it octal, which few who write one mean.
    pub(super) octal: bool,
}

impl Literal {
    /// The number, for the node of that id.
    #[must_use]
    pub fn integer(&self, node: u8) -> Option<i64> {
        match self {
            Self::Integer { value, plus_node: false, .. } => Some(*value),
            Self::Integer { value, plus_node: true, .. } => value.checked_add(i64::from(node)),
            Self::Text(_) => None,
        }
    }
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer { value, plus_node, hex } => {
                if *plus_node {
                    f.write_str("$NODEID+")?;
                }
                if !hex {
                    write!(f, "{value}")
                } else if *value < 0 {
                    write!(f, "-0x{:X}", value.unsigned_abs())
                } else {
                    write!(f, "0x{value:X}")
                }
            }
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// A whole number: decimal, `0x` hexadecimal, octal behind a zero; signed.
pub(super) fn parse_integer(text: &str) -> Option<ParsedInteger> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits.trim_start()),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    // CiA 306 reads a leading zero as octal, which most authors of such files did not mean: a warning
    // shows it.
    let octal = hex.is_none() && digits.len() > 1 && digits.starts_with('0');
    let magnitude = match hex {
        Some(digits) if !digits.starts_with('+') => u64::from_str_radix(digits, 16).ok()?,
        None if !digits.starts_with('+') => {
            u64::from_str_radix(digits, if octal { 8 } else { 10 }).ok()?
        }
        _ => return None,
    };
    // What 64 bits hold unsigned keeps its bits.
    let value = match (negative, i64::try_from(magnitude)) {
        (false, Ok(value)) => value,
        (false, Err(_)) => magnitude.cast_signed(),
        (true, Ok(value)) => -value,
        (true, Err(_)) => return None,
    };
    let octal = octal && value != 0;
    Some(ParsedInteger { value, hex: hex.is_some(), octal })
}

/// A value of that type; what else deserves a word goes to `warn`.
///
/// # Errors
/// The fault of the text.
pub(super) fn parse_literal(
    text: &str,
    kind: DataType,
    warn: &mut impl FnMut(String),
) -> Result<Literal, String> {
    if !kind.is_integer() {
        return Ok(Literal::Text(text.to_owned()));
    }
    let (rest, plus_node) = strip_node_id(text);
    let found = match rest {
        "" if plus_node => Some(ParsedInteger { value: 0, hex: true, octal: false }),
        _ => parse_integer(rest).or_else(|| parse_bool(rest)),
    };
    let Some(found) = found else { return Err(format!("`{text}` is no number")) };
    if found.octal {
        warn(format!("`{text}` begins with 0: read as octal, {}", found.value));
    }
    let value = fit_to_type(found.value, kind).ok_or_else(|| {
        format!("`{text}` does not fit into {}", kind.name().unwrap_or("its type"))
    })?;
    Ok(Literal::Integer { value, plus_node, hex: found.hex })
}

/// The part beside `$NODEID`, on either side of the `+`.
fn strip_node_id(text: &str) -> (&str, bool) {
    match text.split_once('+') {
        _ if is_node_id(text) => ("", true),
        Some((a, b)) if is_node_id(a) => (b.trim(), true),
        Some((a, b)) if is_node_id(b) => (a.trim(), true),
        _ => (text, false),
    }
}

fn is_node_id(part: &str) -> bool {
    const NODE: &str = "$NODEID";
    part.trim().eq_ignore_ascii_case(NODE)
}

/// Booleans in words.
fn parse_bool(text: &str) -> Option<ParsedInteger> {
    let value = match text {
        _ if text.eq_ignore_ascii_case("true") => 1,
        _ if text.eq_ignore_ascii_case("false") => 0,
        _ => return None,
    };
    Some(ParsedInteger { value, hex: false, octal: false })
}

/// The number as the type holds it: bits that make a negative number of a signed type are one.
fn fit_to_type(value: i64, kind: DataType) -> Option<i64> {
    let Some((low, high)) = kind.range() else { return Some(value) };
    if (low..=high).contains(&value) {
        return Some(value);
    }
    let bits = u32::from(kind.bits()?);
    if bits == 64 {
        return Some(value);
    }
    debug_assert!(bits < 64);
    // Many sheets write a negative number by its bits, such as 0xFFFF for -1.
    let as_bits = kind.is_signed() && (0..1 << bits).contains(&value);
    as_bits.then(|| value << (64 - bits) >> (64 - bits))
}
