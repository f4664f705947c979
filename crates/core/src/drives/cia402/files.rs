//! Two objects of any length, to try transfers of every size on: one keeps what is written, one
//! only counts it.

use super::objects::{SCRATCH_MAX, STREAM_MAX, read};
use crate::proto::canopen::sdo::{Abort, crc};

/// Both objects.
#[derive(Clone, Debug)]
pub struct Files {
    kept: [u8; SCRATCH_MAX],
    len: u32,
    streamed: u32,
    check: u16,
}

impl Default for Files {
    fn default() -> Self {
        Self { kept: [0; SCRATCH_MAX], len: 0, streamed: 0, check: 0 }
    }
}

impl Files {
    /// Bytes that are kept.
    #[must_use]
    pub const fn length(&self) -> u32 {
        self.len
    }

    /// Bytes that were counted last.
    #[must_use]
    pub const fn streamed(&self) -> u32 {
        self.streamed
    }

    /// The check over them, as block transfers have it.
    #[must_use]
    pub const fn check(&self) -> u16 {
        self.check
    }

    /// Part of what is kept, or of the stream: its n-th byte is 7 n + n / 256.
    pub fn read(&self, tag: u16, offset: u32, out: &mut [u8]) {
        for (n, byte) in (offset..).zip(out) {
            *byte = match tag {
                read::SCRATCH => self.kept.get(n as usize).copied().unwrap_or(0),
                _ => n.wrapping_mul(7).wrapping_add(n / 256) as u8,
            };
        }
    }

    /// One of them will be written.
    ///
    /// # Errors
    /// [`Abort::MEMORY`] for more than it takes.
    pub fn begin(&mut self, tag: u16, size: Option<u32>) -> Result<(), Abort> {
        let room = if tag == read::SCRATCH { SCRATCH_MAX as u32 } else { STREAM_MAX };
        if size.is_some_and(|size| size > room) {
            return Err(Abort::MEMORY);
        }
        if tag == read::SCRATCH {
            self.len = 0;
        } else {
            (self.streamed, self.check) = (0, 0);
        }
        Ok(())
    }

    /// The next bytes.
    ///
    /// # Errors
    /// [`Abort::MEMORY`] for more than it takes.
    pub fn write(&mut self, tag: u16, offset: u32, data: &[u8]) -> Result<(), Abort> {
        let end = offset.saturating_add(data.len() as u32);
        if tag == read::SCRATCH {
            let place = self.kept.get_mut(offset as usize..end as usize).ok_or(Abort::MEMORY)?;
            place.copy_from_slice(data);
            self.len = end;
        } else if end > STREAM_MAX {
            return Err(Abort::MEMORY);
        } else {
            (self.streamed, self.check) = (end, crc(self.check, data));
        }
        Ok(())
    }
}
