//! The host's end of a simulated wire as a link. All ends share one world.

use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::time::Instant;
use polepair_drives::surroundings::SurroundingsControl;
use polepair_link::{LinkError, LinkIo, LinkWaker, Received, clock};
use polepair_sim::world::{EndId, NodeId, WireId, World};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::SimulationPace;

/// Events of the world between two checks for an interruption.
const EVENTS_PER_POLL_MAX: usize = 4096;

#[derive(Debug)]
pub(super) struct SharedWorld {
    world: Mutex<World>,
    pub(super) pace: SimulationPace,
    /// Conversion of the machine's time to the simulation's, if that passes by itself.
    time_scale: Mutex<TimeScale>,
    /// Waiters for a time by the old pace.
    wakers: Mutex<Vec<LinkWaker>>,
}

/// Scale of the simulation's time, and the instant since which it holds.
#[derive(Clone, Copy, Debug)]
struct TimeScale {
    wall: Instant,
    simulated: Instant,
    scale: f64,
}

impl TimeScale {
    /// The simulation's time at one of the machine's.
    fn simulated_at(&self, wall: Instant) -> Instant {
        self.simulated + scale_span(wall.since(self.wall), self.scale)
    }

    /// The machine's time at one of the simulation's.
    fn wall_at(&self, simulated: Instant) -> Instant {
        self.wall + scale_span(simulated.since(self.simulated), 1.0 / self.scale)
    }
}

/// A span multiplied by `scale`; exact to the nanosecond for 1.
fn scale_span(span: Duration, scale: f64) -> Duration {
    if scale == 1.0 { span } else { Duration::from_nanos((span.as_nanos() as f64 * scale) as u64) }
}

impl SharedWorld {
    pub(super) fn new(world: World, pace: SimulationPace) -> Self {
        let flow = TimeScale { wall: clock::now(), simulated: Instant::ZERO, scale: 1.0 };
        let (time_scale, wakers) = (Mutex::new(flow), Mutex::default());
        Self { world: Mutex::new(world), pace, time_scale, wakers }
    }

    fn lock_time_scale(&self) -> MutexGuard<'_, TimeScale> {
        self.time_scale.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of times faster than the machine's its time passes.
    pub(super) fn scale(&self) -> f64 {
        self.lock_time_scale().scale
    }

    /// Sets the factor of time.
    pub(super) fn set_scale(&self, scale: f64) {
        {
            let (mut flow, wall) = (self.lock_time_scale(), clock::now());
            *flow = TimeScale { wall, simulated: flow.simulated_at(wall), scale };
        }
        let waiting = self.wakers.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.iter().for_each(LinkWaker::wake);
    }

    fn lock_world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Present time of the simulation's clock, with the world locked or not.
    fn current_time(&self, world: &World) -> Instant {
        match self.pace {
            SimulationPace::Virtual => world.now(),
            SimulationPace::Real => self.scaled_now().max(world.now()),
        }
    }

    fn scaled_now(&self) -> Instant {
        self.lock_time_scale().simulated_at(clock::now())
    }

    pub(super) fn now(&self) -> Instant {
        self.current_time(&self.lock_world())
    }

    pub(super) fn advance(&self, span: Duration) {
        if self.pace == SimulationPace::Real {
            let until = self.now() + span;
            clock::sleep_until(self.lock_time_scale().wall_at(until));
            return;
        }
        let mut world = self.lock_world();
        let until = world.now() + span;
        world.run_until(until);
    }

    /// The share of the time so far in which a bus was busy.
    pub(super) fn load(&self, wire: WireId) -> f64 {
        let mut world = self.lock_world();
        let now = self.current_time(&world);
        world.run_until(now);
        world.can_load(wire)
    }

    /// Lends a drive's bench, with the world brought up to the present.
    pub(super) fn with_bench<R>(
        &self,
        link: Option<&(WireId, Vec<NodeId>)>,
        drive: usize,
        f: impl FnOnce(&mut dyn SurroundingsControl, Instant) -> R,
    ) -> Option<R> {
        let node = *link?.1.get(drive)?;
        let mut world = self.lock_world();
        let now = self.current_time(&world);
        world.run_until(now);
        world.with_node(node, |node, now| node.surroundings().map(|bench| f(bench, now)))
    }
}

/// The host's end of one wire.
#[derive(Debug)]
pub(super) struct SimEnd {
    shared: Arc<SharedWorld>,
    end: EndId,
    waker: LinkWaker,
    name: String,
}

impl SimEnd {
    pub(super) fn new(
        shared: Arc<SharedWorld>,
        wire: WireId,
        name: &str,
    ) -> Result<Self, LinkError> {
        let waker = LinkWaker::new().map_err(|error| LinkError::from_io(name, &error))?;
        let end = shared.lock_world().open_end(wire);
        shared.wakers.lock().unwrap_or_else(PoisonError::into_inner).push(waker.clone());
        Ok(Self { shared, end, waker, name: name.to_owned() })
    }

    /// Lets the world run until something arrived here, `until` came, or it is time to look
    /// around. `Err` is how long nothing will happen.
    fn poll_world(&self, take: &mut ReceiveFn<'_>, until: Instant) -> Result<Received, Instant> {
        let mut world = self.shared.lock_world();
        let horizon = match self.shared.pace {
            SimulationPace::Virtual if until == Instant::FAR_FUTURE => world.now(),
            SimulationPace::Virtual => until,
            SimulationPace::Real => self.shared.scaled_now(),
        };
        for _ in 0..EVENTS_PER_POLL_MAX {
            if let Some((at, len)) = take(&mut world, self.end) {
                return Ok(Received::Bytes { len, at });
            }
            if world.next_event().is_none_or(|at| at > horizon) {
                world.run_until(horizon);
                break;
            }
            world.step();
        }
        let (now, next) = (self.shared.current_time(&world), world.next_event());
        if now >= until {
            return Ok(Received::TimedOut);
        }
        match self.shared.pace {
            SimulationPace::Virtual if until == Instant::FAR_FUTURE => Err(Instant::FAR_FUTURE),
            SimulationPace::Virtual => Err(Instant::ZERO),
            SimulationPace::Real => Err(next.map_or(until, |next| next.min(until))),
        }
    }

    fn now(&self) -> Instant {
        self.shared.now()
    }

    fn send(&self, send: impl FnOnce(&mut World, Instant)) {
        let mut world = self.shared.lock_world();
        let now = self.shared.current_time(&world);
        send(&mut world, now);
    }

    fn receive(&self, take: &mut ReceiveFn<'_>, until: Instant) -> Received {
        loop {
            let wait = match self.poll_world(take, until) {
                Ok(received) => return received,
                Err(Instant::FAR_FUTURE) => Instant::FAR_FUTURE,
                Err(until) => self.shared.lock_time_scale().wall_at(until),
            };
            if self.waker.wait(wait) {
                return Received::Woken;
            }
        }
    }
}

/// Takes what arrived at an end: when, and how much.
type ReceiveFn<'a> = dyn FnMut(&mut World, EndId) -> Option<(Instant, usize)> + 'a;

impl LinkIo<Stream> for SimEnd {
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
        self.shared.lock_world().set_line(self.end, line);
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn is_real_time(&self) -> bool {
        self.shared.pace == SimulationPace::Real
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}

impl LinkIo<Can> for SimEnd {
    fn now(&self) -> Instant {
        self.now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        self.send(|world, now| world.send_frame(self.end, now, frame));
        Ok(())
    }

    fn receive(&self, out: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        Ok(self.receive(
            &mut |world, end| {
                let (at, frame) = world.receive_frame(end)?;
                *out = frame;
                Some((at, 1))
            },
            until,
        ))
    }

    /// A simulated bus has the bit rate of its rack.
    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn is_real_time(&self) -> bool {
        self.shared.pace == SimulationPace::Real
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}
