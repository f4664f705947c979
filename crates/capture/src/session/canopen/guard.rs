//! Guarding: a node is asked for its state, and answers with a bit that alternates.

use super::odd;
use super::sdo::{At, TIMEOUT_NS};
use crate::session::{Exchange, Notice, Oddity, Outcome};
use crate::stamp::Stamp;

/// The guarding of one node.
#[derive(Debug, Default)]
pub(super) struct Guard {
    asked: Option<At>,
    toggle: Option<bool>,
    heard: bool,
    /// It did not answer last.
    lost: bool,
}

impl Guard {
    /// It answered.
    pub const fn is_heard(&self) -> bool {
        self.heard
    }

    /// The node starts again: its bit too.
    pub const fn restart(&mut self) {
        (self.toggle, self.asked) = (None, None);
    }

    /// The node is asked.
    pub const fn ask(&mut self, at: At) {
        self.asked = Some(at);
    }

    /// When the answer is missed.
    pub fn due(&self) -> Option<Stamp> {
        Some(Stamp(self.asked?.1?.0.saturating_add(TIMEOUT_NS)))
    }

    /// No more is waited for an answer. True if one was due.
    pub fn give_up(&mut self, node: u8, notices: &mut Vec<Notice>) -> bool {
        let Some(asked) = self.asked.take() else { return false };
        self.lost = true;
        notices.push(Notice::Exchange(exchange(node, asked, None, Outcome::Unanswered)));
        true
    }

    /// The node's state comes; `false` if nobody asked.
    pub fn answer(&mut self, node: u8, toggle: bool, at: At, notices: &mut Vec<Notice>) -> bool {
        let Some(asked) = self.asked.take() else { return false };
        let (known, lost) = (self.toggle.replace(toggle), core::mem::take(&mut self.lost));
        self.heard = true;
        notices.push(Notice::Exchange(exchange(node, asked, Some(at), Outcome::Done)));
        if known == Some(toggle) && !lost {
            let text = "the toggle of its answer to guarding did not change".to_owned();
            notices.push(odd(Oddity::Sequence, node, text));
        }
        true
    }
}

fn exchange(node: u8, asked: At, answered: Option<At>, outcome: Outcome) -> Exchange {
    let axis = Some(node.into());
    Exchange { axis, op: "guarding", asked, answered, outcome, retries: 0 }
}
