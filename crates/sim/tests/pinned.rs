//! One world whose whole history is pinned: real hosts, drives of two protocols, motors that turn,
//! wires that fail. Another platform, another build or another day must give these very numbers,
//! or replays of seeds would be worth nothing. `make test` runs it in debug and in release.

use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::drives;
use polepair_core::drives::bench::Truth;
use polepair_core::error::Outcome;
use polepair_core::medium::MediumKind;
use polepair_core::profile::ParameterId;
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_sim::fault::{Faults, Made};
use polepair_sim::host;
use polepair_sim::rack::RackDrive;
use polepair_sim::random::{History, Ppm};
use polepair_sim::serial_line::Serial;
use polepair_sim::world::{NodeId, WireId, World};

const AXIS: AxisIndex = AxisIndex(0);
/// Steps of the script, and how far they are apart.
const STEPS: u32 = 500;
const STEP_MS: u32 = 40;
/// What everything adds up to. It changes with these drives and hosts only.
const PINNED: u64 = 0xFE8F_9243_D075_0DE0;

/// Something of everything.
const FAULTS: Faults = Faults {
    flip: Ppm(200),
    lose: Ppm(100),
    insert: Ppm(100),
    truncate: Ppm(2_000),
    chunk: Ppm(200_000),
    chunk_gap_us: 1_000,
    duplicate: Ppm(5_000),
    late: Ppm(5_000),
    patience_ms: 100,
    latest_ms: 200,
    lose_request: Ppm(5_000),
    lose_reply: Ppm(5_000),
    collide: Ppm(2_000),
    latency_ms: 1,
    ..Faults::NONE
};

/// A wire with a host at one end and a drive at the other.
struct Place {
    wire: WireId,
    host: NodeId,
    drive: NodeId,
}

impl Place {
    fn new(world: &mut World, protocol: &str, product: &str, set: Serial) -> Self {
        let profile = drives::profiles().iter().find(|p| p.name == product).expect(product);
        let spoken = host::protocols().into_iter().find(|p| p.name == protocol).expect(protocol);
        let wire = world.serial(set);
        let mut spec = RackDrive::new(profile, protocol);
        spec.address = Some(1);
        let drive = spec.build(world, wire, false).expect(product);
        let options = HostOptions::new(spoken.baud);
        let lane = host::lane(protocol, MediumKind::Serial, options, &[(profile, 1)]);
        let host = world.add(lane.expect(protocol));
        world.plug_host(wire, host, 0);
        *world.faults(wire).expect("serial") = FAULTS;
        Self { wire, host, drive }
    }

    /// What the script asks at a step; refusals are answers too.
    fn ask(&self, world: &mut World, step: u32) {
        let ticket = Ticket(step);
        world.with(self.host, |node, now| {
            let axes = node.axes().expect("a host");
            axes.arm(AXIS, true);
            match command(step) {
                Some(command) => axes.command(now, ticket, AXIS, command).is_ok(),
                None if step < 10 => make_ready(axes, now, ticket),
                None => read(axes, now, ticket, step),
            }
        });
    }

    fn tell(&self, world: &mut World, history: &mut History) {
        while let Some((ticket, outcome)) =
            world.look(self.host, |n, _| n.axes().expect("a host").poll_outcome())
        {
            history.note(u64::from(ticket.0));
            history.note(match outcome {
                Outcome::Done(raw) => raw as u64,
                Outcome::NotDone(_) => u64::MAX,
                Outcome::Unknown(_) => u64::MAX - 1,
            });
        }
    }

    fn truth(&self, world: &mut World) -> Truth {
        world.look(self.drive, |n, now| n.bench().expect("a drive").truth(now))
    }
}

fn command(step: u32) -> Option<Command> {
    let verb = match step % 100 {
        10 => Verb::MoveBy,
        40 => Verb::MoveTo,
        60 => Verb::Velocity,
        85 => Verb::Stop,
        _ => return None,
    };
    let target = matches!(verb, Verb::MoveBy | Verb::MoveTo).then_some(f64::from(step % 7) - 3.0);
    let velocity = (verb == Verb::Velocity).then_some(f64::from(step % 11));
    Some(Command { target, velocity, ..Command::new(verb) })
}

/// Internal position mode, where a drive has such a thing.
fn make_ready(axes: &mut dyn Axes, now: Instant, ticket: Ticket) -> bool {
    let profile = axes.profile(AXIS).expect("an axis");
    let mode = profile.parameters.iter().position(|p| p.name == "control mode");
    let id = mode.and_then(|at| u16::try_from(at).ok()).map(ParameterId);
    id.is_some_and(|id| axes.write(now, ticket, AXIS, id, 14, false).is_ok())
}

fn read(axes: &mut dyn Axes, now: Instant, ticket: Ticket, step: u32) -> bool {
    let signals = axes.profile(AXIS).expect("an axis").signals;
    let signal = signals[step as usize % signals.len()];
    axes.read(now, ticket, AXIS, signal.parameter).is_ok()
}

#[test]
fn a_world_with_motors_and_faults_is_the_same_everywhere() {
    let mut world = World::new(20);
    let places = [
        Place::new(&mut world, "tmcl", "tmcm-171", Serial::RS485),
        Place::new(&mut world, "modbus-rtu", "syntron-ts", Serial::RS485),
        Place::new(&mut world, "modbus-ascii", "syntron-ds102", Serial::RS232),
    ];
    let mut history = History::default();
    for step in 1..=STEPS {
        world.run_until(Instant::ZERO.plus_ms(step * STEP_MS));
        for place in &places {
            place.tell(&mut world, &mut history);
            place.ask(&mut world, step);
        }
    }
    for place in &places {
        let truth = place.truth(&mut world);
        assert!(truth.starts > 5 && truth.position.abs() > 0.1, "{truth:?}");
        assert_ne!(world.made(place.wire), Made::default());
        for value in [truth.position, truth.velocity, truth.current, truth.winding] {
            history.note(value.to_bits());
        }
    }
    history.note(world.history());
    assert_eq!(history.value(), PINNED, "{:#018X}", history.value());
}
