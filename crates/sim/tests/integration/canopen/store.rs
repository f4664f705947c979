//! Power that goes while settings are stored: what is there afterwards is all old or all new.

use super::*;

/// Settings of both groups, communication and application: as they were, and as they shall be.
const SETTINGS: [(&str, i64, i64); 4] = [
    ("heartbeat time", 1_000, 2_000),
    ("profile velocity", 111_111, 222_222),
    ("profile acceleration", 333_333, 444_444),
    ("lost connection option", 2, 3),
];

fn stored_outcomes(bench: &mut Bench) -> Vec<Outcome> {
    SETTINGS.iter().map(|(name, ..)| bench.read(0, name)).collect()
}

#[test]
fn power_lost_in_a_store_leaves_the_old_settings_or_the_new() {
    let old: Vec<_> = SETTINGS.iter().map(|(_, old, _)| Outcome::Done(*old)).collect();
    let new: Vec<_> = SETTINGS.iter().map(|(.., new)| Outcome::Done(*new)).collect();
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402()]);
        for (name, value, _) in SETTINGS {
            bench.set(0, &[(name, value)]);
        }
        done(bench.verb(0, Verb::Store));
        bench.pass(100);
        for (name, _, value) in SETTINGS {
            bench.set(0, &[(name, value)]);
        }
        let writes = bench.truth(0).flash_writes;
        let ticket = bench.commanded(0, Command::new(Verb::Store));
        let pause = bench.random.below(30_000);
        let at = bench.world.now().plus_ns(pause * 1_000);
        bench.world.run_until(at);
        bench.act(0, Act::PowerCycle);
        let outcome = bench.end(ticket);
        bench.pass(100);
        let found = stored_outcomes(&mut bench);
        match outcome {
            // The drive acknowledged that it has stored the value.
            Outcome::Done(_) => assert_eq!(found, new, "{pause} us"),
            Outcome::Unknown(Failure::Silent) => {}
            outcome => panic!("{outcome:?} after {pause} us"),
        }
        assert!(found == old || found == new, "{found:?} after {pause} us");
        assert!(bench.truth(0).flash_writes - writes <= 1, "nothing is stored twice");
    });
}
