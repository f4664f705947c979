//! Replies of several axes to one request, in the order of their IDs.

use crate::error::Failure;
use crate::proto::tml::host_request::Answer;
use crate::station::{EventSubject, HostEvent, Ticket};

/// Answers by axis ID, one an axis.
#[derive(Debug)]
pub struct GroupAnswers {
    answers: [Answer; 256],
    present: [u64; 4],
    count: u8,
    state: GroupState,
}

#[derive(Clone, Copy, Debug)]
enum GroupState {
    Idle,
    /// Answers come in.
    Open(Option<Ticket>),
    /// No more replies are accepted; the end is still to be reported.
    Closed(Option<Ticket>),
    /// The replies are being passed on, then the end.
    Draining(Ticket, Result<Answer, Failure>),
}

impl GroupAnswers {
    pub const fn new() -> Self {
        Self {
            answers: [Answer::Accepted(0); 256],
            present: [0; 4],
            count: 0,
            state: GroupState::Idle,
        }
    }

    pub fn begin(&mut self, ticket: Option<Ticket>) {
        self.clear();
        self.state = GroupState::Open(ticket);
    }

    pub const fn clear(&mut self) {
        (self.present, self.count, self.state) = ([0; 4], 0, GroupState::Idle);
    }

    pub const fn is_open(&self) -> bool {
        matches!(self.state, GroupState::Open(_))
    }

    pub const fn is_draining(&self) -> bool {
        matches!(self.state, GroupState::Draining(..))
    }

    /// Takes an axis' answer, or not if it has given one.
    pub const fn add(&mut self, axis: u8, answer: Answer) -> bool {
        let (word, bit) = ((axis >> 6) as usize, 1 << (axis & 63));
        debug_assert!(self.is_open(), "answers are collected while the group is asked");
        if self.present[word] & bit != 0 {
            return false;
        }
        self.present[word] |= bit;
        self.answers[axis as usize] = answer;
        self.count = self.count.saturating_add(1);
        true
    }

    /// Ends the collection, if there is one, and returns the number of replies.
    pub const fn close(&mut self) -> Option<u8> {
        let GroupState::Open(ticket) = self.state else { return None };
        self.state = GroupState::Closed(ticket);
        Some(self.count)
    }

    /// Passes the replies on, then the result.
    pub const fn finish(&mut self, result: Result<Answer, Failure>) {
        self.state = match self.state {
            GroupState::Closed(Some(ticket)) => GroupState::Draining(ticket, result),
            _ => GroupState::Idle,
        };
    }

    pub fn next_event(&mut self) -> Option<HostEvent<Answer>> {
        let GroupState::Draining(ticket, result) = self.state else { return None };
        let Some(word) = self.present.iter().position(|word| *word != 0) else {
            self.clear();
            return Some((EventSubject::Request(ticket), result));
        };
        let axis = (word as u32) << 6 | self.present[word].trailing_zeros();
        self.present[word] &= self.present[word] - 1;
        debug_assert!(axis < 256, "an axis is a byte");
        Some((EventSubject::GroupMember(ticket, axis), Ok(self.answers[axis as usize])))
    }
}
