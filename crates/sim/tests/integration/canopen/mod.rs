//! CANopen under faults, in virtual time: our host against our nodes on the simulated bus.
//!
//! Each test lives through [`SEEDS`] seeds, which decide when the fault comes and how long it lasts.
//! One that fails names its seed and how to live through that alone.

mod bus;
mod capture;
mod heartbeat;
mod moves;
mod process;
mod store;
mod transfer;
mod ts;

use std::sync::{Arc, Mutex, MutexGuard};

use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{Can, CanLine, Frame, MediumKind};
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::HostOptions;
use polepair_core::proto::canopen::host::CanHost;
use polepair_core::proto::canopen::host_request::{Answer, HostRequest};
use polepair_core::proto::canopen::sdo::ObjectIndex;
use polepair_core::station::{
    AxisIndex, Counters, EventSubject, Host as _, LineEvent, RequestClass, Station, Ticket, Timed,
};
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, GroundTruth};
use polepair_drives::{cia402, syntron_ts};
use polepair_sim::host;
use polepair_sim::node::CanStationNode;
use polepair_sim::rack::RackDrive;
use polepair_sim::random::Random;
use polepair_sim::world::{NodeId, WireId, World};

/// Seeds that each test lives through.
const SEEDS: u64 = 20;
const BIT_RATE: u32 = 500_000;
/// Time allowed for a reply (profile `cia402`), ms.
const TIMEOUT_MS: u32 = 200;
/// The host's node-ID.
const HOST: u32 = 127;

/// Lives through every seed, or through that of `POLEPAIR_SEED` alone.
fn seeds(test: impl Fn(u64)) {
    let only = std::env::var("POLEPAIR_SEED").ok().and_then(|seed| seed.parse::<u64>().ok());
    for seed in only.map_or(1..=SEEDS, |seed| seed..=seed) {
        let named = Named(seed);
        test(seed);
        drop(named);
    }
}

/// Prints the command that repeats a seed, if the test fails.
struct Named(u64);

impl Drop for Named {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let (seed, thread) = (self.0, std::thread::current());
            let test = thread.name().unwrap_or("");
            eprintln!("POLEPAIR_SEED={seed} cargo test -p polepair-sim --test integration {test}");
        }
    }
}

fn cia402() -> &'static Profile {
    &cia402::profile::CIA402
}

fn ts() -> &'static Profile {
    &syntron_ts::profile::SYNTRON_TS_CANOPEN
}

/// A simulated drive with that node-ID; a TS is in CANopen mode.
fn drive(profile: &'static Profile, node: u32) -> RackDrive {
    let mut spec = RackDrive::new(profile, "canopen");
    spec.address = Some(node);
    if std::ptr::eq(profile, ts()) {
        let extra = [("variant", "all"), ("fn00", "20"), ("can", "true")];
        spec.extra = extra.map(|(name, value)| (name.to_owned(), value.to_owned())).to_vec();
    }
    spec
}

/// A bus with a program, which commands one axis a drive.
struct Bench {
    world: World,
    random: Random,
    wire: WireId,
    host: NodeId,
    drives: Vec<NodeId>,
    profiles: Vec<&'static Profile>,
    tickets: u32,
    /// Requests that ended while another was waited for.
    ends: Vec<(Ticket, Outcome)>,
}

impl Bench {
    /// Nodes 2, 3 and so on, one for each profile.
    fn new(seed: u64, profiles: &[&'static Profile]) -> Self {
        Self::beating(seed, None, profiles)
    }

    /// Period of the program's heartbeat, ms, while the program sends requests.
    fn beating(seed: u64, heartbeat_ms: Option<u32>, profiles: &[&'static Profile]) -> Self {
        let mut world = World::new(seed);
        let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
        let axes: Vec<_> = profiles.iter().copied().zip(2..).collect();
        let options = HostOptions { heartbeat_ms, ..HostOptions::new(BIT_RATE) };
        let lane = host::host_lane("canopen", MediumKind::Can, options, &axes).unwrap();
        let host = world.add_node(lane);
        world.plug_host(wire, host, 0);
        let drives = axes
            .iter()
            .map(|(profile, node)| drive(profile, *node).build(&mut world, wire, false).unwrap());
        let (drives, profiles) = (drives.collect(), profiles.to_vec());
        let (random, ends) = (Random::new(seed), Vec::new());
        let mut bench = Self { world, random, wire, host, drives, profiles, tickets: 0, ends };
        bench.pass(50);
        bench
    }

    /// Lets this many ms pass.
    fn pass(&mut self, ms: u32) {
        let until = self.world.now().plus_ms(ms);
        self.world.run_until(until);
    }

    fn axes<R>(&mut self, f: impl FnOnce(&mut dyn Axes, Instant) -> R) -> R {
        self.world.with_node(self.host, |node, now| f(node.axes().unwrap(), now))
    }

    fn start(
        &mut self,
        request: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Ticket {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        self.axes(|axes, now| request(axes, now, ticket)).unwrap();
        ticket
    }

    /// Lives on until that ticket ends.
    fn end(&mut self, ticket: Ticket) -> Outcome {
        let limit = self.world.now().plus_ms(130_000);
        loop {
            while let Some(end) = self.axes(|axes, _| axes.poll_outcome()) {
                self.ends.push(end);
            }
            if let Some(at) = self.ends.iter().position(|(ended, _)| *ended == ticket) {
                return self.ends.swap_remove(at).1;
            }
            assert!(self.world.now() < limit, "{ticket:?} never ended");
            self.world.step();
        }
    }

    fn run(
        &mut self,
        request: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Outcome {
        let ticket = self.start(request);
        self.end(ticket)
    }

    fn read(&mut self, axis: u8, name: &str) -> Outcome {
        let id = self.profiles[usize::from(axis)].find_parameter(name).unwrap();
        self.run(|axes, now, ticket| axes.read_parameter(now, ticket, AxisIndex(axis), id))
    }

    fn write(&mut self, axis: u8, name: &str, raw: i64) -> Outcome {
        let id = self.profiles[usize::from(axis)].find_parameter(name).unwrap();
        self.axes(|axes, _| axes.set_armed(AxisIndex(axis), true));
        self.run(|axes, now, ticket| {
            axes.write_parameter(now, ticket, AxisIndex(axis), id, raw, false)
        })
    }

    /// Writes that must be done.
    fn set(&mut self, axis: u8, values: &[(&str, i64)]) {
        for (name, raw) in values {
            assert_eq!(self.write(axis, name, *raw), Outcome::Done(*raw), "{name}");
        }
    }

    fn command(&mut self, axis: u8, command: Command) -> Outcome {
        let ticket = self.commanded(axis, command);
        self.end(ticket)
    }

    /// Starts a verb, and does not wait for its end.
    fn commanded(&mut self, axis: u8, command: Command) -> Ticket {
        self.axes(|axes, _| axes.set_armed(AxisIndex(axis), true));
        self.start(|axes, now, ticket| axes.command(now, ticket, AxisIndex(axis), command))
    }

    fn verb(&mut self, axis: u8, verb: Verb) -> Outcome {
        self.command(axis, Command::new(verb))
    }

    /// Has an axis turn, and waits until it does.
    fn spin(&mut self, axis: u8, rad_per_s: f64) {
        let turn = Command { velocity: Some(rad_per_s), ..Command::new(Verb::Velocity) };
        done(self.command(axis, turn));
        self.pass(500);
        self.turns(axis, rad_per_s);
    }

    #[track_caller]
    fn turns(&mut self, axis: u8, rad_per_s: f64) {
        let truth = self.truth(axis);
        assert!((truth.velocity - rad_per_s).abs() < 1.0, "axis {axis}: {truth:?}");
    }

    #[track_caller]
    fn rests(&mut self, axis: u8) {
        let truth = self.truth(axis);
        assert!(truth.velocity.abs() < 0.5, "axis {axis}: {truth:?}");
    }

    fn truth(&mut self, axis: u8) -> GroundTruth {
        let drive = self.drives[usize::from(axis)];
        self.world.inspect(drive, |node, now| node.surroundings().unwrap().ground_truth(now))
    }

    fn act(&mut self, axis: u8, act: Act) {
        let drive = self.drives[usize::from(axis)];
        assert!(
            self.world.with_node(drive, |node, now| node.surroundings().unwrap().act(now, act))
        );
    }

    fn is_armed(&mut self, axis: u8) -> bool {
        self.axes(|axes, _| axes.state(AxisIndex(axis)).unwrap().armed)
    }

    /// The fault that the host knows of.
    fn fault(&mut self, axis: u8) -> i64 {
        self.axes(|axes, _| axes.state(AxisIndex(axis)).unwrap().reading(Signal::Fault).raw)
    }

    fn counters(&mut self) -> Counters {
        self.axes(|axes, _| axes.counters())
    }

    fn pull(&mut self, axis: u8, away: bool) {
        self.world.set_unplugged(self.wire, self.drives[usize::from(axis)], away);
    }

    /// Sends a frame from elsewhere on the bus.
    fn say(&mut self, id: u16, data: &[u8]) {
        self.flood(Frame::standard(id, data), 1, 0);
        self.pass(2);
    }

    /// Sends a frame repeatedly: number of times, and µs between two.
    fn flood(&mut self, frame: Frame, times: u32, every_us: u64) {
        let talker =
            self.world.add_node(Box::new(CanStationNode(Talker::new(frame, times, every_us))));
        self.world.plug_intruder(self.wire, talker);
    }
}

#[track_caller]
fn done(outcome: Outcome) {
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
}

/// A sender that repeats one frame.
struct Talker {
    frame: Frame,
    left: u32,
    every_us: u64,
    next: Instant,
}

impl Talker {
    const fn new(frame: Frame, times: u32, every_us: u64) -> Self {
        Self { frame, left: times, every_us, next: Instant::ZERO }
    }
}

impl Timed for Talker {
    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        (self.left > 0).then_some(self.next)
    }
}

impl Station<Can> for Talker {
    fn handle_input(&mut self, _: Instant, _: &Frame) {}

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        if self.left == 0 || now < self.next {
            return None;
        }
        self.left -= 1;
        self.next = now.plus_ns(self.every_us * 1_000);
        *out = self.frame;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: BIT_RATE }
    }
}

/// A host without a lane, shared by the world and the test: for what only the protocol has.
#[derive(Clone)]
struct Bare(Arc<Mutex<CanHost>>);

impl Bare {
    fn new() -> Self {
        Self(Arc::new(Mutex::new(CanHost::new(&HostOptions::new(BIT_RATE)))))
    }

    fn host(&self) -> MutexGuard<'_, CanHost> {
        self.0.lock().unwrap()
    }
}

impl Timed for Bare {
    fn handle_timeout(&mut self, now: Instant) {
        self.host().handle_timeout(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.host().poll_timeout()
    }
}

impl Station<Can> for Bare {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.host().handle_input(now, unit);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.host().handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.host().poll_transmit(now, out)
    }

    fn line(&self) -> CanLine {
        self.host().line()
    }
}
