//! Common part of all hosts: one open request, acknowledgements, replies, recovery, doubts.
//!
//! An acknowledgement names neither drive nor message. A reply names its sender and the variable, but not
//! the request. So after a missing reply, and after the reply to a repeated request, there is *doubt* by
//! the rule in `proto/reply_ledger`: no acknowledgement counts, and the variables in doubt are not read.
//! Stops are always sent.
//!
//! On CAN, and for axes behind a relay, no acknowledgement exists. There a read follows an instruction, and
//! an assignment is read back.

mod acknowledgement;
mod group_answers;
mod matching;
mod overtake;
mod recovery;
mod stale_replies;

use super::host_request::{
    self, Answer, Confirmation, HostRequest, MASTERID, SRL, assign_instruction, assigned_variable,
    give_me_data, with_sender,
};
use super::online::OnlineMessage;
use super::rules::{TmlWire, WireRule, breaks_contact};
use super::serial::FRAME_MIN;
use super::wire::{IdCode, Instruction, Message};
use crate::error::{Failure, Unsupported};
use crate::proto::GROUP;
use crate::proto::reply_ledger::LATEST_TIMEOUTS;
use crate::station::{Counters, EventSubject, HostEvent, LineEvent, RequestClass, Ticket};
use crate::time::Instant;
use group_answers::GroupAnswers;
use stale_replies::StaleReplies;

/// Times a question or a stop is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Synchronisation bytes sent at most before a line is taken for dead (manual, chapter 3).
pub const SYNCS_MAX: u8 = 15;
/// SYNC bytes of a scan: most addresses are empty, and on most lines some drive receives the first one.
const SYNCS_SCANNING: u8 = 2;
/// Limit of waiting events; further unsolicited messages are counted and lost.
pub const EVENTS_MAX: usize = 64;
/// Places among them that the ends of requests need.
const EVENT_ROOM_MIN: usize = 8;
/// Messages whose only acknowledgement came too soon, after which they are taken as they come.
const FICTION_MIN: u8 = 2;
/// The register of an axis' own ID and groups.
const AAR: u16 = 0x030C;
/// Silence after which several drives on RS-485 are taken to have dropped a begun frame.
/// SYNC bytes would reach them all. From the field, in no manual.
// Longer than the longest reply at 9,600 baud, so that no drive is sending when the next message
// leaves [I].
const DRAIN_NS: u64 = 50_000_000;

/// Time-outs.
#[derive(Clone, Copy, Debug)]
pub struct Timeouts {
    /// For an acknowledgement, once the frame has left.
    pub ack_ns: u64,
    /// Wait for the reply to a SYNC byte.
    pub sync_pause_ns: u64,
    /// Wait for a reply, once the request was sent.
    pub answer_ns: u64,
    /// One character on the line; 0 where characters take no time.
    pub character_ns: u64,
    /// Between messages to axes behind a relay that nothing else paces.
    pub relay_gap_ns: u64,
}

impl Timeouts {
    fn frame_ns(&self, message: &Message) -> u64 {
        self.character_ns * (FRAME_MIN + 2 * message.instruction.data().len()) as u64
    }
}

/// Place of the host on its wire.
#[derive(Clone, Copy, Debug)]
pub struct Topology {
    /// The wire and its rules.
    pub wire: TmlWire,
    /// The host's own ID code.
    pub own_code: IdCode,
    /// The drive on the other end of an RS-232 line.
    pub relay_axis: Option<u8>,
    /// The first axis that is no group.
    pub first_axis: Option<u8>,
    /// One drive is all there is on the line.
    pub single_drive: bool,
    /// The relay's bus is TechnoCAN.
    pub behind_technocan: bool,
    /// A scan is running.
    pub scanning: bool,
    /// The rule that the host's ID breaks.
    pub broken_rule: Option<WireRule>,
}

/// Next output on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outgoing {
    /// A message.
    Message(Message),
    /// Number of SYNC bytes.
    Sync(u8, u8),
}

#[derive(Clone, Copy, Debug)]
struct PendingExchange {
    /// `None` for a question that is to end a doubt.
    ticket: Option<Ticket>,
    host_request: HostRequest,
    stage: RequestStage,
    phase: RequestPhase,
    attempts: u8,
    /// Something like an acknowledgement came before the message had left.
    early_ack: bool,
    /// And there was none before it, in all the time that a copy may take.
    early_ack_is_first: bool,
}

/// Message that a request is at.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RequestStage {
    SetMaster,
    Request,
    /// The question behind an instruction.
    Proof,
}

impl RequestStage {
    /// First output of a request.
    fn first_for(request: &HostRequest) -> Self {
        if request.confirmation == Confirmation::MasterFirst {
            Self::SetMaster
        } else {
            Self::Request
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RequestPhase {
    /// Not on the wire before then.
    Ready(Instant),
    AwaitAck(Instant),
    AwaitAnswer(Instant),
    /// Number of SYNC bytes that were sent, and the deadline.
    AwaitSync(u8, Instant),
    /// The next SYNC byte is to be sent.
    SendSync(u8),
    Drain(Instant),
}

/// Remaining attempt when a drive is silent: another baud rate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum BaudFallback {
    /// The other rate was tried in vain, or there is none.
    Exhausted,
    /// Not tried since the drive was last received.
    Armed,
    /// A question waits for it.
    Requested,
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    topology: Topology,
    timeouts: Timeouts,
    pending: Option<PendingExchange>,
    /// Is sent once, however silent its drive.
    pub(super) no_retry_ticket: Option<Ticket>,
    /// A stop that waits for the line.
    pending_stop: Option<(Ticket, HostRequest)>,
    /// A question that a stop overtook.
    overtaken: Option<PendingExchange>,
    stale_replies: StaleReplies,
    group_answers: GroupAnswers,
    events: [HostEvent<Answer>; EVENTS_MAX],
    /// The gathered answer that is being handed on.
    current_part: HostEvent<Answer>,
    events_first: usize,
    events_len: usize,
    /// Axes that ever answered.
    answered_axes: [u64; 4],
    /// Time until which the last message through a relay is taken to be on its way.
    relay_free_at: Instant,
    /// Evidence that the line's baud rate is fiction (a virtual port): acknowledgements that come before their messages
    /// can have left.
    fiction_score: u8,
    /// Time of the last byte that may be an acknowledgement.
    last_ack: Option<Instant>,
    pub(super) fallback: BaudFallback,
    link_up: bool,
    pub(super) counters: Counters,
}

impl Session {
    pub(super) fn new(topology: Topology, timeouts: Timeouts) -> Self {
        Self {
            topology,
            timeouts,
            pending: None,
            no_retry_ticket: None,
            pending_stop: None,
            overtaken: None,
            stale_replies: StaleReplies::new(),
            group_answers: GroupAnswers::new(),
            events: [EMPTY_EVENT; EVENTS_MAX],
            current_part: EMPTY_EVENT,
            events_first: 0,
            events_len: 0,
            answered_axes: [0; 4],
            relay_free_at: Instant::ZERO,
            fiction_score: 0,
            last_ack: None,
            fallback: BaudFallback::Exhausted,
            link_up: true,
            counters: Counters::default(),
        }
    }

    #[inline]
    pub(super) const fn wire(&self) -> TmlWire {
        self.topology.wire
    }

    /// Returns whether a drive of that address can be asked: not with the host's own.
    pub(super) fn can_add_drive(&self, address: u32) -> bool {
        // On RS-232 the host has the number of its drive by definition (communication manual, chapter 2).
        let on_bus = self.topology.wire != TmlWire::Rs232;
        !on_bus || address & GROUP != 0 || !self.same_axis(address as u8, self.topology.own_code.id)
    }

    /// There is one more axis.
    pub(super) const fn add_drive(&mut self) {
        self.topology.single_drive = false;
    }

    pub(super) fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        // Every request that is taken must be able to end, also the one that a stop cuts short.
        if self.events_len > EVENTS_MAX - EVENT_ROOM_MIN || self.group_answers.is_draining() {
            return Err(request);
        }
        if let Some(failure) = self.rejection_of(&request) {
            self.push_event(EventSubject::Request(ticket), Err(failure));
            return Ok(());
        }
        let stop = request.class == RequestClass::Stop;
        if self.pending.is_some() {
            return if stop { self.overtake_pending(now, ticket, request) } else { Err(request) };
        }
        if !stop && self.must_wait(now, &request) {
            return Err(request);
        }
        self.start_request(now, Some(ticket), request);
        Ok(())
    }

    pub(super) fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        if self.events_len > 0 {
            let event = &self.events[self.events_first];
            debug_assert!(self.events_first < EVENTS_MAX);
            self.events_first = (self.events_first + 1) % EVENTS_MAX;
            self.events_len -= 1;
            return Some(event);
        }
        self.current_part = self.group_answers.next_event()?;
        Some(&self.current_part)
    }

    /// Bytes to send now, if any.
    #[inline]
    pub(super) fn transmit(&mut self, now: Instant) -> Option<Outgoing> {
        let pending = self.pending.as_mut()?;
        match pending.phase {
            RequestPhase::Ready(at) if at <= now => {}
            RequestPhase::SendSync(sent) => return Some(self.next_sync(now, sent)),
            _ => return None,
        }
        let (request, stage) = (pending.host_request, pending.stage);
        self.counters.sent += 1;
        self.counters.resent += u64::from(pending.attempts > 0);
        debug_assert!(pending.attempts < u8::MAX, "attempts are few");
        (pending.attempts, pending.early_ack) = (pending.attempts + 1, false);
        let message = self.stage_message(&request, stage);
        let left = now.plus_ns(self.timeouts.frame_ns(&message));
        if self.topology.wire.acknowledges(message.to) {
            self.set_phase(RequestPhase::AwaitAck(
                left.plus_ns(self.timeouts.character_ns + self.timeouts.ack_ns),
            ));
        } else {
            self.handle_accepted(left);
        }
        Some(Outgoing::Message(message))
    }

    /// Puts the sending off, but no stop.
    pub(super) fn delay_sending(&mut self, until: Instant) {
        // A stop is not delayed: each byte of a noisy line would delay it again.
        if let Some(pending) = &mut self.pending
            && pending.host_request.class != RequestClass::Stop
            && let RequestPhase::Ready(at) = pending.phase
        {
            pending.phase = RequestPhase::Ready(at.max(until));
        }
    }

    /// True while nothing is outstanding.
    pub(super) fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// The other rate was tried: a question that waited for that is asked again.
    pub(super) fn finish_fallback(&mut self, now: Instant) {
        if self.fallback == BaudFallback::Requested {
            self.resume_after_recovery(now);
            self.fallback = BaudFallback::Exhausted;
        }
    }

    /// True while a message waits to be sent.
    pub(super) fn has_unsent(&self) -> bool {
        self.pending
            .is_some_and(|p| matches!(p.phase, RequestPhase::Ready(_) | RequestPhase::SendSync(_)))
    }

    /// True when an acknowledgement should have come by now.
    pub(super) fn is_ack_overdue(&self, now: Instant) -> bool {
        self.pending.is_some_and(|p| matches!(p.phase, RequestPhase::AwaitAck(at) if now >= at))
    }

    /// Takes a drive's answer to SYNC.
    pub(super) fn handle_sync(&mut self, now: Instant) {
        if self.pending.is_some_and(|p| matches!(p.phase, RequestPhase::AwaitSync(..))) {
            self.resume_after_recovery(now);
        } else {
            self.counters.skipped += 1;
        }
    }

    /// Handles a message that passed every check of the wire. `to` is `None` if the wire does not name the receiver.
    #[inline]
    pub(super) fn handle_message(
        &mut self,
        now: Instant,
        to: Option<IdCode>,
        instruction: &Instruction,
    ) {
        // Group messages are for drives. A host that took them would answer for its own number.
        if !to.is_none_or(|code| !code.group && self.same_axis(code.id, self.topology.own_code.id))
        {
            self.counters.foreign += 1;
            return;
        }
        let Some(message) = OnlineMessage::parse(instruction) else {
            self.counters.foreign += 1;
            return;
        };
        if !self.match_answer(now, &message) {
            match message {
                OnlineMessage::TakeData2 { sender, .. } => self.push_unsolicited(sender, &message),
                _ => self.counters.late += 1,
            }
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        self.expire_phase(now);
        self.stale_replies.expire(now);
        self.start_next(now);
    }

    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let Some(pending) = self.pending else { return self.stale_replies.deadline() };
        match pending.phase {
            RequestPhase::Ready(at)
            | RequestPhase::AwaitAck(at)
            | RequestPhase::AwaitAnswer(at)
            | RequestPhase::AwaitSync(_, at)
            | RequestPhase::Drain(at) => Some(at),
            RequestPhase::SendSync(_) => Some(Instant::ZERO),
        }
    }

    pub(super) fn handle_line(&mut self, _: Instant, event: LineEvent) {
        self.link_up = match event {
            LineEvent::Down | LineEvent::BusOff => false,
            LineEvent::Up => true,
            LineEvent::Break | LineEvent::Rate(_) => self.link_up,
        };
        if self.link_up {
            return;
        }
        // Answers of a group so far are dropped: the caller could not know which are missing.
        self.group_answers.clear();
        let requests = [self.pending.take(), self.overtaken.take()];
        let queried = requests.map(|pending| pending.and_then(|pending| pending.ticket));
        let stop = self.pending_stop.take().map(|(ticket, _)| ticket);
        for ticket in queried.into_iter().chain([stop]).flatten() {
            self.push_event(EventSubject::Request(ticket), Err(Failure::LinkDown));
        }
    }

    /// The message as it goes on the wire: in a request the host fills in its own ID code.
    pub(super) fn with_own_sender(&self, message: &Message) -> Message {
        let mut message = *message;
        if host_request::query_of(&message.instruction).is_some() {
            message.instruction = with_sender(&message.instruction, self.topology.own_code);
        }
        message
    }

    fn stage_message(&self, request: &HostRequest, stage: RequestStage) -> Message {
        let to = request.message.to;
        let instruction = match stage {
            RequestStage::Request => return self.with_own_sender(&request.message),
            RequestStage::SetMaster => {
                let own = IdCode { host: true, ..self.topology.own_code };
                return Message {
                    to,
                    instruction: assign_instruction(MASTERID, own.word().into(), false),
                };
            }
            RequestStage::Proof => match assigned_variable(&request.message.instruction) {
                Some((address, _, long)) => give_me_data(address, long),
                None => give_me_data(SRL, false),
            },
        };
        self.with_own_sender(&Message { to, instruction })
    }

    fn query_of(&self, pending: &PendingExchange) -> Option<OnlineMessage> {
        host_request::query_of(
            &self.stage_message(&pending.host_request, pending.stage).instruction,
        )
    }

    /// The rule that forbids a request at any time.
    fn rejection_of(&self, request: &HostRequest) -> Option<Failure> {
        if !self.link_up {
            return Some(Failure::LinkDown);
        }
        let Topology { wire, own_code, relay_axis, behind_technocan, broken_rule, .. } =
            self.topology;
        let Message { to, instruction } = &request.message;
        let many = to.group || to.id == 0;
        debug_assert!(self.link_up, "a lost link is refused before");
        let question = host_request::query_of(instruction);
        let speaks = request.confirmation == Confirmation::MasterFirst;
        // Behind a relay onto TechnoCAN, a message that makes a drive send by itself has no way back [I].
        let beyond = wire == TmlWire::Rs232 && (to.group || relay_axis != Some(to.id));
        let may_speak = if speaks { wire.check_unsolicited() } else { Ok(()) };
        let second =
            speaks || question.is_some_and(|question| host_request::is_group_query(&question));
        let rule =
            match (broken_rule, wire.check(&self.with_own_sender(&request.message)), may_speak) {
                (Some(rule), ..) | (_, Err(rule), _) | (.., Err(rule)) => Some(rule),
                _ if wire != TmlWire::Rs232 && !many && self.same_axis(to.id, own_code.id) => {
                    Some(WireRule::OwnHostId)
                }
                _ if behind_technocan && beyond && second => Some(WireRule::TechnoCanRelay),
                _ => None,
            };
        let harmless = matches!(request.class, RequestClass::Idempotent | RequestClass::Stop);
        match rule {
            Some(rule) => Some(Failure::Impossible(Unsupported::Forbidden(rule.sentence()))),
            None if !many && !harmless && self.stale_replies.has_duplicate_axis(to.id) => {
                Some(DUPLICATE_AXIS)
            }
            None => None,
        }
    }

    /// True while an answer to this could be taken for another's, or the reverse.
    fn must_wait(&mut self, now: Instant, request: &HostRequest) -> bool {
        self.stale_replies.expire(now);
        let Message { to, instruction } = &request.message;
        match host_request::query_of(instruction) {
            Some(question) => {
                !to.group
                    && self.stale_replies.may_answer_be_stale(
                        now,
                        to.id,
                        host_request::answer_tag(&question),
                    )
            }
            None => {
                self.topology.wire.acknowledges(*to) && self.stale_replies.may_ack_be_stale(now)
            }
        }
    }

    /// Returns whether two axis IDs are the same on this wire: TechnoCAN has five bits for them.
    fn same_axis(&self, a: u8, b: u8) -> bool {
        match self.topology.wire {
            TmlWire::TechnoCan => a % 32 == b % 32,
            _ => a == b,
        }
    }

    fn start_request(&mut self, now: Instant, ticket: Option<Ticket>, request: HostRequest) {
        let stage = RequestStage::first_for(&request);
        let at =
            // A stop passes the relay's queue; what it could displace there is older and less urgent.
            if request.class == RequestClass::Stop { now } else { now.max(self.relay_free_at) };
        let phase = RequestPhase::Ready(at);
        let (attempts, early, first) = (0, false, false);
        self.pending = Some(PendingExchange {
            ticket,
            host_request: request,
            stage,
            phase,
            attempts,
            early_ack: early,
            early_ack_is_first: first,
        });
    }

    fn set_phase(&mut self, phase: RequestPhase) {
        if let Some(pending) = &mut self.pending {
            pending.phase = phase;
        }
    }

    /// On with the request's next message.
    fn enter_stage(&mut self, now: Instant, stage: RequestStage) {
        if let Some(pending) = &mut self.pending {
            (pending.stage, pending.attempts, pending.early_ack) = (stage, 0, false);
            pending.phase = RequestPhase::Ready(now);
        }
    }

    /// A message was acknowledged, or is on a wire that acknowledges nothing.
    fn handle_accepted(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        if let Some(question) = self.query_of(&pending) {
            // On RS-485 the answer comes in any case, and would collide with the stop.
            if self.pending_stop.is_some() && self.topology.wire != TmlWire::Rs485 {
                return self.start_pending_stop(now);
            }
            if host_request::is_group_query(&question) && is_group_request(&pending) {
                self.group_answers.begin(pending.ticket);
            }
            return self.set_phase(RequestPhase::AwaitAnswer(now.plus_ns(self.timeouts.answer_ns)));
        }
        let instruction = &pending.host_request.message.instruction;
        match pending.stage {
            RequestStage::SetMaster => self.enter_stage(now, RequestStage::Request),
            // Points of a path prove themselves by their counter, groups have no drive to ask (TML-3).
            _ if !self.needs_proof(&pending.host_request) => {
                self.relay_free_at = now.plus_ns(self.relay_gap_ns(&pending.host_request.message));
                let value = assigned_variable(instruction).map_or(0, |(_, value, _)| value);
                self.finish_pending(now, Ok(Answer::Accepted(value)));
            }
            // The drive will have another address, or restart: it cannot be asked.
            _ if breaks_contact(instruction.opcode) => {
                self.finish_pending(now, Err(Failure::Silent))
            }
            _ => self.enter_stage(now, RequestStage::Proof),
        }
    }

    /// Returns whether only a reading shows that the drive executed an instruction.
    fn needs_proof(&self, request: &HostRequest) -> bool {
        let to = request.message.to;
        let heard_by_itself = match self.topology.wire {
            TmlWire::Rs232 => self.topology.relay_axis == Some(to.id),
            TmlWire::Rs485 => true,
            TmlWire::TmlCan | TmlWire::TechnoCan => false,
        };
        request.confirmation != Confirmation::None && !to.group && to.id != 0 && !heard_by_itself
    }

    fn relay_gap_ns(&self, message: &Message) -> u64 {
        let behind = message.to.group || self.topology.relay_axis != Some(message.to.id);
        if self.topology.wire == TmlWire::Rs232 && behind { self.timeouts.relay_gap_ns } else { 0 }
    }

    /// Completes the pending request.
    fn finish_pending(&mut self, now: Instant, result: Result<Answer, Failure>) {
        let Some(pending) = self.pending.take() else { return };
        if let Some(ticket) = pending.ticket {
            self.push_event(EventSubject::Request(ticket), result);
        }
        self.start_next(now);
    }

    /// Starts the next request when none is pending: a stop, then the request that it overtook, then a
    /// probe.
    fn start_next(&mut self, now: Instant) {
        if self.pending.is_some() || !self.link_up {
            return;
        }
        if let Some((ticket, request)) = self.pending_stop.take() {
            return self.start_request(now, Some(ticket), request);
        }
        debug_assert!(self.pending_stop.is_none(), "a stop goes before what it overtook");
        if let Some(pending) = self.overtaken.take() {
            self.pending = Some(PendingExchange { phase: RequestPhase::Ready(now), ..pending });
            return;
        }
        if let Some((axis, address)) = self.stale_replies.next_probe(now) {
            let instruction = give_me_data(address, false);
            let message = Message { to: IdCode::axis(axis), instruction };
            self.start_request(now, None, HostRequest::of(message));
        }
    }

    fn push_unsolicited(&mut self, from: u8, message: &OnlineMessage) {
        match host_request::answer_of(message) {
            // Reports of drives never take the places that ends of requests need.
            Some(answer) if self.events_len < EVENTS_MAX - EVENT_ROOM_MIN => {
                self.note_answered(from);
                self.push_event(EventSubject::Unsolicited(from.into()), Ok(answer));
            }
            _ => self.counters.foreign += 1,
        }
    }

    fn push_event(&mut self, to: EventSubject, result: Result<Answer, Failure>) {
        debug_assert!(self.events_len < EVENTS_MAX, "submit leaves room for every end");
        self.events[(self.events_first + self.events_len) % EVENTS_MAX] = (to, result);
        self.events_len += 1;
    }

    fn note_answered(&mut self, axis: u8) {
        self.answered_axes[usize::from(axis >> 6)] |= 1 << (axis & 63);
    }

    fn has_answered(&self, axis: u8) -> bool {
        self.answered_axes[usize::from(axis >> 6)] & 1 << (axis & 63) != 0
    }
}

/// The question that everybody on a CAN bus answers: where they are.
pub(super) fn discovery_message(own: IdCode) -> Message {
    let instruction = Instruction::of(0xB204, [own.word(), AAR]);
    Message { to: IdCode::BROADCAST, instruction }
}

const EMPTY_EVENT: HostEvent<Answer> = (EventSubject::Unsolicited(0), Err(Failure::Silent));

/// Any axis as the sender of a reply.
const ANYBODY: IdCode = IdCode::axis(0);

const DUPLICATE_AXIS: Failure = Failure::NotReady {
    hint: "two drives answer as this axis: disconnect one, give the other an axis ID of its own, \
           and connect again",
};

fn is_group_request(pending: &PendingExchange) -> bool {
    let to = pending.host_request.message.to;
    to.group || to.id == 0
}
