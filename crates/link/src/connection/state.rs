//! The state behind the lock, and the loop that moves frames.

use std::borrow::{Borrow, BorrowMut};
use std::sync::Arc;
use std::task;

use polepair_core::axis::AxisEventKind;
use polepair_core::error::Outcome;
use polepair_core::medium::Medium;
use polepair_core::station::{LineEvent, Ticket};
use polepair_core::time::Instant;

use super::leader::REOPEN_INTERVAL_NS;
use super::mailbox::{ConnectionEvent, MailboxListener};
use super::{AnyLane, LOST_OUTCOME, RequestSlots};
use crate::clock;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Received};
use crate::waker::LinkWaker;

/// Units sent and outcomes delivered in one pump; the rest waits for the next.
// A bound for a lane that would never come to an end; a block of service data has 127 segments.
const PUMP_MAX: usize = 4096;
/// Changes that are delivered at once.
const EVENTS_MAX: usize = 4096;
/// Pause after an expiry that left the lane wanting time at once, lest it eats a core.
// Timers that are due one after the other must not make a system call each.
const TICK_MIN_NS: u64 = 20_000;

pub(super) struct ConnectionState<M: Medium> {
    pub(super) link: Arc<dyn LinkIo<M>>,
    pub(super) lane: Box<dyn AnyLane<M>>,
    pub(super) slots: RequestSlots,
    pub(super) leader: Leader,
    /// Time until which the leader sleeps.
    pub(super) sleeps_until: Instant,
    /// A caller wants to lead; the background thread leaves.
    pub(super) lead_wanted: bool,
    pub(super) interrupts: u64,
    /// Counts reads, so that the background thread sees whether callers lead.
    pub(super) read_count: u64,
    /// Cause of the link's failure.
    pub(super) link_error: Option<LinkError>,
    pub(super) reopening: ReopenState,
    pub(super) background: BackgroundState,
    /// Woken by the thread that releases the lock.
    pub(super) to_wake: Vec<task::Waker>,
    /// Listeners of unsolicited messages.
    pub(super) listeners: Vec<MailboxListener>,
    /// Threads that wait for the lane to have room.
    pub(super) room_waiters: u32,
    /// True if a request has ended since a listener was notified.
    pub(super) room_freed: bool,
    /// The latest time known: clocks cost as much as the rest of a round.
    pub(super) latest_time: Instant,
    /// Time of the last read.
    pub(super) read_at: Instant,
    line: M::Line,
    out_buffer: M::Buffer,
}

/// The thread that reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Leader {
    Nobody,
    Caller,
    Background,
    /// The borrower of the link: this connection sends nothing meanwhile.
    Borrower,
}

/// A link that this program closed, for reopening.
struct ClosedLink {
    name: String,
    /// When it was closed, by its own clock and by this machine's: its time goes on.
    at: Instant,
    closed_at: Instant,
    waker: LinkWaker,
}

impl ClosedLink {
    fn error(&self) -> LinkError {
        LinkError::new(&self.name, Cause::Closed)
    }
}

impl<M: Medium> LinkIo<M> for ClosedLink {
    fn now(&self) -> Instant {
        self.at + clock::now().since(self.closed_at)
    }

    fn send(&self, _: &M::Unit) -> Result<(), LinkError> {
        Err(self.error())
    }

    fn receive(&self, _: &mut M::Out, _: Instant) -> Result<Received, LinkError> {
        Err(self.error())
    }

    fn set_line(&self, _: M::Line) -> Result<(), LinkError> {
        Err(self.error())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn describe(&self) -> String {
        self.name.clone()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        Err(self.error())
    }
}

/// State of the background thread.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum BackgroundState {
    NotStarted,
    /// Sleeps until it is woken.
    Asleep,
    /// Looks every few milliseconds whether it is needed.
    Watching,
    Stopped,
}

/// Opening again.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct ReopenState {
    pub(super) attempts: u32,
    pub(super) next_attempt: Instant,
    pub(super) under_way: bool,
}

impl<M: Medium> ConnectionState<M> {
    pub(super) fn new(link: Arc<dyn LinkIo<M>>, lane: Box<dyn AnyLane<M>>) -> Self {
        Self {
            line: lane.line(),
            latest_time: link.now(),
            read_at: Instant::ZERO,
            listeners: Vec::new(),
            room_waiters: 0,
            room_freed: false,
            link,
            lane,
            slots: RequestSlots::default(),
            leader: Leader::Nobody,
            sleeps_until: Instant::ZERO,
            lead_wanted: false,
            interrupts: 0,
            read_count: 0,
            link_error: None,
            reopening: ReopenState::default(),
            background: BackgroundState::NotStarted,
            to_wake: Vec::new(),
            out_buffer: M::buffer(),
        }
    }

    /// Time of the lane's next action.
    pub(super) fn due(&self) -> Option<Instant> {
        self.lane.poll_timeout()
    }

    /// Takes what a read brought, lets time pass, and pumps.
    pub(super) fn handle_received(
        &mut self,
        received: Result<Received, LinkError>,
        buffer: &M::Out,
    ) {
        let now = match received {
            Ok(Received::Bytes { len, at }) => {
                // Only a link that carries something is well again: one that opens and is lost at
                // once is not tried for ever.
                self.reopening.attempts = 0;
                self.lane.handle_input(at, M::unit(buffer, len));
                at
            }
            Ok(Received::Line { event, at }) => {
                self.lane.handle_line(at, event);
                at
            }
            Ok(Received::TimedOut | Received::Woken) => self.link.now(),
            Err(error) => return self.handle_loss(error),
        };
        self.read_at = now;
        // After the input: data that arrived in time count as in time, also if they are read late. And also after
        // bytes, lest a babbling line stops the clock.
        if self.due().is_some_and(|due| due <= now) {
            self.lane.handle_timeout(now);
        }
        self.pump(now);
    }

    /// Latest time to which a thread may sleep without delaying the lane.
    pub(super) fn sleep_until(&self) -> Instant {
        self.due().map_or(Instant::FAR_FUTURE, |due| due.max(self.latest_time.plus_ns(TICK_MIN_NS)))
    }

    /// Sends the lane's units and delivers its outcomes.
    pub(super) fn pump(&mut self, now: Instant) {
        self.latest_time = now;
        for _ in 0..PUMP_MAX {
            // Requests that the host ends at once, unsent, are delivered too.
            if !self.deliver_outcome() && !self.transmit(now) && !self.deliver_outcome() {
                break;
            }
        }
        // Only after everything was sent: a TML drive takes its new rate behind the acknowledgement.
        let line = self.lane.line();
        if line != self.line {
            self.line = line;
            if let Err(error) = self.link.set_line(line) {
                self.handle_loss(error);
            }
        }
        self.deliver_axis_events(now);
    }

    /// Returns whether a thread must read although no caller waits. In virtual time only a waiting caller lets time
    /// pass, and a read for listeners would find nothing.
    pub(super) fn must_read_for_listeners(&self) -> bool {
        !self.listeners.is_empty() && self.link.is_real_time()
    }

    /// Delivers events of the axes to listeners.
    pub(super) fn deliver_axis_events(&mut self, now: Instant) {
        if self.listeners.is_empty() {
            return;
        }
        for _ in 0..EVENTS_MAX {
            let Some(event) = self.lane.poll_axis_event(now) else { break };
            if let AxisEventKind::Missed(count) = event.kind {
                self.listeners.iter().for_each(|listener| listener.mailbox.add_missed(count));
                continue;
            }
            for listener in self.listeners.iter().filter(|one| one.wants_axis(event.axis)) {
                let waker = listener.mailbox.push(listener.source, ConnectionEvent::Axis(event));
                self.to_wake.extend(waker);
            }
        }
    }

    fn notify_listeners(&mut self, notice: &ConnectionEvent) {
        for listener in &self.listeners {
            let waker = listener.mailbox.push(listener.source, notice.clone());
            self.to_wake.extend(waker);
        }
    }

    /// Everything that hangs on the link ends. The lane disarms its axes.
    pub(super) fn handle_loss(&mut self, error: LinkError) {
        let now = self.link.now();
        let lost = self.link_error.is_none();
        if lost {
            self.link_error = Some(error.clone());
            self.reopening.next_attempt = now.plus_ns(REOPEN_INTERVAL_NS);
            // A leader may still be listening to the dead link.
            self.link.waker().wake();
            self.lane.handle_line(now, LineEvent::Down);
        }
        // Unsent frames of the lane are lost with the link; left in place, they would go out after its
        // return.
        while self.lane.poll_transmit(now, self.out_buffer.borrow_mut()).is_some() {}
        while self.deliver_outcome() {}
        let left: Vec<Ticket> = self.slots.pending().collect();
        for ticket in left {
            self.end_request(ticket, LOST_OUTCOME);
        }
        if lost && !self.listeners.is_empty() {
            self.notify_listeners(&ConnectionEvent::LinkLost(now, Box::new(error)));
            self.deliver_axis_events(now);
        }
    }

    /// Ends everything as [`handle_loss`](Self::handle_loss) does, and lets go of the link for good.
    pub(super) fn close(&mut self) {
        let (name, at, waker) = (self.link.describe(), self.link.now(), self.link.waker());
        self.handle_loss(LinkError::new(&name, Cause::Closed));
        self.link =
            Arc::new(ClosedLink { name, at, closed_at: clock::now(), waker: waker.clone() });
        self.link_error = self.link.reopen().err();
        // Its return needs no check.
        self.reopening.attempts = u32::MAX - 1;
        // A leader may still be listening to the link that it holds.
        waker.wake();
    }

    /// Baud or bit rate that the lane has set the line to.
    pub(super) fn line_rate(&self) -> u32 {
        M::rate(&self.line)
    }

    /// Sets the line as the lane needs it, after another user changed it.
    pub(super) fn restore_line(&mut self) {
        if let Err(error) = self.link.set_line(self.line) {
            self.handle_loss(error);
        }
    }

    /// Goes on with a link opened again.
    pub(super) fn resume_with(&mut self, link: Box<dyn LinkIo<M>>) {
        self.link = Arc::from(link);
        self.link_error = None;
        debug_assert!(self.link_error.is_none());
        self.line = self.lane.line();
        let now = self.link.now();
        if let Err(error) = self.link.set_line(self.line) {
            return self.handle_loss(error);
        }
        self.lane.handle_line(now, LineEvent::Up);
        self.notify_listeners(&ConnectionEvent::LinkRestored(now));
        self.pump(now);
    }

    pub(super) fn end_request(&mut self, ticket: Ticket, outcome: Outcome) {
        self.room_freed = true;
        let waker = self.slots.set_outcome(ticket, outcome);
        self.to_wake.extend(waker);
    }

    fn deliver_outcome(&mut self) -> bool {
        let Some((ticket, outcome)) = self.lane.poll_outcome() else { return false };
        self.end_request(ticket, outcome);
        true
    }

    fn transmit(&mut self, now: Instant) -> bool {
        if self.link_error.is_some() || self.leader == Leader::Borrower {
            return false;
        }
        let Some(len) = self.lane.poll_transmit(now, self.out_buffer.borrow_mut()) else {
            return false;
        };
        match self.link.send(M::unit(self.out_buffer.borrow(), len)) {
            Ok(()) => true,
            // The unit is lost as on a broken wire; the lane notices the silence.
            Err(error) if !error.is_gone() => false,
            Err(error) => {
                self.handle_loss(error);
                false
            }
        }
    }
}
