//! Technosoft and Techsoft drives, which use TML.
//!
//! Sources: the "TML communication" chapters, the vendor's library TML_LIB_light and its help pages; for
//! memory maps, captures of drives with firmware F514L and FA00G. Inferred facts are marked \[I\], and
//! `inferred` in the profiles.

mod addresses;
mod cam;
mod change_reports;
mod clock;
mod contour;
mod control;
mod device;
mod drive;
mod events;
mod execute;
mod firmware;
mod inputs;
mod logger;
mod master;
mod memory;
mod motion;
mod online;
mod options;
mod outbox;
mod points;
pub mod profile;
mod program;
mod protections;
mod remote;
mod setup;
mod shaft;
mod status;
mod surroundings;
mod sync;
mod units;

#[cfg(test)]
mod tests;

pub use device::{Device, Technosoft};
