//! Recent commands by their ids. Each id is executed at most once: the same command again gets the first result,
//! another command is refused. What ends motion is not kept here, because it is always executed.
//!
//! Why: GW-14.

use std::collections::{HashMap, VecDeque};

use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::lease::SessionName;
use super::reply::ReplySender;
use crate::message::{CommandOutcome, GatewayError};

/// Ids that are remembered.
// Five minutes at the most commands that clients may send; an id must outlive its command's time to
// live.
const IDS_MAX: usize = 16_384;
/// Characters of an id.
const ID_MAX: usize = 64;
/// Limit of the clients that wait for one command besides the first.
const WAITING_MAX: usize = 8;

/// Commands by id.
#[derive(Debug, Default)]
pub(super) struct CommandHistory {
    records: HashMap<String, CommandRecord>,
    /// Commands in order of arrival, with the time after which they are too old anyway.
    order: VecDeque<(String, Instant)>,
}

/// Key by which two commands with one id are the same command.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct CommandKey {
    /// Name of the client's token: a client that connects again has another session.
    client: String,
    axis: u16,
    /// Verb and arguments.
    content: String,
}

impl CommandKey {
    /// Key of a command of a session.
    pub fn new(session: &SessionName, axis: u16, content: &serde_json::Value) -> Self {
        let client = session.split_once(' ').map_or(&**session, |(client, _)| client).to_owned();
        Self { client, axis, content: content.to_string() }
    }
}

#[derive(Debug)]
struct CommandRecord {
    key: CommandKey,
    progress: CommandProgress,
}

#[derive(Debug)]
enum CommandProgress {
    Active(Vec<ReplySender<CommandOutcome>>),
    Finished(CommandOutcome),
}

/// Treatment of a command.
#[derive(Debug)]
pub(super) enum CommandLookup {
    /// The command is new: execute it, and call [`CommandHistory::finish`].
    New,
    /// The command was received before, and has this outcome.
    Finished(CommandOutcome),
    /// The command was received before and has not ended yet.
    Active(oneshot::Receiver<Result<CommandOutcome, GatewayError>>),
}

impl CommandHistory {
    /// Looks whether an id is new, which it is not from now on. `stale` is when a command of that id
    /// is too old to be carried out.
    ///
    /// # Errors
    /// `gateway.request` for an id without or with too many characters, and for one of another command;
    /// `gateway.busy`.
    pub fn register(
        &mut self,
        id: &str,
        key: CommandKey,
        stale: Instant,
        now: Instant,
    ) -> Result<CommandLookup, GatewayError> {
        if id.is_empty() || id.len() > ID_MAX {
            let what = format!("an id has 1 to {ID_MAX} characters");
            return Err(GatewayError::new("gateway.request", what));
        }
        let Some(record) = self.records.get_mut(id) else {
            self.make_room(now)?;
            let record = CommandRecord { key, progress: CommandProgress::Active(Vec::new()) };
            self.records.insert(id.to_owned(), record);
            self.order.push_back((id.to_owned(), stale));
            debug_assert_eq!(
                self.records.len(),
                self.order.len(),
                "each id has its place in the order"
            );
            return Ok(CommandLookup::New);
        };
        // The same id for something else is a client's mistake: either answer would be about the wrong
        // command.
        if record.key != key {
            let what = format!("id {id:?} was used for another command; nothing was sent");
            return Err(
                GatewayError::new("gateway.request", what).hint("use a new id for each command")
            );
        }
        match &mut record.progress {
            CommandProgress::Finished(outcome) => {
                Ok(CommandLookup::Finished(CommandOutcome { replayed: true, ..outcome.clone() }))
            }
            CommandProgress::Active(waiting) if waiting.len() < WAITING_MAX => {
                let (reply_sender, reply) = oneshot::channel();
                waiting.push(reply_sender);
                Ok(CommandLookup::Active(reply))
            }
            CommandProgress::Active(_) => {
                Err(GatewayError::new("gateway.busy", "it is being executed"))
            }
        }
    }

    /// Records the outcome of a command, and sends it to all clients that repeated it meanwhile.
    pub fn finish(&mut self, outcome: &CommandOutcome) {
        let Some(seen) = self.records.get_mut(&outcome.id) else { return };
        let finished = CommandProgress::Finished(outcome.clone());
        if let CommandProgress::Active(waiting) = std::mem::replace(&mut seen.progress, finished) {
            for reply_sender in waiting {
                // The receiver may have been dropped.
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
            // It may still be repeated, and then must not run twice.
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

    fn key(axis: u16) -> CommandKey {
        let content = serde_json::json!({ "verb": "velocity" });
        CommandKey::new(&"ann 3".into(), axis, &content)
    }

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
    fn an_id_is_executed_once_and_its_outcome_sent_to_all() {
        let mut once = CommandHistory::default();
        let stale = Instant::ZERO.plus_ms(500);
        assert!(matches!(once.register("a", key(0), stale, Instant::ZERO), Ok(CommandLookup::New)));
        let Ok(CommandLookup::Active(mut reply)) = once.register("a", key(0), stale, Instant::ZERO)
        else {
            panic!("it is being executed");
        };
        once.finish(&done("a"));
        assert!(reply.try_recv().is_ok_and(|result| result.is_ok_and(|outcome| outcome.replayed)));
        let again = once.register("a", key(0), stale, Instant::ZERO.plus_ms(60_000));
        assert!(matches!(again, Ok(CommandLookup::Finished(outcome)) if outcome.replayed));
        // The client after a lost connection, another axis, and another client.
        let content = serde_json::json!({ "verb": "velocity" });
        for (session, axis, known) in [("ann 4", 0, true), ("ann 3", 1, false), ("bob", 0, false)] {
            let key = CommandKey::new(&session.into(), axis, &content);
            let again = once.register("a", key, stale, Instant::ZERO);
            assert_eq!(again.is_ok(), known, "{session}, {axis}");
        }
    }

    #[test]
    fn memory_is_bounded_and_never_forgets_what_could_be_carried_out_again() {
        let mut once = CommandHistory::default();
        let stale = Instant::ZERO.plus_ms(500);
        for n in 0..IDS_MAX {
            assert!(matches!(
                once.register(&n.to_string(), key(0), stale, Instant::ZERO),
                Ok(CommandLookup::New)
            ));
        }
        let full = once.register("more", key(0), stale, Instant::ZERO.plus_ms(499)).unwrap_err();
        assert_eq!(full.code, "gateway.busy");
        assert!(matches!(once.register("more", key(0), stale, stale), Ok(CommandLookup::New)));
        assert_eq!(once.order.len(), IDS_MAX);
        let long = "x".repeat(ID_MAX + 1);
        assert_eq!(once.register(&long, key(0), stale, stale).unwrap_err().code, "gateway.request");
    }
}
