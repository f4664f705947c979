//! Emergencies: queue, history (object 1003h) and error register.

use super::{CanEndpoint, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::pdo::CobId;
use crate::time::Instant;

/// Errors that object 1003h remembers.
pub const HISTORY_MAX: usize = 4;
/// Emergencies that wait for their turn at most; the newest is then left out.
const WAITING_MAX: usize = 8;

/// A SYNC of another length than the counter asks for.
pub(super) const SYNC_LENGTH: u16 = 0x8240;
/// A PDO too short to be used.
pub(super) const PDO_SHORT: u16 = 0x8210;
/// A PDO longer than its mapping.
pub(super) const PDO_LONG: u16 = 0x8220;
/// A PDO did not come in time.
pub(super) const PDO_MISSING: u16 = 0x8250;
/// A heartbeat or guarding did not come.
pub(super) const NO_HEARTBEAT: u16 = 0x8130;
/// The controller was bus-off.
pub(super) const BUS_OFF: u16 = 0x8140;
/// Bit of object 1001h for the protocol's own.
const COMMUNICATION: u8 = 1 << 4;

/// Waiting emergencies, and the error history.
#[derive(Clone, Debug, Default)]
pub(super) struct EmergencyQueue {
    queue: [Emergency; WAITING_MAX],
    queue_len: usize,
    history: [u32; HISTORY_MAX],
    history_len: u8,
    communication_error: bool,
    free_at: Instant,
}

impl EmergencyQueue {
    fn push(&mut self, emergency: Emergency) {
        if emergency.code != 0 {
            // The newest comes first (CiA 301, 1003h).
            self.history.rotate_right(1);
            self.history[0] = emergency.code.into();
            self.history_len = (self.history_len + 1).min(HISTORY_MAX as u8);
        }
        // With a full queue the later ones are lost on the bus; the history has them.
        if let Some(position) = self.queue.get_mut(self.queue_len) {
            *position = emergency;
            self.queue_len += 1;
        }
    }

    /// Nothing waits and nothing was.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Drops the waiting emergencies.
    pub(super) fn clear_queue(&mut self) {
        self.queue_len = 0;
        self.communication_error = false;
    }

    /// Earliest time for the next waiting emergency.
    pub(super) fn due(&self, now: Instant) -> Instant {
        if self.queue_len > 0 && self.free_at > now { self.free_at } else { Instant::FAR_FUTURE }
    }

    /// Object 1003h.
    pub(super) fn history(&self, sub: u8) -> Option<u32> {
        match sub {
            0 => Some(self.history_len.into()),
            _ if sub > self.history_len => None,
            _ => Some(self.history[usize::from(sub) - 1]),
        }
    }

    /// Writing 0 to 1003h sub-index 0.
    pub(super) fn clear_history(&mut self) {
        self.history_len = 0;
    }
}

impl<const N: usize> CanEndpoint<N> {
    /// Object 1001h.
    pub(super) fn error_register(&self, firmware: &impl Firmware) -> u8 {
        let own = if self.emergencies.communication_error { COMMUNICATION | 1 } else { 0 };
        own | firmware.error_register()
    }

    fn queue_emergency(&mut self, emergency: Emergency) {
        self.emergencies.push(emergency);
        self.send_slots.set_emergencies(true);
    }

    /// The protocol's own error.
    pub(super) fn raise_error(&mut self, code: u16, lasts: bool, firmware: &impl Firmware) {
        self.emergencies.communication_error |= lasts;
        // Bit 0 is set beside any other (CiA 301, 7.5.2.2).
        let register = self.error_register(firmware) | COMMUNICATION | 1;
        self.queue_emergency(Emergency { code, register, vendor: [0; 5] });
    }

    /// Ends a lasting error.
    pub(super) fn clear_error(&mut self, firmware: &impl Firmware) {
        if core::mem::take(&mut self.emergencies.communication_error) {
            let register = self.error_register(firmware);
            self.queue_emergency(Emergency { code: 0, register, vendor: [0; 5] });
        }
    }

    /// Takes the emergencies that the firmware has.
    #[inline]
    pub(super) fn collect_emergencies(&mut self, now: Instant, firmware: &mut impl Firmware) {
        while let Some(mut emergency) = firmware.poll_emergency() {
            emergency.register = self.error_register(firmware);
            let is_fault = emergency.code != 0 && emergency.register & !COMMUNICATION != 0;
            self.queue_emergency(emergency);
            if is_fault {
                self.apply_error_behaviour(now, 1, firmware);
            }
        }
    }

    /// The next emergency that may be sent now.
    pub(super) fn next_emergency(&mut self, now: Instant) -> Option<Frame> {
        let cob = CobId(self.communication.emcy_cob);
        let speaks = matches!(self.state, NmtState::Operational | NmtState::PreOperational);
        self.send_slots.set_emergencies(self.emergencies.queue_len > 0);
        if self.emergencies.queue_len == 0 || !speaks || now < self.emergencies.free_at {
            return None;
        }
        let first = self.emergencies.queue[0];
        self.emergencies.queue.rotate_left(1);
        debug_assert!(self.emergencies.queue_len > 0);
        self.emergencies.queue_len -= 1;
        if !cob.is_valid() || (self.quirks.short_emcy && first.code == 0) {
            return self.next_emergency(now);
        }
        // In tenths of a millisecond (CiA 301, 1015h).
        let inhibit = u64::from(self.communication.emcy_inhibit) * 100_000;
        self.emergencies.free_at = now.plus_ns(inhibit);
        if inhibit > 0 {
            self.schedule(self.emergencies.free_at);
        }
        let whole = first.emit(self.node);
        let whole = if self.quirks.short_emcy { first.emit_short(self.node) } else { whole };
        Some(Frame { id: cob.id(), ..whole })
    }
}
