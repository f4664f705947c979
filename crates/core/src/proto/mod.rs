//! The protocols. This is the only list of them: code outside names no protocol.

mod axis_number;
pub mod canopen;
pub mod early_bytes;
pub mod event_ring;
pub mod modbus;
pub mod options;
mod proven_addresses;
pub mod reply_ledger;
pub mod thruster;
pub mod tmcl;
pub mod tml;

use crate::axis::Driver;
use crate::explain::Dissector;
use crate::medium::{Frame, Medium};
use crate::profile::Profile;
use crate::station::Host;
pub use axis_number::{AxisNumber, GROUP, SUB_AXIS, drive_address, sub_axis, with_sub_axis};
pub use options::{HostOptions, OptionKey, OptionKind, SerialStandard};

/// Every protocol as decoders and encoders see it.
#[must_use]
pub fn dissectors() -> &'static [&'static dyn Dissector] {
    &[
        &tmcl::TmclDissector,
        &modbus::RTU,
        &modbus::ASCII,
        &modbus::TCP,
        &tml::explain::SERIAL,
        &tml::explain::TMLCAN,
        &tml::explain::TECHNOCAN,
        &thruster::ThrusterDissector,
        &canopen::CanopenDissector,
    ]
}

/// The dissector of that name.
#[must_use]
pub fn find_dissector(name: &str) -> Option<&'static dyn Dissector> {
    dissectors().iter().copied().find(|d| d.name() == name)
}

/// The host end of a protocol.
pub trait Protocol {
    /// Medium of the protocol.
    type Medium: Medium;
    /// Host of the protocol.
    type Host: Host<Self::Medium> + Send + 'static;
    /// The word in connection strings: `tmcl`, `modbus-rtu`. Two protocols may share it that differ
    /// in the medium.
    const NAME: &'static str;
    /// The word in profiles: `tmcl`, `modbus`.
    const PROFILE_PROTOCOL: &'static str;
    /// The product that is usual on this wire; `None` for the first profile of the protocol.
    const USUAL_PROFILE: Option<&'static str> = None;
    /// The profile of an axis of which nothing else is known.
    fn generic_profile() -> &'static Profile;
    /// Addresses that a scan tries.
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32>;
    /// The host's own address where it is one of the axes' kind: no axis can have it, or it would
    /// take the others' replies for commands.
    const HOST_ADDRESS: Option<u32> = None;
    /// Every address that a drive can have.
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32>;
    /// The address of a drive whose set-up leaves it to switches (address 0), and that has none.
    const SWITCH_ADDRESS: Option<u32> = None;
    /// True if it differs between RS-232 and RS-485.
    const HAS_SERIAL_STANDARDS: bool = false;
    /// Groups of drives that an address can name by [`GROUP`]: numbers 1 to this.
    const GROUPS: u8 = 0;
    /// The numbers of the axes that a drive can have at one address, the first one's first.
    const SUB_AXES: core::ops::RangeInclusive<u8> = 1..=1;
    /// Broadcast address, for requests without a reply.
    const BROADCAST_ADDRESS: Option<u32> = if Self::GROUPS > 0 { Some(GROUP) } else { None };
    /// The number that users of the protocol write for all of its stations; `None` for `g*` alone.
    const BROADCAST_NUMBER: Option<u32> = None;
    /// Keys of connection strings, beside those of every link.
    const KEYS: &'static [OptionKey];
    /// Usual port of a protocol that has TCP of its own, and no serial line.
    const NETWORK_PORT: Option<u16> = None;
    /// An address that no drive has, and a read that a device answers there which does not look at addresses.
    const UNUSED_ADDRESS: Option<(u32, &'static str)> = None;
    /// True if its frames are ASCII characters, for which seven data bits are enough.
    const IS_ASCII: bool = false;
    /// The baud or bit rate from the factory.
    const DEFAULT_RATE: u32;
    /// The baud or bit rates that its drives can have; empty if the protocol defines none.
    const RATES: &'static [u32] = &[];
    /// Writes the text of a read of what a request's text writes. `false` if that writes nothing, and where no one
    /// needs it: a broadcast has replies or does not exist.
    fn read_back(text: &str, profile: &'static Profile, out: &mut dyn core::fmt::Write) -> bool {
        let _ = (text, profile, out);
        false
    }
    /// The host of these axes. Where one of them is a relay to the others, it is the first.
    fn create_host(options: &HostOptions, axes: &[u32]) -> Self::Host;
    /// The driver of one axis, or of those that an address with [`GROUP`] names.
    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<
        Request = <Self::Host as Host<Self::Medium>>::Request,
        Answer = <Self::Host as Host<Self::Medium>>::Answer,
    > + Send
    + 'static;
    /// On CAN, whether a drive or host of that address, or what concerns all of them, has this
    /// identifier: another protocol on the bus must not have it.
    fn uses_can_id(address: u32, id: u32, extended: bool) -> bool {
        let _ = (address, id, extended);
        false
    }
    /// Why no drive may have that address, where it is one of [`VALID_ADDRESSES`](Self::VALID_ADDRESSES).
    fn forbidden_reason(address: u32) -> Option<&'static str> {
        let _ = address;
        None
    }
    /// On CAN, a request that every drive answers; `None` where each address must be asked by itself.
    fn discovery_frame(options: &HostOptions) -> Option<Frame> {
        let _ = options;
        None
    }
    /// On CAN, a read that the drive at this address answers so that [`frame_sender`](Self::frame_sender) shows it.
    /// A scan sends those of all addresses before it waits; `None` where each is waited for.
    fn presence_frame(options: &HostOptions, address: u32) -> Option<Frame> {
        let _ = (options, address);
        None
    }
    /// On CAN, the address of the drive that sent this frame, if the frame alone shows it. A scan uses it for
    /// drives that send by themselves, and for replies to [`discovery_frame`](Self::discovery_frame) and
    /// [`presence_frame`](Self::presence_frame).
    fn frame_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        let _ = (options, frame);
        None
    }
}

/// Takes every protocol in turn.
pub trait ProtocolVisitor {
    /// One protocol.
    fn visit_protocol<P: Protocol>(&mut self);
}

/// Shows every protocol with a host to `visitor`.
pub fn visit_protocols(visitor: &mut impl ProtocolVisitor) {
    visitor.visit_protocol::<tmcl::Tmcl>();
    visitor.visit_protocol::<tmcl::TmclCan>();
    visitor.visit_protocol::<modbus::Rtu>();
    visitor.visit_protocol::<modbus::Ascii>();
    visitor.visit_protocol::<modbus::Tcp>();
    visitor.visit_protocol::<tml::Tml>();
    visitor.visit_protocol::<tml::TmlCan>();
    visitor.visit_protocol::<tml::TechnoCan>();
    visitor.visit_protocol::<thruster::Thruster>();
    visitor.visit_protocol::<canopen::Canopen>();
}
