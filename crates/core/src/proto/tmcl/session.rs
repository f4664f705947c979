//! What both hosts share: one request outstanding, deadlines, retries, quarantine, events.
//!
//! A reply names its module, its opcode and its status, but not the parameter that was asked. So a
//! late reply to `GAP 1` looks exactly like the answer to `GAP 3`. Therefore, after silence (and
//! after an answer to something that was sent twice) a module is *suspect*: nothing but a stop is
//! asked of it until a probe of another opcode was answered, because a module answers in order and
//! nothing older can come after that; or until the latest possible reply is past.
//!
//! Where an earlier program may have spoken, every module begins *unproven*, and becomes so again when
//! a doubt ended by time alone: nobody knows what is owed. Before the first request to it, stops
//! excepted, several probes of different opcodes, drawn at random, must be answered one after another.
//! What an older request is owed takes the place of one only if it has that opcode, and then the
//! probe's own answer comes while the next one is awaited, and is not taken for that. So a value that
//! is wrong takes as many older replies as there are probes, of just these opcodes in this order.

mod modules;
mod motors;
mod proof;
mod quiet;
mod suspects;

use super::opcode::{Opcode, Status};
use super::wire::{Instruction, Reply, Request, VersionText};
use crate::error::{Failure, Unsupported};
use crate::proto::events::Events;
use crate::proto::proven::Proven;
use crate::station::{Class, Counters, Event, LineEvent, Ticket, To};
use crate::time::Instant;
use modules::Modules;
use motors::Motors;
use proof::{PROBES, Waiting};
pub(super) use quiet::Burst;
use quiet::{Count, Plan, Quiet};

/// Times an idempotent request is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Probes sent into silence at most, in one quarantine.
pub const PROBES_MAX: u8 = 4;
/// Modules in quarantine at a time at most; one more closes the line until one is out.
pub const SUSPECTS_MAX: usize = 4;
/// Events that wait to be taken at most; before that, nothing new is accepted.
pub const EVENTS_MAX: usize = 8;
/// Places among them kept for the ends of requests.
const ROOM_MIN: usize = 4;
/// Requests remembered, for whose replies one may be taken that comes too soon.
const RECENT_MAX: usize = 8;
/// Opcodes remembered of a suspect: three attempts and every probe.
const TAGS_MAX: usize = 10;
/// A reply is possible for so many times the reply timeout after its request.
const LATEST_TIMEOUTS: u64 = 3;
/// After "wrong checksum" the true reply of another module may still come for so long.
const GRACE_NS: u64 = 20_000_000;

/// A request with what may be done when no answer comes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ask {
    /// What is sent.
    pub request: Request,
    /// Whether it may be sent again.
    pub class: Class,
}

impl Ask {
    /// A request with the class that its opcode has by itself.
    #[must_use]
    pub const fn of(request: Request) -> Self {
        let class = match request.opcode {
            Opcode::Mst => Class::Stop,
            Opcode::Ror | Opcode::Rol if request.value == 0 => Class::Stop,
            Opcode::Sap | Opcode::Sgp | Opcode::Sio => Class::Confirm,
            opcode if opcode.only_reads() => Class::Idempotent,
            _ => Class::Never,
        };
        Self { request, class }
    }
}

impl crate::station::Request for Ask {
    fn class(&self) -> Class {
        self.class
    }
}

/// What a module answers, after the host's checks. Refusals are [`Failure::Refused`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// The usual reply, with status 100 or 101.
    Reply(Reply),
    /// The version as text.
    Text(VersionText),
    /// An instruction from program memory.
    Instruction(Instruction),
    /// The request has no reply; it is out.
    NoReply,
    /// Sent unasked: a target position was reached.
    Event(Reply),
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    /// `None` for a probe.
    ticket: Option<Ticket>,
    ask: Ask,
    attempts: u8,
    sent: bool,
    /// How it goes out, once that is known.
    plan: Option<Plan>,
    /// It went out at each place of its module's count.
    burst: Option<Burst>,
    /// When it could first have been sent.
    ready: Instant,
    not_before: Instant,
    earliest: Instant,
    deadline: Instant,
    doubts: Doubts,
}

/// What makes the next reply less than certain.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Doubts {
    /// Replies of the same opcode that may still come for older requests.
    ambiguous: u8,
    bad_sum: bool,
    bad_sum_of_module: bool,
    early: bool,
    /// The reply to another motor's stop may still come, or to another program's.
    anothers: bool,
    /// A stop waits, or it was to be sent once: no further attempt.
    cut_short: bool,
}

impl Doubts {
    const NONE: Self = Self {
        ambiguous: 0,
        bad_sum: false,
        bad_sum_of_module: false,
        early: false,
        anothers: false,
        cut_short: false,
    };
}

impl Pending {
    #[inline]
    const fn new(now: Instant, ticket: Option<Ticket>, ask: Ask, ambiguous: u8) -> Self {
        Self {
            ticket,
            ask,
            attempts: 0,
            sent: false,
            plan: None,
            burst: None,
            ready: now,
            not_before: now,
            earliest: now,
            deadline: now,
            doubts: Doubts { ambiguous, ..Doubts::NONE },
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Suspect {
    module: u8,
    /// Opcodes of requests whose answers may still come, each with until when.
    tags: [(u8, Instant); TAGS_MAX],
    count: u8,
    probes: u8,
    probe_due: bool,
    until: Instant,
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    host: u16,
    timeout_ns: u64,
    pending: Option<Pending>,
    stop: Option<(Ticket, Ask)>,
    suspects: [Option<Suspect>; SUSPECTS_MAX],
    /// Something is in doubt: a suspect, a module that is not heard, or whose stop a reply is.
    suspicious: bool,
    quiet: [Option<Quiet>; SUSPECTS_MAX],
    /// Whose stops may still be answered.
    motors: Motors,
    /// Modules of which no older reply can come but those that are known of.
    proven: Proven,
    /// A request that waits for its module to be proven.
    waiting: Option<Waiting>,
    /// The last requests: module, opcode and when.
    recent: [(u8, u8, Instant); RECENT_MAX],
    recent_at: usize,
    events: Events<Answer, EVENTS_MAX>,
    /// Modules that ever answered.
    heard: Modules,
    /// Modules of which nothing was heard since a request to them was not answered.
    unheard: Modules,
    /// Replies that came sooner than the baud rate allows, in a row; past the limit the baud rate
    /// is taken for fiction (USB).
    early_streak: u8,
    count: Count,
    /// Replies in a row that took their time.
    timely: u64,
    up: bool,
    pub(super) counters: Counters,
}

/// Requests in a row whose only reply came too soon, after which replies are taken as they come.
const EARLY_MAX: u8 = 2;
/// Replies in a row that took their time, after which the baud rate is believed again.
const TIMELY_MIN: u64 = 16;

impl Session {
    pub(super) fn new(host: u16, timeout_ms: u32, doubt: Option<u32>) -> Self {
        Self {
            proven: Proven::new(doubt),
            waiting: None,
            recent: [(0, 0, Instant::ZERO); RECENT_MAX],
            recent_at: 0,
            host,
            timeout_ns: u64::from(timeout_ms) * 1_000_000,
            pending: None,
            stop: None,
            suspects: [None; SUSPECTS_MAX],
            suspicious: false,
            quiet: [None; SUSPECTS_MAX],
            motors: Motors::NONE,
            events: Events::new(),
            heard: Modules::NONE,
            unheard: Modules::NONE,
            early_streak: 0,
            count: Count::NONE,
            timely: 0,
            up: true,
            counters: Counters::default(),
        }
    }

    #[inline]
    pub(super) fn submit(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        let own = u16::from(ask.request.address) == self.host;
        if self.pending.is_some()
            || self.suspicious
            || !self.proven.holds(ask.request.address)
            || !self.up
            || own
            || self.events.room() < ROOM_MIN
        {
            return self.submit_in_doubt(now, ticket, ask);
        }
        self.pending = Some(Pending::new(now, Some(ticket), ask, 0));
        Ok(())
    }

    /// Takes back what was not sent yet, for a stop.
    pub(super) fn recall(&mut self) -> Option<Ticket> {
        if let Some(waiting) = self.waiting.take_if(|waiting| waiting.ask.class != Class::Stop) {
            return Some(waiting.ticket);
        }
        let unsent = |p: &&Pending| !p.sent && p.attempts == 0 && p.ask.class != Class::Stop;
        let ticket = self.pending.as_ref().filter(unsent)?.ticket?;
        self.pending = None;
        Some(ticket)
    }

    /// The request of that ticket, of which nothing is on the wire yet, gets one attempt.
    pub(super) fn send_once(&mut self, ticket: Ticket) {
        let its = |p: &&mut Pending| p.ticket == Some(ticket);
        if let Some(pending) = self.pending.as_mut().filter(its) {
            pending.doubts.cut_short = true;
        }
    }

    /// Takes a request where something stands against it.
    #[cold]
    fn submit_in_doubt(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        if self.events.room() < ROOM_MIN {
            return Err(ask);
        }
        if let Some(failure) = self.refusal(&ask) {
            self.events.push(To::Ticket(ticket), Err(failure));
            return Ok(());
        }
        let stop = ask.class == Class::Stop;
        if self.pending.is_some() {
            return if stop { self.overtake(now, ticket, ask) } else { Err(ask) };
        }
        if self.suspicious && !stop && !self.trusts(now, ask.request.address) {
            return Err(ask);
        }
        if stop || self.proven.holds(ask.request.address) {
            self.start(now, Some(ticket), ask);
        } else {
            self.waiting = Some(Waiting::new(ticket, ask, false));
            self.prove(now);
        }
        Ok(())
    }

    #[inline]
    pub(super) fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.events.next()
    }

    /// The request to send now, if one waits. It and its reply are on the wire
    /// for `soonest_ns` at least, `on_wire_ns` at most. `burst`: how it goes out at each place of its
    /// module's count, if it does.
    #[inline]
    pub(super) fn transmit(
        &mut self,
        now: Instant,
        (soonest_ns, on_wire_ns): (u64, u64),
        burst: Option<Burst>,
    ) -> Option<Request> {
        let pending = self.pending.as_mut()?;
        if pending.sent || now < pending.not_before {
            return None;
        }
        pending.burst = burst;
        let request = pending.ask.request;
        pending.sent = true;
        if request.opcode == Opcode::Mst {
            if pending.attempts == 0 {
                pending.doubts.anothers =
                    self.motors.may_be_anothers(&request) || !self.proven.holds(request.address);
            }
            self.motors.told(&request);
            self.suspicious = true;
        }
        self.recent[self.recent_at % RECENT_MAX] = (request.address, request.opcode.number(), now);
        self.recent_at = self.recent_at.wrapping_add(1);
        pending.earliest = now.plus_ns(soonest_ns);
        pending.deadline = now.plus_ns(on_wire_ns + self.timeout_ns);
        self.count.sends(burst, pending.deadline);
        self.counters.sent += 1;
        if pending.attempts > 0 {
            self.counters.resent += 1;
        }
        pending.attempts += 1;
        if matches!(request.opcode, Opcode::Boot | Opcode::BootStart) {
            let ticket = pending.ticket;
            self.pending = None;
            self.end(ticket, Ok(Answer::NoReply));
        }
        Some(request)
    }

    /// True while a request waits to be sent.
    #[inline]
    pub(super) fn has_unsent(&self) -> bool {
        self.pending.as_ref().is_some_and(|pending| !pending.sent)
    }

    /// What waits for an answer now.
    pub(super) fn expected(&self) -> Option<&Request> {
        self.pending.as_ref().filter(|pending| pending.sent).map(|pending| &pending.ask.request)
    }

    /// Puts the sending off, but no stop, and nothing for longer than the reply timeout.
    pub(super) fn hold(&mut self, until: Instant) {
        let timeout = self.timeout_ns;
        if let Some(pending) = &mut self.pending
            && pending.ask.class != Class::Stop
        {
            let until = until.min(pending.ready.plus_ns(timeout));
            pending.not_before = pending.not_before.max(until);
        }
    }

    /// Takes the good reply that is waited for, where nothing is in doubt: what happens most, so it
    /// is looked at first. Returns false when it is something else.
    #[inline]
    pub(super) fn usual(&mut self, now: Instant, reply: Reply) -> bool {
        let Some(pending) = &self.pending else { return false };
        let request = &pending.ask.request;
        let ours = reply.module == request.address
            && reply.opcode == request.opcode
            && reply.status == Status::Ok
            && request.opcode != Opcode::ReadMemory;
        let plain = pending.sent && pending.attempts == 1 && pending.doubts == Doubts::NONE;
        let trusted = !self.suspicious && self.early_streak == 0 && now >= pending.earliest;
        let (true, true, true, Some(ticket)) = (ours, plain, trusted, pending.ticket) else {
            return false;
        };
        self.timely += 1;
        self.heard.add(reply.module);
        self.counters.answered += 1;
        self.pending = None;
        self.events.push(To::Ticket(ticket), Ok(Answer::Reply(reply)));
        true
    }

    /// Takes a reply that passed every check of the wire.
    pub(super) fn reply(&mut self, now: Instant, reply: Reply, soon: bool) {
        // Who complains of a checksum may have lost count.
        if self.suspicious && reply.status != Status::WrongChecksum {
            self.is_heard(reply.module);
        }
        if is_event(&reply) { self.event(reply) } else { self.judge(now, reply, soon) }
    }

    /// Takes the version as text.
    pub(super) fn text(&mut self, now: Instant, text: VersionText) {
        self.answered(now, Ok(Answer::Text(text)));
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.pending.is_some_and(|pending| pending.sent && now >= pending.deadline) {
            self.expired(now);
        }
        if self.suspicious {
            self.expire_suspects(now);
        }
        self.next(now);
    }

    #[inline]
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let pending = self.pending.as_ref().map(|p| if p.sent { p.deadline } else { p.not_before });
        // While something is out, its own deadline comes first; a suspect is let go after it.
        if pending.is_some() || !self.suspicious {
            return pending;
        }
        self.suspects.iter().flatten().map(|suspect| suspect.until).min()
    }

    pub(super) fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.up = match event {
            LineEvent::Down | LineEvent::BusOff => false,
            LineEvent::Up => true,
            LineEvent::Break => self.up,
        };
        if self.up {
            return;
        }
        if let Some(pending) = self.pending.take() {
            self.suspect(now, &pending, false);
            self.end(pending.ticket, Err(Failure::LinkDown));
        }
        let waiting = self.waiting.take().map(|waiting| waiting.ticket);
        let stop = self.stop.take().map(|(ticket, _)| ticket);
        for ticket in stop.into_iter().chain(waiting) {
            self.end(Some(ticket), Err(Failure::LinkDown));
        }
    }

    fn refusal(&self, ask: &Ask) -> Option<Failure> {
        const RULE: &str = "this is the host's own address; give the host another with host=";
        if !self.up {
            return Some(Failure::LinkDown);
        }
        let is_own = u16::from(ask.request.address) == self.host;
        is_own.then_some(Failure::Impossible(Unsupported::Forbidden(RULE)))
    }

    /// A stop, while something is outstanding: a probe is given up at once; a request keeps its
    /// present chance, because its reply may be on the wire, but gets no further one.
    fn overtake(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        let Some(pending) = &mut self.pending else { return Err(ask) };
        if self.stop.is_some() || pending.ask.class == Class::Stop {
            return Err(ask);
        }
        match (pending.ticket, pending.sent) {
            // It is recalled, not overtaken.
            (Some(_), false) if pending.attempts == 0 => return Err(ask),
            (Some(waiting), false) => {
                let pending = *pending;
                self.pending = None;
                self.suspect(now, &pending, true);
                self.end(Some(waiting), Err(Failure::Silent));
                self.start(now, Some(ticket), ask);
            }
            (Some(_), true) => {
                pending.doubts.cut_short = true;
                self.stop = Some((ticket, ask));
            }
            (None, _) => {
                let probe = *pending;
                self.pending = None;
                self.suspect(now, &probe, true);
                self.start(now, Some(ticket), ask);
            }
        }
        Ok(())
    }

    fn start(&mut self, now: Instant, ticket: Option<Ticket>, ask: Ask) {
        let mut ambiguous = 0;
        // After a lost MST another MST is the same request, and nothing but stops was sent since.
        if self.suspicious && ask.request.opcode != Opcode::Mst {
            let opcode = ask.request.opcode.number();
            let of_module = |s: &&Suspect| s.module == ask.request.address;
            if let Some(suspect) = self.suspects.iter().flatten().find(of_module) {
                ambiguous = suspect.owes(now).filter(|tag| *tag == opcode).count() as u8;
            }
        }
        self.pending = Some(Pending::new(now, ticket, ask, ambiguous));
    }

    fn judge(&mut self, now: Instant, reply: Reply, soon: bool) {
        let Some(pending) = self.pending.as_mut().filter(|pending| pending.sent) else {
            self.unasked(&reply);
            self.older(reply.module);
            return;
        };
        let request = &pending.ask.request;
        if reply.status == Status::WrongChecksum {
            if pending.burst.is_some() {
                // One of its pieces; the next one may be whole.
                return;
            }
            self.counters.corrupt += 1;
            pending.doubts.bad_sum = true;
            pending.doubts.bad_sum_of_module = reply.module == request.address;
            pending.deadline = pending.deadline.min(now.plus_ns(GRACE_NS));
            return;
        }
        let ours = reply.module == request.address && reply.opcode == request.opcode;
        let refusal = ours && reply.status.ends_request();
        let refused = refusal && !reply.status.is_good();
        let stored = request.opcode == Opcode::ReadMemory && !refused;
        if !refusal && !stored {
            self.unasked(&reply);
            self.older(reply.module);
            return;
        }
        let soon = soon || now < pending.earliest;
        let (module, opcode, again) =
            (request.address, request.opcode.number(), pending.attempts > 1);
        // What comes too soon is believed where no earlier request could own it; that shows that the
        // line has no baud rate, unless that was believed: then somebody else asked for it.
        let probe = pending.ticket.is_none() && self.waiting.is_some();
        let proof = probe && !self.proven.holds(module);
        if soon && self.early_streak < EARLY_MAX && !proof {
            let believed = self.timely >= TIMELY_MIN;
            if again || believed || self.could_own(now, module, opcode) {
                if let Some(pending) = &mut self.pending {
                    pending.doubts.early = true;
                }
                self.counters.late += 1;
                self.counters.early += 1;
                return;
            }
            self.early_streak = EARLY_MAX;
        }
        let Some(pending) = self.pending.as_mut() else { return };
        if let Some(waiting) = self.waiting.as_mut().filter(|_| proof) {
            waiting.soon &= soon;
        }
        self.timely = if soon { 0 } else { self.timely + 1 };
        if pending.doubts.anothers && (refused || pending.ask.request.motor > 0) {
            return self.say_behind_a_probe(now);
        }
        if pending.doubts.ambiguous > 0 {
            pending.doubts.ambiguous -= 1;
            self.counters.late += 1;
            return;
        }
        if stored {
            return self.answered(now, Ok(Answer::Instruction(Instruction::of_reply(&reply))));
        }
        if refused {
            let code = reply.status.number().into();
            return self.answered(now, Err(Failure::Refused { code }));
        }
        if let Some(ticket) = pending.ticket {
            self.events.push(To::Ticket(ticket), Ok(Answer::Reply(reply)));
        }
        self.close(now);
    }

    /// Any other answer than the usual reply.
    #[cold]
    fn answered(&mut self, now: Instant, answer: Result<Answer, Failure>) {
        let Some(pending) = &self.pending else { return };
        self.end(pending.ticket, answer);
        self.close(now);
    }

    /// What is outstanding was answered: what that says of the module, and what comes next.
    fn close(&mut self, now: Instant) {
        let Some(pending) = self.pending.take() else { return };
        let (probe, module) = (pending.ticket.is_none(), pending.ask.request.address);
        let doubtful = pending.attempts > 1 || pending.doubts.bad_sum || pending.burst.is_some();
        self.heard.add(module);
        if self.early_streak < EARLY_MAX || self.timely >= TIMELY_MIN {
            self.early_streak = 0;
        }
        self.counters.answered += 1;
        if probe && pending.burst.is_none() {
            self.trust(module);
        } else if doubtful {
            self.suspect(now, &pending, true);
        }
        if probe && self.waiting.is_some() {
            return self.proved(now);
        }
        if pending.ask.request.opcode != Opcode::Mst && self.waiting.is_none() {
            self.stops_are_past(module);
        }
        self.next(now);
    }

    #[cold]
    fn event(&mut self, reply: Reply) {
        if self.events.room() > ROOM_MIN {
            self.events.push(To::Address(reply.module.into()), Ok(Answer::Event(reply)));
        } else {
            self.counters.foreign += 1;
        }
    }

    /// No answer in time.
    fn expired(&mut self, now: Instant) {
        let Some(mut pending) = self.pending.take() else { return };
        self.unheard(now, &pending);
        if pending.doubts.early {
            self.early_streak = (self.early_streak + 1).min(EARLY_MAX);
        }
        let resendable = matches!(pending.ask.class, Class::Idempotent | Class::Stop);
        let attempts = if self.knows(pending.ask.request.address) { ATTEMPTS_MAX } else { 2 };
        let user = pending.ticket.is_some();
        if !user && self.waiting.is_some() {
            return self.not_proved(now, &pending);
        }
        if user && resendable && pending.attempts < attempts && !pending.doubts.cut_short {
            (pending.sent, pending.plan) = (false, None);
            pending.doubts.bad_sum = false;
            pending.ready = now;
            pending.not_before = now;
            self.pending = Some(pending);
            return;
        }
        // Others answer, this one never did: it is probably not there, and a probe would only
        // make a scan slower.
        let worth = self.knows(pending.ask.request.address) || self.heard.is_empty();
        self.suspect(now, &pending, worth);
        if user {
            let damaged = pending.doubts.bad_sum && pending.doubts.bad_sum_of_module;
            // Who asked hears why it was not asked again.
            let given_up = pending.doubts.cut_short
                && pending.attempts < attempts
                && pending.ask.class == Class::Idempotent;
            self.counters.silent += u64::from(damaged || !given_up);
            let failure = match damaged {
                true => Failure::Refused { code: Status::WrongChecksum.number().into() },
                false if given_up => Failure::Cancelled,
                false => Failure::Silent,
            };
            self.end(pending.ticket, Err(failure));
        }
    }

    /// What comes next when nothing is outstanding: a stop that waits, then what it overtook, then a
    /// probe.
    #[inline]
    fn next(&mut self, now: Instant) {
        let waits = self.stop.is_some() || self.waiting.is_some();
        if self.pending.is_none() && (waits || self.suspicious) {
            self.stop_or_probe(now);
        }
    }

    #[cold]
    fn stop_or_probe(&mut self, now: Instant) {
        if let Some((ticket, ask)) = self.stop.take() {
            self.start(now, Some(ticket), ask);
        } else if let Some(waiting) = &mut self.waiting {
            let proven = self.proven.holds(waiting.ask.request.address);
            *waiting = Waiting::new(waiting.ticket, waiting.ask, proven);
            self.prove(now);
        } else if let Some(ask) = self.probe(now) {
            self.start(now, None, ask);
        }
    }

    fn probe(&mut self, now: Instant) -> Option<Ask> {
        let suspect = self.suspects.iter_mut().flatten().find(|suspect| suspect.probe_due)?;
        suspect.probe_due = false;
        let is_free = |opcode: Opcode| suspect.owes(now).all(|tag| tag != opcode.number());
        let (opcode, kind) = PROBES.into_iter().find(|(opcode, _)| is_free(*opcode))?;
        suspect.probes += 1;
        let request = Request { address: suspect.module, opcode, kind, motor: 0, value: 0 };
        Some(Ask { request, class: Class::Idempotent })
    }

    fn knows(&self, module: u8) -> bool {
        self.heard.holds(module)
    }

    fn end(&mut self, ticket: Option<Ticket>, result: Result<Answer, Failure>) {
        if let Some(ticket) = ticket {
            self.events.push(To::Ticket(ticket), result);
        }
    }
}

fn is_event(reply: &Reply) -> bool {
    reply.status == Status::Event && reply.opcode == Opcode::PositionReached
}
