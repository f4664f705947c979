//! The WebSocket of a viewer: a reader that never waits for drives, and a writer that sends replies before
//! subscribed data.
//!
//! A stop overtakes open requests of its viewer ([`incoming`]). Data that are the same for all viewers are made once by
//! the [`Broadcaster`]. The writer takes telemetry and frames from the bench when nothing else is pending
//! ([`subscriptions`]). Writers have a runtime of low-priority threads, and share no socket with readers
//! ([`split_socket`]), so no stop waits for them. A viewer that accepts no data for five seconds is disconnected; its
//! leases end.

mod incoming;
mod split_socket;
mod subscriptions;

use polepair_core::convert::saturating;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use futures_util::{SinkExt as _, StreamExt as _};
use hyper::upgrade::Upgraded;
use polepair_link::clock;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc::Permit;
use tokio::sync::{Semaphore, broadcast, mpsc};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tokio_tungstenite::tungstenite::{Message, Utf8Bytes};

use crate::access::{AccessRule, LEASE_SCOPES};
use crate::app_state::SharedAppState;
use crate::auth::Caller;
use crate::bench::SessionName;
use crate::broadcaster::{BroadcastEvent, to_json};
use crate::message::{
    ClientMessage, CommandOutcome, CommandRequest, DismissStop, ErrorBody, GatewayError,
    LeaseAction, OutcomeKind, ServerMessage, StopRequest, WEBSOCKET_PROTOCOL, Welcome,
};
use crate::scope::Scope;
use incoming::{IncomingQueue, OutputQueue, QueuedMessage, RateLimiter};
use split_socket::{SocketReader, SocketWriter, SplitSocket};
use subscriptions::{SubscriptionRequest, SubscriptionRound, Subscriptions};

/// Bytes of a message.
pub const MESSAGE_MAX: usize = 64 * 1024;
/// Answers that wait for one viewer.
const REPLIES_MAX: usize = 256;
/// Changes of a viewer's subscriptions that wait.
const SUBSCRIPTION_REQUESTS_MAX: usize = 64;
/// Commands of one viewer that are under way; as many orders about leases have places of their own,
/// so that long motions keep no lease from being renewed.
const COMMANDS_MAX: usize = 64;
/// Time limit of a viewer that accepts no data.
const SILENT_MAX: Duration = Duration::from_secs(5);
/// Interval of pings.
const PING_INTERVAL: Duration = Duration::from_secs(1);

/// Watch and command
///
/// A WebSocket of the sub-protocol `polepair.v1`. Texts are `ClientMessage` and `ServerMessage`; the
/// binary ones are telemetry.
#[utoipa::path(get, path = "/api/v1/live", tag = "live", responses(
    (status = 101, description = "The WebSocket"),
    (status = "default", body = ErrorBody),
))]
pub(crate) async fn upgrade(
    State(state): State<SharedAppState>,
    Extension(caller): Extension<Caller>,
    mut request: Request,
) -> Response {
    let wrong = |what: String| GatewayError::new("gateway.request", what).into_response();
    let mut answer = match create_response_with_body(&request, Body::empty) {
        Ok(answer) => answer,
        Err(error) => return wrong(error.to_string()),
    };
    if !offers_protocol(request.headers()) {
        return wrong(format!("this is for the sub-protocol {WEBSOCKET_PROTOCOL}"));
    }
    let name = HeaderValue::from_static(WEBSOCKET_PROTOCOL);
    answer.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, name);
    let Ok(permit) = Arc::clone(&state.broadcaster.viewer_slots).try_acquire_owned() else {
        return GatewayError::new("gateway.busy", "too many viewers").into_response();
    };
    let upgrading = hyper::upgrade::on(&mut request);
    let handle = state.runtimes.inbound.clone();
    handle.spawn(async move {
        // A viewer that is disconnected by now watches nothing.
        let Ok(upgraded) = upgrading.await else { return };
        state.metrics.viewers.inc();
        let session = state.new_session(&caller);
        tracing::info!(%session, "viewer connected");
        Viewer::run(&state, caller, &session, upgraded).await;
        tracing::info!(%session, "viewer disconnected");
        state.metrics.viewers.dec();
        drop(permit);
    });
    answer
}

/// Returns whether the sub-protocol is among those that are offered.
fn offers_protocol(headers: &HeaderMap) -> bool {
    let offers = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).into_iter();
    let mut words = offers.flat_map(|offer| offer.as_bytes().split(|byte| *byte == b','));
    words.any(|word| word.trim_ascii() == WEBSOCKET_PROTOCOL.as_bytes())
}

/// A message's turn, with room for its replies.
enum QueuePermit<'a> {
    NotNeeded,
    Reply(Permit<'a, Message>),
    Subscription(Permit<'a, SubscriptionRequest>),
}

/// One viewer.
struct Viewer {
    state: SharedAppState,
    caller: Caller,
    session: SessionName,
    replies: mpsc::Sender<Message>,
    subscription_requests: mpsc::Sender<SubscriptionRequest>,
    command_slots: Arc<Semaphore>,
    lease_slots: Arc<Semaphore>,
}

impl Viewer {
    async fn run(
        app_state: &SharedAppState,
        caller: Caller,
        session: &SessionName,
        upgraded: Upgraded,
    ) {
        let Some(ends) = split_socket::split(upgraded, app_state.runtimes.encrypted).await else {
            return tracing::error!("the connection of the viewer is of an unknown type");
        };
        let SplitSocket { reader, writer } = ends;
        let (reply_sender, replies) = mpsc::channel(REPLIES_MAX);
        let (subscription_sender, subscription_requests) = mpsc::channel(SUBSCRIPTION_REQUESTS_MAX);
        let viewer_writer = ViewerWriter {
            state: Arc::clone(app_state),
            caller: caller.clone(),
            replies,
            events: app_state.broadcaster.events.subscribe(),
            axis_states: app_state.broadcaster.states.subscribe(),
            subscription_requests,
            subscriptions: Subscriptions::default(),
        };
        let (command_slots, lease_slots) = (new_slots(), new_slots());
        let (app_state, session) = (Arc::clone(app_state), session.clone());
        let viewer = Self {
            state: app_state,
            caller,
            session,
            replies: reply_sender,
            subscription_requests: subscription_sender,
            command_slots,
            lease_slots,
        };
        let mut write_task = viewer
            .state
            .runtimes
            .outbound
            .spawn(viewer_writer.write(writer, viewer.initial_messages()));
        let told_to_end = tokio::select! {
            _ = &mut write_task => false,
            () = viewer.read(reader) => true,
        };
        // Its motion stops before anything else is cleaned up.
        viewer.state.bench.end_session(&viewer.session);
        if told_to_end {
            write_task.abort();
            // The slots of its watches are free once that has ended.
            let _ = write_task.await;
        }
    }

    /// First messages: the connection, the bench, and every axis.
    fn initial_messages(&self) -> Vec<Message> {
        let bench = &self.state.bench;
        let welcome = ServerMessage::Welcome(Welcome {
            server_ms: bench.now_ms(),
            t0_ms: bench.t0_ms(),
            session: self.session.to_string(),
            scopes: self.caller.scopes.iter().collect(),
            lease_ms: saturating(bench.lease_duration().as_millis()),
        });
        let view = ServerMessage::Bench(self.state.bench_view(&self.caller));
        let states =
            (0..=u16::MAX).map_while(|id| bench.axis_state(id).ok()).map(ServerMessage::Axis);
        [welcome, view]
            .into_iter()
            .chain(states)
            .map(|message| Message::Text(to_json(&message)))
            .collect()
    }

    /// Reads messages and executes them: a stop at once, all others in order.
    async fn read(&self, mut from: WebSocketStream<SocketReader>) {
        let (mut pace, mut waiting) = (RateLimiter::default(), IncomingQueue::default());
        let mut silent = clock::now() + clock::scale_timeout(SILENT_MAX);
        loop {
            let next = waiting.next_output();
            tokio::select! {
                biased;
                message = from.next(), if waiting.has_room() => {
                    let Some(Ok(message)) = message else { return };
                    silent = clock::now() + clock::scale_timeout(SILENT_MAX);
                    match message {
                        Message::Text(text) => self.receive_text(&text, &mut pace, &mut waiting),
                        Message::Binary(_) => {
                            waiting.push_reply(request_error("a message is a text", None, None), 1);
                        }
                        Message::Close(_) => return,
                        Message::Ping(its) => {
                            let bytes = its.len();
                            waiting.push(QueuedMessage::Ping(its), bytes);
                        }
                        Message::Pong(_) | Message::Frame(_) => waiting.push(QueuedMessage::Pong, 0),
                    }
                }
                turn = self.reserve_permit(&mut pace, next), if next.is_some() => {
                    let Some(turn) = turn else { return };
                    pace.count();
                    self.process_next(turn, &mut waiting);
                }
                // The client sends at least a ping reply, unless it accepts nothing.
                () = sleep(silent.since(clock::now())) => return,
            }
        }
    }

    /// Waits until one more message may be processed, and its replies have room.
    async fn reserve_permit(
        &self,
        pace: &mut RateLimiter,
        next: Option<OutputQueue>,
    ) -> Option<QueuePermit<'_>> {
        pace.wait_until_allowed().await;
        Some(match next? {
            OutputQueue::NotNeeded => QueuePermit::NotNeeded,
            OutputQueue::Reply => QueuePermit::Reply(self.replies.reserve().await.ok()?),
            OutputQueue::Subscription => {
                QueuePermit::Subscription(self.subscription_requests.reserve().await.ok()?)
            }
        })
    }

    /// Processes the next message.
    fn process_next(&self, turn: QueuePermit<'_>, waiting: &mut IncomingQueue) {
        let Some((queued, bytes)) = waiting.pop() else { return };
        let (answer, permit) = match turn {
            QueuePermit::NotNeeded => (None, None),
            QueuePermit::Reply(answer) => (Some(answer), None),
            QueuePermit::Subscription(permit) => (None, Some(permit)),
        };
        let report = match queued {
            QueuedMessage::Request(message, locks) => self.handle_message(message, locks, permit),
            QueuedMessage::Reply(report) => Some(*report),
            // A client that does not accept its replies needs no ping.
            QueuedMessage::Ping(its) => return drop(self.replies.try_send(Message::Pong(its))),
            QueuedMessage::Pong => None,
        };
        match (report, answer) {
            (Some(report), Some(answer)) => answer.send(Message::Text(to_json(&report))),
            // Its place is waited for behind whatever ends motion.
            (Some(report), None) => waiting.push_reply(report, bytes),
            (None, _) => {}
        }
    }

    /// Receives a message. A stop is executed now, before all earlier messages.
    fn receive_text(&self, text: &str, pace: &mut RateLimiter, waiting: &mut IncomingQueue) {
        let locks = self.state.bench.lock_count();
        let message = match serde_json::from_str::<ClientMessage>(text) {
            Ok(message) => message,
            Err(wrong) => {
                return waiting
                    .push_reply(request_error(&wrong.to_string(), None, None), text.len());
            }
        };
        let may = type_and_access(&message).1.is_met_by(self.caller.scopes);
        let ClientMessage::Stop(StopRequest { axes, .. }) = &message else {
            return waiting.push(QueuedMessage::Request(message, locks), text.len());
        };
        if !may || !pace.allow_stop() {
            return waiting.push(QueuedMessage::Request(message, locks), text.len());
        }
        waiting.void_for_stop(axes.as_deref(), |message, refused| {
            self.refusal_message(message, type_and_access(message).0, refused)
        });
        if let Some(report) = self.handle_message(message, locks, None) {
            waiting.push_reply(report, text.len());
        }
    }

    /// Executes a message that was received when motion had been locked `locks` times. Slow replies are sent later.
    fn handle_message(
        &self,
        message: ClientMessage,
        locks: u64,
        permit: Option<Permit<'_, SubscriptionRequest>>,
    ) -> Option<ServerMessage> {
        let (about, needs) = type_and_access(&message);
        if !needs.is_met_by(self.caller.scopes) {
            let grants = self.caller.scopes;
            let refused =
                GatewayError::new("gateway.scope", format!("this needs the scope {needs}"))
                    .hint(format!("this token grants {grants}"));
            self.state.metrics.count_refusal(&refused.code);
            return Some(self.refusal_message(&message, about, refused));
        }
        match message {
            ClientMessage::Ping { client_ms } => {
                let server_ms = self.state.bench.now_ms();
                Some(ServerMessage::Pong { client_ms, server_ms })
            }
            ClientMessage::Stop(request) => self.stop(request),
            ClientMessage::Release => self.release(locks),
            ClientMessage::Dismiss { axis, dismiss } => self.dismiss(axis, dismiss),
            ClientMessage::Command { axis, command } => self.command(axis, command),
            ClientMessage::Lease { axis, act, epoch } => self.lease(axis, act, epoch),
            shown => self.request_subscription(shown, permit),
        }
    }

    /// Subscriptions are the writer's work; their existence is checked here.
    fn request_subscription(
        &self,
        message: ClientMessage,
        permit: Option<Permit<'_, SubscriptionRequest>>,
    ) -> Option<ServerMessage> {
        let (about, _) = type_and_access(&message);
        let wanted = match message {
            ClientMessage::Subscribe { channel, axis, signal, parameter, hz } => {
                let (signal, parameter) = (signal.as_deref(), parameter.as_deref());
                match self.state.bench.resolve_channel(axis, signal, parameter, hz) {
                    Ok(request) => SubscriptionRequest::Subscribe(channel, request),
                    Err(refused) => {
                        return Some(error_message(refused, Some(about), Some(channel)));
                    }
                }
            }
            ClientMessage::Unsubscribe { channel } => SubscriptionRequest::Unsubscribe(channel),
            ClientMessage::Frames { on: true, filter } => SubscriptionRequest::StartFrames(filter),
            ClientMessage::Explain { n } => SubscriptionRequest::Explain(n),
            _ => SubscriptionRequest::StopFrames,
        };
        if let Some(permit) = permit {
            permit.send(wanted);
        }
        None
    }

    fn refusal_message(
        &self,
        message: &ClientMessage,
        about: &str,
        refused: GatewayError,
    ) -> ServerMessage {
        match message {
            ClientMessage::Command { command, .. } => not_done_outcome(command.id.clone(), refused),
            ClientMessage::Lease { axis, .. } | ClientMessage::Dismiss { axis, .. } => {
                error_message(refused, Some(about), Some(*axis))
            }
            ClientMessage::Subscribe { channel, .. } => {
                error_message(refused, Some(about), Some(*channel))
            }
            _ => error_message(refused, Some(about), None),
        }
    }

    /// The progress of the stop is sent to all clients as events. The reply has the parts that could not be executed.
    fn stop(&self, request: StopRequest) -> Option<ServerMessage> {
        let since = clock::now();
        let refused = self.state.bench.refused_targets(&request).into_iter().next();
        let stopped = self.state.bench.stop(&self.session, &request);
        // Stops beyond the rate limit are executed, not measured.
        if let Ok(permit) = Arc::clone(&self.command_slots).try_acquire_owned() {
            let state = Arc::clone(&self.state);
            tokio::spawn(async move {
                if stopped.await.is_ok() {
                    state.metrics.stops.observe(clock::now().since(since).as_secs_f64());
                }
                drop(permit);
            });
        }
        refused.map(|error| error_message(error, Some("stop"), None))
    }

    /// The release is sent to all clients as an event.
    fn release(&self, locks: u64) -> Option<ServerMessage> {
        let about = Some("release");
        let Ok(permit) = Arc::clone(&self.lease_slots).try_acquire_owned() else {
            return Some(error_message(busy_error(), about, None));
        };
        let released = self.state.bench.release(&self.session, locks);
        let answers = self.replies.clone();
        tokio::spawn(async move {
            if let Err(refused) = released.await {
                let _ = answers
                    .send(Message::Text(to_json(&error_message(refused, about, None))))
                    .await;
            }
            drop(permit);
        });
        None
    }

    fn dismiss(&self, axis: u16, dismiss: DismissStop) -> Option<ServerMessage> {
        let Ok(permit) = Arc::clone(&self.lease_slots).try_acquire_owned() else {
            return Some(error_message(busy_error(), Some("dismiss"), Some(axis)));
        };
        let dismissed = self.state.bench.dismiss(axis, &self.session, dismiss);
        let answers = self.replies.clone();
        tokio::spawn(async move {
            let message = match dismissed.await {
                Ok(()) => ServerMessage::Dismissed { axis },
                Err(refused) => error_message(refused, Some("dismiss"), Some(axis)),
            };
            let _ = answers.send(Message::Text(to_json(&message))).await;
            drop(permit);
        });
        None
    }

    fn command(&self, axis: u16, request: CommandRequest) -> Option<ServerMessage> {
        let id = request.id.clone();
        let Ok(permit) = Arc::clone(&self.command_slots).try_acquire_owned() else {
            return Some(not_done_outcome(id, busy_error()));
        };
        let since = clock::now();
        let outcome = self.state.bench.command(axis, &self.session, request);
        let (state, answers) = (Arc::clone(&self.state), self.replies.clone());
        tokio::spawn(async move {
            let message = match outcome.await {
                Ok(outcome) => ServerMessage::Outcome(outcome),
                Err(refused) => not_done_outcome(id, refused),
            };
            state.metrics.commands.observe(clock::now().since(since).as_secs_f64());
            // It has gone: what it commanded ends with its leases.
            let _ = answers.send(Message::Text(to_json(&message))).await;
            drop(permit);
        });
        None
    }

    fn lease(&self, axis: u16, act: LeaseAction, epoch: u64) -> Option<ServerMessage> {
        let Ok(permit) = Arc::clone(&self.lease_slots).try_acquire_owned() else {
            return Some(error_message(busy_error(), Some("lease"), Some(axis)));
        };
        let granted = self.state.bench.request_lease(axis, &self.session, act, epoch);
        let answers = self.replies.clone();
        tokio::spawn(async move {
            let message = match granted.await {
                Ok(granted) => ServerMessage::Leased {
                    axis,
                    epoch: granted.map_or(epoch, |lease| lease.epoch),
                    expires_ms: granted.map(|lease| lease.expires_ms),
                },
                Err(refused) => error_message(refused, Some("lease"), Some(axis)),
            };
            let _ = answers.send(Message::Text(to_json(&message))).await;
            drop(permit);
        });
        None
    }
}

fn new_slots() -> Arc<Semaphore> {
    Arc::new(Semaphore::new(COMMANDS_MAX))
}

/// Writer of a viewer.
struct ViewerWriter {
    state: SharedAppState,
    caller: Caller,
    replies: mpsc::Receiver<Message>,
    events: broadcast::Receiver<BroadcastEvent>,
    axis_states: broadcast::Receiver<Utf8Bytes>,
    subscription_requests: mpsc::Receiver<SubscriptionRequest>,
    subscriptions: Subscriptions,
}

impl ViewerWriter {
    /// Writes until the viewer is gone, or takes nothing.
    async fn write(mut self, mut to: WebSocketStream<SocketWriter>, mut messages: Vec<Message>) {
        let (mut asks, mut round) = (interval(PING_INTERVAL), SubscriptionRound::default());
        asks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            for message in messages.drain(..) {
                let sent = timeout(clock::scale_timeout(SILENT_MAX), to.send(message)).await;
                if !matches!(sent, Ok(Ok(()))) {
                    return;
                }
            }
            // An ended subscription is not sent behind later replies. Replies come before events, and these before
            // telemetry.
            tokio::select! {
                biased;
                look = self.subscription_requests.recv() => match look {
                    Some(subscription) => {
                        let report = self.subscriptions.handle_request(&self.state.bench, subscription);
                        messages.extend(report.map(|report| Message::Text(to_json(&report))));
                    }
                    None => return,
                },
                answer = self.replies.recv() => match answer {
                    Some(answer) => messages.push(answer),
                    None => return,
                },
                news = self.events.recv() => match news {
                    Ok(BroadcastEvent::Message(text)) => messages.push(Message::Text(text)),
                    Ok(BroadcastEvent::BenchChanged) => messages.extend(self.bench_message()),
                    Ok(BroadcastEvent::Resync) | Err(RecvError::Lagged(_)) => messages.extend(self.full_state()),
                    Ok(BroadcastEvent::Closed) | Err(RecvError::Closed) => return,
                },
                _ = asks.tick() => messages.push(Message::Ping(Bytes::new())),
                state = self.axis_states.recv() => match state {
                    Ok(state) => messages.push(Message::Text(state)),
                    Err(RecvError::Lagged(lost)) => drop(self.state.metrics.dropped.inc_by(lost)),
                    Err(RecvError::Closed) => return,
                },
                message = round.next_message(&mut self.subscriptions, &self.state.metrics) => messages.push(message),
            }
        }
    }

    /// The bench, as the broadcaster has it.
    fn bench_message(&self) -> Option<Message> {
        let mut bench = self.state.broadcaster.cached_bench()?;
        bench.scopes = self.caller.scopes.iter().collect();
        Some(Message::Text(to_json(&ServerMessage::Bench(bench))))
    }

    /// The bench and every axis.
    fn full_state(&self) -> Vec<Message> {
        let states = self.state.broadcaster.cached_axes().into_iter().map(ServerMessage::Axis);
        let states = states.map(|state| Message::Text(to_json(&state)));
        self.bench_message().into_iter().chain(states).collect()
    }
}

/// A message's `type`, and its access rule.
fn type_and_access(message: &ClientMessage) -> (&'static str, AccessRule) {
    match message {
        ClientMessage::Command { .. } => ("command", any_of(&[Scope::Move])),
        ClientMessage::Lease { .. } => ("lease", any_of(LEASE_SCOPES)),
        ClientMessage::Stop(_) => ("stop", any_of(&[Scope::Stop])),
        ClientMessage::Release => ("release", any_of(&[Scope::Move])),
        ClientMessage::Dismiss { .. } => ("dismiss", any_of(&[Scope::Move])),
        ClientMessage::Ping { .. } => ("ping", any_of(&[Scope::Read])),
        ClientMessage::Subscribe { .. } => ("subscribe", any_of(&[Scope::Read])),
        ClientMessage::Unsubscribe { .. } => ("unsubscribe", any_of(&[Scope::Read])),
        ClientMessage::Frames { .. } => ("frames", any_of(&[Scope::Read])),
        ClientMessage::Explain { .. } => ("explain", any_of(&[Scope::Read])),
    }
}

const fn any_of(scopes: &'static [Scope]) -> AccessRule {
    AccessRule::AnyOf(scopes)
}

fn error_message(error: GatewayError, about: Option<&str>, subject: Option<u16>) -> ServerMessage {
    ServerMessage::Error { error, about: about.map(str::to_owned), subject }
}

fn request_error(what: &str, about: Option<&str>, subject: Option<u16>) -> ServerMessage {
    error_message(GatewayError::new("gateway.request", what), about, subject)
}

fn not_done_outcome(id: String, refused: GatewayError) -> ServerMessage {
    let error = Some(refused);
    let outcome =
        CommandOutcome { id, outcome: OutcomeKind::NotDone, value: None, error, replayed: false };
    ServerMessage::Outcome(outcome)
}

fn busy_error() -> GatewayError {
    GatewayError::new("gateway.busy", "this viewer has too many open requests")
        .hint("wait for outcomes")
}
