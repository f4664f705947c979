//! Waiting, as leader or as follower.

use std::borrow::{Borrow, BorrowMut};
use std::sync::{Arc, MutexGuard};
use std::task;
use std::time::Duration;

use polepair_core::axis::Axes;
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::medium::Medium;
use polepair_core::station::Ticket;
use polepair_core::time::Instant;

use super::background;
use super::erased::{ErasedConnection, SubmitFn};
use super::mailbox::{Mailbox, MailboxListener};
use super::state::{ConnectionState, Leader};
use super::{ConnectionInner, NOT_SENT_OUTCOME, WaitResult};
use crate::link::Received;

/// Reads before a submission, to drop what arrived while no thread read.
pub(super) const STALE_READS_MAX: usize = 64;
/// Reads to catch up with received units.
const CATCH_UP_READS_MAX: usize = 1 << 17;
/// Age of received bytes below which they need no read before a request: they cannot be distinguished from bytes that
/// arrive that much later, and the host checks them as replies. Back-to-back exchanges save a system call.
// A read costs a system call; data that arrived within that time cannot be late for anything.
const FRESH_NS: u64 = 200_000;
/// With fewer requests pending, a busy lane means something else.
// A lane that is busy with fewer requests is busy for another reason than their number.
const BUSY_PENDING_MIN: usize = 16;
/// A follower looks again after this long, whatever happens to its leader.
// A lost wake-up costs half a second then, and no request for ever.
const PARK_MAX: Duration = Duration::from_millis(500);
/// Pause between two attempts to open a lost link.
pub(super) const REOPEN_INTERVAL_NS: u64 = 250_000_000;

pub(super) type StateGuard<'a, M> = MutexGuard<'a, ConnectionState<M>>;

impl<M: Medium> ErasedConnection for ConnectionInner<M> {
    fn submit(
        &self,
        wait_until: Instant,
        request: &mut SubmitFn<'_>,
    ) -> Result<(Ticket, u64), Unsupported> {
        loop {
            let mut state = self.lock();
            if state.link_error.is_some() {
                state = reopen_link(self, state);
            }
            let now = read_unread(&mut state);
            let interrupts = state.interrupts;
            let submitted = match state.slots.open_slot() {
                None => Err(Unsupported::Busy),
                Some(ticket) if state.link_error.is_some() => {
                    state.end_request(ticket, NOT_SENT_OUTCOME);
                    Ok((ticket, interrupts))
                }
                Some(ticket) => match request(&mut *state.lane, now, ticket) {
                    Ok(()) => {
                        state.pump(now);
                        Ok((ticket, interrupts))
                    }
                    Err(unsupported) => {
                        state.slots.free_slot(ticket);
                        Err(unsupported)
                    }
                },
            };
            // Under the lock of the refusal: a moment later there may be room, and busy means something else.
            let is_crowded = state.slots.pending().count() >= BUSY_PENDING_MIN;
            let left = wait_until.since(state.link.now());
            release_lock(self, state);
            match submitted {
                Err(Unsupported::Busy) if is_crowded && !left.is_zero() => {
                    wait_for_room(self, left.min(PARK_MAX));
                }
                submitted => return submitted,
            }
        }
    }

    fn wait(&self, ticket: Ticket, deadline: Instant, interrupts: &mut u64) -> WaitResult {
        let mut buffer = M::buffer();
        let mut state = self.lock();
        let mut last_look = false;
        loop {
            let waited = if let Some(outcome) = state.slots.take_outcome(ticket) {
                Some(WaitResult::Ended(outcome))
            } else if state.interrupts != *interrupts {
                *interrupts = state.interrupts;
                Some(WaitResult::Interrupted)
            } else {
                last_look.then_some(WaitResult::TimedOut)
            };
            if let Some(waited) = waited {
                state.slots.set_thread(ticket, None);
                hand_over_lead(&state);
                release_lock(self, state);
                return waited;
            }
            // By a time that may be stale: then the next round finds out, and does not wait.
            last_look = deadline <= state.latest_time;
            state = match state.leader {
                Leader::Nobody => lead_round(self, state, Leader::Caller, deadline, &mut buffer),
                _ if last_look => state,
                _ => follow_leader(self, state, ticket, deadline),
            };
        }
    }

    fn poll_or_wake(&self, ticket: Ticket, waker: &task::Waker) -> Option<Outcome> {
        let mut state = self.lock();
        let outcome = state.slots.take_outcome(ticket);
        if outcome.is_none() {
            state.slots.set_waker(ticket, waker);
            background::request_lead(self, &mut state);
        }
        release_lock(self, state);
        outcome
    }

    fn abandon(&self, ticket: Ticket) {
        // Called while unwinding, too.
        let Ok(mut state) = self.state.lock() else { return };
        state.slots.abandon(ticket);
        release_lock(self, state);
    }

    fn with_axes(&self, query: &mut dyn FnMut(&mut dyn Axes, Instant)) {
        let mut state = self.lock();
        let now = state.link.now();
        query(&mut *state.lane, now);
        // Arming changes there.
        if !state.listeners.is_empty() {
            state.deliver_axis_events(now);
            release_lock(self, state);
        }
    }

    /// Reads pending data for listeners, unless a caller reads. The background thread gives way. A lost link in
    /// virtual time, which no background thread opens again, is tried here.
    fn catch_up(&self) {
        let mut state = self.lock();
        if state.link_error.is_some() && !state.link.is_real_time() {
            state = reopen_link(self, state);
        }
        if state.leader == Leader::Background {
            let Some(ticket) = state.slots.open_slot() else { return };
            while state.leader == Leader::Background {
                state = follow_leader(self, state, ticket, Instant::FAR_FUTURE);
            }
            state.slots.free_slot(ticket);
        }
        if state.leader == Leader::Nobody && state.link_error.is_none() {
            state.read_count = state.read_count.wrapping_add(1);
            read_stale(&mut state, CATCH_UP_READS_MAX);
        }
        hand_over_lead(&state);
        release_lock(self, state);
    }
}

/// Reads replies that wait in the system before a request is judged: they may free its place. Returns the time.
fn read_unread<M: Medium>(state: &mut ConnectionState<M>) -> Instant {
    let now = state.link.now();
    let is_fresh = now < state.read_at.plus_ns(FRESH_NS);
    if is_fresh || state.leader != Leader::Nobody || state.link_error.is_some() {
        return now;
    }
    read_stale(state, STALE_READS_MAX);
    state.link.now()
}

/// Reads once as `leader`, without the lock while waiting, and pumps.
pub(super) fn lead_round<'a, M: Medium>(
    shared: &'a ConnectionInner<M>,
    mut state: StateGuard<'a, M>,
    leader: Leader,
    until: Instant,
    buffer: &mut M::Buffer,
) -> StateGuard<'a, M> {
    debug_assert_eq!(state.leader, Leader::Nobody, "one thread reads a link");
    let until = until.min(state.sleep_until());
    (state.leader, state.sleeps_until) = (leader, until);
    let link = Arc::clone(&state.link);
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
    // The lock is free meanwhile: stops are sent while a thread waits for replies.
    let received = link.receive(buffer.borrow_mut(), until);
    let mut state = shared.lock();
    state.leader = Leader::Nobody;
    state.read_count = state.read_count.wrapping_add(1);
    // Otherwise a sender has found the link lost meanwhile; this error is older.
    if state.link_error.is_none() && Arc::ptr_eq(&link, &state.link) {
        state.handle_received(received, (*buffer).borrow());
    }
    if state.room_waiters > 0 && std::mem::take(&mut state.room_freed) {
        shared.room_available.notify_one();
    }
    state
}

/// Sleeps until the leader has something for this ticket, or leaves.
pub(super) fn follow_leader<'a, M: Medium>(
    shared: &'a ConnectionInner<M>,
    mut state: StateGuard<'a, M>,
    ticket: Ticket,
    deadline: Instant,
) -> StateGuard<'a, M> {
    if state.leader == Leader::Background && !state.lead_wanted {
        // A caller wakes up faster from its own read than from another thread's.
        state.lead_wanted = true;
        state.link.waker().wake();
    }
    let left = deadline.since(state.link.now()).min(PARK_MAX);
    state.slots.set_thread(ticket, Some(std::thread::current()));
    drop(state);
    std::thread::park_timeout(left);
    let mut state = shared.lock();
    state.latest_time = state.latest_time.max(state.link.now());
    state.slots.set_thread(ticket, None);
    state
}

/// Waits until a request ended, so that the lane may take another.
fn wait_for_room<M: Medium>(shared: &ConnectionInner<M>, longest: Duration) {
    let mut state = shared.lock();
    if state.slots.pending().count() < BUSY_PENDING_MIN {
        return;
    }
    state.room_waiters += 1;
    let waited = shared.room_available.wait_timeout(state, longest);
    waited.expect("a lane panicked on another thread").0.room_waiters -= 1;
}

/// Lets the next one lead.
pub(super) fn hand_over_lead<M: Medium>(state: &ConnectionState<M>) {
    if state.leader == Leader::Nobody {
        state.slots.unpark_one();
    }
}

/// Releases the lock after a change: the leader's sleep is cut short if the lane now wants time earlier, the background
/// thread is notified if no other thread serves the lane, and wakers are woken.
pub(super) fn release_lock<M: Medium>(shared: &ConnectionInner<M>, mut state: StateGuard<'_, M>) {
    if state.room_waiters > 0 && std::mem::take(&mut state.room_freed) {
        shared.room_available.notify_one();
    }
    if state.leader == Leader::Nobody {
        if background::is_needed(&state) {
            background::ensure_watching(shared, &mut state);
        }
    } else if state.due().is_some_and(|due| due < state.sleeps_until) {
        // The leader sleeps longer than the new request allows; once woken it computes its time anew.
        state.sleeps_until = Instant::ZERO;
        state.link.waker().wake();
    }
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
}

/// Tries to open a lost link again, if it is time to. The lock is released meanwhile.
pub(super) fn reopen_link<'a, M: Medium>(
    shared: &'a ConnectionInner<M>,
    mut state: StateGuard<'a, M>,
) -> StateGuard<'a, M> {
    if state.reopening.under_way || state.link.now() < state.reopening.next_attempt {
        return state;
    }
    debug_assert!(!state.reopening.under_way);
    state.reopening.under_way = true;
    let lost = Arc::clone(&state.link);
    drop(state);
    // To open an adapter may take seconds, so others can see the lost link meanwhile.
    let link = lost.reopen();
    let mut state = shared.lock();
    state.reopening.under_way = false;
    state.reopening.attempts = state.reopening.attempts.saturating_add(1);
    state.reopening.next_attempt = state.link.now().plus_ns(REOPEN_INTERVAL_NS);
    match link {
        // Closed meanwhile.
        _ if !Arc::ptr_eq(&lost, &state.link) => {}
        Ok(link) => state.resume_with(link),
        Err(error) => state.link_error = Some(error),
    }
    state
}

/// Adds a listener. The background thread reads for it while no other thread does.
pub(super) fn add_listener<M: Medium>(shared: &ConnectionInner<M>, listener: MailboxListener) {
    let mut state = shared.lock();
    if state.listeners.is_empty() {
        // Nothing is recorded while there is no listener: a poll costs nothing for it.
        state.lane.enable_events(true);
    }
    state.listeners.push(listener);
    if state.must_read_for_listeners() {
        background::request_lead(shared, &mut state);
    }
    release_lock(shared, state);
}

pub(super) fn remove_listener<M: Medium>(
    shared: &ConnectionInner<M>,
    mailbox: &Mailbox,
    source: usize,
) {
    // Called while unwinding, too.
    let Ok(mut state) = shared.state.lock() else { return };
    state.listeners.retain(|listener| !listener.is_same(mailbox, source));
    if state.listeners.is_empty() {
        state.lane.enable_events(false);
        // The background thread may have no listener left.
        if state.leader == Leader::Background {
            state.link.waker().wake();
        }
    }
    release_lock(shared, state);
}

/// Reads what arrived while no thread read: before the next request goes out, so that a late reply does not pass for
/// the reply to that.
pub(super) fn read_stale<M: Medium>(state: &mut ConnectionState<M>, reads_max: usize) {
    let mut buffer = M::buffer();
    for _ in 0..reads_max {
        match state.link.receive(buffer.borrow_mut(), Instant::ZERO) {
            Ok(Received::TimedOut | Received::Woken) => break,
            received => state.handle_received(received, buffer.borrow()),
        }
        if state.link_error.is_some() {
            return;
        }
    }
    let now = state.link.now();
    if state.due().is_some_and(|due| due <= now) {
        state.lane.handle_timeout(now);
        state.pump(now);
    }
}
