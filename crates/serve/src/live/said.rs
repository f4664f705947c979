//! What a viewer has said and what was not done yet: stops do not wait among it.

use std::collections::VecDeque;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;

use super::MESSAGE_MAX;
use crate::bench::overtaken;
use crate::message::{ClientMessage, LeaseAct, Refused, ServerMessage};

/// Messages of a viewer in each [`SPAN`]; what is more waits.
const MESSAGES_MAX: u32 = 200;
/// A tenth of a second.
const SPAN: Duration = Duration::from_millis(100);
/// Stops among them that go first; more are a flood like any other.
const STOPS_MAX: u32 = 20;
/// Messages that wait; what is more waits in the viewer's socket.
const WAITING_MAX: usize = 256;

/// What waits for its turn: a message, or what is to be answered to one that is none.
pub(super) type Said = Result<ClientMessage, Box<ServerMessage>>;

/// What waits, in the order in which it came.
#[derive(Default)]
pub(super) struct Waiting {
    said: VecDeque<(Said, usize)>,
    bytes: usize,
}

/// Keeps whoever floods us from taking a processor that others need.
pub(super) struct Pace {
    since: Instant,
    count: u32,
    stops: u32,
}

impl Waiting {
    /// Whether more is read.
    pub fn has_room(&self) -> bool {
        self.said.len() < WAITING_MAX && self.bytes < MESSAGE_MAX
    }

    pub fn is_empty(&self) -> bool {
        self.said.is_empty()
    }

    /// Takes what was said in so many bytes.
    pub fn push(&mut self, said: Said, bytes: usize) {
        self.bytes += bytes;
        self.said.push_back((said, bytes));
    }

    /// Whose turn it is.
    pub fn pop(&mut self) -> Option<Said> {
        let (said, bytes) = self.said.pop_front()?;
        self.bytes -= bytes;
        Some(said)
    }

    /// A stop of these axes, or of all, goes before what waits: what of that would move them again, or
    /// let them move, is not done any more, for it was said before.
    pub fn stopped(
        &mut self,
        axes: Option<&[u16]>,
        refuse: impl Fn(&ClientMessage, Refused) -> ServerMessage,
    ) {
        let concerns = |axis: &u16| axes.is_none_or(|axes| axes.contains(axis));
        for (said, _) in &mut self.said {
            let Ok(message) = said else { continue };
            let void = match &*message {
                ClientMessage::Command { axis, .. } => concerns(axis),
                ClientMessage::Lease { axis, act, .. } => {
                    matches!(act, LeaseAct::Take | LeaseAct::TakeOver) && concerns(axis)
                }
                ClientMessage::Release => axes.is_none(),
                _ => false,
            };
            if void {
                let refused = refuse(message, overtaken());
                *said = Err(Box::new(refused));
            }
        }
    }
}

impl Default for Pace {
    fn default() -> Self {
        Self { since: clock::now(), count: 0, stops: 0 }
    }
}

impl Pace {
    /// Waits until one more may be done.
    pub async fn keep(&mut self) {
        if self.count < MESSAGES_MAX {
            return;
        }
        tokio::time::sleep((self.since + SPAN).since(clock::now())).await;
        *self = Self::default();
    }

    /// Counts a message.
    pub fn count(&mut self) {
        self.count += 1;
    }

    /// Counts a stop. False when there were so many that it waits like everything else.
    pub fn stop(&mut self) -> bool {
        if clock::now().since(self.since) >= SPAN {
            *self = Self::default();
        }
        self.stops += 1;
        self.stops <= STOPS_MAX
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, from_value, json};

    use super::*;

    fn said(message: Value) -> Said {
        Ok(from_value(message).unwrap())
    }

    fn lease(axis: u16, act: &str) -> Said {
        said(json!({ "type": "lease", "axis": axis, "act": act, "epoch": 1 }))
    }

    fn command(axis: u16) -> Said {
        said(json!({ "type": "command", "axis": axis, "id": "a", "issued_ms": 0, "ttl_ms": 1,
            "epoch": 1, "verb": "velocity", "arguments": {} }))
    }

    /// How many of what waits are refused because of a stop of these axes.
    fn void(axes: Option<&[u16]>) -> usize {
        let mut waiting = Waiting::default();
        let all = [
            command(0),
            command(1),
            lease(0, "take"),
            lease(0, "renew"),
            lease(0, "drop"),
            lease(1, "take_over"),
            said(json!({ "type": "release" })),
            said(json!({ "type": "ping", "client_ms": 1 })),
            said(json!({ "type": "unsubscribe", "channel": 1 })),
        ];
        all.into_iter().for_each(|said| waiting.push(said, 10));
        waiting.stopped(axes, |_, _| ServerMessage::Unlocked);
        std::iter::from_fn(|| waiting.pop()).filter(Result::is_err).count()
    }

    #[test]
    fn a_stop_voids_what_was_said_before_it_and_would_move_its_axes() {
        assert_eq!(
            (void(Some(&[])), void(Some(&[0])), void(Some(&[0, 1])), void(None)),
            (0, 2, 4, 5)
        );
    }

    #[test]
    fn what_waits_is_bounded_by_number_and_length() {
        let ping = || said(json!({ "type": "ping", "client_ms": 1 }));
        let mut waiting = Waiting::default();
        (0..WAITING_MAX).for_each(|_| waiting.push(ping(), 10));
        assert!(!waiting.has_room());
        assert!(waiting.pop().is_some() && waiting.has_room());
        waiting.push(ping(), MESSAGE_MAX);
        assert!(!waiting.has_room());
        while waiting.pop().is_some() {}
        assert!(waiting.is_empty() && waiting.has_room() && waiting.bytes == 0);
    }

    #[test]
    fn a_flood_of_stops_waits_like_any_other() {
        let mut pace = Pace { since: Instant::FAR, count: 0, stops: 0 };
        let at_once = (0..100).filter(|_| pace.stop()).count();
        assert_eq!(at_once, STOPS_MAX as usize);
    }
}
