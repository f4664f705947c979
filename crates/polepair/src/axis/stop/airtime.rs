//! The share of a wire that stops to silent drives may take.
//!
//! Why: STOP-9.

use std::time::Duration;

use crate::axis::LocalAxis;
use polepair_core::time::Instant;

/// A silence that ends with a reply is at least this long.
pub(super) const SILENCE_MIN: Duration = Duration::from_millis(300);
/// After a stop without a reply, a shared wire is left to others for this multiple of its time (5 % remain).
// An attempt and nineteen times as long for the others: 5 % of the wire (STOP-9).
const AIRTIME_DIVISOR: u32 = 19;
/// The time of one stop without a reply counts as this at most: a drive has that long to reply.
// A reply timeout is no use of the wire.
const ATTEMPT_TIME_MAX: Duration = Duration::from_millis(100);

/// State shared by all pending stops of a wire.
#[derive(Debug, Default)]
pub struct WireAirtime {
    /// No stop to a silent drive is sent before this time.
    free_at: Instant,
    /// Replies so far, and when the last of them was noticed.
    replies: (u64, Instant),
    /// The wire was silent since then, until just now.
    silent_since: Option<Instant>,
}

impl WireAirtime {
    /// A stop that took this long had no reply: the wire belongs to others for a while.
    pub(super) fn reserve(&mut self, now: Instant, took: Duration) {
        self.free_at = now + took.min(ATTEMPT_TIME_MAX) * AIRTIME_DIVISOR;
    }

    pub(super) fn is_free(&self, now: Instant) -> bool {
        now >= self.free_at
    }

    /// Returns whether the wire replies again after a silence, and a stop had ended within it.
    pub(super) fn woke_since(&self, ended_at: Instant) -> bool {
        self.silent_since.is_some_and(|since| ended_at > since)
    }

    /// Checks whether the wire replies again after a silence. Call it before each round of polls.
    pub fn update(&mut self, axis: &LocalAxis) {
        let now = axis.connection.now();
        let replies = axis.connection.with_axes(|axes, _| axes.counters()).answered;
        let (before, last) = self.replies;
        self.silent_since = (replies != before && now.since(last) >= SILENCE_MIN).then_some(last);
        if replies != before {
            self.replies = (replies, now);
        }
    }
}
