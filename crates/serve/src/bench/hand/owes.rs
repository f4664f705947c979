//! What a hand owes its axes: stops that were said, by whomever, until the motors were seen standing.

use std::sync::Arc;

use polepair_core::time::Instant;
use serde_json::json;

use super::{BRISK, Hand, Watched};
use crate::bench::lease::{Lost, Session};
use crate::bench::owed::{Ended, OwedStop, Report};
use crate::bench::shared::{Event, SERVER};
use crate::bench::wire::{Dismiss, Go, StopThese};
use crate::message::{Deed, DismissReason, OwedWhy, Refused, StopClass};

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
        owed.say(&watched.axis, since, report);
        self.begun = self.shared.now();
        is_new
    }

    /// The same, where nobody said so.
    pub(super) fn halt_unasked(&mut self, axis: usize, why: OwedWhy, reason: &str) {
        let is_new = self.halt(axis, self.shared.now(), (why, &SERVER.into()), None);
        let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
        self.shared.noted_by_server(Deed::Stop, id, detail);
        self.note_owed(axis, is_new);
    }

    /// Has the journal keep that an axis is owed a stop, and shows it.
    pub(super) fn note_owed(&self, axis: usize, is_new: bool) {
        let Watched { id, axis: its, owed: Some(owed), .. } = &self.axes[axis] else { return };
        let shown = owed.shown();
        if is_new {
            let detail = json!({ "why": shown.why, "link": self.url, "number": its.number() });
            self.shared.noted(&shown.by.as_str().into(), Deed::StopOwed, Some(*id), detail);
        }
        self.wire.show_owed(axis, Some(shown));
        if is_new {
            self.shared.tell(Event::Owed(*id));
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
            let shown = owed.shown();
            let id = watched.id;
            if let Some(stopped) = news {
                let detail = json!({ "class": stopped.class, "ms": stopped.ms });
                self.shared.noted_by_server(Deed::Outcome, id, detail);
                self.shared.tell(Event::Stopped(stopped));
            }
            let how = match ended {
                None => {
                    owed.answer(id, &watched.axis, now, false);
                    self.wire.show_owed(axis, Some(shown));
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
