//! The core's lists of protocols and families, asked by word.

use crate::error::Error;
use polepair_core::axis::AnyLane;
use polepair_core::lane::{BoxedDriver, Lane};
use polepair_core::medium::Stream;
use polepair_core::profile::Profile;
use polepair_core::proto::{self, HostOptions, Protocol};
use std::any::Any;
use std::ops::RangeInclusive;

/// A protocol on a byte stream, as the registry shows it.
#[derive(Clone, Debug)]
pub(crate) struct Spoken {
    /// The word in connection strings.
    pub(crate) name: &'static str,
    /// The word in profiles.
    pub(crate) profile: &'static str,
    /// Addresses that a scan tries.
    pub(crate) addresses: RangeInclusive<u32>,
    /// Every address that a drive can have.
    pub(crate) every: RangeInclusive<u32>,
    /// The host's own address, which no axis can have.
    pub(crate) host: Option<u32>,
    /// The baud rate from the factory.
    pub(crate) baud: u32,
    /// What an axis is called when nothing else is known.
    pub(crate) generic: &'static Profile,
}

impl Spoken {
    /// The host's address where one of these drives has the one that hosts have from the factory:
    /// the last that nobody has. `None` where the usual one will do.
    pub(crate) fn other_host(&self, drives: &[u32]) -> Option<u32> {
        let usual = self.host?;
        let free = || self.every.clone().rev().find(|address| !drives.contains(address));
        drives.contains(&usual).then(free)?
    }

    /// Refuses an address that no drive can have.
    pub(crate) fn check(&self, address: u32) -> Result<(), Error> {
        if self.every.contains(&address) {
            return Ok(());
        }
        let (first, last) = (self.every.start(), self.every.end());
        let what = format!("no drive can have the address {address} on {}", self.name);
        Err(Error::usage("E212", what, format!("addresses are {first} to {last}")))
    }
}

/// Every protocol with a host on byte streams.
pub(crate) fn protocols() -> Vec<Spoken> {
    let mut list = Lister(Vec::new());
    proto::visit(&mut list);
    list.0
}

/// The words of connection strings.
pub(crate) fn names() -> Vec<&'static str> {
    protocols().iter().map(|protocol| protocol.name).collect()
}

/// The protocol of that word.
pub(crate) fn protocol(name: &str) -> Option<Spoken> {
    protocols().into_iter().find(|protocol| protocol.name == name)
}

/// A host of a protocol with one axis for each profile and address.
pub(crate) fn lane(
    protocol: &str,
    options: HostOptions,
    axes: &[(&'static Profile, u32)],
) -> Option<Box<dyn AnyLane<Stream>>> {
    let mut maker = Maker { protocol, options, axes, made: None };
    proto::visit(&mut maker);
    maker.made
}

fn on_stream<P: Protocol>() -> bool {
    std::any::TypeId::of::<P::Medium>() == std::any::TypeId::of::<Stream>()
}

struct Lister(Vec<Spoken>);

impl proto::Visitor for Lister {
    fn protocol<P: Protocol>(&mut self) {
        if on_stream::<P>() {
            self.0.push(Spoken {
                name: P::NAME,
                profile: P::PROFILE,
                addresses: P::ADDRESSES,
                every: P::EVERY_ADDRESS,
                host: P::HOST,
                baud: P::BAUD,
                generic: P::generic(),
            });
        }
    }
}

struct Maker<'a> {
    protocol: &'a str,
    options: HostOptions,
    axes: &'a [(&'static Profile, u32)],
    made: Option<Box<dyn AnyLane<Stream>>>,
}

impl proto::Visitor for Maker<'_> {
    fn protocol<P: Protocol>(&mut self) {
        if P::NAME != self.protocol || !on_stream::<P>() || self.made.is_some() {
            return;
        }
        let addresses: Vec<u32> = self.axes.iter().map(|(_, address)| *address).collect();
        let drivers = self.axes.iter().map(|&(profile, address)| {
            let driver: BoxedDriver<_, _> = Box::new(P::driver(profile, address));
            driver
        });
        let lane = Lane::<P::Medium, P::Host>::new(P::host(&self.options, &addresses), drivers);
        let lane: Box<dyn AnyLane<P::Medium>> = Box::new(lane);
        // The medium is a stream, as was asked above; the compiler must be shown.
        let lane: Box<dyn Any> = Box::new(lane);
        self.made = lane.downcast::<Box<dyn AnyLane<Stream>>>().ok().map(|lane| *lane);
    }
}

#[cfg(test)]
mod tests {
    use super::protocol;

    #[test]
    fn hosts_give_way_to_drives() {
        let tmcl = protocol("tmcl").expect("known");
        assert_eq!(tmcl.other_host(&[1, 3]), None);
        assert_eq!(tmcl.other_host(&[1, 2]), Some(255));
        assert_eq!(tmcl.other_host(&[2, 255]), Some(254));
        assert_eq!(protocol("modbus-rtu").expect("known").other_host(&[1, 2]), None);
        assert!(tmcl.check(255).is_ok() && tmcl.check(256).is_err());
    }
}
