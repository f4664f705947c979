//! Bytes of a stream that were read and not yet looked at.

use polepair_core::medium::{Medium, Stream};
use polepair_core::time::Instant;

use crate::error::LinkError;
use crate::link::{Link, Received};

pub(crate) struct Inbox {
    bytes: <Stream as Medium>::Buffer,
    from: usize,
    to: usize,
    /// When the last of them arrived.
    pub(crate) at: Instant,
}

impl Default for Inbox {
    fn default() -> Self {
        Self { bytes: Stream::buffer(), from: 0, to: 0, at: Instant::ZERO }
    }
}

impl Inbox {
    pub(crate) fn next(&mut self) -> Option<u8> {
        let byte = *self.bytes[..self.to].get(self.from)?;
        self.from += 1;
        Some(byte)
    }

    #[cfg(unix)]
    pub(crate) const fn is_empty(&self) -> bool {
        self.from == self.to
    }

    /// Reads more, once all was looked at.
    pub(crate) fn receive(
        &mut self,
        from: &dyn Link<Stream>,
        until: Instant,
    ) -> Result<Received, LinkError> {
        let received = from.receive(&mut self.bytes, until)?;
        if let Received::Bytes { len, at } = received {
            (self.from, self.to, self.at) = (0, len, at);
        }
        Ok(received)
    }

    /// Likewise with a `read` of the caller's, which tells how many bytes it read.
    #[cfg(unix)]
    pub(crate) fn fill<E>(
        &mut self,
        at: Instant,
        read: impl FnOnce(&mut [u8]) -> Result<usize, E>,
    ) -> Result<usize, E> {
        let len = read(&mut self.bytes)?;
        (self.from, self.to, self.at) = (0, len, at);
        Ok(len)
    }
}
