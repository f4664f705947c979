//! Simulated drives: racks of them from words or from a file, in this process or on real wires.
//!
//! ```
//! use polepair::simulate::{self, Pace};
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let rack = simulate::rack_of_words(&["tmcl:1,2"], 7)?;
//! let simulation = simulate::Simulation::new(&rack, 7, Pace::Virtual)?;
//! assert_eq!(simulation.links(), 1);
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod end;
mod file;
mod line;

use crate::error::Error;
use crate::registry;
use crate::words;
use end::Shared;
pub use file::{rack_of_file, rack_of_text};
pub use line::{DriveLine, FaultyLine};
use polepair_core::drives::bench::{Act, Truth};
use polepair_core::medium::Stream;
use polepair_core::profile::Profile;
use polepair_core::time::Instant;
use polepair_link::Link;
use polepair_sim::fault::Faults;
use polepair_sim::rack::{Built, Rack, RackDrive, RackLink, RackWire};
use polepair_sim::serial_line::{Duplex, Serial};
use polepair_sim::world::World;
use std::sync::Arc;
use std::time::Duration;

/// Drives on one simulated link at most.
const DRIVES_MAX: usize = 64;

/// How a simulation's time passes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Pace {
    /// As fast as the processor goes: a wait is over at once.
    Virtual,
    /// As fast as real motors.
    Real,
}

/// Links with drives on them, and what the core's description does not hold.
#[derive(Clone, Debug, Default)]
pub struct Description {
    /// The links and drives.
    pub rack: Rack,
    /// For each link, the protocol's word in connection strings, faults of the wire and baud rate.
    pub wires: Vec<Wire>,
}

/// One link of a [`Description`], beside what its rack says.
#[derive(Clone, Debug)]
pub struct Wire {
    /// The protocol's word in connection strings.
    pub protocol: &'static str,
    /// What goes wrong on it.
    pub faults: Faults,
    /// Bits per second; 0 on a wire without timing.
    pub baud: u32,
    /// What each drive is called; empty for no name.
    pub names: Vec<String>,
}

/// A rack from words such as `tmcl`, `tmcl:1,2` or `tmcm-171:3`: each word is a link.
///
/// # Errors
/// [`Error::Usage`] `E203` for a word that is neither protocol, family nor product.
pub fn rack_of_words(words: &[&str], seed: u64) -> Result<Description, Error> {
    let mut description = Description::default();
    for (n, word) in words.iter().enumerate() {
        let (name, addresses) = word.split_once(':').unwrap_or((word, ""));
        let (profile, protocol) = drive_of(name)?;
        let mut drives = Vec::new();
        for text in addresses.split(',').filter(|_| !addresses.is_empty()) {
            let address = address_of(text, word)?;
            protocol.check(address)?;
            drives.push(Some(address));
        }
        if drives.is_empty() {
            drives.push(None);
        }
        let seed = seed.wrapping_add(n as u64 * 1000);
        description.add(word, profile, protocol, &drives, seed);
    }
    Ok(description)
}

fn address_of(text: &str, word: &str) -> Result<u32, Error> {
    let address = crate::file::number(text.trim()).and_then(|n| u32::try_from(n).ok());
    address.ok_or_else(|| {
        let what = format!("`{word}`: `{text}` is no address");
        Error::usage("E217", what, "write `tmcl:1,2` for drives at the addresses 1 and 2")
    })
}

/// The product meant by a protocol's, family's or product's word, and the protocol of its wire.
pub(crate) fn drive_of(word: &str) -> Result<(&'static Profile, registry::Spoken), Error> {
    let profiles = polepair_core::drives::profiles();
    let spoken = registry::protocols();
    for protocol in &spoken {
        let speaks = |p: &&&'static Profile| p.protocol == protocol.profile;
        if let Some(profile) = profiles.iter().filter(speaks).find(|_| protocol.name == word) {
            return Ok((profile, protocol.clone()));
        }
    }
    let named = profiles.iter().find(|p| p.name == word);
    let named = named.or_else(|| profiles.iter().find(|p| p.family == word));
    let found = named.and_then(|profile| {
        let protocol = spoken.iter().find(|protocol| protocol.profile == profile.protocol)?;
        Some((*profile, protocol.clone()))
    });
    found.ok_or_else(|| {
        let known: Vec<&str> =
            spoken.iter().map(|p| p.name).chain(profiles.iter().map(|p| p.name)).collect();
        let near = words::hint(word, known.iter().copied());
        let what = format!("nothing called `{word}` can be simulated{near}");
        Error::usage("E203", what, format!("it can be {}", known.join(", ")))
    })
}

impl Description {
    /// Whether bytes arrive on that link as they were sent.
    #[must_use]
    pub fn is_faultless(&self, link: usize) -> bool {
        let echo =
            matches!(self.rack.links[link].wire, RackWire::Serial(Serial { echo: true, .. }));
        self.wires[link].faults == Faults::NONE && !echo
    }

    fn add(
        &mut self,
        name: &str,
        profile: &'static Profile,
        protocol: registry::Spoken,
        addresses: &[Option<u32>],
        seed: u64,
    ) {
        let drive = |(n, address): (usize, &Option<u32>)| {
            let mut drive = RackDrive::new(profile, protocol.name);
            drive.address = *address;
            drive.seed = seed.wrapping_add(n as u64);
            drive
        };
        let drives: Vec<_> = addresses.iter().enumerate().map(drive).collect();
        self.wires.push(Wire {
            protocol: protocol.name,
            faults: Faults::NONE,
            baud: protocol.baud,
            names: vec![String::new(); drives.len()],
        });
        let wire = RackWire::Serial(Serial::RS485);
        self.rack.links.push(RackLink { name: name.to_owned(), wire, drives });
        self.settle_host(self.wires.len() - 1);
    }

    /// The address that drives of a link answer to, where one of them has the one that hosts have
    /// from the factory.
    #[must_use]
    pub fn host(&self, link: usize) -> Option<u32> {
        let spoken = registry::protocol(self.wires[link].protocol)?;
        let first = *spoken.addresses.start();
        let drives = &self.rack.links[link].drives;
        let addresses: Vec<u32> = drives.iter().map(|d| d.address.unwrap_or(first)).collect();
        spoken.other_host(&addresses)
    }

    /// Has the drives of a link answer to a host that none of them can be mistaken for.
    pub(crate) fn settle_host(&mut self, link: usize) {
        let Some(host) = self.host(link) else { return };
        for drive in &mut self.rack.links[link].drives {
            drive.extra.push(("host".to_owned(), host.to_string()));
        }
    }

    /// Has every drive on a wire whose hosts have addresses answer to this one.
    pub(crate) fn answer_to(&mut self, host: &str) {
        for (link, wire) in self.rack.links.iter_mut().zip(&self.wires) {
            if registry::protocol(wire.protocol).is_some_and(|spoken| spoken.host.is_some()) {
                for drive in &mut link.drives {
                    drive.extra.push(("host".to_owned(), host.to_owned()));
                }
            }
        }
    }

    /// The same with another baud rate everywhere; 0 takes byte timing away.
    pub(crate) fn set_baud(&mut self, baud: u32) {
        for (link, wire) in self.rack.links.iter_mut().zip(&mut self.wires) {
            if let RackWire::Serial(serial) = &mut link.wire {
                serial.timed = baud > 0;
                serial.baud = Some(baud).filter(|baud| *baud > 0);
                wire.baud = baud;
            }
        }
    }

    /// Makes the host's adapter hear itself.
    pub(crate) fn set_echo(&mut self, echo: bool) {
        for link in &mut self.rack.links {
            if let RackWire::Serial(serial) = &mut link.wire {
                serial.echo = echo;
                serial.duplex = if echo { Duplex::Half } else { serial.duplex };
            }
        }
    }
}

/// A running simulation in this process. Clones are the same one. Its links may be used from
/// different threads; time is one for all.
#[derive(Clone, Debug)]
pub struct Simulation {
    shared: Arc<Shared>,
    built: Arc<Built>,
    description: Arc<Description>,
}

impl Simulation {
    /// Builds the drives and gives them power. Whatever is random comes from `seed`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E231` when a drive cannot be built as described.
    pub fn new(description: &Description, seed: u64, pace: Pace) -> Result<Self, Error> {
        let mut world = World::new(seed);
        let built = description.rack.build(&mut world);
        let built = built.map_err(|error| Error::usage("E231", error.to_string(), ""))?;
        for ((wire, _), spec) in built.links.iter().zip(&description.wires) {
            if let Some(faults) = world.faults(*wire) {
                *faults = spec.faults;
            }
        }
        Ok(Self {
            shared: Arc::new(Shared::new(world, pace)),
            built: Arc::new(built),
            description: Arc::new(description.clone()),
        })
    }

    /// How many links it has.
    #[must_use]
    pub fn links(&self) -> usize {
        self.built.links.len()
    }

    /// What it was made from.
    #[must_use]
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The host's end of the link of that number, counted from 0. Open each link once.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` when there is no such link; [`Error::Link`] when the system has no
    /// descriptors left.
    pub fn open(&self, link: usize) -> Result<Box<dyn Link<Stream>>, Error> {
        let (wire, _) = self.built.links.get(link).ok_or_else(|| {
            Error::usage("E212", format!("the rack has no link {link}"), "links count from 0")
        })?;
        let name = format!("sim:{}", self.description.rack.links[link].name);
        Ok(Box::new(end::SimEnd::new(Arc::clone(&self.shared), *wire, &name)?))
    }

    /// The simulation's time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.shared.now()
    }

    /// Lets time pass: at once in virtual time, by sleeping in real time.
    pub fn pass(&self, span: Duration) {
        self.shared.pass(span);
    }

    /// Does something to a drive from outside: a load, a switch, a fault. Links and drives count
    /// from 0. Returns whether there is such a drive with such a thing.
    pub fn act(&self, link: usize, drive: usize, act: Act) -> bool {
        let done =
            self.shared.with(self.built.links.get(link), drive, |bench, now| bench.act(now, act));
        done.unwrap_or(false)
    }

    /// What is true of a motor, whatever its drive reports.
    #[must_use]
    pub fn truth(&self, link: usize, drive: usize) -> Option<Truth> {
        let wire = self.built.links.get(link);
        self.shared.with(wire, drive, |bench, now| bench.truth(now))
    }
}
