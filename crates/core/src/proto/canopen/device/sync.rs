//! SYNC and TIME: received, and produced if objects 1005h and 1012h are set so.

use super::{CanEndpoint, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::pdo::CobId;
use crate::proto::canopen::time::TimeOfDay;
use crate::time::Instant;

/// Interval of a producer of TIME, ms \[I\]: no object defines it.
const TIME_EVERY_MS: u32 = 1000;

/// State of SYNC.
#[derive(Clone, Debug)]
#[repr(C)]
pub(super) struct SyncState {
    /// The next one of its own.
    produce_at: Instant,
    /// The next time of day of its own.
    time_at: Instant,
    counter: u8,
    /// Bytes that it has: one where it counts (1019h).
    frame_len: u8,
    /// CAN identifier.
    pub(super) id: u32,
    /// Until when what belongs to the last one may be sent and taken (1007h).
    pub(super) window_until: Instant,
    /// Length of the window, ns; 0 is for ever.
    window_ns: u64,
}

impl Default for SyncState {
    fn default() -> Self {
        let far = Instant::FAR_FUTURE;
        Self {
            id: 0x80,
            window_until: far,
            window_ns: 0,
            frame_len: 0,
            produce_at: far,
            time_at: far,
            counter: 0,
        }
    }
}

impl SyncState {
    pub(super) fn due(&self) -> Instant {
        self.produce_at.min(self.time_at)
    }
}

impl<const N: usize> CanEndpoint<N> {
    /// The objects of SYNC and TIME were written, or the node boots.
    pub(super) fn apply_sync(&mut self, now: Instant) {
        let cob = CobId(self.communication.sync_cob);
        let bytes = u8::from(self.communication.sync_overflow != 0);
        self.sync = SyncState { id: cob.id(), frame_len: bytes, ..SyncState::default() };
        self.apply_window();
        let produces =
            self.communication.sync_cob & CobId::FLAG != 0 && self.communication.sync_period_us > 0;
        if produces {
            self.sync.produce_at = now.plus_ns(u64::from(self.communication.sync_period_us) * 1000);
            self.schedule(self.sync.produce_at);
        }
        if self.communication.time_cob & CobId::FLAG != 0 && self.quirks.time {
            self.sync.time_at = now.plus_ms(TIME_EVERY_MS);
            self.schedule(self.sync.time_at);
        }
    }

    /// 1007h was written, or the node boots.
    pub(super) fn apply_window(&mut self) {
        self.sync.window_ns = u64::from(self.communication.sync_window_us) * 1000;
        self.sync.window_until = Instant::FAR_FUTURE;
    }

    /// A SYNC: received values that wait for it are applied, then values that are sent with it are sampled.
    #[inline]
    pub(super) fn handle_sync(&mut self, now: Instant, data: &[u8], firmware: &mut impl Firmware) {
        if data.len() != usize::from(self.sync.frame_len) {
            return self.raise_error(emcy::SYNC_LENGTH, false, firmware);
        }
        let counter = data.first().copied().unwrap_or(0);
        if self.sync.window_ns > 0 {
            self.sync.window_until = now.plus_ns(self.sync.window_ns);
        }
        if self.state != NmtState::Operational {
            return;
        }
        self.apply_waiting_rpdos(now, firmware);
        firmware.handle_sync(now);
        self.sample_tpdos(counter, firmware);
    }

    pub(super) fn run_sync_timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let speaks = matches!(self.state, NmtState::Operational | NmtState::PreOperational);
        if now >= self.sync.produce_at {
            let period = u64::from(self.communication.sync_period_us) * 1000;
            self.sync.produce_at = self.sync.produce_at.plus_ns(period).max(now);
            if speaks {
                self.produce_sync(now, firmware);
            }
        }
        if now >= self.sync.time_at {
            self.sync.time_at = now.plus_ms(TIME_EVERY_MS);
            let cob = CobId(self.communication.time_cob);
            let time = firmware.time_of_day(now).filter(|_| speaks);
            if let Some(time) = time {
                self.send_slots.set_time(Frame { id: cob.id(), ..time.emit() });
            }
        }
    }

    fn produce_sync(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let overflow = self.communication.sync_overflow;
        self.sync.counter = if self.sync.counter >= overflow { 1 } else { self.sync.counter + 1 };
        let counter = (overflow > 0).then_some(self.sync.counter);
        self.send_slots.set_sync(counter);
        // Its own PDOs go by it too.
        self.handle_sync(now, counter.as_slice(), firmware);
    }

    pub(super) fn sync_frame(&self, counter: Option<u8>) -> Frame {
        let sync = crate::proto::canopen::sync::SyncMessage { counter };
        Frame { id: self.sync.id, ..sync.emit() }
    }

    pub(super) fn handle_time(
        &mut self,
        now: Instant,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let takes = self.quirks.time && self.communication.time_cob & CobId::INVALID != 0;
        if let Ok(time) = TimeOfDay::parse(frame.bytes())
            && takes
        {
            firmware.set_time_of_day(now, time);
        }
    }
}
