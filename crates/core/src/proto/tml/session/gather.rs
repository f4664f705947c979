//! The answers to a question that several axes answer, put in the order of their IDs.

use crate::error::Failure;
use crate::proto::tml::ask::Answer;
use crate::station::{Event, Ticket, To};

/// Answers by axis ID, one an axis.
#[derive(Debug)]
pub struct Gather {
    answers: [Answer; 256],
    present: [u64; 4],
    count: u8,
    state: State,
}

#[derive(Clone, Copy, Debug)]
enum State {
    Idle,
    /// Answers come in.
    Open(Option<Ticket>),
    /// No more come in; the end is still to be told.
    Closed(Option<Ticket>),
    /// They are handed on, then the end.
    Draining(Ticket, Result<Answer, Failure>),
}

impl Gather {
    pub const fn new() -> Self {
        Self { answers: [Answer::Taken(0); 256], present: [0; 4], count: 0, state: State::Idle }
    }

    pub fn begin(&mut self, ticket: Option<Ticket>) {
        self.clear();
        self.state = State::Open(ticket);
    }

    pub const fn clear(&mut self) {
        (self.present, self.count, self.state) = ([0; 4], 0, State::Idle);
    }

    pub const fn is_open(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    pub const fn is_draining(&self) -> bool {
        matches!(self.state, State::Draining(..))
    }

    /// Takes an axis' answer, or not if it has given one.
    pub const fn take(&mut self, axis: u8, answer: Answer) -> bool {
        let (word, bit) = ((axis >> 6) as usize, 1 << (axis & 63));
        if self.present[word] & bit != 0 {
            return false;
        }
        self.present[word] |= bit;
        self.answers[axis as usize] = answer;
        self.count = self.count.saturating_add(1);
        true
    }

    /// Ends the gathering, if there is one, and tells how many answered.
    pub const fn close(&mut self) -> Option<u8> {
        let State::Open(ticket) = self.state else { return None };
        self.state = State::Closed(ticket);
        Some(self.count)
    }

    /// Hands the answers on, then the result.
    pub const fn end(&mut self, result: Result<Answer, Failure>) {
        self.state = match self.state {
            State::Closed(Some(ticket)) => State::Draining(ticket, result),
            _ => State::Idle,
        };
    }

    pub fn next_event(&mut self) -> Option<Event<Answer>> {
        let State::Draining(ticket, result) = self.state else { return None };
        let Some(word) = self.present.iter().position(|word| *word != 0) else {
            self.clear();
            return Some((To::Ticket(ticket), result));
        };
        let axis = (word as u32) << 6 | self.present[word].trailing_zeros();
        self.present[word] &= self.present[word] - 1;
        Some((To::Part(ticket, axis), Ok(self.answers[axis as usize])))
    }
}
