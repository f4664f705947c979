//! Underwater thrusters, servos and linear actuators with the thruster protocol on CAN.
//!
//! Source: the maker's protocol manual (sections are cited). It does not describe motors and water: their
//! parameters are chosen \[I\], so that speed, voltage and current are close to its examples.

mod device;
mod drive;
mod execute;
mod faults;
mod memory;
mod options;
pub mod profile;
mod shaft;
mod water;

#[cfg(test)]
mod tests;

pub use device::{Device, ThrusterFamily};
pub use water::Water;
