//! One open request for each drive, many drives at once: deadlines, repeats, refusals.
//!
//! A reply repeats the first four bytes of its request and, for settings, the value. It has no number, so
//! it belongs to the oldest request of its drive that it matches. After a missing reply the drive is *in
//! doubt* by the rule in `proto/reply_ledger`, and its replies differ by command word.

use super::fault::{ENCODER, OUTPUT_OFF};
use super::interpretation::{Interpretation, ReplyFormat};
use super::node::NodeTable;
use super::wire::{
    CommandKind, CommandWord, DriveMessage, HeaderlessReport, REFUSED, Reply, ReportFrame, Request,
};
use crate::error::Failure;
use crate::proto::event_ring::EventRing;
use crate::proto::reply_ledger::LATEST_TIMEOUTS;
use crate::station::{Counters, EventSubject, HostEvent, LineEvent, RequestClass, Ticket};
use crate::time::{Instant, earliest};

/// Times an idempotent request or a stop is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Requests outstanding at a time at most.
pub const PENDING_MAX: usize = 16;
/// Places among them that only stops take.
const STOP_SLOTS: usize = 4;
/// Events that wait to be taken at most; before that, nothing new is accepted.
pub const EVENTS_MAX: usize = 64;
/// Places among them kept for the ends of requests.
const EVENT_ROOM_MIN: usize = 2 * PENDING_MAX;

/// A request to one drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostRequest {
    /// The drive's id.
    pub id: u8,
    /// The request.
    pub request: Request,
    /// True if it may be sent again.
    pub class: RequestClass,
    /// Interpretation of the drive's manual.
    pub interpretation: Interpretation,
}

impl crate::station::Request for HostRequest {
    fn class(&self) -> RequestClass {
        self.class
    }
}

/// A reply of a drive, or a message that it sent by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// The usual reply.
    Reply(Reply),
    /// A report with a header.
    Report(ReportFrame),
    /// A report without one.
    Headerless(HeaderlessReport),
    /// The drive has replies switched off (VM): a fault word that was read after the request shows that the
    /// output is on.
    Proven,
    /// A stop was refused, and the fault word shows that the output is off.
    OutputOff {
        /// The fault word.
        faults: u16,
    },
}

/// Stage of a request to a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RequestStage {
    /// The request itself.
    Request,
    /// EF, for the reason of a refusal.
    RefusalReason,
    /// EF, as proof behind a request that is not answered.
    Proof,
    /// EF behind a request of which no attempt was answered: the replies may be switched off.
    SilenceTest,
}

#[derive(Clone, Copy, Debug)]
struct PendingExchange {
    /// `None` for a probe or what feeds a watchdog.
    ticket: Option<Ticket>,
    host_request: HostRequest,
    stage: RequestStage,
    attempts: u8,
    sent: bool,
    /// Time of the last transmission: the oldest is answered first.
    sent_at: Instant,
    deadline: Instant,
    /// Refusals, reports or values that may still come for older requests of this command.
    stale_replies: u8,
    /// A stop is out: no further attempt.
    no_retry: bool,
    /// A reply was damaged that may have been its own.
    reply_damaged: bool,
}

impl PendingExchange {
    fn outgoing_request(&self) -> Request {
        match self.stage {
            RequestStage::Request => self.host_request.request,
            RequestStage::RefusalReason | RequestStage::Proof | RequestStage::SilenceTest => {
                Request::without_value(CommandWord::EF)
            }
        }
    }

    fn enter_stage(&mut self, stage: RequestStage) {
        (self.stage, self.attempts, self.sent, self.stale_replies) = (stage, 0, false, 0);
    }
}

/// Shortest time of a request and its reply. An earlier reply is the second copy of an older
/// reply, which a disturbed last bit makes its sender repeat.
#[derive(Clone, Copy, Debug)]
pub struct MinExchangeTime {
    /// The shortest request, and its reply.
    pub base_ns: u64,
    /// Additional time for requests with a value, ns.
    pub value_extra_ns: u64,
}

impl MinExchangeTime {
    fn for_request(self, out: &Request) -> u64 {
        self.base_ns + if out.data.is_some() { self.value_extra_ns } else { 0 }
    }
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    timeout_ns: u64,
    min_exchange: MinExchangeTime,
    pending: [Option<PendingExchange>; PENDING_MAX],
    nodes: NodeTable,
    events: EventRing<Answer, EVENTS_MAX>,
    link_up: bool,
    pub(super) counters: Counters,
}

impl Session {
    /// A session without requests.
    #[must_use]
    pub fn new(timeout_ms: u32, min_exchange: MinExchangeTime) -> Self {
        Self {
            min_exchange,
            timeout_ns: u64::from(timeout_ms.max(1)) * 1_000_000,
            pending: [None; PENDING_MAX],
            nodes: NodeTable::new(),
            events: EventRing::new(),
            link_up: true,
            counters: Counters::default(),
        }
    }

    pub(super) fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        if self.events.room() <= EVENT_ROOM_MIN {
            return Err(request);
        }
        if !self.link_up {
            self.events.push(EventSubject::Request(ticket), Err(Failure::LinkDown));
            return Ok(());
        }
        self.nodes.renew_lease(request.id, now);
        let stop = request.class == RequestClass::Stop;
        if stop {
            self.overtake_pending(now, request.id);
        } else if self.nodes.get_mut(request.id).is_in_doubt(now) {
            self.start_probes(now);
            return Err(request);
        }
        let busy = self.pending.iter().flatten().filter(|p| p.host_request.id == request.id);
        let blocked = if stop {
            busy.filter(|p| p.host_request.class == RequestClass::Stop && p.ticket.is_some())
                .count()
                > 0
        } else {
            busy.count() > 0
        };
        if blocked || !self.start_request(now, Some(ticket), request) {
            Err(request)
        } else {
            Ok(())
        }
    }

    #[inline]
    pub(super) fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.events.next()
    }

    /// The next request to put on the bus: stops first.
    pub(super) fn transmit(&mut self, now: Instant) -> Option<(u8, Request)> {
        let stop = self.pending.iter().position(|p| is_unsent(p) && is_pending_stop(p));
        let n = stop.or_else(|| self.pending.iter().position(is_unsent))?;
        let deadline = now.plus_ns(self.timeout_ns);
        let pending = self.pending[n].as_mut()?;
        let (id, request) = (pending.host_request.id, pending.outgoing_request());
        self.counters.sent += 1;
        self.counters.resent += u64::from(pending.attempts > 0);
        pending.attempts += 1;
        (pending.sent, pending.sent_at, pending.deadline) = (true, now, deadline);
        let node = self.nodes.get_mut(id);
        node.last_sent = now;
        if pending.stage == RequestStage::Request
            && request.command.is_output()
            && node.reply_format == ReplyFormat::Silent
        {
            pending.enter_stage(RequestStage::Proof);
        }
        Some((id, request))
    }

    /// Returns whether a drive stops that is not spoken to.
    pub(super) fn needs_feeding(&self) -> bool {
        self.nodes.needs_feeding()
    }

    /// A frame of a drive that has no valid form. It may have been the reply to any request that is out.
    pub(super) fn handle_damaged(&mut self, id: u8) {
        self.counters.foreign += 1;
        self.pending
            .iter_mut()
            .flatten()
            .filter(|p| p.host_request.id == id && p.sent)
            .for_each(|p| p.reply_damaged = true);
    }

    /// Handles a message of a drive.
    pub(super) fn handle_message(&mut self, id: u8, message: DriveMessage, now: Instant) {
        match message {
            DriveMessage::Reply(reply) => self.handle_reply(now, id, reply),
            DriveMessage::Report(report) => {
                // The first word of part 2 is the fault word (thruster manual, report frames).
                let status = if report.part == 2 { report.words[0] } else { 0 };
                let last = match self.nodes.get_mut(id).reply_format {
                    ReplyFormat::Frames(mask) => mask >> report.part == 0,
                    _ => true,
                };
                self.push_unsolicited(id, Answer::Report(report));
                let n = self
                    .oldest_output_request(now, id, |p| {
                        p.host_request.request.command.0.to_be_bytes()[0] == report.source
                    })
                    .filter(|_| last);
                self.finish_output_request(now, n, Answer::Report(report), status);
            }
            DriveMessage::Headerless(bare) => {
                let n = self.oldest_output_request(now, id, |_| true);
                if n.is_none() && self.nodes.get_mut(id).reply_format != ReplyFormat::Headerless {
                    self.counters.foreign += 1;
                    return;
                }
                self.push_unsolicited(id, Answer::Headerless(bare));
                self.finish_output_request(now, n, Answer::Headerless(bare), bare.status);
            }
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        for n in 0..PENDING_MAX {
            if self.pending[n].is_some_and(|p| p.sent && now >= p.deadline) {
                self.handle_reply_timeout(now, n);
            }
        }
        self.start_probes(now);
        while let Some((id, readings)) = self.nodes.next_to_feed(now) {
            let request = Request::without_value(CommandWord::EF);
            let host_request = HostRequest {
                id,
                request,
                class: RequestClass::Idempotent,
                interpretation: readings,
            };
            let busy = self.pending.iter().flatten().any(|p| p.host_request.id == id);
            // Counted as sent even where a request is under way: that one feeds the stop time as well.
            self.nodes.get_mut(id).last_sent = now;
            if !busy {
                self.start_request(now, None, host_request);
            }
        }
    }

    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let pending = self
            .pending
            .iter()
            .flatten()
            .map(|p| if p.sent { p.deadline } else { p.sent_at })
            .min();
        earliest(pending, self.nodes.next_due())
    }

    pub(super) fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.link_up = match event {
            LineEvent::Down | LineEvent::BusOff => false,
            LineEvent::Up => true,
            LineEvent::Break | LineEvent::Rate(_) => self.link_up,
        };
        if self.link_up {
            return;
        }
        for n in 0..PENDING_MAX {
            if let Some(pending) = self.pending[n].take() {
                self.note_doubt(now, &pending);
                self.finish_ticket(pending.ticket, Err(Failure::LinkDown));
            }
        }
        self.nodes.clear_stop_timeouts();
    }

    /// Makes way for a stop: an unsent request is given up, a sent one is not repeated.
    fn overtake_pending(&mut self, now: Instant, id: u8) {
        for n in 0..PENDING_MAX {
            let Some(pending) = self.pending[n].as_mut() else { continue };
            if pending.host_request.id != id || pending.host_request.class == RequestClass::Stop {
                continue;
            }
            // On the wire already; its reply still belongs to it, but it is not sent again behind the stop.
            pending.no_retry = true;
            if pending.sent {
                continue;
            }
            let pending = *pending;
            self.pending[n] = None;
            self.note_doubt(now, &pending);
            let never = pending.attempts == 0 && pending.stage == RequestStage::Request;
            let failure = if never { Failure::Cancelled } else { Failure::Silent };
            self.finish_ticket(pending.ticket, Err(failure));
        }
    }

    /// Takes a place for a request, if there is one.
    fn start_request(
        &mut self,
        now: Instant,
        ticket: Option<Ticket>,
        request: HostRequest,
    ) -> bool {
        // Readers never take the last places, so a stop has one in any case.
        let stored = if request.class == RequestClass::Stop { 0 } else { STOP_SLOTS };
        let free = self.pending.iter().filter(|p| p.is_none()).count();
        let index = self.pending.iter().position(Option::is_none).filter(|_| free > stored);
        let Some(n) = index else { return false };
        debug_assert!(self.pending[n].is_none(), "the place is free");
        let ambiguous =
            self.nodes.get_mut(request.id).outstanding.count(now, request.request.command);
        self.pending[n] = Some(PendingExchange {
            ticket,
            host_request: request,
            stage: RequestStage::Request,
            attempts: 0,
            sent: false,
            sent_at: now,
            deadline: now,
            stale_replies: ambiguous,
            no_retry: false,
            reply_damaged: false,
        });
        true
    }

    /// Probes drives in doubt, where no request is pending.
    fn start_probes(&mut self, now: Instant) {
        for _ in 0..PENDING_MAX {
            let busy = |id| self.pending.iter().flatten().any(|p| p.host_request.id == id);
            let Some((id, command)) = self.nodes.next_probe(now, busy) else { return };
            let (request, readings) = (Request::without_value(command), Interpretation::default());
            let host_request = HostRequest {
                id,
                request,
                class: RequestClass::Idempotent,
                interpretation: readings,
            };
            if !self.start_request(now, None, host_request) {
                return;
            }
        }
    }

    /// The oldest request of a drive that is out and fits.
    fn oldest_matching(
        &self,
        now: Instant,
        id: u8,
        fits: impl Fn(&PendingExchange) -> bool,
    ) -> Option<usize> {
        let out = self.pending.iter().enumerate();
        let out = out.filter_map(|(n, p)| p.as_ref().map(|p| (n, p)));
        let out = out.filter(|(_, p)| p.host_request.id == id && p.sent && fits(p));
        let out = out.filter(|(_, p)| {
            // A frame that arrives before both frames are sent answers an older request (REQ-5).
            now >= p.sent_at.plus_ns(self.min_exchange.for_request(&p.outgoing_request()))
        });
        out.min_by_key(|(_, p)| p.sent_at).map(|(n, _)| n)
    }

    /// The oldest TC or VC of a drive that is out and that such a report fits.
    fn oldest_output_request(
        &self,
        now: Instant,
        id: u8,
        fits: impl Fn(&PendingExchange) -> bool,
    ) -> Option<usize> {
        self.oldest_matching(now, id, |p| is_output_request(p) && fits(p))
    }

    fn handle_reply(&mut self, now: Instant, id: u8, reply: Reply) {
        let found = self
            .oldest_matching(now, id, |p| {
                is_same_command(&p.outgoing_request(), &reply.command, reply.sub)
                    && is_echo(&p.outgoing_request(), reply.data)
            })
            .or_else(|| {
                self.oldest_matching(now, id, |p| {
                    is_same_command(&p.outgoing_request(), &reply.command, reply.sub)
                        && may_answer(&p.outgoing_request(), reply.data)
                })
            });
        if reply.command.is_output() {
            self.forget_observed_silence(id);
        }
        let Some(n) = found else { return self.handle_unexpected(now, id, reply) };
        let Some(pending) = self.pending[n].as_mut() else { return };
        let out = pending.outgoing_request();
        let query = matches!(out.command.definition(), Some((CommandKind::Query, _)));
        let echo = is_echo(&out, reply.data);
        if pending.stale_replies > 0 && !echo {
            pending.stale_replies -= 1;
            self.counters.late += 1;
            return;
        }
        match pending.stage {
            RequestStage::Request if reply.data == REFUSED && query => {
                let failure = Failure::Refused { code: REFUSED };
                self.finish_with_answer(now, n, Err(failure));
            }
            RequestStage::Request if !query && !echo => {
                self.counters.answered += 1;
                // EE EE has no reason; the fault word has it (THRUSTER-1).
                pending.enter_stage(RequestStage::RefusalReason);
                pending.sent_at = now;
            }
            RequestStage::Request => {
                self.note_setting(now, n, &out);
                self.finish_with_answer(now, n, Ok(Answer::Reply(reply)));
            }
            RequestStage::RefusalReason | RequestStage::Proof | RequestStage::SilenceTest => {
                self.handle_fault_word(now, n, reply)
            }
        }
    }

    /// A drive that answers TC or VC has its replies switched on.
    fn forget_observed_silence(&mut self, id: u8) {
        let node = self.nodes.get_mut(id);
        if core::mem::take(&mut node.is_silence_observed) {
            node.reply_format = ReplyFormat::default();
        }
    }

    /// EF was answered, behind a refusal or as a proof.
    fn handle_fault_word(&mut self, now: Instant, n: usize, reply: Reply) {
        let Some(pending) = self.pending[n] else { return };
        self.push_unsolicited(pending.host_request.id, Answer::Reply(reply));
        if pending.stage == RequestStage::SilenceTest {
            let node = self.nodes.get_mut(pending.host_request.id);
            (node.reply_format, node.is_silence_observed) = (ReplyFormat::Silent, true);
        }
        let faults = reply.data as u16;
        let stop = pending.host_request.class == RequestClass::Stop;
        let failure = Failure::Faulted { code: faults.into() };
        let blocked = faults & (OUTPUT_OFF | ENCODER) != 0;
        let result = match pending.stage {
            // Refused, and still what the stop was for: there is no output.
            _ if stop && faults & OUTPUT_OFF != 0 => Ok(Answer::OutputOff { faults }),
            // A request that the bus doubled is answered twice: the damaged reply may have confirmed the first.
            RequestStage::RefusalReason
                if pending.reply_damaged && pending.host_request.class == RequestClass::NoRetry =>
            {
                Err(Failure::Misbehaved)
            }
            RequestStage::Proof | RequestStage::SilenceTest if faults & OUTPUT_OFF != 0 => {
                Err(failure)
            }
            RequestStage::Proof | RequestStage::SilenceTest => Ok(Answer::Proven),
            _ if blocked => Err(failure),
            _ => Err(Failure::Refused { code: REFUSED }),
        };
        self.finish_with_answer(now, n, result);
    }

    /// A report answers the output request at `n`, if there is one.
    fn finish_output_request(
        &mut self,
        now: Instant,
        n: Option<usize>,
        answer: Answer,
        status: u16,
    ) {
        let Some(n) = n else { return };
        let Some(pending) = self.pending[n].as_mut() else { return };
        if pending.stale_replies > 0 {
            pending.stale_replies -= 1;
            self.counters.late += 1;
            return;
        }
        let off = status & OUTPUT_OFF != 0 && pending.host_request.class != RequestClass::Stop;
        let code = status.into();
        self.finish_with_answer(
            now,
            n,
            if off { Err(Failure::Faulted { code }) } else { Ok(answer) },
        );
    }

    /// VM and ST change how the host must talk to the drive.
    fn note_setting(&mut self, now: Instant, n: usize, out: &Request) {
        let Some(PendingExchange { host_request, .. }) = self.pending[n] else { return };
        let value = out.value() as u16;
        match out.command {
            CommandWord::VM => {
                let node = self.nodes.get_mut(host_request.id);
                node.reply_format = host_request.interpretation.reply_format(value);
                node.is_silence_observed = false;
            }
            CommandWord::ST => self.nodes.set_stop_timeout(host_request.id, value, now),
            _ => {}
        }
    }

    /// A whole, valid reply that nothing waits for: a stream of the drive's own, or a late one.
    fn handle_unexpected(&mut self, now: Instant, id: u8, reply: Reply) {
        let streamed = matches!(reply.command, CommandWord::QC | CommandWord::QV);
        if streamed && !self.nodes.get_mut(id).outstanding.may_include(now, reply.command) {
            self.push_unsolicited(id, Answer::Reply(reply))
        } else {
            self.counters.late += 1;
        }
    }

    fn push_unsolicited(&mut self, id: u8, answer: Answer) {
        if self.events.room() > EVENT_ROOM_MIN {
            self.events.push(EventSubject::Unsolicited(id.into()), Ok(answer));
        }
    }

    /// Completes the request at `n`, and updates the state of the drive.
    fn finish_with_answer(&mut self, now: Instant, n: usize, result: Result<Answer, Failure>) {
        debug_assert!(self.pending[n].is_some(), "a request ends once");
        let Some(pending) = self.pending[n].take() else { return };
        self.counters.answered += 1;
        let node = self.nodes.get_mut(pending.host_request.id);
        node.has_answered = true;
        match pending.ticket {
            None => {
                if let Ok(answer) = result {
                    self.push_unsolicited(pending.host_request.id, answer);
                }
                self.nodes
                    .get_mut(pending.host_request.id)
                    .clear_outstanding(now, pending.host_request.request.command);
            }
            // A request that was sent twice may be answered twice.
            Some(_) if pending.attempts > 1 => {
                self.note_doubt(
                    now,
                    &PendingExchange { attempts: pending.attempts - 1, ..pending },
                );
            }
            Some(_) => {}
        }
        self.finish_ticket(pending.ticket, result);
    }

    /// No answer in time.
    fn handle_reply_timeout(&mut self, now: Instant, n: usize) {
        let Some(mut pending) = self.pending[n] else { return };
        let again = pending.stage != RequestStage::Request
            || matches!(pending.host_request.class, RequestClass::Idempotent | RequestClass::Stop);
        let received = self.nodes.get_mut(pending.host_request.id).has_answered;
        // A drive that never answered is asked less, so that a scan of 127 addresses stays short.
        let attempts = if received { ATTEMPTS_MAX } else { 2 };
        let user = pending.ticket.is_some();
        if user && again && pending.attempts < attempts && !pending.no_retry {
            (pending.sent, pending.sent_at) = (false, now);
            self.pending[n] = Some(pending);
            return;
        }
        // No attempt was answered: an earlier host may have switched the replies off (VM), and EF has one then.
        if user && again && is_output_request(&pending) && !pending.no_retry {
            self.note_doubt(now, &pending);
            pending.enter_stage(RequestStage::SilenceTest);
            pending.sent_at = now;
            self.pending[n] = Some(pending);
            return;
        }
        self.pending[n] = None;
        self.note_doubt(now, &pending);
        // The caller gets the reason for which a read was not repeated; for a write only that its execution is unknown.
        let given_up = pending.no_retry
            && pending.attempts < attempts
            && pending.host_request.class == RequestClass::Idempotent;
        if user {
            self.counters.silent += u64::from(!given_up);
            let failure = match pending.stage {
                RequestStage::RefusalReason => Failure::Refused { code: REFUSED },
                _ if given_up => Failure::Cancelled,
                _ => Failure::Silent,
            };
            self.finish_ticket(pending.ticket, Err(failure));
        }
    }

    /// Notes that replies of `pending` may still come.
    fn note_doubt(&mut self, now: Instant, pending: &PendingExchange) {
        let until = now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns);
        let node = self.nodes.get_mut(pending.host_request.id);
        for _ in 0..pending.attempts {
            node.outstanding.add(pending.outgoing_request().command, until);
        }
        self.nodes.mark_in_doubt(pending.host_request.id);
    }

    fn finish_ticket(&mut self, ticket: Option<Ticket>, result: Result<Answer, Failure>) {
        if let Some(ticket) = ticket {
            self.events.push(EventSubject::Request(ticket), result);
        }
    }
}

fn is_same_command(out: &Request, reply_command: &CommandWord, reply_sub: u16) -> bool {
    out.command == *reply_command && out.sub == reply_sub
}

fn is_output_request(p: &PendingExchange) -> bool {
    p.stage == RequestStage::Request && p.host_request.request.command.is_output()
}

fn is_pending_stop(p: &Option<PendingExchange>) -> bool {
    p.is_some_and(|p| p.host_request.class == RequestClass::Stop)
}

fn is_unsent(p: &Option<PendingExchange>) -> bool {
    p.is_some_and(|p| !p.sent)
}

/// Returns whether a reply can belong to this request: refused TC and VC may have another reply.
fn may_answer(out: &Request, data: u32) -> bool {
    match out.command.definition() {
        Some((CommandKind::Set, _)) => data == REFUSED || out.command.is_output(),
        _ => true,
    }
}

/// Returns whether a reply repeats the request, in any width. VM's reply in the manual has its bytes swapped.
fn is_echo(out: &Request, data: u32) -> bool {
    let width = out.command.width();
    match (out.command, out.command.definition()) {
        (_, Some((CommandKind::Query, _))) => false,
        _ if data == REFUSED => false,
        (CommandWord::VM, _) => data <= 0xFFFF,
        (CommandWord::SP, _) => out.data == Some(data),
        (_, Some((CommandKind::Set, _))) => width.decode(out.value()) == width.decode(data),
        _ => true,
    }
}
