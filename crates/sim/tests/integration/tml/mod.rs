//! TML from both ends, in virtual time: the rules of the manual's chapters, and faults.

mod clash;
mod resend;
mod setup;
mod verbs;

use polepair_core::axis::{Axes, Command, GroupAnswer, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::{GROUP, HostOptions, SerialStandard};
use polepair_core::station::{AxisIndex, Counters, Ticket};
use polepair_core::stream::{PathKind, Point};
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, GroundTruth};
use polepair_drives::technosoft::{Device, Technosoft};
use polepair_drives::{DeviceOptions, Family};
use polepair_sim::host;
use polepair_sim::node::{CAN_PORT, DriveNode, SERIAL_PORT};
use polepair_sim::random::Ppm;
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::world::{NodeId, WireId, World};

const BIT_RATE: u32 = 500_000;

/// A world with one host and some drives.
struct Bench {
    world: World,
    host: NodeId,
    drives: Vec<NodeId>,
    wire: WireId,
    tickets: u32,
    parts: Vec<(u32, i64)>,
    /// Messages of the host that the wire loses, by their place among all that it sends.
    losing: Vec<u64>,
    /// Number of frames before the next loss.
    lost_before: u64,
    /// Happens when one was lost.
    act_at_loss: Option<Act>,
}

fn profile() -> &'static Profile {
    Technosoft::profiles()[0]
}

fn device(address: u32, extra: &[(&str, &str)]) -> Box<DriveNode<Device>> {
    let wires = &["tml", "tmlcan"];
    let options = DeviceOptions {
        address: Some(address),
        wires,
        standard: None,
        untimed: false,
        seed: 1,
        extra,
    };
    Box::new(DriveNode(Technosoft::create_device(profile(), &options).unwrap()))
}

fn lane(
    protocol: &str,
    options: HostOptions,
    axes: &[u32],
) -> Box<dyn polepair_sim::node::SimNode> {
    let medium = if protocol == "tml" { MediumKind::Serial } else { MediumKind::Can };
    let axes: Vec<_> = axes.iter().map(|axis| (profile(), *axis)).collect();
    host::host_lane(protocol, medium, options, &axes).unwrap()
}

impl Bench {
    /// A host on RS-232 with the first axis, the others behind it on a bus of that kind.
    fn relay(bus: &str, axes: &[u32]) -> Self {
        Self::relay_at(9600, bus, axes)
    }

    fn relay_at(baud: u32, bus: &str, axes: &[u32]) -> Self {
        let mut world = World::new(1);
        let (wire, can) = (
            world.add_serial(SerialWireConfig::RS232),
            world.add_can(CanLine { bit_rate: BIT_RATE }),
        );
        let host = world.add_node(lane("tml", HostOptions::new(baud), axes));
        world.plug_host(wire, host, 0);
        let single: Vec<u32> = axes.iter().copied().filter(|axis| axis & GROUP == 0).collect();
        let mut drives = Vec::new();
        for (n, axis) in single.iter().enumerate() {
            let drive = world.add_node(device(*axis, &[("can", bus), ("baud", &baud.to_string())]));
            if n == 0 {
                world.plug_drive(wire, drive, SERIAL_PORT);
            }
            world.plug_drive(can, drive, CAN_PORT);
            drives.push(drive);
        }
        Self::of(world, wire, host, drives)
    }

    /// A host on RS-485 with all axes.
    fn rs485(options: HostOptions, axes: &[u32], on_line: &[u32]) -> Self {
        let mut world = World::new(1);
        let wire = world.add_serial(SerialWireConfig::RS485);
        let options = HostOptions { standard: Some(SerialStandard::Rs485), ..options };
        let host = world.add_node(lane("tml", options, axes));
        world.plug_host(wire, host, 0);
        let mut drives = Vec::new();
        for axis in on_line {
            let drive = world.add_node(device(*axis, &[("wire", "rs485")]));
            world.plug_drive(wire, drive, SERIAL_PORT);
            drives.push(drive);
        }
        Self::of(world, wire, host, drives)
    }

    /// A host on CAN.
    fn can(bus: &str, options: HostOptions, axes: &[u32], on_bus: &[u32]) -> Self {
        Self::drifting("0", bus, options, axes, on_bus)
    }

    /// Error of the drives' clocks, parts per million.
    fn drifting(ppm: &str, bus: &str, options: HostOptions, axes: &[u32], on_bus: &[u32]) -> Self {
        let mut world = World::new(1);
        let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
        let host = world.add_node(lane(bus, options, axes));
        world.plug_host(wire, host, 0);
        let mut drives = Vec::new();
        for axis in on_bus {
            let drive = world.add_node(device(*axis, &[("can", bus), ("clock-ppm", ppm)]));
            world.plug_drive(wire, drive, CAN_PORT);
            drives.push(drive);
        }
        Self::of(world, wire, host, drives)
    }

    fn of(world: World, wire: WireId, host: NodeId, drives: Vec<NodeId>) -> Self {
        let mut bench = Self {
            world,
            host,
            drives,
            wire,
            tickets: 0,
            parts: Vec::new(),
            losing: Vec::new(),
            lost_before: 0,
            act_at_loss: None,
        };
        bench.world.run_until(Instant::ZERO.plus_ms(50));
        bench
    }

    fn axes<R>(&mut self, f: impl FnOnce(&mut dyn Axes, Instant) -> R) -> R {
        self.world.with_node(self.host, |node, now| f(node.axes().unwrap(), now))
    }

    /// Starts something and lives on until it ends.
    fn run(
        &mut self,
        start: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Outcome {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        self.axes(|axes, now| start(axes, now, ticket)).unwrap();
        let limit = self.world.now().plus_ms(700_000);
        while self.world.now() < limit {
            self.world.step();
            self.apply_losses();
            let (outcome, parts) = self.axes(|axes, _| {
                let outcome = axes.poll_outcome();
                (
                    outcome,
                    std::iter::from_fn(|| axes.poll_group_answer(ticket))
                        .collect::<Vec<GroupAnswer>>(),
                )
            });
            self.parts.extend(parts.iter().map(|part| (part.address, part.raw)));
            match outcome {
                Some((ended, outcome)) if ended == ticket => return outcome,
                Some((ended, _)) => panic!("{ended:?} ended"),
                None => {}
            }
        }
        panic!("nothing ended")
    }

    fn read(&mut self, axis: u8, name: &str) -> Outcome {
        let id = profile().find_parameter(name).unwrap();
        self.run(|axes, now, ticket| axes.read_parameter(now, ticket, AxisIndex(axis), id))
    }

    fn write(&mut self, axis: u8, name: &str, raw: i64) -> Outcome {
        let id = profile().find_parameter(name).unwrap();
        self.axes(|axes, _| axes.set_armed(AxisIndex(axis), true));
        self.run(|axes, now, ticket| {
            axes.write_parameter(now, ticket, AxisIndex(axis), id, raw, false)
        })
    }

    fn command(&mut self, axis: u8, command: Command) -> Outcome {
        self.axes(|axes, _| axes.set_armed(AxisIndex(axis), true));
        self.run(|axes, now, ticket| axes.command(now, ticket, AxisIndex(axis), command))
    }

    fn verb(&mut self, axis: u8, verb: Verb) -> Outcome {
        self.command(axis, Command::new(verb))
    }

    fn raw(&mut self, axis: u8, text: &str) -> Outcome {
        self.axes(|axes, _| axes.set_armed(AxisIndex(axis), true));
        self.run(|axes, now, ticket| axes.send_text(now, ticket, AxisIndex(axis), text))
    }

    fn truth(&mut self, drive: usize) -> GroundTruth {
        self.world
            .inspect(self.drives[drive], |node, now| node.surroundings().unwrap().ground_truth(now))
    }

    fn counters(&mut self) -> Counters {
        self.axes(|axes, _| axes.counters())
    }
}

fn velocity(rad_per_s: f64) -> Command {
    Command { velocity: Some(rad_per_s), ..Command::new(Verb::Velocity) }
}

#[track_caller]
fn done(outcome: Outcome) -> bool {
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
    true
}

const fn hint(outcome: Outcome) -> Option<&'static str> {
    match outcome {
        Outcome::NotDone(Failure::NotReady { hint })
        | Outcome::Partly(Failure::NotReady { hint }, _) => Some(hint),
        _ => None,
    }
}

const fn rule(outcome: Outcome) -> Option<&'static str> {
    match outcome {
        Outcome::NotDone(Failure::Impossible(Unsupported::Forbidden(rule))) => Some(rule),
        _ => None,
    }
}

#[test]
fn a_host_reads_the_gain_of_an_axis_behind_the_relay() {
    for bus in ["tmlcan", "technocan"] {
        let mut bench = Bench::relay(bus, &[255, 1]);
        assert_eq!(bench.write(1, "KPP", 999), Outcome::Done(999), "{bus}");
        assert_eq!(bench.read(1, "KPP"), Outcome::Done(999), "{bus}");
        assert_ne!(bench.read(0, "KPP"), Outcome::Done(999), "the relay's own is another");
        let counters = bench.counters();
        assert_eq!((counters.resent, counters.silent, counters.late), (0, 0, 0));
    }
}

#[test]
fn a_group_answers_in_the_order_of_its_ids() {
    let options = HostOptions { host_address: Some(3), ..HostOptions::new(BIT_RATE) };
    let mut bench = Bench::can("tmlcan", options, &[5, 7, GROUP | 1], &[7, 5]);
    assert_eq!(bench.read(2, "axis address"), Outcome::NotDone(bench_differs()));
    assert_eq!(bench.parts, [(5, 0x0105), (7, 0x0107)]);
    bench.parts.clear();
    assert_eq!(bench.read(2, "POSERR"), Outcome::Done(0));
    assert_eq!(bench.parts.iter().map(|part| part.0).collect::<Vec<_>>(), [5, 7]);
}

fn bench_differs() -> Failure {
    Failure::NotReady {
        hint: "the drives of this group have different values of a parameter that is needed; \
               command them one by one, or make them equal",
    }
}

#[test]
fn an_axis_tells_unasked_that_it_arrived() {
    let mut bench = Bench::relay("tmlcan", &[255, 1]);
    assert_eq!(bench.write(1, "SRL_MASK", 0x0400), Outcome::Done(0x0400));
    assert!(done(bench.verb(1, Verb::Enable)));
    let motion = Command {
        target: Some(1.0),
        velocity: Some(20.0),
        acceleration: Some(500.0),
        ..Command::new(Verb::MoveTo)
    };
    assert!(done(bench.command(1, motion)));
    let reached = |bench: &mut Bench| {
        bench.axes(|axes, _| axes.state(AxisIndex(1)).unwrap().reading(Signal::Reached))
    };
    assert_eq!(reached(&mut bench).raw, 0);
    let until = bench.world.now().plus_ms(2000);
    bench.world.run_until(until);
    assert_eq!(reached(&mut bench).raw, 1, "nobody asked");
    assert!((bench.truth(1).position - 1.0).abs() < 0.01);
}

#[test]
fn a_motor_turns_on_every_wire() {
    let can = HostOptions::new(BIT_RATE);
    let mut benches = [
        Bench::relay("tmlcan", &[1]),
        Bench::relay("tmlcan", &[255, 1]),
        Bench::rs485(HostOptions::new(9600), &[1], &[1]),
        Bench::can("tmlcan", can, &[1], &[1]),
        Bench::can("technocan", can, &[1], &[1]),
    ];
    for (n, bench) in benches.iter_mut().enumerate() {
        let (axis, drive) = if n == 1 { (1, 1) } else { (0, 0) };
        assert!(done(bench.verb(axis, Verb::Enable)), "{n}");
        assert!(done(bench.command(axis, velocity(30.0))), "{n}");
        let until = bench.world.now().plus_ms(2000);
        bench.world.run_until(until);
        assert!((bench.truth(drive).velocity - 30.0).abs() < 1.0, "{n}: {:?}", bench.truth(drive));
        assert!(done(bench.verb(axis, Verb::Stop)), "{n}");
        assert!(bench.truth(drive).velocity.abs() < 1.0, "{n}");
        assert!(done(bench.verb(axis, Verb::Disable)), "{n}");
        assert!(!bench.truth(drive).enabled, "{n}");
        assert_eq!(bench.counters().silent, 0, "{n}");
    }
}

#[test]
fn a_question_to_a_group_on_rs485_is_refused_before_a_byte_is_sent() {
    let mut bench = Bench::rs485(HostOptions::new(9600), &[5, 7, GROUP | 1], &[5, 7]);
    let outcome = bench.read(2, "POSERR");
    assert!(rule(outcome).is_some_and(|rule| rule.contains("would collide")), "{outcome:?}");
    let outcome = bench.write(0, "SRL_MASK", 0x0400);
    assert!(rule(outcome).is_some_and(|rule| rule.contains("no drive speaks unasked")));
    assert_eq!(bench.counters().sent, 0);
}

#[test]
fn behind_a_technocan_relay_no_drive_sends_unasked() {
    let options = HostOptions { relay_axis_max: Some(31), ..HostOptions::new(9600) };
    let mut world = World::new(1);
    let (wire, can) =
        (world.add_serial(SerialWireConfig::RS232), world.add_can(CanLine { bit_rate: BIT_RATE }));
    let host = world.add_node(lane("tml", options, &[255, 1, GROUP | 1]));
    world.plug_host(wire, host, 0);
    let drives: Vec<NodeId> = [255, 1]
        .iter()
        .map(|axis| {
            let drive = world.add_node(device(*axis, &[("can", "technocan")]));
            world.plug_drive(can, drive, CAN_PORT);
            drive
        })
        .collect();
    world.plug_drive(wire, drives[0], SERIAL_PORT);
    let mut bench = Bench::of(world, wire, host, drives);
    for outcome in [bench.read(2, "MER"), bench.write(1, "SRL_MASK", 0x0400)] {
        assert!(rule(outcome).is_some_and(|rule| rule.contains("no drive receives TakeData2")));
    }
    assert_eq!(bench.counters().sent, 0);
    assert_eq!(bench.read(1, "KPP"), Outcome::Done(288), "one axis is asked as ever");
}

#[test]
fn the_wrong_host_id_is_refused_with_its_reason() {
    let wrong = HostOptions { host_address: Some(5), ..HostOptions::new(BIT_RATE) };
    let mut bench = Bench::can("tmlcan", wrong, &[5], &[5]);
    let outcome = bench.read(0, "KPP");
    assert!(rule(outcome).is_some_and(|rule| rule.contains("an axis ID that no drive has")));
    assert_eq!(bench.counters().sent, 0);
    let _ = bench.wire;
}

/// Streams a sine of this many points and returns how it ended.
fn stream(bench: &mut Bench, axis: u8, count: usize, time: f64) -> Outcome {
    stream_as(PathKind::Pvt, bench, axis, count, time)
}

fn stream_as(kind: PathKind, bench: &mut Bench, axis: u8, count: usize, time: f64) -> Outcome {
    let path = |n: usize| {
        let phase = n as f64 / 50.0;
        let end = n == count;
        let speed = 2.0 * phase.sin() / (50.0 * time);
        let position = 2.0 * (1.0 - phase.cos());
        Point { position, velocity: if end { 0.0 } else { speed }, time }
    };
    bench.tickets += 1;
    let ticket = Ticket(bench.tickets);
    bench.axes(|axes, now| {
        axes.set_armed(AxisIndex(axis), true);
        axes.start_path(now, ticket, AxisIndex(axis), kind).unwrap();
    });
    let (mut fed, limit) = (0, bench.world.now().plus_ms(1_000_000));
    while bench.world.now() < limit {
        let points: Vec<Point> = (fed + 1..=count).take(64).map(path).collect();
        let complete = fed + points.len() == count;
        let consumed = bench.axes(|axes, _| axes.feed_points(ticket, &points, complete));
        fed += consumed.unwrap_or(0);
        let until = bench.world.now().plus_ms(50);
        bench.world.run_until(until);
        if let Some((_, outcome)) = bench.axes(|axes, _| axes.poll_outcome()) {
            return outcome;
        }
    }
    panic!("the path never ended")
}

#[test]
fn ten_thousand_points_arrive_with_their_counter_whole() {
    let can = HostOptions::new(BIT_RATE);
    let benches = [
        // A point of 20 ms at 9600 baud is as fast as the line can be.
        (Bench::relay("tmlcan", &[1]), 10_000, 0.020),
        (Bench::relay("tmlcan", &[255, 1]), 500, 0.025),
        (Bench::drifting("900", "technocan", can, &[1], &[1]), 1_000, 0.010),
        (Bench::drifting("-900", "tmlcan", can, &[1], &[1]), 1_000, 0.010),
    ];
    for (n, (mut bench, count, time)) in benches.into_iter().enumerate() {
        let (axis, drive) = if n == 1 { (1, 1) } else { (0, 0) };
        assert!(done(bench.verb(axis, Verb::Enable)), "{n}");
        let started_at = bench.world.now();
        assert_eq!(stream(&mut bench, axis, count, time), Outcome::Done(count as i64), "{n}");
        let took = bench.world.now().since(started_at).as_secs_f64();
        assert!((took - count as f64 * time).abs() < 2.0, "{n}: {took} s");
        let end = 2.0 * (1.0 - (count as f64 / 50.0).cos());
        assert!((bench.truth(drive).position - end).abs() < 0.02, "{n}: {:?}", bench.truth(drive));
        assert_eq!(bench.counters().silent, 0);
    }
}

#[test]
fn ten_thousand_points_go_at_115200_baud() {
    let mut bench = Bench::relay_at(115_200, "tmlcan", &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    assert_eq!(stream(&mut bench, 0, 10_000, 0.005), Outcome::Done(10_000));
    // PVTSTS: neither a wrong counter (12) nor a stop for want of points (11).
    let Outcome::Done(status) = bench.read(0, "PVTSTS") else { panic!("no PVTSTS") };
    assert_eq!(status & 0x1800, 0, "{status:#x}");
    let end = 2.0 * (1.0 - (10_000.0_f64 / 50.0).cos());
    assert!((bench.truth(0).position - end).abs() < 0.02, "{:?}", bench.truth(0));
    assert_eq!(bench.counters().silent, 0);
}

#[test]
fn points_without_speeds_go_on_every_wire() {
    let can = HostOptions::new(BIT_RATE);
    let benches = [
        Bench::relay("tmlcan", &[1]),
        Bench::rs485(HostOptions::new(9600), &[1], &[1]),
        Bench::can("tmlcan", can, &[1], &[1]),
        Bench::can("technocan", can, &[1], &[1]),
    ];
    for (n, mut bench) in benches.into_iter().enumerate() {
        assert!(done(bench.verb(0, Verb::Enable)), "{n}");
        let outcome = stream_as(PathKind::Pt, &mut bench, 0, 500, 0.040);
        assert_eq!(outcome, Outcome::Done(500), "{n}");
        let end = 2.0 * (1.0 - (500.0_f64 / 50.0).cos());
        assert!((bench.truth(0).position - end).abs() < 0.02, "{n}: {:?}", bench.truth(0));
        assert_eq!(bench.counters().silent, 0, "{n}");
    }
}

#[test]
fn a_point_whose_acknowledgement_is_lost_is_sent_once() {
    let mut bench = Bench::relay("tmlcan", &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    // One transmission in a hundred is lost, questions and acknowledgements alike.
    if let Some(faults) = bench.world.serial_faults(bench.wire) {
        (faults.lose_request, faults.lose_reply) = (Ppm(3_000), Ppm(3_000));
    }
    let outcome = stream(&mut bench, 0, 500, 0.060);
    if let Some(faults) = bench.world.serial_faults(bench.wire) {
        *faults = polepair_sim::fault::SerialFaults::default();
    }
    assert_eq!(outcome, Outcome::Done(500));
    assert!(bench.counters().silent > 0, "{:?}", bench.counters());
    let end = 2.0 * (1.0 - (500.0_f64 / 50.0).cos());
    assert!((bench.truth(0).position - end).abs() < 0.02, "{:?}", bench.truth(0));
}

#[test]
fn a_stop_ends_a_path() {
    let mut bench = Bench::relay("tmlcan", &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    let ticket = Ticket(900);
    bench.axes(|axes, now| axes.start_path(now, ticket, AxisIndex(0), PathKind::Pvt).unwrap());
    let far: Vec<Point> = (1..=400)
        .map(|n| Point { position: f64::from(n) * 0.2, velocity: 10.0, time: 0.02 })
        .collect();
    assert_eq!(bench.axes(|axes, _| axes.feed_points(ticket, &far, false)), Some(400));
    let until = bench.world.now().plus_ms(500);
    bench.world.run_until(until);
    assert!((bench.truth(0).velocity - 10.0).abs() < 1.0);
    bench.axes(|axes, now| {
        axes.command(now, Ticket(901), AxisIndex(0), Command::new(Verb::Stop)).unwrap();
    });
    let until = bench.world.now().plus_ms(500);
    bench.world.run_until(until);
    assert!(bench.truth(0).velocity.abs() < 0.5, "{:?}", bench.truth(0));
    let mut ends: Vec<_> =
        bench.axes(|axes, _| std::iter::from_fn(|| axes.poll_outcome()).collect());
    ends.sort_by_key(|(ticket, _)| ticket.0);
    assert_eq!(ends[0], (ticket, Outcome::Unknown(Failure::Cancelled)));
    assert!(matches!(ends[1], (Ticket(901), Outcome::Done(_))));
    assert_eq!(bench.axes(|axes, _| axes.feed_points(ticket, &far, false)), None);
}

#[test]
fn a_path_that_starves_is_reported() {
    let mut bench = Bench::can("tmlcan", HostOptions::new(BIT_RATE), &[1], &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    let ticket = Ticket(900);
    bench.axes(|axes, now| axes.start_path(now, ticket, AxisIndex(0), PathKind::Pvt).unwrap());
    let few: Vec<Point> = (1..=20)
        .map(|n| Point { position: f64::from(n) * 0.2, velocity: 10.0, time: 0.02 })
        .collect();
    bench.axes(|axes, _| axes.feed_points(ticket, &few, false));
    let until = bench.world.now().plus_ms(3000);
    bench.world.run_until(until);
    let outcome = bench.axes(|axes, _| axes.poll_outcome());
    let Some((_, Outcome::Unknown(Failure::NotReady { hint }))) = outcome else {
        panic!("{outcome:?}")
    };
    assert!(hint.contains("ran out of points"));
    assert!(bench.truth(0).velocity.abs() < 0.5);
}

#[test]
fn a_group_starts_at_once_with_one_message() {
    let options = HostOptions::new(BIT_RATE);
    let mut bench = Bench::can("tmlcan", options, &[5, 7, GROUP | 1], &[5, 7]);
    assert!(done(bench.verb(2, Verb::Enable)));
    assert!(bench.truth(0).enabled && bench.truth(1).enabled);
    assert!(done(bench.command(2, velocity(20.0))));
    let until = bench.world.now().plus_ms(1000);
    bench.world.run_until(until);
    let (a, b) = (bench.truth(0), bench.truth(1));
    assert!((a.velocity - 20.0).abs() < 1.0 && (a.position - b.position).abs() < 0.02);
    assert!(done(bench.verb(2, Verb::Stop)));
    assert!(bench.truth(0).velocity.abs() < 1.0 && bench.truth(1).velocity.abs() < 1.0);
}

#[test]
fn setsync_keeps_ten_drives_within_a_slow_loop() {
    let mut world = World::new(1);
    let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
    let axes: Vec<u32> = (1..=10).collect();
    let with_group: Vec<u32> = axes.iter().copied().chain([GROUP | 1]).collect();
    let host = world.add_node(lane("tmlcan", HostOptions::new(BIT_RATE), &with_group));
    world.plug_host(wire, host, 0);
    let mut drives = Vec::new();
    for axis in &axes {
        let ppm = (i64::from(*axis) * 180 - 990).to_string();
        let drive = world.add_node(device(*axis, &[("can", "tmlcan"), ("clock-ppm", &ppm)]));
        world.plug_drive(wire, drive, CAN_PORT);
        drives.push(drive);
    }
    let mut bench = Bench::of(world, wire, host, drives);
    for axis in 0..10 {
        assert!(done(bench.raw(axis, "ENDINIT")));
    }
    assert!(done(bench.raw(0, "SETSYNC 20")));
    let until = bench.world.now().plus_ms(20_000);
    bench.world.run_until(until);
    // One question to all of them, so that all look at their clocks at the same time.
    let _ = bench.read(10, "ATIME");
    let times: Vec<i64> = bench.parts.iter().map(|(_, time)| *time).collect();
    let (min, max) = (times.iter().min().unwrap(), times.iter().max().unwrap());
    assert_eq!(times.len(), 10);
    assert!(max - min <= 1, "{times:?}");
    assert!(*min > 19_900);
}
