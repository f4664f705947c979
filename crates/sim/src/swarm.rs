//! Random worlds: hosts and drives of all protocols, mixed reads, writes, motion and stops, and faulty
//! wires.
//!
//! A seed decides everything: protocols, drives, wires, faults, requests and their times. In the first
//! phase anything may fail, but nothing may become *unsafe*. Then the faults end, and everything must work
//! again within [`RECOVERY_MS`]. A report names its seed; the same seed gives the same run.

mod axis;
mod bus;
mod host_user;
mod inert;
mod intruder;
mod observer;
mod scenario;

use std::collections::BTreeMap;

use polepair_core::medium::MediumKind;
use polepair_core::time::Instant;

use crate::can_bus::InjectedCanFaults;
use crate::check::Violation;
use crate::fault::InjectedSerialFaults;

/// Time after the last fault within which every axis must reply.
pub const RECOVERY_MS: u32 = 2_000;
/// Violations that one report holds at most.
pub const VIOLATIONS_MAX: usize = 8;

/// Result of one seed.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct WorldReport {
    /// The seed that it replays from.
    pub seed: u64,
    /// Events.
    pub events: u64,
    /// Hash over all events.
    pub history: u64,
    /// Time at which the world ended.
    pub world_time: Instant,
    /// Requests that hosts put on a wire.
    pub requests: u64,
    /// Requests executed that powered a motor or gave it somewhere to go.
    pub starts: u64,
    /// Tickets that ended, by outcome.
    pub done: u64,
    /// Tickets that ended as not executed.
    pub not_done: u64,
    /// Tickets that ended not knowing.
    pub unknown: u64,
    /// Wrong values, or matches, whose bytes passed every check of the protocol.
    pub wire_collisions: u64,
    /// Requests that were changed on the way, passed every check, and were answered by a drive.
    pub requests_collided: u64,
    /// Second copies of a reply that a host took for the reply to its next request: they arrive just when a reply
    /// could, and the protocol cannot distinguish them.
    pub copies_taken: u64,
    /// The faults made.
    pub injected: InjectedSerialFaults,
    /// Faults injected on CAN buses.
    pub injected_on_can: InjectedCanFaults,
    /// Copies taken on CAN, by the protocol whose replies cannot be distinguished from copies.
    pub copies_on: BTreeMap<&'static str, u64>,
    /// Verbs that were reported as done though the drive missed their frame, by the protocol that
    /// has no answer for them.
    pub unreported_on: BTreeMap<&'static str, u64>,
    /// Questions that ended because two programs commanded one CANopen network at the same instants,
    /// which put both off the bus.
    pub clashes: u64,
    /// Verbs executed twice because their frame was taken twice.
    pub repeated: u64,
    /// Supplies cut and given back.
    pub resets: u64,
    /// Jams, limit switches, faults and safe torque off, made and undone.
    pub acts: u64,
    /// Cables pulled and plugged.
    pub cable_pulls: u64,
    /// Invariants broken.
    pub violations: Vec<Violation>,
    /// Events since the last report; kept in replays only.
    log: Vec<String>,
    logs: bool,
}

impl WorldReport {
    /// Adds another report's counts and violations; seed and history stay.
    pub fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.world_time = self.world_time.plus_ns(other.world_time.0);
        self.requests += other.requests;
        self.starts += other.starts;
        self.done += other.done;
        self.not_done += other.not_done;
        self.unknown += other.unknown;
        self.wire_collisions += other.wire_collisions;
        self.requests_collided += other.requests_collided;
        self.copies_taken += other.copies_taken;
        self.injected.add(&other.injected);
        self.injected_on_can.add(&other.injected_on_can);
        for (protocol, copies) in &other.copies_on {
            *self.copies_on.entry(protocol).or_default() += copies;
        }
        for (protocol, verbs) in &other.unreported_on {
            *self.unreported_on.entry(protocol).or_default() += verbs;
        }
        self.clashes += other.clashes;
        self.repeated += other.repeated;
        self.resets += other.resets;
        self.acts += other.acts;
        self.cable_pulls += other.cable_pulls;
        self.violations.extend(other.violations.iter().cloned());
    }

    fn log_event(&mut self, at: Instant, line: impl FnOnce() -> String) {
        if self.logs {
            self.log.push(format!("{:12.6} {}", at.0 as f64 / 1e9, line()));
        }
    }

    fn add_violations(&mut self, found: impl IntoIterator<Item = Violation>) {
        let found: Vec<_> = found.into_iter().collect();
        for violation in &found {
            self.log_event(violation.at, || format!("!!! {violation}"));
        }
        let capacity = VIOLATIONS_MAX.saturating_sub(self.violations.len());
        self.violations.extend(found.into_iter().take(capacity));
    }
}

/// Runs the world of a seed and reports everything: its members, each request and its end, each violation, and every
/// received byte.
pub fn replay(medium: MediumKind, seed: u64, report_line: &mut dyn FnMut(&str)) -> WorldReport {
    let mut scene = scenario::Scenario::new(medium, seed);
    scene.enable_log();
    scene.run_with_log(report_line)
}

/// Lives through the world that a seed makes of serial wires, or of a CAN bus. A panic anywhere in it breaks I8.
#[must_use]
pub fn run(medium: MediumKind, seed: u64) -> WorldReport {
    std::panic::catch_unwind(|| scenario::Scenario::new(medium, seed).run()).unwrap_or_else(
        |reason| {
            let text = reason.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| reason.downcast_ref::<&str>().copied());
            let what = format!("panic: {}", text.unwrap_or("without words"));
            let violation = Violation { invariant: "I8", at: Instant::ZERO, what };
            WorldReport { seed, violations: vec![violation], ..WorldReport::default() }
        },
    )
}
