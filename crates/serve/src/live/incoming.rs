//! Open requests of a viewer. Stops do not wait for them.
//!
//! Why: STOP-16.

use std::collections::VecDeque;
use std::time::Duration;

use axum::body::Bytes;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::MESSAGE_MAX;
use crate::bench::overtaken_error;
use crate::message::{ClientMessage, GatewayError, LeaseAction, ServerMessage};

/// Messages of a viewer in each [`WINDOW`]; further ones wait.
const MESSAGES_MAX: u32 = 200;
/// A tenth of a second.
const WINDOW: Duration = Duration::from_millis(100);
/// Stops among them that go first; more are a flood like any other.
// More than a person can press, and fewer than a flood needs (STOP-16).
const STOPS_MAX: u32 = 20;
/// Messages that wait; further ones wait in the viewer's socket.
// A client that does not read its replies waits; it does not fill the server's memory.
const WAITING_MAX: usize = 256;

/// A queued message.
pub(super) enum QueuedMessage {
    /// A message, and how often motion had been locked when it was read.
    Request(ClientMessage, u64),
    /// A reply.
    Reply(Box<ServerMessage>),
    /// A ping of the client.
    Ping(Bytes),
    /// A pong of the client.
    Pong,
}

/// Queue in which the result of a message needs a place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum OutputQueue {
    NotNeeded,
    Reply,
    Subscription,
}

/// Queued messages: those that may move or stop axes, which wait for no unread replies, and the others. Each in order
/// of arrival.
#[derive(Default)]
pub(super) struct IncomingQueue {
    motion: VecDeque<(QueuedMessage, usize)>,
    other: VecDeque<(QueuedMessage, usize)>,
    bytes: usize,
}

/// Limits the rate of a client, so that a flood takes no processor from others.
pub(super) struct RateLimiter {
    since: Instant,
    count: u32,
    stops: u32,
}

impl IncomingQueue {
    /// Returns whether more is read.
    pub fn has_room(&self) -> bool {
        self.motion.len() + self.other.len() < WAITING_MAX && self.bytes < MESSAGE_MAX
    }

    /// Queue in which the next result needs a place. None without a message.
    pub fn next_output(&self) -> Option<OutputQueue> {
        let (queued, _) = self.motion.front().or_else(|| self.other.front())?;
        Some(queued.output_queue())
    }

    /// Queues a message of `bytes` bytes.
    pub fn push(&mut self, queued: QueuedMessage, bytes: usize) {
        self.bytes += bytes;
        let orders = matches!(queued, QueuedMessage::Request(..))
            && queued.output_queue() == OutputQueue::NotNeeded;
        if orders { &mut self.motion } else { &mut self.other }.push_back((queued, bytes));
    }

    /// Queues a reply to a message of `bytes` bytes.
    pub fn push_reply(&mut self, message: ServerMessage, bytes: usize) {
        self.push(QueuedMessage::Reply(Box::new(message)), bytes);
    }

    /// Takes the next message, and its size in bytes.
    pub fn pop(&mut self) -> Option<(QueuedMessage, usize)> {
        // Commands first: a client that does not take its values can still move and stop (STOP-16).
        let (queued, bytes) = self.motion.pop_front().or_else(|| self.other.pop_front())?;
        debug_assert!(self.bytes >= bytes, "bytes are counted in and out alike");
        self.bytes -= bytes;
        Some((queued, bytes))
    }

    /// Refuses queued motion commands and releases for these axes, or for all, because a stop was received after them.
    pub fn void_for_stop(
        &mut self,
        axes: Option<&[u16]>,
        refuse: impl Fn(&ClientMessage, GatewayError) -> ServerMessage,
    ) {
        let void = |message: &ClientMessage| match message {
            // A stop that is received after it is pending anew.
            ClientMessage::Command { axis, .. } | ClientMessage::Dismiss { axis, .. } => {
                concerns_axis(axis, axes)
            }
            ClientMessage::Lease { axis, act, .. } => {
                matches!(act, LeaseAction::Take | LeaseAction::TakeOver)
                    && concerns_axis(axis, axes)
            }
            ClientMessage::Release => axes.is_none(),
            _ => false,
        };
        let rest = &mut self.other;
        self.motion.retain(|(queued, bytes)| match queued {
            QueuedMessage::Request(message, _) if void(message) => {
                rest.push_back((
                    QueuedMessage::Reply(Box::new(refuse(message, overtaken_error()))),
                    *bytes,
                ));
                false
            }
            _ => true,
        });
    }
}

fn concerns_axis(axis: &u16, axes: Option<&[u16]>) -> bool {
    axes.is_none_or(|axes| axes.contains(axis))
}

impl QueuedMessage {
    fn output_queue(&self) -> OutputQueue {
        match self {
            Self::Request(message, _) => match message {
                ClientMessage::Command { .. }
                | ClientMessage::Lease { .. }
                | ClientMessage::Stop(_)
                | ClientMessage::Dismiss { .. }
                | ClientMessage::Release => OutputQueue::NotNeeded,
                ClientMessage::Ping { .. } => OutputQueue::Reply,
                ClientMessage::Subscribe { .. }
                | ClientMessage::Unsubscribe { .. }
                | ClientMessage::Frames { .. }
                | ClientMessage::Explain { .. } => OutputQueue::Subscription,
            },
            Self::Reply(_) => OutputQueue::Reply,
            Self::Ping(_) | Self::Pong => OutputQueue::NotNeeded,
        }
    }
}

impl Default for RateLimiter {
    fn default() -> Self {
        Self { since: clock::now(), count: 0, stops: 0 }
    }
}

impl RateLimiter {
    /// Waits until one more may be done.
    pub async fn wait_until_allowed(&mut self) {
        if self.count < MESSAGES_MAX {
            return;
        }
        let left = (self.since + WINDOW).since(clock::now());
        // To sleep for nothing takes a millisecond.
        if !left.is_zero() {
            tokio::time::sleep(left).await;
        }
        *self = Self::default();
    }

    /// Counts a message.
    pub fn count(&mut self) {
        self.count += 1;
    }

    /// Counts a stop. False above the rate limit: it waits like other messages.
    pub fn allow_stop(&mut self) -> bool {
        if clock::now().since(self.since) >= WINDOW {
            *self = Self::default();
        }
        self.stops += 1;
        self.stops <= STOPS_MAX
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;
    use serde_json::{Value, from_value, json};

    use super::*;

    fn request(message: Value) -> QueuedMessage {
        QueuedMessage::Request(from_value(message).unwrap(), 0)
    }

    fn lease(axis: u16, act: &str) -> QueuedMessage {
        request(json!({ "type": "lease", "axis": axis, "act": act, "epoch": 1 }))
    }

    fn command(axis: u16) -> QueuedMessage {
        request(json!({ "type": "command", "axis": axis, "id": "a", "issued_ms": 0, "ttl_ms": 1,
            "epoch": 1, "verb": "velocity", "arguments": {} }))
    }

    /// Number of queued messages that are refused because of a stop of these axes.
    fn void(axes: Option<&[u16]>) -> usize {
        let mut waiting = IncomingQueue::default();
        let all = [
            command(0),
            command(1),
            lease(0, "take"),
            lease(0, "renew"),
            lease(0, "drop"),
            lease(1, "take_over"),
            request(json!({ "type": "release" })),
            request(json!({ "type": "ping", "client_ms": 1 })),
            request(json!({ "type": "unsubscribe", "channel": 1 })),
        ];
        all.into_iter().for_each(|queued| waiting.push(queued, 10));
        waiting.void_for_stop(axes, |_, _| ServerMessage::Unlocked);
        std::iter::from_fn(|| waiting.pop())
            .filter(|(s, _)| matches!(s, QueuedMessage::Reply(_)))
            .count()
    }

    #[test]
    fn a_stop_voids_earlier_commands_that_would_move_its_axes() {
        assert_eq!(
            (void(Some(&[])), void(Some(&[0])), void(Some(&[0, 1])), void(None)),
            (0, 2, 4, 5)
        );
    }

    #[test]
    fn the_end_of_a_motion_does_not_wait_for_a_reply_that_is_not_read() {
        let mut waiting = IncomingQueue::default();
        assert_eq!(waiting.next_output(), None);
        waiting.push(request(json!({ "type": "ping", "client_ms": 1 })), 1);
        waiting.push(request(json!({ "type": "explain", "n": 1 })), 1);
        waiting.push_reply(ServerMessage::Unlocked, 1);
        assert_eq!(waiting.next_output(), Some(OutputQueue::Reply));
        let motions = [command(0), lease(0, "drop"), request(json!({ "type": "release" }))];
        motions.into_iter().for_each(|queued| waiting.push(queued, 1));
        let places: Vec<_> = std::iter::from_fn(|| {
            let next = waiting.next_output();
            waiting.pop();
            next
        })
        .collect();
        let rest = [OutputQueue::Reply, OutputQueue::Subscription, OutputQueue::Reply];
        assert_eq!((&places[..3], &places[3..]), (&[OutputQueue::NotNeeded; 3][..], &rest[..]));
    }

    #[test]
    fn waiting_messages_are_bounded_by_number_and_length() {
        let ping = || request(json!({ "type": "ping", "client_ms": 1 }));
        let mut waiting = IncomingQueue::default();
        (0..WAITING_MAX).for_each(|_| waiting.push(ping(), 10));
        assert!(!waiting.has_room());
        assert!(waiting.pop().is_some() && waiting.has_room());
        waiting.push(ping(), MESSAGE_MAX);
        assert!(!waiting.has_room());
        while waiting.pop().is_some() {}
        assert!(waiting.next_output().is_none() && waiting.has_room() && waiting.bytes == 0);
    }

    #[test]
    fn a_client_with_old_messages_does_not_wait() {
        let mut pace = RateLimiter { count: MESSAGES_MAX, ..RateLimiter::default() };
        clock::sleep_until(pace.since + WINDOW);
        // Not even for a timer's next tick.
        assert!(pace.wait_until_allowed().now_or_never().is_some());
        assert_eq!(pace.count, 0);
    }

    #[test]
    fn a_flood_of_stops_waits_like_any_other() {
        let mut pace = RateLimiter { since: Instant::FAR_FUTURE, count: 0, stops: 0 };
        let at_once = (0..100).filter(|_| pace.allow_stop()).count();
        assert_eq!(at_once, STOPS_MAX as usize);
    }
}
