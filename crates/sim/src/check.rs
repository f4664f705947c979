//! What must hold after every event, whatever the wire did.
//!
//! The judge is out of band: labels that travel with the bytes say which request a reply answers
//! and whether the wire changed anything, the bench side of a drive says what it did. A host that
//! believes something else broke an invariant; unless the bytes it believed were changed on the way
//! and still passed every check of their protocol: that is a *wire collision*, and only counted.

mod can;

use polepair_core::explain::{Direction, Dissector};
use polepair_core::proto;
use polepair_core::station::Counters;
use polepair_core::time::Instant;

use crate::serial_line::Label;
use crate::world::{NodeId, WireId, World};
pub use can::CanWatch;
pub(crate) use can::Match;

/// The longest frame of all protocols on serial lines, bytes (Modbus ASCII).
const FRAME_MAX: usize = 513;
/// Requests that are kept as unanswered.
const OPEN_MAX: usize = 16;

/// An invariant that was broken.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Violation {
    /// Its number: `I1`.
    pub invariant: &'static str,
    /// When.
    pub at: Instant,
    /// What happened, with the axis and the values.
    pub what: String,
}

impl std::fmt::Display for Violation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at {:.6} s: {}", self.invariant, self.at.0 as f64 / 1e9, self.what)
    }
}

/// Watches one host on its wire.
pub struct Watch {
    host: NodeId,
    wire: WireId,
    dissector: Option<&'static dyn Dissector>,
    sent: Label,
    /// Contents of requests that were sent since the last match and may still be answered.
    open: Vec<u64>,
    counters: Counters,
    /// Content of the request whose answer is still to come, because a copy was taken for it.
    shifted: Option<u64>,
    /// The reply that was matched last was changed on the wire, or answers a changed request.
    pub(crate) last_match_tainted: bool,
    /// It was the second copy of the reply to an earlier request.
    pub(crate) last_match_copied: bool,
    /// How often that happened.
    pub(crate) copies_taken: u64,
}

impl std::fmt::Debug for Watch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Watch({:?})", self.wire)
    }
}

impl Watch {
    /// A watch over `host`, which speaks `protocol` on `wire`.
    #[must_use]
    pub fn new(host: NodeId, wire: WireId, protocol: &str) -> Self {
        Self {
            host,
            wire,
            dissector: proto::dissector(protocol),
            sent: Label::default(),
            open: Vec::with_capacity(OPEN_MAX),
            counters: Counters::default(),
            shifted: None,
            last_match_tainted: false,
            last_match_copied: false,
            copies_taken: 0,
        }
    }

    /// To be called after every event that touched the host. `gave_up` says that a ticket ended
    /// without an answer: from then on no reply to what was sent for it may be taken.
    pub fn after(&mut self, world: &mut World, gave_up: bool) -> Option<Violation> {
        let counters = world.look(self.host, |n, _| n.axes().map(|a| a.counters()))?;
        let before = std::mem::replace(&mut self.counters, counters);
        let mut known = world.knowledge(self.wire, self.host);
        // Behind its own bytes a host may find a frame that came before: sure where they are too few
        // for a reply, and harmless where that frame answers the same question.
        let own = known.heard.tag == known.sent.tag;
        let same = known.heard_others.question == known.sent.content;
        if own && (known.heard.bytes == 1 || same) {
            known.heard = known.heard_others;
        }
        let asked = std::mem::replace(&mut self.sent, known.sent);
        let matched = counters.answered > before.answered;
        let place = self.open.iter().rposition(|content| *content == known.heard.question);
        if matched || gave_up {
            self.open.drain(..place.filter(|_| !gave_up).map_or(self.open.len(), |at| at + 1));
        }
        if known.sent.tag != asked.tag {
            let old = (self.open.len() + 1).saturating_sub(OPEN_MAX);
            self.open.drain(..old);
            self.open.push(known.sent.content);
        }
        let acknowledged = |c: &Counters| c.acknowledged + c.relayed;
        let later = known.heard.answers != asked.tag && known.heard.begun >= asked.left;
        if known.heard.copy && later && acknowledged(&counters) > acknowledged(&before) {
            // A copy of an acknowledgement, which names nothing, that an adapter had kept back.
            self.copies_taken += 1;
        }
        if !matched {
            return None;
        }
        self.last_match_tainted = known.heard.tainted;
        self.last_match_copied = known.heard.copy && place.is_none();
        // Once a copy was taken for the answer, that answer comes while the next one is awaited,
        // which may ask the same again.
        let behind = self.shifted.take() == Some(known.heard.question)
            && known.heard.answers != asked.tag
            && known.heard.begun >= asked.left;
        if known.heard.tainted || (place.is_some() && !behind) {
            // A second copy that says what is asked is right, but the answer itself is to come.
            let ahead = known.heard.copy && known.heard.answers != asked.tag;
            self.shifted = ahead.then_some(asked.content);
            return None;
        }
        self.last_match_copied |= behind;
        if self.last_match_copied && known.heard.begun >= asked.left {
            // It was kept back until the request had left: nothing tells it from an answer.
            self.copies_taken += 1;
            self.shifted = Some(asked.content);
            return None;
        }
        self.last_match_copied = false;
        let what =
            format!("request {} got the reply to request {}", asked.tag, known.heard.answers);
        Some(Violation { invariant: "I1", at: world.now(), what })
    }

    /// Whether what the host heard lately holds a frame that passes every check of its protocol:
    /// then a wrong value is a wire collision.
    #[must_use]
    pub fn collided(&self, world: &World) -> bool {
        let (bytes, fresh) = world.heard(self.wire, self.host);
        let frames = self.dissector.map(|d| frames(d, bytes, fresh, Direction::ToHost));
        frames.is_some_and(|mut frames| frames.next().is_some())
    }

    /// Whether what `drive` heard lately holds a frame that passes every check of its protocol and
    /// that is not what was sent just then: the drive may have done what nobody asked for.
    #[must_use]
    pub fn misled(&self, world: &World, drive: NodeId) -> bool {
        let (bytes, fresh) = world.heard(self.wire, drive);
        let Some(dissector) = self.dissector else { return true };
        frames(dissector, bytes, fresh, Direction::ToDrive)
            .any(|frame| !world.was_meant(self.wire, drive, frame))
    }

    /// Whether what `drive` heard last passes every check of its protocol as a frame that was not
    /// sent: it was changed on the way.
    #[must_use]
    pub fn mistook(&self, world: &World, drive: NodeId) -> bool {
        let (bytes, fresh) = world.heard(self.wire, drive);
        let Some(dissector) = self.dissector else { return false };
        let mut last = frames(dissector, bytes, fresh, Direction::ToDrive)
            .filter(|frame| frame.end == bytes.len())
            .peekable();
        last.peek().is_some() && last.all(|frame| !world.was_meant(self.wire, drive, frame))
    }
}

/// Where every frame is that passes its check, wherever it begins, and ends behind `fresh`.
fn frames(
    dissector: &'static dyn Dissector,
    bytes: &[u8],
    fresh: usize,
    direction: Direction,
) -> impl Iterator<Item = std::ops::Range<usize>> {
    // No frame is longer, so none that begins earlier ends behind `fresh`.
    (fresh.saturating_sub(FRAME_MAX)..bytes.len()).filter_map(move |from| {
        let len = dissector.whole(&bytes[from..], Some(direction))?;
        (from + len > fresh).then_some(from..from + len)
    })
}

/// The values that a drive's parameter may have, by what was reported of writing it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Possible(Option<Vec<i64>>);

impl Possible {
    /// Values that are kept apart; with more, nothing is known.
    const VALUES_MAX: usize = 16;

    /// Nothing is known.
    pub const ANY: Self = Self(None);

    /// A write was reported as done.
    pub fn is(&mut self, value: i64) {
        self.0 = Some(vec![value]);
    }

    /// A write may have been executed.
    pub fn may_be(&mut self, value: i64) {
        if let Some(values) = &mut self.0 {
            values.push(value);
            if values.len() > Self::VALUES_MAX {
                self.0 = None;
            }
        }
    }

    /// Whether reading `value` agrees with what is known. From then on it is what is known.
    pub fn agrees(&mut self, value: i64) -> bool {
        let agrees = self.0.as_ref().is_none_or(|values| values.contains(&value));
        self.is(value);
        agrees
    }
}
