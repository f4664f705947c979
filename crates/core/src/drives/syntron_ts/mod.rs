//! The SYNTRON TS servo drive and its sibling DS102, on Modbus and CANopen.
//!
//! What each part is: [`registers`] Fn_00 to Fn_2FF with flash and its wear; [`paths`] and
//! [`homing`] what the registers of internal position mode mean; [`motion`] what carries them out;
//! [`external`] what drives it past the line; [`shaft`] motor, loops and protections; [`drive`]
//! modes, power and alarms, on no line in particular; [`panel`] the keys and the display;
//! [`objects`] the registers and the drive profile as CANopen has them; [`device`] the ends of both
//! wires and the bench.
//!
//! The host needs no code of its own for this family: the protocol's driver and the plans of the
//! profile suffice.

pub mod alarm;
pub mod device;
pub mod drive;
pub mod external;
pub mod homing;
pub mod io;
pub mod motion;
pub mod objects;
pub mod options;
pub mod panel;
pub mod paths;
pub mod profile;
pub mod registers;
pub mod shaft;

#[cfg(test)]
mod tests;

use crate::drives::{DeviceOptions, Family};
use crate::profile::Profile;

/// The family.
#[derive(Debug)]
pub enum SyntronTs {}

impl Family for SyntronTs {
    const NAME: &'static str = "syntron_ts";
    type Device = device::Device;

    fn profiles() -> &'static [&'static Profile] {
        static USUAL_FIRST: [&Profile; 3] =
            [&profile::SYNTRON_TS, &profile::SYNTRON_DS102, &profile::SYNTRON_TS_CANOPEN];
        &USUAL_FIRST
    }

    fn create_device<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self::Device, &'a str> {
        let ds102 = profile.name == profile::SYNTRON_DS102.name;
        // What is known of the registers stands in the Modbus profiles.
        let registers = if ds102 { &profile::SYNTRON_DS102 } else { &profile::SYNTRON_TS };
        options::Options::from_device_options(options, ds102)
            .map(|made| device::Device::new(registers, made))
    }
}
