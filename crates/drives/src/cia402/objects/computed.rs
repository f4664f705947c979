//! Tags of objects that are computed, not stored as written.

/// The first of them.
pub const FIRST: u16 = 0x100;
/// Error code.
pub const ERROR_CODE: u16 = FIRST;
/// Statusword.
pub const STATUS: u16 = FIRST + 1;
/// Mode of operation in force.
pub const MODE: u16 = FIRST + 2;
/// Position demand.
pub const POSITION_DEMAND: u16 = FIRST + 3;
/// Position in increments.
pub const INCREMENTS: u16 = FIRST + 4;
/// Position.
pub const POSITION: u16 = FIRST + 5;
/// Speed by the sensor.
pub const SENSOR_VELOCITY: u16 = FIRST + 6;
/// Velocity demand.
pub const VELOCITY_DEMAND: u16 = FIRST + 7;
/// Velocity.
pub const VELOCITY: u16 = FIRST + 8;
/// Torque demand.
pub const TORQUE_DEMAND: u16 = FIRST + 9;
/// Rated current.
pub const RATED_CURRENT: u16 = FIRST + 10;
/// Rated torque.
pub const RATED_TORQUE: u16 = FIRST + 11;
/// Torque.
pub const TORQUE: u16 = FIRST + 12;
/// Current.
pub const CURRENT: u16 = FIRST + 13;
/// Voltage of the DC link.
pub const VOLTAGE: u16 = FIRST + 14;
/// Following error.
pub const FOLLOWING_ERROR: u16 = FIRST + 15;
/// Position demand in increments.
pub const DEMAND_INCREMENTS: u16 = FIRST + 16;
/// Digital inputs.
pub const INPUTS: u16 = FIRST + 17;
/// Temperature of the power stage.
pub const TEMPERATURE: u16 = FIRST + 18;
/// Time of day.
pub const CLOCK: u16 = FIRST + 19;
/// Bytes that are kept.
pub const SCRATCH: u16 = FIRST + 20;
/// Bytes that are counted.
pub const STREAM: u16 = FIRST + 21;
/// Number of these tags.
pub const STREAMED: u16 = FIRST + 22;
/// The check over them.
pub const STREAM_CHECK: u16 = FIRST + 23;
/// Supported modes.
pub const MODES: u16 = FIRST + 24;
/// Velocity mode: velocity demand, rpm.
pub const VL_DEMAND: u16 = FIRST + 25;
/// Velocity mode: velocity, rpm.
pub const VL_VELOCITY: u16 = FIRST + 26;
/// Records of the interpolated position mode that wait.
pub const BUFFER_POSITION: u16 = FIRST + 27;
/// Touch probe status.
pub const TOUCH_PROBE_STATUS: u16 = FIRST + 28;
/// Positions at the rising and the falling edge of touch probe 1, then those of touch probe 2.
pub const TOUCH_PROBE_POSITIONS: u16 = FIRST + 29;
