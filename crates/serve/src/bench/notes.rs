//! What is to be written into the journal waits here, in the order in which it was noted, and one thread
//! writes it: nobody who moves or stops anything waits for a disk.
//!
//! What is announced goes on once it is kept, by what was left here for that. Where the disk stalls or
//! refuses, what is announced is refused, and what was done is counted where it cannot be kept: a
//! record tells how many are missing, as soon as there can be one.
//!
//! Why: GW-25.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use serde_json::{Value, json};

use super::clock::Clock;
use super::lease::Session;
use super::shared::{Journal, Note, SERVER, held};
use super::wire::Go;
use crate::message::{Deed, Refused};

/// Notes that wait, and about how many bytes of them. What is announced may take half of either, so that
/// what was done finds room.
const NOTES_MAX: usize = 4096;
const BYTES_MAX: usize = 4 << 20;
/// A disk that has taken nothing for so long stalls: nothing more is announced.
const STALLED: Duration = Duration::from_secs(1);
/// What was announced longer ago than this is not done any more.
const ANNOUNCED_MAX: Duration = Duration::from_secs(2);
/// Between two tries to tell how many notes are missing.
const AGAIN: Duration = Duration::from_secs(1);

/// A note that waits.
struct Waiting {
    who: Session,
    deed: Deed,
    axis: Option<u16>,
    detail: Value,
    /// When it was noted.
    at: Instant,
    /// It is not done yet, and only will be when it is kept.
    announced: bool,
    /// What goes on once it was written, or could not be.
    then: Option<Go>,
}

enum Entry {
    Note(Box<Waiting>),
    /// So many found no room.
    Gap(u64),
}

#[derive(Default)]
struct Queue {
    entries: VecDeque<Entry>,
    bytes: usize,
    /// Since when a record is being written.
    writing: Option<Instant>,
    closed: bool,
}

/// The notes of a bench.
#[derive(Default)]
pub(super) struct Notes {
    queue: Mutex<Queue>,
    called: Condvar,
}

/// Writes them.
pub(super) struct Scribe {
    notes: Arc<Notes>,
    journal: Arc<dyn Journal>,
    clock: Clock,
    missing: Missing,
}

/// Notes that no record was made of.
#[derive(Default)]
struct Missing {
    count: u64,
    why: String,
    /// When to tell so again.
    again: Instant,
}

impl Notes {
    /// Notes what is about to be done: `then` does it once it is kept, or hears why that is not to be.
    /// It must not wait.
    pub fn announce(
        &self,
        (who, deed, axis): (&Session, Deed, Option<u16>),
        detail: Value,
        now: Instant,
        then: Go,
    ) {
        if let Err(refused) = self.takes(now) {
            return then(Err(refused));
        }
        let (who, then) = (who.clone(), Some(then));
        self.push(Waiting { who, deed, axis, detail, at: now, announced: true, then });
    }

    /// Notes what was done. `then` is done once it is written, or cannot be.
    pub fn done(
        &self,
        (who, deed, axis): (&Session, Deed, Option<u16>),
        detail: Value,
        now: Instant,
        then: Option<Go>,
    ) {
        let who = who.clone();
        self.push(Waiting { who, deed, axis, detail, at: now, announced: false, then });
    }

    /// Whether something may be announced.
    ///
    /// # Errors
    /// `gateway.journal` while the disk takes nothing.
    pub fn takes(&self, now: Instant) -> Result<(), Refused> {
        let queue = held(&self.queue);
        let oldest = queue.writing.or_else(|| match queue.entries.front() {
            Some(Entry::Note(waiting)) => Some(waiting.at),
            _ => None,
        });
        let stalls = oldest.is_some_and(|oldest| now.since(oldest) >= STALLED);
        let full = queue.entries.len() >= NOTES_MAX / 2 || queue.bytes >= BYTES_MAX / 2;
        if stalls || full || queue.closed { Err(stalled()) } else { Ok(()) }
    }

    fn push(&self, waiting: Waiting) {
        let bytes = weight(&waiting.detail);
        let mut queue = held(&self.queue);
        if queue.entries.len() < NOTES_MAX && queue.bytes + bytes <= BYTES_MAX && !queue.closed {
            queue.bytes += bytes;
            queue.entries.push_back(Entry::Note(Box::new(waiting)));
            drop(queue);
            self.called.notify_one();
            return;
        }
        match queue.entries.back_mut() {
            Some(Entry::Gap(count)) => *count += 1,
            _ => queue.entries.push_back(Entry::Gap(1)),
        }
        drop(queue);
        waiting.then.into_iter().for_each(|then| then(Err(stalled())));
    }

    /// Nothing more is noted; the scribe ends when all is written.
    pub fn close(&self) {
        held(&self.queue).closed = true;
        self.called.notify_one();
    }

    fn next(&self, now: Instant) -> Option<Entry> {
        let mut queue = held(&self.queue);
        let entry = queue.entries.pop_front();
        if let Some(Entry::Note(waiting)) = &entry {
            queue.bytes -= weight(&waiting.detail);
        }
        queue.writing = entry.is_some().then_some(now);
        entry
    }
}

impl Scribe {
    pub fn new(notes: Arc<Notes>, journal: Arc<dyn Journal>, clock: Clock) -> Self {
        Self { notes, journal, clock, missing: Missing::default() }
    }

    /// Writes until the notes are closed.
    pub fn run(mut self) {
        while self.wait() {
            self.turn();
        }
        self.turn();
        if self.missing.count > 0 && self.tell_missing().is_err() {
            let count = self.missing.count;
            tracing::error!(count, "the journal ends without some of what was done");
        }
    }

    /// Waits for a note. False when none will come.
    fn wait(&self) -> bool {
        let nothing = |queue: &mut Queue| queue.entries.is_empty() && !queue.closed;
        let queue = held(&self.notes.queue);
        let queue: MutexGuard<'_, _> = match self.missing.count {
            0 => {
                self.notes.called.wait_while(queue, nothing).unwrap_or_else(PoisonError::into_inner)
            }
            _ => {
                let waited = self.notes.called.wait_timeout_while(queue, AGAIN, nothing);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
        };
        !queue.closed
    }

    /// Writes what waits.
    pub fn turn(&mut self) {
        while let Some(entry) = self.notes.next(self.clock.now()) {
            match entry {
                Entry::Note(waiting) => self.write(*waiting),
                Entry::Gap(count) => self.missing(count, &stalled()),
            }
        }
        if self.missing.count > 0 && self.clock.now() >= self.missing.again {
            // It is tried again.
            let _ = self.tell_missing();
        }
    }

    fn write(&mut self, mut waiting: Waiting) {
        let then = waiting.then.take();
        if waiting.announced && self.is_late(&waiting) {
            return then.into_iter().for_each(|then| then(Err(stalled())));
        }
        let mut kept = self.keep(&waiting);
        match &kept {
            Err(refused) if !waiting.announced => self.missing(1, refused),
            Ok(()) if waiting.announced && self.is_late(&waiting) => {
                // It says that it was to be done: what follows says that it was not.
                let id = waiting.detail.get("id").cloned();
                let detail = json!({ "id": id, "outcome": "not_done", "error": stalled() });
                let not_done = Waiting { deed: Deed::Outcome, detail, announced: false, ..waiting };
                self.write(not_done);
                kept = Err(stalled());
            }
            _ => {}
        }
        if let Some(then) = then {
            then(kept);
        }
    }

    fn is_late(&self, waiting: &Waiting) -> bool {
        self.clock.now().since(waiting.at) > ANNOUNCED_MAX
    }

    /// Has a record made, behind the one that tells what is missing before it.
    fn keep(&mut self, waiting: &Waiting) -> Result<(), Refused> {
        if self.missing.count > 0 {
            self.tell_missing()?;
        }
        let Waiting { who, deed, axis, detail, .. } = waiting;
        self.journal.note(Note { who, deed: *deed, axis: *axis, detail })
    }

    fn missing(&mut self, count: u64, why: &Refused) {
        if self.missing.count == 0 {
            tracing::error!(%why, "the journal does not keep what is done");
        }
        self.missing.count += count;
        self.missing.why = why.message.clone();
    }

    fn tell_missing(&mut self) -> Result<(), Refused> {
        let Missing { count, why, .. } = &self.missing;
        let detail = json!({ "count": count, "why": why });
        let note = Note { who: SERVER, deed: Deed::Missing, axis: None, detail: &detail };
        let told = self.journal.note(note);
        match told {
            Ok(()) => self.missing = Missing::default(),
            Err(_) => self.missing.again = self.clock.now() + AGAIN,
        }
        told
    }
}

/// About how many bytes a note takes.
fn weight(detail: &Value) -> usize {
    const EACH: usize = 64;
    EACH + match detail {
        Value::String(text) => text.len(),
        Value::Array(all) => all.iter().map(weight).sum(),
        Value::Object(all) => all.iter().map(|(name, value)| name.len() + weight(value)).sum(),
        _ => 0,
    }
}

pub(super) fn stalled() -> Refused {
    Refused::new("gateway.journal", "the journal's disk takes nothing")
        .hint("see to that disk; motors can be stopped meanwhile, not moved")
}
