//! Drives of a rack as stations that `serve` connects to real wires: one world, one end for each link.

use super::RackDescription;
use crate::error::Error;
use crate::registry;
use polepair_core::medium::{Can, CanLine, Frame, Medium, MediumKind, SerialLine, Stream};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, SurroundingsControl};
use polepair_link::{LinkIo, LinkWaker, ServeThread};
use polepair_sim::fault::SerialFaults;
use polepair_sim::rack::RackWire;
use polepair_sim::serial_line::{Duplex, Timing};
use polepair_sim::world::{EndId, NodeId, World};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The drives of a rack, one line for each of its links, in order. Real wires have their own timing: bytes
/// and frames are processed as they arrive, unless the rack has `timing`. `seed` determines the faults.
///
/// # Errors
/// [`Error::Usage`] `E231` if a drive cannot be built as described.
pub fn drive_lines(description: &RackDescription, seed: u64) -> Result<Vec<DriveLine>, Error> {
    let mut description = description.clone();
    let mut rates = Vec::new();
    for (link, wire) in description.rack.links.iter_mut().zip(&description.wires) {
        let is_timed = wire.timed || replies_collide(&link.wire, wire.protocol);
        rates.push(if is_timed { wire.baud } else { 0 });
        match &mut link.wire {
            RackWire::Serial(serial) if is_timed => serial.baud = Some(wire.baud),
            RackWire::Serial(serial) => {
                // Where the protocol defines rates, its drives have no USB, on which any rate is understood.
                let keeps_rate = serial.timing != Timing::Cdc && defines_rates(wire.protocol);
                serial.timing = if keeps_rate { Timing::Pty } else { Timing::Cdc };
                // Without timing a drive cannot distinguish a neighbour's reply from a request.
                if wire.faults == SerialFaults::NONE && !serial.echo && !wire.shared {
                    serial.duplex = Duplex::Full;
                }
            }
            RackWire::Can(line) => line.bit_rate = 0,
        }
    }
    description.let_drives_set_rates();
    let mut world = World::new(seed);
    let built = description.rack.build(&mut world);
    let built = built.map_err(|error| Error::usage("E231", error.to_string(), ""))?;
    description.set_faults(&mut world, &built);
    let ends: Vec<EndId> = built.links.iter().map(|(wire, _)| world.open_end(*wire)).collect();
    for (end, rate) in ends.iter().zip(&rates) {
        world.set_line(*end, SerialLine::new_8n1(*rate));
    }
    let doors = ends.iter().map(|end| LinePort { end: *end, waker: None }).collect();
    let shared = Arc::new(Mutex::new(LineWorld { world, ports: doors }));
    Ok(built
        .links
        .into_iter()
        .zip(ends.into_iter().zip(rates))
        .map(|((_, nodes), (end, baud))| DriveLine {
            shared: Arc::clone(&shared),
            end,
            baud,
            nodes,
        })
        .collect())
}

/// Returns whether several drives of a line may reply at once. Their bytes then take the time of the baud rate, because
/// they collide as long as they take.
fn replies_collide(wire: &RackWire, protocol: &str) -> bool {
    let RackWire::Serial(serial) = wire else { return false };
    let known = registry::find_protocol(protocol, wire.medium());
    serial.duplex == Duplex::Half
        && serial.timing != Timing::Cdc
        && known.is_some_and(|known| known.has_standards)
}

fn defines_rates(protocol: &str) -> bool {
    let known = registry::find_protocol(protocol, MediumKind::Serial);
    known.is_some_and(|known| !known.rates.is_empty())
}

/// The drives of one link of a rack, behind a wire with the rack's faults. Clones are the same drives.
#[derive(Clone)]
pub struct DriveLine {
    shared: Arc<Mutex<LineWorld>>,
    end: EndId,
    /// Rate of a client that sets none; 0 for that of the drives.
    baud: u32,
    nodes: Vec<NodeId>,
}

struct LineWorld {
    world: World,
    ports: Vec<LinePort>,
}

/// Exit of a line from the world, and the waker of its server.
struct LinePort {
    end: EndId,
    waker: Option<LinkWaker>,
}

impl LineWorld {
    /// Brings the world up to `now`, and calls the servers of other lines where something arrived.
    fn advance(&mut self, now: Instant, mine: EndId) {
        self.world.run_until(now);
        for line_port in self.ports.iter().filter(|line_port| line_port.end != mine) {
            if let Some(waker) =
                line_port.waker.as_ref().filter(|_| self.world.has_pending(line_port.end))
            {
                waker.wake();
            }
        }
    }
}

impl std::fmt::Debug for DriveLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DriveLine of {}", self.nodes.len())
    }
}

impl DriveLine {
    /// Serves the drives on a real wire, on a thread of its own.
    pub fn serve<M: Medium>(self, wire: Box<dyn LinkIo<M>>) -> ServeThread
    where
        Self: Station<M>,
    {
        let waker = wire.waker();
        if let Some(line_port) =
            self.lock().ports.iter_mut().find(|line_port| line_port.end == self.end)
        {
            line_port.waker = Some(waker);
        }
        ServeThread::new(wire, Box::new(self))
    }

    /// Number of drives there are.
    #[must_use]
    pub fn drives(&self) -> usize {
        self.nodes.len()
    }

    /// Lends the bench of the drive of that number, counted from 0.
    pub fn with_bench<R>(
        &self,
        drive: usize,
        f: impl FnOnce(&mut dyn SurroundingsControl) -> R,
    ) -> Option<R> {
        let node = *self.nodes.get(drive)?;
        self.lock().world.with_node(node, |node, _| node.surroundings().map(f))
    }

    /// Does something to a motor of the drive of that number, both counted from 0, and has its servers look at
    /// it. Returns whether there is such a drive with such a thing.
    pub fn act(&self, drive: usize, motor: u8, act: Act) -> bool {
        let Some(node) = self.nodes.get(drive) else { return false };
        let mut shared = self.lock();
        let done = shared.world.with_node(*node, |node, now| {
            node.surroundings().is_some_and(|bench| bench.act_on_motor(now, motor, act))
        });
        shared.ports.iter().filter_map(|port| port.waker.as_ref()).for_each(LinkWaker::wake);
        done
    }

    fn lock(&self) -> MutexGuard<'_, LineWorld> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Timed for DriveLine {
    fn handle_timeout(&mut self, now: Instant) {
        self.lock().advance(now, self.end);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.lock().world.next_event()
    }
}

impl Station<Stream> for DriveLine {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        let mut shared = self.lock();
        shared.world.send(self.end, now, unit);
        // What was sent arrives at once.
        shared.advance(now, self.end);
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        if let LineEvent::Rate(baud) = event {
            let baud = if baud == 0 { self.baud } else { baud };
            self.lock().world.set_line(self.end, SerialLine::new_8n1(baud));
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let mut shared = self.lock();
        shared.advance(now, self.end);
        shared.world.receive(self.end, out).map(|(_, count)| count)
    }

    fn line(&self) -> SerialLine {
        SerialLine::new_8n1(0)
    }
}

impl Station<Can> for DriveLine {
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        let mut shared = self.lock();
        shared.world.send_frame(self.end, now, frame);
        shared.advance(now, self.end);
    }

    fn handle_line(&mut self, _now: Instant, _event: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let mut shared = self.lock();
        shared.advance(now, self.end);
        *out = shared.world.receive_frame(self.end)?.1;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: 0 }
    }
}
