//! The drive's internal units (drive manuals, chapter 6 "Scaling factors").

/// Peak current of the power stage, A. \[I\] that of a mid-size drive.
pub(super) const PEAK_A: f64 = 20.0;
/// Highest DC voltage that the drive can measure, V. \[I\]
pub(super) const MEASURED_V: f64 = 102.4;
/// I2TINTLIM_M from the factory: twice the nominal current for three seconds.
pub(super) const I2T_LIMIT: i32 = 900_000;
/// Unit of the I2t integral, A²·s, such that [`I2T_LIMIT`] is 900 A²·s. \[I\]
pub(super) const I2T_A2S: f64 = 1e-3;

/// Current in A of internal units: 65,520 of them are twice the peak current.
pub(super) fn amperes_of_units(units: i16) -> f64 {
    f64::from(units) * 2.0 * PEAK_A / 65_520.0
}

/// Internal units of a current in A.
pub(super) fn units_of_amperes(ampere: f64) -> i16 {
    libm::round(ampere * 65_520.0 / (2.0 * PEAK_A)) as i16
}

/// DC voltage in V of internal units.
pub(super) fn volts_of_units(units: u16) -> f64 {
    f64::from(units) * MEASURED_V / 65_520.0
}

/// Internal units of a DC voltage in V.
pub(super) fn units_of_volts(volt: f64) -> u16 {
    libm::round(volt * 65_520.0 / MEASURED_V) as u16
}

/// Counts, and how they relate to the shaft and to time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct CountScale {
    /// Counts of a radian.
    pub per_rad: f64,
    /// Slow loop period, s.
    pub slow_s: f64,
}

impl CountScale {
    /// Speed in rad/s of counts a slow loop period.
    pub fn speed_of_counts(&self, counts: f64) -> f64 {
        counts / (self.per_rad * self.slow_s)
    }

    /// Counts a slow loop period of a speed in rad/s.
    pub fn counts_of_speed(&self, speed: f64) -> f64 {
        speed * self.per_rad * self.slow_s
    }

    /// Acceleration in rad/s² of counts a squared slow loop period.
    pub fn acceleration_of_counts(&self, counts: f64) -> f64 {
        counts / (self.per_rad * self.slow_s * self.slow_s)
    }

    /// Counts a squared slow loop period of an acceleration in rad/s².
    pub fn counts_of_acceleration(&self, acceleration: f64) -> f64 {
        acceleration * self.per_rad * self.slow_s * self.slow_s
    }
}
