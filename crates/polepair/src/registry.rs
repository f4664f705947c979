//! The core's lists of protocols and families, asked by word and medium.

use crate::bus::{self, Seat};
use crate::error::Error;
use crate::url::Number;
use polepair_core::axis::AnyLane;
use polepair_core::lane::{BoxedDriver, Lane};
use polepair_core::medium::{CanLine, Frame, Medium, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::proto::{self, GROUP, HostOptions, Protocol};
use polepair_core::station::Host;
use polepair_sim::rack::RackWire;
use polepair_sim::serial_line::Serial;
use std::any::Any;
use std::ops::RangeInclusive;

/// A protocol on its medium, as the registry shows it.
#[derive(Clone, Debug)]
pub(crate) struct Spoken {
    /// The word in connection strings.
    pub(crate) name: &'static str,
    /// The wire it speaks on.
    pub(crate) medium: MediumKind,
    /// The word in profiles.
    pub(crate) profile: &'static str,
    /// Addresses that a scan tries.
    pub(crate) addresses: RangeInclusive<u32>,
    /// Every address that a drive can have.
    pub(crate) every: RangeInclusive<u32>,
    /// It speaks differently on RS-232 and on RS-485.
    pub(crate) standards: bool,
    /// Groups of drives that can be told something at once, by number from 1.
    pub(crate) groups: u8,
    /// The address that means everybody.
    pub(crate) everybody: Option<u32>,
    /// The host's own address, which no axis can have.
    pub(crate) host: Option<u32>,
    /// The baud or bit rate from the factory.
    pub(crate) baud: u32,
    /// What an axis is called when nothing else is known.
    pub(crate) generic: &'static Profile,
    /// On CAN, whether what has that address has this identifier, of 29 bits or not.
    pub(crate) uses: fn(u32, u32, bool) -> bool,
    /// Why no drive may have that address.
    forbids: fn(u32) -> Option<&'static str>,
}

impl Spoken {
    /// The host's address where one of these drives has the one that hosts have from the factory:
    /// the last that nobody has. `None` where the usual one will do.
    pub(crate) fn other_host(&self, drives: &[u32]) -> Option<u32> {
        let usual = self.host?;
        let free = || self.every.clone().rev().find(|address| !drives.contains(address));
        drives.contains(&usual).then(free)?
    }

    /// The host's address on a bus that `others` share: the usual one, or the last that nobody has.
    pub(crate) fn host_beside(&self, drives: &[u32], others: &[Seat]) -> Option<u32> {
        let usual = self.host?;
        let seat = |address| Seat { spoken: self.clone(), address };
        let free = |address: &u32| {
            let meets = |other: &Seat| other.meets(&seat(*address)).is_some();
            !drives.contains(address) && !others.iter().any(meets)
        };
        if free(&usual) {
            return None;
        }
        // Better one that no drive of the others could have: their hosts hear those too.
        let claimed = bus::claimed(others);
        let quiet = |address: &u32| free(address) && !bus::claims(&claimed, self.uses, *address);
        let every = || self.every.clone().rev();
        every().find(quiet).or_else(|| every().find(free))
    }

    /// Refuses an address that no drive can have, and groups that the protocol has not.
    pub(crate) fn check(&self, address: u32) -> Result<(), Error> {
        if address & GROUP != 0 {
            return self.check_groups(address);
        }
        if let Some(why) = (self.forbids)(address) {
            return Err(Error::usage(
                "E212",
                format!("no drive can have the address {address}"),
                why,
            ));
        }
        if self.every.contains(&address) {
            return Ok(());
        }
        let (first, last) = (self.every.start(), self.every.end());
        let what = format!("no drive can have the address {address} on {}", self.name);
        Err(Error::usage("E212", what, format!("addresses are {first} to {last}")))
    }

    fn check_groups(&self, address: u32) -> Result<(), Error> {
        let last = 32 - (address & !GROUP).leading_zeros();
        if self.groups > 0 && last <= self.groups.into() {
            return Ok(());
        }
        let what = format!("`#{}`: {} has no such group", Number(address), self.name);
        let hint = match self.groups {
            0 => "this protocol has no groups: name each axis by its number".to_owned(),
            last => format!("groups are g1 to g{last}, several g1+2, all g*"),
        };
        Err(Error::usage("E212", what, hint))
    }

    /// The standard that a serial line follows by default, and how it is built: one drive alone is
    /// on RS-232 where that makes a difference.
    pub(crate) fn usual_wire(&self, drives: usize) -> RackWire {
        match self.medium {
            MediumKind::Can => RackWire::Can(CanLine { bit_rate: self.baud }),
            MediumKind::Serial if self.standards && drives == 1 => RackWire::Serial(Serial::RS232),
            MediumKind::Serial => RackWire::Serial(Serial::RS485),
        }
    }

    /// The word that means this protocol and no other of its name: `tmcl`, `tmcl+can`.
    pub(crate) fn word(&self) -> String {
        match self.medium {
            MediumKind::Can if protocol(self.name, MediumKind::Serial).is_some() => {
                format!("{}+can", self.name)
            }
            _ => self.name.to_owned(),
        }
    }
}

/// Every protocol with a host.
pub(crate) fn protocols() -> Vec<Spoken> {
    let mut list = Lister(Vec::new());
    proto::visit(&mut list);
    list.0
}

/// The words of connection strings.
pub(crate) fn names() -> Vec<&'static str> {
    let mut names: Vec<&str> = Vec::new();
    for protocol in protocols() {
        if !names.contains(&protocol.name) {
            names.push(protocol.name);
        }
    }
    names
}

/// The protocol of that word on that medium.
pub(crate) fn protocol(name: &str, medium: MediumKind) -> Option<Spoken> {
    protocols().into_iter().find(|protocol| protocol.name == name && protocol.medium == medium)
}

/// The protocol of that word where it means one: `tmcl` on its usual medium, `tmcl+can` on CAN.
pub(crate) fn by_word(word: &str) -> Option<Spoken> {
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
pub(crate) fn lane<M: Medium>(
    protocol: &str,
    options: HostOptions,
    axes: &[(&'static Profile, u32)],
) -> Option<Box<dyn AnyLane<M>>> {
    let mut maker = Maker { protocol, options, axes, made: None };
    proto::visit(&mut maker);
    maker.made
}

struct Lister(Vec<Spoken>);

impl proto::Visitor for Lister {
    fn protocol<P: Protocol>(&mut self) {
        self.0.push(Spoken {
            name: P::NAME,
            medium: P::Medium::KIND,
            profile: P::PROFILE,
            addresses: P::ADDRESSES,
            every: P::EVERY_ADDRESS,
            standards: P::STANDARDS,
            groups: P::GROUPS,
            everybody: P::EVERYBODY,
            host: P::HOST,
            baud: P::BAUD,
            generic: P::generic(),
            uses: P::uses,
            forbids: P::forbids,
        });
    }
}

struct Maker<'a, M: Medium> {
    protocol: &'a str,
    options: HostOptions,
    axes: &'a [(&'static Profile, u32)],
    made: Option<Box<dyn AnyLane<M>>>,
}

impl<M: Medium> proto::Visitor for Maker<'_, M> {
    fn protocol<P: Protocol>(&mut self) {
        if P::NAME != self.protocol || P::Medium::KIND != M::KIND || self.made.is_some() {
            return;
        }
        let addresses: Vec<u32> = self.axes.iter().map(|(_, address)| *address).collect();
        let drivers = self.axes.iter().map(|&(profile, address)| driver::<P>(profile, address));
        let host = P::host(&self.options, &addresses);
        let lane: Box<dyn AnyLane<P::Medium>> =
            Box::new(Lane::<P::Medium, P::Host>::new(host, drivers).growing(driver::<P>));
        // The media are the same, as was asked above; the compiler must be shown.
        let lane: Box<dyn Any> = Box::new(lane);
        self.made = lane.downcast::<Box<dyn AnyLane<M>>>().ok().map(|lane| *lane);
    }
}

type Asked<P> = <<P as Protocol>::Host as Host<<P as Protocol>::Medium>>::Request;
type Answered<P> = <<P as Protocol>::Host as Host<<P as Protocol>::Medium>>::Answer;

/// The driver of one axis.
fn driver<P: Protocol>(
    profile: &'static Profile,
    address: u32,
) -> BoxedDriver<Asked<P>, Answered<P>> {
    Box::new(P::driver(profile, address))
}

/// What a scan of a CAN bus can know of a protocol without a host.
pub(crate) struct Listener {
    /// The one question that every drive answers, if there is one.
    pub(crate) question: Option<Frame>,
    sender: fn(&HostOptions, &Frame) -> Option<u32>,
    options: HostOptions,
}

impl Listener {
    /// For the protocol of that word on CAN.
    pub(crate) fn new(protocol: &str, options: HostOptions) -> Self {
        let mut made = Self { question: None, sender: |_, _| None, options };
        proto::visit(&mut Hearer { protocol, made: &mut made });
        made
    }

    /// The address of the drive that sent a frame, where the frame tells it.
    pub(crate) fn sender(&self, frame: &Frame) -> Option<u32> {
        (self.sender)(&self.options, frame)
    }
}

struct Hearer<'a> {
    protocol: &'a str,
    made: &'a mut Listener,
}

impl proto::Visitor for Hearer<'_> {
    fn protocol<P: Protocol>(&mut self) {
        if P::NAME == self.protocol && P::Medium::KIND == MediumKind::Can {
            self.made.question = P::discover(&self.made.options);
            self.made.sender = P::sender;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{GROUP, MediumKind, by_word, protocol};

    #[test]
    fn hosts_give_way_to_drives() {
        let tmcl = protocol("tmcl", MediumKind::Serial).expect("known");
        assert_eq!(tmcl.other_host(&[1, 3]), None);
        assert_eq!(tmcl.other_host(&[1, 2]), Some(255));
        assert_eq!(tmcl.other_host(&[2, 255]), Some(254));
        let modbus = protocol("modbus-rtu", MediumKind::Serial).expect("known");
        assert_eq!(modbus.other_host(&[1, 2]), None);
        assert!(tmcl.check(255).is_ok() && tmcl.check(256).is_err());
        assert!(tmcl.check(GROUP | 1).is_err());
    }

    #[test]
    fn a_word_means_one_protocol() {
        for (word, medium) in [
            ("tmcl", MediumKind::Serial),
            ("tmcl+serial", MediumKind::Serial),
            ("tmcl+can", MediumKind::Can),
        ] {
            assert_eq!(by_word(word).expect(word).medium, medium);
        }
        assert_eq!(by_word("tmcl+can").expect("known").word(), "tmcl+can");
        assert!(by_word("modbus-rtu+can").is_none() && by_word("tmcl+udp").is_none());
    }
}
