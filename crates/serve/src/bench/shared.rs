//! What the wires of a bench share: the lock, the commands that were seen, the journal, those who
//! want to hear what happens.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::time::Instant;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use super::Options;
use super::clock::Clock;
use super::lease::Session;
use super::notes::Notes;
use super::once::Once;
use super::wire::{Go, Tell};
use crate::message::{AxisStopped, Deed, LeaseTold, LockTold, LookView, Outcome, Refused};

/// Things that happened and that a listener has not heard yet.
const EVENTS_MAX: usize = 1024;
/// Who did what nobody asked for.
pub(super) const SERVER: &str = "server";

/// Keeps what is done: see [`Options::journal`](super::Options::journal).
///
/// It is told before anything is sent, stops excepted: those go first. One thread calls it, which looks
/// after nothing else, so it may wait for a disk.
pub trait Journal: Send + Sync {
    /// Takes a note, and returns once it is kept.
    ///
    /// # Errors
    /// When it cannot be kept: what it announces is then not done, and a [`Deed::Missing`] counts what
    /// was done.
    fn note(&self, note: Note<'_>) -> Result<(), Refused>;
}

/// What is about to be done, or was.
#[derive(Debug)]
pub struct Note<'a> {
    /// The session; `server` for what nobody asked for.
    pub who: &'a str,
    /// What.
    pub deed: Deed,
    /// The axis that it concerns.
    pub axis: Option<u16>,
    /// The rest.
    pub detail: &'a Value,
}

/// A journal that keeps nothing, for benches that nobody else commands.
#[derive(Debug)]
pub struct NoJournal;

impl Journal for NoJournal {
    fn note(&self, _note: Note<'_>) -> Result<(), Refused> {
        Ok(())
    }
}

/// Something that happened.
#[derive(Clone, Debug)]
pub enum Event {
    /// An axis got an owner, or has none any more.
    Lease {
        /// Which axis.
        axis: u16,
        /// Who commands it.
        lease: Option<LeaseTold>,
    },
    /// A stop came further.
    Stopped(AxisStopped),
    /// An axis is owed a stop, or none any more: its state has it.
    Owed(u16),
    /// Motion is locked.
    Locked(LockTold),
    /// Motion is let again.
    Unlocked,
    /// A look for drives is further, or has ended.
    Look(LookView),
    /// A link was lost or is back, drives were taken in, or time passes otherwise: the bench's list has it.
    Bench,
}

/// What the wires share.
pub(super) struct Shared {
    pub clock: Clock,
    pub lease: Duration,
    pub last_epoch: u64,
    /// Axes that the server before this one owed a stop: connection string and number.
    owed_before: Mutex<Vec<(String, u32)>>,
    pub notes: Arc<Notes>,
    pub events: broadcast::Sender<Event>,
    /// Somebody looks for drives: one at a time.
    pub looking: AtomicBool,
    once: Arc<Mutex<Once>>,
    lock: Mutex<Option<LockTold>>,
    /// How often motion was locked; changed with the lock in hand.
    locks: AtomicU64,
    closing: AtomicBool,
    /// Who was not seen standing when the bench was closed.
    left: Mutex<Vec<String>>,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").field("clock", &self.clock).finish_non_exhaustive()
    }
}

impl Shared {
    pub fn new(clock: Clock, options: &Options) -> Self {
        Self {
            clock,
            lease: options.lease,
            last_epoch: options.last_epoch,
            owed_before: Mutex::new(options.owed_before.clone()),
            notes: Arc::default(),
            events: broadcast::Sender::new(EVENTS_MAX),
            looking: AtomicBool::new(false),
            once: Arc::default(),
            lock: Mutex::default(),
            locks: AtomicU64::new(0),
            closing: AtomicBool::new(false),
            left: Mutex::default(),
        }
    }

    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Whether the server before this one owed that axis of a link a stop.
    pub fn is_owed_before(&self, url: &str, number: u32) -> bool {
        self.owed_before_on(url).contains(&number)
    }

    /// The numbers of those that it owed one on a link.
    pub fn owed_before_on(&self, url: &str) -> Vec<u32> {
        let owed = held(&self.owed_before);
        owed.iter().filter(|(link, _)| link == url).map(|(_, number)| *number).collect()
    }

    /// Owes that axis nothing more of what the server before owed it.
    pub fn forget_owed_before(&self, url: &str, number: u32) {
        held(&self.owed_before).retain(|(link, axis)| (&**link, *axis) != (url, number));
    }

    pub fn once(&self) -> MutexGuard<'_, Once> {
        held(&self.once)
    }

    /// Who locked motion.
    pub fn lock(&self) -> MutexGuard<'_, Option<LockTold>> {
        held(&self.lock)
    }

    /// How often motion was locked so far.
    pub fn locks(&self) -> u64 {
        self.locks.load(Ordering::SeqCst)
    }

    /// Locks motion. Who listens is told in the order in which it is locked and let again.
    pub fn lock_motion(&self, told: LockTold) {
        let mut lock = self.lock();
        self.locks.fetch_add(1, Ordering::SeqCst);
        *lock = Some(told.clone());
        self.tell(Event::Locked(told));
    }

    /// Lets motion again, unless it was locked since somebody counted so many locks.
    pub fn unlock_motion(&self, locks: u64) -> bool {
        let mut lock = self.lock();
        let newest = self.locks() == locks;
        if newest && lock.take().is_some() {
            self.tell(Event::Unlocked);
        }
        newest
    }

    /// Tells whoever listens.
    pub fn tell(&self, event: Event) {
        // Nobody may be listening.
        let _ = self.events.send(event);
    }

    /// Has the journal keep what was done already and cannot be refused any more.
    pub fn noted(&self, who: &Session, deed: Deed, axis: Option<u16>, detail: Value) {
        self.notes.done((who, deed, axis), detail, self.now(), None);
    }

    /// Has the journal keep what nobody asked for.
    pub fn noted_by_server(&self, deed: Deed, axis: u16, detail: Value) {
        self.noted(&SERVER.into(), deed, Some(axis), detail);
    }

    /// Has the journal keep how a command ended, and then tells it to whoever said it, then or again.
    /// What ends motion is told at once.
    pub fn ended(
        &self,
        (who, axis): (&Session, u16),
        outcome: Outcome,
        ends_motion: bool,
        tell: Tell<Outcome>,
    ) {
        let detail = json!({
            "id": outcome.id, "outcome": outcome.outcome, "error": outcome.error,
        });
        let once = Arc::clone(&self.once);
        let told = move |_| {
            held(&once).ended(&outcome);
            // Who has gone does not want to know.
            let _ = tell.send(Ok(outcome));
        };
        let then: Option<Go> = match ends_motion {
            true => {
                told(Ok(()));
                None
            }
            false => Some(Box::new(told)),
        };
        self.notes.done((who, Deed::Outcome, Some(axis)), detail, self.now(), then);
    }

    /// An axis is left that was not seen standing.
    pub fn leaves(&self, who: String) {
        held(&self.left).push(who);
    }

    /// All of these.
    pub fn left(&self) -> Vec<String> {
        std::mem::take(&mut *held(&self.left))
    }

    pub fn close(&self) {
        self.closing.store(true, Ordering::SeqCst);
    }

    pub fn is_closing(&self) -> bool {
        self.closing.load(Ordering::SeqCst)
    }
}

impl Drop for Shared {
    /// Whoever could note something has gone.
    fn drop(&mut self) {
        self.notes.close();
    }
}

/// What is behind a lock, whatever became of who had it.
pub(super) fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
