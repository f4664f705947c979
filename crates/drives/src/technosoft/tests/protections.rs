//! Protections that switch the motor off, and limits.

use super::DriveFixture;
use crate::surroundings::{Act, SurroundingsControl};
use core::f64::consts::TAU;

fn running() -> DriveFixture {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.fixed(0x02A0, 10.0);
    fixture.send_instruction(0x5909, &[0xBBC1, 0x8301]);
    fixture.update();
    fixture.wait(300);
    fixture
}

#[test]
fn a_jammed_shaft_is_a_control_error() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.act(Act::Jam(true));
    fixture.move_to(20_000);
    fixture.wait(1000);
    assert_eq!(fixture.read(0x08FC), 0x0008);
    assert_eq!((fixture.read(0x090E) & 0x8000, fixture.read(0x090F) & 0x8000), (0, 0x8000));
    fixture.send_instruction(0x0102, &[]);
    assert_eq!(fixture.read(0x090E) & 0x8000, 0, "not before FAULTR");
    fixture.act(Act::Jam(false));
    fixture.send_instruction(0x1C04, &[]);
    fixture.send_instruction(0x0102, &[]);
    assert_eq!((fixture.read(0x08FC), fixture.read(0x090E) & 0x8000), (0, 0x8000));
}

#[test]
fn voltages_out_of_bounds_stop_the_motor() {
    for (volts, bit) in [(70.0, 0x1000), (10.0, 0x2000)] {
        let mut fixture = running();
        fixture.act(Act::Supply(volts));
        fixture.wait(5);
        assert_eq!(fixture.read(0x08FC), bit);
        assert!(!fixture.device.ground_truth(fixture.now).enabled);
        fixture.send_instruction(0x1C04, &[]);
        fixture.wait(5);
        assert_eq!(fixture.read(0x08FC), bit, "the cause is still there");
        fixture.act(Act::Supply(48.0));
        fixture.send_instruction(0x1C04, &[]);
        fixture.wait(5);
        assert_eq!(fixture.read(0x08FC), 0);
    }
}

#[test]
fn enable_and_sto_switch_off_without_a_fault() {
    for input in [5, 6] {
        let mut fixture = running();
        fixture.act(Act::Input(input, false));
        fixture.wait(5);
        assert_eq!(fixture.read(0x08FC), 0x8000);
        assert_eq!(fixture.read(0x090E) & 0x8000, 0);
        fixture.act(Act::Input(input, true));
        fixture.wait(5);
        assert_eq!(fixture.read(0x08FC), 0);
        assert!(!fixture.device.ground_truth(fixture.now).enabled, "AXISON is up to the host");
    }
}

#[test]
fn limit_switches_stop_what_moves_toward_them_only() {
    let mut fixture = running();
    fixture.act(Act::Switch { which: 1, at: 6.0 * TAU });
    fixture.wait(2000);
    assert_eq!(fixture.read(0x08FC), 0x0040);
    let at = fixture.read_long(0x0228);
    assert!((12_000..12_400).contains(&at), "{at}");
    fixture.move_to(20_000);
    fixture.wait(500);
    assert!(fixture.read_long(0x0228) < at + 100);
    fixture.move_to(5000);
    fixture.wait(2000);
    assert_eq!((fixture.read_long(0x0228), fixture.read(0x08FC)), (5000, 0));
}

#[test]
fn software_limits_stop_once_they_are_watched() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.long(0x088C, 3000);
    fixture.long(0x088A, -3000);
    fixture.send_instruction(0x5801, &[0xFFFF, 0x1000]);
    fixture.move_to(20_000);
    fixture.wait(2000);
    let at = fixture.read_long(0x0228);
    assert!((3000..5000).contains(&at), "{at}");
    assert_eq!(fixture.read(0x03AD), 1 << 6);
}

#[test]
fn a_load_too_heavy_for_too_long_is_i2t() {
    let mut fixture = running();
    fixture.act(Act::Load(-1.6));
    fixture.wait(6000);
    assert_eq!(fixture.read(0x08FC) & 0x0200, 0x0200, "{:04X}", fixture.read(0x08FC));
}

#[test]
fn a_broken_encoder_is_noticed() {
    let mut fixture = running();
    fixture.act(Act::EncoderBroken(true));
    fixture.wait(500);
    assert_eq!((fixture.read(0x08FC), fixture.read(0x03AD)), (0x0020, 1 << 10));
}
