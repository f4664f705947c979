//! Several simulated drives on several links, from a description.
//!
//! The description is plain data: the crate that reads rack files makes it, this module builds it.
//! Which drives there are is the registry's business: a family joins by being in `drives::visit`.

use polepair_core::drives::bench::Act;
use polepair_core::drives::{self, DeviceOptions, Family};
use polepair_core::profile::Profile;

use crate::node::{Drive, Node};
use crate::serial_line::Serial;
use crate::world::{NodeId, WireId, World};

/// Links with drives on them.
#[derive(Clone, Debug, Default)]
pub struct Rack {
    /// The links, in order.
    pub links: Vec<RackLink>,
}

/// One link: a serial wire with its drives.
#[derive(Clone, Debug)]
pub struct RackLink {
    /// What people call it.
    pub name: String,
    /// How the wire is built.
    pub serial: Serial,
    /// The drives on it.
    pub drives: Vec<RackDrive>,
}

/// One simulated drive.
#[derive(Clone, Debug)]
pub struct RackDrive {
    /// Which product.
    pub profile: &'static Profile,
    /// The protocol word of the wire: `tmcl`, `modbus-rtu`.
    pub wire: String,
    /// Address on the wire; the factory's if `None`.
    pub address: Option<u32>,
    /// Seed of whatever is random in the drive.
    pub seed: u64,
    /// What the family knows beyond these: `variant=position`.
    pub extra: Vec<(String, String)>,
    /// What is done to it before power is given: its load, its switches.
    pub acts: Vec<Act>,
}

/// Where the parts of a rack are in a world.
#[derive(Clone, Debug, Default)]
pub struct Built {
    /// A wire for each link, with a node for each drive.
    pub links: Vec<(WireId, Vec<NodeId>)>,
}

/// Why a rack cannot be built.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum RackError {
    /// No family in the registry simulates this profile.
    NoSuchDrive {
        /// The profile's name.
        profile: &'static str,
    },
    /// The family does not know an option, or its value.
    Option {
        /// The profile's name.
        profile: &'static str,
        /// The option or value.
        option: String,
    },
    /// The drive has no such thing as an act of the description is done to.
    Act {
        /// The profile's name.
        profile: &'static str,
    },
}

impl std::fmt::Display for RackError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoSuchDrive { profile } => {
                write!(f, "{profile}: no simulated drive of this kind")
            }
            Self::Option { profile, option } => write!(f, "{profile}: unknown option: {option}"),
            Self::Act { profile } => write!(f, "{profile}: it has no such load, switch or input"),
        }
    }
}

impl std::error::Error for RackError {}

impl Rack {
    /// Builds the rack into `world`.
    ///
    /// # Errors
    /// [`RackError`] names the drive; the world may then hold a part of the rack.
    pub fn build(&self, world: &mut World) -> Result<Built, RackError> {
        let mut built = Built::default();
        for link in &self.links {
            let wire = world.serial(link.serial);
            let mut nodes = Vec::with_capacity(link.drives.len());
            for spec in &link.drives {
                nodes.push(spec.build(world, wire, !link.serial.timed)?);
            }
            built.links.push((wire, nodes));
        }
        Ok(built)
    }
}

impl RackDrive {
    /// A drive as from the factory.
    #[must_use]
    pub fn new(profile: &'static Profile, wire: &str) -> Self {
        let (wire, address) = (wire.to_owned(), None);
        Self { profile, wire, address, seed: 0, extra: Vec::new(), acts: Vec::new() }
    }

    /// Puts the drive on a wire of `world`.
    ///
    /// # Errors
    /// [`RackError`].
    pub fn build(
        &self,
        world: &mut World,
        wire: WireId,
        untimed: bool,
    ) -> Result<NodeId, RackError> {
        let profile = self.profile.name;
        let node = world.add(self.device(untimed)?);
        for &act in &self.acts {
            let done = world.with(node, |n, now| n.bench().is_some_and(|b| b.act(now, act)));
            if !done {
                return Err(RackError::Act { profile });
            }
        }
        world.plug_drive(wire, node, 0);
        Ok(node)
    }

    /// The drive, on no wire.
    ///
    /// # Errors
    /// [`RackError`].
    pub fn device(&self, untimed: bool) -> Result<Box<dyn Node>, RackError> {
        let extra: Vec<_> = self.extra.iter().map(|(k, v)| (&**k, &**v)).collect();
        let options = DeviceOptions {
            address: self.address,
            wire: &self.wire,
            untimed,
            seed: self.seed,
            extra: &extra,
        };
        let mut maker = Maker { profile: self.profile, options, made: None };
        drives::visit(&mut maker);
        maker.made.unwrap_or(Err(RackError::NoSuchDrive { profile: self.profile.name }))
    }
}

/// Visits the families until one has the profile's.
struct Maker<'a> {
    profile: &'static Profile,
    options: DeviceOptions<'a>,
    made: Option<Result<Box<dyn Node>, RackError>>,
}

impl drives::Visitor for Maker<'_> {
    fn family<F: Family>(&mut self) {
        if F::NAME != self.profile.family || self.made.is_some() {
            return;
        }
        let profile = self.profile.name;
        let device = F::device(self.profile, &self.options);
        self.made = Some(match device {
            Ok(device) => Ok(Box::new(Drive(device))),
            Err(option) => Err(RackError::Option { profile, option: option.to_owned() }),
        });
    }
}
