//! A CAN bus: the lowest identifier wins, and every frame takes exactly its bits.

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

/// Bits between two frames, and bits after the CRC that are never stuffed: CRC delimiter, ACK slot
/// and delimiter, end of frame.
const INTERFRAME_BITS: u32 = 3;
const TAIL_BITS: u32 = 10;

/// A CAN bus with its nodes' frames waiting.
#[derive(Debug)]
pub(crate) struct CanBus {
    pub(crate) line: CanLine,
    /// One frame per plug that waits for the bus.
    waiting: Vec<Option<Frame>>,
    sending: Option<usize>,
    pub(crate) down: bool,
}

impl CanBus {
    pub(crate) const fn new(line: CanLine) -> Self {
        Self { line, waiting: Vec::new(), sending: None, down: false }
    }

    pub(crate) fn plug(&mut self) -> usize {
        self.waiting.push(None);
        self.waiting.len() - 1
    }

    /// Whether a plug's controller can take a frame.
    pub(crate) fn has_room(&self, plug: usize) -> bool {
        self.waiting[plug].is_none()
    }

    pub(crate) fn offer(&mut self, plug: usize, frame: Frame) {
        self.waiting[plug] = Some(frame);
    }

    /// Starts the next frame if the bus is idle. Returns when it will have ended.
    pub(crate) fn start(&mut self, now: Instant) -> Option<Instant> {
        if self.sending.is_some() {
            return None;
        }
        let ready = self.waiting.iter().enumerate().filter_map(|(at, w)| w.map(|f| (f, at)));
        let (frame, plug) = ready.min_by_key(|(frame, at)| (arbitration(frame), *at))?;
        self.sending = Some(plug);
        let bits = u64::from(bits_on_wire(&frame));
        Some(now.plus_ns(bits * 1_000_000_000 / u64::from(self.line.bit_rate.max(1))))
    }

    /// The frame that has just ended, and who sent it.
    pub(crate) fn finish(&mut self) -> Option<(usize, Frame)> {
        let plug = self.sending.take()?;
        self.waiting[plug].take().map(|frame| (plug, frame))
    }
}

/// The arbitration field as a number: lower wins. A standard frame beats an extended one with the
/// same leading bits, a data frame beats a remote one.
fn arbitration(frame: &Frame) -> u64 {
    let remote = u64::from(frame.remote);
    if frame.extended {
        let (base, rest) = (u64::from(frame.id >> 18), u64::from(frame.id & 0x3_FFFF));
        base << 21 | 0b11 << 19 | rest << 1 | remote
    } else {
        u64::from(frame.id) << 21 | remote << 20
    }
}

/// Bits from start of frame to the end of the interframe space, stuff bits counted (ISO 11898-1).
pub(crate) fn bits_on_wire(frame: &Frame) -> u32 {
    let mut bits = Bits::default();
    bits.put(0, 1);
    if frame.extended {
        bits.put(frame.id >> 18, 11);
        bits.put(0b11, 2);
        bits.put(frame.id & 0x3_FFFF, 18);
        bits.put(u32::from(frame.remote), 1);
        bits.put(0, 2);
    } else {
        bits.put(frame.id, 11);
        bits.put(u32::from(frame.remote), 1);
        bits.put(0, 2);
    }
    bits.put(u32::from(frame.len), 4);
    if !frame.remote {
        frame.bytes().iter().for_each(|&byte| bits.put(u32::from(byte), 8));
    }
    bits.put(u32::from(bits.crc), 15);
    bits.count + TAIL_BITS + INTERFRAME_BITS
}

/// Counts bits as they are stuffed, and keeps the CRC.
#[derive(Default)]
struct Bits {
    count: u32,
    run: u32,
    last: Option<bool>,
    crc: u16,
}

impl Bits {
    fn put(&mut self, value: u32, width: u32) {
        for at in (0..width).rev() {
            self.put_bit(value >> at & 1 == 1);
        }
    }

    fn put_bit(&mut self, bit: bool) {
        let next = bit != (self.crc >> 14 & 1 == 1);
        self.crc = (self.crc << 1 & 0x7FFF) ^ if next { 0x4599 } else { 0 };
        self.count += 1;
        self.run = if self.last == Some(bit) { self.run + 1 } else { 1 };
        self.last = Some(bit);
        if self.run == 5 {
            self.count += 1;
            self.run = 1;
            self.last = Some(!bit);
        }
    }
}
