//! A body that is heated by losses and cooled by air.

/// One thermal mass: a winding, a power stage.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ThermalModel {
    /// To the air, K/W.
    pub resistance: f64,
    /// Heat capacity of the body, J/K.
    pub capacity: f64,
    /// Temperature of the air, °C.
    pub ambient: f64,
    temperature: f64,
}

impl ThermalModel {
    /// A body as warm as the air. `resistance` in K/W, `capacity` in J/K, `ambient` in °C.
    #[must_use]
    pub const fn new(resistance: f64, capacity: f64, ambient: f64) -> Self {
        Self { resistance, capacity, ambient, temperature: ambient }
    }

    /// Temperature, °C.
    #[must_use]
    pub const fn temperature(&self) -> f64 {
        self.temperature
    }

    /// Makes it so warm, °C.
    pub const fn set_temperature(&mut self, temperature: f64) {
        self.temperature = temperature;
    }

    /// Advances by `dt` seconds with `loss` watts going in. Stable at any `dt`.
    pub fn step(&mut self, loss: f64, dt: f64) {
        debug_assert!(dt >= 0.0 && self.resistance * self.capacity + dt > 0.0);
        // Implicit: stable for any step, also one that is longer than the time constant.
        let share = dt / (self.resistance * self.capacity + dt);
        let goal = self.ambient + loss * self.resistance;
        self.temperature += share * (goal - self.temperature);
    }
}
