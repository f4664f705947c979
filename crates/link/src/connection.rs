//! A lane on a link, shared by any number of threads: tickets made waitable.
//!
//! There is one lock and one leader. Any thread may lock, submit and write; the lock is never held
//! while waiting. The thread that waits first leads: it reads for all, wakes the others by ticket,
//! and hands over when it leaves. The *keeper* thread leads when no caller does and something
//! needs time by itself: a plan that nobody waits for, a link to be opened again. It is started
//! when it is first needed, and gives way to a caller at once.

mod keeper;
mod lead;
mod slots;
mod state;

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::task;

use polepair_core::axis::Axes;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::Stream;
use polepair_core::station::Ticket;
use polepair_core::time::Instant;

use crate::error::LinkError;
use crate::link::Link;
use slots::Slots;
use state::State;

pub use slots::PENDING_MAX;

/// What a connection holds: a lane with protocol, family and host erased.
pub use polepair_core::axis::AnyLane;

/// A lane on a link. Clones are the same connection; the last one dropped closes it.
#[derive(Clone, Debug)]
pub struct Connection(Arc<Owner>);

impl Connection {
    /// Puts `lane` on `link`. The link is set to the lane's line already.
    #[must_use]
    pub fn new(link: Box<dyn Link<Stream>>, lane: Box<dyn AnyLane<Stream>>) -> Self {
        let state = State::new(Arc::from(link), lane);
        let shared = Shared {
            state: Mutex::new(state),
            keeper: keeper::Keeper::default(),
            room: Condvar::new(),
        };
        Self(Arc::new(Owner(Arc::new(shared))))
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
        request: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<Pending, Unsupported> {
        let (ticket, interrupts) = lead::submit(&self.0.0, request)?;
        Ok(Pending { connection: self.clone(), ticket, interrupts, ended: None })
    }

    /// Submits a request and waits for its outcome, `None` at `deadline` or after an interrupt.
    /// While many other requests are pending and the lane takes no more, it waits for its turn and
    /// calls `request` again.
    ///
    /// # Errors
    /// As [`submit`](Self::submit).
    pub fn ask(
        &self,
        deadline: Instant,
        mut request: impl FnMut(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<Option<Outcome>, Unsupported> {
        let mut pending = loop {
            match self.submit(&mut request) {
                Err(Unsupported::Busy) if lead::await_room(&self.0.0, deadline) => {}
                submitted => break submitted?,
            }
        };
        Ok(match pending.wait(deadline) {
            Waited::Ended(outcome) => Some(outcome),
            Waited::TimedOut | Waited::Interrupted => None,
        })
    }

    /// Calls `look` with the axes: to read states and profiles, convert, arm, rehearse. Do not
    /// wait in it; everybody else does meanwhile.
    pub fn with<R>(&self, look: impl FnOnce(&mut dyn Axes, Instant) -> R) -> R {
        let mut state = self.0.0.lock();
        let now = state.link.now();
        look(&mut *state.lane, now)
    }

    /// The present time of the link.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.0.0.lock().link.now()
    }

    /// Why the link is down, if it is.
    #[must_use]
    pub fn trouble(&self) -> Option<LinkError> {
        self.0.0.lock().trouble.clone()
    }

    /// What the link is called.
    #[must_use]
    pub fn describe(&self) -> String {
        self.0.0.lock().link.describe()
    }

    #[cfg(test)]
    pub(crate) fn slots(&self) -> usize {
        self.0.0.lock().slots.len()
    }

    /// What ends waits from elsewhere, for instance upon Ctrl-C.
    #[must_use]
    pub fn interrupter(&self) -> Interrupter {
        Interrupter(Arc::downgrade(&self.0.0))
    }
}

/// A request under way. Dropped before its end, it goes on by itself and its outcome is thrown
/// away.
#[derive(Debug)]
#[must_use = "wait for it, or drop it to let it go on by itself"]
pub struct Pending {
    connection: Connection,
    ticket: Ticket,
    interrupts: u64,
    ended: Option<Outcome>,
}

/// What ended a wait for a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Waited {
    /// The request ended. Waiting again says the same.
    Ended(Outcome),
    /// The deadline came; the request goes on.
    TimedOut,
    /// Somebody used an [`Interrupter`]; the request goes on.
    Interrupted,
}

impl Pending {
    /// Waits until the request ends, `deadline` comes, or somebody interrupts. An interrupt since
    /// the request was submitted counts, once.
    pub fn wait(&mut self, deadline: Instant) -> Waited {
        if let Some(outcome) = self.ended {
            return Waited::Ended(outcome);
        }
        let shared = Arc::clone(&self.connection.0.0);
        let waited = lead::wait(&shared, self.ticket, deadline, &mut self.interrupts);
        if let Waited::Ended(outcome) = waited {
            self.ended = Some(outcome);
        }
        waited
    }

    /// Takes what is there without waiting, and tells the outcome if there is one.
    pub fn poll(&mut self) -> Option<Outcome> {
        match self.wait(Instant::ZERO) {
            Waited::Ended(outcome) => Some(outcome),
            Waited::TimedOut | Waited::Interrupted => None,
        }
    }

    /// Tells the outcome if there is one; else `waker` is woken when there is, from whatever
    /// thread reads then. The keeper reads meanwhile.
    pub fn poll_or_wake(&mut self, waker: &task::Waker) -> Option<Outcome> {
        if self.ended.is_none() {
            self.ended = lead::poll_or_wake(&self.connection.0.0, self.ticket, waker);
        }
        self.ended
    }

    /// The ticket that the lane knows it by.
    #[must_use]
    pub const fn ticket(&self) -> Ticket {
        self.ticket
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if self.ended.is_none() {
            lead::abandon(&self.connection.0.0, self.ticket);
        }
    }
}

/// Ends every wait of a connection. Keeps no connection open.
#[derive(Clone, Debug)]
pub struct Interrupter(std::sync::Weak<Shared>);

impl Interrupter {
    /// Makes every wait under way, and the first wait of every request submitted so far, return
    /// [`Waited::Interrupted`]. Locks: not for signal handlers, but for the thread that hears of
    /// the signal.
    pub fn interrupt(&self) {
        let Some(shared) = self.0.upgrade() else { return };
        let mut state = shared.lock();
        state.interrupts += 1;
        state.slots.unpark_all();
        state.link.waker().wake();
    }
}

/// Closes the connection with its last clone: the keeper shares `Shared` and must not keep it.
#[derive(Debug)]
struct Owner(Arc<Shared>);

impl Drop for Owner {
    fn drop(&mut self) {
        keeper::dismiss(&self.0);
    }
}

struct Shared {
    state: Mutex<State>,
    keeper: keeper::Keeper,
    /// Told when a request ended while others wait for the lane to take theirs.
    room: Condvar,
}

impl Shared {
    /// Panics after a lane panicked: its state can no longer be trusted with a motor.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("a lane panicked on another thread")
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}

/// What ends a ticket whose link is gone and whose lane said nothing of it.
const LOST: Outcome = Outcome::Unknown(Failure::LinkDown);
/// What ends a request that could not even be submitted.
const NOT_SENT: Outcome = Outcome::NotDone(Failure::LinkDown);
