//! What an acknowledgement makes of a message, none at all, and one that came too soon.
//!
//! An acknowledgement that was on the line before its message had left is a copy of the one before,
//! or the line's baud rate is fiction (a virtual port). Messages that have no other tell which.

use super::{DRAIN_NS, FICTION_MIN, LATEST_TIMEOUTS, Pending, Phase, Place, Session, Stage};
use crate::error::Failure;
use crate::proto::tml::ask::{self, assigned};
use crate::proto::tml::online::Online;
use crate::proto::tml::rules::Wire;
use crate::proto::tml::wire::{IdCode, Instruction};
use crate::station::Class;
use crate::time::Instant;

impl Session {
    /// Takes an acknowledgement; `early` if it was on the line before the message had left.
    pub(in crate::proto::tml) fn acknowledged(&mut self, now: Instant, early: bool) {
        let before = self.told.replace(now);
        let Some(pending) = self.pending.as_mut().filter(|p| matches!(p.phase, Phase::Ack(_)))
        else {
            self.counters.late += 1;
            return;
        };
        if early && self.fiction < FICTION_MIN {
            let latest = LATEST_TIMEOUTS * self.waits.answer_ns;
            pending.first = !pending.early && before.is_none_or(|at| now > at.plus_ns(latest));
            pending.early = true;
            self.counters.late += 1;
            self.counters.early += 1;
            return;
        }
        let relayed = self.place.relay.is_some_and(|relay| pending.ask.message.to.id != relay);
        self.counters.acknowledged += u64::from(!relayed);
        self.counters.relayed += u64::from(relayed);
        self.fiction = if early { self.fiction } else { self.fiction.saturating_sub(1) };
        self.taken(now);
    }

    /// Takes a message that began before the request had left: a copy of the answer before, where it is
    /// one to that question.
    pub(in crate::proto::tml) fn heard_early(
        &mut self,
        now: Instant,
        to: Option<IdCode>,
        said: &Instruction,
    ) {
        let told = Online::parse(said).filter(|_| self.fiction < FICTION_MIN);
        if told.is_some_and(|told| self.double(&told)) {
            self.counters.early += 1;
            return;
        }
        self.heard(now, to, said);
    }

    /// A byte was lost somewhere: the boundary between frames is to be found again.
    pub(super) fn unacknowledged(&mut self, now: Instant, pending: &Pending) {
        if pending.early {
            self.came_too_soon(1);
            match self.question(pending) {
                Some(_) => return self.taken(now),
                None if tells_by_itself(pending) => return self.advance(now, Stage::Proof),
                None => {}
            }
        }
        let axis = pending.ask.message.to.id;
        if pending.ticket.is_none() {
            // Its answer may still come, so that the next one asks for something else.
            if let Some(question) = self.question(pending) {
                let until = now.plus_ns(LATEST_TIMEOUTS * self.waits.answer_ns);
                self.doubts.add(axis, ask::tag(&question), until, true);
            }
            return match self.place.wire {
                // The drive may be answering: on a line for one at a time nobody speaks into that.
                Wire::Rs485 => self.phase(Phase::Drain(now.plus_ns(DRAIN_NS))),
                _ => self.end(now, Err(Failure::Silent)),
            };
        }
        let until = now.plus_ns(LATEST_TIMEOUTS * self.waits.ack_ns);
        self.doubts.add_ack(self.place.relay.unwrap_or(axis), until);
        self.phase(match self.place {
            Place { wire: Wire::Rs485, alone: false, .. } => Phase::Drain(now.plus_ns(DRAIN_NS)),
            _ => Phase::SyncDue(0),
        });
    }

    /// A question was answered. If its only acknowledgement came too soon, that one was true; and sure
    /// to be, where there was none before of which it could be a copy.
    pub(super) fn answered_before_its_acknowledgement(&mut self, pending: &Pending) {
        if pending.early && matches!(pending.phase, Phase::Ack(_)) {
            self.came_too_soon(if pending.first { FICTION_MIN } else { 1 });
        }
    }

    /// A message had no other acknowledgement than one that came too soon. A copy has one before it
    /// that came in time; with no such between two of these, both were true.
    const fn came_too_soon(&mut self, weight: u8) {
        self.fiction = match self.fiction + weight {
            FICTION_MIN.. => 2 * FICTION_MIN,
            once => once,
        };
    }
}

/// Whether reading it back tells that an instruction was taken. A drive that lost the frame answers
/// any other question as well.
fn tells_by_itself(pending: &Pending) -> bool {
    let instruction = &pending.ask.message.instruction;
    let itself = pending.stage == Stage::Itself && pending.ask.class == Class::Confirm;
    itself && assigned(instruction).is_some()
}
