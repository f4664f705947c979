//! Encodings of parameter values on the wire.

/// Encoding of a raw value on the wire.
///
/// On Modbus a value of 32 bits takes two registers, one of 48 bits three and one of 64 bits four, high word first;
/// the `LowFirst` encodings have the low word first.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Encoding {
    /// One bit.
    Bit,
    /// Unsigned 8 bits, where objects have such a length.
    U8,
    /// Signed 8 bits, where objects have such a length.
    I8,
    /// Unsigned 16 bits, one register.
    U16,
    /// Signed 16 bits, one register.
    I16,
    /// Unsigned 32 bits.
    U32,
    /// Signed 32 bits.
    I32,
    /// Unsigned 48 bits, three registers.
    U48,
    /// Signed 48 bits, three registers.
    I48,
    /// Unsigned 64 bits. The raw value is the same 64 bits as a signed number.
    U64,
    /// Signed 64 bits.
    I64,
    /// IEEE 754, 32 bits. The raw value is its bits.
    F32,
    /// IEEE 754, 64 bits. The raw value is its bits.
    F64,
    /// [`U32`](Self::U32), low word first.
    U32LowFirst,
    /// [`I32`](Self::I32), low word first.
    I32LowFirst,
    /// [`U48`](Self::U48), low word first.
    U48LowFirst,
    /// [`I48`](Self::I48), low word first.
    I48LowFirst,
    /// [`U64`](Self::U64), low word first.
    U64LowFirst,
    /// [`I64`](Self::I64), low word first.
    I64LowFirst,
    /// [`F32`](Self::F32), low word first.
    F32LowFirst,
    /// [`F64`](Self::F64), low word first.
    F64LowFirst,
    /// Signed 32 bits of which the lower 16 are the fraction: raw counts 65536ths.
    Fixed,
    /// Two signed registers: tens in the first, thousandths in the second. Raw counts thousandths.
    TensAndThousandths,
    /// Unsigned, as long as the drive's answer. It can be read, but not written.
    AnyLength,
    /// Characters, as many as there are.
    Text,
    /// Bytes, as many as there are.
    Bytes,
}

impl Encoding {
    /// Returns whether raw values may be negative.
    #[must_use]
    pub const fn is_signed(self) -> bool {
        matches!(
            self,
            Self::I8
                | Self::I16
                | Self::I32
                | Self::I48
                | Self::I64
                | Self::I32LowFirst
                | Self::I48LowFirst
                | Self::I64LowFirst
                | Self::Fixed
                | Self::TensAndThousandths
        )
    }

    /// Returns whether it is a floating-point number.
    #[must_use]
    pub const fn is_real(self) -> bool {
        matches!(self, Self::F32 | Self::F64 | Self::F32LowFirst | Self::F64LowFirst)
    }

    /// Returns whether it is a number of at most 64 bits, and neither text nor bytes.
    #[must_use]
    pub const fn is_number(self) -> bool {
        !matches!(self, Self::Text | Self::Bytes)
    }

    /// The kind of its values in one word: `number`, `text` or `bytes`.
    #[must_use]
    pub const fn kind(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Bytes => "bytes",
            _ => "number",
        }
    }

    /// Returns whether the low word comes first, where a value takes several registers.
    #[must_use]
    pub const fn is_low_first(self) -> bool {
        matches!(
            self,
            Self::U32LowFirst
                | Self::I32LowFirst
                | Self::U48LowFirst
                | Self::I48LowFirst
                | Self::U64LowFirst
                | Self::I64LowFirst
                | Self::F32LowFirst
                | Self::F64LowFirst
        )
    }

    /// Bytes that a value takes; 0 where that is not fixed.
    #[must_use]
    pub const fn size(self) -> u8 {
        match self {
            Self::Bit | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32
            | Self::I32
            | Self::F32
            | Self::U32LowFirst
            | Self::I32LowFirst
            | Self::F32LowFirst
            | Self::Fixed
            | Self::TensAndThousandths => 4,
            Self::U48 | Self::I48 | Self::U48LowFirst | Self::I48LowFirst => 6,
            Self::U64
            | Self::I64
            | Self::F64
            | Self::U64LowFirst
            | Self::I64LowFirst
            | Self::F64LowFirst => 8,
            Self::AnyLength | Self::Text | Self::Bytes => 0,
        }
    }

    /// The least and the greatest raw value.
    #[must_use]
    pub const fn raw_range(self) -> (i64, i64) {
        match self {
            Self::Bit => (0, 1),
            // 32768 tens and less than ten more, in thousandths.
            Self::TensAndThousandths => (-327_689_999, 327_679_999),
            Self::F32 | Self::F32LowFirst => (f32::MIN.to_bits() as i64, f32::MAX.to_bits() as i64),
            Self::F64 | Self::F64LowFirst => {
                (f64::MIN.to_bits().cast_signed(), f64::MAX.to_bits().cast_signed())
            }
            Self::U64 | Self::U64LowFirst | Self::AnyLength | Self::Text | Self::Bytes => {
                (0, u64::MAX.cast_signed())
            }
            _ => {
                let bits = 8 * self.size() as u32;
                if self.is_signed() {
                    (i64::MIN >> (64 - bits), i64::MAX >> (64 - bits))
                } else {
                    (0, (u64::MAX >> (64 - bits)).cast_signed())
                }
            }
        }
    }

    /// Returns whether a raw value is between two others.
    #[must_use]
    pub fn is_between(self, raw: i64, min: i64, max: i64) -> bool {
        match self {
            Self::Text | Self::Bytes => true,
            _ if self.is_real() => {
                (self.number(min)..=self.number(max)).contains(&self.number(raw))
            }
            Self::U64 | Self::U64LowFirst | Self::AnyLength => {
                (min.cast_unsigned()..=max.cast_unsigned()).contains(&raw.cast_unsigned())
            }
            _ => (min..=max).contains(&raw),
        }
    }

    /// The number that a raw value is.
    #[inline]
    #[must_use]
    pub const fn number(self, raw: i64) -> f64 {
        match self {
            Self::F32 | Self::F32LowFirst => f32::from_bits(raw as u32) as f64,
            Self::F64 | Self::F64LowFirst => f64::from_bits(raw.cast_unsigned()),
            Self::U64 | Self::U64LowFirst | Self::AnyLength => raw.cast_unsigned() as f64,
            _ => raw as f64,
        }
    }

    /// The raw value of a number, rounded to the nearest; `None` where it has none, is too great to
    /// be exact, or is a fraction so small that a float makes zero of it.
    #[must_use]
    pub fn raw(self, number: f64) -> Option<i64> {
        // Beyond this a float no longer counts single steps.
        const EXACT_MAX: f64 = 9.0e15;
        match self {
            Self::F32 | Self::F32LowFirst => {
                let real = number as f32;
                let vanishes = real == 0.0 && number != 0.0;
                (real.is_finite() && !vanishes).then_some(real.to_bits().into())
            }
            Self::F64 | Self::F64LowFirst => {
                number.is_finite().then_some(number.to_bits().cast_signed())
            }
            _ => {
                let whole = libm::round(number);
                (whole.abs() < EXACT_MAX).then_some(whole as i64)
            }
        }
    }
}

#[cfg(test)]
mod tests;
