//! Simulated wires, faults and worlds under a virtual clock.
//!
//! A [`World`](world::World) has [nodes](node::SimNode), drives and hosts, on [serial
//! wires](serial_line::SerialWireConfig) and CAN buses. It reads no clock, never sleeps, runs on one thread
//! and is deterministic: all random values come from a seed. Its stations are the same objects as on real
//! wires.
#![forbid(unsafe_code)]

pub mod can_bus;
pub mod check;
pub mod data_sheet;
pub mod fault;
pub mod host;
pub mod node;
pub mod profile_drive;
pub mod rack;
pub mod random;
pub mod serial_line;
pub mod sim_link;
pub mod swarm;
#[cfg(test)]
mod tests;
mod timed_queue;
mod uart;
pub mod world;
