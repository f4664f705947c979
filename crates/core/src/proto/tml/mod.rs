//! TML, the motion language of Technosoft and Techsoft drives: on RS-232, RS-485 and Ethernet, on CAN with
//! 29-bit identifiers (TMLCAN) and with 11-bit ones beside CANopen (TechnoCAN).
//!
//! Sources: the vendor's "TML communication" chapters (serial, TMLCAN, TechnoCAN) and its help pages on
//! instruction coding. Facts from drivers in the field or from captures are marked in the tables. Inferred
//! facts are marked \[I\].

pub mod address;
pub mod device;
pub mod driver;
pub mod explain;
pub mod generic;
pub mod host;
pub mod host_request;
pub mod instruction;
mod keys;
pub mod logger;
pub mod online;
pub mod program;
pub mod relay;
pub mod rules;
pub mod serial;
pub mod session;
pub mod technocan;
pub mod tmlcan;
pub mod wire;

pub use driver::{TechnoCan, Tml, TmlCan, TmlDriver};

#[cfg(test)]
mod tests;
