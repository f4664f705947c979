//! What waits to be sent, each service in a place of its own, and in which order.

use super::{CanEnd, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::cob;
use crate::proto::canopen::nmt::State;
use crate::time::Instant;

/// Places for what has no other place.
#[derive(Clone, Debug, Default)]
pub(super) struct Mail {
    /// Boot-up, heartbeat or guarding: the byte.
    pub(super) alive: Option<u8>,
    /// The byte of a SYNC to send; `Some(None)` is one without counter.
    pub(super) sync: Option<Option<u8>>,
    /// A time of day.
    pub(super) time: Option<Frame>,
    /// An SDO reply.
    pub(super) sdo: Option<[u8; 8]>,
    /// It waits until the settings are stored: it confirms that (CiA 301, object 1010h).
    pub(super) stores: bool,
    /// An LSS reply.
    pub(super) lss: Option<[u8; 8]>,
    /// A bit rate is being changed until then: nothing is sent or heard.
    pub(super) quiet_until: Instant,
}

impl Mail {
    /// The bus is not to be touched.
    #[inline]
    pub(super) fn is_quiet(&self, now: Instant) -> bool {
        now < self.quiet_until
    }
}

impl<const N: usize> CanEnd<N> {
    /// The next frame to send: the lowest identifier first, after the boot-up message.
    #[inline]
    pub fn poll_transmit(&mut self, now: Instant, firmware: &mut impl Firmware) -> Option<Frame> {
        if self.mail.is_quiet(now) {
            return None;
        }
        if self.mail.alive == Some(u8::from(State::BootUp)) {
            return self.alive();
        }
        self.collect(now, firmware);
        if let Some(counter) = self.mail.sync.take() {
            return Some(self.sync_frame(counter));
        }
        if let Some(frame) = self.next_emergency(now) {
            return Some(frame);
        }
        if self.sends.ready != 0 {
            return self.next_pdo(now);
        }
        self.next_other(firmware)
    }

    fn next_other(&mut self, firmware: &mut impl Firmware) -> Option<Frame> {
        if let Some(frame) = self.mail.time.take() {
            return Some(frame);
        }
        if !self.mail.stores
            && let Some(bytes) = self.mail.sdo.take().or_else(|| self.next_segment(firmware))
        {
            return Some(Frame::standard(cob::SDO_REPLY | u16::from(self.node), &bytes));
        }
        if let Some(frame) = self.alive() {
            return Some(frame);
        }
        let bytes = self.mail.lss.take()?;
        Some(Frame::standard(cob::LSS_REPLY, &bytes))
    }

    fn alive(&mut self) -> Option<Frame> {
        let byte = self.mail.alive.take()?;
        Some(Frame::standard(cob::HEARTBEAT | u16::from(self.node), &[byte]))
    }
}
