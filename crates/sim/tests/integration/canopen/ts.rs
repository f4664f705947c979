//! The TS over CANopen: alarms, flash.

use polepair_core::profile::Severity;

use super::*;

/// Registers that flash keeps, as they were and as they shall be.
const SETTINGS: [(&str, i64, i64); 4] = [
    ("path 1 acceleration time", 100, 150),
    ("path 1 deceleration time", 200, 250),
    ("path 1 delay", 300, 350),
    ("homing delay", 400, 450),
];

/// Every alarm of the manual: it stops a turning motor, the host is notified, a stop is obeyed and
/// moves nothing, and once the alarm is cleared the drive obeys as before.
#[test]
fn each_alarm_stops_is_reported_and_is_cleared() {
    let faults = ts().faults.iter().filter(|fault| fault.severity == Severity::Fault);
    let mut count = 0;
    for fault in faults {
        let mut bench = Bench::new(1, &[ts()]);
        bench.spin(0, 20.0);
        bench.act(0, Act::Fault(fault.code));
        bench.pass(5);
        assert_eq!(bench.fault(0), i64::from(fault.code), "{}", fault.name);
        assert!(!bench.truth(0).enabled, "{}", fault.name);
        let turn = Command { velocity: Some(20.0), ..Command::new(Verb::Velocity) };
        for command in [turn, Command::new(Verb::Enable)] {
            let outcome = bench.command(0, command);
            let code = fault.code;
            assert_eq!(outcome, Outcome::NotDone(Failure::Faulted { code }), "{}", fault.name);
        }
        for verb in [Verb::Stop, Verb::QuickStop] {
            done(bench.verb(0, verb));
            bench.rests(0);
        }
        done(bench.verb(0, Verb::Clear));
        assert_eq!((bench.truth(0).fault, bench.truth(0).enabled), (0, false), "{}", fault.name);
        bench.pass(300);
        bench.rests(0);
        bench.spin(0, -20.0);
        done(bench.verb(0, Verb::Stop));
        bench.rests(0);
        count += 1;
    }
    assert_eq!(count, 23, "as many as the manuals have");
}

/// A turning motor is stopped by each verb that is a stop; none of them is an alarm.
#[test]
fn each_stop_brings_it_to_rest_from_every_speed() {
    seeds(|seed| {
        for verb in [Verb::Stop, Verb::QuickStop, Verb::Disable] {
            let mut bench = Bench::new(seed, &[ts()]);
            let speed = 5.0 + bench.random.below(60) as f64;
            bench.spin(0, speed);
            done(bench.verb(0, verb));
            bench.pass(if verb == Verb::Disable { 5_000 } else { 300 });
            bench.rests(0);
            assert_eq!(bench.truth(0).fault, 0, "{verb:?}");
            bench.spin(0, -speed);
        }
    });
}

/// Each register is written to flash by itself, at once: power that goes between two leaves those
/// that were reported as stored new, the others old, and the one in question either.
#[test]
fn power_lost_while_registers_are_kept_leaves_each_old_or_new() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[ts()]);
        let keep = |bench: &mut Bench, name: &str, raw| {
            let id = ts().find_parameter(name).unwrap();
            bench.start(|axes, now, ticket| {
                axes.write_parameter(now, ticket, AxisIndex(0), id, raw, true)
            })
        };
        for (name, old, _) in SETTINGS {
            let ticket = keep(&mut bench, name, old);
            done(bench.end(ticket));
        }
        let writes = bench.truth(0).flash_writes;
        let tickets = SETTINGS.map(|(name, _, new)| keep(&mut bench, name, new));
        let pause = bench.random.below(6_000);
        let at = bench.world.now().plus_ns(pause * 1_000);
        bench.world.run_until(at);
        bench.act(0, Act::PowerCycle);
        let outcomes = tickets.map(|ticket| bench.end(ticket));
        bench.pass(100);
        let writes = bench.truth(0).flash_writes - writes;
        // Fn_99 to flash, the register, Fn_99 back to RAM.
        assert!(writes <= 3 * 4, "{writes} writes: {outcomes:?}");
        for ((name, old, new), outcome) in SETTINGS.into_iter().zip(outcomes) {
            let Outcome::Done(found) = bench.read(0, name) else { panic!("{name}") };
            match outcome {
                Outcome::Done(_) => assert_eq!(found, new, "{name} after {pause} us"),
                Outcome::NotDone(_) => assert_eq!(found, old, "{name} after {pause} us"),
                Outcome::Unknown(_) => assert!([old, new].contains(&found), "{name}: {found}"),
                // The second step of three is the setting itself.
                Outcome::Partly(_, extent) => match (extent.done >> 1 & 1, extent.unknown >> 1 & 1)
                {
                    (1, _) => assert_eq!(found, new, "{name} after {pause} us: {extent:?}"),
                    (_, 1) => assert!([old, new].contains(&found), "{name}: {found}"),
                    _ => assert_eq!(found, old, "{name} after {pause} us: {extent:?}"),
                },
            }
        }
    });
}
