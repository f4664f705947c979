//! What the lock guards, and the pump.

use std::borrow::{Borrow, BorrowMut};
use std::sync::Arc;
use std::task;

use polepair_core::axis::Change;
use polepair_core::error::Outcome;
use polepair_core::medium::Medium;
use polepair_core::station::{LineEvent, Ticket};
use polepair_core::time::Instant;

use super::lead::REOPEN_EVERY_NS;
use super::mailbox::{Listener, Notice};
use super::{AnyLane, LOST, Slots};
use crate::clock;
use crate::error::{Cause, LinkError};
use crate::link::{Link, Received};
use crate::wake::Waker;

/// Units sent and outcomes told in one pump; what is left waits for the next.
const PUMP_MAX: usize = 4096;
/// Changes that are told in one go.
const SPREAD_MAX: usize = 4096;
/// Pause after an expiry that left the lane wanting time at once, lest it eats a core.
const TICK_MIN_NS: u64 = 20_000;

pub(super) struct State<M: Medium> {
    pub(super) link: Arc<dyn Link<M>>,
    pub(super) lane: Box<dyn AnyLane<M>>,
    pub(super) slots: Slots,
    pub(super) leader: Leader,
    /// Until when the leader sleeps.
    pub(super) sleeps_until: Instant,
    /// A caller wants to lead; the keeper leaves.
    pub(super) wanted: bool,
    pub(super) interrupts: u64,
    /// Counts reads, so that the keeper sees whether callers lead.
    pub(super) rounds: u64,
    /// Why the link is down.
    pub(super) trouble: Option<LinkError>,
    pub(super) retry: Retry,
    pub(super) keeper: Watch,
    /// Woken by the thread that releases the lock.
    pub(super) to_wake: Vec<task::Waker>,
    /// Who wants to hear what nobody asked for.
    pub(super) listeners: Vec<Listener>,
    /// Threads that wait for the lane to have room.
    pub(super) crowd: u32,
    /// A request has ended since one of them was told.
    pub(super) freed: bool,
    /// The latest time known: clocks cost as much as the rest of a round.
    pub(super) seen: Instant,
    /// When somebody last read.
    pub(super) read_at: Instant,
    line: M::Line,
    out: M::Buffer,
}

/// Who reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Leader {
    Nobody,
    Caller,
    Keeper,
    /// Somebody else, to whom the link is lent: nothing is sent here meanwhile.
    Aside,
}

/// Where a link was that this program closed.
struct Closed {
    name: String,
    /// When it was closed, by its own clock and by this machine's: its time goes on.
    at: Instant,
    since: Instant,
    waker: Waker,
}

impl Closed {
    fn error(&self) -> LinkError {
        LinkError::new(&self.name, Cause::Closed)
    }
}

impl<M: Medium> Link<M> for Closed {
    fn now(&self) -> Instant {
        self.at + clock::now().since(self.since)
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

    fn waker(&self) -> Waker {
        self.waker.clone()
    }

    fn describe(&self) -> String {
        self.name.clone()
    }

    fn reopen(&self) -> Result<Box<dyn Link<M>>, LinkError> {
        Err(self.error())
    }
}

/// What the keeper does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Watch {
    NotStarted,
    /// Until somebody nudges it.
    Asleep,
    /// Looks every few milliseconds whether it is needed.
    Watching,
    Dismissed,
}

/// Opening again.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Retry {
    pub(super) tried: u32,
    pub(super) next: Instant,
    pub(super) under_way: bool,
}

impl<M: Medium> State<M> {
    pub(super) fn new(link: Arc<dyn Link<M>>, lane: Box<dyn AnyLane<M>>) -> Self {
        Self {
            line: lane.line(),
            seen: link.now(),
            read_at: Instant::ZERO,
            listeners: Vec::new(),
            crowd: 0,
            freed: false,
            link,
            lane,
            slots: Slots::default(),
            leader: Leader::Nobody,
            sleeps_until: Instant::ZERO,
            wanted: false,
            interrupts: 0,
            rounds: 0,
            trouble: None,
            retry: Retry::default(),
            keeper: Watch::NotStarted,
            to_wake: Vec::new(),
            out: M::buffer(),
        }
    }

    /// When the lane next wants time.
    pub(super) fn due(&self) -> Option<Instant> {
        self.lane.poll_timeout()
    }

    /// Takes what a read brought, lets time pass, and pumps.
    pub(super) fn digest(&mut self, received: Result<Received, LinkError>, buffer: &M::Out) {
        let now = match received {
            Ok(Received::Bytes { len, at }) => {
                // Only a link that carries something is well again: one that opens and is lost at
                // once is not tried for ever.
                self.retry.tried = 0;
                self.lane.handle_input(at, M::unit(buffer, len));
                at
            }
            Ok(Received::Line { event, at }) => {
                self.lane.handle_line(at, event);
                at
            }
            Ok(Received::TimedOut | Received::Woken) => self.link.now(),
            Err(error) => return self.lose(error),
        };
        self.read_at = now;
        // After the input: what came in time counts as in time however late it is read. And also
        // after bytes, lest a babbling line stops the clock.
        if self.due().is_some_and(|due| due <= now) {
            self.lane.handle_timeout(now);
        }
        self.pump(now);
    }

    /// Until when to sleep at most, for the lane's sake.
    pub(super) fn sleep_until(&self) -> Instant {
        self.due().map_or(Instant::FAR, |due| due.max(self.seen.plus_ns(TICK_MIN_NS)))
    }

    /// Sends what the lane has to say and tells what it has found out.
    pub(super) fn pump(&mut self, now: Instant) {
        self.seen = now;
        for _ in 0..PUMP_MAX {
            // What the host ends at once, unsent, is told too.
            if !self.tell() && !self.transmit(now) && !self.tell() {
                break;
            }
        }
        let line = self.lane.line();
        if line != self.line {
            self.line = line;
            if let Err(error) = self.link.set_line(line) {
                self.lose(error);
            }
        }
        self.spread(now);
    }

    /// Whether somebody must read though nobody asks: where time passes only while somebody waits,
    /// reading for listeners would find nothing.
    pub(super) fn is_listened_to(&self) -> bool {
        !self.listeners.is_empty() && self.link.runs_by_itself()
    }

    /// Tells listeners what happened to the axes.
    pub(super) fn spread(&mut self, now: Instant) {
        if self.listeners.is_empty() {
            return;
        }
        for _ in 0..SPREAD_MAX {
            let Some(news) = self.lane.poll_news(now) else { break };
            if let Change::Missed(count) = news.change {
                self.listeners.iter().for_each(|listener| listener.mailbox.miss(count));
                continue;
            }
            for listener in self.listeners.iter().filter(|one| one.wants(news.axis)) {
                let waker = listener.mailbox.put(listener.source, Notice::Axis(news));
                self.to_wake.extend(waker);
            }
        }
    }

    fn announce(&mut self, notice: &Notice) {
        for listener in &self.listeners {
            let waker = listener.mailbox.put(listener.source, notice.clone());
            self.to_wake.extend(waker);
        }
    }

    /// Everything that hangs on the link ends. The lane disarms its axes.
    pub(super) fn lose(&mut self, error: LinkError) {
        let now = self.link.now();
        let lost = self.trouble.is_none();
        if lost {
            self.trouble = Some(error.clone());
            self.retry.next = now.plus_ns(REOPEN_EVERY_NS);
            // A leader may still be listening to the dead link.
            self.link.waker().wake();
            self.lane.handle_line(now, LineEvent::Down);
        }
        while self.lane.poll_transmit(now, self.out.borrow_mut()).is_some() {}
        while self.tell() {}
        let left: Vec<Ticket> = self.slots.pending().collect();
        for ticket in left {
            self.end(ticket, LOST);
        }
        if lost && !self.listeners.is_empty() {
            self.announce(&Notice::Lost(now, Box::new(error)));
            self.spread(now);
        }
    }

    /// Ends everything as [`lose`](Self::lose) does, and lets go of the link for good.
    pub(super) fn close(&mut self) {
        let (name, at, waker) = (self.link.describe(), self.link.now(), self.link.waker());
        self.lose(LinkError::new(&name, Cause::Closed));
        self.link = Arc::new(Closed { name, at, since: clock::now(), waker: waker.clone() });
        self.trouble = self.link.reopen().err();
        // Nobody has to look whether it comes back.
        self.retry.tried = u32::MAX - 1;
        // A leader may still be listening to the link that it holds.
        waker.wake();
    }

    /// Sets the line as the lane has it, whoever set it otherwise.
    pub(super) fn restore_line(&mut self) {
        if let Err(error) = self.link.set_line(self.line) {
            self.lose(error);
        }
    }

    /// Goes on with a link opened again.
    pub(super) fn regain(&mut self, link: Box<dyn Link<M>>) {
        self.link = Arc::from(link);
        self.trouble = None;
        self.line = self.lane.line();
        let now = self.link.now();
        if let Err(error) = self.link.set_line(self.line) {
            return self.lose(error);
        }
        self.lane.handle_line(now, LineEvent::Up);
        self.announce(&Notice::Back(now));
        self.pump(now);
    }

    pub(super) fn end(&mut self, ticket: Ticket, outcome: Outcome) {
        self.freed = true;
        let waker = self.slots.end(ticket, outcome);
        self.to_wake.extend(waker);
    }

    fn tell(&mut self) -> bool {
        let Some((ticket, outcome)) = self.lane.poll_outcome() else { return false };
        self.end(ticket, outcome);
        true
    }

    fn transmit(&mut self, now: Instant) -> bool {
        if self.trouble.is_some() || self.leader == Leader::Aside {
            return false;
        }
        let Some(len) = self.lane.poll_transmit(now, self.out.borrow_mut()) else { return false };
        match self.link.send(M::unit(self.out.borrow(), len)) {
            Ok(()) => true,
            // The unit is lost as on a broken wire; the lane notices the silence.
            Err(error) if !error.is_gone() => false,
            Err(error) => {
                self.lose(error);
                false
            }
        }
    }
}
