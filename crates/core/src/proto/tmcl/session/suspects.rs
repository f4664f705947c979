//! Modules with a possibly pending reply to an earlier request.

use super::{
    HostRequest, LATEST_TIMEOUTS, OUTSTANDING_MAX, Opcode, PROBES_MAX, PendingExchange, Request,
    SUSPECTS_MAX, Session, SuspectModule,
};
use crate::proto::drive_address;
use crate::time::Instant;

impl SuspectModule {
    /// Opcodes of requests whose answers may still come.
    pub(super) fn outstanding_opcodes(&self, now: Instant) -> impl Iterator<Item = u8> {
        let tags = &self.outstanding[..usize::from(self.outstanding_len)];
        tags.iter().filter(move |(_, until)| now < *until).map(|(opcode, _)| *opcode)
    }

    /// Drops requests whose replies can no longer arrive.
    fn drop_expired(&mut self, now: Instant) {
        let mut stored = 0;
        for n in 0..usize::from(self.outstanding_len) {
            if now < self.outstanding[n].1 {
                self.outstanding[stored] = self.outstanding[n];
                stored += 1;
            }
        }
        self.outstanding_len = stored as u8;
    }
}

impl Session {
    /// Quarantines a module that sent an impossible value of a parameter: since a copy of an older reply each reply may
    /// belong to the request before, and the last is still to come. So a probe of another opcode is sent.
    #[cold]
    pub(in crate::proto::tmcl) fn quarantine_module(&mut self, now: Instant, address: u32) {
        let address = drive_address(address) as u8;
        // As if a read had stayed unanswered: probes then settle the order of replies.
        let request = Request { address, opcode: Opcode::Gap, kind: 0, motor: 0, value: 0 };
        let pending_exchange = PendingExchange {
            attempts: 1,
            ..PendingExchange::new(now, None, HostRequest::of(request), 0)
        };
        self.mark_suspect(now, &pending_exchange, true);
        self.start_next(now);
    }

    /// Notes that replies of `pending` may still come.
    pub(super) fn mark_suspect(&mut self, now: Instant, pending: &PendingExchange, probe: bool) {
        // A request that never left has no reply.
        if pending.attempts == 0 {
            return;
        }
        let module = pending.host_request.request.address;
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns);
        let index = self
            .suspects
            .iter()
            .position(|s| s.is_some_and(|s| s.module == module))
            .or_else(|| free_slot(&self.suspects));
        // A full table keeps its oldest entry longest: the line is closed until one is out.
        let index = index.unwrap_or(SUSPECTS_MAX - 1);
        let tags = [(0, until); OUTSTANDING_MAX];
        let fresh = SuspectModule {
            module,
            outstanding: tags,
            outstanding_len: 0,
            probes: 0,
            probe_due: false,
            until,
        };
        let suspect = self.suspects[index].get_or_insert(fresh);
        suspect.drop_expired(now);
        for _ in 0..pending.attempts {
            // One reply for each attempt; those beyond the table are covered by the module's own time.
            if let Some(tag) = suspect.outstanding.get_mut(usize::from(suspect.outstanding_len)) {
                *tag = (pending.host_request.request.opcode.number(), until);
                suspect.outstanding_len += 1;
            }
        }
        suspect.until = suspect.until.max(until);
        // A module that replies "wrong checksum" exists and is quick: it is worth further attempts.
        suspect.probe_due = probe && (suspect.probes < PROBES_MAX || pending.flags.checksum_error);
        self.suspicious = true;
    }

    pub(super) fn clear_suspect(&mut self, module: u8) {
        for slot in &mut self.suspects {
            if slot.is_some_and(|suspect| suspect.module == module) {
                *slot = None;
            }
        }
        self.update_suspicious();
    }

    pub(super) fn expire_suspects(&mut self, now: Instant) {
        let probed = self.pending.map(|pending| pending.host_request.request.address);
        for slot in &mut self.suspects {
            let Some(SuspectModule { module, .. }) =
                slot.filter(|s| now >= s.until && probed != Some(s.module))
            else {
                continue;
            };
            *slot = None;
            // Time has passed, and proves nothing.
            self.proven_addresses.remove(module);
        }
        self.update_suspicious();
    }

    pub(super) fn update_suspicious(&mut self) {
        let suspects = self.suspects.iter().any(Option::is_some);
        self.suspicious =
            suspects || !self.unanswered_modules.is_empty() || !self.motor_stops.is_empty();
    }

    pub(super) fn is_trusted(&mut self, now: Instant, module: u8) -> bool {
        self.expire_suspects(now);
        let full = self.suspects.iter().all(Option::is_some);
        !full && !self.suspects.iter().flatten().any(|suspect| suspect.module == module)
    }
}

fn free_slot(slots: &[Option<SuspectModule>]) -> Option<usize> {
    slots.iter().position(Option::is_none)
}
