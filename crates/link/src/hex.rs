//! Hexadecimal digits of the ASCII protocols for CAN.

/// The digit of `nibble`, upper case.
pub(crate) const fn digit(nibble: u32) -> u8 {
    b"0123456789ABCDEF"[(nibble & 0xF) as usize]
}

/// The value of one digit.
pub(crate) const fn digit_value(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        _ => None,
    }
}

/// The value of 1 to 8 digits.
pub(crate) fn parse_hex(digits: &[u8]) -> Option<u32> {
    if digits.is_empty() || digits.len() > 8 {
        return None;
    }
    digits.iter().try_fold(0, |sum, &d| Some(sum << 4 | u32::from(digit_value(d)?)))
}

/// A line under construction; what does not fit is cut, which no caller lets happen.
#[derive(Debug)]
pub(crate) struct TextWriter<'a> {
    pub(crate) out: &'a mut [u8],
    pub(crate) len: usize,
}

impl<'a> TextWriter<'a> {
    pub(crate) fn new(out: &'a mut [u8]) -> Self {
        Self { out, len: 0 }
    }

    pub(crate) fn push_byte(&mut self, byte: u8) {
        if let Some(index) = self.out.get_mut(self.len) {
            *index = byte;
            self.len += 1;
        }
    }

    pub(crate) fn push_bytes(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.push_byte(byte));
    }

    /// Appends `value` in `digits` hexadecimal digits.
    pub(crate) fn push_hex(&mut self, value: u32, digits: u32) {
        (0..digits).rev().for_each(|n| self.push_byte(digit(value >> (4 * n))));
    }

    /// Appends `value` in decimal, with at least `digits` digits.
    pub(crate) fn push_decimal(&mut self, value: u64, digits: u32) {
        let min = 10_u64.pow(digits.saturating_sub(1));
        let mut power = min.max(10_u64.pow(value.checked_ilog10().unwrap_or(0)));
        while power > 0 {
            self.push_byte(b'0' + (value / power % 10) as u8);
            power /= 10;
        }
    }
}
