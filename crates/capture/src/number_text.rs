//! Appends numbers as text, like [`core::fmt`], in a tenth of its time.

/// `00` to `99`.
const PAIRS: &[u8; 200] = b"0001020304050607080910111213141516171819\
2021222324252627282930313233343536373839\
4041424344454647484950515253545556575859\
6061626364656667686970717273747576777879\
8081828384858687888990919293949596979899";
/// Digits of the greatest number.
const DIGITS_MAX: usize = 20;
const HEX: &[u8; 16] = b"0123456789ABCDEF";

/// `1 frame`, `2 frames`.
#[must_use]
pub fn plural(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Appends a number with at least `width` characters, `fill` in front.
#[inline]
pub(crate) fn append_padded(mut value: u64, width: usize, fill: u8, out: &mut Vec<u8>) {
    let mut digits = [fill; DIGITS_MAX];
    let mut at = DIGITS_MAX;
    while value >= 10 {
        let pair = 2 * (value % 100) as usize;
        value /= 100;
        at -= 2;
        digits[at] = PAIRS[pair];
        digits[at + 1] = PAIRS[pair + 1];
    }
    // A number of even length has no digit left.
    if value > 0 || at == DIGITS_MAX {
        at -= 1;
        digits[at] = b'0' + value as u8;
    }
    out.extend_from_slice(&digits[at.min(DIGITS_MAX - width)..]);
}

/// A number.
#[inline]
pub(crate) fn append_unsigned(value: u64, out: &mut Vec<u8>) {
    append_padded(value, 1, b'0', out);
}

/// A number with its sign.
#[inline]
pub(crate) fn append_signed(value: i64, out: &mut Vec<u8>) {
    if value < 0 {
        out.push(b'-');
    }
    append_unsigned(value.unsigned_abs(), out);
}

/// Appends a real number in the shortest text that distinguishes it from others.
pub(crate) fn append_real(value: f64, out: &mut Vec<u8>) {
    use std::io::Write as _;

    /// Integers below are exact.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    let whole = value as i64;
    if whole as f64 == value && value.abs() < EXACT && (whole != 0 || value.is_sign_positive()) {
        return append_signed(whole, out);
    }
    // Writing into a Vec cannot fail.
    let _ = write!(out, "{value}");
}

/// A byte as two digits.
#[inline]
pub(crate) const fn hex_digits(byte: u8) -> [u8; 2] {
    [HEX[(byte >> 4) as usize], HEX[(byte & 0xF) as usize]]
}

#[cfg(test)]
mod tests {
    use super::{append_padded, append_real, append_signed};

    fn text(put: impl FnOnce(&mut Vec<u8>)) -> String {
        let mut out = Vec::new();
        put(&mut out);
        String::from_utf8(out).expect("text")
    }

    #[test]
    fn numbers_as_the_standard_library_writes_them() {
        let powers = (0..19).map(|n| 10_i64.pow(n));
        let near = powers.flat_map(|n| [n - 1, n, n + 1, -n, 1 - n, n / 3, n / 7 * 5]);
        for number in near.chain([i64::MIN, i64::MAX]) {
            assert_eq!(text(|out| append_signed(number, out)), number.to_string());
            let real_number = number as f64 / 8.0;
            assert_eq!(text(|out| append_real(real_number, out)), real_number.to_string());
        }
        for number in [0.0, -0.0, 0.1, 1e300, -2.5, f64::NAN, f64::INFINITY, 9.1e15, 1e16] {
            assert_eq!(text(|out| append_real(number, out)), number.to_string());
        }
        assert_eq!(text(|out| append_padded(u64::MAX, 1, b'0', out)), u64::MAX.to_string());
        assert_eq!(text(|out| append_padded(7, 4, b' ', out)), "   7");
        assert_eq!(text(|out| append_padded(12, 6, b'0', out)), "000012");
        assert_eq!(text(|out| append_padded(123, 2, b'0', out)), "123");
    }
}
