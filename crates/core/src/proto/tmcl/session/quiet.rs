//! Modules that are not heard: they may have lost count of bytes.
//!
//! Some modules count to nine and know no pause: one that got a byte too many or too few takes no
//! request any more. A single byte between two requests moves its count on by one, so that it is in
//! step again after nine of them at most. Others drop after a pause what is not whole, and such a byte then
//! spoils the request behind it; so every fourth request goes without. A module that is only late must not
//! get that byte, so it waits until the latest possible reply is past. The others of the line count that byte
//! too: while one of them answers, a module that does not is probably gone, and no byte is put between.

use super::{Opcode, Pending, SUSPECTS_MAX, Session};
use crate::station::Class;
use crate::time::Instant;

/// Timeouts after the first request that was not answered, before bytes are put between requests.
const SHIFT_TIMEOUTS: u64 = 2;
/// Requests that were not answered, before that.
const SENDS_MIN: u8 = 2;
/// The same where all of them were stops: a stop that goes out for every place reaches a module whatever it
/// has counted, so that no answer to one says little of its count. A motor may be silent, and its module
/// answers for another.
const STOPS_MIN: u8 = 6;

/// Of so many requests to a module that was heard one goes without a byte before it.
const PLAIN_EACH: u8 = 4;

/// Places of a module's count.
const SHIFTS_MAX: u8 = 9;

/// A module of which nothing was heard since requests to it were not answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quiet {
    module: u8,
    since: Instant,
    sends: u8,
    /// Bytes that were put between requests to it.
    shifts: u8,
    /// Something else than a stop was not answered.
    asked: bool,
}

/// A stop that goes out once for every place of a module's count.
#[derive(Clone, Copy, Debug)]
pub(in crate::proto::tmcl) struct Burst {
    /// It moves the module's count on by one: the stop alone that follows may then be understood.
    pub shifts: bool,
}

impl Session {
    /// For modules that know no frame but by counting bytes.
    pub(in crate::proto::tmcl) fn counting_bytes(mut self) -> Self {
        self.counts_bytes = true;
        self
    }

    /// Notes that a request was not answered.
    pub(super) fn unheard(&mut self, now: Instant, pending: &Pending) {
        let module = pending.ask.request.address;
        let same = |quiet: &Option<Quiet>| quiet.is_some_and(|quiet| quiet.module == module);
        let free = |slots: &[Option<Quiet>]| slots.iter().position(Option::is_none);
        let place = self.quiet.iter().position(same).or_else(|| free(&self.quiet));
        let fresh = Quiet { module, since: now, sends: 0, shifts: 0, asked: false };
        let quiet = &mut self.quiet[place.unwrap_or(SUSPECTS_MAX - 1)];
        if !same(quiet) {
            *quiet = Some(fresh);
        }
        if let Some(quiet) = quiet {
            quiet.sends = quiet.sends.checked_add(1).unwrap_or(u8::MAX - 1);
            quiet.asked |= !is_stop(pending);
        }
        self.unheard.add(module);
        self.suspicious = true;
    }

    /// Notes that a module was heard: it counts as this host does, unless what it answered moved its count on.
    pub(super) fn is_heard(&mut self, module: u8) {
        let moved = self.pending.as_ref().filter(|p| p.burst.is_some_and(|burst| burst.shifts));
        if moved.is_some_and(|pending| pending.ask.request.address == module)
            && let Some(quiet) =
                self.quiet.iter_mut().flatten().find(|quiet| quiet.module == module)
        {
            quiet.asked = true;
            return;
        }
        for place in &mut self.quiet {
            if place.is_some_and(|quiet| quiet.module == module) {
                *place = None;
            }
        }
        self.unheard.remove(module);
        self.note_suspicion();
    }

    fn quiet_of(&self, module: u8) -> Option<&Quiet> {
        self.quiet.iter().flatten().find(|quiet| quiet.module == module)
    }

    /// Whether a byte is to go before the request that is sent next: that goes to a module that may have
    /// lost count of bytes, and is no stop, which waits for no byte. It counts as sent.
    pub(in crate::proto::tmcl) fn take_shift(&mut self, now: Instant) -> bool {
        let pending = self.pending.as_ref().filter(|_| self.suspicious);
        let pending = pending.filter(|pending| !pending.sent && !is_stop(pending));
        let Some(module) = pending.map(|pending| pending.ask.request.address) else { return false };
        // A module may drop what is not whole after a pause, and the byte alone kept it from its request.
        let plain = self.knows(module)
            && self.quiet_of(module).is_some_and(|quiet| quiet.sends % PLAIN_EACH == 0);
        let shifts = !plain && self.is_out_of_step(now, module);
        if let Some(quiet) = self.quiet.iter_mut().flatten().find(|quiet| quiet.module == module) {
            quiet.shifts = quiet.shifts.saturating_add(shifts.into());
        }
        shifts
    }

    /// Whether a module of which nothing was ever heard may have lost count still: a program that was killed
    /// may have left the modules of the line in the middle of it. Where nobody answers, a byte goes before
    /// each of nine requests, so that who was in step is so again at the end.
    pub(super) fn may_be_shifted(&self, module: u8) -> bool {
        let shifts = self.quiet_of(module).map_or(0, |quiet| quiet.shifts);
        self.counts_bytes && self.heard.is_empty() && shifts < SHIFTS_MAX
    }

    /// How the stop is repeated that is to be sent next, where its module did not answer the one before:
    /// it goes out so that the module takes it wherever it is in its count. On a two-wire line its answer
    /// meets the bytes that are still being sent, so nothing is heard of that; every second stop goes
    /// out alone, to be answered.
    pub(in crate::proto::tmcl) fn burst(&self, now: Instant) -> Option<Burst> {
        let pending = self.pending.as_ref().filter(|pending| !pending.sent && is_stop(pending))?;
        let module = pending.ask.request.address;
        let odd = self.quiet_of(module).is_some_and(|quiet| quiet.sends % 2 == 1);
        odd.then(|| Burst { shifts: self.is_out_of_step(now, module) })
    }

    /// Whether a module answered what it was asked last.
    fn is_in_step(&self, module: u8) -> bool {
        self.knows(module) && !self.unheard.holds(module)
    }

    /// Whether a module may have lost count of bytes, by what it did not answer so far.
    fn is_out_of_step(&self, now: Instant, module: u8) -> bool {
        // Others hear the byte too: it is for none that was never there, and puts out of step who counts.
        let worth = self.knows(module) || self.heard.is_empty();
        let alone = !self.recent.iter().any(|(to, ..)| *to != module && self.is_in_step(*to));
        let quiet = self.quiet_of(module).filter(|_| worth && alone);
        quiet.is_some_and(|quiet| {
            let past = now >= quiet.since.plus_ns(SHIFT_TIMEOUTS * self.timeout_ns);
            past && quiet.sends >= if quiet.asked { SENDS_MIN } else { STOPS_MIN }
        })
    }
}

fn is_stop(pending: &Pending) -> bool {
    pending.ask.class == Class::Stop && pending.ask.request.opcode == Opcode::Mst
}
