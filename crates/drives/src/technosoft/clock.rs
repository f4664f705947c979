//! The time of a drive: its quartz, its slow loop, and the master's time that it follows.

use super::options::Options;
use polepair_core::convert::saturating;
use polepair_core::plant::{TICK_NS, Ticks};
use polepair_core::time::Instant;

/// The clock of a drive. The loops of the model run at 1 kHz of its own time; what programs and
/// hosts see is counted in slow loop periods.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriveClock {
    ppm: i32,
    slow_ns: u64,
    ticks: Ticks,
    /// Ticks that were taken and are still to be run.
    pub unfinished: u64,
    /// Own time at which absolute time was zero, ns; may lie before the start.
    absolute_zero: i64,
    /// Tick at which relative time was zero.
    relative_zero: i64,
}

impl DriveClock {
    /// A clock that starts at `now`.
    pub fn new(options: &Options, now: Instant) -> Self {
        let mut new = Self {
            ppm: options.clock_ppm,
            slow_ns: options.slow_ns,
            ticks: Ticks::new(Instant::ZERO),
            unfinished: 0,
            absolute_zero: 0,
            relative_zero: 0,
        };
        let own = new.own_time(now);
        new.ticks = Ticks::new(own);
        (new.absolute_zero, new.relative_zero) = (own.0.cast_signed(), own.0.cast_signed());
        new
    }

    /// Whole ticks up to `now`; they count as done.
    pub fn take_ticks(&mut self, now: Instant) -> u64 {
        let own = self.own_time(now);
        self.ticks.advance_to(own)
    }

    /// Absolute time (ATIME), slow loop periods, as of `now`.
    pub fn absolute_time(&self, now: Instant) -> u32 {
        self.periods(now, self.absolute_zero)
    }

    /// Relative time (RTIME), slow loop periods, as of `now`.
    pub fn relative_time(&self, now: Instant) -> u32 {
        self.periods(now, self.relative_zero)
    }

    /// Makes absolute time read `periods` at `now`.
    pub fn set_absolute(&mut self, now: Instant, periods: u32) {
        self.absolute_zero = self.zero_for(now, periods);
    }

    /// Makes relative time read `periods` at `now`.
    pub fn set_relative(&mut self, now: Instant, periods: u32) {
        self.relative_zero = self.zero_for(now, periods);
    }

    /// Moves absolute time by `periods`.
    pub fn adjust_absolute(&mut self, periods: i32) {
        self.absolute_zero -= i64::from(periods) * self.slow_ns.cast_signed();
    }

    /// The instant `count` ticks from now.
    pub fn after_ticks(&self, count: u64) -> Instant {
        let own = self.ticks.at().0.saturating_sub(self.unfinished * TICK_NS);
        let own = Instant(own).plus_ns(count * TICK_NS);
        if self.ppm == 0 {
            return own;
        }
        let own = i128::from(own.0);
        let world = own * 1_000_000 / (1_000_000 + i128::from(self.ppm)) + 1;
        Instant(saturating(world))
    }

    /// The end of the last tick, as of which everything is known, in the world's time.
    pub fn now(&self) -> Instant {
        self.after_ticks(0)
    }

    fn own_time(&self, now: Instant) -> Instant {
        if self.ppm == 0 {
            return now;
        }
        let drift = i128::from(now.0) * i128::from(self.ppm) / 1_000_000;
        Instant(u64::try_from(i128::from(now.0) + drift).unwrap_or(0))
    }

    fn periods(&self, now: Instant, zero: i64) -> u32 {
        let since = self.own_time(now).0.cast_signed() - zero;
        since.div_euclid(self.slow_ns.cast_signed()) as u32
    }

    fn zero_for(&self, now: Instant, periods: u32) -> i64 {
        let span = i64::from(periods).saturating_mul(self.slow_ns.cast_signed());
        self.own_time(now).0.cast_signed() - span
    }
}
