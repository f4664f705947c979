//! Frames that say what an earlier one with the same bytes said: the beat, heartbeats, orders and
//! requests come again and again, and what each says by itself hangs on its bytes alone.
//!
//! Why: DEC-6.

use std::sync::Arc;

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::lane::Lane;
use crate::explained::Explained;

/// Frames of a link that are remembered: a power of two.
const PLACES: usize = 1 << 9;

/// What frames said that may come again, each where its bytes lead; one that takes the place of
/// another is explained again.
#[derive(Default)]
pub(super) struct Repeats(Vec<Option<(Key, Option<Known>)>>);

/// What makes frames the same.
type Key = (u32, u8, [u8; 8], Option<Direction>);

/// What a frame said.
pub(super) struct Known {
    pub lane: Lane,
    /// Answers belong to it.
    pub asks: bool,
    pub said: Arc<Explained>,
    /// Where in a batch its voice was last.
    pub voice: u16,
}

impl core::fmt::Debug for Repeats {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {PLACES}", self.0.iter().flatten().count())
    }
}

impl Repeats {
    /// What the frame said when it came before.
    pub fn of(&mut self, frame: &Frame, direction: Option<Direction>) -> Option<&mut Known> {
        let key = key(frame, direction);
        let (known, said) = self.0.get_mut(place(&key))?.as_mut()?;
        said.as_mut().filter(|_| *known == key && !frame.extended && !frame.remote)
    }

    /// Takes note of what a frame of 11 bits said: from the second time on it is kept.
    pub fn note(
        &mut self,
        frame: &Frame,
        direction: Option<Direction>,
        lane: Lane,
        it: &Explained,
    ) {
        self.0.resize_with(PLACES, || None);
        let key = key(frame, direction);
        match &mut self.0[place(&key)] {
            Some((known, Some(_))) if *known == key => {}
            Some((known, said)) if *known == key => {
                let raw = super::raw(frame);
                let (asks, said_now) = (lane.dissector.asks(&raw), Arc::new(it.copied()));
                *said = Some(Known { lane, asks, said: said_now, voice: 0 });
            }
            other => *other = Some((key, None)),
        }
    }
}

fn key(frame: &Frame, direction: Option<Direction>) -> Key {
    (frame.id, frame.len, frame.data, direction)
}

fn place((id, len, data, _): &Key) -> usize {
    /// 2 to the 64th by the golden ratio: near numbers become far ones.
    const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;
    let mixed = u64::from_le_bytes(*data) ^ u64::from(*id) << 48 ^ u64::from(*len) << 60;
    (mixed.wrapping_mul(SPREAD) >> 40) as usize & (PLACES - 1)
}
