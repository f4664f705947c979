//! Several simulated drives as one station: what `serve` puts on a real wire.

use super::Description;
use crate::error::Error;
use polepair_core::drives::bench::Bench;
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};
use polepair_sim::node::Node;
use polepair_sim::rack::{Rack, RackWire};
use polepair_sim::world::{EndId, World};

/// The drives of one link of a rack. Each hears the host, none hears another.
pub struct DriveLine {
    nodes: Vec<Box<dyn Node>>,
}

impl std::fmt::Debug for DriveLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DriveLine of {}", self.nodes.len())
    }
}

impl DriveLine {
    /// The drives of the link of that number, counted from 0, for a pty or TCP: no byte timing.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no such link (`E212`), or a drive cannot be built as
    /// described (`E231`).
    pub fn new(description: &Description, link: usize) -> Result<Self, Error> {
        let spec = description.rack.links.get(link).ok_or_else(|| {
            Error::usage("E212", format!("the rack has no link {link}"), "links count from 0")
        })?;
        let mut nodes = Vec::with_capacity(spec.drives.len());
        for drive in &spec.drives {
            let unbuildable =
                |error: polepair_sim::rack::RackError| Error::usage("E231", error.to_string(), "");
            let mut node = drive.device(true).map_err(unbuildable)?;
            drive.prepare(&mut *node, Instant::ZERO).map_err(unbuildable)?;
            nodes.push(node);
        }
        Ok(Self { nodes })
    }

    /// How many drives there are.
    #[must_use]
    pub fn drives(&self) -> usize {
        self.nodes.len()
    }

    /// The bench of the drive of that number, counted from 0.
    pub fn bench(&mut self, drive: usize) -> Option<&mut dyn Bench> {
        self.nodes.get_mut(drive)?.bench()
    }

    fn stations(&mut self) -> impl Iterator<Item = &mut dyn Station<Stream>> {
        self.nodes.iter_mut().filter_map(|node| node.stream(0))
    }
}

impl Timed for DriveLine {
    fn handle_timeout(&mut self, now: Instant) {
        for node in &mut self.nodes {
            if node.poll_timeout().is_some_and(|due| due <= now) {
                node.handle_timeout(now);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.nodes.iter().fold(None, |soonest, node| earliest(soonest, node.poll_timeout()))
    }
}

impl Station<Stream> for DriveLine {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.stations().for_each(|station| station.handle_input(now, unit));
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.stations().for_each(|station| station.handle_line(now, event));
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.stations().find_map(|station| station.poll_transmit(now, out))
    }

    fn line(&self) -> SerialLine {
        // A pty and TCP have none.
        SerialLine::n81(0)
    }
}

/// The drives of one link of a rack behind a wire that does to their bytes what the rack says:
/// noise, losses, late replies, an echo. No byte timing.
pub struct FaultyLine {
    world: World,
    end: EndId,
}

impl std::fmt::Debug for FaultyLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("FaultyLine")
    }
}

impl FaultyLine {
    /// The link of that number, counted from 0. Which faults come when follows from `seed`.
    ///
    /// # Errors
    /// As [`DriveLine::new`].
    pub fn new(description: &Description, link: usize, seed: u64) -> Result<Self, Error> {
        let spec = description.rack.links.get(link).ok_or_else(|| {
            Error::usage("E212", format!("the rack has no link {link}"), "links count from 0")
        })?;
        let mut spec = spec.clone();
        if let RackWire::Serial(serial) = &mut spec.wire {
            serial.timed = false;
        }
        let mut world = World::new(seed.wrapping_add(link as u64));
        let built = Rack { links: vec![spec] }.build(&mut world);
        let built = built.map_err(|error| Error::usage("E231", error.to_string(), ""))?;
        let (wire, _) = built.links[0];
        if let Some(faults) = world.faults(wire) {
            *faults = description.wires[link].faults;
        }
        let end = world.open(wire);
        Ok(Self { world, end })
    }
}

impl Timed for FaultyLine {
    fn handle_timeout(&mut self, now: Instant) {
        self.world.run_until(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.world.next_event()
    }
}

impl Station<Stream> for FaultyLine {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.world.send(self.end, now, unit);
        // Without byte timing what was sent arrives at once.
        self.world.run_until(now);
    }

    fn handle_line(&mut self, _now: Instant, _event: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.world.run_until(now);
        self.world.receive(self.end, out).map(|(_, count)| count)
    }

    fn line(&self) -> SerialLine {
        SerialLine::n81(0)
    }
}
