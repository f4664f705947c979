//! Synchronised time of several drives: a master sends its time, the others follow.
//!
//! Source: TML communication manual, chapter 5, example 4. At the synchronisation message each drive
//! latches its time. Then the master sends its latched time, and the others correct the difference. The
//! period is in slow loops.

use super::drive::Drive;
use polepair_core::plant::TICK_NS;
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::wire::{IdCode, Message};
use polepair_core::time::Instant;

/// A drive's part in keeping time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct TimeSync {
    /// Ticks from one synchronisation to the next, zero in a slave.
    period_ticks: u64,
    ticks_left: u64,
    latched_time: u32,
}

impl TimeSync {
    /// Synchronisation of a slave, which sends no messages.
    pub const SLAVE: Self = Self { period_ticks: 0, ticks_left: 0, latched_time: 0 };

    /// Ticks to the next synchronisation that this drive sends.
    pub fn ticks_left(&self) -> Option<u64> {
        (self.period_ticks > 0).then_some(self.ticks_left.max(1))
    }
}

impl Drive {
    /// SETSYNC: this drive becomes the master and synchronises every `periods` slow loop periods; 0 ends it. Less than
    /// a tick of the model is a tick.
    pub fn set_sync(&mut self, periods: u32) {
        let ns = u64::from(periods) * self.options.slow_ns;
        self.sync.period_ticks = if periods == 0 { 0 } else { (ns / TICK_NS).max(1) };
        self.sync.ticks_left = self.sync.period_ticks;
    }

    /// Latches the time of a synchronisation message, received or sent.
    pub fn latch_time(&mut self, now: Instant) {
        self.sync.latched_time = self.clock.absolute_time(now);
    }

    /// The master's time at the last synchronisation.
    pub fn follow_master(&mut self, master: u32) {
        if self.sync.period_ticks == 0 {
            self.clock.adjust_absolute(master.wrapping_sub(self.sync.latched_time).cast_signed());
            self.sync.latched_time = master;
            self.mark_stale();
        }
    }

    /// Sends the synchronisation message when it is time.
    #[inline]
    pub fn tick_sync(&mut self) {
        if self.sync.period_ticks == 0 {
            return;
        }
        self.sync.ticks_left -= 1;
        if self.sync.ticks_left == 0 {
            self.sync.ticks_left = self.sync.period_ticks;
            self.send(IdCode::BROADCAST, OnlineMessage::Synchronisation.emit());
        }
    }

    /// Handles a sent message: after a synchronisation message, its time of sending follows.
    pub fn handle_sent(&mut self, now: Instant, message: &Message) {
        if message.instruction == OnlineMessage::Synchronisation.emit() {
            self.latch_time(now);
            self.send(IdCode::BROADCAST, OnlineMessage::MasterTime(self.sync.latched_time).emit());
        }
    }
}
