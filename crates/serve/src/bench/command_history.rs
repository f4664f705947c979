//! Recent commands by their ids. Each id is executed at most once; a repeated id gets the first result.
//!
//! Why: GW-14.

use std::collections::{HashMap, VecDeque};

use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::reply::ReplySender;
use crate::message::{CommandOutcome, GatewayError};

/// Ids that are remembered.
const IDS_MAX: usize = 16_384;
/// Characters of an id.
const ID_MAX: usize = 64;
/// Who may wait for one command besides the first.
const WAITING_MAX: usize = 8;

/// Commands by id.
#[derive(Debug, Default)]
pub(super) struct CommandHistory {
    records: HashMap<String, CommandRecord>,
    /// In the order in which they came, with the time after which they are too old anyhow.
    order: VecDeque<(String, Instant)>,
}

#[derive(Debug)]
enum CommandRecord {
    Active(Vec<ReplySender<CommandOutcome>>),
    Finished(CommandOutcome),
}

/// What is to be done about a command.
#[derive(Debug)]
pub(super) enum CommandLookup {
    /// It is new: carry it out, and tell [`CommandHistory::finish`].
    New,
    /// It was seen, and ended so.
    Finished(CommandOutcome),
    /// It was seen and has not ended yet.
    Active(oneshot::Receiver<Result<CommandOutcome, GatewayError>>),
}

impl CommandHistory {
    /// Looks whether an id is new, which it is not from now on. `stale` is when a command of that id
    /// is too old to be carried out.
    pub fn register(
        &mut self,
        id: &str,
        stale: Instant,
        now: Instant,
    ) -> Result<CommandLookup, GatewayError> {
        if id.is_empty() || id.len() > ID_MAX {
            let what = format!("an id has 1 to {ID_MAX} characters");
            return Err(GatewayError::new("gateway.request", what));
        }
        match self.records.get_mut(id) {
            Some(CommandRecord::Finished(outcome)) => {
                Ok(CommandLookup::Finished(CommandOutcome { replayed: true, ..outcome.clone() }))
            }
            Some(CommandRecord::Active(waiting)) if waiting.len() < WAITING_MAX => {
                let (reply_sender, reply) = oneshot::channel();
                waiting.push(reply_sender);
                Ok(CommandLookup::Active(reply))
            }
            Some(CommandRecord::Active(_)) => {
                Err(GatewayError::new("gateway.busy", "it is being executed"))
            }
            None => {
                self.make_room(now)?;
                self.records.insert(id.to_owned(), CommandRecord::Active(Vec::new()));
                self.order.push_back((id.to_owned(), stale));
                Ok(CommandLookup::New)
            }
        }
    }

    /// Notes how a command ended, and tells whoever said it again meanwhile.
    pub fn finish(&mut self, outcome: &CommandOutcome) {
        let Some(seen) = self.records.get_mut(&outcome.id) else { return };
        if let CommandRecord::Active(waiting) =
            std::mem::replace(seen, CommandRecord::Finished(outcome.clone()))
        {
            for reply_sender in waiting {
                // Who has gone does not want to know.
                let _ = reply_sender.send(Ok(CommandOutcome { replayed: true, ..outcome.clone() }));
            }
        }
    }

    /// The oldest is forgotten only when it is too old to be carried out, so that nothing is twice.
    fn make_room(&mut self, now: Instant) -> Result<(), GatewayError> {
        if self.order.len() < IDS_MAX {
            return Ok(());
        }
        match self.order.front() {
            Some((_, stale)) if *stale > now => {
                Err(GatewayError::new("gateway.busy", "too many commands at once")
                    .hint("ask less often"))
            }
            _ => {
                let oldest = self.order.pop_front();
                oldest.and_then(|(id, _)| self.records.remove(&id));
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::OutcomeKind;

    fn done(id: &str) -> CommandOutcome {
        CommandOutcome {
            id: id.into(),
            outcome: OutcomeKind::Done,
            value: None,
            error: None,
            replayed: false,
        }
    }

    #[test]
    fn an_id_is_carried_out_once_and_its_outcome_told_to_all() {
        let mut once = CommandHistory::default();
        let stale = Instant::ZERO.plus_ms(500);
        assert!(matches!(once.register("a", stale, Instant::ZERO), Ok(CommandLookup::New)));
        let Ok(CommandLookup::Active(mut reply)) = once.register("a", stale, Instant::ZERO) else {
            panic!("it is being executed");
        };
        once.finish(&done("a"));
        assert!(reply.try_recv().is_ok_and(|result| result.is_ok_and(|outcome| outcome.replayed)));
        let again = once.register("a", stale, Instant::ZERO.plus_ms(60_000));
        assert!(matches!(again, Ok(CommandLookup::Finished(outcome)) if outcome.replayed));
    }

    #[test]
    fn memory_is_bounded_and_never_forgets_what_could_be_carried_out_again() {
        let mut once = CommandHistory::default();
        let stale = Instant::ZERO.plus_ms(500);
        for n in 0..IDS_MAX {
            assert!(matches!(
                once.register(&n.to_string(), stale, Instant::ZERO),
                Ok(CommandLookup::New)
            ));
        }
        let full = once.register("more", stale, Instant::ZERO.plus_ms(499)).unwrap_err();
        assert_eq!(full.code, "gateway.busy");
        assert!(matches!(once.register("more", stale, stale), Ok(CommandLookup::New)));
        assert_eq!(once.order.len(), IDS_MAX);
        let long = "x".repeat(ID_MAX + 1);
        assert_eq!(once.register(&long, stale, stale).unwrap_err().code, "gateway.request");
    }
}
