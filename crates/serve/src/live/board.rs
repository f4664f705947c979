//! Where all viewers read what is the same for each of them: it is made once, however many they are.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::Utf8Bytes;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{Semaphore, broadcast};
use tokio::time::{MissedTickBehavior, interval};

use super::text;
use crate::api::Shared;
use crate::bench::Event;
use crate::message::{AxisState, ServerMessage, Stopped};

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
}

/// Something that happened.
#[derive(Debug, Clone)]
pub(super) enum News {
    Text(Utf8Bytes),
    /// The bench changed: each viewer is told with its own scopes.
    Bench,
    /// Too much happened at once: all is told anew.
    Whole,
}

impl Default for Board {
    fn default() -> Self {
        let places = Arc::new(Semaphore::new(VIEWERS_MAX));
        let (states, news) =
            (broadcast::Sender::new(STATES_MAX), broadcast::Sender::new(EVENTS_MAX));
        Self { states, news, places }
    }
}

impl Board {
    /// Looks after it as long as there is a gate.
    pub async fn look_after(gate: Shared) {
        let mut events = gate.bench.events();
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut shown: Vec<(AxisState, u8)> = Vec::new();
        loop {
            tokio::select! {
                biased;
                event = events.recv() => match event {
                    Ok(event) => gate.board.tell(&gate, event),
                    Err(RecvError::Lagged(_)) => drop(gate.board.news.send(News::Whole)),
                    Err(RecvError::Closed) => return,
                },
                _ = looks.tick() => gate.board.look(&gate, &mut shown),
            }
        }
    }

    fn look(&self, gate: &Shared, shown: &mut Vec<(AxisState, u8)>) {
        if self.states.receiver_count() == 0 {
            return shown.clear();
        }
        for id in 0..=u16::MAX {
            let Ok(state) = gate.bench.axis(id) else { break };
            self.show(state, shown);
        }
    }

    /// Puts up a state that has changed, or was not put up for a while.
    fn show(&self, state: AxisState, shown: &mut Vec<(AxisState, u8)>) {
        let at = usize::from(state.id);
        let ageless = ageless(&state);
        match shown.get_mut(at) {
            Some((before, looks)) if *before == ageless && *looks < LOOKS_MAX => {
                *looks += 1;
                return;
            }
            Some(before) => *before = (ageless, 0),
            None => shown.push((ageless, 0)),
        }
        // Nobody may look any more.
        let _ = self.states.send(text(&ServerMessage::Axis(state)));
    }

    fn tell(&self, gate: &Shared, event: Event) {
        if self.news.receiver_count() == 0 {
            return;
        }
        let message = match event {
            Event::Lease { axis, .. } => match gate.bench.axis(axis) {
                Ok(state) => ServerMessage::Axis(state),
                Err(_) => return,
            },
            Event::Stopped(axis) => ServerMessage::Stopped(Stopped { axes: vec![axis] }),
            Event::Locked(lock) => ServerMessage::Locked(lock),
            Event::Unlocked => ServerMessage::Unlocked,
            Event::Bench => return drop(self.news.send(News::Bench)),
        };
        // The last one may just have gone.
        let _ = self.news.send(News::Text(text(&message)));
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
