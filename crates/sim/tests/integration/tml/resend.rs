//! Messages that are sent again after one lost message (TML communication manual, chapter 3, step 3 of both
//! lists for synchronisation), and those that never are.

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::proto::HostOptions;
use polepair_drives::surroundings::Act;
use polepair_sim::random::Ppm;

use super::Bench;

const ALWAYS: Ppm = Ppm(1_000_000);

impl Bench {
    /// On RS-232, or RS-485, with one drive.
    pub(super) fn serial(rs485: bool) -> Self {
        if rs485 {
            Self::rs485(HostOptions::new(9600), &[1], &[1])
        } else {
            Self::relay("tmlcan", &[1])
        }
    }

    /// Loses those of the host's next messages, counted from 0.
    fn lose(&mut self, messages: &[u64]) {
        let (sent, lost) = (self.counters().sent, self.lost());
        self.losing = messages.iter().map(|message| sent + message).collect();
        self.losing.reverse();
        self.lost_before = lost;
        self.apply_losses();
    }

    fn lost(&self) -> u64 {
        self.world.injected_faults(self.wire).requests_lost
    }

    /// Does that, step by step of the world.
    pub(super) fn apply_losses(&mut self) {
        let Some(next) = self.losing.last().copied() else { return };
        let lost = self.lost() > self.lost_before;
        let loses = !lost && self.counters().sent >= next;
        if let Some(faults) = self.world.serial_faults(self.wire) {
            faults.lose_request = if loses { ALWAYS } else { Ppm::NEVER };
        }
        if lost {
            self.lost_before += 1;
            self.losing.pop();
            if let Some(act) = self.act_at_loss.take() {
                self.act(act);
            }
        }
    }

    fn lost_all(&self) -> bool {
        self.losing.is_empty()
    }
}

fn motion(verb: Verb, target: f64) -> Command {
    Command {
        target: Some(target),
        velocity: Some(20.0),
        acceleration: Some(500.0),
        ..Command::new(verb)
    }
}

/// A write, a question that ends the doubt about late acknowledgements, the question for the setting,
/// and the write again.
#[test]
fn a_lost_setting_is_written_again_at_most_twice() {
    for rs485 in [false, true] {
        for (lost, expected) in [
            (&[0][..], Outcome::Done(900)),
            (&[0, 3], Outcome::Done(900)),
            (&[0, 3, 6], Outcome::NotDone(Failure::Silent)),
        ] {
            let mut bench = Bench::serial(rs485);
            let Outcome::Done(before) = bench.read(0, "KPP") else { panic!("silent") };
            bench.lose(lost);
            assert_eq!(bench.write(0, "KPP", 900), expected, "{rs485} {lost:?}");
            assert!(bench.lost_all());
            let after = if matches!(expected, Outcome::Done(_)) { 900 } else { before };
            assert_eq!(bench.read(0, "KPP"), Outcome::Done(after), "{rs485} {lost:?}");
        }
    }
}

/// Every message of an enable and of a move is lost once. Either the verb succeeds, or the lost
/// message was one that is never sent again: `STA`, which presets a position, or `UPD`, which
/// starts the motion.
#[test]
fn one_lost_message_fails_neither_enable_nor_move() {
    for rs485 in [false, true] {
        for verb in [Verb::MoveTo, Verb::MoveBy] {
            let mut failed = Vec::new();
            for kept in 0.. {
                let mut bench = Bench::serial(rs485);
                bench.lose(&[kept]);
                let enabled = bench.verb(0, Verb::Enable);
                if !matches!(enabled, Outcome::Done(_)) {
                    failed.push(("enable", kept, enabled));
                    assert!(!bench.truth(0).enabled, "{rs485} {kept}: {enabled:?}");
                    continue;
                }
                let moved = bench.command(0, motion(verb, 1.0));
                bench.pass(2000);
                let truth = bench.truth(0);
                assert!(truth.velocity.abs() < 0.1, "{rs485} {kept}: {truth:?}");
                if matches!(moved, Outcome::Done(_)) {
                    assert!((truth.position - 1.0).abs() < 0.01, "{rs485} {kept}: {truth:?}");
                } else {
                    failed.push(("move", kept, moved));
                    assert!(truth.position.abs() < 0.01, "{rs485} {kept}: {truth:?}");
                }
                if !bench.lost_all() {
                    assert!(kept > 8, "{kept} messages cannot be all");
                    break;
                }
            }
            let names: Vec<&str> = failed.iter().map(|(name, ..)| *name).collect();
            assert_eq!(names, ["enable", "move"], "{rs485} {verb:?}: {failed:?}");
            assert!(failed.iter().all(|(.., outcome)| matches!(
                outcome,
                Outcome::Partly(Failure::Silent, _) | Outcome::Unknown(Failure::Silent)
            )));
        }
    }
}

/// During a fault only settings are written again.
#[test]
fn nothing_is_switched_on_again_during_a_fault() {
    for kept in 0..8 {
        let mut bench = Bench::serial(false);
        bench.lose(&[kept]);
        bench.act_at_loss = Some(Act::Fault(1 << 8));
        let outcome = bench.verb(0, Verb::Enable);
        if bench.lost_all() {
            assert!(!matches!(outcome, Outcome::Done(_)), "{kept}: {outcome:?}");
            assert!(!bench.truth(0).enabled, "{kept}");
        }
    }
}
