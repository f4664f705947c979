//! Assigns a reply if several open requests expect a similar one.

use super::{Pairing, TrackedRequest};
use crate::session::ObservedFrame;
use crate::timestamp::Timestamp;

/// Answers after which it is known how long they usually take …
const USUAL_MIN: u64 = 4;
/// … which is twice the longest so far, and this besides, ns: adapters pass frames on in bunches.
const USUAL_SLACK: u64 = 5_000_000;
/// Ratio of awaited to overtaken replies above which a host takes turns with an axis.
const WAITED_RATIO: u64 = 16;

impl Pairing {
    /// Returns whether an answer now would come as soon as answers of this link usually do. Without that, one lost
    /// answer to a host that asks on would shift all that follow by one.
    fn is_usual_delay(&self, request: &TrackedRequest, now: Option<Timestamp>) -> bool {
        let waited = request.last_sent.zip(now).map_or(0, |(last, now)| now.since(last));
        if self.waits_for_answers() {
            let min = self.fastest.unwrap_or(0) / 2;
            return (min..=self.slowest + self.slowest / 2).contains(&waited);
        }
        let max = self.slowest.saturating_mul(2).saturating_add(USUAL_SLACK);
        self.answers < USUAL_MIN || waited <= max
    }

    /// Returns whether the host waits for an answer before it asks an axis again: when it does not, it gave the answer
    /// up.
    fn waits_for_answers(&self) -> bool {
        self.answers >= WAITED_RATIO * self.overlapping.max(1)
    }

    /// Deviation of a reply's time from the recent ones, if the host takes turns.
    fn deviation(&self, request: &TrackedRequest, now: Option<Timestamp>) -> u64 {
        let waited = request.last_sent.zip(now).map(|(last, now)| now.since(last));
        let lately = self.recent_mean.filter(|_| self.waits_for_answers());
        waited.zip(lately).map_or(0, |(waited, lately)| waited.abs_diff(lately))
    }

    /// The request that an answer belongs to, among those that wait: one that it repeats, else one
    /// that may be answered so soon, else one that is not late, else any. Of several the oldest, or
    /// where the host takes turns that whose answer would take the time that answers take.
    pub(super) fn find_candidate(&self, observed: &ObservedFrame<'_>) -> Option<usize> {
        let fits = |request: &TrackedRequest| {
            request.awaits_answer()
                && observed.dissector.is_answer_to(&observed.raw, &request.frame.raw())
        };
        let mut best: Option<((u8, u64), usize)> = None;
        for (at, request) in self.requests.iter().enumerate().filter(|(_, r)| fits(r)) {
            let rank = if request.frame.bytes == observed.raw.bytes {
                0
            } else if request.is_late(observed.time) {
                3
            } else {
                1 + u8::from(!self.is_usual_delay(request, observed.time))
            };
            let strange = if rank == 1 { self.deviation(request, observed.time) } else { 0 };
            let rank = (rank, strange);
            if best.is_none_or(|(least, _)| rank < least) {
                best = Some((rank, at));
            }
        }
        best.map(|(_, at)| at)
    }
}
