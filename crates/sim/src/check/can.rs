//! Invariants of a host on a CAN bus.
//!
//! The CRC excludes undetected damage, so a host that assigns a reply to the wrong request breaks I1. Two
//! exceptions are counted: the frame of an intruder, which looks like a drive's frame; and the second copy
//! of a reply after a disturbed last bit, if the protocol's replies have no number and do not repeat the
//! request. A copy that arrives sooner than request and reply can pass the bus is no exception, because a
//! host knows the bit rate.

#[cfg(test)]
mod tests;

use polepair_core::medium::bits::bit_time_ns;
use std::collections::BTreeMap;

use polepair_core::station::Counters;
use polepair_core::time::Instant;

use super::Violation;
use crate::can_bus::bits::INTERFRAME_BITS;
use crate::can_bus::{CanFrameLabel, CanPlugStatus};
use crate::world::{NodeId, WireId, World};

/// Frames that are kept as unanswered.
const OPEN_MAX: usize = 64;
/// Answers that are kept as still to come, because something else was taken for them.
const OUTSTANDING_MAX: usize = 16;
/// Longest time of such a reply, ms.
const OUTSTANDING_MS: u32 = 1_000;

/// Age above which a request counts as given up: no host waits less, ms. A newer one is still to be answered; so is a
/// stop that overtook it, or with which a verb begins.
const GIVEN_UP_MS: u32 = 10;

/// Watches one host on its bus.
#[derive(Debug)]
pub struct CanChecker {
    host: NodeId,
    wire: WireId,
    bit_rate: u32,
    counters: Counters,
    status: CanPlugStatus,
    open: Vec<OpenRequest>,
    /// Requests that were passed over, since a newer one was answered. The host may still wait for them.
    passed_over: Vec<OpenRequest>,
    /// The identifier by which a drive, named by its place on the bus, was last asked.
    request_ids: BTreeMap<usize, (u32, bool)>,
    outstanding: Vec<OutstandingReply>,
    pub(crate) last_match: ReplyMatch,
    /// Place of the last sender on the bus.
    pub(crate) last_sender: usize,
    /// Copies that were taken for answers, and intruders' frames that were.
    pub(crate) copies_taken: u64,
    pub(crate) intruder_taken: u64,
}

/// Kind of the last matched reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum ReplyMatch {
    #[default]
    Sound,
    /// A second copy, or the answer behind one.
    Copy,
    Intruder,
    /// The world does not know what it answers.
    Unknown,
}

#[derive(Clone, Copy, Debug)]
struct OpenRequest {
    label: CanFrameLabel,
    sent_at: Instant,
}

/// An answer that is still to come, because something else was taken for it.
#[derive(Clone, Copy, Debug)]
struct OutstandingReply {
    /// Number of the request that it answers.
    tag: u32,
    until: Instant,
    /// An intruder's frame was, or may have been.
    from_intruder: bool,
    /// More was open: it may have been taken for the answer to something else.
    ambiguous: bool,
}

impl CanChecker {
    /// A watch over `host` on `wire`, where frames take their bits at that rate.
    #[must_use]
    pub fn new(host: NodeId, wire: WireId, bit_rate: u32) -> Self {
        Self {
            host,
            wire,
            bit_rate,
            counters: Counters::default(),
            status: CanPlugStatus::default(),
            open: Vec::with_capacity(OPEN_MAX),
            passed_over: Vec::new(),
            request_ids: BTreeMap::new(),
            outstanding: Vec::new(),
            last_match: ReplyMatch::Sound,
            last_sender: 0,
            copies_taken: 0,
            intruder_taken: 0,
        }
    }

    /// To be called after every event that touched the host. `gave_up` are the drives of whose
    /// tickets one ended without an answer, with the time since when a verb of theirs is open: no
    /// reply to what was sent before that may be taken any more.
    pub fn check_event(
        &mut self,
        world: &mut World,
        gave_up: &[(NodeId, Option<Instant>)],
    ) -> Option<Violation> {
        let counters = world.inspect(self.host, |n, _| n.axes().map(|a| a.counters()))?;
        let before = std::mem::replace(&mut self.counters, counters);
        let known = world.can_status(self.wire, self.host)?;
        let was = std::mem::replace(&mut self.status, known);
        let now = world.now();
        let received = known.received_count > was.received_count;
        let answers = known.last_received.answers.filter(|_| received).map(|(tag, _)| tag);
        let behind = answers.and_then(|tag| self.find_outstanding(now, tag));
        let found = if counters.answered > before.answered && received {
            self.judge_match(now, known.last_received, behind)
        } else {
            None
        };
        for (drive, verb) in gave_up {
            let index = world.can_status(self.wire, *drive).map(|drive| drive.plug);
            let id = index.and_then(|plug| self.request_ids.get(&plug)).copied();
            self.open.retain(|open| Some(open.label.id) != id || is_newer(open, now, *verb));
        }
        self.record_sent(&was, &known);
        found
    }

    fn record_sent(&mut self, was: &CanPlugStatus, known: &CanPlugStatus) {
        if known.last_sent.tag != was.last_sent.tag {
            let old = (self.open.len() + 1).saturating_sub(OPEN_MAX);
            self.open.drain(..old);
            self.open.push(OpenRequest { label: known.last_sent, sent_at: known.sent_at });
        }
    }

    /// Checks a reply that was taken for an answer.
    fn judge_match(
        &mut self,
        now: Instant,
        reply: CanFrameLabel,
        behind: Option<OutstandingReply>,
    ) -> Option<Violation> {
        self.last_sender = reply.sender;
        if reply.from_intruder {
            return self.excuse_intruder(now);
        }
        if reply.cause_unknown {
            self.last_match = ReplyMatch::Unknown;
            // It may answer what is older, and then the answer itself is still to come.
            if let Some(open) = self.last_request_to(&reply) {
                self.open.retain(|other| other.label.tag != open.label.tag);
                self.add_outstanding(now, open, false);
            }
            return None;
        }
        self.last_match = ReplyMatch::Sound;
        let (tag, question) = reply.answers?;
        if behind.is_some_and(|outstanding| outstanding.from_intruder)
            && let Some(open) = self.last_request_to(&reply).filter(|open| open.label.tag != tag)
        {
            self.excuse_copy(now, open);
            return None;
        }
        let exact = self.open.iter().position(|open| open.label.tag == tag);
        let same = || self.open.iter().rposition(|open| open.label.content_hash == question);
        let Some(at) = exact.or_else(same) else {
            return self.judge_mismatch(now, reply, tag, question, behind);
        };
        let open = self.open[at];
        self.request_ids.insert(reply.sender, open.label.id);
        if (reply.is_copy || behind.is_some()) && open.label.tag != tag {
            // It has the requested value; but it was sent before the request, and before the replies to older ones.
            self.excuse_copy(now, open);
            return None;
        }
        if exact.is_none() {
            // An answer to the same that was asked before: what else is open is still to be answered.
            self.open.remove(at);
            return None;
        }
        self.pass_over_older(now, at);
        None
    }

    /// The request at `at` was answered: what is older and went to the same drive is passed over.
    fn pass_over_older(&mut self, now: Instant, at: usize) {
        let open = self.open[at];
        self.passed_over.retain(|old| now < old.sent_at.plus_ms(OUTSTANDING_MS));
        let mut index = 0;
        self.open.retain(|other| {
            index += 1;
            if index > at + 1 || other.label.id != open.label.id {
                return true;
            }
            if index <= at {
                self.passed_over.push(*other);
            }
            false
        });
    }

    /// The reply answers nothing that is open.
    fn judge_mismatch(
        &mut self,
        now: Instant,
        reply: CanFrameLabel,
        tag: u32,
        question: u64,
        behind: Option<OutstandingReply>,
    ) -> Option<Violation> {
        let open = self.last_request_to(&reply);
        if let Some(open) = open.filter(|a| {
            (reply.is_copy || behind.is_some()) && now >= self.soonest_reply(a, reply.bits_min)
        }) {
            self.excuse_copy(now, open);
            return None;
        }
        if behind.is_some_and(|outstanding| outstanding.ambiguous) && !reply.is_copy {
            // The copy before was not taken for the answer to this, but to something older.
            return None;
        }
        let same = |old: &OpenRequest| old.label.content_hash == question && old.label.tag != tag;
        if let Some(older) = self.passed_over.iter().position(same).filter(|_| reply.is_copy) {
            // The first was taken for the answer to the same that was asked before, which was passed
            // over; so this is taken for the answer to what it answers.
            let open = self.passed_over.remove(older);
            self.excuse_copy(now, open);
            return None;
        }
        let copy = if reply.is_copy { "a copy of " } else { "" };
        let requested = open.map_or(0, |open| open.label.tag);
        let what = format!("request {requested} got {copy}the reply to request {tag}");
        Some(Violation { invariant: "I1", at: now, what })
    }

    fn soonest_reply(&self, open: &OpenRequest, reply_bits_min: u32) -> Instant {
        let bits = u64::from(open.label.bits_min + reply_bits_min - INTERFRAME_BITS);
        let ns = bit_time_ns(bits, self.bit_rate);
        open.sent_at.plus_ns(ns - ns / 20)
    }

    /// The last request to the sender of a reply. A drive that was plugged in with the address of another one, and has
    /// received nothing before, counts as the receiver of the last request of all.
    fn last_request_to(&self, reply: &CanFrameLabel) -> Option<OpenRequest> {
        let Some(id) = self.request_ids.get(&reply.sender) else {
            return self.open.last().copied();
        };
        self.open.iter().rfind(|open| open.label.id == *id).copied()
    }

    /// Something else was taken for the answer to that: the answer itself is still to come.
    fn excuse_copy(&mut self, now: Instant, open: OpenRequest) {
        self.last_match = ReplyMatch::Copy;
        self.copies_taken += 1;
        self.open.retain(|other| other.label.tag != open.label.tag);
        self.add_outstanding(now, open, false);
    }

    fn excuse_intruder(&mut self, now: Instant) -> Option<Violation> {
        self.last_match = ReplyMatch::Intruder;
        self.intruder_taken += 1;
        self.defer_open(now);
        None
    }

    /// Whatever is open may have been answered by an intruder.
    fn defer_open(&mut self, now: Instant) {
        for at in self.open.len().saturating_sub(OUTSTANDING_MAX)..self.open.len() {
            self.add_outstanding(now, self.open[at], true);
        }
    }

    fn add_outstanding(&mut self, now: Instant, open: OpenRequest, strange: bool) {
        let CanFrameLabel { tag, id, .. } = open.label;
        let several = self.open.iter().any(|other| other.label.id == id && other.label.tag != tag);
        self.outstanding.push(OutstandingReply {
            tag,
            until: now.plus_ms(OUTSTANDING_MS),
            from_intruder: strange,
            ambiguous: several,
        });
        let old = self.outstanding.len().saturating_sub(OUTSTANDING_MAX);
        self.outstanding.drain(..old);
    }

    /// The outstanding reply, if a reply to that request came, and another frame had been taken for it. Several may
    /// come: each copy of the request brings one, and the host may take any of them for the reply to its next request.
    fn find_outstanding(&mut self, now: Instant, tag: u32) -> Option<OutstandingReply> {
        self.outstanding.retain(|outstanding| now < outstanding.until);
        self.outstanding.iter().find(|outstanding| outstanding.tag == tag).copied()
    }
}

fn is_newer(open: &OpenRequest, now: Instant, verb: Option<Instant>) -> bool {
    let of_verb = verb.is_some_and(|verb| open.sent_at >= verb);
    of_verb || now < open.sent_at.plus_ms(GIVEN_UP_MS)
}
