//! Each mode of operation.

use super::*;

#[test]
fn set_points_are_handed_over_and_reached() {
    let mut desk = DriveFixture::enabled(1);
    assert_eq!(desk.status() & 0x3400, 0, "nothing reached, acknowledged or wrong");
    desk.write(0x607A, 0, 20_000);
    desk.control(0x1F);
    assert_eq!(desk.status() & 0x1400, 0x1000, "acknowledged");
    desk.control(0x0F);
    assert_eq!(desk.status() & 0x1400, 0, "ready for the next");
    desk.wait_for_bit(10, 1000);
    desk.is_at(20_000);
    desk.hand_over_point(5_000, 0x40);
    desk.wait_for_bit(10, 1000);
    desk.is_at(25_000);
    desk.hand_over_point(25_000, 0);
    desk.wait_for_bit(10, 10);
    desk.is_at(25_000);
    desk.write(0x6081, 0, 20_000);
    desk.hand_over_point(0, 0);
    desk.advance(500);
    assert!((desk.turns() + 2.0).abs() < 0.05, "at the profile's speed: {}", desk.turns());
}

#[test]
fn one_set_point_waits_and_the_next_does_not_fit() {
    let mut desk = DriveFixture::enabled(1);
    desk.hand_over_point(20_000, 0);
    desk.hand_over_point(40_000, 0);
    assert_eq!(desk.status() & 0x1000, 0x1000, "no room");
    desk.hand_over_point(60_000, 0);
    desk.wait_for_bit(10, 3000);
    desk.is_at(40_000);
    assert_eq!(desk.status() & 0x1000, 0);
    // At once: what runs and what waits is forgotten.
    desk.hand_over_point(80_000, 0);
    desk.advance(50);
    desk.hand_over_point(90_000, 0);
    desk.hand_over_point(30_000, 0x20);
    desk.wait_for_bit(10, 3000);
    desk.is_at(30_000);
}

#[test]
fn a_point_is_passed_at_speed_where_bit_9_says_so() {
    let lowest = |passing: u16| {
        let mut desk = DriveFixture::enabled(1);
        desk.hand_over_point(20_000, 0);
        desk.hand_over_point(60_000, passing);
        let mut lowest = f64::INFINITY;
        for _ in 0..350 {
            desk.advance(1);
            if desk.position() > 10_000 {
                let speed = desk.turns();
                lowest = lowest.min(speed);
            }
        }
        desk.wait_for_bit(10, 2000);
        desk.is_at(60_000);
        lowest
    };
    assert!(lowest(0x200) > 9.0, "{}", lowest(0x200));
    assert!(lowest(0) < 1.0, "{}", lowest(0));
}

#[test]
fn a_halt_is_gone_on_from() {
    let mut desk = DriveFixture::enabled(1);
    desk.hand_over_point(100_000, 0);
    desk.advance(300);
    desk.control(0x10F);
    desk.wait_for_bit(10, 300);
    let there = desk.position();
    assert!(there < 60_000 && desk.turns().abs() < 0.1);
    desk.advance(300);
    desk.is_at(there);
    desk.control(0x00F);
    assert_eq!(desk.status() & 0x400, 0x400, "until the next tick");
    desk.advance(5);
    desk.wait_for_bit(10, 2000);
    desk.is_at(100_000);
}

#[test]
fn limits_cut_what_is_asked() {
    let mut desk = DriveFixture::enabled(1);
    desk.write(0x607D, 1, -1_000);
    desk.write(0x607D, 2, 30_000);
    desk.hand_over_point(50_000, 0);
    assert_eq!(desk.status() & 0x800, 0x800, "an internal limit acts");
    desk.wait_for_bit(10, 1000);
    desk.is_at(30_000);
    desk.write(0x607F, 0, 20_000);
    desk.hand_over_point(0, 0);
    desk.advance(300);
    assert!((desk.turns() + 2.0).abs() < 0.05);
    let mut desk = DriveFixture::enabled(3);
    desk.write(0x6080, 0, 120);
    desk.write(0x60FF, 0, 90_000);
    desk.advance(300);
    assert!((desk.turns() - 2.0).abs() < 0.05, "2 turns a second: {}", desk.turns());
    assert_eq!(desk.status() & 0x0C00, 0x0800);
}

#[test]
fn velocity_follows_its_ramp_and_windows() {
    let mut desk = DriveFixture::enabled(3);
    assert_eq!(desk.status() & 0x1400, 0, "before the first tick");
    desk.advance(1);
    assert_eq!(desk.status() & 0x1400, 0x1400, "at rest, as asked");
    desk.write(0x6083, 0, 100_000);
    desk.write(0x60FF, 0, 50_000);
    desk.advance(250);
    assert!((desk.turns() - 2.5).abs() < 0.2, "half way up: {}", desk.turns());
    assert_eq!(desk.status() & 0x1400, 0);
    desk.advance(300);
    assert_eq!(desk.status() & 0x1400, 0x0400);
    assert!((desk.read(0x606C, 0) - 50_000).abs() < 500);
    assert!((desk.read(0x606B, 0) - 50_000).abs() < 5);
    desk.write(0x60FF, 0, -50_000);
    desk.advance(1000);
    assert!((desk.turns() + 5.0).abs() < 0.1);
    desk.control(0x10F);
    desk.wait_for_bit(10, 500);
    assert!(desk.turns().abs() < 0.1);
    desk.control(0x0F);
    desk.advance(1000);
    assert!((desk.turns() + 5.0).abs() < 0.1, "the halt is over");
}

#[test]
fn torque_follows_its_slope_and_fades_at_the_speed_limit() {
    let mut desk = DriveFixture::enabled(4);
    desk.act(Act::Jam(true));
    desk.write(0x6087, 0, 1000);
    desk.write(0x6071, 0, 500);
    desk.advance(250);
    let half = desk.read(0x6077, 0);
    assert!((half - 250).abs() < 10, "{half}");
    assert_eq!(desk.status() & 0x400, 0);
    desk.advance(300);
    assert!((desk.read(0x6077, 0) - 500).abs() < 10);
    assert_eq!(desk.status() & 0x400, 0x400);
    desk.act(Act::Jam(false));
    desk.write(0x6080, 0, 300);
    desk.advance(1000);
    assert!((4.0..5.1).contains(&desk.turns()), "{}", desk.turns());
    desk.write(0x6072, 0, 100);
    desk.act(Act::Jam(true));
    desk.advance(1000);
    assert!((desk.read(0x6077, 0) - 100).abs() < 10);
}

#[test]
fn cyclic_positions_are_followed_sync_by_sync() {
    let mut desk = DriveFixture::enabled(8);
    desk.write(0x60C2, 1, 4);
    let mut behind = 0;
    for n in 1..=250_i64 {
        desk.write(0x607A, 0, n * 200);
        desk.sync();
        for _ in 0..4 {
            desk.advance(1);
            behind = behind.max((desk.read(0x6062, 0) - desk.position()).abs());
        }
        assert!((desk.read(0x6062, 0) - n * 200).abs() <= 1, "cycle {n}");
    }
    assert!(behind < 400, "{behind}");
    assert_eq!(desk.status() & 0x3000, 0x1000, "it follows");
    desk.advance(100);
    desk.is_at(50_000);
}

#[test]
fn cyclic_velocity_and_torque_know_no_ramp() {
    let mut desk = DriveFixture::enabled(9);
    desk.write(0x60FF, 0, 30_000);
    desk.write(0x60B1, 0, 10_000);
    desk.advance(30);
    assert!((desk.turns() - 4.0).abs() < 0.3, "{}", desk.turns());
    let mut desk = DriveFixture::enabled(10);
    desk.act(Act::Jam(true));
    desk.write(0x6071, 0, 300);
    desk.write(0x60B2, 0, 100);
    desk.advance(5);
    assert!((desk.read(0x6077, 0) - 400).abs() < 10);
}

#[test]
fn a_mode_that_is_none_is_refused_and_a_change_brakes() {
    let mut desk = DriveFixture::enabled(3);
    for wrong in [-1, 2, 5, 7, 11] {
        assert_eq!(desk.try_write(0x6060, 0, wrong), Err(AbortCode::VALUE));
    }
    desk.write(0x60FF, 0, 50_000);
    desk.advance(200);
    desk.write(0x6060, 0, 1);
    assert_eq!(desk.read(0x6061, 0), 1);
    desk.advance(200);
    assert!(desk.turns().abs() < 0.1);
    let there = desk.position();
    desk.hand_over_point(10_000, 0x40);
    desk.wait_for_bit(10, 1000);
    desk.is_at(there + 10_000);
}

#[test]
fn units_go_by_gear_and_feed() {
    let mut desk = DriveFixture::enabled(1);
    // 360 units a turn of the shaft, ten turns of the motor to one of the shaft.
    desk.write(0x6091, 1, 10);
    desk.write(0x6092, 1, 360);
    desk.write(0x6081, 0, 360);
    desk.write(0x6083, 0, 3600);
    desk.write(0x6084, 0, 3600);
    desk.hand_over_point(90, 0);
    desk.wait_for_bit(10, 2000);
    assert!((desk.truth().position / TAU - 2.5).abs() < 0.03, "{}", desk.truth().position / TAU);
    assert!((desk.read(0x6063, 0) - 25_000).abs() < 300);
}

#[test]
fn polarity_turns_positions_and_speeds_round() {
    let mut desk = DriveFixture::enabled(1);
    desk.write(0x607E, 0, 0x80);
    desk.write(0x607D, 1, -5_000);
    desk.write(0x607D, 2, 90_000);
    desk.hand_over_point(20_000, 0);
    desk.wait_for_bit(10, 1000);
    desk.is_at(20_000);
    assert!((desk.truth().position / TAU + 2.0).abs() < 0.01);
    assert!(desk.read(0x6063, 0) < 0, "increments are the motor's own");
    desk.hand_over_point(-20_000, 0);
    desk.wait_for_bit(10, 1000);
    desk.is_at(-5_000);
    let mut desk = DriveFixture::enabled(3);
    desk.write(0x607E, 0, 0x40);
    desk.write(0x60FF, 0, 30_000);
    desk.advance(300);
    assert!((desk.turns() + 3.0).abs() < 0.05);
    assert!((desk.read(0x606C, 0) - 30_000).abs() < 300);
}

#[test]
fn limit_switches_stop_the_motor_and_let_it_back() {
    for mode in [1, 3, 8, 9] {
        let mut desk = DriveFixture::enabled(mode);
        desk.act(Act::Switch { which: 1, at: 4.0 * TAU });
        match mode {
            1 => desk.hand_over_point(90_000, 0),
            3 | 9 => desk.write(0x60FF, 0, 30_000),
            _ => {
                for n in 0..100 {
                    desk.write(0x607A, 0, n * 500);
                    desk.advance(10);
                }
            }
        }
        desk.advance(2500);
        let at = desk.truth().position / TAU;
        assert!((4.0..4.4).contains(&at), "mode {mode}: {at}");
        assert_eq!(desk.status() & 0x800, 0x800, "mode {mode}");
        assert_eq!(desk.read(0x60FD, 0) & 7, 2 | 4, "positive limit, and the home switch");
        match mode {
            1 => desk.hand_over_point(0, 0),
            3 | 9 => desk.write(0x60FF, 0, -30_000),
            _ => desk.write(0x607A, 0, 39_000),
        }
        desk.advance(200);
        assert!(desk.truth().position / TAU < 4.0, "mode {mode}");
    }
}
