//! What the session does when nothing comes: the boundary between frames is found again, and what
//! can do no harm is sent once more (TML communication manual, chapter 3).

use super::{
    ATTEMPTS_MAX, Fallback, LATEST_TIMEOUTS, Out, Pending, Phase, SYNCS_MAX, SYNCS_PROBING, Session,
};
use crate::error::Failure;
use crate::proto::tml::ask::{self, Answer};
use crate::proto::tml::rules::Wire;
use crate::proto::tml::serial::{self, FRAME_MAX, SYNC, is_sync, span};
use crate::proto::tml::wire::Message;
use crate::station::Class;
use crate::time::Instant;

impl Session {
    /// The time of what was waited for is over.
    pub(super) fn expire(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        match pending.phase {
            Phase::Ack(at) if now >= at => self.unacknowledged(now, &pending),
            Phase::Answer(at) if now >= at => self.unanswered(now, &pending),
            Phase::Sync(sent, at) if now >= at && sent >= self.syncs_max() => self.silent(now),
            Phase::Sync(sent, at) if now >= at => self.phase(Phase::SyncDue(sent)),
            Phase::Drain(at) if now >= at => self.recovered(now),
            _ => {}
        }
    }

    pub(super) fn synchronise(&mut self, now: Instant, sent: u8) -> Out {
        let byte = self.pending.map_or(SYNC, |p| harmless(&self.message(&p.ask, p.stage)));
        // A stop does not wait to be told that the drive listens again.
        let blind = self.place.wire == Wire::Rs485 || self.stop.is_some();
        let count = if blind { SYNCS_MAX - sent } else { 1 };
        let left = now.plus_ns(u64::from(count + 1) * self.waits.character_ns);
        let until = left.plus_ns(self.waits.pause_ns);
        self.phase(match self.stop {
            Some(_) => Phase::Drain(left),
            None if blind => Phase::Drain(until),
            None => Phase::Sync(sent + 1, until),
        });
        Out::Sync(byte, count)
    }

    /// The drive listens again: once more, if that can do no harm.
    pub(super) fn recovered(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        if self.stop.is_some() {
            self.give_way(now);
        } else if pending.ticket.is_none() {
            self.end(now, Err(Failure::Silent));
        } else if self.may_repeat(&pending) {
            self.phase(Phase::Ready(now));
        } else {
            self.silent(now);
        }
    }

    pub(super) fn unanswered(&mut self, now: Instant, pending: &Pending) {
        if self.stop.is_some() {
            return self.give_way(now);
        }
        if let Some(count) = self.gather.close() {
            // Nobody knows how many there are: silence is the end, not a failure, if some spoke.
            let result =
                if count == 0 { Err(Failure::Silent) } else { Ok(Answer::Gathered(count)) };
            self.counters.answered += u64::from(count > 0);
            self.pending = None;
            self.gather.end(result);
            return self.next(now);
        }
        if self.may_repeat(pending) {
            return self.phase(Phase::Ready(now));
        }
        if let Some(question) = self.question(pending) {
            let until = now.plus_ns(LATEST_TIMEOUTS * self.waits.answer_ns);
            let axis = pending.ask.message.to.id;
            self.doubts.add(axis, ask::tag(&question), until, self.knows(axis));
        }
        self.silent(now);
    }

    /// Only questions and stops are ever sent again.
    pub(super) fn may_repeat(&self, pending: &Pending) -> bool {
        let question = self.question(pending).is_some();
        let harmless = question || pending.ask.class == Class::Stop;
        let axis = pending.ask.message.to.id;
        let most = match (self.knows(axis), self.place.probing) {
            (true, _) => ATTEMPTS_MAX,
            (false, true) => 1,
            (false, false) => ATTEMPTS_MAX - 1,
        };
        let probe = pending.ticket.is_none();
        let most = if self.once == pending.ticket { 1 } else { most };
        harmless && !probe && pending.attempts < most
    }

    const fn syncs_max(&self) -> u8 {
        if self.place.probing { SYNCS_PROBING } else { SYNCS_MAX }
    }

    pub(super) fn silent(&mut self, now: Instant) {
        if self.fallback == Fallback::Armed
            && let Some(pending) = self.pending
            && self.question(&pending).is_some()
        {
            self.fallback = Fallback::Due;
            self.advance(now, pending.stage);
            return self.phase(Phase::Drain(Instant::FAR));
        }
        self.counters.silent += 1;
        self.end(now, Err(Failure::Silent));
    }
}

/// A SYNC byte that completes no piece of this message to a valid frame. A drive that lost a byte
/// of it takes SYNC bytes for the rest; one time in three hundred their sum would fit `0D`. "Larger
/// values are accepted too" (manual, chapter 3), so there is a choice.
fn harmless(message: &Message) -> u8 {
    let mut frame = [0; FRAME_MAX];
    let len = serial::encode(message, &mut frame);
    let frame = &frame[..len];
    let candidates = (SYNC..=u8::MAX).filter(|byte| is_sync(*byte) && *byte != serial::ACK);
    candidates.into_iter().find(|byte| !completes(frame, *byte)).unwrap_or(SYNC)
}

/// Whether some piece of a frame, cut short or with one byte lost, is a valid frame once followed by
/// this byte again and again.
fn completes(frame: &[u8], filler: u8) -> bool {
    let cut = (1..frame.len()).any(|end| is_completed(frame[..end].iter().copied(), filler));
    cut || (0..frame.len()).any(|lost| {
        let rest = frame.iter().enumerate().filter(|(at, _)| *at != lost);
        is_completed(rest.map(|(_, byte)| *byte), filler)
    })
}

fn is_completed(piece: impl Iterator<Item = u8> + Clone, filler: u8) -> bool {
    let mut bytes = piece.clone().chain(core::iter::repeat(filler));
    let Some(whole) = bytes.next().and_then(span) else { return false };
    let have = piece.clone().count();
    let body = piece.chain(core::iter::repeat(filler)).take(whole - 1);
    let sum = body.fold(0_u8, u8::wrapping_add);
    have < whole && sum == filler
}
