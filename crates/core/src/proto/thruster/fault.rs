//! The fault word of EF and FR (protocol manual, section 3).

/// One bit of the fault word.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FaultBit {
    /// The bit alone.
    pub mask: u16,
    /// Name for fields.
    pub field: &'static str,
    /// Name for people.
    pub name: &'static str,
    /// 1 closes the output, 2 limits it or only reports. The reaction of the drive is [`OUTPUT_OFF`],
    /// [`OUTPUT_LIMITED`] or [`POSITION_FORBIDDEN`]; the communication timeout is of level 2 and closes the
    /// output.
    pub level: u8,
    /// True if it clears itself with its cause; otherwise CF or a restart clears it.
    pub recovers: bool,
}

/// EEPROM could not be read or written.
pub const EE_ACCESS: u16 = 1 << 0;
/// Invalid data in the EEPROM.
pub const EE_DATA: u16 = 1 << 1;
/// Over-current.
pub const OVER_CURRENT: u16 = 1 << 2;
/// Over-voltage.
pub const OVER_VOLTAGE: u16 = 1 << 3;
/// Supply voltage below its limit (bit 4).
pub const UNDER_VOLTAGE: u16 = 1 << 4;
/// Stalled.
pub const STALL: u16 = 1 << 6;
/// Encoder fault: position commands are void.
pub const ENCODER: u16 = 1 << 7;
/// Driver over-temperature.
pub const DRIVER_HOT: u16 = 1 << 8;
/// Motor over-temperature.
pub const MOTOR_HOT: u16 = 1 << 9;
/// The signal has not passed zero.
pub const ZERO_POINT: u16 = 1 << 10;
/// No command arrived in time.
pub const TIMEOUT: u16 = 1 << 11;
/// Driver temperature sensor.
pub const DRIVER_SENSOR: u16 = 1 << 12;
/// Reserved in the table, called motor temperature in the example of section 2.6.
pub const MOTOR_TEMPERATURE: u16 = 1 << 14;
/// Motor temperature sensor.
pub const MOTOR_SENSOR: u16 = 1 << 13;

/// Faults that close the output until they are cleared.
pub const OUTPUT_CLOSED: u16 = EE_ACCESS | EE_DATA | OVER_CURRENT | STALL;
/// Faults with which there is no output.
pub const OUTPUT_OFF: u16 = OUTPUT_CLOSED | TIMEOUT | ZERO_POINT;
/// Faults that limit it.
pub const OUTPUT_LIMITED: u16 = DRIVER_HOT | MOTOR_HOT;
/// Faults that void position commands.
pub const POSITION_FORBIDDEN: u16 = ENCODER;
/// Faults that only CF or a restart clears.
pub const LATCHED: u16 = OUTPUT_CLOSED | ENCODER;

/// Every bit that has a name, the highest first.
pub const BITS: [FaultBit; 14] = {
    const fn bit(
        mask: u16,
        field: &'static str,
        name: &'static str,
        level: u8,
        recovers: bool,
    ) -> FaultBit {
        FaultBit { mask, field, name, level, recovers }
    }
    [
        bit(MOTOR_TEMPERATURE, "motor_temperature", "undocumented motor temperature", 2, true),
        bit(MOTOR_SENSOR, "motor_sensor", "motor temperature sensor", 2, true),
        bit(DRIVER_SENSOR, "driver_sensor", "driver temperature sensor", 2, true),
        bit(TIMEOUT, "timeout", "communication timeout", 2, true),
        bit(ZERO_POINT, "zero_point", "zero-point protection", 2, true),
        bit(MOTOR_HOT, "motor_hot", "motor over-temperature", 2, true),
        bit(DRIVER_HOT, "driver_hot", "driver over-temperature", 2, true),
        bit(ENCODER, "encoder", "encoder fault", 2, false),
        bit(STALL, "stall", "stall protection", 1, false),
        bit(UNDER_VOLTAGE, "under_voltage", "under-voltage", 2, true),
        bit(OVER_VOLTAGE, "over_voltage", "over-voltage", 2, true),
        bit(OVER_CURRENT, "over_current", "over-current", 1, false),
        bit(EE_DATA, "ee_data", "EEPROM data error", 1, false),
        bit(EE_ACCESS, "ee_access", "EEPROM read or write error", 1, false),
    ]
};

/// The bits of a word that have a name.
pub fn named_bits(word: u16) -> impl Iterator<Item = &'static FaultBit> {
    BITS.iter().filter(move |bit| word & bit.mask != 0)
}
