//! The object dictionary of a TS, and the meaning of its drive profile (TS manual V2, chapter 3).
//!
//! Fn registers start at 2000h, Dn readings at 3000h, 16 bits each, as in Modbus. Speeds are in 0.1 rpm,
//! except 606Ch in rpm; ramps are the time from 0 to 3000 rpm; positions are in pulses, which 6093h
//! converts to increments.

use core::f64::consts::TAU;

use super::registers::{DN_COUNT, FN_COUNT, Registers, fn_registers};
use super::shaft::COUNTS_PER_TURN;
use polepair_core::plant::Limits;
use polepair_core::proto::canopen::device::motion::{
    Braking, HomingSettings, MotionLimits, MotionSettings, MotionWindows, StopReactions, Window,
    modes,
};
use polepair_core::proto::canopen::device::{standard_entries, standard_len};
use polepair_core::proto::canopen::od::{
    DefaultValue, Dictionary, ObjectAccess, ObjectEntry, PROTOCOL_TAG, ValueType, merge,
};
use polepair_core::units::nearest;

/// PDOs each way (§3.4).
pub const PDOS: usize = 4;
/// Top speed of the set-point, rad/s.
const TOP_SPEED: f64 = 6000.0 / 60.0 * TAU;
/// Speed that the times of ramps go to, rad/s (§3.6.1: 3000 rpm).
const RAMP_END_SPEED: f64 = 3000.0 / 60.0 * TAU;
/// rad/s of 0.1 rpm.
const TENTH_RPM: f64 = 0.1 / 60.0 * TAU;

/// Tags: Fn registers have their numbers, Dn readings come behind them, then the drive profile's
/// objects.
pub const DN_TAGS: u16 = 0x300;
/// First tag of stored objects.
pub const STORED_TAGS: u16 = 0x400;
/// First tag of computed objects.
pub const COMPUTED_TAGS: u16 = 0x500;

/// Tags of objects that are stored as written.
pub mod stored {
    use super::STORED_TAGS;
    /// Controlword.
    pub const CONTROL: u16 = STORED_TAGS;
    /// Mode of operation.
    pub const MODE: u16 = STORED_TAGS + 1;
    /// Target position, pulses.
    pub const TARGET_POSITION: u16 = STORED_TAGS + 2;
    /// Profile velocity, 0.1 rpm.
    pub const PROFILE_VELOCITY: u16 = STORED_TAGS + 3;
    /// Ramp up, ms to 3000 rpm.
    pub const ACCELERATION: u16 = STORED_TAGS + 4;
    /// Ramp down, ms from 3000 rpm.
    pub const DECELERATION: u16 = STORED_TAGS + 5;
    /// Target velocity, 0.1 rpm.
    pub const TARGET_VELOCITY: u16 = STORED_TAGS + 6;
    /// Target torque, 0.1 %.
    pub const TARGET_TORQUE: u16 = STORED_TAGS + 7;
    /// Torque slope.
    pub const TORQUE_SLOPE: u16 = STORED_TAGS + 8;
    /// Following error window, pulses.
    pub const FOLLOWING_WINDOW: u16 = STORED_TAGS + 9;
    /// Following error time, ms.
    pub const FOLLOWING_TIME: u16 = STORED_TAGS + 10;
    /// Position window, pulses.
    pub const POSITION_WINDOW: u16 = STORED_TAGS + 11;
    /// Position window time, ms.
    pub const POSITION_TIME: u16 = STORED_TAGS + 12;
    /// Velocity window, 0.1 rpm.
    pub const VELOCITY_WINDOW: u16 = STORED_TAGS + 13;
    /// Velocity window time, ms.
    pub const VELOCITY_TIME: u16 = STORED_TAGS + 14;
    /// Velocity threshold, 0.1 rpm.
    pub const STANDSTILL: u16 = STORED_TAGS + 15;
    /// Velocity threshold time, ms.
    pub const STANDSTILL_TIME: u16 = STORED_TAGS + 16;
    /// Homing method.
    pub const HOMING_METHOD: u16 = STORED_TAGS + 17;
    /// Homing speed to the switch, 0.1 rpm.
    pub const HOMING_FAST: u16 = STORED_TAGS + 18;
    /// Homing speed to the zero, 0.1 rpm.
    pub const HOMING_SLOW: u16 = STORED_TAGS + 19;
    /// Homing ramp, ms to 3000 rpm.
    pub const HOMING_ACCELERATION: u16 = STORED_TAGS + 20;
    /// Home offset, pulses.
    pub const HOME_OFFSET: u16 = STORED_TAGS + 21;
    /// Position factor, numerator.
    pub const FACTOR: u16 = STORED_TAGS + 22;
    /// Position factor, divisor.
    pub const DIVISOR: u16 = STORED_TAGS + 23;
    /// Number of these tags.
    pub const COUNT: usize = 24;
}

/// Tags of objects that are computed.
pub mod computed {
    use super::COMPUTED_TAGS;
    /// Statusword.
    pub const STATUS: u16 = COMPUTED_TAGS;
    /// Mode in force.
    pub const MODE: u16 = COMPUTED_TAGS + 1;
    /// Position demand, pulses.
    pub const POSITION_DEMAND: u16 = COMPUTED_TAGS + 2;
    /// Position, increments.
    pub const INCREMENTS: u16 = COMPUTED_TAGS + 3;
    /// Position, pulses.
    pub const POSITION: u16 = COMPUTED_TAGS + 4;
    /// Speed, 0.1 rpm.
    pub const SENSOR_VELOCITY: u16 = COMPUTED_TAGS + 5;
    /// Speed demand, 0.1 rpm.
    pub const VELOCITY_DEMAND: u16 = COMPUTED_TAGS + 6;
    /// Speed, rpm.
    pub const VELOCITY: u16 = COMPUTED_TAGS + 7;
    /// Following error, pulses.
    pub const FOLLOWING_ERROR: u16 = COMPUTED_TAGS + 8;
    /// Position demand, increments.
    pub const DEMAND_INCREMENTS: u16 = COMPUTED_TAGS + 9;
    /// Alarm code.
    pub const ERROR_CODE: u16 = COMPUTED_TAGS + 10;
    /// Torque, 0.1 %.
    pub const TORQUE: u16 = COMPUTED_TAGS + 11;
    /// Time since power-on, µs.
    pub const TIME: u16 = COMPUTED_TAGS + 12;
}

const RO: ObjectAccess = ObjectAccess::RO.mappable();
const RW: ObjectAccess = ObjectAccess::RW.mappable();

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

/// The drive profile's objects as the manual's tables have them (§3.6), and three that hosts look
/// for and the manual does not name: 603Fh, 6077h, 6502h `[I]`. Defaults are `[I]` too.
const PROFILE_ENTRIES: [ObjectEntry; 39] = {
    use computed as r;
    use stored as k;
    let (i8, i16, i32) = (ValueType::I8, ValueType::I16, ValueType::I32);
    let (u8, u16, u32) = (ValueType::U8, ValueType::U16, ValueType::U32);
    let most = core::primitive::i32::MAX as i64;
    let ramp = 200;
    [
        entry(0x603F, 0, u16, RO, r::ERROR_CODE, "error code"),
        entry(0x6040, 0, u16, RW, k::CONTROL, "controlword"),
        entry(0x6041, 0, u16, RO, r::STATUS, "statusword"),
        entry(0x6060, 0, i8, RW, k::MODE, "modes of operation"),
        entry(0x6061, 0, i8, RO, r::MODE, "modes of operation display"),
        entry(0x6062, 0, i32, RO, r::POSITION_DEMAND, "position demand value"),
        entry(0x6063, 0, i32, RO, r::INCREMENTS, "position actual value in increments"),
        entry(0x6064, 0, i32, RO, r::POSITION, "position actual value"),
        entry(0x6065, 0, u32, RW, k::FOLLOWING_WINDOW, "following error window")
            .with_default(10_000),
        entry(0x6066, 0, u16, RW, k::FOLLOWING_TIME, "following error time out"),
        entry(0x6067, 0, u32, RW, k::POSITION_WINDOW, "position window").with_default(10),
        entry(0x6068, 0, u16, RW, k::POSITION_TIME, "position window time"),
        entry(0x6069, 0, i32, RO, r::SENSOR_VELOCITY, "velocity sensor actual value"),
        entry(0x606B, 0, i32, RO, r::VELOCITY_DEMAND, "velocity demand value"),
        entry(0x606C, 0, i32, RO, r::VELOCITY, "velocity actual value"),
        entry(0x606D, 0, u16, RW, k::VELOCITY_WINDOW, "velocity window").with_default(100),
        entry(0x606E, 0, u16, RW, k::VELOCITY_TIME, "velocity window time"),
        entry(0x606F, 0, u16, RW, k::STANDSTILL, "velocity threshold").with_default(50),
        entry(0x6070, 0, u16, RW, k::STANDSTILL_TIME, "velocity threshold time"),
        entry(0x6071, 0, i16, RW, k::TARGET_TORQUE, "target torque"),
        entry(0x6077, 0, i16, RO, r::TORQUE, "torque actual value"),
        entry(0x607A, 0, i32, RW, k::TARGET_POSITION, "target position"),
        entry(0x607C, 0, i32, RW, k::HOME_OFFSET, "home offset"),
        entry(0x6081, 0, u32, RW, k::PROFILE_VELOCITY, "profile velocity").with_limits(0, 60_000),
        entry(0x6083, 0, u32, RW, k::ACCELERATION, "profile acceleration")
            .with_default(ramp)
            .with_limits(0, most),
        entry(0x6084, 0, u32, RW, k::DECELERATION, "profile deceleration")
            .with_default(ramp)
            .with_limits(0, most),
        entry(0x6087, 0, i32, RW, k::TORQUE_SLOPE, "torque slope").with_limits(0, most),
        entry(0x6093, 0, u8, ObjectAccess::RO, PROTOCOL_TAG, "position factor: highest sub-index")
            .with_default(2),
        entry(0x6093, 1, u32, RW, k::FACTOR, "numerator").with_default(1).with_limits(1, most),
        entry(0x6093, 2, u32, RW, k::DIVISOR, "divisor").with_default(1).with_limits(1, most),
        entry(0x6098, 0, i8, RW, k::HOMING_METHOD, "homing method").with_default(35),
        entry(0x6099, 0, u8, ObjectAccess::RO, PROTOCOL_TAG, "homing speeds: highest sub-index")
            .with_default(2),
        entry(0x6099, 1, u32, RW, k::HOMING_FAST, "speed to the switch")
            .with_default(2000)
            .with_limits(0, 60_000),
        entry(0x6099, 2, u32, RW, k::HOMING_SLOW, "speed to the zero")
            .with_default(200)
            .with_limits(0, 60_000),
        entry(0x609A, 0, u32, RW, k::HOMING_ACCELERATION, "homing acceleration")
            .with_default(ramp)
            .with_limits(0, most),
        entry(0x60F4, 0, i32, RO, r::FOLLOWING_ERROR, "following error actual value"),
        entry(0x60FC, 0, i32, RO, r::DEMAND_INCREMENTS, "position demand value in increments"),
        entry(0x60FF, 0, i32, RW, k::TARGET_VELOCITY, "target velocity")
            .with_limits(-60_000, 60_000),
        entry(0x6502, 0, u32, ObjectAccess::RO, PROTOCOL_TAG, "supported drive modes")
            .with_default(0x2D),
    ]
};

/// Registers with a sign `[I]`: the speed, and the readings that Modbus shows signed.
const fn register_type(index: u16) -> ValueType {
    match index {
        0x2033 | 0x3000 | 0x3002 | 0x3016 => ValueType::I16,
        _ => ValueType::U16,
    }
}

const REGISTERS: usize = FN_COUNT + DN_COUNT as usize;

const fn register_entries() -> [ObjectEntry; REGISTERS] {
    let mut entries = [entry(0, 0, ValueType::U16, RO, 0, ""); REGISTERS];
    let mut at = 0;
    while at < REGISTERS {
        let number = at as u16;
        let is_fn = at < FN_COUNT;
        let index = if is_fn { 0x2000 + number } else { 0x3000 + number - DN_TAGS };
        let access = if is_fn { RW } else { RO };
        entries[at] = entry(index, 0, register_type(index), access, number, "");
        at += 1;
    }
    entries
}

/// Objects of the protocol that the manual does not name: the drive does not have them `[I]`.
const MISSING_OBJECTS: [u16; 7] = [0x1003, 0x100C, 0x100D, 0x1010, 0x1011, 0x1019, 0x1029];
/// Their entries.
const MISSING_ENTRIES: usize = 5 + 1 + 1 + 4 + 4 + 1 + 3;

/// The maker has no number that is known `[I]`. Nor are the factory's mappings `[I]`: nothing is
/// received, as every recipe maps its own objects; statusword, by change and every 100 ms, position and
/// speed are sent.
const DEFAULTS: [(u16, u8, DefaultValue); 12] = [
    default_number(0x1018, 3, 2),
    default_number(0x1018, 4, 1),
    default_number(0x1800, 2, 255),
    default_number(0x1800, 5, 800),
    default_number(0x1801, 2, 254),
    default_number(0x1802, 2, 254),
    default_number(0x1803, 2, 254),
    default_number(0x1A00, 0, 1),
    default_number(0x1A00, 1, 0x6041_0010),
    default_number(0x1A01, 0, 2),
    default_number(0x1A01, 1, 0x6064_0020),
    default_number(0x1A01, 2, 0x606C_0020),
];

const fn default_number(index: u16, sub: u8, value: i64) -> (u16, u8, DefaultValue) {
    (index, sub, DefaultValue::Number(value))
}

const DEVICE_ENTRIES: [ObjectEntry; 2] = [
    entry(0x1000, 0, ValueType::U32, ObjectAccess::RO, PROTOCOL_TAG, "device type")
        .with_default(0x0002_0192),
    entry(0x1013, 0, ValueType::U32, RO, computed::TIME, "high resolution time stamp"),
];
const STANDARD_LEN: usize = standard_len(PDOS, MISSING_ENTRIES);
const STANDARD_ENTRIES: [ObjectEntry; STANDARD_LEN] =
    standard_entries(PDOS as u16, &MISSING_OBJECTS, &DEFAULTS);
const PROTOCOL_LEN: usize = STANDARD_LEN + DEVICE_ENTRIES.len();
const OWN_LEN: usize = REGISTERS + PROFILE_ENTRIES.len();
static ENTRIES: [ObjectEntry; PROTOCOL_LEN + OWN_LEN] = merge(
    &merge::<PROTOCOL_LEN>(&DEVICE_ENTRIES, &STANDARD_ENTRIES),
    &merge::<OWN_LEN>(&register_entries(), &PROFILE_ENTRIES),
);
static PLACES: [u16; 2048] = Dictionary::hash_slots(&ENTRIES);
/// The drive's dictionary.
pub static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);

/// Written values of the drive profile's objects.
#[derive(Clone, Debug)]
pub struct Objects([i32; stored::COUNT]);

impl Default for Objects {
    fn default() -> Self {
        let mut objects = Self([0; stored::COUNT]);
        for entry in &PROFILE_ENTRIES {
            objects.set(entry.tag, entry.default_bits(0) as i32);
        }
        objects
    }
}

impl Objects {
    /// A value; 0 for a tag that is none of [`stored`].
    #[must_use]
    pub fn value(&self, tag: u16) -> i32 {
        self.0.get(usize::from(tag.wrapping_sub(STORED_TAGS))).copied().unwrap_or(0)
    }

    /// Sets a value.
    pub fn set(&mut self, tag: u16, value: i32) {
        if let Some(index) = self.0.get_mut(usize::from(tag.wrapping_sub(STORED_TAGS))) {
            *index = value;
        }
    }

    fn real_value(&self, tag: u16) -> f64 {
        f64::from(self.value(tag))
    }

    /// rad of a pulse: 6093h makes increments of pulses `[I]`.
    fn rad_per_pulse(&self) -> f64 {
        self.real_value(stored::FACTOR) / self.real_value(stored::DIVISOR) / COUNTS_PER_TURN * TAU
    }

    /// rad in pulses.
    #[must_use]
    pub fn pulses(&self, rad: f64) -> i32 {
        nearest(rad / self.rad_per_pulse()) as i32
    }

    fn pulses_window(&self, width: u16, ms: u16) -> Window {
        let width = match self.value(width).cast_unsigned() {
            u32::MAX => f64::INFINITY,
            width => f64::from(width) * self.rad_per_pulse(),
        };
        Window { width, ms: self.milliseconds(ms) }
    }

    fn speed_window(&self, width: u16, ms: u16) -> Window {
        Window { width: self.real_value(width) * TENTH_RPM, ms: self.milliseconds(ms) }
    }

    fn milliseconds(&self, tag: u16) -> u32 {
        self.value(tag).cast_unsigned() & 0xFFFF
    }

    /// Slope of a ramp with this duration to 3000 rpm, rad/s²; 0 is no ramp.
    fn slope(&self, tag: u16) -> f64 {
        let ms = self.real_value(tag);
        if ms > 0.0 { RAMP_END_SPEED / ms * 1000.0 } else { 0.0 }
    }
}

/// The objects beside the registers.
#[derive(Debug)]
pub struct CommandedObjects<'a> {
    /// The objects.
    pub objects: &'a Objects,
    /// The registers.
    pub registers: &'a Registers,
    /// Homing methods 3 and 19 begin forward.
    pub homes_by_cia: bool,
}

impl MotionLimits for CommandedObjects<'_> {
    fn profile(&self) -> Limits {
        Limits {
            velocity: self.objects.real_value(stored::PROFILE_VELOCITY) * TENTH_RPM,
            acceleration: self.objects.slope(stored::ACCELERATION),
            deceleration: self.objects.slope(stored::DECELERATION),
            smoothing_s: 0.0,
        }
    }

    /// The manual gives no unit: thousandths of the rated torque per second `[I]`, as CiA 402 has it.
    fn torque_slope(&self) -> f64 {
        self.objects.real_value(stored::TORQUE_SLOPE) / 1000.0
    }

    /// The manual names no object for it: the ramp down `[I]`.
    fn quick_stop(&self) -> f64 {
        self.objects.slope(stored::DECELERATION)
    }

    /// Fn_95 limits the speed in torque mode (§3.6.3); 0 is no limit `[I]`.
    fn velocity_max(&self) -> f64 {
        let limit = f64::from(self.registers.value(fn_registers::TORQUE_SPEED)) / 60.0 * TAU;
        match self.mode() {
            modes::PROFILE_TORQUE if limit > 0.0 => limit,
            modes::PROFILE_TORQUE => f64::INFINITY,
            _ => TOP_SPEED,
        }
    }
}

impl MotionWindows for CommandedObjects<'_> {
    fn position_window(&self) -> Window {
        self.objects.pulses_window(stored::POSITION_WINDOW, stored::POSITION_TIME)
    }

    fn following_window(&self) -> Window {
        self.objects.pulses_window(stored::FOLLOWING_WINDOW, stored::FOLLOWING_TIME)
    }

    fn velocity_window(&self) -> Window {
        self.objects.speed_window(stored::VELOCITY_WINDOW, stored::VELOCITY_TIME)
    }

    fn standstill(&self) -> Window {
        self.objects.speed_window(stored::STANDSTILL, stored::STANDSTILL_TIME)
    }
}

impl StopReactions for CommandedObjects<'_> {
    /// `[I]` It stays in that state, so that statusword 0017h is seen.
    fn quick_stop_option(&self) -> (Braking, bool) {
        (Braking::Ramp, true)
    }

    /// `[I]`
    fn disable_option(&self) -> Braking {
        Braking::Coast
    }
}

impl MotionSettings for CommandedObjects<'_> {
    fn mode(&self) -> i8 {
        self.objects.value(stored::MODE) as i8
    }

    fn target_position(&self) -> f64 {
        self.objects.real_value(stored::TARGET_POSITION) * self.objects.rad_per_pulse()
    }

    fn target_velocity(&self) -> f64 {
        self.objects.real_value(stored::TARGET_VELOCITY) * TENTH_RPM
    }

    fn target_torque(&self) -> f64 {
        self.objects.real_value(stored::TARGET_TORQUE) / 1000.0
    }

    /// "Reverse, home switch" (methods 3 and 19, §3.6.4): the search begins in reverse wherever it is, as
    /// methods 14 and 30 of CiA 402 do; its 3 and 19 begin forward outside the switch.
    fn homing(&self) -> HomingSettings {
        HomingSettings {
            method: match self.objects.value(stored::HOMING_METHOD) as i8 {
                3 if !self.homes_by_cia => 14,
                19 if !self.homes_by_cia => 30,
                method => method,
            },
            fast: self.objects.real_value(stored::HOMING_FAST) * TENTH_RPM,
            slow: self.objects.real_value(stored::HOMING_SLOW) * TENTH_RPM,
            acceleration: self.objects.slope(stored::HOMING_ACCELERATION),
            offset: self.objects.real_value(stored::HOME_OFFSET) * self.objects.rad_per_pulse(),
        }
    }
}

/// The thirteen homing methods (§3.6.4).
#[must_use]
pub const fn is_method(method: i8) -> bool {
    matches!(method, -18 | -17 | -2 | -1 | 1..=4 | 17..=20 | 35)
}

/// The methods that search the home switch.
#[must_use]
pub const fn seeks_home_switch(method: i8) -> bool {
    matches!(method, 3 | 4 | 19 | 20)
}

/// The modes of operation (§3.6), and none.
#[must_use]
pub const fn is_mode(mode: i8) -> bool {
    matches!(mode, 0 | 1 | 3 | 4 | 6)
}
