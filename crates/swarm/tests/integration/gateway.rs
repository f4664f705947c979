//! Some hundred seeds of the swarm over the gateway; `cargo xtask swarm --on gateway` lives through more.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use polepair_swarm::{GatewayReport, run};

/// Seeds, from 1; `POLEPAIR_GATEWAY_SEEDS` for more.
const SEEDS: u64 = 200;

#[test]
fn no_seeded_gateway_breaks_an_invariant() {
    let reported = std::env::var("POLEPAIR_GATEWAY_SEEDS").ok().and_then(|n| n.parse().ok());
    let (seeds, next) = (reported.unwrap_or(SEEDS), AtomicU64::new(1));
    let sum = Mutex::new((GatewayReport::default(), Vec::new()));
    let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed > seeds {
                        break;
                    }
                    let report = run(seed);
                    let mut broken: Vec<String> = Vec::new();
                    for violation in &report.violations {
                        broken.push(format!("seed gateway:{seed} {violation}"));
                    }
                    let mut sum = sum.lock().unwrap();
                    sum.0.add(&report);
                    sum.1.extend(broken);
                }
            });
        }
    });
    let (sum, broken) = sum.into_inner().unwrap();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    // Worlds in which nothing happens prove nothing.
    for name in
        ["motion executed", "stops said", "stops standing", "links lost", "units lost on the way"]
    {
        let count = sum.counts.get(name).copied().unwrap_or(0);
        assert!(count >= seeds, "{name}: {count} in {seeds} worlds");
    }
}

#[test]
fn a_seed_gives_the_same_history_again() {
    for seed in [3, 14, 159] {
        assert_eq!(run(seed), run(seed));
    }
}

/// Worlds that broke something, and what it was.
const KEPT: [(u64, &str); 5] = [
    (208, "a command that was refused counted as the one that moves the axis"),
    (5876, "what a stop writes was taken for motion"),
    (7598, "a stop that was lost on TechnoCAN was told as acknowledged"),
    (20592, "a hand waited for a drive whose scales were unread, and all stood still"),
    (39904, "a command was done on a drive that lost its supply before its last step"),
];

#[test]
fn worlds_that_broke_something_hold() {
    for (seed, what) in KEPT {
        assert_eq!(run(seed).violations, [], "seed gateway:{seed}: {what}");
    }
}
