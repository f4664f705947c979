//! Underwater thrusters, servos and linear actuators that speak the thruster protocol on CAN.
//!
//! Source: the maker's protocol manual (sections are cited). It says nothing of motors and water:
//! those are chosen \[I\], so that speed, voltage and current are near those of its examples.

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
