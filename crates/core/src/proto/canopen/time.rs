//! TIME: the time of day (CiA 301, 7.2.6 and 7.1.6.7).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// Days from 1970-01-01 to 1984-01-01, where CANopen begins to count.
const EPOCH_DAYS: u64 = 5_113;
const DAY_MS: u64 = 86_400_000;

/// Time of day and day.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub struct TimeOfDay {
    /// Days since 1984-01-01.
    pub days: u16,
    /// Milliseconds since midnight; 28 bits.
    pub ms: u32,
}

impl TimeOfDay {
    /// From milliseconds since 1970-01-01; `None` before 1984 and after 2163.
    #[must_use]
    pub fn from_unix_ms(ms: u64) -> Option<Self> {
        let days = (ms / DAY_MS).checked_sub(EPOCH_DAYS)?;
        Some(Self { days: u16::try_from(days).ok()?, ms: (ms % DAY_MS) as u32 })
    }

    /// Milliseconds since 1970-01-01.
    #[must_use]
    pub const fn unix_ms(self) -> u64 {
        (self.days as u64 + EPOCH_DAYS) * DAY_MS + self.ms as u64
    }

    /// The six bytes.
    #[must_use]
    pub const fn bytes(self) -> [u8; 6] {
        let [a, b, c, d] = (self.ms & 0x0FFF_FFFF).to_le_bytes();
        let [e, f] = self.days.to_le_bytes();
        [a, b, c, d, e, f]
    }

    /// The frame with the usual identifier.
    #[must_use]
    pub fn emit(self) -> Frame {
        Frame::standard(cob::TIME, &self.bytes())
    }

    /// Reads the data of a frame. The four reserved bits do not count.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: six bytes are all.
    pub const fn parse(data: &[u8]) -> Result<Self, WireError> {
        match *data {
            [a, b, c, d, e, f] => Ok(Self {
                days: u16::from_le_bytes([e, f]),
                ms: u32::from_le_bytes([a, b, c, d]) & 0x0FFF_FFFF,
            }),
            _ => Err(super::wrong_length(6, data)),
        }
    }
}
