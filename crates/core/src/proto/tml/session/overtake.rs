//! How a stop gets past what is outstanding.

use super::{Phase, Session, Stage};
use crate::error::Failure;
use crate::proto::tml::ask::Ask;
use crate::proto::tml::rules::Wire;
use crate::station::{Class, Ticket, To};
use crate::time::Instant;

impl Session {
    /// A stop, while something is outstanding. Where both may speak at once it does not wait for
    /// answers; on RS-485 it must, or they would collide. An acknowledgement that is on its way is
    /// waited for, because it names nothing: it could be taken for the stop's.
    pub(super) fn overtake(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        let Some(pending) = self.pending.filter(|pending| pending.ask.class != Class::Stop) else {
            return Err(ask);
        };
        if self.stop.is_some() {
            return Err(ask);
        }
        self.stop = Some((ticket, ask));
        match pending.phase {
            Phase::Ready(_) => self.give_way(now),
            Phase::Answer(_) if self.place.wire != Wire::Rs485 => self.give_way(now),
            Phase::Sync(sent, _) => self.phase(Phase::SyncDue(sent)),
            _ => {}
        }
        Ok(())
    }

    /// Takes back what was not sent yet, for a stop.
    pub(in crate::proto::tml) fn recall(&mut self) -> Option<Ticket> {
        let pending = self.pending.as_ref().filter(|pending| pending.ask.class != Class::Stop)?;
        let unsent = matches!(pending.phase, Phase::Ready(_)) && pending.attempts == 0;
        if !unsent || pending.stage != Stage::first(&pending.ask) {
            return None;
        }
        let ticket = pending.ticket?;
        self.pending = None;
        Some(ticket)
    }

    /// The stop that waits takes the line. A question is asked again when the stop is through.
    pub(super) fn give_way(&mut self, now: Instant) {
        let (Some((ticket, ask)), Some(pending)) = (self.stop.take(), self.pending.take()) else {
            return;
        };
        self.gather.clear();
        match (pending.ticket, self.question(&pending)) {
            (None, _) => self.doubts.again(pending.ask.message.to.id),
            (Some(_), Some(_)) => self.aside = Some(pending),
            (Some(waiting), None) => {
                let sent = pending.attempts > 0 || pending.stage != Stage::Itself;
                let failure = if sent { Failure::Silent } else { Failure::Cancelled };
                self.push(To::Ticket(waiting), Err(failure));
            }
        }
        self.start(now, Some(ticket), ask);
    }
}
