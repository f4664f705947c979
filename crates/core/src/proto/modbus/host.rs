//! The commanding end: one request outstanding, every echo that the protocol offers compared.
//!
//! A reply to a read repeats no address, so a late one looks like the answer to the next request.
//! Therefore the host keeps a ledger of what it is still owed. After silence the line is in
//! quarantine: a probe, a read with a function code that is not owed, is sent; drives answer in
//! order, so when the probe is answered (even refused) nothing older can still come. Without an
//! answer the quarantine lasts three times the timeout. A late reply that arrives meanwhile can only
//! be the one waited for, and is taken as such. Only what is harmless to repeat is sent again, and
//! only after the quarantine.
//!
//! Where an earlier program may have spoken, each station begins *unproven*: before the first request to
//! it, stops excepted, probes drawn at random must be answered one after another. What an older
//! request is owed takes the place of one only if it has that function code and length.

mod proof;
mod receive;

use super::ascii::{self, Collector};
use super::request::{Answer, Ask, Request};
use super::rtu::{self, ADU_MAX};
use super::wire::{BROADCAST, Format, Space};
use crate::error::Failure;
use crate::medium::{SerialLine, Stream};
use crate::proto::HostOptions;
use crate::proto::events::Events;
use crate::proto::pace::{Pace, tolerated};
use crate::proto::proven::Proven;
use crate::station::{self, Class, Counters, Event, LineEvent, Station, Ticket, Timed, To};
use crate::time::Instant;
use proof::Proof;

/// Times that one request is put on the wire at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Time allowed for a reply when nothing else is said, ms; the time that the bytes take on the wire
/// comes on top.
pub const REPLY_TIMEOUT_MS: u32 = 100;
/// As [`HostOptions::gap_us`]: 3.5 characters whatever the baud rate, instead of the standard's fixed
/// 1.75 ms above 19200 baud.
pub const GAP_TRUE_CHARACTERS: u32 = HostOptions::GAP_CHARACTERS;
/// Silence after a broadcast, and before another station is spoken to on a timed line: more than
/// the 10 ms that the TS drive takes for the end of a frame (TS manual V2 §2.3). It hears its
/// neighbours' replies too, so a shorter pause would make one bad frame of them and its request \[I\].
pub const STATION_GAP_US: u32 = 10_500;
/// Stands for whoever spoke on the line while it was somebody else's: no station has it.
const STRANGER: u8 = 255;

/// Requests in a row whose only reply came sooner than its bytes can travel, after which the baud
/// rate is taken for fiction (a virtual port).
const EARLY_MAX: u8 = 2;
/// Replies in a row that took their time, after which it is believed again.
const TIMELY_MIN: u8 = 16;
const QUARANTINE_TIMEOUTS: u64 = 3;
const RECEIVE_MAX: usize = 2 * ADU_MAX;
const OWED_MAX: usize = 8;
const EVENTS_MAX: usize = 4;
/// Places among them that a request needs: its own end, and that of one that it cuts short.
const ROOM_MIN: usize = 2;
/// A reply equal to the last one but to another question, so soon after it on a wire without
/// timing, may be that one's duplicate: it is held back, at least for as long.
const SUSPECT_NS: u64 = 1_000_000;

/// The commanding end of a line.
#[derive(Clone, Debug)]
pub struct Host {
    format: Format,
    line: SerialLine,
    timeout_ns: u64,
    /// Silence before a frame: what the options say, and what the standard does.
    gap_ns: Option<u64>,
    silence_ns: u64,
    echo: Echo,
    /// Cleared when replies come faster than the baud rate allows: the wire is none.
    timed: bool,
    /// It never is.
    untimed: bool,
    pace: Pace,
    /// The frame in hand began before the request had left.
    soon: bool,
    /// Requests in a row whose only reply came too soon; replies in a row that took their time.
    early_streak: u8,
    timely: u8,

    current: Option<Current>,
    sending: Option<Sending>,
    /// Deadline of what was sent last, and whether the line is in quarantine until then.
    deadline: Option<Instant>,
    quarantine: bool,
    owed: [Owed; OWED_MAX],
    owed_len: usize,

    sent: [u8; ascii::FRAME_MAX],
    sent_len: usize,
    sent_at: Instant,
    sent_unit: Option<u8>,
    /// How long what was sent last takes on the wire.
    sent_ns: u64,
    /// Since the last frame was sent: its echo came; bytes came, or were thrown away.
    echo_seen: bool,
    /// A reply to what was sent last came sooner than its bytes can travel, and was left alone.
    early: bool,
    heard: bool,
    junk: bool,
    /// A station that answered the last request it got.
    alive: Option<u8>,

    received: [u8; RECEIVE_MAX],
    received_len: usize,
    characters: Collector,
    active_at: Option<Instant>,

    payload: [u8; ADU_MAX],
    payload_len: usize,
    answered: Option<Answered>,
    /// When the answer came that is held back.
    held: Option<Instant>,
    events: Events<Answer, EVENTS_MAX>,
    counters: Counters,

    /// Stations of which it is known that nothing older can come.
    proven: Proven,
    /// While the present request waits for its station to be proven.
    proof: Option<Proof>,
}

#[derive(Clone, Copy, Debug)]
struct Current {
    ticket: Ticket,
    request: Request,
    attempts: u8,
    since: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Sending {
    Request,
    Probe,
}

/// Whether we hear our own bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Echo {
    /// The user said so.
    Always,
    /// The last exchange that could tell had an echo.
    Learnt,
    /// It had none, or there was no such exchange yet.
    Unknown,
}

/// A reply that may still come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Owed {
    unit: u8,
    function: u8,
    /// Address and value or count that a write's reply repeats; the byte count of a read's.
    echo: (u16, u16),
    role: Role,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Role {
    Request,
    Probe,
    /// Its ticket was closed for a stop.
    Abandoned,
}

/// The exchange before, if it was a read: what was asked, and when the answer came. What was read
/// still lies where the payload begins.
#[derive(Clone, Copy, Debug)]
struct Answered {
    at: Instant,
    latency_ns: u64,
    unit: u8,
    space: Space,
    start: u16,
    count: u16,
    len: usize,
}

const NOTHING_OWED: Owed = Owed { unit: 0, function: 0, echo: (0, 0), role: Role::Abandoned };

impl Owed {
    #[inline]
    fn of(request: &Request, role: Role) -> Self {
        let echo = match request.ask {
            Ask::Read { space, count, .. } => (0, space.reply_bytes(count) as u16),
            _ => request.ask.echo(),
        };
        Self { unit: request.unit, function: request.ask.function().code(), echo, role }
    }

    /// Bytes of the PDU that is owed, if it is no exception.
    #[inline]
    fn pdu_len(self) -> usize {
        match Space::read_by(self.function) {
            Some(_) => 2 + usize::from(self.echo.1),
            None => 5,
        }
    }
}

impl Host {
    /// A host that sends `format`.
    #[must_use]
    pub fn new(format: Format, options: &HostOptions) -> Self {
        let timeout_ms = options.reply_timeout_ms.unwrap_or(REPLY_TIMEOUT_MS);
        let line = SerialLine::n81(options.baud);
        Self {
            format,
            line,
            timeout_ns: u64::from(timeout_ms.max(1)) * 1_000_000,
            gap_ns: options.gap_us.map(|gap| match gap {
                GAP_TRUE_CHARACTERS => rtu::true_silence_ns(&line),
                us => u64::from(us) * 1000,
            }),
            silence_ns: match format {
                Format::Rtu => rtu::silence_ns(&line),
                Format::Ascii => 0,
            },
            echo: if options.echo { Echo::Always } else { Echo::Unknown },
            timed: options.pace() != 0,
            untimed: options.untimed,
            pace: Pace::new(&SerialLine::n81(options.pace())),
            soon: false,
            early_streak: 0,
            timely: 0,
            current: None,
            sending: None,
            deadline: None,
            quarantine: false,
            owed: [NOTHING_OWED; OWED_MAX],
            owed_len: 0,
            sent: [0; ascii::FRAME_MAX],
            sent_len: 0,
            sent_at: Instant::ZERO,
            sent_unit: None,
            sent_ns: 0,
            echo_seen: false,
            early: false,
            heard: false,
            junk: false,
            alive: None,
            received: [0; RECEIVE_MAX],
            received_len: 0,
            characters: Collector::default(),
            active_at: None,
            payload: [0; ADU_MAX],
            payload_len: 0,
            answered: None,
            held: None,
            events: Events::new(),
            counters: Counters::default(),
            proven: Proven::new(options.doubt),
            proof: None,
        }
    }

    /// The data of the last read that was answered, as it lay in the reply: big-endian words, or
    /// bits eight to a byte. Stands until the next request is submitted.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload[..self.payload_len]
    }

    fn owed(&self) -> &[Owed] {
        &self.owed[..self.owed_len]
    }

    /// The present request was answered; what it read is the payload.
    #[inline]
    fn succeed(&mut self) {
        let Some(Current { ticket, request, .. }) = &self.current else { return };
        self.counters.answered += 1;
        self.alive = Some(request.unit);
        let event = self.events.push(To::Ticket(*ticket), Ok(Answer::BLANK));
        if let Ok(answer) = event {
            answer.fill(request, &self.payload[..self.payload_len]);
        }
        self.close();
    }

    /// The present request was refused, or brought no answer.
    #[cold]
    fn fail(&mut self, failure: Failure) {
        let Some(Current { ticket, request, .. }) = &self.current else { return };
        match failure {
            Failure::Refused { .. } => self.counters.answered += 1,
            Failure::Silent => self.counters.silent += 1,
            _ => {}
        }
        match failure {
            Failure::Cancelled => {}
            Failure::Silent => self.alive = None,
            _ => self.alive = Some(request.unit),
        }
        self.events.push(To::Ticket(*ticket), Err(failure));
        self.close();
    }

    #[inline]
    fn close(&mut self) {
        self.current = None;
        self.proof = None;
        if self.sending == Some(Sending::Request) {
            self.sending = None;
        }
    }

    /// Nothing is outstanding and nothing can still come.
    #[inline]
    fn settle(&mut self) {
        self.quarantine = false;
        self.deadline = None;
        self.owed_len = 0;
        self.held = None;
        if self.sending == Some(Sending::Probe) {
            self.sending = None;
        }
    }

    /// When the next frame may go out: after the silence that the line needs, but no later than a
    /// timeout after it was asked for, however much the line babbles.
    fn send_at(&self) -> Instant {
        self.quiet().min(self.latest())
    }

    /// When the line has been silent for long enough.
    #[inline]
    fn quiet(&self) -> Instant {
        let Some(active) = self.active_at else { return Instant::ZERO };
        let unit = match (self.sending, &self.current) {
            (Some(Sending::Request), Some(current)) => Some(current.request.unit),
            (_, Some(current)) if self.proof.is_some() => Some(current.request.unit),
            _ => self.sent_unit,
        };
        let gap = self.gap_ns.unwrap_or(if self.timed { self.silence_ns } else { 0 });
        if unit == self.sent_unit && unit != Some(BROADCAST) {
            return active.plus_ns(gap);
        }
        active.plus_ns(gap.max(self.other_gap_ns()))
    }

    /// Least silence before a frame to another station than the one spoken to last.
    #[cold]
    fn other_gap_ns(&self) -> u64 {
        let timed = self.timed && self.format == Format::Rtu && self.gap_ns.is_none();
        match self.sent_unit {
            Some(BROADCAST) => u64::from(STATION_GAP_US) * 1000,
            Some(_) if timed => u64::from(STATION_GAP_US) * 1000,
            _ => 0,
        }
    }

    fn latest(&self) -> Instant {
        let patience = self.timeout_ns.max(2 * u64::from(STATION_GAP_US) * 1000);
        match (self.sending, &self.current) {
            (Some(Sending::Request), Some(current)) => current.since.plus_ns(patience),
            (_, Some(current)) if self.proof.is_some() => current.since.plus_ns(patience),
            _ => self.deadline.unwrap_or(Instant::FAR),
        }
    }

    /// A read of one bit or register with a function code that is not owed.
    fn probe(&self) -> Option<Request> {
        let unit = self.sent_unit.filter(|&unit| unit != BROADCAST)?;
        let spaces = [Space::Holding, Space::Coil, Space::Input, Space::Discrete];
        let free = |space: &Space| {
            let code = space.read().code();
            !self.owed().iter().any(|owed| owed.function == code)
        };
        let space = spaces.into_iter().find(free)?;
        let ask = Ask::Read { space, start: 0, count: 1 };
        Some(Request { unit, ask, class: Class::Idempotent })
    }

    /// Notes that what lies in `sent` goes out now, and what is owed for it.
    #[inline]
    fn note_sent(&mut self, now: Instant, owed: Owed) {
        let gone = self.line.characters_ns(self.sent_len as u32);
        self.sending = None;
        self.sent_at = now;
        self.sent_unit = Some(owed.unit);
        self.active_at = Some(now.plus_ns(gone));
        self.sent_ns = gone;
        self.echo_seen = false;
        self.early &= owed.role == Role::Probe;
        self.heard &= owed.role == Role::Probe;
        if self.received_len > 0 {
            self.skip(self.received_len);
        }
        self.junk = false;
        self.characters.clear();
        self.pace.sent(now, tolerated(gone));
        self.counters.sent += 1;
        if owed.unit == BROADCAST {
            self.succeed();
            return self.settle();
        }
        // A probe may be answered as late as any request.
        let timeouts = self.timeouts();
        let reply = self.line.characters_ns(self.characters_of(owed.pdu_len()) as u32);
        self.deadline = Some(now.plus_ns(gone + reply + timeouts * self.timeout_ns));
        self.owe(owed);
    }

    /// Characters of a frame around a PDU of so many bytes.
    #[inline]
    fn characters_of(&self, pdu_len: usize) -> usize {
        match self.format {
            Format::Rtu => pdu_len + 3,
            Format::Ascii => 2 * pdu_len + 7,
        }
    }

    #[inline]
    fn owe(&mut self, owed: Owed) {
        if let Some(place) = self.owed.get_mut(self.owed_len) {
            *place = owed;
            self.owed_len += 1;
        }
    }

    fn late(&mut self, now: Instant) {
        if self.proof.is_some() {
            return self.not_proved();
        }
        if self.quarantine {
            return self.give_up(now);
        }
        self.quarantine = true;
        if self.owed_len < OWED_MAX && self.probe().is_some() {
            self.sending = Some(Sending::Probe);
        }
        self.prolong();
    }

    /// The deadline becomes that of the latest possible reply.
    fn prolong(&mut self) {
        let more = (QUARANTINE_TIMEOUTS - 1) * self.timeout_ns;
        self.deadline = self.deadline.map(|deadline| deadline.plus_ns(more));
    }

    /// The wire was away. A reply that is owed may still come once it is back, and nothing shows
    /// what it answers: until the latest is past, the line stays closed.
    fn abandon(&mut self) {
        self.sending = None;
        self.held = None;
        self.alive = None;
        self.characters.clear();
        self.skip(self.received_len);
        if self.owed_len == 0 {
            self.sent_unit = None;
            return self.settle();
        }
        self.owed[..self.owed_len].iter_mut().for_each(|owed| owed.role = Role::Abandoned);
        if !core::mem::replace(&mut self.quarantine, true) {
            self.prolong();
        }
    }

    #[inline]
    fn begin(&mut self, now: Instant, ticket: Ticket, request: Request) {
        self.held = None;
        self.payload_len = 0;
        self.current = Some(Current { ticket, request, attempts: 1, since: now });
        self.sending = Some(Sending::Request);
    }

    /// Takes a request where something stands against it, and gives it back if too much does: a
    /// stop takes the place of the present request in a quarantined line.
    #[cold]
    fn submit_in_doubt(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: Request,
    ) -> Result<(), Request> {
        let full = self.events.room() < ROOM_MIN;
        let busy = self.current.is_some() || self.quarantine;
        let stop = station::Request::is_stop(&request);
        if full || (busy && !(stop && self.quarantine && self.proof.is_none())) {
            return Err(request);
        }
        if !busy && !stop && request.unit != BROADCAST {
            self.prove(now, ticket, request);
            return Ok(());
        }
        // Who asked hears why a read was not asked again.
        let again = |current: &Current| {
            current.request.class == Class::Idempotent && current.attempts < ATTEMPTS_MAX
        };
        let given_up = self.current.as_ref().is_some_and(again);
        self.fail(if given_up { Failure::Cancelled } else { Failure::Silent });
        for owed in &mut self.owed[..self.owed_len] {
            if owed.role == Role::Request {
                owed.role = Role::Abandoned;
            }
        }
        self.begin(now, ticket, request);
        if request.unit == BROADCAST && request.ask.function().reads().is_some() {
            // Nobody answers a broadcast (MSL 2.1): a read of it is silence without a byte sent.
            self.fail(Failure::Silent);
        }
        Ok(())
    }

    /// The quarantine ran out: nothing can still come.
    fn give_up(&mut self, now: Instant) {
        let worth = self.heard || self.current.is_some_and(|c| self.alive == Some(c.request.unit));
        self.settle();
        if worth {
            self.lost(now);
        } else {
            self.fail(Failure::Silent);
        }
    }

    /// The request or its reply was lost, and the line is clean.
    fn lost(&mut self, now: Instant) {
        if self.early {
            self.early_streak += 1;
            self.timed &= self.early_streak < EARLY_MAX;
        }
        let Some(current) = &mut self.current else { return };
        let harmless = matches!(current.request.class, Class::Idempotent | Class::Stop);
        if harmless && current.attempts < ATTEMPTS_MAX && self.owed_len == 0 {
            current.attempts += 1;
            current.since = now;
            self.counters.resent += 1;
            self.sending = Some(Sending::Request);
            self.quarantine = false;
            self.deadline = None;
        } else {
            self.fail(Failure::Silent);
        }
    }
}

impl Timed for Host {
    fn handle_timeout(&mut self, now: Instant) {
        if self.deadline.is_none_or(|deadline| now < deadline)
            || self.sending == Some(Sending::Request)
        {
            return;
        }
        match self.held.take() {
            Some(at) => {
                self.remember(at, now);
                self.settle();
                self.succeed();
            }
            None => self.late(now),
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.sending {
            Some(_) => Some(self.send_at()),
            None => self.deadline,
        }
    }
}

impl Station<Stream> for Host {
    #[inline]
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.active_at = Some(self.active_at.map_or(now, |active| active.max(now)));
        self.heard = true;
        if self.format == Format::Ascii {
            return self.work_ascii(now, unit);
        }
        match self.plain_read(unit) {
            Some(data) => self.read(now, unit.len(), data),
            None => self.collect(now, unit),
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        if matches!(event, LineEvent::Down | LineEvent::BusOff) {
            self.fail(Failure::LinkDown);
        }
        if !matches!(event, LineEvent::Break) && self.current.is_none() {
            self.abandon();
        }
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let sending = self.sending?;
        if now < self.quiet() && now < self.latest() {
            return None;
        }
        let (request, role) = match sending {
            Sending::Request => (&self.current.as_ref()?.request, Role::Request),
            Sending::Probe => (&self.next_probe()?, Role::Probe),
        };
        self.sent_len = request.emit(self.format, &mut self.sent);
        let owed = Owed::of(request, role);
        self.note_sent(now, owed);
        if self.sent_len == rtu::SHORT {
            *out.first_chunk_mut::<{ rtu::SHORT }>()? = *self.sent.first_chunk()?;
        } else {
            out.get_mut(..self.sent_len)?.copy_from_slice(&self.sent[..self.sent_len]);
        }
        Some(self.sent_len)
    }

    fn line(&self) -> SerialLine {
        self.line
    }
}

impl station::Host<Stream> for Host {
    type Request = Request;
    type Answer = Answer;

    #[inline]
    fn submit(&mut self, now: Instant, ticket: Ticket, request: Request) -> Result<(), Request> {
        let busy = self.current.is_some() || self.quarantine;
        let unit = request.unit;
        if busy || self.events.room() < ROOM_MIN || unit == BROADCAST || !self.proven.holds(unit) {
            return self.submit_in_doubt(now, ticket, request);
        }
        self.begin(now, ticket, request);
        Ok(())
    }

    /// A request that waits for the line to be silent, for the first time or once more.
    fn recall(&mut self, _stop: &Request) -> Option<Ticket> {
        let unsent = self.sending == Some(Sending::Request) || self.proof.is_some();
        let current = self.current.as_ref().filter(|_| unsent)?;
        if station::Request::is_stop(&current.request) {
            return None;
        }
        let ticket = current.ticket;
        self.close();
        if self.owed_len == 0 {
            self.settle();
        }
        Some(ticket)
    }

    fn send_once(&mut self, ticket: Ticket) {
        if let Some(current) = self.current.as_mut().filter(|current| current.ticket == ticket) {
            current.attempts = ATTEMPTS_MAX;
        }
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.events.next()
    }

    fn emit(&self, request: &Request, out: &mut [u8]) -> usize {
        request.emit(self.format, out)
    }

    fn disturbed(&mut self, now: Instant) {
        self.active_at = Some(now);
        // To whom nobody here has spoken: that frame is another station's in any case.
        self.sent_unit = Some(STRANGER);
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn unread(&self) -> usize {
        self.received_len + self.characters.pending()
    }
}
