//! Bytes of a stream that were read and not processed yet.

use polepair_core::medium::{Medium, Stream};
use polepair_core::time::Instant;

use crate::error::LinkError;
use crate::link::{LinkIo, Received};

pub(crate) struct Inbox {
    bytes: <Stream as Medium>::Buffer,
    start: usize,
    end: usize,
    /// Arrival of the last of them.
    pub(crate) received_at: Instant,
}

impl Default for Inbox {
    fn default() -> Self {
        Self { bytes: Stream::buffer(), start: 0, end: 0, received_at: Instant::ZERO }
    }
}

impl Inbox {
    pub(crate) fn next_byte(&mut self) -> Option<u8> {
        let byte = *self.bytes[..self.end].get(self.start)?;
        self.start += 1;
        Some(byte)
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.start == self.end
    }

    /// Reads more, once all was looked at.
    pub(crate) fn receive(
        &mut self,
        from: &dyn LinkIo<Stream>,
        until: Instant,
    ) -> Result<Received, LinkError> {
        let received = from.receive(&mut self.bytes, until)?;
        if let Received::Bytes { len, at } = received {
            (self.start, self.end, self.received_at) = (0, len, at);
        }
        Ok(received)
    }

    /// [`fill_from`](Self::fill_from) with a `read` of the caller, which returns the number of bytes.
    pub(crate) fn fill<E>(
        &mut self,
        at: Instant,
        read: impl FnOnce(&mut [u8]) -> Result<usize, E>,
    ) -> Result<usize, E> {
        let len = read(&mut self.bytes)?;
        (self.start, self.end, self.received_at) = (0, len, at);
        Ok(len)
    }
}
