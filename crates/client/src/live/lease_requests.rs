//! Open requests about the lease of one axis. Replies may arrive in another order, and a refusal does not
//! name its lease. Therefore a refusal is assigned after all other replies.

use std::collections::VecDeque;

use polepair_messages::LeaseAction;

use super::ResponseSender;
use crate::GatewayError;

/// Lease requests without a reply yet, oldest first.
#[derive(Debug, Default)]
pub(super) struct PendingLeaseRequests {
    waiting: VecDeque<PendingLeaseRequest>,
    refusals: VecDeque<GatewayError>,
}

/// One thing that was asked.
#[derive(Debug)]
pub(super) struct PendingLeaseRequest {
    pub act: LeaseAction,
    /// Epoch of the lease; 0 if there is none yet.
    pub epoch: u64,
    /// The waiting caller; `None` for a renewal.
    pub reply: Option<ResponseSender<u64>>,
}

impl PendingLeaseRequests {
    pub fn push(&mut self, one: PendingLeaseRequest) {
        self.waiting.push_back(one);
    }

    /// Matches a reply about a lease that was acquired or released to its request.
    pub fn match_reply(&mut self, epoch: u64, held: bool) -> Option<PendingLeaseRequest> {
        let at = if held {
            let renewed =
                self.waiting.iter().position(|one| is_request_of(one, LeaseAction::Renew, epoch));
            renewed.or_else(|| self.waiting.iter().position(PendingLeaseRequest::is_acquire))
        } else {
            self.waiting.iter().position(|one| is_request_of(one, LeaseAction::Drop, epoch))
        };
        at.and_then(|at| self.waiting.remove(at))
    }

    pub fn push_refusal(&mut self, why: GatewayError) {
        self.refusals.push_back(why);
    }

    /// Takes the refused requests, once there are as many refusals as requests.
    pub fn drain_settled(&mut self) -> Vec<(PendingLeaseRequest, GatewayError)> {
        // A refusal names no request: which one it was is certain once each has one.
        if self.refusals.len() < self.waiting.len() {
            Vec::new()
        } else {
            self.waiting.drain(..).zip(self.refusals.drain(..)).collect()
        }
    }

    /// The waiting callers.
    pub fn into_senders(self) -> impl Iterator<Item = ResponseSender<u64>> {
        self.waiting.into_iter().filter_map(|one| one.reply)
    }
}

fn is_request_of(one: &PendingLeaseRequest, act: LeaseAction, epoch: u64) -> bool {
    one.act == act && one.epoch == epoch
}

impl PendingLeaseRequest {
    pub const fn is_acquire(&self) -> bool {
        matches!(self.act, LeaseAction::Take | LeaseAction::TakeOver)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(act: LeaseAction, epoch: u64) -> PendingLeaseRequest {
        PendingLeaseRequest { act, epoch, reply: None }
    }

    fn no() -> GatewayError {
        GatewayError::new("gateway.lease", "no")
    }

    /// After a stop, the late reply to a renewal does not end a lease that was acquired since.
    #[test]
    fn a_late_renewal_does_not_fail_what_is_taken_after_it() {
        let mut pending = PendingLeaseRequests::default();
        pending.push(one(LeaseAction::Renew, 3));
        pending.push(one(LeaseAction::Take, 0));
        pending.push_refusal(no());
        assert!(pending.drain_settled().is_empty(), "it may be of either");
        let pending_lease_request = pending.match_reply(4, true).expect("a grant");
        assert!(pending_lease_request.is_acquire());
        let settled = pending.drain_settled();
        assert_eq!(
            (settled.len(), settled[0].0.act, settled[0].0.epoch),
            (1, LeaseAction::Renew, 3)
        );
    }

    #[test]
    fn a_refused_take_does_not_end_the_lease_that_is_renewed() {
        let mut pending = PendingLeaseRequests::default();
        pending.push(one(LeaseAction::Take, 0));
        pending.push(one(LeaseAction::Renew, 3));
        pending.push_refusal(no());
        assert_eq!(pending.match_reply(3, true).expect("a renewal").act, LeaseAction::Renew);
        let settled = pending.drain_settled();
        assert!(settled.len() == 1 && settled[0].0.is_acquire());
    }

    #[test]
    fn an_exclusive_request_is_refused_at_once_and_leaves_nothing() {
        let mut pending = PendingLeaseRequests::default();
        pending.push(one(LeaseAction::Drop, 3));
        assert!(pending.match_reply(2, false).is_none(), "of another lease");
        pending.push_refusal(no());
        assert_eq!(pending.drain_settled().len(), 1);
        pending.push_refusal(no());
        assert!(pending.drain_settled().is_empty(), "of nothing that was asked");
        pending.push(one(LeaseAction::Take, 0));
        assert!(pending.drain_settled().is_empty(), "it is not the next one's");
    }
}
