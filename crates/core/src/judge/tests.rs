//! Verdicts of motions whose readings the test decides.

use super::*;
use crate::profile::Encoding;

/// 10000 counts a turn: 0.5 deg are 13.9 counts, 0.5 rpm are 83 counts a second.
const TOLERANCE: Tolerance = Tolerance {
    encoding: Encoding::I32,
    window: 13.9,
    noise: 3.5,
    standstill: Some(83.0),
    drift: 83.0,
    speed: None,
};

fn at(ms: u32) -> Instant {
    Instant::ZERO.plus_ms(ms)
}

/// A drive that is read every 20 ms, and what it reports then.
fn watch(
    judge: &mut MotionJudge,
    from_ms: u32,
    to_ms: u32,
    seen: impl Fn(u32) -> Observation,
) -> (u32, MotionVerdict) {
    for ms in (from_ms..to_ms).step_by(20) {
        judge.observe(at(ms), &seen(ms));
        let mut verdict = judge.verdict(at(ms));
        if verdict == MotionVerdict::Examine {
            judge.mark_examined(at(ms));
            judge.observe(at(ms), &seen(ms));
            verdict = judge.verdict(at(ms));
        }
        if verdict != MotionVerdict::Pending {
            return (ms, verdict);
        }
    }
    (to_ms, MotionVerdict::Pending)
}

fn to(target: i64) -> MotionJudge {
    let mut judge = MotionJudge::new(MotionGoal::Position([Some(target), None]), TOLERANCE);
    judge.observe_before(at(0), &Observation { position: Some(0), ..Observation::default() });
    judge
}

fn seen(position: i64, speed: f64, flag: bool) -> Observation {
    Observation {
        position: Some(position),
        speed: Some(speed),
        flag: Some(flag),
        enabled: Some(true),
        ..Observation::default()
    }
}

#[test]
fn a_position_within_the_window_is_an_arrival_when_the_flag_is_set() {
    let mut judge = to(10_000);
    let drive = |ms: u32| match ms {
        0..1000 => seen(i64::from(ms) * 10, 10_000.0, false),
        _ => seen(9_995, 0.0, true),
    };
    assert_eq!(watch(&mut judge, 0, 5000, drive), (1000, MotionVerdict::Arrived));
}

#[test]
fn a_flag_that_is_left_over_from_an_earlier_move_ends_nothing() {
    let mut judge = to(10_000);
    let drive = |ms: u32| match ms {
        0..80 => seen(0, 0.0, true),
        80..1000 => seen(i64::from(ms) * 10, 10_000.0, false),
        _ => seen(10_000, 0.0, true),
    };
    assert_eq!(watch(&mut judge, 0, 5000, drive), (1000, MotionVerdict::Arrived));
}

#[test]
fn a_set_flag_elsewhere_ends_the_wait_with_the_reason() {
    let mut judge = to(20_000);
    let limit = |ms: u32| Observation {
        positive_limit: Some(true),
        negative_limit: Some(true),
        ..seen(i64::from(ms.min(500)) * 10, if ms < 500 { 10_000.0 } else { 0.0 }, ms >= 500)
    };
    let (ms, verdict) = watch(&mut judge, 0, 5000, limit);
    assert_eq!(verdict, MotionVerdict::Ended(EndReason::Limit(LimitEnd::Either)));
    assert!((800..900).contains(&ms), "{ms}");
    // One at the other end did not stop it.
    let mut judge = to(20_000);
    let other = |ms| Observation { positive_limit: Some(false), ..limit(ms) };
    assert_eq!(watch(&mut judge, 0, 5000, other).1, MotionVerdict::Ended(EndReason::Unknown));
}

#[test]
fn an_axis_that_never_starts_is_reported_as_such() {
    let mut judge = to(20_000);
    let (ms, verdict) = watch(&mut judge, 0, 5000, |_| seen(0, 0.0, true));
    assert_eq!(verdict, MotionVerdict::Ended(EndReason::NotStarted));
    assert!((1200..1300).contains(&ms), "a late fault was waited for: {ms}");
    // Without a report of its end it may still begin: its brake opens.
    let mut judge = to(20_000);
    let (ms, verdict) = watch(&mut judge, 0, 5000, |_| seen(0, 0.0, false));
    assert_eq!(verdict, MotionVerdict::Ended(EndReason::NotStarted));
    assert!((2900..3000).contains(&ms), "{ms}");
}

#[test]
fn faults_and_lost_power_come_before_other_reasons() {
    let mut judge = to(20_000);
    let off = |ms: u32| Observation {
        enabled: Some(ms < 200),
        fault: Some(if ms < 200 { 0 } else { 7 }),
        ..seen(i64::from(ms) * 10, 10_000.0, false)
    };
    assert_eq!(watch(&mut judge, 0, 5000, off), (200, MotionVerdict::Faulted(7)));
    let mut judge = to(20_000);
    let off = |ms: u32| Observation { fault: Some(0), ..off(ms) };
    assert_eq!(watch(&mut judge, 0, 5000, off), (200, MotionVerdict::PowerLost));
}

#[test]
fn a_fault_code_from_before_the_motion_is_not_its_fault() {
    let mut judge = to(1_000);
    judge.observe_before(at(0), &Observation { fault: Some(0x8611), ..Observation::default() });
    let stale = |ms: u32| Observation {
        fault: Some(0x8611),
        ..seen(i64::from(ms.min(100)) * 10, 0.0, ms >= 100)
    };
    assert_eq!(watch(&mut judge, 0, 5000, stale), (100, MotionVerdict::Arrived));
}

#[test]
fn a_halt_and_another_mode_name_another_master() {
    let halted = |ms: u32| seen(i64::from(ms.min(500)) * 10, 0.0, ms >= 500);
    let mut judge = to(20_000);
    let halt = |ms| Observation { halted: Some(true), ..halted(ms) };
    assert_eq!(watch(&mut judge, 0, 5000, halt).1, MotionVerdict::Ended(EndReason::Halted));
    let mut judge = to(20_000);
    let mode = |ms: u32| Observation { mode: Some(if ms < 500 { 1 } else { 3 }), ..halted(ms) };
    assert_eq!(watch(&mut judge, 0, 5000, mode).1, MotionVerdict::Ended(EndReason::Mode(3)));
}

#[test]
fn a_counter_that_wraps_around_is_no_distance() {
    let tolerance = Tolerance { encoding: Encoding::I16, ..TOLERANCE };
    assert_eq!(tolerance.distance(32_000, -32_000), 1536.0);
    assert_eq!(tolerance.distance(-32_000, 32_000), -1536.0);
    let real = Tolerance { encoding: Encoding::F32, ..TOLERANCE };
    let bits = |number: f32| i64::from(number.to_bits());
    assert_eq!(real.distance(bits(1.5), bits(-2.0)), -3.5);
}

#[test]
fn a_slow_motion_is_no_standstill() {
    // 0.1 rpm: 17 counts a second, slower than the speed that means standstill.
    let mut judge = to(170);
    judge.tolerance.speed = Some(16.7);
    let drive = |ms: u32| seen(i64::from(ms.min(10_000)) / 60, 16.7, ms >= 10_000);
    assert_eq!(watch(&mut judge, 0, 20_000, drive).1, MotionVerdict::Arrived);
}

#[test]
fn standstill_needs_several_slow_readings_and_a_position_that_stays() {
    let stop = || MotionJudge::new(MotionGoal::Standstill, TOLERANCE);
    let braking = |ms: u32| {
        let speed = 10_000.0 - 10.0 * f64::from(ms);
        seen(i64::from(ms) * 5, speed.max(0.0), false)
    };
    let (ms, verdict) = watch(&mut stop(), 0, 5000, |ms| match ms {
        0..1000 => braking(ms),
        _ => seen(5_000, 0.0, false),
    });
    assert_eq!(verdict, MotionVerdict::Arrived);
    assert!((1100..1140).contains(&ms), "{ms}");
    // A speed that reads zero while the position goes on.
    let lying = |ms: u32| seen(i64::from(ms), 0.0, true);
    assert_eq!(watch(&mut stop(), 0, 5000, lying).1, MotionVerdict::Pending);
    // A noisy speed of an axis that stays where it is.
    let noisy = |ms: u32| seen(i64::from(ms / 20 % 2), 150.0, false);
    assert_eq!(watch(&mut stop(), 0, 5000, noisy).1, MotionVerdict::Arrived);
}

#[test]
fn homing_counts_when_it_was_seen_to_run() {
    let home = || MotionJudge::new(MotionGoal::Reference, TOLERANCE);
    let ignored = |_| seen(0, 0.0, true);
    assert_eq!(watch(&mut home(), 0, 5000, ignored).1, MotionVerdict::Ended(EndReason::NotStarted));
    let runs = |ms: u32| seen(-i64::from(ms.min(900)), 1000.0, ms >= 900);
    assert_eq!(watch(&mut home(), 0, 5000, runs), (900, MotionVerdict::Arrived));
    // Too short to be read while it ran: the counter has jumped.
    let mut judge = home();
    judge.observe_before(at(0), &Observation { position: Some(70_000), ..Observation::default() });
    assert_eq!(watch(&mut judge, 0, 5000, ignored), (0, MotionVerdict::Arrived));
}

#[test]
fn without_a_position_nothing_is_confirmed() {
    let mut judge = to(10_000);
    judge.mark_without_position();
    let drive = |ms: u32| Observation { position: None, ..seen(0, 500.0, ms >= 500) };
    assert_eq!(watch(&mut judge, 0, 5000, drive), (500, MotionVerdict::Unconfirmed));
    // A relative move whose beginning is not known.
    let mut judge = MotionJudge::new(MotionGoal::Position([None; 2]), TOLERANCE);
    let drive = |ms: u32| seen(i64::from(ms.min(500)), 500.0, ms >= 500);
    assert_eq!(watch(&mut judge, 0, 5000, drive), (500, MotionVerdict::Unconfirmed));
}

#[test]
fn a_start_without_acknowledgement_is_proven_by_the_flag_or_the_position() {
    let mut judge = to(10_000);
    judge.observe_before(at(0), &Observation { flag: Some(true), ..Observation::default() });
    judge.observe(at(0), &seen(0, 0.0, true));
    assert!(!judge.proves_start());
    judge.observe(at(20), &seen(0, 0.0, false));
    assert!(judge.proves_start());
    // Nor does one that is pushed away from its target, or drifts (swarm seed serial:15707).
    for (position, proves) in [(-500, false), (500, true)] {
        let mut judge = to(10_000);
        judge.observe_before(at(0), &seen(0, 0.0, false));
        judge.observe(at(20), &seen(position, 0.0, false));
        assert_eq!(judge.proves_start(), proves, "{position}");
    }
    // A motor that turned before proves nothing by turning on.
    let mut judge = to(10_000);
    judge.observe_before(at(0), &Observation { speed: Some(5000.0), ..Observation::default() });
    judge.observe(at(20), &seen(200, 5000.0, false));
    assert!(!judge.proves_start());
    // Nor does one that had just begun a motion: slow, and with the flag of the motion before that.
    let mut judge = to(10_000);
    judge.mark_follows_motion();
    judge.observe_before(at(0), &seen(0, 0.0, true));
    judge.observe(at(20), &seen(500, 5000.0, false));
    assert!(!judge.proves_start());
}
