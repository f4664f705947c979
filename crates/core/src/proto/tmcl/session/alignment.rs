//! Silent modules that may have lost count of bytes.
//!
//! Some modules count to nine and ignore pauses: after a byte too many or too few they accept no request. A
//! single byte between two requests moves their count by one, so they are in step after nine at most. Other
//! modules drop incomplete datagrams after a pause, and such a byte spoils the next request; so every
//! fourth request has none. A late module must not get this byte, so it waits until the latest possible
//! reply is overdue. The other modules of the line count the byte too: while one of them replies, a silent
//! module is probably gone, and no byte is sent.

use super::proof::PROBES;
use super::{Opcode, PendingExchange, RECENT_MAX, Request, SUSPECTS_MAX, Session};
use crate::proto::tmcl::wire::{DATAGRAM, checksum};
use crate::station::RequestClass;
use crate::time::Instant;

/// Timeouts after the first request that was not answered, before bytes are put between requests.
const FILLER_TIMEOUTS: u64 = 2;
/// Requests that were not answered, before that.
const UNANSWERED_MIN: u8 = 2;
/// Number of unanswered requests that must be exceeded if all were stops: a stop that is sent for every byte position
/// reaches a module at any position, so that no reply to one proves little. A motor may be silent, and its module
/// replies for another.
// A block with a stop reaches a module whatever it has counted, so that a lost stop shows little
// (TMCL-4).
const UNANSWERED_STOPS_MIN: u8 = 6;

/// Length of the cycle of attempts: to a module that is searched for, one of them goes without a filler byte; to a
/// silent one, one goes for every position and one without a filler byte.
// In step, by a block, at the next place: a module of either kind takes one of three.
const ATTEMPT_CYCLE: u8 = 3;

/// Places of a module's count.
const OFFSETS: u8 = DATAGRAM as u8;

/// A module that has sent nothing since requests to it were not answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct SilentModule {
    module: u8,
    since: Instant,
    unanswered: u8,
    /// Filler bytes between requests to it, before any module had replied.
    fillers: u8,
    /// Something else than a stop was not answered.
    missed_non_stop: bool,
    attempt: u8,
    /// Byte position of the last attempt, during silence.
    last_offset: u8,
    /// True if it replied to a burst for every position: it exists, and receives the host's bytes.
    answered_burst: bool,
    /// True if that was just now.
    just_answered_burst: bool,
    /// Places that were tried since it was found.
    offsets_tried: u8,
}

impl SilentModule {
    const fn new(module: u8, since: Instant) -> Self {
        let (missed_non_stop, answered_burst, just_answered_burst) = (false, false, false);
        let (unanswered, fillers, attempt, last_offset, offsets_tried) = (0, 0, 0, 0, 0);
        Self {
            module,
            since,
            unanswered,
            fillers,
            missed_non_stop,
            attempt,
            last_offset,
            answered_burst,
            just_answered_burst,
            offsets_tried,
        }
    }

    const fn next_attempt(&mut self) -> u8 {
        let turn = self.attempt;
        self.attempt = (turn + 1) % (2 * ATTEMPT_CYCLE);
        turn
    }

    /// Next byte position to try during silence.
    const fn next_search_offset(&mut self) -> u8 {
        self.last_offset = self.last_offset % (OFFSETS - 1) + 1;
        debug_assert!(
            self.last_offset >= 1 && self.last_offset < OFFSETS,
            "0 is the place of a block"
        );
        self.last_offset
    }

    /// The next place to try where it was found. It is there that a byte was lost with what went before,
    /// if the wire came back between two requests.
    const fn next_found_offset(&mut self) -> u8 {
        // Its own place goes without a byte, as it is.
        self.offsets_tried += if self.offsets_tried == self.last_offset { 2 } else { 1 };
        (self.last_offset + 1 + OFFSETS - self.offsets_tried) % OFFSETS
    }
}

/// A request that is sent once for every byte position of a module.
#[derive(Clone, Copy, Debug)]
pub(in crate::proto::tmcl) struct Burst {
    /// Bytes before it. They undo the bytes that were put between the requests before.
    pub lead_bytes: u8,
    /// Bytes after it, so that the next single request is tried at another byte position.
    pub trail_bytes: u8,
}

/// Form in which a request is sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct SendPlan {
    /// Bytes that go out alone before it.
    filler_bytes: u8,
    burst: Option<Burst>,
}

impl SendPlan {
    const PLAIN: Self = Self { filler_bytes: 0, burst: None };

    /// At another place, from the present one.
    const fn at_offset(index: u8, from: u8) -> Self {
        Self { filler_bytes: (OFFSETS + index - from) % OFFSETS, burst: None }
    }
}

/// Byte position of the modules on the line.
#[derive(Clone, Copy, Debug)]
pub(super) struct ByteAlignment {
    /// They know no frame but by counting bytes: on serial lines.
    counts_bytes: bool,
    /// Bytes beyond whole datagrams that were sent since the last reply.
    offset: u8,
    /// True if the last request was a burst for every position.
    last_was_burst: bool,
    /// Time at which its answer was due.
    answer_due: Instant,
}

impl ByteAlignment {
    pub(super) const NONE: Self =
        Self { counts_bytes: false, offset: 0, last_was_burst: false, answer_due: Instant::ZERO };

    const fn advance(&mut self, bytes: u8) {
        self.offset = (self.offset + bytes) % OFFSETS;
    }

    pub(super) fn note_sent(&mut self, burst: Option<Burst>, due: Instant) {
        self.last_was_burst = burst.is_some();
        self.answer_due = due;
        self.advance(burst.map_or(0, |burst| burst.lead_bytes + burst.trail_bytes));
    }
}

impl Session {
    /// For modules that know no frame but by counting bytes.
    pub(in crate::proto::tmcl) fn with_byte_counting(mut self) -> Self {
        self.alignment.counts_bytes = true;
        self
    }

    /// Notes that a request was not answered.
    pub(super) fn note_unanswered(&mut self, now: Instant, pending: &PendingExchange) {
        let module = pending.host_request.request.address;
        let same = |quiet: &Option<SilentModule>| quiet.is_some_and(|quiet| quiet.module == module);
        // Full tables give up their last place: the module that fell silent now matters more than one long
        // gone.
        let index =
            self.silent_modules.iter().position(same).or_else(|| free_slot(&self.silent_modules));
        let quiet = &mut self.silent_modules[index.unwrap_or(SUSPECTS_MAX - 1)];
        if !same(quiet) {
            *quiet = Some(SilentModule::new(module, now));
        }
        if let Some(quiet) = quiet {
            // A search that is under way keeps its start: the pause counts from the first silence.
            if quiet.unanswered == 0 && quiet.offsets_tried == 0 {
                quiet.since = now;
            }
            quiet.unanswered = quiet.unanswered.checked_add(1).unwrap_or(u8::MAX - 1);
            quiet.missed_non_stop |= !is_stop(pending);
            // It is gone again.
            quiet.answered_burst &= pending.burst.is_none();
        }
        self.unanswered_modules.insert(module);
        self.suspicious = true;
    }

    /// Records a frame of a module: its byte position agrees with this host's, unless it replied to a burst.
    pub(super) fn note_received(&mut self, module: u8) {
        // Any nine of a block's bytes may have been the request, so its answer shows no place of the count.
        let newest = self.next_recent.wrapping_sub(1) % RECENT_MAX;
        if self.alignment.last_was_burst
            && self.recent[newest].0 == module
            && let Some(quiet) = self.silent_module_mut(module)
        {
            (quiet.unanswered, quiet.missed_non_stop) = (0, false);
            if !quiet.answered_burst {
                (quiet.attempt, quiet.offsets_tried) = (1, 0);
            }
            (quiet.answered_burst, quiet.just_answered_burst) = (true, true);
            return;
        }
        for silent_module in &mut self.silent_modules {
            if silent_module.is_some_and(|quiet| quiet.module == module) {
                *silent_module = None;
            }
        }
        self.alignment.offset = 0;
        self.unanswered_modules.remove(module);
        self.update_suspicious();
    }

    fn silent_module_mut(&mut self, module: u8) -> Option<&mut SilentModule> {
        self.silent_modules.iter_mut().flatten().find(|quiet| quiet.module == module)
    }

    fn silent_module(&self, module: u8) -> Option<&SilentModule> {
        self.silent_modules.iter().flatten().find(|quiet| quiet.module == module)
    }

    /// Bytes that are to go before the request that is sent next: that goes to a module that may have
    /// lost count of bytes, and is no stop, which waits for no byte. They count as sent.
    pub(in crate::proto::tmcl) fn take_filler_bytes(&mut self, now: Instant) -> u8 {
        if !self.suspicious {
            return 0;
        }
        let Some(pending) = self.pending.filter(|pending| !pending.sent) else { return 0 };
        let mut plan = pending.send_plan.unwrap_or_else(|| self.plan_send(now, &pending));
        debug_assert!(plan.filler_bytes < OFFSETS, "more bytes than a datagram change nothing");
        let shift = core::mem::take(&mut plan.filler_bytes);
        self.alignment.advance(shift);
        if let Some(pending) = &mut self.pending {
            pending.send_plan = Some(plan);
        }
        shift
    }

    /// Returns whether a module is there, and not every place of its count was tried yet.
    pub(super) fn is_searching_offset(&self, module: u8) -> bool {
        self.silent_module(module)
            .is_some_and(|quiet| quiet.answered_burst && quiet.offsets_tried < OFFSETS)
    }

    /// Burst of the next request, if it is sent for every byte position.
    pub(in crate::proto::tmcl) fn burst(&self) -> Option<Burst> {
        self.pending.filter(|pending| !pending.sent)?.send_plan?.burst
    }

    /// Plans the sending of a request.
    fn plan_send(&mut self, now: Instant, pending: &PendingExchange) -> SendPlan {
        let module = pending.host_request.request.address;
        let lost = self.is_misaligned(now, module);
        let shiftable = !self.has_answered(module) && self.may_start_misaligned(module);
        let ByteAlignment { offset, answer_due, .. } = self.alignment;
        // A module that resets its alignment in a pause is aligned after one.
        let paused = now >= answer_due.plus_ns(self.timeout_ns / 2);
        let Some(quiet) = self.silent_module_mut(module) else { return SendPlan::PLAIN };
        let back = if quiet.answered_burst { 0 } else { (OFFSETS - offset) % OFFSETS };
        if is_stop(pending) {
            // On two wires its answer meets the bytes that are still being sent: every second goes alone.
            let alone = quiet.unanswered.is_multiple_of(2);
            let elsewhere =
                !alone && lost && !quiet.answered_burst && quiet.next_attempt() % 2 == 1;
            return match (alone, elsewhere) {
                (true, _) => SendPlan::PLAIN,
                (_, true) => burst_plan(quiet.next_search_offset(), back),
                _ => burst_plan(0, back),
            };
        }
        if core::mem::take(&mut quiet.just_answered_burst) {
            // It is most likely in step.
            return if quiet.offsets_tried == 0 {
                SendPlan::at_offset(0, offset)
            } else {
                SendPlan::PLAIN
            };
        }
        if !lost {
            return SendPlan::PLAIN;
        }
        let repeats = is_safe_to_burst(pending);
        if quiet.answered_burst && quiet.offsets_tried < OFFSETS {
            return match quiet.next_attempt() % ATTEMPT_CYCLE {
                _ if paused => SendPlan::PLAIN,
                0 => SendPlan::PLAIN,
                _ => SendPlan::at_offset(quiet.next_found_offset(), offset),
            };
        }
        quiet.answered_burst = false;
        if shiftable {
            quiet.fillers += 1;
            return SendPlan { filler_bytes: 1, burst: None };
        }
        if paused && quiet.attempt > 0 {
            return SendPlan::PLAIN;
        }
        match quiet.next_attempt() % ATTEMPT_CYCLE {
            0 if repeats => burst_plan(0, back),
            2 => SendPlan::at_offset(quiet.next_search_offset(), offset),
            _ => SendPlan::at_offset(0, offset),
        }
    }

    /// Returns whether a module that never replied may still have lost its byte position: a killed program may have
    /// left the modules of the line in the middle of a datagram. Without any reply, a byte goes before each of nine
    /// requests, so that a module that was aligned is aligned again at the end.
    pub(super) fn may_start_misaligned(&self, module: u8) -> bool {
        // Nine bytes have tried every place. After that, silence has another cause than a count.
        let shifts = self.silent_module(module).map_or(0, |quiet| quiet.fillers);
        self.alignment.counts_bytes && self.answered_modules.is_empty() && shifts < OFFSETS
    }

    /// Returns whether a module replied to its last request.
    fn is_aligned(&self, module: u8) -> bool {
        self.has_answered(module) && !self.unanswered_modules.contains(module)
    }

    /// Returns whether a module may have lost its byte position, by the requests without reply so far.
    fn is_misaligned(&self, now: Instant, module: u8) -> bool {
        // Others hear the byte too: it is for none that was never there, and puts out of step who counts.
        let worth = self.has_answered(module) || self.answered_modules.is_empty();
        // All modules of a line count a byte, also those that were in step.
        let alone = !self.recent.iter().any(|(to, ..)| *to != module && self.is_aligned(*to));
        let quiet = self.silent_module(module).filter(|_| worth && alone);
        quiet.is_some_and(|quiet| {
            let past = now >= quiet.since.plus_ns(FILLER_TIMEOUTS * self.timeout_ns);
            let min = if !quiet.missed_non_stop {
                UNANSWERED_STOPS_MIN
            } else if quiet.offsets_tried > 0 {
                1
            } else {
                UNANSWERED_MIN
            };
            past && quiet.unanswered >= min
        })
    }
}

fn burst_plan(trail: u8, back: u8) -> SendPlan {
    SendPlan { filler_bytes: 0, burst: Some(Burst { lead_bytes: back, trail_bytes: trail }) }
}

fn free_slot(slots: &[Option<SilentModule>]) -> Option<usize> {
    slots.iter().position(Option::is_none)
}

fn is_stop(pending: &PendingExchange) -> bool {
    pending.host_request.class == RequestClass::Stop
        && pending.host_request.request.opcode == Opcode::Mst
        && !pending.is_stored
}

/// Returns whether a read may be sent at every byte position: no other piece of these bytes may be a request.
fn is_safe_to_burst(pending: &PendingExchange) -> bool {
    let Request { opcode, kind, .. } = pending.host_request.request;
    let known = PROBES.iter().any(|(probe, _)| *probe == opcode);
    if !known
        || (opcode, kind) == (Opcode::Version, 0)
        || pending.host_request.class != RequestClass::Idempotent
        || pending.is_stored
    {
        return false;
    }
    // Two in a row, with and without the zero between them: no nine bytes across the seam may be a
    // request.
    let datagram = pending.host_request.request.emit();
    let mut bytes = [0; 2 * DATAGRAM + 1];
    bytes[..DATAGRAM].copy_from_slice(&datagram);
    let last = has_no_shifted_request(&bytes);
    bytes[DATAGRAM + 1..].copy_from_slice(&datagram);
    last && has_no_shifted_request(&bytes)
}

/// Returns whether the bytes after the first datagram contain no request at any position.
fn has_no_shifted_request(bytes: &[u8; 2 * DATAGRAM + 1]) -> bool {
    !bytes.windows(DATAGRAM).skip(1).take(DATAGRAM).any(is_request_bytes)
}

fn is_request_bytes(w: &[u8]) -> bool {
    let sum = w.try_into().map(|w: &[u8; DATAGRAM]| checksum(w));
    w[0] != 0 && w[1] != 0 && sum.is_ok_and(|sum| sum == w[DATAGRAM - 1])
}
