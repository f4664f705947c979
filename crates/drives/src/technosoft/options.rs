//! Options of a simulated drive.

use crate::DeviceOptions;
use polepair_core::convert::saturating;
use polepair_core::profile::Profile;
use polepair_core::proto;
use polepair_core::proto::tml::device::Quirks;
use polepair_core::proto::tml::rules::TmlWire;

/// Options of a drive: build, wiring and set-up.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Options {
    /// Properties of its wires.
    pub quirks: Quirks,
    /// Axis ID in the set-up table, 1 by default; 0 uses the switches.
    pub axis: u8,
    /// Switches or jumpers for the axis ID, if it has any.
    pub switches: Option<u8>,
    /// The set-up table is valid.
    pub setup: bool,
    /// Encoder counts of a turn.
    pub counts: u32,
    /// Slow loop period, ns.
    pub slow_ns: u64,
    /// Baud rate in the set-up.
    pub baud: u32,
    /// Time that AXISON takes to find the motor's field, ms.
    pub axison_ms: u16,
    /// Clock error, parts per million; positive if fast.
    pub clock_ppm: i32,
    /// Firmware name: `514L`.
    pub version: [u8; 4],
    /// Time of an EEPROM write of one or two words, ms. \[I\]
    pub eeprom_ms: u32,
    /// Address of SRL_MASK in this firmware.
    pub srl_mask: u16,
}

impl Options {
    /// Reads them.
    ///
    /// # Errors
    /// The name or value that is unknown.
    pub fn from_device_options<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self, &'a str> {
        let mut read = Self::for_profile(profile);
        read.quirks.untimed = options.untimed;
        let standard = match options.standard {
            Some(proto::SerialStandard::Rs485) => TmlWire::Rs485,
            _ => TmlWire::Rs232,
        };
        read.quirks.wire = is_wired("tml", options.wires).then_some(standard);
        read.quirks.can =
            match (is_wired("tmlcan", options.wires), is_wired("technocan", options.wires)) {
                (_, true) => Some(TmlWire::TechnoCan),
                (tmlcan, _) => tmlcan.then_some(TmlWire::TmlCan),
            };
        if let Some(address) = options.address {
            read.axis = saturating(address);
        }
        for (key, value) in options.extra {
            read.set_option(key, value)?;
        }
        Ok(read)
    }

    fn for_profile(profile: &'static Profile) -> Self {
        let late = profile.name.ends_with("fa00g");
        Self {
            quirks: Quirks::default(),
            axis: 1,
            switches: None,
            setup: true,
            counts: 2000,
            slow_ns: 1_000_000,
            baud: 9600,
            axison_ms: 0,
            clock_ppm: 0,
            eeprom_ms: 5,
            version: match profile.name {
                "technosoft-f2xx" => *b"214A",
                _ if late => *b"A00G",
                _ => *b"514L",
            },
            srl_mask: if late {
                super::addresses::SRL_MASK_FA00G
            } else {
                super::addresses::SRL_MASK_F514L
            },
        }
    }

    fn set_option<'a>(&mut self, key: &'a str, value: &'a str) -> Result<(), &'a str> {
        match (key, value) {
            ("wire", "rs232") => self.quirks.wire = Some(TmlWire::Rs232),
            ("wire", "rs485") => self.quirks.wire = Some(TmlWire::Rs485),
            ("can", "tmlcan") => self.quirks.can = Some(TmlWire::TmlCan),
            ("can", "technocan") => self.quirks.can = Some(TmlWire::TechnoCan),
            // It replies to every host.
            ("host", _) => {}
            ("address-from", "switches") => self.axis = 0,
            ("setup", "valid" | "invalid") => self.setup = value == "valid",
            ("switches", _) => self.switches = Some(parse_number(value, 1, 255)?),
            ("counts", _) => self.counts = parse_number(value, 4, 16_777_216)?,
            ("slow-loop-us", _) => self.slow_ns = 1000 * parse_number::<u64>(value, 100, 10_000)?,
            ("baud", "9600" | "19200" | "38400" | "57600" | "115200") => {
                self.baud = parse_number(value, 9600, 115_200)?;
            }
            ("firmware", _) => {
                let named = value.strip_prefix('F').unwrap_or(value).as_bytes().try_into();
                self.version = named.map_err(|_| value)?;
            }
            ("axison-ms", _) => self.axison_ms = parse_number(value, 0, 10_000)?,
            ("clock-ppm", _) => self.clock_ppm = parse_number(value, -1000, 1000)?,
            ("eeprom-ms", _) => self.eeprom_ms = parse_number(value, 0, 1000)?,
            ("byte-timeout-ms", _) => {
                self.quirks.byte_timeout_ms = Some(parse_number(value, 1, 10_000)?);
            }
            ("wire" | "can" | "setup" | "baud" | "address-from", _) => return Err(value),
            _ => return Err(key),
        }
        Ok(())
    }
}

fn is_wired(word: &str, options_wires: &[&str]) -> bool {
    options_wires.contains(&word)
}

fn parse_number<T: core::str::FromStr + PartialOrd>(
    value: &str,
    least: T,
    most: T,
) -> Result<T, &str> {
    value.parse().ok().filter(|n| (least..=most).contains(n)).ok_or(value)
}
