//! Simulates a receiver with another line setting than the sender.
//!
//! The sender's bits are sampled like in a receiver: it waits for a falling edge, samples the middle of
//! each bit of its own length, and restarts after the stop bit. A wrong baud rate therefore gives the same
//! garbage as on a real line.

use polepair_core::medium::{Parity, SerialLine};

/// Greatest difference of two baud rates, in per cent, that receivers put up with.
const TOLERANCE_PERCENT: u64 = 3;

/// True when a receiver set to `receiver` reads what a sender set to `sender` sends.
pub(crate) fn is_compatible(sender: SerialLine, receiver: SerialLine) -> bool {
    if sender == receiver || sender.baud == 0 || receiver.baud == 0 {
        return true;
    }
    let (a, b) = (u64::from(sender.baud), u64::from(receiver.baud));
    sender.data_bits == receiver.data_bits
        && sender.parity == receiver.parity
        && a.abs_diff(b) * 100 <= b * TOLERANCE_PERCENT
}

/// Appends the characters that `receiver` decodes from `bytes` of `sender` to the output. Returns whether a character
/// had a wrong stop bit or parity; such characters are dropped.
pub(crate) fn resample(
    bytes: &[u8],
    sender: SerialLine,
    receiver: SerialLine,
    received: &mut Vec<u8>,
) -> bool {
    let wave = Waveform { bytes, line: sender };
    let bit_ns = 1_000_000_000 / u64::from(receiver.baud.max(1));
    let end = wave.end_ns();
    let mut broken = false;
    let mut at = 0;
    while let Some(edge) = wave.falling_edge(at, end) {
        let mut character = 0;
        let bits = u64::from(receiver.bits_per_character());
        for bit in 0..bits {
            character |= u32::from(wave.level(edge + bit * bit_ns + bit_ns / 2)) << bit;
        }
        match decode_character(character, receiver) {
            Some(byte) => received.push(byte),
            None => broken = true,
        }
        at = edge + bits * bit_ns - bit_ns / 2;
    }
    broken
}

/// The byte in a sampled character, start bit lowest, or `None` if its frame is wrong.
fn decode_character(character: u32, line: SerialLine) -> Option<u8> {
    let data = (character >> 1) & ((1 << line.data_bits) - 1);
    let after = character >> (1 + line.data_bits);
    let (parity_right, stop) = match line.parity {
        Parity::None => (true, after & 1),
        Parity::Even => ((data.count_ones() + (after & 1)).is_multiple_of(2), (after >> 1) & 1),
        Parity::Odd => ((data.count_ones() + (after & 1)) % 2 == 1, (after >> 1) & 1),
    };
    (character & 1 == 0 && stop == 1 && parity_right).then_some(data as u8)
}

/// Characters as levels in time.
struct Waveform<'a> {
    bytes: &'a [u8],
    line: SerialLine,
}

impl Waveform<'_> {
    fn bit_ns(&self) -> u64 {
        1_000_000_000 / u64::from(self.line.baud.max(1))
    }

    fn end_ns(&self) -> u64 {
        self.bytes.len() as u64 * u64::from(self.line.bits_per_character()) * self.bit_ns()
    }

    /// The level at a time since the first start bit: true is idle.
    fn level(&self, ns: u64) -> bool {
        let bit = ns / self.bit_ns();
        let per_character = u64::from(self.line.bits_per_character());
        let Some(&byte) = self.bytes.get((bit / per_character) as usize) else { return true };
        let data_bits = u64::from(self.line.data_bits);
        match bit % per_character {
            0 => false,
            n if n <= data_bits => byte >> (n - 1) & 1 == 1,
            n if n == data_bits + 1 && self.line.parity != Parity::None => {
                let is_odd = byte.count_ones() % 2 == 1;
                is_odd == (self.line.parity == Parity::Even)
            }
            _ => true,
        }
    }

    /// The first falling edge at or after `from`, to the resolution of a sender's bit.
    fn falling_edge(&self, from: u64, end: u64) -> Option<u64> {
        let bit = self.bit_ns();
        let mut before = from == 0 || self.level(from);
        let mut at = if from.is_multiple_of(bit) { from } else { from - from % bit + bit };
        while at < end {
            let level = self.level(at + bit / 2);
            if before && !level {
                return Some(at);
            }
            before = level;
            at += bit;
        }
        None
    }
}
