//! The task on the WebSocket.

use std::collections::HashMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use hyper::header::{AUTHORIZATION, HeaderValue, SEC_WEBSOCKET_PROTOCOL};
use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_messages::{ClientMessage, ErrorBody, LeaseAct, PROTOCOL, ServerMessage, telemetry};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use super::asked::{Asked, One};
use super::{Ask, Channel, Feed, Known, Passing, Tell};
use crate::Refused;
use crate::lease::ended;
use crate::rest::{deed, lost, nonsense, question};
use crate::wire::{Stream, Wire, broken};

/// How often leases are renewed: they last three times as long.
const RENEW: Duration = Duration::from_millis(500);
/// How long a server may say nothing: it asks each second whether we are there.
const SILENT_MAX: Duration = Duration::from_secs(5);

type Socket = WebSocketStream<Box<dyn Stream>>;

/// Connects, hears who we are, and leaves the rest to a task of its own.
pub(super) async fn open(wire: &Wire, asked: mpsc::Receiver<Ask>) -> Result<Arc<Known>, Refused> {
    let mut socket = connect(wire).await?;
    let welcome = timeout(SILENT_MAX, welcomed(&mut socket)).await;
    let (session, server_ms) = welcome.unwrap_or_else(|_| Err(lost("it says nothing")))?;
    let known = Arc::new(Known::new(session, server_ms));
    let task = Task {
        socket,
        known: Arc::clone(&known),
        commands: HashMap::new(),
        leases: HashMap::new(),
        feeds: HashMap::new(),
        watching: HashMap::new(),
        passing: None,
        heard: clock::now(),
    };
    tokio::spawn(task.run(asked));
    Ok(known)
}

async fn connect(wire: &Wire) -> Result<Socket, Refused> {
    let stream = wire.dial().await?;
    let url = format!("ws://{}/api/v1/live", wire.address.authority());
    let wrong = |error: &dyn std::fmt::Display| Refused::new("E256", format!("{url}: {error}"));
    let mut request = url.as_str().into_client_request().map_err(|error| wrong(&error))?;
    let bearer = HeaderValue::from_str(&wire.secret.bearer()).map_err(|error| wrong(&error))?;
    request.headers_mut().insert(AUTHORIZATION, bearer);
    request.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(PROTOCOL));
    let shaken = timeout(SILENT_MAX, client_async(request, stream)).await;
    let (socket, _) = shaken.map_err(|_| lost("it does not answer"))?.map_err(refused)?;
    Ok(socket)
}

/// What the server says instead of a WebSocket.
fn refused(error: Error) -> Refused {
    let Error::Http(answer) = error else { return broken(&error) };
    let body = answer.body().as_deref().unwrap_or_default();
    let told = serde_json::from_slice::<ErrorBody>(body);
    told.map_or_else(|error| nonsense(&error.to_string()), |body| body.error)
}

async fn welcomed(socket: &mut Socket) -> Result<(String, f64), Refused> {
    while let Some(heard) = socket.next().await {
        if let Message::Text(text) = heard.map_err(|error| lost(&error.to_string()))? {
            return match serde_json::from_str(&text) {
                Ok(ServerMessage::Welcome(welcome)) => Ok((welcome.session, welcome.server_ms)),
                Ok(_) => Err(nonsense("it does not begin with a welcome")),
                Err(error) => Err(nonsense(&error.to_string())),
            };
        }
    }
    Err(lost("it hung up"))
}

/// What is on its way.
struct Task {
    socket: Socket,
    known: Arc<Known>,
    commands: HashMap<String, Tell<()>>,
    leases: HashMap<u16, Asked>,
    /// Of each channel; it is watched as long as somebody has it.
    feeds: HashMap<u16, Weak<Feed>>,
    watching: HashMap<u16, Tell<Channel>>,
    /// Where frames go; they are sent as long as somebody has it.
    passing: Option<Weak<Passing>>,
    heard: Instant,
}

impl Task {
    async fn run(mut self, mut asked: mpsc::Receiver<Ask>) {
        let mut renew = interval(RENEW);
        renew.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let ended = loop {
            let went_on = tokio::select! {
                biased;
                _ = renew.tick() => self.renew().await,
                ask = asked.recv() => match ask {
                    Some(ask) => self.ask(ask).await,
                    // Nobody holds or watches anything any more.
                    None => {
                        let _ = timeout(RENEW, self.socket.close(None)).await;
                        return;
                    }
                },
                heard = self.socket.next() => self.hear(heard),
            };
            if let Err(why) = went_on {
                break why;
            }
        };
        // From here on nothing more is taken, and what was not said yet never will be.
        asked.close();
        self.known.set_lost(ended.clone());
        self.wake();
        while let Some(ask) = asked.recv().await {
            ask.refuse(Refused { executed: Some(false), ..ended.clone() });
        }
        // Who waited has gone, or hears it; here and below.
        let (done, asked) = (deed(ended.clone()), question(ended));
        self.commands.into_values().for_each(|tell| drop(tell.send(Err(done.clone()))));
        let leases = self.leases.into_values().flat_map(Asked::into_tells);
        leases.for_each(|tell| drop(tell.send(Err(done.clone()))));
        self.watching.into_values().for_each(|tell| drop(tell.send(Err(asked.clone()))));
    }

    /// Keeps what is ours, and looks whether the server is there.
    async fn renew(&mut self) -> Result<(), Refused> {
        if clock::now().since(self.heard) >= SILENT_MAX {
            return Err(lost("it says nothing"));
        }
        let leases = self.known.leases();
        for (axis, epoch) in &leases {
            let (axis, epoch, act) = (*axis, *epoch, LeaseAct::Renew);
            self.leases.entry(axis).or_default().ask(One { act, epoch, tell: None });
            self.say(&ClientMessage::Lease { axis, act, epoch }).await?;
        }
        if !leases.is_empty() {
            self.say(&ClientMessage::Ping { client_ms: 0.0 }).await?;
        }
        self.unwatch().await
    }

    /// Has whoever watches look whether there is still something to see.
    fn wake(&self) {
        self.feeds.values().filter_map(Weak::upgrade).for_each(|feed| feed.wake());
    }

    /// Ends channels and frames that nobody watches any more.
    async fn unwatch(&mut self) -> Result<(), Refused> {
        if self.passing.take_if(|passing| passing.strong_count() == 0).is_some() {
            self.say(&ClientMessage::Frames { on: false, filter: None }).await?;
        }
        for (channel, _) in self.feeds.extract_if(|_, feed| feed.strong_count() == 0) {
            let text = text(&ClientMessage::Unsubscribe { channel })?;
            say(&mut self.socket, text).await?;
        }
        Ok(())
    }

    async fn ask(&mut self, ask: Ask) -> Result<(), Refused> {
        let message = match ask {
            Ask::Command { axis, order, tell } => {
                self.commands.insert(order.id.clone(), tell);
                ClientMessage::Command { axis, command: order }
            }
            Ask::Lease { axis, act, epoch, tell } => {
                if act == LeaseAct::Drop {
                    self.known.end_lease(axis, epoch);
                }
                self.leases.entry(axis).or_default().ask(One { act, epoch, tell: Some(tell) });
                ClientMessage::Lease { axis, act, epoch }
            }
            Ask::Watch { channel, what, feed, tell } => {
                // A client has a number of channels at most.
                self.unwatch().await?;
                self.feeds.insert(channel, Arc::downgrade(&feed));
                self.watching.insert(channel, tell);
                let super::What { axis, signal, parameter, hz } = what;
                ClientMessage::Subscribe { channel, axis, signal, parameter, hz }
            }
            Ask::Frames { filter, passing } => {
                self.passing = Some(Arc::downgrade(&passing));
                ClientMessage::Frames { on: true, filter }
            }
        };
        self.say(&message).await
    }

    async fn say(&mut self, message: &ClientMessage) -> Result<(), Refused> {
        say(&mut self.socket, text(message)?).await
    }

    fn hear(&mut self, heard: Option<Result<Message, Error>>) -> Result<(), Refused> {
        self.heard = clock::now();
        match heard {
            Some(Ok(Message::Text(text))) => {
                // What a later version says besides is nothing to this one.
                if let Ok(message) = serde_json::from_str(&text) {
                    self.told(message);
                }
            }
            Some(Ok(Message::Binary(bytes))) => {
                if let Some((channel, lost_total, samples)) = telemetry::decode(&bytes)
                    && let Some(feed) = self.feeds.get(&channel).and_then(Weak::upgrade)
                {
                    feed.take(lost_total, &samples, self.heard);
                }
            }
            Some(Ok(Message::Close(_))) | None => return Err(lost("it hung up")),
            Some(Ok(_)) => {}
            Some(Err(error)) => return Err(lost(&error.to_string())),
        }
        Ok(())
    }

    fn told(&mut self, message: ServerMessage) {
        match message {
            ServerMessage::Outcome(outcome) => {
                if let Some(tell) = self.commands.remove(&outcome.id) {
                    let _ = tell.send(ended(outcome));
                }
            }
            ServerMessage::Leased { axis, epoch, expires_ms } => {
                self.leased(axis, epoch, expires_ms.is_some());
            }
            ServerMessage::Subscribed { channel, hz, source, unit } => {
                if let Some(tell) = self.watching.remove(&channel) {
                    let _ = tell.send(Ok(Channel { hz, source, unit }));
                }
            }
            ServerMessage::Pong { server_ms, .. } => self.known.set_time(server_ms),
            ServerMessage::Axis(state) => {
                let newer = state.lease.as_ref().filter(|lease| lease.owner != self.known.session);
                if let Some(lease) = newer
                    && self.known.leases().iter().any(|(a, e)| *a == state.id && *e < lease.epoch)
                {
                    let what = format!("{} took the axis over", lease.owner);
                    self.known.set_lease(state.id, Err(Refused::new("gateway.lease", what)));
                }
                self.known.set_state(state);
            }
            ServerMessage::Bench(bench) => {
                self.known.set_links(&bench);
                self.wake();
            }
            ServerMessage::Locked(lock) => self.known.set_lock(Some(lock)),
            ServerMessage::Unlocked => self.known.set_lock(None),
            ServerMessage::Stopped(stopped) => self.known.set_stopped(stopped.axes),
            ServerMessage::Frames { items, lost } => {
                if let Some(passing) = self.passing.as_ref().and_then(Weak::upgrade) {
                    passing.take(items, lost);
                }
            }
            ServerMessage::Error { error, about: Some(about), .. } if about == "frames" => {
                if let Some(passing) = self.passing.as_ref().and_then(Weak::upgrade) {
                    passing.refuse(error);
                }
            }
            ServerMessage::Error { error, about, subject: Some(subject) } => {
                self.failed(about.as_deref(), subject, error);
            }
            _ => {}
        }
    }

    /// A lease was given, renewed or given back.
    fn leased(&mut self, axis: u16, epoch: u64, held: bool) {
        let asked = self.leases.entry(axis).or_default();
        if let Some(one) = asked.answered(epoch, held) {
            // One that nobody waits for any more is not renewed, and ends.
            if one.is_taking() && one.tell.as_ref().is_some_and(|tell| !tell.is_closed()) {
                self.known.set_lease(axis, Ok(epoch));
            }
            // Who asked may have gone; here and below.
            one.tell.map(|tell| tell.send(Ok(epoch)));
        }
        self.settle(axis);
    }

    fn failed(&mut self, about: Option<&str>, subject: u16, error: Refused) {
        match about {
            Some("lease") => {
                self.leases.entry(subject).or_default().refused(error);
                self.settle(subject);
            }
            Some("subscribe") => {
                self.feeds.remove(&subject);
                if let Some(tell) = self.watching.remove(&subject) {
                    let _ = tell.send(Err(error));
                }
            }
            _ => {}
        }
    }

    /// Says what is refused by now.
    fn settle(&mut self, axis: u16) {
        let settled = self.leases.entry(axis).or_default().settled();
        for (One { epoch, tell, .. }, error) in settled {
            match tell {
                Some(tell) => drop(tell.send(Err(error))),
                // A renewal came too late: somebody stopped or took the axis, or we slept.
                None if self.known.holds(axis, epoch) => {
                    self.known.set_lease(axis, Err(over(&error)));
                }
                None => {}
            }
        }
    }
}

fn text(message: &ClientMessage) -> Result<String, Refused> {
    serde_json::to_string(message).map_err(|error| lost(&error.to_string()))
}

async fn say(socket: &mut Socket, text: String) -> Result<(), Refused> {
    let said = timeout(SILENT_MAX, socket.send(Message::text(text))).await;
    said.map_err(|_| lost("it takes nothing"))?.map_err(|error| lost(&error.to_string()))
}

/// Why a lease ended that was not given back.
fn over(error: &Refused) -> Refused {
    if error.code == "E313" {
        return error.clone();
    }
    Refused::new("gateway.lease", format!("the lease ended: {}", error.message))
        .hint("somebody stopped the axis or took it over; the server's journal tells who")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_that_ended_with_its_link_is_nobodys_stop() {
        let lost = Refused::new("E313", "the link of axis 1 went away").hint("cut its supply");
        assert_eq!(over(&lost), lost);
        let stopped = over(&Refused::new("gateway.lease", "nobody has the lease of this axis"));
        assert!(stopped.code == "gateway.lease" && stopped.hint.contains("somebody stopped"));
    }
}
