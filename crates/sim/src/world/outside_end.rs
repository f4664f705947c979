//! The ends of wires that are held outside of a world: by a link, a pty, a test.

use std::collections::VecDeque;

use polepair_core::medium::{Frame, SerialLine};
use polepair_core::time::Instant;

/// Bytes that wait at an outside end; what comes beyond is dropped and counted.
const INBOX_MAX: usize = 1 << 20;
/// Frames that wait each way; the same.
const FRAMES_MAX: usize = 1 << 16;

/// Data that wait at an end that is held outside of the world.
pub(super) struct OutsideEnd {
    pub(super) plug: (usize, usize),
    pub(super) line: SerialLine,
    arrivals: VecDeque<(Instant, usize)>,
    bytes: VecDeque<u8>,
    frames: VecDeque<(Instant, Frame)>,
    /// Frames that wait for the controller.
    outbox: VecDeque<Frame>,
    pub(super) dropped: u64,
}

impl Default for OutsideEnd {
    fn default() -> Self {
        Self {
            plug: (0, 0),
            line: SerialLine::new_8n1(0),
            arrivals: VecDeque::new(),
            bytes: VecDeque::new(),
            frames: VecDeque::new(),
            outbox: VecDeque::new(),
            dropped: 0,
        }
    }
}

impl OutsideEnd {
    pub(super) fn push_bytes(&mut self, now: Instant, bytes: &[u8]) {
        if bytes.is_empty() || self.bytes.len() + bytes.len() > INBOX_MAX {
            self.dropped += bytes.len() as u64;
            return;
        }
        self.bytes.extend(bytes);
        match self.arrivals.back_mut() {
            Some((at, len)) if *at == now => *len += bytes.len(),
            _ => self.arrivals.push_back((now, bytes.len())),
        }
    }

    pub(super) fn read_bytes(&mut self, buffer: &mut [u8]) -> Option<(Instant, usize)> {
        let (at, waiting) = self.arrivals.front_mut()?;
        let (at, count) = (*at, buffer.len().min(*waiting));
        *waiting -= count;
        if *waiting == 0 {
            self.arrivals.pop_front();
        }
        buffer.iter_mut().zip(self.bytes.drain(..count)).for_each(|(to, byte)| *to = byte);
        Some((at, count))
    }

    pub(super) fn push_frame(&mut self, now: Instant, frame: &Frame) {
        if self.frames.len() < FRAMES_MAX {
            self.frames.push_back((now, *frame))
        } else {
            self.dropped += 1;
        }
    }

    pub(super) fn pop_frame(&mut self) -> Option<(Instant, Frame)> {
        self.frames.pop_front()
    }

    /// Puts a frame in line for the controller. Returns whether there was room.
    pub(super) fn queue_frame(&mut self, frame: &Frame) -> bool {
        let has_room = self.outbox.len() < FRAMES_MAX;
        if has_room {
            self.outbox.push_back(*frame);
        }
        has_room
    }

    pub(super) fn pop_to_send(&mut self) -> Option<Frame> {
        self.outbox.pop_front()
    }

    pub(super) fn has_pending(&self) -> bool {
        !self.arrivals.is_empty() || !self.frames.is_empty()
    }
}
