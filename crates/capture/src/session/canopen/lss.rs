//! Layer setting services: requests to all devices of a bus, answered by one or none (CiA 305). Requests
//! that form one selection, such as the four numbers of an identity, are one exchange.
//!
//! Some requests are answered by silence: a search for devices gets no reply if there is none. A setting
//! must get a reply.

use polepair_core::proto::canopen::explain::{lss_answers, lss_kind};
use polepair_core::proto::canopen::lss::{LssReply, LssRequest};

use super::sdo::{FLASH_TIMEOUT_NS, FrameRef, TIMEOUT_NS};
use crate::session::{
    AnomalyKind, AnomalyNotice, ExchangeNotice, ExchangeOutcome, InternedName, SessionNotice,
};
use crate::timestamp::Timestamp;

/// The layer setting of one bus.
#[derive(Debug, Default)]
pub(super) struct LssTracker {
    pending: Option<LssExchange>,
    /// Last answered exchange, and its reply.
    last_answered: Option<(LssExchange, [u8; 8])>,
    /// Exchange that was given up.
    abandoned: Option<LssExchange>,
    /// True if a request was received: later replies do not belong to requests before the capture.
    sees_requests: bool,
}

/// A request.
#[derive(Clone, Copy, Debug)]
struct LssExchange {
    request: [u8; 8],
    op: InternedName,
    /// First frame, and last frame.
    first: FrameRef,
    last: FrameRef,
    expectation: LssExpectation,
    retries: u16,
}

/// Expected reply of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum LssExpectation {
    /// Nothing: it is an order, or more of it comes.
    Nothing,
    /// A reply if there is such a device; silence means that there is none.
    Optional,
    /// An answer.
    Required,
}

impl LssExpectation {
    const fn for_request(request: LssRequest) -> Self {
        match request {
            LssRequest::SwitchGlobal(_)
            | LssRequest::ActivateBitTiming(_)
            | LssRequest::Other(_) => Self::Nothing,
            LssRequest::SwitchSelective(..)
            | LssRequest::Identify(..)
            | LssRequest::IdentifyUnconfigured
            | LssRequest::FastScan { .. } => Self::Optional,
            LssRequest::SetNode(_)
            | LssRequest::SetBitTiming(..)
            | LssRequest::Store
            | LssRequest::Inquire(_)
            | LssRequest::InquireNode => Self::Required,
        }
    }
}

impl LssExchange {
    fn timeout_ns(&self) -> u64 {
        match LssRequest::parse(&self.request) {
            Ok(LssRequest::Store) => FLASH_TIMEOUT_NS,
            _ => TIMEOUT_NS,
        }
    }

    fn exchange_notice(
        &self,
        answered: Option<FrameRef>,
        outcome: ExchangeOutcome,
    ) -> SessionNotice {
        let Self { op, first, retries, .. } = *self;
        SessionNotice::Exchange(ExchangeNotice {
            axis: None,
            op,
            requested: first,
            answered,
            outcome,
            retries,
        })
    }
}

impl LssTracker {
    /// Takes eight bytes from the master.
    pub fn handle_request(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Ok(request) = LssRequest::parse(&bytes) else { return };
        (self.sees_requests, self.last_answered) = (true, None);
        let op = lss_kind(request);
        let before = self.pending.take();
        if let Some(mut open) = before {
            let more = open.op == op
                && open.expectation == LssExpectation::Optional
                && is_continuation(request);
            let again = open.expectation == LssExpectation::Required && open.request == bytes;
            if more || again {
                (open.request, open.last) = (bytes, at);
                open.retries += u16::from(again);
                self.pending = Some(open);
                if again {
                    notices.push(anomaly(
                        AnomalyKind::Retry,
                        format!("{op} sent again before an answer"),
                    ));
                }
                return;
            }
            self.give_up(open, " before the next request", notices);
        }
        let lss_expectation = LssExpectation::for_request(request);
        let exchange = LssExchange {
            request: bytes,
            op,
            first: at,
            last: at,
            expectation: lss_expectation,
            retries: 0,
        };
        match lss_expectation {
            LssExpectation::Nothing => {
                notices.push(exchange.exchange_notice(None, ExchangeOutcome::Done))
            }
            _ => self.pending = Some(exchange),
        }
    }

    /// Takes eight bytes from a device.
    pub fn handle_reply(&mut self, bytes: [u8; 8], at: FrameRef, notices: &mut Vec<SessionNotice>) {
        if let Some(exchange) = self.pending.take_if(|exchange| fits_exchange(exchange, &bytes)) {
            self.last_answered = Some((exchange, bytes));
            let refused = refusal_code(bytes);
            if let Some(error) = refused {
                let text = format!("{} was refused, error {error}", exchange.op);
                notices.push(anomaly(AnomalyKind::Refused, text));
            }
            let outcome =
                if refused.is_some() { ExchangeOutcome::Refused } else { ExchangeOutcome::Done };
            return notices.push(exchange.exchange_notice(Some(at), outcome));
        }
        if let Some(asked) = self.abandoned.take_if(|exchange| fits_exchange(exchange, &bytes)) {
            let ms = at.1.zip(asked.last.1).map_or(0, |(now, then)| now.since(then) / 1_000_000);
            let text = format!("{}: the answer came {ms} ms after its request", asked.op);
            return notices.push(anomaly(AnomalyKind::LateReply, text));
        }
        match &self.last_answered {
            // All matching devices reply, in any number.
            Some((exchange, _))
                if fits_exchange(exchange, &bytes)
                    && exchange.expectation == LssExpectation::Optional => {}
            Some((exchange, before)) if fits_exchange(exchange, &bytes) && *before == bytes => {
                let text = format!("{}: the same answer twice", exchange.op);
                notices.push(anomaly(AnomalyKind::DuplicateReply, text));
            }
            Some((exchange, _)) if fits_exchange(exchange, &bytes) => {
                let text = format!("{}: two devices are in configuration at once", exchange.op);
                notices.push(anomaly(AnomalyKind::DuplicateAddress, text));
            }
            _ if self.sees_requests => {
                let text = "an answer to layer setting without a request".to_owned();
                notices.push(anomaly(AnomalyKind::ForeignReply, text));
            }
            _ => {}
        }
    }

    /// Time at which silence counts as an answer, or as a missing one.
    pub fn due(&self) -> Option<Timestamp> {
        let open = self.pending.as_ref()?;
        Some(Timestamp(open.last.1?.0.saturating_add(open.timeout_ns())))
    }

    /// Time went on to `now`.
    pub fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        if self.due().is_some_and(|due| due < now)
            && let Some(open) = self.pending.take()
        {
            let ms = open.timeout_ns() / 1_000_000;
            self.give_up(open, &format!(" within {ms} ms"), notices);
        }
    }

    /// The capture ends: who was not given the time to answer is not accused.
    pub fn finish(&mut self, notices: &mut Vec<SessionNotice>) {
        notices.extend(
            self.pending.take().map(|open| open.exchange_notice(None, ExchangeOutcome::Unknown)),
        );
    }

    fn give_up(&mut self, exchange: LssExchange, why: &str, notices: &mut Vec<SessionNotice>) {
        if exchange.expectation == LssExpectation::Required {
            notices.push(exchange.exchange_notice(None, ExchangeOutcome::Unanswered));
            let text = format!("{} was not answered{why}", exchange.op);
            let time = exchange.last.1;
            let kind = AnomalyKind::Unanswered;
            notices.push(SessionNotice::Anomaly(AnomalyNotice { kind, axis: None, time, text }));
            self.abandoned = Some(exchange);
        } else {
            notices.push(exchange.exchange_notice(None, ExchangeOutcome::Done));
        }
    }
}

fn fits_exchange(exchange: &LssExchange, bytes: &[u8; 8]) -> bool {
    lss_answers(bytes, &exchange.request)
}

/// Returns whether a request goes on with what one of its kind began.
const fn is_continuation(request: LssRequest) -> bool {
    use polepair_core::proto::canopen::lss::{IdentifyBound, IdentityNumber};
    match request {
        LssRequest::SwitchSelective(number, _) => !matches!(number, IdentityNumber::Vendor),
        LssRequest::Identify(bound, _) => !matches!(bound, IdentifyBound::Vendor),
        _ => false,
    }
}

/// The error of an answer that refuses.
fn refusal_code(bytes: [u8; 8]) -> Option<u8> {
    match LssReply::parse(&bytes) {
        Ok(
            LssReply::SetNode(error @ 1.., _)
            | LssReply::SetBitTiming(error @ 1.., _)
            | LssReply::Store(error @ 1.., _),
        ) => Some(error),
        _ => None,
    }
}

fn anomaly(kind: AnomalyKind, text: String) -> SessionNotice {
    SessionNotice::Anomaly(AnomalyNotice { kind, axis: None, time: None, text })
}
