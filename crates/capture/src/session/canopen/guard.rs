//! Node guarding: a node is polled for its state, and replies with an alternating bit.

use super::anomaly;
use super::sdo::{FrameRef, TIMEOUT_NS};
use crate::session::{AnomalyKind, ExchangeNotice, ExchangeOutcome, SessionNotice};
use crate::timestamp::Timestamp;

/// The guarding of one node.
#[derive(Debug, Default)]
pub(super) struct NodeGuardMonitor {
    pending: Option<FrameRef>,
    toggle: Option<bool>,
    seen: bool,
    /// True if the last request was not answered.
    lost: bool,
}

impl NodeGuardMonitor {
    /// Returns whether it has replied.
    pub const fn is_seen(&self) -> bool {
        self.seen
    }

    /// The node starts again: its bit too.
    pub const fn restart(&mut self) {
        (self.toggle, self.pending) = (None, None);
    }

    /// The node is asked.
    pub const fn record_request(&mut self, at: FrameRef) {
        self.pending = Some(at);
    }

    /// Time at which the answer counts as missing.
    pub fn due(&self) -> Option<Timestamp> {
        Some(Timestamp(self.pending?.1?.0.saturating_add(TIMEOUT_NS)))
    }

    /// No more is waited for an answer. True if one was due.
    pub fn give_up(&mut self, node: u8, notices: &mut Vec<SessionNotice>) -> bool {
        let Some(request) = self.pending.take() else { return false };
        self.lost = true;
        notices.push(SessionNotice::Exchange(guard_exchange(
            node,
            request,
            None,
            ExchangeOutcome::Unanswered,
        )));
        true
    }

    /// Handles the node's state; `false` without a request.
    pub fn handle_answer(
        &mut self,
        node: u8,
        toggle: bool,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> bool {
        let Some(request) = self.pending.take() else { return false };
        let (known, lost) = (self.toggle.replace(toggle), core::mem::take(&mut self.lost));
        self.seen = true;
        notices.push(SessionNotice::Exchange(guard_exchange(
            node,
            request,
            Some(at),
            ExchangeOutcome::Done,
        )));
        if known == Some(toggle) && !lost {
            let text = "the toggle of its answer to guarding did not change".to_owned();
            notices.push(anomaly(AnomalyKind::Sequence, node, text));
        }
        true
    }
}

fn guard_exchange(
    node: u8,
    request: FrameRef,
    answered: Option<FrameRef>,
    outcome: ExchangeOutcome,
) -> ExchangeNotice {
    let axis = Some(node.into());
    ExchangeNotice { axis, op: "guarding", requested: request, answered, outcome, retries: 0 }
}
