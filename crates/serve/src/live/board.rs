//! Where all viewers read what is the same for each of them: it is made once, however many they are.
//!
//! It has a thread of its own, as important as any other, which alone looks at links and axes for
//! viewers: their writers stand back, and a lock that one of those has is had for as long as the
//! machine is busy. They find here what was looked at, behind a lock that nobody needs who moves or
//! stops anything.

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

use super::text;
use crate::api::Shared;
use crate::bench::Event;
use crate::message::{AxisState, BenchView, ServerMessage, Stopped};
use crate::refusal::Refusal;

/// Viewers at once.
pub const VIEWERS_MAX: usize = 2048;
/// How often states are looked at.
const LOOK: Duration = Duration::from_millis(100);
/// After how many looks a state is told though only its age has changed.
const LOOKS_MAX: u8 = 10;
/// States that a slow viewer may be behind.
const STATES_MAX: usize = 256;
/// Events that it may be behind.
const EVENTS_MAX: usize = 1024;

/// What viewers are told.
#[derive(Debug, Clone)]
pub(crate) struct Board {
    /// States of axes, which may be missed: the next one has it all.
    pub(super) states: broadcast::Sender<Utf8Bytes>,
    /// What happened.
    pub(super) news: broadcast::Sender<News>,
    pub(super) places: Arc<Semaphore>,
    known: Arc<Mutex<Known>>,
}

/// What was last looked at; axes, while somebody watches.
#[derive(Debug, Default)]
struct Known {
    /// Scopes are each viewer's own.
    bench: Option<BenchView>,
    axes: Vec<PutUp>,
}

/// A state as it was last put up.
#[derive(Debug)]
struct PutUp {
    /// Without ages.
    told: AxisState,
    /// Looks since.
    looks: u8,
    /// As it was last looked at.
    state: AxisState,
    at: Instant,
}

/// Something that happened.
#[derive(Debug, Clone)]
pub(super) enum News {
    Text(Utf8Bytes),
    /// The bench changed: each viewer is told with its own scopes.
    Bench,
    /// Too much happened at once: all is told anew.
    Whole,
    /// The server ends, and this was the last.
    End,
}

impl Default for Board {
    fn default() -> Self {
        let places = Arc::new(Semaphore::new(VIEWERS_MAX));
        let (states, news) =
            (broadcast::Sender::new(STATES_MAX), broadcast::Sender::new(EVENTS_MAX));
        Self { states, news, places, known: Arc::default() }
    }
}

impl Board {
    /// Has a thread look after it until that ends.
    pub fn start(gate: Shared, mut end: oneshot::Receiver<()>) -> Result<JoinHandle<()>, Refusal> {
        let refused = |error: std::io::Error| {
            Refusal::adapter("E318", "no threads can be started").why(error.to_string())
        };
        let runtime = Builder::new_current_thread().enable_time().build().map_err(refused)?;
        let looks = move || {
            runtime.block_on(async {
                let mut events = gate.bench.events();
                let ended = tokio::select! {
                    () = Self::look_after(&gate, &mut events) => return,
                    // Who could say so may be gone as well.
                    ended = &mut end => ended,
                };
                // What stops told at the last is told on.
                while let Ok(event) = events.try_recv() {
                    gate.board.tell(&gate, event);
                }
                if ended.is_ok() {
                    gate.board.say_last(&gate);
                    // Nobody may watch.
                    let _ = gate.board.news.send(News::End);
                }
            });
        };
        std::thread::Builder::new().name("gateway-board".into()).spawn(looks).map_err(refused)
    }

    async fn look_after(gate: &Shared, events: &mut broadcast::Receiver<Event>) {
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                biased;
                event = events.recv() => match event {
                    Ok(event) => gate.board.tell(gate, event),
                    Err(RecvError::Lagged(_)) => gate.board.whole(gate),
                    Err(RecvError::Closed) => return,
                },
                _ = looks.tick() => gate.board.look(gate),
            }
        }
    }

    /// The bench as it was last looked at.
    pub(super) fn bench(&self) -> Option<BenchView> {
        self.known().bench.clone()
    }

    /// The axes' states as they were last looked at, and as old as they are by now.
    pub(super) fn axes(&self) -> Vec<AxisState> {
        let now = clock::now();
        self.known().axes.iter().map(|shown| shown.older(now)).collect()
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn look_at_bench(&self, gate: &Shared) {
        let bench = gate.bench.snapshot();
        self.known().bench = Some(bench);
    }

    fn look(&self, gate: &Shared) {
        if self.known().bench.is_none() {
            self.look_at_bench(gate);
        }
        if self.states.receiver_count() == 0 {
            return self.known().axes.clear();
        }
        for id in 0..=u16::MAX {
            let Ok(state) = gate.bench.axis(id) else { break };
            self.show(state);
        }
    }

    /// Says how each axis was left.
    fn say_last(&self, gate: &Shared) {
        for state in (0..=u16::MAX).map_while(|id| gate.bench.axis(id).ok()) {
            // Nobody may watch.
            let _ = self.news.send(News::Text(text(&ServerMessage::Axis(state))));
        }
    }

    /// Waits until nobody watches any more, or for so long.
    pub async fn empty(&self, most: Duration) {
        let all = self.places.acquire_many(VIEWERS_MAX as u32);
        // Who still watches then is left alone.
        let _ = timeout(most, all).await;
    }

    /// Tells everybody everything anew.
    fn whole(&self, gate: &Shared) {
        self.look_at_bench(gate);
        self.look(gate);
        // The last one may just have gone.
        let _ = self.news.send(News::Whole);
    }

    /// Puts up a state that has changed, or was not put up for a while.
    fn show(&self, state: AxisState) {
        let (told, at) = (ageless(&state), clock::now());
        let shown = PutUp { told, looks: 0, state: state.clone(), at };
        {
            let mut known = self.known();
            match known.axes.get_mut(usize::from(state.id)) {
                Some(before) if before.told == shown.told && before.looks < LOOKS_MAX => {
                    *before = PutUp { looks: before.looks + 1, ..shown };
                    return;
                }
                Some(before) => *before = shown,
                None => known.axes.push(shown),
            }
        }
        // Nobody may look any more.
        let _ = self.states.send(text(&ServerMessage::Axis(state)));
    }

    fn tell(&self, gate: &Shared, event: Event) {
        // Also while nobody watches: who comes next finds it.
        if matches!(event, Event::Locked(_) | Event::Unlocked | Event::Bench | Event::Look(_)) {
            self.look_at_bench(gate);
        }
        if self.news.receiver_count() == 0 {
            return;
        }
        let message = match event {
            Event::Lease { axis, .. } | Event::Owed(axis) => match gate.bench.axis(axis) {
                Ok(state) => ServerMessage::Axis(state),
                Err(_) => return,
            },
            Event::Stopped(axis) => {
                ServerMessage::Stopped(Stopped { axes: vec![axis], unreached: Vec::new() })
            }
            Event::Locked(lock) => ServerMessage::Locked(lock),
            Event::Unlocked => ServerMessage::Unlocked,
            Event::Look(look) => ServerMessage::Look(look),
            Event::Bench => return drop(self.news.send(News::Bench)),
        };
        // The last one may just have gone.
        let _ = self.news.send(News::Text(text(&message)));
    }
}

impl PutUp {
    /// The state with the age that its values have now.
    fn older(&self, now: Instant) -> AxisState {
        let (mut state, ms) = (self.state.clone(), now.since(self.at).as_secs_f64() * 1e3);
        state.signals.iter_mut().for_each(|signal| signal.age_ms += ms);
        state
    }
}

fn ageless(state: &AxisState) -> AxisState {
    let mut state = state.clone();
    state.signals.iter_mut().for_each(|signal| signal.age_ms = 0.0);
    if let Some(lease) = &mut state.lease {
        lease.expires_ms = 0.0;
    }
    state
}
