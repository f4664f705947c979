//! How a module is proven of which nothing is known: what an earlier program asked may still be
//! answered.

use super::{Ask, EARLY_MAX, LATEST_TIMEOUTS, Pending, RECENT_MAX, Session, Suspect};
use crate::error::Failure;
use crate::proto::tmcl::opcode::Opcode;
use crate::proto::tmcl::wire::{Reply, Request};
use crate::station::{Class, Ticket};
use crate::time::Instant;

/// Probes that prove a module of which nothing is known.
pub(super) const PROOFS: u8 = 3;
/// Probes into silence to a module that answered before.
const KNOWN_MAX: u8 = 2 * PROOFS;
/// The same to one that never did.
const UNKNOWN_MAX: u8 = 2;
/// The same to one that may have lost count.
const SENT_MAX: u8 = 40;

/// Probes that are answered among older replies, after which those are taken for somebody else's.
const OLDER_MAX: u8 = 16;

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
pub(super) struct Waiting {
    pub(super) ticket: Ticket,
    pub(super) ask: Ask,
    /// Probes still to be answered.
    pub(super) proofs: u8,
    /// Probes that were sent.
    pub(super) sent: u8,
    /// All that were answered came sooner than the baud rate allows.
    pub(super) soon: bool,
    /// The probe before, which the next one differs from.
    pub(super) last: Option<u8>,
    /// Since the present probe the module said something else: older replies are on their way.
    pub(super) older: bool,
    /// How many probes were answered so.
    pub(super) olders: u8,
}

impl Waiting {
    /// Nothing proven yet. Of a module that is `proven` one answer more shows what is past.
    pub(super) const fn new(ticket: Ticket, ask: Ask, proven: bool) -> Self {
        Self {
            ticket,
            ask,
            proofs: if proven { 1 } else { PROOFS },
            sent: 0,
            soon: !proven,
            last: None,
            older: false,
            olders: if proven { OLDER_MAX } else { 0 },
        }
    }
}

impl Session {
    /// Sends the next probe for the request that waits.
    #[cold]
    pub(super) fn prove(&mut self, now: Instant) {
        let Some(mut waiting) = self.waiting else { return };
        let module = waiting.ask.request.address;
        let suspect = self.suspects.iter().flatten().find(|suspect| suspect.module == module);
        let fresh = |(opcode, _): &(Opcode, u8)| {
            let is_owed = |suspect: &Suspect| suspect.owes(now).any(|tag| tag == opcode.number());
            waiting.last != Some(opcode.number()) && !suspect.is_some_and(is_owed)
        };
        let choices = PROBES.iter().filter(|probe| fresh(probe)).count();
        let nth = self.proven.below(choices);
        let probe = PROBES.iter().filter(|probe| fresh(probe)).nth(nth).unwrap_or(&PROBES[0]);
        waiting.sent = waiting.sent.saturating_add(1);
        waiting.last = Some(probe.0.number());
        self.waiting = Some(waiting);
        let request =
            Request { address: module, opcode: probe.0, kind: probe.1, motor: 0, value: 0 };
        self.start(now, None, Ask { request, class: Class::Idempotent });
    }

    /// A probe for the request that waits was answered.
    pub(super) fn proved(&mut self, now: Instant) {
        let Some(waiting) = &mut self.waiting else { return };
        waiting.proofs = waiting.proofs.saturating_sub(1);
        if core::mem::take(&mut waiting.older) && waiting.olders < OLDER_MAX {
            // What answered it may be one of them.
            waiting.olders += 1;
            (waiting.proofs, waiting.sent) = (PROOFS, 0);
        }
        if waiting.proofs > 0 {
            return self.prove(now);
        }
        let Waiting { ticket, ask, soon, .. } = *waiting;
        let module = ask.request.address;
        self.waiting = None;
        self.proven.add(module);
        self.stops_are_past(module);
        if soon {
            // Nobody else could own these answers: the line has no baud rate.
            self.early_streak = EARLY_MAX;
        }
        self.start(now, Some(ticket), ask);
    }

    /// The module that is being proven said what nobody asks now.
    pub(super) fn older(&mut self, module: u8) {
        if let Some(waiting) = &mut self.waiting
            && waiting.ask.request.address == module
        {
            waiting.older = true;
        }
    }

    /// Whether an earlier request could be answered by such a reply.
    pub(super) fn could_own(&self, now: Instant, module: u8, opcode: u8) -> bool {
        let latest = LATEST_TIMEOUTS * self.timeout_ns;
        let newest = self.recent_at.wrapping_sub(1) % RECENT_MAX;
        self.recent.iter().enumerate().any(|(n, (to, what, at))| {
            n != newest && (*to, *what) == (module, opcode) && now < at.plus_ns(latest)
        })
    }

    /// Counts an answer to nothing that waits: a late one where it was asked for.
    pub(super) fn unasked(&mut self, reply: &Reply) {
        let asked = self.was_asked(reply.module, reply.opcode.number());
        self.counters.late += u64::from(asked);
        self.counters.foreign += u64::from(!asked);
    }

    /// Whether such a reply answers one of the last requests.
    fn was_asked(&self, module: u8, opcode: u8) -> bool {
        self.recent.iter().any(|(to, what, _)| (*to, *what) == (module, opcode))
    }

    /// A probe for the request that waits brought nothing: its answer may still come, so that the
    /// proof begins again with others.
    #[cold]
    pub(super) fn not_proved(&mut self, now: Instant, probe: &Pending) {
        self.suspect(now, probe, false);
        let module = probe.ask.request.address;
        let most = match self.knows(module) {
            true if self.is_searched(module) => SENT_MAX,
            true => KNOWN_MAX,
            false if self.may_be_shifted(module) => SENT_MAX,
            false => UNKNOWN_MAX,
        };
        let Some(waiting) = &mut self.waiting else { return };
        waiting.proofs = PROOFS;
        if waiting.sent < most {
            return self.prove(now);
        }
        let ticket = waiting.ticket;
        self.waiting = None;
        self.counters.silent += 1;
        self.end(Some(ticket), Err(Failure::Silent));
    }
}
