//! The observer itself: what it takes, and what it does not.

use super::*;
use crate::drives::DRIVE_KINDS;

/// An axis that turned when the server ended was reported, and its wire was not well in time; nothing else is
/// accepted.
#[test]
fn only_a_reported_axis_may_turn_when_the_server_has_ended() {
    let kind = &DRIVE_KINDS[0];
    let mut watch = StopObserver::new(kind, 0);
    let now = Instant::ZERO.plus_ms(100_000);
    let long = (STOP_ARRIVAL.as_millis() as u32) + kind.ramp_ms;
    let well = |ms: u32| Some(Instant::ZERO.plus_ms(100_000 - ms));
    assert_eq!(watch.check_after_shutdown(now, false, well(60_000)), None, "it stands");
    let truth = GroundTruth { velocity: 20.0, enabled: true, ..GroundTruth::default() };
    watch.check(now, truth, None, None, false);
    for late in [None, well(0), well(long)] {
        assert_eq!(watch.check_after_shutdown(now, true, late), None);
        assert!(watch.check_after_shutdown(now, false, late).is_some(), "nobody was told of it");
    }
    assert!(
        watch.check_after_shutdown(now, true, well(long + 1)).is_some(),
        "there was time enough"
    );
}

/// A stop by its lease's holder is pending like any other, its alarm comes later, and the holder's next
/// command ends it.
#[test]
fn a_stop_of_the_holder_is_pending_until_it_continues() {
    let kind = &DRIVE_KINDS[0];
    let at = |ms: u32| Instant::ZERO.plus_ms(ms);
    let truth = GroundTruth { velocity: 20.0, enabled: true, ..GroundTruth::default() };
    let broken = |goes_on: bool| {
        let mut watch = StopObserver::new(kind, 0);
        watch.record_lease(Some(1), at(0));
        (watch.moved_epoch, watch.standing_since) = (Some(1), None);
        watch.record_motion_order(1, at(10));
        watch.require_holder_stop(2, at(20));
        assert_eq!(watch.stop_pending_since, None, "that lease is nobody's");
        watch.require_holder_stop(1, at(20));
        if goes_on {
            watch.record_motion_order(1, at(500));
        }
        let mut found = Vec::new();
        for ms in (100..20_000 + kind.ramp_ms).step_by(10) {
            let broke = watch.check(at(ms), truth, Some(at(0)), Some(false), false);
            found.extend(broke.into_iter().map(|(invariant, _)| (invariant, ms)));
        }
        found
    };
    assert_eq!(broken(true), []);
    let found = broken(false);
    let when = |what: &str| found.iter().find(|(invariant, _)| *invariant == what).map(|f| f.1);
    assert!(when("G2").is_some_and(|ms| (2_250..2_400).contains(&ms)), "{found:?}");
    assert!(when("G1").is_some_and(|ms| ms >= 3_000), "{found:?}");
}
