//! Stops that come before what waits.

use super::{HostRequest, Session};
use crate::error::Failure;
use crate::station::{RequestClass, Ticket};
use crate::time::Instant;

impl Session {
    /// Takes back a request that was not sent yet, for a stop.
    pub(in crate::proto::tmcl) fn recall(&mut self) -> Option<Ticket> {
        if let Some(waiting) = self
            .unproven_request
            // Only its probes have left: the request itself has not, so to give it back is no repetition (STOP-3).
            .take_if(|waiting| waiting.host_request.class != RequestClass::Stop)
        {
            return Some(waiting.ticket);
        }
        let ticket = self
            .pending
            .as_ref()
            .filter(|p| !p.sent && p.attempts == 0 && p.host_request.class != RequestClass::Stop)?
            .ticket?;
        self.pending = None;
        Some(ticket)
    }

    /// The request of that ticket, of which nothing is on the wire yet, gets one attempt.
    pub(in crate::proto::tmcl) fn disable_retries(&mut self, ticket: Ticket) {
        if let Some(pending) = self.pending.as_mut().filter(|p| p.ticket == Some(ticket)) {
            pending.flags.no_retry = true;
        }
    }

    /// A stop, while something is outstanding: a probe is given up at once; a request keeps its
    /// present chance, because its reply may be on the wire, but gets no further one.
    pub(super) fn overtake_pending(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        let Some(pending) = &mut self.pending else { return Err(request) };
        if self.pending_stop.is_some() || pending.host_request.class == RequestClass::Stop {
            return Err(request);
        }
        match (pending.ticket, pending.sent) {
            // It is recalled, not overtaken.
            (Some(_), false) if pending.attempts == 0 => return Err(request),
            // Between two attempts of a repeated request: the first may still be answered.
            (Some(waiting), false) => {
                let pending = *pending;
                self.pending = None;
                self.mark_suspect(now, &pending, true);
                self.finish_ticket(Some(waiting), Err(Failure::Silent));
                self.start_request(now, Some(ticket), request);
            }
            (Some(_), true) => {
                pending.flags.no_retry = true;
                self.pending_stop = Some((ticket, request));
            }
            // A probe has no caller; the stop takes its place.
            (None, _) => {
                let probe = *pending;
                self.pending = None;
                self.mark_suspect(now, &probe, true);
                self.start_request(now, Some(ticket), request);
            }
        }
        Ok(())
    }
}
