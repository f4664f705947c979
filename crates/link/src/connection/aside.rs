//! A link lent to somebody else for a moment, between two exchanges of its connection.
//!
//! Why: GW-6.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_core::medium::{Medium, MediumKind};
use polepair_core::time::Instant;

use super::Shared;
use super::lead::{Guard, STALE_READS_MAX};
use super::lead::{follow, hand_over, read_stale, release, round};
use super::state::Leader;
use crate::error::LinkError;
use crate::link::{Link, Losses, Received};
use crate::wake::Waker;

/// A connection that is set aside: until this is dropped it sends nothing, and what is submitted to
/// it waits. Who has the link must have left it when this is dropped; from then on it is gone for
/// them.
#[must_use = "the connection goes on at once when this is dropped"]
pub struct Aside<M: Medium>(Arc<Lent<M>>);

impl<M: Medium> std::fmt::Debug for Aside<M> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Aside").field(&self.0.link.describe()).finish()
    }
}

impl<M: Medium> Aside<M> {
    /// The connection's link. What arrives on a CAN bus is shown to the connection as well, which
    /// would miss what its own drives say unasked.
    #[must_use]
    pub fn link(&self) -> Box<dyn Link<M>> {
        Box::new(Borrowed(Arc::clone(&self.0)))
    }
}

impl<M: Medium> Drop for Aside<M> {
    fn drop(&mut self) {
        self.0.over.store(true, Ordering::SeqCst);
        let shared = &self.0.shared;
        // Dropped while unwinding, too.
        let Ok(mut state) = shared.state.lock() else { return };
        state.rounds = state.rounds.wrapping_add(1);
        if self.0.set.load(Ordering::SeqCst) {
            state.restore_line();
        }
        if state.trouble.is_none() {
            // What comes late is not for this connection, and must not pass for an answer: nothing
            // is sent before all of it is read.
            read_stale(&mut state, STALE_READS_MAX);
        }
        state.leader = Leader::Nobody;
        if state.trouble.is_none() {
            let now = state.link.now();
            state.lane.disturbed(now);
            state.pump(now);
        }
        hand_over(&state);
        release(shared, state);
    }
}

/// A link, and whose it is.
struct Lent<M: Medium> {
    shared: Arc<Shared<M>>,
    link: Arc<dyn Link<M>>,
    over: AtomicBool,
    /// Somebody set the line otherwise.
    set: AtomicBool,
}

struct Borrowed<M: Medium>(Arc<Lent<M>>);

impl<M: Medium> Lent<M> {
    fn check(&self) -> Result<(), LinkError> {
        match self.over.load(Ordering::SeqCst) {
            true => Err(LinkError::gone(&self.link.describe())),
            false => Ok(()),
        }
    }

    /// The connection, while this link is still its own: it may have been opened again meanwhile.
    fn owner(&self) -> Option<Guard<'_, M>> {
        let state = self.shared.lock();
        let its = state.leader == Leader::Aside && Arc::ptr_eq(&self.link, &state.link);
        (its && !self.over.load(Ordering::SeqCst)).then_some(state)
    }

    /// Tells the connection what it would have noticed itself.
    fn overheard(&self, received: &Result<Received, LinkError>, buffer: &M::Out) {
        match received {
            Ok(Received::Bytes { len, at }) if M::KIND == MediumKind::Can => {
                let Some(mut state) = self.owner() else { return };
                state.lane.handle_input(*at, M::unit(buffer, *len));
                state.pump(*at);
                release(&self.shared, state);
            }
            Ok(Received::Line { event, at }) => {
                let Some(mut state) = self.owner() else { return };
                state.lane.handle_line(*at, *event);
                state.pump(*at);
                release(&self.shared, state);
            }
            Err(error) => self.lost(error),
            Ok(_) => {}
        }
    }

    fn lost(&self, error: &LinkError) {
        let Some(mut state) = self.owner() else { return };
        state.lose(error.clone());
        release(&self.shared, state);
    }
}

impl<M: Medium> Link<M> for Borrowed<M> {
    fn now(&self) -> Instant {
        self.0.link.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        self.0.check()?;
        let sent = self.0.link.send(unit);
        sent.inspect_err(|error| {
            if error.is_gone() {
                self.0.lost(error)
            }
        })
    }

    fn ready(&self, until: Instant) -> Result<bool, LinkError> {
        self.0.check()?;
        self.0.link.ready(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        self.0.check()?;
        let received = self.0.link.receive(buffer, until);
        self.0.overheard(&received, buffer);
        received
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.0.check()?;
        self.0.set.store(true, Ordering::SeqCst);
        self.0.link.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.0.link.waker()
    }

    fn runs_by_itself(&self) -> bool {
        self.0.link.runs_by_itself()
    }

    fn describe(&self) -> String {
        self.0.link.describe()
    }

    fn losses(&self) -> Losses {
        self.0.link.losses()
    }
}

/// Waits until nothing is pending and nobody reads, leading meanwhile where nobody does, and keeps
/// everybody from sending. `None` when it did not come to that until then.
pub(super) fn set_aside<M: Medium>(
    shared: &Shared<M>,
    until: Instant,
) -> Result<Option<Box<dyn Any + Send>>, LinkError> {
    let Some(me) = shared.me.upgrade() else { return Ok(None) };
    let mut state = shared.lock();
    let Some(own) = state.slots.open() else { return Ok(None) };
    let mut buffer = M::buffer();
    let aside = loop {
        if let Some(trouble) = &state.trouble {
            break Err(trouble.clone());
        }
        // Refused at once: while it waited here, the program would not be heard of.
        if state.lane.keeps_alive() {
            break Ok(false);
        }
        // Not even a question of the lane's own may be under way: on a line its answer would be
        // taken for another's. On a bus it is heard as well.
        let waits = M::KIND == MediumKind::Serial && state.due().is_some();
        let quiet = state.slots.pending().all(|ticket| ticket == own) && !waits;
        state = match state.leader {
            Leader::Nobody if quiet => break Ok(true),
            _ if state.link.now() >= until => break Ok(false),
            Leader::Nobody => round(shared, state, Leader::Caller, until, &mut buffer),
            _ => follow(shared, state, own, until),
        };
    };
    state.slots.close(own);
    let aside = aside.map(|quiet| quiet.then(|| lend(me, &mut state)));
    hand_over(&state);
    release(shared, state);
    aside
}

fn lend<M: Medium>(shared: Arc<Shared<M>>, state: &mut Guard<'_, M>) -> Box<dyn Any + Send> {
    // Nobody's sleep is to be cut short.
    (state.leader, state.sleeps_until) = (Leader::Aside, Instant::ZERO);
    let (over, set) = (AtomicBool::new(false), AtomicBool::new(false));
    Box::new(Aside(Arc::new(Lent { shared, link: Arc::clone(&state.link), over, set })))
}
