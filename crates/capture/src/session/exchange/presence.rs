//! Detects senders that stop their periodic frames.

use super::{AXES_MAX, anomaly};
use crate::session::{AnomalyKind, SessionNotice};
use crate::timestamp::Timestamp;

/// Frames of an axis after which its silence has a meaning.
const FRAMES_MIN: u32 = 8;
/// Unanswered requests in a row that are a silence.
const MISSES: u32 = 3;
/// Number of missed periods after which a regular sender is silent …
const PAUSES_MAX: u64 = 10;
/// … and this long at least, ns.
const SILENCE_MIN: u64 = 1_000_000_000;
/// Interval of checking regular senders, ns.
const CHECK_INTERVAL_NS: u64 = 100_000_000;

/// Axes of a link and the times of their frames.
#[derive(Debug, Default)]
pub(super) struct PresenceMonitor {
    axes: Vec<AxisPresence>,
    last_check: Option<Timestamp>,
}

#[derive(Debug, Default)]
struct AxisPresence {
    axis: u32,
    frame_count: u32,
    last: Option<Timestamp>,
    /// Unanswered requests since.
    misses: u32,
    silent: bool,
    /// Unsolicited reports: their number, the last one, and the longest pause between.
    unsolicited_count: u32,
    unsolicited_last: Option<Timestamp>,
    longest_pause: u64,
}

impl PresenceMonitor {
    fn axis_mut(&mut self, axis: u32) -> Option<&mut AxisPresence> {
        let at = match self.axes.iter().position(|known| known.axis == axis) {
            Some(at) => at,
            None if self.axes.len() == AXES_MAX => return None,
            None => {
                self.axes.push(AxisPresence { axis, ..AxisPresence::default() });
                self.axes.len() - 1
            }
        };
        Some(&mut self.axes[at])
    }

    /// Records a request, which may end the unsolicited reports of an axis.
    pub fn record_request(&mut self, axis: Option<u32>) {
        for known in self.axes.iter_mut().filter(|known| axis.is_none_or(|axis| axis == known.axis))
        {
            known.unsolicited_count = 0;
        }
    }

    /// Records a frame; `unasked` for an unsolicited one.
    pub fn record_frame(&mut self, axis: Option<u32>, now: Option<Timestamp>, unasked: bool) {
        let Some(known) = axis.and_then(|axis| self.axis_mut(axis)) else { return };
        known.frame_count = known.frame_count.saturating_add(1);
        (known.last, known.misses, known.silent) = (now, 0, false);
        if unasked {
            let pause = now.zip(known.unsolicited_last).map_or(0, |(now, last)| now.since(last));
            known.longest_pause =
                if known.unsolicited_count > 1 { known.longest_pause.max(pause) } else { pause };
            known.unsolicited_count = known.unsolicited_count.saturating_add(1);
            known.unsolicited_last = now;
        }
    }

    /// Records unanswered requests.
    pub fn record_missed(
        &mut self,
        axes: impl Iterator<Item = u32>,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        for axis in axes {
            let Some(known) = self.axis_mut(axis) else { continue };
            known.misses = known.misses.saturating_add(1);
            if known.frame_count >= FRAMES_MIN && known.misses >= MISSES && !known.silent {
                known.report_silence(now, notices);
            }
        }
    }

    /// Advances the time: a regular sender may be missing.
    pub fn check_silence(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        if self.last_check.is_some_and(|polled| now.since(polled) < CHECK_INTERVAL_NS) {
            return;
        }
        self.last_check = Some(now);
        for known in &mut self.axes {
            let steady = known.unsolicited_count >= FRAMES_MIN && !known.silent;
            let quiet = known.last.map_or(0, |last| now.since(last));
            if steady && quiet > SILENCE_MIN.max(PAUSES_MAX * known.longest_pause) {
                known.report_silence(Some(now), notices);
            }
        }
    }
}

impl AxisPresence {
    fn report_silence(&mut self, now: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        self.silent = true;
        let quiet = now.zip(self.last).map(|(now, last)| now.since(last) as f64 / 1e9);
        let for_long = quiet.map_or(String::new(), |quiet| format!(" for {quiet:.1} s"));
        let text = format!(
            "axis {} has been silent{for_long}, after {} frames of it",
            self.axis, self.frame_count
        );
        notices.push(anomaly(AnomalyKind::Silent, Some(self.axis), text));
    }
}
