//! The SYNTRON TS servo drive and the similar DS102, on Modbus and CANopen.
//!
//! [`registers`] are Fn_00 to Fn_2FF with flash and its wear; [`homing`] has the homing way of
//! internal position mode; [`motion`] executes them; [`external`] other set-points; `shaft` motor, loops
//! and protections; [`drive`] modes, power and alarms; [`panel`] keys and display; [`objects`] registers
//! and drive profile in CANopen; [`device`] both wires and the environment.
//!
//! The host needs no code for this family: the protocol's driver and the plans of the profile are enough.

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
pub mod path_model;
pub mod profile;
pub mod registers;
mod shaft;

#[cfg(test)]
mod tests;

use crate::{DeviceOptions, Family};
use polepair_core::profile::Profile;

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
        // All facts on the registers are in the Modbus profiles.
        let registers = if ds102 { &profile::SYNTRON_DS102 } else { &profile::SYNTRON_TS };
        options::Options::from_device_options(options, ds102)
            .map(|made| device::Device::new(registers, made))
    }
}
