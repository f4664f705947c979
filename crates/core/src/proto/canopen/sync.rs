//! SYNC messages (CiA 301, 7.2.5).

use super::cob;
use crate::error::WireError;
use crate::medium::Frame;

/// SYNC with a counter from 1 to the value of object 1019h, or without.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SyncMessage {
    /// The counter, where there is one.
    pub counter: Option<u8>,
}

/// Values of object 1019h other than 0.
pub const OVERFLOW_RANGE: core::ops::RangeInclusive<u8> = 2..=240;

impl SyncMessage {
    /// The frame with the usual identifier.
    #[must_use]
    pub fn emit(self) -> Frame {
        match self.counter {
            None => Frame::standard(cob::SYNC, &[]),
            Some(counter) => Frame::standard(cob::SYNC, &[counter]),
        }
    }

    /// Reads the data of a frame.
    ///
    /// # Errors
    /// [`WireError::Long`]: at most one byte.
    pub const fn parse(data: &[u8]) -> Result<Self, WireError> {
        match *data {
            [] => Ok(Self { counter: None }),
            [counter] => Ok(Self { counter: Some(counter) }),
            _ => Err(super::wrong_length(1, data)),
        }
    }
}
