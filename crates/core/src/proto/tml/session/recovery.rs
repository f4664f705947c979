//! Recovery after a missing reply: finds the boundary between frames again, and repeats harmless requests
//! (TML communication manual, chapter 3).

use super::{
    ATTEMPTS_MAX, BaudFallback, LATEST_TIMEOUTS, Outgoing, PendingExchange, RequestPhase,
    SYNCS_MAX, SYNCS_SCANNING, Session,
};
use crate::error::Failure;
use crate::proto::tml::host_request::{self, Answer};
use crate::proto::tml::rules::TmlWire;
use crate::proto::tml::serial::{self, FRAME_MAX, SYNC, frame_len, is_sync};
use crate::proto::tml::wire::Message;
use crate::station::RequestClass;
use crate::time::Instant;

impl Session {
    /// Handles the end of the present wait.
    pub(super) fn expire_phase(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        match pending.phase {
            RequestPhase::AwaitAck(at) if now >= at => self.handle_ack_timeout(now, &pending),
            RequestPhase::AwaitAnswer(at) if now >= at => self.handle_answer_timeout(now, &pending),
            // Fifteen bytes complete any frame that a drive may be in (communication manual, chapter 3).
            RequestPhase::AwaitSync(sent, at) if now >= at && sent >= self.syncs_max() => {
                self.finish_silent(now)
            }
            RequestPhase::AwaitSync(sent, at) if now >= at => {
                self.set_phase(RequestPhase::SendSync(sent))
            }
            RequestPhase::Drain(at) if now >= at => self.resume_after_recovery(now),
            _ => {}
        }
    }

    pub(super) fn next_sync(&mut self, now: Instant, sent: u8) -> Outgoing {
        let byte = self
            .pending
            .map_or(SYNC, |p| safe_sync_byte(&self.stage_message(&p.host_request, p.stage)));
        // A stop does not wait for a sign that the drive receives again.
        let blind = self.topology.wire == TmlWire::Rs485 || self.pending_stop.is_some();
        debug_assert!(sent < SYNCS_MAX, "SYNC bytes are counted");
        let count = if blind { SYNCS_MAX - sent } else { 1 };
        let left = now.plus_ns(u64::from(count + 1) * self.timeouts.character_ns);
        let until = left.plus_ns(self.timeouts.sync_pause_ns);
        self.set_phase(match self.pending_stop {
            // Only until the bytes have left: nothing is waited for.
            Some(_) => RequestPhase::Drain(left),
            None if blind => RequestPhase::Drain(until),
            None => RequestPhase::AwaitSync(sent + 1, until),
        });
        Outgoing::Sync(byte, count)
    }

    /// The drive listens again: once more, if that can do no harm.
    pub(super) fn resume_after_recovery(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        if self.pending_stop.is_some() {
            self.start_pending_stop(now);
        } else if pending.ticket.is_none() {
            self.finish_pending(now, Err(Failure::Silent));
        } else if self.may_repeat(&pending) {
            self.set_phase(RequestPhase::Ready(now));
        } else {
            self.finish_silent(now);
        }
    }

    pub(super) fn handle_answer_timeout(&mut self, now: Instant, pending: &PendingExchange) {
        if self.pending_stop.is_some() {
            return self.start_pending_stop(now);
        }
        if let Some(count) = self.group_answers.close() {
            // The number of drives is unknown: silence is the end, not a failure, if some replied.
            let result =
                if count == 0 { Err(Failure::Silent) } else { Ok(Answer::GroupAnswered(count)) };
            self.counters.answered += u64::from(count > 0);
            self.pending = None;
            self.group_answers.finish(result);
            return self.start_next(now);
        }
        if self.may_repeat(pending) {
            return self.set_phase(RequestPhase::Ready(now));
        }
        if let Some(question) = self.query_of(pending) {
            let until = now.plus_ns(LATEST_TIMEOUTS * self.timeouts.answer_ns);
            let axis = pending.host_request.message.to.id;
            self.stale_replies.add_answer(
                axis,
                host_request::answer_tag(&question),
                until,
                self.has_answered(axis),
            );
        }
        // The acknowledgement came, so the line's rate is right.
        self.end_silent(now);
    }

    /// Only questions and stops are ever sent again.
    pub(super) fn may_repeat(&self, pending: &PendingExchange) -> bool {
        let question = self.query_of(pending).is_some();
        let harmless = question || pending.host_request.class == RequestClass::Stop;
        let axis = pending.host_request.message.to.id;
        let max = match (self.has_answered(axis), self.topology.scanning) {
            // A drive that answered before is there; one that never did is asked less, or a scan takes minutes
            // (TML-5).
            (true, _) => ATTEMPTS_MAX,
            (false, true) => 1,
            (false, false) => ATTEMPTS_MAX - 1,
        };
        let probe = pending.ticket.is_none();
        let max = if self.no_retry_ticket == pending.ticket { 1 } else { max };
        harmless && !probe && pending.attempts < max
    }

    const fn syncs_max(&self) -> u8 {
        if self.topology.scanning { SYNCS_SCANNING } else { SYNCS_MAX }
    }

    pub(super) fn finish_silent(&mut self, now: Instant) {
        if self.fallback == BaudFallback::Armed
            && let Some(pending) = self.pending
            && self.query_of(&pending).is_some()
        {
            debug_assert!(self.pending.is_some(), "the question is asked again at the other rate");
            self.fallback = BaudFallback::Requested;
            self.enter_stage(now, pending.stage);
            return self.set_phase(RequestPhase::Drain(Instant::FAR_FUTURE));
        }
        self.end_silent(now);
    }

    fn end_silent(&mut self, now: Instant) {
        self.counters.silent += 1;
        self.finish_pending(now, Err(Failure::Silent));
    }
}

/// A SYNC byte that completes no piece of this message to a valid frame. A drive that lost a byte
/// of it takes SYNC bytes for the rest; one time in three hundred their sum would fit `0D`. "Larger
/// values are accepted too" (manual, chapter 3), so there is a choice.
fn safe_sync_byte(message: &Message) -> u8 {
    let mut frame = [0; FRAME_MAX];
    let len = serial::encode(message, &mut frame);
    let frame = &frame[..len];
    // "Larger values are accepted too" (communication manual, chapter 3). 4Fh would look like an
    // acknowledgement.
    let candidates = (SYNC..=u8::MAX).filter(|byte| is_sync(*byte) && *byte != serial::ACK);
    candidates.into_iter().find(|byte| !completes_frame(frame, *byte)).unwrap_or(SYNC)
}

/// Returns whether some piece of a frame, cut short or with one byte lost, is a valid frame once this byte follows it
/// repeatedly.
fn completes_frame(frame: &[u8], filler: u8) -> bool {
    let cut = (1..frame.len()).any(|end| is_completed(frame[..end].iter().copied(), filler));
    cut || (0..frame.len()).any(|lost| {
        let rest = frame.iter().enumerate().filter(|(at, _)| *at != lost);
        is_completed(rest.map(|(_, byte)| *byte), filler)
    })
}

fn is_completed(piece: impl Iterator<Item = u8> + Clone, filler: u8) -> bool {
    let mut bytes = piece.clone().chain(core::iter::repeat(filler));
    let Some(whole) = bytes.next().and_then(frame_len) else { return false };
    let have = piece.clone().count();
    let body = piece.chain(core::iter::repeat(filler)).take(whole - 1);
    let sum = body.fold(0_u8, u8::wrapping_add);
    have < whole && sum == filler
}
