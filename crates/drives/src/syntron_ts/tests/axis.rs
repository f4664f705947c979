//! The axis verbs of the profile, run by the lane over Modbus against the simulated drive.

use std::boxed::Box;

use super::*;
use polepair_core::axis::{AxisCommands, AxisRequests, Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::lane::Lane;
use polepair_core::medium::Stream;
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::modbus::Rtu;
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, Ticket};

const AXIS: AxisIndex = AxisIndex(0);

/// A host and a drive on one wire.
struct HostAndDrive {
    lane: Lane<Stream, <Rtu as Protocol>::Host>,
    fixture: DriveFixture,
}

impl HostAndDrive {
    fn new(profile: &'static Profile) -> Self {
        let options = HostOptions::new(0);
        let mut lane = Lane::new(
            Rtu::create_host(&options, &[1]),
            [Box::new(Rtu::create_driver(profile, 1)) as _],
        );
        lane.set_armed(AXIS, true);
        let mut fixture = DriveFixture::new();
        fixture.device = SyntronTs::create_device(profile, &OPTIONS).unwrap();
        Self { lane, fixture }
    }

    fn run(&mut self, command: Command) -> Outcome {
        self.run_while(command, |_, _| ())
    }

    /// Runs a verb; `meanwhile` is done to the drive after each request that it received.
    fn run_while(
        &mut self,
        command: Command,
        mut meanwhile: impl FnMut(&mut DriveFixture, &[u8]),
    ) -> Outcome {
        self.lane.command(self.fixture.now, Ticket(1), AXIS, command).unwrap();
        for _ in 0..100_000 {
            let mut bytes = [0; STREAM_UNIT_MAX];
            while let Some(len) = self.lane.poll_transmit(self.fixture.now, &mut bytes) {
                Station::<Stream>::handle_input(
                    &mut self.fixture.device,
                    self.fixture.now,
                    &bytes[..len],
                );
                meanwhile(&mut self.fixture, &bytes[..len]);
            }
            while let Some(len) = Station::<Stream>::poll_transmit(
                &mut self.fixture.device,
                self.fixture.now,
                &mut bytes,
            ) {
                self.lane.handle_input(self.fixture.now, &bytes[..len]);
            }
            if let Some((ticket, outcome)) = self.lane.poll_outcome() {
                assert_eq!(ticket, Ticket(1));
                return outcome;
            }
            self.fixture.advance(1);
            self.lane.handle_timeout(self.fixture.now);
        }
        panic!("{command:?} never ends");
    }

    fn verb(&mut self, verb: Verb) -> Outcome {
        self.run(Command::new(verb))
    }

    fn done(&mut self, command: Command) {
        let outcome = self.run(command);
        assert!(matches!(outcome, Outcome::Done(_)), "{command:?}: {outcome:?}");
    }

    /// Degrees of the shaft by the drive's own count.
    fn degrees(&mut self) -> f64 {
        f64::from(self.fixture.counts()) * 0.036
    }
}

fn usual() -> &'static Profile {
    SyntronTs::profiles()[0]
}

fn radians(degrees: f64) -> f64 {
    degrees.to_radians()
}

#[test]
fn the_host_refuses_to_move_until_the_mode_fits() {
    let mut pair = HostAndDrive::new(usual());
    let target = Some(1.0);
    for command in [
        Command::new(Verb::Enable),
        Command { velocity: Some(10.0), ..Command::new(Verb::Velocity) },
        Command { target, ..Command::new(Verb::MoveTo) },
        Command { target, ..Command::new(Verb::MoveBy) },
        Command::new(Verb::Home),
    ] {
        match pair.run(command) {
            Outcome::NotDone(Failure::NotReady { hint }) => assert!(hint.contains("Fn_00 = ")),
            other => panic!("{command:?}: {other:?}"),
        }
    }
    assert_eq!(pair.fixture.truth().flash_writes, 0, "and wrote nothing");
}

#[test]
fn speed_runs_stops_and_costs_one_flash_write() {
    let mut pair = HostAndDrive::new(usual());
    pair.fixture.write(fn_registers::MODE, 1);
    let before = pair.fixture.truth().flash_writes;
    let velocity = Some(300.0 * core::f64::consts::TAU / 60.0);
    for _ in 0..2 {
        pair.done(Command { velocity, ..Command::new(Verb::Velocity) });
        pair.fixture.advance(1000);
        assert_eq!(pair.fixture.rpm(), 300);
        pair.done(Command::new(Verb::Stop));
        assert!(pair.fixture.truth().velocity.abs() < 0.6 && pair.fixture.truth().enabled);
    }
    pair.done(Command::new(Verb::Disable));
    assert!(!pair.fixture.truth().enabled);
    pair.done(Command::new(Verb::Enable));
    assert!(pair.fixture.truth().enabled);
    assert_eq!(pair.fixture.truth().flash_writes - before, 1, "Fn_99, once");
}

#[test]
fn moves_reach_degrees_of_the_shaft() {
    let mut pair = HostAndDrive::new(usual());
    pair.fixture.write(fn_registers::MODE, 14);
    pair.fixture.write(fn_registers::MOTOR_TURNS, 3);
    pair.fixture.write(fn_registers::TRAVEL, 10);
    let velocity = Some(60.0);
    for (verb, degrees, end) in
        [(Verb::MoveTo, 90.0, 90.0), (Verb::MoveBy, -450.0, -360.0), (Verb::MoveTo, 7.5, 7.5)]
    {
        pair.done(Command { target: Some(radians(degrees)), velocity, ..Command::new(verb) });
        pair.done(Command::new(Verb::Reached));
        pair.fixture.advance(800);
        let found = pair.degrees();
        assert!((found - end).abs() < 0.3, "{verb:?} {degrees}: at {found}");
    }
    assert_eq!(pair.fixture.truth().unrepeatable, 3, "each move ran once");
}

/// Swarm serial:10219: an overload from the move before came while path 32 was written. The drive
/// took the trigger, as every register, and did not move.
#[test]
fn an_alarm_between_the_first_look_and_the_trigger_is_reported() {
    let mut pair = HostAndDrive::new(usual());
    pair.fixture.write(fn_registers::MODE, 14);
    let command = Command { target: Some(radians(90.0)), ..Command::new(Verb::MoveBy) };
    let [high, low] = fn_registers::ENABLE.to_be_bytes();
    let outcome = pair.run_while(command, |fixture, request| {
        if request[1..4] == [3, high, low] {
            fixture.act(Act::Fault(0x1614));
        }
    });
    let faulted = Failure::Faulted { code: 0x1614 };
    assert!(matches!(outcome, Outcome::Partly(failure, _) if failure == faulted), "{outcome:?}");
    assert_eq!(pair.fixture.truth().unrepeatable, 0);
}

#[test]
fn a_stop_ends_a_move_and_the_next_one_starts() {
    for verb in [Verb::Stop, Verb::QuickStop] {
        let mut pair = HostAndDrive::new(usual());
        pair.fixture.write(fn_registers::MODE, 14);
        let target = Some(radians(36_000.0));
        pair.done(Command { target, ..Command::new(Verb::MoveTo) });
        pair.fixture.advance(1000);
        pair.done(Command::new(verb));
        let truth = pair.fixture.truth();
        assert!(truth.velocity.abs() < 0.6 && truth.enabled, "{verb:?}");
        assert_eq!(pair.fixture.read(fn_registers::PATH_STOP), 0, "not left blocked");
        pair.done(Command { target: Some(0.0), ..Command::new(Verb::MoveTo) });
        pair.done(Command::new(Verb::Reached));
        pair.fixture.advance(800);
        assert!(pair.degrees().abs() < 0.3);
    }
}

#[test]
fn home_finds_the_switch() {
    let mut pair = HostAndDrive::new(usual());
    pair.fixture.write(fn_registers::MODE, 14);
    pair.done(Command::new(Verb::Home));
    pair.fixture.advance(800);
    assert!(pair.degrees().abs() < 0.3);
    assert!((pair.fixture.truth().position + core::f64::consts::PI).abs() < 0.01);
}

#[test]
fn an_alarm_stops_the_plans_and_its_remedy_is_reported() {
    let mut pair = HostAndDrive::new(usual());
    pair.fixture.write(fn_registers::MODE, 1);
    pair.done(Command::new(Verb::Clear));
    pair.fixture.act(Act::Fault(0x1614));
    assert_eq!(pair.verb(Verb::Enable), Outcome::NotDone(Failure::Faulted { code: 0x1614 }));
    let Outcome::NotDone(Failure::NotReady { hint }) = pair.verb(Verb::Clear) else {
        panic!("a TS cannot clear over the line")
    };
    assert!(hint.contains("off and on"));
}

#[test]
fn the_sibling_clears_over_the_line_and_tells_its_torque() {
    let mut pair = HostAndDrive::new(SyntronTs::profiles()[1]);
    pair.fixture.write(fn_registers::MODE, 1);
    pair.fixture.act(Act::Fault(0x1614));
    pair.done(Command::new(Verb::Clear));
    pair.done(Command::new(Verb::Enable));
    assert!(SyntronTs::profiles()[1].signal(Signal::Torque).is_some());
    assert!(usual().signal(Signal::Torque).is_none());
}

/// A TS without the position option refuses what concerns paths: its stop leaves that out.
#[test]
fn a_drive_without_paths_is_stopped_without_a_word_about_them() {
    let mut pair = HostAndDrive::new(usual());
    let options = DeviceOptions { extra: &[("variant", "standard")], ..OPTIONS };
    pair.fixture.device = SyntronTs::create_device(usual(), &options).unwrap();
    pair.fixture.write(fn_registers::MODE, 1);
    for stop in [Verb::Stop, Verb::QuickStop] {
        pair.done(Command::new(Verb::Enable));
        pair.done(Command { velocity: Some(10.0), ..Command::new(Verb::Velocity) });
        pair.fixture.advance(500);
        assert!(pair.fixture.rpm() > 90);
        pair.done(Command::new(stop));
        assert!(pair.fixture.rpm().abs() <= 5, "{stop:?}: {}", pair.fixture.rpm());
    }
}
