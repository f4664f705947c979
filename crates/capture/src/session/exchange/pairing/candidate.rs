//! Assigns a reply if several requests expect a similar one.

use polepair_core::explain::{Dissector, RawFrame};

use super::{Pairing, RequestState, TrackedRequest};
use crate::session::ObservedFrame;
use crate::timestamp::Timestamp;

/// Bytes of an answer whose search is remembered.
const SEARCHED_MAX: usize = 16;

/// The last search for the request of an answer. An answer is explained by its request and then paired with it: both
/// times the search is the same, unless something of the requests changed in between.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct AnswerSearch {
    revision: u64,
    bytes: [u8; SEARCHED_MAX],
    len: usize,
    id: Option<u32>,
    now: Option<Timestamp>,
    found: Option<usize>,
}

/// Answers after which it is known how long they usually take …
const USUAL_MIN: u64 = 4;
/// … which is twice the longest so far, and this besides, ns: adapters pass frames on in bunches.
const USUAL_SLACK: u64 = 5_000_000;

impl Pairing {
    /// The request that an answer belongs to, if it comes now, among those that wait for one.
    pub(super) fn candidate(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<usize> {
        let (mut bytes, len, id) = ([0; SEARCHED_MAX], answer.bytes.len(), answer.id);
        let Some(head) = bytes.get_mut(..len).filter(|_| !answer.extended) else {
            return self.find_candidate(dissector, answer, now);
        };
        head.copy_from_slice(answer.bytes);
        let search = AnswerSearch { revision: self.revision, bytes, len, id, now, found: None };
        if let Some(last) = self.last_search.get()
            && last == (AnswerSearch { found: last.found, ..search })
        {
            return last.found;
        }
        let found = self.find_candidate(dissector, answer, now);
        self.last_search.set(Some(AnswerSearch { found, ..search }));
        found
    }

    /// Searches for the request of an answer.
    ///
    /// A host that waited longer than answers take before it asked again has given the requests before that one up, so
    /// the answer belongs to the newest. Of several that were sent without such a pause, the oldest is answered first.
    fn find_candidate(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<usize> {
        let fits = |at: &usize| dissector.is_answer_to(answer, &self.requests[*at].frame.raw());
        let open = || (0..self.requests.len()).filter(|at| self.requests[*at].awaits_answer());
        // Most lines have one request under way: nothing else is looked at.
        let (mut newest, mut repeated, mut open_count) = (None, None, 0);
        for (at, request) in self.requests.iter().enumerate().rev() {
            if !request.awaits_answer() {
                continue;
            }
            open_count += 1;
            let is_repeated = request.frame.bytes == answer.bytes;
            if (newest.is_none() || is_repeated) && fits(&at) {
                newest = newest.or(Some(at));
                repeated = if is_repeated { Some(at) } else { repeated };
            }
        }
        if repeated.is_some() {
            return repeated;
        }
        let newest = newest?;
        if self.is_too_soon(newest, now)
            && let Some(before) = self.find_unanswered(newest, dissector, answer, now)
        {
            return Some(before);
        }
        if open_count == 1 {
            return Some(newest);
        }
        let mut burst = newest;
        let mut best = (self.rank(newest, now), newest);
        for at in open().rev().filter(|at| *at < newest).filter(fits) {
            if !self.is_burst(at, burst, now) {
                break;
            }
            burst = at;
            let rank = self.rank(at, now);
            if rank <= best.0 {
                best = (rank, at);
            }
        }
        Some(best.1)
    }

    /// Returns whether the answer to request `at` could as well be the late one to a request before it.
    pub(super) fn is_doubtful(&self, at: usize, observed: &ObservedFrame<'_>) -> bool {
        let (dissector, raw) = (observed.dissector, &observed.raw);
        let repeats = self.requests[at].frame.bytes == raw.bytes;
        let before = self.find_unanswered(at, dissector, raw, observed.time);
        before.is_some_and(|before| {
            let request = &self.requests[before];
            // An answer in the usual time is likely to be its own.
            let is_likely = request.state == RequestState::Settled
                && request.exchange.latency().is_none_or(|took| took <= self.usual_max_ns());
            !repeats && !is_likely && !self.is_burst(before, at, observed.time)
        })
    }

    /// The last request to the axis before request `at` that the same answer could belong to.
    fn find_unanswered(
        &self,
        at: usize,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<usize> {
        (0..at).rev().find(|before| {
            let earlier = &self.requests[*before];
            earlier.exchange.axis == self.requests[at].exchange.axis
                && earlier.may_be_unanswered()
                && !earlier.is_late(now)
                && dissector.is_answer_to(answer, &earlier.frame.raw())
        })
    }

    /// Returns whether request `at` was sent a moment ago, so that the drive cannot have answered it.
    fn is_too_soon(&self, at: usize, now: Option<Timestamp>) -> bool {
        let fastest = self.fastest.filter(|_| self.answers >= USUAL_MIN);
        fastest.is_some_and(|fastest| waited_ns(&self.requests[at], now) < fastest / 2)
    }

    /// Returns whether the host sent the later request without waiting for an answer to the earlier.
    fn is_burst(&self, earlier: usize, later: usize, now: Option<Timestamp>) -> bool {
        let gap = waited_ns(&self.requests[earlier], self.requests[later].last_sent);
        // Until it is known how long answers take, this one has taken longer than the host waits.
        gap < self.recent_mean.unwrap_or_else(|| waited_ns(&self.requests[later], now))
    }

    /// Time within which answers usually come, ns.
    fn usual_max_ns(&self) -> u64 {
        self.slowest.saturating_mul(2).saturating_add(USUAL_SLACK)
    }

    /// Rank of a request of a burst: 0 if answers take that long, 1 if they are faster, 2 if it is late. Without that,
    /// one lost answer to a host that asks on would shift all that follow by one.
    fn rank(&self, at: usize, now: Option<Timestamp>) -> u8 {
        let request = &self.requests[at];
        if request.is_late(now) {
            2
        } else {
            u8::from(self.answers >= USUAL_MIN && waited_ns(request, now) > self.usual_max_ns())
        }
    }
}

impl TrackedRequest {
    /// Returns whether an answer to it may still be under way.
    fn may_be_unanswered(&self) -> bool {
        match self.state {
            RequestState::Open => self.awaits_answer(),
            RequestState::GivenUp => !self.overtaken,
            RequestState::Settled => self.doubtful,
        }
    }
}

/// Time since a request was sent, ns.
fn waited_ns(request: &TrackedRequest, now: Option<Timestamp>) -> u64 {
    request.last_sent.zip(now).map_or(0, |(last, now)| now.since(last))
}
