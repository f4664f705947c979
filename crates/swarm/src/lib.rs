//! Whole gateways from one number: a bench in virtual time, clients that vanish, hang, stop, take over
//! and come back, drives of every family, and wires that are cut, refused, flapping, silent and slow.
//!
//! A seed decides everything, and running it again gives the same history. After every event the actions and reports of
//! the bench are compared with the truth of each simulated motor; see [`INVARIANTS`]. First everything may fail, then
//! all wires are well again, and all axes with a pending stop must be at standstill.
#![forbid(unsafe_code)]

mod client;
mod drives;
mod history;
mod runner;
mod scenario;
mod schedule;
mod stop_observer;
pub mod wire;

use std::collections::BTreeMap;

use polepair_core::time::Instant;
pub use polepair_sim::check::Violation;

/// Invariants that must hold after every event: number and meaning.
pub const INVARIANTS: [(&str, &str); 14] = [
    (
        "G1",
        "3 s after its wire is well, and within its ramp, an axis with a pending stop is at standstill",
    ),
    ("G2", "the alarm is shown while an axis with a pending stop turns"),
    ("G3", "the alarm ends when the axis is at standstill and its wire is well"),
    ("G4", "the alarm does not end while the motor turns, unless a client dismissed it"),
    ("G5", "`standing` is reported only of a motor at standstill"),
    ("G6", "`acknowledged` is reported only of a stop that the drive executed"),
    ("G7", "`not done` is reported of nothing that was executed"),
    ("G8", "`failed`, nothing sent, is reported of no stop that was executed"),
    ("G9", "a client that sends STOP is answered within 10 s"),
    ("G10", "nothing starts to move while its stop is pending or motion is locked"),
    ("G11", "`done` is reported only of motion that the drive executed, if it answers"),
    ("G12", "nothing panics"),
    ("G13", "an axis that is reported as arrived has its shaft at the target"),
    ("G14", "a stop is sent, whatever id it has"),
];

/// Violations that one report holds at most.
pub const VIOLATIONS_MAX: usize = 8;

/// Result of one seed, or of many.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct GatewayReport {
    /// The seed that it replays from.
    pub seed: u64,
    /// Hash over all that happened.
    pub history: u64,
    /// Time at which the world ended.
    pub world_time: Instant,
    /// Counted events by name, in alphabetical order.
    pub counts: BTreeMap<&'static str, u64>,
    /// Violations that were excused, by what proves that no host could know better.
    pub excused: BTreeMap<&'static str, u64>,
    /// Invariants broken.
    pub violations: Vec<Violation>,
}

impl GatewayReport {
    /// Counts something.
    pub(crate) fn count(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    /// Adds another report's counts and violations; seed and history stay.
    pub fn add(&mut self, other: &Self) {
        self.world_time = self.world_time.plus_ns(other.world_time.0);
        for (name, count) in &other.counts {
            *self.counts.entry(name).or_default() += count;
        }
        for (name, count) in &other.excused {
            *self.excused.entry(name).or_default() += count;
        }
        self.violations.extend(other.violations.iter().cloned());
    }
}

/// Lives through the world of a seed. A panic anywhere in it breaks G12.
#[must_use]
pub fn run(seed: u64) -> GatewayReport {
    run_guarded(seed, None)
}

/// Runs a seed and reports everything: each request, every frame with its meaning and fate, each reply, and the truth
/// of each motor.
pub fn replay(seed: u64, report_line: impl Fn(&str) + 'static) -> GatewayReport {
    run_guarded(seed, Some(Box::new(report_line)))
}

/// Takes a line of the history.
type HistorySink = Box<dyn Fn(&str)>;

fn run_guarded(seed: u64, report_line: Option<HistorySink>) -> GatewayReport {
    let lived = std::panic::AssertUnwindSafe(move || scenario::run_world(seed, report_line));
    let report = std::panic::catch_unwind(lived).unwrap_or_else(|reason| {
        let text = reason.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| reason.downcast_ref::<&str>().copied());
        let what = format!("panic: {}", text.unwrap_or("without words"));
        let violation = Violation { invariant: "G12", at: Instant::ZERO, what };
        GatewayReport { seed, violations: vec![violation], ..GatewayReport::default() }
    });
    wire::set_wait_hook(None);
    report
}
