//! Digits of lines, eight at a time: the way that millions of lines go.

use super::seriallog::HEX;

const ONES: u64 = 0x0101_0101_0101_0101;
const HIGH: u64 = 0x80 * ONES;
/// What makes digits of their characters.
const LOW: u64 = 0x0F * ONES;
/// What makes small letters of capitals.
const SMALL: u64 = 0x20 * ONES;

/// A byte's uppermost bit where `low <= byte <= high`, for bytes below 80h.
const fn between(bytes: u64, low: u8, high: u8) -> u64 {
    let from = bytes + (0x80 - low as u64) * ONES;
    let beyond = bytes + (0x7F - high as u64) * ONES;
    from & !beyond & HIGH
}

const fn are_decimal(text: u64) -> bool {
    between(text & !HIGH, b'0', b'9') & !text == HIGH
}

/// Eight decimal digits.
#[inline]
pub(super) const fn decimal(text: [u8; 8]) -> Option<u64> {
    let text = u64::from_le_bytes(text);
    if !are_decimal(text) {
        return None;
    }
    // Neighbours are joined: digits to pairs, pairs to fours, fours to the number.
    let pairs = (text & LOW).wrapping_mul(10 << 8 | 1) >> 8 & 0x00FF_00FF_00FF_00FF;
    let fours = pairs.wrapping_mul(100 << 16 | 1) >> 16 & 0x0000_FFFF_0000_FFFF;
    Some(fours.wrapping_mul(10_000 << 32 | 1) >> 32)
}

/// Eight hexadecimal digits, the first the uppermost.
#[inline]
pub(super) const fn hexadecimal(text: [u8; 8]) -> Option<u32> {
    let text = u64::from_le_bytes(text);
    let lower = (text & !HIGH) | SMALL;
    let digits = between(text & !HIGH, b'0', b'9') | between(lower, b'a', b'f');
    if digits & !text != HIGH {
        return None;
    }
    let nibbles = (text & LOW) + ((text >> 6) & ONES) * 9;
    let bytes = nibbles.swap_bytes();
    let bytes = (bytes | bytes >> 4) & 0x00FF_00FF_00FF_00FF;
    let words = (bytes | bytes >> 8) & 0x0000_FFFF_0000_FFFF;
    Some((words | words >> 16) as u32)
}

/// Bytes as hexadecimal digits, at most sixteen of them; how many bytes.
#[inline]
pub(super) fn bytes(text: &[u8], out: &mut [u8; 8]) -> Option<u8> {
    let mut data = 0u64;
    let mut left = text;
    while let Some((eight, rest)) = left.split_first_chunk::<8>() {
        data = data << 32 | u64::from(hexadecimal(*eight)?);
        left = rest;
    }
    let (mut bad, (pairs, odd)) = (0, left.as_chunks::<2>());
    for [high, low] in pairs {
        let (high, low) = (HEX[usize::from(*high)], HEX[usize::from(*low)]);
        bad |= high | low;
        data = data << 8 | u64::from(high << 4 | low & 0xF);
    }
    let len = text.len() / 2;
    if bad > 15 || !odd.is_empty() || len > 8 {
        return None;
    }
    *out = if len == 0 { [0; 8] } else { (data << (64 - 8 * len as u32)).to_be_bytes() };
    Some(len as u8)
}

#[cfg(test)]
mod tests {
    use super::{bytes, decimal, hexadecimal};

    /// Every byte in every place says what the standard library says.
    #[test]
    fn eight_digits_as_one_by_one() {
        for place in 0..8 {
            for byte in 0..=255u8 {
                let mut text = *b"90817263";
                text[place] = byte;
                let plain = text.iter().all(u8::is_ascii_alphanumeric);
                let shown = std::str::from_utf8(&text).ok().filter(|_| plain);
                let number = |radix| shown.and_then(|text| u64::from_str_radix(text, radix).ok());
                assert_eq!(decimal(text), number(10), "{text:?}");
                assert_eq!(hexadecimal(text).map(u64::from), number(16), "{text:?}");
            }
        }
    }

    #[test]
    fn bytes_of_any_length() {
        let mut out = [0xFF; 8];
        assert_eq!((bytes(b"", &mut out), out), (Some(0), [0; 8]));
        assert_eq!((bytes(b"aB01", &mut out), out), (Some(2), [0xAB, 1, 0, 0, 0, 0, 0, 0]));
        assert_eq!(bytes(b"0102030405060708", &mut out), Some(8));
        assert_eq!(out, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes(b"010203040506", &mut out), Some(6));
        assert_eq!(out, [1, 2, 3, 4, 5, 6, 0, 0]);
        for text in ["1", "010", "0g", "01020304050607080", "010203040506070809"] {
            assert_eq!(bytes(text.as_bytes(), &mut out), None, "{text}");
        }
    }
}
