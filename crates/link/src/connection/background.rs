//! The background thread, which leads if no caller waits.

use std::sync::{Condvar, Mutex, PoisonError};
use std::task;
use std::thread::JoinHandle;
use std::time::Duration;

use polepair_core::medium::Medium;
use polepair_core::time::{Instant, earliest};

use super::ConnectionInner;
use super::leader::{StateGuard, hand_over_lead, lead_round, reopen_link};
use super::state::{BackgroundState, ConnectionState, Leader};

/// Interval at which the background thread checks whether it is needed; also the pause before it leads in a caller's
/// place.
// Callers that ask again and again lead for themselves; the thread only looks whether one has left
// (REQ-14).
const CHECK_INTERVAL: Duration = Duration::from_millis(5);
/// Interval of these checks while the link is lost.
const LINK_CHECK_INTERVAL: Duration = Duration::from_millis(50);
/// Checks without need before it sleeps.
// Half a second of them. A thread that slept at once would be woken for each of a slow program's
// requests.
const IDLE_CHECKS_MAX: u32 = 100;
/// Time that it goes on leading for wakers (asyncio), so that their next request finds it reading.
const LINGER_NS: u64 = 500_000_000;
/// Attempts to open a lost link, four a second; later ones only at a request.
// Two minutes: a cable that is out for longer is reopened by the next request.
const REOPEN_ATTEMPTS_MAX: u32 = 480;

#[derive(Default)]
pub(super) struct BackgroundThread {
    wake: Condvar,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// Returns true if time must pass without a waiting caller. In virtual time only a waiting caller lets time pass, so
/// that runs repeat exactly; the background thread does not.
pub(super) fn is_needed<M: Medium>(state: &ConnectionState<M>) -> bool {
    match state.link_error {
        None if !state.link.is_real_time() => state.slots.has_wakers(),
        Some(_) if !state.link.is_real_time() => false,
        Some(_) => state.reopening.attempts < REOPEN_ATTEMPTS_MAX,
        None => {
            state.due().is_some() || state.slots.has_wakers() || state.must_read_for_listeners()
        }
    }
}

/// Makes sure that it watches. Costs nothing when it does.
pub(super) fn ensure_watching<M: Medium>(
    shared: &ConnectionInner<M>,
    state: &mut ConnectionState<M>,
) {
    match state.background {
        BackgroundState::NotStarted => spawn(shared, state),
        BackgroundState::Asleep => {
            state.background = BackgroundState::Watching;
            shared.background.wake.notify_one();
        }
        BackgroundState::Watching | BackgroundState::Stopped => {}
    }
}

/// Makes the background thread lead now, if no caller does.
pub(super) fn request_lead<M: Medium>(shared: &ConnectionInner<M>, state: &mut ConnectionState<M>) {
    ensure_watching(shared, state);
    if state.leader == Leader::Nobody {
        shared.background.wake.notify_one();
    }
}

/// Ends it, and waits for that unless it is connecting somewhere, which may take seconds.
pub(super) fn shut_down<M: Medium>(shared: &ConnectionInner<M>) {
    let Ok(mut state) = shared.state.lock() else { return };
    // Set before the wake-up, so that the thread sees it whenever it looks.
    state.background = BackgroundState::Stopped;
    state.link.waker().wake();
    shared.background.wake.notify_all();
    let connecting = state.reopening.under_way;
    drop(state);
    let thread = shared.background.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(thread) = thread {
        // A waker may drop the last clone on the background thread itself.
        if !connecting && thread.thread().id() != std::thread::current().id() {
            let _ = thread.join();
        }
    }
}

fn spawn<M: Medium>(shared: &ConnectionInner<M>, state: &mut ConnectionState<M>) {
    // Without an owner left there is nothing to keep.
    let Some(its) = shared.weak_self.upgrade() else { return };
    let thread = std::thread::Builder::new().name("polepair-link".into());
    // Out of threads: the next request tries again, and callers lead for themselves meanwhile.
    if let Ok(handle) = thread.spawn(move || run_thread(&its)) {
        state.background = BackgroundState::Watching;
        *shared.background.thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(handle);
    }
}

fn run_thread<M: Medium>(shared: &ConnectionInner<M>) {
    let mut buffer = M::buffer();
    let mut rounds_seen = u64::MAX;
    let mut idle_looks = 0;
    let mut linger_until = Instant::ZERO;
    let mut state = shared.lock();
    while state.background != BackgroundState::Stopped {
        if state.link_error.is_some() && is_needed(&state) {
            state = run_wakers(shared, reopen_link(shared, state));
        }
        // In virtual time, time would pass without a waiting caller.
        if state.slots.has_wakers() && state.link.is_real_time() {
            linger_until = state.link.now().plus_ns(LINGER_NS);
        }
        if may_lead(&state, rounds_seen, linger_until) {
            idle_looks = 0;
            let lingers = (state.link.now() < linger_until).then_some(linger_until);
            let until = earliest(state.due(), lingers).unwrap_or(Instant::FAR_FUTURE);
            state = run_wakers(
                shared,
                lead_round(shared, state, Leader::Background, until, &mut buffer),
            );
            rounds_seen = state.read_count;
            if !std::mem::take(&mut state.lead_wanted) {
                continue;
            }
            linger_until = Instant::ZERO;
        }
        hand_over_lead(&state);
        idle_looks =
            if is_needed(&state) || state.read_count != rounds_seen { 0 } else { idle_looks + 1 };
        rounds_seen = state.read_count;
        state = wait_for_check(shared, state, &mut idle_looks);
    }
}

/// Wakes wakers without the lock.
fn run_wakers<'a, M: Medium>(
    shared: &'a ConnectionInner<M>,
    mut state: StateGuard<'a, M>,
) -> StateGuard<'a, M> {
    if state.to_wake.is_empty() {
        return state;
    }
    // Without the lock: a waker may ask this connection at once.
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
    shared.lock()
}

/// Returns whether the background thread has to read: no other thread does, or is about to.
fn may_lead<M: Medium>(
    state: &ConnectionState<M>,
    rounds_seen: u64,
    linger_until: Instant,
) -> bool {
    if state.leader != Leader::Nobody || state.link_error.is_some() {
        return false;
    }
    // A caller has read since then: it is at work, and is left to it.
    let quiet = state.read_count == rounds_seen;
    state.slots.has_wakers() || quiet && (is_needed(state) || state.link.now() < linger_until)
}

/// Until the next look, or until called once there was nothing to do for long.
fn wait_for_check<'a, M: Medium>(
    shared: &'a ConnectionInner<M>,
    mut state: StateGuard<'a, M>,
    idle_looks: &mut u32,
) -> StateGuard<'a, M> {
    let called = &shared.background.wake;
    if *idle_looks < IDLE_CHECKS_MAX {
        let lost = state.link_error.is_some();
        let pause = if lost { LINK_CHECK_INTERVAL } else { CHECK_INTERVAL };
        let waited = called.wait_timeout(state, pause);
        return waited.expect("a lane panicked on another thread").0;
    }
    *idle_looks = 0;
    state.background = BackgroundState::Asleep;
    called.wait(state).expect("a lane panicked on another thread")
}
