//! Processing of acknowledgements, missing ones, and early ones.
//!
//! An acknowledgement before its message was sent is a copy of the previous one, or the baud rate is not
//! real (a virtual port). Messages without any other acknowledgement show which.

use super::{
    DRAIN_NS, FICTION_MIN, LATEST_TIMEOUTS, PendingExchange, RequestPhase, RequestStage, Session,
    Topology,
};
use crate::error::Failure;
use crate::proto::tml::host_request::{self, assigned_variable};
use crate::proto::tml::online::OnlineMessage;
use crate::proto::tml::rules::TmlWire;
use crate::proto::tml::wire::{IdCode, Instruction};
use crate::station::RequestClass;
use crate::time::Instant;

impl Session {
    /// Takes an acknowledgement; `early` if it was on the line before the message had left.
    pub(in crate::proto::tml) fn handle_ack(&mut self, now: Instant, early: bool) {
        let before = self.last_ack.replace(now);
        let Some(pending) =
            self.pending.as_mut().filter(|p| matches!(p.phase, RequestPhase::AwaitAck(_)))
        else {
            self.counters.late += 1;
            self.counters.late_acknowledged += 1;
            return;
        };
        // The byte 4F names nothing. What comes before the drive can have the message belongs to an older one.
        if early && self.fiction_score < FICTION_MIN {
            let latest = LATEST_TIMEOUTS * self.timeouts.answer_ns;
            pending.early_ack_is_first =
                !pending.early_ack && before.is_none_or(|at| now > at.plus_ns(latest));
            debug_assert!(matches!(pending.phase, RequestPhase::AwaitAck(_)));
            pending.early_ack = true;
            self.counters.late += 1;
            self.counters.early += 1;
            self.counters.late_acknowledged += 1;
            return;
        }
        let relayed = self
            .topology
            .relay_axis
            .is_some_and(|relay| pending.host_request.message.to.id != relay);
        self.counters.acknowledged += u64::from(!relayed);
        self.counters.relayed += u64::from(relayed);
        self.fiction_score =
            if early { self.fiction_score } else { self.fiction_score.saturating_sub(1) };
        self.handle_accepted(now);
    }

    /// Takes a message that began before the request had left: a copy of the answer before, where it is
    /// one to that question.
    pub(in crate::proto::tml) fn handle_early_message(
        &mut self,
        now: Instant,
        to: Option<IdCode>,
        instruction: &Instruction,
    ) {
        let message =
            OnlineMessage::parse(instruction).filter(|_| self.fiction_score < FICTION_MIN);
        if message.is_some_and(|message| self.note_duplicate(&message)) {
            self.counters.early += 1;
            return;
        }
        self.handle_message(now, to, instruction);
    }

    /// A byte was lost somewhere: the boundary between frames is to be found again.
    pub(super) fn handle_ack_timeout(&mut self, now: Instant, pending: &PendingExchange) {
        if pending.early_ack {
            // Nothing else came: either that was the acknowledgement and the baud rate is fiction, or it was lost.
            self.raise_fiction_score(1);
            match self.query_of(pending) {
                Some(_) => return self.handle_accepted(now),
                None if is_read_back(pending) => return self.enter_stage(now, RequestStage::Proof),
                None => {}
            }
        }
        let axis = pending.host_request.message.to.id;
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeouts.answer_ns);
        // A late acknowledgement is followed by the answer, so that the next question asks for
        // something else.
        if let Some(question) = self.query_of(pending) {
            let tag = host_request::answer_tag(&question);
            self.stale_replies.add_answer(axis, tag, until, true);
        }
        if pending.ticket.is_none() {
            return match self.topology.wire {
                // The drive may be sending its reply: on a half-duplex line no other station may send then.
                TmlWire::Rs485 => self.set_phase(RequestPhase::Drain(now.plus_ns(DRAIN_NS))),
                _ => self.finish_pending(now, Err(Failure::Silent)),
            };
        }
        // A serial server or a busy adapter delays the byte 4F as long as an answer.
        self.stale_replies.add_ack(self.topology.relay_axis.unwrap_or(axis), until);
        // SYNC bytes would reach every drive of the line in the middle of what it counts (TML-4).
        self.set_phase(match self.topology {
            Topology { wire: TmlWire::Rs485, single_drive: false, .. } => {
                RequestPhase::Drain(now.plus_ns(DRAIN_NS))
            }
            _ => RequestPhase::SendSync(0),
        });
    }

    /// A question was answered. If its only acknowledgement came too soon, that one was true; and sure
    /// to be, where there was none before of which it could be a copy.
    pub(super) fn confirm_early_ack(&mut self, pending: &PendingExchange) {
        if pending.early_ack && matches!(pending.phase, RequestPhase::AwaitAck(_)) {
            self.raise_fiction_score(if pending.early_ack_is_first { FICTION_MIN } else { 1 });
        }
    }

    /// A message had no other acknowledgement than one that came too soon. A copy has one before it
    /// that came in time; with no such between two of these, both were true.
    const fn raise_fiction_score(&mut self, weight: u8) {
        self.fiction_score = match self.fiction_score + weight {
            // Twice as high, so that two acknowledgements in time do not make the rate real at once.
            FICTION_MIN.. => 2 * FICTION_MIN,
            once => once,
        };
    }
}

/// Returns whether a read-back shows that an instruction was executed. A drive that lost the frame replies to any other
/// request as well.
fn is_read_back(pending: &PendingExchange) -> bool {
    let instruction = &pending.host_request.message.instruction;
    let itself = pending.stage == RequestStage::Request
        && pending.host_request.class == RequestClass::ReadBack;
    itself && assigned_variable(instruction).is_some()
}
