//! Common parts of simulated TMCL modules, independent of their motors: settings and EEPROM, global
//! parameters, stand-alone programs, control functions, and both wires.

mod device;
mod execute;
pub mod interrupts;
pub mod memory;
pub mod program;
mod state;

pub use device::{ModuleDevice, WireOptions};
pub use state::{ModulePrograms, ModuleState, TmclModule};
