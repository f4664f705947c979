//! Proof of an unproven module: replies to an earlier program may be pending, and two modules may have one
//! address.
//!
//! After the last probe, the session listens for [`SECOND_REPLY_NS`]: a module replies once, so a second
//! reply means a second module. After a first double reply it listens after each probe, and
//! [`SECOND_REPLIES_MIN`] in a row end the request. A pending reply has the opcode of the probe only by
//! chance.

use super::{EARLY_STREAK_MAX, HostRequest, LATEST_TIMEOUTS, PendingExchange, RECENT_MAX, Session};
use crate::error::Failure;
use crate::proto::tmcl::opcode::Opcode;
use crate::proto::tmcl::wire::{Reply, Request};
use crate::station::{RequestClass, Ticket};
use crate::time::Instant;

/// Probes that prove a module of which nothing is known.
pub(super) const PROOFS_NEEDED: u8 = 3;
/// Time by which a second module with the same address may reply later than the first.
pub(super) const SECOND_REPLY_NS: u64 = 50_000_000;
/// Probes in a row that were answered twice, after which two modules have the address.
const SECOND_REPLIES_MIN: u8 = 3;
/// Shortest time between two proofs of a module because of a second reply.
const RECHECK_NS: u64 = 1_000_000_000;
/// Probes into silence to a module that answered before.
const KNOWN_PROBES_MAX: u8 = 2 * PROOFS_NEEDED;
/// Probes to a module that never replied.
const UNKNOWN_PROBES_MAX: u8 = 2;
/// Probes to a module that may have lost its byte position.
// Nine places, each tried with the two kinds of module in mind, and some for damaged bytes.
const MISALIGNED_PROBES_MAX: u8 = 40;

/// Answered probes among older replies, after which those are taken for another host's.
const STALE_PROOFS_MAX: u8 = 16;

/// Reads that change nothing, each with an opcode of its own.
pub(super) const PROBES: [(Opcode, u8); 6] = [
    (Opcode::Version, 1),
    (Opcode::Ggp, 66),
    (Opcode::Gap, 1),
    (Opcode::ProgramStatus, 0),
    (Opcode::Gio, 0),
    (Opcode::Gco, 0),
];

/// A request whose module is being proven.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnprovenRequest {
    pub(super) ticket: Ticket,
    pub(super) host_request: HostRequest,
    /// Probes still to be answered.
    pub(super) proofs_left: u8,
    /// Probes that were sent.
    pub(super) probes_sent: u8,
    /// All that were answered came sooner than the baud rate allows.
    pub(super) all_early: bool,
    /// The probe before, which the next one differs from.
    pub(super) last_probe: Option<u8>,
    /// The last one that was answered.
    pub(super) answered_probe: Option<u8>,
    /// True if the module sent another reply since the present probe: older replies are on their way.
    pub(super) stale_reply_seen: bool,
    /// Number of probes were answered so.
    pub(super) stale_proofs: u8,
    /// Nothing is sent until then: a second reply to the last probe may come.
    pub(super) listen_until: Option<Instant>,
    /// One came, so that each probe is listened for.
    listens_always: bool,
    /// One came behind the last probe that was listened for.
    second_reply: bool,
    /// Probes in a row that were answered twice.
    second_replies: u8,
}

impl UnprovenRequest {
    /// Nothing proven yet. For a module that is `proven`, one more answer shows that earlier ones are past.
    pub(super) const fn new(ticket: Ticket, host_request: HostRequest, proven: bool) -> Self {
        Self {
            ticket,
            host_request,
            proofs_left: if proven { 1 } else { PROOFS_NEEDED },
            probes_sent: 0,
            all_early: !proven,
            last_probe: None,
            answered_probe: None,
            stale_reply_seen: false,
            stale_proofs: if proven { STALE_PROOFS_MAX } else { 0 },
            listen_until: None,
            listens_always: false,
            second_reply: false,
            second_replies: 0,
        }
    }
}

impl Session {
    /// Sends the next probe for the request that waits.
    #[cold]
    pub(super) fn send_proof_probe(&mut self, now: Instant) {
        let Some(mut waiting) = self.unproven_request else { return };
        let module = waiting.host_request.request.address;
        let fresh = |(opcode, _): &(Opcode, u8)| {
            waiting.last_probe != Some(opcode.number())
                && self.suspects.count(now, module, *opcode) == 0
        };
        // A reply to what was asked lately may still come, also a second one that a bus error made.
        let unasked = |(opcode, _): &(Opcode, u8)| {
            !self.recent_requests(now, module, opcode.number()).any(|_| true)
        };
        let strict = PROBES.iter().any(|probe| fresh(probe) && unasked(probe));
        let is_eligible = |probe: &(Opcode, u8)| fresh(probe) && (!strict || unasked(probe));
        let eligible = PROBES.map(|probe| is_eligible(&probe));
        let count = eligible.iter().filter(|eligible| **eligible).count();
        debug_assert!(count <= PROBES.len());
        // Drawn at random, so that two programs that were started together do not ask the same (REQ-7).
        let nth = self.proven_addresses.random_below(count);
        let mut candidates = PROBES.iter().zip(eligible).filter(|(_, eligible)| *eligible);
        let probe = candidates.nth(nth).map_or(&PROBES[0], |(probe, _)| probe);
        waiting.probes_sent = waiting.probes_sent.saturating_add(1);
        waiting.last_probe = Some(probe.0.number());
        self.unproven_request = Some(waiting);
        let request =
            Request { address: module, opcode: probe.0, kind: probe.1, motor: 0, value: 0 };
        let probe = HostRequest { class: RequestClass::Idempotent, ..HostRequest::of(request) };
        self.start_request(now, None, probe);
    }

    /// A probe for the request that waits was answered.
    pub(super) fn handle_proof(&mut self, now: Instant) {
        let Some(waiting) = &mut self.unproven_request else { return };
        debug_assert!(waiting.last_probe.is_some(), "a proof follows a probe");
        waiting.proofs_left = waiting.proofs_left.saturating_sub(1);
        waiting.answered_probe = waiting.last_probe;
        if core::mem::take(&mut waiting.stale_reply_seen) && waiting.stale_proofs < STALE_PROOFS_MAX
        {
            // The reply may belong to one of them.
            waiting.stale_proofs += 1;
            // Programs that were killed one after the other leave replies that pass two proofs; three in a row
            // prove it.
            (waiting.proofs_left, waiting.probes_sent) = (PROOFS_NEEDED, 0);
        }
        let module = waiting.host_request.request.address;
        let last = waiting.proofs_left == 0 && !self.proven_addresses.contains(module);
        // A stop is no value that could be another module's.
        let listens = !self.urgent && waiting.host_request.class != RequestClass::Stop;
        if listens && (last || waiting.listens_always) {
            // A second module of the kind answers within milliseconds of the first. Only silence shows that there
            // is none.
            (waiting.second_reply, waiting.listen_until) =
                (false, Some(now.plus_ns(SECOND_REPLY_NS)));
            return;
        }
        self.continue_proof(now);
    }

    /// The time for a second reply is over.
    #[cold]
    pub(super) fn handle_listened(&mut self, now: Instant) {
        let Some(waiting) = &mut self.unproven_request else { return };
        waiting.listen_until = None;
        if waiting.second_reply {
            // An older program's reply has the opcode of a probe by chance, but not three times in a row (TMCL-5).
            waiting.second_replies += 1;
            waiting.proofs_left = waiting.proofs_left.max(1);
        } else {
            (waiting.second_replies, waiting.listens_always) = (0, false);
        }
        if waiting.second_replies < SECOND_REPLIES_MIN {
            return self.continue_proof(now);
        }
        let ticket = waiting.ticket;
        self.unproven_request = None;
        self.finish_ticket(Some(ticket), Err(Failure::AnsweredTwice));
    }

    fn continue_proof(&mut self, now: Instant) {
        let Some(waiting) = &mut self.unproven_request else { return };
        if waiting.proofs_left > 0 {
            return self.send_proof_probe(now);
        }
        let UnprovenRequest { ticket, host_request, all_early, .. } = *waiting;
        let module = host_request.request.address;
        self.unproven_request = None;
        self.proven_addresses.insert(module);
        // Probes answered in order: every reply to an older stop has come, or will not.
        self.forget_stops(module);
        if all_early {
            // No other request could own these replies: the line has no baud rate.
            self.early_streak = EARLY_STREAK_MAX;
        }
        self.start_request(now, Some(ticket), host_request);
    }

    /// Handles a reply to no pending request. For a module that is being proven, older replies are under way, or there
    /// are two modules; another one that repeats its last reply is proven before the next request.
    pub(super) fn note_unexpected_reply(&mut self, now: Instant, reply: &Reply) {
        let (module, opcode) = (reply.module, reply.opcode.number());
        match &mut self.unproven_request {
            Some(waiting) if waiting.host_request.request.address == module => {
                waiting.stale_reply_seen = true;
                // The probe before that is out, or the one whose second reply may come.
                if waiting.answered_probe == Some(opcode) {
                    (waiting.second_reply, waiting.listens_always) = (true, true);
                }
            }
            _ => {
                let newest = self.recent[self.next_recent.wrapping_sub(1) % RECENT_MAX];
                // Once a second at most: on a noisy bus the proofs would otherwise take all of its time.
                let again = (newest.0, newest.1) == (module, opcode) && self.pending.is_none();
                if again && !self.suspicious && now >= self.recheck_at {
                    self.recheck_at = now.plus_ns(RECHECK_NS);
                    self.proven_addresses.remove(module);
                }
            }
        }
    }

    /// Returns whether an earlier request could be answered by such a reply.
    pub(super) fn may_answer_older(&self, now: Instant, module: u8, opcode: u8) -> bool {
        let newest = self.next_recent.wrapping_sub(1) % RECENT_MAX;
        self.recent_requests(now, module, opcode).any(|n| n != newest)
    }

    /// The places of the last requests of that kind to which a reply may still come.
    fn recent_requests(
        &self,
        now: Instant,
        module: u8,
        opcode: u8,
    ) -> impl Iterator<Item = usize> + '_ {
        let latest = LATEST_TIMEOUTS * self.timeout_ns;
        self.recent.iter().enumerate().filter_map(move |(n, (to, what, at))| {
            let open = (*to, *what) == (module, opcode) && now < at.plus_ns(latest);
            open.then_some(n)
        })
    }

    /// Counts an answer to nothing that waits: a late one where it was asked for.
    pub(super) fn count_unexpected(&mut self, reply: &Reply) {
        let requested = self.is_recent_request(reply.module, reply.opcode.number());
        self.counters.late += u64::from(requested);
        self.counters.foreign += u64::from(!requested);
    }

    /// Returns whether such a reply belongs to one of the last requests.
    fn is_recent_request(&self, module: u8, opcode: u8) -> bool {
        self.recent.iter().any(|(to, what, _)| (*to, *what) == (module, opcode))
    }

    /// A probe for the request that waits brought nothing: its answer may still come, so that the
    /// proof begins again with others.
    #[cold]
    pub(super) fn handle_proof_timeout(&mut self, now: Instant, probe: &PendingExchange) {
        self.mark_suspect(now, probe, false);
        let module = probe.host_request.request.address;
        let max = if self.has_answered(module) {
            if self.is_searching_offset(module) { MISALIGNED_PROBES_MAX } else { KNOWN_PROBES_MAX }
        } else if self.may_start_misaligned(module) {
            MISALIGNED_PROBES_MAX
        } else {
            UNKNOWN_PROBES_MAX
        };
        let Some(waiting) = &mut self.unproven_request else { return };
        waiting.proofs_left = PROOFS_NEEDED;
        if waiting.probes_sent < max {
            return self.send_proof_probe(now);
        }
        let ticket = waiting.ticket;
        self.unproven_request = None;
        self.counters.silent += 1;
        self.finish_ticket(Some(ticket), Err(Failure::Silent));
    }
}
