//! Splits a serial stream into frames: one direction of one link.

use std::collections::VecDeque;

use polepair_core::explain::{Context, Direction, FrameBoundary};

use crate::explanation::Explanation;
use crate::rules::{Rule, RuleScope};
use crate::timestamp::Timestamp;

/// Bytes that may wait for the rest of their frame; more than that are no frame.
const PENDING_MAX: usize = 4096;
/// Silence after which no further byte belongs to the received ones.
const SILENCE_NS: u64 = 20_000_000;

/// Content at the head of the stream.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum PieceKind {
    /// A whole frame.
    Frame,
    /// A frame whose check fails.
    BadCheck,
    /// Bytes of no frame.
    Junk,
}

/// A piece to be taken from the head of the stream.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct StreamPiece {
    pub len: usize,
    pub kind: PieceKind,
    /// Index of the rule that found it.
    pub rule: usize,
}

/// Arrival and place of bytes in the capture.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct ChunkOrigin {
    pub time: Option<Timestamp>,
    pub offset: u64,
}

/// Bytes of one direction that were not yet given out, and when they came.
#[derive(Debug, Default)]
pub(crate) struct SerialFlow {
    bytes: Vec<u8>,
    head: usize,
    /// Start of each chunk in `bytes`, and its origin.
    origins: VecDeque<(usize, ChunkOrigin)>,
    last_time: Option<Timestamp>,
}

impl SerialFlow {
    pub(crate) fn pending(&self) -> &[u8] {
        &self.bytes[self.head..]
    }

    /// True when `chunk` comes after a silence and does not complete what waits.
    pub(crate) fn interrupts(
        &self,
        rules: &[Rule],
        direction: Option<Direction>,
        time: Option<Timestamp>,
        chunk: &[u8],
    ) -> bool {
        let (Some(last), Some(time)) = (self.last_time, time) else { return false };
        if self.pending().is_empty() || time.since(last) < SILENCE_NS {
            return false;
        }
        // A pause within a frame is possible on a busy computer: only bytes that give no frame together are
        // cut here.
        let joined = [self.pending(), chunk].concat();
        !matches!(cut_frame(rules, &joined, direction, false).0, FrameBoundary::Frame(_))
    }

    pub(crate) fn push(&mut self, origin: ChunkOrigin, chunk: &[u8]) {
        if self.head == self.bytes.len() {
            self.bytes.clear();
            self.origins.clear();
            self.head = 0;
        // Moved seldom, so that a long line costs no copy per frame.
        } else if self.head > PENDING_MAX {
            self.drop_consumed();
        }
        debug_assert!(self.head <= self.bytes.len());
        self.origins.push_back((self.bytes.len(), origin));
        self.bytes.extend_from_slice(chunk);
        self.last_time = origin.time;
    }

    /// Drops bytes that were given out, also when a rest always waits for its frame's end.
    fn drop_consumed(&mut self) {
        self.bytes.drain(..self.head);
        for (start, _) in &mut self.origins {
            *start = start.saturating_sub(self.head);
        }
        self.head = 0;
    }

    /// The next piece, if there are enough bytes to decide. Stray bytes in a row are one piece.
    pub(crate) fn next_piece(
        &self,
        rules: &[Rule],
        direction: Option<Direction>,
        ended: bool,
    ) -> Option<StreamPiece> {
        let pending = self.pending();
        let mut stray = 0;
        while stray < pending.len() {
            let rest = &pending[stray..];
            let (found, rule) = cut_frame(rules, rest, direction, ended);
            let (len, shape) = match found {
                FrameBoundary::Skip(len) => {
                    stray += len.clamp(1, rest.len());
                    continue;
                }
                FrameBoundary::Incomplete if !ended && rest.len() <= PENDING_MAX => break,
                FrameBoundary::Incomplete => (rest.len(), PieceKind::Junk),
                FrameBoundary::Frame(len) => (len.clamp(1, rest.len()), PieceKind::Frame),
                FrameBoundary::Corrupt(len) => (len.clamp(1, rest.len()), PieceKind::BadCheck),
            };
            // The stray bytes go out first and the frame with the next call: both keep their own times.
            if stray > 0 {
                break;
            }
            return Some(StreamPiece { len, kind: shape, rule });
        }
        (stray > 0).then_some(StreamPiece { len: stray, kind: PieceKind::Junk, rule: 0 })
    }

    /// Whence the byte at the head came.
    pub(crate) fn origin(&mut self) -> ChunkOrigin {
        while self.origins.get(1).is_some_and(|(start, _)| *start <= self.head) {
            self.origins.pop_front();
        }
        self.origins.front().map(|(_, origin)| *origin).unwrap_or_default()
    }

    /// Takes `len` bytes off the head.
    pub(crate) fn consume(&mut self, len: usize) -> &[u8] {
        let from = self.head;
        debug_assert!(len > 0, "a piece of no bytes would be found again for ever");
        self.head = (from + len).min(self.bytes.len());
        &self.bytes[from..self.head]
    }
}

fn cut_frame(
    rules: &[Rule],
    bytes: &[u8],
    direction: Option<Direction>,
    ended: bool,
) -> (FrameBoundary, usize) {
    match rules {
        [] => (FrameBoundary::Skip(bytes.len()), 0),
        [Rule { dissector, scope: RuleScope::Anywhere | RuleScope::Link(_) }] => {
            (dissector.find_frame(bytes, direction, ended), 0)
        }
        _ => cut_by_rules(rules, bytes, direction, ended),
    }
}

/// The first rule that finds a whole frame of an axis in its scope; otherwise one that waits for more.
fn cut_by_rules(
    rules: &[Rule],
    bytes: &[u8],
    direction: Option<Direction>,
    ended: bool,
) -> (FrameBoundary, usize) {
    let (mut more, mut broken, mut skip) = (None, None, None);
    for (at, rule) in rules.iter().enumerate() {
        match rule.dissector.find_frame(bytes, direction, ended) {
            FrameBoundary::Frame(len)
                if rule_holds(rule, &bytes[..len.min(bytes.len())], direction) =>
            {
                return (FrameBoundary::Frame(len), at);
            }
            FrameBoundary::Frame(_) => skip = skip.or(Some((1, at))),
            FrameBoundary::Incomplete => more = more.or(Some(at)),
            FrameBoundary::Corrupt(len) => broken = broken.or(Some((len, at))),
            FrameBoundary::Skip(len) => {
                skip = Some(skip.map_or((len, at), |(min, by)| (len.min(min), by)));
            }
        }
    }
    match (more, broken, skip) {
        (Some(at), ..) => (FrameBoundary::Incomplete, at),
        (None, Some((len, at)), _) => (FrameBoundary::Corrupt(len), at),
        (None, None, found) => {
            found.map_or((FrameBoundary::Skip(1), 0), |(len, at)| (FrameBoundary::Skip(len), at))
        }
    }
}

fn rule_holds(rule: &Rule, frame: &[u8], direction: Option<Direction>) -> bool {
    let RuleScope::Axis(axis) = rule.scope else { return true };
    let mut explained = Explanation::default();
    rule.dissector.explain(frame, &Context { direction, ..Context::default() }, &mut explained);
    explained.axis == Some(axis)
}

#[cfg(test)]
mod tests {
    use super::{ChunkOrigin, PENDING_MAX, SerialFlow};
    use crate::timestamp::Timestamp;

    #[test]
    fn a_stream_that_is_never_empty_takes_bounded_memory() {
        let mut flow = SerialFlow::default();
        let stamp = |n: u32| ChunkOrigin {
            time: Timestamp::parse(format!("{n}.5").as_bytes()),
            offset: n.into(),
        };
        flow.push(stamp(0), &[0; 40]);
        for n in 1..10_000u32 {
            flow.push(stamp(n), &[n as u8; 64]);
            assert_eq!(flow.origin(), stamp(n - 1), "piece {n}");
            let consumed = flow.consume(64);
            assert_eq!((consumed[0], consumed[63]), ((n - 1) as u8, n as u8), "piece {n}");
        }
        assert_eq!(flow.pending().len(), 40);
        assert!(flow.bytes.len() <= PENDING_MAX + 128, "{} bytes", flow.bytes.len());
        assert!(flow.origins.len() < 4, "{} marks", flow.origins.len());
    }
}
