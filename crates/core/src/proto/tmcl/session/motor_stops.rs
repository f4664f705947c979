//! Stops of several motors of one module: a reply to `MST` does not name its motor.
//!
//! A late or repeated reply therefore looks like the reply to the stop of another motor. A module replies
//! in order: after another reply, all replies to earlier stops are past. A stop whose reply is ambiguous is
//! sent at once, but its reply is not accepted: a probe is sent, and then the stop again. The same applies
//! to an unproven module, because an earlier program may have stopped another motor. For motor 0, whose
//! standstill is checked, a positive reply is accepted; a refusal of another motor's stop would wrongly
//! mean that its own was not executed.

use super::module_set::ModuleSet;
use super::proof::UnprovenRequest;
use super::{HostRequest, Session};
use crate::error::Failure;
use crate::proto::tmcl::wire::Request;
use crate::station::Ticket;
use crate::time::Instant;

/// Limit of stops that wait to be repeated: of every motor but the one that is sent now.
pub(super) const REPEATED_STOPS_MAX: usize = 5;

/// Modules that answered nothing else yet since stops were sent to them.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotorStops {
    first_motor: ModuleSet,
    other_motors: ModuleSet,
}

impl MotorStops {
    pub(super) const NONE: Self =
        Self { first_motor: ModuleSet::NONE, other_motors: ModuleSet::NONE };

    /// A stop goes out.
    pub(super) fn note_stop_sent(&mut self, request: &Request) {
        match request.motor {
            0 => self.first_motor.insert(request.address),
            _ => self.other_motors.insert(request.address),
        }
    }

    /// Returns whether a reply may come that looks like the one to this stop and is that to another motor's.
    pub(super) fn is_reply_ambiguous(&self, request: &Request) -> bool {
        let module = request.address;
        self.other_motors.contains(module) || request.motor > 0 && self.first_motor.contains(module)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.first_motor.is_empty() && self.other_motors.is_empty()
    }
}

impl Session {
    /// The module answered something that is no stop.
    pub(super) fn forget_stops(&mut self, module: u8) {
        self.motor_stops.first_motor.remove(module);
        self.motor_stops.other_motors.remove(module);
        self.update_suspicious();
    }

    /// Repeats the present stop behind a probe, because its reply may have been that of another motor's stop.
    #[cold]
    pub(super) fn repeat_after_probe(&mut self, now: Instant) {
        let Some(pending) = self.pending.take() else { return };
        self.counters.late += 1;
        match pending.ticket {
            Some(ticket) if self.unproven_request.is_none() => {
                let proven = self.proven_addresses.contains(pending.host_request.request.address);
                self.unproven_request =
                    Some(UnprovenRequest::new(ticket, pending.host_request, proven));
            }
            Some(ticket) => self.queue_stop(ticket, pending.host_request),
            None => {}
        }
        self.start_next(now);
    }

    /// Queues another stop, to be sent first.
    fn queue_stop(&mut self, ticket: Ticket, stop: HostRequest) {
        match self.repeated_stops.iter_mut().find(|place| place.is_none()) {
            Some(place) => *place = Some((ticket, stop)),
            // More stops than motors of a module: what does not fit is reported as silent, and its caller repeats
            // it.
            None => {
                self.counters.silent += 1;
                self.finish_ticket(Some(ticket), Err(Failure::Silent));
            }
        }
    }

    /// Takes the waiting stops, which will not be repeated.
    pub(super) fn take_repeated_stops(&mut self) -> impl Iterator<Item = Ticket> + use<> {
        let waiting = core::mem::take(&mut self.repeated_stops);
        waiting.into_iter().flatten().map(|(ticket, _)| ticket)
    }

    /// Sends the next waiting stop, if none is pending.
    pub(super) fn next_repeated_stop(&mut self) {
        if self.unproven_request.is_some() {
            return;
        }
        let Some((ticket, stop)) = self.repeated_stops[0].take() else { return };
        debug_assert!(self.unproven_request.is_none(), "one request waits for its proof at a time");
        self.repeated_stops.rotate_left(1);
        let proven = self.proven_addresses.contains(stop.request.address);
        self.unproven_request = Some(UnprovenRequest::new(ticket, stop, proven));
    }
}
