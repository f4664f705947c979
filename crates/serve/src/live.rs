//! The WebSocket: one for each viewer, with a reader that never waits for drives and a writer that puts
//! what was asked before what is merely shown.
//!
//! What is the same for all viewers is made once, by the [`Board`]. Telemetry and frames are taken from
//! the bench by each viewer's writer when nothing else is to be said ([`watched`]). Writers have a
//! runtime of their own: however many there are, who reads commands does not wait for them. A viewer
//! that takes nothing for five seconds is closed: it is asked each second whether it is there. Its
//! leases end with it, and nothing is watched for it any more.

mod board;
mod watched;

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, State};
use axum::response::{IntoResponse as _, Response};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use polepair_core::time::Instant;
use polepair_link::clock;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{Semaphore, broadcast, mpsc};
use tokio::time::{MissedTickBehavior, interval, timeout};

use crate::api::{self, COMMAND, Needs, Shared};
use crate::bench::Session;
use crate::message::{
    ClientMessage, CommandOrder, Ended, ErrorBody, LeaseAct, Outcome, PROTOCOL, Refused,
    ServerMessage, StopOrder, Welcome,
};
use crate::scope::Scope;
use crate::session::Caller;
use board::News;
use watched::{Round, Watched};

pub(crate) use board::Board;

/// Bytes of a message.
pub const MESSAGE_MAX: usize = 64 * 1024;
/// Answers that wait for one viewer.
const ANSWERS_MAX: usize = 256;
/// Commands of one viewer that are under way; as many orders about leases have places of their own,
/// so that long motions keep no lease from being renewed.
const COMMANDS_MAX: usize = 64;
/// Messages of a viewer in each [`SPAN`]; what is more waits in its socket.
const MESSAGES_MAX: u32 = 200;
/// A tenth of a second.
const SPAN: Duration = Duration::from_millis(100);
/// How long a viewer may take nothing.
const SILENT_MAX: Duration = Duration::from_secs(5);
/// How often it is asked whether it is there.
const ASK: Duration = Duration::from_secs(1);

/// Watch and command
///
/// A WebSocket of the sub-protocol `polepair.v1`. Texts are `ClientMessage` and `ServerMessage`; the
/// binary ones are telemetry.
#[utoipa::path(get, path = "/api/v1/live", tag = "live", responses(
    (status = 101, description = "The WebSocket"),
    (status = "default", body = ErrorBody),
))]
pub(crate) async fn upgrade(
    State(gate): State<Shared>,
    Extension(caller): Extension<Caller>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let wrong = |what: String| Refused::new("gateway.request", what).into_response();
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade.protocols([PROTOCOL]),
        Err(error) => return wrong(error.body_text()),
    };
    if upgrade.selected_protocol().is_none() {
        return wrong(format!("this is for the sub-protocol {PROTOCOL}"));
    }
    let Ok(place) = Arc::clone(&gate.board.places).try_acquire_owned() else {
        return Refused::new("gateway.busy", "as many watch as can").into_response();
    };
    let upgrade = upgrade.max_message_size(MESSAGE_MAX).max_frame_size(MESSAGE_MAX);
    upgrade.on_upgrade(move |socket| async move {
        gate.metrics.viewers.inc();
        let session = gate.session(&caller);
        tracing::info!(%session, "a viewer came");
        Viewer::watch(&gate, caller, &session, socket).await;
        tracing::info!(%session, "a viewer went");
        gate.bench.gone(&session);
        gate.metrics.viewers.dec();
        drop(place);
    })
}

/// One viewer.
struct Viewer {
    gate: Shared,
    caller: Caller,
    session: Session,
    answers: mpsc::Sender<Utf8Bytes>,
    under_way: Arc<Semaphore>,
    leasing: Arc<Semaphore>,
    watched: Arc<Watched>,
}

impl Viewer {
    async fn watch(gate: &Shared, caller: Caller, session: &Session, socket: WebSocket) {
        let (to, from) = socket.split();
        let (answers, waiting) = mpsc::channel(ANSWERS_MAX);
        let watched = Arc::<Watched>::default();
        let shown = Shown {
            gate: Arc::clone(gate),
            caller: caller.clone(),
            waiting,
            news: gate.board.news.subscribe(),
            states: gate.board.states.subscribe(),
            watched: Arc::clone(&watched),
        };
        let places = || Arc::new(Semaphore::new(COMMANDS_MAX));
        let (under_way, leasing) = (places(), places());
        let (gate, session) = (Arc::clone(gate), session.clone());
        let viewer = Self { gate, caller, session, answers, under_way, leasing, watched };
        let mut writing = viewer.gate.shows.spawn(shown.write(to, viewer.welcome()));
        tokio::select! {
            _ = &mut writing => {}
            () = viewer.read(from) => {
                writing.abort();
                // What was watched is free once that has ended, as it was told to.
                let _ = writing.await;
            }
        }
    }

    /// What is said first.
    fn welcome(&self) -> Utf8Bytes {
        let bench = &self.gate.bench;
        text(&ServerMessage::Welcome(Welcome {
            server_ms: bench.now_ms(),
            t0_ms: bench.t0_ms(),
            session: self.session.to_string(),
            scopes: self.caller.scopes.iter().collect(),
            lease_ms: u32::try_from(bench.lease_lasts().as_millis()).unwrap_or(u32::MAX),
        }))
    }

    async fn read(&self, mut from: SplitStream<WebSocket>) {
        let mut pace = Pace::default();
        // It says at least that it is there, unless it takes nothing.
        while let Ok(Some(Ok(message))) = timeout(SILENT_MAX, from.next()).await {
            pace.keep().await;
            let told = match message {
                Message::Text(text) => self.hear(&text),
                Message::Binary(_) => Some(error("a message is a text", None, None)),
                Message::Close(_) => return,
                Message::Ping(_) | Message::Pong(_) => None,
            };
            if let Some(told) = told
                && self.answers.send(text(&told)).await.is_err()
            {
                return;
            }
        }
    }

    /// Takes a message. What cannot be answered at once is answered later.
    fn hear(&self, said: &str) -> Option<ServerMessage> {
        let message = match serde_json::from_str::<ClientMessage>(said) {
            Ok(message) => message,
            Err(wrong) => return Some(error(&wrong.to_string(), None, None)),
        };
        let (about, needs) = about(&message);
        if !needs.met_by(self.caller.scopes) {
            let grants = self.caller.scopes;
            let refused = Refused::new("gateway.scope", format!("this needs the scope {needs}"))
                .hint(format!("this token grants {grants}"));
            self.gate.metrics.refused(&refused.code);
            return Some(self.refused(&message, about, refused));
        }
        match message {
            ClientMessage::Ping { client_ms } => {
                let server_ms = self.gate.bench.now_ms();
                return Some(ServerMessage::Pong { client_ms, server_ms });
            }
            ClientMessage::Stop { axes, reason } => self.stop(StopOrder { axes, reason }),
            ClientMessage::Release => {
                let released = self.gate.bench.release(&self.session);
                return released.err().map(|refused| told(refused, Some(about), None));
            }
            ClientMessage::Command { axis, command } => return self.command(axis, command),
            ClientMessage::Lease { axis, act, epoch } => return self.lease(axis, act, epoch),
            shown => return self.show(shown),
        }
        None
    }

    /// What only looks. What is watched is told by the writer.
    fn show(&self, message: ClientMessage) -> Option<ServerMessage> {
        let (bench, watched) = (&self.gate.bench, &self.watched);
        let (about, _) = about(&message);
        let (shown, subject) = match message {
            ClientMessage::Subscribe { channel, axis, signal, parameter, hz } => {
                let subscribed = bench.subscribe(axis, signal.as_deref(), parameter.as_deref(), hz);
                (subscribed.and_then(|its| watched.subscribe(channel, its)), Some(channel))
            }
            ClientMessage::Unsubscribe { channel } => {
                watched.unsubscribe(channel);
                return None;
            }
            ClientMessage::Frames { on: true, filter } => {
                (watched.frames(bench, filter.as_deref()), None)
            }
            ClientMessage::Explain { n } => match bench.explain(n) {
                Ok(fields) => return Some(ServerMessage::Explained { n, fields }),
                Err(refused) => (Err(refused), None),
            },
            _ => {
                watched.no_frames();
                return None;
            }
        };
        shown.err().map(|refused| told(refused, Some(about), subject))
    }

    fn refused(&self, message: &ClientMessage, about: &str, refused: Refused) -> ServerMessage {
        match message {
            ClientMessage::Command { command, .. } => not_done(command.id.clone(), refused),
            ClientMessage::Lease { axis, .. } => told(refused, Some(about), Some(*axis)),
            _ => told(refused, Some(about), None),
        }
    }

    /// How far it came is told by events, to everybody.
    fn stop(&self, order: StopOrder) {
        let since = clock::now();
        let stopped = self.gate.bench.stop(&self.session, &order);
        // Whoever floods us with stops is obeyed, not measured.
        if let Ok(place) = Arc::clone(&self.under_way).try_acquire_owned() {
            let gate = Arc::clone(&self.gate);
            tokio::spawn(async move {
                if stopped.await.is_ok() {
                    gate.metrics.stops.observe(clock::now().since(since).as_secs_f64());
                }
                drop(place);
            });
        }
    }

    fn command(&self, axis: u16, order: CommandOrder) -> Option<ServerMessage> {
        let id = order.id.clone();
        let Ok(place) = Arc::clone(&self.under_way).try_acquire_owned() else {
            return Some(not_done(id, busy()));
        };
        let since = clock::now();
        let outcome = self.gate.bench.command(axis, &self.session, order);
        let (gate, answers) = (Arc::clone(&self.gate), self.answers.clone());
        tokio::spawn(async move {
            let told = match outcome.await {
                Ok(outcome) => ServerMessage::Outcome(outcome),
                Err(refused) => not_done(id, refused),
            };
            gate.metrics.commands.observe(clock::now().since(since).as_secs_f64());
            // It has gone: what it commanded ends with its leases.
            let _ = answers.send(text(&told)).await;
            drop(place);
        });
        None
    }

    fn lease(&self, axis: u16, act: LeaseAct, epoch: u64) -> Option<ServerMessage> {
        let Ok(place) = Arc::clone(&self.leasing).try_acquire_owned() else {
            return Some(told(busy(), Some("lease"), Some(axis)));
        };
        let granted = self.gate.bench.lease(axis, &self.session, act, epoch);
        let answers = self.answers.clone();
        tokio::spawn(async move {
            let said = match granted.await {
                Ok(granted) => ServerMessage::Leased {
                    axis,
                    epoch: granted.map_or(epoch, |lease| lease.epoch),
                    expires_ms: granted.map(|lease| lease.expires_ms),
                },
                Err(refused) => told(refused, Some("lease"), Some(axis)),
            };
            let _ = answers.send(text(&said)).await;
            drop(place);
        });
        None
    }
}

/// Keeps whoever floods us from taking a processor that others need.
struct Pace {
    since: Instant,
    count: u32,
}

impl Default for Pace {
    fn default() -> Self {
        Self { since: clock::now(), count: 0 }
    }
}

impl Pace {
    /// Counts a message; waits until the span is over in which there were too many.
    async fn keep(&mut self) {
        self.count += 1;
        if self.count > MESSAGES_MAX {
            tokio::time::sleep((self.since + SPAN).since(clock::now())).await;
            *self = Self::default();
        }
    }
}

/// What a viewer is shown.
struct Shown {
    gate: Shared,
    caller: Caller,
    waiting: mpsc::Receiver<Utf8Bytes>,
    news: broadcast::Receiver<News>,
    states: broadcast::Receiver<Utf8Bytes>,
    watched: Arc<Watched>,
}

impl Shown {
    /// Writes until the viewer is gone, or takes nothing.
    async fn write(mut self, mut to: SplitSink<WebSocket, Message>, welcome: Utf8Bytes) {
        let (mut asks, mut round) = (interval(ASK), Round::default());
        asks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut messages = vec![Message::Text(welcome)];
        messages.extend(self.whole());
        loop {
            for message in messages.drain(..) {
                let sent = timeout(SILENT_MAX, to.send(message)).await;
                if !matches!(sent, Ok(Ok(()))) {
                    return;
                }
            }
            // What was asked comes before what happens, and that before what is merely shown.
            tokio::select! {
                biased;
                text = self.waiting.recv() => match text {
                    Some(text) => messages.push(Message::Text(text)),
                    None => return,
                },
                news = self.news.recv() => match news {
                    Ok(News::Text(text)) => messages.push(Message::Text(text)),
                    Ok(News::Bench) => messages.push(self.bench().0),
                    Ok(News::Whole) | Err(RecvError::Lagged(_)) => messages.extend(self.whole()),
                    Err(RecvError::Closed) => return,
                },
                _ = asks.tick() => messages.push(Message::Ping(Bytes::new())),
                state = self.states.recv() => match state {
                    Ok(state) => messages.push(Message::Text(state)),
                    Err(RecvError::Lagged(lost)) => drop(self.gate.metrics.dropped.inc_by(lost)),
                    Err(RecvError::Closed) => return,
                },
                message = round.message(&self.watched, &self.gate.metrics) => messages.push(message),
            }
        }
    }

    /// The bench, and how many axes it has.
    fn bench(&self) -> (Message, u16) {
        let bench = api::bench_of(&self.gate, &self.caller);
        let axes = u16::try_from(bench.axes.len()).unwrap_or(u16::MAX);
        (Message::Text(text(&ServerMessage::Bench(bench))), axes)
    }

    /// The bench and every axis.
    fn whole(&self) -> Vec<Message> {
        let (bench, axes) = self.bench();
        let states = (0..axes).filter_map(|id| self.gate.bench.axis(id).ok());
        let states = states.map(|state| Message::Text(text(&ServerMessage::Axis(state))));
        std::iter::once(bench).chain(states).collect()
    }
}

/// A message's `type`, and what it needs besides being let in.
fn about(message: &ClientMessage) -> (&'static str, Needs) {
    let needs = |scopes| Needs::One(scopes);
    match message {
        ClientMessage::Command { .. } => ("command", needs(&[Scope::Move])),
        ClientMessage::Lease { .. } => ("lease", needs(COMMAND)),
        ClientMessage::Stop { .. } => ("stop", needs(&[Scope::Stop])),
        ClientMessage::Release => ("release", needs(&[Scope::Move])),
        ClientMessage::Ping { .. } => ("ping", needs(&[Scope::Read])),
        ClientMessage::Subscribe { .. } => ("subscribe", needs(&[Scope::Read])),
        ClientMessage::Unsubscribe { .. } => ("unsubscribe", needs(&[Scope::Read])),
        ClientMessage::Frames { .. } => ("frames", needs(&[Scope::Read])),
        ClientMessage::Explain { .. } => ("explain", needs(&[Scope::Read])),
    }
}

fn text(message: &ServerMessage) -> Utf8Bytes {
    // Made of strings and finite numbers, it can always be written down.
    serde_json::to_string(message).unwrap_or_default().into()
}

fn told(error: Refused, about: Option<&str>, subject: Option<u16>) -> ServerMessage {
    ServerMessage::Error { error, about: about.map(str::to_owned), subject }
}

fn error(what: &str, about: Option<&str>, subject: Option<u16>) -> ServerMessage {
    told(Refused::new("gateway.request", what), about, subject)
}

fn not_done(id: String, refused: Refused) -> ServerMessage {
    let error = Some(refused);
    let outcome = Outcome { id, outcome: Ended::NotDone, value: None, error, replayed: false };
    ServerMessage::Outcome(outcome)
}

fn busy() -> Refused {
    Refused::new("gateway.busy", "too much of this viewer is under way").hint("wait for outcomes")
}
