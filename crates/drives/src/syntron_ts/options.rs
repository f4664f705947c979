//! Options of a simulated TS: variant, registers of similar drives, ambiguous parts of the manual.

use super::external::ExternalSignals;
use super::io::{InputLines, InputPurpose, PURPOSES};
use crate::DeviceOptions;
use polepair_core::proto::canopen::device as can;

/// Registers that a password may lock.
const LOCKED_MAX: usize = 16;

/// Variant of the drive (TS manual V2 §1.1).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Variant {
    /// Modbus with internal speed mode.
    Standard,
    /// Speed mode and internal position mode.
    Position,
    /// CANopen.
    Canopen,
    /// Everything.
    All,
}

/// The CAN end as the manual has it: short requests, mapping while operational, times of which 400 are
/// 50 ms (§3.5.4), emergencies of two bytes (§3.5.2), answers that repeat the written value (§3.5.3);
/// nothing that it does not name.
const CAN_QUIRKS: can::Quirks = can::Quirks {
    lenient: true,
    maps_pre_operational: false,
    echoes_writes: true,
    segmented_sdo: false,
    lss: false,
    time: false,
    guarding: true,
    short_emcy: true,
    inhibit_unit_us: 125,
    event_unit_us: 125,
    type_254_by_timer: true,
};

/// Options of a simulated drive.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Options {
    /// Variant.
    pub variant: Variant,
    /// True if it has the registers that only drivers of the DS102 name.
    pub ds102: bool,
    /// Address, baud rate and framing act at once rather than at the next power-on `[I]`.
    pub applies_at_once: bool,
    /// Fn_3D takes 0x0101 and 0x0102 rather than decimal 101 and 102 `[I]`.
    pub hex_format: bool,
    /// Silence that ends a frame, ms; 0 goes by the length of frames.
    pub gap_ms: u32,
    /// The wire has no byte timing.
    pub untimed: bool,
    /// Station address from the factory.
    pub address: u8,
    /// ASCII from the factory.
    pub ascii: bool,
    /// The drive is behind a gateway of Modbus TCP, which it looks like itself.
    pub tcp: bool,
    /// Control mode from the factory (Fn_00).
    pub mode: u16,
    /// Deviations of the CAN end from the standard.
    pub can: can::Quirks,
    /// Homing methods 3 and 19 begin forward outside the switch, as CiA 402 has them, and not in reverse as
    /// the TS manual (§3.6.4).
    pub homes_by_cia: bool,
    /// Fn_203 and Fn_204 are turns and pulses, as the manual's text has them, and not the words of a number of
    /// thousandths.
    pub zero_in_turns: bool,
    /// Inputs and switches.
    pub lines: InputLines,
    /// Initial signals of the analog and the pulse input.
    pub external: ExternalSignals,
    locked: [Option<u16>; LOCKED_MAX],
}

impl Options {
    /// Parses options of a rack or command line.
    ///
    /// # Errors
    /// The name of an unknown option, or an invalid value.
    pub fn from_device_options<'a>(
        options: &DeviceOptions<'a>,
        ds102: bool,
    ) -> Result<Self, &'a str> {
        let address = options.address.unwrap_or(1);
        let mut made = Self {
            variant: Variant::All,
            ds102,
            applies_at_once: false,
            hex_format: false,
            gap_ms: if options.untimed { 0 } else { 10 },
            untimed: options.untimed,
            address: u8::try_from(address).ok().filter(|a| *a < 128).ok_or("address")?,
            ascii: options.wires.contains(&"modbus-ascii"),
            tcp: options.wires.contains(&"modbus-tcp"),
            mode: 2,
            can: CAN_QUIRKS,
            homes_by_cia: false,
            zero_in_turns: false,
            // Half a turn behind, so that homing finds it `[I]`.
            lines: InputLines::new(PURPOSES, -core::f64::consts::PI),
            external: ExternalSignals::default(),
            locked: [None; LOCKED_MAX],
        };
        for (key, value) in options.extra {
            made.set_option(key, value)?;
        }
        Ok(made)
    }

    /// Returns whether the password locks that register.
    #[must_use]
    pub fn is_locked(&self, number: u16) -> bool {
        self.locked.contains(&Some(number))
    }

    /// Returns whether Fn_3D accepts that value (TS manual V2 §2.2).
    #[must_use]
    pub const fn accepts_format(&self, value: u16) -> bool {
        match value {
            1 | 2 => true,
            101 | 102 => !self.hex_format,
            0x101 | 0x102 => self.hex_format,
            _ => false,
        }
    }

    fn set_option<'a>(&mut self, key: &'a str, value: &'a str) -> Result<(), &'a str> {
        match (key, value) {
            ("variant", "standard") => self.variant = Variant::Standard,
            ("variant", "position") => self.variant = Variant::Position,
            ("variant", "canopen") => self.variant = Variant::Canopen,
            ("variant", "all") => self.variant = Variant::All,
            ("ds102", "0" | "1") => self.ds102 = value == "1",
            ("settings", "at-once") => self.applies_at_once = true,
            ("settings", "power-cycle") => self.applies_at_once = false,
            ("format", "decimal") => self.hex_format = false,
            ("format", "hex") => self.hex_format = true,
            ("gap", _) => self.gap_ms = value.parse().map_err(|_| value)?,
            ("fn00", _) => {
                self.mode = value.parse().ok().filter(|mode| *mode <= 20).ok_or(value)?
            }
            ("can", "true") => self.can = CAN_QUIRKS,
            ("can", "strict") => self.can = can::Quirks::STRICT,
            ("zero", "thousandths" | "turns") => self.zero_in_turns = value == "turns",
            ("homing", "manual" | "cia") => self.homes_by_cia = value == "cia",
            ("emcy", "2" | "8") => self.can.short_emcy = value == "2",
            ("pdo-timer", _) => self.set_pdo_timer(value)?,
            ("lss", "0" | "1") => self.can.lss = value == "1",
            ("time", "0" | "1") => self.can.time = value == "1",
            ("guarding", "0" | "1") => self.can.guarding = value == "1",
            ("segments", "0" | "1") => self.can.segmented_sdo = value == "1",
            // A host of this protocol needs no address of its own.
            ("host", _) => {}
            ("inputs", _) => self.lines.assign(InputPurpose::of_digits(value).ok_or(value)?),
            ("closed", _) => self.close_inputs(value)?,
            ("analog", _) => self.external.set_volts(parse_number(value)?),
            ("pulses", _) => self.external.set_rate(parse_number(value)?),
            ("locked", _) => self.lock_registers(value)?,
            ("variant" | "ds102" | "settings" | "format" | "can" | "emcy" | "homing", _) => {
                return Err(value);
            }
            ("lss" | "time" | "guarding" | "segments", _) => return Err(value),
            _ => return Err(key),
        }
        Ok(())
    }

    /// Unit of both times of a PDO, µs.
    fn set_pdo_timer<'a>(&mut self, value: &'a str) -> Result<(), &'a str> {
        let unit = value.parse().ok().filter(|unit| (1..=100_000).contains(unit)).ok_or(value)?;
        (self.can.inhibit_unit_us, self.can.event_unit_us) = (unit, unit);
        Ok(())
    }

    /// Numbers of the inputs that something outside closes from the start, a digit each.
    fn close_inputs<'a>(&mut self, list: &'a str) -> Result<(), &'a str> {
        for digit in list.bytes() {
            let at = usize::from(digit.wrapping_sub(b'1'));
            *self.lines.forced_closed.get_mut(at).ok_or(list)? = true;
        }
        Ok(())
    }

    /// Register numbers in hexadecimal: `95,9A`, or with plus signs.
    fn lock_registers<'a>(&mut self, list: &'a str) -> Result<(), &'a str> {
        for (at, number) in list.split([',', '+']).enumerate() {
            let number = number.trim().trim_start_matches("Fn_");
            let number = u16::from_str_radix(number, 16).map_err(|_| list)?;
            *self.locked.get_mut(at).ok_or(list)? = Some(number);
        }
        Ok(())
    }
}

fn parse_number(text: &str) -> Result<f64, &str> {
    text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or(text)
}
