//! Two objects of any length for transfer tests: one stores written bytes, one only counts them.

use super::objects::{SCRATCH_MAX, STREAM_MAX, computed};
use polepair_core::proto::canopen::sdo::{AbortCode, crc};

/// Both objects.
#[derive(Clone, Debug)]
pub struct TransferObjects {
    scratch: [u8; SCRATCH_MAX],
    scratch_len: u32,
    streamed: u32,
    stream_crc: u16,
}

impl Default for TransferObjects {
    fn default() -> Self {
        Self { scratch: [0; SCRATCH_MAX], scratch_len: 0, streamed: 0, stream_crc: 0 }
    }
}

impl TransferObjects {
    /// Bytes that are kept.
    #[must_use]
    pub const fn scratch_len(&self) -> u32 {
        self.scratch_len
    }

    /// Bytes that were counted last.
    #[must_use]
    pub const fn streamed(&self) -> u32 {
        self.streamed
    }

    /// The check over them, as block transfers have it.
    #[must_use]
    pub const fn stream_crc(&self) -> u16 {
        self.stream_crc
    }

    /// Reads a part of the stored bytes, or of the stream: its n-th byte is 7 n + n / 256.
    pub fn read(&self, tag: u16, offset: u32, out: &mut [u8]) {
        for (n, byte) in (offset..).zip(out) {
            *byte = match tag {
                computed::SCRATCH => self.scratch.get(n as usize).copied().unwrap_or(0),
                _ => n.wrapping_mul(7).wrapping_add(n / 256) as u8,
            };
        }
    }

    /// One of them will be written.
    ///
    /// # Errors
    /// [`AbortCode::MEMORY`] for more than it takes.
    pub fn begin_write(&mut self, tag: u16, size: Option<u32>) -> Result<(), AbortCode> {
        let capacity = if tag == computed::SCRATCH { SCRATCH_MAX as u32 } else { STREAM_MAX };
        if size.is_some_and(|size| size > capacity) {
            return Err(AbortCode::MEMORY);
        }
        if tag == computed::SCRATCH {
            self.scratch_len = 0;
        } else {
            (self.streamed, self.stream_crc) = (0, 0);
        }
        Ok(())
    }

    /// The next bytes.
    ///
    /// # Errors
    /// [`AbortCode::MEMORY`] for more than it takes.
    pub fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), AbortCode> {
        let end = offset.saturating_add(data.len() as u32);
        if tag == computed::SCRATCH {
            let slot =
                self.scratch.get_mut(offset as usize..end as usize).ok_or(AbortCode::MEMORY)?;
            slot.copy_from_slice(data);
            self.scratch_len = end;
        } else if end > STREAM_MAX {
            return Err(AbortCode::MEMORY);
        } else {
            (self.streamed, self.stream_crc) = (end, crc(self.stream_crc, data));
        }
        Ok(())
    }
}
