//! The core's lists of protocols and families, asked by word.

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
    /// The host's own address, which no axis can have.
    pub(crate) host: Option<u32>,
    /// The baud rate from the factory.
    pub(crate) baud: u32,
    /// What an axis is called when nothing else is known.
    pub(crate) generic: &'static Profile,
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
        let drivers = self.axes.iter().map(|&(profile, address)| {
            let driver: BoxedDriver<_, _> = Box::new(P::driver(profile, address));
            driver
        });
        let lane = Lane::<P::Medium, P::Host>::new(P::host(&self.options), drivers);
        let lane: Box<dyn AnyLane<P::Medium>> = Box::new(lane);
        // The medium is a stream, as was asked above; the compiler must be shown.
        let lane: Box<dyn Any> = Box::new(lane);
        self.made = lane.downcast::<Box<dyn AnyLane<Stream>>>().ok().map(|lane| *lane);
    }
}
