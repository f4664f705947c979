use core::f64::consts::{PI, TAU};

use super::super::homing::{AfterHoming, HomingMark, HomingMethod, HomingStart};
use super::*;

#[test]
fn the_way_is_decimal_digits() {
    let way = HomingMethod::decode(21_133).unwrap();
    assert_eq!(
        (way.after, way.z_search, way.start),
        (AfterHoming::Stop, true, HomingStart::ByTrigger)
    );
    assert_eq!((way.mark, way.direction), (HomingMark::HomeSwitch, 1.0));
    assert!(!HomingMethod::decode(4100).unwrap().z_search, "Z only after a switch");
    assert_eq!(HomingMethod::decode(17).unwrap().after, AfterHoming::Path(17));
    assert_eq!(HomingMethod::decode(8000), None);
}

fn home(fixture: &mut DriveFixture, way: u16) {
    fixture.write(fn_registers::HOMING_WAY, way);
    fixture.write(fn_registers::HOMING_TRIGGER, 0);
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    fixture.write(fn_registers::HOMING_TRIGGER, 0);
    assert!(fixture.busy(), "way {way}");
    fixture.settle(30_000);
}

/// TS manual V2 §2.6.2, "homing", step by step, with the simulated drive's own home switch.
#[test]
fn the_homing_recipe_finds_the_switch() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 14), (0x20A, 1), (0x20D, 0), (0x38, 1), (0x20D, 1), (0x20D, 0)] {
        fixture.write(number, value);
    }
    fixture.settle(10_000);
    fixture.is_at(0);
    assert!((fixture.truth().position + PI).abs() < 0.005);
}

/// Every direction and mark with and without Z, overshooting and coming back.
#[test]
fn every_way_finds_its_zero() {
    let cases = [
        // C, B, switch, where it is, where the zero has to be.
        (0, 0, Some((0, -4.0)), -4.0),
        (1, 0, Some((0, 4.0)), 4.0),
        (0, 1, Some((0, -4.0)), -TAU),
        (1, 1, Some((0, 4.0)), TAU),
        (2, 0, Some((2, -9.0)), -9.0),
        (3, 0, Some((1, 9.0)), 9.0),
        (2, 1, Some((2, -9.0)), -TAU),
        (3, 1, Some((1, 9.0)), TAU),
        (4, 0, None, 0.0),
        (5, 0, None, TAU),
    ];
    for (c, b, switch, zero) in cases {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.act(Act::Switch { which: 0, at: f64::NAN });
        if let Some((which, at)) = switch {
            fixture.act(Act::Switch { which, at });
        }
        // From a little forward of a Z pulse.
        fixture.fill(1, 1002, 10_000, 60, [50, 50, 0, 0]);
        fixture.trigger(1);
        fixture.settle(2000);
        home(&mut fixture, 20_000 + c * 1000 + b * 100);
        // A limit switch has no place of its own but the tick in which it closed: 10 mrad.
        let found = fixture.truth().position;
        assert!((found - zero).abs() < 0.015, "way {c}{b}: zero at {found}, not {zero}");
        fixture.is_at(0);
    }
}

/// A search finds its switch whatever side of it the axis is on: beyond it, it turns round after some turns.
#[test]
fn homing_finds_the_same_zero_any_number_of_times() {
    for (way, at) in [(20_000, -PI), (21_000, -PI), (20_000, 5.0), (21_000, 5.0), (20_100, -PI)] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.act(Act::Switch { which: 0, at });
        let mut zeros = [0.0; 4];
        for (n, zero) in zeros.iter_mut().enumerate() {
            home(&mut fixture, way);
            assert_eq!(fixture.alarm(), 0, "way {way}, time {n}");
            *zero = fixture.truth().position;
            // Away from it, in the one and the other direction.
            let by = [90_000, 0, 400_000, 0][n];
            fixture.fill(1, 1002, by, 300, [50, 50, 0, 0]);
            fixture.trigger(1);
            fixture.settle(5000);
        }
        let first = zeros[0];
        assert!(zeros.iter().all(|zero| (zero - first).abs() < 0.01), "way {way}: {zeros:?}");
    }
}

#[test]
fn a_mechanical_stop_is_a_zero() {
    for (c, direction) in [(6, -1.0), (7, 1.0)] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.write(fn_registers::HOMING_WAY, 20_000 + c * 1000);
        fixture.write(fn_registers::HOMING_TRIGGER, 1);
        fixture.advance(1000);
        fixture.act(Act::Jam(true));
        let stop = fixture.truth().position;
        assert!(stop * direction > 5.0, "it was on its way");
        fixture.settle(5000);
        assert_eq!((fixture.alarm(), fixture.counts()), (0, 0), "way {c}");
        assert!((fixture.truth().position - stop).abs() < 1e-9);
    }
}

#[test]
fn the_digits_after_the_zero_are_parsed() {
    let switch = Act::Switch { which: 0, at: 20.0 };
    for (a, at_zero) in [(0, true), (33, false)] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.act(switch);
        fixture.write(fn_registers::HOMING_SPEED, 600);
        home(&mut fixture, 21_000 + a);
        let counts = fixture.counts();
        assert_eq!(counts.abs() <= 5, at_zero, "A = {a}: at {counts}");
        assert!(counts >= -5, "overshot, not short: {counts}");
    }
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.act(switch);
    fixture.fill(5, 1002, 720_000, 300, [100, 100, 0, 0]);
    home(&mut fixture, 21_005);
    fixture.is_at(20_000);
    assert!((fixture.truth().position - (20.0 + 2.0 * TAU)).abs() < 0.005);
}

#[test]
fn delay_path_and_coordinate_of_the_zero() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::HOMING_DELAY, 700);
    fixture.write(fn_registers::HOMING_PATH, 2);
    // 90.000 degrees as 90000 thousandths: 1 * 65536 + 24464.
    fixture.write(fn_registers::ZERO_HIGH, 1);
    fixture.write(fn_registers::ZERO_LOW, 24_464);
    fixture.fill(2, 1002, 360_000, 600, [100, 100, 0, 0]);
    fixture.write(fn_registers::HOMING_WAY, 20_000);
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    for _ in 0..2000 {
        fixture.advance(5);
        if (fixture.counts() - 2500).abs() <= 3 && fixture.rpm() == 0 {
            break;
        }
    }
    fixture.advance(400);
    assert!(fixture.busy(), "the delay belongs to homing");
    fixture.is_at(2500);
    fixture.settle(3000);
    fixture.is_at(10_000);
}

#[test]
fn digit_d_says_when() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::HOMING_WAY, 0);
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    assert!(!fixture.busy(), "D = 0");
    fixture.write(fn_registers::ENABLE, 0);
    fixture.write(fn_registers::HOMING_WAY, 10_000);
    fixture.write(fn_registers::ENABLE, 1);
    assert!(fixture.busy(), "D = 1: as soon as powered");
    fixture.settle(10_000);
    fixture.write(fn_registers::ENABLE, 0);
    fixture.write(fn_registers::ENABLE, 1);
    assert!(!fixture.busy(), "once is enough");
}

#[test]
fn the_wrong_side_of_the_switch_is_left_at_the_limit() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.act(Act::Switch { which: 0, at: 6.0 });
    fixture.act(Act::Switch { which: 2, at: -8.0 });
    home(&mut fixture, 20_000);
    fixture.is_at(0);
    assert!((fixture.truth().position - 6.0).abs() < 0.005);
}

#[test]
fn a_stop_ends_homing() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.act(Act::Switch { which: 0, at: f64::NAN });
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    fixture.advance(5000);
    assert!(fixture.busy(), "nothing to find");
    fixture.write(fn_registers::PATH_STOP, 1);
    fixture.settle(1000);
    assert_eq!(fixture.rpm(), 0);
}

#[test]
fn a_speed_that_never_arrives_is_an_alarm() {
    for (number, a, alarm) in [(0x201, 0, 0x1A14), (0x202, 0, 0x1A14), (0x202, 33, 0)] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.write(number, 0);
        fixture.write(fn_registers::HOMING_WAY, 20_000 + a);
        fixture.write(fn_registers::HOMING_TRIGGER, 1);
        fixture.advance(2);
        assert_eq!(
            (fixture.alarm(), fixture.busy()),
            (alarm, alarm == 0),
            "Fn_{number:X}, A = {a}"
        );
    }
}

#[test]
fn an_input_triggers_homing() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::TRIGGER_SOURCE, 0);
    fixture.act(Act::Input(4, true));
    fixture.advance(5);
    fixture.settle(10_000);
    assert!((fixture.truth().position + PI).abs() < 0.005);
}

/// §2.6.1 has two readings of Fn_203 and Fn_204: 1 and 2500 are a turn and a quarter, or 68.036 degrees.
#[test]
fn the_zero_gets_its_coordinate_by_either_reading() {
    for (option, counts) in [("turns", 12_500), ("thousandths", 1_890)] {
        let mut fixture = DriveFixture::positioning(&[("zero", option)]);
        fixture.write(fn_registers::ZERO_HIGH, 1);
        fixture.write(fn_registers::ZERO_LOW, 2500);
        home(&mut fixture, 20_000);
        fixture.is_at(counts);
    }
}
