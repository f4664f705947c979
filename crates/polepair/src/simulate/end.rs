//! The host's end of a simulated wire as a link, and the world behind it, shared by all ends.

use polepair_core::drives::bench::Bench;
use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::time::Instant;
use polepair_link::{Link, LinkError, Received, Waker, clock};
use polepair_sim::world::{EndId, NodeId, WireId, World};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::Pace;

/// Events of the world between two looks whether somebody wants this wait to end.
const EVENTS_MAX: usize = 4096;

#[derive(Debug)]
pub(super) struct Shared {
    world: Mutex<World>,
    pub(super) pace: Pace,
    /// How the machine's time becomes the simulation's, where that passes by itself.
    flow: Mutex<Flow>,
    /// Who may be waiting for a time by the old flow.
    waiting: Mutex<Vec<Waker>>,
}

/// Since when the simulation's time passes how fast.
#[derive(Clone, Copy, Debug)]
struct Flow {
    wall: Instant,
    simulated: Instant,
    scale: f64,
}

impl Flow {
    /// The simulation's time at one of the machine's.
    fn simulated_at(&self, wall: Instant) -> Instant {
        self.simulated + scaled(wall.since(self.wall), self.scale)
    }

    /// The machine's time at one of the simulation's.
    fn wall_at(&self, simulated: Instant) -> Instant {
        self.wall + scaled(simulated.since(self.simulated), 1.0 / self.scale)
    }
}

/// A span that is so many times longer; to the nanosecond where it is as long.
fn scaled(span: Duration, scale: f64) -> Duration {
    if scale == 1.0 { span } else { Duration::from_nanos((span.as_nanos() as f64 * scale) as u64) }
}

impl Shared {
    pub(super) fn new(world: World, pace: Pace) -> Self {
        let flow = Flow { wall: clock::now(), simulated: Instant::ZERO, scale: 1.0 };
        let (flow, waiting) = (Mutex::new(flow), Mutex::default());
        Self { world: Mutex::new(world), pace, flow, waiting }
    }

    fn flow(&self) -> MutexGuard<'_, Flow> {
        self.flow.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many times faster than the machine's its time passes.
    pub(super) fn scale(&self) -> f64 {
        self.flow().scale
    }

    /// Has time pass so many times faster from now on.
    pub(super) fn set_scale(&self, scale: f64) {
        {
            let (mut flow, wall) = (self.flow(), clock::now());
            *flow = Flow { wall, simulated: flow.simulated_at(wall), scale };
        }
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.iter().for_each(Waker::wake);
    }

    fn lock(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the simulation's clock shows, the world locked or not.
    fn time(&self, world: &World) -> Instant {
        match self.pace {
            Pace::Virtual => world.now(),
            Pace::Real => self.real().max(world.now()),
        }
    }

    fn real(&self) -> Instant {
        self.flow().simulated_at(clock::now())
    }

    pub(super) fn now(&self) -> Instant {
        self.time(&self.lock())
    }

    pub(super) fn pass(&self, span: Duration) {
        if self.pace == Pace::Real {
            let until = self.now() + span;
            clock::sleep_until(self.flow().wall_at(until));
            return;
        }
        let mut world = self.lock();
        let until = world.now() + span;
        world.run_until(until);
    }

    /// The share of the time so far in which a bus was busy.
    pub(super) fn load(&self, wire: WireId) -> f64 {
        let mut world = self.lock();
        let now = self.time(&world);
        world.run_until(now);
        world.can_load(wire)
    }

    /// Lends a drive's bench, with the world brought up to the present.
    pub(super) fn with<R>(
        &self,
        link: Option<&(WireId, Vec<NodeId>)>,
        drive: usize,
        f: impl FnOnce(&mut dyn Bench, Instant) -> R,
    ) -> Option<R> {
        let node = *link?.1.get(drive)?;
        let mut world = self.lock();
        let now = self.time(&world);
        world.run_until(now);
        world.with(node, |node, now| node.bench().map(|bench| f(bench, now)))
    }
}

/// The host's end of one wire.
#[derive(Debug)]
pub(super) struct SimEnd {
    shared: Arc<Shared>,
    end: EndId,
    waker: Waker,
    name: String,
}

impl SimEnd {
    pub(super) fn new(shared: Arc<Shared>, wire: WireId, name: &str) -> Result<Self, LinkError> {
        let waker = Waker::new().map_err(|error| LinkError::from_io(name, &error))?;
        let end = shared.lock().open(wire);
        shared.waiting.lock().unwrap_or_else(PoisonError::into_inner).push(waker.clone());
        Ok(Self { shared, end, waker, name: name.to_owned() })
    }

    /// Lets the world run until something arrived here, `until` came, or it is time to look
    /// around. `Err` is how long nothing will happen.
    fn look(&self, take: &mut Take<'_>, until: Instant) -> Result<Received, Instant> {
        let mut world = self.shared.lock();
        let horizon = match self.shared.pace {
            Pace::Virtual if until == Instant::FAR => world.now(),
            Pace::Virtual => until,
            Pace::Real => self.shared.real(),
        };
        for _ in 0..EVENTS_MAX {
            if let Some((at, len)) = take(&mut world, self.end) {
                return Ok(Received::Bytes { len, at });
            }
            if world.next_event().is_none_or(|at| at > horizon) {
                world.run_until(horizon);
                break;
            }
            world.step();
        }
        let (now, next) = (self.shared.time(&world), world.next_event());
        if now >= until {
            return Ok(Received::TimedOut);
        }
        match self.shared.pace {
            Pace::Virtual if until == Instant::FAR => Err(Instant::FAR),
            Pace::Virtual => Err(Instant::ZERO),
            Pace::Real => Err(next.map_or(until, |next| next.min(until))),
        }
    }

    fn now(&self) -> Instant {
        self.shared.now()
    }

    fn send(&self, send: impl FnOnce(&mut World, Instant)) {
        let mut world = self.shared.lock();
        let now = self.shared.time(&world);
        send(&mut world, now);
    }

    fn receive(&self, take: &mut Take<'_>, until: Instant) -> Received {
        loop {
            let wait = match self.look(take, until) {
                Ok(received) => return received,
                Err(Instant::FAR) => Instant::FAR,
                Err(until) => self.shared.flow().wall_at(until),
            };
            if self.waker.wait(wait) {
                return Received::Woken;
            }
        }
    }
}

/// Takes what arrived at an end: when, and how much.
type Take<'a> = dyn FnMut(&mut World, EndId) -> Option<(Instant, usize)> + 'a;

impl Link<Stream> for SimEnd {
    fn now(&self) -> Instant {
        self.now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.send(|world, now| world.send(self.end, now, unit));
        Ok(())
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        Ok(self.receive(&mut |world, end| world.receive(end, buffer), until))
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        self.shared.lock().set_line(self.end, line);
        Ok(())
    }

    fn waker(&self) -> Waker {
        self.waker.clone()
    }

    fn runs_by_itself(&self) -> bool {
        self.shared.pace == Pace::Real
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}

impl Link<Can> for SimEnd {
    fn now(&self) -> Instant {
        self.now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        self.send(|world, now| world.send_frame(self.end, now, frame));
        Ok(())
    }

    fn receive(&self, out: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        let mut take = |world: &mut World, end| {
            let (at, frame) = world.receive_frame(end)?;
            *out = frame;
            Some((at, 1))
        };
        Ok(self.receive(&mut take, until))
    }

    /// A simulated bus has the bit rate that its rack says.
    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> Waker {
        self.waker.clone()
    }

    fn runs_by_itself(&self) -> bool {
        self.shared.pace == Pace::Real
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}
