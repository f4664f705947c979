//! Positions: absolute, relative, zeros, the safe range, the emergency stop.

use super::{DriveFixture, profile};
use crate::surroundings::Act;

impl DriveFixture {
    fn position(&mut self) -> i16 {
        self.value("QA")
    }

    fn relative(&mut self) -> i32 {
        let data = self.request("51 52 00 00");
        i32::from_be_bytes([data[4], data[5], data[6], data[7]])
    }
}

#[test]
fn absolute_moves_arrive_and_may_be_repeated() {
    let mut rig = DriveFixture::servo();
    for _ in 0..3 {
        rig.ok("4C 41 00 1E 00 00 03 84");
        rig.wait(700);
    }
    assert_eq!(rig.position(), 900);
    assert_eq!(rig.value("QV"), 0);
    rig.ok("4C 41 00 3C FF FF FC 7C");
    rig.wait(300);
    assert!((-62..=-58).contains(&rig.value("QV")), "60 rpm: {}", rig.value("QV"));
    rig.wait(2000);
    assert_eq!(rig.position(), -900);
    rig.ok("4C 41 00 3C 00 00 F8 F9");
    rig.wait(3000);
    assert_eq!(rig.position(), -1799, "16 bits are as good");
    rig.refused("4C 41 00 1E 00 00 07 08");
    rig.refused("4C 41 00 1E FF FF F8 F8");
}

#[test]
fn speed_zero_starts_nothing() {
    let mut rig = DriveFixture::servo();
    rig.ok("4C 41 00 00 00 00 03 84");
    rig.ok("4C 52 00 00 00 00 00 64");
    rig.wait(1000);
    assert_eq!((rig.position(), rig.relative(), rig.truth().starts), (0, 0, 0));
    rig.ok("4C 52 00 1E 00 00 00 64");
    rig.wait(1000);
    assert_eq!(rig.relative(), 100, "nothing was added up before");
}

#[test]
fn each_relative_move_adds() {
    let mut rig = DriveFixture::endless();
    for _ in 0..3 {
        rig.ok("4C 52 00 1E 00 00 00 64");
        rig.wait(20);
    }
    rig.wait(2000);
    assert_eq!((rig.relative(), rig.position()), (300, 300));
    assert_eq!(rig.truth().unrepeatable, 3);
    rig.ok("4C 52 00 1E FF FF FF 38");
    rig.wait(2000);
    assert_eq!(rig.relative(), 100);
    // More than a turn.
    rig.ok("4C 52 00 64 00 00 0E 10");
    rig.wait(3000);
    assert_eq!((rig.relative(), rig.position()), (3700, 3700));
    let mut rig = DriveFixture::with(&profile::THRUSTER_SERVO, &[("round", "on")]);
    rig.ok("4C 52 00 64 00 00 0E 74");
    rig.wait(3000);
    assert_eq!((rig.relative(), rig.position()), (3700, 100));
}

#[test]
fn zeros_are_set_here_and_kept() {
    let mut rig = DriveFixture::endless();
    rig.ok("4C 41 00 1E 00 00 01 F4");
    rig.wait(2000);
    rig.ok("52 5A 00 00 00 00 00 00");
    assert_eq!((rig.relative(), rig.position()), (0, 500));
    rig.ok("41 5A 00 00 00 00 00 00");
    assert_eq!(rig.position(), 0);
    rig.ok("4C 52 00 1E 00 00 00 C8");
    rig.wait(2000);
    rig.act(Act::PowerCycle);
    assert_eq!((rig.relative(), rig.position()), (200, 200), "kept");
    rig.ok("52 43 00 00 00 00 00 00");
    assert_eq!((rig.relative(), rig.position()), (0, 200));
    rig.ok("4C 52 00 1E 00 00 07 08");
    rig.wait(100);
    rig.ok("52 43 00 00 00 00 00 00");
    rig.wait(2000);
    assert!(rig.relative().abs() < 400, "what was left of the way is given up");
}

#[test]
fn nothing_goes_beyond_the_safe_range() {
    let mut rig = DriveFixture::servo();
    assert_eq!(rig.request("52 50 4C 41")[4..], [0xF8, 0xF9, 0x07, 0x07]);
    rig.ok("53 50 4C 41 FC 7C 03 84");
    assert_eq!(rig.request("52 50 4C 41")[4..], [0xFC, 0x7C, 0x03, 0x84]);
    rig.refused("4C 41 00 1E 00 00 03 85");
    rig.refused("4C 41 00 1E FF FF FC 7B");
    rig.refused("4C 52 00 1E 00 00 03 85");
    rig.ok("4C 41 00 1E 00 00 03 84");
    rig.wait(2000);
    assert_eq!(rig.position(), 900);
    rig.act(Act::PowerCycle);
    rig.refused("4C 41 00 1E 00 00 03 85");
    let before = rig.truth().flash_writes;
    rig.ok("53 50 4C 41 00 64 00 64");
    assert_eq!(rig.request("52 50 4C 41")[4..], [0xFF, 0x9C, 0x00, 0x64], "a magnitude");
    assert_eq!(rig.truth().flash_writes, before + 1);
    rig.refused("53 50 4C 41 F8 F8 00 64");
}

#[test]
fn the_emergency_stop_gives_up_moves_and_output() {
    let mut rig = DriveFixture::endless();
    rig.ok("4C 52 00 1E 00 00 07 08");
    rig.wait(200);
    rig.ok("4C 53 00 00 00 00 00 00");
    assert!(!rig.truth().enabled);
    rig.wait(2000);
    let stood = rig.relative();
    assert!(stood < 900, "{stood}");
    rig.ok("4C 52 00 1E 00 00 00 64");
    rig.wait(2000);
    assert_eq!(rig.relative(), stood + 100, "nothing of the old way is left");
}

#[test]
fn thrusters_have_no_positions_and_actuators_have() {
    let mut rig = DriveFixture::thruster();
    for frame in
        ["51 41 00 00", "51 52 00 00", "52 50 4C 41", "4C 41 00 1E 00 00 00 64", "41 5A 00 00"]
    {
        rig.refused(frame);
    }
    rig.ok("4C 53 00 00 00 00 00 00");
    let mut rig = DriveFixture::with(&profile::THRUSTER_ACTUATOR, &[]);
    rig.ok("4C 41 00 1E 00 00 07 07");
    rig.wait(3000);
    rig.refused("4C 52 00 1E 00 00 00 64"); // beyond the stroke
    rig.ok("4C 52 00 1E FF FF FF 9C");
    rig.wait(2000);
    assert_eq!(rig.position(), 1699);
}

/// A servo has hard stops: it presses against one, stalls, closes its output, and goes on once CF and the
/// zero signal came (section 3, stall protection).
#[test]
fn a_servo_stalls_at_its_end_and_recovers_by_cf() {
    let mut rig = DriveFixture::servo();
    rig.ok("56 43 00 00 00 00 00 00");
    rig.ok("56 43 00 00 00 00 00 C8"); // VC 200 rpm
    rig.wait(800);
    let truth = rig.truth();
    let end = 179.9_f64.to_radians();
    assert!((truth.position - end).abs() < 1e-6 && truth.velocity == 0.0, "{truth:?}");
    assert!(truth.current > 3.9, "it presses: {truth:?}");
    rig.wait(1500);
    assert_eq!(rig.request("45 46 00 00")[6..], [0x00, 0x40], "stall");
    assert!(!rig.truth().enabled);
    assert_eq!(rig.request("56 43 00 00 00 00 FF 38")[6..], [0xEE, 0xEE], "the output is closed");
    rig.ok("43 46 00 00");
    rig.ok("56 43 00 00 00 00 00 00");
    rig.ok("56 43 00 00 00 00 FF 38"); // VC -200 rpm
    rig.wait(200);
    assert!(rig.truth().position < end - 0.5, "away from the end");
    rig.ok("4C 53 00 00 00 00 00 00");
}

/// LR adds beyond LA's range only where there is no end.
#[test]
fn relative_moves_add_beyond_half_a_turn_only_without_ends() {
    let far = "4C 52 00 64 00 00 07 D0"; // LR 100 rpm 200.0 deg
    assert_eq!(DriveFixture::servo().request(far)[6..], [0xEE, 0xEE]);
    let mut rig = DriveFixture::endless();
    rig.ok(far);
    rig.wait(2000);
    assert_eq!(rig.relative(), 2000);
    let mut rig = DriveFixture::with(&profile::THRUSTER_ACTUATOR, &[("ends", "-5..50")]);
    rig.ok("4C 52 00 C8 00 00 02 58"); // LR 200 rpm 60.0
    rig.wait(3000);
    assert!((rig.relative() - 500).abs() <= 1, "{}", rig.relative());
}
