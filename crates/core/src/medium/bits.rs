//! A frame on the wire bit by bit (ISO 11898-1): arbitration, the first difference of two frames, duration.

use super::Frame;

/// Bits between two frames.
pub const INTERFRAME_BITS: u32 = 3;
/// Bits after the CRC, which are never stuffed: CRC delimiter, ACK slot and delimiter, end of frame.
const TAIL_BITS: u32 = 10;

/// The arbitration field as a number: lower wins. A standard frame beats an extended one with the
/// same leading bits, a data frame beats a remote one.
#[must_use]
pub fn arbitration_key(frame: &Frame) -> u64 {
    let remote = u64::from(frame.remote);
    if frame.extended {
        let (base, rest) = (u64::from(frame.id >> 18), u64::from(frame.id & 0x3_FFFF));
        base << 21 | 0b11 << 19 | rest << 1 | remote
    } else {
        u64::from(frame.id) << 21 | remote << 20
    }
}

/// Bits from start of frame to the end of the interframe space, stuff bits counted (ISO 11898-1).
#[must_use]
pub fn wire_bits(frame: &Frame) -> u32 {
    let (bits, count) = bits_with_crc(frame);
    stuffed_len(bits, count) + TAIL_BITS + INTERFRAME_BITS
}

/// Bits that a data frame of so many bytes takes without a single stuff bit, the interframe space
/// counted.
#[must_use]
pub const fn unstuffed_bits(extended: bool, bytes: u32) -> u32 {
    bits_before_crc(extended, bytes) + CRC_BITS + TAIL_BITS + INTERFRAME_BITS
}

/// The same with as many stuff bits as there can be: one behind the first five bits, and one behind
/// each four from then on.
#[must_use]
pub const fn max_wire_bits(extended: bool, bytes: u32) -> u32 {
    unstuffed_bits(extended, bytes) + (bits_before_crc(extended, bytes) + CRC_BITS - 1) / 4
}

const CRC_BITS: u32 = 15;

/// Bits of a data frame before its CRC: start, identifier, RTR, IDE, reserved bits and length, then
/// the data; with 29 bits of identifier SRR and the second half of it besides.
const fn bits_before_crc(extended: bool, bytes: u32) -> u32 {
    let head = if extended { 39 } else { 19 };
    head + 8 * bytes
}

/// Bits from start of frame to the first in which two frames differ.
#[must_use]
pub fn bits_until_difference(one: &Frame, other: &Frame) -> u32 {
    let ((one, len), (other, _)) = (bits_with_crc(one), bits_with_crc(other));
    let same = (one ^ other).leading_zeros();
    stuffed_len(one, len.min(same + 1))
}

/// Length of the first `count` of `bits` with stuff bits: one opposite bit after five equal ones. Each
/// bit is first compared with the one before it; four agreements in a row are five equal bits, and the
/// inserted bit inverts the value that the next bit is compared with.
fn stuffed_len(bits: u128, count: u32) -> u32 {
    let mut same = !(bits ^ bits >> 1) & u128::MAX >> 1;
    let mut total = count;
    loop {
        let fifth = (same & same >> 1 & same >> 2 & same >> 3).leading_zeros();
        if fifth >= count {
            return total;
        }
        total += 1;
        same = (same << fifth << 1 ^ 1 << 127) >> fifth >> 1;
    }
}

/// The bits of a frame from its start to its CRC, the first on top, and how many there are.
fn bits_with_crc(frame: &Frame) -> (u128, u32) {
    let bytes = if frame.remote { 0 } else { frame.bytes().len() as u32 };
    let data = u64::from_be_bytes(frame.data).unbounded_shr(64 - 8 * bytes);
    let tail = u64::from(frame.remote) << 6 | u64::from(frame.len & 0xF);
    let head = if frame.extended {
        let (base, rest) = (u64::from(frame.id >> 18 & 0x7FF), u64::from(frame.id & 0x3_FFFF));
        base << 27 | 0b11 << 25 | rest << 7 | tail
    } else {
        u64::from(frame.id & 0x7FF) << 7 | tail
    };
    let count = bits_before_crc(frame.extended, bytes);
    let bits = u128::from(head) << (8 * bytes) | u128::from(data);
    let bits = bits << CRC_BITS | u128::from(crc15(bits, count));
    (bits << (128 - count - CRC_BITS), count + CRC_BITS)
}

/// The CRC-15 of the last `count` of `bits`.
fn crc15(bits: u128, count: u32) -> u16 {
    let bytes = bits.to_be_bytes();
    let step = |crc: u16, byte: &u8| crc << 8 ^ CRC_TABLE[usize::from((crc >> 7) as u8 ^ byte)];
    // Leading zeros do not count.
    bytes[16 - count.div_ceil(8) as usize..].iter().fold(0, step) & 0x7FFF
}

/// What a byte makes of the CRC.
static CRC_TABLE: [u16; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut crc, mut bit) = ((byte as u16) << 7, 0);
        while bit < 8 {
            crc = crc << 1 ^ if crc & 0x4000 == 0 { 0 } else { 0x4599 };
            bit += 1;
        }
        table[byte] = crc & 0x7FFF;
        byte += 1;
    }
    table
};
