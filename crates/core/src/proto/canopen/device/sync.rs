//! SYNC and the time of day: heard, and produced where objects 1005h and 1012h say so.

use super::{CanEnd, Firmware, emcy};
use crate::medium::Frame;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::pdo::CobId;
use crate::proto::canopen::time::TimeOfDay;
use crate::time::Instant;

/// A producer of TIME sends so often, ms \[I\]: no object says.
const TIME_EVERY_MS: u32 = 1000;

/// What is known of SYNC.
#[derive(Clone, Debug)]
#[repr(C)]
pub(super) struct Sync {
    /// The next one of its own.
    produce_at: Instant,
    /// The next time of day of its own.
    time_at: Instant,
    counter: u8,
    /// Bytes that it has: one where it counts (1019h).
    bytes: u8,
    /// Its identifier.
    pub(super) id: u32,
    /// Until when what belongs to the last one may be sent and taken (1007h).
    pub(super) open_until: Instant,
    /// How long that is, ns; 0 is for ever.
    window_ns: u64,
}

impl Default for Sync {
    fn default() -> Self {
        let far = Instant::FAR;
        Self {
            id: 0x80,
            open_until: far,
            window_ns: 0,
            bytes: 0,
            produce_at: far,
            time_at: far,
            counter: 0,
        }
    }
}

impl Sync {
    pub(super) fn due(&self) -> Instant {
        self.produce_at.min(self.time_at)
    }
}

impl<const N: usize> CanEnd<N> {
    /// The objects of SYNC and TIME were written, or the node boots.
    pub(super) fn apply_sync(&mut self, now: Instant) {
        let cob = CobId(self.comm.sync_cob);
        let bytes = u8::from(self.comm.sync_overflow != 0);
        self.sync = Sync { id: cob.id(), bytes, ..Sync::default() };
        self.apply_window();
        let produces = self.comm.sync_cob & CobId::FLAG != 0 && self.comm.sync_period_us > 0;
        if produces {
            self.sync.produce_at = now.plus_ns(u64::from(self.comm.sync_period_us) * 1000);
            self.arm(self.sync.produce_at);
        }
        if self.comm.time_cob & CobId::FLAG != 0 && self.options.time {
            self.sync.time_at = now.plus_ms(TIME_EVERY_MS);
            self.arm(self.sync.time_at);
        }
    }

    /// 1007h was written, or the node boots.
    pub(super) fn apply_window(&mut self) {
        self.sync.window_ns = u64::from(self.comm.sync_window_us) * 1000;
        self.sync.open_until = Instant::FAR;
    }

    /// A SYNC: what waits for it is taken, then what goes with it is sampled.
    #[inline]
    pub(super) fn synced(&mut self, now: Instant, data: &[u8], firmware: &mut impl Firmware) {
        if data.len() != usize::from(self.sync.bytes) {
            return self.raise(emcy::SYNC_LENGTH, false, firmware);
        }
        let counter = data.first().copied().unwrap_or(0);
        if self.sync.window_ns > 0 {
            self.sync.open_until = now.plus_ns(self.sync.window_ns);
        }
        if self.state != State::Operational {
            return;
        }
        self.take_waiting(now, firmware);
        firmware.synced(now);
        self.sample(counter, firmware);
    }

    pub(super) fn sync_timers(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let speaks = matches!(self.state, State::Operational | State::PreOperational);
        if now >= self.sync.produce_at {
            let period = u64::from(self.comm.sync_period_us) * 1000;
            self.sync.produce_at = self.sync.produce_at.plus_ns(period).max(now);
            if speaks {
                self.produce(now, firmware);
            }
        }
        if now >= self.sync.time_at {
            self.sync.time_at = now.plus_ms(TIME_EVERY_MS);
            let cob = CobId(self.comm.time_cob);
            let time = firmware.time_of_day(now).filter(|_| speaks);
            if let Some(time) = time {
                self.mail.time(Frame { id: cob.id(), ..time.emit() });
            }
        }
    }

    fn produce(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let overflow = self.comm.sync_overflow;
        self.sync.counter = if self.sync.counter >= overflow { 1 } else { self.sync.counter + 1 };
        let counter = (overflow > 0).then_some(self.sync.counter);
        self.mail.sync(counter);
        // Its own PDOs go by it too.
        self.synced(now, counter.as_slice(), firmware);
    }

    pub(super) fn sync_frame(&self, counter: Option<u8>) -> Frame {
        let sync = crate::proto::canopen::sync::Sync { counter };
        Frame { id: self.sync.id, ..sync.emit() }
    }

    pub(super) fn heard_time(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let takes = self.options.time && self.comm.time_cob & CobId::INVALID != 0;
        if let Ok(time) = TimeOfDay::parse(frame.bytes())
            && takes
        {
            firmware.clock(now, time);
        }
    }
}
