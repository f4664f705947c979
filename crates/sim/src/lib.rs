//! Simulated wires, faults and worlds under a virtual clock.
//!
//! A [`World`](world::World) holds [nodes](node::SimNode), drives and hosts, on
//! [serial wires](serial_line::SerialWireConfig) and CAN buses. It reads no clock, sleeps never, runs on one
//! thread and is deterministic: whatever is random comes from a seed. The stations on its wires are
//! the same objects that stand at real ones.
#![forbid(unsafe_code)]

pub mod can_bus;
pub mod check;
pub mod data_sheet;
pub mod fault;
pub mod host;
pub mod node;
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
