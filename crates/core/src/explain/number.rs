//! Numbers of a frame, and the bytes that they come from. An explanation that names the bytes of its numbers can be
//! made anew for a frame with other numbers, without explaining that frame.
//!
//! Why: DEC-6.

use crate::convert::ascii_text;

/// Order of the bytes of a number.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ByteOrder {
    /// The high byte first.
    HighFirst,
    /// The low byte first.
    LowFirst,
    /// 16-bit words with the high byte first, the low word first.
    LowWordFirst,
}

/// The bytes of a frame that are a number, eight at most.
///
/// They have no other effect on the explanation than the numbers, fields and values that are reported with this place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NumberPlace {
    /// First byte in the frame.
    pub start: u8,
    /// Number of bytes.
    pub len: u8,
    /// Order of the bytes.
    pub order: ByteOrder,
    /// True for two's complement.
    pub is_signed: bool,
    /// Numbers that are explained in other words.
    pub named: &'static [(i64, &'static str)],
}

impl NumberPlace {
    /// A number without a sign, the high byte first.
    #[must_use]
    pub const fn unsigned(start: u8, len: u8) -> Self {
        Self { start, len, order: ByteOrder::HighFirst, is_signed: false, named: &[] }
    }

    /// A number in two's complement, the high byte first.
    #[must_use]
    pub const fn signed(start: u8, len: u8) -> Self {
        Self { is_signed: true, ..Self::unsigned(start, len) }
    }

    /// The number in a frame; `None` if the frame is too short, or explains the number in other words.
    #[must_use]
    pub fn decode(&self, frame: &[u8]) -> Option<i64> {
        let start = usize::from(self.start);
        let bytes = frame.get(start..start + usize::from(self.len))?;
        let join = |bits: u64, byte: &u8| bits << 8 | u64::from(*byte);
        let bits = match self.order {
            ByteOrder::HighFirst => bytes.iter().fold(0, join),
            ByteOrder::LowFirst => bytes.iter().rev().fold(0, join),
            ByteOrder::LowWordFirst => bytes.chunks(2).rev().flatten().fold(0, join),
        };
        let unused = u64::BITS - 8 * u32::from(self.len.clamp(1, 8));
        let number = if self.is_signed {
            (bits << unused).cast_signed() >> unused
        } else {
            bits.cast_signed()
        };
        let is_named = self.named.iter().any(|(value, _)| *value == number);
        (!is_named).then_some(number)
    }
}

/// Text of a number.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum NumberStyle {
    /// The number alone: `-12`.
    Whole,
    /// A number of tenths: `-1.2`.
    Tenths,
    /// Hexadecimal, with this number of digits: `0x00FF`. The number is not negative and has no more than eight.
    Hex(u8),
    /// Multiplied by a factor, with at most three decimals: `-0.012`. The product is at most
    /// [`SCALED_MAX`](Self::SCALED_MAX).
    Scaled(f64),
}

impl NumberStyle {
    /// Thousandths of larger numbers do not fit the integer in which they are counted.
    pub const SCALED_MAX: f64 = 9.0e12;

    /// Returns whether a number is not too large for the style.
    #[must_use]
    pub fn fits(self, number: i64) -> bool {
        match self {
            Self::Whole | Self::Tenths => true,
            Self::Hex(_) => (0..=u32::MAX.into()).contains(&number),
            Self::Scaled(factor) => (number as f64 * factor).abs() <= Self::SCALED_MAX,
        }
    }

    /// Writes a number; `None` if it is too large for the style.
    #[must_use]
    pub fn text_of(self, number: i64) -> Option<Decimal> {
        self.fits(number).then(|| match self {
            Self::Whole => Decimal::of(number),
            Self::Tenths => Decimal::with_decimals(number, 1),
            Self::Hex(digits) => Decimal::hexadecimal(number as u32, digits),
            Self::Scaled(factor) => {
                Decimal::of_thousandths(rounded(number as f64 * factor * 1000.0))
            }
        })
    }
}

/// The nearest whole number, a half away from zero, of one that is far from the ends of the range.
fn rounded(value: f64) -> i64 {
    let whole = value as i64;
    // The difference is exact: where numbers have fractions, whole ones next to them are numbers too.
    let rest = value - whole as f64;
    if rest >= 0.5 {
        whole + 1
    } else if rest <= -0.5 {
        whole - 1
    } else {
        whole
    }
}

/// A number as characters, in decimal mostly.
#[derive(Clone, Copy, Debug)]
pub struct Decimal {
    digits: [u8; Self::MAX],
    start: usize,
}

impl Decimal {
    const MAX: usize = 24;

    /// Writes `number`.
    #[must_use]
    pub fn of(number: i64) -> Self {
        Self::with_decimals(number, 0)
    }

    /// Writes `number` with the last digits, as many as `decimals`, behind a point.
    #[must_use]
    pub fn with_decimals(number: i64, decimals: usize) -> Self {
        let mut this = Self { digits: [0; Self::MAX], start: Self::MAX };
        let mut rest = number.unsigned_abs();
        for place in 0.. {
            // At least one digit is before the point.
            if rest == 0 && place > decimals {
                break;
            }
            if place == decimals && decimals > 0 {
                this.push(b'.');
            }
            this.push(b'0' + (rest % 10) as u8);
            rest /= 10;
        }
        if number < 0 {
            this.push(b'-');
        }
        this
    }

    /// Writes `number` in hexadecimal with at least `digits` digits.
    #[must_use]
    fn hexadecimal(number: u32, digits: u8) -> Self {
        let mut this = Self { digits: [0; Self::MAX], start: Self::MAX };
        let mut rest = number;
        for place in 0..8 {
            if rest == 0 && place >= digits {
                break;
            }
            this.push(b"0123456789ABCDEF"[(rest & 0xF) as usize]);
            rest >>= 4;
        }
        this.push(b'x');
        this.push(b'0');
        this
    }

    /// Writes a number of thousandths without zeros at the end.
    #[must_use]
    pub fn of_thousandths(number: i64) -> Self {
        let (mut shown, mut decimals) = (number, 3);
        while decimals > 0 && shown % 10 == 0 {
            (shown, decimals) = (shown / 10, decimals - 1);
        }
        Self::with_decimals(shown, decimals)
    }

    /// The characters.
    #[must_use]
    pub fn as_str(&self) -> &str {
        ascii_text(self.as_bytes())
    }

    /// The characters as bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.digits[self.start..]
    }

    fn push(&mut self, digit: u8) {
        self.start -= 1;
        self.digits[self.start] = digit;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;

    use super::*;

    #[test]
    fn decimals_read_as_those_of_the_standard_library() {
        for number in [0, 5, -5, 10, -10, 999, 1000, -1001, i64::MAX, i64::MIN] {
            assert_eq!(Decimal::of(number).as_str(), format!("{number}"));
            let (sign, size) = (if number < 0 { "-" } else { "" }, number.unsigned_abs());
            let tenths = format!("{sign}{}.{}", size / 10, size % 10);
            assert_eq!(Decimal::with_decimals(number, 1).as_str(), tenths);
        }
        for (thousandths, text) in [
            (0, "0"),
            (1, "0.001"),
            (-10, "-0.01"),
            (1500, "1.5"),
            (-2000, "-2"),
            (10_050, "10.05"),
        ] {
            assert_eq!(Decimal::of_thousandths(thousandths).as_str(), text);
        }
    }

    #[test]
    fn halves_are_rounded_away_from_zero() {
        let near = [0.0, 0.5, 1.0, 1.5, 2.5, 0.499_999_999_999_999_94, 4e15, 4.5e15, 9e15];
        for value in near.into_iter().flat_map(|it| [it, -it, it + 0.25, it - 0.25]) {
            assert_eq!(rounded(value), libm::round(value) as i64, "{value}");
        }
    }

    #[test]
    fn places_are_read_in_their_order() {
        let frame = [0xFF, 0xFE, 0x00, 0x01];
        let low = ByteOrder::LowWordFirst;
        let words = NumberPlace { order: low, ..NumberPlace::signed(0, 4) };
        assert_eq!(words.decode(&frame), Some(0x0001_FFFE));
        assert_eq!(NumberPlace::signed(0, 2).decode(&frame), Some(-2));
        assert_eq!(NumberPlace::unsigned(0, 2).decode(&frame), Some(0xFFFE));
        assert_eq!(NumberPlace::unsigned(1, 4).decode(&frame), None);
        let named = NumberPlace { named: &[(-2, "refused")], ..NumberPlace::signed(0, 2) };
        assert_eq!(named.decode(&frame), None);
        assert_eq!(NumberStyle::Scaled(0.5).text_of(3).map(|it| it.as_str().len()), Some(3));
        assert!(NumberStyle::Scaled(1e6).text_of(i64::MAX).is_none());
        let low = NumberPlace { order: ByteOrder::LowFirst, ..NumberPlace::unsigned(0, 3) };
        assert_eq!(low.decode(&frame), Some(0xFEFF));
        for (number, digits, text) in [(0, 2, "0x00"), (0xAB, 4, "0x00AB"), (0xABCDE, 2, "0xABCDE")]
        {
            let hex = NumberStyle::Hex(digits).text_of(number);
            assert_eq!(hex.map(|it| it.as_str() == text), Some(true), "{text}");
        }
    }
}
