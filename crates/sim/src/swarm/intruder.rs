//! An intruder on a CAN bus: keeps it busy, or sends frames of other senders.

use std::collections::VecDeque;

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

use crate::random::{Ppm, Random};

/// An identifier that wins against all others and belongs to no protocol: 29 bits, of which TML has bit 10 zero.
const LOWEST_ID: u32 = 0x400;
/// Frames of others that are remembered.
const RECENT_MAX: usize = 16;
/// Shortest interval between two frames with another sender's identifier, ms.
const FORGE_MS: i64 = 80;

/// Action of an intruder.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum IntruderAction {
    /// Talks without a pause, before everybody else: a babbling node (F9).
    Babble,
    /// Sends a frame in every such interval, µs, before all others (F9).
    Load(u32),
    /// Sends frames with others' identifiers (F25).
    Forge,
}

/// An intruder that is active from one instant to another.
#[derive(Debug)]
pub struct Intruder {
    action: IntruderAction,
    until: Instant,
    next: Instant,
    recent_frames: VecDeque<Frame>,
    random: Random,
    bit_rate: u32,
}

impl Intruder {
    pub fn new(
        action: IntruderAction,
        span: (Instant, Instant),
        bit_rate: u32,
        random: Random,
    ) -> Self {
        let (from, until) = span;

        Self { action, until, next: from, recent_frames: VecDeque::new(), random, bit_rate }
    }

    /// A frame with the identifier of a recent sender: noise, or nearly its content.
    fn forge_frame(&mut self) -> Option<Frame> {
        let at = self.random.below(self.recent_frames.len() as u64) as usize;
        let mut frame = *self.recent_frames.get(at)?;
        if self.random.chance(Ppm(500_000)) {
            let byte = self.random.below(frame.len.into()) as usize;
            frame.data[byte] = self.random.next_byte();
            return Some(frame);
        }
        frame.len = self.random.between(0, 8) as u8;
        frame.data = [0; 8];
        let len = usize::from(frame.len);
        frame.data[..len].fill_with(|| self.random.next_byte());
        Some(frame)
    }
}

impl Timed for Intruder {
    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.until {
            self.next = Instant::FAR_FUTURE;
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        (self.next < self.until).then_some(self.next)
    }
}

impl Station<Can> for Intruder {
    fn handle_input(&mut self, _: Instant, frame: &Frame) {
        if self.action == IntruderAction::Forge && frame.len > 0 {
            self.recent_frames.truncate(RECENT_MAX - 1);
            self.recent_frames.push_front(*frame);
        }
    }

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        if now < self.next || now >= self.until {
            return None;
        }
        let noise = self.random.next_u64().to_le_bytes();
        let foremost = Frame { id: LOWEST_ID, extended: true, remote: false, len: 8, data: noise };
        *out = match self.action {
            IntruderAction::Babble => foremost,
            IntruderAction::Load(every_us) => {
                self.next = now.plus_ns(u64::from(every_us) * 1_000);
                foremost
            }
            IntruderAction::Forge => {
                self.next = now.plus_ms(self.random.between(1, FORGE_MS) as u32);
                self.forge_frame()?
            }
        };
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}
