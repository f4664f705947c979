//! The fault word: what brings a bit, what it does, what takes it away.

extern crate std;

use super::{DriveFixture, profile};
use crate::surroundings::{Act, SurroundingsControl};
use polepair_core::proto::thruster::fault;

fn running() -> DriveFixture {
    let mut rig = DriveFixture::thruster();
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("54 43 00 00 00 00 00 32");
    rig.wait(2000);
    rig
}

#[test]
fn thrust_and_drag_grow_with_the_square_of_the_speed() {
    let mut rig = DriveFixture::thruster();
    rig.ok("54 43 00 00 00 00 00 00");
    let mut at = |rpm: i16| {
        let [a, b] = rpm.to_be_bytes();
        rig.ok(&std::format!("56 43 00 00 00 00 {a:02X} {b:02X}"));
        rig.wait(4000);
        let thrust = rig.device.thrust(rig.now);
        (rig.value("QV"), thrust, rig.truth().current)
    };
    let ((slow, little, few), (fast, much, many)) = (at(1000), at(2000));
    assert_eq!((slow, fast), (1000, 2000));
    assert!((much / little - 4.0).abs() < 0.05, "{little} N, {much} N");
    assert!(many / few > 3.5, "{few} A, {many} A");
    let (back, pull, _) = at(-2000);
    assert!(back == -2000 && (pull + much).abs() < 0.5, "{pull} N");
}

#[test]
fn a_signal_is_open_loop_and_water_brakes() {
    let mut rig = running();
    let half = rig.value("QV");
    rig.ok("54 43 00 00 00 00 00 64");
    rig.wait(2000);
    let full = rig.value("QV");
    assert!(half > 1000 && full > half && full < 2 * half, "{half} {full}");
    rig.ok("54 43 00 00 00 00 FF 9C");
    rig.wait(3000);
    assert!((rig.value("QV") + full).abs() <= 2);
    rig.ok("54 43 00 00 00 00 00 00");
    assert!(!rig.truth().enabled);
    rig.wait(20_000);
    assert!(rig.value("QV").abs() < 120, "water alone brakes it: {}", rig.value("QV"));
}

#[test]
fn output_is_forbidden_until_the_signal_was_zero() {
    let mut rig = DriveFixture::thruster();
    assert_eq!(rig.word("EF"), 0);
    rig.refused("54 43 00 00 00 00 00 05");
    rig.refused("56 43 00 00 00 00 01 F4");
    assert_eq!(rig.word("EF"), fault::ZERO_POINT);
    rig.ok("54 43 00 00 00 00 00 00");
    assert_eq!(rig.word("EF"), 0);
    rig.ok("54 43 00 00 00 00 00 05");
    assert_eq!(rig.word("FR"), fault::ZERO_POINT, "the record keeps it");
    rig.act(Act::PowerCycle);
    assert_eq!(rig.word("FR"), 0, "until the next start");
    rig.refused("54 43 00 00 00 00 00 05");
    rig.ok("56 43 00 00 00 00 00 00");
    rig.ok("56 43 00 00 00 00 01 F4");
}

#[test]
fn silence_stops_the_motor_and_is_reported_once() {
    let mut rig = running();
    rig.ok("53 54 00 00 00 00 01 F4");
    for _ in 0..10 {
        rig.wait(400);
        rig.ok("51 56 00 00");
    }
    assert!(rig.truth().enabled, "any command feeds it");
    rig.wait(499);
    assert!(rig.truth().enabled);
    rig.wait(3);
    assert!(!rig.truth().enabled);
    assert_eq!(rig.word("EF"), fault::TIMEOUT);
    assert_eq!(rig.word("EF"), 0, "told once");
    assert_eq!(rig.word("FR"), fault::TIMEOUT);
    rig.ok("54 43 00 00 00 00 00 05");
    rig.wait(502);
    rig.ok("54 43 00 00 00 00 00 05");
    assert_eq!(rig.word("EF"), 0, "the next command cleared it");
    rig.act(Act::PowerCycle);
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("54 43 00 00 00 00 00 05");
    rig.wait(60_000);
    assert!(rig.truth().enabled, "off after a restart");
}

#[test]
fn a_jammed_propeller_trips_until_it_is_cleared() {
    let mut rig = running();
    rig.act(Act::Jam(true));
    rig.wait(1500);
    assert!(!rig.truth().enabled);
    assert_eq!(rig.device.take_notice(), Some("stalled: output off"));
    rig.refused("54 43 00 00 00 00 00 05");
    rig.ok("54 43 00 00 00 00 00 00");
    rig.refused("56 43 00 00 00 00 01 F4");
    assert_eq!(rig.word("EF"), fault::STALL);
    rig.act(Act::Jam(false));
    rig.wait(5000);
    assert_eq!(rig.word("EF"), fault::STALL, "it does not recover by itself");
    rig.ok("43 46 00 00");
    assert_eq!(rig.word("EF"), 0);
    rig.refused("54 43 00 00 00 00 00 05");
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("54 43 00 00 00 00 00 05");
}

#[test]
fn supply_is_reported_and_recovers() {
    let mut rig = running();
    for (volts, bit) in [(30.0, fault::UNDER_VOLTAGE), (65.0, fault::OVER_VOLTAGE), (48.0, 0)] {
        rig.act(Act::Supply(volts));
        rig.wait(10);
        assert_eq!(rig.word("EF"), bit, "{volts} V");
        assert_eq!(f64::from(rig.value("QP")), volts * 10.0);
        assert!(rig.truth().enabled, "only reported");
    }
    rig.act(Act::Supply(0.0));
    assert!(rig.to(11, &super::hex("51 50 00 00")).is_empty(), "dead");
    rig.act(Act::Supply(48.0));
    rig.refused("54 43 00 00 00 00 00 05");
}

#[test]
fn heat_limits_the_output_until_it_is_cool() {
    let mut rig = running();
    rig.ok("54 43 00 00 00 00 00 64");
    rig.wait(2000);
    let cold = rig.value("QV");
    rig.act(Act::Ambient(125.0));
    for _ in 0..30 {
        rig.wait(20_000);
    }
    let hot = fault::MOTOR_HOT | fault::DRIVER_HOT;
    assert_eq!(rig.word("EF") & hot, hot, "{} {}", rig.value("QT"), rig.value("EQ"));
    assert!(rig.value("QV") < cold * 7 / 10 && rig.truth().enabled, "limited, not closed");
    rig.act(Act::Ambient(16.0));
    rig.wait(20_000);
    for _ in 0..60 {
        rig.wait(20_000);
    }
    assert_eq!(rig.word("EF"), 0, "{} {}", rig.value("QT"), rig.value("EQ"));
    assert!((rig.value("QV") - cold).abs() < 5);
}

#[test]
fn faults_can_be_brought_by_their_bits() {
    for bit in fault::BITS {
        let mut rig = running();
        rig.act(Act::Fault(bit.mask.into()));
        rig.wait(5);
        assert_eq!(rig.word("EF"), bit.mask, "{}", bit.name);
        let off = bit.mask & fault::OUTPUT_OFF != 0;
        assert_eq!(rig.truth().enabled, !off, "{}", bit.name);
        rig.act(Act::Fault(0));
        rig.wait(5);
        let stays = bit.mask & fault::LATCHED != 0 || bit.mask == fault::ZERO_POINT;
        assert_eq!(rig.word("EF") != 0, stays, "{}", bit.name);
        assert_eq!(bit.recovers, bit.mask & fault::LATCHED == 0, "{}", bit.name);
        if bit.mask & fault::LATCHED != 0 {
            rig.ok("43 46 00 00");
            assert_eq!(rig.word("EF"), 0, "{}", bit.name);
        }
        assert_eq!(rig.word("FR"), bit.mask, "{}", bit.name);
    }
    let mut rig = DriveFixture::thruster();
    assert!(!rig.device.act(rig.now, Act::Fault(0x8000)), "reserved");
    assert!(!rig.device.act(rig.now, Act::EncoderBroken(true)), "it has none");
}

#[test]
fn a_servo_without_its_encoder_takes_no_positions() {
    let mut rig = DriveFixture::servo();
    rig.ok("4C 41 00 1E 00 00 03 84");
    rig.wait(200);
    rig.act(Act::EncoderBroken(true));
    assert!(!rig.truth().enabled);
    rig.refused("4C 41 00 1E 00 00 00 00");
    rig.refused("4C 52 00 1E 00 00 00 0A");
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("54 43 00 00 00 00 00 05");
    rig.ok("43 46 00 00");
    rig.refused("4C 41 00 1E 00 00 00 00");
    rig.act(Act::EncoderBroken(false));
    rig.ok("43 46 00 00");
    rig.ok("4C 41 00 1E 00 00 00 00");
    let mut rig = DriveFixture::with(&profile::THRUSTER_SERVO, &[("after-stop", "latched")]);
    rig.ok("4C 53 00 00 00 00 00 00");
    rig.refused("4C 41 00 1E 00 00 00 00");
    rig.ok("43 46 00 00");
    rig.ok("4C 41 00 1E 00 00 00 00");
}
