//! The inner part of a connection without its medium: serial lines and CAN buses have the same interface.

use std::any::Any;
use std::task;

use polepair_core::axis::Axes;
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::medium::Medium;
use polepair_core::station::Ticket;
use polepair_core::time::Instant;

use super::mailbox::{Mailbox, MailboxListener};
use super::{ConnectionInner, WaitResult, background, borrow, leader};
use crate::error::LinkError;
use crate::link::Losses;

/// Function that submits a request. It is called again after [`Unsupported::Busy`].
pub(super) type SubmitFn<'a> =
    dyn FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported> + 'a;

/// State of a connection and of its link.
pub(super) trait ConnectionInfo {
    fn now(&self) -> Instant;

    fn is_real_time(&self) -> bool;

    fn link_error(&self) -> Option<LinkError>;

    fn describe(&self) -> String;

    fn losses(&self) -> Losses;

    fn line_rate(&self) -> u32;

    #[cfg(test)]
    fn slot_count(&self) -> usize;
}

/// Listeners, interruption and the end of a connection.
pub(super) trait ConnectionControl {
    fn add_listener(&self, listener: MailboxListener);

    fn remove_listener(&self, mailbox: &Mailbox, source: usize);

    fn interrupt(&self);

    fn shut_down(&self);

    fn close(&self);

    fn borrow_link(&self, until: Instant) -> Result<Option<Box<dyn Any + Send>>, LinkError>;
}

/// See the methods of [`Connection`](super::Connection) and [`Pending`](super::Pending).
pub(super) trait ErasedConnection: Send + Sync + ConnectionInfo + ConnectionControl {
    fn submit(
        &self,
        wait_until: Instant,
        request: &mut SubmitFn<'_>,
    ) -> Result<(Ticket, u64), Unsupported>;

    fn wait(&self, ticket: Ticket, deadline: Instant, interrupts: &mut u64) -> WaitResult;

    fn poll_or_wake(&self, ticket: Ticket, waker: &task::Waker) -> Option<Outcome>;

    fn abandon(&self, ticket: Ticket);

    fn with_axes(&self, query: &mut dyn FnMut(&mut dyn Axes, Instant));

    fn catch_up(&self);
}

impl<M: Medium> ConnectionInfo for ConnectionInner<M> {
    fn now(&self) -> Instant {
        self.lock().link.now()
    }

    fn is_real_time(&self) -> bool {
        self.lock().link.is_real_time()
    }

    fn link_error(&self) -> Option<LinkError> {
        self.lock().link_error.clone()
    }

    fn describe(&self) -> String {
        self.lock().link.describe()
    }

    fn losses(&self) -> Losses {
        self.lock().link.losses()
    }

    fn line_rate(&self) -> u32 {
        self.lock().line_rate()
    }

    #[cfg(test)]
    fn slot_count(&self) -> usize {
        self.lock().slots.len()
    }
}

impl<M: Medium> ConnectionControl for ConnectionInner<M> {
    fn add_listener(&self, listener: MailboxListener) {
        leader::add_listener(self, listener);
    }

    fn remove_listener(&self, mailbox: &Mailbox, source: usize) {
        leader::remove_listener(self, mailbox, source);
    }

    fn interrupt(&self) {
        let mut state = self.lock();
        // A number and not a flag: each waiter notices it, however many there are.
        state.interrupts += 1;
        for n in 0..state.listeners.len() {
            let waker = state.listeners[n].mailbox.set_interrupted();
            state.to_wake.extend(waker);
        }
        state.slots.unpark_all();
        state.link.waker().wake();
        leader::release_lock(self, state);
    }

    fn shut_down(&self) {
        background::shut_down(self);
    }

    fn close(&self) {
        let mut state = self.lock();
        state.close();
        leader::release_lock(self, state);
    }

    fn borrow_link(&self, until: Instant) -> Result<Option<Box<dyn Any + Send>>, LinkError> {
        borrow::borrow_link(self, until)
    }
}

impl std::fmt::Debug for dyn ErasedConnection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Engine").finish_non_exhaustive()
    }
}
