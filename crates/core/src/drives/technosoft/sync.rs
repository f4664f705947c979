//! One time for all drives: a master tells its time, the others follow.
//!
//! Source: TML communication manual, chapter 5, example 4. At the synchronisation message each
//! drive latches its time; then the master tells what it latched, and the others go by the
//! difference. The unit of the period is the slow loop.

use super::drive::Drive;
use crate::plant::TICK_NS;
use crate::proto::tml::online::Online;
use crate::proto::tml::wire::{IdCode, Message};
use crate::time::Instant;

/// A drive's part in keeping time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Sync {
    /// Ticks from one synchronisation to the next, zero in a slave.
    every: u64,
    left: u64,
    latched: u32,
}

impl Sync {
    /// A slave.
    pub const SLAVE: Self = Self { every: 0, left: 0, latched: 0 };

    /// Ticks to the next synchronisation that this drive sends.
    pub fn ticks_left(&self) -> Option<u64> {
        (self.every > 0).then_some(self.left.max(1))
    }
}

impl Drive {
    /// SETSYNC: from now on this drive is the master and synchronises every so many periods; 0
    /// ends it. Less than a tick of the model is a tick.
    pub fn set_sync(&mut self, periods: u32) {
        let ns = u64::from(periods) * self.options.slow_ns;
        self.sync.every = if periods == 0 { 0 } else { (ns / TICK_NS).max(1) };
        self.sync.left = self.sync.every;
    }

    /// A synchronisation message came, or went out.
    pub fn latch_time(&mut self, now: Instant) {
        self.sync.latched = self.clock.absolute(now);
    }

    /// The master's time at the last synchronisation.
    pub fn follow_master(&mut self, master: u32) {
        if self.sync.every == 0 {
            self.clock.correct(master.wrapping_sub(self.sync.latched).cast_signed());
            self.sync.latched = master;
            self.stale();
        }
    }

    /// Sends the synchronisation message when it is time.
    #[inline]
    pub fn tick_sync(&mut self) {
        if self.sync.every == 0 {
            return;
        }
        self.sync.left -= 1;
        if self.sync.left == 0 {
            self.sync.left = self.sync.every;
            self.send(IdCode::BROADCAST, Online::Synchronisation.emit());
        }
    }

    /// A message goes out: behind a synchronisation follows the time at which it went.
    pub fn sent(&mut self, now: Instant, message: &Message) {
        if message.instruction == Online::Synchronisation.emit() {
            self.latch_time(now);
            self.send(IdCode::BROADCAST, Online::MasterTime(self.sync.latched).emit());
        }
    }
}
