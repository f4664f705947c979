//! How a module is proven of which nothing is known: what an earlier program asked may still be
//! answered.

use super::{Ask, EARLY_MAX, LATEST_TIMEOUTS, Pending, RECENT_MAX, Session};
use crate::error::Failure;
use crate::proto::tmcl::opcode::Opcode;
use crate::proto::tmcl::wire::Request;
use crate::station::{Class, Ticket};
use crate::time::Instant;

/// Probes that prove a module of which nothing is known.
pub(super) const PROOFS: u8 = 3;
/// Probes into silence to a module that never answered.
const UNKNOWN_MAX: u8 = 2;
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
    /// Probes still to be answered, and to be sent at most.
    pub(super) proofs: u8,
    pub(super) left: u8,
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
            left: 2 * PROOFS,
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
        let owed = suspect.map_or(&[][..], |s| &s.tags[..usize::from(s.count)]);
        let fresh = |(opcode, _): &(Opcode, u8)| {
            waiting.last != Some(opcode.number()) && !owed.contains(&opcode.number())
        };
        let choices = PROBES.iter().filter(|probe| fresh(probe)).count();
        let nth = self.proven.below(choices);
        let probe = PROBES.iter().filter(|probe| fresh(probe)).nth(nth).unwrap_or(&PROBES[0]);
        waiting.left = waiting.left.saturating_sub(1);
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
            (waiting.proofs, waiting.left) = (PROOFS, 2 * PROOFS);
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

    /// A probe for the request that waits brought nothing: its answer may still come, so that the
    /// proof begins again with others. From who never answered two are enough.
    #[cold]
    pub(super) fn not_proved(&mut self, now: Instant, probe: &Pending) {
        self.suspect(now, probe, false);
        let module = probe.ask.request.address;
        let known = self.knows(module);
        let Some(waiting) = &mut self.waiting else { return };
        waiting.proofs = PROOFS;
        let sent = 2 * PROOFS - waiting.left;
        if waiting.left > 0 && (known || sent < UNKNOWN_MAX) {
            return self.prove(now);
        }
        let ticket = waiting.ticket;
        self.waiting = None;
        self.counters.silent += 1;
        self.end(Some(ticket), Err(Failure::Silent));
    }
}
