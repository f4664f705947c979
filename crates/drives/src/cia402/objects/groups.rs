//! Groups of similar settings: sets of tags, one bit each.

use super::stored;

/// A bit for each of these tags.
pub(super) const fn bits(tags: &[u16]) -> u64 {
    let (mut bits, mut at) = (0, 0);
    while at < tags.len() {
        if tags[at] < 64 {
            bits |= 1 << tags[at];
        }
        at += 1;
    }
    bits
}

/// Settings of 32 bits without sign.
pub(super) const UNSIGNED: u64 = bits(&[
    stored::PROFILE_VELOCITY,
    stored::ACCELERATION,
    stored::DECELERATION,
    stored::QUICK_STOP,
    stored::TORQUE_SLOPE,
    stored::MAX_PROFILE_VELOCITY,
    stored::MAX_MOTOR_SPEED,
    stored::FOLLOWING_WINDOW,
    stored::POSITION_WINDOW,
    stored::HOMING_FAST,
    stored::HOMING_SLOW,
    stored::HOMING_ACCELERATION,
    stored::GEAR_MOTOR,
    stored::GEAR_SHAFT,
    stored::FEED,
    stored::FEED_TURNS,
]);
/// Objects that keep a motor from turning, or a target from being reached, while they are 0.
pub(super) const NEEDED: u64 = UNSIGNED
    | bits(&[
        stored::MAX_TORQUE,
        stored::FORWARD_TORQUE,
        stored::BACKWARD_TORQUE,
        stored::VELOCITY_WINDOW,
        stored::STANDSTILL,
    ]);
/// Objects in user units of velocity.
pub(super) const VELOCITIES: u64 = bits(&[
    stored::PROFILE_VELOCITY,
    stored::MAX_PROFILE_VELOCITY,
    stored::VELOCITY_WINDOW,
    stored::STANDSTILL,
    stored::HOMING_FAST,
    stored::HOMING_SLOW,
]);
/// Objects in user units of acceleration.
pub(super) const ACCELERATIONS: u64 = bits(&[
    stored::ACCELERATION,
    stored::DECELERATION,
    stored::QUICK_STOP,
    stored::HOMING_ACCELERATION,
]);
/// Objects in user units.
pub(super) const IN_UNITS: u64 =
    VELOCITIES | ACCELERATIONS | bits(&[stored::FOLLOWING_WINDOW, stored::POSITION_WINDOW]);
/// Objects from which user units are computed.
pub(super) const SCALES: u64 = bits(&[
    stored::GEAR_MOTOR,
    stored::GEAR_SHAFT,
    stored::FEED,
    stored::FEED_TURNS,
    stored::POLARITY,
    stored::POSITION_FACTOR,
    stored::POSITION_FACTOR_DIVISOR,
    stored::VELOCITY_ENCODER_FACTOR,
    stored::VELOCITY_ENCODER_FACTOR_DIVISOR,
    stored::VELOCITY_FACTOR_1,
    stored::VELOCITY_FACTOR_1_DIVISOR,
    stored::VELOCITY_FACTOR,
    stored::VELOCITY_FACTOR_DIVISOR,
    stored::ACCELERATION_FACTOR,
    stored::ACCELERATION_FACTOR_DIVISOR,
    stored::SI_POSITION,
    stored::SI_VELOCITY,
    stored::SI_ACCELERATION,
]);

/// Returns whether the tag is one of them.
pub(super) const fn is_in(tag: u16, bits: u64) -> bool {
    tag < 64 && bits >> tag & 1 != 0
}
