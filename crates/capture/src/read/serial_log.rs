//! Serial logs: `> 01 01 00 00 00 00 01 5E 61` after the time stamp and the link.

use polepair_core::explain::Direction;

use super::ReadError;
use super::text::split_word;

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

/// Reads bytes in hexadecimal without spaces.
pub(crate) fn parse_hex(digits: &[u8], bytes: &mut Vec<u8>) -> Result<(), ReadError> {
    let pairs = digits.chunks_exact(2);
    if !pairs.remainder().is_empty() {
        return Err(ReadError("a byte has only one hexadecimal digit"));
    }
    for pair in pairs {
        let (high, low) = (parse_hex_digit(pair[0])?, parse_hex_digit(pair[1])?);
        bytes.push(high << 4 | low);
    }
    Ok(())
}

/// Value of one hexadecimal digit.
pub(crate) const fn parse_hex_digit(digit: u8) -> Result<u8, ReadError> {
    match HEX[digit as usize] {
        value @ 0..16 => Ok(value),
        _ => Err(ReadError("expected bytes as hexadecimal digits")),
    }
}

/// Values of hexadecimal digits by their character; 16 for what is none.
pub(crate) const HEX: [u8; 256] = {
    let mut table = [16; 256];
    let mut c = 0;
    while c < 256 {
        table[c] = match c as u8 {
            digit @ b'0'..=b'9' => digit - b'0',
            digit @ b'a'..=b'f' => digit - b'a' + 10,
            digit @ b'A'..=b'F' => digit - b'A' + 10,
            _ => 16,
        };
        c += 1;
    }
    table
};
