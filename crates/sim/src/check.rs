//! Invariants that are checked after every event.
//!
//! The checker is out of band: labels of the bytes state which request a reply answers, and whether the
//! wire changed it. The drive states its executed requests. A host with another belief breaks an invariant,
//! except if changed bytes still passed all checks of their protocol. That is a *wire collision*, and only
//! counted.

mod can;

use polepair_core::explain::{Direction, Dissector};
use polepair_core::proto;
use polepair_core::station::Counters;
use polepair_core::time::Instant;

use crate::serial_line::TransmissionLabel;
use crate::world::{NodeId, WireId, World};
pub use can::CanChecker;
pub(crate) use can::ReplyMatch;

/// The longest frame of all protocols on serial lines, bytes (Modbus ASCII).
const FRAME_MAX: usize = 513;
/// Requests that are kept as unanswered.
const OPEN_MAX: usize = 16;

/// An invariant that was broken.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Violation {
    /// Number of the invariant: `I1`.
    pub invariant: &'static str,
    /// Time.
    pub at: Instant,
    /// Description of the violation, with the axis and the values.
    pub what: String,
}

impl std::fmt::Display for Violation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at {:.6} s: {}", self.invariant, self.at.0 as f64 / 1e9, self.what)
    }
}

/// Watches one host on its wire.
pub struct SerialChecker {
    host: NodeId,
    wire: WireId,
    dissector: Option<&'static dyn Dissector>,
    last_sent: TransmissionLabel,
    /// Contents of requests that were sent since the last match and may still be answered.
    open_requests: Vec<u64>,
    counters: Counters,
    /// Content of the request whose answer is still to come, because a copy was taken for it.
    pending_question: Option<u64>,
    /// The reply that was matched last was changed on the wire, or answers a changed request.
    pub(crate) last_match_tainted: bool,
    /// True if the last match was the second copy of the reply to an earlier request.
    pub(crate) last_match_copied: bool,
    /// Number of such copies.
    pub(crate) copies_taken: u64,
}

impl std::fmt::Debug for SerialChecker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Watch({:?})", self.wire)
    }
}

impl SerialChecker {
    /// Creates the watch of `host`, which uses `protocol` on `wire`.
    #[must_use]
    pub fn new(host: NodeId, wire: WireId, protocol: &str) -> Self {
        Self {
            host,
            wire,
            dissector: proto::find_dissector(protocol),
            last_sent: TransmissionLabel::default(),
            open_requests: Vec::with_capacity(OPEN_MAX),
            counters: Counters::default(),
            pending_question: None,
            last_match_tainted: false,
            last_match_copied: false,
            copies_taken: 0,
        }
    }

    /// Checks the host; call it after every event that touched it. `gave_up` is true if a ticket ended without a reply:
    /// from then on no reply to its requests may be accepted.
    pub fn check_event(&mut self, world: &mut World, gave_up: bool) -> Option<Violation> {
        let counters = world.inspect(self.host, |n, _| n.axes().map(|a| a.counters()))?;
        let before = std::mem::replace(&mut self.counters, counters);
        // A plan may also end between two requests, for an earlier silence, while another plan's is open.
        let gave_up = gave_up && counters.silent > before.silent;
        let mut known = world.serial_status(self.wire, self.host);
        // Behind its own bytes a host may find a frame that came before: sure where they are too few
        // for a reply, and harmless where that frame answers the same question.
        let own = known.last_received.tag == known.last_sent.tag;
        let same = known.last_from_others.question_hash == known.last_sent.content_hash;
        if own && (known.last_received.byte_count == 1 || same) {
            known.last_received = known.last_from_others;
        }
        let transmission_label = std::mem::replace(&mut self.last_sent, known.last_sent);
        let matched = counters.answered > before.answered;
        let index = self
            .open_requests
            .iter()
            .rposition(|content| *content == known.last_received.question_hash);
        if matched || gave_up {
            self.open_requests
                .drain(..index.filter(|_| !gave_up).map_or(self.open_requests.len(), |at| at + 1));
        }
        if known.last_sent.tag != transmission_label.tag {
            let old = (self.open_requests.len() + 1).saturating_sub(OPEN_MAX);
            self.open_requests.drain(..old);
            debug_assert!(self.open_requests.len() < OPEN_MAX);
            self.open_requests.push(known.last_sent.content_hash);
        }
        let later = known.last_received.answers != transmission_label.tag
            && known.last_received.begun_by >= transmission_label.left_at;
        if known.last_received.is_copy
            && later
            && acknowledged_count(&counters) > acknowledged_count(&before)
        {
            // A copy of an acknowledgement, which names nothing, that an adapter had kept back.
            self.copies_taken += 1;
        }
        if !matched {
            return None;
        }
        self.last_match_tainted = known.last_received.tainted;
        self.last_match_copied = known.last_received.is_copy && index.is_none();
        // Once a copy was taken for the answer, that answer comes while the next one is awaited,
        // which may ask the same again.
        let behind = self.pending_question.take() == Some(known.last_received.question_hash)
            && known.last_received.answers != transmission_label.tag
            && known.last_received.begun_by >= transmission_label.left_at;
        if known.last_received.tainted || (index.is_some() && !behind) {
            // A second copy with the right value is right, but the reply itself will still arrive.
            let ahead = known.last_received.is_copy
                && known.last_received.answers != transmission_label.tag;
            self.pending_question = ahead.then_some(transmission_label.content_hash);
            return None;
        }
        self.last_match_copied |= behind;
        if self.last_match_copied && known.last_received.begun_by >= transmission_label.left_at {
            // It was kept back until the request had left: it cannot be distinguished from a reply.
            self.copies_taken += 1;
            self.pending_question = Some(transmission_label.content_hash);
            return None;
        }
        self.last_match_copied = false;
        let what = format!(
            "request {} got the reply to request {}",
            transmission_label.tag, known.last_received.answers
        );
        Some(Violation { invariant: "I1", at: world.now(), what })
    }

    /// Returns whether the recently received bytes of the host contain a frame that passes every check of its protocol:
    /// then a wrong value is a wire collision.
    #[must_use]
    pub fn is_wire_collision(&self, world: &World) -> bool {
        let (bytes, fresh) = world.received_bytes(self.wire, self.host);
        let frames = self.dissector.map(|d| valid_frames(d, bytes, fresh, Direction::ToHost));
        frames.is_some_and(|mut frames| frames.next().is_some())
    }

    /// Returns whether the recently received bytes of `drive` contain a frame that passes every check of its protocol
    /// and was not sent just then: the drive may have executed a request of no host.
    #[must_use]
    pub fn accepted_unsent(&self, world: &World, drive: NodeId) -> bool {
        let (bytes, fresh) = world.received_bytes(self.wire, drive);
        let Some(dissector) = self.dissector else { return true };
        valid_frames(dissector, bytes, fresh, Direction::ToDrive)
            .any(|frame| !world.is_as_sent(self.wire, drive, frame))
    }

    /// Returns whether the last received bytes of `drive` pass every check of its protocol as a frame that was not
    /// sent: it was changed on the way.
    #[must_use]
    pub fn accepted_changed(&self, world: &World, drive: NodeId) -> bool {
        let (bytes, fresh) = world.received_bytes(self.wire, drive);
        let Some(dissector) = self.dissector else { return false };
        let mut last = valid_frames(dissector, bytes, fresh, Direction::ToDrive)
            .filter(|frame| frame.end == bytes.len())
            .peekable();
        last.peek().is_some() && last.all(|frame| !world.is_as_sent(self.wire, drive, frame))
    }
}

fn acknowledged_count(c: &Counters) -> u64 {
    c.acknowledged + c.relayed
}

/// Places of every frame that passes its check, wherever it begins, and ends behind `fresh`.
fn valid_frames(
    dissector: &'static dyn Dissector,
    bytes: &[u8],
    fresh: usize,
    direction: Direction,
) -> impl Iterator<Item = std::ops::Range<usize>> {
    // No frame is longer, so none that begins earlier ends behind `fresh`.
    (fresh.saturating_sub(FRAME_MAX)..bytes.len()).filter_map(move |from| {
        let len = dissector.valid_frame_len(&bytes[from..], Some(direction))?;
        (from + len > fresh).then_some(from..from + len)
    })
}

/// The values that a drive's parameter may have, by the reported results of its writes.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PossibleValues(Option<Vec<i64>>);

impl PossibleValues {
    /// Values that are kept apart; with more, nothing is known.
    const VALUES_MAX: usize = 16;

    /// Nothing is known.
    pub const ANY: Self = Self(None);

    /// A write was reported as done.
    pub fn set(&mut self, value: i64) {
        self.0 = Some(vec![value]);
    }

    /// A write may have been executed.
    pub fn add(&mut self, value: i64) {
        if let Some(values) = &mut self.0 {
            values.push(value);
            if values.len() > Self::VALUES_MAX {
                self.0 = None;
            }
        }
    }

    /// Returns whether reading `value` agrees with what is known. From then on it is what is known.
    pub fn observe(&mut self, value: i64) -> bool {
        let agrees = self.0.as_ref().is_none_or(|values| values.contains(&value));
        self.set(value);
        agrees
    }
}
