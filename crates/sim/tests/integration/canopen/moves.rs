//! Moves behind a halt: what it left of an earlier one is gone.

use super::*;

const PRODUCTS: [fn() -> &'static Profile; 2] = [cia402, ts];

/// An axis that was stopped in the middle of a move of 20 rad.
fn stopped_midway(seed: u64, profile: &'static Profile) -> Bench {
    let mut bench = Bench::new(seed, &[profile]);
    done(bench.verb(0, Verb::Enable));
    let far = Command { target: Some(20.0), velocity: Some(10.0), ..Command::new(Verb::MoveBy) };
    done(bench.command(0, far));
    let pause = 200 + bench.random.below(1_500) as u32;
    bench.pass(pause);
    done(bench.verb(0, Verb::Stop));
    bench.pass(300);
    let here = bench.truth(0).position;
    assert!((0.5..19.5).contains(&here), "at {here} rad");
    bench
}

/// The furthest that the motor is from where it begins, on either side, within three seconds.
fn way(bench: &mut Bench, from: f64) -> (f64, f64) {
    (0..300).fold((0.0, 0.0), |(min, max): (f64, f64), _| {
        bench.pass(10);
        let at = bench.truth(0).position - from;
        (min.min(at), max.max(at))
    })
}

#[test]
fn a_relative_move_counts_from_where_a_stop_left_the_motor() {
    for profile in PRODUCTS {
        seeds(|seed| {
            let mut bench = stopped_midway(seed, profile());
            let from = bench.truth(0).position;
            let by = Command { target: Some(-1.0), ..Command::new(Verb::MoveBy) };
            done(bench.command(0, by));
            let (min, max) = way(&mut bench, from);
            let end = bench.truth(0).position - from;
            assert!((end + 1.0).abs() < 0.05, "{end} rad");
            assert!(min > -1.2 && max < 0.2, "{min} to {max} rad");
        });
    }
}

#[test]
fn a_move_to_a_place_goes_there_straight_from_where_a_stop_left_the_motor() {
    for profile in PRODUCTS {
        seeds(|seed| {
            let mut bench = stopped_midway(seed, profile());
            let from = bench.truth(0).position;
            let home = Command { target: Some(0.0), ..Command::new(Verb::MoveTo) };
            done(bench.command(0, home));
            done(bench.verb(0, Verb::Reached));
            let end = bench.truth(0).position;
            assert!(end.abs() < 0.05, "{end} rad");
            let (_, max) = way(&mut bench, from);
            assert!(max < 0.2, "{max} rad");
        });
    }
}
