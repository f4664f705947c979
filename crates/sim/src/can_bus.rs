//! A CAN bus: the lowest identifier wins, and every frame takes exactly its bits.
//!
//! Each plug is a controller with one frame waiting and the transmit error counter of ISO 11898-1.
//! Two controllers that send the same identifier at once differ later, in a bit that one of them
//! finds overwritten: both fail, and as both try again, both end bus-off. Frames alike in every bit
//! are one frame to everybody.

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

use crate::random::{Ppm, Random};

#[cfg(test)]
mod tests;

/// Bits between two frames, and bits after the CRC that are never stuffed: CRC delimiter, ACK slot
/// and delimiter, end of frame.
const INTERFRAME_BITS: u32 = 3;
const TAIL_BITS: u32 = 10;
/// An error flag with those of the others behind it, and its delimiter.
const ERROR_BITS: u32 = 12 + 8;
/// What a failed transmission adds to the transmit error counter, and beyond what it is bus-off.
const ERROR_WEIGHT: u16 = 8;
const ERRORS_MAX: u16 = 255;
/// Recessive bits that a controller waits before it takes part again.
const RECOVERY_BITS: u64 = 128 * 11;

/// Faults of a CAN bus, as chances per frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanFaults {
    /// A disturbed bit: an error frame ends it, and its sender repeats it by itself.
    pub error: Ppm,
    /// Disturbed in its last bit, which its sender alone notices: receivers take it, it is
    /// repeated, and they take it again.
    pub twice: Ppm,
    /// A receiver's controller or adapter drops it.
    pub lose: Ppm,
}

/// How many faults were made on a CAN bus, by kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanMade {
    /// Frames ended by an error frame.
    pub errors: u64,
    /// Frames that met another of their own identifier.
    pub collided: u64,
    /// Frames taken twice.
    pub twice: u64,
    /// Frames that one receiver did not get.
    pub lost: u64,
    /// Controllers that went bus-off.
    pub off: u64,
}

/// A CAN bus with its nodes' frames waiting.
#[derive(Debug)]
pub(crate) struct CanBus {
    pub(crate) line: CanLine,
    pub(crate) faults: CanFaults,
    pub(crate) made: CanMade,
    pub(crate) down: bool,
    random: Random,
    plugs: Vec<Plug>,
    sending: Option<Sending>,
    /// An appointment to start is made: until then whoever has something to say joins in.
    starting: bool,
    /// Bits that were on the wire so far.
    busy_bits: u64,
}

/// One controller.
#[derive(Clone, Copy, Debug, Default)]
struct Plug {
    waiting: Option<Frame>,
    sending: bool,
    errors: u16,
    off: bool,
}

/// What is on the wire.
#[derive(Clone, Copy, Debug)]
struct Sending {
    frame: Frame,
    end: End,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum End {
    Good,
    Twice,
    Destroyed,
}

impl CanBus {
    pub(crate) fn new(line: CanLine, random: Random) -> Self {
        Self {
            line,
            faults: CanFaults::default(),
            made: CanMade::default(),
            down: false,
            random,
            plugs: Vec::new(),
            sending: None,
            starting: false,
            busy_bits: 0,
        }
    }

    pub(crate) fn plug(&mut self) -> usize {
        self.plugs.push(Plug::default());
        self.plugs.len() - 1
    }

    /// Whether a plug's controller can take a frame.
    pub(crate) fn has_room(&self, plug: usize) -> bool {
        self.plugs[plug].waiting.is_none() && !self.plugs[plug].off
    }

    /// Puts a frame into a plug's controller. Returns whether to [`start`](Self::start) is now to
    /// be arranged for, at the end of this instant: what is ready by then arbitrates.
    pub(crate) fn offer(&mut self, plug: usize, frame: Frame) -> bool {
        self.plugs[plug].waiting = Some(frame);
        let arrange = !self.starting && self.sending.is_none();
        self.starting |= arrange;
        arrange
    }

    /// Starts the frame that wins. Returns when it will have ended.
    pub(crate) fn start(&mut self, now: Instant) -> Option<Instant> {
        self.starting = false;
        let frame = self.plugs.iter().filter_map(|plug| plug.waiting).min_by_key(arbitration)?;
        let (mut bits, mut end) = (bits_on_wire(&frame), End::Good);
        for plug in &mut self.plugs {
            let rival = plug.waiting.filter(|other| arbitration(other) == arbitration(&frame));
            plug.sending = rival.is_some();
            if let Some(rival) = rival.filter(|rival| *rival != frame) {
                end = End::Destroyed;
                bits = bits.min(until_they_differ(&frame, &rival) + ERROR_BITS + INTERFRAME_BITS);
            }
        }
        if end == End::Destroyed {
            self.made.collided += 1;
        } else if self.random.chance(self.faults.error) {
            end = End::Destroyed;
            bits = 1 + self.random.below(bits.into()) as u32 + ERROR_BITS + INTERFRAME_BITS;
        } else if self.random.chance(self.faults.twice) {
            (end, bits) = (End::Twice, bits + ERROR_BITS);
        }
        self.sending = Some(Sending { frame, end });
        self.busy_bits += u64::from(bits);
        Some(now.plus_ns(self.bits_ns(bits.into())))
    }

    /// Ends what is on the wire: the frame if it arrived. When all have heard it,
    /// [`start`](Self::start) the next.
    pub(crate) fn finish(&mut self) -> Option<Frame> {
        let Sending { frame, end } = self.sending.take()?;
        self.starting = true;
        let senders = self.plugs.iter_mut().filter(|plug| plug.sending);
        for plug in senders {
            match end {
                End::Good => (plug.waiting, plug.errors) = (None, plug.errors.saturating_sub(1)),
                End::Twice | End::Destroyed => plug.errors += ERROR_WEIGHT,
            }
        }
        match end {
            End::Good => {}
            End::Twice => self.made.twice += 1,
            End::Destroyed => self.made.errors += 1,
        }
        (end != End::Destroyed).then_some(frame)
    }

    /// Whether a plug hears the frame that has just ended.
    pub(crate) fn hears(&mut self, plug: usize) -> bool {
        if self.down || self.plugs[plug].sending || self.plugs[plug].off {
            return false;
        }
        let lost = self.random.chance(self.faults.lose);
        self.made.lost += u64::from(lost);
        !lost
    }

    /// Takes the next plug off the bus whose errors are too many.
    pub(crate) fn next_off(&mut self) -> Option<usize> {
        let plug = self.plugs.iter().position(|plug| plug.errors > ERRORS_MAX)?;
        self.switch_off(plug);
        Some(plug)
    }

    pub(crate) fn switch_off(&mut self, plug: usize) {
        self.plugs[plug] = Plug { off: true, ..Plug::default() };
        self.made.off += 1;
    }

    /// How long a controller stays away after it went bus-off.
    pub(crate) fn recovery_ns(&self) -> u64 {
        self.bits_ns(RECOVERY_BITS)
    }

    pub(crate) fn switch_on(&mut self, plug: usize) {
        self.plugs[plug].off = false;
    }

    /// How much of `now` the bus was busy, 0 to 1.
    pub(crate) fn load(&self, now: Instant) -> f64 {
        let busy = self.bits_ns(self.busy_bits) as f64;
        if now == Instant::ZERO { 0.0 } else { busy / now.0 as f64 }
    }

    /// Nanoseconds that so many bits take; 0 on a bus without bit timing.
    fn bits_ns(&self, bits: u64) -> u64 {
        (bits * 1_000_000_000).checked_div(self.line.bit_rate.into()).unwrap_or(0)
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
    let (bits, count) = Bits::of(frame);
    stuffed(bits, count) + TAIL_BITS + INTERFRAME_BITS
}

/// Bits from start of frame to the first in which two frames differ.
fn until_they_differ(one: &Frame, other: &Frame) -> u32 {
    let ((one, len), (other, _)) = (Bits::of(one), Bits::of(other));
    let same = (one ^ other).leading_zeros();
    stuffed(one, len.min(same + 1))
}

/// How many bits the first `count` of `bits` take when a bit of the other kind follows each five
/// alike. Each bit is first compared with the one before it; four agreements in a row are five
/// alike, and the bit stuffed in turns round what the next one is compared with.
fn stuffed(bits: u128, count: u32) -> u32 {
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

/// The bits of a frame from its start to its CRC.
#[derive(Default)]
struct Bits {
    bits: u128,
    count: u32,
}

impl Bits {
    /// The first bit on top, and how many there are.
    fn of(frame: &Frame) -> (u128, u32) {
        let mut bits = Self::default();
        bits.put(0, 1);
        if frame.extended {
            bits.put(frame.id >> 18, 11);
            bits.put(0b11, 2);
            bits.put(frame.id, 18);
        } else {
            bits.put(frame.id, 11);
        }
        bits.put(u32::from(frame.remote), 1);
        bits.put(0, 2);
        bits.put(u32::from(frame.len), 4);
        if !frame.remote {
            frame.bytes().iter().for_each(|&byte| bits.put(u32::from(byte), 8));
        }
        bits.put(crc(bits.bits).into(), 15);
        (bits.bits << (128 - bits.count), bits.count)
    }

    fn put(&mut self, value: u32, width: u32) {
        self.bits = self.bits << width | u128::from(value & ((1 << width) - 1));
        self.count += width;
    }
}

/// The CRC-15 of `bits`, whose leading zeros do not count.
fn crc(bits: u128) -> u16 {
    let bytes = bits.to_be_bytes();
    let step = |crc: u16, byte: &u8| crc << 8 ^ CRC[usize::from((crc >> 7) as u8 ^ byte)];
    bytes.iter().fold(0, step) & 0x7FFF
}

/// What a byte makes of the CRC.
static CRC: [u16; 256] = {
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
