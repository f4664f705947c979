//! Requests and public state of a wire. The command worker reads its requests here.

use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::Thread;

use polepair::LocalAxis;
use polepair::axis::PreparedCommand;
use polepair_core::axis::Command;
use polepair_core::time::Instant;

use super::AXES_MAX;
use super::append_only_vec::AppendOnlyVec;
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::pending_stop::StopCollector;
use super::reply::{Continuation, ReplySender};
use super::scan_flag::{ScanFlag, scan_error};
use super::state::axis_state;
use crate::message::{
    CommandOutcome, DismissStop, GatewayError, LeaseGrant, LeaseView, PendingStopView,
};

/// Orders that wait for one wire; stops have places of their own.
const REQUESTS_MAX: usize = 1024;
/// Stops that wait for one wire; the axes of more are added to the last.
// More batches than viewers that can ask at once; beyond them stops are merged, not dropped.
const STOPS_MAX: usize = 64;

/// Sends the pending stops of a wire on the calling thread, if its worker is not at work.
pub(super) type StopSender = Box<dyn Fn() + Send + Sync>;

/// A wire and its axes.
pub(super) struct BenchWire {
    /// Axes of the wire, with their numbers in the bench.
    pub axes: AppendOnlyVec<(u16, LocalAxis)>,
    /// True during a scan of the wire.
    pub scan_flag: ScanFlag,
    /// Begin of the bench's time, on the wire's clock.
    pub time_origin: OnceLock<Instant>,
    /// Requests with their numbers, in order of arrival.
    requests: Mutex<VecDeque<(u64, WireRequest)>>,
    stops: Mutex<VecDeque<StopBatch>>,
    worker: OnceLock<(Thread, StopSender)>,
    leases: Mutex<Vec<Option<LeaseView>>>,
    pending_stops: Mutex<Vec<Option<PendingStopView>>>,
    /// Axes whose drives the server alone set to watch this host.
    host_watched: Mutex<BTreeSet<usize>>,
    /// Axes of the bench whose drives have just started.
    restarted: Mutex<Vec<u16>>,
    link_error: Mutex<Option<(Instant, GatewayError)>>,
    clash: Mutex<Option<String>>,
    /// Requests arrived since the command worker last ran.
    wakeup: AtomicBool,
    /// Orders and stops so far.
    request_count: AtomicU64,
    /// Stops so far.
    stop_count: AtomicU64,
}

/// A request to a command worker.
pub(super) enum WireRequest {
    /// A lease is wanted, kept, or given back.
    Lease(LeaseRequest),
    /// An axis is to do something.
    Command(Box<QueuedCommand>),
    /// A write that moves nothing: `then` gets the permission.
    Write { axis: usize, session: SessionName, epoch: u64, then: Continuation },
    /// A scan: the continuation gets the permission.
    Scan(Continuation),
    /// A client has gone: its leases end.
    SessionEnded(SessionName),
    /// Clears the pending stop of an axis.
    Dismiss(DismissRequest),
    /// The journal did not keep that a lease was given.
    LeaseNotRecorded { axis: usize, epoch: u64 },
}

/// Action on a lease.
#[derive(Debug)]
pub(super) struct LeaseRequest {
    pub axis: usize,
    pub session: SessionName,
    pub action: crate::message::LeaseAction,
    pub epoch: u64,
    pub reply: ReplySender<Option<LeaseGrant>>,
}

/// Dismissal of a pending stop.
#[derive(Debug)]
pub(super) struct DismissRequest {
    pub axis: usize,
    pub session: SessionName,
    pub dismiss: DismissStop,
    pub reply: ReplySender<()>,
}

/// Header of every command.
#[derive(Debug)]
pub(super) struct CommandHeader {
    pub id: String,
    pub issued_ms: f64,
    pub ttl_ms: f64,
    pub epoch: u64,
}

/// A command on its way.
#[derive(Debug)]
pub(super) struct QueuedCommand {
    pub axis: usize,
    pub session: SessionName,
    pub header: CommandHeader,
    pub action: CommandAction,
    /// Made ready, where that took a question.
    pub prepared: Option<Result<PreparedCommand, GatewayError>>,
    pub reply: ReplySender<CommandOutcome>,
}

/// Meaning of a command's word.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum CommandAction {
    /// Let motion commands through, or no longer.
    Arm(bool),
    /// Run a command of the drive.
    Run(Command),
    /// A request in the protocol's own text, of unknown effect.
    Raw(String),
}

impl CommandAction {
    /// Returns whether a motor may move by it.
    pub fn may_move(&self) -> bool {
        match self {
            Self::Arm(armed) => *armed,
            Self::Run(command) => command.verb.needs_arming(),
            Self::Raw(_) => true,
        }
    }

    /// Returns whether nothing moves once it is done.
    pub fn is_stop(&self) -> bool {
        matches!(self, Self::Run(command) if command.verb.is_stop())
    }

    /// Returns whether it only keeps an axis from moving: it waits for no journal.
    pub fn ends_motion(&self) -> bool {
        self.is_stop() || *self == Self::Arm(false)
    }
}

/// Axes that are to stop.
#[derive(Debug)]
pub(super) struct StopBatch {
    /// With the number of the stop among the wire's orders and stops, which the wire gives it: axes
    /// that were added have one of their own.
    pub axes: Vec<(usize, u64)>,
    pub session: SessionName,
    pub reason: String,
    pub requested_at: Instant,
    pub collector: Option<Arc<StopCollector>>,
}

impl LeaseRequest {
    /// Returns whether the lease gets a new holder.
    pub fn is_acquire(&self) -> bool {
        use crate::message::LeaseAction::{Take, TakeOver};
        matches!(self.action, Take | TakeOver)
    }
}

/// Error of a motion command that arrived behind a stop that was requested after it.
pub(crate) fn overtaken_error() -> GatewayError {
    GatewayError::new("gateway.expired", "a stop was sent after this")
        .hint("send it again, if it is still wanted")
}

fn queue_full_error() -> GatewayError {
    GatewayError::new("gateway.busy", "too many commands wait for this link").hint("ask less often")
}

impl StopBatch {
    fn merge(&mut self, other: Self) {
        for (axis, sequence) in other.axes {
            match self.axes.iter_mut().find(|(known, _)| *known == axis) {
                Some((_, known)) => *known = sequence.max(*known),
                None => self.axes.push((axis, sequence)),
            }
        }
    }
}

impl BenchWire {
    pub fn new(axes: Vec<(u16, LocalAxis)>) -> Self {
        Self {
            leases: Mutex::new(vec![None; axes.len()]),
            pending_stops: Mutex::new(vec![None; axes.len()]),
            host_watched: Mutex::default(),
            restarted: Mutex::default(),
            axes: AppendOnlyVec::new(AXES_MAX, axes),
            scan_flag: ScanFlag::default(),
            time_origin: OnceLock::new(),
            requests: Mutex::default(),
            stops: Mutex::default(),
            worker: OnceLock::new(),
            link_error: Mutex::default(),
            clash: Mutex::default(),
            wakeup: AtomicBool::new(false),
            request_count: AtomicU64::new(0),
            stop_count: AtomicU64::new(0),
        }
    }

    /// Adds an axis, with its number among all of the bench, and returns its place on this wire. Its
    /// pending stop is shown from the first moment on, before the command worker sends it.
    pub fn add_axis(
        &self,
        id: u16,
        axis: LocalAxis,
        pending_stop: Option<PendingStopView>,
    ) -> Option<usize> {
        lock_unpoisoned(&self.leases).push(None);
        lock_unpoisoned(&self.pending_stops).push(pending_stop);
        self.axes.push((id, axis))
    }

    /// Present time of the wire, and the time of the bench's start on it; nothing without axes.
    pub fn time(&self) -> Option<(Instant, Instant)> {
        let now = self.axes.first()?.1.connection().now();
        Some((now, *self.time_origin.get_or_init(|| now)))
    }

    /// Begin of the bench's time, on the wire's clock.
    pub fn time_origin(&self) -> Instant {
        self.time_origin.get().copied().unwrap_or(Instant::ZERO)
    }

    /// The thread that is woken for requests, and what sends pending stops if that thread is not at work.
    pub fn set_worker(&self, thread: Thread, send_stops: StopSender) {
        let _ = self.worker.set((thread, send_stops));
    }

    /// Gives an order.
    pub fn submit(&self, request: WireRequest) -> Result<(), GatewayError> {
        {
            let mut motions = lock_unpoisoned(&self.requests);
            if motions.len() >= REQUESTS_MAX {
                return Err(queue_full_error());
            }
            // Numbered under the lock, so that the order of numbers is that of the queue.
            motions.push_back((self.next_number(), request));
        }
        self.wake_worker();
        Ok(())
    }

    /// Takes a number for an order that is given when the journal has it: a stop that comes between
    /// goes before.
    pub fn reserve_number(&self) -> Result<u64, GatewayError> {
        if lock_unpoisoned(&self.requests).len() < REQUESTS_MAX {
            Ok(self.next_number())
        } else {
            Err(queue_full_error())
        }
    }

    /// Gives an order that was announced. There is room: no more are announced at once than notes wait.
    pub fn submit_reserved(&self, sequence: u64, request: WireRequest) {
        lock_unpoisoned(&self.requests).push_back((sequence, request));
        self.wake_worker();
    }

    /// Gives an order that had its place already, with the number that it had.
    pub fn submit_first(&self, sequence: u64, request: WireRequest) {
        lock_unpoisoned(&self.requests).push_front((sequence, request));
        self.wake_worker();
    }

    fn next_number(&self) -> u64 {
        self.request_count.fetch_add(1, Ordering::SeqCst)
    }

    /// Orders a stop: there is always room for one.
    pub fn submit_stop(&self, mut stop: StopBatch) {
        self.scan_flag.cancel();
        self.stop_count.fetch_add(1, Ordering::SeqCst);
        {
            let mut stops = lock_unpoisoned(&self.stops);
            // Numbered where it is queued: no later stop comes before an earlier one.
            let sequence = self.next_number();
            stop.axes.iter_mut().for_each(|(_, its)| *its = sequence);
            debug_assert!(stops.len() <= STOPS_MAX);
            let stops_full = stops.len() == STOPS_MAX;
            match stops.back_mut().filter(|_| stops_full) {
                // The stop itself is not lost, only the word of how far it came.
                Some(last) => last.merge(stop),
                None => stops.push_back(stop),
            }
        }
        self.wake_worker();
    }

    /// Number of stops ordered so far.
    pub fn stop_count(&self) -> u64 {
        self.stop_count.load(Ordering::SeqCst)
    }

    /// Checks that no axis of it is commanded, has a pending stop, is armed or turns: then no client waits for a scan
    /// there.
    pub fn check_at_rest(&self) -> Result<(), GatewayError> {
        for (index, (id, axis)) in self.axes.iter().enumerate() {
            let (label, state) = (axis.label(), axis_state(*id, axis));
            if let Some(lease) = self.lease(index) {
                let what = format!("{} commands {label}", lease.owner);
                return refused_scan(what, "wait until it is released: it could not be controlled");
            }
            if self.pending_stop(index).is_some() {
                return refused_scan(
                    format!("{label} is being stopped"),
                    "wait until it is at \
                 standstill",
                );
            }
            // A scan takes the wire for a request at a time, and the stop of a turning motor would wait for it.
            if state.armed || state.moving == Some(true) {
                return refused_scan(
                    format!("{label} is armed or turns"),
                    "stop and disarm it first",
                );
            }
        }
        Ok(())
    }

    /// The next stop.
    pub fn next_stop(&self) -> Option<StopBatch> {
        lock_unpoisoned(&self.stops).pop_front()
    }

    /// The next order.
    pub fn next_request(&self) -> Option<(u64, WireRequest)> {
        lock_unpoisoned(&self.requests).pop_front()
    }

    /// Wakes the command worker.
    pub fn wake_worker(&self) {
        // Before the thread is woken, which may look at it at once.
        self.wakeup.store(true, Ordering::SeqCst);
        if let Some((thread, _)) = self.worker.get() {
            thread.unpark();
        }
    }

    /// Sends pending stops on this thread, because the worker's thread may take a while to wake.
    /// Where the worker is running, or the last stop took long to write, its own thread sends them.
    pub fn send_stops(&self) {
        if let Some((_, send_stops)) = self.worker.get() {
            send_stops();
        }
    }

    /// Returns whether the worker was woken since the last call.
    pub fn clear_wakeup(&self) -> bool {
        self.wakeup.swap(false, Ordering::SeqCst)
    }

    /// Holder of an axis' lease.
    pub fn lease(&self, axis: usize) -> Option<LeaseView> {
        lock_unpoisoned(&self.leases).get(axis).cloned().flatten()
    }

    pub fn set_lease(&self, axis: usize, lease: Option<LeaseView>) {
        if let Some(shown) = lock_unpoisoned(&self.leases).get_mut(axis) {
            *shown = lease;
        }
    }

    /// Pending stop of an axis.
    pub fn pending_stop(&self, axis: usize) -> Option<PendingStopView> {
        lock_unpoisoned(&self.pending_stops).get(axis).cloned().flatten()
    }

    pub fn set_pending_stop(&self, axis: usize, pending: Option<PendingStopView>) {
        if let Some(shown) = lock_unpoisoned(&self.pending_stops).get_mut(axis) {
            *shown = pending;
        }
    }

    /// Records whether the drive of an axis watches this host by the server's own setting.
    pub fn set_host_watched(&self, axis: usize, own: bool) {
        let mut watching = lock_unpoisoned(&self.host_watched);
        if own {
            watching.insert(axis)
        } else {
            watching.remove(&axis)
        };
    }

    /// Ends the watch of this host by drives that the server set to it, except those with a pending stop.
    pub fn end_host_watch(&self) {
        let own = std::mem::take(&mut *lock_unpoisoned(&self.host_watched));
        // A motor whose standstill was not confirmed keeps its watchdog: it is the last thing that can stop
        // it.
        for axis in own.into_iter().filter(|axis| self.pending_stop(*axis).is_none()) {
            let (id, axis) = &self.axes[axis];
            let ended = match axis.connection().link_error() {
                Some(error) => Err(error.into()),
                None => axis.set_watchdog(None),
            };
            if let Err(error) = ended {
                tracing::warn!(axis = id, %error, "cannot turn off the watchdog of the drive");
            }
        }
    }

    /// Records that the drive of an axis has just started: values in its memory are gone.
    pub fn record_restart(&self, id: u16) {
        lock_unpoisoned(&self.restarted).push(id);
    }

    /// Takes the axes that restarted since the last call.
    pub fn drain_restarted(&self) -> Vec<u16> {
        std::mem::take(&mut *lock_unpoisoned(&self.restarted))
    }

    /// Why the link is not open, and since when, if it is not.
    pub fn link_error(&self) -> Option<(Instant, GatewayError)> {
        lock_unpoisoned(&self.link_error).clone()
    }

    pub fn set_link_error(&self, why: Option<(Instant, GatewayError)>) {
        *lock_unpoisoned(&self.link_error) = why;
    }

    /// Description of other hosts on the wire, if any are detected.
    pub fn clash(&self) -> Option<String> {
        lock_unpoisoned(&self.clash).clone()
    }

    pub fn set_clash(&self, what: Option<String>) {
        *lock_unpoisoned(&self.clash) = what;
    }
}

fn refused_scan(what: String, hint: &str) -> Result<(), GatewayError> {
    Err(scan_error(what).hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(wire: &BenchWire, axes: &[usize]) {
        let axes = axes.iter().map(|axis| (*axis, 0)).collect();
        let (who, reason, since) = ("ann".into(), String::new(), Instant::ZERO);
        wire.submit_stop(StopBatch {
            axes,
            session: who,
            reason,
            requested_at: since,
            collector: None,
        });
    }

    #[test]
    fn stops_come_in_the_order_of_their_numbers_whoever_says_them() {
        let wire = BenchWire::new(Vec::new());
        let last = std::thread::scope(|scope| {
            let two = [0, 1].map(|axis| {
                let wire = &wire;
                scope.spawn(move || (0..20_000).for_each(|_| stop(wire, &[axis])))
            });
            let (mut last, mut ended) = (0, false);
            loop {
                while let Some(stop) = wire.next_stop() {
                    let first = stop.axes.iter().map(|(_, sequence)| *sequence).min().unwrap();
                    assert!(first >= last, "{first} behind {last}");
                    last = stop.axes.iter().map(|(_, sequence)| *sequence).max().unwrap();
                }
                if ended {
                    return last;
                }
                ended = two.iter().all(std::thread::ScopedJoinHandle::is_finished);
            }
        });
        assert_eq!(last, 39_999);
    }

    #[test]
    fn axes_of_stops_that_are_put_together_keep_their_numbers() {
        let wire = BenchWire::new(Vec::new());
        (0..STOPS_MAX).for_each(|_| stop(&wire, &[0]));
        stop(&wire, &[1]);
        stop(&wire, &[0, 2]);
        let stops: Vec<_> = std::iter::from_fn(|| wire.next_stop()).collect();
        let n = STOPS_MAX as u64;
        assert_eq!(stops.len(), STOPS_MAX);
        assert_eq!(stops[STOPS_MAX - 1].axes, [(0, n + 1), (1, n), (2, n + 1)]);
    }
}
