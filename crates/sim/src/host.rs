//! Host lanes as nodes, made from the registry of protocols.

use std::any::Any;

use polepair_core::axis::AnyLane;
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::mux::{BoxedLane, Mux};
use polepair_core::profile::Profile;
use polepair_core::proto::{self, HostOptions, Protocol};

use crate::node::{CanHostLane, HostLane, SimNode};

/// A protocol that has a host, as the registry shows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostProtocol {
    /// The word in connection strings.
    pub name: &'static str,
    /// The word in profiles.
    pub profile: &'static str,
    /// The first address that a scan tries.
    pub first_address: u32,
    /// Kind of the wire.
    pub medium: MediumKind,
    /// The baud or bit rate from the factory.
    pub baud: u32,
    /// True if it is spoken on TCP alone, which keeps all bytes: its frames have no check sum.
    pub is_on_network: bool,
}

/// Every protocol with a host, in the order of the registry.
#[must_use]
pub fn protocols() -> Vec<HostProtocol> {
    let mut list = HostProtocolLister(Vec::new());
    proto::visit_protocols(&mut list);
    list.0
}

/// A host of the protocol called `protocol` on that medium, with one axis per profile and address.
/// `None` when there is no such protocol.
#[must_use]
pub fn host_lane(
    protocol: &str,
    medium: MediumKind,
    options: HostOptions,
    axes: &[(&'static Profile, u32)],
) -> Option<Box<dyn SimNode>> {
    let mut maker = HostLaneBuilder { protocol, medium, options, axes, built: None };
    proto::visit_protocols(&mut maker);
    maker.built.and_then(lane_node)
}

/// A lane of a program: the protocol's word, the host's settings, the axes.
pub type LaneSpec<'a> = (&'a str, HostOptions, Vec<(&'static Profile, u32)>);

/// A program on a CAN bus: one lane for each of its protocols, as one set of axes, those of the first lane first.
/// `None` for a protocol that is unknown on CAN.
#[must_use]
pub fn can_program(lanes: &[LaneSpec<'_>]) -> Option<Box<dyn SimNode>> {
    let lanes: Option<Vec<BoxedLane>> = lanes
        .iter()
        .map(|(protocol, options, axes)| {
            let mut maker = HostLaneBuilder {
                protocol,
                medium: MediumKind::Can,
                options: *options,
                axes,
                built: None,
            };
            proto::visit_protocols(&mut maker);
            maker.built.and_then(|made| made.downcast::<BoxedLane>().ok()).map(|lane| *lane)
        })
        .collect();
    Some(Box::new(CanHostLane(Box::new(Mux::new(lanes?)?))))
}

struct HostProtocolLister(Vec<HostProtocol>);

impl proto::ProtocolVisitor for HostProtocolLister {
    fn visit_protocol<P: Protocol>(&mut self) {
        self.0.push(HostProtocol {
            name: P::NAME,
            profile: P::PROFILE_PROTOCOL,
            first_address: *P::SCAN_ADDRESSES.start(),
            medium: P::Medium::KIND,
            baud: P::DEFAULT_RATE,
            is_on_network: P::NETWORK_PORT.is_some(),
        });
    }
}

struct HostLaneBuilder<'a> {
    protocol: &'a str,
    medium: MediumKind,
    options: HostOptions,
    axes: &'a [(&'static Profile, u32)],
    built: Option<Box<dyn Any>>,
}

impl proto::ProtocolVisitor for HostLaneBuilder<'_> {
    fn visit_protocol<P: Protocol>(&mut self) {
        let matches = P::NAME == self.protocol && P::Medium::KIND == self.medium;
        if !matches || self.built.is_some() {
            return;
        }
        let addresses: Vec<u32> = self.axes.iter().map(|(_, address)| *address).collect();
        let drivers = self.axes.iter().map(|&(profile, address)| {
            let driver: polepair_core::lane::BoxedDriver<_, _> =
                Box::new(P::create_driver(profile, address));
            driver
        });
        let lane: Box<dyn AnyLane<P::Medium>> = Box::new(Lane::<P::Medium, P::Host>::new(
            P::create_host(&self.options, &addresses),
            drivers,
        ));
        self.built = Some(Box::new(lane));
    }
}

/// Node of a lane. Only the protocol knows the medium of its lane; here the two kinds of wire are distinguished.
fn lane_node(lane: Box<dyn Any>) -> Option<Box<dyn SimNode>> {
    let lane = match lane.downcast::<Box<dyn AnyLane<Stream>>>() {
        Ok(lane) => return Some(Box::new(HostLane(*lane))),
        Err(other) => other,
    };
    let lane = lane.downcast::<Box<dyn AnyLane<Can>>>().ok()?;
    Some(Box::new(CanHostLane(*lane)))
}
