//! Water around a propeller: it takes torque and gives thrust, both by the square of the speed.

/// A propeller in water at rest.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Water {
    /// Torque that it takes, N·m·s².
    pub drag: f64,
    /// Thrust that it gives, N·s².
    pub thrust: f64,
}

impl Water {
    /// No propeller.
    pub const NONE: Self = Self { drag: 0.0, thrust: 0.0 };
    /// A propeller of 15 cm: 1.7 N·m and 90 N at 3,200 rpm. \[I\]
    pub const PROPELLER: Self = Self { drag: 1.5e-5, thrust: 8e-4 };

    /// Torque on the shaft at a speed (rad/s), N·m: always against it.
    #[must_use]
    pub fn drag_torque(&self, velocity: f64) -> f64 {
        -self.drag * velocity * velocity.abs()
    }

    /// Thrust at a speed (rad/s), N; forward if the speed is.
    #[must_use]
    pub fn thrust(&self, velocity: f64) -> f64 {
        self.thrust * velocity * velocity.abs()
    }
}
