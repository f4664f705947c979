//! Proof of an unproven station, whose replies to an earlier program may still be pending.

use super::{LATEST_TIMEOUTS, OUTSTANDING_MAX, PendingSend, ReplyRole, SerialHost};
use crate::error::Failure;
use crate::proto::modbus::host_request::{HostRequest, RequestBody};
use crate::proto::modbus::wire::Space;
use crate::station::{RequestClass, Ticket};
use crate::time::Instant;

/// Probes that prove a station.
const PROOFS_NEEDED: u8 = 2;
/// Probes into silence at most. Behind the first they are reads of holding registers: some drives leave
/// function codes unanswered that they do not know \[I\].
const UNANSWERED_MAX: u8 = 4;
/// Registers or bits of a probe: neither one nor two, for most that is read is as long. A drive that has
/// fewer refuses it, which is an answer.
// Not 1 or 2, which most programs read: their late replies would pass.
const COUNT_MIN: u16 = 3;
const COUNT_MAX: u16 = 5;
/// Other function codes than most reads have.
const SPACES: [Space; 3] = [Space::Coil, Space::Discrete, Space::Input];

/// The probes before a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct StationProof {
    /// Still to be answered, and how many were not.
    probes_left: u8,
    unanswered: u8,
    /// The one that is out, or is to be sent.
    space: Space,
    count: u16,
}

impl SerialHost {
    /// Takes a request to a station of which nothing is known: probes go first.
    #[cold]
    pub(super) fn begin_proof(&mut self, now: Instant, ticket: Ticket, request: HostRequest) {
        self.start_request(now, ticket, request);
        self.draw_probe(PROOFS_NEEDED, 0);
    }

    fn draw_probe(&mut self, left: u8, silent: u8) {
        let last = self.proof.map(|proof| proof.space);
        let mut others = SPACES.into_iter().filter(|space| last != Some(*space));
        // Another one each time, so that a reply to the probe before does not answer this one.
        let nth = self.proven_addresses.random_below(SPACES.len() - usize::from(last.is_some()));
        let space = match silent {
            0 => others.nth(nth).unwrap_or(Space::Input),
            // A drive that ignores unknown function codes still answers a read of its registers.
            _ => Space::Holding,
        };
        let before = self.proof.map_or(0, |proof| proof.count);
        let mut others = (COUNT_MIN..=COUNT_MAX).filter(|count| *count != before);
        let nth = self.proven_addresses.random_below(usize::from(COUNT_MAX - COUNT_MIN));
        let count = others.nth(nth).unwrap_or(COUNT_MAX);
        self.proof = Some(StationProof { probes_left: left, unanswered: silent, space, count });
        // Nothing but the probe and a stop is sent until the order of replies is proven (REQ-7).
        self.quarantine = true;
        self.deadline = None;
        self.sending = Some(PendingSend::Probe);
    }

    /// Probe to send.
    pub(super) fn probe_request(&self) -> Option<HostRequest> {
        let (Some(StationProof { space, count, .. }), Some(current)) = (self.proof, &self.current)
        else {
            return self.quarantine_probe();
        };
        let start = match current.request.body {
            // Registers that the caller is about to read exist; number 0 may not.
            RequestBody::Read { space: Space::Holding, start, .. } if space == Space::Holding => {
                start
            }
            _ => 0,
        };
        let request = RequestBody::Read { space, start, count };
        Some(HostRequest {
            unit: current.request.unit,
            body: request,
            class: RequestClass::Idempotent,
        })
    }

    /// Handles the reply to a probe, if no other reply is outstanding.
    pub(super) fn handle_proof(&mut self, now: Instant) {
        let (Some(proof), Some(current)) = (self.proof, &mut self.current) else { return };
        if proof.probes_left > 1 {
            return self.draw_probe(proof.probes_left - 1, proof.unanswered);
        }
        debug_assert_eq!(proof.probes_left, 1, "every probe was answered");
        self.proven_addresses.insert(current.request.unit);
        current.since = now;
        self.proof = None;
        self.sending = Some(PendingSend::Request);
    }

    /// Handles a probe without a reply in time: others follow, and all must be answered then. On a wire without any
    /// received byte one more is enough.
    #[cold]
    pub(super) fn handle_proof_timeout(&mut self) {
        let Some(proof) = self.proof else { return };
        let silent = proof.unanswered + 1;
        // Bytes were received, so a drive is there: it may refuse this kind of probe. Without a byte two are enough.
        let max = if self.received_any { UNANSWERED_MAX } else { 1 };
        if silent <= max && self.outstanding_len < OUTSTANDING_MAX {
            self.outstanding[..self.outstanding_len]
                .iter_mut()
                .for_each(|awaited| awaited.role = ReplyRole::Abandoned);
            return self.draw_probe(PROOFS_NEEDED, silent);
        }
        self.end_quarantine();
        self.fail_current(Failure::Silent);
    }

    /// Number of timeouts a probe's answer is waited for: where the first brings none, an older request's may still
    /// come before it.
    pub(super) fn deadline_timeouts(&self) -> u64 {
        match self.proof {
            Some(StationProof { unanswered: 0, .. }) => 1,
            // A late reply may take as long as the request that is waited for, and its own probe's behind it.
            _ if self.quarantine => LATEST_TIMEOUTS,
            _ => 1,
        }
    }
}
