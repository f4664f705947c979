//! The unified verbs on the simulated drives, through a lane.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use super::{DriveFixture, profile};
use crate::surroundings::{Act, SurroundingsControl};
use polepair_core::axis::{AxisCommands, AxisDirectory, AxisRequests, AxisText, Command, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, Frame};
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::thruster::{CanHost, ThrusterDriver};
use polepair_core::proto::{HostOptions, Protocol, thruster};
use polepair_core::station::{AxisIndex, Station, Ticket, Timed};
use polepair_core::time::{Instant, earliest};

const X: AxisIndex = AxisIndex(0);

/// A lane and a drive on a wire without delay.
struct Pair {
    rig: DriveFixture,
    lane: Lane<Can, CanHost>,
    now: Instant,
    sent: Vec<Frame>,
    tickets: u32,
}

impl Pair {
    fn new(profile: &'static Profile) -> Self {
        let host = thruster::Thruster::create_host(&HostOptions::new(0), &[11]);
        let lane = Lane::new(host, [Box::new(ThrusterDriver::new(profile, 11)) as _]);
        let rig = DriveFixture::with(profile, &[]);
        Self { rig, lane, now: Instant::ZERO, sent: Vec::new(), tickets: 0 }
    }

    fn exchange(&mut self) {
        let mut frame = Frame::default();
        loop {
            let mut quiet = true;
            while self.lane.poll_transmit(self.now, &mut frame).is_some() {
                self.sent.push(frame);
                self.rig.device.handle_input(self.now, &frame);
                quiet = false;
            }
            while Station::<Can>::poll_transmit(&mut self.rig.device, self.now, &mut frame)
                .is_some()
            {
                self.lane.handle_input(self.now, &frame);
                quiet = false;
            }
            if quiet {
                return;
            }
        }
    }

    fn run(&mut self, ms: u32) {
        let end = self.now.plus_ms(ms);
        loop {
            self.exchange();
            let next = earliest(self.lane.poll_timeout(), self.rig.device.poll_timeout());
            let Some(at) = next.filter(|at| *at <= end) else { break };
            self.now = at.max(self.now);
            self.lane.handle_timeout(self.now);
            self.rig.device.handle_timeout(self.now);
        }
        self.now = end;
        self.rig.now = end;
        self.lane.handle_timeout(end);
        self.rig.device.handle_timeout(end);
        self.exchange();
    }

    fn ended(&mut self) -> Outcome {
        for _ in 0..100_000 {
            self.run(1);
            if let Some((_, outcome)) = self.lane.poll_outcome() {
                return outcome;
            }
        }
        panic!("no end");
    }

    fn command(&mut self, command: Command) -> Result<Outcome, Unsupported> {
        self.tickets += 1;
        self.lane.command(self.now, Ticket(self.tickets), X, command)?;
        Ok(self.ended())
    }

    fn verb(&mut self, verb: Verb) -> Outcome {
        self.command(Command::new(verb)).expect("a plan")
    }

    fn read(&mut self, name: &str) -> Outcome {
        let id = self.lane.profile(X).and_then(|p| p.find_parameter(name)).expect(name);
        self.lane.read_parameter(self.now, Ticket(900), X, id).expect("readable");
        self.ended()
    }

    fn write(&mut self, name: &str, raw: i64) -> Result<Outcome, Unsupported> {
        let id = self.lane.profile(X).and_then(|p| p.find_parameter(name)).expect(name);
        self.lane.write_parameter(self.now, Ticket(901), X, id, raw, false)?;
        Ok(self.ended())
    }

    fn raw(&mut self, text: &str) -> Result<Outcome, Unsupported> {
        self.lane.send_text(self.now, Ticket(902), X, text)?;
        Ok(self.ended())
    }
}

fn turning(rpm: f64) -> Command {
    let velocity = Some(rpm * core::f64::consts::TAU / 60.0);
    Command { velocity, ..Command::new(Verb::Velocity) }
}

fn moving(verb: Verb, degrees: f64, rpm: Option<f64>) -> Command {
    let velocity = rpm.map(|rpm| rpm * core::f64::consts::TAU / 60.0);
    Command { target: Some(degrees.to_radians()), velocity, ..Command::new(verb) }
}

#[test]
fn a_thruster_is_enabled_spun_and_stopped() {
    let mut pair = Pair::new(&profile::THRUSTER);
    assert_eq!(pair.command(turning(500.0)), Err(Unsupported::NotArmed));
    pair.lane.set_armed(X, true);
    // Without the zero signal the drive refuses, with the reason.
    let result = pair.command(turning(500.0));
    assert_eq!(result, Ok(Outcome::NotDone(Failure::Faulted { code: 0x0400 })));
    assert!(matches!(pair.verb(Verb::Enable), Outcome::Done(_)));
    assert!(matches!(pair.command(turning(500.0)), Ok(Outcome::Done(_))));
    pair.run(3000);
    assert_eq!(pair.read("speed"), Outcome::Done(500));
    assert_eq!(pair.read("voltage"), Outcome::Done(480));
    let torque = Command { torque: Some(-0.25), ..Command::new(Verb::Torque) };
    assert!(matches!(pair.command(torque), Ok(Outcome::Done(_))));
    assert_eq!(pair.sent.last().map(|f| f.data), Some(*b"TC\0\0\0\0\xFF\xE7"));
    pair.run(3000);
    assert!(matches!(pair.read("speed"), Outcome::Done(rpm) if rpm < -600));
    assert!(matches!(pair.verb(Verb::Stop), Outcome::Done(_)));
    assert!(!pair.rig.truth().enabled);
}

#[test]
fn limits_hold_before_a_byte_is_sent() {
    let mut pair = Pair::new(&profile::THRUSTER_SERVO);
    pair.lane.set_armed(X, true);
    let refused =
        |result| matches!(result, Err(Unsupported::OutOfRange { .. } | Unsupported::Forbidden(_)));
    assert!(refused(pair.command(turning(201.0))));
    assert!(refused(pair.command(moving(Verb::MoveTo, 180.0, None))));
    assert!(refused(pair.command(moving(Verb::MoveTo, 90.0, Some(201.0)))));
    assert!(refused(pair.write("command timeout", 60_001)));
    assert!(refused(pair.raw("LR 10 rpm -437.0 deg")), "EE EE");
    assert!(refused(pair.raw("VC 29 rpm")));
    assert!(pair.sent.is_empty());
    let impossible = |result| matches!(result, Ok(Outcome::NotDone(Failure::Impossible(_))));
    assert!(impossible(pair.command(moving(Verb::MoveBy, -437.0, None))), "EE EE");
    assert!(impossible(pair.write("command timeout", 99)));
    let moved = pair.sent.iter().any(|f| matches!(f.data, [b'L' | b'V' | b'T', ..]));
    assert!(!moved, "{:?}", pair.sent);
}

#[test]
fn a_servo_goes_to_its_target_and_reports_its_arrival() {
    let mut pair = Pair::new(&profile::THRUSTER_SERVO);
    pair.lane.set_armed(X, true);
    assert!(matches!(pair.verb(Verb::Enable), Outcome::Done(_)));
    assert!(matches!(pair.command(moving(Verb::MoveTo, 90.0, Some(60.0))), Ok(Outcome::Done(_))));
    let la = pair.sent.iter().find(|f| f.data.starts_with(b"LA")).expect("sent");
    assert_eq!(la.data[2..], [0, 60, 0, 0, 3, 0x84]);
    assert!(matches!(pair.verb(Verb::Reached), Outcome::Done(_)));
    assert_eq!(pair.read("absolute position"), Outcome::Done(900));
    assert!(matches!(pair.command(moving(Verb::MoveBy, -30.0, None)), Ok(Outcome::Done(_))));
    let lr = pair.sent.iter().rfind(|f| f.data.starts_with(b"LR")).expect("sent");
    assert_eq!(lr.data[2..], [0, 30, 0xFF, 0xFF, 0xFE, 0xD4]);
    assert!(matches!(pair.verb(Verb::Reached), Outcome::Done(_)));
    assert_eq!(pair.read("absolute position"), Outcome::Done(600));
    assert!(matches!(pair.command(turning(40.0)), Ok(Outcome::Done(_))));
    pair.run(300);
    assert_eq!(pair.read("speed"), Outcome::Done(40));
    assert!(matches!(pair.verb(Verb::QuickStop), Outcome::Done(_)));
    let stop = pair.sent.iter().rfind(|f| !f.data.starts_with(b"Q")).expect("sent");
    assert_eq!(stop.data, *b"LS\0\0\0\0\0\0");
    assert_eq!(pair.read("speed"), Outcome::Done(0), "it was measured at standstill");
    pair.read("safe range");
    assert!(matches!(pair.write("reverse end", -900), Ok(Outcome::Done(_))));
    assert!(matches!(pair.write("forward end", 900), Ok(Outcome::Done(_))));
    assert_eq!(pair.read("reverse end"), Outcome::Done(-900));
    assert_eq!(pair.read("forward end"), Outcome::Done(900));
    let result = pair.command(moving(Verb::MoveTo, 95.0, None));
    assert_eq!(result, Ok(Outcome::NotDone(Failure::Refused { code: 0xEEEE })));
}

#[test]
fn reports_without_a_query_are_received() {
    let mut pair = Pair::new(&profile::THRUSTER);
    pair.lane.set_armed(X, true);
    assert!(matches!(pair.verb(Verb::Enable), Outcome::Done(_)));
    assert!(matches!(pair.raw("MM"), Ok(Outcome::Done(_))));
    assert!(matches!(pair.command(turning(600.0)), Ok(Outcome::Done(_))));
    pair.run(3000);
    let state = *pair.lane.state(X).expect("an axis");
    assert_eq!(state.reading(Signal::Velocity).raw, 600);
    assert!(pair.now.since(state.reading(Signal::Current).at.expect("heard")).as_millis() <= 100);
    assert!(matches!(pair.raw("MQ"), Ok(Outcome::Done(_))));
    let set = pair.write("autosend", 0x0003_0064);
    assert!(matches!(set, Ok(Outcome::Done(_))), "{set:?}");
    pair.rig.act(Act::PowerCycle);
    pair.run(500);
    let state = pair.lane.state(X).expect("an axis");
    assert_eq!(state.reading(Signal::Voltage).raw, 480);
    assert_eq!(state.reading(Signal::Temperature).raw, 16);
}

#[test]
fn the_timeout_stop_is_fed_while_the_program_lives() {
    let mut pair = Pair::new(&profile::THRUSTER);
    pair.lane.set_armed(X, true);
    assert!(matches!(pair.verb(Verb::Enable), Outcome::Done(_)));
    assert!(matches!(pair.write("command timeout", 300), Ok(Outcome::Done(_))));
    assert!(matches!(pair.command(turning(600.0)), Ok(Outcome::Done(_))));
    for _ in 0..5 {
        pair.run(900);
        assert!(matches!(pair.read("voltage"), Outcome::Done(_)));
    }
    assert!(pair.rig.truth().enabled, "one request in 900 ms keeps it running");
    pair.run(1000 + 300 + 10);
    assert!(!pair.rig.truth().enabled, "a program that hangs does not");
    assert_eq!(pair.rig.device.take_notice(), Some("no command in time: output off"));
}

/// AZ, RZ, RC, MQ, ML, MM and the two ends of SPLA by name (sections 2.1, 4.1, 4.2).
#[test]
fn each_name_of_the_manual_is_a_parameter() {
    let mut pair = Pair::new(&profile::THRUSTER_SERVO);
    pair.lane.set_armed(X, true);
    assert!(matches!(pair.command(moving(Verb::MoveTo, 30.0, Some(60.0))), Ok(Outcome::Done(_))));
    assert!(matches!(pair.verb(Verb::Reached), Outcome::Done(_)));
    for (name, position, relative) in
        [("relative zero", 300, 0), ("absolute zero", 0, 0), ("relative counter", 0, 0)]
    {
        assert!(matches!(pair.write(name, 1), Ok(Outcome::Done(_))), "{name}");
        assert_eq!(pair.read("absolute position"), Outcome::Done(position), "{name}");
        assert_eq!(pair.read("relative position"), Outcome::Done(relative), "{name}");
    }
    assert!(matches!(pair.write("reverse end", -450), Ok(Outcome::Done(-450))));
    assert!(matches!(pair.write("forward end", 600), Ok(Outcome::Done(600))));
    assert_eq!(pair.sent.last().map(|f| f.data), Some(*b"SPLA\xFE\x3E\x02\x58"));
    assert_eq!(pair.read("reverse end"), Outcome::Done(-450));
    assert_eq!(pair.read("forward end"), Outcome::Done(600));
    for (raw, letters) in [(1, b"ML"), (2, b"MM"), (0, b"MQ")] {
        assert!(matches!(pair.write("value report", raw), Ok(Outcome::Done(_))), "{raw}");
        assert_eq!(pair.sent.last().map(|f| (f.len, [f.data[0], f.data[1]])), Some((4, *letters)));
    }
}
