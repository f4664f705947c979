//! The observer itself: each thing that a drive must not do is noticed.

use super::*;

use polepair_core::plant::Setpoint;

/// A motor at rest, powered, held to 10 rad/s, 100 rad/s² and 2 A.
fn held() -> GroundTruth {
    let bounds = ServoBounds { velocity: 10.0, acceleration: 100.0, current: 2.0 };
    GroundTruth {
        enabled: true,
        bounds,
        setpoint: Some(Setpoint::default()),
        ..GroundTruth::default()
    }
}

fn at(ms: u32) -> Instant {
    Instant::ZERO.plus_ms(ms)
}

/// An observer that saw the drive at rest for a second, and nothing asked.
fn rested() -> MotionObserver {
    let mut witness = MotionObserver::default();
    for ms in 0..=1_000 {
        assert_eq!(witness.check(at(ms), held(), false), None);
    }
    witness
}

fn invariant(found: Option<MotionViolation>) -> Option<&'static str> {
    found.map(|(invariant, _)| invariant)
}

#[test]
fn an_unawaited_outcome_is_noticed() {
    let started = GroundTruth { starts: 1, ..held() };
    assert_eq!(invariant(rested().check(at(1_001), started, false)), Some("I4"));
    assert_eq!(rested().check(at(1_001), started, true), None, "somebody waits for it");
    let mut cut = rested();
    cut.record_link_lost();
    assert_eq!(invariant(cut.check(at(1_001), started, false)), Some("I6"));
    cut.record_verb(at(1_002), &started, None);
    assert_eq!(cut.check(at(1_003), GroundTruth { starts: 2, ..started }, true), None);
}

#[test]
fn a_request_executed_twice_is_noticed() {
    let mut witness = rested();
    witness.record_verb(at(1_001), &held(), None);
    assert_eq!(witness.check(at(1_002), GroundTruth { unrepeatable: 1, ..held() }, true), None);
    let twice = GroundTruth { unrepeatable: 2, ..held() };
    assert_eq!(invariant(witness.check(at(1_003), twice, true)), Some("I2"));
}

#[test]
fn a_way_that_is_left_is_noticed() {
    let locate = |position| GroundTruth { position, velocity: 1.0, ..held() };
    let mut witness = rested();
    witness.record_verb(at(1_001), &held(), Some(-5.0));
    assert_eq!(witness.check(at(1_002), locate(-5.1), true), None);
    assert_eq!(invariant(witness.check(at(1_003), locate(-5.5), true)), Some("I14"));
    witness.record_verb(at(1_004), &held(), Some(-5.0));
    assert_eq!(witness.check(at(1_005), locate(-9.0), true), None, "it did not begin at rest");
}

#[test]
fn a_ramp_may_start_anew_from_the_motor() {
    let set = |velocity| Some(Setpoint { velocity, ..Setpoint::default() });
    let turning = GroundTruth { velocity: 3.0, ..held() };
    for (requested, expected) in [(3.9, None), (4.9, Some("I14"))] {
        let mut witness = rested();
        assert_eq!(witness.check(at(1_010), turning, true), None);
        let anew = GroundTruth { setpoint: set(requested), ..turning };
        assert_eq!(invariant(witness.check(at(1_020), anew, true)), expected);
    }
}

#[test]
fn a_value_beyond_a_bound_is_noticed() {
    let set = |velocity| Some(Setpoint { velocity, ..Setpoint::default() });
    let cases = [
        (GroundTruth { setpoint: set(0.9), velocity: 1.1, current: 1.9, ..held() }, None),
        (GroundTruth { setpoint: set(10.1), ..held() }, Some("I14")),
        (GroundTruth { setpoint: set(2.0), ..held() }, Some("I14")),
        (GroundTruth { velocity: 17.0, ..held() }, Some("I14")),
        (GroundTruth { current: -2.2, ..held() }, Some("I14")),
        (GroundTruth { current: -2.2, setpoint: None, ..held() }, None),
    ];
    for (truth, expected) in cases {
        assert_eq!(invariant(rested().check(at(1_010), truth, true)), expected, "{truth:?}");
    }
}

/// A motor that had turned the other way overshoots by a share of the whole step, and only for as long as
/// its loops take to settle.
#[test]
fn a_motor_overshoots_by_a_share_of_the_step() {
    let turning = |velocity| GroundTruth { velocity, ..held() };
    let turned_back = |before: f64, pause_ms: u32, after: f64| {
        let mut witness = rested();
        assert_eq!(
            witness.check(at(1_001), GroundTruth { enabled: false, ..turning(before) }, true),
            None
        );
        for ms in 1_002..1_002 + pause_ms {
            assert_eq!(witness.check(at(ms), turning(0.0), true), None);
        }
        invariant(witness.check(at(1_002 + pause_ms), turning(after), true))
    };
    // 10 rad/s + 13.6 % of 45 + 5.
    assert_eq!(turned_back(-35.0, 20, 16.8), None);
    assert_eq!(turned_back(-35.0, 20, 21.5), Some("I14"));
    assert_eq!(turned_back(35.0, 20, -16.8), None);
    assert_eq!(turned_back(35.0, 20, 16.8), Some("I14"), "it turned no other way");
    assert_eq!(turned_back(-35.0, 100, 16.8), Some("I14"), "that is long past");
}
