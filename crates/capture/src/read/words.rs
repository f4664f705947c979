//! Words and hexadecimal bytes of lines.

use super::ReadError;

/// The first word, and what follows it without the space between.
pub(crate) fn split_word(text: &[u8]) -> (&[u8], &[u8]) {
    let text = text.trim_ascii_start();
    let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    (&text[..end], text[end..].trim_ascii_start())
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

/// Values of hexadecimal digits by their character; 16 for all other characters.
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

/// The next word of a line; an empty one at its end, which no field accepts.
pub(super) fn next_word<'l>(words: &mut impl Iterator<Item = &'l str>) -> &'l str {
    words.next().unwrap_or("")
}
