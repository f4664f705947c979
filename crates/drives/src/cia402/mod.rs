//! A simulated drive by the CiA 402 standard, with all modes and options. Only its two objects for transfer
//! tests are its own.
//!
//! [`objects`] is the dictionary and the meaning of its values;
//! [`ServoShaft`](polepair_core::plant::ServoShaft) motor, loops and protections;
//! [`units`] turns and rpm in the drive's numbers; [`drive`] connects them to the motion of
//! [`proto::canopen`](polepair_core::proto::canopen::device::motion); [`faults`] error codes; [`transfer_objects`]
//! objects of any length; [`device`] the bus.

pub mod device;
pub mod drive;
pub mod faults;
mod interpolation;
pub mod objects;
pub mod profile;
mod surroundings;
pub mod touch_probe;
pub mod transfer_objects;

mod protections;
pub mod units;

#[cfg(test)]
mod tests;

use crate::{DeviceOptions, Family};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::device::Quirks;

/// The family.
#[derive(Debug)]
pub enum Cia402 {}

/// Bit rate from the factory, bit/s.
const BIT_RATE: u32 = 500_000;

impl Family for Cia402 {
    const NAME: &'static str = "cia402";
    type Device = device::Device;

    fn profiles() -> &'static [&'static Profile] {
        static ALL: [&Profile; 2] = [&profile::CIA402, &profile::CIA402_VL];
        &ALL
    }

    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self::Device, &'a str> {
        let mut node = match options.address {
            None => 1,
            Some(address) => {
                u8::try_from(address).ok().filter(|n| (1..=127).contains(n)).ok_or("address")?
            }
        };
        let (mut serial, mut modes) = (u32::from(node), None);
        let mut quirks = Quirks::STRICT;
        for (key, value) in options.extra {
            match (*key, *value) {
                ("serial", number) => serial = number.parse().map_err(|_| number)?,
                // Without node-ID, to be given one by LSS.
                ("node", "none") => node = 255,
                ("modes", bits) => modes = Some(parse_modes(bits).ok_or(bits)?),
                ("mapping", "pre-operational") => quirks.maps_pre_operational = true,
                // A host of this protocol needs no address of its own.
                ("host", _) => {}
                ("node", value) => return Err(value),
                (key, _) => return Err(key),
            }
        }
        let drive = drive::Drive::new(node, serial, BIT_RATE);
        let is_inverter = profile.name == profile::CIA402_VL.name;
        let drive = if is_inverter { drive.with_velocity_mode_only() } else { drive };
        let drive = modes.into_iter().fold(drive, drive::Drive::with_modes);
        Ok(device::Device::with_quirks(drive, quirks))
    }
}

/// Supported modes as 6502h has them, decimal or hexadecimal: at least one, and none that the drive lacks.
fn parse_modes(text: &str) -> Option<u32> {
    let modes = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16),
        None => text.parse(),
    };
    modes.ok().filter(|modes| *modes != 0 && modes & !objects::ALL_MODES == 0)
}
