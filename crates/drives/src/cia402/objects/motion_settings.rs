//! Settings of the motion from the objects, in SI units.

use polepair_core::proto::canopen::device::motion::{
    CyclicOffsets, MotionLimits, MotionWindows, StopReactions, modes,
};

use super::*;

impl MotionLimits for Objects {
    fn profile(&self) -> Limits {
        if self.is_in_velocity_mode() {
            return self.velocity_mode_limits();
        }
        let top = self
            .real_value(stored::PROFILE_VELOCITY)
            .min(self.real_value(stored::MAX_PROFILE_VELOCITY));
        Limits {
            velocity: top * self.rad_per_velocity_unit,
            acceleration: self.rad_value(stored::ACCELERATION),
            deceleration: self.rad_value(stored::DECELERATION),
            smoothing_s: 0.0,
        }
    }

    fn torque_slope(&self) -> f64 {
        self.real_value(stored::TORQUE_SLOPE) / 1000.0
    }

    fn quick_stop(&self) -> f64 {
        self.rad_value(stored::QUICK_STOP)
    }

    #[inline]
    fn velocity_max(&self) -> f64 {
        let motor = self.real_value(stored::MAX_MOTOR_SPEED) * RPM;
        if self.is_in_velocity_mode() {
            return motor.min(self.real_value(stored::VL_MAX) * self.velocity_mode_unit());
        }
        self.rad_value(stored::MAX_PROFILE_VELOCITY).min(motor)
    }

    fn torque_limits(&self) -> (f64, f64) {
        let max = self.real_value(stored::MAX_TORQUE);
        let [backward, forward] = [stored::BACKWARD_TORQUE, stored::FORWARD_TORQUE]
            .map(|limit| self.real_value(limit).min(max) / 1000.0);
        (backward, forward)
    }

    #[inline]
    fn position_limits(&self) -> Option<(f64, f64)> {
        let (min, greatest) = (stored::POSITION_MIN, stored::POSITION_MAX);
        let are_set = self.value(min) < self.value(greatest);
        let (one, other) = (
            self.real_value(min) * self.rad_per_position,
            self.real_value(greatest) * self.rad_per_position,
        );
        are_set.then(|| (one.min(other), one.max(other)))
    }
}

impl MotionWindows for Objects {
    fn position_window(&self) -> Window {
        self.window(stored::POSITION_WINDOW, stored::POSITION_TIME)
    }

    #[inline]
    fn following_window(&self) -> Window {
        self.window(stored::FOLLOWING_WINDOW, stored::FOLLOWING_TIME)
    }

    fn velocity_window(&self) -> Window {
        self.window(stored::VELOCITY_WINDOW, stored::VELOCITY_TIME)
    }

    fn standstill(&self) -> Window {
        self.window(stored::STANDSTILL, stored::STANDSTILL_TIME)
    }
}

impl StopReactions for Objects {
    fn quick_stop_option(&self) -> (Braking, bool) {
        let stays = self.value(stored::QUICK_STOP_OPTION) >= 5;
        (self.braking_option(stored::QUICK_STOP_OPTION), stays)
    }

    fn shutdown_option(&self) -> Braking {
        self.braking_option(stored::SHUTDOWN_OPTION)
    }

    fn disable_option(&self) -> Braking {
        self.braking_option(stored::DISABLE_OPTION)
    }

    fn halt_option(&self) -> Braking {
        self.braking_option(stored::HALT_OPTION)
    }

    fn fault_option(&self) -> Braking {
        self.braking_option(stored::FAULT_OPTION)
    }
}

impl MotionSettings for Objects {
    #[inline]
    fn mode(&self) -> i8 {
        self.value(stored::MODE) as i8
    }

    #[inline]
    fn target_position(&self) -> f64 {
        self.real_value(stored::TARGET_POSITION) * self.rad_per_position
    }

    #[inline]
    fn target_velocity(&self) -> f64 {
        if self.is_in_velocity_mode() {
            return self.velocity_mode_target();
        }
        self.real_value(stored::TARGET_VELOCITY) * self.rad_per_velocity
    }

    fn target_torque(&self) -> f64 {
        self.real_value(stored::TARGET_TORQUE) / 1000.0
    }

    fn homing(&self) -> HomingSettings {
        HomingSettings {
            method: self.value(stored::HOMING_METHOD) as i8,
            fast: self.rad_value(stored::HOMING_FAST),
            slow: self.rad_value(stored::HOMING_SLOW),
            acceleration: self.rad_value(stored::HOMING_ACCELERATION),
            offset: self.real_value(stored::HOME_OFFSET) * self.rad_per_position,
        }
    }

    #[inline]
    fn offsets(&self) -> CyclicOffsets {
        CyclicOffsets {
            position: self.real_value(stored::POSITION_OFFSET) * self.rad_per_position,
            velocity: self.real_value(stored::VELOCITY_OFFSET) * self.rad_per_velocity,
            torque: self.real_value(stored::TORQUE_OFFSET) / 1000.0,
        }
    }

    #[inline]
    fn interpolation_target(&self) -> f64 {
        self.real_value(stored::ACTIVE_RECORD) * self.rad_per_position
    }

    #[inline]
    fn cycle_ms(&self) -> u32 {
        match (self.value(stored::PERIOD), self.value(stored::PERIOD_EXPONENT)) {
            (ms @ 1..=255, -3) => ms.cast_unsigned(),
            (value, exponent) => milliseconds(value, exponent),
        }
    }

    fn relative_to(&self) -> u8 {
        self.value(stored::POSITIONING) as u8
    }
}

/// Bits of the controlword by which the ramp runs and follows 6042h (CiA 402-2, velocity mode).
const RAMP_BITS: i32 = 0x70;

impl Objects {
    #[inline]
    const fn is_in_velocity_mode(&self) -> bool {
        self.values[stored::MODE as usize] == modes::VELOCITY as i32
    }

    /// rad/s in a step of 6042h to 6049h: an rpm, by the dimension factor.
    pub(in super::super) fn velocity_mode_unit(&self) -> f64 {
        match (self.real_value(stored::VL_NUMERATOR), self.real_value(stored::VL_DIVISOR)) {
            (numerator, divisor) if numerator != 0.0 && divisor != 0.0 => RPM * numerator / divisor,
            _ => RPM,
        }
    }

    /// The target, rad/s: 0 unless the ramp follows it, and never less than the least speed.
    fn velocity_mode_target(&self) -> f64 {
        let target = self.real_value(stored::VL_TARGET);
        if target == 0.0 || self.value(stored::CONTROL) & RAMP_BITS != RAMP_BITS {
            return 0.0;
        }
        target.signum()
            * target.abs().max(self.real_value(stored::VL_MIN))
            * self.velocity_mode_unit()
    }

    fn velocity_mode_limits(&self) -> Limits {
        let unit = self.velocity_mode_unit();
        let ramp = |speed, time| self.real_value(speed) * unit / self.real_value(time).max(0.001);
        Limits {
            velocity: self.real_value(stored::VL_MAX) * unit,
            acceleration: ramp(stored::VL_ACCELERATION_SPEED, stored::VL_ACCELERATION_TIME),
            deceleration: ramp(stored::VL_DECELERATION_SPEED, stored::VL_DECELERATION_TIME),
            smoothing_s: 0.0,
        }
    }
}

/// `value` times ten to the `exponent` seconds.
pub(super) fn milliseconds(value: i32, exponent: i32) -> u32 {
    let tens = 10_i32.saturating_pow(exponent.saturating_add(3).unsigned_abs());
    let ms = if exponent > -3 { value.saturating_mul(tens) } else { value / tens };
    ms.clamp(1, 10_000).cast_unsigned()
}
