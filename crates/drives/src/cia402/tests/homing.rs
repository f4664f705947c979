//! Every homing method, from every side.

use super::*;

const METHODS: [i8; 31] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28,
    29, 30, 33, 34, 37,
];
/// The limit switches, and the sides of the home switch, rad.
const LIMITS: (f64, f64) = (-30.0, 30.0);
const HOME: (f64, f64) = (2.0, 9.0);

/// Expected zero: an edge, or the first index pulse beyond it in that direction.
fn expected(method: i8, start: f64) -> f64 {
    let before = |x: f64| libm::floor(x / TAU) * TAU;
    let behind = |x: f64| libm::ceil(x / TAU) * TAU;
    let (edge, toward) = match if method > 16 { method - 16 } else { method } {
        _ if method == 33 => return before(start),
        _ if method == 34 => return behind(start),
        _ if method > 34 => return start,
        1 => (LIMITS.0, 1.0),
        2 => (LIMITS.1, -1.0),
        3 | 7 | 14 => (HOME.0, -1.0),
        4 | 8 | 13 => (HOME.0, 1.0),
        5 | 10 | 11 => (HOME.1, 1.0),
        _ => (HOME.1, -1.0),
    };
    if method > 16 {
        edge
    } else if toward > 0.0 {
        behind(edge)
    } else {
        before(edge)
    }
}

/// A drive with all switches, its motor at `start` (rad).
fn desk_at(method: i8, start: f64) -> DriveFixture {
    let mut fixture = DriveFixture::enabled(1);
    let positive = matches!(method, 3 | 4 | 19 | 20);
    let negative = matches!(method, 5 | 6 | 21 | 22);
    fixture.act(Act::Switch { which: 1, at: LIMITS.1 });
    fixture.act(Act::Switch { which: 2, at: LIMITS.0 });
    fixture.act(Act::Switch { which: 0, at: if negative { -1e9 } else { HOME.0 } });
    fixture.act(Act::Switch { which: 3, at: if positive { 1e9 } else { HOME.1 } });
    fixture.hand_over_point((start / TAU * 10_000.0) as i64, 0);
    fixture.wait_for_bit(10, 3000);
    fixture
}

#[test]
fn every_method_finds_its_zero_from_everywhere() {
    for method in METHODS {
        for start in [-15.0, 5.0, 20.0] {
            let mut fixture = desk_at(method, start);
            let from = fixture.truth().position;
            fixture.write(0x6060, 0, 6);
            fixture.write(0x6098, 0, method.into());
            fixture.write(0x607C, 0, 1000);
            fixture.control(0x1F);
            fixture.advance(1);
            if method != 37 {
                assert_eq!(fixture.status() & 0x3400, 0, "{method}: under way");
            }
            fixture.wait_for_bit(12, 30_000);
            fixture.wait_for_bit(10, 100);
            assert_eq!(fixture.status() & 0x3400, 0x1400, "{method}: attained");
            // The zero is 1000 increments beyond the home position.
            let found =
                fixture.truth().position - (fixture.position() + 1000) as f64 / 10_000.0 * TAU;
            let wanted = expected(method, from);
            assert!((found - wanted).abs() < 0.02, "{method} from {start}: {found}, not {wanted}");
        }
    }
}

#[test]
fn a_mechanical_stop_is_felt() {
    for (method, index) in [(-17, false), (-18, false), (-1, true), (-2, true)] {
        let mut fixture = DriveFixture::enabled(6);
        fixture.write(0x6098, 0, method);
        fixture.control(0x1F);
        fixture.advance(300);
        fixture.act(Act::Jam(true));
        let stop = fixture.truth().position;
        assert_eq!(stop > 0.0, matches!(method, -2 | -18));
        fixture.advance(300);
        fixture.act(Act::Jam(false));
        fixture.wait_for_bit(12, 5000);
        let zero = fixture.truth().position - fixture.position() as f64 / 10_000.0 * TAU;
        let back = if stop > 0.0 { libm::floor(stop / TAU) } else { libm::ceil(stop / TAU) } * TAU;
        let wanted = if index { back } else { stop };
        assert!((zero - wanted).abs() < 0.05, "{method}: {zero}, not {wanted}");
    }
}

#[test]
fn homing_is_interrupted_halted_and_fails() {
    let mut fixture = DriveFixture::enabled(6);
    for wrong in [15, 16, 31, 32, 36, 38, -3] {
        assert_eq!(fixture.try_write(0x6098, 0, wrong), Err(AbortCode::VALUE), "reserved");
    }
    fixture.write(0x6098, 0, 1);
    fixture.control(0x1F);
    fixture.advance(200);
    assert!(fixture.turns() < -1.0);
    fixture.control(0x0F);
    fixture.wait_for_bit(10, 300);
    assert_eq!(fixture.status() & 0x3400, 0x0400, "interrupted");
    fixture.control(0x1F);
    fixture.advance(200);
    fixture.control(0x11F);
    fixture.wait_for_bit(10, 300);
    assert!(fixture.turns().abs() < 0.1);
    // No switch anywhere: both limits are met, again and again.
    fixture.act(Act::Switch { which: 0, at: f64::NAN });
    fixture.act(Act::Switch { which: 1, at: 3.0 });
    fixture.act(Act::Switch { which: 2, at: -12.0 });
    fixture.write(0x6098, 0, 7);
    fixture.control(0x0F);
    fixture.control(0x1F);
    fixture.wait_for_bit(13, 60_000);
    assert_eq!(fixture.status() & 0x1000, 0, "an error, not a zero");
    fixture.write(0x6099, 2, 0);
    fixture.control(0x0F);
    fixture.control(0x1F);
    assert_eq!(fixture.status() & 0x2000, 0, "until the tick");
    fixture.advance(1);
    assert_eq!(fixture.status() & 0x2000, 0x2000, "without speed it would never arrive");
}
