//! Which settings are alike: sets of tags, a bit each.

use super::kept;

/// A bit for each of these tags.
pub(super) const fn bits(tags: &[u16]) -> u64 {
    let (mut bits, mut at) = (0, 0);
    while at < tags.len() {
        bits |= 1 << tags[at];
        at += 1;
    }
    bits
}

/// Settings of 32 bits without sign.
pub(super) const UNSIGNED: u64 = bits(&[
    kept::PROFILE_VELOCITY,
    kept::ACCELERATION,
    kept::DECELERATION,
    kept::QUICK_STOP,
    kept::TORQUE_SLOPE,
    kept::MAX_PROFILE_VELOCITY,
    kept::MAX_MOTOR_SPEED,
    kept::FOLLOWING_WINDOW,
    kept::POSITION_WINDOW,
    kept::HOMING_FAST,
    kept::HOMING_SLOW,
    kept::HOMING_ACCELERATION,
    kept::GEAR_MOTOR,
    kept::GEAR_SHAFT,
    kept::FEED,
    kept::FEED_TURNS,
]);
/// What keeps a motor from turning while it is 0, or no target from being reached.
pub(super) const NEEDED: u64 =
    UNSIGNED | bits(&[kept::MAX_TORQUE, kept::VELOCITY_WINDOW, kept::STANDSTILL]);
/// What counts user units.
pub(super) const IN_UNITS: u64 = bits(&[
    kept::PROFILE_VELOCITY,
    kept::ACCELERATION,
    kept::DECELERATION,
    kept::QUICK_STOP,
    kept::MAX_PROFILE_VELOCITY,
    kept::FOLLOWING_WINDOW,
    kept::POSITION_WINDOW,
    kept::VELOCITY_WINDOW,
    kept::STANDSTILL,
    kept::HOMING_FAST,
    kept::HOMING_SLOW,
    kept::HOMING_ACCELERATION,
]);

/// Whether the tag is one of them.
pub(super) const fn is_in(tag: u16, bits: u64) -> bool {
    tag < 64 && bits >> tag & 1 != 0
}
