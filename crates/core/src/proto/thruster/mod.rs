//! The CAN protocol of a family of underwater thrusters, servos and linear actuators: two letters
//! and a value, in 11-bit frames with CANopen's PDO2 identifiers.
//!
//! Source: the maker's protocol manual (in Chinese; it names neither maker nor product), whose
//! sections are cited. Where it is silent or contradicts itself the reading is marked \[I\], and
//! is a switch of the profile or of the simulated drive where two are possible.

pub mod address;
pub mod axis;
pub mod device;
pub mod explain;
pub mod fault;
pub mod generic;
pub mod host;
pub mod interpretation;
mod node;
pub mod rules;
pub mod session;
pub mod text;
pub mod wire;

pub use axis::{Axis, Thruster};
pub use explain::ThrusterDissector;
pub use host::CanHost;
pub use session::{Answer, HostRequest};
pub use wire::{CommandWord, DriveMessage, Reply, Request};

#[cfg(test)]
mod tests;
