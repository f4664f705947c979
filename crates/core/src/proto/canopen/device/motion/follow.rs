//! Set-points that the host makes cycle by cycle: the way between two of them.

use crate::plant::{Setpoint, TICK_S, TICKS_PER_S, cut};

/// A straight way from one commanded position to the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cycle {
    at: f64,
    to: f64,
    velocity: f64,
    left: u32,
}

impl Cycle {
    /// At rest at `position`, rad.
    #[must_use]
    pub const fn resting(position: f64) -> Self {
        Self { at: position, to: position, velocity: 0.0, left: 0 }
    }

    /// The cycle is over.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.left == 0
    }

    /// Where it is now, rad.
    #[must_use]
    pub const fn at(&self) -> f64 {
        self.at
    }

    /// To be at `position` (rad) within so many ticks.
    pub const fn aim(&mut self, position: f64, ticks: u32) {
        self.to = position;
        self.left = if ticks == 0 { 1 } else { ticks };
    }

    /// One tick, at most as fast as `top` (rad/s), with `offset` added to the speed that is fed
    /// forward.
    #[inline]
    pub fn step(&mut self, top: f64, offset: f64) -> Setpoint {
        let (mut way, most) = (self.to - self.at, top * TICK_S);
        if self.left > 1 {
            way /= f64::from(self.left);
        }
        let way = cut(way, most);
        self.left = self.left.saturating_sub(1);
        self.at += way;
        let before = core::mem::replace(&mut self.velocity, way * TICKS_PER_S);
        let acceleration = (self.velocity - before) * TICKS_PER_S;
        Setpoint { position: self.at, velocity: self.velocity + offset, acceleration }
    }
}
