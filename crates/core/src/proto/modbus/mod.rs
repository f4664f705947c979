//! Modbus over a serial line: RTU and ASCII, both ends.
//!
//! Sources: MODBUS Application Protocol Specification V1.1b3 ("MAP"), MODBUS over Serial Line V1.02
//! ("MSL"), TS manual V2 chapter 2. What no source states is marked `[I]`.

pub mod ascii;
pub mod axis;
pub mod device;
pub mod encoding;
pub mod explain;
pub mod host;
pub mod request;
pub mod rtu;
pub mod text;
pub mod wire;

#[cfg(test)]
mod tests;

use super::{HostOptions, Protocol};
use crate::axis::Driver;
use crate::medium::Stream;
use crate::profile::Profile;

pub use axis::Axis;
pub use explain::ModbusDissector;
pub use host::Host;
pub use request::{Answer, Request};

/// RTU in captures and the encoder.
pub const RTU: ModbusDissector = ModbusDissector(wire::Format::Rtu);
/// ASCII in captures and the encoder.
pub const ASCII: ModbusDissector = ModbusDissector(wire::Format::Ascii);

/// Modbus RTU.
#[derive(Debug)]
pub enum Rtu {}

/// Modbus ASCII.
#[derive(Debug)]
pub enum Ascii {}

macro_rules! protocol {
    ($kind:ident, $name:literal) => {
        impl Protocol for $kind {
            type Medium = Stream;
            type Host = Host;
            const NAME: &'static str = $name;
            const PROFILE: &'static str = "modbus";
            // TS manual V2 §2.2: 1 to 127 on the drives known here; the standard
            // allows up to 247.
            const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
            const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 1..=247;
            const EVERYBODY: Option<u32> = Some(wire::BROADCAST as u32);
            const BAUD: u32 = 115_200;

            fn generic() -> &'static Profile {
                &axis::GENERIC
            }

            fn host(options: &HostOptions, _axes: &[u32]) -> Host {
                Host::new(wire::Format::$kind, options)
            }

            fn driver(
                profile: &'static Profile,
                address: u32,
            ) -> impl Driver<Request = Request, Answer = Answer> + Send + 'static {
                Axis::new(profile, address)
            }
        }
    };
}

protocol!(Rtu, "modbus-rtu");
protocol!(Ascii, "modbus-ascii");
