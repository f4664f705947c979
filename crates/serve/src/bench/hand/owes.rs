//! What a hand owes its axes: stops that were said, by whomever, until the motors were seen standing.

use std::sync::Arc;

use polepair_core::time::Instant;
use serde_json::json;

use super::{BRISK, Hand, Watched};
use crate::bench::lease::{Lost, Session};
use crate::bench::owed::{Ended, OwedStop, Report};
use crate::bench::shared::{Event, SERVER};
use crate::bench::wire::{Commanded, Dismiss, Go, StopThese};
use crate::message::{AxisStopped, Deed, DismissReason, OwedWhy, Refused, StopClass};

impl Hand {
    /// Sends what stops; what there is to write about it comes when all of them are on the wire.
    pub(in crate::bench) fn take_stops(&mut self) {
        while let Some(StopThese { axes, who, reason, since, report }) = self.wire.next_stop() {
            self.grow();
            self.wire.looking.break_off();
            let began = self.shared.now();
            let mut ended = Vec::with_capacity(axes.len());
            for (axis, said) in axes {
                self.axes[axis].stopped = said.max(self.axes[axis].stopped);
                let lost = self.axes[axis].seat.end();
                let is_new = self.halt(axis, since, (OwedWhy::Stop, &who), report.clone());
                ended.push((axis, lost, is_new));
            }
            self.brisk = self.shared.now().since(began) <= BRISK;
            for (axis, lost, is_new) in ended {
                if let Some(Lost { holder, .. }) = lost {
                    self.ended(axis, &holder, "stopped");
                }
                let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
                self.shared.noted(&who, Deed::Stop, Some(id), detail);
                self.note_owed(axis, is_new);
            }
        }
    }

    /// Sends a stop, and disarms the axis. True when none was owed before.
    fn halt(
        &mut self,
        axis: usize,
        since: Instant,
        (why, by): (OwedWhy, &Session),
        report: Option<Arc<Report>>,
    ) -> bool {
        let watched = &mut self.axes[axis];
        watched.axis.arm(false);
        let is_new = watched.owed.is_none();
        let owed = watched.owed.get_or_insert_with(|| OwedStop::new(why, by.clone(), since));
        owed.said_by(why, by);
        owed.say(&watched.axis, since, report);
        self.begun = self.shared.now();
        is_new
    }

    /// Stops an axis because whoever holds its lease says so. It stays armed and theirs: what they have it
    /// do next ends the debt.
    pub(super) fn halt_for_holder(&mut self, said: u64, commanded: Commanded) {
        let Commanded { axis, session, order, .. } = &commanded;
        let axis = *axis;
        if let Err(refused) = self.may(axis, session, order.epoch, false) {
            return self.tell(commanded, Some(refused));
        }
        let (now, epoch) = (self.shared.now(), order.epoch);
        let watched = &mut self.axes[axis];
        // What was said before it and would move is not done any more.
        watched.stopped = said.max(watched.stopped);
        let (report, told) = Report::of(&[watched.id], Vec::new());
        let is_new = watched.owed.is_none();
        let fresh = || OwedStop::new(OwedWhy::Stop, session.clone(), now).of_holder(epoch);
        let owed = watched.owed.get_or_insert_with(fresh);
        owed.say(&watched.axis, now, Some(report));
        self.begun = now;
        self.note_owed(axis, is_new);
        self.halting.push((commanded, told));
    }

    /// Answers those who hold a lease and said stop.
    pub(super) fn answer_holders(&mut self) {
        let mut at = 0;
        while at < self.halting.len() {
            let Ok(told) = self.halting[at].1.try_recv() else {
                at += 1;
                continue;
            };
            let (commanded, _) = self.halting.swap_remove(at);
            let stopped = told.map(|mut stopped| stopped.axes.pop());
            let error = match stopped {
                Ok(Some(AxisStopped { class: StopClass::Owed, error, .. })) => {
                    let what = "it was told to stop, and was not seen standing";
                    Some(error.unwrap_or_else(|| Refused::new("gateway.owed", what)))
                }
                Ok(_) => None,
                Err(refused) => Some(refused),
            };
            if error.is_none() {
                self.axes[commanded.axis].seat.stopped();
            }
            // How it was told to stop is known; whether the motor stands is not.
            let error = error.map(|error| Refused { executed: None, ..error });
            self.tell(commanded, error);
        }
    }

    /// Whoever holds the lease has the axis do something else than to stop, as they said before.
    pub(super) fn holder_goes_on(&mut self, axis: usize, session: &Session, epoch: u64) {
        let (id, now) = (self.axes[axis].id, self.shared.now());
        let of_holder = |owed: &mut OwedStop| owed.is_of_holder(epoch);
        let Some(mut owed) = self.axes[axis].owed.take_if(of_holder) else { return };
        let what = "it was set in motion again before it was seen standing";
        owed.give_up(id, now, &Refused::new("gateway.owed", what));
        self.pay(axis, session, json!({ "how": "set in motion again" }), None);
    }

    /// The same, where nobody said so.
    pub(super) fn halt_unasked(&mut self, axis: usize, why: OwedWhy, reason: &str) {
        let is_new = self.halt(axis, self.shared.now(), (why, &SERVER.into()), None);
        let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
        self.shared.noted_by_server(Deed::Stop, id, detail);
        self.note_owed(axis, is_new);
    }

    /// Has the journal keep that an axis is owed a stop, and shows it.
    pub(super) fn note_owed(&mut self, axis: usize, is_new: bool) {
        let now = self.shared.now();
        let Watched { id, axis: its, owed: Some(owed), .. } = &mut self.axes[axis] else { return };
        let (id, number, shown) = (*id, its.number(), owed.shown());
        let (alarm, is_news) = owed.alarm(now);
        if is_new {
            let detail = json!({ "why": shown.why, "link": self.url, "number": number });
            self.shared.noted(&shown.by.as_str().into(), Deed::StopOwed, Some(id), detail);
        }
        self.wire.show_owed(axis, alarm);
        if is_news {
            self.shared.tell(Event::Owed(id));
        }
    }

    /// An axis is owed no stop any more.
    fn pay(&mut self, axis: usize, who: &Session, mut detail: serde_json::Value, then: Option<Go>) {
        let watched = &mut self.axes[axis];
        watched.owed = None;
        detail["link"] = json!(self.url);
        detail["number"] = json!(watched.axis.number());
        let (id, now) = (watched.id, self.shared.now());
        // Shown before anybody is answered, which the journal's thread does as soon as it is written.
        self.wire.show_owed(axis, None);
        self.shared.tell(Event::Owed(id));
        self.shared.notes.done((who, Deed::StopEnded, Some(id)), detail, now, then);
    }

    /// Says stops again that are owed, and looks how far they came.
    pub(super) fn look_at_owed(&mut self) {
        let now = self.shared.now();
        let owed = |watched: &&Watched| watched.owed.is_some();
        let Some(first) = self.axes.iter().find(owed) else { return };
        self.airtime.look(&first.axis, now);
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            let Some(owed) = &mut watched.owed else { continue };
            let said = owed.said();
            let (news, ended) = owed.look(watched.id, &watched.axis, now, &mut self.airtime);
            if owed.said() > said {
                self.begun = now;
            }
            let (alarm, is_news) = owed.alarm(now);
            let id = watched.id;
            if is_news && ended.is_none() {
                self.shared.tell(Event::Owed(id));
            }
            if let Some(stopped) = news {
                let detail = json!({ "class": stopped.class, "ms": stopped.ms });
                self.shared.noted_by_server(Deed::Outcome, id, detail);
                self.shared.tell(Event::Stopped(stopped));
            }
            let how = match ended {
                None => {
                    owed.answer(id, &watched.axis, now, false);
                    self.wire.show_owed(axis, alarm);
                    continue;
                }
                Some(Ended::Standing) => "standing",
                Some(Ended::NotKnown) => "standing not known",
                Some(Ended::Impossible(_)) => "the drive has no stop",
            };
            let (its, owed) = (watched.axis.clone(), watched.owed.take());
            self.pay(axis, &SERVER.into(), json!({ "how": how }), None);
            owed.into_iter().for_each(|mut owed| owed.answer(id, &its, now, true));
        }
    }

    /// Owes an axis its stop no more, though nobody saw it stand: somebody knows better, and the journal
    /// keeps who.
    pub(super) fn dismiss(&mut self, Dismiss { axis, session, dismiss, tell }: Dismiss) {
        let now = self.shared.now();
        let held = match dismiss.reason {
            DismissReason::TakenOver => {
                self.axes[axis].seat.held(&session, dismiss.epoch, now).map(drop)
            }
            _ => Ok(()),
        };
        let may = held.and_then(|()| self.shared.notes.takes(now));
        if may.is_err() || self.axes[axis].owed.is_none() {
            // Who has gone does not want to know, here and below.
            return drop(tell.send(may));
        }
        let detail = json!({ "how": "dismissed", "reason": dismiss.reason, "note": dismiss.note });
        let id = self.axes[axis].id;
        if let Some(mut owed) = self.axes[axis].owed.take() {
            let what = "the stop was dismissed before the axis was seen standing";
            owed.give_up(id, now, &Refused::new("gateway.owed", what));
        }
        self.pay(axis, &session, detail, Some(Box::new(move |kept| drop(tell.send(kept)))));
    }

    /// Answers those who still wait when the bench is closed, and names whom nobody saw standing.
    pub(in crate::bench) fn leave(&mut self) {
        let now = self.shared.now();
        let why = Refused::new("gateway.owed", "the server ends, and it was not seen standing");
        for watched in &mut self.axes {
            let Some(owed) = &mut watched.owed else { continue };
            owed.give_up(watched.id, now, &why);
            let detail = json!({ "class": StopClass::Owed, "reason": "the server ends" });
            self.shared.noted_by_server(Deed::Outcome, watched.id, detail);
            self.shared.leaves(format!("{} of {}", watched.axis.label(), self.url));
        }
    }
}
