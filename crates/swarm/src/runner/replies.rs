//! Replies to clients, and checks that they are true.

use std::time::Duration;

use polepair_core::time::Instant;
use polepair_serve::message::{
    CommandOutcome, GatewayError, LeaseGrant, OutcomeKind, StopClass, StopReport,
};

use super::{
    CERTAIN_MAX_AGE, CallKind, MAY_EXECUTE_MS, MOTION_VERBS, PendingCall, RENEW_MS, SETTLE_TIME,
    WorldRunner, error_text,
};
use crate::client::{HeldLease, LeaseProgress};
use crate::history::seconds;
use crate::stop_observer::STOP_REPLY_MAX;

/// A command of a client, as it was sent.
struct SentCommand {
    verb: &'static str,
    epoch: u64,
    /// Starts of the motor when it was sent.
    starts: u64,
    /// True while no other command of the axis was sent.
    alone: bool,
    /// Commanded position, rad.
    target: Option<f64>,
}

impl WorldRunner {
    /// Returns whether the request was answered; then its client has the reply.
    pub(super) fn poll_reply(&mut self, n: usize) -> bool {
        let (now, PendingCall { client, axis, sent_at, .. }) = (self.now, &self.pending[n]);
        let (who, axis, said_at) = (*client, *axis, *sent_at);
        match &mut self.pending[n].kind {
            CallKind::Lease(reply) => {
                let Some(result) = reply.try_recv() else { return false };
                self.handle_lease(who, axis, result);
            }
            CallKind::Command { verb, epoch, starts, alone, target, reply } => {
                let Some(report) = reply.try_recv() else { return false };
                let (verb, epoch, starts) = (*verb, *epoch, *starts);
                let command = SentCommand { verb, epoch, starts, alone: *alone, target: *target };
                self.handle_command_outcome(who, axis, said_at, command, report);
            }
            CallKind::Stop { turned, late, reply } => {
                let Some(reported) = reply.try_recv() else {
                    if !*late && now.since(said_at) > STOP_REPLY_MAX {
                        *late = true;
                        self.add_violation(
                            "G9",
                            format!("a stop said at {:.3} s is not answered", seconds(said_at)),
                        );
                    }
                    return false;
                };
                let turned = std::mem::take(turned);
                self.handle_stop_outcome(who, said_at, &turned, reported);
            }
            CallKind::Release(reply) => {
                let Some(result) = reply.try_recv() else { return false };
                let name = self.clients[who].name.clone();
                self.log(|| {
                    format!("{name} is told: release {}", error_text(result.as_ref().err()))
                });
            }
            CallKind::Read(reply) => {
                let Some(result) = reply.try_recv() else { return false };
                let name = self.clients[who].name.clone();
                let value = result.ok().and_then(|all| all.first().and_then(|one| one.value));
                self.log(|| format!("{name} reads the speed of axis {axis}: {value:?}"));
            }
        }
        true
    }

    fn handle_lease(
        &mut self,
        who: usize,
        axis: u16,
        result: Result<Option<LeaseGrant>, GatewayError>,
    ) {
        let (now, person) = (self.now, &mut self.clients[who]);
        match result {
            Ok(Some(LeaseGrant { epoch, .. })) => {
                let known = person.leases.get(&axis).is_some_and(|hold| hold.epoch == epoch);
                if !known {
                    let hold = HeldLease {
                        epoch,
                        renew_at: now.plus_ms(RENEW_MS),
                        progress: LeaseProgress::Held,
                        command_pending: false,
                    };
                    person.leases.insert(axis, hold);
                    self.report.count("leases");
                    let name = person.name.clone();
                    self.log(|| format!("{name} has axis {axis}, epoch {epoch}"));
                }
            }
            Ok(None) => {}
            Err(refused) => {
                person.leases.remove(&axis);
                let name = person.name.clone();
                self.log(|| {
                    format!("{name} is told: lease of axis {axis} {}", error_text(Some(&refused)))
                });
            }
        }
    }

    fn handle_command_outcome(
        &mut self,
        who: usize,
        axis: u16,
        sent_at: Instant,
        command: SentCommand,
        result: Result<CommandOutcome, GatewayError>,
    ) {
        let SentCommand { verb, epoch, starts, alone, target } = command;
        let moves = MOTION_VERBS.contains(&verb);
        let turns = matches!(verb, "velocity" | "move-to");
        let outcome = match &result {
            Ok(outcome) => outcome.outcome,
            Err(refused) if refused.executed == Some(false) => OutcomeKind::NotDone,
            Err(_) => OutcomeKind::Unknown,
        };
        let error = result.as_ref().map_or_else(Some, |report| report.error.as_ref());
        let because = error_text(error);
        let name = self.clients[who].name.clone();
        self.log(|| format!("{name} is told: axis {axis} {verb} {outcome:?} {because}"));
        self.report.count(match outcome {
            OutcomeKind::Done => "commands done",
            OutcomeKind::NotDone => "commands not done",
            OutcomeKind::Unknown => "commands unknown",
        });
        if verb == "stop" && result.as_ref().is_ok_and(|report| report.replayed) {
            let what = format!("axis {axis}: a stop was answered from the history, and not sent");
            self.add_violation("G14", what);
        }
        let (now, watch) = (self.now, &mut self.observers[usize::from(axis)]);
        let executed = watch.truth.starts > starts;
        if moves {
            watch.open_commands -= 1;
            if outcome == OutcomeKind::Unknown || !watch.kind.confirms_motion {
                watch.unknown_until = now.plus_ms(MAY_EXECUTE_MS);
            }
            // One whose answer was lost is the holder's, too.
            let obeyed =
                outcome == OutcomeKind::Done || outcome == OutcomeKind::Unknown && executed;
            if obeyed && turns {
                watch.record_motion_done(sent_at);
            }
            // A request that was sent meanwhile may have come behind it.
            if outcome == OutcomeKind::Done && alone && watch.stopped_at < sent_at {
                watch.target = target.map(|target| (target, now));
            }
        }
        let (kind, owned) = (watch.kind, watch.epoch == Some(epoch));
        let alone = alone && now.since(watch.stopped_at) > now.since(sent_at) + SETTLE_TIME;
        if let Some(hold) = self.clients[who].leases.get_mut(&axis).filter(|h| h.epoch == epoch) {
            hold.command_pending = false;
            hold.progress = match (verb, outcome) {
                ("arm", OutcomeKind::Done) => LeaseProgress::Armed,
                ("enable", OutcomeKind::Done) => LeaseProgress::Enabled,
                ("velocity", OutcomeKind::Done) => LeaseProgress::Moved,
                ("move-to", OutcomeKind::Done) => LeaseProgress::Sent,
                ("disarm", _) => LeaseProgress::Held,
                ("disable", _) => LeaseProgress::Armed,
                ("velocity" | "move-to" | "enable", _) => LeaseProgress::Held,
                _ => hold.progress,
            };
        }
        if verb == "reached" && outcome == OutcomeKind::Done {
            self.report.count("arrivals told");
            let found = self.observers[usize::from(axis)].check_arrival(sent_at);
            self.add_violations(usize::from(axis), found);
        }
        if moves && outcome == OutcomeKind::NotDone && alone && executed {
            self.add_violation(
                "G7",
                format!("axis {axis}: {verb} is told as not done ({because}), and was executed"),
            );
        }
        if turns && outcome == OutcomeKind::Done && alone && !executed && owned {
            if kind.confirms_motion {
                self.add_violation(
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

    fn handle_stop_outcome(
        &mut self,
        who: usize,
        sent_at: Instant,
        turned: &[bool],
        result: Result<StopReport, GatewayError>,
    ) {
        let name = self.clients[who].name.clone();
        let stopped = match result {
            Ok(stopped) => stopped,
            Err(refused) => {
                return self.log(|| format!("{name} is told: STOP {}", error_text(Some(&refused))));
            }
        };
        for one in stopped.axes {
            let because = error_text(one.error.as_ref());
            self.log(|| {
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
            // While others were waited for, it may have been moved again.
            let certain = sent_at + Duration::from_secs_f64(one.ms.max(0.0) / 1e3);
            if self.now.since(certain) < CERTAIN_MAX_AGE {
                self.check_stop(one.id, one.class);
            }
            let n = usize::from(one.id);
            let stands = !self.observers[n].is_turning() && self.observers[n].truth.enabled;
            if one.class == StopClass::Failed && turned[n] && stands {
                self.add_violation(
                    "G8",
                    format!("axis {n}: told `failed`, nothing left, and it was stopped"),
                );
            }
        }
    }

    pub(super) fn check_stop(&mut self, axis: u16, class: StopClass) {
        let found = self.observers[usize::from(axis)].check_stop_report(class, self.now);
        self.add_violations(usize::from(axis), found);
    }
}
