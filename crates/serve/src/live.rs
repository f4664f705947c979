//! The WebSocket: one for each viewer, with a reader that never waits for drives and a writer that puts
//! what was asked before what is merely shown.
//!
//! A stop goes before whatever its own viewer said before it and is not done yet ([`said`]). What is the
//! same for all viewers is made once, by the [`Board`]. Telemetry and frames are taken from
//! the bench by each viewer's writer when nothing else is to be said ([`watched`]). Writers have a
//! runtime of their own, whose threads stand back where nothing is encrypted, and share no socket with
//! who reads commands ([`socket`]): however many there are, no stop waits for them. A viewer
//! that takes nothing for five seconds is closed: it is asked each second whether it is there. Its
//! leases end with it, and nothing is watched for it any more.

mod board;
mod said;
mod socket;
mod watched;

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use futures_util::{SinkExt as _, StreamExt as _};
use hyper::upgrade::Upgraded;
use polepair_link::clock;
use tokio::runtime::Handle;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc::Permit;
use tokio::sync::{Semaphore, broadcast, mpsc};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tokio_tungstenite::tungstenite::{Message, Utf8Bytes};

use crate::api::{self, COMMAND, Needs, Shared};
use crate::bench::Session;
use crate::message::{
    ClientMessage, CommandOrder, DismissStop, Ended, ErrorBody, LeaseAct, Outcome, PROTOCOL,
    Refused, ServerMessage, StopOrder, Welcome,
};
use crate::scope::Scope;
use crate::session::Caller;
use board::News;
use said::{Pace, Place, Said, Waiting};
use socket::{Ends, Hears, Tells};
use watched::{Look, Round, Watched};

pub(crate) use board::Board;

/// Bytes of a message.
pub const MESSAGE_MAX: usize = 64 * 1024;
/// Answers that wait for one viewer.
const ANSWERS_MAX: usize = 256;
/// Changes of what it watches that wait.
const LOOKS_MAX: usize = 64;
/// Commands of one viewer that are under way; as many orders about leases have places of their own,
/// so that long motions keep no lease from being renewed.
const COMMANDS_MAX: usize = 64;
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
    mut request: Request,
) -> Response {
    let wrong = |what: String| Refused::new("gateway.request", what).into_response();
    let mut answer = match create_response_with_body(&request, Body::empty) {
        Ok(answer) => answer,
        Err(error) => return wrong(error.to_string()),
    };
    if !speaks(request.headers()) {
        return wrong(format!("this is for the sub-protocol {PROTOCOL}"));
    }
    let name = HeaderValue::from_static(PROTOCOL);
    answer.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, name);
    let Ok(place) = Arc::clone(&gate.board.places).try_acquire_owned() else {
        return Refused::new("gateway.busy", "as many watch as can").into_response();
    };
    let upgrading = hyper::upgrade::on(&mut request);
    let hears = gate.threads.hears.clone();
    hears.spawn(async move {
        // Whoever is gone by now does not watch.
        let Ok(upgraded) = upgrading.await else { return };
        gate.metrics.viewers.inc();
        let session = gate.session(&caller);
        tracing::info!(%session, "a viewer came");
        Viewer::watch(&gate, caller, &session, upgraded).await;
        tracing::info!(%session, "a viewer went");
        gate.metrics.viewers.dec();
        drop(place);
    });
    answer
}

/// Whether the sub-protocol is among those that are offered.
fn speaks(headers: &HeaderMap) -> bool {
    let offers = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).into_iter();
    let mut words = offers.flat_map(|offer| offer.as_bytes().split(|byte| *byte == b','));
    words.any(|word| word.trim_ascii() == PROTOCOL.as_bytes())
}

/// Whose threads do what for viewers.
#[derive(Debug)]
pub(crate) struct Threads {
    /// They hear what viewers say, and do it. What strangers keep busy are others.
    pub hears: Handle,
    /// They write to viewers.
    pub shows: Handle,
    /// Whether connections are encrypted; else those that write stand back.
    pub encrypts: bool,
}

/// A message's turn, with the place that what comes of it has.
enum Turn<'a> {
    Free,
    Answer(Permit<'a, Message>),
    Look(Permit<'a, Look>),
}

/// One viewer.
struct Viewer {
    gate: Shared,
    caller: Caller,
    session: Session,
    answers: mpsc::Sender<Message>,
    looks: mpsc::Sender<Look>,
    under_way: Arc<Semaphore>,
    leasing: Arc<Semaphore>,
}

impl Viewer {
    async fn watch(gate: &Shared, caller: Caller, session: &Session, upgraded: Upgraded) {
        let Some(ends) = socket::ends(upgraded, gate.threads.encrypts).await else {
            return tracing::error!("a viewer's connection is not what this server listens to");
        };
        let Ends { hears, tells } = ends;
        let (answers, waiting) = mpsc::channel(ANSWERS_MAX);
        let (looks, looked) = mpsc::channel(LOOKS_MAX);
        let shown = Shown {
            gate: Arc::clone(gate),
            caller: caller.clone(),
            waiting,
            news: gate.board.news.subscribe(),
            states: gate.board.states.subscribe(),
            looked,
            watched: Watched::default(),
        };
        let places = || Arc::new(Semaphore::new(COMMANDS_MAX));
        let (under_way, leasing) = (places(), places());
        let (gate, session) = (Arc::clone(gate), session.clone());
        let viewer = Self { gate, caller, session, answers, looks, under_way, leasing };
        let mut writing = viewer.gate.threads.shows.spawn(shown.write(tells, viewer.first()));
        let told_to_end = tokio::select! {
            _ = &mut writing => false,
            () = viewer.read(hears) => true,
        };
        // What it set in motion stops before anything else is tidied up.
        viewer.gate.bench.gone(&viewer.session);
        if told_to_end {
            writing.abort();
            // What was watched is free once that has ended.
            let _ = writing.await;
        }
    }

    /// What is said first: who it is, the bench, and every axis.
    fn first(&self) -> Vec<Message> {
        let bench = &self.gate.bench;
        let welcome = ServerMessage::Welcome(Welcome {
            server_ms: bench.now_ms(),
            t0_ms: bench.t0_ms(),
            session: self.session.to_string(),
            scopes: self.caller.scopes.iter().collect(),
            lease_ms: u32::try_from(bench.lease_lasts().as_millis()).unwrap_or(u32::MAX),
        });
        let view = ServerMessage::Bench(api::bench_of(&self.gate, &self.caller));
        let states = (0..=u16::MAX).map_while(|id| bench.axis(id).ok()).map(ServerMessage::Axis);
        [welcome, view].into_iter().chain(states).map(|told| Message::Text(text(&told))).collect()
    }

    /// Hears what is said, and does it: a stop at once, all else in its turn.
    async fn read(&self, mut from: WebSocketStream<Hears>) {
        let (mut pace, mut waiting) = (Pace::default(), Waiting::default());
        let mut silent = clock::now() + SILENT_MAX;
        loop {
            let next = waiting.next();
            tokio::select! {
                biased;
                message = from.next(), if waiting.has_room() => {
                    let Some(Ok(message)) = message else { return };
                    silent = clock::now() + SILENT_MAX;
                    match message {
                        Message::Text(said) => self.hear(&said, &mut pace, &mut waiting),
                        Message::Binary(_) => {
                            waiting.tell(error("a message is a text", None, None), 1);
                        }
                        Message::Close(_) => return,
                        Message::Ping(its) => {
                            let bytes = its.len();
                            waiting.push(Said::Ping(its), bytes);
                        }
                        Message::Pong(_) | Message::Frame(_) => waiting.push(Said::Pong, 0),
                    }
                }
                turn = self.turn(&mut pace, next), if next.is_some() => {
                    let Some(turn) = turn else { return };
                    pace.count();
                    self.go_on(turn, &mut waiting);
                }
                // It says at least that it is there, unless it takes nothing.
                () = sleep(silent.since(clock::now())) => return,
            }
        }
    }

    /// Waits until one more message may be done, and what comes of it has a place.
    async fn turn(&self, pace: &mut Pace, next: Option<Place>) -> Option<Turn<'_>> {
        pace.keep().await;
        Some(match next? {
            Place::Nowhere => Turn::Free,
            Place::Answer => Turn::Answer(self.answers.reserve().await.ok()?),
            Place::Look => Turn::Look(self.looks.reserve().await.ok()?),
        })
    }

    /// Does what is next.
    fn go_on(&self, turn: Turn<'_>, waiting: &mut Waiting) {
        let Some((said, bytes)) = waiting.pop() else { return };
        let (answer, look) = match turn {
            Turn::Free => (None, None),
            Turn::Answer(answer) => (Some(answer), None),
            Turn::Look(look) => (None, Some(look)),
        };
        let told = match said {
            Said::Message(message, locks) => self.obey(message, locks, look),
            Said::Told(told) => Some(*told),
            // Where its answers are not taken, it need not be told that we are here.
            Said::Ping(its) => return drop(self.answers.try_send(Message::Pong(its))),
            Said::Pong => None,
        };
        match (told, answer) {
            (Some(told), Some(answer)) => answer.send(Message::Text(text(&told))),
            // Its place is waited for behind whatever ends motion.
            (Some(told), None) => waiting.tell(told, bytes),
            (None, _) => {}
        }
    }

    /// Takes what was said. A stop is done now, whatever was said before it.
    fn hear(&self, said: &str, pace: &mut Pace, waiting: &mut Waiting) {
        let locks = self.gate.bench.locks();
        let message = match serde_json::from_str::<ClientMessage>(said) {
            Ok(message) => message,
            Err(wrong) => return waiting.tell(error(&wrong.to_string(), None, None), said.len()),
        };
        let may = about(&message).1.met_by(self.caller.scopes);
        let ClientMessage::Stop { axes, .. } = &message else {
            return waiting.push(Said::Message(message, locks), said.len());
        };
        if !may || !pace.stop() {
            return waiting.push(Said::Message(message, locks), said.len());
        }
        waiting.stopped(axes.as_deref(), |message, refused| {
            self.refused(message, about(message).0, refused)
        });
        if let Some(told) = self.obey(message, locks, None) {
            waiting.tell(told, said.len());
        }
    }

    /// Does what was said when motion had been locked so often. What cannot be answered at once is
    /// answered later.
    fn obey(
        &self,
        message: ClientMessage,
        locks: u64,
        look: Option<Permit<'_, Look>>,
    ) -> Option<ServerMessage> {
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
            ClientMessage::Release => return self.release(locks),
            ClientMessage::Dismiss { axis, dismiss } => return self.dismiss(axis, dismiss),
            ClientMessage::Command { axis, command } => return self.command(axis, command),
            ClientMessage::Lease { axis, act, epoch } => return self.lease(axis, act, epoch),
            shown => return self.show(shown, look),
        }
        None
    }

    /// What only looks is the writer's to do; whether it is there to be watched is found out here.
    fn show(
        &self,
        message: ClientMessage,
        look: Option<Permit<'_, Look>>,
    ) -> Option<ServerMessage> {
        let (about, _) = about(&message);
        let wanted = match message {
            ClientMessage::Subscribe { channel, axis, signal, parameter, hz } => {
                let (signal, parameter) = (signal.as_deref(), parameter.as_deref());
                match self.gate.bench.wish(axis, signal, parameter, hz) {
                    Ok(wish) => Look::Subscribe(channel, wish),
                    Err(refused) => return Some(told(refused, Some(about), Some(channel))),
                }
            }
            ClientMessage::Unsubscribe { channel } => Look::Unsubscribe(channel),
            ClientMessage::Frames { on: true, filter } => Look::Frames(filter),
            ClientMessage::Explain { n } => Look::Explain(n),
            _ => Look::NoFrames,
        };
        if let Some(look) = look {
            look.send(wanted);
        }
        None
    }

    fn refused(&self, message: &ClientMessage, about: &str, refused: Refused) -> ServerMessage {
        match message {
            ClientMessage::Command { command, .. } => not_done(command.id.clone(), refused),
            ClientMessage::Lease { axis, .. } | ClientMessage::Dismiss { axis, .. } => {
                told(refused, Some(about), Some(*axis))
            }
            ClientMessage::Subscribe { channel, .. } => told(refused, Some(about), Some(*channel)),
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

    /// That motion is let again is told by an event, to everybody.
    fn release(&self, locks: u64) -> Option<ServerMessage> {
        let about = Some("release");
        let Ok(place) = Arc::clone(&self.leasing).try_acquire_owned() else {
            return Some(told(busy(), about, None));
        };
        let released = self.gate.bench.release(&self.session, locks);
        let answers = self.answers.clone();
        tokio::spawn(async move {
            if let Err(refused) = released.await {
                let _ = answers.send(Message::Text(text(&told(refused, about, None)))).await;
            }
            drop(place);
        });
        None
    }

    fn dismiss(&self, axis: u16, dismiss: DismissStop) -> Option<ServerMessage> {
        let Ok(place) = Arc::clone(&self.leasing).try_acquire_owned() else {
            return Some(told(busy(), Some("dismiss"), Some(axis)));
        };
        let dismissed = self.gate.bench.dismiss(axis, &self.session, dismiss);
        let answers = self.answers.clone();
        tokio::spawn(async move {
            let said = match dismissed.await {
                Ok(()) => ServerMessage::Dismissed { axis },
                Err(refused) => told(refused, Some("dismiss"), Some(axis)),
            };
            let _ = answers.send(Message::Text(text(&said))).await;
            drop(place);
        });
        None
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
            let _ = answers.send(Message::Text(text(&told))).await;
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
            let _ = answers.send(Message::Text(text(&said))).await;
            drop(place);
        });
        None
    }
}

/// What a viewer is shown.
struct Shown {
    gate: Shared,
    caller: Caller,
    waiting: mpsc::Receiver<Message>,
    news: broadcast::Receiver<News>,
    states: broadcast::Receiver<Utf8Bytes>,
    looked: mpsc::Receiver<Look>,
    watched: Watched,
}

impl Shown {
    /// Writes until the viewer is gone, or takes nothing.
    async fn write(mut self, mut to: WebSocketStream<Tells>, mut messages: Vec<Message>) {
        let (mut asks, mut round) = (interval(ASK), Round::default());
        asks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            for message in messages.drain(..) {
                let sent = timeout(SILENT_MAX, to.send(message)).await;
                if !matches!(sent, Ok(Ok(()))) {
                    return;
                }
            }
            // What is wanted no more is not sent behind the answers to what was said later. What was
            // asked comes before what happens, and that before what is merely shown.
            tokio::select! {
                biased;
                look = self.looked.recv() => match look {
                    Some(look) => {
                        let told = self.watched.look(&self.gate.bench, look);
                        messages.extend(told.map(|told| Message::Text(text(&told))));
                    }
                    None => return,
                },
                answer = self.waiting.recv() => match answer {
                    Some(answer) => messages.push(answer),
                    None => return,
                },
                news = self.news.recv() => match news {
                    Ok(News::Text(text)) => messages.push(Message::Text(text)),
                    Ok(News::Bench) => messages.extend(self.bench()),
                    Ok(News::Whole) | Err(RecvError::Lagged(_)) => messages.extend(self.whole()),
                    Ok(News::End) | Err(RecvError::Closed) => return,
                },
                _ = asks.tick() => messages.push(Message::Ping(Bytes::new())),
                state = self.states.recv() => match state {
                    Ok(state) => messages.push(Message::Text(state)),
                    Err(RecvError::Lagged(lost)) => drop(self.gate.metrics.dropped.inc_by(lost)),
                    Err(RecvError::Closed) => return,
                },
                message = round.message(&mut self.watched, &self.gate.metrics) => messages.push(message),
            }
        }
    }

    /// The bench, as the board has it.
    fn bench(&self) -> Option<Message> {
        let mut bench = self.gate.board.bench()?;
        bench.scopes = self.caller.scopes.iter().collect();
        Some(Message::Text(text(&ServerMessage::Bench(bench))))
    }

    /// The bench and every axis.
    fn whole(&self) -> Vec<Message> {
        let states = self.gate.board.axes().into_iter().map(ServerMessage::Axis);
        let states = states.map(|state| Message::Text(text(&state)));
        self.bench().into_iter().chain(states).collect()
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
        ClientMessage::Dismiss { .. } => ("dismiss", needs(&[Scope::Move])),
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
