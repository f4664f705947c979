//! The units of a stepper module, computed from its settings (hardware manuals of the TMCM-1140, TMCM-1180
//! and TMCM-610, "velocity and acceleration vs. microstep and fullstep frequency").
//!
//! A full step has 2 to the power of parameter 140 microsteps. The number of full steps of a turn is
//! parameter 202, if the module has it, else 200. Modules with a TMC428 or TMC429 (those with pulse divisor
//! 154 and ramp divisor 153) use speeds from 0 to 2047; the others use microsteps per second.

use polepair_core::profile::{NoScale, ObjectKey, ScaleRule, ScaleRuleValue};

/// Clock of the TMC428 and TMC429, Hz.
const CLOCK_HZ: f64 = 16e6;
/// Default full steps per turn; `steps=` replaces it.
pub const FULL_STEPS: f64 = 200.0;
/// The greatest exponent of microsteps and of the divisors.
const EXPONENT_MAX: i64 = 13;

/// Axis parameters: microstep resolution, full steps, pulse divisor, ramp divisor.
pub const MICROSTEPS: ObjectKey = (140, 0);
const MOTOR_STEPS: ObjectKey = (202, 0);
/// True if speeds are in microsteps per second: 1 where the module has the choice.
const UNIT_MODE: ObjectKey = (255, 0);
/// The divisors of the TMC428 and TMC429.
pub const PULSE_DIVISOR: ObjectKey = (154, 0);
/// See [`PULSE_DIVISOR`].
pub const RAMP_DIVISOR: ObjectKey = (153, 0);

/// Turns from microsteps.
pub static POSITION: ScaleRule = ScaleRule {
    name: "tmcm-position",
    objects: &[MICROSTEPS, MOTOR_STEPS],
    words: &[],
    full_steps: Some((FULL_STEPS, MOTOR_STEPS)),
    compute: |read, _| {
        let factor = 1.0 / microsteps_per_turn(read)?;
        Ok(ScaleRuleValue { factor, from: &[MICROSTEPS, MOTOR_STEPS] })
    },
};

/// Turns per minute from the module's speeds.
pub static VELOCITY: ScaleRule = ScaleRule {
    name: "tmcm-velocity",
    objects: &[MICROSTEPS, MOTOR_STEPS, PULSE_DIVISOR],
    words: &[],
    full_steps: Some((FULL_STEPS, MOTOR_STEPS)),
    compute: |read, _| {
        let divisor = exponent(read(PULSE_DIVISOR))?;
        let factor = 60.0 * velocity_unit(divisor) / microsteps_per_turn(read)?;
        Ok(ScaleRuleValue { factor, from: &[MICROSTEPS, MOTOR_STEPS, PULSE_DIVISOR] })
    },
};

/// Turns per minute from microsteps per second.
pub static VELOCITY_PPS: ScaleRule = ScaleRule {
    name: "tmcm-velocity-pps",
    objects: &[MICROSTEPS, MOTOR_STEPS, UNIT_MODE],
    words: &[],
    full_steps: Some((FULL_STEPS, MOTOR_STEPS)),
    compute: |read, _| per_second(read),
};

/// Turns per minute gained each second from microsteps per second each second.
pub static ACCELERATION_PPS: ScaleRule =
    ScaleRule { name: "tmcm-acceleration-pps", ..VELOCITY_PPS };

fn per_second(read: &dyn Fn(ObjectKey) -> Option<i64>) -> Result<ScaleRuleValue, NoScale> {
    if read(UNIT_MODE).is_some_and(|mode| mode != 1) {
        return Err(NoScale(
            "the module counts in its chip's units, not in microsteps per second: unit mode (AP 255) is not 1",
        ));
    }
    let factor = 60.0 / microsteps_per_turn(read)?;
    Ok(ScaleRuleValue { factor, from: &[MICROSTEPS, MOTOR_STEPS, UNIT_MODE] })
}

/// Turns per minute gained each second from the module's accelerations.
pub static ACCELERATION: ScaleRule = ScaleRule {
    name: "tmcm-acceleration",
    objects: &[MICROSTEPS, MOTOR_STEPS, PULSE_DIVISOR, RAMP_DIVISOR],
    words: &[],
    full_steps: Some((FULL_STEPS, MOTOR_STEPS)),
    compute: |read, _| {
        let divisors = exponent(read(PULSE_DIVISOR))?.zip(exponent(read(RAMP_DIVISOR))?);
        let factor = 60.0 * acceleration_unit(divisors) / microsteps_per_turn(read)?;
        Ok(ScaleRuleValue { factor, from: &[MICROSTEPS, MOTOR_STEPS, PULSE_DIVISOR, RAMP_DIVISOR] })
    },
};

/// Microsteps per second of a speed of 1; without a divisor speeds are that already.
#[must_use]
pub fn velocity_unit(pulse_divisor: Option<u32>) -> f64 {
    pulse_divisor.map_or(1.0, |pulse| CLOCK_HZ / power_of_two(pulse) / (2048.0 * 32.0))
}

/// Microsteps per second gained each second of an acceleration of 1, by pulse and ramp divisor.
#[must_use]
pub fn acceleration_unit(divisors: Option<(u32, u32)>) -> f64 {
    divisors.map_or(1.0, |(pulse, ramp)| CLOCK_HZ * CLOCK_HZ / power_of_two(pulse + ramp + 29))
}

/// Two to that power.
#[must_use]
pub fn power_of_two(exponent: u32) -> f64 {
    libm::ldexp(1.0, exponent as i32)
}

fn microsteps_per_turn(read: &dyn Fn(ObjectKey) -> Option<i64>) -> Result<f64, NoScale> {
    let microsteps =
        exponent(read(MICROSTEPS))?.ok_or(NoScale("the module has no microstep resolution"))?;
    let steps = match read(MOTOR_STEPS) {
        None => FULL_STEPS,
        Some(steps) if steps > 0 => steps as f64,
        Some(_) => return Err(NoScale("motor full step resolution (AP 202) is zero")),
    };
    Ok(steps * power_of_two(microsteps))
}

fn exponent(raw: Option<i64>) -> Result<Option<u32>, NoScale> {
    raw.map(|raw| {
        if (0..=EXPONENT_MAX).contains(&raw) {
            Ok(raw as u32)
        } else {
            Err(NoScale("a resolution or divisor that scales it is beyond 13"))
        }
    })
    .transpose()
}
