//! What was asked about the lease of one axis. Answers may come in another order than what they answer,
//! and a refusal does not say of which lease: so refusals wait until all else is answered.

use std::collections::VecDeque;

use polepair_messages::LeaseAct;

use super::Tell;
use crate::Refused;

/// What is not answered yet, in the order in which it was asked.
#[derive(Debug, Default)]
pub(super) struct Asked {
    waiting: VecDeque<One>,
    refusals: VecDeque<Refused>,
}

/// One thing that was asked.
#[derive(Debug)]
pub(super) struct One {
    pub act: LeaseAct,
    /// Of the lease that it is about; 0 where there is none yet.
    pub epoch: u64,
    /// Who waits for the answer: nobody, for a renewal.
    pub tell: Option<Tell<u64>>,
}

impl Asked {
    pub fn ask(&mut self, one: One) {
        self.waiting.push_back(one);
    }

    /// What a lease that is held from now on, or was given back, answers.
    pub fn answered(&mut self, epoch: u64, held: bool) -> Option<One> {
        let its = |one: &One, act| one.act == act && one.epoch == epoch;
        let at = match held {
            true => {
                let renewed = self.waiting.iter().position(|one| its(one, LeaseAct::Renew));
                renewed.or_else(|| self.waiting.iter().position(One::is_taking))
            }
            false => self.waiting.iter().position(|one| its(one, LeaseAct::Drop)),
        };
        at.and_then(|at| self.waiting.remove(at))
    }

    pub fn refused(&mut self, why: Refused) {
        self.refusals.push_back(why);
    }

    /// What is known to be refused: all that waits, once there are as many refusals.
    pub fn settled(&mut self) -> Vec<(One, Refused)> {
        match self.refusals.len() < self.waiting.len() {
            true => Vec::new(),
            false => self.waiting.drain(..).zip(self.refusals.drain(..)).collect(),
        }
    }

    /// Whoever waits.
    pub fn into_tells(self) -> impl Iterator<Item = Tell<u64>> {
        self.waiting.into_iter().filter_map(|one| one.tell)
    }
}

impl One {
    pub const fn is_taking(&self) -> bool {
        matches!(self.act, LeaseAct::Take | LeaseAct::TakeOver)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(act: LeaseAct, epoch: u64) -> One {
        One { act, epoch, tell: None }
    }

    fn no() -> Refused {
        Refused::new("gateway.lease", "no")
    }

    /// The axis was stopped: the renewal that was under way comes too late, what is taken anew is ours.
    #[test]
    fn a_late_renewal_does_not_fail_what_is_taken_after_it() {
        let mut asked = Asked::default();
        asked.ask(one(LeaseAct::Renew, 3));
        asked.ask(one(LeaseAct::Take, 0));
        asked.refused(no());
        assert!(asked.settled().is_empty(), "it may be of either");
        let taken = asked.answered(4, true).expect("a grant");
        assert!(taken.is_taking());
        let settled = asked.settled();
        assert_eq!((settled.len(), settled[0].0.act, settled[0].0.epoch), (1, LeaseAct::Renew, 3));
    }

    #[test]
    fn a_refused_take_does_not_end_the_lease_that_is_renewed() {
        let mut asked = Asked::default();
        asked.ask(one(LeaseAct::Take, 0));
        asked.ask(one(LeaseAct::Renew, 3));
        asked.refused(no());
        assert_eq!(asked.answered(3, true).expect("a renewal").act, LeaseAct::Renew);
        let settled = asked.settled();
        assert!(settled.len() == 1 && settled[0].0.is_taking());
    }

    #[test]
    fn what_is_alone_is_refused_at_once_and_leaves_nothing() {
        let mut asked = Asked::default();
        asked.ask(one(LeaseAct::Drop, 3));
        assert!(asked.answered(2, false).is_none(), "of another lease");
        asked.refused(no());
        assert_eq!(asked.settled().len(), 1);
        asked.refused(no());
        assert!(asked.settled().is_empty(), "of nothing that was asked");
        asked.ask(one(LeaseAct::Take, 0));
        assert!(asked.settled().is_empty(), "it is not the next one's");
    }
}
