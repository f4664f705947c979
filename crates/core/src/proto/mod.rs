//! The protocols. This is the one list of them: nothing outside names one.

pub mod modbus;
pub mod pace;
pub mod tmcl;
pub mod tml;

use crate::axis::Driver;
use crate::explain::Dissector;
use crate::medium::Medium;
use crate::profile::Profile;
use crate::station::Host;

/// Every protocol as decoders and encoders see it.
#[must_use]
pub fn dissectors() -> &'static [&'static dyn Dissector] {
    &[&tmcl::TmclDissector, &modbus::RTU, &modbus::ASCII]
}

/// The dissector of that name.
#[must_use]
pub fn dissector(name: &str) -> Option<&'static dyn Dissector> {
    dissectors().iter().copied().find(|d| d.name() == name)
}

/// Settings of a host that a connection string can give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostOptions {
    /// Baud rate; 0 on a wire without timing.
    pub baud: u32,
    /// Time allowed for a reply, ms; the profile's if `None`.
    pub reply_timeout_ms: Option<u32>,
    /// Silence before a frame, µs; the protocol's standard if `None`.
    pub gap_us: Option<u32>,
    /// Host address; the protocol's default if `None`.
    pub host: Option<u32>,
    /// The adapter lets us hear our own bytes.
    pub echo: bool,
}

impl HostOptions {
    /// As [`gap_us`](Self::gap_us): 3.5 characters at the line's baud rate, whatever it is.
    pub const GAP_CHARACTERS: u32 = u32::MAX;
}

/// How a protocol's commanding end is made.
pub trait Protocol {
    /// The wire it speaks on.
    type Medium: Medium;
    /// Its host.
    type Host: Host<Self::Medium> + Send + 'static;
    /// The word in connection strings: `tmcl`, `modbus-rtu`.
    const NAME: &'static str;
    /// The word in profiles: `tmcl`, `modbus`.
    const PROFILE: &'static str;
    /// What an axis on this protocol is called when nothing else is known.
    fn generic() -> &'static Profile;
    /// Addresses that a scan tries.
    const ADDRESSES: core::ops::RangeInclusive<u32>;
    /// The host's own address where it is one of the axes' kind: no axis can have it, or it would
    /// take the others' replies for commands.
    const HOST: Option<u32> = None;
    /// Every address that a drive can have.
    const EVERY_ADDRESS: core::ops::RangeInclusive<u32>;
    /// The baud rate from the factory.
    const BAUD: u32;
    /// The host.
    fn host(options: &HostOptions) -> Self::Host;
    /// The driver of one axis.
    fn driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<
        Request = <Self::Host as Host<Self::Medium>>::Request,
        Answer = <Self::Host as Host<Self::Medium>>::Answer,
    > + Send
    + 'static;
}

/// Takes every protocol in turn.
pub trait Visitor {
    /// One protocol.
    fn protocol<P: Protocol>(&mut self);
}

/// Shows every protocol with a host to `visitor`.
pub fn visit(visitor: &mut impl Visitor) {
    visitor.protocol::<tmcl::Tmcl>();
    visitor.protocol::<modbus::Rtu>();
    visitor.protocol::<modbus::Ascii>();
}
