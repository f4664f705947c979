//! SYNC of a bus: counter and period.

use super::heartbeat::LONGEST_NS;
use crate::session::{AnomalyKind, AnomalyNotice, SessionNotice};
use crate::timestamp::Timestamp;

/// Intervals in a row that make a period.
const STEADY: u32 = 16;

/// SYNC of one bus.
#[derive(Debug, Default)]
pub(super) struct SyncMonitor {
    last: Option<Timestamp>,
    period: u64,
    steady: u32,
    counter: Option<u8>,
    /// Overflow value by object 1019h, or by the counter.
    overflow: Option<u8>,
}

impl SyncMonitor {
    /// The counter goes up to this.
    pub fn configure(&mut self, overflow: u8) {
        self.overflow = Some(overflow).filter(|overflow| *overflow > 1);
    }

    /// Restarts the counter, as a commanded node may.
    pub const fn restart_counter(&mut self) {
        (self.counter, self.steady) = (None, 0);
    }

    /// SYNC came.
    pub fn handle_sync(
        &mut self,
        counter: Option<u8>,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        if let Some(text) = self.check_counter(counter) {
            notices.push(anomaly(AnomalyKind::Sequence, text));
        }
        let Some(now) = now else { return };
        let Some(last) = self.last.replace(now) else { return };
        let interval = now.since(last).min(LONGEST_NS);
        if interval.abs_diff(self.period) * 10 <= self.period {
            self.steady += 1;
            return;
        }
        // A longer pause or a change of the period is intended.
        let off = interval * 2 < self.period
            || (interval * 2 > self.period * 3 && interval < self.period * 10);
        if self.steady >= STEADY && off {
            let (us, period) = (interval / 1000, self.period / 1000);
            let text = format!("SYNC came after {us} us instead of {period} us");
            notices.push(anomaly(AnomalyKind::Jitter, text));
        }
        (self.period, self.steady) = (interval, 0);
    }

    /// Fault of the counter.
    fn check_counter(&mut self, counter: Option<u8>) -> Option<String> {
        let now = counter?;
        let before = self.counter.replace(now)?;
        if now == 1 && before > 1 {
            let known = self.overflow.replace(before);
            let right = known.is_none_or(|known| known == before);
            return (!right).then(|| format!("SYNC counter 1 came after {before}"));
        }
        let right = now == before.wrapping_add(1) && self.overflow.is_none_or(|top| now <= top);
        if now > before && self.overflow.is_some_and(|top| now > top) {
            self.overflow = None;
        }
        (!right).then(|| format!("SYNC counter {now} came after {before}"))
    }
}

fn anomaly(kind: AnomalyKind, text: String) -> SessionNotice {
    SessionNotice::Anomaly(AnomalyNotice { kind, axis: None, time: None, text })
}
