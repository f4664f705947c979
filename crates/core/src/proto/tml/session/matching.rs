//! Finds the request that a message answers.

use super::super::host_request;
use super::{
    ANYBODY, Answer, Failure, IdCode, Instant, LATEST_TIMEOUTS, OnlineMessage, PendingExchange,
    RequestClass, RequestPhase, RequestStage, Session, TmlWire, assigned_variable,
};

impl Session {
    /// Returns whether a message is the reply to a present or recent question.
    pub(super) fn match_answer(&mut self, now: Instant, message: &OnlineMessage) -> bool {
        // It was requested, so it is not late; and it has no waiter, so it is no answer.
        if self.answers_overtaken(message) {
            return true;
        }
        let pending = self.pending.filter(|pending| pending.attempts > 0);
        let request = pending.and_then(|pending| Some((pending, self.query_of(&pending)?)));
        let Some((pending, question)) = request else { return self.note_duplicate(message) };
        let Some(answer) =
            host_request::answer_of(message).filter(|_| message.answers(&question, ANYBODY))
        else {
            return self.note_duplicate(message);
        };
        let (from, to) = (message.answered_by(), pending.host_request.message.to);
        if self.group_answers.is_open() {
            return self.collect_answer(now, from, answer);
        }
        // Another drive's answer to the same question is a copy, or a second program's.
        if from.is_some_and(|from| to.id != 0 && !self.same_axis(from, to.id)) {
            return self.note_duplicate(message);
        }
        self.finish_query(now, &pending, question, answer);
        true
    }

    /// Returns whether this answers the question that a stop overtook, which was on the wire before the stop's own: a
    /// drive answers in order, so it proves nothing of the stop. It is asked again.
    pub(super) fn answers_overtaken(&mut self, message: &OnlineMessage) -> bool {
        let aside = self.overtaken.filter(|aside| aside.attempts > 0);
        let Some(question) = aside.and_then(|aside| self.query_of(&aside)) else { return false };
        let to = aside.map_or(IdCode::BROADCAST, |aside| aside.host_request.message.to);
        let fits = message.answers(&question, ANYBODY)
            && message.answered_by().is_none_or(|from| to.id == 0 || self.same_axis(from, to.id));
        if let Some(aside) = self.overtaken.as_mut().filter(|_| fits) {
            debug_assert!(aside.attempts > 0, "an answer belongs to an attempt");
            aside.attempts -= 1;
        }
        fits
    }

    pub(super) fn collect_answer(
        &mut self,
        now: Instant,
        from: Option<u8>,
        answer: Answer,
    ) -> bool {
        let Some(from) = from else { return false };
        self.note_answered(from);
        if !self.group_answers.add(from, answer) {
            self.stale_replies.count_duplicate(from);
        }
        // The time counts anew with each drive: on a CAN bus 255 answers take a while.
        self.set_phase(RequestPhase::AwaitAnswer(now.plus_ns(self.timeouts.answer_ns)));
        true
    }

    pub(super) fn finish_query(
        &mut self,
        now: Instant,
        pending: &PendingExchange,
        question: OnlineMessage,
        answer: Answer,
    ) {
        let axis = pending.host_request.message.to.id;
        self.note_answered(axis);
        self.confirm_early_ack(pending);
        self.counters.answered += 1;
        self.stale_replies.clear_answered(
            axis,
            question,
            self.topology.wire == TmlWire::Rs232,
            pending.attempts == 1,
        );
        // Each attempt may still be answered: until then the question is asked for no other request.
        if pending.attempts > 1 {
            let until = now.plus_ns(LATEST_TIMEOUTS * self.timeouts.answer_ns);
            self.stale_replies.add_answer(axis, host_request::answer_tag(&question), until, true);
            if self.topology.wire.acknowledges(pending.host_request.message.to) {
                // It names nothing, and comes as often as was asked.
                self.stale_replies.add_ack(axis, until);
            }
        }
        if pending.stage == RequestStage::Request {
            return self.finish_pending(now, Ok(answer));
        }
        let assigned = assigned_variable(&pending.host_request.message.instruction);
        let found = match answer {
            Answer::Value { value, .. } => value,
            _ => 0,
        };
        let result = match assigned {
            Some((_, value, _))
                if pending.host_request.class == RequestClass::ReadBack && value != found =>
            {
                Err(Failure::Misbehaved)
            }
            Some((_, value, _)) => Ok(Answer::Accepted(value)),
            None => Ok(Answer::Accepted(0)),
        };
        self.finish_pending(now, result);
    }

    /// An answer of a moment ago is given again: by a second drive of that ID, if it happens always.
    pub(in crate::proto::tml) fn note_duplicate(&mut self, message: &OnlineMessage) -> bool {
        if self.stale_replies.note_duplicate(message) {
            self.counters.late += 1;
            return true;
        }
        false
    }
}
