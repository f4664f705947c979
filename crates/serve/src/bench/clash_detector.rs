//! Detects replies without a request: another master, or two drives with one address.
//!
//! Why: GW-4.

use std::collections::VecDeque;
use std::time::Duration;

use polepair_core::station::Counters;
use polepair_core::time::Instant;

/// A request counts as unanswered a moment after its answer came late: its link is in recovery until then.
const UNEXPLAINED_FOR: Duration = Duration::from_secs(3);
/// Interval between two looks at the counters.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Time for which a request without a reply explains a late one: a drive or a gateway in between that stalled sends its
/// stored replies.
const LATE_ALLOWED_FOR: Duration = Duration::from_secs(30);
/// Time for which a clash is shown that was not seen again.
const SHOWN_FOR: Duration = Duration::from_secs(10);

/// Detects other hosts and drives on a wire by counters.
#[derive(Default)]
pub(super) struct ClashDetector {
    next: Instant,
    last: Counters,
    /// Requests without an answer, as many as each look found: one answer to each may still come.
    late_allowed: VecDeque<(Instant, u64)>,
    /// Late answers that no request explains yet, and how many of them each look found.
    unexplained: VecDeque<(Instant, u64)>,
    /// Answers that no request explains.
    unsolicited: u64,
    seen: Option<Instant>,
}

impl ClashDetector {
    /// New display of a clash, if it changes; the inner `None` ends the display.
    pub fn check(
        &mut self,
        counters: impl FnOnce() -> Counters,
        now: Instant,
    ) -> Option<Option<String>> {
        if now < self.next {
            return None;
        }
        self.next = now + CHECK_INTERVAL;
        let more = self.count_unsolicited(counters(), now);
        if more > 0 {
            self.unsolicited += more;
            self.seen = Some(now);
            let unasked = self.unsolicited;
            let answers = if unasked == 1 { "answer" } else { "answers" };
            return Some(Some(format!(
                "{unasked} {answers} without a request: another master is on this wire, or two \
                 drives have one address"
            )));
        }
        self.seen.take_if(|seen| now.since(*seen) > SHOWN_FOR).map(|_| None)
    }

    /// Marks the present counts as explained.
    pub fn skip_counted(&mut self, counters: Counters, now: Instant) {
        self.count_unsolicited(counters, now);
    }

    /// Number of new unsolicited replies: frames of other exchanges, and late replies beyond the outstanding ones, for
    /// each request is answered once at most.
    fn count_unsolicited(&mut self, counters: Counters, now: Instant) -> u64 {
        let last = core::mem::replace(&mut self.last, counters);
        self.late_allowed.push_back((now, unanswered_count(&counters) - unanswered_count(&last)));
        self.unexplained
            .push_back((now, unacknowledged_late(&counters) - unacknowledged_late(&last)));
        self.late_allowed.retain(|(at, _)| now.since(*at) < LATE_ALLOWED_FOR);
        for (_, late) in &mut self.unexplained {
            for (_, allowed) in &mut self.late_allowed {
                let explained = (*late).min(*allowed);
                (*late, *allowed) = (*late - explained, *allowed - explained);
            }
        }
        let mut unsolicited = counters.foreign - last.foreign;
        self.unexplained.retain(|(at, late)| {
            let is_over = now.since(*at) >= UNEXPLAINED_FOR;
            unsolicited += if is_over { *late } else { 0 };
            *late > 0 && !is_over
        });
        self.late_allowed.retain(|(_, allowed)| *allowed > 0);
        unsolicited
    }
}

fn unanswered_count(counters: &Counters) -> u64 {
    counters.silent + counters.resent
}

fn unacknowledged_late(counters: &Counters) -> u64 {
    counters.late - counters.late_acknowledged
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> Instant {
        Instant::ZERO + Duration::from_secs(seconds)
    }

    #[test]
    fn answers_that_come_late_are_no_clash() {
        let late = Counters { sent: 10, answered: 7, silent: 3, late: 3, ..Counters::default() };
        assert_eq!(ClashDetector::default().check(|| late, at(1)), None);
        let doubled = Counters { sent: 10, answered: 10, late: 4, ..Counters::default() };
        let mut watch = ClashDetector::default();
        assert_eq!(watch.check(|| doubled, at(1)), None, "their requests may be counted yet");
        let output = watch.check(|| doubled, at(4)).flatten();
        assert!(output.is_some_and(|output| output.starts_with("4 answers")));
        // The bytes that only acknowledge come beside the answers.
        let acknowledged = Counters { late: 6, late_acknowledged: 3, silent: 3, ..late };
        let mut watch = ClashDetector::default();
        assert_eq!([1, 4].map(|time| watch.check(|| acknowledged, at(time))), [None, None]);
    }

    #[test]
    fn a_drive_that_stalls_again_and_again_is_no_clash() {
        let mut watch = ClashDetector::default();
        for stall in 1..=20 {
            // Some answers are counted before their requests, the others long after.
            let (silent, late) = (10 * stall - 9, 10 * stall - 7);
            let counters = Counters { silent, late, ..Counters::default() };
            assert_eq!(watch.check(|| counters, at(2 * stall)), None);
            let counters = Counters { silent: 10 * stall, late: 10 * stall, ..counters };
            assert_eq!(watch.check(|| counters, at(2 * stall + 1)), None);
        }
    }

    #[test]
    fn a_drive_that_was_away_hides_no_clash_for_long() {
        let mut watch = ClashDetector::default();
        let away = Counters { sent: 500, silent: 500, ..Counters::default() };
        assert_eq!(watch.check(|| away, at(1)), None);
        let doubled = Counters { sent: 510, answered: 10, late: 10, ..away };
        assert_eq!(watch.check(|| doubled, at(2)), None, "one answer to each is owed");
        let doubled = Counters { sent: 520, answered: 20, late: 20, ..away };
        assert_eq!(watch.check(|| doubled, at(32)), None);
        let output = watch.check(|| doubled, at(35)).flatten();
        assert!(output.is_some_and(|output| output.starts_with("10 answers")));
    }

    #[test]
    fn a_clash_is_shown_until_it_was_not_seen_for_a_while() {
        let mut watch = ClashDetector::default();
        let foreign = |foreign| move || Counters { foreign, ..Counters::default() };
        assert!(matches!(watch.check(foreign(1), at(1)), Some(Some(_))));
        assert_eq!(watch.check(foreign(2), at(1)), None, "not looked at yet");
        assert!(matches!(watch.check(foreign(2), at(5)), Some(Some(_))));
        assert_eq!(watch.check(foreign(2), at(15)), None);
        assert_eq!(watch.check(foreign(2), at(16)), Some(None));
        assert_eq!(watch.check(foreign(2), at(30)), None);
    }
}
