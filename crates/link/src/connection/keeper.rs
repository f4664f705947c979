//! The thread that leads when nobody else does.

use std::sync::{Condvar, Mutex, PoisonError};
use std::task;
use std::thread::JoinHandle;
use std::time::Duration;

use polepair_core::medium::Medium;
use polepair_core::time::{Instant, earliest};

use super::Shared;
use super::lead::{Guard, hand_over, reopen, round};
use super::state::{Leader, State, Watch};

/// How often a watching keeper looks whether it is needed; also the quiet that it waits for before
/// it leads in a caller's place.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// How often it looks while the link is lost.
const LOOK_FOR_LINK_EVERY: Duration = Duration::from_millis(50);
/// After so many looks without need it sleeps.
const IDLE_LOOKS_MAX: u32 = 100;
/// How long it goes on leading for wakers (asyncio), so that their next request finds it there.
const LINGER_NS: u64 = 500_000_000;
/// Attempts to open a lost link, four a second; later ones only when somebody asks for something.
const REOPEN_MAX: u32 = 480;

#[derive(Default)]
pub(super) struct Keeper {
    called: Condvar,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// True when time must pass though no caller waits. Where time passes only while somebody waits, it
/// is not the keeper's to let it pass for plans and links that nobody waits for: their callers do,
/// and the same happens each time.
pub(super) fn needed<M: Medium>(state: &State<M>) -> bool {
    match state.trouble {
        None if !state.link.runs_by_itself() => state.slots.anybody_asleep(),
        Some(_) if !state.link.runs_by_itself() => false,
        Some(_) => state.retry.tried < REOPEN_MAX,
        None => state.due().is_some() || state.slots.anybody_asleep() || state.is_listened_to(),
    }
}

/// Makes sure that it watches. Costs nothing when it does.
pub(super) fn nudge<M: Medium>(shared: &Shared<M>, state: &mut State<M>) {
    match state.keeper {
        Watch::NotStarted => start(shared, state),
        Watch::Asleep => {
            state.keeper = Watch::Watching;
            shared.keeper.called.notify_one();
        }
        Watch::Watching | Watch::Dismissed => {}
    }
}

/// Makes it lead now, if nobody does.
pub(super) fn call<M: Medium>(shared: &Shared<M>, state: &mut State<M>) {
    nudge(shared, state);
    if state.leader == Leader::Nobody {
        shared.keeper.called.notify_one();
    }
}

/// Ends it, and waits for that unless it is connecting somewhere, which may take seconds.
pub(super) fn dismiss<M: Medium>(shared: &Shared<M>) {
    let Ok(mut state) = shared.state.lock() else { return };
    state.keeper = Watch::Dismissed;
    state.link.waker().wake();
    shared.keeper.called.notify_all();
    let connecting = state.retry.under_way;
    drop(state);
    let thread = shared.keeper.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(thread) = thread {
        // A waker may drop the last clone on the keeper's own thread.
        if !connecting && thread.thread().id() != std::thread::current().id() {
            let _ = thread.join();
        }
    }
}

fn start<M: Medium>(shared: &Shared<M>, state: &mut State<M>) {
    // Without an owner left there is nothing to keep.
    let Some(its) = shared.me.upgrade() else { return };
    let thread = std::thread::Builder::new().name("polepair-keeper".into());
    // Out of threads: the next request tries again, and callers lead for themselves meanwhile.
    if let Ok(handle) = thread.spawn(move || run(&its)) {
        state.keeper = Watch::Watching;
        *shared.keeper.thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(handle);
    }
}

fn run<M: Medium>(shared: &Shared<M>) {
    let mut buffer = M::buffer();
    let mut rounds_seen = u64::MAX;
    let mut idle_looks = 0;
    let mut linger_until = Instant::ZERO;
    let mut state = shared.lock();
    while state.keeper != Watch::Dismissed {
        if state.trouble.is_some() && needed(&state) {
            state = flush(shared, reopen(shared, state));
        }
        if state.slots.anybody_asleep() {
            linger_until = state.link.now().plus_ns(LINGER_NS);
        }
        if may_lead(&state, rounds_seen, linger_until) {
            idle_looks = 0;
            let lingers = (state.link.now() < linger_until).then_some(linger_until);
            let until = earliest(state.due(), lingers).unwrap_or(Instant::FAR);
            state = flush(shared, round(shared, state, Leader::Keeper, until, &mut buffer));
            rounds_seen = state.rounds;
            if !std::mem::take(&mut state.wanted) {
                continue;
            }
            linger_until = Instant::ZERO;
        }
        hand_over(&state);
        idle_looks = if needed(&state) || state.rounds != rounds_seen { 0 } else { idle_looks + 1 };
        rounds_seen = state.rounds;
        state = pause(shared, state, &mut idle_looks);
    }
}

/// Wakes wakers without the lock.
fn flush<'a, M: Medium>(shared: &'a Shared<M>, mut state: Guard<'a, M>) -> Guard<'a, M> {
    if state.to_wake.is_empty() {
        return state;
    }
    let wakers = std::mem::take(&mut state.to_wake);
    drop(state);
    wakers.into_iter().for_each(task::Waker::wake);
    shared.lock()
}

/// Nobody leads, somebody must, and no caller has just led or is about to.
fn may_lead<M: Medium>(state: &State<M>, rounds_seen: u64, linger_until: Instant) -> bool {
    if state.leader != Leader::Nobody || state.trouble.is_some() {
        return false;
    }
    let quiet = state.rounds == rounds_seen;
    state.slots.anybody_asleep() || quiet && (needed(state) || state.link.now() < linger_until)
}

/// Until the next look, or until called once there was nothing to do for long.
fn pause<'a, M: Medium>(
    shared: &'a Shared<M>,
    mut state: Guard<'a, M>,
    idle_looks: &mut u32,
) -> Guard<'a, M> {
    let called = &shared.keeper.called;
    if *idle_looks < IDLE_LOOKS_MAX {
        let lost = state.trouble.is_some();
        let pause = if lost { LOOK_FOR_LINK_EVERY } else { LOOK_EVERY };
        let waited = called.wait_timeout(state, pause);
        return waited.expect("a lane panicked on another thread").0;
    }
    *idle_looks = 0;
    state.keeper = Watch::Asleep;
    called.wait(state).expect("a lane panicked on another thread")
}
