//! Commands that were seen: each id is carried out at most once, and whoever says it again is told
//! what came of it.
//!
//! Why: GW-14.

use std::collections::{HashMap, VecDeque};

use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::wire::Tell;
use crate::message::{Outcome, Refused};

/// Ids that are remembered.
const IDS_MAX: usize = 16_384;
/// Characters of an id.
const ID_MAX: usize = 64;
/// Who may wait for one command besides the first.
const WAITING_MAX: usize = 8;

/// Commands by id.
#[derive(Debug, Default)]
pub(super) struct Once {
    seen: HashMap<String, Seen>,
    /// In the order in which they came, with the time after which they are too old anyhow.
    order: VecDeque<(String, Instant)>,
}

#[derive(Debug)]
enum Seen {
    UnderWay(Vec<Tell<Outcome>>),
    Over(Outcome),
}

/// What is to be done about a command.
#[derive(Debug)]
pub(super) enum First {
    /// It is new: carry it out, and tell [`Once::ended`].
    Yes,
    /// It was seen, and ended so.
    Ended(Outcome),
    /// It was seen and has not ended yet.
    UnderWay(oneshot::Receiver<Result<Outcome, Refused>>),
}

impl Once {
    /// Looks whether an id is new, which it is not from now on. `stale` is when a command of that id
    /// is too old to be carried out.
    pub fn first(&mut self, id: &str, stale: Instant, now: Instant) -> Result<First, Refused> {
        if id.is_empty() || id.len() > ID_MAX {
            let what = format!("an id has 1 to {ID_MAX} characters");
            return Err(Refused::new("gateway.request", what));
        }
        match self.seen.get_mut(id) {
            Some(Seen::Over(outcome)) => {
                Ok(First::Ended(Outcome { replayed: true, ..outcome.clone() }))
            }
            Some(Seen::UnderWay(waiting)) if waiting.len() < WAITING_MAX => {
                let (tell, told) = oneshot::channel();
                waiting.push(tell);
                Ok(First::UnderWay(told))
            }
            Some(Seen::UnderWay(_)) => Err(Refused::new("gateway.busy", "it is under way")),
            None => {
                self.make_room(now)?;
                self.seen.insert(id.to_owned(), Seen::UnderWay(Vec::new()));
                self.order.push_back((id.to_owned(), stale));
                Ok(First::Yes)
            }
        }
    }

    /// Notes how a command ended, and tells whoever said it again meanwhile.
    pub fn ended(&mut self, outcome: &Outcome) {
        let Some(seen) = self.seen.get_mut(&outcome.id) else { return };
        if let Seen::UnderWay(waiting) = std::mem::replace(seen, Seen::Over(outcome.clone())) {
            for tell in waiting {
                // Who has gone does not want to know.
                let _ = tell.send(Ok(Outcome { replayed: true, ..outcome.clone() }));
            }
        }
    }

    /// The oldest is forgotten only when it is too old to be carried out, so that nothing is twice.
    fn make_room(&mut self, now: Instant) -> Result<(), Refused> {
        if self.order.len() < IDS_MAX {
            return Ok(());
        }
        match self.order.front() {
            Some((_, stale)) if *stale > now => {
                Err(Refused::new("gateway.busy", "more commands at once than can be remembered")
                    .hint("ask less often"))
            }
            _ => {
                let oldest = self.order.pop_front();
                oldest.and_then(|(id, _)| self.seen.remove(&id));
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Ended;

    fn done(id: &str) -> Outcome {
        Outcome { id: id.into(), outcome: Ended::Done, value: None, error: None, replayed: false }
    }

    #[test]
    fn an_id_is_carried_out_once_and_its_outcome_told_to_all() {
        let mut once = Once::default();
        let stale = Instant::ZERO.plus_ms(500);
        assert!(matches!(once.first("a", stale, Instant::ZERO), Ok(First::Yes)));
        let Ok(First::UnderWay(mut told)) = once.first("a", stale, Instant::ZERO) else {
            panic!("it is under way");
        };
        once.ended(&done("a"));
        assert!(told.try_recv().is_ok_and(|told| told.is_ok_and(|outcome| outcome.replayed)));
        let again = once.first("a", stale, Instant::ZERO.plus_ms(60_000));
        assert!(matches!(again, Ok(First::Ended(outcome)) if outcome.replayed));
    }

    #[test]
    fn memory_is_bounded_and_never_forgets_what_could_be_carried_out_again() {
        let mut once = Once::default();
        let stale = Instant::ZERO.plus_ms(500);
        for n in 0..IDS_MAX {
            assert!(matches!(once.first(&n.to_string(), stale, Instant::ZERO), Ok(First::Yes)));
        }
        let full = once.first("more", stale, Instant::ZERO.plus_ms(499)).unwrap_err();
        assert_eq!(full.code, "gateway.busy");
        assert!(matches!(once.first("more", stale, stale), Ok(First::Yes)));
        assert_eq!(once.order.len(), IDS_MAX);
        let long = "x".repeat(ID_MAX + 1);
        assert_eq!(once.first(&long, stale, stale).unwrap_err().code, "gateway.request");
    }
}
