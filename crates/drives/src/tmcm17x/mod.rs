//! Trinamic TMCM-170 and TMCM-171: BLDC servo modules with TMCL on RS-232, RS-485 and CAN.
//!
//! Sources: "TMCM-170 and TMCM-171 Reference and Programming Manual" v1.14, of which only parts are public;
//! "TMCM-171 Hardware Manual" v0.92; for the rest similar modules and the TMCL reference. Inferred facts
//! are marked \[I\], and `inferred` in the profile.

mod device;
mod execute;
mod flags;
mod module;
pub mod profile;
mod settings;

#[cfg(test)]
mod tests;

pub use device::{Device, Tmcm17x};
