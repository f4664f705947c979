//! Modbus, both ends: RTU and ASCII on a serial line, and TCP.
//!
//! Sources: MODBUS Application Protocol Specification V1.1b3 ("MAP"), MODBUS over Serial Line V1.02
//! ("MSL"), MODBUS Messaging on TCP/IP Implementation Guide V1.0b ("MTG"), TS manual V2 chapter 2. Inferred facts are
//! marked `[I]`.

pub mod address;
pub mod ascii;
pub mod device;
pub mod device_id;
pub mod driver;
pub mod encoding;
pub mod explain;
mod function;
pub mod host;
pub mod host_request;
pub mod rtu;
pub mod tcp;
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
pub use host::tcp::TcpHost;
pub use host_request::{Answer, HostRequest};

/// RTU in captures and the encoder.
pub const RTU: ModbusDissector = ModbusDissector(wire::WireFormat::Rtu);
/// ASCII in captures and the encoder.
pub const ASCII: ModbusDissector = ModbusDissector(wire::WireFormat::Ascii);
/// TCP in captures and the encoder.
pub const TCP: ModbusDissector = ModbusDissector(wire::WireFormat::Tcp);

/// Modbus RTU.
#[derive(Debug)]
pub enum Rtu {}

/// Modbus ASCII.
#[derive(Debug)]
pub enum Ascii {}

/// Modbus TCP.
#[derive(Debug)]
pub enum Tcp {}

macro_rules! protocol {
    ($kind:ident, $name:literal, $host:ident, { $($own:tt)* }) => {
        impl Protocol for $kind {
            type Medium = Stream;
            type Host = $host;
            const NAME: &'static str = $name;
            const PROFILE_PROTOCOL: &'static str = "modbus";
            // TS manual V2 §2.2: 1 to 127 on the drives known here; the standard
            // allows up to 247.
            const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=127;
            const SUB_AXES: core::ops::RangeInclusive<u8> = 1..=8;
            const BROADCAST_ADDRESS: Option<u32> = Some(GROUP);
            const BROADCAST_NUMBER: Option<u32> = Some(wire::BROADCAST as u32);
            $($own)*

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

            fn create_driver(
                profile: &'static Profile,
                address: u32,
            ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
                ModbusDriver::new(profile, address)
            }
        }
    };
}

protocol!(Rtu, "modbus-rtu", SerialHost, {
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=247;
    const DEFAULT_RATE: u32 = 115_200;
    const KEYS: &[OptionKey] = &[options::TIMEOUT, options::GAP];
    fn create_host(options: &HostOptions, _axes: &[u32]) -> SerialHost {
        SerialHost::new(wire::WireFormat::Rtu, options)
    }
});
protocol!(Ascii, "modbus-ascii", SerialHost, {
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=247;
    const IS_ASCII: bool = true;
    const DEFAULT_RATE: u32 = 115_200;
    const KEYS: &[OptionKey] = &[options::TIMEOUT, options::GAP];
    fn create_host(options: &HostOptions, _axes: &[u32]) -> SerialHost {
        SerialHost::new(wire::WireFormat::Ascii, options)
    }
});
protocol!(Tcp, "modbus-tcp", TcpHost, {
    // 255 is a device without a gateway before it (MTG 4.4.1.2).
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=tcp::DEVICE_UNIT as u32;
    const NETWORK_PORT: Option<u16> = Some(tcp::PORT);
    // 248 to 254 are reserved (MSL 2.2).
    const UNUSED_ADDRESS: Option<(u32, &'static str)> = Some((254, "read 0 1"));
    const DEFAULT_RATE: u32 = 0;
    const KEYS: &[OptionKey] = &[options::TIMEOUT];
    fn create_host(options: &HostOptions, _axes: &[u32]) -> TcpHost {
        TcpHost::new(options)
    }
});
