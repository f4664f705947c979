//! The sink of the bench's journal.

use serde_json::Value;

use crate::message::{GatewayError, JournalAction};

/// Session name for actions that no client requested.
pub(super) const SERVER: &str = "server";

/// Keeps records of acts: see [`BenchOptions::journal`](super::BenchOptions::journal).
///
/// Called before anything is sent, stops excepted: those go first. One thread calls it that has no other work, so it
/// may wait for a disk.
pub trait JournalSink: Send + Sync {
    /// Takes a note, and returns once it is kept.
    ///
    /// # Errors
    /// When it cannot be kept: the announced act is not done, and a [`JournalAction::Missing`] counts the acts that
    /// were.
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError>;
}

/// An action, announced or executed.
#[derive(Debug)]
pub struct JournalEntry<'a> {
    /// The session; `server` for actions that no client requested.
    pub who: &'a str,
    /// Kind of the action.
    pub action: JournalAction,
    /// The axis that it concerns.
    pub axis: Option<u16>,
    /// The rest.
    pub detail: &'a Value,
}

/// A journal that keeps nothing, for benches with a single user.
#[derive(Debug)]
pub struct NullJournal;

impl JournalSink for NullJournal {
    fn write_entry(&self, _note: JournalEntry<'_>) -> Result<(), GatewayError> {
        Ok(())
    }
}
