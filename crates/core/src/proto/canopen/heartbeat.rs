//! Boot-up, heartbeat and guarding: one byte each (CiA 301, 7.2.8.3).

use super::cob;
use super::nmt::NmtState;
use crate::error::WireError;
use crate::medium::Frame;

/// State message of a node: heartbeat, boot-up or a reply to guarding.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Heartbeat {
    /// State of the node; [`NmtState::BootUp`] only once after a reset.
    pub state: NmtState,
    /// Answers to guarding requests alternate; heartbeats have it clear.
    pub toggle: bool,
}

impl Heartbeat {
    /// The frame of `node` with this state.
    #[must_use]
    pub fn emit(self, node: u8) -> Frame {
        let byte = u8::from(self.state) | u8::from(self.toggle) << 7;
        Frame::standard(cob::HEARTBEAT | u16::from(node), &[byte])
    }

    /// Reads the data of a frame.
    ///
    /// # Errors
    /// [`WireError::Short`] or [`WireError::Long`]: one byte is all.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        match *data {
            [byte] => Ok(Self { state: byte.into(), toggle: byte & 0x80 != 0 }),
            _ => Err(super::wrong_length(1, data)),
        }
    }
}

/// The remote request that guards `node`.
#[must_use]
pub fn guarding_request(node: u8) -> Frame {
    let id = u32::from(cob::HEARTBEAT | u16::from(node));
    Frame { id, remote: true, len: 1, ..Frame::default() }
}
