//! Sends a stop before the open request is complete.

use super::{RequestPhase, RequestStage, SYNCS_MAX, Session};
use crate::error::Failure;
use crate::proto::tml::host_request::HostRequest;
use crate::proto::tml::rules::TmlWire;
use crate::station::{EventSubject, RequestClass, Ticket};
use crate::time::Instant;

impl Session {
    /// A stop, while something is outstanding. Where both may speak at once it does not wait for
    /// answers; on RS-485 it must, or they would collide. An acknowledgement that is on its way is
    /// waited for, because it names nothing: it could be taken for the stop's.
    pub(super) fn overtake_pending(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        let Some(pending) =
            self.pending.filter(|pending| pending.host_request.class != RequestClass::Stop)
        else {
            return Err(request);
        };
        if self.pending_stop.is_some() {
            return Err(request);
        }
        debug_assert!(self.pending.is_some(), "there is something to overtake");
        self.pending_stop = Some((ticket, request));
        match pending.phase {
            RequestPhase::Ready(_) => self.start_pending_stop(now),
            // On a half-duplex line the answer that is being sent would destroy the stop.
            RequestPhase::AwaitAnswer(_) if self.topology.wire != TmlWire::Rs485 => {
                self.start_pending_stop(now)
            }
            // The other SYNC bytes at once: the stop does not wait for a sign of life.
            RequestPhase::AwaitSync(sent, _) if sent < SYNCS_MAX => {
                self.set_phase(RequestPhase::SendSync(sent))
            }
            // All of them were sent: the stop follows once the last one has left.
            RequestPhase::AwaitSync(..) => {
                self.set_phase(RequestPhase::Drain(now.plus_ns(self.timeouts.character_ns)))
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes back a request that was not sent yet, for a stop.
    pub(in crate::proto::tml) fn recall(&mut self) -> Option<Ticket> {
        let pending = self
            .pending
            .as_ref()
            .filter(|pending| pending.host_request.class != RequestClass::Stop)?;
        let unsent = matches!(pending.phase, RequestPhase::Ready(_)) && pending.attempts == 0;
        if !unsent || pending.stage != RequestStage::first_for(&pending.host_request) {
            return None;
        }
        let ticket = pending.ticket?;
        self.pending = None;
        Some(ticket)
    }

    /// The stop that waits takes the line. A question is asked again when the stop is through.
    pub(super) fn start_pending_stop(&mut self, now: Instant) {
        let (Some((ticket, request)), Some(pending)) =
            (self.pending_stop.take(), self.pending.take())
        else {
            return;
        };
        self.group_answers.clear();
        match (pending.ticket, self.query_of(&pending)) {
            (None, _) => self.stale_replies.repeat_probe(pending.host_request.message.to.id),
            // A question is asked again after the stop: its answer proves nothing about the stop (TML-10).
            (Some(_), Some(_)) => self.overtaken = Some(pending),
            (Some(waiting), None) => {
                debug_assert!(self.pending.is_none(), "the stop takes its place");
                let sent = pending.attempts > 0 || pending.stage != RequestStage::Request;
                let failure = if sent { Failure::Silent } else { Failure::Cancelled };
                self.push_event(EventSubject::Request(waiting), Err(failure));
            }
        }
        self.start_request(now, Some(ticket), request);
    }
}
