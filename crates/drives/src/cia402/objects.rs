//! The objects of the drive: dictionary, writable values, and their meaning in SI.
//!
//! Positions are in user units (factory setting: increments of the encoder), speeds in these per second,
//! accelerations in these per second squared, unless [`units`] gives others. Torques are in thousandths of
//! the rated torque (CiA 402, factor group).

mod groups;
mod motion_settings;

use core::f64::consts::TAU;

use groups::{ACCELERATIONS, IN_UNITS, NEEDED, SCALES, UNSIGNED, VELOCITIES, bits, is_in};

use super::interpolation::RECORDS_MAX;
use super::units;
use polepair_core::plant::Limits;
use polepair_core::profile::{ObjectKey, ScaleRuleValue};
use polepair_core::proto::canopen::device::motion::{
    Braking, HomingSettings, MotionSettings, Window,
};
use polepair_core::proto::canopen::device::{standard_entries, standard_len};
use polepair_core::proto::canopen::od::{
    DefaultValue, Dictionary, ObjectAccess, ObjectEntry, PROTOCOL_TAG, ValueType, merge,
};
use polepair_core::units::nearest;

/// PDOs each way.
pub const PDOS: usize = 4;
/// Increments of the encoder in a turn.
pub const INCREMENTS: i64 = 10_000;
/// Bytes that the scratch object keeps.
pub const SCRATCH_MAX: usize = 1024;
/// Bytes that the stream object takes and gives at most.
pub const STREAM_MAX: u32 = 16 << 20;

pub mod computed;
pub mod stored;

/// Number of entries at the start of [`stored`] that are commands, not settings.
const COMMAND_COUNT: usize = stored::TARGET_TORQUE as usize + 1;

const RO: ObjectAccess = ObjectAccess::RO.mappable();
const RW: ObjectAccess = ObjectAccess::RW.mappable();
const RW_UNMAPPED: ObjectAccess = ObjectAccess::RW;
const RO_UNMAPPED: ObjectAccess = ObjectAccess::RO;

const fn entry(
    i: u16,
    s: u8,
    kind: ValueType,
    a: ObjectAccess,
    tag: u16,
    name: &'static str,
) -> ObjectEntry {
    ObjectEntry::new(i, s, kind, a, tag, name)
}

/// rad/s of 1 rpm.
const RPM: f64 = TAU / 60.0;

/// Everything that is not the protocol's.
const APPLICATION_ENTRIES: [ObjectEntry; 137] = {
    use computed as r;
    use stored as k;
    let (u8, i8) = (ValueType::U8, ValueType::I8);
    let (u16, i16) = (ValueType::U16, ValueType::I16);
    let (u32, i32) = (ValueType::U32, ValueType::I32);
    let unsigned = i32::MAX as i64;
    [
        entry(0x2F00, 0, ValueType::DOMAIN, RW_UNMAPPED, r::SCRATCH, "scratch"),
        entry(0x2F01, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "stream: highest sub-index")
            .with_default(4),
        entry(0x2F01, 1, u32, RW_UNMAPPED, k::STREAM_LENGTH, "bytes that the stream gives")
            .with_default(889)
            .with_limits(0, STREAM_MAX as i64),
        entry(0x2F01, 2, ValueType::DOMAIN, RW_UNMAPPED, r::STREAM, "stream"),
        entry(0x2F01, 3, u32, RO_UNMAPPED, r::STREAMED, "bytes that the stream took"),
        entry(0x2F01, 4, u16, RO_UNMAPPED, r::STREAM_CHECK, "check over them"),
        entry(0x2F02, 0, ValueType::TIME_OF_DAY, RO_UNMAPPED, r::CLOCK, "time of day"),
        entry(0x2F03, 0, i16, RO, r::TEMPERATURE, "temperature of the power stage"),
        entry(0x6007, 0, i16, RW, k::ABORT_OPTION, "abort connection option code")
            .with_default(3)
            .with_limits(0, 3),
        entry(0x603F, 0, u16, RO, r::ERROR_CODE, "error code"),
        entry(0x6040, 0, u16, RW, k::CONTROL, "controlword"),
        entry(0x6041, 0, u16, RO, r::STATUS, "statusword"),
        entry(0x6042, 0, i16, RW, k::VL_TARGET, "vl target velocity"),
        entry(0x6043, 0, i16, RO, r::VL_DEMAND, "vl velocity demand"),
        entry(0x6044, 0, i16, RO, r::VL_VELOCITY, "vl velocity actual value"),
        entry(0x6046, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "vl velocity limits: highest sub-index")
            .with_default(2),
        entry(0x6046, 1, u32, RW, k::VL_MIN, "vl velocity min amount").with_limits(0, unsigned),
        entry(0x6046, 2, u32, RW, k::VL_MAX, "vl velocity max amount")
            .with_default(6000)
            .with_limits(0, unsigned),
        entry(0x6048, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "vl acceleration: highest sub-index")
            .with_default(2),
        entry(0x6048, 1, u32, RW, k::VL_ACCELERATION_SPEED, "delta speed")
            .with_default(1500)
            .with_limits(1, unsigned),
        entry(0x6048, 2, u16, RW, k::VL_ACCELERATION_TIME, "delta time").with_default(1),
        entry(0x6049, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "vl deceleration: highest sub-index")
            .with_default(2),
        entry(0x6049, 1, u32, RW, k::VL_DECELERATION_SPEED, "delta speed")
            .with_default(1500)
            .with_limits(1, unsigned),
        entry(0x6049, 2, u16, RW, k::VL_DECELERATION_TIME, "delta time").with_default(1),
        entry(0x604C, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "vl dimension factor: highest sub-index")
            .with_default(2),
        entry(0x604C, 1, i32, RW, k::VL_NUMERATOR, "numerator").with_default(1),
        entry(0x604C, 2, i32, RW, k::VL_DIVISOR, "divisor").with_default(1),
        entry(0x605A, 0, i16, RW, k::QUICK_STOP_OPTION, "quick stop option code")
            .with_default(2)
            .with_limits(0, 8),
        entry(0x605B, 0, i16, RW, k::SHUTDOWN_OPTION, "shutdown option code").with_limits(0, 1),
        entry(0x605C, 0, i16, RW, k::DISABLE_OPTION, "disable operation option code")
            .with_default(1)
            .with_limits(0, 1),
        entry(0x605D, 0, i16, RW, k::HALT_OPTION, "halt option code")
            .with_default(1)
            .with_limits(1, 4),
        entry(0x605E, 0, i16, RW, k::FAULT_OPTION, "fault reaction option code")
            .with_default(2)
            .with_limits(0, 4),
        entry(0x6060, 0, i8, RW, k::MODE, "modes of operation"),
        entry(0x6061, 0, i8, RO, r::MODE, "modes of operation display"),
        entry(0x6062, 0, i32, RO, r::POSITION_DEMAND, "position demand value"),
        entry(0x6063, 0, i32, RO, r::INCREMENTS, "position actual internal value"),
        entry(0x6064, 0, i32, RO, r::POSITION, "position actual value"),
        entry(0x6065, 0, u32, RW, k::FOLLOWING_WINDOW, "following error window")
            .with_default(2 * INCREMENTS),
        entry(0x6066, 0, u16, RW, k::FOLLOWING_TIME, "following error time out"),
        entry(0x6067, 0, u32, RW, k::POSITION_WINDOW, "position window").with_default(10),
        entry(0x6068, 0, u16, RW, k::POSITION_TIME, "position window time"),
        entry(0x6069, 0, i32, RO, r::SENSOR_VELOCITY, "velocity sensor actual value"),
        entry(0x606B, 0, i32, RO, r::VELOCITY_DEMAND, "velocity demand value"),
        entry(0x606C, 0, i32, RO, r::VELOCITY, "velocity actual value"),
        entry(0x606D, 0, u16, RW, k::VELOCITY_WINDOW, "velocity window").with_default(1000),
        entry(0x606E, 0, u16, RW, k::VELOCITY_TIME, "velocity window time"),
        entry(0x606F, 0, u16, RW, k::STANDSTILL, "velocity threshold").with_default(500),
        entry(0x6070, 0, u16, RW, k::STANDSTILL_TIME, "velocity threshold time"),
        entry(0x6071, 0, i16, RW, k::TARGET_TORQUE, "target torque"),
        entry(0x6072, 0, u16, RW, k::MAX_TORQUE, "max torque").with_default(3000),
        entry(0x6074, 0, i16, RO, r::TORQUE_DEMAND, "torque demand"),
        entry(0x6075, 0, u32, RO, r::RATED_CURRENT, "motor rated current"),
        entry(0x6076, 0, u32, RO, r::RATED_TORQUE, "motor rated torque"),
        entry(0x6077, 0, i16, RO, r::TORQUE, "torque actual value"),
        entry(0x6078, 0, i16, RO, r::CURRENT, "current actual value"),
        entry(0x6079, 0, u32, RO, r::VOLTAGE, "DC link circuit voltage"),
        entry(0x607A, 0, i32, RW, k::TARGET_POSITION, "target position"),
        entry(0x607C, 0, i32, RW, k::HOME_OFFSET, "home offset"),
        entry(
            0x607D,
            0,
            u8,
            RO_UNMAPPED,
            PROTOCOL_TAG,
            "software position limit: highest sub-index",
        )
        .with_default(2),
        entry(0x607D, 1, i32, RW, k::POSITION_MIN, "min position limit"),
        entry(0x607D, 2, i32, RW, k::POSITION_MAX, "max position limit"),
        entry(0x607E, 0, u8, RW, k::POLARITY, "polarity"),
        entry(0x607F, 0, u32, RW, k::MAX_PROFILE_VELOCITY, "max profile velocity")
            .with_default(100 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6080, 0, u32, RW, k::MAX_MOTOR_SPEED, "max motor speed")
            .with_default(6000)
            .with_limits(0, 100_000),
        entry(0x6081, 0, u32, RW, k::PROFILE_VELOCITY, "profile velocity")
            .with_default(10 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6083, 0, u32, RW, k::ACCELERATION, "profile acceleration")
            .with_default(100 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6084, 0, u32, RW, k::DECELERATION, "profile deceleration")
            .with_default(100 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6085, 0, u32, RW, k::QUICK_STOP, "quick stop deceleration")
            .with_default(500 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6086, 0, i16, RW, k::PROFILE_TYPE, "motion profile type").with_limits(0, 0),
        entry(0x6087, 0, u32, RW, k::TORQUE_SLOPE, "torque slope")
            .with_default(1000)
            .with_limits(0, unsigned),
        entry(0x6088, 0, i16, RW, k::TORQUE_PROFILE_TYPE, "torque profile type").with_limits(0, 0),
        entry(0x608F, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "encoder resolution: highest sub-index")
            .with_default(2),
        entry(0x608F, 1, u32, RO_UNMAPPED, PROTOCOL_TAG, "encoder increments")
            .with_default(INCREMENTS),
        entry(0x608F, 2, u32, RO_UNMAPPED, PROTOCOL_TAG, "motor revolutions").with_default(1),
        entry(0x6091, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "gear ratio: highest sub-index")
            .with_default(2),
        entry(0x6091, 1, u32, RW_UNMAPPED, k::GEAR_MOTOR, "motor revolutions")
            .with_default(1)
            .with_limits(1, unsigned),
        entry(0x6091, 2, u32, RW_UNMAPPED, k::GEAR_SHAFT, "shaft revolutions")
            .with_default(1)
            .with_limits(1, unsigned),
        entry(0x6092, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "feed constant: highest sub-index")
            .with_default(2),
        entry(0x6092, 1, u32, RW_UNMAPPED, k::FEED, "feed")
            .with_default(INCREMENTS)
            .with_limits(1, unsigned),
        entry(0x6092, 2, u32, RW_UNMAPPED, k::FEED_TURNS, "shaft revolutions")
            .with_default(1)
            .with_limits(1, unsigned),
        entry(0x6093, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "position factor: highest sub-index")
            .with_default(2),
        entry(0x6093, 1, u32, RW_UNMAPPED, k::POSITION_FACTOR, "numerator"),
        entry(0x6093, 2, u32, RW_UNMAPPED, k::POSITION_FACTOR_DIVISOR, "divisor"),
        entry(
            0x6094,
            0,
            u8,
            RO_UNMAPPED,
            PROTOCOL_TAG,
            "velocity encoder factor: highest sub-index",
        )
        .with_default(2),
        entry(0x6094, 1, u32, RW_UNMAPPED, k::VELOCITY_ENCODER_FACTOR, "numerator"),
        entry(0x6094, 2, u32, RW_UNMAPPED, k::VELOCITY_ENCODER_FACTOR_DIVISOR, "divisor"),
        entry(0x6095, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "velocity factor 1: highest sub-index")
            .with_default(2),
        entry(0x6095, 1, u32, RW_UNMAPPED, k::VELOCITY_FACTOR_1, "numerator"),
        entry(0x6095, 2, u32, RW_UNMAPPED, k::VELOCITY_FACTOR_1_DIVISOR, "divisor"),
        entry(0x6096, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "velocity factor: highest sub-index")
            .with_default(2),
        entry(0x6096, 1, u32, RW_UNMAPPED, k::VELOCITY_FACTOR, "numerator"),
        entry(0x6096, 2, u32, RW_UNMAPPED, k::VELOCITY_FACTOR_DIVISOR, "divisor"),
        entry(0x6097, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "acceleration factor: highest sub-index")
            .with_default(2),
        entry(0x6097, 1, u32, RW_UNMAPPED, k::ACCELERATION_FACTOR, "numerator"),
        entry(0x6097, 2, u32, RW_UNMAPPED, k::ACCELERATION_FACTOR_DIVISOR, "divisor"),
        entry(0x6098, 0, i8, RW, k::HOMING_METHOD, "homing method").with_default(37),
        entry(0x6099, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "homing speeds: highest sub-index")
            .with_default(2),
        entry(0x6099, 1, u32, RW, k::HOMING_FAST, "speed during search for switch")
            .with_default(5 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x6099, 2, u32, RW, k::HOMING_SLOW, "speed during search for zero")
            .with_default(INCREMENTS / 2)
            .with_limits(0, unsigned),
        entry(0x609A, 0, u32, RW, k::HOMING_ACCELERATION, "homing acceleration")
            .with_default(100 * INCREMENTS)
            .with_limits(0, unsigned),
        entry(0x60A8, 0, u32, RW_UNMAPPED, k::SI_POSITION, "SI unit position"),
        entry(0x60A9, 0, u32, RW_UNMAPPED, k::SI_VELOCITY, "SI unit velocity"),
        entry(0x60AA, 0, u32, RW_UNMAPPED, k::SI_ACCELERATION, "SI unit acceleration"),
        entry(0x60B0, 0, i32, RW, k::POSITION_OFFSET, "position offset"),
        entry(0x60B1, 0, i32, RW, k::VELOCITY_OFFSET, "velocity offset"),
        entry(0x60B2, 0, i16, RW, k::TORQUE_OFFSET, "torque offset"),
        entry(0x60B8, 0, u16, RW, k::TOUCH_PROBE, "touch probe function"),
        entry(0x60B9, 0, u16, RO, r::TOUCH_PROBE_STATUS, "touch probe status"),
        entry(0x60BA, 0, i32, RO, r::TOUCH_PROBE_POSITIONS, "touch probe 1 positive edge"),
        entry(0x60BB, 0, i32, RO, r::TOUCH_PROBE_POSITIONS + 1, "touch probe 1 negative edge"),
        entry(0x60BC, 0, i32, RO, r::TOUCH_PROBE_POSITIONS + 2, "touch probe 2 positive edge"),
        entry(0x60BD, 0, i32, RO, r::TOUCH_PROBE_POSITIONS + 3, "touch probe 2 negative edge"),
        entry(0x60C0, 0, i16, RW_UNMAPPED, k::INTERPOLATION_TYPE, "interpolation sub mode select")
            .with_limits(0, 0),
        entry(
            0x60C1,
            0,
            u8,
            RO_UNMAPPED,
            PROTOCOL_TAG,
            "interpolation data record: highest sub-index",
        )
        .with_default(1),
        entry(0x60C1, 1, i32, RW, k::RECORD, "set-point of the position"),
        entry(
            0x60C2,
            0,
            u8,
            RO_UNMAPPED,
            PROTOCOL_TAG,
            "interpolation time period: highest sub-index",
        )
        .with_default(2),
        entry(0x60C2, 1, u8, RW_UNMAPPED, k::PERIOD, "interpolation time period value")
            .with_default(1)
            .with_limits(1, 255),
        entry(0x60C2, 2, i8, RW_UNMAPPED, k::PERIOD_EXPONENT, "interpolation time index")
            .with_default(-3)
            .with_limits(-6, 0),
        entry(
            0x60C4,
            0,
            u8,
            RO_UNMAPPED,
            PROTOCOL_TAG,
            "interpolation data configuration: highest sub-index",
        )
        .with_default(6),
        entry(0x60C4, 1, u32, RO_UNMAPPED, PROTOCOL_TAG, "maximum buffer size")
            .with_default(RECORDS_MAX as i64),
        entry(0x60C4, 2, u32, RW_UNMAPPED, k::BUFFER_SIZE, "actual buffer size")
            .with_default(1)
            .with_limits(1, RECORDS_MAX as i64),
        entry(0x60C4, 3, u8, RW_UNMAPPED, k::BUFFER_ORGANISATION, "buffer organisation")
            .with_limits(0, 0),
        entry(0x60C4, 4, u16, RO, r::BUFFER_POSITION, "buffer position"),
        entry(0x60C4, 5, u8, RW_UNMAPPED, k::RECORD_SIZE, "size of data record")
            .with_default(4)
            .with_limits(4, 4),
        entry(0x60C4, 6, u8, RW_UNMAPPED, k::BUFFER_CLEAR, "buffer clear")
            .with_default(1)
            .with_limits(0, 1),
        entry(0x60E0, 0, u16, RW, k::FORWARD_TORQUE, "positive torque limit value")
            .with_default(3000),
        entry(0x60E1, 0, u16, RW, k::BACKWARD_TORQUE, "negative torque limit value")
            .with_default(3000),
        entry(0x60F2, 0, u16, RW, k::POSITIONING, "positioning option code").with_limits(0, 2),
        entry(0x60F4, 0, i32, RO, r::FOLLOWING_ERROR, "following error actual value"),
        entry(0x60FC, 0, i32, RO, r::DEMAND_INCREMENTS, "position demand internal value"),
        entry(0x60FD, 0, u32, RO, r::INPUTS, "digital inputs"),
        entry(0x60FE, 0, u8, RO_UNMAPPED, PROTOCOL_TAG, "digital outputs: highest sub-index")
            .with_default(2),
        entry(0x60FE, 1, u32, RW, k::OUTPUTS, "physical outputs"),
        entry(0x60FE, 2, u32, RW, k::OUTPUT_MASK, "output mask"),
        entry(0x60FF, 0, i32, RW, k::TARGET_VELOCITY, "target velocity"),
        entry(0x6402, 0, u16, RO_UNMAPPED, PROTOCOL_TAG, "motor type").with_default(10),
        entry(0x6502, 0, u32, RO_UNMAPPED, r::MODES, "supported drive modes"),
    ]
};

/// Bits of 6502h: PP, VL, PV, PT, HM, IP, CSP, CSV, CST.
pub(super) const ALL_MODES: u32 = 0x3EF;
/// Bit of 6502h of an inverter: VL.
pub(super) const VELOCITY_MODE: u32 = 0x002;

const fn default_number(index: u16, sub: u8, value: i64) -> (u16, u8, DefaultValue) {
    (index, sub, DefaultValue::Number(value))
}

/// Mappings as CiA 402 has them from the factory. Only the statusword is on, by change and every 100 ms: python
/// canopen's drive node takes a frame that came twice for periodic, its own frames on UDP among them, so a master must
/// switch on each further one.
const DEFAULTS: [(u16, u8, DefaultValue); 34] = [
    default_number(0x1018, 1, 0x0000_FFFF),
    default_number(0x1018, 2, 0x0000_0402),
    default_number(0x1018, 3, 0x0001_0000),
    default_number(0x1018, 4, 1),
    (0x1400, 1, DefaultValue::PlusNode(1 << 31 | 0x200)),
    (0x1401, 1, DefaultValue::PlusNode(1 << 31 | 0x300)),
    (0x1402, 1, DefaultValue::PlusNode(1 << 31 | 0x400)),
    (0x1403, 1, DefaultValue::PlusNode(1 << 31 | 0x500)),
    default_number(0x1600, 0, 1),
    default_number(0x1600, 1, 0x6040_0010),
    default_number(0x1601, 0, 2),
    default_number(0x1601, 1, 0x6040_0010),
    default_number(0x1601, 2, 0x6060_0008),
    default_number(0x1602, 0, 2),
    default_number(0x1602, 1, 0x6040_0010),
    default_number(0x1602, 2, 0x607A_0020),
    default_number(0x1603, 0, 2),
    default_number(0x1603, 1, 0x6040_0010),
    default_number(0x1603, 2, 0x60FF_0020),
    default_number(0x1800, 5, 100),
    (0x1801, 1, DefaultValue::PlusNode(1 << 31 | 0x280)),
    (0x1802, 1, DefaultValue::PlusNode(1 << 31 | 0x380)),
    (0x1803, 1, DefaultValue::PlusNode(1 << 31 | 0x480)),
    default_number(0x1A00, 0, 1),
    default_number(0x1A00, 1, 0x6041_0010),
    default_number(0x1A01, 0, 2),
    default_number(0x1A01, 1, 0x6041_0010),
    default_number(0x1A01, 2, 0x6061_0008),
    default_number(0x1A02, 0, 2),
    default_number(0x1A02, 1, 0x6041_0010),
    default_number(0x1A02, 2, 0x6064_0020),
    default_number(0x1A03, 0, 2),
    default_number(0x1A03, 1, 0x6041_0010),
    default_number(0x1A03, 2, 0x606C_0020),
];

const fn default_text(index: u16, name: &'static str, value: &'static str) -> ObjectEntry {
    entry(index, 0, ValueType::TEXT, RO_UNMAPPED, PROTOCOL_TAG, name)
        .with_default_value(DefaultValue::Text(value))
}

/// Device information of the node.
const DEVICE_ENTRIES: [ObjectEntry; 4] = [
    entry(0x1000, 0, ValueType::U32, RO_UNMAPPED, PROTOCOL_TAG, "device type")
        .with_default(0x0002_0192),
    default_text(0x1008, "device name", "Polepair CiA 402 drive"),
    default_text(0x1009, "hardware version", "simulated"),
    default_text(0x100A, "software version", env!("CARGO_PKG_VERSION")),
];

const STANDARD_LEN: usize = standard_len(PDOS, 0);
const STANDARD_ENTRIES: [ObjectEntry; STANDARD_LEN] = standard_entries(PDOS as u16, &[], &DEFAULTS);
const PROTOCOL_LEN: usize = STANDARD_LEN + DEVICE_ENTRIES.len();
static ENTRIES: [ObjectEntry; PROTOCOL_LEN + APPLICATION_ENTRIES.len()] =
    merge(&merge::<PROTOCOL_LEN>(&DEVICE_ENTRIES, &STANDARD_ENTRIES), &APPLICATION_ENTRIES);
static PLACES: [u16; 1024] = Dictionary::hash_slots(&ENTRIES);
/// The drive's dictionary.
pub static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);

/// Values from the factory, by tag.
const FACTORY_VALUES: [i32; stored::COUNT] = {
    let (mut values, mut at) = ([0; stored::COUNT], 0);
    while at < APPLICATION_ENTRIES.len() {
        let entry = &APPLICATION_ENTRIES[at];
        if (entry.tag as usize) < stored::COUNT {
            values[entry.tag as usize] = entry.default_bits(0) as i32;
        }
        at += 1;
    }
    values
};

/// Writable values, and their meaning.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Objects {
    /// rad of the motor in a user unit of position, of velocity and of acceleration.
    rad_per_unit: f64,
    rad_per_velocity_unit: f64,
    rad_per_acceleration_unit: f64,
    /// Radians in a unit of position and of speed, with the sign of 607Eh.
    rad_per_position: f64,
    rad_per_velocity: f64,
    /// User units of a rad, and of a rad/s.
    positions_per_rad: f64,
    velocities_per_rad: f64,
    /// Settings for which this drive's own stand in while they are 0.
    zero_settings: u64,
    values: [i32; stored::COUNT],
    /// Increments of the encoder in a turn.
    increments_per_turn: f64,
}

impl Objects {
    /// Objects with their factory values.
    #[must_use]
    pub fn factory() -> Self {
        let mut objects = Self {
            values: FACTORY_VALUES,
            increments_per_turn: INCREMENTS as f64,
            zero_settings: 0,
            rad_per_unit: 1.0,
            rad_per_velocity_unit: 1.0,
            rad_per_acceleration_unit: 1.0,
            rad_per_position: 1.0,
            rad_per_velocity: 1.0,
            positions_per_rad: 1.0,
            velocities_per_rad: 1.0,
        };
        objects.update_factors();
        objects
    }

    /// Factory settings of another drive: its values by tag, and the increments of its encoder per turn.
    /// Where its data sheet has 0 or nothing for a value that the motor needs, this drive's own value is
    /// used until another one is written \[I\].
    #[must_use]
    pub fn from_defaults(values: impl IntoIterator<Item = (u16, i64)>, turn: u32) -> Self {
        let mut objects = Self::factory();
        objects.increments_per_turn = f64::from(turn.max(1));
        objects.zero_settings = NEEDED;
        for tag in (0..stored::COUNT as u16).filter(|tag| is_in(*tag, NEEDED)) {
            objects.values[usize::from(tag)] = 0;
        }
        for (tag, value) in values {
            objects.set(tag, value as i32);
            if value != 0 {
                objects.zero_settings &= !bits(&[tag]);
            }
        }
        objects.update_factors();
        objects
    }

    /// Increments of the encoder in a turn.
    #[must_use]
    pub const fn increments_per_turn(&self) -> f64 {
        self.increments_per_turn
    }

    /// A value; 0 for a tag that is none of [`stored`].
    #[inline]
    #[must_use]
    pub fn value(&self, tag: u16) -> i32 {
        self.values.get(usize::from(tag)).copied().unwrap_or(0)
    }

    /// Sets a value.
    #[inline]
    pub fn set(&mut self, tag: u16, value: i32) {
        if let Some(index) = self.values.get_mut(usize::from(tag)) {
            *index = value;
        }
        if is_in(tag, SCALES) {
            self.update_factors();
        }
    }

    /// The settings without commands: the values to store for the next power-up.
    #[must_use]
    pub fn settings(&self) -> Self {
        let mut settings = self.clone();
        settings.values[..COMMAND_COUNT].fill(0);
        for command in
            [stored::VL_TARGET, stored::RECORD, stored::ACTIVE_RECORD, stored::TOUCH_PROBE]
        {
            settings.values[usize::from(command)] = 0;
        }
        settings
    }

    fn update_factors(&mut self) {
        let gear = self.value_ratio(stored::GEAR_MOTOR, stored::GEAR_SHAFT);
        // A setting that contradicts another one changes nothing.
        let scales = [&units::POSITION, &units::VELOCITY, &units::ACCELERATION]
            .map(|rule| (rule.compute)(&|key| self.scale_object(key), false).ok());
        let [position, velocity, acceleration] = scales;
        self.rad_per_unit =
            position.map_or(self.rad_per_unit, |scale| motor_scale(TAU, scale, gear));
        self.rad_per_velocity_unit =
            velocity.map_or(self.rad_per_velocity_unit, |scale| motor_scale(RPM, scale, gear));
        self.rad_per_acceleration_unit = acceleration
            .map_or(self.rad_per_acceleration_unit, |scale| motor_scale(RPM, scale, gear));
        (self.rad_per_position, self.rad_per_velocity) = (
            self.rad_per_unit * self.polarity_sign(0x80),
            self.rad_per_velocity_unit * self.polarity_sign(0x40),
        );
        (self.positions_per_rad, self.velocities_per_rad) =
            (1.0 / self.rad_per_position, 1.0 / self.rad_per_velocity);
    }

    fn polarity_sign(&self, bit: i32) -> f64 {
        if self.value(stored::POLARITY) & bit != 0 { -1.0 } else { 1.0 }
    }

    fn value_ratio(&self, over: u16, under: u16) -> f64 {
        self.real_value(over) / self.real_value(under).max(1.0)
    }

    /// The objects that units are computed from. 607Eh is not among them: a drive turns its values round
    /// by itself.
    fn scale_object(&self, key: ObjectKey) -> Option<i64> {
        let tag = match key {
            (0x608F, 1) => return Some(nearest(self.increments_per_turn)),
            (0x6091, 1) => stored::GEAR_MOTOR,
            (0x6091, 2) => stored::GEAR_SHAFT,
            (0x6092, 1) => stored::FEED,
            (0x6092, 2) => stored::FEED_TURNS,
            (0x6093, 1) => stored::POSITION_FACTOR,
            (0x6093, 2) => stored::POSITION_FACTOR_DIVISOR,
            (0x6094, 1) => stored::VELOCITY_ENCODER_FACTOR,
            (0x6094, 2) => stored::VELOCITY_ENCODER_FACTOR_DIVISOR,
            (0x6095, 1) => stored::VELOCITY_FACTOR_1,
            (0x6095, 2) => stored::VELOCITY_FACTOR_1_DIVISOR,
            (0x6096, 1) => stored::VELOCITY_FACTOR,
            (0x6096, 2) => stored::VELOCITY_FACTOR_DIVISOR,
            (0x6097, 1) => stored::ACCELERATION_FACTOR,
            (0x6097, 2) => stored::ACCELERATION_FACTOR_DIVISOR,
            (0x60A8, 0) => stored::SI_POSITION,
            (0x60A9, 0) => stored::SI_VELOCITY,
            (0x60AA, 0) => stored::SI_ACCELERATION,
            _ => return None,
        };
        Some(self.value(tag).cast_unsigned().into())
    }

    #[inline]
    fn real_value(&self, tag: u16) -> f64 {
        let value = self.value(tag);
        if value == 0 && is_in(tag, self.zero_settings) {
            self.fallback_value(tag)
        } else if is_in(tag, UNSIGNED) {
            f64::from(value.cast_unsigned())
        } else {
            f64::from(value)
        }
    }

    /// This drive's own value of a setting that was left open.
    #[cold]
    fn fallback_value(&self, tag: u16) -> f64 {
        let own = f64::from(FACTORY_VALUES[usize::from(tag)]);
        match tag {
            stored::FEED => self.increments_per_turn,
            _ if is_in(tag, IN_UNITS) => own * TAU / (self.unit_of(tag) * INCREMENTS as f64),
            _ => own,
        }
    }

    /// rad of the motor in the user unit of a setting.
    #[inline]
    const fn unit_of(&self, tag: u16) -> f64 {
        match tag {
            _ if is_in(tag, VELOCITIES) => self.rad_per_velocity_unit,
            _ if is_in(tag, ACCELERATIONS) => self.rad_per_acceleration_unit,
            _ => self.rad_per_unit,
        }
    }

    /// A value in user units as rad of the motor.
    #[inline]
    fn rad_value(&self, tag: u16) -> f64 {
        self.real_value(tag) * self.unit_of(tag)
    }

    /// An unsigned value of 32 bits in user units as rad of the motor.
    #[inline]
    fn unsigned_rad_value(&self, tag: u16) -> f64 {
        match self.value(tag).cast_unsigned() {
            u32::MAX => f64::INFINITY,
            _ => self.rad_value(tag),
        }
    }

    #[inline]
    fn window(&self, width: u16, ms: u16) -> Window {
        Window {
            width: self.unsigned_rad_value(width),
            ms: self.value(ms).cast_unsigned() & 0xFFFF,
        }
    }

    /// A position, or a way, in user units.
    #[inline]
    #[must_use]
    pub fn to_user_position(&self, rad: f64) -> i32 {
        nearest(rad * self.positions_per_rad) as i32
    }

    /// A speed in user units.
    #[inline]
    #[must_use]
    pub fn to_user_velocity(&self, rad_per_s: f64) -> i32 {
        nearest(rad_per_s * self.velocities_per_rad) as i32
    }

    fn braking_option(&self, tag: u16) -> Braking {
        match self.value(tag) {
            0 => Braking::Coast,
            1 | 5 => Braking::Ramp,
            2 | 6 => Braking::Quick,
            _ => Braking::Hard,
        }
    }
}

fn motor_scale(per: f64, scale: ScaleRuleValue, gear: f64) -> f64 {
    per * gear * scale.factor
}
