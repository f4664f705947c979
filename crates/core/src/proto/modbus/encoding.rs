//! How a parameter's value lies in registers.

use crate::profile::Encoding;

/// Registers that an encoding takes.
#[must_use]
pub const fn register_count(encoding: Encoding) -> u16 {
    match encoding {
        Encoding::Bit | Encoding::U8 | Encoding::I8 | Encoding::U16 | Encoding::I16 => 1,
        Encoding::U32
        | Encoding::I32
        | Encoding::I32LowFirst
        | Encoding::Fixed
        | Encoding::TensAndThousandths => 2,
    }
}

/// The raw value in one or two registers, in the order of their addresses.
#[must_use]
pub const fn decode(encoding: Encoding, words: [u16; 2]) -> i64 {
    let [first, second] = words;
    let (high, low) = (first as i64, second as i64);
    match encoding {
        Encoding::Bit => (first != 0) as i64,
        Encoding::U8 => first as u8 as i64,
        Encoding::I8 => first as i8 as i64,
        Encoding::U16 => high,
        Encoding::I16 => first as i16 as i64,
        Encoding::U32 => high << 16 | low,
        Encoding::I32 | Encoding::Fixed => (high << 16 | low) as i32 as i64,
        Encoding::I32LowFirst => (low << 16 | high) as i32 as i64,
        // TS manual V2 §2.6: tens and above in the first register, the ones digit and three
        // decimals in the second; both signed [I].
        Encoding::TensAndThousandths => first as i16 as i64 * 10_000 + second as i16 as i64,
    }
}

/// The registers of a raw value, in the order of their addresses; `None` when it does not fit.
#[must_use]
pub const fn encode(encoding: Encoding, raw: i64) -> Option<[u16; 2]> {
    let (min, max) = match encoding {
        Encoding::Bit => (0, 1),
        Encoding::U8 => (0, 0xFF),
        Encoding::I8 => (i8::MIN as i64, i8::MAX as i64),
        Encoding::U16 => (0, 0xFFFF),
        Encoding::I16 => (i16::MIN as i64, i16::MAX as i64),
        Encoding::U32 => (0, u32::MAX as i64),
        Encoding::I32 | Encoding::I32LowFirst | Encoding::Fixed => {
            (i32::MIN as i64, i32::MAX as i64)
        }
        Encoding::TensAndThousandths => (-327_689_999, 327_679_999),
    };
    if raw < min || raw > max {
        return None;
    }
    let (high, low) = ((raw >> 16) as u16, raw as u16);
    Some(match encoding {
        Encoding::Bit | Encoding::U8 | Encoding::I8 | Encoding::U16 | Encoding::I16 => [low, 0],
        Encoding::U32 | Encoding::I32 | Encoding::Fixed => [high, low],
        Encoding::I32LowFirst => [low, high],
        Encoding::TensAndThousandths => [(raw / 10_000) as u16, (raw % 10_000) as u16],
    })
}
