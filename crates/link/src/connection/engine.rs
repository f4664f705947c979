//! A connection's insides with the medium erased: serial lines and CAN buses look alike from here.

use std::any::Any;
use std::task;

use polepair_core::axis::Axes;
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::medium::Medium;
use polepair_core::station::Ticket;
use polepair_core::time::Instant;

use super::mailbox::{Listener, Mailbox};
use super::{Shared, Waited, aside, keeper, lead};
use crate::error::LinkError;
use crate::link::Losses;

/// What is submitted; called at most once.
pub(super) type Request<'a> =
    dyn FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported> + 'a;

/// See the methods of [`Connection`](super::Connection) and [`Pending`](super::Pending).
pub(super) trait Engine: Send + Sync {
    fn submit(&self, request: &mut Request<'_>) -> Result<(Ticket, u64), Unsupported>;
    fn wait(&self, ticket: Ticket, deadline: Instant, interrupts: &mut u64) -> Waited;
    fn poll_or_wake(&self, ticket: Ticket, waker: &task::Waker) -> Option<Outcome>;
    fn abandon(&self, ticket: Ticket);
    fn await_room(&self, deadline: Instant) -> bool;
    fn with(&self, look: &mut dyn FnMut(&mut dyn Axes, Instant));
    fn now(&self) -> Instant;
    fn trouble(&self) -> Option<LinkError>;
    fn describe(&self) -> String;
    fn losses(&self) -> Losses;
    fn listen(&self, listener: Listener);
    fn unlisten(&self, mailbox: &Mailbox, source: usize);
    fn catch_up(&self);
    fn interrupt(&self);
    fn dismiss(&self);
    fn close(&self);
    fn set_aside(&self, until: Instant) -> Result<Option<Box<dyn Any + Send>>, LinkError>;
    #[cfg(test)]
    fn slots(&self) -> usize;
}

impl<M: Medium> Engine for Shared<M> {
    fn submit(&self, request: &mut Request<'_>) -> Result<(Ticket, u64), Unsupported> {
        lead::submit(self, request)
    }

    fn close(&self) {
        let mut state = self.lock();
        state.close();
        lead::release(self, state);
    }

    fn wait(&self, ticket: Ticket, deadline: Instant, interrupts: &mut u64) -> Waited {
        lead::wait(self, ticket, deadline, interrupts)
    }

    fn poll_or_wake(&self, ticket: Ticket, waker: &task::Waker) -> Option<Outcome> {
        lead::poll_or_wake(self, ticket, waker)
    }

    fn abandon(&self, ticket: Ticket) {
        lead::abandon(self, ticket);
    }

    fn await_room(&self, deadline: Instant) -> bool {
        lead::await_room(self, deadline)
    }

    fn with(&self, look: &mut dyn FnMut(&mut dyn Axes, Instant)) {
        let mut state = self.lock();
        let now = state.link.now();
        look(&mut *state.lane, now);
        // Arming changes there.
        if !state.listeners.is_empty() {
            state.spread(now);
            lead::release(self, state);
        }
    }

    fn now(&self) -> Instant {
        self.lock().link.now()
    }

    fn trouble(&self) -> Option<LinkError> {
        self.lock().trouble.clone()
    }

    fn describe(&self) -> String {
        self.lock().link.describe()
    }

    fn losses(&self) -> Losses {
        self.lock().link.losses()
    }

    fn listen(&self, listener: Listener) {
        lead::listen(self, listener);
    }

    fn unlisten(&self, mailbox: &Mailbox, source: usize) {
        lead::unlisten(self, mailbox, source);
    }

    fn catch_up(&self) {
        lead::catch_up(self);
    }

    fn interrupt(&self) {
        let mut state = self.lock();
        state.interrupts += 1;
        for n in 0..state.listeners.len() {
            let waker = state.listeners[n].mailbox.interrupted_by_connection();
            state.to_wake.extend(waker);
        }
        state.slots.unpark_all();
        state.link.waker().wake();
        lead::release(self, state);
    }

    fn dismiss(&self) {
        keeper::dismiss(self);
    }

    fn set_aside(&self, until: Instant) -> Result<Option<Box<dyn Any + Send>>, LinkError> {
        aside::set_aside(self, until)
    }

    #[cfg(test)]
    fn slots(&self) -> usize {
        self.lock().slots.len()
    }
}

impl std::fmt::Debug for dyn Engine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Engine").finish_non_exhaustive()
    }
}
