//! Event queues of a connection, one for each listener.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::task;

use polepair_core::axis::AxisEvent;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;

use super::Connection;
use crate::clock;
use crate::error::LinkError;

/// One thing that happened on a connection.
#[derive(Clone, PartialEq, Debug)]
pub enum ConnectionEvent {
    /// To one of its axes.
    Axis(AxisEvent),
    /// The link was lost.
    LinkLost(Instant, Box<LinkError>),
    /// The link is there again.
    LinkRestored(Instant),
}

/// A queue of notices from any number of connections, each with the number of its connection. It has
/// a fixed size; when it is full, the oldest notices are dropped and counted. Clones share one queue.
#[derive(Clone, Debug)]
pub struct Mailbox(Arc<MailboxInner>);

#[derive(Debug)]
struct MailboxInner {
    queue: Mutex<MailboxQueue>,
    arrived: Condvar,
}

#[derive(Debug)]
struct MailboxQueue {
    events: VecDeque<(usize, ConnectionEvent)>,
    capacity: usize,
    missed: u64,
    interrupted: bool,
    waker: Option<task::Waker>,
}

impl Mailbox {
    /// An empty queue for `max` notices. All memory is allocated here.
    #[must_use]
    pub fn new(max: usize) -> Self {
        let queue = MailboxQueue {
            events: VecDeque::with_capacity(max),
            capacity: max.max(1),
            missed: 0,
            interrupted: false,
            waker: None,
        };
        Self(Arc::new(MailboxInner { queue: Mutex::new(queue), arrived: Condvar::new() }))
    }

    /// The oldest notice, and the number of its connection.
    #[must_use]
    pub fn pop(&self) -> Option<(usize, ConnectionEvent)> {
        self.lock().events.pop_front()
    }

    /// Returns the next notice; waits for one until `deadline` on the system's clock, or until an
    /// interrupt.
    #[must_use]
    pub fn wait_next(&self, deadline: Instant) -> Option<(usize, ConnectionEvent)> {
        let mut queue = self.lock();
        loop {
            if let Some(notice) = queue.events.pop_front() {
                return Some(notice);
            }
            let left = deadline.since(clock::now());
            if left.is_zero() || std::mem::take(&mut queue.interrupted) {
                return None;
            }
            queue = if deadline == Instant::FAR_FUTURE {
                self.0.arrived.wait(queue).unwrap_or_else(PoisonError::into_inner)
            } else {
                let waited = self.0.arrived.wait_timeout(queue, left);
                waited.unwrap_or_else(PoisonError::into_inner).0
            };
        }
    }

    /// Returns whether there is a notice; if not, `waker` is woken by the next one, or by an interrupt.
    #[must_use]
    pub fn ready_or_wake(&self, waker: &task::Waker) -> bool {
        let mut queue = self.lock();
        let ready = !queue.events.is_empty();
        queue.waker = (!ready).then(|| waker.clone());
        ready
    }

    /// Takes the interrupt, if there was one.
    #[must_use]
    pub fn take_interrupt(&self) -> bool {
        std::mem::take(&mut self.lock().interrupted)
    }

    /// Number of notices dropped so far.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.lock().missed
    }

    /// Ends the wait under way, or the next.
    pub fn interrupt(&self) {
        if let Some(waker) = self.set_interrupted() {
            waker.wake();
        }
    }

    /// Marks it as interrupted. Returns the waker to be woken once the connection's lock is released.
    pub(super) fn set_interrupted(&self) -> Option<task::Waker> {
        let mut queue = self.lock();
        queue.interrupted = true;
        self.0.arrived.notify_all();
        queue.waker.take()
    }

    /// Puts a notice in. Gives the waker to be woken once the connection's lock is released.
    pub(super) fn push(&self, source: usize, notice: ConnectionEvent) -> Option<task::Waker> {
        let mut queue = self.lock();
        // A listener wants its present state, so the oldest go first (REQ-14).
        if queue.events.len() == queue.capacity {
            queue.events.pop_front();
            queue.missed += 1;
        }
        debug_assert!(queue.events.len() < queue.capacity);
        queue.events.push_back((source, notice));
        self.0.arrived.notify_one();
        queue.waker.take()
    }

    pub(super) fn add_missed(&self, count: u32) {
        self.lock().missed += u64::from(count);
    }

    fn lock(&self) -> MutexGuard<'_, MailboxQueue> {
        self.0.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Has a connection fill a mailbox until it is dropped. It keeps the connection open.
#[derive(Debug)]
#[must_use = "no event is delivered after it is dropped"]
pub struct ListenerGuard {
    pub(super) connection: Connection,
    pub(super) mailbox: Mailbox,
    pub(super) source: usize,
}

impl ListenerGuard {
    /// Processes received data on links in virtual time, where time passes only during a wait and nothing
    /// else reads for a listener.
    pub fn catch_up(&self) {
        self.connection.catch_up();
    }
}

impl Drop for ListenerGuard {
    fn drop(&mut self) {
        self.connection.0.0.remove_listener(&self.mailbox, self.source);
    }
}

/// One who listens.
pub(super) struct MailboxListener {
    pub(super) mailbox: Mailbox,
    pub(super) source: usize,
    /// The axis alone that it wants to hear of.
    pub(super) axis: Option<AxisIndex>,
}

impl MailboxListener {
    pub(super) fn wants_axis(&self, axis: AxisIndex) -> bool {
        self.axis.is_none_or(|only| only == axis)
    }

    pub(super) fn is_same(&self, mailbox: &Mailbox, source: usize) -> bool {
        self.mailbox.is_same(mailbox) && self.source == source
    }
}
