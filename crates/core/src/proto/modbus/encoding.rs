//! Encodings of parameter values in registers.

use crate::convert::tail;
use crate::explain::{ByteOrder, NumberPlace};
use crate::profile::Encoding;

/// Registers that a number takes at most.
pub const REGISTERS_MAX: usize = 4;

/// Registers that an encoding takes; 0 for text and bytes.
#[must_use]
pub const fn register_count(encoding: Encoding) -> u16 {
    (encoding.size() as u16).div_ceil(2)
}

/// The raw value in registers, in the order of their addresses. Those that the encoding does not take
/// do not count.
#[must_use]
pub const fn decode(encoding: Encoding, words: [u16; REGISTERS_MAX]) -> i64 {
    let [first, second, third, fourth] = words;
    let bits = match (register_count(encoding), encoding.is_low_first()) {
        (0 | 1, _) => first as u64,
        (2, false) => join([0, 0, first, second]),
        (2, true) => join([0, 0, second, first]),
        (3, false) => join([0, first, second, third]),
        (3, true) => join([0, third, second, first]),
        (_, false) => join(words),
        (_, true) => join([fourth, third, second, first]),
    };
    match encoding {
        Encoding::Bit => (first != 0) as i64,
        // TS manual V2 §2.6: tens and above in the first register, the ones digit and three
        // decimals in the second; both signed [I].
        Encoding::TensAndThousandths => first as i16 as i64 * 10_000 + second as i16 as i64,
        _ if encoding.is_signed() => {
            let unused = 64 - 8 * encoding.size() as u32;
            (bits << unused).cast_signed() >> unused
        }
        Encoding::U8 => first as u8 as i64,
        _ => bits.cast_signed(),
    }
}

/// The place of a value in a frame whose registers are bytes, the value's first one at byte `start`; `None` where it is
/// more than a number.
#[must_use]
pub fn number_place(
    encoding: Encoding,
    start: usize,
    named: &'static [(i64, &'static str)],
) -> Option<NumberPlace> {
    let (len, order) = match encoding {
        Encoding::U16 | Encoding::I16 => (2, ByteOrder::HighFirst),
        Encoding::U32 | Encoding::I32 => (4, ByteOrder::HighFirst),
        Encoding::U32LowFirst | Encoding::I32LowFirst => (4, ByteOrder::LowWordFirst),
        _ => return None,
    };
    let start = u8::try_from(start).ok()?;
    Some(NumberPlace { start, len, order, is_signed: encoding.is_signed(), named })
}

/// The registers of a raw value, in the order of their addresses; `None` when it does not fit.
#[must_use]
pub fn encode(encoding: Encoding, raw: i64) -> Option<[u16; REGISTERS_MAX]> {
    let (min, max) = encoding.raw_range();
    if register_count(encoding) == 0 || !encoding.is_between(raw, min, max) {
        return None;
    }
    let [w3, w2, w1, w0] = [48, 32, 16, 0].map(|shift| (raw >> shift) as u16);
    Some(match (register_count(encoding), encoding.is_low_first()) {
        (1, _) => [w0, 0, 0, 0],
        _ if encoding == Encoding::TensAndThousandths => {
            [(raw / 10_000) as u16, (raw % 10_000) as u16, 0, 0]
        }
        (2, false) => [w1, w0, 0, 0],
        (2, true) => [w0, w1, 0, 0],
        (3, false) => [w2, w1, w0, 0],
        (3, true) => [w0, w1, w2, 0],
        (_, false) => [w3, w2, w1, w0],
        (_, true) => [w0, w1, w2, w3],
    })
}

/// The registers of an answer's data from the `at`-th on; 0 for those beyond its end.
#[must_use]
pub fn words_from(data: &[u8], at: usize) -> [u16; REGISTERS_MAX] {
    let (pairs, _) = data.as_chunks::<2>();
    let mut words = [0; REGISTERS_MAX];
    let its = tail(pairs, at);
    words.iter_mut().zip(its).for_each(|(word, pair)| *word = u16::from_be_bytes(*pair));
    words
}

/// The bits of words, the high one first.
const fn join([w3, w2, w1, w0]: [u16; REGISTERS_MAX]) -> u64 {
    (w3 as u64) << 48 | (w2 as u64) << 32 | (w1 as u64) << 16 | w0 as u64
}
