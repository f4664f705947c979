//! Buffer of a long transfer: one block, which limits the speed of both ends.

use crate::proto::canopen::host_request::HostRequest;
use crate::proto::canopen::sdo::{BLOCK_MAX, SEGMENT, crc};
use crate::station::Ticket;

/// Bytes of a whole block.
const BYTES_MAX: usize = BLOCK_MAX as usize * SEGMENT;

#[derive(Clone, Copy, Debug)]
pub struct TransferBuffer {
    ticket: Option<Ticket>,
    pub node: u8,
    /// Bytes go to the node; else they come from there.
    pub writes: bool,
    ring: [u8; BYTES_MAX],
    /// Index of the oldest byte.
    first: usize,
    len: usize,
    /// Bytes to be written that are not acknowledged yet.
    bytes_left: u32,
    /// The check over what went.
    crc: u16,
    /// Bytes of the last segment that do not count.
    unused: u8,
    /// Last received segment of a block: its valid length is known at the end.
    held_segment: Option<[u8; SEGMENT]>,
    has_last: bool,
}

/// Content of a segment.
#[derive(Clone, Copy, Default, Debug)]
pub struct OutgoingSegment {
    pub data: [u8; SEGMENT],
    pub len: u8,
    pub last: bool,
}

impl TransferBuffer {
    /// Most segments of a block.
    pub const SEGMENTS: u8 = BLOCK_MAX;
    pub const FREE: Self = Self {
        ticket: None,
        node: 0,
        writes: false,
        ring: [0; BYTES_MAX],
        first: 0,
        len: 0,
        bytes_left: 0,
        crc: 0,
        unused: 0,
        held_segment: None,
        has_last: false,
    };

    pub fn is_free(&self) -> bool {
        self.ticket.is_none()
    }

    pub fn belongs_to(&self, ticket: Ticket) -> bool {
        self.ticket == Some(ticket)
    }

    pub fn begin(&mut self, ticket: Ticket, node: u8, request: &HostRequest) {
        let (writes, left) = match *request {
            HostRequest::Download { size, .. } => (true, size),
            _ => (false, 0),
        };
        // Nine hundred bytes that need no clearing: `len` states how many of them count.
        let ring = self.ring;
        *self = Self { ticket: Some(ticket), node, writes, bytes_left: left, ring, ..Self::FREE };
    }

    pub fn end(&mut self) {
        self.ticket = None;
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Segments that there is room for, one being held back.
    pub fn free_segments(&self) -> u8 {
        let held = usize::from(self.held_segment.is_some());
        ((BYTES_MAX - self.len) / SEGMENT).saturating_sub(held) as u8
    }

    /// Appends bytes, as many as there is room for.
    fn push(&mut self, bytes: &[u8]) -> usize {
        let count = bytes.len().min(BYTES_MAX - self.len);
        for (n, byte) in bytes[..count].iter().enumerate() {
            self.ring[(self.first + self.len + n) % BYTES_MAX] = *byte;
        }
        self.len += count;
        count
    }

    /// Takes the oldest bytes away.
    fn discard(&mut self, count: usize) {
        debug_assert!(count <= self.len, "no more leaves than is there");
        self.first = (self.first + count) % BYTES_MAX;
        self.len -= count;
    }

    /// Reads bytes that have arrived.
    pub fn read_bytes(&mut self, out: &mut [u8]) -> usize {
        let count = out.len().min(self.len);
        for (n, byte) in out[..count].iter_mut().enumerate() {
            *byte = self.ring[(self.first + n) % BYTES_MAX];
        }
        self.discard(count);
        count
    }

    /// Bytes to be written come.
    pub fn write_bytes(&mut self, bytes: &[u8]) -> usize {
        // No more than was announced: a node refuses a longer value at its end.
        let wanted = (self.bytes_left as usize).saturating_sub(self.len);
        self.push(&bytes[..bytes.len().min(wanted)])
    }

    /// Takes a segment of a segmented transfer, with its length.
    pub fn push_segment(&mut self, bytes: &[u8]) {
        self.push(bytes);
    }

    /// Takes a segment of a block.
    pub fn push_block_segment(&mut self, data: [u8; SEGMENT], last: bool) {
        // Only the end of a transfer states how many bytes of its last segment count, so one segment is held
        // back.
        if let Some(before) = self.held_segment.replace(data) {
            self.crc = crc(self.crc, &before);
            self.push(&before);
        }
        self.has_last = last;
    }

    /// Returns whether the last segment has arrived.
    pub fn has_last(&self) -> bool {
        self.has_last
    }

    /// Ends all blocks: `unused` bytes of the last segment are invalid. Returns the CRC.
    pub fn finish_blocks(&mut self, unused: u8) -> u16 {
        if let Some(tail) = self.held_segment.take() {
            let tail = &tail[..SEGMENT.saturating_sub(unused.into())];
            self.crc = crc(self.crc, tail);
            self.push(tail);
        }
        self.crc
    }

    /// The segment `ahead` places behind the oldest byte; `None` before its bytes are there.
    pub fn segment(&self, ahead: u8) -> Option<OutgoingSegment> {
        let from = usize::from(ahead) * SEGMENT;
        let left = (self.bytes_left as usize).saturating_sub(from);
        let len = left.min(SEGMENT);
        if self.len < from + len {
            return None;
        }
        let mut sent =
            OutgoingSegment { len: len as u8, last: left <= SEGMENT, ..OutgoingSegment::default() };
        for (n, byte) in sent.data[..len].iter_mut().enumerate() {
            *byte = self.ring[(self.first + from + n) % BYTES_MAX];
        }
        Some(sent)
    }

    /// Records that `segments` segments arrived; true for the last ones.
    pub fn acknowledge_segments(&mut self, segments: u8) -> bool {
        for _ in 0..segments {
            let Some(OutgoingSegment { data, len, .. }) = self.segment(0) else { break };
            let len = usize::from(len);
            self.crc = crc(self.crc, &data[..len]);
            self.unused = (SEGMENT - len) as u8;
            debug_assert!(len as u32 <= self.bytes_left, "no more is acknowledged than was left");
            self.bytes_left -= len as u32;
            self.discard(len);
        }
        self.bytes_left == 0
    }

    /// End of a block transfer: unused bytes of the last segment, and the check sum.
    pub fn block_end(&self) -> (u8, u16) {
        (self.unused, self.crc)
    }
}
