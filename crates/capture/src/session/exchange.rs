//! Requests and their results, for any protocol. The dissector states for each frame its role, which
//! replies it expects and which requests it answers. This module pairs them, and reports missing ones.
//!
//! ```text
//!   exchange    the tracker: faults of single frames, turns on the line
//!    ├ pairing  requests under way, and the answers that settle them
//!    ├ values   values read and written, faults, states
//!    └ presence who spoke regularly and fell silent
//! ```
//!
//! Why: DEC-11 to DEC-13.

mod pairing;
mod presence;
mod values;

use polepair_core::error::WireError;
use polepair_core::explain::{
    ConversationContext, Direction, Dissector, FrameRole, RawFrame, SequencePosition,
};

use super::{AnomalyKind, AnomalyNotice, ObservedFrame, ProtocolTracker, Quality, SessionNotice};
use crate::defect::{FrameDefect, stray_text};
use crate::explanation::Explanation;
use crate::timestamp::Timestamp;
use pairing::Pairing;
use presence::PresenceMonitor;
use values::ValueTracker;

/// Axes of a link that are followed one by one.
const AXES_MAX: usize = 256;

/// Follows one protocol of requests and answers on one link.
#[derive(Debug, Default)]
pub(super) struct ExchangeTracker {
    pairing: Pairing,
    presence: PresenceMonitor,
    values: ValueTracker,
    /// The last place of each axis in a sequence that counts.
    sequence_numbers: Vec<(u32, u32)>,
    /// Anomaly that may only be the end of a truncated capture, until another frame follows.
    pending_anomaly: Option<AnomalyNotice>,
    /// True once a valid frame was received: earlier bytes may be the truncated beginning.
    synced: bool,
}

impl ProtocolTracker for ExchangeTracker {
    fn handle_frame(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        if observed.echo {
            return;
        }
        notices.extend(self.pending_anomaly.take().map(SessionNotice::Anomaly));
        if let Some(wrong) = observed.defect {
            return self.handle_defect(wrong, observed, explanation, notices);
        }
        self.synced = true;
        let turn = observed
            .dissector
            .role(&observed.raw, &self.conversation_context(observed, explanation.axis));
        let quality = match turn {
            FrameRole::Request(awaits) => {
                self.check_sequence(observed, explanation, notices);
                self.pairing.handle_request(awaits, observed, explanation, notices);
                self.presence.record_request(explanation.axis);
                Quality::Good
            }
            FrameRole::Acknowledgement => self.pairing.handle_acknowledge(observed, notices),
            FrameRole::Answer | FrameRole::Report => {
                let reports = turn == FrameRole::Report;
                let settled = self.pairing.handle_answer(reports, observed, explanation, notices);
                self.presence.record_frame(
                    explanation.axis,
                    observed.time,
                    reports && !settled.requested,
                );
                settled.quality
            }
            FrameRole::Unrelated => Quality::Good,
        };
        let request = self.pairing.request_of(observed.number);
        self.values.handle_values(observed, explanation, quality, request, notices);
        if self.pairing.has_given_up() {
            self.presence.record_missed(self.pairing.take_given_up(), observed.time, notices);
        }
    }

    fn keeps_explanation(&self, _: &RawFrame<'_>) -> bool {
        true
    }

    fn awaited_request(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<RawFrame<'_>> {
        self.pairing.awaited_request(dissector, answer, now)
    }

    fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        self.pairing.advance_time(now, notices);
        if self.pairing.has_given_up() {
            self.presence.record_missed(self.pairing.take_given_up(), Some(now), notices);
        }
        self.presence.check_silence(now, notices);
    }

    fn finish(&mut self, notices: &mut Vec<SessionNotice>) {
        self.pairing.finish(notices);
    }
}

impl ExchangeTracker {
    /// A tracker, without notices of values if `skips_signals`.
    pub(super) fn new(skips_signals: bool) -> Self {
        Self { values: ValueTracker::new(skips_signals), ..Self::default() }
    }

    fn conversation_context<'a>(
        &'a self,
        observed: &ObservedFrame<'_>,
        axis: Option<u32>,
    ) -> ConversationContext<'a> {
        ConversationContext {
            direction: observed.direction,
            open_request: self.pairing.open_request(),
            format_request: self.pairing.format_request(axis),
            profile: observed.profile,
        }
    }

    /// A frame that breaks something, or bytes that are none.
    fn handle_defect(
        &mut self,
        wrong: FrameDefect,
        observed: &ObservedFrame<'_>,
        explanation: &Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let short = matches!(wrong, FrameDefect::Wire(WireError::Short { .. }));
        let (kind, axis, text) = if observed.stray {
            (AnomalyKind::Stray, None, stray_text(observed.raw.bytes.len()))
        } else {
            (anomaly_kind(wrong), explanation.axis, wrong.to_string())
        };
        let anomaly = AnomalyNotice { kind, axis, time: None, text };
        let cut = observed.stray || short;
        if cut && observed.raw.id.is_none() {
            // The capture may have begun in the middle of this, or may end in it.
            self.pending_anomaly =
                Some(AnomalyNotice { time: observed.time, ..anomaly }).filter(|_| self.synced);
            if observed.direction != Some(Direction::ToDrive) {
                self.pairing.mark_spoiled();
            }
            return;
        }
        self.synced = true;
        notices.push(SessionNotice::Anomaly(anomaly));
        if observed.direction != Some(Direction::ToDrive) && observed.raw.id.is_none() {
            self.pairing.handle_broken_answer(observed, notices);
        }
        self.values.handle_values(observed, explanation, Quality::BadCheck, None, notices);
    }

    /// Points that count up: one that is left out was lost.
    fn check_sequence(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let (Some(sequence_position), Some(axis)) =
            (observed.dissector.sequence_position(&observed.raw), explanation.axis)
        else {
            return;
        };
        let known = self.sequence_numbers.iter().position(|(of, _)| *of == axis);
        let SequencePosition::Number(number, after) = sequence_position else {
            known.map(|at| self.sequence_numbers.swap_remove(at));
            return;
        };
        let Some(at) = known else {
            if self.sequence_numbers.len() < AXES_MAX {
                self.sequence_numbers.push((axis, number));
            }
            return;
        };
        let last = core::mem::replace(&mut self.sequence_numbers[at].1, number);
        let expected = (last + 1) % after;
        if number != expected && number != last {
            let missed = (number + after - expected) % after;
            let text = format!(
                "point {number} after {last} to axis {axis}: {missed} of a path are missing"
            );
            let kind = AnomalyKind::Sequence;
            notices.push(SessionNotice::Anomaly(AnomalyNotice {
                kind,
                axis: Some(axis),
                time: None,
                text,
            }));
        }
    }
}

fn anomaly_kind(wrong: FrameDefect) -> AnomalyKind {
    match wrong {
        FrameDefect::Stray(_) => AnomalyKind::Stray,
        wrong if wrong.is_bad_check() => AnomalyKind::BadCheck,
        FrameDefect::BadCheck | FrameDefect::Wire(_) => AnomalyKind::Malformed,
    }
}

/// Something odd of an axis, now.
fn anomaly(kind: AnomalyKind, axis: Option<u32>, text: String) -> SessionNotice {
    SessionNotice::Anomaly(AnomalyNotice { kind, axis, time: None, text })
}

#[cfg(test)]
mod tests;
