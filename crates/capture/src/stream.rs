//! Frames out of a serial stream: one direction of one link.

use std::collections::VecDeque;

use polepair_core::explain::{Context, Cut, Direction};

use crate::explained::Explained;
use crate::rules::{Rule, Scope};
use crate::stamp::Stamp;

/// Bytes that may wait for the rest of their frame; more than that are no frame.
const PENDING_MAX: usize = 4096;
/// After so long without a byte nothing more is expected to belong to what came before.
const SILENCE_NS: u64 = 20_000_000;

/// What stands at the head of the stream.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Shape {
    /// A whole frame.
    Frame,
    /// A frame whose check fails.
    Broken,
    /// Bytes of no frame.
    Junk,
}

/// A piece to be taken from the head of the stream.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Piece {
    pub len: usize,
    pub shape: Shape,
    /// Which rule found it.
    pub rule: usize,
}

/// When bytes came, and where in the capture they stand.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Origin {
    pub time: Option<Stamp>,
    pub at: u64,
}

/// Bytes of one direction that were not yet given out, and when they came.
#[derive(Debug, Default)]
pub(crate) struct Flow {
    bytes: Vec<u8>,
    head: usize,
    /// Where in `bytes` each chunk begins, and whence it came.
    marks: VecDeque<(usize, Origin)>,
    last: Option<Stamp>,
}

impl Flow {
    pub(crate) fn pending(&self) -> &[u8] {
        &self.bytes[self.head..]
    }

    /// True when `chunk` comes after a silence and does not complete what waits.
    pub(crate) fn breaks_off(
        &self,
        rules: &[Rule],
        direction: Option<Direction>,
        time: Option<Stamp>,
        chunk: &[u8],
    ) -> bool {
        let (Some(last), Some(time)) = (self.last, time) else { return false };
        if self.pending().is_empty() || time.since(last) < SILENCE_NS {
            return false;
        }
        let joined = [self.pending(), chunk].concat();
        !matches!(cut(rules, &joined, direction, false).0, Cut::Frame(_))
    }

    pub(crate) fn push(&mut self, origin: Origin, chunk: &[u8]) {
        if self.head == self.bytes.len() {
            self.bytes.clear();
            self.marks.clear();
            self.head = 0;
        } else if self.head > PENDING_MAX {
            self.forget();
        }
        self.marks.push_back((self.bytes.len(), origin));
        self.bytes.extend_from_slice(chunk);
        self.last = origin.time;
    }

    /// Lets go of what was given out, also when a rest always waits for its frame's end.
    fn forget(&mut self) {
        self.bytes.drain(..self.head);
        for (start, _) in &mut self.marks {
            *start = start.saturating_sub(self.head);
        }
        self.head = 0;
    }

    /// The next piece, if enough is there to tell. Stray bytes in a row are one piece.
    pub(crate) fn next(
        &self,
        rules: &[Rule],
        direction: Option<Direction>,
        ended: bool,
    ) -> Option<Piece> {
        let pending = self.pending();
        let mut stray = 0;
        while stray < pending.len() {
            let rest = &pending[stray..];
            let (found, rule) = cut(rules, rest, direction, ended);
            let (len, shape) = match found {
                Cut::Skip(len) => {
                    stray += len.clamp(1, rest.len());
                    continue;
                }
                Cut::More if !ended && rest.len() <= PENDING_MAX => break,
                Cut::More => (rest.len(), Shape::Junk),
                Cut::Frame(len) => (len.clamp(1, rest.len()), Shape::Frame),
                Cut::Broken(len) => (len.clamp(1, rest.len()), Shape::Broken),
            };
            if stray > 0 {
                break;
            }
            return Some(Piece { len, shape, rule });
        }
        (stray > 0).then_some(Piece { len: stray, shape: Shape::Junk, rule: 0 })
    }

    /// Whence the byte at the head came.
    pub(crate) fn origin(&mut self) -> Origin {
        while self.marks.get(1).is_some_and(|(start, _)| *start <= self.head) {
            self.marks.pop_front();
        }
        self.marks.front().map(|(_, origin)| *origin).unwrap_or_default()
    }

    /// Takes `len` bytes off the head.
    pub(crate) fn take(&mut self, len: usize) -> &[u8] {
        let from = self.head;
        self.head = (from + len).min(self.bytes.len());
        &self.bytes[from..self.head]
    }
}

fn cut(rules: &[Rule], bytes: &[u8], direction: Option<Direction>, ended: bool) -> (Cut, usize) {
    match rules {
        [] => (Cut::Skip(bytes.len()), 0),
        [Rule { dissector, scope: Scope::Anywhere | Scope::Link(_) }] => {
            (dissector.cut(bytes, direction, ended), 0)
        }
        _ => cut_by_any(rules, bytes, direction, ended),
    }
}

/// The first rule that finds a whole frame of an axis it holds for; else whoever waits for more.
fn cut_by_any(
    rules: &[Rule],
    bytes: &[u8],
    direction: Option<Direction>,
    ended: bool,
) -> (Cut, usize) {
    let (mut more, mut broken, mut skip) = (None, None, None);
    for (at, rule) in rules.iter().enumerate() {
        match rule.dissector.cut(bytes, direction, ended) {
            Cut::Frame(len) if holds(rule, &bytes[..len.min(bytes.len())], direction) => {
                return (Cut::Frame(len), at);
            }
            Cut::Frame(_) => skip = skip.or(Some((1, at))),
            Cut::More => more = more.or(Some(at)),
            Cut::Broken(len) => broken = broken.or(Some((len, at))),
            Cut::Skip(len) => {
                skip = Some(skip.map_or((len, at), |(least, by)| (len.min(least), by)));
            }
        }
    }
    match (more, broken, skip) {
        (Some(at), ..) => (Cut::More, at),
        (None, Some((len, at)), _) => (Cut::Broken(len), at),
        (None, None, found) => found.map_or((Cut::Skip(1), 0), |(len, at)| (Cut::Skip(len), at)),
    }
}

fn holds(rule: &Rule, frame: &[u8], direction: Option<Direction>) -> bool {
    let Scope::Axis(axis) = rule.scope else { return true };
    let mut explained = Explained::default();
    rule.dissector.explain(frame, &Context { direction, ..Context::default() }, &mut explained);
    explained.axis == Some(axis)
}

#[cfg(test)]
mod tests {
    use super::{Flow, Origin, PENDING_MAX};
    use crate::stamp::Stamp;

    #[test]
    fn a_stream_that_is_never_empty_takes_bounded_memory() {
        let mut flow = Flow::default();
        let stamp =
            |n: u32| Origin { time: Stamp::parse(format!("{n}.5").as_bytes()), at: n.into() };
        flow.push(stamp(0), &[0; 40]);
        for n in 1..10_000u32 {
            flow.push(stamp(n), &[n as u8; 64]);
            assert_eq!(flow.origin(), stamp(n - 1), "piece {n}");
            let taken = flow.take(64);
            assert_eq!((taken[0], taken[63]), ((n - 1) as u8, n as u8), "piece {n}");
        }
        assert_eq!(flow.pending().len(), 40);
        assert!(flow.bytes.len() <= PENDING_MAX + 128, "{} bytes", flow.bytes.len());
        assert!(flow.marks.len() < 4, "{} marks", flow.marks.len());
    }
}
