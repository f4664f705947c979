//! A cache of explanations by the bytes of the frame. SYNC, heartbeats, commands and requests repeat, and
//! the explanation of a single frame depends on its bytes only.
//!
//! Why: DEC-6.

use std::sync::Arc;

use polepair_core::explain::{Direction, RawFrame};
use polepair_core::medium::Frame;

use super::route::FrameRoute;
use crate::explanation::Explanation;

/// Frames of a link that are remembered.
pub(super) const SLOTS: usize = 1 << SLOT_BITS;
const SLOT_BITS: u32 = 9;

/// Explanations of frames that may be repeated, in a hash table; a frame that takes the place of another causes a new
/// explanation.
#[derive(Default)]
pub(super) struct RepeatCache<K>(Vec<Option<(K, Option<RepeatedFrame>)>>);

/// Common properties of identical frames.
pub(super) trait RepeatKey: Copy + PartialEq {
    /// Place of the frames in the table.
    fn slot_index(&self) -> usize;
}

/// Key of CAN frames of 11 bits: identifier, length, data and sender.
pub(super) type CanKey = (u32, u8, [u8; 8], Option<Direction>);

/// Key of requests on a serial line: their bytes, and how many count.
pub(super) type SerialKey = (u8, [u8; SERIAL_MAX]);

/// Longest request of a serial line that is remembered; reads and most writes are shorter.
pub(super) const SERIAL_MAX: usize = 16;

/// Explanation of a repeated frame.
pub(super) struct RepeatedFrame {
    pub route: FrameRoute,
    /// Answers belong to it.
    pub is_request: bool,
    pub explanation: Arc<Explanation>,
    /// Index of its last template in a batch.
    pub template: u16,
}

impl<K> core::fmt::Debug for RepeatCache<K> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {SLOTS}", self.0.iter().flatten().count())
    }
}

impl<K: RepeatKey> RepeatCache<K> {
    /// Finds the explanation of an earlier identical frame.
    pub fn find(&mut self, key: &K) -> Option<&mut RepeatedFrame> {
        let (known, repeated) = self.0.get_mut(key.slot_index())?.as_mut()?;
        repeated.as_mut().filter(|_| known == key)
    }

    /// Records the explanation of a frame: it is stored from the second time on.
    pub fn record(&mut self, key: K, raw: &RawFrame<'_>, route: FrameRoute, it: &Explanation) {
        self.0.resize_with(SLOTS, || None);
        match &mut self.0[key.slot_index()] {
            Some((known, Some(_))) if *known == key => {}
            // Stored at the second sight: a frame that never comes again would only displace one that does.
            Some((known, repeated)) if *known == key => {
                let is_request = route.dissector.is_request(raw);
                let explanation = Arc::new(it.duplicate());
                *repeated = Some(RepeatedFrame { route, is_request, explanation, template: 0 });
            }
            other => *other = Some((key, None)),
        }
    }
}

/// The key of a CAN frame of 11 bits; `None` for all others.
pub(super) fn can_key(frame: &Frame, direction: Option<Direction>) -> Option<CanKey> {
    let is_plain = !frame.extended && !frame.remote;
    is_plain.then_some((frame.id, frame.len, frame.data, direction))
}

/// The key of a request on a serial line; `None` for a long one.
pub(super) fn serial_key(bytes: &[u8]) -> Option<SerialKey> {
    let mut key = [0; SERIAL_MAX];
    key.get_mut(..bytes.len())?.copy_from_slice(bytes);
    Some((bytes.len() as u8, key))
}

/// 2 to the 64th by the golden ratio: near numbers become far ones.
const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;

/// Place in the table of a key whose bits were mixed into a number.
pub(super) fn slot_of(mixed: u64) -> usize {
    // All bits of a factor reach the uppermost bits of the product, and no others.
    (mixed.wrapping_mul(SPREAD) >> (u64::BITS - SLOT_BITS)) as usize
}

impl RepeatKey for CanKey {
    fn slot_index(&self) -> usize {
        let (id, len, data, _) = self;
        slot_of(u64::from_le_bytes(*data) ^ u64::from(*id) << 48 ^ u64::from(*len) << 60)
    }
}

impl RepeatKey for SerialKey {
    fn slot_index(&self) -> usize {
        let (len, bytes) = self;
        let [low, high] = [0, 8].map(|at| {
            let mut half = [0; 8];
            half.copy_from_slice(&bytes[at..at + 8]);
            u64::from_le_bytes(half)
        });
        slot_of(low ^ high.rotate_left(24) ^ u64::from(*len) << 60)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::{RepeatKey as _, SLOTS, serial_key};

    /// A poll of each node of a bus, as hosts send it.
    #[test]
    fn polled_nodes_have_slots_of_their_own() {
        let request = [0x40, 0x64, 0x60, 0, 0, 0, 0, 0];
        let slot = |node: u32| (0x600 + node, 8, request, None).slot_index();
        let slots: BTreeSet<usize> = (1..=32).map(slot).collect();
        assert!(slots.len() >= 28, "{slots:?}");
        assert!(slots.iter().all(|slot| *slot < SLOTS));
    }

    #[test]
    fn polled_registers_have_slots_of_their_own() {
        let slot = |register: u8| {
            let request = [1, 3, 0x10, register, 0, 2, register, !register];
            serial_key(&request).expect("short").slot_index()
        };
        let slots: BTreeSet<usize> = (0..32).map(slot).collect();
        assert!(slots.len() >= 28, "{slots:?}");
        assert_eq!(serial_key(&[0; 17]), None);
    }
}
