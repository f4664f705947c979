//! Each mode of operation.

use super::*;

#[test]
fn set_points_are_handed_over_and_reached() {
    let mut fixture = DriveFixture::enabled(1);
    assert_eq!(fixture.status() & 0x3400, 0, "nothing reached, acknowledged or wrong");
    fixture.write(0x607A, 0, 20_000);
    fixture.control(0x1F);
    assert_eq!(fixture.status() & 0x1400, 0x1000, "acknowledged");
    fixture.control(0x0F);
    assert_eq!(fixture.status() & 0x1400, 0, "ready for the next");
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(20_000);
    fixture.hand_over_point(5_000, 0x40);
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(25_000);
    fixture.hand_over_point(25_000, 0);
    fixture.wait_for_bit(10, 10);
    fixture.is_at(25_000);
    fixture.write(0x6081, 0, 20_000);
    fixture.hand_over_point(0, 0);
    fixture.advance(500);
    assert!((fixture.turns() + 2.0).abs() < 0.05, "at the profile's speed: {}", fixture.turns());
}

#[test]
fn one_set_point_waits_and_the_next_does_not_fit() {
    let mut fixture = DriveFixture::enabled(1);
    fixture.hand_over_point(20_000, 0);
    fixture.hand_over_point(40_000, 0);
    assert_eq!(fixture.status() & 0x1000, 0x1000, "no room");
    fixture.hand_over_point(60_000, 0);
    fixture.wait_for_bit(10, 3000);
    fixture.is_at(40_000);
    assert_eq!(fixture.status() & 0x1000, 0);
    // At once: what runs and what waits is forgotten.
    fixture.hand_over_point(80_000, 0);
    fixture.advance(50);
    fixture.hand_over_point(90_000, 0);
    fixture.hand_over_point(30_000, 0x20);
    fixture.wait_for_bit(10, 3000);
    fixture.is_at(30_000);
}

#[test]
fn a_point_is_passed_at_speed_where_bit_9_says_so() {
    let lowest = |passing: u16| {
        let mut fixture = DriveFixture::enabled(1);
        fixture.hand_over_point(20_000, 0);
        fixture.hand_over_point(60_000, passing);
        let mut lowest = f64::INFINITY;
        for _ in 0..350 {
            fixture.advance(1);
            if fixture.position() > 10_000 {
                let speed = fixture.turns();
                lowest = lowest.min(speed);
            }
        }
        fixture.wait_for_bit(10, 2000);
        fixture.is_at(60_000);
        lowest
    };
    assert!(lowest(0x200) > 9.0, "{}", lowest(0x200));
    assert!(lowest(0) < 1.0, "{}", lowest(0));
}

#[test]
fn a_halt_is_gone_on_from() {
    let mut fixture = DriveFixture::enabled(1);
    fixture.hand_over_point(100_000, 0);
    fixture.advance(300);
    fixture.control(0x10F);
    fixture.wait_for_bit(10, 300);
    let there = fixture.position();
    assert!(there < 60_000 && fixture.turns().abs() < 0.1);
    fixture.advance(300);
    fixture.is_at(there);
    fixture.control(0x00F);
    assert_eq!(fixture.status() & 0x400, 0x400, "until the next tick");
    fixture.advance(5);
    fixture.wait_for_bit(10, 2000);
    fixture.is_at(100_000);
}

#[test]
fn limits_cut_what_is_asked() {
    let mut fixture = DriveFixture::enabled(1);
    fixture.write(0x607D, 1, -1_000);
    fixture.write(0x607D, 2, 30_000);
    fixture.hand_over_point(50_000, 0);
    assert_eq!(fixture.status() & 0x800, 0x800, "an internal limit acts");
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(30_000);
    fixture.write(0x607F, 0, 20_000);
    fixture.hand_over_point(0, 0);
    fixture.advance(300);
    assert!((fixture.turns() + 2.0).abs() < 0.05);
    let mut fixture = DriveFixture::enabled(3);
    fixture.write(0x6080, 0, 120);
    fixture.write(0x60FF, 0, 90_000);
    fixture.advance(300);
    assert!((fixture.turns() - 2.0).abs() < 0.05, "2 turns a second: {}", fixture.turns());
    assert_eq!(fixture.status() & 0x0C00, 0x0800);
}

#[test]
fn velocity_follows_its_ramp_and_windows() {
    let mut fixture = DriveFixture::enabled(3);
    assert_eq!(fixture.status() & 0x1400, 0, "before the first tick");
    fixture.advance(1);
    assert_eq!(fixture.status() & 0x1400, 0x1400, "at rest, as asked");
    fixture.write(0x6083, 0, 100_000);
    fixture.write(0x60FF, 0, 50_000);
    fixture.advance(250);
    assert!((fixture.turns() - 2.5).abs() < 0.2, "half way up: {}", fixture.turns());
    assert_eq!(fixture.status() & 0x1400, 0);
    fixture.advance(300);
    assert_eq!(fixture.status() & 0x1400, 0x0400);
    assert!((fixture.read(0x606C, 0) - 50_000).abs() < 500);
    assert!((fixture.read(0x606B, 0) - 50_000).abs() < 5);
    fixture.write(0x60FF, 0, -50_000);
    fixture.advance(1000);
    assert!((fixture.turns() + 5.0).abs() < 0.1);
    fixture.control(0x10F);
    fixture.wait_for_bit(10, 500);
    assert!(fixture.turns().abs() < 0.1);
    fixture.control(0x0F);
    fixture.advance(1000);
    assert!((fixture.turns() + 5.0).abs() < 0.1, "the halt is over");
}

#[test]
fn torque_follows_its_slope_and_fades_at_the_speed_limit() {
    let mut fixture = DriveFixture::enabled(4);
    fixture.act(Act::Jam(true));
    fixture.write(0x6087, 0, 1000);
    fixture.write(0x6071, 0, 500);
    fixture.advance(250);
    let half = fixture.read(0x6077, 0);
    assert!((half - 250).abs() < 10, "{half}");
    assert_eq!(fixture.status() & 0x400, 0);
    fixture.advance(300);
    assert!((fixture.read(0x6077, 0) - 500).abs() < 10);
    assert_eq!(fixture.status() & 0x400, 0x400);
    fixture.act(Act::Jam(false));
    fixture.write(0x6080, 0, 300);
    fixture.advance(1000);
    assert!((4.0..5.1).contains(&fixture.turns()), "{}", fixture.turns());
    fixture.write(0x6072, 0, 100);
    fixture.act(Act::Jam(true));
    fixture.advance(1000);
    assert!((fixture.read(0x6077, 0) - 100).abs() < 10);
}

#[test]
fn cyclic_positions_are_followed_sync_by_sync() {
    let mut fixture = DriveFixture::enabled(8);
    fixture.write(0x60C2, 1, 4);
    let mut behind = 0;
    for n in 1..=250_i64 {
        fixture.write(0x607A, 0, n * 200);
        fixture.sync();
        for _ in 0..4 {
            fixture.advance(1);
            behind = behind.max((fixture.read(0x6062, 0) - fixture.position()).abs());
        }
        assert!((fixture.read(0x6062, 0) - n * 200).abs() <= 1, "cycle {n}");
    }
    assert!(behind < 400, "{behind}");
    assert_eq!(fixture.status() & 0x3000, 0x1000, "it follows");
    fixture.advance(100);
    fixture.is_at(50_000);
}

#[test]
fn cyclic_velocity_and_torque_know_no_ramp() {
    let mut fixture = DriveFixture::enabled(9);
    fixture.write(0x60FF, 0, 30_000);
    fixture.write(0x60B1, 0, 10_000);
    fixture.advance(30);
    assert!((fixture.turns() - 4.0).abs() < 0.3, "{}", fixture.turns());
    let mut fixture = DriveFixture::enabled(10);
    fixture.act(Act::Jam(true));
    fixture.write(0x6071, 0, 300);
    fixture.write(0x60B2, 0, 100);
    fixture.advance(5);
    assert!((fixture.read(0x6077, 0) - 400).abs() < 10);
}

#[test]
fn a_mode_that_is_none_is_refused_and_a_change_brakes() {
    let mut fixture = DriveFixture::enabled(3);
    for wrong in [-1, 5, 11] {
        assert_eq!(fixture.try_write(0x6060, 0, wrong), Err(AbortCode::VALUE));
    }
    fixture.write(0x60FF, 0, 50_000);
    fixture.advance(200);
    fixture.write(0x6060, 0, 1);
    assert_eq!(fixture.read(0x6061, 0), 1);
    fixture.advance(200);
    assert!(fixture.turns().abs() < 0.1);
    let there = fixture.position();
    fixture.hand_over_point(10_000, 0x40);
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(there + 10_000);
}

/// CiA 402-2, velocity mode: the ramp follows 6042h while bits 4 to 6 are set, and bit 8 halts.
#[test]
fn an_inverter_turns_by_its_velocity_mode() {
    let mut fixture = DriveFixture::enabled(2);
    fixture.write(0x6048, 1, 3000);
    fixture.write(0x6042, 0, 600);
    fixture.advance(300);
    assert_eq!(fixture.read(0x6044, 0), 0, "the ramp does not follow");
    fixture.control(0x7F);
    fixture.advance(100);
    assert!((200..400).contains(&fixture.read(0x6044, 0)), "3000 rpm/s");
    fixture.advance(900);
    assert_eq!((fixture.read(0x6043, 0), fixture.read(0x6044, 0)), (600, 600));
    fixture.write(0x6046, 1, 900);
    fixture.advance(900);
    assert_eq!(fixture.read(0x6044, 0), 900, "the least speed");
    fixture.control(0x17F);
    fixture.advance(1500);
    assert_eq!(fixture.read(0x6044, 0), 0, "halted");
    // Steps of 0.5 rpm.
    fixture.write(0x604C, 2, 2);
    fixture.write(0x6046, 1, 0);
    fixture.control(0x7F);
    fixture.advance(1500);
    assert_eq!(fixture.read(0x6044, 0), 600);
    let rpm = fixture.truth().velocity / TAU * 60.0;
    assert!((rpm - 300.0).abs() < 1.0, "{rpm}");
}

#[test]
fn units_go_by_gear_and_feed() {
    let mut fixture = DriveFixture::enabled(1);
    // 360 units a turn of the shaft, ten turns of the motor to one of the shaft.
    fixture.write(0x6091, 1, 10);
    fixture.write(0x6092, 1, 360);
    fixture.write(0x6081, 0, 360);
    fixture.write(0x6083, 0, 3600);
    fixture.write(0x6084, 0, 3600);
    fixture.hand_over_point(90, 0);
    fixture.wait_for_bit(10, 2000);
    assert!(
        (fixture.truth().position / TAU - 2.5).abs() < 0.03,
        "{}",
        fixture.truth().position / TAU
    );
    assert!((fixture.read(0x6063, 0) - 25_000).abs() < 300);
}

#[test]
fn polarity_turns_positions_and_speeds_round() {
    let mut fixture = DriveFixture::enabled(1);
    fixture.write(0x607E, 0, 0x80);
    fixture.write(0x607D, 1, -5_000);
    fixture.write(0x607D, 2, 90_000);
    fixture.hand_over_point(20_000, 0);
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(20_000);
    assert!((fixture.truth().position / TAU + 2.0).abs() < 0.01);
    assert!(fixture.read(0x6063, 0) < 0, "increments are the motor's own");
    fixture.hand_over_point(-20_000, 0);
    fixture.wait_for_bit(10, 1000);
    fixture.is_at(-5_000);
    let mut fixture = DriveFixture::enabled(3);
    fixture.write(0x607E, 0, 0x40);
    fixture.write(0x60FF, 0, 30_000);
    fixture.advance(300);
    assert!((fixture.turns() + 3.0).abs() < 0.05);
    assert!((fixture.read(0x606C, 0) - 30_000).abs() < 300);
}

#[test]
fn limit_switches_stop_the_motor_and_let_it_back() {
    for mode in [1, 3, 8, 9] {
        let mut fixture = DriveFixture::enabled(mode);
        fixture.act(Act::Switch { which: 1, at: 4.0 * TAU });
        match mode {
            1 => fixture.hand_over_point(90_000, 0),
            3 | 9 => fixture.write(0x60FF, 0, 30_000),
            _ => {
                for n in 0..100 {
                    fixture.write(0x607A, 0, n * 500);
                    fixture.advance(10);
                }
            }
        }
        fixture.advance(2500);
        let at = fixture.truth().position / TAU;
        assert!((4.0..4.4).contains(&at), "mode {mode}: {at}");
        assert_eq!(fixture.status() & 0x800, 0x800, "mode {mode}");
        assert_eq!(fixture.read(0x60FD, 0) & 7, 2 | 4, "positive limit, and the home switch");
        match mode {
            1 => fixture.hand_over_point(0, 0),
            3 | 9 => fixture.write(0x60FF, 0, -30_000),
            _ => fixture.write(0x607A, 0, 39_000),
        }
        fixture.advance(200);
        assert!(fixture.truth().position / TAU < 4.0, "mode {mode}");
    }
}
