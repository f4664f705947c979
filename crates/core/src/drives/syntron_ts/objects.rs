//! The dictionary of a TS, and what its drive profile's objects mean (TS manual V2, chapter 3).
//!
//! Fn registers are at 2000h on, Dn readings at 3000h on, 16 bits each: the same that Modbus has.
//! Speeds are in 0.1 rpm, but 606Ch in rpm; ramps are the time from rest to 3000 rpm; positions in
//! pulses, of which 6093h makes increments.

use core::f64::consts::TAU;

use super::registers::{DN_COUNT, FN_COUNT, Registers, fns};
use super::shaft::COUNTS_PER_TURN;
use crate::plant::Limits;
use crate::proto::canopen::device::motion::{Braking, HomingSettings, Settings, Window, modes};
use crate::proto::canopen::device::{standard, standard_len};
use crate::proto::canopen::od::{Access, Dictionary, Entry, OWN, Type, Worth, merge};
use crate::units::nearest;

/// PDOs each way (§3.4).
pub const PDOS: usize = 4;
/// Top speed of the set-point, rad/s.
const TOP: f64 = 6000.0 / 60.0 * TAU;
/// Speed that the times of ramps go to, rad/s (§3.6.1: 3000 rpm).
const RAMP_TO: f64 = 3000.0 / 60.0 * TAU;
/// rad/s of 0.1 rpm.
const TENTH_RPM: f64 = 0.1 / 60.0 * TAU;

/// Tags: Fn registers have their numbers, Dn readings come behind them, then the drive profile's
/// objects.
pub const DN: u16 = 0x300;
/// First tag of what is kept as written.
pub const KEPT: u16 = 0x400;
/// First tag of what is read.
pub const READ: u16 = 0x500;

/// Tags of what is kept as written.
pub mod kept {
    use super::KEPT;
    /// Controlword.
    pub const CONTROL: u16 = KEPT;
    /// Mode of operation.
    pub const MODE: u16 = KEPT + 1;
    /// Target position, pulses.
    pub const TARGET_POSITION: u16 = KEPT + 2;
    /// Profile velocity, 0.1 rpm.
    pub const PROFILE_VELOCITY: u16 = KEPT + 3;
    /// Ramp up, ms to 3000 rpm.
    pub const ACCELERATION: u16 = KEPT + 4;
    /// Ramp down, ms from 3000 rpm.
    pub const DECELERATION: u16 = KEPT + 5;
    /// Target velocity, 0.1 rpm.
    pub const TARGET_VELOCITY: u16 = KEPT + 6;
    /// Target torque, 0.1 %.
    pub const TARGET_TORQUE: u16 = KEPT + 7;
    /// Torque slope.
    pub const TORQUE_SLOPE: u16 = KEPT + 8;
    /// Following error window, pulses.
    pub const FOLLOWING_WINDOW: u16 = KEPT + 9;
    /// Following error time, ms.
    pub const FOLLOWING_TIME: u16 = KEPT + 10;
    /// Position window, pulses.
    pub const POSITION_WINDOW: u16 = KEPT + 11;
    /// Position window time, ms.
    pub const POSITION_TIME: u16 = KEPT + 12;
    /// Velocity window, 0.1 rpm.
    pub const VELOCITY_WINDOW: u16 = KEPT + 13;
    /// Velocity window time, ms.
    pub const VELOCITY_TIME: u16 = KEPT + 14;
    /// Velocity threshold, 0.1 rpm.
    pub const STANDSTILL: u16 = KEPT + 15;
    /// Velocity threshold time, ms.
    pub const STANDSTILL_TIME: u16 = KEPT + 16;
    /// Homing method.
    pub const HOMING_METHOD: u16 = KEPT + 17;
    /// Homing speed to the switch, 0.1 rpm.
    pub const HOMING_FAST: u16 = KEPT + 18;
    /// Homing speed to the zero, 0.1 rpm.
    pub const HOMING_SLOW: u16 = KEPT + 19;
    /// Homing ramp, ms to 3000 rpm.
    pub const HOMING_ACCELERATION: u16 = KEPT + 20;
    /// Home offset, pulses.
    pub const HOME_OFFSET: u16 = KEPT + 21;
    /// Position factor, numerator.
    pub const FACTOR: u16 = KEPT + 22;
    /// Position factor, divisor.
    pub const DIVISOR: u16 = KEPT + 23;
    /// How many there are.
    pub const COUNT: usize = 24;
}

/// Tags of what is read.
pub mod read {
    use super::READ;
    /// Statusword.
    pub const STATUS: u16 = READ;
    /// Mode in force.
    pub const MODE: u16 = READ + 1;
    /// Position demand, pulses.
    pub const POSITION_DEMAND: u16 = READ + 2;
    /// Position, increments.
    pub const INCREMENTS: u16 = READ + 3;
    /// Position, pulses.
    pub const POSITION: u16 = READ + 4;
    /// Speed, 0.1 rpm.
    pub const SENSOR_VELOCITY: u16 = READ + 5;
    /// Speed demand, 0.1 rpm.
    pub const VELOCITY_DEMAND: u16 = READ + 6;
    /// Speed, rpm.
    pub const VELOCITY: u16 = READ + 7;
    /// Following error, pulses.
    pub const FOLLOWING_ERROR: u16 = READ + 8;
    /// Position demand, increments.
    pub const DEMAND_INCREMENTS: u16 = READ + 9;
    /// Alarm code.
    pub const ERROR_CODE: u16 = READ + 10;
    /// Torque, 0.1 %.
    pub const TORQUE: u16 = READ + 11;
}

const RO: Access = Access::RO.mappable();
const RW: Access = Access::RW.mappable();

const fn e(i: u16, s: u8, kind: Type, a: Access, tag: u16, name: &'static str) -> Entry {
    Entry::new(i, s, kind, a, tag, name)
}

/// The drive profile's objects as the manual's tables have them (§3.6), and three that hosts look
/// for and the manual does not name: 603Fh, 6077h, 6502h `[I]`. Defaults are `[I]` too.
const PROFILE: [Entry; 39] = {
    use kept as k;
    use read as r;
    let (i8, i16, i32) = (Type::I8, Type::I16, Type::I32);
    let (u8, u16, u32) = (Type::U8, Type::U16, Type::U32);
    let most = core::primitive::i32::MAX as i64;
    let ramp = 200;
    [
        e(0x603F, 0, u16, RO, r::ERROR_CODE, "error code"),
        e(0x6040, 0, u16, RW, k::CONTROL, "controlword"),
        e(0x6041, 0, u16, RO, r::STATUS, "statusword"),
        e(0x6060, 0, i8, RW, k::MODE, "modes of operation"),
        e(0x6061, 0, i8, RO, r::MODE, "modes of operation display"),
        e(0x6062, 0, i32, RO, r::POSITION_DEMAND, "position demand value"),
        e(0x6063, 0, i32, RO, r::INCREMENTS, "position actual value in increments"),
        e(0x6064, 0, i32, RO, r::POSITION, "position actual value"),
        e(0x6065, 0, u32, RW, k::FOLLOWING_WINDOW, "following error window").worth(10_000),
        e(0x6066, 0, u16, RW, k::FOLLOWING_TIME, "following error time out"),
        e(0x6067, 0, u32, RW, k::POSITION_WINDOW, "position window").worth(10),
        e(0x6068, 0, u16, RW, k::POSITION_TIME, "position window time"),
        e(0x6069, 0, i32, RO, r::SENSOR_VELOCITY, "velocity sensor actual value"),
        e(0x606B, 0, i32, RO, r::VELOCITY_DEMAND, "velocity demand value"),
        e(0x606C, 0, i32, RO, r::VELOCITY, "velocity actual value"),
        e(0x606D, 0, u16, RW, k::VELOCITY_WINDOW, "velocity window").worth(100),
        e(0x606E, 0, u16, RW, k::VELOCITY_TIME, "velocity window time"),
        e(0x606F, 0, u16, RW, k::STANDSTILL, "velocity threshold").worth(50),
        e(0x6070, 0, u16, RW, k::STANDSTILL_TIME, "velocity threshold time"),
        e(0x6071, 0, i16, RW, k::TARGET_TORQUE, "target torque"),
        e(0x6077, 0, i16, RO, r::TORQUE, "torque actual value"),
        e(0x607A, 0, i32, RW, k::TARGET_POSITION, "target position"),
        e(0x607C, 0, i32, RW, k::HOME_OFFSET, "home offset"),
        e(0x6081, 0, u32, RW, k::PROFILE_VELOCITY, "profile velocity").within(0, 60_000),
        e(0x6083, 0, u32, RW, k::ACCELERATION, "profile acceleration").worth(ramp).within(0, most),
        e(0x6084, 0, u32, RW, k::DECELERATION, "profile deceleration").worth(ramp).within(0, most),
        e(0x6087, 0, i32, RW, k::TORQUE_SLOPE, "torque slope").within(0, most),
        e(0x6093, 0, u8, Access::RO, OWN, "position factor: highest sub-index").worth(2),
        e(0x6093, 1, u32, RW, k::FACTOR, "numerator").worth(1).within(1, most),
        e(0x6093, 2, u32, RW, k::DIVISOR, "divisor").worth(1).within(1, most),
        e(0x6098, 0, i8, RW, k::HOMING_METHOD, "homing method").worth(35),
        e(0x6099, 0, u8, Access::RO, OWN, "homing speeds: highest sub-index").worth(2),
        e(0x6099, 1, u32, RW, k::HOMING_FAST, "speed to the switch").worth(2000).within(0, 60_000),
        e(0x6099, 2, u32, RW, k::HOMING_SLOW, "speed to the zero").worth(200).within(0, 60_000),
        e(0x609A, 0, u32, RW, k::HOMING_ACCELERATION, "homing acceleration")
            .worth(ramp)
            .within(0, most),
        e(0x60F4, 0, i32, RO, r::FOLLOWING_ERROR, "following error actual value"),
        e(0x60FC, 0, i32, RO, r::DEMAND_INCREMENTS, "position demand value in increments"),
        e(0x60FF, 0, i32, RW, k::TARGET_VELOCITY, "target velocity").within(-60_000, 60_000),
        e(0x6502, 0, u32, Access::RO, OWN, "supported drive modes").worth(0x2D),
    ]
};

/// Registers with a sign `[I]`: the speed, and the readings that Modbus shows signed.
const fn register_type(index: u16) -> Type {
    match index {
        0x2033 | 0x3000 | 0x3002 | 0x3016 => Type::I16,
        _ => Type::U16,
    }
}

const REGISTERS: usize = FN_COUNT + DN_COUNT as usize;

const fn registers() -> [Entry; REGISTERS] {
    let mut entries = [e(0, 0, Type::U16, RO, 0, ""); REGISTERS];
    let mut at = 0;
    while at < REGISTERS {
        let number = at as u16;
        let is_fn = at < FN_COUNT;
        let index = if is_fn { 0x2000 + number } else { 0x3000 + number - DN };
        let access = if is_fn { RW } else { RO };
        entries[at] = e(index, 0, register_type(index), access, number, "");
        at += 1;
    }
    entries
}

/// Objects of the protocol that the manual does not name: the drive does not have them `[I]`.
const MISSING: [u16; 8] = [0x1003, 0x1007, 0x100C, 0x100D, 0x1010, 0x1011, 0x1019, 0x1029];
/// Their entries.
const MISSING_ENTRIES: usize = 5 + 1 + 1 + 1 + 4 + 4 + 1 + 3;

/// The maker has no number that is known `[I]`. Nor are the factory's mappings `[I]`: nothing is
/// received, as every recipe maps what it needs; statusword, by change and every 100 ms, position and
/// speed are sent.
const WORTHS: [(u16, u8, Worth); 12] = [
    number(0x1018, 3, 2),
    number(0x1018, 4, 1),
    number(0x1800, 2, 255),
    number(0x1800, 5, 800),
    number(0x1801, 2, 254),
    number(0x1802, 2, 254),
    number(0x1803, 2, 254),
    number(0x1A00, 0, 1),
    number(0x1A00, 1, 0x6041_0010),
    number(0x1A01, 0, 2),
    number(0x1A01, 1, 0x6064_0020),
    number(0x1A01, 2, 0x606C_0020),
];

const fn number(index: u16, sub: u8, value: i64) -> (u16, u8, Worth) {
    (index, sub, Worth::Number(value))
}

const SELF: [Entry; 1] =
    [e(0x1000, 0, Type::U32, Access::RO, OWN, "device type").worth(0x0002_0192)];
const STANDARD_LEN: usize = standard_len(PDOS, MISSING_ENTRIES);
const STANDARD: [Entry; STANDARD_LEN] = standard(PDOS as u16, &MISSING, &WORTHS);
const PROTOCOL_LEN: usize = STANDARD_LEN + SELF.len();
const OWN_LEN: usize = REGISTERS + PROFILE.len();
static ENTRIES: [Entry; PROTOCOL_LEN + OWN_LEN] =
    merge(&merge::<PROTOCOL_LEN>(&SELF, &STANDARD), &merge::<OWN_LEN>(&registers(), &PROFILE));
static PLACES: [u16; 2048] = Dictionary::places(&ENTRIES);
/// The drive's dictionary.
pub static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);

/// What was written to the drive profile's objects.
#[derive(Clone, Debug)]
pub struct Objects([i32; kept::COUNT]);

impl Default for Objects {
    fn default() -> Self {
        let mut objects = Self([0; kept::COUNT]);
        for entry in &PROFILE {
            objects.set(entry.tag, entry.factory(0) as i32);
        }
        objects
    }
}

impl Objects {
    /// A value; 0 for a tag that is none of [`kept`].
    #[must_use]
    pub fn value(&self, tag: u16) -> i32 {
        self.0.get(usize::from(tag.wrapping_sub(KEPT))).copied().unwrap_or(0)
    }

    /// Sets a value.
    pub fn set(&mut self, tag: u16, value: i32) {
        if let Some(place) = self.0.get_mut(usize::from(tag.wrapping_sub(KEPT))) {
            *place = value;
        }
    }

    fn real(&self, tag: u16) -> f64 {
        f64::from(self.value(tag))
    }

    /// rad of a pulse: 6093h makes increments of pulses `[I]`.
    fn pulse(&self) -> f64 {
        self.real(kept::FACTOR) / self.real(kept::DIVISOR) / COUNTS_PER_TURN * TAU
    }

    /// rad in pulses.
    #[must_use]
    pub fn pulses(&self, rad: f64) -> i32 {
        nearest(rad / self.pulse()) as i32
    }

    fn pulses_window(&self, width: u16, ms: u16) -> Window {
        let width = match self.value(width).cast_unsigned() {
            u32::MAX => f64::INFINITY,
            width => f64::from(width) * self.pulse(),
        };
        Window { width, ms: self.ms(ms) }
    }

    fn speed_window(&self, width: u16, ms: u16) -> Window {
        Window { width: self.real(width) * TENTH_RPM, ms: self.ms(ms) }
    }

    fn ms(&self, tag: u16) -> u32 {
        self.value(tag).cast_unsigned() & 0xFFFF
    }

    /// The slope of a ramp that takes so long to 3000 rpm, rad/s²; 0 is no ramp.
    fn slope(&self, tag: u16) -> f64 {
        let ms = self.real(tag);
        if ms > 0.0 { RAMP_TO / ms * 1000.0 } else { 0.0 }
    }
}

/// The objects beside the registers.
#[derive(Debug)]
pub struct Commands<'a> {
    /// The objects.
    pub objects: &'a Objects,
    /// The registers.
    pub registers: &'a Registers,
}

impl Settings for Commands<'_> {
    fn mode(&self) -> i8 {
        self.objects.value(kept::MODE) as i8
    }

    fn target_position(&self) -> f64 {
        self.objects.real(kept::TARGET_POSITION) * self.objects.pulse()
    }

    fn profile(&self) -> Limits {
        Limits {
            velocity: self.objects.real(kept::PROFILE_VELOCITY) * TENTH_RPM,
            acceleration: self.objects.slope(kept::ACCELERATION),
            deceleration: self.objects.slope(kept::DECELERATION),
            smoothing_s: 0.0,
        }
    }

    fn target_velocity(&self) -> f64 {
        self.objects.real(kept::TARGET_VELOCITY) * TENTH_RPM
    }

    fn target_torque(&self) -> f64 {
        self.objects.real(kept::TARGET_TORQUE) / 1000.0
    }

    /// The manual gives no unit: thousandths of the rated torque per second `[I]`, as CiA 402 has it.
    fn torque_slope(&self) -> f64 {
        self.objects.real(kept::TORQUE_SLOPE) / 1000.0
    }

    /// The manual names no object for it: the ramp down `[I]`.
    fn quick_stop(&self) -> f64 {
        self.objects.slope(kept::DECELERATION)
    }

    fn homing(&self) -> HomingSettings {
        HomingSettings {
            method: self.objects.value(kept::HOMING_METHOD) as i8,
            fast: self.objects.real(kept::HOMING_FAST) * TENTH_RPM,
            slow: self.objects.real(kept::HOMING_SLOW) * TENTH_RPM,
            acceleration: self.objects.slope(kept::HOMING_ACCELERATION),
            offset: self.objects.real(kept::HOME_OFFSET) * self.objects.pulse(),
        }
    }

    fn position_window(&self) -> Window {
        self.objects.pulses_window(kept::POSITION_WINDOW, kept::POSITION_TIME)
    }

    fn following_window(&self) -> Window {
        self.objects.pulses_window(kept::FOLLOWING_WINDOW, kept::FOLLOWING_TIME)
    }

    fn velocity_window(&self) -> Window {
        self.objects.speed_window(kept::VELOCITY_WINDOW, kept::VELOCITY_TIME)
    }

    fn standstill(&self) -> Window {
        self.objects.speed_window(kept::STANDSTILL, kept::STANDSTILL_TIME)
    }

    /// Fn_95 limits the speed in torque mode (§3.6.3); 0 is no limit `[I]`.
    fn velocity_max(&self) -> f64 {
        let limit = f64::from(self.registers.value(fns::TORQUE_SPEED)) / 60.0 * TAU;
        match self.mode() {
            modes::PROFILE_TORQUE if limit > 0.0 => limit,
            modes::PROFILE_TORQUE => f64::INFINITY,
            _ => TOP,
        }
    }

    /// `[I]` It stays in that state, so that statusword 0017h is seen.
    fn quick_stop_option(&self) -> (Braking, bool) {
        (Braking::Ramp, true)
    }

    /// `[I]`
    fn disable_option(&self) -> Braking {
        Braking::Coast
    }
}

/// The thirteen homing methods (§3.6.4).
#[must_use]
pub const fn is_method(method: i8) -> bool {
    matches!(method, -18 | -17 | -2 | -1 | 1..=4 | 17..=20 | 35)
}

/// The modes of operation (§3.6), and none.
#[must_use]
pub const fn is_mode(mode: i8) -> bool {
    matches!(mode, 0 | 1 | 3 | 4 | 6)
}
