//! The physics: motor, load, trajectory, servo loops, thermal model, encoder.
//!
//! Everything is in SI and computed in ticks of [`TICK_NS`]. This module knows no drive or protocol. A
//! simulated drive has a [`Servo`] and a [`Motor`], and computes the ticks up to `now` at each request:
//!
//! ```
//! use polepair_core::plant::{Conditions, Goal, Motor, MotorParameters, Servo};
//! let mut motor = Motor::new(MotorParameters::BLDC_24V);
//! let mut servo = Servo::new(motor.parameters());
//! servo.enable(&motor);
//! servo.set_goal(Goal::Velocity(100.0));
//! for _ in 0..1000 {
//!     servo.step(&mut motor, Conditions { bus: 24.0, load: 0.05 });
//! }
//! assert!((motor.velocity() - 100.0).abs() < 0.1);
//! ```

mod encoder;
mod motor;
mod servo;
mod shaft;
mod stepper;
mod thermal;
pub mod trajectory;

#[cfg(test)]
mod tests;

pub use encoder::Encoder;
pub use motor::{Energy, Inputs, Motor, MotorParameters, Winding};
pub use servo::{Conditions, Gains, Goal, Servo, ServoBounds, StallDetector};
pub use shaft::ServoShaft;
pub use stepper::{Stepper, StepperInputs, StepperParameters};
pub use thermal::ThermalModel;
pub use trajectory::{Limits, Setpoint, Trajectory};

use crate::time::Instant;

/// Nanoseconds of a tick: current, speed and position loops run at 1 kHz.
pub const TICK_NS: u64 = 1_000_000;

/// Length of a tick, s.
pub const TICK_S: f64 = 1e-3;

/// Ticks per second.
pub const TICKS_PER_S: f64 = 1e3;

/// Most ticks that [`Ticks`] runs at one call: a day, so that a clock gone wrong cannot hang it.
pub const TICKS_MAX: u64 = 86_400_000;

/// Progress of a lazily advanced plant.
///
/// ```
/// use polepair_core::{plant::Ticks, time::Instant};
/// let mut ticks = Ticks::new(Instant::ZERO);
/// assert_eq!(ticks.advance_to(Instant(2_500_000)), 2);
/// assert_eq!(ticks.advance_to(Instant(3_000_000)), 1);
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ticks {
    at: Instant,
}

impl Ticks {
    /// Ticks that start at `now`.
    #[must_use]
    pub const fn new(now: Instant) -> Self {
        Self { at: now }
    }

    /// Advances to `now`, and returns the number of whole ticks since the last call.
    #[inline]
    #[must_use]
    pub fn advance_to(&mut self, now: Instant) -> u64 {
        let since = now.0.saturating_sub(self.at.0);
        // Most often none is over.
        if since < TICK_NS {
            return 0;
        }
        let ticks = since / TICK_NS;
        self.at = self.at.plus_ns(ticks * TICK_NS);
        ticks.min(TICKS_MAX)
    }

    /// The instant that the last tick ended.
    #[must_use]
    pub const fn at(&self) -> Instant {
        self.at
    }
}

/// `value` within ±`most`.
#[inline]
pub(crate) fn clamp_abs(value: f64, max: f64) -> f64 {
    // Two instructions, unlike `clamp`, which looks at `most` as well.
    let below = if value > max { max } else { value };
    if below < -max { -max } else { below }
}

/// `value` with the sign of `sign`, zero when `sign` is zero.
#[inline]
fn with_sign(value: f64, sign: f64) -> f64 {
    if sign > 0.0 {
        value
    } else if sign < 0.0 {
        -value
    } else {
        0.0
    }
}
