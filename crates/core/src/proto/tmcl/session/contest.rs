//! Requests of another host to the same module, as they are seen on CAN.
//!
//! Two hosts with the same reply identifier both receive every reply, and a reply names neither host nor parameter: the
//! position that the other one asked for would be the temperature that this one asked for. The two requests were in
//! the module's queue in an order that cannot be known here, so neither reply is believed. A request that may be
//! repeated is repeated behind a probe of another opcode, whose reply comes after both.

use super::{Opcode, Session};
use crate::error::Failure;
use crate::proto::tmcl::wire::{Reply, Request};
use crate::station::RequestClass;
use crate::time::Instant;

/// Replies in a row that may have been another host's, after which a request is given up.
const CONTESTS_MAX: u8 = 16;

/// Knowledge of another host's requests.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contest {
    /// The last request whose reply was not seen yet, and when it was seen.
    unanswered: Option<(Request, Instant)>,
    /// Replies in a row that were not believed.
    pub(super) count: u8,
}

impl Contest {
    pub(super) const NONE: Self = Self { unanswered: None, count: 0 };

    /// Returns whether a reply to another host may come that looks like the one to `request`, which is sent now.
    #[inline]
    pub(super) fn threatens(&self, now: Instant, request: &Request, timeout_ns: u64) -> bool {
        let Some((other, at)) = &self.unanswered else { return false };
        is_alike(request, other) && now < at.plus_ns(timeout_ns)
    }

    /// Forgets a request of the other host when its reply was seen.
    pub(super) fn note_reply(&mut self, reply: &Reply) {
        self.unanswered.take_if(|(request, _)| {
            (request.address, request.opcode) == (reply.module, reply.opcode)
        });
    }
}

impl Session {
    /// Takes a request of another host to a module. Its reply may look like one to this host.
    #[cold]
    pub(in crate::proto::tmcl) fn note_other_request(&mut self, now: Instant, request: Request) {
        self.contest.unanswered = Some((request, now));
        if let Some(pending) = self.pending.as_mut().filter(|pending| pending.sent) {
            pending.flags.contested |= is_alike(&pending.host_request.request, &request);
        }
    }

    /// Judges the reply to a contested request. Returns false if it has to be believed: what must not be sent twice
    /// is not repeated for it.
    pub(super) fn reject_contested(&mut self, now: Instant) -> bool {
        let Some(pending) = self.pending else { return false };
        let class = pending.host_request.class;
        let repeatable = matches!(class, RequestClass::Idempotent | RequestClass::Stop);
        if pending.ticket.is_none() || pending.is_stored || !repeatable {
            return false;
        }
        if !pending.flags.contested {
            self.contest.count = 0;
            return false;
        }
        self.contest.count += 1;
        self.contest.unanswered = None;
        if self.contest.count < CONTESTS_MAX {
            self.repeat_after_probe(now);
        } else {
            self.contest.count = 0;
            self.finish_with_answer(now, Err(Failure::Misbehaved));
        }
        true
    }
}

/// Returns whether the replies to both could be confused, and would differ.
fn is_alike(own: &Request, other: &Request) -> bool {
    // A copy of the own request, such as the echo of some adapters, has the same answer.
    (own.address, own.opcode) == (other.address, other.opcode)
        && own != other
        && own.opcode != Opcode::DownloadStart
}
