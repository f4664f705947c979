//! Heartbeats that fail to come: the master's at a node, and a node's at the master.

use super::*;

/// Codes of what a node finds when its master is lost (CiA 301, EMCY 8130h) or its bus is.
const LOST: i64 = 0x8130;
/// 6007h, what a lost connection does: nothing, a fault, power off, a quick stop.
const OPTIONS: [i64; 4] = [0, 1, 2, 3];
const SPEED: f64 = 20.0;

/// A turning axis that watches its master for `within` ms and then acts by `option`.
fn watched(seed: u64, option: i64, within: u32) -> Bench {
    let mut bench = Bench::beating(seed, Some(within / 3), &[cia402(), cia402()]);
    let watch = i64::from(HOST << 16 | within);
    bench.set(0, &[("lost connection option", option), ("consumer heartbeat", watch)]);
    bench.spin(0, SPEED);
    bench.spin(1, SPEED);
    bench
}

/// Runs until the motor is not driven as before, at most for `limit` ms. Returns the time.
fn until_it_reacts(bench: &mut Bench, limit: u32) -> u32 {
    let started_at = bench.world.now();
    while bench.world.now() < started_at.plus_ms(limit) {
        bench.pass(1);
        let truth = bench.truth(0);
        let driven = truth.enabled && truth.setpoint.is_none_or(|set| set.velocity > SPEED - 0.1);
        if !driven {
            break;
        }
    }
    bench.world.now().since(started_at).as_millis() as u32
}

/// Checks the state of the axis after the loss of its master.
fn has_ended(bench: &mut Bench, option: i64) {
    let truth = bench.truth(0);
    match option {
        0 => return bench.turns(0, SPEED),
        1 => assert_eq!(i64::from(truth.fault), LOST, "{truth:?}"),
        2 => assert_eq!((truth.enabled, truth.fault), (false, 0), "{truth:?}"),
        _ => assert_eq!(truth.fault, 0, "{truth:?}"),
    }
    bench.rests(0);
    // The node without a heartbeat consumer keeps turning.
    bench.turns(1, SPEED);
}

#[test]
fn a_lost_master_stops_the_motor_within_the_time_and_as_configured() {
    seeds(|seed| {
        let within = 60 + 10 * seed as u32;
        for option in OPTIONS {
            let mut bench = watched(seed, option, within);
            bench.world.set_unplugged(bench.wire, bench.host, true);
            let reacted = until_it_reacts(&mut bench, 2 * within);
            // From its last heartbeat on, which was a moment ago.
            assert!(option == 0 || reacted <= within + 2, "{option}: {reacted} of {within} ms");
            assert!(reacted >= within - within / 3 - 2, "{option}: {reacted} of {within} ms");
            bench.pass(3_000);
            has_ended(&mut bench, option);
        }
    });
}

/// A program that hangs does not feed the watch: its heartbeat ends with the lease, a second after it
/// last asked something.
#[test]
fn a_program_that_asks_nothing_any_more_is_a_lost_master() {
    seeds(|seed| {
        let within = 60 + 10 * seed as u32;
        let option = OPTIONS[1 + seed as usize % 3];
        let mut bench = watched(seed, option, within);
        let reacted = until_it_reacts(&mut bench, 5_000);
        assert!((500..=1_000 + within + 2).contains(&reacted), "{option}: {reacted} ms");
        bench.pass(3_000);
        has_ended(&mut bench, option);
        if option == 1 {
            assert_eq!(bench.fault(0), LOST, "the host is told");
        }
        // The master is back: the motor stays at standstill until a new command.
        done(bench.read(0, "statusword"));
        bench.pass(200);
        bench.rests(0);
        done(bench.verb(0, Verb::Clear));
        bench.spin(0, SPEED);
    });
}

#[test]
fn a_lost_node_is_reported_and_the_others_stay_under_command() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402(), cia402()]);
        let period = 50 + 10 * seed as u32;
        for axis in 0..3 {
            bench.set(axis, &[("heartbeat time", period.into())]);
            bench.spin(axis, SPEED);
        }
        let pause = bench.random.below(u64::from(period)) as u32;
        bench.pass(pause);
        bench.pull(1, true);
        let lost = bench.world.now();
        while bench.is_armed(1) && bench.world.now() < lost.plus_ms(1_000) {
            bench.pass(1);
        }
        let reported = bench.world.now().since(lost).as_millis() as u32;
        assert!((period..=2 * period + 2).contains(&reported), "{reported} ms at {period} ms");
        for axis in [0, 2] {
            assert!(bench.is_armed(axis), "axis {axis}");
            bench.turns(axis, SPEED);
            bench.spin(axis, -SPEED);
            done(bench.verb(axis, Verb::Stop));
            bench.rests(axis);
        }
        // Who comes back is not armed by that; once it is, it obeys.
        assert_eq!(bench.read(1, "statusword"), Outcome::NotDone(Failure::Silent));
        bench.pull(1, false);
        bench.pass(100);
        assert!(!bench.is_armed(1));
        done(bench.verb(1, Verb::Stop));
        bench.rests(1);
        bench.spin(1, SPEED);
    });
}

#[test]
fn a_node_that_restarts_is_reported_and_does_not_move_until_armed() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        bench.spin(0, SPEED);
        bench.spin(1, SPEED);
        let pause = bench.random.below(50) as u32;
        bench.pass(pause);
        bench.act(0, Act::PowerCycle);
        bench.pass(5);
        assert!(!bench.is_armed(0) && bench.is_armed(1));
        bench.pass(3_000);
        bench.rests(0);
        bench.turns(1, SPEED);
        bench.spin(0, SPEED);
    });
}
