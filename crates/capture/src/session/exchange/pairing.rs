//! Open requests, and the frames that complete them.

mod acknowledgement;
mod candidate;
mod expiry;

use core::cell::Cell;
use core::fmt::Write as _;
use std::collections::VecDeque;

use polepair_core::explain::{
    ConversationContext, Dissector, RawFrame, ReplyCount, ReplyExpectation,
};

use super::{AXES_MAX, anomaly};
use crate::explanation::Explanation;
use crate::session::{
    AnomalyKind, AnomalyNotice, ExchangeNotice, ExchangeOutcome, InternedName, ObservedFrame,
    Quality, SessionNotice, intern,
};
use crate::timestamp::Timestamp;
use candidate::AnswerSearch;

/// Requests of a link that are remembered, settled or not.
const REQUESTS_MAX: usize = 64;
/// Operations whose names are at hand.
const OPERATIONS_MAX: usize = 64;
/// Shorter times to answer than this are not insisted on, ns: adapters and operating systems are
/// slower than drives.
const LIMIT_MIN: u64 = 100_000_000;
/// Time for a reply without a profile's, ns.
const LIMIT_UNKNOWN: u64 = 1_000_000_000;
/// Factor of the limit after which an open request will not be answered …
const PATIENCE_FACTOR: u64 = 3;
/// … nor so long after it, ns; hosts that ask again do it within that time.
const PATIENCE_MIN: u64 = 3_500_000_000;
/// Repetitions that belong to one request; more are questions to an absent drive.
const RETRIES_MAX: u16 = 3;
/// Requests before the first reply without a request: an earlier one may have been sent before the capture began.
const FIRST_REQUESTS: u32 = 2;

/// Requests and answers of one link.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    /// The newest is the last.
    // Boxed, because they change places often.
    requests: VecDeque<Box<TrackedRequest>>,
    /// Number of changes of the requests.
    revision: u64,
    last_search: Cell<Option<AnswerSearch>>,
    /// A request that is over, whose buffers the next one gets.
    spare: Option<Box<TrackedRequest>>,
    operations: Vec<InternedName>,
    /// Last request of each axis that defines the format of its replies.
    format_requests: Vec<(u32, FrameBytes)>,
    /// Latest time at which the next request is given up.
    due: Option<Timestamp>,
    /// Axes that left a request unanswered since this was asked.
    given_up_axes: Vec<u32>,
    /// The frame that was answered last, and by which.
    last_pair: (u64, u64),
    request_count: u32,
    start_time: Option<Timestamp>,
    now: Option<Timestamp>,
    acks: u64,
    answers: u64,
    /// The longest that an answer which came in time took, ns, and the shortest.
    slowest: u64,
    fastest: Option<u64>,
    /// Mean of its recent response times, with decay.
    recent_mean: Option<u64>,
}

/// A frame that is kept.
#[derive(Debug, Default)]
struct FrameBytes {
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
}

impl FrameBytes {
    fn raw(&self) -> RawFrame<'_> {
        RawFrame { bytes: &self.bytes, id: self.id, extended: self.extended }
    }

    fn store(&mut self, raw: &RawFrame<'_>) {
        self.bytes.clear();
        self.bytes.extend_from_slice(raw.bytes);
        (self.id, self.extended) = (raw.id, raw.extended);
    }
}

#[derive(Debug)]
struct TrackedRequest {
    exchange: ExchangeNotice,
    frame: FrameBytes,
    awaits: ReplyExpectation,
    acks: u8,
    answers: u8,
    /// Time of the last transmission.
    last_sent: Option<Timestamp>,
    limit_ns: u64,
    state: RequestState,
    /// Something that is no frame came where its answer was due.
    spoiled: bool,
    /// A later request to the axis was answered before it.
    overtaken: bool,
    /// The answer that settled it may be the late one to a request before it.
    doubtful: bool,
    /// The bytes that settled it.
    answer: Vec<u8>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RequestState {
    /// An expected reply may still arrive.
    Open,
    /// All expected replies have arrived.
    Settled,
    /// The missing reply was reported.
    GivenUp,
}

/// Match of a reply.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnswerMatch {
    /// True if it was requested.
    pub requested: bool,
    /// Quality of its values.
    pub quality: Quality,
}

impl TrackedRequest {
    fn requires_reply(&self) -> bool {
        is_exact(self.awaits.answers) || is_exact(self.awaits.acks)
    }

    fn is_late(&self, now: Option<Timestamp>) -> bool {
        matches!((now, self.last_sent), (Some(now), Some(last)) if now.since(last) > self.limit_ns)
    }

    fn patience_ns(&self) -> u64 {
        PATIENCE_MIN.max(PATIENCE_FACTOR * self.limit_ns)
    }

    fn awaits_answer(&self) -> bool {
        self.state == RequestState::Open && self.awaits.answers != ReplyCount::Zero
    }

    /// `GAP to axis 1`.
    fn description(&self) -> String {
        let mut text = String::from(self.exchange.op);
        // Writing into a String cannot fail.
        let _ = match self.exchange.axis {
            Some(axis) => write!(text, " to axis {axis}"),
            None => write!(text, " to everybody"),
        };
        text
    }
}

fn is_exact(reply_count: ReplyCount) -> bool {
    matches!(reply_count, ReplyCount::Exactly(_))
}

impl Pairing {
    /// The last request, while nothing answered it.
    pub fn open_request(&self) -> Option<RawFrame<'_>> {
        let last = self.requests.back()?;
        (last.state == RequestState::Open).then(|| last.frame.raw())
    }

    /// The request that an answer belongs to, if it comes now.
    pub fn awaited_request(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<RawFrame<'_>> {
        Some(self.requests[self.candidate(dissector, answer, now)?].frame.raw())
    }

    /// Request that defines the format of an axis' replies.
    pub fn format_request(&self, axis: Option<u32>) -> Option<RawFrame<'_>> {
        let axis = axis?;
        self.format_requests.iter().find(|(of, _)| *of == axis).map(|(_, frame)| frame.raw())
    }

    /// The frame that frame `number` answers.
    pub fn request_of(&self, number: u64) -> Option<u64> {
        (self.last_pair.1 == number && self.last_pair.0 > 0).then_some(self.last_pair.0)
    }

    /// Returns whether axes left requests unanswered.
    pub fn has_given_up(&self) -> bool {
        !self.given_up_axes.is_empty()
    }

    /// Axes that left requests unanswered since this was called last.
    pub fn take_given_up(&mut self) -> impl Iterator<Item = u32> + '_ {
        self.given_up_axes.drain(..)
    }

    /// Takes a request.
    pub fn handle_request(
        &mut self,
        awaits: ReplyExpectation,
        observed: &ObservedFrame<'_>,
        explanation: &Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.revision += 1;
        self.note_start(observed.time);
        self.request_count = self.request_count.saturating_add(1);
        // Before anything else: a repetition belongs to the request that it repeats.
        if self.match_retry(observed, explanation.axis, notices) {
            return;
        }
        self.expire_overtaken(awaits, observed, explanation.axis, notices);
        // Buffers of settled requests are used again: a busy serial line has thousands of exchanges a second.
        let mut request = self.recycle_request(notices);
        let op = self.intern_operation(&explanation.kind);
        request.exchange = ExchangeNotice {
            axis: explanation.axis,
            op,
            requested: (observed.number, observed.time),
            answered: None,
            outcome: ExchangeOutcome::Unanswered,
            retries: 0,
        };
        request.frame.store(&observed.raw);
        request.awaits = awaits;
        (request.acks, request.answers) = (0, 0);
        (request.spoiled, request.overtaken, request.doubtful) = (false, false, false);
        request.last_sent = observed.time;
        // A profile's time is that of its serial line.
        let profile = observed.profile.filter(|_| !observed.dissector.has_transactions());
        request.limit_ns = profile.map_or(LIMIT_UNKNOWN, |profile| {
            LIMIT_MIN.max(u64::from(profile.reply_timeout_ms) * 1_000_000)
        });
        request.state = if awaits == ReplyExpectation::NONE {
            RequestState::Settled
        } else {
            RequestState::Open
        };
        self.schedule(&request);
        debug_assert!(self.requests.len() < REQUESTS_MAX);
        self.requests.push_back(request);
    }

    /// Matches a repetition of the same bytes before their reply.
    fn match_retry(
        &mut self,
        observed: &ObservedFrame<'_>,
        axis: Option<u32>,
        notices: &mut Vec<SessionNotice>,
    ) -> bool {
        let same = |request: &TrackedRequest| {
            request.state == RequestState::Open
                && request.requires_reply()
                && request.frame.raw() == observed.raw
        };
        let Some(at) = self.requests.iter().rposition(|it| same(it)) else { return false };
        // To a host whose answer was spoiled it is a new request, as after one whose check failed, and
        // to one that asked the axis something else meanwhile, and was answered.
        let went_on = |later: &TrackedRequest| {
            later.exchange.axis == axis && later.state == RequestState::Settled
        };
        let went_on = self.requests.iter().skip(at + 1).any(|it| went_on(it));
        let request = &self.requests[at];
        if request.exchange.retries == RETRIES_MAX || request.spoiled || went_on {
            self.give_up_request(at, observed.time, notices);
            return false;
        }
        // Now the newest.
        let Some(mut request) = self.requests.remove(at) else { return false };
        request.exchange.retries = request.exchange.retries.saturating_add(1);
        request.last_sent = observed.time;
        let text = format!(
            "{} sent again before an answer, for the {} time",
            request.description(),
            ordinal(request.exchange.retries)
        );
        self.requests.push_back(request);
        notices.push(anomaly(AnomalyKind::Retry, axis, text));
        true
    }

    /// Ends the wait for the previous request on lines with one exchange at a time. Settled exchanges of the axis are
    /// dropped.
    fn expire_overtaken(
        &mut self,
        awaits: ReplyExpectation,
        observed: &ObservedFrame<'_>,
        axis: Option<u32>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let turns = observed.raw.id.is_none() && !observed.dissector.has_transactions();
        let acked = awaits.acks != ReplyCount::Zero;
        for at in (0..self.requests.len()).rev() {
            let request = &self.requests[at];
            let same_axis = request.exchange.axis == axis;
            // Only where the capture has acknowledgements at all: a tap on one wire sees none.
            let unacked = turns && acked && request.acks == 0 && self.acks > 0;
            match request.state {
                RequestState::Open if unacked && request.awaits.acks == ReplyCount::Exactly(1) => {
                    self.report_unacknowledged(at, observed.time, notices);
                }
                RequestState::Open if turns && !acked && same_axis => {
                    self.give_up_request(at, observed.time, notices);
                }
                RequestState::Settled
                    if same_axis && (!request.doubtful || request.is_late(observed.time)) =>
                {
                    self.spare = self.requests.remove(at);
                }
                _ => {}
            }
        }
    }

    /// Handles a reply, or a possible unsolicited report.
    pub fn handle_answer(
        &mut self,
        reports: bool,
        observed: &ObservedFrame<'_>,
        explanation: &Explanation,
        notices: &mut Vec<SessionNotice>,
    ) -> AnswerMatch {
        self.note_start(observed.time);
        let fits = |request: &TrackedRequest| {
            observed.dissector.is_answer_to(&observed.raw, &request.frame.raw())
        };
        let open = self.candidate(observed.dissector, &observed.raw, observed.time);
        self.revision += 1;
        if let Some(at) = open.filter(|at| self.requests[*at].awaits_answer()) {
            self.answers += 1;
            let is_doubtful = self.is_doubtful(at, observed);
            // Before it is settled, because afterwards it would count as answered itself.
            self.expire_earlier(at, observed, notices);
            let quality = self.settle_request(at, observed, notices);
            self.requests[at].doubtful = is_doubtful;
            if is_doubtful {
                return AnswerMatch { requested: true, quality: Quality::Stale };
            }
            self.note_delay(at);
            return AnswerMatch { requested: true, quality };
        }
        if let Some(at) = open {
            let quality = self.handle_repeated_answer(at, observed, notices);
            return AnswerMatch { requested: true, quality };
        }
        let again =
            |request: &TrackedRequest| fits(request) && self.may_come_again(request, observed);
        // A request that was given up a moment ago still expects a reply; an answered one does not.
        let outstanding = self.requests.iter().rposition(|request| {
            let waited =
                request.last_sent.zip(observed.time).map_or(0, |(last, now)| now.since(last));
            request.state == RequestState::GivenUp
                && waited <= request.patience_ns()
                && fits(request)
        });
        let known = outstanding.or_else(|| self.requests.iter().rposition(|it| again(it)));
        let mut quality = Quality::Good;
        match known {
            Some(at) if self.requests[at].state == RequestState::GivenUp || !reports => {
                quality = self.handle_repeated_answer(at, observed, notices);
            }
            None if !reports && self.is_past_start(observed.time) => {
                let axis =
                    explanation.axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
                let text = format!("an answer{axis} ({}) without a request", explanation.kind);
                notices.push(anomaly(AnomalyKind::ForeignReply, explanation.axis, text));
            }
            _ => {}
        }
        AnswerMatch { requested: known.is_some(), quality }
    }

    /// An axis answers in order: earlier requests that the same answer could settle are lost.
    fn expire_earlier(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        for earlier in 0..at {
            let axis = self.requests[at].exchange.axis;
            let request = &mut self.requests[earlier];
            let fits = || observed.dissector.is_answer_to(&observed.raw, &request.frame.raw());
            // Nothing of it changes any more.
            let is_settled = request.state == RequestState::Settled;
            let is_over =
                (request.overtaken || is_settled) && !request.doubtful && !request.awaits_answer();
            if request.exchange.axis != axis || is_over || !fits() {
                continue;
            }
            (request.overtaken, request.doubtful) = (true, false);
            if request.awaits_answer() {
                self.give_up_request(earlier, observed.time, notices);
            }
        }
    }

    /// Returns whether a reply can belong to a settled request: soon after it and, on lines with one exchange at a
    /// time, before any other request.
    fn may_come_again(&self, request: &TrackedRequest, observed: &ObservedFrame<'_>) -> bool {
        if request.state == RequestState::GivenUp {
            return true;
        }
        let answered = request.exchange.answered.map_or(request.last_sent, |(_, time)| time);
        let turns = observed.raw.id.is_none()
            && request.awaits.acks == ReplyCount::Zero
            && !observed.dissector.has_transactions();
        let newest =
            self.requests.back().is_some_and(|last| core::ptr::eq(&raw const **last, request));
        observed.time.zip(answered).is_none_or(|(now, then)| now.since(then) <= request.limit_ns)
            && (newest || !turns)
    }

    /// An answer to what waits for it.
    fn settle_request(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) -> Quality {
        self.last_pair = (self.requests[at].exchange.requested.0, observed.number);
        let request = &mut self.requests[at];
        if request.awaits.acks == ReplyCount::Exactly(1) && request.acks == 0 && self.acks > 0 {
            let text = format!("{}: answered, but not acknowledged", request.description());
            notices.push(anomaly(AnomalyKind::MissingAck, request.exchange.axis, text));
        }
        request.acks = request.acks.max(1);
        request.answers = request.answers.saturating_add(1);
        request.exchange.answered = Some((observed.number, observed.time));
        request.answer.clear();
        request.answer.extend_from_slice(observed.raw.bytes);
        // A read of several registers has one reply for each of them.
        if matches!(request.awaits.answers, ReplyCount::Exactly(count) if request.answers < count) {
            return Quality::Good;
        }
        request.state = RequestState::Settled;
        let refused = observed.dissector.refusal_reason(&observed.raw, &request.frame.raw());
        let late = request.is_late(observed.time);
        request.exchange.outcome = match refused {
            Some(_) => ExchangeOutcome::Refused,
            None if late => ExchangeOutcome::Late,
            None => ExchangeOutcome::Done,
        };
        if let Some(why) = refused {
            let text = format!("{}: {why}", request.description());
            notices.push(anomaly(AnomalyKind::Refused, request.exchange.axis, text));
        }
        if late {
            let limit = request.limit_ns / 1_000_000;
            let took = match request.exchange.latency() {
                Some(ns) => format!("after {} ms", ns / 1_000_000),
                None => "late".to_owned(),
            };
            let text = format!("{}: answered {took}, {limit} allowed", request.description());
            notices.push(anomaly(AnomalyKind::LateReply, request.exchange.axis, text));
        }
        notices.push(SessionNotice::Exchange(request.exchange));
        if refused.is_none() && observed.dissector.sets_reply_format(&request.frame.raw()) {
            self.learn_format(at);
        }
        // A late value is kept, but a diagram can leave it out: it may belong to an earlier request.
        if late { Quality::Stale } else { Quality::Good }
    }

    /// Learns from the answer to a request how long answers take.
    fn note_delay(&mut self, at: usize) {
        let request = &self.requests[at];
        // A capture without times has no usual delay to compare with.
        let took = request.exchange.latency().filter(|took| *took <= request.limit_ns);
        let Some(took) = took.filter(|_| request.state == RequestState::Settled) else { return };
        self.slowest = self.slowest.max(took);
        self.fastest = Some(self.fastest.map_or(took, |fastest| fastest.min(took)));
        self.recent_mean =
            Some(self.recent_mean.map_or(took, |lately| lately - lately / 8 + took / 8));
    }

    /// Another answer to a request that was settled or given up.
    fn handle_repeated_answer(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) -> Quality {
        let request = &self.requests[at];
        let axis = request.exchange.axis;
        let talk = ConversationContext {
            format_request: self.format_request(axis),
            profile: observed.profile,
            ..ConversationContext::default()
        };
        if observed.dissector.shows_restart(&observed.raw, &request.frame.raw(), &talk) {
            let text = format!(
                "{}: answered as from power-up, so the drive has started again",
                request.description()
            );
            notices.push(anomaly(AnomalyKind::Restart, axis, text));
            // A drive that has started again has forgotten how it was to reply.
            self.format_requests.retain(|(of, _)| Some(*of) != axis);
            return Quality::Good;
        }
        let request = &mut self.requests[at];
        let whose = request.description();
        if request.state == RequestState::GivenUp {
            request.state = RequestState::Settled;
            let text = format!("{whose}: answered after it had been given up");
            notices.push(anomaly(AnomalyKind::LateReply, axis, text));
            return Quality::Stale;
        }
        if core::mem::take(&mut request.doubtful) && request.answer != observed.raw.bytes {
            let text = format!(
                "{whose}: answered again, so the answer before may be that to the request before it"
            );
            notices.push(anomaly(AnomalyKind::LateReply, axis, text));
            return Quality::Good;
        }
        let expected = match request.awaits.answers {
            ReplyCount::Unknown => return Quality::Good,
            ReplyCount::Exactly(count) => u16::from(count),
            ReplyCount::Zero => 0,
        };
        let before = u16::from(request.answers);
        request.answers = request.answers.saturating_add(1);
        let (kind, text) = if expected == 0 {
            (AnomalyKind::ForeignReply, format!("{whose}: answered, though it gets no answer"))
        } else if before < expected.saturating_mul(1 + request.exchange.retries) {
            (AnomalyKind::LateReply, format!("{whose}: answered once more, to its repetition"))
        } else if request.answer == observed.raw.bytes {
            (AnomalyKind::DuplicateReply, format!("{whose}: the same answer twice"))
        } else {
            let text = format!("{whose}: two different answers, so two devices have one address");
            (AnomalyKind::DuplicateAddress, text)
        };
        notices.push(anomaly(kind, axis, text));
        if kind == AnomalyKind::DuplicateReply { Quality::Good } else { Quality::Stale }
    }

    /// Something whose check fails came where an answer was due.
    pub fn handle_broken_answer(
        &mut self,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.revision += 1;
        let Some(at) = self.requests.iter().rposition(|request| request.awaits_answer()) else {
            return;
        };
        let last = at + 1 == self.requests.len();
        // Behind a relay several may wait: the owner cannot be determined.
        let alone = self.requests.iter().filter(|request| request.awaits_answer()).count() == 1;
        let request = &mut self.requests[at];
        if !last || (request.awaits.acks != ReplyCount::Zero && !(alone && request.acks > 0)) {
            return;
        }
        request.state = RequestState::Settled;
        request.exchange.answered = Some((observed.number, observed.time));
        request.exchange.outcome = ExchangeOutcome::BadCheck;
        notices.push(SessionNotice::Exchange(request.exchange));
        // A good answer may yet come to a repetition of it, as to a new request.
        self.requests.remove(at);
    }

    /// Room for another request; the oldest goes.
    fn recycle_request(&mut self, notices: &mut Vec<SessionNotice>) -> Box<TrackedRequest> {
        if self.requests.len() == REQUESTS_MAX {
            let settled =
                self.requests.iter().position(|request| request.state != RequestState::Open);
            // With none settled the oldest is given up: memory stays bounded in a capture of requests alone.
            let at = settled.unwrap_or(0);
            if settled.is_none() {
                let now = self.requests[at].last_sent;
                self.give_up_request(at, now, notices);
            }
            self.spare = self.requests.remove(at);
        }
        if let Some(request) = self.spare.take() {
            return request;
        }
        Box::new(TrackedRequest {
            exchange: ExchangeNotice {
                axis: None,
                op: "",
                requested: (0, None),
                answered: None,
                outcome: ExchangeOutcome::Unanswered,
                retries: 0,
            },
            frame: FrameBytes::default(),
            awaits: ReplyExpectation::NONE,
            acks: 0,
            answers: 0,
            last_sent: None,
            limit_ns: 0,
            state: RequestState::Settled,
            spoiled: false,
            overtaken: false,
            doubtful: false,
            answer: Vec::new(),
        })
    }

    fn schedule(&mut self, request: &TrackedRequest) {
        self.due = earliest(self.due, deadline(request));
    }

    fn note_start(&mut self, now: Option<Timestamp>) {
        self.start_time = self.start_time.or(now);
    }

    /// Returns whether the capture's begin is so long ago that no earlier request can be answered.
    fn is_past_start(&self, now: Option<Timestamp>) -> bool {
        let later = now.zip(self.start_time).is_none_or(|(now, began)| is_past_limit(now, began));
        later && self.request_count >= FIRST_REQUESTS
    }

    fn intern_operation(&mut self, kind: &str) -> InternedName {
        if let Some(known) = self.operations.iter().find(|op| **op == kind) {
            return known;
        }
        let op = intern(kind);
        // A capture with more names than a protocol has is hostile; those are looked up each time.
        if self.operations.len() < OPERATIONS_MAX {
            self.operations.push(op);
        }
        op
    }
}

fn is_past_limit(now: Timestamp, began: Timestamp) -> bool {
    now.since(began) > LIMIT_MIN
}

fn deadline(request: &TrackedRequest) -> Option<Timestamp> {
    let open = request.state == RequestState::Open;
    let last = request.last_sent.filter(|_| open)?;
    Some(Timestamp(last.0.saturating_add(request.patience_ns() + 1)))
}

fn earliest(one: Option<Timestamp>, other: Option<Timestamp>) -> Option<Timestamp> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}

fn ordinal(number: u16) -> String {
    match number {
        1 => "first".to_owned(),
        2 => "second".to_owned(),
        3 => "third".to_owned(),
        number => format!("{number}th"),
    }
}
