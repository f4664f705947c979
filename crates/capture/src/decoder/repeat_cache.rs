//! A cache of explanations by the bytes of the frame. SYNC, heartbeats, commands and requests repeat, and
//! the explanation of a single frame depends on its bytes only.
//!
//! Why: DEC-6.

use std::sync::Arc;

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::route::FrameRoute;
use crate::explanation::Explanation;

/// Frames of a link that are remembered.
const SLOTS: usize = 1 << SLOT_BITS;
const SLOT_BITS: u32 = 9;

/// Explanations of frames that may be repeated, in a hash table; a frame that takes the place of another causes a new
/// explanation.
#[derive(Default)]
pub(super) struct RepeatCache(Vec<Option<(RepeatKey, Option<RepeatedFrame>)>>);

/// Key of identical frames.
type RepeatKey = (u32, u8, [u8; 8], Option<Direction>);

/// Explanation of a repeated frame.
pub(super) struct RepeatedFrame {
    pub route: FrameRoute,
    /// Answers belong to it.
    pub is_request: bool,
    pub explanation: Arc<Explanation>,
    /// Index of its last template in a batch.
    pub template: u16,
}

impl core::fmt::Debug for RepeatCache {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {SLOTS}", self.0.iter().flatten().count())
    }
}

impl RepeatCache {
    /// Finds the explanation of an earlier identical frame.
    pub fn find(
        &mut self,
        frame: &Frame,
        direction: Option<Direction>,
    ) -> Option<&mut RepeatedFrame> {
        let key = repeat_key(frame, direction);
        let (known, repeated) = self.0.get_mut(slot_index(&key))?.as_mut()?;
        repeated.as_mut().filter(|_| *known == key && !frame.extended && !frame.remote)
    }

    /// Records the explanation of a frame of 11 bits: it is stored from the second time on.
    pub fn record(
        &mut self,
        frame: &Frame,
        direction: Option<Direction>,
        lane: FrameRoute,
        it: &Explanation,
    ) {
        self.0.resize_with(SLOTS, || None);
        let key = repeat_key(frame, direction);
        match &mut self.0[slot_index(&key)] {
            Some((known, Some(_))) if *known == key => {}
            // Stored at the second sight: a frame that never comes again would only displace one that does.
            Some((known, repeated)) if *known == key => {
                let raw = super::raw_frame(frame);
                let (asks, said_now) = (lane.dissector.is_request(&raw), Arc::new(it.duplicate()));
                *repeated = Some(RepeatedFrame {
                    route: lane,
                    is_request: asks,
                    explanation: said_now,
                    template: 0,
                });
            }
            other => *other = Some((key, None)),
        }
    }
}

fn repeat_key(frame: &Frame, direction: Option<Direction>) -> RepeatKey {
    (frame.id, frame.len, frame.data, direction)
}

fn slot_index((id, len, data, _): &RepeatKey) -> usize {
    /// 2 to the 64th by the golden ratio: near numbers become far ones.
    const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;
    let mixed = u64::from_le_bytes(*data) ^ u64::from(*id) << 48 ^ u64::from(*len) << 60;
    // All bits of a factor reach the uppermost bits of the product, and no others.
    (mixed.wrapping_mul(SPREAD) >> (u64::BITS - SLOT_BITS)) as usize
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::{SLOTS, slot_index};

    /// A poll of each node of a bus, as hosts send it.
    #[test]
    fn polled_nodes_have_slots_of_their_own() {
        let request = [0x40, 0x64, 0x60, 0, 0, 0, 0, 0];
        let slot = |node: u32| slot_index(&(0x600 + node, 8, request, None));
        let slots: BTreeSet<usize> = (1..=32).map(slot).collect();
        assert!(slots.len() >= 28, "{slots:?}");
        assert!(slots.iter().all(|slot| *slot < SLOTS));
    }
}
