//! A lane on a link, shared by any number of threads.
//!
//! One lock and one leader: any thread may lock, submit and write. The lock is never held while waiting.
//! The first waiting thread leads: it reads for all, wakes the others by their tickets, and passes the lead
//! on when it leaves. The background thread leads if no caller waits and work is pending: a plan, a link to
//! be reopened, an event stream. It is started at its first use, and gives way to callers at once.

mod background;
mod borrow;
mod erased;
mod leader;
mod mailbox;
mod slots;
mod state;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, Weak};
use std::task;
use std::time::Duration;

use polepair_core::axis::Axes;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::Medium;
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::LinkError;
use crate::link::{LinkIo, Losses};
use erased::ErasedConnection;
use slots::RequestSlots;
use state::ConnectionState;

pub use borrow::BorrowedLink;
pub use mailbox::{ConnectionEvent, ListenerGuard, Mailbox};
pub use slots::PENDING_MAX;

/// Lane of a connection, with protocol, family and host erased.
pub use polepair_core::axis::AnyLane;

/// A lane on a link. Clones are the same connection; the last one dropped closes it.
#[derive(Clone, Debug)]
pub struct Connection(Arc<Owner>);

impl Connection {
    /// Puts `lane` on `link`. The link is set to the lane's line already.
    #[must_use]
    pub fn new<M: Medium>(link: Box<dyn LinkIo<M>>, lane: Box<dyn AnyLane<M>>) -> Self {
        Self(Arc::new(Owner(ConnectionInner::new(link, lane))))
    }

    /// Submits a request: `request` gets the axes, the present time and the ticket to use. What
    /// can go out at once is on the wire when this returns.
    ///
    /// While the link is down (and one attempt to open it again has failed) the request is not
    /// submitted, and the outcome is `NotDone(LinkDown)`.
    ///
    /// # Errors
    /// [`Unsupported`] as `request` gave it: nothing was sent. [`Unsupported::Busy`] when
    /// [`PENDING_MAX`] requests are pending.
    pub fn submit(
        &self,
        request: impl FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<PendingRequest, Unsupported> {
        self.submit_in_turn(Instant::ZERO, request)
    }

    /// Submits a request. While many others are pending and the lane takes no more, it waits for its
    /// turn until `deadline`, and calls `request` again.
    ///
    /// # Errors
    /// As [`submit`](Self::submit).
    pub fn submit_in_turn(
        &self,
        deadline: Instant,
        mut request: impl FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<PendingRequest, Unsupported> {
        let (ticket, interrupts) = self.0.0.submit(deadline, &mut request)?;
        Ok(PendingRequest { connection: self.clone(), ticket, interrupts, outcome: None })
    }

    /// Submits a request in turn and waits for its outcome, `None` at `deadline` or after an
    /// interrupt.
    ///
    /// # Errors
    /// As [`submit`](Self::submit).
    pub fn request(
        &self,
        deadline: Instant,
        request: impl FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<Option<Outcome>, Unsupported> {
        Ok(match self.submit_in_turn(deadline, request)?.wait(deadline) {
            WaitResult::Ended(outcome) => Some(outcome),
            WaitResult::TimedOut | WaitResult::Interrupted => None,
        })
    }

    /// Calls `look` with the axes: to read states and profiles, convert, arm, rehearse. Do not
    /// wait in it; everybody else does meanwhile.
    pub fn with_axes<R>(&self, query: impl FnOnce(&mut dyn Axes, Instant) -> R) -> R {
        let (mut query, mut seen) = (Some(query), None);
        self.0.0.with_axes(&mut |axes, now| seen = query.take().map(|query| query(axes, now)));
        seen.expect("an engine lends its axes once")
    }

    /// The present time of the link.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.0.0.now()
    }

    /// The [scale of time-outs](clock::timeout_scale) on this link: 1 in virtual time.
    #[must_use]
    pub fn timeout_scale(&self) -> u32 {
        if self.0.0.is_real_time() { clock::timeout_scale() } else { 1 }
    }

    /// Scales a time-out in the same way.
    #[must_use]
    pub fn scale_timeout(&self, timeout: Duration) -> Duration {
        if self.0.0.is_real_time() { clock::scale_timeout(timeout) } else { timeout }
    }

    /// Records events in `mailbox`, as of the connection `source`, until the guard is dropped: events of all
    /// axes or of one, and of the link. Where no other thread reads the link, the background thread does.
    pub fn listen(
        &self,
        mailbox: &Mailbox,
        source: usize,
        axis: Option<AxisIndex>,
    ) -> ListenerGuard {
        self.0.0.add_listener(mailbox::MailboxListener { mailbox: mailbox.clone(), source, axis });
        ListenerGuard { connection: self.clone(), mailbox: mailbox.clone(), source }
    }

    /// Processes received data without waiting, unless another thread is reading.
    pub fn catch_up(&self) {
        self.0.0.catch_up();
    }

    /// Lends the link as soon as no request of this connection is running. Until the result is dropped,
    /// requests that are submitted here wait and are not sent; [`submit`](Self::submit) does not block.
    /// Messages that drives send by themselves on a serial line meanwhile are lost. `None` when requests were
    /// running all the time until then, or the link is of another medium; at once when drives have to be kept
    /// alive (heartbeat, SYNC, a watchdog).
    ///
    /// # Errors
    /// [`LinkError`] while the link is down.
    pub fn borrow_link<M: Medium>(
        &self,
        until: Instant,
    ) -> Result<Option<BorrowedLink<M>>, LinkError> {
        let borrowed = self.0.0.borrow_link(until)?;
        Ok(borrowed
            .and_then(|borrowed| borrowed.downcast().ok())
            .map(|borrowed_link| *borrowed_link))
    }

    /// Cause of the link's failure; `None` while it works.
    #[must_use]
    pub fn link_error(&self) -> Option<LinkError> {
        self.0.0.link_error()
    }

    /// Closes the link at once, for all clones: running requests end as when the link is lost, and later
    /// requests end with [`Cause::Closed`](crate::Cause::Closed). It is never opened again.
    pub fn close(&self) {
        self.0.0.close();
    }

    /// Returns whether both are clones of one connection.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Name of the link.
    #[must_use]
    pub fn describe(&self) -> String {
        self.0.0.describe()
    }

    /// Losses on the link since it was last opened.
    #[must_use]
    pub fn losses(&self) -> Losses {
        self.0.0.losses()
    }

    /// Baud or bit rate that the line is set to now; `None` where it has none, or another program sets it.
    #[must_use]
    pub fn line_rate(&self) -> Option<u32> {
        Some(self.0.0.line_rate()).filter(|rate| *rate > 0)
    }

    #[cfg(test)]
    pub(crate) fn slot_count(&self) -> usize {
        self.0.0.slot_count()
    }

    /// A handle that ends waits from another thread, for instance after Ctrl-C.
    #[must_use]
    pub fn interrupter(&self) -> Interrupter {
        Interrupter(Arc::downgrade(&self.0.0))
    }
}

/// A request under way. Dropped before its end, it goes on by itself and its outcome is thrown
/// away.
#[derive(Debug)]
#[must_use = "wait for it, or drop it to continue in the background"]
pub struct PendingRequest {
    connection: Connection,
    ticket: Ticket,
    interrupts: u64,
    outcome: Option<Outcome>,
}

/// Result of a wait for a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WaitResult {
    /// The request ended. Another wait returns the same.
    Ended(Outcome),
    /// The deadline passed; the request continues.
    TimedOut,
    /// An [`Interrupter`] ended the wait; the request continues.
    Interrupted,
}

impl PendingRequest {
    /// Waits until the request ends, `deadline` passes, or an interrupt arrives. An interrupt since the
    /// request was submitted counts, once.
    pub fn wait(&mut self, deadline: Instant) -> WaitResult {
        if let Some(outcome) = self.outcome {
            return WaitResult::Ended(outcome);
        }
        let waited = self.connection.0.0.wait(self.ticket, deadline, &mut self.interrupts);
        if let WaitResult::Ended(outcome) = waited {
            self.outcome = Some(outcome);
        }
        waited
    }

    /// Processes received data without waiting, and returns the outcome if there is one.
    pub fn poll(&mut self) -> Option<Outcome> {
        match self.wait(Instant::ZERO) {
            WaitResult::Ended(outcome) => Some(outcome),
            WaitResult::TimedOut | WaitResult::Interrupted => None,
        }
    }

    /// Returns the outcome if there is one; otherwise `waker` is woken when there is. The background thread
    /// reads the link meanwhile.
    pub fn poll_or_wake(&mut self, waker: &task::Waker) -> Option<Outcome> {
        if self.outcome.is_none() {
            self.outcome = self.connection.0.0.poll_or_wake(self.ticket, waker);
        }
        self.outcome
    }

    /// The ticket of the request in the lane.
    #[must_use]
    pub const fn ticket(&self) -> Ticket {
        self.ticket
    }
}

impl Drop for PendingRequest {
    fn drop(&mut self) {
        if self.outcome.is_none() {
            self.connection.0.0.abandon(self.ticket);
        }
    }
}

/// Ends every wait of a connection. Keeps no connection open.
#[derive(Clone, Debug)]
pub struct Interrupter(Weak<dyn ErasedConnection>);

impl Interrupter {
    /// Ends every running wait, and the first wait of every request submitted so far, with
    /// [`WaitResult::Interrupted`]. It takes a lock: call it from a thread, not from a signal handler.
    pub fn interrupt(&self) {
        if let Some(engine) = self.0.upgrade() {
            engine.interrupt();
        }
    }
}

/// Closes the connection with its last clone: the background thread shares `ConnectionInner` and must not keep it.
#[derive(Debug)]
struct Owner(Arc<dyn ErasedConnection>);

impl Drop for Owner {
    fn drop(&mut self) {
        self.0.shut_down();
    }
}

struct ConnectionInner<M: Medium> {
    state: Mutex<ConnectionState<M>>,
    background: background::BackgroundThread,
    /// Notified when a request ended while others wait for room in the lane.
    room_available: Condvar,
    /// For the background thread, once it is needed.
    weak_self: Weak<Self>,
}

impl<M: Medium> ConnectionInner<M> {
    fn new(link: Box<dyn LinkIo<M>>, lane: Box<dyn AnyLane<M>>) -> Arc<Self> {
        Arc::new_cyclic(|me| Self {
            state: Mutex::new(ConnectionState::new(Arc::from(link), lane)),
            background: background::BackgroundThread::default(),
            room_available: Condvar::new(),
            weak_self: me.clone(),
        })
    }

    /// Panics after a lane panicked: its state can no longer be trusted with a motor.
    fn lock(&self) -> MutexGuard<'_, ConnectionState<M>> {
        // Its jobs are half changed then, and nothing that it reports could be believed.
        self.state.lock().expect("a lane panicked on another thread")
    }
}

/// Outcome of a ticket whose link is gone and whose lane gave none.
const LOST_OUTCOME: Outcome = Outcome::Unknown(Failure::LinkDown);
/// Outcome of a request that could not be submitted.
const NOT_SENT_OUTCOME: Outcome = Outcome::NotDone(Failure::LinkDown);
