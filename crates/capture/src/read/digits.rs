//! Parses digits of lines, eight at a time.

const ONES: u64 = 0x0101_0101_0101_0101;
const HIGH: u64 = 0x80 * ONES;
/// Mask that converts characters to digits.
const LOW: u64 = 0x0F * ONES;
/// Mask that converts capitals to small letters.
const SMALL: u64 = 0x20 * ONES;

/// A byte's uppermost bit where `low <= byte <= high`, for bytes below 80h.
const fn in_range_mask(bytes: u64, low: u8, high: u8) -> u64 {
    let from = bytes + (0x80 - low as u64) * ONES;
    let beyond = bytes + (0x7F - high as u64) * ONES;
    from & !beyond & HIGH
}

const fn all_decimal(text: u64) -> bool {
    in_range_mask(text & !HIGH, b'0', b'9') & !text == HIGH
}

/// Eight decimal digits.
#[inline]
pub(super) const fn parse_decimal(text: [u8; 8]) -> Option<u64> {
    let text = u64::from_le_bytes(text);
    if !all_decimal(text) {
        return None;
    }
    // Neighbours are joined: digits to pairs, pairs to fours, fours to the number.
    let pairs = (text & LOW).wrapping_mul(10 << 8 | 1) >> 8 & 0x00FF_00FF_00FF_00FF;
    let fours = pairs.wrapping_mul(100 << 16 | 1) >> 16 & 0x0000_FFFF_0000_FFFF;
    Some(fours.wrapping_mul(10_000 << 32 | 1) >> 32)
}

/// Eight hexadecimal digits, the first the uppermost.
#[inline]
pub(super) const fn parse_hex(text: [u8; 8]) -> Option<u32> {
    let (bytes, other) = hex_bytes(u64::from_le_bytes(text));
    if other == 0 { Some((bytes as u32).swap_bytes()) } else { None }
}

/// Four bytes of eight hexadecimal digits, the first lowest; and for each character that is no such digit, the
/// uppermost bit.
#[inline]
const fn hex_bytes(text: u64) -> (u64, u64) {
    let decimal = in_range_mask(text & !HIGH, b'0', b'9');
    let letter = in_range_mask((text & !HIGH) | SMALL, b'a', b'f');
    let nibbles = (text & LOW) + ((text >> 6) & ONES) * 9;
    let bytes = (nibbles << 4 | nibbles >> 8) & 0x00FF_00FF_00FF_00FF;
    let words = (bytes | bytes >> 8) & 0x0000_FFFF_0000_FFFF;
    ((words | words >> 16) & 0xFFFF_FFFF, (!(decimal | letter) | text) & HIGH)
}

/// The first eight digits of a time stamp, and their value in microseconds: the same for 100 s.
#[derive(Clone, Copy, Debug)]
pub(super) struct StampPrefix([u8; 8], u64);

impl Default for StampPrefix {
    fn default() -> Self {
        Self(*b"00000000", 0)
    }
}

/// Seconds and microseconds of `(1700000000.000500) `, as one number.
#[inline]
pub(super) fn parse_stamp(text: &[u8; 20], known: &mut StampPrefix) -> Option<u64> {
    let [open, high @ .., _, _, _, _, _, _, _, _, _, _, _] = text;
    let [.., a, b, dot, m, n, o, p, q, r, close, space] = text;
    if [*open, *dot, *close, *space] != *b"(.) " {
        return None;
    }
    // Ten digits of seconds and six of microseconds, split after the eighth.
    if *high != known.0 {
        *known = StampPrefix(*high, parse_decimal(*high)? * 100_000_000);
    }
    Some(known.1 + parse_decimal([*a, *b, *m, *n, *o, *p, *q, *r])?)
}

/// Bytes as hexadecimal digits up to the end of their line, at most sixteen; and how many digits. Further
/// bytes are zero.
#[inline]
pub(super) fn parse_hex_line(text: &[u8; 17]) -> Option<([u8; 8], usize)> {
    let (eights, [last]) = text.as_chunks::<8>() else { return None };
    let [first, second] = eights else { return None };
    let (low, other) = hex_bytes(u64::from_le_bytes(*first));
    let (high, beyond) = hex_bytes(u64::from_le_bytes(*second));
    let data = low | high << 32;
    // Most frames have eight bytes.
    if other | beyond == 0 {
        return (*last == b'\n').then_some((data.to_le_bytes(), 16));
    }
    let count = match other {
        0 => 8 + beyond.trailing_zeros() / 8,
        _ => other.trailing_zeros() / 8,
    };
    let whole = count.is_multiple_of(2) && text[count as usize] == b'\n';
    whole.then(|| ((data & !(u64::MAX << (4 * count))).to_le_bytes(), count as usize))
}

/// Four bytes of text such as ` 01 0A FF 00`, each behind a space.
#[inline]
pub(super) fn parse_four_spaced(text: &[u8; 12]) -> Option<[u8; 4]> {
    let (head, tail) = (text.first_chunk()?, text.last_chunk()?);
    let (low, high) = (u64::from_le_bytes(*head), u64::from(u32::from_le_bytes(*tail)));
    if (low & 0x00FF_0000_FF00_00FF, high & 0xFF00) != (0x0020_0000_2000_0020, 0x2000) {
        return None;
    }
    // The pairs of digits, one behind the other.
    let digits = (low >> 8 & 0xFFFF)
        | (low >> 32 & 0xFFFF) << 16
        | (low >> 56) << 32
        | (high & 0xFF) << 40
        | (high >> 16) << 48;
    let (bytes, other) = hex_bytes(digits);
    (other == 0).then(|| (bytes as u32).to_le_bytes())
}

#[cfg(test)]
mod tests {
    use super::{StampPrefix, parse_decimal, parse_hex, parse_hex_line, parse_stamp};

    /// Every byte at every position gives the result of the standard library.
    #[test]
    fn eight_digits_as_one_by_one() {
        for index in 0..8 {
            for byte in 0..=255u8 {
                let mut text = *b"90817263";
                text[index] = byte;
                let plain = text.iter().all(u8::is_ascii_alphanumeric);
                let shown = std::str::from_utf8(&text).ok().filter(|_| plain);
                let number = |radix| shown.and_then(|text| u64::from_str_radix(text, radix).ok());
                assert_eq!(parse_decimal(text), number(10), "{text:?}");
                assert_eq!(parse_hex(text).map(u64::from), number(16), "{text:?}");
            }
        }
    }

    #[test]
    fn bytes_of_any_length() {
        let read = |text: &str| {
            let line = format!("{text}(1700000000.000500)");
            let line = line.as_bytes().first_chunk().expect("long enough");
            parse_hex_line(line)
        };
        assert_eq!(read("\n"), Some(([0; 8], 0)));
        assert_eq!(read("aB01\n"), Some(([0xAB, 1, 0, 0, 0, 0, 0, 0], 4)));
        assert_eq!(read("0102030405\n"), Some(([1, 2, 3, 4, 5, 0, 0, 0], 10)));
        assert_eq!(read("010203040506\n"), Some(([1, 2, 3, 4, 5, 6, 0, 0], 12)));
        assert_eq!(read("0102030405060708\n"), Some(([1, 2, 3, 4, 5, 6, 7, 8], 16)));
        for text in ["1\n", "010\n", "0g\n", "01\r\n", "01020304050607080\n", "0102030405060708"] {
            assert_eq!(read(text), None, "{text:?}");
        }
    }

    #[test]
    fn stamps_of_seconds_and_microseconds() {
        let mut high = StampPrefix::default();
        let mut read = |text| parse_stamp(text, &mut high);
        assert_eq!(read(b"(1700000000.000500) "), Some(1_700_000_000_000_500));
        assert_eq!(read(b"(1700000099.999999) "), Some(1_700_000_099_999_999));
        assert_eq!(read(b"(1700000100.000000) "), Some(1_700_000_100_000_000));
        assert_eq!(read(b"(0000000012.345678) "), Some(12_345_678));
        for text in [b"[1700000000.000500) ", b"(1700000000,000500) ", b"(1700000000.00050)  "] {
            assert_eq!(read(text), None);
        }
        let zeros = b"(\0\0\0\0\0\0\0\x0000.000500) ";
        assert_eq!(parse_stamp(zeros, &mut StampPrefix::default()), None);
        assert_eq!(read(b"(17000x0000.000500) "), None);
    }
}
