//! Interpolates between two cyclic set-points of the host.

use crate::plant::{Setpoint, TICK_S, TICKS_PER_S, clamp_abs};

/// A straight way from one commanded position to the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct Interpolator {
    position: f64,
    target: f64,
    velocity: f64,
    ticks_left: u32,
}

impl Interpolator {
    /// At rest at `position`, rad.
    #[must_use]
    pub const fn at_rest(position: f64) -> Self {
        Self { position, target: position, velocity: 0.0, ticks_left: 0 }
    }

    /// The cycle is over.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.ticks_left == 0
    }

    /// Present position, rad.
    #[must_use]
    pub const fn position(&self) -> f64 {
        self.position
    }

    /// Sets the target `position` (rad), to be reached within `ticks`.
    pub const fn set_target(&mut self, position: f64, ticks: u32) {
        self.target = position;
        self.ticks_left = if ticks == 0 { 1 } else { ticks };
    }

    /// One tick, at most as fast as `top` (rad/s), with `offset` added to the speed that is fed
    /// forward.
    #[inline]
    pub fn step(&mut self, top: f64, offset: f64) -> Setpoint {
        let (mut way, max) = (self.target - self.position, top * TICK_S);
        if self.ticks_left > 1 {
            way /= f64::from(self.ticks_left);
        }
        let way = clamp_abs(way, max);
        self.ticks_left = self.ticks_left.saturating_sub(1);
        self.position += way;
        let before = core::mem::replace(&mut self.velocity, way * TICKS_PER_S);
        let acceleration = (self.velocity - before) * TICKS_PER_S;
        Setpoint { position: self.position, velocity: self.velocity + offset, acceleration }
    }
}
