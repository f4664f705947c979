//! The queue of the journal: one thread writes the records in their order, so no motion or stop waits for a
//! disk.
//!
//! An announced action continues when its record is written. If the disk stalls or fails, announced actions
//! are refused. Records of executed actions that cannot be written are counted, and a later record states
//! the number.
//!
//! Why: GW-25.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use serde_json::{Value, json};

use super::clock::BenchClock;
use super::journal_sink::JournalEntry;
use super::journal_sink::JournalSink;
use super::journal_sink::SERVER;
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::reply::Continuation;
use crate::message::{GatewayError, JournalAction};

/// Records that wait, and about how many bytes of them. Announcements may take half of either, so that
/// acts that were done find room.
const ENTRIES_MAX: usize = 4096;
const BYTES_MAX: usize = 4 << 20;
/// Time without progress after which a disk counts as stalled: nothing more is announced.
// A disk that takes longer is not merely slow; commands are refused while people still watch the
// motor.
const STALLED_AFTER: Duration = Duration::from_secs(1);
/// Age of an announced action after which it is not executed any more.
// A command that waits longer for its record would surprise the person who gave it.
const WRITE_AHEAD_MAX: Duration = Duration::from_secs(2);
/// Interval of attempts to record the number of missing entries.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Session, kind and axis of an action in the journal.
#[derive(Clone, Copy)]
pub(super) struct ActionSubject<'a> {
    who: &'a SessionName,
    action: JournalAction,
    axis: Option<u16>,
}

impl<'a> ActionSubject<'a> {
    pub const fn new(who: &'a SessionName, action: JournalAction, axis: Option<u16>) -> Self {
        Self { who, action, axis }
    }
}

/// A record that waits to be written.
struct QueuedEntry {
    who: SessionName,
    action: JournalAction,
    axis: Option<u16>,
    detail: Value,
    /// Time at which it was noted.
    at: Instant,
    /// True if the action is executed only after it is written.
    write_ahead: bool,
    /// Continuation after the write, or its failure.
    then: Option<Continuation>,
}

impl QueuedEntry {
    fn new(
        subject: ActionSubject<'_>,
        detail: Value,
        at: Instant,
        write_ahead: bool,
        then: Option<Continuation>,
    ) -> Self {
        let ActionSubject { who, action, axis } = subject;
        Self { who: who.clone(), action, axis, detail, at, write_ahead, then }
    }
}

enum QueueItem {
    Entry(Box<QueuedEntry>),
    /// Number of entries that found no room.
    Gap(u64),
}

#[derive(Default)]
struct EntryQueue {
    entries: VecDeque<QueueItem>,
    bytes: usize,
    /// Begin of the write in progress.
    writing: Option<Instant>,
    closed: bool,
}

/// The notes of a bench.
#[derive(Default)]
pub(super) struct JournalQueue {
    queue: Mutex<EntryQueue>,
    wakeup: Condvar,
}

/// Writes them.
pub(super) struct JournalWriter {
    queue: Arc<JournalQueue>,
    journal: Arc<dyn JournalSink>,
    clock: BenchClock,
    missing: MissingEntries,
}

/// Notes that no record was made of.
#[derive(Default)]
struct MissingEntries {
    count: u64,
    why: String,
    /// Time of the next attempt to record it.
    retry_at: Instant,
}

impl JournalQueue {
    /// Records an action before its execution: `then` executes it once it is written, or gets the reason of the
    /// refusal. It must not wait.
    pub fn write_ahead(
        &self,
        subject: ActionSubject<'_>,
        detail: Value,
        now: Instant,
        then: Continuation,
    ) {
        if let Err(refused) = self.check_writable(now) {
            return then(Err(refused));
        }
        self.push(QueuedEntry::new(subject, detail, now, true, Some(then)));
    }

    /// Records an act. `then` is called once it is written, or cannot be.
    pub fn record(
        &self,
        subject: ActionSubject<'_>,
        detail: Value,
        now: Instant,
        then: Option<Continuation>,
    ) {
        self.push(QueuedEntry::new(subject, detail, now, false, then));
    }

    /// Checks that an action can be announced.
    ///
    /// # Errors
    /// `gateway.journal` while the disk takes nothing.
    pub fn check_writable(&self, now: Instant) -> Result<(), GatewayError> {
        let queue = lock_unpoisoned(&self.queue);
        let oldest = queue.writing.or_else(|| match queue.entries.front() {
            Some(QueueItem::Entry(waiting)) => Some(waiting.at),
            _ => None,
        });
        let stalls = oldest.is_some_and(|oldest| now.since(oldest) >= STALLED_AFTER);
        // The other half is for stops and outcomes, which are recorded without being asked.
        let full = queue.entries.len() >= ENTRIES_MAX / 2 || queue.bytes >= BYTES_MAX / 2;
        if stalls || full || queue.closed { Err(stalled_error()) } else { Ok(()) }
    }

    fn push(&self, waiting: QueuedEntry) {
        let bytes = entry_bytes(&waiting.detail);
        let mut queue = lock_unpoisoned(&self.queue);
        if queue.entries.len() < ENTRIES_MAX && queue.bytes + bytes <= BYTES_MAX && !queue.closed {
            queue.bytes += bytes;
            queue.entries.push_back(QueueItem::Entry(Box::new(waiting)));
            drop(queue);
            self.wakeup.notify_one();
            return;
        }
        match queue.entries.back_mut() {
            // One entry for all that is missing: the gap itself never fills the queue.
            Some(QueueItem::Gap(count)) => *count += 1,
            _ => queue.entries.push_back(QueueItem::Gap(1)),
        }
        drop(queue);
        waiting.then.into_iter().for_each(|then| then(Err(stalled_error())));
    }

    /// No more entries are added; the writer ends when all are written.
    pub fn close(&self) {
        lock_unpoisoned(&self.queue).closed = true;
        self.wakeup.notify_one();
    }

    fn next(&self, now: Instant) -> Option<QueueItem> {
        let mut queue = lock_unpoisoned(&self.queue);
        let entry = queue.entries.pop_front();
        if let Some(QueueItem::Entry(waiting)) = &entry {
            debug_assert!(
                queue.bytes >= entry_bytes(&waiting.detail),
                "bytes are counted in and out alike"
            );
            queue.bytes -= entry_bytes(&waiting.detail);
        }
        queue.writing = entry.is_some().then_some(now);
        entry
    }
}

impl JournalWriter {
    pub fn new(queue: Arc<JournalQueue>, journal: Arc<dyn JournalSink>, clock: BenchClock) -> Self {
        Self { queue, journal, clock, missing: MissingEntries::default() }
    }

    /// Writes until the notes are closed.
    pub fn run(mut self) {
        while self.wait() {
            self.write_queued();
        }
        self.write_queued();
        if self.missing.count > 0 && self.report_missing().is_err() {
            let count = self.missing.count;
            tracing::error!(count, "entries are missing at the end of the journal");
        }
    }

    /// Waits for a note. False when none will come.
    fn wait(&self) -> bool {
        let queue = lock_unpoisoned(&self.queue.queue);
        let queue: MutexGuard<'_, _> = match self.missing.count {
            0 => {
                self.queue.wakeup.wait_while(queue, is_idle).unwrap_or_else(PoisonError::into_inner)
            }
            _ => {
                let waited = self.queue.wakeup.wait_timeout_while(queue, RETRY_INTERVAL, is_idle);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
        };
        !queue.closed
    }

    /// Writes what waits.
    pub fn write_queued(&mut self) {
        while let Some(entry) = self.queue.next(self.clock.now()) {
            match entry {
                QueueItem::Entry(waiting) => self.write(*waiting),
                QueueItem::Gap(count) => self.count_missing(count, &stalled_error()),
            }
        }
        if self.missing.count > 0 && self.clock.now() >= self.missing.retry_at {
            // It is tried again.
            let _ = self.report_missing();
        }
    }

    fn write(&mut self, mut waiting: QueuedEntry) {
        let then = waiting.then.take();
        // Its client has given it up by now, so it is neither recorded nor run.
        if waiting.write_ahead && self.is_late(&waiting) {
            return then.into_iter().for_each(|then| then(Err(stalled_error())));
        }
        let mut recorded = self.store_entry(&waiting);
        match &recorded {
            Err(refused) if !waiting.write_ahead => self.count_missing(1, refused),
            Ok(()) if waiting.write_ahead && self.is_late(&waiting) => {
                // The record announces the action: the next one states that it was not executed.
                let id = waiting.detail.get("id").cloned();
                let detail = json!({ "id": id, "outcome": "not_done", "error": stalled_error() });
                let not_done = QueuedEntry {
                    action: JournalAction::Outcome,
                    detail,
                    write_ahead: false,
                    ..waiting
                };
                self.write(not_done);
                recorded = Err(stalled_error());
            }
            _ => {}
        }
        if let Some(then) = then {
            then(recorded);
        }
    }

    fn is_late(&self, waiting: &QueuedEntry) -> bool {
        self.clock.now().since(waiting.at) > WRITE_AHEAD_MAX
    }

    /// Writes a record, behind one that states the number of missing entries.
    fn store_entry(&mut self, waiting: &QueuedEntry) -> Result<(), GatewayError> {
        if self.missing.count > 0 {
            self.report_missing()?;
        }
        let QueuedEntry { who, action, axis, detail, .. } = waiting;
        self.journal.write_entry(JournalEntry { who, action: *action, axis: *axis, detail })
    }

    fn count_missing(&mut self, count: u64, why: &GatewayError) {
        if self.missing.count == 0 {
            tracing::error!(%why, "cannot write to the journal");
        }
        self.missing.count += count;
        self.missing.why = why.message.clone();
    }

    fn report_missing(&mut self) -> Result<(), GatewayError> {
        let MissingEntries { count, why, .. } = &self.missing;
        let detail = json!({ "count": count, "why": why });
        let note = JournalEntry {
            who: SERVER,
            action: JournalAction::Missing,
            axis: None,
            detail: &detail,
        };
        let result = self.journal.write_entry(note);
        match result {
            Ok(()) => self.missing = MissingEntries::default(),
            Err(_) => self.missing.retry_at = self.clock.now() + RETRY_INTERVAL,
        }
        result
    }
}

fn is_idle(queue: &mut EntryQueue) -> bool {
    queue.entries.is_empty() && !queue.closed
}

/// About how many bytes a note takes.
fn entry_bytes(detail: &Value) -> usize {
    const EACH: usize = 64;
    EACH + match detail {
        Value::String(text) => text.len(),
        Value::Array(all) => all.iter().map(entry_bytes).sum(),
        Value::Object(all) => all.iter().map(|(name, value)| name.len() + entry_bytes(value)).sum(),
        _ => 0,
    }
}

pub(super) fn stalled_error() -> GatewayError {
    GatewayError::new("gateway.journal", "the journal's disk accepts no data")
        .hint("check that disk; until then motors can be stopped, but not moved")
}
