//! Common part of both hosts: one open request, deadlines, repeats, quarantine, events.
//!
//! A reply names its module, opcode and status, but not the parameter. So a late reply to `GAP 1` looks
//! like the reply to `GAP 3`. Therefore, after a missing reply (and after a reply to a repeated request) a
//! module is *suspect*: it is in doubt by the rule in `proto/reply_ledger`, and its replies differ by
//! opcode.
//!
//! If an earlier program may have used the line, each module begins *unproven*, and becomes so again when a
//! doubt ended by time only. Several random probes of different opcodes must be answered one after another
//! before its first request, except stops. A pending reply can replace one of them only if it has this
//! opcode; then the probe's own reply arrives during the next probe, and does not match it. So a wrong
//! value needs as many pending replies as there are probes, with these opcodes in this order.

mod alignment;
mod contest;
mod download;
mod matching;
mod module_set;
mod motor_stops;
mod overtake;
mod proof;
mod suspects;

pub use super::host_request::{HostRequest, Storing};
use super::opcode::{Opcode, Status};
use super::wire::{Instruction, Reply, Request, VersionText};
use crate::error::{Failure, Unsupported};
use crate::proto::HostOptions;
use crate::proto::event_ring::EventRing;
use crate::proto::proven_addresses::ProvenAddresses;
use crate::proto::reply_ledger::{LATEST_TIMEOUTS, ReplyLedger};
use crate::station::{Counters, EventSubject, HostEvent, LineEvent, RequestClass, Ticket};
use crate::time::{Instant, earliest};
pub(super) use alignment::Burst;
use alignment::{ByteAlignment, SendPlan, SilentModule};
use contest::Contest;
use module_set::ModuleSet;
use motor_stops::{MotorStops, REPEATED_STOPS_MAX};
use proof::{PROBES, UnprovenRequest};

/// Times an idempotent request is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Modules in quarantine at a time at most; one more puts the whole line in doubt.
pub const SUSPECTS_MAX: usize = 4;
/// Events that wait to be taken at most; before that, nothing new is accepted.
pub const EVENTS_MAX: usize = 8;
/// Places among them kept for the ends of requests.
const EVENT_ROOM_MIN: usize = 4;
/// Requests remembered, for whose replies one may be taken that comes too soon.
const RECENT_MAX: usize = 8;
/// Replies remembered of a suspect: to three attempts and every probe.
const OUTSTANDING_MAX: usize = 10;
/// Time for which the true reply of another module may still come after "wrong checksum".
const GRACE_NS: u64 = 20_000_000;

/// A module's reply, after the host's checks. Refusals are [`Failure::Refused`].
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
struct PendingExchange {
    /// `None` for a probe.
    ticket: Option<Ticket>,
    host_request: HostRequest,
    attempts: u8,
    sent: bool,
    /// Plan of its sending, once that is known.
    send_plan: Option<SendPlan>,
    /// Burst that was sent for each byte position of its module.
    burst: Option<Burst>,
    /// Earliest time at which it could be sent.
    ready_at: Instant,
    not_before: Instant,
    earliest_reply: Instant,
    deadline: Instant,
    flags: PendingFlags,
    /// The module adds it to its program instead of executing it.
    is_stored: bool,
}

/// Reasons for doubt about the next reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct PendingFlags {
    /// Replies of the same opcode that may still come for older requests.
    stale_replies: u8,
    checksum_error: bool,
    checksum_error_by_module: bool,
    early_reply: bool,
    /// The reply to another motor's stop may still come, or to another program's.
    other_motors_reply: bool,
    /// Another host's reply may look like this one's.
    contested: bool,
    /// A stop waits, or it was to be sent once: no further attempt.
    no_retry: bool,
}

impl PendingFlags {
    const NONE: Self = Self {
        stale_replies: 0,
        checksum_error: false,
        checksum_error_by_module: false,
        early_reply: false,
        other_motors_reply: false,
        contested: false,
        no_retry: false,
    };
}

impl PendingExchange {
    #[inline]
    const fn new(
        now: Instant,
        ticket: Option<Ticket>,
        host_request: HostRequest,
        ambiguous: u8,
    ) -> Self {
        Self {
            ticket,
            host_request,
            attempts: 0,
            sent: false,
            send_plan: None,
            burst: None,
            ready_at: now,
            not_before: now,
            earliest_reply: now,
            deadline: now,
            flags: PendingFlags { stale_replies: ambiguous, ..PendingFlags::NONE },
            is_stored: false,
        }
    }
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    host_address: u16,
    timeout_ns: u64,
    pending: Option<PendingExchange>,
    pending_stop: Option<(Ticket, HostRequest)>,
    /// Modules with replies that may still come; by opcode.
    suspects: ReplyLedger<Opcode, SUSPECTS_MAX, OUTSTANDING_MAX>,
    /// True if anything needs care: a suspect, a silent module, a download, or the owner of a stop's reply.
    suspicious: bool,
    silent_modules: [Option<SilentModule>; SUSPECTS_MAX],
    /// Modules that this host has put into download mode.
    storing_modules: ModuleSet,
    /// Motors whose stops may still be answered.
    motor_stops: MotorStops,
    contest: Contest,
    /// Modules of which no older reply can come but those that are known of.
    proven_addresses: ProvenAddresses,
    /// A request that waits for its module to be proven.
    unproven_request: Option<UnprovenRequest>,
    /// Stops of other motors that wait to be repeated.
    repeated_stops: [Option<(Ticket, HostRequest)>; REPEATED_STOPS_MAX],
    /// A stop waits: no second reply is listened for.
    urgent: bool,
    /// No module is proven again for a second reply before then.
    recheck_at: Instant,
    /// The last requests: module, opcode and when.
    recent: [(u8, u8, Instant); RECENT_MAX],
    next_recent: usize,
    events: EventRing<Answer, EVENTS_MAX>,
    /// Modules that ever answered.
    answered_modules: ModuleSet,
    /// Modules that have sent nothing since a request to them was not answered.
    unanswered_modules: ModuleSet,
    /// Replies that came sooner than the baud rate allows, in a row; past the limit the baud rate
    /// is taken for fiction (USB).
    early_streak: u8,
    alignment: ByteAlignment,
    /// Replies in a row that took their time.
    timely_streak: u64,
    link_up: bool,
    pub(super) counters: Counters,
}

/// Requests in a row whose only reply came too soon, after which replies are taken as they come.
const EARLY_STREAK_MAX: u8 = 2;
/// Replies in a row that took their time, after which the baud rate is believed again.
const TIMELY_STREAK_MIN: u64 = 16;

impl Session {
    pub(super) fn new(host_address: u16, timeout_ms: u32, options: &HostOptions) -> Self {
        Self {
            proven_addresses: ProvenAddresses::new(options.probe_seed),
            urgent: options.urgent,
            unproven_request: None,
            repeated_stops: [None; REPEATED_STOPS_MAX],
            recheck_at: Instant::ZERO,
            recent: [(0, 0, Instant::ZERO); RECENT_MAX],
            next_recent: 0,
            host_address,
            timeout_ns: u64::from(timeout_ms) * 1_000_000,
            pending: None,
            pending_stop: None,
            suspects: ReplyLedger::new(),
            suspicious: false,
            silent_modules: [None; SUSPECTS_MAX],
            storing_modules: ModuleSet::NONE,
            motor_stops: MotorStops::NONE,
            contest: Contest::NONE,
            events: EventRing::new(),
            answered_modules: ModuleSet::NONE,
            unanswered_modules: ModuleSet::NONE,
            early_streak: 0,
            alignment: ByteAlignment::NONE,
            timely_streak: 0,
            link_up: true,
            counters: Counters::default(),
        }
    }

    #[inline]
    pub(super) fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        // A module that answered in the host's own number would look like an echo.
        let own = u16::from(request.request.address) == self.host_address;
        // One look at all that needs care. A poll passes here thousands of times a second with none of it.
        if self.pending.is_some()
            || self.suspicious
            || self.unproven_request.is_some()
            || !self.proven_addresses.contains(request.request.address)
            || !self.link_up
            || own
            || request.storing == Storing::Required
            || self.events.room() < EVENT_ROOM_MIN
        {
            return self.submit_slow_path(now, ticket, request);
        }
        self.pending = Some(PendingExchange::new(now, Some(ticket), request, 0));
        Ok(())
    }

    /// Submits a request that has to wait.
    #[cold]
    fn submit_slow_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        if self.events.room() < EVENT_ROOM_MIN {
            return Err(request);
        }
        if let Some(failure) = self.rejection_of(&request) {
            self.events.push(EventSubject::Request(ticket), Err(failure));
            return Ok(());
        }
        if let Some(failure) = self.download_refusal(&request) {
            self.events.push(EventSubject::Request(ticket), Err(failure));
            return Ok(());
        }
        let stop = request.class == RequestClass::Stop;
        if self.pending.is_some() {
            return if stop { self.overtake_pending(now, ticket, request) } else { Err(request) };
        }
        let waits = self.unproven_request.is_some()
            || self.suspicious && !self.is_trusted(now, request.request.address);
        if waits && !stop {
            return Err(request);
        }
        // A module in download mode would store the probes of a proof.
        let module = request.request.address;
        let is_ready =
            self.proven_addresses.contains(module) || self.storing_modules.contains(module);
        if stop || is_ready {
            self.start_request(now, Some(ticket), request);
        } else {
            self.unproven_request = Some(UnprovenRequest::new(ticket, request, false));
            self.send_proof_probe(now);
        }
        Ok(())
    }

    #[inline]
    pub(super) fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.events.next()
    }

    /// The request to send now, if one waits. It and its reply are on the wire
    /// for `soonest_ns` at least, `on_wire_ns` at most. `burst`: how it goes out at each place of its
    /// module's count, if it does.
    #[inline]
    pub(super) fn transmit(
        &mut self,
        now: Instant,
        on_wire: (u64, u64),
        burst: Option<Burst>,
    ) -> Option<Request> {
        let (soonest_ns, on_wire_ns) = on_wire;

        let pending = self.pending.as_mut()?;
        if pending.sent || now < pending.not_before {
            return None;
        }
        pending.burst = burst;
        let request = pending.host_request.request;
        pending.flags.contested = self.contest.threatens(now, &request, self.timeout_ns);
        pending.sent = true;
        // Replies to stops of several motors differ in nothing, so from here on another stop's may be taken
        // for it.
        if request.opcode == Opcode::Mst && !pending.is_stored {
            if pending.attempts == 0 {
                pending.flags.other_motors_reply = self.motor_stops.is_reply_ambiguous(&request)
                    || !self.proven_addresses.contains(request.address);
            }
            self.motor_stops.note_stop_sent(&request);
            self.suspicious = true;
        }
        self.recent[self.next_recent % RECENT_MAX] =
            (request.address, request.opcode.number(), now);
        self.next_recent = self.next_recent.wrapping_add(1);
        debug_assert!(pending.attempts < ATTEMPTS_MAX, "a request leaves as often as it may");
        pending.earliest_reply = now.plus_ns(soonest_ns);
        pending.deadline = now.plus_ns(on_wire_ns + self.timeout_ns);
        self.alignment.note_sent(burst, pending.deadline);
        self.counters.sent += 1;
        if pending.attempts > 0 {
            self.counters.resent += 1;
        }
        pending.attempts += 1;
        if request.opcode == Opcode::DownloadStart && !pending.is_stored {
            self.storing_modules.insert(request.address);
            self.suspicious = true;
        }
        // A module that restarts into its boot loader does not answer (TMCL firmware manual, "Boot").
        if matches!(request.opcode, Opcode::Boot | Opcode::BootStart) && !pending.is_stored {
            let ticket = pending.ticket;
            self.pending = None;
            self.finish_ticket(ticket, Ok(Answer::NoReply));
        }
        Some(request)
    }

    /// True while a request waits to be sent.
    #[inline]
    pub(super) fn has_unsent(&self) -> bool {
        self.pending.as_ref().is_some_and(|pending| !pending.sent)
    }

    /// Request that waits for a reply.
    pub(super) fn expected_request(&self) -> Option<&Request> {
        self.pending
            .as_ref()
            .filter(|pending| pending.sent)
            .map(|pending| &pending.host_request.request)
    }

    /// Returns whether that request is added to a program, so that its reply is a plain one with status 101.
    pub(super) fn expects_stored(&self) -> bool {
        self.pending.as_ref().is_some_and(|pending| pending.is_stored)
    }

    /// Puts the sending off, but no stop, and nothing for longer than the reply timeout.
    pub(super) fn delay_sending(&mut self, until: Instant) {
        let timeout = self.timeout_ns;
        if let Some(pending) = &mut self.pending
            // A stop goes out into a noisy line at once. Delayed, it could be delayed again by each new byte of
            // noise.
            && pending.host_request.class != RequestClass::Stop
        {
            let until = until.min(pending.ready_at.plus_ns(timeout));
            pending.not_before = pending.not_before.max(until);
        }
    }

    /// Takes the good reply that is waited for, where nothing is in doubt: what happens most, so it
    /// is looked at first. Returns false when it is something else.
    #[inline]
    pub(super) fn try_fast_reply(&mut self, now: Instant, reply: Reply) -> bool {
        let Some(pending) = &self.pending else { return false };
        let request = &pending.host_request.request;
        // Everything that a late, foreign or doubled reply could differ in is compared here; the rest is for
        // `match_reply`.
        let ours = reply.module == request.address
            && reply.opcode == request.opcode
            && reply.status == Status::Ok
            && request.opcode != Opcode::ReadMemory;
        let plain = pending.sent && pending.attempts == 1 && pending.flags == PendingFlags::NONE;
        let trusted = !self.suspicious && self.early_streak == 0 && now >= pending.earliest_reply;
        let (true, true, true, Some(ticket)) = (ours, plain, trusted, pending.ticket) else {
            return false;
        };
        self.timely_streak += 1;
        self.contest.count = 0;
        self.answered_modules.insert(reply.module);
        self.counters.answered += 1;
        self.pending = None;
        self.events.push(EventSubject::Request(ticket), Ok(Answer::Reply(reply)));
        true
    }

    /// Takes a reply that passed every check of the wire.
    pub(super) fn handle_reply(&mut self, now: Instant, reply: Reply, soon: bool) {
        // A module that reports a wrong checksum may be misaligned.
        if self.suspicious && reply.status != Status::WrongChecksum {
            self.note_received(reply.module);
        }
        if is_event(&reply) {
            self.push_unsolicited(reply)
        } else {
            self.match_reply(now, reply, soon)
        }
    }

    /// Takes the version as text.
    pub(super) fn handle_version_text(&mut self, now: Instant, text: VersionText) {
        self.finish_with_answer(now, Ok(Answer::Text(text)));
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.pending.is_some_and(|pending| pending.sent && now >= pending.deadline) {
            self.handle_reply_timeout(now);
        }
        if self.suspicious {
            self.expire_suspects(now);
        }
        if self.listen_until().is_some_and(|until| now >= until) {
            self.handle_listened(now);
        }
        self.start_next(now);
    }

    /// Until when a second reply to the last probe may come, and nothing is sent but a stop.
    fn listen_until(&self) -> Option<Instant> {
        self.unproven_request.as_ref()?.listen_until.filter(|_| self.pending.is_none())
    }

    #[inline]
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let pending = self.pending.as_ref().map(|p| if p.sent { p.deadline } else { p.not_before });
        // While a request is open, its deadline comes first; a suspect is released after it.
        if pending.is_some() {
            return pending;
        }
        let listened = self.listen_until();
        if !self.suspicious {
            return listened;
        }
        earliest(self.suspects.deadline(), listened)
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
        if let Some(pending) = self.pending.take() {
            self.mark_suspect(now, &pending, false);
            self.finish_ticket(pending.ticket, Err(Failure::LinkDown));
        }
        // Their replies may come once the cable is back. The suspects keep them from being taken for new ones
        // (REQ-8).
        let waiting = self.unproven_request.take().map(|waiting| waiting.ticket);
        let stop = self.pending_stop.take().map(|(ticket, _)| ticket);
        let repeated = self.take_repeated_stops();
        stop.into_iter()
            .chain(waiting)
            .chain(repeated)
            .for_each(|ticket| self.finish_ticket(Some(ticket), Err(Failure::LinkDown)));
    }

    /// Ends a request that is not sent.
    pub(super) fn reject(
        &mut self,
        ticket: Ticket,
        request: HostRequest,
        rule: &'static str,
    ) -> Result<(), HostRequest> {
        if self.events.room() < EVENT_ROOM_MIN {
            return Err(request);
        }
        let why = Failure::Impossible(Unsupported::Forbidden(rule));
        self.events.push(EventSubject::Request(ticket), Err(why));
        Ok(())
    }

    fn rejection_of(&self, request: &HostRequest) -> Option<Failure> {
        const RULE: &str = "this is the host's own address; give the host another with host=";
        if !self.link_up {
            return Some(Failure::LinkDown);
        }
        // On CAN that identifier is the one of replies: the module could not distinguish its requests from them.
        let is_own = request.can_id == self.host_address;
        is_own.then_some(Failure::Impossible(Unsupported::Forbidden(RULE)))
    }

    fn start_request(&mut self, now: Instant, ticket: Option<Ticket>, request: HostRequest) {
        let Request { address, opcode, .. } = request.request;
        // A module answers in order, so replies to earlier requests of the same opcode come first and are
        // skipped. After a lost MST another MST is the same request, and nothing but stops was sent since.
        let ambiguous = if self.suspicious && opcode != Opcode::Mst {
            self.suspects.count(now, address, opcode)
        } else {
            0
        };
        let mut pending = PendingExchange::new(now, ticket, request, ambiguous);
        pending.is_stored = self.is_stored(&request);
        // A second copy would be a second instruction.
        pending.flags.no_retry |= pending.is_stored;
        self.pending = Some(pending);
    }

    /// Any other answer than the usual reply.
    #[cold]
    fn finish_with_answer(&mut self, now: Instant, answer: Result<Answer, Failure>) {
        let Some(pending) = &self.pending else { return };
        self.finish_ticket(pending.ticket, answer);
        self.finish_pending(now);
    }

    /// Completes the pending request, and selects the next one.
    fn finish_pending(&mut self, now: Instant) {
        let Some(pending) = self.pending.take() else { return };
        self.note_download_end(&pending.host_request);
        let (probe, module) = (pending.ticket.is_none(), pending.host_request.request.address);
        let doubtful =
            pending.attempts > 1 || pending.flags.checksum_error || pending.burst.is_some();
        self.answered_modules.insert(module);
        // The measured rate counts for more than a single reply that came too soon (TMCL-1).
        if self.early_streak < EARLY_STREAK_MAX || self.timely_streak >= TIMELY_STREAK_MIN {
            self.early_streak = 0;
        }
        self.counters.answered += 1;
        if probe && pending.burst.is_none() {
            self.clear_suspect(module);
        } else if doubtful {
            self.mark_suspect(now, &pending, true);
        }
        debug_assert!(self.pending.is_none(), "a proof goes on when its probe has ended");
        if probe && self.unproven_request.is_some() {
            return self.handle_proof(now);
        }
        if pending.host_request.request.opcode != Opcode::Mst && self.unproven_request.is_none() {
            self.forget_stops(module);
        }
        self.start_next(now);
    }

    #[cold]
    fn push_unsolicited(&mut self, reply: Reply) {
        if self.events.room() > EVENT_ROOM_MIN {
            self.events
                .push(EventSubject::Unsolicited(reply.module.into()), Ok(Answer::Event(reply)));
        } else {
            self.counters.foreign += 1;
        }
    }

    /// No answer in time.
    fn handle_reply_timeout(&mut self, now: Instant) {
        let Some(mut pending) = self.pending.take() else { return };
        self.note_unanswered(now, &pending);
        if pending.flags.early_reply {
            self.early_streak = (self.early_streak + 1).min(EARLY_STREAK_MAX);
        }
        let resendable =
            matches!(pending.host_request.class, RequestClass::Idempotent | RequestClass::Stop);
        let attempts =
            if self.has_answered(pending.host_request.request.address) { ATTEMPTS_MAX } else { 2 };
        let user = pending.ticket.is_some();
        if !user && self.unproven_request.is_some() {
            return self.handle_proof_timeout(now, &pending);
        }
        if user && resendable && pending.attempts < attempts && !pending.flags.no_retry {
            (pending.sent, pending.send_plan) = (false, None);
            pending.flags.checksum_error = false;
            pending.ready_at = now;
            pending.not_before = now;
            self.pending = Some(pending);
            return;
        }
        // Others answer, this one never did: it is probably not there, and a probe would only
        // make a scan slower.
        let worth = self.has_answered(pending.host_request.request.address)
            || self.answered_modules.is_empty();
        self.note_download_end(&pending.host_request);
        self.mark_suspect(now, &pending, worth);
        if user {
            let damaged = pending.flags.checksum_error && pending.flags.checksum_error_by_module;
            // The caller gets the reason for which a read was not repeated.
            let given_up = pending.flags.no_retry
                && pending.attempts < attempts
                && pending.host_request.class == RequestClass::Idempotent;
            self.counters.silent += u64::from(damaged || !given_up);
            let failure = if damaged {
                Failure::Refused { code: Status::WrongChecksum.number().into() }
            } else if given_up {
                Failure::Cancelled
            } else {
                Failure::Silent
            };
            self.finish_ticket(pending.ticket, Err(failure));
        }
    }

    /// Starts the next request when none is pending: a stop, then the request that it overtook, then a
    /// probe.
    #[inline]
    fn start_next(&mut self, now: Instant) {
        if self.repeated_stops[0].is_some() && self.pending.is_none() {
            self.next_repeated_stop();
        }
        let waits = self.pending_stop.is_some() || self.unproven_request.is_some();
        if self.pending.is_none() && (waits || self.suspicious) {
            self.start_stop_or_probe(now);
        }
    }

    #[cold]
    fn start_stop_or_probe(&mut self, now: Instant) {
        if let Some((ticket, request)) = self.pending_stop.take() {
            self.start_request(now, Some(ticket), request);
        } else if self.listen_until().is_some_and(|until| now < until) {
            // Nothing is sent meanwhile.
        } else if let Some(waiting) = &mut self.unproven_request {
            let proven = self.proven_addresses.contains(waiting.host_request.request.address);
            *waiting = UnprovenRequest::new(waiting.ticket, waiting.host_request, proven);
            self.send_proof_probe(now);
        } else if let Some(request) = self.next_probe(now) {
            self.start_request(now, None, request);
        }
    }

    fn next_probe(&mut self, now: Instant) -> Option<HostRequest> {
        debug_assert!(self.pending.is_none(), "probes do not overtake requests");
        let opcodes = PROBES.map(|(opcode, _)| opcode);
        let (address, opcode) = self.suspects.next_probe(now, &opcodes)?;
        let (_, kind) = PROBES.into_iter().find(|(other, _)| *other == opcode)?;
        let request = Request { address, opcode, kind, motor: 0, value: 0 };
        Some(HostRequest { class: RequestClass::Idempotent, ..HostRequest::of(request) })
    }

    fn has_answered(&self, module: u8) -> bool {
        self.answered_modules.contains(module)
    }

    fn finish_ticket(&mut self, ticket: Option<Ticket>, result: Result<Answer, Failure>) {
        if let Some(ticket) = ticket {
            self.events.push(EventSubject::Request(ticket), result);
        }
    }
}

fn is_event(reply: &Reply) -> bool {
    reply.status == Status::Event && reply.opcode == Opcode::PositionReached
}
