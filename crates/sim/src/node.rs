//! A node of a world: an object with ports.
//!
//! Only this module and `link` know that one object can be on several wires. A host or a drive is a
//! [`Station`] on one medium; a node has one station for each of its ports.

use polepair_core::axis::{AnyLane, Axes};
use polepair_core::medium::{Can, Stream};
use polepair_core::station::{Station, Timed};
use polepair_core::time::{Instant, earliest};
use polepair_drives::SimulatedDevice;
use polepair_drives::surroundings::{Act, SurroundingsControl};

/// A member of a world: an object with ports.
pub trait SimNode: Timed + Send {
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
    fn surroundings(&mut self) -> Option<&mut dyn SurroundingsControl> {
        None
    }
}

/// A simulated drive with a port for each of its ends: [`SERIAL_PORT`], [`CAN_PORT`].
#[derive(Debug)]
pub struct DriveNode<D>(pub D);

/// Port number of the serial end of a [`DriveNode`].
pub const SERIAL_PORT: u8 = 0;
/// Port number of the CAN end of a [`DriveNode`].
pub const CAN_PORT: u8 = 1;

/// A host lane on a serial port.
pub struct HostLane(pub Box<dyn AnyLane<Stream>>);

/// A host lane on a CAN port.
pub struct CanHostLane(pub Box<dyn AnyLane<Can>>);

/// Any single station on a serial port: a bare host, a probe, a babbler.
#[derive(Debug)]
pub struct SerialStationNode<S>(pub S);

/// Any single station on a CAN bus.
#[derive(Debug)]
pub struct CanStationNode<S>(pub S);

/// Something that is done to a drive at a certain time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ScheduledAct {
    /// Time.
    pub at: Instant,
    /// To which of its motors, from 0.
    pub motor: u8,
    /// The act.
    pub act: Act,
}

/// A drive to which something is done at certain times.
pub struct ScheduledActs {
    node: Box<dyn SimNode>,
    /// The latest first.
    acts: Vec<ScheduledAct>,
}

impl ScheduledActs {
    /// Creates a node with these scheduled acts.
    #[must_use]
    pub fn new(node: Box<dyn SimNode>, mut acts: Vec<ScheduledAct>) -> Self {
        // Backwards, because the earliest is taken from the end.
        acts.sort_by_key(|act| std::cmp::Reverse(act.at));
        Self { node, acts }
    }
}

impl std::fmt::Debug for ScheduledActs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ScheduledActs({} left)", self.acts.len())
    }
}

impl Timed for ScheduledActs {
    fn handle_timeout(&mut self, now: Instant) {
        while let Some(scheduled) = self.acts.pop_if(|scheduled| scheduled.at <= now) {
            if let Some(bench) = self.node.surroundings() {
                bench.act_on_motor(now, scheduled.motor, scheduled.act);
            }
        }
        self.node.handle_timeout(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.node.poll_timeout(), self.acts.last().map(|scheduled| scheduled.at))
    }
}

impl SimNode for ScheduledActs {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        self.node.stream(port)
    }
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        self.node.can(port)
    }
    fn axes(&mut self) -> Option<&mut dyn Axes> {
        self.node.axes()
    }
    fn surroundings(&mut self) -> Option<&mut dyn SurroundingsControl> {
        self.node.surroundings()
    }
}

macro_rules! timed {
    (impl {$($t:ident)?} for $wrapper:ty) => {
        impl $(<$t: Timed>)? Timed for $wrapper {
            fn handle_timeout(&mut self, now: Instant) {
                self.0.handle_timeout(now);
            }
            fn poll_timeout(&self) -> Option<Instant> {
                self.0.poll_timeout()
            }
        }
    };
}
timed!(impl {T} for DriveNode<T>);
timed!(impl {T} for SerialStationNode<T>);
timed!(impl {T} for CanStationNode<T>);
timed!(impl {} for HostLane);
timed!(impl {} for CanHostLane);

impl<D: SimulatedDevice> SimNode for DriveNode<D> {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        if port == SERIAL_PORT { self.0.serial_station() } else { None }
    }
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        if port == CAN_PORT { self.0.can_station() } else { None }
    }
    fn surroundings(&mut self) -> Option<&mut dyn SurroundingsControl> {
        Some(&mut self.0)
    }
}

impl SimNode for HostLane {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        (port == 0).then_some(&mut *self.0 as _)
    }
    fn axes(&mut self) -> Option<&mut dyn Axes> {
        Some(&mut *self.0)
    }
}

impl SimNode for CanHostLane {
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        (port == 0).then_some(&mut *self.0 as _)
    }
    fn axes(&mut self) -> Option<&mut dyn Axes> {
        Some(&mut *self.0)
    }
}

impl std::fmt::Debug for HostLane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HostLane({} axes)", self.0.axis_count())
    }
}

impl std::fmt::Debug for CanHostLane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CanHostLane({} axes)", self.0.axis_count())
    }
}

impl<S: Station<Stream> + Send> SimNode for SerialStationNode<S> {
    fn stream(&mut self, port: u8) -> Option<&mut dyn Station<Stream>> {
        (port == 0).then_some(&mut self.0 as _)
    }
}

impl<S: Station<Can> + Send> SimNode for CanStationNode<S> {
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        (port == 0).then_some(&mut self.0 as _)
    }
}
