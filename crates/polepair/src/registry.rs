//! Finds protocols and families of the core by name and medium.

use crate::error::Error;
use polepair_core::axis::AnyLane;
use polepair_core::lane::{BoxedDriver, Lane};
use polepair_core::medium::{CanLine, Frame, Medium, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::proto::AxisNumber;
use polepair_core::proto::{self, GROUP, HostOptions, OptionKey, Protocol};
use polepair_core::station::Host;
use polepair_sim::rack::RackWire;
use polepair_sim::serial_line::{SerialWireConfig, Timing};
use std::any::Any;
use std::ops::RangeInclusive;

/// A protocol on its medium, as the registry shows it.
#[derive(Clone, Debug)]
pub(crate) struct ProtocolInfo {
    /// The word in connection strings.
    pub(crate) name: &'static str,
    /// Medium of the protocol.
    pub(crate) medium: MediumKind,
    /// The word in profiles.
    pub(crate) profile: &'static str,
    /// The product that is usual on this wire, if it is not the first of these profiles.
    pub(crate) usual_profile: Option<&'static str>,
    /// Addresses that a scan tries.
    pub(crate) addresses: RangeInclusive<u32>,
    /// Every address that a drive can have.
    pub(crate) all_addresses: RangeInclusive<u32>,
    /// The address of a drive whose set-up leaves it to switches, and that has none.
    pub(crate) switch_address: Option<u32>,
    /// True if it differs between RS-232 and RS-485.
    pub(crate) has_standards: bool,
    /// Number of drive groups, numbered from 1.
    pub(crate) groups: u8,
    /// The numbers of the axes that a drive can have at one address.
    pub(crate) sub_axes: RangeInclusive<u8>,
    /// The address that means everybody.
    pub(crate) broadcast: Option<u32>,
    /// The number that means the same as `g*` in a connection string.
    pub(crate) broadcast_number: Option<u32>,
    /// The host's own address, which no axis can have.
    pub(crate) host: Option<u32>,
    /// True if its frames are ASCII characters.
    pub(crate) is_ascii: bool,
    /// Usual port, if it is spoken on TCP alone.
    pub(crate) network_port: Option<u16>,
    /// An address that no drive has, and a read that is answered there only by what ignores addresses.
    pub(crate) unused_address: Option<(u32, &'static str)>,
    /// Keys of connection strings, beside those of every link.
    pub(crate) keys: &'static [OptionKey],
    /// The baud or bit rate from the factory.
    pub(crate) baud: u32,
    /// The rates that its drives can have; empty if the protocol defines none.
    pub(crate) rates: &'static [u32],
    /// Profile of an unidentified axis.
    pub(crate) generic: &'static Profile,
    /// On CAN, whether what has that address has this identifier, of 29 bits or not.
    pub(crate) uses_identifier: fn(u32, u32, bool) -> bool,
    /// Writes the text of a read of what a request's text writes, as far as a broadcast needs it.
    pub(crate) read_back: fn(&str, &'static Profile, &mut dyn std::fmt::Write) -> bool,
    /// Returns the reason why no drive may have an address.
    forbidden_reason: fn(u32) -> Option<&'static str>,
}

/// The numbers of the axes that a drive of that protocol can have at one address.
pub(crate) fn sub_axes(protocol: &str) -> RangeInclusive<u8> {
    let found = protocols().into_iter().find(|known| known.name == protocol);
    found.map_or(1..=1, |known| known.sub_axes)
}

/// The greatest number of an axis that profiles of a protocol can have at one address; on some it counts from 0.
pub(crate) fn last_sub_axis(profile_protocol: &str) -> u8 {
    let known = protocols().into_iter().filter(|known| known.profile == profile_protocol);
    known.map(|known| *known.sub_axes.end()).max().unwrap_or(1)
}

impl ProtocolInfo {
    /// Returns whether its drives can have that baud or bit rate.
    pub(crate) fn has_rate(&self, rate: u32) -> bool {
        self.rates.is_empty() || self.rates.contains(&rate)
    }

    /// The rate as a port is set to it.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210` if its drives cannot have it.
    pub(crate) fn checked_rate(&self, rate: u32, unit: &str) -> Result<u32, Error> {
        match rate {
            _ if self.has_rate(rate) => Ok(rate),
            // The TML communication manual prints 56600 for the rate that ports call 57600 (chapter 3).
            56_600 if self.has_rate(57_600) => Ok(57_600),
            _ => {
                let rates: Vec<_> = self.rates.iter().map(u32::to_string).collect();
                let what = format!("{} drives cannot be at {rate} {unit}", self.name);
                Err(Error::usage("E210", what, format!("they can be at {}", rates.join(", "))))
            }
        }
    }

    /// Addresses of one byte. A drive has a larger one only by its settings, and a host never selects one,
    /// because captures are not searched for it.
    pub(crate) fn byte_addresses(&self) -> RangeInclusive<u32> {
        *self.all_addresses.start()..=*self.all_addresses.end().min(&0xFF)
    }

    /// Another host address, if one of these drives has the default host address: the last free one. `None`
    /// if the default can be used.
    pub(crate) fn alternative_host(&self, drives: &[u32]) -> Option<u32> {
        let usual = self.host?;
        drives
            .contains(&usual)
            .then(|| self.byte_addresses().rev().find(|address| !drives.contains(address)))?
    }

    /// Returns whether that axis is all stations of a line where none of them answers.
    pub(crate) fn is_unanswered(&self, axis: u32) -> bool {
        self.groups == 0 && self.broadcast == Some(axis)
    }

    /// Refuses an address that no drive can have, and groups that the protocol has not.
    pub(crate) fn check_address(&self, address: u32) -> Result<(), Error> {
        if address & GROUP != 0 {
            return self.check_groups(address);
        }
        self.check_sub_axis(address)?;
        let address = proto::drive_address(address);
        if let Some(why) = (self.forbidden_reason)(address) {
            return Err(Error::usage(
                "E212",
                format!("no drive can have the address {address}"),
                why,
            ));
        }
        if self.all_addresses.contains(&address) {
            return Ok(());
        }
        let (first, last) = (self.all_addresses.start(), self.all_addresses.end());
        let what = format!("no drive can have the address {address} on {}", self.name);
        Err(Error::usage("E212", what, format!("addresses are {first} to {last}")))
    }

    /// Refuses an axis of a drive that the protocol has not.
    /// The profile of an axis, of the drive's: motors behind one address may have registers of their own.
    pub(crate) fn profile_of_axis(
        &self,
        profile: &'static Profile,
        number: u32,
    ) -> &'static Profile {
        profile.of_motor(proto::sub_axis(number).saturating_sub(*self.sub_axes.start()))
    }

    /// A hint that a serial server may be one of the protocol that the same drives have on TCP; empty for none.
    pub(crate) fn network_twin_hint(&self) -> String {
        let twin = protocols()
            .into_iter()
            .find(|other| other.profile == self.profile && other.network_port.is_some());
        twin.map_or_else(String::new, |twin| {
            format!("; or the server is one of another protocol: `{}://`", twin.name)
        })
    }

    fn check_sub_axis(&self, address: u32) -> Result<(), Error> {
        let sub = proto::sub_axis(address);
        let (first, last) = (self.sub_axes.start(), self.sub_axes.end());
        if sub == 0 || (first + 1..=*last).contains(&sub) {
            return Ok(());
        }
        let what = format!("`#{}`: {} has no such axis", AxisNumber(address), self.name);
        let drive = proto::drive_address(address);
        let hint = if first == last {
            format!("a drive has one axis: `#{drive}`")
        } else {
            format!("`#{drive}` is the first, then `#{drive}.{}` to `.{last}`", first + 1)
        };
        Err(Error::usage("E212", what, hint))
    }

    fn check_groups(&self, address: u32) -> Result<(), Error> {
        let last = 32 - (address & !GROUP).leading_zeros();
        if self.broadcast == Some(address) || self.groups > 0 && last <= self.groups.into() {
            return Ok(());
        }
        let what = format!("`#{}`: {} has no such group", AxisNumber(address), self.name);
        let hint = match self.groups {
            0 => "this protocol has no groups: name each axis by its number".to_owned(),
            last => format!("groups are g1 to g{last}, several g1+2, all g*"),
        };
        Err(Error::usage("E212", what, hint))
    }

    /// The standard that a serial line follows by default, and how it is built: one drive alone is
    /// on RS-232 where that makes a difference.
    pub(crate) fn default_wire(&self, drives: usize) -> RackWire {
        match self.medium {
            MediumKind::Can => RackWire::Can(CanLine { bit_rate: self.baud }),
            MediumKind::Serial if self.network_port.is_some() => {
                RackWire::Serial(SerialWireConfig {
                    timing: Timing::Cdc,
                    ..SerialWireConfig::RS232
                })
            }
            MediumKind::Serial if self.has_standards && drives == 1 => {
                RackWire::Serial(SerialWireConfig::RS232)
            }
            MediumKind::Serial => RackWire::Serial(SerialWireConfig::RS485),
        }
    }

    /// The connection string at a place, such as `serial:///dev/pts/3`, without axes.
    pub(crate) fn url_at(&self, place: &str) -> String {
        match place.strip_prefix("tcp:") {
            Some(address) if self.network_port.is_some() => format!("{}:{address}", self.name),
            _ => format!("{}+{place}", self.name),
        }
    }

    /// The word that means this protocol and no other of its name: `tmcl`, `tmcl+can`.
    pub(crate) fn unique_word(&self) -> String {
        match self.medium {
            MediumKind::Can if find_protocol(self.name, MediumKind::Serial).is_some() => {
                format!("{}+can", self.name)
            }
            _ => self.name.to_owned(),
        }
    }
}

/// Every protocol with a host.
pub(crate) fn protocols() -> Vec<ProtocolInfo> {
    let mut list = ProtocolLister(Vec::new());
    proto::visit_protocols(&mut list);
    list.0
}

/// The words of connection strings.
pub(crate) fn protocol_names() -> Vec<&'static str> {
    let mut names: Vec<&str> = Vec::new();
    for protocol in protocols() {
        if !names.contains(&protocol.name) {
            names.push(protocol.name);
        }
    }
    names
}

/// The protocol of that word on that medium.
pub(crate) fn find_protocol(name: &str, medium: MediumKind) -> Option<ProtocolInfo> {
    protocols().into_iter().find(|protocol| protocol.name == name && protocol.medium == medium)
}

/// The protocol of that word where it means one: `tmcl` on its usual medium, `tmcl+can` on CAN.
pub(crate) fn protocol_by_word(word: &str) -> Option<ProtocolInfo> {
    let (name, medium) = match word.split_once('+') {
        None => (word, None),
        Some((name, "serial")) => (name, Some(MediumKind::Serial)),
        Some((name, "can")) => (name, Some(MediumKind::Can)),
        Some(_) => return None,
    };
    protocols()
        .into_iter()
        .find(|protocol| protocol.name == name && medium.is_none_or(|m| m == protocol.medium))
}

/// A host of a protocol with one axis for each profile and address.
pub(crate) fn build_lane<M: Medium>(
    protocol: &str,
    options: HostOptions,
    axes: &[(&'static Profile, u32)],
) -> Option<Box<dyn AnyLane<M>>> {
    let mut maker = LaneBuilder { protocol, options, axes, lane: None };
    proto::visit_protocols(&mut maker);
    maker.lane
}

struct ProtocolLister(Vec<ProtocolInfo>);

impl proto::ProtocolVisitor for ProtocolLister {
    fn visit_protocol<P: Protocol>(&mut self) {
        self.0.push(ProtocolInfo {
            name: P::NAME,
            medium: P::Medium::KIND,
            profile: P::PROFILE_PROTOCOL,
            usual_profile: P::USUAL_PROFILE,
            addresses: P::SCAN_ADDRESSES,
            all_addresses: P::VALID_ADDRESSES,
            switch_address: P::SWITCH_ADDRESS,
            has_standards: P::HAS_SERIAL_STANDARDS,
            groups: P::GROUPS,
            sub_axes: P::SUB_AXES,
            broadcast: P::BROADCAST_ADDRESS,
            broadcast_number: P::BROADCAST_NUMBER,
            host: P::HOST_ADDRESS,
            is_ascii: P::IS_ASCII,
            network_port: P::NETWORK_PORT,
            unused_address: P::UNUSED_ADDRESS,
            keys: P::KEYS,
            baud: P::DEFAULT_RATE,
            rates: P::RATES,
            generic: P::generic_profile(),
            uses_identifier: P::uses_can_id,
            read_back: P::read_back,
            forbidden_reason: P::forbidden_reason,
        });
    }
}

struct LaneBuilder<'a, M: Medium> {
    protocol: &'a str,
    options: HostOptions,
    axes: &'a [(&'static Profile, u32)],
    lane: Option<Box<dyn AnyLane<M>>>,
}

impl<M: Medium> proto::ProtocolVisitor for LaneBuilder<'_, M> {
    fn visit_protocol<P: Protocol>(&mut self) {
        if P::NAME != self.protocol || P::Medium::KIND != M::KIND || self.lane.is_some() {
            return;
        }
        let addresses: Vec<u32> = self.axes.iter().map(|(_, address)| *address).collect();
        let drivers =
            self.axes.iter().map(|&(profile, address)| build_driver::<P>(profile, address));
        let host = P::create_host(&self.options, &addresses);
        let lane: Box<dyn AnyLane<P::Medium>> = Box::new(
            Lane::<P::Medium, P::Host>::new(host, drivers).with_driver_factory(build_driver::<P>),
        );
        // The media are the same, as was asked above; the compiler must be shown.
        let lane: Box<dyn Any> = Box::new(lane);
        self.lane = lane.downcast::<Box<dyn AnyLane<M>>>().ok().map(|lane| *lane);
    }
}

type HostRequest<P> = <<P as Protocol>::Host as Host<<P as Protocol>::Medium>>::Request;
type HostAnswer<P> = <<P as Protocol>::Host as Host<<P as Protocol>::Medium>>::Answer;

/// The driver of one axis.
fn build_driver<P: Protocol>(
    profile: &'static Profile,
    address: u32,
) -> BoxedDriver<HostRequest<P>, HostAnswer<P>> {
    Box::new(P::create_driver(profile, address))
}

/// Detector of a protocol's senders on a CAN bus, without a host.
pub(crate) struct SenderDetector {
    /// The one question that every drive answers, if there is one.
    pub(crate) question: Option<Frame>,
    presence: fn(&HostOptions, u32) -> Option<Frame>,
    sender: fn(&HostOptions, &Frame) -> Option<u32>,
    options: HostOptions,
}

impl SenderDetector {
    /// For the protocol of that word on CAN.
    pub(crate) fn new(protocol: &str, options: HostOptions) -> Self {
        let mut made = Self { question: None, presence: |_, _| None, sender: |_, _| None, options };
        proto::visit_protocols(&mut SenderDetectorBuilder { protocol, detector: &mut made });
        made
    }

    /// The question to the drive at one address that it answers with its address.
    pub(crate) fn presence_frame(&self, address: u32) -> Option<Frame> {
        (self.presence)(&self.options, address)
    }

    /// The address of the drive that sent a frame, if the frame contains it.
    pub(crate) fn sender(&self, frame: &Frame) -> Option<u32> {
        (self.sender)(&self.options, frame)
    }
}

struct SenderDetectorBuilder<'a> {
    protocol: &'a str,
    detector: &'a mut SenderDetector,
}

impl proto::ProtocolVisitor for SenderDetectorBuilder<'_> {
    fn visit_protocol<P: Protocol>(&mut self) {
        if P::NAME == self.protocol && P::Medium::KIND == MediumKind::Can {
            self.detector.question = P::discovery_frame(&self.detector.options);
            self.detector.presence = P::presence_frame;
            self.detector.sender = P::frame_sender;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{GROUP, MediumKind, find_protocol, protocol_by_word};

    #[test]
    fn hosts_give_way_to_drives() {
        let tmcl = find_protocol("tmcl", MediumKind::Serial).expect("known");
        assert_eq!(tmcl.alternative_host(&[1, 3]), None);
        assert_eq!(tmcl.alternative_host(&[1, 2]), Some(255));
        assert_eq!(tmcl.alternative_host(&[2, 255]), Some(254));
        let modbus = find_protocol("modbus-rtu", MediumKind::Serial).expect("known");
        assert_eq!(modbus.alternative_host(&[1, 2]), None);
        assert!(tmcl.check_address(255).is_ok() && tmcl.check_address(256).is_err());
        assert!(tmcl.check_address(GROUP | 1).is_err() && tmcl.check_address(GROUP).is_err());
        let modbus = find_protocol("modbus-rtu", MediumKind::Serial).unwrap();
        assert!(modbus.check_address(GROUP).is_ok() && modbus.check_address(GROUP | 1).is_err());
        assert!(modbus.is_unanswered(GROUP) && !modbus.is_unanswered(1));
    }

    #[test]
    fn a_word_means_one_protocol() {
        for (word, medium) in [
            ("tmcl", MediumKind::Serial),
            ("tmcl+serial", MediumKind::Serial),
            ("tmcl+can", MediumKind::Can),
        ] {
            assert_eq!(protocol_by_word(word).expect(word).medium, medium);
        }
        assert_eq!(protocol_by_word("tmcl+can").expect("known").unique_word(), "tmcl+can");
        assert!(
            protocol_by_word("modbus-rtu+can").is_none() && protocol_by_word("tmcl+udp").is_none()
        );
    }
}
