//! The data logger: variables sampled in the slow or the fast loop into a buffer of the drive's RAM.
//!
//! Sources: see [`polepair_core::proto::tml::logger`]. The model computes once a millisecond, so samples of the
//! fast loop repeat its values.

use super::addresses;
use super::drive::Drive;
use polepair_core::data_logger::LogHead;
use polepair_core::plant::TICK_NS;
use polepair_core::proto::tml::logger::{BUFFER_BITS, FAST_LOOP, FAST_LOOPS, LOOP_BITS, SLOW_LOOP};
use polepair_core::proto::tml::online::MemorySpace as Space;

/// Progress of the logger in its buffer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct DataLogger {
    /// Points taken since the start.
    taken: u16,
    /// Loops since the last point.
    loops: u16,
    /// Time since the last loop, ns.
    since_loop_ns: u64,
}

impl DataLogger {
    /// Off.
    pub const OFF: Self = Self { taken: 0, loops: 0, since_loop_ns: 0 };
}

impl Drive {
    /// Returns whether points are still to come.
    pub fn is_logging(&self) -> bool {
        let pointer = self.memory.word(addresses::LOG_PTR);
        pointer & LOOP_BITS != 0
            && self.memory.word((pointer & BUFFER_BITS) + LogHead::POINTS_LEFT) > 0
    }

    /// Takes the points of a tick.
    #[inline]
    pub fn tick_logger(&mut self) {
        if !self.is_logging() {
            self.logger = DataLogger::OFF;
            return;
        }
        let loop_ns = match self.memory.word(addresses::LOG_PTR) & LOOP_BITS {
            SLOW_LOOP => self.options.slow_ns,
            FAST_LOOP => self.options.slow_ns / u64::from(FAST_LOOPS),
            _ => return,
        };
        self.publish();
        self.logger.since_loop_ns += TICK_NS;
        while self.logger.since_loop_ns >= loop_ns {
            self.logger.since_loop_ns -= loop_ns;
            self.log_loop();
        }
    }

    /// A loop of the controller: takes a point if it is time.
    fn log_loop(&mut self) {
        let buffer = self.memory.word(addresses::LOG_PTR) & BUFFER_BITS;
        let left = self.memory.word(buffer + LogHead::POINTS_LEFT);
        let period = self.memory.word(buffer + LogHead::PERIOD).max(1);
        self.logger.loops += 1;
        if left == 0 || self.logger.loops < period {
            return;
        }
        self.logger.loops = 0;
        let count = self.memory.word(buffer + LogHead::WORDS);
        let data = u32::from(buffer) + u32::from(LogHead::len_for(count));
        let first = data + u32::from(self.logger.taken) * u32::from(count);
        for n in 0..count {
            let Ok(to) = u16::try_from(first + u32::from(n)) else { return };
            let address = self.memory.word(buffer.wrapping_add(LogHead::ADDRESSES + n));
            let value = self.memory.word(address);
            // Behind the end of memory nothing is stored.
            if self.memory.write(Space::Data, to, value).is_err() {
                return;
            }
        }
        self.logger.taken += 1;
        self.memory.set(buffer + LogHead::POINTS_LEFT, left - 1);
    }
}
