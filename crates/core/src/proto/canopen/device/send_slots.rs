//! Frames to be sent, one slot for each service, with their order.

use super::{CanEndpoint, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::cob;
use crate::proto::canopen::nmt::NmtState;
use crate::time::Instant;

/// Places for what has no other place.
#[derive(Clone, Debug, Default)]
#[repr(C)]
pub(super) struct SendSlots {
    time: Frame,
    lss: [u8; 8],
    sdo: [u8; 8],
    /// End of a change of the bit rate: until then nothing is sent or received.
    pub(super) silenced_until: Instant,
    /// The counter of a SYNC to send, if it has one.
    sync: Option<u8>,
    /// Boot-up, heartbeat or guarding: the byte.
    heartbeat_byte: u8,
    /// The SDO reply waits until the settings are stored: it confirms that (CiA 301, object 1010h).
    pub(super) awaits_store: bool,
    /// Occupied slots, here and elsewhere, a bit each: one comparison shows that none is.
    occupied: u8,
}

const HEARTBEAT: u8 = 1;
const SYNC: u8 = 2;
const TIME: u8 = 4;
const SDO: u8 = 8;
const LSS: u8 = 16;
const SEGMENTS: u8 = 32;
const EMERGENCIES: u8 = 64;

impl SendSlots {
    /// The bus is not to be touched.
    #[inline]
    pub(super) fn is_silenced(&self, now: Instant) -> bool {
        now < self.silenced_until
    }

    /// An SDO reply.
    #[inline]
    pub(super) const fn set_sdo(&mut self, reply: [u8; 8]) {
        self.sdo = reply;
        self.occupied |= SDO;
    }

    /// An LSS reply.
    pub(super) const fn set_lss(&mut self, reply: [u8; 8]) {
        self.lss = reply;
        self.occupied |= LSS;
    }

    /// Boot-up or guarding.
    pub(super) const fn set_heartbeat(&mut self, byte: u8) {
        self.heartbeat_byte = byte;
        self.occupied |= HEARTBEAT;
    }

    /// A heartbeat, unless something of the kind waits already.
    pub(super) const fn offer_heartbeat(&mut self, byte: u8) {
        if self.occupied & HEARTBEAT == 0 {
            self.set_heartbeat(byte);
        }
    }

    /// A SYNC, with its counter if it has one.
    pub(super) const fn set_sync(&mut self, counter: Option<u8>) {
        self.sync = counter;
        self.occupied |= SYNC;
    }

    /// A time of day.
    pub(super) const fn set_time(&mut self, frame: Frame) {
        self.time = frame;
        self.occupied |= TIME;
    }

    /// Nothing waits any more.
    pub(super) const fn clear(&mut self) {
        (self.occupied, self.awaits_store) = (0, false);
    }

    /// The client wants no SDO reply any more.
    pub(super) const fn drop_sdo(&mut self) {
        self.occupied &= !SDO;
    }

    /// Nothing waits any more but boot-up, heartbeat or guarding, and emergencies.
    pub(super) const fn clear_services(&mut self) {
        self.occupied &= HEARTBEAT | EMERGENCIES;
        self.awaits_store = false;
    }

    /// Segments of a block may be sent, or no more are.
    pub(super) const fn set_segments(&mut self, sends: bool) {
        self.occupied = if sends { self.occupied | SEGMENTS } else { self.occupied & !SEGMENTS };
    }

    /// Emergencies wait, or none does.
    pub(super) const fn set_emergencies(&mut self, wait: bool) {
        self.occupied =
            if wait { self.occupied | EMERGENCIES } else { self.occupied & !EMERGENCIES };
    }

    #[inline]
    const fn take_slot(&mut self, index: u8) -> bool {
        let is = self.occupied & index != 0;
        self.occupied &= !index;
        is
    }
}

impl<const N: usize> CanEndpoint<N> {
    /// The next frame to send, into `out`: the lowest identifier first, after the boot-up message.
    /// Returns 1 when there is one.
    #[inline]
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        out: &mut Frame,
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.send_slots.is_silenced(now) {
            return None;
        }
        self.collect_emergencies(now, firmware);
        // Process data, a lone SDO reply, or nothing: what most calls are about.
        match self.send_slots.occupied {
            0 => self.next_pdo(now, out),
            SDO if self.tpdos.ready == 0 && !self.send_slots.awaits_store => {
                self.send_slots.occupied = 0;
                self.write_sdo_frame(self.send_slots.sdo, out)
            }
            _ => self.next_frame(now, out, firmware),
        }
    }

    fn next_frame(
        &mut self,
        now: Instant,
        out: &mut Frame,
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.send_slots.occupied & HEARTBEAT != 0
            && self.send_slots.heartbeat_byte == u8::from(NmtState::BootUp)
        {
            return self.write_heartbeat(out);
        }
        if self.send_slots.occupied & !SDO != 0 {
            if self.send_slots.take_slot(SYNC) {
                return write_frame(out, self.sync_frame(self.send_slots.sync));
            }
            if let Some(frame) = self.next_emergency(now) {
                return write_frame(out, frame);
            }
        }
        if self.next_pdo(now, out).is_some() {
            return Some(1);
        }
        if self.send_slots.take_slot(TIME) {
            return write_frame(out, self.send_slots.time);
        }
        if !self.send_slots.awaits_store && self.send_slots.take_slot(SDO) {
            return self.write_sdo_frame(self.send_slots.sdo, out);
        }
        if self.send_slots.occupied & SEGMENTS != 0
            && !self.send_slots.awaits_store
            && let Some(bytes) = self.next_segment(firmware)
        {
            return self.write_sdo_frame(bytes, out);
        }
        if self.send_slots.occupied & HEARTBEAT != 0 {
            return self.write_heartbeat(out);
        }
        let waits = self.send_slots.take_slot(LSS);
        waits.then(|| *out = Frame::standard(cob::LSS_REPLY, &self.send_slots.lss)).map(|()| 1)
    }

    /// An SDO reply, each part put where it will be read.
    #[inline]
    fn write_sdo_frame(&self, data: [u8; 8], out: &mut Frame) -> Option<usize> {
        let id = u32::from(cob::SDO_REPLY | u16::from(self.node));
        *out = Frame { id, extended: false, remote: false, len: 8, data };
        Some(1)
    }

    #[cold]
    fn write_heartbeat(&mut self, out: &mut Frame) -> Option<usize> {
        self.send_slots.occupied &= !HEARTBEAT;
        let id = cob::HEARTBEAT | u16::from(self.node);
        write_frame(out, Frame::standard(id, &[self.send_slots.heartbeat_byte]))
    }
}

fn write_frame(out: &mut Frame, frame: Frame) -> Option<usize> {
    *out = frame;
    Some(1)
}
