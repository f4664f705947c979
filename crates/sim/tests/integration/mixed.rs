//! Every protocol on one CAN bus at 1 Mbit/s, all axes under command all the time.
//!
//! A TS in profile velocity whose set-points and readings go with SYNC a thousand times a second, two
//! TechnoCAN axes that follow points (PVT), a TMCL module and two thrusters that are read and commanded,
//! each a hundred times a second. `POLEPAIR_BUS_SECONDS` sets the duration; a minute is usual, `make soak`
//! takes an hour.

use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, LineEvent, Station, Ticket, Timed};
use polepair_core::stream::{PathKind, Point};
use polepair_core::time::Instant;
use polepair_sim::can_bus::bits;
use polepair_sim::host;
use polepair_sim::node::CanStationNode;
use polepair_sim::rack::RackDrive;
use polepair_sim::world::{NodeId, WireId, World};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};

const BIT_RATE: u32 = 1_000_000;
/// Duration of the test in seconds, unless the environment states another.
const SECONDS: u64 = 60;
/// The shares of the bus that the plan of these drives has (`docs/examples/one-bus.toml`).
const PLANNED: std::ops::Range<f64> = 0.40..0.55;
/// Time between two points, s, and points that are handed over at once.
const POINT_S: f64 = 0.01;
const POINTS: usize = 32;
/// The axes, in the order of the lanes.
const SPINDLE: u8 = 0;
const X: u8 = 1;
const Y: u8 = 2;
const GRIPPER: u8 = 3;
const PORT: u8 = 4;
const STARBOARD: u8 = 5;

fn profile(name: &str) -> &'static Profile {
    polepair_drives::profiles().iter().find(|profile| profile.name == name).unwrap()
}

/// Protocol, product and number of each axis.
const DRIVES: [(&str, &str, u32); 6] = [
    ("canopen", "syntron-ts-canopen", 2),
    ("technocan", "technosoft-f514l", 5),
    ("technocan", "technosoft-f514l", 7),
    ("tmcl", "tmcm-171", 0x61),
    ("thruster", "thruster", 11),
    ("thruster", "thruster", 12),
];

/// Counts what goes over the bus, bit by bit: without a stuff bit, and with as many as can be.
#[derive(Default)]
struct Tally {
    frames: AtomicU64,
    least: AtomicU64,
    most: AtomicU64,
}

struct Ear(Arc<Tally>);

impl Timed for Ear {
    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl Station<Can> for Ear {
    fn handle_input(&mut self, _: Instant, frame: &Frame) {
        let (extended, bytes) = (frame.extended, frame.bytes().len() as u32);
        self.0.frames.fetch_add(1, Ordering::Relaxed);
        self.0.least.fetch_add(bits::unstuffed_bits(extended, bytes).into(), Ordering::Relaxed);
        self.0.most.fetch_add(bits::max_wire_bits(extended, bytes).into(), Ordering::Relaxed);
    }

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, _: Instant, _: &mut Frame) -> Option<usize> {
        None
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: BIT_RATE }
    }
}

/// A master that commands the spindle by process data: set-point, ramp speed and SYNC each millisecond.
struct Cycle {
    /// Target velocity, 0.1 rpm.
    target: Arc<AtomicI32>,
    next: Instant,
    frames: u16,
}

/// RPDOs 1 and 2 of the spindle.
const RPDOS: [u16; 2] = [0x202, 0x302];
const PERIOD_NS: u64 = 1_000_000;

impl Timed for Cycle {
    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }
}

impl Station<Can> for Cycle {
    fn handle_input(&mut self, _: Instant, _: &Frame) {}

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        if now < self.next {
            return None;
        }
        *out = match self.frames {
            0 => Frame::standard(RPDOS[0], &self.target.load(Ordering::Relaxed).to_le_bytes()),
            1 => Frame::standard(RPDOS[1], &3_000_u32.to_le_bytes()),
            _ => Frame::standard(0x080, &[]),
        };
        self.frames = (self.frames + 1) % 3;
        if self.frames == 0 {
            self.next = self.next.plus_ns(PERIOD_NS);
        }
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: BIT_RATE }
    }
}

struct Bus {
    world: World,
    wire: WireId,
    host: NodeId,
    drives: Vec<NodeId>,
    tally: Arc<Tally>,
    target: Arc<AtomicI32>,
    tickets: u32,
    /// Points of both paths that were handed over, and the path's tickets.
    fed: [u64; 2],
    paths: [Ticket; 2],
    ended: u64,
}

impl Bus {
    fn new() -> Self {
        let mut world = World::new(1);
        let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
        let build = |(protocol, name, address): &(&str, &str, u32)| {
            let mut spec = RackDrive::new(profile(name), protocol);
            spec.address = Some(*address);
            if *protocol == "canopen" {
                let extra = [("variant", "all"), ("fn00", "20"), ("can", "true")];
                spec.extra = extra.map(|(key, value)| (key.into(), value.into())).to_vec();
            }
            spec.build(&mut world, wire, false).unwrap()
        };
        let drives = DRIVES.iter().map(build).collect();
        let lane = |protocol: &'static str| {
            let own = DRIVES.iter().filter(|drive| drive.0 == protocol);
            let axes = own.map(|(_, name, address)| (profile(name), *address)).collect();
            (protocol, HostOptions::new(BIT_RATE), axes)
        };
        let lanes = ["canopen", "technocan", "tmcl", "thruster"].map(lane);
        let host = world.add_node(host::can_program(&lanes).unwrap());
        world.plug_host(wire, host, 0);
        let tally = Arc::new(Tally::default());
        let node_id = world.add_node(Box::new(CanStationNode(Ear(Arc::clone(&tally)))));
        world.plug_drive(wire, node_id, 0);
        let target = Arc::new(AtomicI32::new(0));
        let (tickets, fed, paths) = (0, [0; 2], [Ticket(0); 2]);
        let mut bus =
            Self { world, wire, host, drives, tally, target, tickets, fed, paths, ended: 0 };
        bus.pass(100);
        bus
    }

    fn pass(&mut self, ms: u32) {
        let until = self.world.now().plus_ms(ms);
        self.world.run_until(until);
    }

    fn start(
        &mut self,
        request: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Ticket {
        self.tickets = self.tickets.wrapping_add(1);
        let ticket = Ticket(self.tickets);
        let requested = |axes: &mut dyn Axes, now| request(axes, now, ticket);
        let taken =
            self.world.with_node(self.host, |node, now| requested(node.axes().unwrap(), now));
        taken.unwrap_or_else(|error| panic!("{ticket:?}: {error:?}"));
        ticket
    }

    /// Waits until every request is done; returns the tickets that were waited for.
    fn settle(&mut self) -> Vec<Ticket> {
        let mut done = Vec::new();
        let next = |node: &mut dyn polepair_sim::node::SimNode, _| node.axes()?.poll_outcome();
        while let Some((ticket, outcome)) = self.world.inspect(self.host, next) {
            assert!(matches!(outcome, Outcome::Done(_)), "{ticket:?}: {outcome:?}");
            self.ended += 1;
            done.push(ticket);
        }
        done
    }

    fn finish(&mut self, ticket: Ticket) {
        let limit = self.world.now().plus_ms(5_000);
        while !self.settle().contains(&ticket) {
            assert!(self.world.now() < limit, "{ticket:?} never ended");
            self.world.step();
        }
    }

    fn command(&mut self, axis: u8, command: Command) -> Ticket {
        self.start(|axes, now, ticket| {
            axes.set_armed(AxisIndex(axis), true);
            axes.command(now, ticket, AxisIndex(axis), command)
        })
    }

    fn turn(&mut self, axis: u8, rad_per_s: f64) -> Ticket {
        self.command(axis, Command { velocity: Some(rad_per_s), ..Command::new(Verb::Velocity) })
    }

    fn read_speed(&mut self, axis: u8) {
        let source = profile(DRIVES[usize::from(axis)].1).signal(Signal::Velocity).unwrap();
        self.start(|axes, now, ticket| {
            axes.read_parameter(now, ticket, AxisIndex(axis), source.parameter)
        });
    }

    /// Set-points with SYNC, and readings with it.
    fn map(&mut self) {
        let objects = [("rpdo 1", 0x60FF_0020), ("rpdo 2", 0x6081_0020)];
        let readings = [("tpdo 1", 0x6064_0020), ("tpdo 2", 0x606C_0020)];
        for (pdo, object) in objects.into_iter().chain(readings) {
            for (what, raw) in
                [("entries", 0), ("entry 1", object), ("entries", 1), ("transmission", 1)]
            {
                let id = profile(DRIVES[0].1).find_parameter(&format!("{pdo} {what}")).unwrap();
                let write = self.start(|axes, now, ticket| {
                    axes.write_parameter(now, ticket, AxisIndex(SPINDLE), id, raw, false)
                });
                self.finish(write);
            }
        }
    }

    fn begin(&mut self) {
        self.map();
        for axis in [X, Y, PORT, STARBOARD] {
            let enabled = self.command(axis, Command::new(Verb::Enable));
            self.finish(enabled);
        }
        for axis in [SPINDLE, GRIPPER, PORT, STARBOARD] {
            let turning = self.turn(axis, 10.0);
            self.finish(turning);
        }
        let (target, next) = (Arc::clone(&self.target), self.world.now());
        let cycle =
            self.world.add_node(Box::new(CanStationNode(Cycle { target, next, frames: 0 })));
        self.world.plug_host(self.wire, cycle, 0);
        for (n, axis) in [X, Y].into_iter().enumerate() {
            self.paths[n] = self.start(|axes, now, ticket| {
                axes.set_armed(AxisIndex(axis), true);
                axes.start_path(now, ticket, AxisIndex(axis), PathKind::Pvt)
            });
        }
    }

    /// Keeps both paths fed: sines of two seconds.
    fn feed(&mut self) {
        for n in 0..2 {
            let point = |k: u64| {
                let phase = std::f64::consts::PI * POINT_S * k as f64;
                let velocity = std::f64::consts::PI * phase.sin();
                Point { position: 1.0 - phase.cos(), velocity, time: POINT_S }
            };
            let points: Vec<_> = (self.fed[n] + 1..).take(POINTS).map(point).collect();
            let path = self.paths[n];
            let consumed = self.world.with_node(self.host, |node, _| {
                node.axes().and_then(|axes| axes.feed_points(path, &points, false))
            });
            self.fed[n] += consumed.expect("the path goes on") as u64;
        }
    }

    /// One second in which every drive gets a new command, and must have executed it at the end.
    fn second(&mut self, n: u64) {
        let speed = if n.is_multiple_of(2) { 20.0 } else { -20.0 };
        for axis in [GRIPPER, PORT, STARBOARD] {
            self.turn(axis, speed);
        }
        let target = speed * 600.0 / std::f64::consts::TAU;
        self.target.store(target as i32, Ordering::Relaxed);
        let way = [X, Y].map(|axis| self.at(axis));
        for ms in 0..1_000 {
            match ms % 10 {
                1 => self.feed(),
                3 => self.read_speed(GRIPPER),
                5 => self.read_speed(PORT),
                7 => self.read_speed(STARBOARD),
                _ => {}
            }
            self.pass(1);
            self.settle();
        }
        for axis in [SPINDLE, GRIPPER] {
            let turns = self.truth(axis).velocity;
            assert!((turns - speed).abs() < 1.5, "second {n}, axis {axis}: {turns} rad/s");
        }
        for axis in [PORT, STARBOARD] {
            let turns = self.truth(axis).velocity;
            assert!(turns * speed > 0.0, "second {n}, axis {axis}: {turns} rad/s");
        }
        // What was read is what was true, up to the steps of the reading.
        for axis in [GRIPPER, PORT, STARBOARD] {
            let read = self.world.inspect(self.host, |node, _| {
                node.axes().unwrap().state(AxisIndex(axis)).unwrap().reading(Signal::Velocity)
            });
            let turns = self.truth(axis).velocity;
            assert!((read.value - turns).abs() < 1.5, "second {n}, axis {axis}: {read:?}, {turns}");
        }
        for (axis, from) in [X, Y].into_iter().zip(way) {
            let execution = (self.at(axis) - from).abs();
            assert!(n < 2 || execution > 1.0, "second {n}, axis {axis} went {execution} rad");
        }
    }

    fn truth(&mut self, axis: u8) -> polepair_drives::surroundings::GroundTruth {
        let drive = self.drives[usize::from(axis)];
        self.world.inspect(drive, |node, now| node.surroundings().unwrap().ground_truth(now))
    }

    fn at(&mut self, axis: u8) -> f64 {
        self.truth(axis).position
    }
}

#[test]
fn every_protocol_shares_one_bus_for_as_long_as_is_asked() {
    let seconds = std::env::var("POLEPAIR_BUS_SECONDS").ok().and_then(|text| text.parse().ok());
    let seconds = seconds.unwrap_or(SECONDS);
    let mut bus = Bus::new();
    bus.begin();
    for n in 0..seconds {
        bus.second(n);
    }
    let counters = bus.world.inspect(bus.host, |node, _| node.axes().unwrap().counters());
    // Every lane receives all frames, so others' are foreign to it.
    assert_eq!((counters.late, counters.silent, counters.resent), (0, 0, 0), "{counters:?}");
    let made = bus.world.injected_can_faults(bus.wire);
    assert_eq!((made.collided, made.errors, made.bus_off), (0, 0, 0), "{made:?}");
    let load = bus.world.can_load(bus.wire);
    let share = |bits: &AtomicU64| {
        bits.load(Ordering::Relaxed) as f64 / f64::from(BIT_RATE) / (bus.world.now().0 as f64 / 1e9)
    };
    let (min, max) = (share(&bus.tally.least), share(&bus.tally.most));
    let frames = bus.tally.frames.load(Ordering::Relaxed);
    println!(
        "{seconds} s: {frames} frames, {} tickets, load {:.2} %, computed {:.2} to {:.2} %",
        bus.ended,
        load * 100.0,
        min * 100.0,
        max * 100.0
    );
    assert!((min..=max).contains(&load), "{load}: computed {min} to {max}");
    assert!(PLANNED.contains(&load), "{load}");
}
