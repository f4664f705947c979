//! Shared state of all wires of a bench: motion lock, command history, journal, event receivers.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use polepair::LocalAxis;
use polepair_core::time::Instant;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use super::BenchOptions;
use super::clock::BenchClock;
use super::command_history::CommandHistory;
use super::journal_queue::JournalQueue;
use super::journal_sink::SERVER;
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::pending_stop::PendingStop;
use super::reply::Continuation;
use super::reply::ReplySender;
use crate::message::{
    AxisStopReport, CommandOutcome, JournalAction, LeaseView, MotionLock, ScanView, SearchView,
    StopCause,
};

/// Things that happened and that a listener has not heard yet.
const EVENTS_MAX: usize = 1024;

/// Something that happened.
#[derive(Clone, Debug)]
pub enum BenchEvent {
    /// An axis got an owner, or has none any more.
    Lease {
        /// Which axis.
        axis: u16,
        /// Who commands it.
        lease: Option<LeaseView>,
    },
    /// A stop came further.
    Stopped(AxisStopReport),
    /// An axis is owed a stop, or none any more: its state has it.
    PendingStop(u16),
    /// Motion is locked.
    Locked(MotionLock),
    /// Motion is let again.
    Unlocked,
    /// A look for drives is further, or has ended.
    Scan(ScanView),
    /// A search of ports is further, or has ended.
    Search(SearchView),
    /// A link was lost or is back, drives were taken in, or time passes otherwise: the bench's list has it.
    BenchChanged,
}

/// What the wires share.
pub(super) struct BenchContext {
    pub clock: BenchClock,
    pub lease_duration: Duration,
    pub last_epoch: u64,
    /// Axes that the server before this one owed a stop: connection string and number.
    inherited_stops: Mutex<Vec<(String, u32)>>,
    pub journal: Arc<JournalQueue>,
    pub events: broadcast::Sender<BenchEvent>,
    /// Somebody looks for drives: one at a time.
    pub scan_active: AtomicBool,
    command_history: Arc<Mutex<CommandHistory>>,
    motion_lock: Mutex<Option<MotionLock>>,
    /// How often motion was locked; changed with the lock in hand.
    lock_count: AtomicU64,
    closing: AtomicBool,
    /// Who was not seen standing when the bench was closed.
    not_standing: Mutex<Vec<String>>,
}

impl std::fmt::Debug for BenchContext {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").field("clock", &self.clock).finish_non_exhaustive()
    }
}

impl BenchContext {
    pub fn new(clock: BenchClock, options: &BenchOptions) -> Self {
        Self {
            clock,
            lease_duration: options.lease_duration,
            last_epoch: options.last_epoch,
            inherited_stops: Mutex::new(options.inherited_stops.clone()),
            journal: Arc::default(),
            events: broadcast::Sender::new(EVENTS_MAX),
            scan_active: AtomicBool::new(false),
            command_history: Arc::default(),
            motion_lock: Mutex::default(),
            lock_count: AtomicU64::new(0),
            closing: AtomicBool::new(false),
            not_standing: Mutex::default(),
        }
    }

    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Whether the server before this one owed that axis of a link a stop.
    pub fn has_inherited_stop(&self, url: &str, number: u32) -> bool {
        self.inherited_stops_on(url).contains(&number)
    }

    /// The pending stop that an axis of a link has from the server before this one, if it has one.
    pub fn inherited_stop(&self, url: &str, axis: &LocalAxis) -> Option<PendingStop> {
        self.has_inherited_stop(url, axis.number())
            .then(|| PendingStop::new(axis, StopCause::ServerBefore, SERVER.into(), self.now()))
    }

    /// The numbers of those that it owed one on a link.
    pub fn inherited_stops_on(&self, url: &str) -> Vec<u32> {
        let pending = lock_unpoisoned(&self.inherited_stops);
        pending.iter().filter(|(link, _)| link == url).map(|(_, number)| *number).collect()
    }

    /// Owes that axis nothing more of what the server before owed it.
    pub fn remove_inherited_stop(&self, url: &str, number: u32) {
        lock_unpoisoned(&self.inherited_stops)
            .retain(|(link, axis)| (&**link, *axis) != (url, number));
    }

    pub fn lock_history(&self) -> MutexGuard<'_, CommandHistory> {
        lock_unpoisoned(&self.command_history)
    }

    /// Who locked motion.
    pub fn current_lock(&self) -> MutexGuard<'_, Option<MotionLock>> {
        lock_unpoisoned(&self.motion_lock)
    }

    /// How often motion was locked so far.
    pub fn lock_count(&self) -> u64 {
        self.lock_count.load(Ordering::SeqCst)
    }

    /// Locks motion. Who listens is told in the order in which it is locked and let again.
    pub fn lock_motion(&self, motion_lock: MotionLock) {
        let mut lock = self.current_lock();
        self.lock_count.fetch_add(1, Ordering::SeqCst);
        *lock = Some(motion_lock.clone());
        self.publish(BenchEvent::Locked(motion_lock));
    }

    /// Lets motion again, unless it was locked since somebody counted so many locks.
    pub fn unlock_motion(&self, locks: u64) -> bool {
        let mut lock = self.current_lock();
        let newest = self.lock_count() == locks;
        if newest && lock.take().is_some() {
            self.publish(BenchEvent::Unlocked);
        }
        newest
    }

    /// Tells whoever listens.
    pub fn publish(&self, event: BenchEvent) {
        // Nobody may be listening.
        let _ = self.events.send(event);
    }

    /// Has the journal keep what was done already and cannot be refused any more.
    pub fn record(
        &self,
        who: &SessionName,
        action: JournalAction,
        axis: Option<u16>,
        detail: Value,
    ) {
        self.journal.record((who, action, axis), detail, self.now(), None);
    }

    /// Has the journal keep what nobody asked for.
    pub fn record_by_server(&self, action: JournalAction, axis: u16, detail: Value) {
        self.record(&SERVER.into(), action, Some(axis), detail);
    }

    /// Has the journal keep how a command ended, and then tells it to whoever said it, then or again.
    /// What ends motion is told at once.
    pub fn report_outcome(
        &self,
        (who, axis): (&SessionName, u16),
        outcome: CommandOutcome,
        ends_motion: bool,
        reply_sender: ReplySender<CommandOutcome>,
    ) {
        let detail = json!({
            "id": outcome.id, "outcome": outcome.outcome, "error": outcome.error,
        });
        let once = Arc::clone(&self.command_history);
        let reported = move |_| {
            if !ends_motion {
                lock_unpoisoned(&once).finish(&outcome);
            }
            // Who has gone does not want to know.
            let _ = reply_sender.send(Ok(outcome));
        };
        let then: Option<Continuation> = match ends_motion {
            true => {
                reported(Ok(()));
                None
            }
            false => Some(Box::new(reported)),
        };
        self.journal.record((who, JournalAction::Outcome, Some(axis)), detail, self.now(), then);
    }

    /// An axis is left that was not seen standing.
    pub fn add_not_standing(&self, who: String) {
        lock_unpoisoned(&self.not_standing).push(who);
    }

    /// All of these.
    pub fn drain_not_standing(&self) -> Vec<String> {
        std::mem::take(&mut *lock_unpoisoned(&self.not_standing))
    }

    pub fn close(&self) {
        self.closing.store(true, Ordering::SeqCst);
    }

    pub fn is_closing(&self) -> bool {
        self.closing.load(Ordering::SeqCst)
    }
}

impl Drop for BenchContext {
    /// Whoever could note something has gone.
    fn drop(&mut self) {
        self.journal.close();
    }
}
