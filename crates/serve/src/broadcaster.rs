//! Data that are the same for all viewers, made once.
//!
//! The broadcaster has its own thread of normal priority, the only one that reads links and axes for viewers. The
//! viewers' writers have low priority, so a lock that they hold may be held for long. They read the result here, behind
//! a lock that motion and stops do not need.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;
use tokio::runtime::Builder;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{Semaphore, broadcast, oneshot};
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::tungstenite::Utf8Bytes;

use crate::bench::{Bench, BenchEvent};
use crate::error::SetupError;
use crate::message::{AxisState, BenchView, ServerMessage, StopReport};

/// Viewers at once.
pub const VIEWERS_MAX: usize = 2048;
/// Interval of reading the states.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Reads after which a state is sent although only its age has changed.
const POLLS_UNCHANGED_MAX: u8 = 10;
/// States that a slow viewer may be behind.
const STATES_MAX: usize = 256;
/// Events that it may be behind.
const EVENTS_MAX: usize = 1024;

/// Broadcaster of data that are the same for all viewers.
#[derive(Debug, Clone)]
pub(crate) struct Broadcaster {
    /// States of axes, which may be missed: the next one has it all.
    pub(crate) states: broadcast::Sender<Utf8Bytes>,
    /// Events for viewers.
    pub(crate) events: broadcast::Sender<BroadcastEvent>,
    pub(crate) viewer_slots: Arc<Semaphore>,
    cache: Arc<Mutex<BroadcastCache>>,
}

/// Last read bench, and axes while there are viewers.
#[derive(Debug, Default)]
struct BroadcastCache {
    /// Scopes are each viewer's own.
    bench: Option<BenchView>,
    axes: Vec<PublishedState>,
}

/// A state as it was last put up.
#[derive(Debug)]
struct PublishedState {
    /// Without ages.
    published: AxisState,
    /// Looks since.
    polls: u8,
    /// State at the last read.
    state: AxisState,
    at: Instant,
}

/// Something that happened.
#[derive(Debug, Clone)]
pub(crate) enum BroadcastEvent {
    Message(Utf8Bytes),
    /// The bench changed: each viewer gets it with its own scopes.
    BenchChanged,
    /// Too many events at once: everything is sent again.
    Resync,
    /// The server ends, and this was the last.
    Closed,
}

impl Default for Broadcaster {
    fn default() -> Self {
        let places = Arc::new(Semaphore::new(VIEWERS_MAX));
        let (states, event_sender) =
            (broadcast::Sender::new(STATES_MAX), broadcast::Sender::new(EVENTS_MAX));
        Self { states, events: event_sender, viewer_slots: places, cache: Arc::default() }
    }
}

impl Broadcaster {
    /// Has a thread look after it until that ends.
    pub fn start(
        &self,
        bench: Bench,
        mut end: oneshot::Receiver<()>,
    ) -> Result<JoinHandle<()>, SetupError> {
        let broadcaster = self.clone();
        let runtime = Builder::new_current_thread().enable_time().build().map_err(thread_error)?;
        std::thread::Builder::new()
            .name("broadcaster".into())
            .spawn(move || {
                runtime.block_on(async {
                    let mut events = bench.subscribe_events();
                    let ended = tokio::select! {
                        () = broadcaster.run(&bench, &mut events) => return,
                        // The sender of the end may be gone as well.
                        ended = &mut end => ended,
                    };
                    // Events of the last stops are still sent.
                    while let Ok(event) = events.try_recv() {
                        broadcaster.publish_event(&bench, event);
                    }
                    if ended.is_ok() {
                        broadcaster.publish_final_states(&bench);
                        // There may be no viewer.
                        let _ = broadcaster.events.send(BroadcastEvent::Closed);
                    }
                });
            })
            .map_err(thread_error)
    }

    async fn run(&self, bench: &Bench, events: &mut broadcast::Receiver<BenchEvent>) {
        let mut looks = interval(POLL_INTERVAL);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                biased;
                event = events.recv() => match event {
                    Ok(event) => self.publish_event(bench, event),
                    Err(RecvError::Lagged(_)) => self.resync(bench),
                    Err(RecvError::Closed) => return,
                },
                _ = looks.tick() => self.poll_states(bench),
            }
        }
    }

    /// The bench as it was last looked at.
    pub(crate) fn cached_bench(&self) -> Option<BenchView> {
        self.lock_cache().bench.clone()
    }

    /// The axes' states as they were last looked at, and as old as they are by now.
    pub(crate) fn cached_axes(&self) -> Vec<AxisState> {
        let now = clock::now();
        self.lock_cache().axes.iter().map(|shown| shown.with_current_age(now)).collect()
    }

    fn lock_cache(&self) -> MutexGuard<'_, BroadcastCache> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn refresh_bench(&self, bench: &Bench) {
        let view = bench.snapshot();
        self.lock_cache().bench = Some(view);
    }

    fn poll_states(&self, bench: &Bench) {
        // The first viewer must not wait for a change of the bench.
        if self.lock_cache().bench.is_none() {
            self.refresh_bench(bench);
        }
        if self.states.receiver_count() == 0 {
            // States are not read without viewers: each reading takes the locks that workers need.
            return self.lock_cache().axes.clear();
        }
        for id in 0..=u16::MAX {
            let Ok(state) = bench.axis_state(id) else { break };
            self.publish_state(state);
        }
    }

    /// Publishes the final state of each axis.
    fn publish_final_states(&self, bench: &Bench) {
        for state in (0..=u16::MAX).map_while(|id| bench.axis_state(id).ok()) {
            // There may be no viewer.
            let _ = self.events.send(BroadcastEvent::Message(to_json(&ServerMessage::Axis(state))));
        }
    }

    /// Waits until no viewer is left, at most `max`.
    pub async fn wait_until_empty(&self, max: Duration) {
        let all = self.viewer_slots.acquire_many(VIEWERS_MAX as u32);
        // Viewers that are still connected then are cut off.
        let _ = timeout(max, all).await;
    }

    /// Sends everything again to all viewers.
    fn resync(&self, bench: &Bench) {
        self.refresh_bench(bench);
        self.poll_states(bench);
        // The last one may just have gone.
        let _ = self.events.send(BroadcastEvent::Resync);
    }

    /// Puts up a state that has changed, or was not put up for a while.
    fn publish_state(&self, state: AxisState) {
        // Ages grow with every poll: a state that differs in nothing else is not sent again.
        let (axis_state, at) = (without_ages(&state), clock::now());
        let shown = PublishedState { published: axis_state, polls: 0, state: state.clone(), at };
        {
            let mut known = self.lock_cache();
            match known.axes.get_mut(usize::from(state.id)) {
                Some(before)
                    if before.published == shown.published
                        && before.polls < POLLS_UNCHANGED_MAX =>
                {
                    *before = PublishedState { polls: before.polls + 1, ..shown };
                    return;
                }
                Some(before) => *before = shown,
                None => known.axes.push(shown),
            }
        }
        // There may be no viewer any more.
        let _ = self.states.send(to_json(&ServerMessage::Axis(state)));
    }

    fn publish_event(&self, bench: &Bench, event: BenchEvent) {
        // Also without viewers: the next one finds it.
        if matches!(
            event,
            BenchEvent::Locked(_)
                | BenchEvent::Unlocked
                | BenchEvent::BenchChanged
                | BenchEvent::Scan(_)
                | BenchEvent::Search(_)
        ) {
            self.refresh_bench(bench);
        }
        if self.events.receiver_count() == 0 {
            return;
        }
        let message = match event {
            BenchEvent::Lease { axis, .. } | BenchEvent::PendingStop(axis) => {
                match bench.axis_state(axis) {
                    Ok(state) => ServerMessage::Axis(state),
                    Err(_) => return,
                }
            }
            BenchEvent::Stopped(axis) => ServerMessage::Stopped(StopReport {
                axes: vec![axis],
                unreached: Vec::new(),
                refused: Vec::new(),
            }),
            BenchEvent::Locked(lock) => ServerMessage::Locked(lock),
            BenchEvent::Unlocked => ServerMessage::Unlocked,
            BenchEvent::Scan(view) => ServerMessage::Look(view),
            BenchEvent::Search(view) => ServerMessage::Search(view),
            BenchEvent::BenchChanged => {
                return drop(self.events.send(BroadcastEvent::BenchChanged));
            }
        };
        // The last one may just have gone.
        let _ = self.events.send(BroadcastEvent::Message(to_json(&message)));
    }
}

fn thread_error(error: std::io::Error) -> SetupError {
    SetupError::adapter("E318", "no threads can be started").why(error.to_string())
}

impl PublishedState {
    /// The state with the age that its values have now.
    fn with_current_age(&self, now: Instant) -> AxisState {
        let (mut state, ms) = (self.state.clone(), now.since(self.at).as_secs_f64() * 1e3);
        state.signals.iter_mut().for_each(|signal| signal.age_ms += ms);
        state
    }
}

fn without_ages(state: &AxisState) -> AxisState {
    let mut state = state.clone();
    state.signals.iter_mut().for_each(|signal| signal.age_ms = 0.0);
    if let Some(lease) = &mut state.lease {
        lease.expires_ms = 0.0;
    }
    state
}

pub(crate) fn to_json(message: &ServerMessage) -> Utf8Bytes {
    serde_json::to_string(message).expect("a message is of strings and finite numbers").into()
}
