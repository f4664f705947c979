//! Trinamic's brushless and servo modules beside the TMCM-170 and 171: TMCM-1617 to 1690 and 2611.
//!
//! Parameters have other numbers in each kind of module, which finds them by their names in its profile.
//! Source: PyTrinamic 0.2.26, whose classes name the parameters and whose examples show their units (rpm, mA, counts of
//! the encoder or of the position scaler). Inferred facts are marked \[I\].

mod device;
mod layout;
mod module;
pub mod units;

pub use device::{BrushlessFamily, Device};
