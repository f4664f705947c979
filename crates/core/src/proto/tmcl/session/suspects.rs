//! Modules with a possibly pending reply to an earlier request.

use super::{HostRequest, LATEST_TIMEOUTS, Opcode, PendingExchange, Request, Session};
use crate::proto::drive_address;
use crate::time::Instant;

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
        let Request { address, opcode, .. } = pending.host_request.request;
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns);
        for _ in 0..pending.attempts {
            if !self.suspects.add(address, opcode, until) {
                // The end of this module's doubt will not be noticed.
                self.proven_addresses.remove(address);
            }
        }
        if pending.flags.checksum_error {
            // A module that replies "wrong checksum" exists and is quick.
            self.suspects.allow_probe(address);
        }
        self.suspects.set_probe_due(address, probe && !self.storing_modules.contains(address));
        self.suspicious = true;
    }

    pub(super) fn clear_suspect(&mut self, module: u8) {
        self.suspects.settle(module);
        self.update_suspicious();
    }

    pub(super) fn expire_suspects(&mut self, now: Instant) {
        let probed = self.pending.map(|pending| pending.host_request.request.address);
        while let Some(module) = self.suspects.pop_expired(now, probed) {
            // Time has passed, and proves nothing.
            self.proven_addresses.remove(module);
        }
        self.update_suspicious();
    }

    pub(super) fn update_suspicious(&mut self) {
        self.suspicious = !self.suspects.is_empty()
            || !self.unanswered_modules.is_empty()
            || !self.storing_modules.is_empty()
            || !self.motor_stops.is_empty();
    }

    pub(super) fn is_trusted(&mut self, now: Instant, module: u8) -> bool {
        self.expire_suspects(now);
        !self.suspects.is_in_doubt(now, module)
    }
}
