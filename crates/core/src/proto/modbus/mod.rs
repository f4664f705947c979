//! Modbus on a serial line: RTU and ASCII, both ends.
//!
//! Sources: MODBUS Application Protocol Specification V1.1b3 ("MAP"), MODBUS over Serial Line V1.02
//! ("MSL"), TS manual V2 chapter 2. Inferred facts are marked `[I]`.

pub mod address;
pub mod ascii;
pub mod device;
pub mod device_id;
pub mod driver;
pub mod encoding;
pub mod explain;
pub mod host;
pub mod host_request;
pub mod rtu;
pub mod text;
pub mod wire;

#[cfg(test)]
mod tests;

use super::options::{self, OptionKey};
use super::{GROUP, HostOptions, Protocol};
use crate::axis::Driver;
use crate::medium::Stream;
use crate::profile::Profile;

pub use driver::ModbusDriver;
pub use explain::ModbusDissector;
pub use host::SerialHost;
pub use host_request::{Answer, HostRequest};

/// RTU in captures and the encoder.
pub const RTU: ModbusDissector = ModbusDissector(wire::WireFormat::Rtu);
/// ASCII in captures and the encoder.
pub const ASCII: ModbusDissector = ModbusDissector(wire::WireFormat::Ascii);

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
            type Host = SerialHost;
            const NAME: &'static str = $name;
            const PROFILE_PROTOCOL: &'static str = "modbus";
            // TS manual V2 §2.2: 1 to 127 on the drives known here; the standard
            // allows up to 247.
            const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
            const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=247;
            const BROADCAST_ADDRESS: Option<u32> = Some(GROUP);
            const BROADCAST_NUMBER: Option<u32> = Some(wire::BROADCAST as u32);
            const IS_ASCII: bool = matches!(wire::WireFormat::$kind, wire::WireFormat::Ascii);
            const DEFAULT_RATE: u32 = 115_200;
            const KEYS: &[OptionKey] = &[options::TIMEOUT, options::GAP];

            fn generic_profile() -> &'static Profile {
                &driver::GENERIC
            }

            fn read_back(
                request: &str,
                profile: &'static Profile,
                out: &mut dyn core::fmt::Write,
            ) -> bool {
                text::parse(request, Some(profile)).is_ok_and(|parsed| parsed.read_back(out))
            }

            fn create_host(options: &HostOptions, _axes: &[u32]) -> SerialHost {
                SerialHost::new(wire::WireFormat::$kind, options)
            }

            fn create_driver(
                profile: &'static Profile,
                address: u32,
            ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
                ModbusDriver::new(profile, address)
            }
        }
    };
}

protocol!(Rtu, "modbus-rtu");
protocol!(Ascii, "modbus-ascii");
