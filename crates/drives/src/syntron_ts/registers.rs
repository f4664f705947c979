//! The registers Fn_00 to Fn_2FF: working values, values in flash, and the number of flash writes.

use polepair_core::profile::{Access, Encoding, Parameter, Profile};

/// Number of Fn registers.
pub const FN_COUNT: usize = 0x300;
/// Number of Dn registers.
pub const DN_COUNT: u16 = 0x30;
/// Modbus address of Dn_00.
pub const DN_BASE: u16 = 0x1000;

/// Numbers of the Fn registers that do something.
pub mod fn_registers {
    use super::super::profile::{SYNTRON_DS102, SYNTRON_TS};

    /// Control mode.
    pub const MODE: u16 = SYNTRON_TS.index_named("control mode");
    /// Rated current, 0.01 A (DS102).
    pub const RATED_CURRENT: u16 = SYNTRON_DS102.index_named("rated current");
    /// Internal speed, rpm.
    pub const SPEED: u16 = SYNTRON_TS.index_named("internal speed");
    /// Internal enable.
    pub const ENABLE: u16 = SYNTRON_TS.index_named("internal enable");
    /// Modbus address.
    pub const ADDRESS: u16 = SYNTRON_TS.index_named("modbus address");
    /// Modbus baud rate.
    pub const BAUD: u16 = SYNTRON_TS.index_named("modbus baud");
    /// Interface and framing.
    pub const FORMAT: u16 = SYNTRON_TS.index_named("modbus format");
    /// Password.
    pub const PASSWORD: u16 = SYNTRON_TS.index_named("password");
    /// Alarm clear (DS102).
    pub const CLEAR: u16 = SYNTRON_DS102.index_named("clear alarm");
    /// Speed limit of torque mode, rpm.
    pub const TORQUE_SPEED: u16 = SYNTRON_TS.index_named("max speed in torque mode");
    /// CANopen node-ID.
    pub const NODE: u16 = SYNTRON_TS.index_named("can node id");
    /// CAN bit rate, kbit/s.
    pub const BIT_RATE: u16 = SYNTRON_TS.index_named("can bit rate");
    /// 1 keeps writes in RAM.
    pub const RAM_ONLY: u16 = SYNTRON_TS.index_named("write target");
    /// First register of path 1.
    pub const PATHS: u16 = SYNTRON_TS.index_named("path 1 definition 1");
    /// Homing way.
    pub const HOMING_WAY: u16 = SYNTRON_TS.index_named("homing way");
    /// Fast homing speed, rpm.
    pub const HOMING_SPEED: u16 = SYNTRON_TS.index_named("homing speed");
    /// Slow homing speed, rpm.
    pub const HOMING_SLOW: u16 = SYNTRON_TS.index_named("homing slow speed");
    /// Coordinate of the zero, high word.
    pub const ZERO_HIGH: u16 = SYNTRON_TS.index_named("zero coordinate high");
    /// Coordinate of the zero, low word.
    pub const ZERO_LOW: u16 = SYNTRON_TS.index_named("zero coordinate low");
    /// Motor turns of the mechanics' ratio.
    pub const MOTOR_TURNS: u16 = SYNTRON_TS.index_named("mechanics motor turns");
    /// Travel of the mechanics' ratio.
    pub const TRAVEL: u16 = SYNTRON_TS.index_named("mechanics travel");
    /// Delay after homing, ms.
    pub const HOMING_DELAY: u16 = SYNTRON_TS.index_named("homing delay");
    /// Path after homing.
    pub const HOMING_PATH: u16 = SYNTRON_TS.index_named("path after homing");
    /// Stop behaviour of a path.
    pub const STOP_SETTING: u16 = SYNTRON_TS.index_named("stop setting");
    /// Source of the trigger of a path.
    pub const TRIGGER_SOURCE: u16 = SYNTRON_TS.index_named("trigger source");
    /// Path that the trigger starts.
    pub const PATH_NUMBER: u16 = SYNTRON_TS.index_named("path number");
    /// Path trigger.
    pub const PATH_TRIGGER: u16 = SYNTRON_TS.index_named("path trigger");
    /// Homing trigger.
    pub const HOMING_TRIGGER: u16 = SYNTRON_TS.index_named("homing trigger");
    /// Path stop.
    pub const PATH_STOP: u16 = SYNTRON_TS.index_named("path stop");
    /// S-time of path 1, ms.
    pub const S_TIMES: u16 = SYNTRON_TS.index_named("path 1 s-time");
}

/// Numbers of the Dn registers with values.
pub mod dn_registers {
    use super::super::profile::{SYNTRON_DS102, SYNTRON_TS};
    use super::DN_BASE;

    /// Motor speed, rpm.
    pub const SPEED: u16 = SYNTRON_TS.index_named("motor speed") - DN_BASE;
    /// Load, 0.1 % (DS102).
    pub const LOAD: u16 = SYNTRON_DS102.index_named("motor load") - DN_BASE;
    /// Version (DS102).
    pub const VERSION: u16 = SYNTRON_DS102.index_named("firmware version") - DN_BASE;
    /// Alarm code.
    pub const ALARM: u16 = SYNTRON_TS.index_named("alarm code") - DN_BASE;
    /// Temperature, °C (DS102).
    pub const TEMPERATURE: u16 = SYNTRON_DS102.index_named("temperature") - DN_BASE;
    /// 1 while a path or homing runs.
    pub const PATH_STATE: u16 = SYNTRON_TS.index_named("path state") - DN_BASE;
    /// Encoder position, low word.
    pub const POSITION_LOW: u16 = SYNTRON_TS.index_named("encoder position") - DN_BASE;
    /// Encoder position, high word.
    pub const POSITION_HIGH: u16 = POSITION_LOW + 1;
}

/// The store behind Fn_00 to Fn_2FF.
#[derive(Debug)]
pub struct Registers {
    ram: [u16; FN_COUNT],
    flash: [u16; FN_COUNT],
    wear: u64,
}

impl Registers {
    /// Factory settings, by the defaults of `profile`; 0 where it has none.
    #[must_use]
    pub fn factory(profile: &Profile) -> Self {
        let mut flash = [0; FN_COUNT];
        for parameter in profile.parameters.iter().filter(|p| is_single_register(p)) {
            if let Some(at) = flash.get_mut(usize::from(parameter.index)) {
                *at = parameter.default.unwrap_or(0) as u16;
            }
        }
        Self { ram: flash, flash, wear: 0 }
    }

    /// The value that runs; 0 outside the range.
    #[must_use]
    pub fn value(&self, number: u16) -> u16 {
        self.ram.get(usize::from(number)).copied().unwrap_or(0)
    }

    /// The value that runs, as a signed number.
    #[must_use]
    pub fn signed(&self, number: u16) -> i16 {
        self.value(number) as i16
    }

    /// The value that the next power-on brings.
    #[must_use]
    pub fn stored(&self, number: u16) -> u16 {
        self.flash.get(usize::from(number)).copied().unwrap_or(0)
    }

    /// Writes to flash so far.
    #[must_use]
    pub const fn wear(&self) -> u64 {
        self.wear
    }

    /// Changes what runs.
    pub fn set(&mut self, number: u16, value: u16) {
        if let Some(at) = self.ram.get_mut(usize::from(number)) {
            *at = value;
        }
    }

    /// Makes it a value from the factory, without wear.
    pub fn preset(&mut self, number: u16, value: u16) {
        self.set(number, value);
        if let Some(at) = self.flash.get_mut(usize::from(number)) {
            *at = value;
        }
    }

    /// Changes what runs and what flash keeps. Each such write wears the flash, equal ones too.
    pub fn store(&mut self, number: u16, value: u16) {
        self.preset(number, value);
        self.wear += 1;
    }

    /// A write over the line: to flash while Fn_99 is 0, else to RAM (§1.4.1). The manual has a
    /// drive set to RAM once and find it so at every power-on (§2.5), so Fn_99 itself is always
    /// kept `[I]`.
    pub fn write(&mut self, number: u16, value: u16) {
        if number == fn_registers::RAM_ONLY || self.value(fn_registers::RAM_ONLY) == 0 {
            self.store(number, value);
        } else {
            self.set(number, value);
        }
    }

    /// Power off and on: RAM is what flash kept.
    pub fn power_cycle(&mut self) {
        self.ram = self.flash;
    }
}

/// Limits of an Fn register: least and greatest value, and whether it is signed.
#[must_use]
pub fn write_limits(profile: &Profile, number: u16) -> (i64, i64, bool) {
    let known = profile.parameters.iter().find(|p| p.index == number && is_single_register(p));
    match known {
        Some(p) => (p.min, p.max, p.encoding == Encoding::I16),
        // The two words of a coordinate are signed each `[I]`.
        None => (i64::from(i16::MIN), i64::from(u16::MAX), false),
    }
}

fn is_single_register(parameter: &Parameter) -> bool {
    parameter.space == 0
        && parameter.access != Access::Read
        && matches!(parameter.encoding, Encoding::U16 | Encoding::I16)
}
