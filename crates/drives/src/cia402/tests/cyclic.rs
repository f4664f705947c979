//! Eight drives that follow the host's SYNC: positions, speeds, torques, and what goes wrong.

extern crate std;

use core::f64::consts::TAU;
use core::time::Duration;
use std::boxed::Box;
use std::vec::Vec;

use super::super::device::Device;
use super::super::drive::Drive;
use super::super::profile::CIA402;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_core::axis::{AxisCommands, AxisPaths, AxisRequests, Command, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::HostOptions;
use polepair_core::proto::canopen::{CanHost, CanopenDriver};
use polepair_core::station::{AxisIndex, Station, Ticket, Timed};
use polepair_core::stream::cyclic::{CyclicConfig, SetpointBounds, SetpointKind};
use polepair_core::time::Instant;

const AXES: usize = 8;
const PERIOD: Duration = Duration::from_millis(1);
/// Within this a drive whose host fell silent comes to rest: 150 ms of watch, and its quick stop.
const WATCH_MS: u32 = 150;

/// Eight drives and their host on a wire without timing.
struct MultiAxisFixture {
    lane: Lane<Can, CanHost>,
    devices: Vec<Device>,
    now: Instant,
    /// Which drive's plug is out.
    unplugged: Option<usize>,
    /// The host's program hangs.
    frozen: bool,
    /// Duration of a frame.
    frame_ns: u64,
    syncs: u32,
    sent: Vec<Frame>,
}

impl MultiAxisFixture {
    fn new() -> Self {
        Self::at(0)
    }

    fn at(bit_rate: u32) -> Self {
        Self::with_drives(bit_rate, |node| Drive::new(node, 1, 1_000_000))
    }

    fn with_drives(bit_rate: u32, drive: impl Fn(u8) -> Drive) -> Self {
        let host = CanHost::new(&HostOptions::new(bit_rate));
        let nodes = 1..=AXES as u8;
        let drivers =
            nodes.clone().map(|node| Box::new(CanopenDriver::new(&CIA402, node.into())) as _);
        let mut rig = Self {
            lane: Lane::new(host, drivers),
            devices: nodes.map(|node| Device::new(drive(node))).collect(),
            now: Instant(1_000_000_000),
            unplugged: None,
            frozen: false,
            frame_ns: if bit_rate == 0 { 0 } else { 250_000 },
            syncs: 0,
            sent: Vec::new(),
        };
        rig.settle();
        rig
    }

    fn axes() -> Vec<AxisIndex> {
        (0..AXES as u8).map(AxisIndex).collect()
    }

    /// Sends all pending frames of all nodes, each to all others.
    fn settle(&mut self) {
        let mut frame = Frame::default();
        for _ in 0..10_000 {
            let mut matches = false;
            if !self.frozen && self.lane.poll_transmit(self.now, &mut frame).is_some() {
                matches = true;
                self.now = self.now.plus_ns(self.frame_ns);
                self.syncs += u32::from(frame.id == 0x80);
                self.sent.push(frame);
                self.receive(usize::MAX, &frame);
            }
            for n in 0..self.devices.len() {
                let device = &mut self.devices[n];
                if Station::poll_transmit(device, self.now, &mut frame).is_some() {
                    matches = true;
                    self.now = self.now.plus_ns(self.frame_ns);
                    if self.unplugged != Some(n) {
                        self.receive(n, &frame);
                    }
                }
            }
            if !matches {
                return;
            }
        }
        panic!("never quiet");
    }

    fn receive(&mut self, from: usize, frame: &Frame) {
        if from != usize::MAX && !self.frozen {
            self.lane.handle_input(self.now, frame);
        }
        for (n, device) in self.devices.iter_mut().enumerate() {
            if n != from && self.unplugged != Some(n) {
                Station::handle_input(device, self.now, frame);
            }
        }
    }

    fn advance(&mut self, ms: u32) {
        let end = self.now.plus_ms(ms);
        while self.now < end {
            let own = if self.frozen { None } else { self.lane.poll_timeout() };
            let dues = self.devices.iter().filter_map(Timed::poll_timeout).chain(own);
            let next = dues.min().unwrap_or(end).max(self.now.plus_ns(1)).min(end);
            self.now = self.now.max(next);
            self.devices.iter_mut().for_each(|device| device.handle_timeout(next));
            if own.is_some_and(|due| due <= next) {
                self.lane.handle_timeout(next);
            }
            self.settle();
        }
    }

    fn outcome(&mut self) -> Option<(u32, Outcome)> {
        self.lane.poll_outcome().map(|(Ticket(n), outcome)| (n, outcome))
    }

    fn arm(&mut self) {
        Self::axes().into_iter().for_each(|axis| self.lane.set_armed(axis, true));
    }

    fn command(&mut self, n: u8, command: Command) -> Result<(), Unsupported> {
        let axis = AxisIndex(n);
        self.lane.command(self.now, Ticket(100 + u32::from(n)), axis, command)
    }

    /// The verb, on every axis at once.
    fn run(&mut self, command: Command) {
        for n in 0..AXES as u8 {
            self.command(n, command).expect("taken");
        }
        let mut ended = 0;
        for _ in 0..3_000 {
            self.advance(1);
            while let Some((n, outcome)) = self.outcome() {
                assert!(matches!(outcome, Outcome::Done(_)), "{n}: {outcome:?}");
                ended += 1;
            }
            if ended == AXES {
                return;
            }
        }
        panic!("{ended} of {AXES} ended");
    }

    fn ready(&mut self, verb: Verb) {
        self.arm();
        self.run(Command { period: Some(PERIOD.as_secs_f64()), ..Command::new(verb) });
    }

    fn follow(
        &mut self,
        setpoint: SetpointKind,
        bounds: SetpointBounds,
    ) -> Result<(), Unsupported> {
        let axes = Self::axes();
        let bounds = [bounds; AXES];
        let following = CyclicConfig {
            axes: &axes,
            bounds: &bounds,
            setpoint,
            period: PERIOD,
            timeout_scale: 1,
        };
        self.lane.start_cyclic(self.now, Ticket(1), &following)
    }

    /// Feeds a motion of this many cycles as room comes free, until it ends or `more` returns false.
    fn stream(
        &mut self,
        cycles: usize,
        point: impl Fn(usize, usize) -> f64,
        mut more: impl FnMut(&mut Self) -> bool,
    ) -> Option<Outcome> {
        let all: Vec<f64> = (0..cycles)
            .flat_map(|k| (0..AXES).map(move |n| (k, n)))
            .map(|(k, n)| point(k, n))
            .collect();
        let mut fed = 0;
        for _ in 0..cycles + 2_000 {
            if fed < all.len()
                && let Some(count) = self.lane.feed_cycles(Ticket(1), &all[fed..], true)
            {
                fed += count * AXES;
            }
            self.advance(1);
            if let Some((1, outcome)) = self.outcome() {
                return Some(outcome);
            }
            if !more(self) {
                return None;
            }
        }
        panic!("never ended");
    }

    fn truth(&mut self, n: usize) -> GroundTruth {
        let now = self.now;
        self.devices[n].ground_truth(now)
    }

    fn moves(&mut self) -> bool {
        (0..AXES).any(|n| self.truth(n).velocity.abs() > 0.05)
    }
}

/// A circle, axis by axis a part of a turn behind the one before; begins and ends at rest at 0.
fn circle(k: usize, n: usize) -> f64 {
    const CYCLES: f64 = 1000.0;
    let part = k as f64 / CYCLES;
    // Once round, along a way without a step of speed.
    let angle = part * TAU - (part * TAU).sin();
    (angle + n as f64).cos() - (n as f64).cos()
}

#[test]
fn positions_are_followed_by_all_on_one_sync() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowPosition);
    let before: Vec<f64> = (0..AXES).map(|n| rig.truth(n).position).collect();
    let limits = SetpointBounds {
        velocity: Some(30.0),
        acceleration: Some(300.0),
        ..SetpointBounds::default()
    };
    rig.follow(SetpointKind::Position, limits).expect("follows");
    let mut far: f64 = 0.0;
    let outcome = rig.stream(1001, circle, |rig| {
        far = far.max(rig.truth(3).position.abs());
        true
    });
    assert_eq!(outcome, Some(Outcome::Done(1001)));
    assert!(far > 1.0, "it went round: {far}");
    let account = rig.lane.cycle_statistics(AxisIndex(0)).expect("an account").clone();
    assert_eq!((account.cycles, account.missed_cycles, account.late_reports), (1001, 0, 0));
    // Two cycles behind at up to 12.6 rad/s: one by the drive's own interpolation.
    assert!(account.max_following_error < 0.026, "lag {}", account.max_following_error);
    for (n, before) in before.iter().enumerate() {
        let end = rig.truth(n).position;
        assert!((end - before).abs() < 0.01, "axis {n} ends at {end}");
    }
    // Between two SYNCs comes one set-point for each axis, and nothing else moves one.
    let beats: Vec<&[Frame]> = rig.sent.split(|frame| frame.id == 0x80).collect();
    for beat in &beats[2..beats.len() - 1] {
        let nodes: Vec<u32> =
            beat.iter().filter(|f| f.id & 0x780 == 0x200).map(|f| f.id & 0x7F).collect();
        assert_eq!(nodes, (1..=AXES as u32).collect::<Vec<_>>());
    }
}

#[test]
fn drives_without_cyclic_position_follow_by_interpolated_position() {
    let mut rig =
        MultiAxisFixture::with_drives(0, |node| Drive::new(node, 1, 1_000_000).with_modes(0x6F));
    rig.ready(Verb::FollowPosition);
    rig.follow(SetpointKind::Position, SetpointBounds::default()).expect("follows");
    let mut far: f64 = 0.0;
    let outcome = rig.stream(1001, circle, |rig| {
        far = far.max(rig.truth(3).position.abs());
        true
    });
    assert_eq!(outcome, Some(Outcome::Done(1001)));
    assert!(far > 1.0, "it went round: {far}");
    let account = rig.lane.cycle_statistics(AxisIndex(0)).expect("an account").clone();
    assert!(account.max_following_error < 0.026, "lag {}", account.max_following_error);
    assert!((0..AXES).all(|n| rig.truth(n).position.abs() < 0.01));
    // Each set-point has bit 4 with it, and none of them is the target of cyclic position.
    let set_points = rig.sent.iter().filter(|frame| frame.id & 0x780 == 0x200);
    assert!(set_points.clone().count() > 8_000);
    assert!(set_points.clone().all(|frame| frame.data[4] == 0x1F), "enabled, interpolating");
}

#[test]
fn every_axis_changes_its_set_point_on_the_same_sync() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let mut changed = [None; AXES];
    let outcome = rig.stream(
        400,
        |k, _| if (150..350).contains(&k) { 5.0 } else { 0.0 },
        |rig| {
            for (n, changed) in changed.iter_mut().enumerate() {
                if changed.is_none()
                    && rig.truth(n).setpoint.is_some_and(|s| s.velocity.abs() > 0.0)
                {
                    *changed = Some(rig.now);
                }
            }
            true
        },
    );
    assert_eq!(outcome, Some(Outcome::Done(400)));
    assert!(changed[0].is_some());
    assert_eq!(changed, [changed[0]; AXES], "spread zero");
}

#[test]
fn speeds_and_torques_are_followed() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let ramp = |k: usize, n: usize| match k {
        0..500 => k as f64 / 500.0 * (5.0 + n as f64),
        500..1000 => 5.0 + n as f64,
        1000..1500 => (1500 - k) as f64 / 500.0 * (5.0 + n as f64),
        _ => 0.0,
    };
    let mut top = [0.0f64; AXES];
    let outcome = rig.stream(1501, ramp, |rig| {
        (0..AXES).for_each(|n| top[n] = top[n].max(rig.truth(n).velocity));
        true
    });
    assert_eq!(outcome, Some(Outcome::Done(1501)));
    for (n, top) in top.iter().enumerate() {
        assert!((top - 5.0 - n as f64).abs() < 0.5, "axis {n}: {top}");
    }
    rig.ready(Verb::FollowTorque);
    rig.follow(SetpointKind::Torque, SetpointBounds::default()).expect("follows");
    let mut torque: f64 = 0.0;
    let outcome = rig.stream(
        301,
        |k, _| if k < 300 { 0.02 } else { 0.0 },
        |rig| {
            torque = torque.max(rig.truth(5).torque);
            true
        },
    );
    assert_eq!(outcome, Some(Outcome::Done(301)));
    assert!((torque - 0.02).abs() < 0.01, "{torque}");
    rig.run(Command::new(Verb::Unfollow));
}

#[test]
fn a_drive_that_is_unplugged_stops_all_within_its_watch() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let turn = |k: usize, _| if k < 5_000 { (k as f64 / 100.0).min(5.0) } else { 0.0 };
    let mut left = 1_500;
    let outcome = rig.stream(5_001, turn, |rig| {
        left -= 1;
        if left == 0 {
            assert!(rig.moves());
            rig.unplugged = Some(2);
        }
        true
    });
    assert_eq!(outcome, Some(Outcome::Unknown(Failure::Silent)));
    rig.advance(WATCH_MS + 100);
    assert!(!rig.moves(), "all of them, the lost one too");
    // No drive continues by itself, nor on a command without being armed anew.
    rig.unplugged = None;
    let syncs = rig.syncs;
    rig.advance(500);
    assert!(!rig.moves() && rig.syncs == syncs);
    assert_eq!(
        rig.follow(SetpointKind::Velocity, SetpointBounds::default()),
        Err(Unsupported::NotArmed)
    );
    let ready = Command { period: Some(1e-3), ..Command::new(Verb::FollowVelocity) };
    assert_eq!(rig.command(0, ready), Err(Unsupported::NotArmed));
}

#[test]
fn a_host_that_hangs_stops_the_drives_and_itself_when_it_wakes() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let turn = |k: usize, _| if k < 5_000 { (k as f64 / 100.0).min(5.0) } else { 0.0 };
    let mut left = 1_500;
    rig.stream(5_001, turn, |_| {
        left -= 1;
        left > 0
    });
    assert!(rig.moves());
    rig.frozen = true;
    rig.advance(WATCH_MS + 200);
    assert!(!rig.moves(), "the drives watch the host");
    rig.frozen = false;
    rig.advance(20);
    let Some((1, Outcome::Unknown(failure))) = rig.outcome() else { panic!("an outcome") };
    assert!(matches!(failure, Failure::NotReady { .. }), "{failure:?}");
    rig.advance(500);
    assert!(!rig.moves());
    assert_eq!(
        rig.follow(SetpointKind::Velocity, SetpointBounds::default()),
        Err(Unsupported::NotArmed)
    );
}

#[test]
fn a_hiccup_is_counted_and_not_made_up_for() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowPosition);
    rig.follow(SetpointKind::Position, SetpointBounds::default()).expect("follows");
    let mut left = 500;
    let outcome = rig.stream(1001, circle, |rig| {
        left -= 1;
        if left == 0 {
            rig.frozen = true;
            rig.advance(10);
            rig.frozen = false;
        }
        true
    });
    assert_eq!(outcome, Some(Outcome::Done(1001)));
    let account = rig.lane.cycle_statistics(AxisIndex(7)).expect("an account");
    assert_eq!(account.cycles, 1001, "none is left out");
    assert!((9..=11).contains(&account.missed_cycles), "{}", account.missed_cycles);
    let (_, _, max) = account.lateness.summary().expect("beats");
    assert!(max <= PERIOD, "what is left of it: {max:?}");
}

#[test]
fn a_stop_of_one_stops_all_at_once() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let turn = |k: usize, _| if k < 5_000 { (k as f64 / 100.0).min(5.0) } else { 0.0 };
    let mut left = 1_000;
    let outcome = rig.stream(5_001, turn, |rig| {
        left -= 1;
        if left == 0 {
            rig.command(4, Command::new(Verb::Stop)).expect("a stop always gets through");
        }
        true
    });
    assert_eq!(outcome, Some(Outcome::Unknown(Failure::Cancelled)));
    rig.advance(100);
    assert!(!rig.moves());
}

#[test]
fn points_too_far_apart_or_too_fast_move_nothing() {
    let bounds = SetpointBounds {
        position: Some((-0.3, 0.3)),
        velocity: Some(20.0),
        acceleration: Some(2_000.0),
        torque: None,
    };
    type Case = (&'static str, fn(usize) -> f64);
    let cases: [Case; 5] = [
        ("does not begin at", |_| 0.5),
        ("faster", |k| 9e-4 * (k * k) as f64),
        ("speed", |k| if k < 100 { 0.0 } else { 0.01 }),
        ("position limits", |k| -1e-5 * (k * k) as f64),
        ("finite", |k| if k < 300 { 0.0 } else { f64::NAN }),
    ];
    for (what, point) in cases {
        let mut rig = MultiAxisFixture::new();
        rig.ready(Verb::FollowPosition);
        rig.follow(SetpointKind::Position, bounds).expect("follows");
        let points: Vec<f64> = (0..500).flat_map(|k| [point(k); AXES]).collect();
        rig.advance(5);
        // All 500 cycles come at once: the drives are still held where they are.
        while rig.lane.feed_cycles(Ticket(1), &points, false).is_some_and(|consumed| consumed == 0)
        {
        }
        rig.advance(5);
        let (_, outcome) = rig.outcome().expect(what);
        let Outcome::NotDone(Failure::Impossible(why)) = outcome else { panic!("{outcome:?}") };
        match why {
            Unsupported::Forbidden(text) => assert!(text.contains(what), "{what}: {text}"),
            other => assert_eq!((what, other), ("finite", Unsupported::BadArgument)),
        }
        assert!((0..AXES).all(|n| rig.truth(n).position.abs() < 0.01), "{what}");
    }
}

#[test]
fn an_end_in_motion_and_a_want_of_points_stop() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    assert_eq!(rig.lane.feed_cycles(Ticket(1), &[1.0; AXES], true), None);
    rig.advance(5);
    assert!(matches!(rig.outcome(), Some((1, Outcome::NotDone(Failure::NotReady { .. })))));
    rig.ready(Verb::FollowVelocity);
    rig.follow(SetpointKind::Velocity, SetpointBounds::default()).expect("follows");
    let speeds: Vec<f64> = (0..200).flat_map(|k| [f64::from(k) / 100.0; AXES]).collect();
    assert_eq!(rig.lane.feed_cycles(Ticket(1), &speeds, false), Some(200));
    rig.advance(150);
    assert!(rig.moves());
    rig.advance(150);
    let Some((1, Outcome::Unknown(Failure::NotReady { hint }))) = rig.outcome() else { panic!() };
    assert!(hint.contains("feed them faster"), "{hint}");
    assert!(!rig.moves());
}

#[test]
fn a_bus_that_is_full_is_refused_and_what_was_set_is_taken_back() {
    let mut rig = MultiAxisFixture::at(1_000_000);
    rig.ready(Verb::FollowPosition);
    let ns = rig.lane.cycle_ns(&MultiAxisFixture::axes()).expect("ready");
    // Eight times two frames of six bytes, 115 bits each with every stuff bit, and SYNC's 55.
    assert_eq!(ns, (8 * 2 * 115 + 55) * 1_000);
    let refused = rig.follow(SetpointKind::Position, SetpointBounds::default());
    assert!(matches!(refused, Err(Unsupported::Forbidden(text)) if text.contains("80 %")));
    let watch = |rig: &mut MultiAxisFixture| {
        let id = CIA402.find_parameter("consumer heartbeat").expect("a parameter");
        rig.lane.read_parameter(rig.now, Ticket(9), AxisIndex(3), id).expect("taken");
        rig.advance(5);
        rig.outcome()
    };
    assert_eq!(watch(&mut rig), Some((9, Outcome::Done(0x7F_0096))));
    rig.run(Command::new(Verb::Unfollow));
    assert_eq!(watch(&mut rig), Some((9, Outcome::Done(0))));
}

#[test]
fn a_fault_of_one_stops_all() {
    let mut rig = MultiAxisFixture::new();
    rig.ready(Verb::FollowPosition);
    rig.follow(SetpointKind::Position, SetpointBounds::default()).expect("follows");
    let mut left = 700;
    let outcome = rig.stream(1001, circle, |rig| {
        left -= 1;
        if left == 0 {
            let now = rig.now;
            assert!(rig.devices[6].act(now, Act::Fault(0x2310)));
        }
        true
    });
    assert_eq!(outcome, Some(Outcome::Unknown(Failure::Faulted { code: 0x2310 })));
    rig.advance(200);
    assert!(!rig.moves());
}

#[test]
fn moves_that_were_made_ready_begin_on_one_sync() {
    let mut rig = MultiAxisFixture::new();
    rig.arm();
    for n in 0..AXES as u8 {
        let command = Command {
            target: Some(if n % 2 == 0 { 6.0 } else { -3.0 }),
            velocity: Some(20.0),
            ..Command::new(Verb::PrepareTo)
        };
        rig.command(n, command).expect("taken");
    }
    let mut ended = 0;
    for _ in 0..1_000 {
        rig.advance(1);
        while let Some((n, outcome)) = rig.outcome() {
            assert!(matches!(outcome, Outcome::Done(_)), "{n}: {outcome:?}");
            ended += 1;
        }
    }
    assert_eq!(ended, AXES);
    assert!(!rig.moves(), "all wait for the signal");
    rig.command(0, Command::new(Verb::Begin)).expect("taken");
    let mut started = [None; AXES];
    for _ in 0..50 {
        rig.advance(1);
        for (n, started_at) in started.iter_mut().enumerate() {
            let moves = rig.truth(n).setpoint.is_some_and(|s| s.velocity.abs() > 0.0);
            *started_at = started_at.or(moves.then_some(rig.now));
        }
    }
    assert!(started[0].is_some());
    assert_eq!(started, [started[0]; AXES], "spread zero");
    assert!(matches!(rig.outcome(), Some((100, Outcome::Done(_)))));
    rig.run(Command::new(Verb::Begun));
    rig.advance(2_000);
    for n in 0..AXES {
        let target = if n % 2 == 0 { 6.0 } else { -3.0 };
        assert!((rig.truth(n).position - target).abs() < 0.02, "axis {n}");
    }
}
