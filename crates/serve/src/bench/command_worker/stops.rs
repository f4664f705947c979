//! Pending stops of the axes of a wire: stops whose standstill is not confirmed yet.

use std::sync::Arc;

use polepair_core::time::Instant;
use serde_json::json;

use super::super::journal_queue::ActionSubject;
use super::{CommandWorker, FAST_SEND_MAX, WorkerAxis};
use crate::bench::context::BenchEvent;
use crate::bench::journal_sink::SERVER;
use crate::bench::lease::{EndedLease, SessionName};
use crate::bench::pending_stop::{PendingStop, StopCollector, StopPoll, StopResolution};
use crate::bench::reply::Continuation;
use crate::bench::wire::{DismissRequest, QueuedCommand, StopBatch};
use crate::message::{
    AxisStopReport, DismissReason, GatewayError, JournalAction, StopCause, StopClass,
};

impl CommandWorker {
    /// Sends the stops; their records are written when all of them are on the wire.
    pub(in crate::bench) fn process_stops(&mut self) {
        while let Some(StopBatch { axes, session, reason, requested_at, collector }) =
            self.wire.next_stop()
        {
            self.add_joined_axes();
            // A scan has the wire; it ends after the address that it is asking.
            self.wire.scan_flag.cancel();
            let began = self.context.now();
            let mut ended = Vec::with_capacity(axes.len());
            for (axis, sequence) in axes {
                self.axes[axis].last_stop_number = sequence.max(self.axes[axis].last_stop_number);
                // The holder may not move it after another client stopped it.
                let lost = self.axes[axis].lease.end();
                let is_new = self.stop_axis(
                    axis,
                    requested_at,
                    StopCause::Stop,
                    &session,
                    collector.clone(),
                );
                // All axes are stopped before the first entry of the journal, which may take a disk's time (STOP-16).
                ended.push((axis, lost, is_new));
            }
            // A wire that took long is left to its own thread, so that it keeps no other wire waiting (STOP-14).
            self.fast_send = self.context.now().since(began) <= FAST_SEND_MAX;
            for (axis, lost, is_new) in ended {
                if let Some(EndedLease { holder, .. }) = lost {
                    self.record_lease_end(axis, &holder, "stopped");
                }
                let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
                self.context.record(&session, JournalAction::Stop, Some(id), detail);
                self.publish_pending_stop(axis, is_new);
            }
        }
    }

    /// Sends a stop, and disarms the axis. True if none was pending before.
    fn stop_axis(
        &mut self,
        axis: usize,
        since: Instant,
        why: StopCause,
        by: &SessionName,
        report: Option<Arc<StopCollector>>,
    ) -> bool {
        let watched = &mut self.axes[axis];
        // First of all: from here on no motion command passes, even if the stop is lost.
        watched.axis.arm(false);
        let is_new = watched.pending_stop.is_none();
        let pending = watched
            .pending_stop
            .get_or_insert_with(|| PendingStop::new(&watched.axis, why, by.clone(), since));
        pending.add_requester(why, by);
        pending.send(since, report);
        self.last_start = self.context.now();
        is_new
    }

    /// Stops an axis on a request of the holder of its lease. It stays armed and leased: its next motion command ends
    /// the pending stop.
    pub(super) fn stop_for_holder(&mut self, sequence: u64, commanded: QueuedCommand) {
        let QueuedCommand { axis, session, header, .. } = &commanded;
        let axis = *axis;
        if let Err(refused) = self.check_allowed(axis, session, header.epoch, false) {
            return self.finish_command(commanded, Some(refused));
        }
        let (now, epoch) = (self.context.now(), header.epoch);
        let watched = &mut self.axes[axis];
        // Earlier motion commands are not executed any more.
        watched.last_stop_number = sequence.max(watched.last_stop_number);
        let (report, reply) = StopCollector::for_axes(&[watched.id], Vec::new(), Vec::new());
        let is_new = watched.pending_stop.is_none();
        let pending = watched.pending_stop.get_or_insert_with(|| {
            let stop = PendingStop::new(&watched.axis, StopCause::Stop, session.clone(), now);
            stop.for_holder(epoch)
        });
        pending.send(now, Some(report));
        self.last_start = now;
        self.publish_pending_stop(axis, is_new);
        self.holder_stops.push((commanded, reply));
    }

    /// Replies to holders of leases that requested a stop.
    pub(super) fn reply_to_holders(&mut self) {
        let mut at = 0;
        while at < self.holder_stops.len() {
            let Ok(result) = self.holder_stops[at].1.try_recv() else {
                at += 1;
                continue;
            };
            let (commanded, _) = self.holder_stops.swap_remove(at);
            let stopped = result.map(|mut stopped| stopped.axes.pop());
            let error = match stopped {
                Ok(Some(AxisStopReport { class: StopClass::Pending, error, .. })) => {
                    let what = "it received a stop, but its standstill is not confirmed";
                    Some(error.unwrap_or_else(|| GatewayError::new("gateway.pending", what)))
                }
                Ok(_) => None,
                Err(refused) => Some(refused),
            };
            if error.is_none() {
                debug_assert!(error.is_none(), "only a stop that was seen through ends the motion");
                self.axes[commanded.axis].lease.mark_stopped();
            }
            // The result of its stop is known; whether the motor is at standstill is not.
            let error = error.map(|error| GatewayError { executed: None, ..error });
            self.finish_command(commanded, error);
        }
    }

    /// Ends the pending stop of a lease's holder, who commands the axis again.
    pub(super) fn cancel_holder_stop(&mut self, axis: usize, session: &SessionName, epoch: u64) {
        let (id, now) = (self.axes[axis].id, self.context.now());
        let Some(mut outstanding) =
            self.axes[axis].pending_stop.take_if(|pending| pending.is_holder_stop(epoch))
        else {
            return;
        };
        let what = "it was moved again before its standstill was confirmed";
        // The holder moved it again: the stop is not wanted any more, by the one who asked for it.
        outstanding.abandon(id, now, &GatewayError::new("gateway.pending", what));
        self.clear_pending_stop(axis, session, json!({ "how": "moved again" }), None);
    }

    /// Stops an axis without a request of a client.
    pub(super) fn stop_unrequested(&mut self, axis: usize, why: StopCause, reason: &str) {
        let is_new = self.stop_axis(axis, self.context.now(), why, &SERVER.into(), None);
        let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
        self.context.record_by_server(JournalAction::Stop, id, detail);
        self.publish_pending_stop(axis, is_new);
    }

    /// Records in the journal that an axis has a pending stop, and shows it.
    pub(super) fn publish_pending_stop(&mut self, axis: usize, is_new: bool) {
        let now = self.context.now();
        let WorkerAxis { id, axis: its, pending_stop: Some(pending), .. } = &mut self.axes[axis]
        else {
            return;
        };
        let (id, number, shown) = (*id, its.number(), pending.view());
        let (alarm, is_news) = pending.update_alarm(now);
        if is_new {
            let detail = json!({ "why": shown.why, "link": self.url, "number": number });
            self.context.record(
                &shown.by.as_str().into(),
                JournalAction::StopPending,
                Some(id),
                detail,
            );
        }
        self.wire.set_pending_stop(axis, alarm);
        if is_news {
            self.context.publish(BenchEvent::PendingStop(id));
        }
    }

    /// Clears the pending stop of an axis.
    fn clear_pending_stop(
        &mut self,
        axis: usize,
        who: &SessionName,
        mut detail: serde_json::Value,
        then: Option<Continuation>,
    ) {
        let watched = &mut self.axes[axis];
        watched.pending_stop = None;
        detail["link"] = json!(self.url);
        detail["number"] = json!(watched.axis.number());
        let (id, now) = (watched.id, self.context.now());
        // Shown before anybody is answered, which the journal's thread does as soon as it is written.
        debug_assert!(self.axes[axis].pending_stop.is_none());
        self.wire.set_pending_stop(axis, None);
        self.context.publish(BenchEvent::PendingStop(id));
        self.context.journal.record(
            ActionSubject::new(who, JournalAction::StopEnded, Some(id)),
            detail,
            now,
            then,
        );
    }

    /// Repeats pending stops, and checks their progress.
    pub(super) fn poll_pending_stops(&mut self) {
        let now = self.context.now();
        let Some(first) = self.axes.iter().find(|watched| watched.pending_stop.is_some()) else {
            return;
        };
        // All axes of a wire share its counters, so one of them is enough.
        self.airtime.update(&first.axis);
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            let Some(pending_stop) = &mut watched.pending_stop else { continue };
            let sequence = pending_stop.attempts();
            let StopPoll { report, sent_quick_stop, ended } =
                pending_stop.poll(watched.id, now, &mut self.airtime);
            if pending_stop.attempts() > sequence {
                self.last_start = now;
            }
            let (alarm, is_news) = pending_stop.update_alarm(now);
            let id = watched.id;
            if is_news && ended.is_none() {
                self.context.publish(BenchEvent::PendingStop(id));
            }
            if sent_quick_stop {
                let detail = json!({ "reason": "the stop did not slow the motor", "quick": true });
                self.context.record_by_server(JournalAction::Stop, id, detail);
            }
            if let Some(stopped) = report {
                let detail = json!({ "class": stopped.class, "ms": stopped.ms });
                self.context.record_by_server(JournalAction::Outcome, id, detail);
                self.context.publish(BenchEvent::Stopped(stopped));
            }
            let how = match ended {
                None => {
                    pending_stop.reply_to_waiters(id, &watched.axis, now, false);
                    self.wire.set_pending_stop(axis, alarm);
                    continue;
                }
                Some(StopResolution::Standing) => "standing",
                Some(StopResolution::NotKnown) => "standing not known",
                Some(StopResolution::Impossible(_)) => "the drive has no stop",
            };
            let (its, pending_stop) = (watched.axis.clone(), watched.pending_stop.take());
            self.clear_pending_stop(axis, &SERVER.into(), json!({ "how": how }), None);
            pending_stop
                .into_iter()
                .for_each(|mut pending_stop| pending_stop.reply_to_waiters(id, &its, now, true));
        }
    }

    /// Clears the pending stop of an axis without measured standstill: a client knows more, and the journal keeps the
    /// session.
    pub(super) fn handle_dismiss(
        &mut self,
        DismissRequest { axis, session, dismiss, reply }: DismissRequest,
    ) {
        let now = self.context.now();
        let held = match dismiss.reason {
            // The only reason that needs the lease: with the others no program can stop the motor any more
            // (STOP-12).
            DismissReason::TakenOver => {
                self.axes[axis].lease.check_holder(&session, dismiss.epoch, now).map(drop)
            }
            _ => Ok(()),
        };
        // A dismissal without a record would be a motor for which no person answers.
        let may = held.and_then(|()| self.context.journal.check_writable(now));
        if may.is_err() || self.axes[axis].pending_stop.is_none() {
            // The receiver may have been dropped, here and below.
            return drop(reply.send(may));
        }
        let detail = json!({ "how": "dismissed", "reason": dismiss.reason, "note": dismiss.note });
        let id = self.axes[axis].id;
        if let Some(mut pending) = self.axes[axis].pending_stop.take() {
            let what = "the stop was dismissed before standstill was confirmed";
            pending.abandon(id, now, &GatewayError::new("gateway.pending", what));
        }
        self.clear_pending_stop(
            axis,
            &session,
            detail,
            Some(Box::new(move |recorded| drop(reply.send(recorded)))),
        );
    }

    /// Replies to clients that still wait when the bench is closed, and names the axes without measured standstill.
    pub(in crate::bench) fn abandon_pending_stops(&mut self) {
        let now = self.context.now();
        let why = GatewayError::new(
            "gateway.pending",
            "the server ends, and its standstill is not \
             confirmed",
        );
        for watched in &mut self.axes {
            let Some(pending) = &mut watched.pending_stop else { continue };
            pending.abandon(watched.id, now, &why);
            let detail = json!({ "class": StopClass::Pending, "reason": "the server ends" });
            self.context.record_by_server(JournalAction::Outcome, watched.id, detail);
            self.context.add_not_standing(format!("{} of {}", watched.axis.label(), self.url));
        }
    }
}
