//! What switches the motor off, and limits.

use super::DriveFixture;
use crate::drives::bench::{Act, BenchControl};
use core::f64::consts::TAU;

fn running() -> DriveFixture {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.fixed(0x02A0, 10.0);
    desk.send_instruction(0x5909, &[0xBBC1, 0x8301]);
    desk.update();
    desk.wait(300);
    desk
}

#[test]
fn a_jammed_shaft_is_a_control_error() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.act(Act::Jam(true));
    desk.move_to(20_000);
    desk.wait(1000);
    assert_eq!(desk.read(0x08FC), 0x0008);
    assert_eq!((desk.read(0x090E) & 0x8000, desk.read(0x090F) & 0x8000), (0, 0x8000));
    desk.send_instruction(0x0102, &[]);
    assert_eq!(desk.read(0x090E) & 0x8000, 0, "not before FAULTR");
    desk.act(Act::Jam(false));
    desk.send_instruction(0x1C04, &[]);
    desk.send_instruction(0x0102, &[]);
    assert_eq!((desk.read(0x08FC), desk.read(0x090E) & 0x8000), (0, 0x8000));
}

#[test]
fn voltages_out_of_bounds_stop_the_motor() {
    for (volts, bit) in [(70.0, 0x1000), (10.0, 0x2000)] {
        let mut desk = running();
        desk.act(Act::Supply(volts));
        desk.wait(5);
        assert_eq!(desk.read(0x08FC), bit);
        assert!(!desk.device.ground_truth(desk.now).enabled);
        desk.send_instruction(0x1C04, &[]);
        desk.wait(5);
        assert_eq!(desk.read(0x08FC), bit, "the cause is still there");
        desk.act(Act::Supply(48.0));
        desk.send_instruction(0x1C04, &[]);
        desk.wait(5);
        assert_eq!(desk.read(0x08FC), 0);
    }
}

#[test]
fn enable_and_sto_switch_off_without_a_fault() {
    for input in [5, 6] {
        let mut desk = running();
        desk.act(Act::Input(input, false));
        desk.wait(5);
        assert_eq!(desk.read(0x08FC), 0x8000);
        assert_eq!(desk.read(0x090E) & 0x8000, 0);
        desk.act(Act::Input(input, true));
        desk.wait(5);
        assert_eq!(desk.read(0x08FC), 0);
        assert!(!desk.device.ground_truth(desk.now).enabled, "AXISON is up to the host");
    }
}

#[test]
fn limit_switches_stop_what_moves_toward_them_only() {
    let mut desk = running();
    desk.act(Act::Switch { which: 1, at: 6.0 * TAU });
    desk.wait(2000);
    assert_eq!(desk.read(0x08FC), 0x0040);
    let at = desk.read_long(0x0228);
    assert!((12_000..12_400).contains(&at), "{at}");
    desk.move_to(20_000);
    desk.wait(500);
    assert!(desk.read_long(0x0228) < at + 100);
    desk.move_to(5000);
    desk.wait(2000);
    assert_eq!((desk.read_long(0x0228), desk.read(0x08FC)), (5000, 0));
}

#[test]
fn software_limits_stop_once_they_are_watched() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.long(0x088C, 3000);
    desk.long(0x088A, -3000);
    desk.send_instruction(0x5801, &[0xFFFF, 0x1000]);
    desk.move_to(20_000);
    desk.wait(2000);
    let at = desk.read_long(0x0228);
    assert!((3000..5000).contains(&at), "{at}");
    assert_eq!(desk.read(0x03AD), 1 << 6);
}

#[test]
fn a_load_too_heavy_for_too_long_is_i2t() {
    let mut desk = running();
    desk.act(Act::Load(-1.6));
    desk.wait(6000);
    assert_eq!(desk.read(0x08FC) & 0x0200, 0x0200, "{:04X}", desk.read(0x08FC));
}

#[test]
fn a_broken_encoder_is_noticed() {
    let mut desk = running();
    desk.act(Act::EncoderBroken(true));
    desk.wait(500);
    assert_eq!((desk.read(0x08FC), desk.read(0x03AD)), (0x0020, 1 << 10));
}
