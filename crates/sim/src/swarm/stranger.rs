//! Somebody on a CAN bus who belongs to nobody: keeps it busy, or speaks in others' names.

use std::collections::VecDeque;

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

use crate::random::{Ppm, Random};

/// An identifier that wins against all others and is nobody's: 29 bits, of which TML has bit 10 zero.
const FOREMOST: u32 = 0x400;
/// Frames of others that are remembered.
const HEARD_MAX: usize = 16;
/// A frame in another's name comes every so many ms at most.
const FORGE_MS: i64 = 80;

/// What a stranger does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Deed {
    /// Talks without a pause, before everybody else: a babbling node (F9).
    Babble,
    /// Takes a frame's place every so many µs, before everybody else (F9).
    Load(u32),
    /// Sends frames with others' identifiers (F25).
    Forge,
}

/// Somebody who does a deed from one instant to another.
#[derive(Debug)]
pub struct Stranger {
    deed: Deed,
    until: Instant,
    next: Instant,
    heard: VecDeque<Frame>,
    random: Random,
    bit_rate: u32,
}

impl Stranger {
    pub fn new(
        deed: Deed,
        (from, until): (Instant, Instant),
        bit_rate: u32,
        random: Random,
    ) -> Self {
        Self { deed, until, next: from, heard: VecDeque::new(), random, bit_rate }
    }

    /// A frame in the name of somebody who spoke a moment ago: noise, or nearly what he said.
    fn forge(&mut self) -> Option<Frame> {
        let at = self.random.below(self.heard.len() as u64) as usize;
        let mut frame = *self.heard.get(at)?;
        if self.random.chance(Ppm(500_000)) {
            let byte = self.random.below(frame.len.into()) as usize;
            frame.data[byte] = self.random.byte();
            return Some(frame);
        }
        frame.len = self.random.between(0, 8) as u8;
        frame.data = [0; 8];
        let len = usize::from(frame.len);
        frame.data[..len].fill_with(|| self.random.byte());
        Some(frame)
    }
}

impl Timed for Stranger {
    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.until {
            self.next = Instant::FAR;
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        (self.next < self.until).then_some(self.next)
    }
}

impl Station<Can> for Stranger {
    fn handle_input(&mut self, _: Instant, frame: &Frame) {
        if self.deed == Deed::Forge && frame.len > 0 {
            self.heard.truncate(HEARD_MAX - 1);
            self.heard.push_front(*frame);
        }
    }

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        if now < self.next || now >= self.until {
            return None;
        }
        let noise = self.random.word().to_le_bytes();
        let foremost = Frame { id: FOREMOST, extended: true, remote: false, len: 8, data: noise };
        *out = match self.deed {
            Deed::Babble => foremost,
            Deed::Load(every_us) => {
                self.next = now.plus_ns(u64::from(every_us) * 1_000);
                foremost
            }
            Deed::Forge => {
                self.next = now.plus_ms(self.random.between(1, FORGE_MS) as u32);
                self.forge()?
            }
        };
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}
