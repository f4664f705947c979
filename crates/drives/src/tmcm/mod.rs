//! Trinamic's stepper modules (TMCM-6110, TMCM-1140 and their relatives): one to six motors, ramps in the
//! module, microsteps, reference search, stallGuard2.
//!
//! Sources: TMCM-6110 and TMCM-1140 TMCL firmware manuals, TMC429 velocity and acceleration formulas of
//! the hardware manuals (chapter "operational description"). Conclusions are marked \[I\].

mod channel;
mod device;
mod module;
pub mod profile;
mod search;
pub mod units;

#[cfg(test)]
mod tests;

pub use device::{Device, Tmcm};
