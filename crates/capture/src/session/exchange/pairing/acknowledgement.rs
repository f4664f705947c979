//! Acknowledgements, which carry no address.

use polepair_core::explain::ReplyCount;

use super::{Pairing, RequestState, TrackedRequest, anomaly};
use crate::session::{AnomalyKind, ExchangeOutcome, ObservedFrame, Quality, SessionNotice};
use crate::timestamp::Timestamp;

impl Pairing {
    /// The next message came before the acknowledgement of this one.
    pub(super) fn report_unacknowledged(
        &mut self,
        at: usize,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let request = &mut self.requests[at];
        if request.awaits.answers == ReplyCount::Zero {
            return self.give_up_request(at, now, notices);
        }
        // Its answer may still come.
        request.awaits.acks = ReplyCount::Zero;
        let text = format!("{}: not acknowledged", request.description());
        notices.push(anomaly(AnomalyKind::MissingAck, request.exchange.axis, text));
    }

    /// Takes an acknowledgement: of the oldest message that waits for one.
    pub fn handle_acknowledge(
        &mut self,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) -> Quality {
        self.revision += 1;
        self.note_start(observed.time);
        self.acks += 1;
        // The oldest: an acknowledgement carries no address, and a line keeps its order (TML on RS-232).
        let Some(request) = self.requests.iter_mut().find(|it| waits_for_ack(it)) else {
            if let Some(request) = self.last_acknowledged(observed.time) {
                let text = format!("{}: acknowledged twice", request.description());
                notices.push(anomaly(AnomalyKind::DuplicateReply, request.exchange.axis, text));
            } else if self.is_past_start(observed.time) {
                let text = "an acknowledgement that no message waits for".to_owned();
                notices.push(anomaly(AnomalyKind::ForeignReply, None, text));
            }
            return Quality::Good;
        };
        request.acks = 1;
        if request.awaits.answers == ReplyCount::Zero {
            let late = request.is_late(observed.time);
            request.state = RequestState::Settled;
            request.exchange.answered = Some((observed.number, observed.time));
            request.exchange.outcome =
                if late { ExchangeOutcome::Late } else { ExchangeOutcome::Done };
            notices.push(SessionNotice::Exchange(request.exchange));
        }
        Quality::Good
    }

    /// The last message, if it was acknowledged a moment ago: a device that repeats it intends that.
    fn last_acknowledged(&self, now: Option<Timestamp>) -> Option<&TrackedRequest> {
        let last = self.requests.back().filter(|request| request.acks > 0)?;
        let soon =
            now.zip(last.last_sent).is_none_or(|(now, sent)| now.since(sent) <= last.limit_ns);
        soon.then_some(last)
    }
}

fn waits_for_ack(request: &TrackedRequest) -> bool {
    request.state == RequestState::Open
        && request.awaits.acks != ReplyCount::Zero
        && request.acks == 0
}
