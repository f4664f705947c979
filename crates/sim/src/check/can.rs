//! What must hold of a host on a CAN bus.
//!
//! The CRC leaves no damage that a station could see, so a host that takes a reply for the answer to
//! something else broke I1. Two things excuse it, and both are counted: a stranger's frame, which
//! nothing tells from a drive's; and the second copy of a reply that a disturbed last bit makes,
//! where the protocol's replies neither carry a number nor repeat all that was asked. A copy that
//! came sooner than request and reply can pass the bus is no excuse: a host that knows the bit rate
//! can tell.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use polepair_core::station::Counters;
use polepair_core::time::Instant;

use super::Violation;
use crate::can_bus::bits::INTERFRAME;
use crate::can_bus::{Mark, Standing};
use crate::world::{NodeId, WireId, World};

/// Frames that are kept as unanswered.
const OPEN_MAX: usize = 64;
/// Answers that are kept as still to come, because something else was taken for them.
const OWED_MAX: usize = 16;
/// Such an answer comes within so long, or not at all, ms.
const OWED_MS: u32 = 1_000;

/// What was given up on was sent so long ago: no host waits less. What is newer is still to be
/// answered, ms; so is a stop that overtook it, or that a verb begins with.
const GIVEN_UP_MS: u32 = 10;

/// Watches one host on its bus.
#[derive(Debug)]
pub struct CanWatch {
    host: NodeId,
    wire: WireId,
    bit_rate: u32,
    counters: Counters,
    known: Standing,
    open: Vec<Asked>,
    /// What was passed over, since something newer was answered. The host may still wait for it.
    passed: Vec<Asked>,
    /// The identifier by which a drive, named by its place on the bus, was last asked.
    asked_by: BTreeMap<usize, (u32, bool)>,
    owed: Vec<Owed>,
    pub(crate) last_match: Match,
    /// Place on the bus of whoever sent it.
    pub(crate) last_from: usize,
    /// Copies that were taken for answers, and strangers' frames that were.
    pub(crate) copies_taken: u64,
    pub(crate) strange_taken: u64,
}

/// What the reply that was matched last was.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Match {
    #[default]
    Sound,
    /// A second copy, or the answer behind one.
    Copied,
    Strange,
    /// The world does not know what it answers.
    Unknown,
}

#[derive(Clone, Copy, Debug)]
struct Asked {
    mark: Mark,
    since: Instant,
}

/// An answer that is still to come, because something else was taken for it.
#[derive(Clone, Copy, Debug)]
struct Owed {
    /// Number of the request that it answers.
    tag: u32,
    until: Instant,
    /// A stranger's frame was, or may have been.
    strange: bool,
    /// More was open: it may have been taken for the answer to something else.
    several: bool,
}

impl CanWatch {
    /// A watch over `host` on `wire`, where frames take their bits at that rate.
    #[must_use]
    pub fn new(host: NodeId, wire: WireId, bit_rate: u32) -> Self {
        Self {
            host,
            wire,
            bit_rate,
            counters: Counters::default(),
            known: Standing::default(),
            open: Vec::with_capacity(OPEN_MAX),
            passed: Vec::new(),
            asked_by: BTreeMap::new(),
            owed: Vec::new(),
            last_match: Match::Sound,
            last_from: 0,
            copies_taken: 0,
            strange_taken: 0,
        }
    }

    /// To be called after every event that touched the host. `gave_up` are the drives of whose
    /// tickets one ended without an answer, with the time since when a verb of theirs is open: no
    /// reply to what was sent before that may be taken any more.
    pub fn after(
        &mut self,
        world: &mut World,
        gave_up: &[(NodeId, Option<Instant>)],
    ) -> Option<Violation> {
        let counters = world.look(self.host, |n, _| n.axes().map(|a| a.counters()))?;
        let before = std::mem::replace(&mut self.counters, counters);
        let known = world.standing(self.wire, self.host)?;
        let was = std::mem::replace(&mut self.known, known);
        let now = world.now();
        let heard = known.count > was.count;
        let answers = known.heard.answers.filter(|_| heard).map(|(tag, _)| tag);
        let behind = answers.and_then(|tag| self.is_owed(now, tag));
        let found = match counters.answered > before.answered && heard {
            true => self.matched(now, known.heard, behind),
            false => None,
        };
        for (drive, verb) in gave_up {
            let place = world.standing(self.wire, *drive).map(|drive| drive.plug);
            let id = place.and_then(|plug| self.asked_by.get(&plug)).copied();
            let newer = |asked: &Asked| {
                let of_verb = verb.is_some_and(|verb| asked.since >= verb);
                of_verb || now < asked.since.plus_ms(GIVEN_UP_MS)
            };
            self.open.retain(|asked| Some(asked.mark.id) != id || newer(asked));
        }
        self.sent(&was, &known);
        found
    }

    fn sent(&mut self, was: &Standing, known: &Standing) {
        if known.sent.tag != was.sent.tag {
            let old = (self.open.len() + 1).saturating_sub(OPEN_MAX);
            self.open.drain(..old);
            self.open.push(Asked { mark: known.sent, since: known.since });
        }
    }

    /// Judges a reply that was taken for an answer.
    fn matched(&mut self, now: Instant, reply: Mark, behind: Option<Owed>) -> Option<Violation> {
        self.last_from = reply.from;
        if reply.strange {
            return self.believed(now);
        }
        if reply.unsure {
            self.last_match = Match::Unknown;
            // It may answer what is older, and then the answer itself is still to come.
            if let Some(asked) = self.last_asked(&reply) {
                self.open.retain(|other| other.mark.tag != asked.mark.tag);
                self.owe(now, asked, false);
            }
            return None;
        }
        self.last_match = Match::Sound;
        let (tag, question) = reply.answers?;
        if behind.is_some_and(|owed| owed.strange)
            && let Some(asked) = self.last_asked(&reply).filter(|asked| asked.mark.tag != tag)
        {
            self.copied(now, asked);
            return None;
        }
        let exact = self.open.iter().position(|asked| asked.mark.tag == tag);
        let same = || self.open.iter().rposition(|asked| asked.mark.content == question);
        let Some(at) = exact.or_else(same) else {
            return self.mismatched(now, reply, (tag, question), behind);
        };
        let asked = self.open[at];
        self.asked_by.insert(reply.from, asked.mark.id);
        if (reply.copy || behind.is_some()) && asked.mark.tag != tag {
            // It says what is asked; but it was said before it was asked, and before the answers
            // to what is older.
            self.copied(now, asked);
            return None;
        }
        if exact.is_none() {
            // An answer to the same that was asked before: what else is open is still to be answered.
            self.open.remove(at);
            return None;
        }
        self.pass(now, at);
        None
    }

    /// The request at `at` was answered: what is older and went to the same drive is passed over.
    fn pass(&mut self, now: Instant, at: usize) {
        let asked = self.open[at];
        self.passed.retain(|old| now < old.since.plus_ms(OWED_MS));
        let mut place = 0;
        self.open.retain(|other| {
            place += 1;
            if place > at + 1 || other.mark.id != asked.mark.id {
                return true;
            }
            if place <= at {
                self.passed.push(*other);
            }
            false
        });
    }

    /// The reply answers nothing that is open.
    fn mismatched(
        &mut self,
        now: Instant,
        reply: Mark,
        (tag, question): (u32, u64),
        behind: Option<Owed>,
    ) -> Option<Violation> {
        let soonest = |asked: &Asked| {
            let bits = u64::from(asked.mark.bits + reply.bits - INTERFRAME);
            let ns = (bits * 1_000_000_000).checked_div(self.bit_rate.into()).unwrap_or(0);
            asked.since.plus_ns(ns - ns / 20)
        };
        let asked = self.last_asked(&reply);
        if let Some(asked) = asked.filter(|a| (reply.copy || behind.is_some()) && now >= soonest(a))
        {
            self.copied(now, asked);
            return None;
        }
        if behind.is_some_and(|owed| owed.several) && !reply.copy {
            // The copy before was not taken for the answer to this, but to something older.
            return None;
        }
        let same = |old: &Asked| old.mark.content == question && old.mark.tag != tag;
        if let Some(older) = self.passed.iter().position(same).filter(|_| reply.copy) {
            // The first was taken for the answer to the same that was asked before, which was passed
            // over; so this is taken for the answer to what it answers.
            let asked = self.passed.remove(older);
            self.copied(now, asked);
            return None;
        }
        let copy = if reply.copy { "a copy of " } else { "" };
        let asked = asked.map_or(0, |asked| asked.mark.tag);
        let what = format!("request {asked} got {copy}the reply to request {tag}");
        Some(Violation { invariant: "I1", at: now, what })
    }

    /// What the sender of a reply was asked last.
    fn last_asked(&self, reply: &Mark) -> Option<Asked> {
        let id = self.asked_by.get(&reply.from)?;
        self.open.iter().rfind(|asked| asked.mark.id == *id).copied()
    }

    /// Something else was taken for the answer to that: the answer itself is still to come.
    fn copied(&mut self, now: Instant, asked: Asked) {
        self.last_match = Match::Copied;
        self.copies_taken += 1;
        self.open.retain(|other| other.mark.tag != asked.mark.tag);
        self.owe(now, asked, false);
    }

    fn believed(&mut self, now: Instant) -> Option<Violation> {
        self.last_match = Match::Strange;
        self.strange_taken += 1;
        self.put_off(now);
        None
    }

    /// Whatever is open may have been answered by a stranger.
    fn put_off(&mut self, now: Instant) {
        for at in self.open.len().saturating_sub(OWED_MAX)..self.open.len() {
            self.owe(now, self.open[at], true);
        }
    }

    fn owe(&mut self, now: Instant, asked: Asked, strange: bool) {
        let Mark { tag, id, .. } = asked.mark;
        let several = self.open.iter().any(|other| other.mark.id == id && other.mark.tag != tag);
        self.owed.push(Owed { tag, until: now.plus_ms(OWED_MS), strange, several });
        let old = self.owed.len().saturating_sub(OWED_MAX);
        self.owed.drain(..old);
    }

    /// What was to come, if a reply to that request came, and something else had been taken for it.
    /// Several may come: each copy of the request brings one, and the host may take any of them for
    /// the answer to what it asks then.
    fn is_owed(&mut self, now: Instant, tag: u32) -> Option<Owed> {
        self.owed.retain(|owed| now < owed.until);
        self.owed.iter().find(|owed| owed.tag == tag).copied()
    }
}
