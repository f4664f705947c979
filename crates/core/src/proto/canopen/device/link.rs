//! What waits to be sent, each service in a place of its own, and in which order.

use super::{CanEnd, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::cob;
use crate::proto::canopen::nmt::State;
use crate::time::Instant;

/// Places for what has no other place.
#[derive(Clone, Debug, Default)]
#[repr(C)]
pub(super) struct Mail {
    time: Frame,
    lss: [u8; 8],
    sdo: [u8; 8],
    /// A bit rate is being changed until then: nothing is sent or heard.
    pub(super) quiet_until: Instant,
    /// The counter of a SYNC to send, if it has one.
    sync: Option<u8>,
    /// Boot-up, heartbeat or guarding: the byte.
    alive: u8,
    /// The SDO reply waits until the settings are stored: it confirms that (CiA 301, object 1010h).
    pub(super) stores: bool,
    /// Places that hold something, here and elsewhere, a bit each: one look tells that none does.
    full: u8,
}

const ALIVE: u8 = 1;
const SYNC: u8 = 2;
const TIME: u8 = 4;
const SDO: u8 = 8;
const LSS: u8 = 16;
const SEGMENTS: u8 = 32;
const ALARMS: u8 = 64;

impl Mail {
    /// The bus is not to be touched.
    #[inline]
    pub(super) fn is_quiet(&self, now: Instant) -> bool {
        now < self.quiet_until
    }

    /// An SDO reply.
    #[inline]
    pub(super) const fn sdo(&mut self, reply: [u8; 8]) {
        self.sdo = reply;
        self.full |= SDO;
    }

    /// An LSS reply.
    pub(super) const fn lss(&mut self, reply: [u8; 8]) {
        self.lss = reply;
        self.full |= LSS;
    }

    /// Boot-up or guarding.
    pub(super) const fn alive(&mut self, byte: u8) {
        self.alive = byte;
        self.full |= ALIVE;
    }

    /// A heartbeat, unless something of the kind waits already.
    pub(super) const fn beat(&mut self, byte: u8) {
        if self.full & ALIVE == 0 {
            self.alive(byte);
        }
    }

    /// A SYNC, with its counter if it has one.
    pub(super) const fn sync(&mut self, counter: Option<u8>) {
        self.sync = counter;
        self.full |= SYNC;
    }

    /// A time of day.
    pub(super) const fn time(&mut self, frame: Frame) {
        self.time = frame;
        self.full |= TIME;
    }

    /// Nothing waits any more.
    pub(super) const fn clear(&mut self) {
        (self.full, self.stores) = (0, false);
    }

    /// The client wants no SDO reply any more.
    pub(super) const fn drop_sdo(&mut self) {
        self.full &= !SDO;
    }

    /// Nothing waits any more but boot-up, heartbeat or guarding, and emergencies.
    pub(super) const fn clear_services(&mut self) {
        self.full &= ALIVE | ALARMS;
        self.stores = false;
    }

    /// Segments of a block may be sent, or no more are.
    pub(super) const fn segments(&mut self, sends: bool) {
        self.full = if sends { self.full | SEGMENTS } else { self.full & !SEGMENTS };
    }

    /// Emergencies wait, or none does.
    pub(super) const fn alarms(&mut self, wait: bool) {
        self.full = if wait { self.full | ALARMS } else { self.full & !ALARMS };
    }

    #[inline]
    const fn take(&mut self, place: u8) -> bool {
        let is = self.full & place != 0;
        self.full &= !place;
        is
    }
}

impl<const N: usize> CanEnd<N> {
    /// The next frame to send, into `out`: the lowest identifier first, after the boot-up message.
    /// Returns 1 when there is one.
    #[inline]
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        out: &mut Frame,
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.mail.is_quiet(now) {
            return None;
        }
        self.collect(now, firmware);
        // Process data, a lone SDO reply, or nothing: what most calls are about.
        match self.mail.full {
            0 => self.next_pdo(now, out),
            SDO if self.sends.ready == 0 && !self.mail.stores => {
                self.mail.full = 0;
                self.service(self.mail.sdo, out)
            }
            _ => self.next(now, out, firmware),
        }
    }

    fn next(
        &mut self,
        now: Instant,
        out: &mut Frame,
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.mail.full & ALIVE != 0 && self.mail.alive == u8::from(State::BootUp) {
            return self.alive(out);
        }
        if self.mail.full & !SDO != 0 {
            if self.mail.take(SYNC) {
                return put(out, self.sync_frame(self.mail.sync));
            }
            if let Some(frame) = self.next_emergency(now) {
                return put(out, frame);
            }
        }
        if self.next_pdo(now, out).is_some() {
            return Some(1);
        }
        if self.mail.take(TIME) {
            return put(out, self.mail.time);
        }
        if !self.mail.stores && self.mail.take(SDO) {
            return self.service(self.mail.sdo, out);
        }
        if self.mail.full & SEGMENTS != 0
            && !self.mail.stores
            && let Some(bytes) = self.next_segment(firmware)
        {
            return self.service(bytes, out);
        }
        if self.mail.full & ALIVE != 0 {
            return self.alive(out);
        }
        let waits = self.mail.take(LSS);
        waits.then(|| *out = Frame::standard(cob::LSS_REPLY, &self.mail.lss)).map(|()| 1)
    }

    /// An SDO reply, each part put where it will be read.
    #[inline]
    fn service(&self, data: [u8; 8], out: &mut Frame) -> Option<usize> {
        let id = u32::from(cob::SDO_REPLY | u16::from(self.node));
        *out = Frame { id, extended: false, remote: false, len: 8, data };
        Some(1)
    }

    #[cold]
    fn alive(&mut self, out: &mut Frame) -> Option<usize> {
        self.mail.full &= !ALIVE;
        let id = cob::HEARTBEAT | u16::from(self.node);
        put(out, Frame::standard(id, &[self.mail.alive]))
    }
}

fn put(out: &mut Frame, frame: Frame) -> Option<usize> {
    *out = frame;
    Some(1)
}
