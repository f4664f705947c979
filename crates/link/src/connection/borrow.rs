//! Lends a link to another user for a short time, between two exchanges of its connection.
//!
//! Why: GW-6.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_core::medium::{Medium, MediumKind};
use polepair_core::time::Instant;

use super::ConnectionInner;
use super::leader::{STALE_READS_MAX, StateGuard};
use super::leader::{follow_leader, hand_over_lead, lead_round, read_stale, release_lock};
use super::state::Leader;
use crate::error::LinkError;
use crate::link::{LinkIo, Losses, Received};
use crate::waker::LinkWaker;

/// A borrowed link. Until this is dropped, the connection sends nothing, and new requests wait. The
/// borrower must have finished before the drop; afterwards its calls fail.
#[must_use = "the connection goes on at once when this is dropped"]
pub struct BorrowedLink<M: Medium>(Arc<BorrowState<M>>);

impl<M: Medium> std::fmt::Debug for BorrowedLink<M> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Aside").field(&self.0.link.describe()).finish()
    }
}

impl<M: Medium> BorrowedLink<M> {
    /// The link of the connection. Frames of a CAN bus are given to the connection too, which would otherwise miss
    /// unsolicited messages of its drives.
    #[must_use]
    pub fn link(&self) -> Box<dyn LinkIo<M>> {
        Box::new(LinkProxy(Arc::clone(&self.0)))
    }
}

impl<M: Medium> Drop for BorrowedLink<M> {
    fn drop(&mut self) {
        // First of all: a thread that still holds the proxy must not read what belongs to the connection.
        self.0.ended.store(true, Ordering::SeqCst);
        let shared = &self.0.shared;
        // Dropped while unwinding, too.
        let Ok(mut state) = shared.state.lock() else { return };
        state.read_count = state.read_count.wrapping_add(1);
        if self.0.line_changed.load(Ordering::SeqCst) {
            state.restore_line();
        }
        if state.link_error.is_none() {
            // Late bytes are not for this connection, and must not pass for an answer: nothing is
            // sent before all of them are read.
            read_stale(&mut state, STALE_READS_MAX);
        }
        debug_assert_eq!(
            state.leader,
            Leader::Borrower,
            "a link is returned by the one who has it"
        );
        state.leader = Leader::Nobody;
        if state.link_error.is_none() {
            let now = state.link.now();
            state.lane.handle_resume(now);
            state.pump(now);
        }
        hand_over_lead(&state);
        release_lock(shared, state);
    }
}

/// A link, and whose it is.
struct BorrowState<M: Medium> {
    shared: Arc<ConnectionInner<M>>,
    link: Arc<dyn LinkIo<M>>,
    ended: AtomicBool,
    /// True if a borrower changed the line's settings.
    line_changed: AtomicBool,
}

struct LinkProxy<M: Medium>(Arc<BorrowState<M>>);

impl<M: Medium> BorrowState<M> {
    fn check_active(&self) -> Result<(), LinkError> {
        if self.ended.load(Ordering::SeqCst) {
            Err(LinkError::gone(&self.link.describe()))
        } else {
            Ok(())
        }
    }

    /// The connection, while this link is still its own: it may have been opened again meanwhile.
    fn lock_owner(&self) -> Option<StateGuard<'_, M>> {
        let state = self.shared.lock();
        // The connection may have opened another link since.
        let its = state.leader == Leader::Borrower && Arc::ptr_eq(&self.link, &state.link);
        (its && !self.ended.load(Ordering::SeqCst)).then_some(state)
    }

    /// Passes received data to the connection that the link belongs to.
    fn forward_received(&self, received: &Result<Received, LinkError>, buffer: &M::Out) {
        match received {
            Ok(Received::Bytes { len, at }) if M::KIND == MediumKind::Can => {
                let Some(mut state) = self.lock_owner() else { return };
                state.lane.handle_input(*at, M::unit(buffer, *len));
                state.pump(*at);
                release_lock(&self.shared, state);
            }
            Ok(Received::Line { event, at }) => {
                let Some(mut state) = self.lock_owner() else { return };
                state.lane.handle_line(*at, *event);
                state.pump(*at);
                release_lock(&self.shared, state);
            }
            Err(error) => self.handle_loss(error),
            Ok(_) => {}
        }
    }

    fn handle_loss(&self, error: &LinkError) {
        let Some(mut state) = self.lock_owner() else { return };
        state.handle_loss(error.clone());
        release_lock(&self.shared, state);
    }
}

impl<M: Medium> LinkIo<M> for LinkProxy<M> {
    fn now(&self) -> Instant {
        self.0.link.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        self.0.check_active()?;
        let sent = self.0.link.send(unit);
        sent.inspect_err(|error| {
            if error.is_gone() {
                self.0.handle_loss(error)
            }
        })
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.0.check_active()?;
        self.0.link.wait_writable(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        self.0.check_active()?;
        let received = self.0.link.receive(buffer, until);
        self.0.forward_received(&received, buffer);
        received
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.0.check_active()?;
        self.0.line_changed.store(true, Ordering::SeqCst);
        self.0.link.set_line(line)
    }

    fn waker(&self) -> LinkWaker {
        self.0.link.waker()
    }

    fn is_real_time(&self) -> bool {
        self.0.link.is_real_time()
    }

    fn describe(&self) -> String {
        self.0.link.describe()
    }

    fn losses(&self) -> Losses {
        self.0.link.losses()
    }
}

/// Waits until nothing is pending and no thread reads, and keeps all others from sending. Reads meanwhile if no other
/// thread does. `None` at the deadline.
pub(super) fn borrow_link<M: Medium>(
    shared: &ConnectionInner<M>,
    until: Instant,
) -> Result<Option<Box<dyn Any + Send>>, LinkError> {
    let Some(me) = shared.weak_self.upgrade() else { return Ok(None) };
    let mut state = shared.lock();
    // A place of its own, to be woken when the leader leaves.
    let Some(own) = state.slots.open_slot() else { return Ok(None) };
    let mut buffer = M::buffer();
    let aside = loop {
        if let Some(trouble) = &state.link_error {
            break Err(trouble.clone());
        }
        // Refused at once: a wait here would keep the program from reading.
        if state.lane.sends_keepalive() {
            break Ok(false);
        }
        // A query of the lane itself must have ended too: on a line its reply would be taken for another's. On a bus
        // both receive it.
        let waits = M::KIND == MediumKind::Serial && state.due().is_some();
        let quiet = state.slots.pending().all(|ticket| ticket == own) && !waits;
        state = match state.leader {
            Leader::Nobody if quiet => break Ok(true),
            _ if state.link.now() >= until => break Ok(false),
            Leader::Nobody => lead_round(shared, state, Leader::Caller, until, &mut buffer),
            _ => follow_leader(shared, state, own, until),
        };
    };
    state.slots.free_slot(own);
    let aside = aside.map(|quiet| quiet.then(|| start_borrow(me, &mut state)));
    hand_over_lead(&state);
    release_lock(shared, state);
    aside
}

fn start_borrow<M: Medium>(
    shared: Arc<ConnectionInner<M>>,
    state: &mut StateGuard<'_, M>,
) -> Box<dyn Any + Send> {
    // No thread's sleep is to be cut short.
    debug_assert_eq!(state.leader, Leader::Nobody, "one thread reads a link");
    (state.leader, state.sleeps_until) = (Leader::Borrower, Instant::ZERO);
    let (over, set) = (AtomicBool::new(false), AtomicBool::new(false));
    Box::new(BorrowedLink(Arc::new(BorrowState {
        shared,
        link: Arc::clone(&state.link),
        ended: over,
        line_changed: set,
    })))
}
