//! An object with ports: what a world holds.
//!
//! Only here and in `link` does anybody know that one object may sit on several wires. A protocol's
//! end, a host or a drive is a [`Station`] on one medium; a node lends the world one station for
//! each of its ports.

use polepair_core::axis::Axes;
use polepair_core::drives::bench::Bench;
use polepair_core::medium::{Can, Stream};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;

/// What a world holds: an object with ports.
pub trait Node: Timed + Send {
    /// The station behind a serial port, counted from 0.
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        let _ = port;
        None
    }
    /// The station behind a CAN port, counted from 0.
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        let _ = port;
        None
    }
    /// The axes, if this is a host lane.
    fn axes(&mut self) -> Option<&mut dyn Axes> {
        None
    }
    /// The bench side, if this is a simulated drive.
    fn bench(&mut self) -> Option<&mut dyn Bench> {
        None
    }
}

/// A simulated drive with one serial port.
#[derive(Debug)]
pub struct Drive<D>(pub D);

/// A host lane on a serial port.
#[derive(Debug)]
pub struct HostLane<L>(pub L);

/// Any single station on a serial port: a bare host, a probe, a babbler.
#[derive(Debug)]
pub struct Lone<S>(pub S);

/// Any single station on a CAN bus.
#[derive(Debug)]
pub struct LoneCan<S>(pub S);

macro_rules! timed {
    ($($wrapper:ident),*) => {$(
        impl<T: Timed> Timed for $wrapper<T> {
            fn handle_timeout(&mut self, now: Instant) {
                self.0.handle_timeout(now);
            }
            fn poll_timeout(&self) -> Option<Instant> {
                self.0.poll_timeout()
            }
        }
    )*};
}
timed!(Drive, HostLane, Lone, LoneCan);

impl<D: Station<Stream> + Bench + Send> Node for Drive<D> {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        (port == 0).then_some(&mut self.0 as _)
    }
    fn bench(&mut self) -> Option<&mut dyn Bench> {
        Some(&mut self.0)
    }
}

impl<L: Station<Stream> + Axes + Send> Node for HostLane<L> {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        (port == 0).then_some(&mut self.0 as _)
    }
    fn axes(&mut self) -> Option<&mut dyn Axes> {
        Some(&mut self.0)
    }
}

impl<S: Station<Stream> + Send> Node for Lone<S> {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        (port == 0).then_some(&mut self.0 as _)
    }
}

impl<S: Station<Can> + Send> Node for LoneCan<S> {
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        (port == 0).then_some(&mut self.0 as _)
    }
}
