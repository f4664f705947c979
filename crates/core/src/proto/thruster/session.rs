//! One request outstanding per drive, many drives at once: deadlines, retries, what a refusal means.
//!
//! A reply repeats the request's first four bytes and, to what is set, its value; it has no number.
//! So it belongs to the oldest request of that drive that it fits. After silence the drive is *in
//! doubt*: nothing but a stop is asked of it until a query of another command was answered, since a
//! drive answers in order, or until the latest possible reply is past.

use super::fault::{ENCODER, OUTPUT_OFF};
use super::node::Nodes;
use super::readings::{Form, Readings};
use super::wire::{Bare, Command, Heard, REFUSED, Reply, Report, Request, Shape};
use crate::error::Failure;
use crate::proto::events::Events;
use crate::station::{Class, Counters, Event, LineEvent, Ticket, To};
use crate::time::{Instant, earliest};

/// Times an idempotent request or a stop is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Requests outstanding at a time at most.
pub const PENDING_MAX: usize = 16;
/// Places among them that only stops take.
const STOP_PLACES: usize = 4;
/// Events that wait to be taken at most; before that, nothing new is accepted.
pub const EVENTS_MAX: usize = 64;
/// Places among them kept for the ends of requests.
const ROOM_MIN: usize = 2 * PENDING_MAX;
/// A reply is possible for so many times the reply timeout after its request.
const LATEST_TIMEOUTS: u64 = 3;

/// A request to one drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ask {
    /// The drive's id.
    pub id: u8,
    /// What is sent.
    pub request: Request,
    /// Whether it may be sent again.
    pub class: Class,
    /// How the drive's manual is read.
    pub readings: Readings,
}

impl crate::station::Request for Ask {
    fn class(&self) -> Class {
        self.class
    }
}

/// What a drive answers, or tells unasked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// The usual reply.
    Reply(Reply),
    /// A report with a header.
    Report(Report),
    /// A report without one.
    Bare(Bare),
    /// It was told not to answer (VM): a fault word that was read behind the request says that the
    /// output is free.
    Proven,
    /// A stop was refused, and the fault word says that there is no output.
    Off {
        /// The fault word.
        faults: u16,
    },
}

/// What is being asked of a drive now.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    /// The request itself.
    Asking,
    /// EF, for the reason of a refusal.
    Reason,
    /// EF, as proof behind a request that is not answered.
    Proof,
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    /// `None` for a probe or what feeds a watchdog.
    ticket: Option<Ticket>,
    ask: Ask,
    stage: Stage,
    attempts: u8,
    sent: bool,
    /// When it was last sent: the oldest is answered first.
    at: Instant,
    deadline: Instant,
    /// Refusals, reports or values that may still come for older requests of this command.
    ambiguous: u8,
    /// A stop is out: no further attempt.
    cut_short: bool,
}

impl Pending {
    fn outgoing(&self) -> Request {
        match self.stage {
            Stage::Asking => self.ask.request,
            Stage::Reason | Stage::Proof => Request::plain(Command::EF),
        }
    }

    fn turn_to(&mut self, stage: Stage) {
        (self.stage, self.attempts, self.sent, self.ambiguous) = (stage, 0, false, 0);
    }
}

/// A request and its reply take at least so long. What comes sooner is the second copy of an older
/// reply, which a disturbed last bit makes its sender repeat.
#[derive(Clone, Copy, Debug)]
pub struct Soonest {
    /// The shortest request, and its reply.
    pub plain_ns: u64,
    /// So much more where the request has a value.
    pub value_ns: u64,
}

impl Soonest {
    fn after(self, out: &Request) -> u64 {
        self.plain_ns + if out.data.is_some() { self.value_ns } else { 0 }
    }
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    timeout_ns: u64,
    soonest: Soonest,
    pending: [Option<Pending>; PENDING_MAX],
    nodes: Nodes,
    events: Events<Answer, EVENTS_MAX>,
    up: bool,
    pub(super) counters: Counters,
}

impl Session {
    /// Nothing asked yet.
    #[must_use]
    pub fn new(timeout_ms: u32, soonest: Soonest) -> Self {
        Self {
            soonest,
            timeout_ns: u64::from(timeout_ms.max(1)) * 1_000_000,
            pending: [None; PENDING_MAX],
            nodes: Nodes::new(),
            events: Events::new(),
            up: true,
            counters: Counters::default(),
        }
    }

    pub(super) fn submit(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        if self.events.room() <= ROOM_MIN {
            return Err(ask);
        }
        if !self.up {
            self.events.push(To::Ticket(ticket), Err(Failure::LinkDown));
            return Ok(());
        }
        self.nodes.renew(ask.id, now);
        let stop = ask.class == Class::Stop;
        if stop {
            self.overtake(now, ask.id);
        } else if self.nodes.get_mut(ask.id).is_in_doubt(now) {
            self.start_probes(now);
            return Err(ask);
        }
        let of_node = |p: &&Pending| p.ask.id == ask.id;
        let busy = self.pending.iter().flatten().filter(of_node);
        let blocked = match stop {
            false => busy.count() > 0,
            true => busy.filter(|p| p.ask.class == Class::Stop && p.ticket.is_some()).count() > 0,
        };
        if blocked || !self.start(now, Some(ticket), ask) { Err(ask) } else { Ok(()) }
    }

    #[inline]
    pub(super) fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.events.next()
    }

    /// The next request to put on the bus: stops first.
    pub(super) fn transmit(&mut self, now: Instant) -> Option<(u8, Request)> {
        let unsent = |p: &Option<Pending>| p.is_some_and(|p| !p.sent);
        let is_stop = |p: &Option<Pending>| p.is_some_and(|p| p.ask.class == Class::Stop);
        let stop = self.pending.iter().position(|p| unsent(p) && is_stop(p));
        let n = stop.or_else(|| self.pending.iter().position(unsent))?;
        let deadline = now.plus_ns(self.timeout_ns);
        let pending = self.pending[n].as_mut()?;
        let (id, request) = (pending.ask.id, pending.outgoing());
        self.counters.sent += 1;
        self.counters.resent += u64::from(pending.attempts > 0);
        pending.attempts += 1;
        (pending.sent, pending.at, pending.deadline) = (true, now, deadline);
        let node = self.nodes.get_mut(id);
        node.fed = now;
        if pending.stage == Stage::Asking
            && request.command.is_output()
            && node.form == Form::Silent
        {
            pending.turn_to(Stage::Proof);
        }
        Some((id, request))
    }

    /// Whether a drive stops that is not spoken to.
    pub(super) fn feeds(&self) -> bool {
        self.nodes.feeds()
    }

    /// Takes what a drive says.
    pub(super) fn heard(&mut self, id: u8, heard: Heard, now: Instant) {
        match heard {
            Heard::Reply(reply) => self.reply(now, id, reply),
            Heard::Report(report) => {
                let of = |p: &Pending| p.ask.request.command.0.to_be_bytes()[0] == report.of;
                let status = if report.part == 2 { report.words[0] } else { 0 };
                let last = match self.nodes.get_mut(id).form {
                    Form::Frames(mask) => mask >> report.part == 0,
                    _ => true,
                };
                self.unasked(id, Answer::Report(report));
                let n = self.reported(now, id, of).filter(|_| last);
                self.output_set(now, n, Answer::Report(report), status);
            }
            Heard::Bare(bare) => {
                let n = self.reported(now, id, |_| true);
                if n.is_none() && self.nodes.get_mut(id).form != Form::Headerless {
                    self.counters.foreign += 1;
                    return;
                }
                self.unasked(id, Answer::Bare(bare));
                self.output_set(now, n, Answer::Bare(bare), bare.status);
            }
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        for n in 0..PENDING_MAX {
            if self.pending[n].is_some_and(|p| p.sent && now >= p.deadline) {
                self.expired(now, n);
            }
        }
        self.start_probes(now);
        while let Some((id, readings)) = self.nodes.hungry(now) {
            let request = Request::plain(Command::EF);
            let ask = Ask { id, request, class: Class::Idempotent, readings };
            let busy = self.pending.iter().flatten().any(|p| p.ask.id == id);
            self.nodes.get_mut(id).fed = now;
            if !busy {
                self.start(now, None, ask);
            }
        }
    }

    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let due = |p: &Pending| if p.sent { p.deadline } else { p.at };
        let pending = self.pending.iter().flatten().map(due).min();
        earliest(pending, self.nodes.next())
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
        for n in 0..PENDING_MAX {
            if let Some(pending) = self.pending[n].take() {
                self.doubt(now, &pending);
                self.end(pending.ticket, Err(Failure::LinkDown));
            }
        }
        self.nodes.unwatch();
    }

    /// A stop comes: what was not sent yet is given up, what is out gets no further attempt.
    fn overtake(&mut self, now: Instant, id: u8) {
        for n in 0..PENDING_MAX {
            let Some(pending) = self.pending[n].as_mut() else { continue };
            if pending.ask.id != id || pending.ask.class == Class::Stop {
                continue;
            }
            pending.cut_short = true;
            if pending.sent {
                continue;
            }
            let pending = *pending;
            self.pending[n] = None;
            self.doubt(now, &pending);
            let never = pending.attempts == 0 && pending.stage == Stage::Asking;
            let failure = if never { Failure::Cancelled } else { Failure::Silent };
            self.end(pending.ticket, Err(failure));
        }
    }

    /// Takes a place for a request, if there is one.
    fn start(&mut self, now: Instant, ticket: Option<Ticket>, ask: Ask) -> bool {
        let kept = if ask.class == Class::Stop { 0 } else { STOP_PLACES };
        let free = self.pending.iter().filter(|p| p.is_none()).count();
        let place = self.pending.iter().position(Option::is_none).filter(|_| free > kept);
        let Some(n) = place else { return false };
        let ambiguous = self.nodes.get_mut(ask.id).owed(ask.request.command);
        self.pending[n] = Some(Pending {
            ticket,
            ask,
            stage: Stage::Asking,
            attempts: 0,
            sent: false,
            at: now,
            deadline: now,
            ambiguous,
            cut_short: false,
        });
        true
    }

    /// Asks drives in doubt something else, where nothing is out.
    fn start_probes(&mut self, now: Instant) {
        for _ in 0..PENDING_MAX {
            let busy = |id| self.pending.iter().flatten().any(|p| p.ask.id == id);
            let Some((id, command)) = self.nodes.probe(now, busy) else { return };
            let (request, readings) = (Request::plain(command), Readings::default());
            let ask = Ask { id, request, class: Class::Idempotent, readings };
            if !self.start(now, None, ask) {
                return;
            }
        }
    }

    /// The oldest request of a drive that is out and fits.
    fn oldest(&self, now: Instant, id: u8, fits: impl Fn(&Pending) -> bool) -> Option<usize> {
        let out = self.pending.iter().enumerate();
        let out = out.filter_map(|(n, p)| p.as_ref().map(|p| (n, p)));
        let out = out.filter(|(_, p)| p.ask.id == id && p.sent && fits(p));
        let out = out.filter(|(_, p)| now >= p.at.plus_ns(self.soonest.after(&p.outgoing())));
        out.min_by_key(|(_, p)| p.at).map(|(n, _)| n)
    }

    /// The oldest TC or VC of a drive that is out and that such a report fits.
    fn reported(&self, now: Instant, id: u8, fits: impl Fn(&Pending) -> bool) -> Option<usize> {
        let output = |p: &Pending| p.stage == Stage::Asking && p.ask.request.command.is_output();
        self.oldest(now, id, |p| output(p) && fits(p))
    }

    fn reply(&mut self, now: Instant, id: u8, reply: Reply) {
        let same = |out: &Request| out.command == reply.command && out.sub == reply.sub;
        let exact = |p: &Pending| same(&p.outgoing()) && is_echo(&p.outgoing(), reply.data);
        let fits = |p: &Pending| same(&p.outgoing()) && fits(&p.outgoing(), reply.data);
        let found = self.oldest(now, id, exact).or_else(|| self.oldest(now, id, fits));
        let Some(n) = found else { return self.extra(id, reply) };
        let Some(pending) = self.pending[n].as_mut() else { return };
        let out = pending.outgoing();
        let query = matches!(out.command.known(), Some((Shape::Query, _)));
        let echo = is_echo(&out, reply.data);
        if pending.ambiguous > 0 && !echo {
            pending.ambiguous -= 1;
            self.counters.late += 1;
            return;
        }
        match pending.stage {
            Stage::Asking if reply.data == REFUSED && query => {
                let failure = Failure::Refused { code: REFUSED };
                self.answered(now, n, Err(failure));
            }
            Stage::Asking if !query && !echo => {
                self.counters.answered += 1;
                pending.turn_to(Stage::Reason);
                pending.at = now;
            }
            Stage::Asking => {
                self.note_setting(now, n, &out);
                self.answered(now, n, Ok(Answer::Reply(reply)));
            }
            Stage::Reason | Stage::Proof => self.explained(now, n, reply),
        }
    }

    /// EF was answered, behind a refusal or as a proof.
    fn explained(&mut self, now: Instant, n: usize, reply: Reply) {
        let Some(pending) = self.pending[n] else { return };
        self.unasked(pending.ask.id, Answer::Reply(reply));
        let faults = reply.data as u16;
        let stop = pending.ask.class == Class::Stop;
        let told = Failure::Faulted { code: faults.into() };
        let blocked = faults & (OUTPUT_OFF | ENCODER) != 0;
        let result = match pending.stage {
            _ if stop && faults & OUTPUT_OFF != 0 => Ok(Answer::Off { faults }),
            Stage::Proof if faults & OUTPUT_OFF != 0 => Err(told),
            Stage::Proof => Ok(Answer::Proven),
            _ if blocked => Err(told),
            _ => Err(Failure::Refused { code: REFUSED }),
        };
        self.answered(now, n, result);
    }

    /// A report answers the output request at `n`, if there is one.
    fn output_set(&mut self, now: Instant, n: Option<usize>, answer: Answer, status: u16) {
        let Some(n) = n else { return };
        let Some(pending) = self.pending[n].as_mut() else { return };
        if pending.ambiguous > 0 {
            pending.ambiguous -= 1;
            self.counters.late += 1;
            return;
        }
        let off = status & OUTPUT_OFF != 0 && pending.ask.class != Class::Stop;
        let code = status.into();
        self.answered(now, n, if off { Err(Failure::Faulted { code }) } else { Ok(answer) });
    }

    /// VM and ST change how the drive is to be spoken with.
    fn note_setting(&mut self, now: Instant, n: usize, out: &Request) {
        let Some(Pending { ask, .. }) = self.pending[n] else { return };
        let value = out.data.unwrap_or(0) as u16;
        match out.command {
            Command::VM => self.nodes.get_mut(ask.id).form = ask.readings.form(value),
            Command::ST => self.nodes.watch(ask.id, value, now),
            _ => {}
        }
    }

    /// A whole, valid reply that nothing waits for: a stream of the drive's own, or a late one.
    fn extra(&mut self, id: u8, reply: Reply) {
        let streamed = matches!(reply.command, Command::QC | Command::QV);
        match streamed && self.nodes.get_mut(id).owed(reply.command) == 0 {
            true => self.unasked(id, Answer::Reply(reply)),
            false => self.counters.late += 1,
        }
    }

    fn unasked(&mut self, id: u8, answer: Answer) {
        if self.events.room() > ROOM_MIN {
            self.events.push(To::Address(id.into()), Ok(answer));
        }
    }

    /// What is at `n` was answered, and what that says of the drive.
    fn answered(&mut self, now: Instant, n: usize, result: Result<Answer, Failure>) {
        let Some(pending) = self.pending[n].take() else { return };
        self.counters.answered += 1;
        let node = self.nodes.get_mut(pending.ask.id);
        node.heard = true;
        match pending.ticket {
            None => {
                if let Ok(answer) = result {
                    self.unasked(pending.ask.id, answer);
                }
                self.nodes.get_mut(pending.ask.id).trust(pending.ask.request.command);
            }
            // What was sent twice may be answered twice.
            Some(_) if pending.attempts > 1 => {
                self.doubt(now, &Pending { attempts: pending.attempts - 1, ..pending });
            }
            Some(_) => {}
        }
        self.end(pending.ticket, result);
    }

    /// No answer in time.
    fn expired(&mut self, now: Instant, n: usize) {
        let Some(mut pending) = self.pending[n] else { return };
        let again = pending.stage != Stage::Asking
            || matches!(pending.ask.class, Class::Idempotent | Class::Stop);
        let heard = self.nodes.get_mut(pending.ask.id).heard;
        let attempts = if heard { ATTEMPTS_MAX } else { 2 };
        let user = pending.ticket.is_some();
        if user && again && pending.attempts < attempts && !pending.cut_short {
            (pending.sent, pending.at) = (false, now);
            self.pending[n] = Some(pending);
            return;
        }
        self.pending[n] = None;
        self.doubt(now, &pending);
        // Who asked hears why it was not asked again; of what changes the drive only that it is
        // unknown.
        let given_up = pending.cut_short
            && pending.attempts < attempts
            && pending.ask.class == Class::Idempotent;
        if user {
            self.counters.silent += u64::from(!given_up);
            let failure = match pending.stage {
                Stage::Reason => Failure::Refused { code: REFUSED },
                _ if given_up => Failure::Cancelled,
                _ => Failure::Silent,
            };
            self.end(pending.ticket, Err(failure));
        }
    }

    /// Notes that replies of `pending` may still come.
    fn doubt(&mut self, now: Instant, pending: &Pending) {
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns);
        let node = self.nodes.get_mut(pending.ask.id);
        for _ in 0..pending.attempts {
            node.doubt(pending.outgoing().command, until);
        }
        self.nodes.doubtful(pending.ask.id);
    }

    fn end(&mut self, ticket: Option<Ticket>, result: Result<Answer, Failure>) {
        if let Some(ticket) = ticket {
            self.events.push(To::Ticket(ticket), result);
        }
    }
}

/// Whether a reply can be one to this request: TC and VC may come back as something else where they
/// are not accepted.
fn fits(out: &Request, data: u32) -> bool {
    match out.command.known() {
        Some((Shape::Set, _)) => data == REFUSED || out.command.is_output(),
        _ => true,
    }
}

/// Whether a reply repeats what was sent, in whatever width. VM's printed reply has its bytes
/// swapped.
fn is_echo(out: &Request, data: u32) -> bool {
    let width = out.command.width();
    match (out.command, out.command.known()) {
        (_, Some((Shape::Query, _))) => false,
        _ if data == REFUSED => false,
        (Command::VM, _) => data <= 0xFFFF,
        (Command::SP, _) => out.data == Some(data),
        (_, Some((Shape::Set, _))) => width.read(out.data.unwrap_or(0)) == width.read(data),
        _ => true,
    }
}
