//! CANopen: network management, service and process data on CAN, and drives by CiA 402.
//!
//! Sources: CiA 301 (services, objects 1000h to 1FFFh), CiA 302 (masters), CiA 305 (LSS), CiA 402 (drives);
//! chapter 3 of the TS communication manual for deviations of that drive. Inferred facts are marked \[I\].

pub mod address;
pub mod cia402;
pub mod cob;
pub mod device;
pub mod driver;
pub mod emcy;
pub mod explain;
pub mod generic;
pub mod heartbeat;
pub mod host;
pub mod host_request;
pub mod known_pdo;
pub mod lss;
pub mod nmt;
pub mod od;
pub mod pdo;
pub mod sdo;
pub mod sync;
pub mod text;
pub mod time;

pub use cob::Cob;
pub use driver::{Canopen, CanopenDriver};
pub use explain::CanopenDissector;
pub use host::CanHost;
pub use host_request::{Answer, HostRequest};

use crate::error::WireError;

/// Node-IDs go from 1 to this.
pub const NODE_MAX: u8 = 127;

/// Error of `data` with a wrong length; `need` is the right one.
const fn wrong_length(need: u16, data: &[u8]) -> WireError {
    let found = data.len() as u16;
    if found < need { WireError::Short { need, found } } else { WireError::Long { need, found } }
}

#[cfg(test)]
mod tests;
