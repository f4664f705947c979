//! Finds the request that a reply answers.

use super::super::wire::Request;
use super::{
    Answer, EARLY_STREAK_MAX, EventSubject, Failure, GRACE_NS, Instant, Instruction, Opcode, Reply,
    Session, Status, TIMELY_STREAK_MIN,
};

impl Session {
    /// Returns whether a reply, to any host, has the form of a reply to the pending request.
    pub(in crate::proto::tmcl) fn answers_pending(&self, reply: &Reply) -> bool {
        let expected = self.expected_request();
        expected.is_some_and(|request| {
            reply.status.ends_request()
                && (reply.module, reply.opcode) == (request.address, request.opcode)
        })
    }

    /// Takes a reply to another host than this one.
    #[cold]
    pub(in crate::proto::tmcl) fn note_other_host(&mut self, host: u32, reply: &Reply) {
        // It belongs to another program on the bus; that it fits our request as well is worth a hint in the
        // error.
        self.counters.foreign += 1;
        if self.answers_pending(reply) {
            self.counters.other_host = Some(host);
        }
    }

    pub(super) fn match_reply(&mut self, now: Instant, reply: Reply, soon: bool) {
        let Some(pending) = self.pending.as_mut().filter(|pending| pending.sent) else {
            self.contest.note_reply(&reply);
            self.count_unexpected(&reply);
            self.note_unexpected_reply(now, &reply);
            return;
        };
        let request = &pending.host_request.request;
        if reply.status == Status::WrongChecksum && complains(&reply, request, pending.attempts) {
            if pending.burst.is_some() {
                // One of its pieces; the next one may be whole.
                return;
            }
            self.counters.corrupt += 1;
            pending.flags.checksum_error = true;
            pending.flags.checksum_error_by_module = reply.module == request.address;
            // The module has answered, so nothing else is to come but a reply that crossed on the wire.
            pending.deadline = pending.deadline.min(now.plus_ns(GRACE_NS));
            return;
        }
        let ours = reply.module == request.address && reply.opcode == request.opcode;
        let refusal = ours && reply.status.ends_request();
        let refused = refusal && !reply.status.is_good();
        // Its reply is an instruction: any byte may be in the place of the status.
        let reads_memory = request.opcode == Opcode::ReadMemory && !pending.is_stored && !refused;
        if !refusal && !reads_memory {
            self.contest.note_reply(&reply);
            let misaddressed = reply.opcode == request.opcode && reply.module != request.address;
            if misaddressed {
                self.counters.misaddressed += 1;
                self.counters.other_address = Some(reply.module.into());
            }
            self.count_unexpected(&reply);
            self.note_unexpected_reply(now, &reply);
            return;
        }
        let soon = soon || now < pending.earliest_reply;
        let (module, opcode, again) =
            (request.address, request.opcode.number(), pending.attempts > 1);
        // A reply that comes too soon is accepted if no earlier request could own it; that shows that the line has no
        // baud rate, unless it was known to have one: then another host requested it.
        let probe = pending.ticket.is_none() && self.unproven_request.is_some();
        let proof = probe && !self.proven_addresses.contains(module);
        if soon && self.early_streak < EARLY_STREAK_MAX {
            let believed = self.timely_streak >= TIMELY_STREAK_MIN;
            let older = self.may_answer_older(now, module, opcode);
            if older || (again || believed) && !proof {
                if let Some(pending) = &mut self.pending {
                    pending.flags.early_reply = true;
                }
                self.counters.late += 1;
                self.counters.early += 1;
                return;
            }
            if !proof {
                self.early_streak = EARLY_STREAK_MAX;
            }
        }
        let Some(pending) = self.pending.as_mut() else { return };
        if let Some(waiting) = self.unproven_request.as_mut().filter(|_| proof) {
            waiting.all_early &= soon;
        }
        debug_assert!(pending.sent, "a reply belongs to a request that has left");
        self.timely_streak = if soon { 0 } else { self.timely_streak + 1 };
        if pending.flags.other_motors_reply && (refused || pending.host_request.request.motor > 0) {
            // It may be the reply to the stop of another motor, so it does not count, and the stop is sent again
            // (idempotent).
            return self.repeat_after_probe(now);
        }
        if pending.flags.stale_replies > 0 {
            pending.flags.stale_replies -= 1;
            self.counters.late += 1;
            return;
        }
        if self.reject_contested(now) {
            return;
        }
        if reads_memory {
            return self
                .finish_with_answer(now, Ok(Answer::Instruction(Instruction::of_reply(&reply))));
        }
        let is_stored = self.pending.is_some_and(|pending| pending.is_stored);
        let executed = is_stored && reply.status == Status::Ok;
        if executed || refused && opcode == Opcode::DownloadStart.number() {
            self.note_not_storing(module);
        }
        if refused {
            let code = reply.status.number().into();
            return self.finish_with_answer(now, Err(Failure::Refused { code }));
        }
        if let Some(ticket) = self.pending.as_ref().and_then(|pending| pending.ticket) {
            self.events.push(EventSubject::Request(ticket), Ok(Answer::Reply(reply)));
        }
        self.finish_pending(now);
    }
}

/// Returns whether a reply of that status is a complaint. One that holds an instruction (134) has its type there: it is
/// a complaint if it names module and request. If it names the module alone, the request is sent once more, and the
/// same reply again is an instruction.
fn complains(reply: &Reply, request: &Request, attempts: u8) -> bool {
    request.opcode != Opcode::ReadMemory
        || (reply.module == request.address && (reply.opcode == request.opcode || attempts == 1))
}
