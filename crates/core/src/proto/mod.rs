//! The protocols. This is the only list of them: code outside names no protocol.

mod axis_number;
pub mod canopen;
pub mod early_bytes;
pub mod event_ring;
pub mod modbus;
mod proven_addresses;
pub mod thruster;
pub mod tmcl;
pub mod tml;

use crate::axis::Driver;
use crate::explain::Dissector;
use crate::medium::{Frame, Medium};
use crate::profile::Profile;
use crate::station::Host;
pub use axis_number::{AxisNumber, GROUP, SUB_AXIS, drive_address, sub_axis, with_sub_axis};

/// Every protocol as decoders and encoders see it.
#[must_use]
pub fn dissectors() -> &'static [&'static dyn Dissector] {
    &[
        &tmcl::TmclDissector,
        &modbus::RTU,
        &modbus::ASCII,
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

/// Standard of a serial line, for protocols that differ by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SerialStandard {
    /// Point to point, both ways at once.
    Rs232,
    /// Many drives on one pair, one speaker at a time.
    Rs485,
}

/// Settings of a host that a connection string can give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostOptions {
    /// Baud rate of a serial line; 0 on a wire without timing.
    pub baud: u32,
    /// The port is set to `baud`, but bytes may travel sooner than it allows (USB CDC, emulators of
    /// serial ports): no answer comes too soon.
    pub untimed: bool,
    /// Bit rate of a CAN bus; 0 where the link does not know it (UDP).
    pub bit_rate: u32,
    /// Which standard the serial line follows; the protocol's usual one if `None`.
    pub standard: Option<SerialStandard>,
    /// Time allowed for a reply, ms; the profile's if `None`.
    pub reply_timeout_ms: Option<u32>,
    /// Time allowed for an acknowledgement where it is apart from the reply, ms; the protocol's
    /// if `None`.
    pub ack_timeout_ms: Option<u32>,
    /// Wait for each step of bringing a line back into step, ms; the protocol's if `None`.
    pub resync_pause_ms: Option<u32>,
    /// Silence before a frame, µs; the protocol's standard if `None`.
    pub gap_us: Option<u32>,
    /// Host address; the protocol's default if `None`.
    pub host_address: Option<u32>,
    /// Period of the host's own heartbeat, if the protocol has one, ms; `None` for none. It continues only
    /// while the application sends requests.
    pub heartbeat_ms: Option<u32>,
    /// The adapter returns our own bytes.
    pub echo: bool,
    /// The axis that the host is wired to, where others are reached through it; the first axis if `None`.
    pub relay_axis: Option<u32>,
    /// Axes behind a relay only answer questions of their own: what they say unasked, or to a
    /// question to a group, does not come back.
    pub relay_answers_only: bool,
    /// An earlier program may have used the wire, and a late reply to it may still arrive. Where replies do
    /// not repeat their request, a session then starts with probes, varied by this seed; only stops are sent
    /// before these have replies. `None` where no program was there before (REQ-7).
    pub probe_seed: Option<u32>,
    /// For scans: an address that never replied is asked only once, so that silence costs the least time.
    pub scanning: bool,
    /// A stop waits for the reply: the check for two drives with one address, which takes longer, is left
    /// out.
    pub urgent: bool,
    /// All time-outs of the host are so many times as long, for tests on a busy machine; 1 otherwise.
    pub timeout_scale: u32,
}

impl HostOptions {
    /// [`gap_us`](Self::gap_us) of 3.5 characters at the line's baud rate.
    pub const GAP_CHARACTERS: u32 = u32::MAX;

    /// A time-out of so many milliseconds, scaled.
    #[must_use]
    pub const fn scaled_ms(&self, timeout_ms: u32) -> u32 {
        timeout_ms.saturating_mul(self.timeout_scale)
    }

    /// Time-out of a reply, ms, scaled: the stated one, or `usual_ms`.
    #[must_use]
    pub fn reply_timeout_ms(&self, usual_ms: u32) -> u32 {
        self.scaled_ms(self.reply_timeout_ms.unwrap_or(usual_ms))
    }

    /// The baud rate that no byte travels faster than; 0 where there is none.
    #[must_use]
    pub const fn timed_baud(&self) -> u32 {
        if self.untimed { 0 } else { self.baud }
    }

    /// Everything as the protocol has it, on a wire of that baud or bit rate.
    #[must_use]
    pub const fn new(rate: u32) -> Self {
        Self {
            baud: rate,
            untimed: false,
            bit_rate: rate,
            standard: None,
            reply_timeout_ms: None,
            ack_timeout_ms: None,
            resync_pause_ms: None,
            gap_us: None,
            host_address: None,
            heartbeat_ms: None,
            echo: false,
            relay_axis: None,
            relay_answers_only: false,
            probe_seed: None,
            scanning: false,
            urgent: false,
            timeout_scale: 1,
        }
    }
}

/// The host end of a protocol.
pub trait Protocol {
    /// The wire it speaks on.
    type Medium: Medium;
    /// Its host.
    type Host: Host<Self::Medium> + Send + 'static;
    /// The word in connection strings: `tmcl`, `modbus-rtu`. Two protocols may share it that differ
    /// in the medium.
    const NAME: &'static str;
    /// The word in profiles: `tmcl`, `modbus`.
    const PROFILE_PROTOCOL: &'static str;
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
    /// It speaks differently on RS-232 and on RS-485.
    const HAS_SERIAL_STANDARDS: bool = false;
    /// Groups of drives that an address can name by [`GROUP`]: numbers 1 to this.
    const GROUPS: u8 = 0;
    /// The numbers of the axes that a drive can have at one address, the first one's first.
    const SUB_AXES: core::ops::RangeInclusive<u8> = 1..=1;
    /// The address that means everybody: to it can be said what needs no answer.
    const BROADCAST_ADDRESS: Option<u32> = if Self::GROUPS > 0 { Some(GROUP) } else { None };
    /// Its frames are characters of ASCII, for which seven data bits are enough.
    const IS_ASCII: bool = false;
    /// The baud or bit rate from the factory.
    const DEFAULT_RATE: u32;
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
    /// On CAN, the address of the drive that sent this frame, if the frame alone shows it. A scan uses it for
    /// drives that send by themselves, and for replies to [`discovery_frame`](Self::discovery_frame).
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
    visitor.visit_protocol::<tml::Tml>();
    visitor.visit_protocol::<tml::TmlCan>();
    visitor.visit_protocol::<tml::TechnoCan>();
    visitor.visit_protocol::<thruster::Thruster>();
    visitor.visit_protocol::<canopen::Canopen>();
}
