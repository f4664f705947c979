//! The CAN protocol of a family of underwater thrusters, servos and linear actuators: two letters and a
//! value, in 11-bit frames with CANopen's PDO2 identifiers.
//!
//! Source: the maker's protocol manual (in Chinese, without the names of maker and product), whose sections
//! are cited. Inferred facts are marked \[I\]; if two readings are possible, the profile or the simulated
//! drive has an option.

pub mod address;
pub mod device;
pub mod driver;
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

pub use driver::{Thruster, ThrusterDriver};
pub use explain::ThrusterDissector;
pub use host::CanHost;
pub use session::{Answer, HostRequest};
pub use wire::{CommandWord, DriveMessage, Reply, Request};

#[cfg(test)]
mod tests;
