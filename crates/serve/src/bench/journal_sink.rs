//! Where the bench writes what is done.

use serde_json::Value;

use crate::message::{GatewayError, JournalAction};

/// Who did what nobody asked for.
pub(super) const SERVER: &str = "server";

/// Keeps what is done: see [`BenchOptions::journal`](super::BenchOptions::journal).
///
/// It is told before anything is sent, stops excepted: those go first. One thread calls it, which looks
/// after nothing else, so it may wait for a disk.
pub trait JournalSink: Send + Sync {
    /// Takes a note, and returns once it is kept.
    ///
    /// # Errors
    /// When it cannot be kept: what it announces is then not done, and a [`JournalAction::Missing`] counts what
    /// was done.
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError>;
}

/// What is about to be done, or was.
#[derive(Debug)]
pub struct JournalEntry<'a> {
    /// The session; `server` for what nobody asked for.
    pub who: &'a str,
    /// What.
    pub action: JournalAction,
    /// The axis that it concerns.
    pub axis: Option<u16>,
    /// The rest.
    pub detail: &'a Value,
}

/// A journal that keeps nothing, for benches that nobody else commands.
#[derive(Debug)]
pub struct NullJournal;

impl JournalSink for NullJournal {
    fn write_entry(&self, _note: JournalEntry<'_>) -> Result<(), GatewayError> {
        Ok(())
    }
}
