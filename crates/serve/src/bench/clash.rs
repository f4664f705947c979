//! Detects replies without a request: another master, or two drives with one address.
//!
//! Why: GW-4.

use std::time::Duration;

use polepair_core::station::Counters;
use polepair_core::time::Instant;

/// Between two looks at what was counted.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Answers that drives may still owe: of one that was unplugged for long, none comes.
const LATE_ALLOWED_MAX: u64 = 4;
/// How long a clash is shown that was not seen again.
const SHOWN_FOR: Duration = Duration::from_secs(10);

/// What counts tell of others on a wire.
#[derive(Default)]
pub(super) struct ClashDetector {
    next: Instant,
    last: Counters,
    /// Requests without an answer lately, of which one may still come.
    late_allowed: u64,
    /// Answers that no request explains.
    unsolicited: u64,
    seen: Option<Instant>,
}

impl ClashDetector {
    /// What is to be shown from now on, where that changes; the inner `None` is nothing any more.
    pub fn check(
        &mut self,
        counters: impl FnOnce() -> Counters,
        now: Instant,
    ) -> Option<Option<String>> {
        if now < self.next {
            return None;
        }
        self.next = now + CHECK_INTERVAL;
        let more = self.count_unsolicited(counters());
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

    /// Takes what was counted so far for explained.
    pub fn skip_counted(&mut self, counters: Counters) {
        self.count_unsolicited(counters);
    }

    /// How many came since the last look that nobody asked for: frames of somebody else's talk, and
    /// late answers beyond those that are owed, for each request is answered once at most.
    fn count_unsolicited(&mut self, counters: Counters) -> u64 {
        let Counters { foreign, late, silent, resent, .. } = self.last;
        self.last = counters;
        self.late_allowed += counters.silent + counters.resent - silent - resent;
        let late = counters.late - late;
        let unasked = late.saturating_sub(self.late_allowed);
        self.late_allowed = self.late_allowed.saturating_sub(late).min(LATE_ALLOWED_MAX);
        counters.foreign - foreign + unasked
    }
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
        let output = ClashDetector::default().check(|| doubled, at(1)).flatten();
        assert!(output.is_some_and(|output| output.starts_with("4 answers")));
    }

    #[test]
    fn a_drive_that_was_away_hides_no_clash() {
        let mut watch = ClashDetector::default();
        let away = Counters { sent: 500, silent: 500, ..Counters::default() };
        assert_eq!(watch.check(|| away, at(1)), None);
        let doubled = Counters { sent: 510, answered: 10, late: 10, ..away };
        let output = watch.check(|| doubled, at(2)).flatten();
        assert!(output.is_some_and(|output| output.starts_with("6 answers")));
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
