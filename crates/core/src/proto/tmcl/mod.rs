//! TMCL, Trinamic's motion control language: nine-byte datagrams on RS-232 and RS-485, the same in CAN
//! frames, and an ASCII mode.
//!
//! Sources: "TMCM-170 and TMCM-171 MODULE, Reference and Programming Manual" chapter 2 for the datagram;
//! later TMCL manuals for the rest. Inferred facts are marked \[I\].

pub mod address;
pub mod ascii;
pub mod device;
pub mod driver;
pub mod explain;
pub mod generic;
pub mod host;
pub mod host_request;
pub mod instructions;
pub mod module;
pub mod opcode;
pub mod session;
pub mod text;
pub mod wire;

pub use driver::{Tmcl, TmclCan, TmclDriver};
pub use explain::TmclDissector;
pub use host::{CanHost, SerialHost};
pub use host_request::HostRequest;
pub use opcode::{Opcode, Status};
pub use session::Answer;
pub use wire::{Instruction, Reply, Request, VersionText};

#[cfg(test)]
mod tests;
