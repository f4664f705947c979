//! Two worlds whose whole history is pinned, one of serial wires and one with a CAN bus: real hosts,
//! drives of every protocol, motors that turn, wires that fail. Another platform, another build or
//! another day must give these very numbers, or replays of seeds would be worth nothing.
//! `make test` runs them in debug and in release.
//!
//! A program of its own: it alone is built for release as well.

use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::error::Outcome;
use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::profile::ParameterId;
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_drives::surroundings::GroundTruth;
use polepair_sim::can_bus::{CanFaults, InjectedCanFaults};
use polepair_sim::fault::{InjectedSerialFaults, SerialFaults};
use polepair_sim::host;
use polepair_sim::rack::RackDrive;
use polepair_sim::random::{HistoryHash, Ppm};
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::world::{NodeId, WireId, World};

const AXIS: AxisIndex = AxisIndex(0);
/// Steps of the script, and how far they are apart.
const STEPS: u32 = 500;
const STEP_MS: u32 = 40;
/// Checksum over everything. It changes with these drives and hosts only.
const PINNED: u64 = 0xDAA0_E887_D2AD_5CD1;
const PINNED_ON_CAN: u64 = 0x900C_1BA1_E865_D3E3;
const BIT_RATE: u32 = 1_000_000;
/// The variant with CANopen, in the mode that obeys it.
const TS_ON_CAN: [(&str, &str); 3] = [("variant", "all"), ("fn00", "20"), ("can", "true")];

/// Something of everything.
const FAULTS: SerialFaults = SerialFaults {
    flip: Ppm(200),
    lose: Ppm(100),
    insert: Ppm(100),
    truncate: Ppm(2_000),
    chunk: Ppm(200_000),
    chunk_gap_us: 1_000,
    duplicate: Ppm(5_000),
    late: Ppm(5_000),
    host_timeout_ms: 100,
    late_max_ms: 200,
    lose_request: Ppm(5_000),
    lose_reply: Ppm(5_000),
    collide: Ppm(2_000),
    latency_ms: 1,
    ..SerialFaults::NONE
};

/// Faults of a bus.
const CAN_FAULTS: CanFaults = CanFaults {
    error: Ppm(20_000),
    last_bit: Ppm(2_000),
    lose: Ppm(5_000),
    late: Ppm(2_000),
    late_max_ms: 150,
    cut: Ppm(2_000),
    echo: true,
};

/// A host and a drive on a wire.
struct WorldPart {
    wire: WireId,
    host: NodeId,
    drive: NodeId,
}

impl WorldPart {
    fn new(world: &mut World, protocol: &str, product: &str, set: SerialWireConfig) -> Self {
        let profile =
            polepair_drives::profiles().iter().find(|p| p.name == product).expect(product);
        let host_protocol =
            host::protocols().into_iter().find(|p| p.name == protocol).expect(protocol);
        let wire = world.add_serial(set);
        let mut spec = RackDrive::new(profile, protocol);
        spec.address = Some(1);
        let drive = spec.build(world, wire, false).expect(product);
        let options = HostOptions::new(host_protocol.baud);
        let lane = host::host_lane(protocol, MediumKind::Serial, options, &[(profile, 1)]);
        let host = world.add_node(lane.expect(protocol));
        world.plug_host(wire, host, 0);
        *world.serial_faults(wire).expect("serial") = FAULTS;
        Self { wire, host, drive }
    }

    /// On a bus that others are on, too.
    fn on_bus(
        world: &mut World,
        wire: WireId,
        (word, product, address): (&str, &str, u32),
        options: &[(&str, &str)],
    ) -> Self {
        let profile =
            polepair_drives::profiles().iter().find(|p| p.name == product).expect(product);
        let mut spec = RackDrive::new(profile, word);
        spec.address = Some(address);
        spec.extra =
            options.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect();
        let drive = spec.build(world, wire, false).expect(product);
        let host =
            host::can_program(&[(word, HostOptions::new(BIT_RATE), vec![(profile, address)])]);
        let host = world.add_node(host.expect(word));
        world.plug_host(wire, host, 0);
        Self { wire, host, drive }
    }

    /// Submits the request of a step; refusals are results too.
    fn submit_step(&self, world: &mut World, step: u32) {
        let ticket = Ticket(step);
        let on_bus = world.bit_rate(self.wire) > 0;
        world.with_node(self.host, |node, now| {
            let axes = node.axes().expect("a host");
            axes.set_armed(AXIS, true);
            match command(step) {
                Some(command) => axes.command(now, ticket, AXIS, command).is_ok(),
                // Anew after each stop: what was lost on the way may have been the last one.
                None if step % 100 < 10 && on_bus => {
                    axes.command(now, ticket, AXIS, Command::new(Verb::Enable)).is_ok()
                }
                None if step < 10 => set_mode(axes, now, ticket),
                None => read(axes, now, ticket, step),
            }
        });
    }

    fn add_events(&self, world: &mut World, history: &mut HistoryHash) {
        while let Some((ticket, outcome)) =
            world.inspect(self.host, |n, _| n.axes().expect("a host").poll_outcome())
        {
            history.add(u64::from(ticket.0));
            history.add(match outcome {
                Outcome::Done(raw) => raw as u64,
                Outcome::NotDone(_) => u64::MAX,
                Outcome::Unknown(_) | Outcome::Partly(..) => u64::MAX - 1,
            });
        }
    }

    fn truth(&self, world: &mut World) -> GroundTruth {
        world.inspect(self.drive, |n, now| n.surroundings().expect("a drive").ground_truth(now))
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
fn set_mode(axes: &mut dyn Axes, now: Instant, ticket: Ticket) -> bool {
    let profile = axes.profile(AXIS).expect("an axis");
    let mode = profile.parameters.iter().position(|p| p.name == "control mode");
    let id = mode.and_then(|at| u16::try_from(at).ok()).map(ParameterId);
    id.is_some_and(|id| axes.write_parameter(now, ticket, AXIS, id, 14, false).is_ok())
}

fn read(axes: &mut dyn Axes, now: Instant, ticket: Ticket, step: u32) -> bool {
    let signals = axes.profile(AXIS).expect("an axis").signals;
    let signal = signals[step as usize % signals.len()];
    axes.read_parameter(now, ticket, AXIS, signal.parameter).is_ok()
}

/// Lives through the script; the hash over all of it.
fn run_world(mut world: World, places: &[WorldPart]) -> u64 {
    let mut history = HistoryHash::default();
    for step in 1..=STEPS {
        world.run_until(Instant::ZERO.plus_ms(step * STEP_MS));
        for position in places {
            position.add_events(&mut world, &mut history);
            position.submit_step(&mut world, step);
        }
    }
    for (n, position) in places.iter().enumerate() {
        let truth = position.truth(&mut world);
        assert!(truth.starts >= 4 && truth.position.abs() > 0.1, "{n}: {truth:?}");
        let made = (world.injected_faults(position.wire), world.injected_can_faults(position.wire));
        assert_ne!(made, (InjectedSerialFaults::default(), InjectedCanFaults::default()));
        for value in [truth.position, truth.velocity, truth.current, truth.winding] {
            history.add(value.to_bits());
        }
    }
    history.add(world.history());
    history.value()
}

#[test]
fn a_world_with_motors_and_faults_is_the_same_everywhere() {
    let mut world = World::new(20);
    let places = [
        WorldPart::new(&mut world, "tmcl", "tmcm-171", SerialWireConfig::RS485),
        WorldPart::new(&mut world, "modbus-rtu", "syntron-ts", SerialWireConfig::RS485),
        WorldPart::new(&mut world, "modbus-ascii", "syntron-ds102", SerialWireConfig::RS232),
    ];
    let history = run_world(world, &places);
    assert_eq!(history, PINNED, "{history:#018X}");
}

#[test]
fn so_is_a_bus_with_every_protocol() {
    let mut world = World::new(21);
    let bus = world.add_can(CanLine { bit_rate: BIT_RATE });
    *world.can_faults(bus).expect("a bus") = CAN_FAULTS;
    let mut on = |drive, options: &[_]| WorldPart::on_bus(&mut world, bus, drive, options);
    let places = [
        on(("tmcl", "tmcm-171", 1), &[]),
        on(("tmlcan", "technosoft-fa00g", 3), &[]),
        on(("technocan", "technosoft-f514l", 17), &[]),
        on(("canopen", "cia402", 33), &[]),
        on(("canopen", "syntron-ts-canopen", 34), &TS_ON_CAN),
        on(("thruster", "thruster", 11), &[]),
    ];
    let history = run_world(world, &places);
    assert_eq!(history, PINNED_ON_CAN, "{history:#018X}");
}
