//! Position of the modules without a position scaler: counts of the encoder, or of the hall sensors.
//!
//! PyTrinamic 0.2.26, examples of the TMCM-1630, 1633 and 1640: a turn has as many counts as the encoder by
//! `encoder_position_mode.py`, and three for each pole by `hall_position_mode.py`.

use polepair_core::profile::{NoScale, ObjectKey, ScaleRule, ScaleRuleValue};

/// Commutation mode.
pub const COMMUTATION: ObjectKey = (159, 0);
/// Encoder counts of a turn.
pub const ENCODER_STEPS: ObjectKey = (250, 0);
/// Poles of the motor.
pub const POLES: ObjectKey = (253, 0);

/// Commutation by hall sensors: block and FOC.
pub const HALL_MODES: [i64; 2] = [0, 6];
/// Commutation by the encoder.
const ENCODER_MODE: i64 = 7;
/// Hall counts of a turn for each pole.
pub const HALL_COUNTS: i64 = 3;

/// Degrees of a count.
pub static POSITION: ScaleRule = ScaleRule {
    name: "tmcm-bldc-position",
    objects: &[COMMUTATION, ENCODER_STEPS, POLES],
    words: &[],
    full_steps: None,
    compute: |read, _| {
        let counts = match read(COMMUTATION) {
            Some(mode) if HALL_MODES.contains(&mode) => {
                read(POLES).map(|poles| poles * HALL_COUNTS)
            }
            Some(ENCODER_MODE) => read(ENCODER_STEPS),
            Some(_) => {
                return Err(NoScale("the commutation mode has no position: it uses no sensor"));
            }
            None => None,
        };
        let counts = counts.filter(|counts| *counts > 0);
        let counts = counts.ok_or(NoScale("motor poles or encoder steps are missing or zero"))?;
        let from: &[ObjectKey] = &[COMMUTATION, ENCODER_STEPS, POLES];
        Ok(ScaleRuleValue { factor: 360.0 / counts as f64, from })
    },
};
