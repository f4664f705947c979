//! Simulated drives: racks from names or from a file, in this process or on real wires.
//!
//! ```
//! use polepair::simulate::{self, SimulationPace};
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let rack = simulate::rack_of_words(&["tmcl:1,2"], 7)?;
//! let simulation = simulate::Simulation::new(&rack, 7, SimulationPace::Virtual)?;
//! assert_eq!(simulation.links(), 1);
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod act;
mod drive_line;
mod rack_file;
mod sim_end;
mod word;

use crate::bus::{BusAddress, BusLoadRange};
use crate::error::Error;
use crate::mounting::Mounting;
use crate::registry::{self, ProtocolInfo};
use crate::toml_file::{FileError, FileLocation, Located};
use crate::url::AxisNumber;
use crate::wire::AnyLink;
pub use act::{ACTS, ActKind, ActValue, act_of_value, parse_act, parse_act_value};
pub use drive_line::{DriveLine, drive_lines};
use polepair_core::medium::MediumKind;
use polepair_core::profile::Profile;
use polepair_core::proto::{self, drive_address, sub_axis};
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_link::clock;
use polepair_sim::can_bus::CanFaults;
use polepair_sim::fault::SerialFaults;
use polepair_sim::rack::{BuiltRack, RackDrive, RackLink, RackSpec, RackWire};
use polepair_sim::serial_line::{Duplex, Timing};
use polepair_sim::world::World;
pub(crate) use rack_file::FILE_KEYS;
pub use rack_file::{rack_of_file, rack_of_text};
use sim_end::SharedWorld;
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
pub(crate) use word::{find_drive, is_own_profile};
pub use word::{is_drive, words};

/// Drives on one simulated link at most.
const DRIVES_MAX: usize = 64;

/// Characters of a panel.
const PANEL_MAX: usize = 64;
/// Number of times faster than real motors simulated ones can live.
const TIME_SCALES: RangeInclusive<f64> = 0.01..=100.0;

/// Pace of a simulation's time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SimulationPace {
    /// Virtual time: a wait is over at once.
    Virtual,
    /// Real time, with the pace of real motors.
    Real,
}

/// Links with drives on them, and what the core's description does not hold.
#[derive(Clone, Debug, Default)]
pub struct RackDescription {
    /// The links and drives.
    pub rack: RackSpec,
    /// For each link, the protocol's word in connection strings, faults of the wire and baud rate.
    pub wires: Vec<WireDescription>,
}

/// A motor of a simulated drive, by places that count from 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SimulatedMotor {
    /// The link.
    pub link: usize,
    /// The drive on it.
    pub drive: usize,
    /// The motor of the drive.
    pub motor: u8,
}

/// The rack's entry of a further axis of a drive.
#[derive(Clone, Debug)]
pub(crate) struct RackAxis {
    /// Number in connection strings: 2 is `#5.2`.
    pub(crate) number: u8,
    /// Name; empty for none.
    pub(crate) name: String,
    /// Mounting in its machine.
    pub(crate) mounting: Option<Arc<Mounting>>,
    /// Full steps of a turn of its motor, where they differ from those of the drive's others.
    pub(crate) steps: Option<u32>,
}

/// One link of a [`RackDescription`], with settings of the rack file.
#[derive(Clone, Debug)]
pub struct WireDescription {
    /// The protocol's word in connection strings.
    pub protocol: &'static str,
    /// Faults of a serial wire.
    pub faults: SerialFaults,
    /// Faults of a CAN bus.
    pub can_faults: CanFaults,
    /// Bits per second; 0 on a wire without timing.
    pub baud: u32,
    /// True if its drives receive each other's bytes even on a wire without timing.
    pub shared: bool,
    /// True if its timing also applies when the wire is served on a real one.
    pub timed: bool,
    /// Names of the drives; empty for no name.
    pub names: Vec<String>,
    /// Planned bus load of its drives.
    pub load: BusLoadRange,
    /// Mounting of each drive in its machine.
    pub(crate) mountings: Vec<Option<Arc<Mounting>>>,
    /// Full steps of a turn of each drive's stepper motors, if given.
    pub(crate) steps: Vec<Option<u32>>,
    /// Further axes of each drive.
    pub(crate) axes: Vec<Vec<RackAxis>>,
    /// Place of the real link.
    pub(crate) connect: Option<Located<String>>,
    /// Location of the link in its file; `None` without a file.
    pub(crate) location: Option<FileLocation>,
}

/// A rack from words such as `tmcl`, `tmcl:1,2`, `tmcm-171:3`, `tmcl+can` or `syntron-ts:1?fn00=14`, with options of
/// its drives: each word is a link.
///
/// # Errors
/// [`Error::Usage`] `E203` for a word that is neither protocol, family nor product, `E217` for an address that is no
/// number, `E210` for an option that is given twice.
pub fn rack_of_words(words: &[&str], seed: u64) -> Result<RackDescription, Error> {
    let mut description = RackDescription::default();
    for (n, word) in words.iter().enumerate() {
        let (word, options) = word.split_once('?').unwrap_or((word, ""));
        let (name, addresses) = word.split_once(':').unwrap_or((word, ""));
        let (profile, protocol) = find_drive(name)?;
        let mut drives = Vec::new();
        for text in addresses.split(',').filter(|_| !addresses.is_empty()) {
            let address = parse_address(text, word)?;
            protocol.check_address(address)?;
            drives.push(Some(address));
        }
        if drives.is_empty() {
            drives.push(None);
        }
        let seed = seed.wrapping_add(n as u64 * 1000);
        description.add_link(word, profile, protocol, &drives, seed);
        let options = crate::url::parse_keys(options)?;
        for drive in description.rack.links.iter_mut().skip(n).flat_map(|link| &mut link.drives) {
            drive.extra.extend(options.iter().cloned());
        }
    }
    Ok(description)
}

fn parse_address(text: &str, word: &str) -> Result<u32, Error> {
    let address = crate::toml_file::parse_number(text.trim()).and_then(|n| u32::try_from(n).ok());
    address.ok_or_else(|| {
        let what = format!("`{word}`: `{text}` is no address");
        Error::usage("E217", what, "write `tmcl:1,2` for drives at the addresses 1 and 2")
    })
}

impl WireDescription {
    /// The names of all axes on it; empty for those without one.
    pub fn axis_names(&self) -> impl Iterator<Item = &String> {
        self.names.iter().chain(self.axes.iter().flatten().map(|axis| &axis.name))
    }
}

impl RackDescription {
    /// Makes the drives of a link what a data sheet (EDS or DCF) lists: a motor by CiA 402 where the
    /// objects are there, else a node that keeps written values. Returns the differences of the sheet
    /// from the standard.
    ///
    /// # Errors
    /// [`Error::File`] with line and reason; [`Error::Usage`] `E213` for drives that have no sheet.
    pub fn apply_sheet(&mut self, link: usize, file: &Path) -> Result<Vec<FileError>, Error> {
        let links = &mut self.rack.links;
        let drives = links.get_mut(link).map(|link| &mut link.drives).into_iter().flatten();
        let (sheet, eds) = crate::eds::load_sheet(file)?;
        for drive in drives {
            if !crate::eds::accepts_sheet(drive.profile) {
                let what = format!("`{}` is no device of a data sheet", drive.profile.name);
                return Err(Error::usage("E213", what, "a CANopen device is: canopen:5"));
            }
            drive.data_sheet = Some(Arc::clone(&sheet));
            drive.address = drive.address.or(eds.node_id().map(u32::from));
        }
        Ok(eds.warnings)
    }

    /// Applies a sheet to every link with a drive that it can describe and that has none.
    pub(crate) fn apply_sheet_where_possible(&mut self, file: &Path) -> Result<(), Error> {
        for link in 0..self.rack.links.len() {
            let fits =
                |d: &RackDrive| d.data_sheet.is_none() && crate::eds::accepts_sheet(d.profile);
            if self.rack.links[link].drives.iter().all(fits) {
                self.apply_sheet(link, file)?;
            }
        }
        Ok(())
    }

    /// The link on which a drive relays to this one.
    #[must_use]
    pub fn relay_link(&self, link: usize) -> Option<usize> {
        self.rack.links.iter().position(|other| has_relay(&other.drives, link))
    }

    /// A motor of a drive that is on this link, or behind a relay on it: of the axis of that name or number;
    /// of the only drive, text may be empty.
    #[must_use]
    pub fn find_motor(&self, link: usize, text: &str) -> Option<SimulatedMotor> {
        let all: Vec<(usize, usize)> = (0..self.rack.links.len())
            .filter(|n| *n == link || self.relay_link(*n) == Some(link))
            .flat_map(|n| (0..self.rack.links[n].drives.len()).map(move |at| (n, at)))
            .collect();
        let first_motor = |(link, drive): (usize, usize)| SimulatedMotor { link, drive, motor: 0 };
        if let ([only], "") = (&all[..], text) {
            return Some(first_motor(*only));
        }
        if let Some(number) = AxisNumber::parse(text) {
            let address = Some(drive_address(number.0));
            let is_it =
                |(n, at): &&(usize, usize)| self.rack.links[*n].drives[*at].address == address;
            let found = all.iter().find(is_it).copied()?;
            return Some(SimulatedMotor {
                motor: self.motor_number(found, sub_axis(number.0)),
                ..first_motor(found)
            });
        }
        all.iter().filter(|_| !text.is_empty()).find_map(|&(n, at)| {
            let wire = &self.wires[n];
            if wire.names.get(at).is_some_and(|name| name == text) {
                return Some(first_motor((n, at)));
            }
            let axis = wire.axes.get(at)?.iter().find(|axis| axis.name == text)?;
            let motor = self.motor_number((n, at), axis.number);
            Some(SimulatedMotor { motor, ..first_motor((n, at)) })
        })
    }

    /// The motor of the axis of that number on a link or behind a relay on it, or else of the drive of that
    /// place.
    #[must_use]
    pub fn motor_of_axis(&self, link: usize, number: u32, index: usize) -> Option<SimulatedMotor> {
        let found = self.find_motor(link, &AxisNumber(number).to_string());
        let exists = self.rack.links.get(link)?.drives.get(index).is_some();
        found.or_else(|| exists.then_some(SimulatedMotor { link, drive: index, motor: 0 }))
    }

    /// Returns the motor of a drive that an axis is, from 0.
    pub(crate) fn motor_number(&self, motor: (usize, usize), sub_axis: u8) -> u8 {
        let (link, _) = motor;

        sub_axis.saturating_sub(*registry::sub_axes(self.wires[link].protocol).start())
    }

    /// The links that drives of this one relay to.
    pub(crate) fn links_behind(&self, link: usize) -> impl Iterator<Item = usize> {
        self.rack.links[link].drives.iter().filter_map(|drive| drive.second_link)
    }

    fn add_link(
        &mut self,
        name: &str,
        profile: &'static Profile,
        protocol: registry::ProtocolInfo,
        addresses: &[Option<u32>],
        seed: u64,
    ) {
        let mut wire = protocol.default_wire(addresses.len());
        // A user's profile states the line of its drive.
        let line = profile.line.filter(|_| protocol.network_port.is_none());
        if let (RackWire::Serial(serial), Some(line)) = (&mut wire, line) {
            serial.baud = Some(line.baud);
        }
        let drive = |(n, address): (usize, &Option<u32>)| {
            let mut drive = RackDrive::new(profile, protocol.name);
            drive.standard = wire.standard().filter(|_| protocol.has_standards);
            drive.address = *address;
            drive.seed = seed.wrapping_add(n as u64);
            drive
        };
        let drives: Vec<_> = addresses.iter().enumerate().map(drive).collect();
        self.wires.push(WireDescription {
            protocol: protocol.name,
            faults: SerialFaults::NONE,
            can_faults: CanFaults::default(),
            baud: line.map_or(protocol.baud, |line| line.baud),
            shared: false,
            timed: false,
            names: vec![String::new(); drives.len()],
            load: BusLoadRange::default(),
            mountings: vec![None; drives.len()],
            steps: vec![None; drives.len()],
            axes: vec![Vec::new(); drives.len()],
            connect: None,
            location: None,
        });
        self.rack.links.push(RackLink { name: name.to_owned(), wire, drives });
        self.assign_host(self.wires.len() - 1);
    }

    /// The host address of a link's drives in one protocol, if a drive or another protocol on the bus has
    /// the default one.
    ///
    /// A drive's option `host` has priority, because it is the setting of the real drive.
    pub(crate) fn host_address(&self, link: usize, protocol: &ProtocolInfo) -> Option<u32> {
        let drives =
            self.rack.links[link].drives.iter().filter(|drive| speaks_protocol(drive, protocol));
        let report = drives.flat_map(|drive| &drive.extra).find(|(key, _)| key == "host");
        let reported = report.and_then(|(_, host)| crate::toml_file::parse_number(host));
        if let Some(host) = reported.and_then(|host| u32::try_from(host).ok()) {
            return Some(host);
        }
        let (own, others): (Vec<BusAddress>, Vec<BusAddress>) = self
            .bus_addresses(link)
            .into_iter()
            .partition(|bus_address| bus_address.protocol.name == protocol.name);
        let addresses: Vec<u32> = own.iter().map(|bus_address| bus_address.address).collect();
        protocol.host_among(&addresses, &others)
    }

    /// Each drive of a link with its protocol and address.
    pub(crate) fn bus_addresses(&self, link: usize) -> Vec<BusAddress> {
        let rack = &self.rack.links[link];
        rack.drives
            .iter()
            .filter_map(|drive| {
                let info = registry::find_protocol(drive.wires.first()?, rack.wire.medium())?;
                let address = drive.address.unwrap_or(*info.addresses.start());
                Some(BusAddress { protocol: info, address })
            })
            .collect()
    }

    /// The protocols that are spoken on a link, in the order of its drives.
    pub(crate) fn protocols_on(&self, link: usize) -> Vec<ProtocolInfo> {
        let mut all: Vec<ProtocolInfo> = Vec::new();
        for BusAddress { protocol, .. } in self.bus_addresses(link) {
            if all.iter().all(|other| other.name != protocol.name) {
                all.push(protocol);
            }
        }
        // A bus on which a relay alone sits.
        if all.is_empty() {
            all.extend(self.link_protocol(link));
        }
        all
    }

    /// The standard that a link's line follows, where its protocol makes a difference.
    pub(crate) fn line_standard(&self, link: usize) -> Option<proto::SerialStandard> {
        let makes_a_difference =
            self.link_protocol(link).is_some_and(|protocol| protocol.has_standards);
        self.rack.links[link].wire.standard().filter(|_| makes_a_difference)
    }

    fn link_protocol(&self, link: usize) -> Option<registry::ProtocolInfo> {
        registry::find_protocol(self.wires[link].protocol, self.rack.links[link].wire.medium())
    }

    /// The connection strings of a link, to be opened at `place` (`serial:///dev/pts/3`): one for
    /// each protocol on it.
    #[must_use]
    pub fn urls(&self, link: usize, location: &str) -> Vec<String> {
        self.protocols_on(link)
            .iter()
            .map(|protocol| self.protocol_url(link, protocol, location))
            .collect()
    }

    /// Returns whether the drives of a link are on TCP alone.
    #[must_use]
    pub fn is_on_network(&self, link: usize) -> bool {
        let mut protocols = self.protocols_on(link).into_iter();
        protocols.any(|protocol| protocol.network_port.is_some())
    }

    fn protocol_url(&self, link: usize, protocol: &ProtocolInfo, location: &str) -> String {
        let first = *protocol.addresses.start();
        let behind = self.links_behind(link).flat_map(|other| &self.rack.links[other].drives);
        let own =
            self.rack.links[link].drives.iter().filter(|drive| speaks_protocol(drive, protocol));
        let rs485 = self.line_standard(link) == Some(proto::SerialStandard::Rs485);
        let wire = rs485.then(|| "wire=rs485".to_owned());
        let host = self.host_address(link, protocol).map(|host| format!("host={host}"));
        // An adapter needs the bit rate; any other bus has it.
        let rate = self.wires[link].baud;
        let reported = location.starts_with("slcan") && rate != protocol.baud;
        let bit_rate = reported.then(|| format!("bitrate={rate}"));
        // Drives that keep to a rate are reached at it only.
        let is_set = protocol.rates.contains(&rate) && rate != protocol.baud;
        let port_rate = if is_set && location.starts_with("serial") {
            format!(":{rate}")
        } else {
            String::new()
        };
        // No reply distinguishes a drive of a user's profile from another one.
        let drives: Vec<&RackDrive> = own.chain(behind).collect();
        let mut profiles: Vec<_> = drives.iter().map(|drive| drive.profile).collect();
        profiles.dedup_by_key(|profile| profile.name);
        let profile = match profiles[..] {
            [own] if is_own_profile(own) => Some(format!("profile={}", own.name)),
            _ => None,
        };
        let keys: Vec<String> =
            wire.into_iter().chain(bit_rate).chain(host).chain(profile).collect();
        let mark = if keys.is_empty() { "" } else { "?" };
        let addresses: Vec<String> =
            drives.iter().map(|drive| drive.address.unwrap_or(first).to_string()).collect();
        let (keys, addresses) = (keys.join("&"), addresses.join(","));
        let place = protocol.url_at(location);
        format!("{place}{port_rate}{mark}{keys}#{addresses}")
    }

    /// Has the drives of a link answer to a host that none of them can be mistaken for.
    pub(crate) fn assign_host(&mut self, link: usize) {
        for protocol in self.protocols_on(link) {
            let Some(host) = self.host_address(link, &protocol) else { continue };
            let drives = self.rack.links[link].drives.iter_mut();
            for drive in drives.filter(|drive| speaks_protocol(drive, &protocol)) {
                drive.extra.push(("host".to_owned(), host.to_string()));
            }
        }
    }

    /// Has every drive on a wire whose hosts have addresses answer to this one.
    pub(crate) fn set_host(&mut self, host: &str) {
        for link in 0..self.wires.len() {
            for protocol in
                self.protocols_on(link).iter().filter(|protocol| protocol.host.is_some())
            {
                let drives = self.rack.links[link].drives.iter_mut();
                for drive in drives.filter(|drive| speaks_protocol(drive, protocol)) {
                    drive.extra.push(("host".to_owned(), host.to_owned()));
                }
            }
        }
    }

    /// Sets another baud rate on every serial line, and another bit rate on every CAN bus; 0 removes the timing.
    pub(crate) fn set_rates(&mut self, baud: Option<u32>, bit_rate: Option<u32>) {
        for (link, wire) in self.rack.links.iter_mut().zip(&mut self.wires) {
            let new = match link.wire {
                RackWire::Serial(_) => baud,
                RackWire::Can(_) => bit_rate,
            };
            let Some(rate) = new else { continue };
            let before = std::mem::replace(&mut wire.baud, rate);
            match &mut link.wire {
                RackWire::Serial(serial) => {
                    match (before, rate) {
                        (_, 0) => serial.timing = Timing::Cdc,
                        (0, _) => serial.timing = Timing::Uart,
                        _ => {}
                    }
                    serial.baud = Some(rate).filter(|rate| *rate > 0);
                }
                RackWire::Can(line) => line.bit_rate = rate,
            }
        }
    }

    /// Lets drives whose protocol sets rates have the rate of their line themselves, so that they can change it.
    pub(crate) fn let_drives_set_rates(&mut self) {
        for (link, wire) in self.rack.links.iter_mut().zip(&self.wires) {
            let known = registry::find_protocol(wire.protocol, link.wire.medium());
            let RackWire::Serial(serial) = &mut link.wire else { continue };
            let Some(rate) = serial.baud.filter(|_| serial.timing != Timing::Tcp) else { continue };
            if known.is_some_and(|known| known.rates.contains(&rate)) {
                serial.baud = None;
                let option = ("baud".to_owned(), rate.to_string());
                link.drives.iter_mut().for_each(|drive| drive.extra.insert(0, option.clone()));
            }
        }
    }

    /// Sets these adapters before every serial line: a `timing` of racks, or `off` for a line without timing.
    pub(crate) fn set_timing(&mut self, word: &str) -> Result<(), Error> {
        let timing = if word == "off" { Ok(Timing::Cdc) } else { rack_file::parse_timing(word) };
        let timing = timing.map_err(|why| Error::usage("E210", format!("timing: {why}"), ""))?;
        for (link, wire) in self.rack.links.iter_mut().zip(&mut self.wires) {
            if let RackWire::Serial(serial) = &mut link.wire {
                rack_file::set_timing(serial, timing, wire.baud);
                wire.timed = true;
            }
        }
        Ok(())
    }

    /// Sets the standard of every serial line.
    pub(crate) fn set_standard(&mut self, standard: proto::SerialStandard) {
        for link in &mut self.rack.links {
            if let RackWire::Serial(serial) = &mut link.wire {
                serial.duplex = match standard {
                    proto::SerialStandard::Rs232 => Duplex::Full,
                    proto::SerialStandard::Rs485 => Duplex::Half,
                };
                link.drives.iter_mut().for_each(|drive| drive.standard = Some(standard));
            }
        }
    }

    fn set_faults(&self, world: &mut World, built: &BuiltRack) {
        for ((wire, _), spec) in built.links.iter().zip(&self.wires) {
            if let Some(faults) = world.serial_faults(*wire) {
                *faults = spec.faults;
            }
            if let Some(faults) = world.can_faults(*wire) {
                *faults = spec.can_faults;
            }
        }
    }

    /// Makes the host's adapter echo.
    pub(crate) fn set_echo(&mut self, echo: bool) {
        for link in &mut self.rack.links {
            if let RackWire::Serial(serial) = &mut link.wire {
                serial.echo = echo;
                serial.duplex = if echo { Duplex::Half } else { serial.duplex };
            }
        }
    }
}

fn has_relay(drives: &[RackDrive], link: usize) -> bool {
    drives.iter().any(|d| d.second_link == Some(link))
}

/// Returns whether a drive uses that protocol on the link that it is listed on.
pub(crate) fn speaks_protocol(drive: &RackDrive, protocol: &ProtocolInfo) -> bool {
    drive.wires.first().is_some_and(|word| word == protocol.name)
}

/// A running simulation in this process. Clones are the same one. Its links may be used from
/// different threads; time is one for all.
#[derive(Clone, Debug)]
pub struct Simulation {
    shared: Arc<SharedWorld>,
    built: Arc<BuiltRack>,
    description: Arc<RackDescription>,
}

impl Simulation {
    /// Builds the drives and gives them power. Whatever is random comes from `seed`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E231` when a drive cannot be built as described.
    pub fn new(
        description: &RackDescription,
        seed: u64,
        pace: SimulationPace,
    ) -> Result<Self, Error> {
        let mut world = World::new(seed);
        let built = description.rack.build(&mut world);
        let built = built.map_err(|error| Error::usage("E231", error.to_string(), ""))?;
        description.set_faults(&mut world, &built);
        Ok(Self {
            shared: Arc::new(SharedWorld::new(world, pace)),
            built: Arc::new(built),
            description: Arc::new(description.clone()),
        })
    }

    /// Number of links it has.
    #[must_use]
    pub fn links(&self) -> usize {
        self.built.links.len()
    }

    /// Description that it was built from.
    #[must_use]
    pub fn description(&self) -> &RackDescription {
        &self.description
    }

    /// The host's end of the link of that number, counted from 0. Open each link once.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` when there is no such link; [`Error::Link`] when the system has no
    /// descriptors left.
    pub fn open(&self, link: usize) -> Result<AnyLink, Error> {
        let (wire, _) = self.built.links.get(link).ok_or_else(|| {
            Error::usage("E212", format!("the rack has no link {link}"), "links count from 0")
        })?;
        let name = format!("sim:{}", self.description.rack.links[link].name);
        let end = sim_end::SimEnd::new(Arc::clone(&self.shared), *wire, &name)?;
        Ok(match self.description.rack.links[link].wire.medium() {
            MediumKind::Serial => AnyLink::Serial(Box::new(end)),
            MediumKind::Can => AnyLink::Can(Box::new(end)),
        })
    }

    /// Planned load of a CAN bus by its drives, and the share of the time so far in which it was busy, 0 to 1. `None`
    /// for a serial line and a bus without bit timing.
    ///
    /// ```
    /// use polepair::simulate::{SimulationPace, Simulation, rack_of_text};
    /// let rack = "[[link]]\nkind = 'can'\n[[link.drive]]\nprofile = 'thruster'\ncycle = 100";
    /// let simulation = Simulation::new(&rack_of_text("rack.toml", rack, 1)?, 1, SimulationPace::Virtual)?;
    /// let (planned, measured) = simulation.load(0).expect("a CAN bus");
    /// assert!(planned.least > 0.04 && planned.most < 0.06, "{planned}");
    /// assert_eq!(measured, 0.0);
    /// # Ok::<(), polepair::Error>(())
    /// ```
    #[must_use]
    pub fn load(&self, link: usize) -> Option<(BusLoadRange, f64)> {
        let (wire, _) = self.built.links.get(link)?;
        let RackWire::Can(line) = self.description.rack.links[link].wire else { return None };
        let timed = line.bit_rate > 0;
        timed.then(|| (self.description.wires[link].load, self.shared.load(*wire)))
    }

    /// The simulation's time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.shared.now()
    }

    /// Lets time pass: at once in virtual time, by sleeping in real time.
    pub fn advance(&self, span: Duration) {
        self.shared.advance(span);
    }

    /// Pace of its time.
    #[must_use]
    pub fn pace(&self) -> SimulationPace {
        self.shared.pace
    }

    /// Number of times faster than real motors these live, where their time passes by itself.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.shared.scale()
    }

    /// Sets the factor of time: a hundredth to a hundred. No effect in virtual time.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`.
    pub fn set_scale(&self, scale: f64) -> Result<(), Error> {
        if !TIME_SCALES.contains(&scale) {
            let what = format!("time cannot pass {scale} times as fast");
            return Err(Error::usage("E217", what, "it can from 0.01 to 100 times"));
        }
        self.shared.set_scale(scale);
        Ok(())
    }

    /// Display of a drive's own panel, where it has one.
    #[must_use]
    pub fn panel(&self, link: usize, drive: usize) -> Option<String> {
        let mut text = [0; PANEL_MAX];
        let len = self.shared.with_bench(
            self.built.links.get(link),
            drive,
            |bench: &mut dyn SurroundingsControl, now| bench.panel_text(now, &mut text),
        )??;
        Some(String::from_utf8_lossy(&text[..len.min(PANEL_MAX)]).into_owned())
    }

    /// Does something to a drive, or to its first motor, from outside: a load, a switch, a fault. Links and
    /// drives count from 0. Returns whether there is such a drive with such a thing.
    pub fn act(&self, link: usize, drive: usize, act: Act) -> bool {
        self.act_on_motor(SimulatedMotor { link, drive, motor: 0 }, act)
    }

    /// Executes an act on any of its motors.
    pub fn act_on_motor(&self, motor: SimulatedMotor, act: Act) -> bool {
        let wire = self.built.links.get(motor.link);
        self.shared
            .with_bench(wire, motor.drive, |bench, now| bench.act_on_motor(now, motor.motor, act))
            .unwrap_or(false)
    }

    /// True state of a drive's first motor, independent of the drive's reports.
    #[must_use]
    pub fn truth(&self, link: usize, drive: usize) -> Option<GroundTruth> {
        self.motor_truth(SimulatedMotor { link, drive, motor: 0 })
    }

    /// True state of any of its motors.
    #[must_use]
    pub fn motor_truth(&self, motor: SimulatedMotor) -> Option<GroundTruth> {
        let wire = self.built.links.get(motor.link);
        self.shared
            .with_bench(wire, motor.drive, |bench, now| bench.motor_truth(now, motor.motor))?
    }
}

/// Waits on the clock of a simulation or, without one, on the wall's.
pub(crate) fn sleep_on_clock(simulation: Option<&Simulation>, span: Duration) {
    match simulation {
        Some(simulation) => simulation.advance(span),
        None => clock::sleep_until(clock::now() + span),
    }
}
