//! Tags of writable values.

/// Controlword.
pub const CONTROL: u16 = 0;
/// Mode of operation.
pub const MODE: u16 = 1;
/// Target position.
pub const TARGET_POSITION: u16 = 2;
/// Target velocity.
pub const TARGET_VELOCITY: u16 = 3;
/// Target torque.
pub const TARGET_TORQUE: u16 = 4;
/// Profile velocity.
pub const PROFILE_VELOCITY: u16 = 5;
/// Profile acceleration.
pub const ACCELERATION: u16 = 6;
/// Profile deceleration.
pub const DECELERATION: u16 = 7;
/// Quick stop deceleration.
pub const QUICK_STOP: u16 = 8;
/// Torque slope.
pub const TORQUE_SLOPE: u16 = 9;
/// Velocity offset.
pub const VELOCITY_OFFSET: u16 = 10;
/// Torque offset.
pub const TORQUE_OFFSET: u16 = 11;
/// Interpolation time, units.
pub const PERIOD: u16 = 12;
/// Interpolation time, power of ten of the unit.
pub const PERIOD_EXPONENT: u16 = 13;
/// Max profile velocity.
pub const MAX_PROFILE_VELOCITY: u16 = 14;
/// Max motor speed, rpm.
pub const MAX_MOTOR_SPEED: u16 = 15;
/// Max torque.
pub const MAX_TORQUE: u16 = 16;
/// Least position.
pub const POSITION_MIN: u16 = 17;
/// Greatest position.
pub const POSITION_MAX: u16 = 18;
/// Following error window.
pub const FOLLOWING_WINDOW: u16 = 19;
/// Following error time.
pub const FOLLOWING_TIME: u16 = 20;
/// Position window.
pub const POSITION_WINDOW: u16 = 21;
/// Position window time.
pub const POSITION_TIME: u16 = 22;
/// Velocity window.
pub const VELOCITY_WINDOW: u16 = 23;
/// Velocity window time.
pub const VELOCITY_TIME: u16 = 24;
/// Velocity threshold.
pub const STANDSTILL: u16 = 25;
/// Velocity threshold time.
pub const STANDSTILL_TIME: u16 = 26;
/// Abort connection option.
pub const ABORT_OPTION: u16 = 27;
/// Quick stop option.
pub const QUICK_STOP_OPTION: u16 = 28;
/// Shutdown option.
pub const SHUTDOWN_OPTION: u16 = 29;
/// Disable operation option.
pub const DISABLE_OPTION: u16 = 30;
/// Halt option.
pub const HALT_OPTION: u16 = 31;
/// Fault reaction option.
pub const FAULT_OPTION: u16 = 32;
/// Homing method.
pub const HOMING_METHOD: u16 = 33;
/// Homing speed to the switch.
pub const HOMING_FAST: u16 = 34;
/// Homing speed to the zero.
pub const HOMING_SLOW: u16 = 35;
/// Homing acceleration.
pub const HOMING_ACCELERATION: u16 = 36;
/// Home offset.
pub const HOME_OFFSET: u16 = 37;
/// Motion profile type.
pub const PROFILE_TYPE: u16 = 38;
/// Torque profile type.
pub const TORQUE_PROFILE_TYPE: u16 = 39;
/// Gear ratio, motor turns.
pub const GEAR_MOTOR: u16 = 40;
/// Gear ratio, shaft turns.
pub const GEAR_SHAFT: u16 = 41;
/// Feed.
pub const FEED: u16 = 42;
/// Shaft turns of the feed.
pub const FEED_TURNS: u16 = 43;
/// Polarity: bit 7 of positions, bit 6 of speeds.
pub const POLARITY: u16 = 44;
/// Positioning option.
pub const POSITIONING: u16 = 45;
/// Digital outputs.
pub const OUTPUTS: u16 = 46;
/// Mask of the digital outputs.
pub const OUTPUT_MASK: u16 = 47;
/// Bytes that the stream gives.
pub const STREAM_LENGTH: u16 = 48;
/// Unit of positions.
pub const SI_POSITION: u16 = 49;
/// Unit of velocities.
pub const SI_VELOCITY: u16 = 50;
/// Unit of accelerations.
pub const SI_ACCELERATION: u16 = 51;
/// Position factor, numerator.
pub const POSITION_FACTOR: u16 = 52;
/// Position factor, divisor.
pub const POSITION_FACTOR_DIVISOR: u16 = 53;
/// Velocity encoder factor, numerator.
pub const VELOCITY_ENCODER_FACTOR: u16 = 54;
/// Velocity encoder factor, divisor.
pub const VELOCITY_ENCODER_FACTOR_DIVISOR: u16 = 55;
/// Velocity factor 1, numerator.
pub const VELOCITY_FACTOR_1: u16 = 56;
/// Velocity factor 1, divisor.
pub const VELOCITY_FACTOR_1_DIVISOR: u16 = 57;
/// Velocity factor, numerator.
pub const VELOCITY_FACTOR: u16 = 58;
/// Velocity factor, divisor.
pub const VELOCITY_FACTOR_DIVISOR: u16 = 59;
/// Acceleration factor, numerator.
pub const ACCELERATION_FACTOR: u16 = 60;
/// Acceleration factor, divisor.
pub const ACCELERATION_FACTOR_DIVISOR: u16 = 61;
/// Greatest torque forward.
pub const FORWARD_TORQUE: u16 = 62;
/// Greatest torque backward.
pub const BACKWARD_TORQUE: u16 = 63;
/// Velocity mode: target velocity, rpm.
pub const VL_TARGET: u16 = 64;
/// Velocity mode: least speed, rpm.
pub const VL_MIN: u16 = 65;
/// Velocity mode: greatest speed, rpm.
pub const VL_MAX: u16 = 66;
/// Velocity mode: change of speed of the acceleration, rpm.
pub const VL_ACCELERATION_SPEED: u16 = 67;
/// Velocity mode: time of that change, s.
pub const VL_ACCELERATION_TIME: u16 = 68;
/// Velocity mode: change of speed of the deceleration, rpm.
pub const VL_DECELERATION_SPEED: u16 = 69;
/// Velocity mode: time of that change, s.
pub const VL_DECELERATION_TIME: u16 = 70;
/// Velocity mode: dimension factor, numerator.
pub const VL_NUMERATOR: u16 = 71;
/// Velocity mode: dimension factor, divisor.
pub const VL_DIVISOR: u16 = 72;
/// Position offset.
pub const POSITION_OFFSET: u16 = 73;
/// Record of the interpolated position mode, as last written.
pub const RECORD: u16 = 74;
/// Record that is in force; no object shows it.
pub const ACTIVE_RECORD: u16 = 75;
/// Sub mode of the interpolation.
pub const INTERPOLATION_TYPE: u16 = 76;
/// Records that wait at most, with the one in force.
pub const BUFFER_SIZE: u16 = 77;
/// Organisation of these.
pub const BUFFER_ORGANISATION: u16 = 78;
/// Bytes of a record.
pub const RECORD_SIZE: u16 = 79;
/// Records are taken, or dropped and refused.
pub const BUFFER_CLEAR: u16 = 80;
/// Touch probe function.
pub const TOUCH_PROBE: u16 = 81;
/// Number of these objects.
pub const COUNT: usize = 82;
