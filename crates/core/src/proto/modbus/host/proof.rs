//! How a station is proven of which nothing is known: what an earlier program asked may still be
//! answered.

use super::{Host, OWED_MAX, QUARANTINE_TIMEOUTS, Role, Sending};
use crate::error::Failure;
use crate::proto::modbus::request::{Ask, Request};
use crate::proto::modbus::wire::Space;
use crate::station::{Class, Ticket};
use crate::time::Instant;

/// Probes that prove a station.
const PROOFS: u8 = 2;
/// Probes into silence at most. Behind the first they are reads of holding registers: some drives leave
/// function codes unanswered that they do not know \[I\].
const SILENT_MAX: u8 = 4;
/// Registers or bits of a probe: neither one nor two, for most that is read is as long. A drive that has
/// fewer refuses it, which is an answer.
const COUNT_MIN: u16 = 3;
const COUNT_MAX: u16 = 5;
/// Other function codes than most reads have.
const SPACES: [Space; 3] = [Space::Coil, Space::Discrete, Space::Input];

/// The probes before a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Proof {
    /// Still to be answered, and how many were not.
    left: u8,
    silent: u8,
    /// The one that is out, or is to be sent.
    space: Space,
    count: u16,
}

impl Host {
    /// Takes a request to a station of which nothing is known: probes go first.
    #[cold]
    pub(super) fn prove(&mut self, now: Instant, ticket: Ticket, request: Request) {
        self.begin(now, ticket, request);
        self.draw_probe(PROOFS, 0);
    }

    fn draw_probe(&mut self, left: u8, silent: u8) {
        let last = self.proof.map(|proof| proof.space);
        let mut others = SPACES.into_iter().filter(|space| last != Some(*space));
        let nth = self.proven.below(SPACES.len() - usize::from(last.is_some()));
        let space = match silent {
            0 => others.nth(nth).unwrap_or(Space::Input),
            _ => Space::Holding,
        };
        let before = self.proof.map_or(0, |proof| proof.count);
        let mut others = (COUNT_MIN..=COUNT_MAX).filter(|count| *count != before);
        let nth = self.proven.below(usize::from(COUNT_MAX - COUNT_MIN));
        let count = others.nth(nth).unwrap_or(COUNT_MAX);
        self.proof = Some(Proof { left, silent, space, count });
        self.quarantine = true;
        self.deadline = None;
        self.sending = Some(Sending::Probe);
    }

    /// What is to be sent as a probe.
    pub(super) fn next_probe(&self) -> Option<Request> {
        let (Some(Proof { space, count, .. }), Some(current)) = (self.proof, &self.current) else {
            return self.probe();
        };
        let start = match current.request.ask {
            Ask::Read { space: Space::Holding, start, .. } if space == Space::Holding => start,
            _ => 0,
        };
        let ask = Ask::Read { space, start, count };
        Some(Request { unit: current.request.unit, ask, class: Class::Idempotent })
    }

    /// A probe was answered, and nothing is owed any more.
    pub(super) fn proved(&mut self, now: Instant) {
        let (Some(proof), Some(current)) = (self.proof, &mut self.current) else { return };
        if proof.left > 1 {
            return self.draw_probe(proof.left - 1, proof.silent);
        }
        self.proven.add(current.request.unit);
        current.since = now;
        self.proof = None;
        self.sending = Some(Sending::Request);
    }

    /// A probe was not answered in time: others follow, and all are to be answered then. From a wire on
    /// which nothing was heard one more is enough.
    #[cold]
    pub(super) fn not_proved(&mut self) {
        let Some(proof) = self.proof else { return };
        let silent = proof.silent + 1;
        let most = if self.heard { SILENT_MAX } else { 1 };
        if silent <= most && self.owed_len < OWED_MAX {
            self.owed[..self.owed_len].iter_mut().for_each(|owed| owed.role = Role::Abandoned);
            return self.draw_probe(PROOFS, silent);
        }
        self.settle();
        self.fail(Failure::Silent);
    }

    /// How many timeouts a probe's answer is waited for: where the first brings none, an older request's
    /// may still come before it.
    pub(super) fn timeouts(&self) -> u64 {
        match self.proof {
            Some(Proof { silent: 0, .. }) => 1,
            _ if self.quarantine => QUARANTINE_TIMEOUTS,
            _ => 1,
        }
    }
}
