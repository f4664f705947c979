//! Modules that are not heard: they may have lost count of bytes.
//!
//! Some modules count to nine and know no pause: one that got a byte too many or too few takes no
//! request any more. A single byte between two requests moves its count on by one, so that it is in
//! step again after nine of them at most. Others drop after a pause what is not whole, and such a byte then
//! spoils the request behind it; so every fourth request goes without. A module that is only late must not
//! get that byte, so it waits until the latest possible reply is past. The others of the line count that byte
//! too: while one of them answers, a module that does not is probably gone, and no byte is put between.

use super::proof::PROBES;
use super::{Opcode, Pending, RECENT_MAX, Request, SUSPECTS_MAX, Session};
use crate::proto::tmcl::wire::{DATAGRAM, checksum};
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

/// Of so many requests to a module that is searched for, one goes without a byte before it; and of so many
/// to one of which nothing comes, one goes out for every place and one without a byte.
const TURNS: u8 = 3;

/// Places of a module's count.
const PLACES: u8 = DATAGRAM as u8;

/// A module of which nothing was heard since requests to it were not answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quiet {
    module: u8,
    since: Instant,
    sends: u8,
    /// Bytes that were put between requests to it, while nobody had ever answered.
    shifts: u8,
    /// Something else than a stop was not answered.
    asked: bool,
    turn: u8,
    /// The place that was tried last, while nothing was heard.
    last: u8,
    /// It answered what went out for every place: it is there, and gets what is sent.
    found: bool,
    /// It did so just now.
    just_found: bool,
    /// Places that were tried since it was found.
    tried: u8,
}

impl Quiet {
    const fn new(module: u8, since: Instant) -> Self {
        let (asked, found, just_found) = (false, false, false);
        let (sends, shifts, turn, last, tried) = (0, 0, 0, 0, 0);
        Self { module, since, sends, shifts, asked, turn, last, found, just_found, tried }
    }

    const fn next_turn(&mut self) -> u8 {
        let turn = self.turn;
        self.turn = (turn + 1) % (2 * TURNS);
        turn
    }

    /// The next place to try while nothing is heard.
    const fn next_last(&mut self) -> u8 {
        self.last = self.last % (PLACES - 1) + 1;
        self.last
    }

    /// The next place to try where it was found. It is there that a byte was lost with what went before,
    /// if the wire came back between two requests.
    const fn next_tried(&mut self) -> u8 {
        // Its own place goes without a byte, as it is.
        self.tried += if self.tried == self.last { 2 } else { 1 };
        (self.last + 1 + PLACES - self.tried) % PLACES
    }
}

/// How a request goes out once for every place of a module's count.
#[derive(Clone, Copy, Debug)]
pub(in crate::proto::tmcl) struct Burst {
    /// Bytes before it. They undo what was put between the requests before.
    pub lead: u8,
    /// Bytes after it, so that what goes out alone next is tried at another place.
    pub trail: u8,
}

/// How a request goes out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    /// Bytes that go out alone before it.
    shift: u8,
    burst: Option<Burst>,
}

impl Plan {
    const PLAIN: Self = Self { shift: 0, burst: None };

    /// At another place, from the present one.
    const fn at(place: u8, from: u8) -> Self {
        Self { shift: (PLACES + place - from) % PLACES, burst: None }
    }
}

/// How modules of the line count.
#[derive(Clone, Copy, Debug)]
pub(super) struct Count {
    /// They know no frame but by counting bytes: on serial lines.
    by_bytes: bool,
    /// Bytes beyond whole datagrams that went out since one was heard.
    place: u8,
    /// What went out last did so for every place.
    burst: bool,
    /// When its answer was due.
    due: Instant,
}

impl Count {
    pub(super) const NONE: Self =
        Self { by_bytes: false, place: 0, burst: false, due: Instant::ZERO };

    const fn add(&mut self, bytes: u8) {
        self.place = (self.place + bytes) % PLACES;
    }

    pub(super) fn sends(&mut self, burst: Option<Burst>, due: Instant) {
        self.burst = burst.is_some();
        self.due = due;
        self.add(burst.map_or(0, |burst| burst.lead + burst.trail));
    }
}

impl Session {
    /// For modules that know no frame but by counting bytes.
    pub(in crate::proto::tmcl) fn counting_bytes(mut self) -> Self {
        self.count.by_bytes = true;
        self
    }

    /// Notes that a request was not answered.
    pub(super) fn unheard(&mut self, now: Instant, pending: &Pending) {
        let module = pending.ask.request.address;
        let same = |quiet: &Option<Quiet>| quiet.is_some_and(|quiet| quiet.module == module);
        let free = |slots: &[Option<Quiet>]| slots.iter().position(Option::is_none);
        let place = self.quiet.iter().position(same).or_else(|| free(&self.quiet));
        let quiet = &mut self.quiet[place.unwrap_or(SUSPECTS_MAX - 1)];
        if !same(quiet) {
            *quiet = Some(Quiet::new(module, now));
        }
        if let Some(quiet) = quiet {
            if quiet.sends == 0 && quiet.tried == 0 {
                quiet.since = now;
            }
            quiet.sends = quiet.sends.checked_add(1).unwrap_or(u8::MAX - 1);
            quiet.asked |= !is_stop(pending);
            // It is gone again.
            quiet.found &= pending.burst.is_none();
        }
        self.unheard.add(module);
        self.suspicious = true;
    }

    /// Notes that a module was heard: it counts as this host does, unless it answered what went out for every
    /// place.
    pub(super) fn is_heard(&mut self, module: u8) {
        let newest = self.recent_at.wrapping_sub(1) % RECENT_MAX;
        if self.count.burst
            && self.recent[newest].0 == module
            && let Some(quiet) = self.quiet_mut(module)
        {
            (quiet.sends, quiet.asked) = (0, false);
            if !quiet.found {
                (quiet.turn, quiet.tried) = (1, 0);
            }
            (quiet.found, quiet.just_found) = (true, true);
            return;
        }
        for place in &mut self.quiet {
            if place.is_some_and(|quiet| quiet.module == module) {
                *place = None;
            }
        }
        self.count.place = 0;
        self.unheard.remove(module);
        self.note_suspicion();
    }

    fn quiet_mut(&mut self, module: u8) -> Option<&mut Quiet> {
        self.quiet.iter_mut().flatten().find(|quiet| quiet.module == module)
    }

    fn quiet_of(&self, module: u8) -> Option<&Quiet> {
        self.quiet.iter().flatten().find(|quiet| quiet.module == module)
    }

    /// Bytes that are to go before the request that is sent next: that goes to a module that may have
    /// lost count of bytes, and is no stop, which waits for no byte. They count as sent.
    pub(in crate::proto::tmcl) fn take_shift(&mut self, now: Instant) -> u8 {
        if !self.suspicious {
            return 0;
        }
        let Some(pending) = self.pending.filter(|pending| !pending.sent) else { return 0 };
        let mut plan = pending.plan.unwrap_or_else(|| self.plan(now, &pending));
        let shift = core::mem::take(&mut plan.shift);
        self.count.add(shift);
        if let Some(pending) = &mut self.pending {
            pending.plan = Some(plan);
        }
        shift
    }

    /// Whether a module is there, and not every place of its count was tried yet.
    pub(super) fn is_searched(&self, module: u8) -> bool {
        self.quiet_of(module).is_some_and(|quiet| quiet.found && quiet.tried < PLACES)
    }

    /// How the request that is sent next goes out for every place, if it does.
    pub(in crate::proto::tmcl) fn burst(&self) -> Option<Burst> {
        self.pending.filter(|pending| !pending.sent)?.plan?.burst
    }

    /// How a request goes out.
    fn plan(&mut self, now: Instant, pending: &Pending) -> Plan {
        let module = pending.ask.request.address;
        let lost = self.is_out_of_step(now, module);
        let shiftable = !self.knows(module) && self.may_be_shifted(module);
        let Count { place, due, .. } = self.count;
        // Who knows a pause is in step behind one.
        let paused = now >= due.plus_ns(self.timeout_ns / 2);
        let Some(quiet) = self.quiet_mut(module) else { return Plan::PLAIN };
        let back = if quiet.found { 0 } else { (PLACES - place) % PLACES };
        let burst = |trail| Plan { shift: 0, burst: Some(Burst { lead: back, trail }) };
        if is_stop(pending) {
            // On two wires its answer meets the bytes that are still being sent: every second goes alone.
            let alone = quiet.sends.is_multiple_of(2);
            let elsewhere = !alone && lost && !quiet.found && quiet.next_turn() % 2 == 1;
            return match (alone, elsewhere) {
                (true, _) => Plan::PLAIN,
                (_, true) => burst(quiet.next_last()),
                _ => burst(0),
            };
        }
        if core::mem::take(&mut quiet.just_found) {
            // It is most likely in step.
            return if quiet.tried == 0 { Plan::at(0, place) } else { Plan::PLAIN };
        }
        if !lost {
            return Plan::PLAIN;
        }
        let repeats = is_harmless(pending);
        if quiet.found && quiet.tried < PLACES {
            return match quiet.next_turn() % TURNS {
                _ if paused => Plan::PLAIN,
                0 => Plan::PLAIN,
                _ => Plan::at(quiet.next_tried(), place),
            };
        }
        quiet.found = false;
        if shiftable {
            quiet.shifts += 1;
            return Plan { shift: 1, burst: None };
        }
        if paused && quiet.turn > 0 {
            return Plan::PLAIN;
        }
        match quiet.next_turn() % TURNS {
            0 if repeats => burst(0),
            2 => Plan::at(quiet.next_last(), place),
            _ => Plan::at(0, place),
        }
    }

    /// Whether a module of which nothing was ever heard may have lost count still: a program that was killed
    /// may have left the modules of the line in the middle of it. Where nobody answers, a byte goes before
    /// each of nine requests, so that who was in step is so again at the end.
    pub(super) fn may_be_shifted(&self, module: u8) -> bool {
        let shifts = self.quiet_of(module).map_or(0, |quiet| quiet.shifts);
        self.count.by_bytes && self.heard.is_empty() && shifts < PLACES
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
            let least = match quiet.asked {
                true if quiet.tried > 0 => 1,
                true => SENDS_MIN,
                false => STOPS_MIN,
            };
            past && quiet.sends >= least
        })
    }
}

fn is_stop(pending: &Pending) -> bool {
    pending.ask.class == Class::Stop && pending.ask.request.opcode == Opcode::Mst
}

/// Whether a read may go out for every place: no other piece of these bytes may be a request.
fn is_harmless(pending: &Pending) -> bool {
    let Request { opcode, kind, .. } = pending.ask.request;
    let known = PROBES.iter().any(|(probe, _)| *probe == opcode);
    if !known || (opcode, kind) == (Opcode::Version, 0) || pending.ask.class != Class::Idempotent {
        return false;
    }
    let datagram = pending.ask.request.emit();
    let mut bytes = [0; 2 * DATAGRAM + 1];
    bytes[..DATAGRAM].copy_from_slice(&datagram);
    let last = is_idle_behind(&bytes);
    bytes[DATAGRAM + 1..].copy_from_slice(&datagram);
    last && is_idle_behind(&bytes)
}

/// Whether what comes behind the first datagram of these bytes is no request at any place.
fn is_idle_behind(bytes: &[u8; 2 * DATAGRAM + 1]) -> bool {
    let is_request = |w: &[u8]| {
        let sum = w.try_into().map(|w: &[u8; DATAGRAM]| checksum(w));
        w[0] != 0 && w[1] != 0 && sum.is_ok_and(|sum| sum == w[DATAGRAM - 1])
    };
    !bytes.windows(DATAGRAM).skip(1).take(DATAGRAM).any(is_request)
}
