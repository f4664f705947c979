//! What all hosts share: one request outstanding, acknowledgements, answers, recovery, doubts.
//!
//! An acknowledgement names nothing: neither the drive nor the message. An answer names its sender
//! and the variable, but not the request. So after silence, and after an answer to what was asked
//! twice, there is *doubt*: until a question of another variable was answered by the same drive
//! (drives take messages in order, so nothing older can follow), or the latest possible time is
//! past, no acknowledgement counts and the variables in doubt are not asked for. Stops are let
//! through at any time.
//!
//! On CAN, and for axes behind a relay, nothing tells that a drive took an instruction. There a
//! question to the same drive follows it; an assignment is read back by it.

mod acknowledge;
mod doubt;
mod gather;
mod overtake;
mod recovery;

use super::ask::{
    self, Answer, Ask, MASTERID, SRL, With, assigned, assignment, give_me_data, signed,
};
use super::online::Online;
use super::rules::{Rule, Wire, leaves};
use super::serial::FRAME_MIN;
use super::wire::{IdCode, Instruction, Message};
use crate::error::{Failure, Unsupported};
use crate::proto::GROUP;
use crate::station::{Class, Counters, Event, LineEvent, Ticket, To};
use crate::time::Instant;
use doubt::Doubts;
use gather::Gather;

/// Times a question or a stop is sent at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Synchronisation bytes sent at most before a line is taken for dead (manual, chapter 3).
pub const SYNCS_MAX: u8 = 15;
/// The same while somebody looks for drives: most addresses are nobody's, and on most lines some drive
/// hears the first one.
const SYNCS_PROBING: u8 = 2;
/// Questions asked at most to end one doubt.
pub const PROBES_MAX: u8 = 4;
/// Events that wait to be taken at most; what drives say unasked beyond that is counted and lost.
pub const EVENTS_MAX: usize = 64;
/// Places among them that the ends of requests need.
const EVENTS_KEPT: usize = 8;
/// An acknowledgement or answer is possible for so many times the time allowed for it.
const LATEST_TIMEOUTS: u64 = 3;
/// Messages whose only acknowledgement came too soon, after which they are taken as they come.
const FICTION_MIN: u8 = 2;
/// The register of an axis' own ID and groups.
const AAR: u16 = 0x030C;
/// Silence after which several drives on RS-485 are taken to have dropped what they had of a frame.
/// SYNC bytes would reach them all. From the field, in no manual.
const DRAIN_NS: u64 = 50_000_000;

/// How long is waited for what.
#[derive(Clone, Copy, Debug)]
pub struct Waits {
    /// For an acknowledgement, once the frame has left.
    pub ack_ns: u64,
    /// For what a SYNC byte brings.
    pub pause_ns: u64,
    /// For an answer, once the request was heard.
    pub answer_ns: u64,
    /// One character on the line; 0 where characters take no time.
    pub character_ns: u64,
    /// Between messages to axes behind a relay that nothing else paces.
    pub pace_ns: u64,
}

impl Waits {
    fn frame_ns(&self, message: &Message) -> u64 {
        self.character_ns * (FRAME_MIN + 2 * message.instruction.data().len()) as u64
    }
}

/// Who the host is on its wire.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The wire and its rules.
    pub wire: Wire,
    /// The host's own ID code.
    pub own: IdCode,
    /// The drive on the other end of an RS-232 line.
    pub relay: Option<u8>,
    /// The first axis that is no group.
    pub first: Option<u8>,
    /// One drive is all there is on the line.
    pub alone: bool,
    /// The relay's bus is TechnoCAN.
    pub behind_technocan: bool,
    /// Somebody looks for drives.
    pub probing: bool,
    /// What the host's ID breaks.
    pub broken: Option<Rule>,
}

/// What is to be put on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Out {
    /// A message.
    Message(Message),
    /// So many bytes that synchronise.
    Sync(u8, u8),
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    /// `None` for a question that is to end a doubt.
    ticket: Option<Ticket>,
    ask: Ask,
    stage: Stage,
    phase: Phase,
    attempts: u8,
    /// Something like an acknowledgement came before the message had left.
    early: bool,
    /// And there was none before it, in all the time that a copy may take.
    first: bool,
}

/// Which of its messages a request is at.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    Master,
    Itself,
    /// The question behind an instruction.
    Proof,
}

impl Stage {
    /// What goes out first.
    fn first(ask: &Ask) -> Self {
        if ask.with == With::Master { Self::Master } else { Self::Itself }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// Not on the wire before then.
    Ready(Instant),
    Ack(Instant),
    Answer(Instant),
    /// So many SYNC bytes are out.
    Sync(u8, Instant),
    /// The next SYNC byte is to be sent.
    SyncDue(u8),
    Drain(Instant),
}

/// What the host can still try when a drive is silent: another baud rate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Fallback {
    /// It was tried in vain, or there is none.
    Spent,
    /// It was not tried since the drive was last heard.
    Armed,
    /// A question waits for it.
    Due,
}

/// The session of one host.
#[derive(Debug)]
pub struct Session {
    place: Place,
    waits: Waits,
    pending: Option<Pending>,
    /// Is sent once, however silent its drive.
    pub(super) once: Option<Ticket>,
    /// A stop that waits for the line.
    stop: Option<(Ticket, Ask)>,
    /// A question that a stop overtook.
    aside: Option<Pending>,
    doubts: Doubts,
    gather: Gather,
    events: [Event<Answer>; EVENTS_MAX],
    /// The gathered answer that is being handed on.
    part: Event<Answer>,
    first: usize,
    count: usize,
    /// Axes that ever answered.
    known: [u64; 4],
    /// Until when the last message to somebody behind a relay is taken to be on its way.
    paced: Instant,
    /// How sure it is that the line's baud rate is fiction (a virtual port): acknowledgements come
    /// before their messages can have left.
    fiction: u8,
    /// When something like an acknowledgement came last.
    told: Option<Instant>,
    pub(super) fallback: Fallback,
    up: bool,
    pub(super) counters: Counters,
}

impl Session {
    pub(super) fn new(place: Place, waits: Waits) -> Self {
        Self {
            place,
            waits,
            pending: None,
            once: None,
            stop: None,
            aside: None,
            doubts: Doubts::new(),
            gather: Gather::new(),
            events: [NOTHING; EVENTS_MAX],
            part: NOTHING,
            first: 0,
            count: 0,
            known: [0; 4],
            paced: Instant::ZERO,
            fiction: 0,
            told: None,
            fallback: Fallback::Spent,
            up: true,
            counters: Counters::default(),
        }
    }

    #[inline]
    pub(super) const fn wire(&self) -> Wire {
        self.place.wire
    }

    /// Whether a drive of that address can be asked: not with the host's own.
    pub(super) fn may_join(&self, address: u32) -> bool {
        let on_bus = self.place.wire != Wire::Rs232;
        !on_bus || address & GROUP != 0 || !self.same_axis(address as u8, self.place.own.id)
    }

    /// There is one more axis.
    pub(super) const fn joined(&mut self) {
        self.place.alone = false;
    }

    pub(super) fn submit(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        if self.count > EVENTS_MAX - EVENTS_KEPT || self.gather.is_draining() {
            return Err(ask);
        }
        if let Some(failure) = self.refusal(&ask) {
            self.push(To::Ticket(ticket), Err(failure));
            return Ok(());
        }
        let stop = ask.class == Class::Stop;
        if self.pending.is_some() {
            return if stop { self.overtake(now, ticket, ask) } else { Err(ask) };
        }
        if !stop && self.must_wait(now, &ask) {
            return Err(ask);
        }
        self.start(now, Some(ticket), ask);
        Ok(())
    }

    pub(super) fn poll_event(&mut self) -> Option<&Event<Answer>> {
        if self.count > 0 {
            let event = &self.events[self.first];
            self.first = (self.first + 1) % EVENTS_MAX;
            self.count -= 1;
            return Some(event);
        }
        self.part = self.gather.next_event()?;
        Some(&self.part)
    }

    /// What to put on the wire now, if anything.
    #[inline]
    pub(super) fn transmit(&mut self, now: Instant) -> Option<Out> {
        let pending = self.pending.as_mut()?;
        match pending.phase {
            Phase::Ready(at) if at <= now => {}
            Phase::SyncDue(sent) => return Some(self.synchronise(now, sent)),
            _ => return None,
        }
        let (ask, stage) = (pending.ask, pending.stage);
        self.counters.sent += 1;
        self.counters.resent += u64::from(pending.attempts > 0);
        (pending.attempts, pending.early) = (pending.attempts + 1, false);
        let message = self.message(&ask, stage);
        let left = now.plus_ns(self.waits.frame_ns(&message));
        if self.place.wire.acknowledges(message.to) {
            self.phase(Phase::Ack(left.plus_ns(self.waits.character_ns + self.waits.ack_ns)));
        } else {
            self.taken(left);
        }
        Some(Out::Message(message))
    }

    /// Puts the sending off, but no stop.
    pub(super) fn hold(&mut self, until: Instant) {
        if let Some(pending) = &mut self.pending
            && pending.ask.class != Class::Stop
            && let Phase::Ready(at) = pending.phase
        {
            pending.phase = Phase::Ready(at.max(until));
        }
    }

    /// True while nothing is outstanding.
    pub(super) fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// The other rate was tried: a question that waited for that is asked again.
    pub(super) fn fell_back(&mut self, now: Instant) {
        if self.fallback == Fallback::Due {
            self.recovered(now);
        }
        self.fallback = Fallback::Spent;
    }

    /// True while a message waits to be sent.
    pub(super) fn has_unsent(&self) -> bool {
        self.pending.is_some_and(|p| matches!(p.phase, Phase::Ready(_) | Phase::SyncDue(_)))
    }

    /// True when an acknowledgement should have come by now.
    pub(super) fn lacks_ack(&self, now: Instant) -> bool {
        self.pending.is_some_and(|p| matches!(p.phase, Phase::Ack(at) if now >= at))
    }

    /// Takes a drive's answer to SYNC.
    pub(super) fn synchronised(&mut self, now: Instant) {
        if self.pending.is_some_and(|p| matches!(p.phase, Phase::Sync(..))) {
            self.recovered(now);
        } else {
            self.counters.skipped += 1;
        }
    }

    /// Takes a message that passed every check of the wire. `to` is `None` where the wire does not
    /// say whom it is for.
    #[inline]
    pub(super) fn heard(&mut self, now: Instant, to: Option<IdCode>, said: &Instruction) {
        let own = |code: IdCode| !code.group && self.same_axis(code.id, self.place.own.id);
        if !to.is_none_or(own) {
            self.counters.foreign += 1;
            return;
        }
        let Some(said) = Online::parse(said) else {
            self.counters.foreign += 1;
            return;
        };
        if !self.judge(now, &said) {
            match said {
                Online::TakeData2 { sender, .. } => self.event(sender, &said),
                _ => self.counters.late += 1,
            }
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        self.expire(now);
        self.doubts.expire(now);
        self.next(now);
    }

    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let Some(pending) = self.pending else { return self.doubts.until() };
        match pending.phase {
            Phase::Ready(at)
            | Phase::Ack(at)
            | Phase::Answer(at)
            | Phase::Sync(_, at)
            | Phase::Drain(at) => Some(at),
            Phase::SyncDue(_) => Some(Instant::ZERO),
        }
    }

    pub(super) fn handle_line(&mut self, _: Instant, event: LineEvent) {
        self.up = match event {
            LineEvent::Down | LineEvent::BusOff => false,
            LineEvent::Up => true,
            LineEvent::Break => self.up,
        };
        if self.up {
            return;
        }
        self.gather.clear();
        let asked = [self.pending.take(), self.aside.take()];
        let asked = asked.map(|pending| pending.and_then(|pending| pending.ticket));
        let stop = self.stop.take().map(|(ticket, _)| ticket);
        for ticket in asked.into_iter().chain([stop]).flatten() {
            self.push(To::Ticket(ticket), Err(Failure::LinkDown));
        }
    }

    /// The message as it goes on the wire: in a request the host fills in its own ID code.
    pub(super) fn addressed(&self, message: &Message) -> Message {
        let mut message = *message;
        if ask::question(&message.instruction).is_some() {
            message.instruction = signed(&message.instruction, self.place.own);
        }
        message
    }

    fn message(&self, ask: &Ask, stage: Stage) -> Message {
        let to = ask.message.to;
        let instruction = match stage {
            Stage::Itself => return self.addressed(&ask.message),
            Stage::Master => {
                let own = IdCode { host: true, ..self.place.own };
                return Message { to, instruction: assignment(MASTERID, own.word().into(), false) };
            }
            Stage::Proof => match assigned(&ask.message.instruction) {
                Some((address, _, long)) => give_me_data(address, long),
                None => give_me_data(SRL, false),
            },
        };
        self.addressed(&Message { to, instruction })
    }

    fn question(&self, pending: &Pending) -> Option<Online> {
        ask::question(&self.message(&pending.ask, pending.stage).instruction)
    }

    /// What forbids a request, whatever the time.
    fn refusal(&self, ask: &Ask) -> Option<Failure> {
        if !self.up {
            return Some(Failure::LinkDown);
        }
        let Place { wire, own, relay, behind_technocan, broken, .. } = self.place;
        let Message { to, instruction } = &ask.message;
        let many = to.group || to.id == 0;
        let question = ask::question(instruction);
        let speaks = ask.with == With::Master;
        let beyond = wire == Wire::Rs232 && (to.group || relay != Some(to.id));
        let may_speak = if speaks { wire.unasked() } else { Ok(()) };
        let second = speaks || question.is_some_and(|question| ask::gathers(&question));
        let rule = match (broken, wire.check(&self.addressed(&ask.message)), may_speak) {
            (Some(rule), ..) | (_, Err(rule), _) | (.., Err(rule)) => Some(rule),
            _ if wire != Wire::Rs232 && !many && self.same_axis(to.id, own.id) => {
                Some(Rule::OwnHostId)
            }
            _ if behind_technocan && beyond && second => Some(Rule::TechnoCanRelay),
            _ => None,
        };
        let harmless = matches!(ask.class, Class::Idempotent | Class::Stop);
        match rule {
            Some(rule) => Some(Failure::Impossible(Unsupported::Forbidden(rule.sentence()))),
            None if !many && !harmless && self.doubts.are_twins(to.id) => Some(TWINS),
            None => None,
        }
    }

    /// True while an answer to this could be taken for another's, or the reverse.
    fn must_wait(&mut self, now: Instant, ask: &Ask) -> bool {
        self.doubts.expire(now);
        let Message { to, instruction } = &ask.message;
        match ask::question(instruction) {
            Some(question) => !to.group && self.doubts.concern(to.id, ask::tag(&question)),
            None => self.place.wire.acknowledges(*to) && self.doubts.concern_acks(),
        }
    }

    /// Whether two axis IDs are one on this wire: TechnoCAN has five bits for them.
    fn same_axis(&self, a: u8, b: u8) -> bool {
        match self.place.wire {
            Wire::TechnoCan => a % 32 == b % 32,
            _ => a == b,
        }
    }

    fn start(&mut self, now: Instant, ticket: Option<Ticket>, ask: Ask) {
        let stage = Stage::first(&ask);
        let at = if ask.class == Class::Stop { now } else { now.max(self.paced) };
        let phase = Phase::Ready(at);
        let (attempts, early, first) = (0, false, false);
        self.pending = Some(Pending { ticket, ask, stage, phase, attempts, early, first });
    }

    fn phase(&mut self, phase: Phase) {
        if let Some(pending) = &mut self.pending {
            pending.phase = phase;
        }
    }

    /// On with the request's next message.
    fn advance(&mut self, now: Instant, stage: Stage) {
        if let Some(pending) = &mut self.pending {
            (pending.stage, pending.attempts, pending.early) = (stage, 0, false);
            pending.phase = Phase::Ready(now);
        }
    }

    /// A message was acknowledged, or is on a wire that acknowledges nothing.
    fn taken(&mut self, now: Instant) {
        let Some(pending) = self.pending else { return };
        if let Some(question) = self.question(&pending) {
            if self.stop.is_some() && self.place.wire != Wire::Rs485 {
                return self.give_way(now);
            }
            if ask::gathers(&question) && is_for_many(&pending) {
                self.gather.begin(pending.ticket);
            }
            return self.phase(Phase::Answer(now.plus_ns(self.waits.answer_ns)));
        }
        let instruction = &pending.ask.message.instruction;
        match pending.stage {
            Stage::Master => self.advance(now, Stage::Itself),
            _ if !self.wants_proof(&pending.ask) => {
                self.paced = now.plus_ns(self.pace_ns(&pending.ask.message));
                let value = assigned(instruction).map_or(0, |(_, value, _)| value);
                self.end(now, Ok(Answer::Taken(value)));
            }
            // The drive will be somewhere else, or start anew: nobody is there to be asked.
            _ if leaves(instruction.opcode) => self.end(now, Err(Failure::Silent)),
            _ => self.advance(now, Stage::Proof),
        }
    }

    /// Whether only a question tells that the drive took an instruction.
    fn wants_proof(&self, ask: &Ask) -> bool {
        let to = ask.message.to;
        let heard_by_itself = match self.place.wire {
            Wire::Rs232 => self.place.relay == Some(to.id),
            Wire::Rs485 => true,
            Wire::TmlCan | Wire::TechnoCan => false,
        };
        ask.with != With::Nothing && !to.group && to.id != 0 && !heard_by_itself
    }

    fn pace_ns(&self, message: &Message) -> u64 {
        let behind = message.to.group || self.place.relay != Some(message.to.id);
        if self.place.wire == Wire::Rs232 && behind { self.waits.pace_ns } else { 0 }
    }

    /// Whether what was said answers what was asked, now or a moment ago.
    fn judge(&mut self, now: Instant, said: &Online) -> bool {
        // It was asked for, so it is not late; and nobody takes it, so it is no answer.
        if self.answers_aside(said) {
            return true;
        }
        let pending = self.pending.filter(|pending| pending.attempts > 0);
        let asked = pending.and_then(|pending| Some((pending, self.question(&pending)?)));
        let Some((pending, question)) = asked else { return self.double(said) };
        let Some(answer) = ask::answer(said).filter(|_| said.answers(&question, ANYBODY)) else {
            return self.double(said);
        };
        let (from, to) = (said.answered_by(), pending.ask.message.to);
        if self.gather.is_open() {
            return self.gathered(now, from, answer);
        }
        if from.is_some_and(|from| to.id != 0 && !self.same_axis(from, to.id)) {
            return self.double(said);
        }
        self.answered(now, &pending, question, answer);
        true
    }

    /// Whether this answers the question that a stop overtook, which was on the wire before the
    /// stop's own: a drive answers in order, so it proves nothing of the stop. It is asked again.
    fn answers_aside(&mut self, said: &Online) -> bool {
        let aside = self.aside.filter(|aside| aside.attempts > 0);
        let Some(question) = aside.and_then(|aside| self.question(&aside)) else { return false };
        let to = aside.map_or(IdCode::BROADCAST, |aside| aside.ask.message.to);
        let fits = said.answers(&question, ANYBODY)
            && said.answered_by().is_none_or(|from| to.id == 0 || self.same_axis(from, to.id));
        if let Some(aside) = self.aside.as_mut().filter(|_| fits) {
            aside.attempts -= 1;
        }
        fits
    }

    fn gathered(&mut self, now: Instant, from: Option<u8>, answer: Answer) -> bool {
        let Some(from) = from else { return false };
        self.know(from);
        if !self.gather.take(from, answer) {
            self.doubts.doubled(from);
        }
        self.phase(Phase::Answer(now.plus_ns(self.waits.answer_ns)));
        true
    }

    fn answered(&mut self, now: Instant, pending: &Pending, question: Online, answer: Answer) {
        let axis = pending.ask.message.to.id;
        self.know(axis);
        self.answered_before_its_acknowledgement(pending);
        self.counters.answered += 1;
        self.doubts.answered(axis, question, self.place.wire == Wire::Rs232, pending.attempts == 1);
        if pending.attempts > 1 {
            let until = now.plus_ns(LATEST_TIMEOUTS * self.waits.answer_ns);
            self.doubts.add(axis, ask::tag(&question), until, true);
            if self.place.wire.acknowledges(pending.ask.message.to) {
                // It names nothing, and comes as often as was asked.
                self.doubts.add_ack(axis, until);
            }
        }
        if pending.stage == Stage::Itself {
            return self.end(now, Ok(answer));
        }
        let assigned = assigned(&pending.ask.message.instruction);
        let found = match answer {
            Answer::Value { value, .. } => value,
            _ => 0,
        };
        let result = match assigned {
            Some((_, value, _)) if pending.ask.class == Class::Confirm && value != found => {
                Err(Failure::Misbehaved)
            }
            Some((_, value, _)) => Ok(Answer::Taken(value)),
            None => Ok(Answer::Taken(0)),
        };
        self.end(now, result);
    }

    /// An answer of a moment ago is given again: by a second drive of that ID, if it happens always.
    pub(super) fn double(&mut self, said: &Online) -> bool {
        if self.doubts.is_double(said) {
            self.counters.late += 1;
            return true;
        }
        false
    }

    /// Ends what is outstanding.
    fn end(&mut self, now: Instant, result: Result<Answer, Failure>) {
        let Some(pending) = self.pending.take() else { return };
        if let Some(ticket) = pending.ticket {
            self.push(To::Ticket(ticket), result);
        }
        self.next(now);
    }

    /// What comes next when nothing is outstanding: a stop that waits, what it overtook, then a
    /// question that ends a doubt.
    fn next(&mut self, now: Instant) {
        if self.pending.is_some() || !self.up {
            return;
        }
        if let Some((ticket, ask)) = self.stop.take() {
            return self.start(now, Some(ticket), ask);
        }
        if let Some(pending) = self.aside.take() {
            self.pending = Some(Pending { phase: Phase::Ready(now), ..pending });
            return;
        }
        if let Some((axis, address)) = self.doubts.probe() {
            let instruction = give_me_data(address, false);
            let message = Message { to: IdCode::axis(axis), instruction };
            self.start(now, None, Ask::of(message));
        }
    }

    fn event(&mut self, from: u8, said: &Online) {
        match ask::answer(said) {
            Some(answer) if self.count < EVENTS_MAX - EVENTS_KEPT => {
                self.know(from);
                self.push(To::Address(from.into()), Ok(answer));
            }
            _ => self.counters.foreign += 1,
        }
    }

    fn push(&mut self, to: To, result: Result<Answer, Failure>) {
        debug_assert!(self.count < EVENTS_MAX, "submit leaves room for every end");
        self.events[(self.first + self.count) % EVENTS_MAX] = (to, result);
        self.count += 1;
    }

    fn know(&mut self, axis: u8) {
        self.known[usize::from(axis >> 6)] |= 1 << (axis & 63);
    }

    fn knows(&self, axis: u8) -> bool {
        self.known[usize::from(axis >> 6)] & 1 << (axis & 63) != 0
    }
}

/// The question that everybody on a CAN bus answers: where they are.
pub(super) fn discovery(own: IdCode) -> Message {
    let instruction = Instruction::of(0xB204, [own.word(), AAR]);
    Message { to: IdCode::BROADCAST, instruction }
}

const NOTHING: Event<Answer> = (To::Address(0), Err(Failure::Silent));

/// Whoever answers.
const ANYBODY: IdCode = IdCode::axis(0);

const TWINS: Failure = Failure::NotReady {
    hint: "two drives answer as this axis: disconnect one, give the other an axis ID of its own, \
           and connect again",
};

fn is_for_many(pending: &Pending) -> bool {
    let to = pending.ask.message.to;
    to.group || to.id == 0
}
