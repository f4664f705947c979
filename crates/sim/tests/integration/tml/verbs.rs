//! Verbs of an axis, and their messages on the wire.

use super::{BIT_RATE, Bench, done, hint};
use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::proto::HostOptions;
use polepair_core::station::AxisIndex;
use polepair_drives::surroundings::Act;

/// Radians of a count, at 2,000 counts a turn.
const COUNT: f64 = core::f64::consts::TAU / 2000.0;

fn benches() -> [Bench; 4] {
    let can = HostOptions::new(BIT_RATE);
    [
        Bench::relay("tmlcan", &[1]),
        Bench::rs485(HostOptions::new(9600), &[1], &[1]),
        Bench::can("tmlcan", can, &[1], &[1]),
        Bench::can("technocan", can, &[1], &[1]),
    ]
}

fn go(verb: Verb, target: f64) -> Command {
    Command {
        target: Some(target),
        velocity: Some(40.0),
        acceleration: Some(2000.0),
        ..Command::new(verb)
    }
}

fn curve(verb: Verb, target: f64, jerk_time: f64) -> Command {
    Command { jerk_time: Some(jerk_time), ..go(verb, target) }
}

impl Bench {
    pub(super) fn pass(&mut self, ms: u32) {
        let until = self.world.now().plus_ms(ms);
        self.world.run_until(until);
    }

    pub(super) fn act(&mut self, act: Act) {
        let drive = self.drives[0];
        assert!(self.world.inspect(drive, |node, now| node.surroundings().unwrap().act(now, act)));
    }

    /// The drive's position, counts.
    #[track_caller]
    fn counts(&mut self) -> i64 {
        match self.read(0, "APOS") {
            Outcome::Done(counts) => counts,
            other => panic!("{other:?}"),
        }
    }

    /// Waits for the end of a move. Returns the resting position, counts.
    #[track_caller]
    fn rest(&mut self) -> i64 {
        assert!(done(self.verb(0, Verb::Reached)));
        self.pass(1000);
        self.counts()
    }
}

#[test]
fn relative_moves_count_from_the_target_of_the_moment_and_additive_ones_from_the_last() {
    for (n, bench) in benches().iter_mut().enumerate() {
        assert!(done(bench.verb(0, Verb::Enable)), "{n}");
        assert!(done(bench.command(0, go(Verb::MoveTo, 10_000.0 * COUNT))), "{n}");
        bench.pass(50);
        assert!(done(bench.command(0, go(Verb::MoveOn, 1000.0 * COUNT))), "{n}");
        assert_eq!(bench.rest(), 11_000, "{n}: under way, but from the target");
        assert!(done(bench.command(0, go(Verb::MoveTo, 0.0))), "{n}");
        bench.pass(50);
        assert!(done(bench.command(0, go(Verb::MoveBy, -1000.0 * COUNT))), "{n}");
        let there = bench.rest();
        assert!((1000..9900).contains(&there), "{n}: {there}, from where the target was then");
        assert_eq!(bench.truth(0).unrepeatable, 2, "{n}");
    }
}

#[test]
fn an_s_curve_arrives_later_than_a_trapezoid_and_on_the_same_count() {
    for (n, bench) in benches().iter_mut().enumerate() {
        assert!(done(bench.verb(0, Verb::Enable)), "{n}");
        assert!(done(bench.command(0, curve(Verb::CurveTo, 4000.0 * COUNT, 0.2))), "{n}");
        // Refused by a question alone, so the motion under way is left in peace.
        let outcome = bench.command(0, curve(Verb::CurveBy, 4000.0 * COUNT, 0.2));
        assert!(hint(outcome).is_some_and(|hint| hint.contains("begins at rest")), "{outcome:?}");
        let started_at = bench.world.now();
        assert_eq!(bench.rest(), 4000, "{n}");
        let slow = bench.world.now().since(started_at);
        assert!(done(bench.command(0, curve(Verb::CurveBy, -4000.0 * COUNT, 0.2))), "{n}");
        assert_eq!(bench.rest(), 0, "{n}");
        assert!(done(bench.command(0, go(Verb::MoveTo, 4000.0 * COUNT))), "{n}");
        let started_at = bench.world.now();
        assert_eq!(bench.rest(), 4000, "{n}");
        let fast = bench.world.now().since(started_at);
        assert!(slow > fast, "{n}: {slow:?}, {fast:?}");
    }
}

#[test]
fn an_s_curve_that_the_drive_refused_before_is_not_taken_for_a_new_refusal() {
    let mut bench = Bench::relay("tmlcan", &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    assert!(done(bench.command(0, curve(Verb::CurveTo, 9000.0 * COUNT, 0.2))));
    assert!(done(bench.raw(0, "UPD")), "the drive ignores it and notes that");
    assert_eq!(bench.rest(), 9000);
    let starts = bench.truth(0).starts;
    let outcome = bench.command(0, curve(Verb::CurveTo, 0.0, 0.2));
    assert!(hint(outcome).is_some_and(|hint| hint.contains("clear its faults")), "{outcome:?}");
    assert_eq!(bench.truth(0).starts, starts);
    assert!(done(bench.verb(0, Verb::Clear)));
    assert!(done(bench.command(0, curve(Verb::CurveTo, 0.0, 0.2))));
    assert_eq!(bench.rest(), 0);
}

#[test]
fn torque_is_a_share_of_the_peak_current() {
    for (n, bench) in benches().iter_mut().enumerate() {
        bench.act(Act::Load(-0.2));
        assert!(done(bench.verb(0, Verb::Enable)), "{n}");
        let torque = Command { torque: Some(0.1), ..Command::new(Verb::Torque) };
        assert!(done(bench.command(0, torque)), "{n}");
        bench.pass(50);
        // The simulated drive's peak is 20 A.
        assert!((bench.truth(0).current - 2.0).abs() < 0.01, "{n}: {:?}", bench.truth(0));
        assert!(done(bench.verb(0, Verb::Stop)), "{n}");
        bench.pass(100);
        assert!(bench.truth(0).velocity.abs() < 1.0, "{n}: {:?}", bench.truth(0));
        let most = Command { torque: Some(1.01), ..Command::new(Verb::Torque) };
        bench.tickets += 1;
        let ticket = polepair_core::station::Ticket(bench.tickets);
        let refused = bench.axes(|axes, now| axes.command(now, ticket, AxisIndex(0), most));
        assert!(refused.is_err(), "more than the peak is not sent");
    }
}

#[test]
fn homing_ends_at_the_limit_switch_that_the_sign_of_its_speed_names() {
    for (n, bench) in benches().iter_mut().enumerate() {
        bench.act(Act::Switch { which: 1, at: 7.0 });
        bench.act(Act::Switch { which: 2, at: -7.0 });
        assert!(done(bench.verb(0, Verb::Enable)), "{n}");
        let outcome = bench.verb(0, Verb::Home);
        assert!(hint(outcome).is_some_and(|hint| hint.contains("homing speed")), "{outcome:?}");
        for (speed, switch) in [(5.0, 7.0), (-5.0, -7.0)] {
            let home = Command { velocity: Some(speed), ..Command::new(Verb::Home) };
            assert!(done(bench.command(0, home)), "{n}");
            let truth = bench.truth(0);
            let beyond = (truth.position - switch) * speed.signum();
            assert!((0.0..0.3).contains(&beyond) && truth.velocity.abs() < 0.1, "{n}: {truth:?}");
            assert!(bench.counts().abs() <= 1, "{n}");
            let outcome = bench.command(0, home);
            assert!(hint(outcome).is_some_and(|hint| hint.contains("off it first")), "{outcome:?}");
            assert!(done(bench.command(0, go(Verb::MoveTo, -switch))), "{n}");
            bench.rest();
            assert!(bench.truth(0).position.abs() < 0.3, "{n}: {:?}", bench.truth(0));
        }
    }
}

#[test]
fn a_fault_ends_homing() {
    let mut bench = Bench::can("tmlcan", HostOptions::new(BIT_RATE), &[1], &[1]);
    assert!(done(bench.verb(0, Verb::Enable)));
    bench.act(Act::Jam(true));
    let home = Command { velocity: Some(50.0), ..Command::new(Verb::Home) };
    let started_at = bench.world.now();
    let outcome = bench.command(0, home);
    assert!(matches!(outcome.failure(), Some(Failure::Faulted { .. })), "{outcome:?}");
    assert!(bench.world.now().since(started_at).as_secs() < 30);
}
