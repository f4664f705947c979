//! Counts CAN frames whose content supports or contradicts a protocol. A frame that repeats counts once.

use std::collections::HashSet;

use polepair_core::explain::{Dissector, RawFrame};

/// Distinct frames that are remembered.
const FRAMES_MAX: usize = 1024;

/// Distinct frames for and against a protocol.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    seen: HashSet<(u32, u64)>,
    pub supporting: u64,
    pub contradicting: u64,
}

impl Evidence {
    /// The counts, without the frames that are remembered.
    pub fn counts(&self) -> Self {
        let Self { supporting, contradicting, .. } = *self;
        Self { seen: HashSet::new(), supporting, contradicting }
    }

    /// Takes a valid frame.
    pub fn observe(&mut self, dissector: &dyn Dissector, frame: &RawFrame<'_>) {
        let (Some(id), len @ 0..=8) = (frame.id, frame.bytes.len()) else { return };
        let Some(supports) = dissector.content_evidence(frame) else { return };
        let mut data = [0; 8];
        data[..len].copy_from_slice(frame.bytes);
        let key = (id | u32::from(frame.extended) << 31, u64::from_le_bytes(data));
        // A frame that is sent every 10 ms proves no more than one of it.
        if self.seen.len() >= FRAMES_MAX || !self.seen.insert(key) {
            return;
        }
        if supports { self.supporting += 1 } else { self.contradicting += 1 }
    }
}
