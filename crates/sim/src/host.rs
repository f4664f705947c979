//! Host lanes as nodes, made from the registry of protocols.

use std::any::Any;

use polepair_core::axis::AnyLane;
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::mux::{BoxedLane, Mux};
use polepair_core::profile::Profile;
use polepair_core::proto::{self, HostOptions, Protocol};

use crate::node::{CanHostLane, HostLane, Node};

/// A protocol that has a host, as the registry shows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Spoken {
    /// The word in connection strings.
    pub name: &'static str,
    /// The word in profiles.
    pub profile: &'static str,
    /// The first address that a scan tries.
    pub first_address: u32,
    /// The wire it speaks on.
    pub medium: MediumKind,
    /// The baud or bit rate from the factory.
    pub baud: u32,
}

/// Every protocol with a host, in the order of the registry.
#[must_use]
pub fn protocols() -> Vec<Spoken> {
    let mut list = Lister(Vec::new());
    proto::visit(&mut list);
    list.0
}

/// A host of the protocol called `protocol` on that medium, with one axis per profile and address.
/// `None` when there is no such protocol.
#[must_use]
pub fn lane(
    protocol: &str,
    medium: MediumKind,
    options: HostOptions,
    axes: &[(&'static Profile, u32)],
) -> Option<Box<dyn Node>> {
    let mut maker = Maker { protocol, medium, options, axes, made: None };
    proto::visit(&mut maker);
    maker.made.and_then(node)
}

/// A lane of a program: the protocol's word, the host's settings, the axes.
pub type LaneOf<'a> = (&'a str, HostOptions, Vec<(&'static Profile, u32)>);

/// A program on a CAN bus: one lane for each protocol that it speaks, as one set of axes, those of
/// the first lane first. `None` when some protocol is unknown on CAN.
#[must_use]
pub fn mux(lanes: &[LaneOf<'_>]) -> Option<Box<dyn Node>> {
    let lane = |(protocol, options, axes): &LaneOf<'_>| {
        let mut maker =
            Maker { protocol, medium: MediumKind::Can, options: *options, axes, made: None };
        proto::visit(&mut maker);
        maker.made.and_then(|made| made.downcast::<BoxedLane>().ok()).map(|lane| *lane)
    };
    let lanes: Option<Vec<BoxedLane>> = lanes.iter().map(lane).collect();
    Some(Box::new(CanHostLane(Box::new(Mux::new(lanes?)?))))
}

struct Lister(Vec<Spoken>);

impl proto::Visitor for Lister {
    fn protocol<P: Protocol>(&mut self) {
        self.0.push(Spoken {
            name: P::NAME,
            profile: P::PROFILE,
            first_address: *P::ADDRESSES.start(),
            medium: P::Medium::KIND,
            baud: P::BAUD,
        });
    }
}

struct Maker<'a> {
    protocol: &'a str,
    medium: MediumKind,
    options: HostOptions,
    axes: &'a [(&'static Profile, u32)],
    made: Option<Box<dyn Any>>,
}

impl proto::Visitor for Maker<'_> {
    fn protocol<P: Protocol>(&mut self) {
        let meant = P::NAME == self.protocol && P::Medium::KIND == self.medium;
        if !meant || self.made.is_some() {
            return;
        }
        let addresses: Vec<u32> = self.axes.iter().map(|(_, address)| *address).collect();
        let drivers = self.axes.iter().map(|&(profile, address)| {
            let driver: polepair_core::lane::BoxedDriver<_, _> =
                Box::new(P::driver(profile, address));
            driver
        });
        let lane: Box<dyn AnyLane<P::Medium>> =
            Box::new(Lane::<P::Medium, P::Host>::new(P::host(&self.options, &addresses), drivers));
        self.made = Some(Box::new(lane));
    }
}

/// The lane's medium is known to the protocol only; here the two kinds of wire are told apart.
fn node(lane: Box<dyn Any>) -> Option<Box<dyn Node>> {
    let lane = match lane.downcast::<Box<dyn AnyLane<Stream>>>() {
        Ok(lane) => return Some(Box::new(HostLane(*lane))),
        Err(other) => other,
    };
    let lane = lane.downcast::<Box<dyn AnyLane<Can>>>().ok()?;
    Some(Box::new(CanHostLane(*lane)))
}
