//! Stops of several motors behind one address: a reply to `MST` does not name its motor.
//!
//! So a reply that is late, or comes twice, looks like the one to the stop of another motor. A module answers
//! in order: once it has answered something else, all replies to stops that were sent before are past. A
//! stop whose reply could be another motor's goes out at once, like every stop, but that reply is not
//! believed: a probe is asked, and then the stop is said once more. So it is with a module that is not
//! proven: an earlier program may have stopped another motor. For motor 0, whose standing is looked
//! at, a good reply is taken as it comes; a refusal of another's stop would say that its own was not executed.

use super::Session;
use super::modules::Modules;
use super::proof::Waiting;
use crate::error::Failure;
use crate::proto::tmcl::wire::Request;
use crate::time::Instant;

/// Modules that answered nothing else yet since stops were sent to them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motors {
    first: Modules,
    further: Modules,
}

impl Motors {
    pub(super) const NONE: Self = Self { first: Modules::NONE, further: Modules::NONE };

    /// A stop goes out.
    pub(super) fn told(&mut self, request: &Request) {
        match request.motor {
            0 => self.first.add(request.address),
            _ => self.further.add(request.address),
        }
    }

    /// Whether a reply may come that looks like the one to this stop and is that to another motor's.
    pub(super) fn may_be_anothers(&self, request: &Request) -> bool {
        let module = request.address;
        self.further.holds(module) || request.motor > 0 && self.first.holds(module)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.first.is_empty() && self.further.is_empty()
    }
}

impl Session {
    /// The module answered something that is no stop.
    pub(super) fn stops_are_past(&mut self, module: u8) {
        self.motors.first.remove(module);
        self.motors.further.remove(module);
        self.note_suspicion();
    }

    /// What came may be the reply to another motor's stop: the present one is said again, behind a probe.
    #[cold]
    pub(super) fn say_behind_a_probe(&mut self, now: Instant) {
        let Some(pending) = self.pending.take() else { return };
        self.counters.late += 1;
        match pending.ticket {
            Some(ticket) if self.waiting.is_none() => {
                let proven = self.proven.holds(pending.ask.request.address);
                self.waiting = Some(Waiting::new(ticket, pending.ask, proven));
            }
            // Something else waits for the same.
            ticket => {
                self.counters.silent += 1;
                self.end(ticket, Err(Failure::Silent));
            }
        }
        self.next(now);
    }
}
