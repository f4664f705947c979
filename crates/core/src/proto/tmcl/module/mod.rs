//! What simulated TMCL modules have in common, whatever motors they drive: settings and EEPROM, global
//! parameters, stand-alone programs, control functions, and the ends of their wires.

mod device;
mod execute;
pub mod interrupts;
pub mod memory;
pub mod program;
mod state;

pub use device::{ModuleDevice, WireOptions};
pub use state::{ModuleState, TmclModule};
