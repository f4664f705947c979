//! The task of the WebSocket.

use std::collections::HashMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use hyper::header::{AUTHORIZATION, HeaderValue, SEC_WEBSOCKET_PROTOCOL};
use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_messages::{
    ClientMessage, ErrorBody, LeaseAction, ServerMessage, WEBSOCKET_PROTOCOL, telemetry,
};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use super::lease_requests::{PendingLeaseRequest, PendingLeaseRequests};
use super::{ChannelInfo, FrameBuffer, LiveCache, LiveRequest, ResponseSender, SampleBuffer};
use crate::GatewayError;
use crate::dialer::{Dialer, connection_error};
use crate::failure::{action_error, invalid_response, outcome_result, query_error, server_lost};
use crate::server_stream::ServerStream;

/// Interval of lease renewals: a third of a lease's duration, so that two may be lost.
const RENEW: Duration = Duration::from_millis(500);
/// Longest silence of a server: it sends a ping each second.
const SILENT_MAX: Duration = Duration::from_secs(5);

type ClientSocket = WebSocketStream<Box<dyn ServerStream>>;

/// Connects, reads the welcome, and starts the task.
pub(super) async fn spawn_task(
    wire: &Dialer,
    requests: mpsc::Receiver<LiveRequest>,
) -> Result<Arc<LiveCache>, GatewayError> {
    let mut socket = connect_socket(wire).await?;
    let welcome = timeout(clock::scale_timeout(SILENT_MAX), await_welcome(&mut socket)).await;
    let (session, server_ms) = welcome.unwrap_or_else(|_| Err(server_lost("it says nothing")))?;
    let known = Arc::new(LiveCache::new(session, server_ms));
    let task = SocketTask {
        socket,
        cache: Arc::clone(&known),
        commands: HashMap::new(),
        lease_requests: HashMap::new(),
        sample_buffers: HashMap::new(),
        pending_subscriptions: HashMap::new(),
        frame_buffer: None,
        last_received: clock::now(),
    };
    tokio::spawn(task.run(requests));
    Ok(known)
}

async fn connect_socket(wire: &Dialer) -> Result<ClientSocket, GatewayError> {
    let stream = wire.dial().await?;
    let url = format!("ws://{}/api/v1/live", wire.address.authority());
    let wrong =
        |error: &dyn std::fmt::Display| GatewayError::new("E256", format!("{url}: {error}"));
    let mut request = url.as_str().into_client_request().map_err(|error| wrong(&error))?;
    let bearer = HeaderValue::from_str(&wire.secret.bearer()).map_err(|error| wrong(&error))?;
    request.headers_mut().insert(AUTHORIZATION, bearer);
    request
        .headers_mut()
        .insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(WEBSOCKET_PROTOCOL));
    let shaken = timeout(clock::scale_timeout(SILENT_MAX), client_async(request, stream)).await;
    let (socket, _) =
        shaken.map_err(|_| server_lost("it does not answer"))?.map_err(handshake_error)?;
    Ok(socket)
}

/// The server's reply instead of a WebSocket.
fn handshake_error(error: Error) -> GatewayError {
    let Error::Http(answer) = error else { return connection_error(&error) };
    let body = answer.body().as_deref().unwrap_or_default();
    let result = serde_json::from_slice::<ErrorBody>(body);
    result.map_or_else(|error| invalid_response(&error.to_string()), |body| body.error)
}

async fn await_welcome(socket: &mut ClientSocket) -> Result<(String, f64), GatewayError> {
    while let Some(result) = socket.next().await {
        if let Message::Text(text) = result.map_err(|error| server_lost(&error.to_string()))? {
            return match serde_json::from_str(&text) {
                Ok(ServerMessage::Welcome(welcome)) => Ok((welcome.session, welcome.server_ms)),
                Ok(_) => Err(invalid_response("it does not begin with a welcome")),
                Err(error) => Err(invalid_response(&error.to_string())),
            };
        }
    }
    Err(server_lost("it hung up"))
}

/// The task that reads and writes the socket, with the requests in flight.
struct SocketTask {
    socket: ClientSocket,
    cache: Arc<LiveCache>,
    commands: HashMap<String, ResponseSender<()>>,
    lease_requests: HashMap<u16, PendingLeaseRequests>,
    /// Buffers of the channels; a channel is subscribed while its buffer exists.
    sample_buffers: HashMap<u16, Weak<SampleBuffer>>,
    pending_subscriptions: HashMap<u16, ResponseSender<ChannelInfo>>,
    /// Buffer of frames; they are sent while it exists.
    frame_buffer: Option<Weak<FrameBuffer>>,
    last_received: Instant,
}

impl SocketTask {
    async fn run(mut self, mut requests: mpsc::Receiver<LiveRequest>) {
        let mut renew = interval(RENEW);
        // After a sleep of the computer one renewal is enough.
        renew.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let ended = loop {
            let went_on = tokio::select! {
                // Renewals first: a flood of samples must not let a lease end.
                biased;
                _ = renew.tick() => self.renew_leases().await,
                request = requests.recv() => match request {
                    Some(live_request) => self.handle_request(live_request).await,
                    // No handle of the client is left.
                    None => {
                        let _ = timeout(RENEW, self.socket.close(None)).await;
                        return;
                    }
                },
                heard = self.socket.next() => self.handle_frame(heard),
            };
            if let Err(why) = went_on {
                break why;
            }
        };
        // From here on nothing is accepted, and what is still queued is never sent.
        requests.close();
        self.cache.set_disconnected(ended.clone());
        self.wake_streams();
        while let Some(live_request) = requests.recv().await {
            live_request.fail(GatewayError { executed: Some(false), ..ended.clone() });
        }
        // A waiter that was dropped needs no result; here and below.
        let (done, error) = (action_error(ended.clone()), query_error(ended));
        self.commands.into_values().for_each(|tell| drop(tell.send(Err(done.clone()))));
        let leases = self.lease_requests.into_values().flat_map(PendingLeaseRequests::into_senders);
        leases.for_each(|reply_sender| drop(reply_sender.send(Err(done.clone()))));
        self.pending_subscriptions
            .into_values()
            .for_each(|tell| drop(tell.send(Err(error.clone()))));
    }

    /// Renews leases, and checks that the server replies.
    async fn renew_leases(&mut self) -> Result<(), GatewayError> {
        // A connection whose cable was pulled reports no error for minutes.
        if clock::now().since(self.last_received) >= clock::scale_timeout(SILENT_MAX) {
            return Err(server_lost("it says nothing"));
        }
        let leases = self.cache.leases();
        for (axis, epoch) in &leases {
            let (axis, epoch, act) = (*axis, *epoch, LeaseAction::Renew);
            self.lease_requests.entry(axis).or_default().push(PendingLeaseRequest {
                act,
                epoch,
                reply: None,
            });
            self.send_message(&ClientMessage::Lease { axis, act, epoch }).await?;
        }
        if !leases.is_empty() {
            self.send_message(&ClientMessage::Ping { client_ms: 0.0 }).await?;
        }
        self.unsubscribe_unused().await
    }

    /// Wakes all readers, so that they check their streams.
    fn wake_streams(&self) {
        self.sample_buffers.values().filter_map(Weak::upgrade).for_each(|feed| feed.wake());
    }

    /// Ends subscriptions without a reader.
    async fn unsubscribe_unused(&mut self) -> Result<(), GatewayError> {
        if self.frame_buffer.take_if(|passing| passing.strong_count() == 0).is_some() {
            self.send_message(&ClientMessage::Frames { on: false, filter: None }).await?;
        }
        for (channel, _) in self.sample_buffers.extract_if(|_, feed| feed.strong_count() == 0) {
            let text = to_json(&ClientMessage::Unsubscribe { channel })?;
            send_text(&mut self.socket, text).await?;
        }
        Ok(())
    }

    async fn handle_request(&mut self, live_request: LiveRequest) -> Result<(), GatewayError> {
        let message = match live_request {
            LiveRequest::Command { axis, request, reply: reply_sender } => {
                // Before it is sent: the outcome may come at once.
                self.commands.insert(request.id.clone(), reply_sender);
                ClientMessage::Command { axis, command: request }
            }
            LiveRequest::Lease { axis, act, epoch, reply: sender } => {
                if act == LeaseAction::Drop {
                    self.cache.end_lease(axis, epoch);
                }
                self.lease_requests.entry(axis).or_default().push(PendingLeaseRequest {
                    act,
                    epoch,
                    reply: Some(sender),
                });
                ClientMessage::Lease { axis, act, epoch }
            }
            LiveRequest::Subscribe { channel, spec, buffer, reply: tell } => {
                // A client has a number of channels at most.
                self.unsubscribe_unused().await?;
                self.sample_buffers.insert(channel, Arc::downgrade(&buffer));
                self.pending_subscriptions.insert(channel, tell);
                let super::ChannelSpec { axis, signal, parameter, hz } = spec;
                ClientMessage::Subscribe { channel, axis, signal, parameter, hz }
            }
            LiveRequest::Frames { filter, buffer } => {
                self.frame_buffer = Some(Arc::downgrade(&buffer));
                ClientMessage::Frames { on: true, filter }
            }
        };
        self.send_message(&message).await
    }

    async fn send_message(&mut self, message: &ClientMessage) -> Result<(), GatewayError> {
        send_text(&mut self.socket, to_json(message)?).await
    }

    fn handle_frame(&mut self, result: Option<Result<Message, Error>>) -> Result<(), GatewayError> {
        self.last_received = clock::now();
        match result {
            Some(Ok(Message::Text(text))) => {
                // A message of a later version is ignored.
                if let Ok(message) = serde_json::from_str(&text) {
                    self.handle_message(message);
                }
            }
            Some(Ok(Message::Binary(bytes))) => {
                if let Some((channel, lost_total, samples)) = telemetry::decode(&bytes)
                    && let Some(feed) = self.sample_buffers.get(&channel).and_then(Weak::upgrade)
                {
                    feed.push(lost_total, &samples, self.last_received);
                }
            }
            Some(Ok(Message::Close(_))) | None => return Err(server_lost("it hung up")),
            Some(Ok(_)) => {}
            Some(Err(error)) => return Err(server_lost(&error.to_string())),
        }
        Ok(())
    }

    fn handle_message(&mut self, message: ServerMessage) {
        match message {
            ServerMessage::Outcome(outcome) => {
                if let Some(reply_sender) = self.commands.remove(&outcome.id) {
                    let _ = reply_sender.send(outcome_result(outcome));
                }
            }
            ServerMessage::Leased { axis, epoch, expires_ms } => {
                self.handle_leased(axis, epoch, expires_ms.is_some());
            }
            ServerMessage::Subscribed { channel, hz, source, unit } => {
                if let Some(sender) = self.pending_subscriptions.remove(&channel) {
                    let _ = sender.send(Ok(ChannelInfo { hz, source, unit }));
                }
            }
            ServerMessage::Pong { server_ms, .. } => self.cache.set_time(server_ms),
            ServerMessage::Axis(state) => {
                let newer = state.lease.as_ref().filter(|lease| lease.owner != self.cache.session);
                if let Some(lease) = newer
                    && self.cache.leases().iter().any(|(a, e)| *a == state.id && *e < lease.epoch)
                {
                    let what = format!("{} took the axis over", lease.owner);
                    self.cache.set_lease(state.id, Err(GatewayError::new("gateway.lease", what)));
                }
                self.cache.set_state(state);
            }
            ServerMessage::Bench(bench) => {
                self.cache.set_links(&bench);
                self.wake_streams();
            }
            ServerMessage::Locked(lock) => self.cache.set_lock(Some(lock)),
            ServerMessage::Unlocked => self.cache.set_lock(None),
            ServerMessage::Stopped(stopped) => self.cache.set_stopped(stopped.axes),
            ServerMessage::Frames { items, lost } => {
                if let Some(buffer) = self.frame_buffer.as_ref().and_then(Weak::upgrade) {
                    buffer.push(items, lost);
                }
            }
            ServerMessage::Error { error, about: Some(about), .. } if about == "frames" => {
                if let Some(buffer) = self.frame_buffer.as_ref().and_then(Weak::upgrade) {
                    buffer.fail(error);
                }
            }
            ServerMessage::Error { error, about, subject: Some(subject) } => {
                self.handle_error(about.as_deref(), subject, error);
            }
            _ => {}
        }
    }

    /// A lease was given, renewed or given back.
    fn handle_leased(&mut self, axis: u16, epoch: u64, held: bool) {
        let asked = self.lease_requests.entry(axis).or_default();
        if let Some(one) = asked.match_reply(epoch, held) {
            // A lease without a handle is not renewed, and ends.
            if one.is_acquire() && one.reply.as_ref().is_some_and(|tell| !tell.is_closed()) {
                self.cache.set_lease(axis, Ok(epoch));
            }
            // The receiver may have been dropped; here and below.
            one.reply.map(|tell| tell.send(Ok(epoch)));
        }
        self.settle_leases(axis);
    }

    fn handle_error(&mut self, about: Option<&str>, subject: u16, error: GatewayError) {
        match about {
            Some("lease") => {
                self.lease_requests.entry(subject).or_default().push_refusal(error);
                self.settle_leases(subject);
            }
            Some("subscribe") => {
                self.sample_buffers.remove(&subject);
                if let Some(reply_sender) = self.pending_subscriptions.remove(&subject) {
                    let _ = reply_sender.send(Err(error));
                }
            }
            _ => {}
        }
    }

    /// Reports refused lease requests.
    fn settle_leases(&mut self, axis: u16) {
        let settled = self.lease_requests.entry(axis).or_default().drain_settled();
        for (PendingLeaseRequest { epoch, reply, .. }, error) in settled {
            match reply {
                Some(reply_sender) => drop(reply_sender.send(Err(error))),
                // A renewal was too late: the axis was stopped or taken, or this machine slept.
                None if self.cache.holds(axis, epoch) => {
                    self.cache.set_lease(axis, Err(lease_end_error(&error)));
                }
                None => {}
            }
        }
    }
}

fn to_json(message: &ClientMessage) -> Result<String, GatewayError> {
    serde_json::to_string(message).map_err(|error| server_lost(&error.to_string()))
}

async fn send_text(socket: &mut ClientSocket, text: String) -> Result<(), GatewayError> {
    let result = timeout(clock::scale_timeout(SILENT_MAX), socket.send(Message::text(text))).await;
    result
        .map_err(|_| server_lost("it takes nothing"))?
        .map_err(|error| server_lost(&error.to_string()))
}

/// Describes why a lease ended without being released.
fn lease_end_error(error: &GatewayError) -> GatewayError {
    if error.code == "E313" {
        return error.clone();
    }
    GatewayError::new("gateway.lease", format!("the lease ended: {}", error.message))
        .hint("another client stopped the axis or took it over; the server's journal names it")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_that_ended_with_its_link_causes_no_stop() {
        let lost = GatewayError::new("E313", "the link of axis 1 went away").hint("cut its supply");
        assert_eq!(lease_end_error(&lost), lost);
        let stopped = lease_end_error(&GatewayError::new(
            "gateway.lease",
            "no client has the lease of this axis",
        ));
        assert!(stopped.code == "gateway.lease" && stopped.hint.contains("another client stopped"));
    }
}
