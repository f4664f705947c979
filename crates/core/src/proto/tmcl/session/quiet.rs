//! Modules that are not heard: they may have lost count of bytes.
//!
//! Some modules count to nine and know no pause: one that got a byte too many or too few takes no
//! request any more. A single byte between two requests moves its count on by one, so that it is in
//! step again after nine of them at most. A module that is only late must not get that byte, so it
//! waits until the latest possible reply is past.

use super::{Opcode, Pending, SUSPECTS_MAX, Session};
use crate::station::Class;
use crate::time::Instant;

/// Timeouts after the first request that was not answered, before bytes are put between requests.
const SHIFT_TIMEOUTS: u64 = 2;
/// Requests that were not answered, before that.
const SENDS_MIN: u8 = 2;

/// A module of which nothing was heard since requests to it were not answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quiet {
    module: u8,
    since: Instant,
    sends: u8,
}

impl Session {
    /// Notes that a request was not answered.
    pub(super) fn unheard(&mut self, now: Instant, pending: &Pending) {
        let module = pending.ask.request.address;
        let same = |quiet: &Option<Quiet>| quiet.is_some_and(|quiet| quiet.module == module);
        let free = |slots: &[Option<Quiet>]| slots.iter().position(Option::is_none);
        let place = self.quiet.iter().position(same).or_else(|| free(&self.quiet));
        let fresh = Quiet { module, since: now, sends: 0 };
        let quiet = &mut self.quiet[place.unwrap_or(SUSPECTS_MAX - 1)];
        if !same(quiet) {
            *quiet = Some(fresh);
        }
        if let Some(quiet) = quiet {
            quiet.sends = quiet.sends.saturating_add(1);
        }
        self.suspicious = true;
    }

    /// Notes that a module was heard: it counts as this host does.
    pub(super) fn is_heard(&mut self, module: u8) {
        for place in &mut self.quiet {
            if place.is_some_and(|quiet| quiet.module == module) {
                *place = None;
            }
        }
        self.note_suspicion();
    }

    fn quiet_of(&self, module: u8) -> Option<&Quiet> {
        self.quiet.iter().flatten().find(|quiet| quiet.module == module)
    }

    /// True while the request to be sent next goes to a module that may have lost count of bytes.
    pub(in crate::proto::tmcl) fn wants_shift(&self, now: Instant) -> bool {
        let Some(pending) = self.pending.as_ref().filter(|pending| !pending.sent) else {
            return false;
        };
        let module = pending.ask.request.address;
        // Others hear it too: it is for none that was never there.
        let worth = self.knows(module) || self.heard == [0; 4];
        let quiet = self.quiet_of(module).filter(|_| worth);
        !self.wants_burst()
            && quiet.is_some_and(|quiet| {
                let past = now >= quiet.since.plus_ns(SHIFT_TIMEOUTS * self.timeout_ns);
                past && quiet.sends >= SENDS_MIN
            })
    }

    /// True while the request to be sent next is a stop to a module that did not answer: it goes out so
    /// that the module takes it wherever it is in its count.
    pub(in crate::proto::tmcl) fn wants_burst(&self) -> bool {
        let Some(pending) = self.pending.as_ref().filter(|pending| !pending.sent) else {
            return false;
        };
        let stop = pending.ask.class == Class::Stop && pending.ask.request.opcode == Opcode::Mst;
        stop && self.quiet_of(pending.ask.request.address).is_some()
    }
}
