//! What clients are told, and whether it is true.

use std::time::Duration;

use polepair_core::time::Instant;
use polepair_serve::message::{Ended, LeaseGranted, Outcome, Refused, StopClass, Stopped};

use super::{Asked, FRESH, LINGERS_MS, Live, RENEW_MS, SETTLED, What, why};
use crate::person::{Hold, Step};
use crate::scene::at;
use crate::watch::ANSWERED;

impl Live {
    /// Whether that was answered; then whoever said it has heard it.
    pub(super) fn answered(&mut self, n: usize) -> bool {
        let (now, Asked { who, axis, said, .. }) = (self.now, &self.asked[n]);
        let (who, axis, said) = (*who, *axis, *said);
        match &mut self.asked[n].what {
            What::Lease(reply) => {
                let Some(told) = reply.take() else { return false };
                self.leased(who, axis, told);
            }
            What::Command { verb, epoch, starts, alone, reply } => {
                let Some(told) = reply.take() else { return false };
                let command = (*verb, *epoch, *starts, *alone);
                self.commanded(who, axis, said, command, told);
            }
            What::Stop { turned, late, reply } => {
                let Some(told) = reply.take() else {
                    if !*late && now.since(said) > ANSWERED {
                        *late = true;
                        self.violate(
                            "G9",
                            format!("a stop said at {:.3} s is not answered", at(said)),
                        );
                    }
                    return false;
                };
                let turned = std::mem::take(turned);
                self.stopped(who, said, &turned, told);
            }
            What::Release(reply) => {
                let Some(told) = reply.take() else { return false };
                let name = self.people[who].name.clone();
                self.say(|| format!("{name} is told: release {}", why(told.as_ref().err())));
            }
            What::Read(reply) => {
                let Some(told) = reply.take() else { return false };
                let name = self.people[who].name.clone();
                let value = told.ok().and_then(|all| all.first().and_then(|one| one.value));
                self.say(|| format!("{name} reads the speed of axis {axis}: {value:?}"));
            }
        }
        true
    }

    fn leased(&mut self, who: usize, axis: u16, told: Result<Option<LeaseGranted>, Refused>) {
        let (now, person) = (self.now, &mut self.people[who]);
        match told {
            Ok(Some(LeaseGranted { epoch, .. })) => {
                let known = person.holds.get(&axis).is_some_and(|hold| hold.epoch == epoch);
                if !known {
                    let hold = Hold {
                        epoch,
                        renew_at: now.plus_ms(RENEW_MS),
                        step: Step::Held,
                        waits: false,
                    };
                    person.holds.insert(axis, hold);
                    self.report.count("leases");
                    let name = person.name.clone();
                    self.say(|| format!("{name} has axis {axis}, epoch {epoch}"));
                }
            }
            Ok(None) => {}
            Err(refused) => {
                person.holds.remove(&axis);
                let name = person.name.clone();
                self.say(|| {
                    format!("{name} is told: lease of axis {axis} {}", why(Some(&refused)))
                });
            }
        }
    }

    fn commanded(
        &mut self,
        who: usize,
        axis: u16,
        said: Instant,
        (verb, epoch, starts, alone): (&'static str, u64, u64, bool),
        told: Result<Outcome, Refused>,
    ) {
        let moves = ["velocity", "enable"].contains(&verb);
        let outcome = match &told {
            Ok(outcome) => outcome.outcome,
            Err(refused) if refused.executed == Some(false) => Ended::NotDone,
            Err(_) => Ended::Unknown,
        };
        let error = told.as_ref().map_or_else(Some, |told| told.error.as_ref());
        let because = why(error);
        let name = self.people[who].name.clone();
        self.say(|| format!("{name} is told: axis {axis} {verb} {outcome:?} {because}"));
        self.report.count(match outcome {
            Ended::Done => "commands done",
            Ended::NotDone => "commands not done",
            Ended::Unknown => "commands unknown",
        });
        let (now, watch) = (self.now, &mut self.watches[usize::from(axis)]);
        let executed = watch.truth.starts > starts;
        if moves {
            watch.open -= 1;
            if outcome == Ended::Unknown || !watch.kind.answers {
                watch.unknown_until = now.plus_ms(LINGERS_MS);
            }
            // One whose answer was lost is the holder's, too.
            let obeyed = outcome == Ended::Done || outcome == Ended::Unknown && executed;
            if obeyed && verb == "velocity" {
                watch.is_commanded(said);
            }
        }
        let (kind, owned) = (watch.kind, watch.epoch == Some(epoch));
        let alone = alone && now.since(watch.stopped_at) > now.since(said) + SETTLED;
        if let Some(hold) = self.people[who].holds.get_mut(&axis).filter(|h| h.epoch == epoch) {
            hold.waits = false;
            hold.step = match (verb, outcome) {
                ("arm", Ended::Done) => Step::Armed,
                ("enable", Ended::Done) => Step::Enabled,
                ("velocity", Ended::Done) => Step::Moved,
                ("disarm", _) => Step::Held,
                ("disable", _) => Step::Armed,
                ("velocity" | "enable", _) => Step::Held,
                _ => hold.step,
            };
        }
        if moves && outcome == Ended::NotDone && alone && executed {
            self.violate(
                "G7",
                format!("axis {axis}: {verb} is told as not done ({because}), and was executed"),
            );
        }
        if verb == "velocity" && outcome == Ended::Done && alone && !executed && owned {
            if kind.answers {
                self.violate(
                    "G11",
                    format!("axis {axis}: {verb} is told as done, and was not executed"),
                );
            } else {
                *self
                    .report
                    .excused
                    .entry("done without an answer, where the protocol has none")
                    .or_default() += 1;
            }
        }
    }

    fn stopped(
        &mut self,
        who: usize,
        said: Instant,
        turned: &[bool],
        told: Result<Stopped, Refused>,
    ) {
        let name = self.people[who].name.clone();
        let stopped = match told {
            Ok(stopped) => stopped,
            Err(refused) => {
                return self.say(|| format!("{name} is told: STOP {}", why(Some(&refused))));
            }
        };
        for one in stopped.axes {
            let because = why(one.error.as_ref());
            self.say(|| {
                format!(
                    "{name} is told: axis {} stop {:?} after {:.0} ms {because}",
                    one.id, one.class, one.ms
                )
            });
            self.report.count(match one.class {
                StopClass::Standing => "stops standing",
                StopClass::Acknowledged => "stops acknowledged",
                StopClass::Failed => "stops failed",
                _ => "stops sent",
            });
            // Where others were waited for, it may have been moved again meanwhile.
            let certain = said + Duration::from_secs_f64(one.ms.max(0.0) / 1e3);
            if self.now.since(certain) < FRESH {
                self.judge_stop(one.id, one.class);
            }
            let n = usize::from(one.id);
            let stands = !self.watches[n].turns() && self.watches[n].truth.enabled;
            if one.class == StopClass::Failed && turned[n] && stands {
                self.violate(
                    "G8",
                    format!("axis {n}: told `failed`, nothing left, and it was stopped"),
                );
            }
        }
    }

    pub(super) fn judge_stop(&mut self, axis: u16, class: StopClass) {
        let found = self.watches[usize::from(axis)].told_stopped(class, self.now);
        self.found(usize::from(axis), found);
    }
}
