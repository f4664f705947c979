//! Load of a wire: bits over time, and the bit rate.

use polepair_core::medium::{Frame, bits};

use crate::batch::{CompactFrame, FrameTemplate};
use crate::decoder::DecodedFrame;
use crate::timestamp::Timestamp;

/// The peak is taken over windows of this length, ns.
pub const WINDOW_NS: u64 = 100_000_000;
/// Bit rates of CAN buses (CiA 301, table 1, and what adapters offer besides).
const RATES: [u32; 11] = [
    10_000, 20_000, 33_333, 50_000, 83_333, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000,
];
/// A start bit, eight, and a stop bit.
const BITS_PER_BYTE: u64 = 10;
/// Frames as close as a rate allows that make it believable, and the share of all that they are.
const CLOSE_MIN: u64 = 8;
const CLOSE_SHARE: u64 = 200;
/// The share of frames that may be closer than a rate allows: stamps are not exact.
const CLOSER_SHARE: u64 = 200;

/// Bits that passed on one link.
#[derive(Clone, Debug, Default)]
pub struct BusLoad {
    bits: u64,
    window: Option<(Timestamp, u64)>,
    peak: u64,
    last: Option<Timestamp>,
    frames: u64,
    /// For each rate: frames as close behind each other as it allows.
    at_rate: [u64; RATES.len()],
    /// Frames by how many rates, from the lowest on, do not allow them to be so close.
    lower_rates: [u64; RATES.len() + 1],
}

impl BusLoad {
    /// Adds a frame of `bits` bits.
    #[inline]
    pub(super) fn add_frame(&mut self, time: Option<Timestamp>, bits: u64, is_can: bool) {
        self.bits += bits;
        let Some(time) = time else { return };
        if is_can {
            self.compare_rates(time, bits);
        }
        let (since, sum) = self.window.get_or_insert((time, 0));
        if time.since(*since) >= WINDOW_NS {
            self.peak = self.peak.max(*sum);
            (*since, *sum) = (time, 0);
        }
        *sum += bits;
    }

    /// Compares the distance of a frame from the one before with the least at each rate.
    fn compare_rates(&mut self, time: Timestamp, bits: u64) {
        let Some(last) = self.last.replace(time) else { return };
        self.frames += 1;
        // A frame of this many bits ends `min` / rate ns after the one before it: both sides times the rate.
        let (gap, min) = (time.since(last).max(1) as f64, bits as f64 * 1e9);
        let (early, late) = (min * 0.96, min * 1.04);
        // The lower rates do not allow so small a gap; rates differ by more than the tolerance.
        let passed = RATES.map(|rate| gap * f64::from(rate));
        let lower = passed.into_iter().map(|passed| usize::from(passed < early)).sum::<usize>();
        self.lower_rates[lower] += 1;
        if let Some(passed) = passed.get(lower) {
            self.at_rate[lower] += u64::from(*passed < late);
        }
    }

    /// Frames that are closer behind each other than a rate allows.
    fn above_rate(&self, at: usize) -> u64 {
        self.lower_rates[at + 1..].iter().sum()
    }

    /// Estimated bit rate of a CAN bus, by the shortest distances of its frames; `None` if they do not show it.
    #[must_use]
    pub fn estimated_bit_rate(&self) -> Option<u32> {
        let at = (0..RATES.len()).find(|at| self.above_rate(*at) * CLOSER_SHARE <= self.frames)?;
        let enough = self.at_rate[at] >= CLOSE_MIN.max(self.frames / CLOSE_SHARE);
        enough.then_some(RATES[at])
    }

    /// All bits.
    #[must_use]
    pub const fn bits(&self) -> u64 {
        self.bits
    }

    /// Bits a second in the busiest window of a capture of that length, ns.
    #[must_use]
    pub fn peak_per_s(&self, length: u64) -> f64 {
        let open = self.window.map_or(0, |(_, sum)| sum);
        self.peak.max(open) as f64 * 1e9 / WINDOW_NS.min(length.max(1)) as f64
    }
}

/// Bits that a frame takes on its wire.
pub(super) fn frame_bits(event: &DecodedFrame<'_>) -> u64 {
    let Some(id) = event.id else { return event.bytes.len() as u64 * BITS_PER_BYTE };
    let DecodedFrame { bytes, extended, remote, .. } = *event;
    let mut data = [0; 8];
    // A longer frame is one of CAN FD, whose data go at a rate of their own: not counted.
    let len = bytes.len().min(data.len());
    data[..len].copy_from_slice(&bytes[..len]);
    let id = id & 0x1FFF_FFFF;
    bits::wire_bits(&Frame { id, extended, remote, len: len as u8, data }).into()
}

/// Bits of a compact frame.
pub(super) fn compact_bits(template: &FrameTemplate, frame: &CompactFrame) -> u64 {
    let FrameTemplate { id, len, .. } = *template;
    let Some(id) = id else { return u64::from(len) * BITS_PER_BYTE };
    let data = frame.data.to_le_bytes();
    bits::wire_bits(&Frame { id, extended: false, remote: false, len, data }).into()
}
