//! A frame on the wire bit by bit (ISO 11898-1): arbitration, the first difference of two frames, duration.

use super::Frame;

/// Time of a number of bits, ns; 0 where the bit rate is not known, as on a virtual bus.
#[must_use]
pub fn bit_time_ns(bits: u64, bit_rate: u32) -> u64 {
    (bits * 1_000_000_000).checked_div(bit_rate.into()).unwrap_or(0)
}

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

/// Bits of a data frame of `bytes` bytes without a single stuff bit, with the interframe space.
#[must_use]
pub const fn unstuffed_bits(extended: bool, bytes: u32) -> u32 {
    bits_before_crc(extended, bytes) + CRC_BITS + TAIL_BITS + INTERFRAME_BITS
}

/// Bits of a data frame with as many stuff bits as possible: one behind the first five bits, and one behind each four
/// from then on.
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
    let ((one, len), (other, other_len)) = (bits_with_crc(one), bits_with_crc(other));
    let same = (one << (128 - len)) ^ (other << (128 - other_len));
    let count = len.min(same.leading_zeros() + 1);
    stuffed_len(one >> (len - count), count)
}

/// Length of the last `count` of `bits` with stuff bits: one opposite bit after five equal ones. The bits
/// begin with a dominant one.
fn stuffed_len(bits: u128, count: u32) -> u32 {
    /// Bits of which no two neighbours are equal, the last recessive: in front of the frame, they add
    /// nothing.
    const ALTERNATING: u128 = u128::MAX / 3;
    let bytes = (bits | ALTERNATING.unbounded_shl(count)).to_be_bytes();
    let (mut run, mut total) = (RECESSIVE, count);
    for byte in &bytes[16 - count.div_ceil(8) as usize..] {
        let step = STUFFING[usize::from(run & 7)][usize::from(*byte)];
        total += u32::from(step >> 3);
        run = step;
    }
    total
}

/// One recessive bit behind a dominant one, as a row of [`STUFFING`].
const RECESSIVE: u8 = 4;

/// Effect of a byte: the row for the next byte in the lowest three bits, and stuff bits in those above. A row is the
/// value of the last bit (4 if recessive) and the number of equal ones before it.
static STUFFING: [[u8; 256]; 8] = {
    let mut table = [[0; 256]; 8];
    let mut entry = 0;
    while entry < 8 * 256 {
        let (row, byte) = (entry / 256, entry % 256);
        let (mut level, mut equal, mut stuffed) = (row / 4, row % 4, 0);
        let mut bit = 8;
        while bit > 0 {
            bit -= 1;
            let next = byte >> bit & 1;
            equal = if next == level { equal + 1 } else { 0 };
            level = next;
            if equal == 4 {
                (level, equal, stuffed) = (1 - level, 0, stuffed + 1);
            }
        }
        table[row][byte] = (stuffed << 3 | level << 2 | equal) as u8;
        entry += 1;
    }
    table
};

/// The bits of a frame from its start to its CRC, the last lowest, and how many there are.
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
    (bits << CRC_BITS | u128::from(crc15(bits, count)), count + CRC_BITS)
}

/// The CRC-15 of the last `count` of `bits`; leading zeros do not count.
fn crc15(bits: u128, count: u32) -> u16 {
    let bytes = bits.to_le_bytes();
    let shares = bytes.iter().zip(&CRC_SHARES).take(count.div_ceil(8) as usize);
    shares.fold(0, |crc, (byte, share)| crc ^ share[usize::from(*byte)])
}

/// Contribution of a byte to the CRC, by the number of bytes behind it.
static CRC_SHARES: [[u16; 256]; 16] = {
    let mut shares = [[0; 256]; 16];
    let mut entry = 0;
    while entry < 16 * 256 {
        let (behind, byte) = (entry / 256, entry % 256);
        let (mut crc, mut bit) =
            if behind == 0 { ((byte as u16) << 7, 0) } else { (shares[behind - 1][byte], 0) };
        while bit < 8 {
            crc = crc << 1 ^ if crc & 0x4000 == 0 { 0 } else { 0x4599 };
            bit += 1;
        }
        shares[behind][byte] = crc & 0x7FFF;
        entry += 1;
    }
    shares
};
