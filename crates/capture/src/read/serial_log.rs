//! Serial logs: `> 01 01 00 00 00 00 01 5E 61` after the time stamp and the link.

use polepair_core::explain::Direction;

use super::ReadError;
use super::words::{parse_hex, parse_hex_digit, split_word};

/// Reads direction and bytes. Without `>` or `<` the direction is not known.
pub(crate) fn parse_data(rest: &[u8], bytes: &mut Vec<u8>) -> Result<Option<Direction>, ReadError> {
    bytes.clear();
    let (direction, digits) = match rest.first() {
        Some(b'>') => (Some(Direction::ToDrive), &rest[1..]),
        Some(b'<') => (Some(Direction::ToHost), &rest[1..]),
        _ => (None, rest),
    };
    parse_hex_words(digits, bytes)?;
    if bytes.is_empty() {
        return Err(ReadError("the line has no bytes"));
    }
    Ok(direction)
}

/// Reads bytes in hexadecimal, apart or together: `01 0A`, `010A`. A word that begins with a colon is
/// a frame of Modbus ASCII as its characters, whose end of line is added.
pub(crate) fn parse_hex_words(mut digits: &[u8], bytes: &mut Vec<u8>) -> Result<(), ReadError> {
    loop {
        let (pair, rest) = split_word(digits);
        if pair.is_empty() {
            return Ok(());
        }
        match pair {
            [b':', characters @ ..] => {
                characters.iter().try_for_each(|c| parse_hex_digit(*c).map(drop))?;
                bytes.extend_from_slice(pair);
                bytes.extend_from_slice(b"\r\n");
            }
            _ => parse_hex(pair, bytes)?,
        }
        digits = rest;
    }
}
