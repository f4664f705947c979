//! Requests whose reply is overdue.

use super::*;

impl Pairing {
    /// Bytes that are no frame came from a drive: the answer that is due may have been among them, and
    /// may yet come whole.
    pub fn mark_spoiled(&mut self) {
        let last = self.requests.back_mut().filter(|request| request.awaits_answer());
        last.into_iter().for_each(|request| request.spoiled = true);
    }

    /// Time goes on.
    pub fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        self.now = Some(now);
        if self.due.is_none_or(|due| now < due) {
            return;
        }
        self.revision += 1;
        self.due = None;
        for at in 0..self.requests.len() {
            let request = &self.requests[at];
            let waited = request.last_sent.map_or(0, |last| now.since(last));
            if request.state == RequestState::Open && waited > request.patience_ns() {
                self.give_up_request(at, Some(now), notices);
            }
            self.due = earliest(self.due, deadline(&self.requests[at]));
        }
    }

    /// Ends the capture: overdue replies are missing, others are no fault.
    pub fn finish(&mut self, notices: &mut Vec<SessionNotice>) {
        for at in 0..self.requests.len() {
            let request = &mut self.requests[at];
            if request.state != RequestState::Open || !request.requires_reply() {
                continue;
            }
            if request.is_late(self.now) {
                self.give_up_request(at, self.now, notices);
            } else {
                request.exchange.outcome = ExchangeOutcome::Unknown;
                notices.push(SessionNotice::Exchange(request.exchange));
            }
        }
        self.requests.clear();
    }

    pub(super) fn give_up_request(
        &mut self,
        at: usize,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let acks = self.acks;
        let request = &mut self.requests[at];
        request.state = RequestState::GivenUp;
        // A tool between host and drive may keep acknowledgements to itself.
        let unheard = acks == 0 && self.answers > 0 && request.awaits.answers == ReplyCount::Zero;
        if !request.requires_reply() || unheard {
            return;
        }
        if request.spoiled {
            // The damaged reply was reported.
            request.exchange.outcome = ExchangeOutcome::BadCheck;
            return notices.push(SessionNotice::Exchange(request.exchange));
        }
        let due = request.last_sent.map(|last| Timestamp(last.0.saturating_add(request.limit_ns)));
        let time = due.map(|due| now.map_or(due, |now| now.min(due)));
        let mut text = match (request.awaits.answers, request.answers) {
            (ReplyCount::Zero, _) => format!("{}: not acknowledged", request.description()),
            (ReplyCount::Exactly(count), got @ 1..) => {
                format!("{}: {got} of {count} answers", request.description())
            }
            _ => format!("{}: no answer", request.description()),
        };
        if request.exchange.retries > 0 {
            let _ = write!(text, ", though sent {} times", request.exchange.retries + 1);
        }
        let kind = match (request.awaits.answers, request.answers) {
            (ReplyCount::Zero, _) if acks > 0 => AnomalyKind::MissingAck,
            (_, 1..) => AnomalyKind::Incomplete,
            _ => AnomalyKind::Unanswered,
        };
        let axis = request.exchange.axis;
        notices.push(SessionNotice::Exchange(request.exchange));
        notices.push(SessionNotice::Anomaly(AnomalyNotice { kind, axis, time, text }));
        if self.given_up_axes.len() < AXES_MAX {
            let times = 1 + usize::from(self.requests[at].exchange.retries);
            self.given_up_axes.extend(axis.into_iter().cycle().take(times));
        }
    }

    /// Learns the format of the axis' replies from now on.
    pub(super) fn learn_format(&mut self, at: usize) {
        let request = &self.requests[at];
        let Some(axis) = request.exchange.axis else { return };
        let slot = self.format_requests.iter().position(|(of, _)| *of == axis);
        let slot = slot.unwrap_or_else(|| {
            if self.format_requests.len() == AXES_MAX {
                self.format_requests.remove(0);
            }
            self.format_requests.push((axis, FrameBytes::default()));
            self.format_requests.len() - 1
        });
        self.format_requests[slot].1.store(&request.frame.raw());
    }
}
