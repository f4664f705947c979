//! Timers for values inside or outside a window.

use super::Window;

/// Duration of a condition, in ticks of a millisecond.
#[derive(Clone, Copy, Debug, Default)]
pub struct WindowTimer {
    ticks: u32,
}

impl WindowTimer {
    /// Takes one tick. True once it has been so for longer than `ms`.
    #[inline]
    pub const fn tick(&mut self, so: bool, ms: u32) -> bool {
        self.ticks = if so { self.ticks.saturating_add(1) } else { 0 };
        self.ticks > ms
    }

    /// Updates the timer with a distance that is to be within `window`.
    pub fn within(&mut self, distance: f64, window: Window) -> bool {
        self.tick(distance.abs() <= window.width, window.ms)
    }

    /// Updates the timer with a distance that is to be beyond it.
    #[inline]
    pub fn beyond(&mut self, distance: f64, window: Window) -> bool {
        self.tick(distance.abs() > window.width, window.ms)
    }

    /// Resets the timer.
    pub const fn reset(&mut self) {
        self.ticks = 0;
    }
}
