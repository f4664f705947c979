//! Builds simulated drives on links from a description.
//!
//! The description is plain data, made by the crate that reads rack files. A family of drives is added in
//! `polepair_drives::visit_families`.

use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::proto;
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_drives::{self, DeviceOptions, Family};
use std::sync::Arc;

use crate::data_sheet::{self, DataSheet};
use crate::node::{CAN_PORT, DriveNode, SERIAL_PORT, ScheduledAct, ScheduledActs, SimNode};
use crate::profile_drive::ProfileDrive;
use crate::serial_line::{Duplex, SerialWireConfig};
use crate::world::{NodeId, WireId, World};

/// Links with drives on them.
#[derive(Clone, Debug, Default)]
pub struct RackSpec {
    /// The links, in order.
    pub links: Vec<RackLink>,
}

/// One link: a wire with its drives.
#[derive(Clone, Debug)]
pub struct RackLink {
    /// Name for users.
    pub name: String,
    /// Wire of the link.
    pub wire: RackWire,
    /// The drives on it.
    pub drives: Vec<RackDrive>,
}

/// Wire of a link.
#[derive(Clone, Copy, Debug)]
pub enum RackWire {
    /// Two or three conductors for bytes.
    Serial(SerialWireConfig),
    /// A CAN bus.
    Can(CanLine),
}

impl RackWire {
    /// Medium of the wire.
    #[must_use]
    pub const fn medium(&self) -> MediumKind {
        match self {
            Self::Serial(_) => MediumKind::Serial,
            Self::Can(_) => MediumKind::Can,
        }
    }

    /// The standard of a serial wire, which decides the receivers of each sender.
    #[must_use]
    pub const fn standard(&self) -> Option<proto::SerialStandard> {
        match self {
            Self::Serial(SerialWireConfig { duplex: Duplex::Half, .. }) => {
                Some(proto::SerialStandard::Rs485)
            }
            Self::Serial(SerialWireConfig { duplex: Duplex::Full, .. }) => {
                Some(proto::SerialStandard::Rs232)
            }
            Self::Can(_) => None,
        }
    }

    /// Bytes arrive at once: the wire has no baud rate.
    #[must_use]
    pub const fn is_untimed(&self) -> bool {
        matches!(self, Self::Serial(serial) if !serial.timing.has_byte_timing())
    }

    /// Lays the wire in `world`.
    pub fn add_to_world(&self, world: &mut World) -> WireId {
        match *self {
            Self::Serial(serial) => world.add_serial(serial),
            Self::Can(line) => world.add_can(line),
        }
    }
}

/// One simulated drive.
#[derive(Clone, Debug)]
pub struct RackDrive {
    /// Product of the drive.
    pub profile: &'static Profile,
    /// The protocol words of its wires, that of the link it is listed on first: `tmcl`,
    /// `modbus-rtu`.
    pub wires: Vec<String>,
    /// The standard of its serial wire, for families that differ by it.
    pub standard: Option<proto::SerialStandard>,
    /// The link of another medium that it is plugged into besides, by its place in the rack.
    pub second_link: Option<usize>,
    /// Address on the wire; the factory's if `None`.
    pub address: Option<u32>,
    /// Seed of whatever is random in the drive.
    pub seed: u64,
    /// Further keys of the family: `variant=position`.
    pub extra: Vec<(String, String)>,
    /// Data sheet of the drive, where one describes it.
    pub data_sheet: Option<Arc<DataSheet>>,
    /// Acts before power is given: its load, its switches.
    pub acts: Vec<(u8, Act)>,
    /// Acts at later times.
    pub scheduled_acts: Vec<ScheduledAct>,
}

/// Places of the parts of a rack in a world.
#[derive(Clone, Debug, Default)]
pub struct BuiltRack {
    /// A wire for each link, with a node for each drive: first those listed on the link, then those
    /// of other links that are plugged into it besides.
    pub links: Vec<(WireId, Vec<NodeId>)>,
}

/// Reason why a rack cannot be built.
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
    /// The drive is to be on two links, and the second is none that it can be plugged into.
    NoSecondLink {
        /// The profile's name.
        profile: &'static str,
    },
    /// The drive has no connector for such a wire.
    Wire {
        /// The profile's name.
        profile: &'static str,
        /// Medium of the wire.
        medium: MediumKind,
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
                write!(
                    f,
                    "{profile}: no simulated drive of this kind; of own profiles, those of Modbus are \
                     simulated, and those that extend a simulated one"
                )
            }
            Self::Option { profile, option } => write!(f, "{profile}: unknown option: {option}"),
            Self::NoSecondLink { profile } => {
                write!(f, "{profile}: its second link must be one of the rack's, of another kind")
            }
            Self::Wire { profile, medium: MediumKind::Serial } => {
                write!(f, "{profile}: this drive has no serial connector")
            }
            Self::Wire { profile, medium: MediumKind::Can } => {
                write!(f, "{profile}: this drive has no CAN connector")
            }
            Self::Act { profile } => write!(f, "{profile}: it has nothing for one of its acts"),
        }
    }
}

impl std::error::Error for RackError {}

impl RackSpec {
    /// Builds the rack into `world`.
    ///
    /// # Errors
    /// [`RackError`] names the drive; the world may then hold a part of the rack.
    pub fn build(&self, world: &mut World) -> Result<BuiltRack, RackError> {
        let mut built = BuiltRack::default();
        for link in &self.links {
            built
                .links
                .push((link.wire.add_to_world(world), Vec::with_capacity(link.drives.len())));
        }
        let mut second = Vec::new();
        for (at, link) in self.links.iter().enumerate() {
            let wire = built.links[at].0;
            for spec in &link.drives {
                let other = spec.find_second_link(self, link.wire.medium())?;
                let untimed = link.wire.is_untimed() || other.is_some_and(|n| n.1.is_untimed());
                let node = spec.build(world, wire, untimed)?;
                built.links[at].1.push(node);
                if let Some((n, wire)) = other {
                    spec.plug_into(world, built.links[n].0, wire.medium(), node)?;
                    second.push((n, node));
                }
            }
        }
        second.into_iter().for_each(|(n, node)| built.links[n].1.push(node));
        Ok(built)
    }
}

impl RackDrive {
    /// A drive as from the factory.
    #[must_use]
    pub fn new(profile: &'static Profile, wire: &str) -> Self {
        let (wires, address) = (vec![wire.to_owned()], None);
        let (extra, acts, scheduled_acts) = (Vec::new(), Vec::new(), Vec::new());
        let (standard, second_link, data_sheet) = (None, None, None);
        Self {
            profile,
            wires,
            standard,
            second_link,
            address,
            seed: 0,
            extra,
            data_sheet,
            acts,
            scheduled_acts,
        }
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
        let device = self.device(untimed)?;
        self.check_scheduled_acts()?;
        let node = world.add_node(match &self.scheduled_acts[..] {
            [] => device,
            acts => Box::new(ScheduledActs::new(device, acts.to_vec())),
        });
        world.with_node(node, |node, now| self.apply_acts(node, now))?;
        self.plug_into(world, wire, world.medium(wire), node)?;
        Ok(node)
    }

    /// Checks that the drive supports its scheduled acts, by trying them on another one.
    fn check_scheduled_acts(&self) -> Result<(), RackError> {
        if self.scheduled_acts.is_empty() {
            return Ok(());
        }
        let mut device = self.device(true)?;
        let mut has = |scheduled: &ScheduledAct| {
            let bench = device.surroundings();
            bench.is_some_and(|it| it.act_on_motor(Instant::ZERO, scheduled.motor, scheduled.act))
        };
        if self.scheduled_acts.iter().all(&mut has) {
            Ok(())
        } else {
            Err(RackError::Act { profile: self.profile.name })
        }
    }

    /// The drive, on no wire.
    ///
    /// # Errors
    /// [`RackError`].
    pub fn device(&self, untimed: bool) -> Result<Box<dyn SimNode>, RackError> {
        if let Some(sheet) = &self.data_sheet {
            return self.sheet_device(sheet);
        }
        let extra: Vec<_> = self.extra.iter().map(|(k, v)| (&**k, &**v)).collect();
        let wires: Vec<&str> = self.wires.iter().map(String::as_str).collect();
        let options = DeviceOptions {
            address: self.address,
            wires: &wires,
            standard: self.standard,
            untimed,
            seed: self.seed,
            extra: &extra,
        };
        let mut maker = RackDeviceBuilder { profile: self.profile, options, built: None };
        polepair_drives::visit_families(&mut maker);
        maker.built.unwrap_or_else(|| self.profile_device(&options))
    }

    /// The drive of a user's profile.
    fn profile_device(&self, options: &DeviceOptions<'_>) -> Result<Box<dyn SimNode>, RackError> {
        if self.profile.protocol != ProfileDrive::PROTOCOL {
            return Err(RackError::NoSuchDrive { profile: self.profile.name });
        }
        match ProfileDrive::new(self.profile, options) {
            Ok(device) => Ok(Box::new(DriveNode(device))),
            Err(option) => Err(self.option_error(option)),
        }
    }

    /// The device of a data sheet, which knows of the options the serial number and, to be given a
    /// node-ID by LSS, `node=none`.
    fn sheet_device(&self, sheet: &Arc<DataSheet>) -> Result<Box<dyn SimNode>, RackError> {
        let address = self.address.unwrap_or(1);
        let mut node = u8::try_from(address).map_err(|_| self.option_error("address"))?;
        let mut serial = address;
        for (key, value) in &self.extra {
            match (key.as_str(), value.as_str()) {
                ("serial", number) => {
                    serial = number.parse().map_err(|_| self.option_error(number))?
                }
                ("node", "none") => node = u8::MAX,
                ("host", _) => {}
                ("node", other) | (other, _) => return Err(self.option_error(other)),
            }
        }
        Ok(Box::new(DriveNode(data_sheet::DataSheetDevice::new(Arc::clone(sheet), node, serial))))
    }

    fn option_error(&self, option: &str) -> RackError {
        RackError::Option { profile: self.profile.name, option: option.to_owned() }
    }

    /// Executes the acts of the description on the drive before power is given.
    ///
    /// # Errors
    /// [`RackError::Act`].
    pub fn apply_acts(&self, node: &mut dyn SimNode, now: Instant) -> Result<(), RackError> {
        let mut done = |(motor, act): &(u8, Act)| {
            node.surroundings().is_some_and(|bench| bench.act_on_motor(now, *motor, *act))
        };
        if self.acts.iter().all(&mut done) {
            Ok(())
        } else {
            Err(RackError::Act { profile: self.profile.name })
        }
    }

    fn find_second_link<'a>(
        &self,
        rack: &'a RackSpec,
        medium: MediumKind,
    ) -> Result<Option<(usize, &'a RackWire)>, RackError> {
        let Some(at) = self.second_link else { return Ok(None) };
        let other = rack.links.get(at).map(|link| &link.wire);
        let other = other.filter(|wire| wire.medium() != medium);
        let profile = self.profile.name;
        other.map(|wire| Some((at, wire))).ok_or(RackError::NoSecondLink { profile })
    }

    fn plug_into(
        &self,
        world: &mut World,
        wire: WireId,
        medium: MediumKind,
        node: NodeId,
    ) -> Result<(), RackError> {
        let port = match medium {
            MediumKind::Serial => SERIAL_PORT,
            MediumKind::Can => CAN_PORT,
        };
        let fits = world.inspect(node, |node, _| match medium {
            MediumKind::Serial => node.stream(port).is_some(),
            MediumKind::Can => node.can(port).is_some(),
        });
        if !fits {
            return Err(RackError::Wire { profile: self.profile.name, medium });
        }
        world.plug_drive(wire, node, port);
        Ok(())
    }
}

/// Visits the families until one has the profile's.
struct RackDeviceBuilder<'a> {
    profile: &'static Profile,
    options: DeviceOptions<'a>,
    built: Option<Result<Box<dyn SimNode>, RackError>>,
}

impl polepair_drives::FamilyVisitor for RackDeviceBuilder<'_> {
    fn visit_family<F: Family>(&mut self) {
        if F::NAME != self.profile.family || self.built.is_some() {
            return;
        }
        let profile = self.profile.name;
        let device = F::create_device(self.profile, &self.options);
        self.built = Some(match device {
            Ok(device) => Ok(Box::new(DriveNode(device))),
            Err(option) => Err(RackError::Option { profile, option: option.to_owned() }),
        });
    }
}
