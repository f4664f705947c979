//! Waiting, by leading or by following.

use std::borrow::{Borrow, BorrowMut};
use std::sync::{Arc, MutexGuard};
use std::task;
use std::time::Duration;

use polepair_core::error::{Outcome, Unsupported};
use polepair_core::medium::Medium;
use polepair_core::station::Ticket;
use polepair_core::time::Instant;

use super::keeper;
use super::mailbox::{Listener, Mailbox};
use super::state::{Leader, State};
use super::{NOT_SENT, Request, Shared, Waited};
use crate::link::Received;

/// Reads before a submission that throw out what came while nobody read.
pub(super) const STALE_READS_MAX: usize = 64;
/// The same, for those who catch up with what came.
const UNREAD_MAX: usize = 1 << 17;
/// What has lain unread for less than this before a request goes out is no different from what
/// comes as much later; the host tells that from an answer, or nobody can. So exchanges back to
/// back save a system call.
const FRESH_NS: u64 = 200_000;
/// With fewer requests pending, a lane that says busy means something else.
const CROWD_MIN: usize = 16;
/// A follower looks again after this long, whatever happens to its leader.
const PARK_MAX: Duration = Duration::from_millis(500);
/// Pause between two attempts to open a lost link.
pub(super) const REOPEN_EVERY_NS: u64 = 250_000_000;

pub(super) type Guard<'a, M> = MutexGuard<'a, State<M>>;

pub(super) fn submit<M: Medium>(
    shared: &Shared<M>,
    request: &mut Request<'_>,
) -> Result<(Ticket, u64), Unsupported> {
    let mut state = shared.lock();
    if state.trouble.is_some() {
        state = reopen(shared, state);
    }
    let ticket = state.slots.open().ok_or(Unsupported::Busy)?;
    let interrupts = state.interrupts;
    let mut now = state.link.now();
    let unread = state.leader == Leader::Nobody && now >= state.read_at.plus_ns(FRESH_NS);
    if unread && state.trouble.is_none() {
        read_stale(&mut state, STALE_READS_MAX);
        now = state.link.now();
    }
    if state.trouble.is_some() {
        state.end(ticket, NOT_SENT);
        release(shared, state);
        return Ok((ticket, interrupts));
    }
    if let Err(unsupported) = request(&mut *state.lane, now, ticket) {
        state.slots.close(ticket);
        release(shared, state);
        return Err(unsupported);
    }
    state.pump(now);
    release(shared, state);
    Ok((ticket, interrupts))
}

pub(super) fn wait<M: Medium>(
    shared: &Shared<M>,
    ticket: Ticket,
    deadline: Instant,
    interrupts: &mut u64,
) -> Waited {
    let mut buffer = M::buffer();
    let mut state = shared.lock();
    let mut last_look = false;
    loop {
        let waited = if let Some(outcome) = state.slots.take(ticket) {
            Some(Waited::Ended(outcome))
        } else if state.interrupts != *interrupts {
            *interrupts = state.interrupts;
            Some(Waited::Interrupted)
        } else {
            last_look.then_some(Waited::TimedOut)
        };
        if let Some(waited) = waited {
            state.slots.attend(ticket, None);
            hand_over(&state);
            release(shared, state);
            return waited;
        }
        // By a time that may be stale: then the next round finds out, and does not wait.
        last_look = deadline <= state.seen;
        state = match state.leader {
            Leader::Nobody => round(shared, state, Leader::Caller, deadline, &mut buffer),
            _ if last_look => state,
            _ => follow(shared, state, ticket, deadline),
        };
    }
}

pub(super) fn poll_or_wake<M: Medium>(
    shared: &Shared<M>,
    ticket: Ticket,
    waker: &task::Waker,
) -> Option<Outcome> {
    let mut state = shared.lock();
    let outcome = state.slots.take(ticket);
    if outcome.is_none() {
        state.slots.attend_with(ticket, waker);
        keeper::call(shared, &mut state);
    }
    release(shared, state);
    outcome
}

pub(super) fn abandon<M: Medium>(shared: &Shared<M>, ticket: Ticket) {
    // Called while unwinding, too.
    let Ok(mut state) = shared.state.lock() else { return };
    state.slots.abandon(ticket);
    release(shared, state);
}

/// Reads once as `leader`, without the lock while waiting, and pumps.
pub(super) fn round<'a, M: Medium>(
    shared: &'a Shared<M>,
    mut state: Guard<'a, M>,
    leader: Leader,
    until: Instant,
    buffer: &mut M::Buffer,
) -> Guard<'a, M> {
    let until = until.min(state.sleep_until());
    (state.leader, state.sleeps_until) = (leader, until);
    let link = Arc::clone(&state.link);
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
    let received = link.receive(buffer.borrow_mut(), until);
    let mut state = shared.lock();
    state.leader = Leader::Nobody;
    state.rounds = state.rounds.wrapping_add(1);
    // Otherwise a sender has found the link lost meanwhile; what this one says is of the past.
    if state.trouble.is_none() && Arc::ptr_eq(&link, &state.link) {
        state.digest(received, (*buffer).borrow());
    }
    if state.crowd > 0 && std::mem::take(&mut state.freed) {
        shared.room.notify_one();
    }
    state
}

/// Sleeps until the leader has something for this ticket, or leaves.
pub(super) fn follow<'a, M: Medium>(
    shared: &'a Shared<M>,
    mut state: Guard<'a, M>,
    ticket: Ticket,
    deadline: Instant,
) -> Guard<'a, M> {
    if state.leader == Leader::Keeper && !state.wanted {
        state.wanted = true;
        state.link.waker().wake();
    }
    let left = deadline.since(state.link.now()).min(PARK_MAX);
    state.slots.attend(ticket, Some(std::thread::current()));
    drop(state);
    std::thread::park_timeout(left);
    let mut state = shared.lock();
    state.seen = state.seen.max(state.link.now());
    state.slots.attend(ticket, None);
    state
}

/// Waits until a request ended, so that the lane may take another. False when so few are pending
/// that it is not for want of room that the lane refused, and at `deadline`.
pub(super) fn await_room<M: Medium>(shared: &Shared<M>, deadline: Instant) -> bool {
    let mut state = shared.lock();
    let left = deadline.since(state.link.now()).min(PARK_MAX);
    if left.is_zero() || state.slots.pending().count() < CROWD_MIN {
        return false;
    }
    state.crowd += 1;
    let waited = shared.room.wait_timeout(state, left);
    waited.expect("a lane panicked on another thread").0.crowd -= 1;
    true
}

/// Lets the next one lead.
pub(super) fn hand_over<M: Medium>(state: &State<M>) {
    if state.leader == Leader::Nobody {
        state.slots.unpark_one();
    }
}

/// Releases the lock as everybody must who has changed something: the leader's sleep is cut short
/// if the lane now wants time earlier, the keeper is nudged if nobody else sees to the lane, and
/// wakers are woken.
pub(super) fn release<M: Medium>(shared: &Shared<M>, mut state: Guard<'_, M>) {
    if state.crowd > 0 && std::mem::take(&mut state.freed) {
        shared.room.notify_one();
    }
    if state.leader == Leader::Nobody {
        if keeper::needed(&state) {
            keeper::nudge(shared, &mut state);
        }
    } else if state.due().is_some_and(|due| due < state.sleeps_until) {
        state.sleeps_until = Instant::ZERO;
        state.link.waker().wake();
    }
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
}

/// Tries to open a lost link again, if it is time to. The lock is released meanwhile.
pub(super) fn reopen<'a, M: Medium>(
    shared: &'a Shared<M>,
    mut state: Guard<'a, M>,
) -> Guard<'a, M> {
    if state.retry.under_way || state.link.now() < state.retry.next {
        return state;
    }
    state.retry.under_way = true;
    let lost = Arc::clone(&state.link);
    drop(state);
    let link = lost.reopen();
    let mut state = shared.lock();
    state.retry.under_way = false;
    state.retry.tried = state.retry.tried.saturating_add(1);
    state.retry.next = state.link.now().plus_ns(REOPEN_EVERY_NS);
    match link {
        // Closed meanwhile.
        _ if !Arc::ptr_eq(&lost, &state.link) => {}
        Ok(link) => state.regain(link),
        Err(error) => state.trouble = Some(error),
    }
    state
}

/// Takes a listener in. The keeper reads for it when nobody else does.
pub(super) fn listen<M: Medium>(shared: &Shared<M>, listener: Listener) {
    let mut state = shared.lock();
    if state.listeners.is_empty() {
        state.lane.listen(true);
    }
    state.listeners.push(listener);
    if state.is_listened_to() {
        keeper::call(shared, &mut state);
    }
    release(shared, state);
}

pub(super) fn unlisten<M: Medium>(shared: &Shared<M>, mailbox: &Mailbox, source: usize) {
    // Called while unwinding, too.
    let Ok(mut state) = shared.state.lock() else { return };
    state.listeners.retain(|listener| !listener.is(mailbox, source));
    if state.listeners.is_empty() {
        state.lane.listen(false);
        // The keeper may read for nobody now.
        if state.leader == Leader::Keeper {
            state.link.waker().wake();
        }
    }
    release(shared, state);
}

/// Takes in what came, for those who listen, unless a caller reads. The keeper gives way. A lost link
/// in virtual time, which no keeper opens again, is tried here.
pub(super) fn catch_up<M: Medium>(shared: &Shared<M>) {
    let mut state = shared.lock();
    if state.trouble.is_some() && !state.link.runs_by_itself() {
        state = reopen(shared, state);
    }
    if state.leader == Leader::Keeper {
        let Some(ticket) = state.slots.open() else { return };
        while state.leader == Leader::Keeper {
            state = follow(shared, state, ticket, Instant::FAR);
        }
        state.slots.close(ticket);
    }
    if state.leader == Leader::Nobody && state.trouble.is_none() {
        state.rounds = state.rounds.wrapping_add(1);
        read_stale(&mut state, UNREAD_MAX);
    }
    hand_over(&state);
    release(shared, state);
}

/// Takes what came while nobody read: before the next request goes out, a late answer must not
/// pass for an answer to that.
pub(super) fn read_stale<M: Medium>(state: &mut State<M>, reads_max: usize) {
    let mut buffer = M::buffer();
    for _ in 0..reads_max {
        match state.link.receive(buffer.borrow_mut(), Instant::ZERO) {
            Ok(Received::TimedOut | Received::Woken) => break,
            received => state.digest(received, buffer.borrow()),
        }
        if state.trouble.is_some() {
            return;
        }
    }
    let now = state.link.now();
    if state.due().is_some_and(|due| due <= now) {
        state.lane.handle_timeout(now);
        state.pump(now);
    }
}
