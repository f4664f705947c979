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
use super::journal_queue::{ActionSubject, JournalQueue};
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

/// Limit of events that a listener has not received yet.
const EVENTS_MAX: usize = 1024;

/// Something that happened.
#[derive(Clone, Debug)]
pub enum BenchEvent {
    /// An axis got an owner, or has none any more.
    Lease {
        /// Axis of the bench.
        axis: u16,
        /// New holder of the lease.
        lease: Option<LeaseView>,
    },
    /// A stop came further.
    Stopped(AxisStopReport),
    /// An axis has a pending stop, or none any more: its state has it.
    PendingStop(u16),
    /// Motion is locked.
    Locked(MotionLock),
    /// Motion is allowed again.
    Unlocked,
    /// A look for drives is further, or has ended.
    Scan(ScanView),
    /// A search of ports is further, or has ended.
    Search(SearchView),
    /// A link was lost or is back, drives were taken in, or time passes otherwise: the bench's list has it.
    BenchChanged,
}

/// State shared by the wires.
pub(super) struct BenchContext {
    pub clock: BenchClock,
    pub lease_duration: Duration,
    pub last_epoch: u64,
    /// Axes with a pending stop of the previous server: connection string and number.
    inherited_stops: Mutex<Vec<(String, u32)>>,
    pub journal: Arc<JournalQueue>,
    pub events: broadcast::Sender<BenchEvent>,
    /// True during a scan: one at a time.
    pub scan_active: AtomicBool,
    command_history: Arc<Mutex<CommandHistory>>,
    motion_lock: Mutex<Option<MotionLock>>,
    /// Number of locks of motion; changed with the lock in hand.
    lock_count: AtomicU64,
    closing: AtomicBool,
    /// Axes without measured standstill when the bench was closed.
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

    /// Returns whether that axis of a link has a pending stop of the previous server.
    pub fn has_inherited_stop(&self, url: &str, number: u32) -> bool {
        self.inherited_stops_on(url).contains(&number)
    }

    /// The pending stop that an axis of a link has from the server before this one, if it has one.
    pub fn inherited_stop(&self, url: &str, axis: &LocalAxis) -> Option<PendingStop> {
        self.has_inherited_stop(url, axis.number())
            .then(|| PendingStop::new(axis, StopCause::ServerBefore, SERVER.into(), self.now()))
    }

    /// Numbers of axes on a link with a pending stop of the previous server.
    pub fn inherited_stops_on(&self, url: &str) -> Vec<u32> {
        let pending = lock_unpoisoned(&self.inherited_stops);
        pending.iter().filter(|(link, _)| link == url).map(|(_, number)| *number).collect()
    }

    /// Clears the inherited pending stop of that axis.
    pub fn remove_inherited_stop(&self, url: &str, number: u32) {
        lock_unpoisoned(&self.inherited_stops)
            .retain(|(link, axis)| (&**link, *axis) != (url, number));
    }

    pub fn lock_history(&self) -> MutexGuard<'_, CommandHistory> {
        lock_unpoisoned(&self.command_history)
    }

    /// The present lock of motion.
    pub fn current_lock(&self) -> MutexGuard<'_, Option<MotionLock>> {
        lock_unpoisoned(&self.motion_lock)
    }

    /// Number of locks of motion so far.
    pub fn lock_count(&self) -> u64 {
        self.lock_count.load(Ordering::SeqCst)
    }

    /// Locks motion. Listeners receive locks and releases in their order.
    pub fn lock_motion(&self, motion_lock: MotionLock) {
        let mut lock = self.current_lock();
        self.lock_count.fetch_add(1, Ordering::SeqCst);
        *lock = Some(motion_lock.clone());
        self.publish(BenchEvent::Locked(motion_lock));
    }

    /// Allows motion again, unless it was locked more often than `locks` times.
    pub fn unlock_motion(&self, locks: u64) -> bool {
        let mut lock = self.current_lock();
        let newest = self.lock_count() == locks;
        if newest && lock.take().is_some() {
            self.publish(BenchEvent::Unlocked);
        }
        newest
    }

    /// Sends an event to all listeners.
    pub fn publish(&self, event: BenchEvent) {
        // There may be no listener.
        let _ = self.events.send(event);
    }

    /// Records an act that was done already and cannot be refused any more.
    pub fn record(
        &self,
        who: &SessionName,
        action: JournalAction,
        axis: Option<u16>,
        detail: Value,
    ) {
        self.journal.record(ActionSubject::new(who, action, axis), detail, self.now(), None);
    }

    /// Records an action of the server itself in the journal.
    pub fn record_by_server(&self, action: JournalAction, axis: u16, detail: Value) {
        self.record(&SERVER.into(), action, Some(axis), detail);
    }

    /// Records the end of a command in the journal, and then sends it to all clients that requested it. The outcome of
    /// a stop is sent at once.
    pub fn report_outcome(
        &self,
        receiver: (&SessionName, u16),
        outcome: CommandOutcome,
        ends_motion: bool,
        reply_sender: ReplySender<CommandOutcome>,
    ) {
        let (who, axis) = receiver;

        let detail = json!({
            "id": outcome.id, "outcome": outcome.outcome, "error": outcome.error,
        });
        let once = Arc::clone(&self.command_history);
        let reported = move |_| {
            if !ends_motion {
                lock_unpoisoned(&once).finish(&outcome);
            }
            // The receiver may have been dropped.
            let _ = reply_sender.send(Ok(outcome));
        };
        let then: Option<Continuation> = if ends_motion {
            reported(Ok(()));
            None
        } else {
            Some(Box::new(reported))
        };
        self.journal.record(
            ActionSubject::new(who, JournalAction::Outcome, Some(axis)),
            detail,
            self.now(),
            then,
        );
    }

    /// Notes an axis that is left without confirmed standstill.
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
    /// No thread is left that could record anything.
    fn drop(&mut self) {
        self.journal.close();
    }
}
