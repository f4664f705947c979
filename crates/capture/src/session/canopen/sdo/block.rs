//! The segments of one block until their number is acknowledged; the others are sent again.

use polepair_core::proto::canopen::sdo::{BLOCK_MAX, BlockSegment, SEGMENT};

/// Segments of a block.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockBuffer {
    bytes: Vec<u8>,
    /// Segments of the block at most.
    pub segments_max: u8,
    /// The last one that came in order.
    pub count: u8,
    /// True for the last of all.
    pub last: bool,
    /// The last segment of all, whose end may not count.
    tail: Option<[u8; SEGMENT]>,
}

impl BlockBuffer {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.bytes.clear();
        (self.segments_max, self.count, self.last, self.tail) = (BLOCK_MAX, 0, false, None);
    }

    /// Takes a segment; `false` if it is not the next one.
    pub fn push(&mut self, segment: &BlockSegment) -> bool {
        if segment.number != self.count + 1 || segment.number > BLOCK_MAX || self.last {
            return false;
        }
        debug_assert!(self.count < BLOCK_MAX);
        self.bytes.extend_from_slice(&segment.data);
        (self.count, self.last) = (segment.number, segment.last);
        true
    }

    /// No more segments come before an acknowledgement.
    pub const fn is_full(&self) -> bool {
        self.last || self.count >= self.segments_max
    }

    /// Gives the bytes of the `arrived` segments, except those of the last of all, which wait for their valid length.
    /// The next block has `capacity` segments.
    pub fn acknowledge(&mut self, arrived: u8, capacity: u8, mut each: impl FnMut(&[u8])) {
        let all = arrived >= self.count && self.last;
        let len = usize::from(arrived.min(self.count)) * SEGMENT;
        debug_assert!(len <= self.bytes.len(), "as many segments as were counted");
        let (whole, _) = self.bytes.split_at(len);
        match whole.split_last_chunk::<SEGMENT>() {
            Some((before, tail)) if all => {
                each(before);
                self.tail = Some(*tail);
            }
            _ => each(whole),
        }
        self.bytes.clear();
        (self.segments_max, self.count, self.last) = (capacity, 0, all);
    }

    /// The bytes of the last segment that count.
    pub fn take_tail(&mut self, unused: u8) -> Option<([u8; SEGMENT], usize)> {
        let tail = self.tail.take()?;
        Some((tail, SEGMENT.saturating_sub(unused.into())))
    }
}
