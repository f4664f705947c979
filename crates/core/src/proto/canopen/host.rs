//! The commanding end: network master and service data client.
//!
//! Each node is asked one thing at a time, many nodes are asked at once. A reply is taken only if its
//! node asks for it, and it names the very object or carries on the very transfer. After silence
//! nothing of the same object counts until another object was answered, because a node answers in
//! order (CiA 301, 7.2.4.2 aborts the transfer meanwhile).

mod channel;
mod fast_scan;
mod long;
mod network;
mod nodes;
mod transfer;

use super::ask::{Answer, Ask};
use super::cob::{self, Cob};
use super::heartbeat::{Heartbeat, guard};
use super::nmt;
use super::sdo::Abort;
use super::sync::Sync;
use super::{NODE_MAX, lss};
use crate::error::Failure;
use crate::medium::{Can, CanLine, Frame};
use crate::proto::HostOptions;
use crate::proto::events::Events;
use crate::proto::pace::tolerated;
use crate::station::{
    self, Class, Counters, Event, LineEvent, Request as _, Station, Ticket, Timed, To,
};
use crate::time::{Instant, earliest};
use channel::{Channel, Sort, Step};
use fast_scan::Lss;
use long::Long;
use network::Network;
use nodes::NodeSet;

/// Time allowed for a reply when neither caller nor profile says one, ms.
pub const REPLY_TIMEOUT_MS: u32 = 200;
/// The host's node-ID: the last one.
pub const HOST_ID: u8 = NODE_MAX;
/// A stop waits so long for the answer that its node still owes, ms.
const PATIENCE_MS: u32 = 10;
/// Long transfers at once.
pub const LONGS_MAX: usize = 4;
/// Frames without answer that wait to be sent.
const FRAMES_MAX: usize = 16;
/// Room for the end of every request, and as much again for what nodes say unasked.
const EVENTS_MAX: usize = 512;
/// Of that, room that what is said unasked leaves: every channel, LSS, and frames.
const ENDS_MAX: usize = NODES + FRAMES_MAX + 1;
const NODES: usize = NODE_MAX as usize + 1;
/// Segments of blocks that are sent ahead of the wire: whatever comes after them waits for no more.
const AHEAD_MAX: u64 = 8;
/// The bit rate of a wire that tells none, for them.
const BIT_RATE: u32 = 1_000_000;
/// Bits of a segment without a single stuff bit, with the pause behind it: fewer than it takes, so that
/// the wire is never left idle.
const SEGMENT_BITS: u64 = 47 + 8 * SDO_BYTES as u64;

/// The host on CAN.
#[derive(Debug)]
pub struct Host {
    channels: [Channel; NODES],
    /// Nodes whose channel has a frame to send.
    unsent: NodeSet,
    /// Nodes whose channel has more segments of a block to send, when nothing else is.
    blocks: NodeSet,
    /// When the wire is through with those that were sent.
    ahead: Instant,
    /// How long it takes for one.
    segment_ns: u64,
    /// Nodes whose transfer is to be aborted.
    aborts: NodeSet,
    /// Nodes whose channel waits for an answer.
    waiting: NodeSet,
    longs: [Long; LONGS_MAX],
    frames: Frames,
    lss: Lss,
    network: Network,
    events: Events<Answer, EVENTS_MAX>,
    counters: Counters,
    timeout_ns: u64,
    /// A request and its reply take at least so long. What comes sooner is the second copy of an
    /// older reply, which a disturbed last bit makes its sender repeat.
    soonest_ns: u64,
    /// When a stop that waits for a node's answer waits no more.
    urge: Option<Instant>,
    bit_rate: u32,
}

/// Every answer came twice.
const TWINS: Failure = Failure::NotReady {
    hint: "two nodes answer with this node-ID: disconnect one, give the other a node-ID of its own, \
           and connect again",
};

/// Bytes of an SDO, whatever it says (CiA 301, 7.2.4.3).
const SDO_BYTES: u8 = 8;

/// Bits of a request and its reply without a single stuff bit, less the pause behind the last.
const EXCHANGE_BITS: u64 = 2 * (47 + 8 * SDO_BYTES as u64) - 3;

/// A queue of frames that nobody answers.
#[derive(Debug, Default)]
struct Frames {
    ring: [(Option<Ticket>, Frame); FRAMES_MAX],
    taken: usize,
    pushed: usize,
}

impl Frames {
    const fn is_full(&self) -> bool {
        self.pushed - self.taken == FRAMES_MAX
    }

    fn push(&mut self, ticket: Option<Ticket>, frame: Frame) {
        self.ring[self.pushed % FRAMES_MAX] = (ticket, frame);
        self.pushed += 1;
    }

    fn pop(&mut self) -> Option<(Option<Ticket>, Frame)> {
        (self.taken < self.pushed).then(|| {
            self.taken += 1;
            self.ring[(self.taken - 1) % FRAMES_MAX]
        })
    }
}

impl Host {
    /// A host as `options` say.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let timeout = options.reply_timeout_ms.unwrap_or(REPLY_TIMEOUT_MS);
        let id = options.host.and_then(|id| u8::try_from(id).ok()).unwrap_or(HOST_ID);
        let exchange_ns = EXCHANGE_BITS * 1_000_000_000;
        let bit_rate = if options.bit_rate == 0 { BIT_RATE } else { options.bit_rate };
        Self {
            channels: [Channel::IDLE; NODES],
            unsent: NodeSet::EMPTY,
            blocks: NodeSet::EMPTY,
            ahead: Instant::ZERO,
            segment_ns: SEGMENT_BITS * 1_000_000_000 / u64::from(bit_rate),
            aborts: NodeSet::EMPTY,
            waiting: NodeSet::EMPTY,
            longs: [Long::FREE; LONGS_MAX],
            frames: Frames::default(),
            lss: Lss::default(),
            network: Network::new(id, options.heartbeat_ms),
            events: Events::new(),
            counters: Counters::default(),
            timeout_ns: u64::from(timeout) * 1_000_000,
            soonest_ns: tolerated(exchange_ns.checked_div(options.bit_rate.into()).unwrap_or(0)),
            urge: None,
            bit_rate: options.bit_rate,
        }
    }

    /// The state that a node told last, if it told any.
    #[must_use]
    pub fn state(&self, node: u8) -> Option<nmt::State> {
        self.network.state(node)
    }

    fn end(&mut self, ticket: Ticket, result: Result<Answer, Failure>) {
        self.events.push(To::Ticket(ticket), result);
    }

    /// Tells what a node said unasked. Where nobody takes what there is to tell, it is only counted.
    fn tell(&mut self, node: u8, answer: Answer) {
        if self.events.room() > ENDS_MAX {
            self.events.push(To::Address(node.into()), Ok(answer));
        } else {
            self.counters.late += 1;
        }
    }

    /// What a step of node's transfer leads to.
    #[inline]
    fn follow(&mut self, node: u8, step: Step) {
        match step {
            Step::Wait => {}
            Step::Send => {
                self.waiting.remove(node);
                self.blocks.remove(node);
                self.unsent.insert(node);
            }
            Step::End(result) => self.ended(node, result),
            Step::Abort(abort, result) => {
                self.channels[usize::from(node)].abort = abort;
                self.aborts.insert(node);
                self.ended(node, result);
            }
        }
    }

    #[inline]
    fn ended(&mut self, node: u8, result: Result<Answer, Failure>) {
        let channel = &mut self.channels[usize::from(node)];
        self.unsent.remove(node);
        self.blocks.remove(node);
        self.waiting.remove(node);
        if let Some(long) = channel.end().and_then(|at| self.longs.get_mut(at)) {
            long.end();
        }
        let ticket = channel.ticket;
        if let Ok(answer) = &result {
            self.network.learn(node, answer);
        }
        self.end(ticket, result);
    }

    #[inline]
    fn replied(&mut self, now: Instant, node: u8, frame: &Frame) {
        // What comes before the question is out answers an older one.
        let channel = &mut self.channels[usize::from(node)];
        let sent = channel.deadline.0.saturating_sub(self.timeout_ns);
        let soon = now.0 < sent + self.soonest_ns && channel.long.is_none();
        if !self.waiting.contains(node) || soon {
            channel.spoke_again(frame.data);
            self.counters.late += 1;
            return;
        }
        if let Some(answer) = channel.at_once(frame.data) {
            let ticket = channel.ticket;
            self.waiting.remove(node);
            self.counters.answered += 1;
            self.network.learn(node, &answer);
            self.events.push(To::Ticket(ticket), Ok(answer));
            return;
        }
        self.went_on(now, node, frame);
    }

    /// A reply that is not all there is to it.
    fn went_on(&mut self, now: Instant, node: u8, frame: &Frame) {
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.long.and_then(|at| self.longs.get_mut(usize::from(at)));
        let deadline = now.plus_ns(self.timeout_ns);
        let (step, sort) = channel.reply(deadline, frame.data, long);
        match sort {
            Sort::Answer => self.counters.answered += 1,
            Sort::Late => self.counters.late += 1,
        }
        self.follow(node, step);
    }

    fn beat(&mut self, now: Instant, node: u8, data: &[u8]) {
        let Ok(beat) = Heartbeat::parse(data) else {
            self.counters.corrupt += 1;
            return;
        };
        let channel = &mut self.channels[usize::from(node)];
        if channel.guarded() {
            self.counters.answered += 1;
            let result = match self.network.guarded(node, beat) {
                true => Ok(Answer::State(beat.state)),
                false => Err(Failure::Misbehaved),
            };
            return self.ended(node, result);
        }
        if beat.state == nmt::State::BootUp && channel.is_amid() {
            // It restarted, and what it is sent now would begin something else.
            self.counters.silent += 1;
            self.ended(node, Err(Failure::Silent));
        }
        if self.network.heard(now, node, beat.state) {
            self.tell(node, Answer::State(beat.state));
        }
    }

    /// Everything that is under way ends so.
    fn end_all(&mut self, failure: Failure) {
        for node in self.waiting.iter() {
            self.channels[usize::from(node)].overtaken();
        }
        for node in self.unsent.or(self.waiting).iter() {
            self.ended(node, Err(failure));
        }
        self.aborts = NodeSet::EMPTY;
        while let Some((ticket, _)) = self.frames.pop() {
            if let Some(ticket) = ticket {
                self.end(ticket, Err(failure));
            }
        }
        if let Some((ticket, _)) = self.lss.cancel() {
            self.end(ticket, Err(failure));
        }
    }

    fn silent(&mut self, node: u8) {
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.long.and_then(|at| self.longs.get_mut(usize::from(at)));
        let (step, resent) = channel.silent(long);
        self.counters.resent += u64::from(resent);
        if matches!(step, Step::End(_) | Step::Abort(..)) {
            self.counters.silent += 1;
        } else if channel.is_beginning() {
            // What brought nothing is over for the node, too.
            self.aborts.insert(node);
        }
        self.follow(node, step);
    }

    fn frame_of(ask: &Ask) -> Option<Frame> {
        Some(match *ask {
            Ask::Order(order) => order.emit(),
            Ask::Process { cob, data, len } => {
                let mut frame = Frame::standard(cob.id(), &data.to_le_bytes());
                frame.len = len.min(8);
                frame.data[usize::from(frame.len)..].fill(0);
                frame
            }
            Ask::Sync(counter) => Sync { counter }.emit(),
            Ask::Time(time) => time.emit(),
            _ => return None,
        })
    }

    /// Whatever is asked, but what goes ahead of everything else. Never inlined there: it would make
    /// one jump by a table of all.
    #[inline(never)]
    fn submit_any(&mut self, now: Instant, ticket: Ticket, request: Ask) -> Result<(), Ask> {
        match request {
            Ask::Read { .. }
            | Ask::Write { .. }
            | Ask::Upload { .. }
            | Ask::Download { .. }
            | Ask::Guard { .. } => self.submit_channel(now, ticket, request),
            Ask::Watch { node, ms } => {
                let written = self.submit_channel(now, ticket, self.network.watched(node, ms));
                written.map_err(|_| request)?;
                self.network.beat_within(now, node, ms);
                Ok(())
            }
            Ask::Lss(lss) => self.lss.submit(ticket, Some(lss)).map_err(|()| request),
            Ask::FastScan => self.lss.submit(ticket, None).map_err(|()| request),
            Ask::SyncEvery(us) => {
                self.network.sync_every(now, us);
                self.end(ticket, Ok(Answer::Sent));
                Ok(())
            }
            _ => {
                let frame = Self::frame_of(&request).filter(|_| !self.frames.is_full());
                self.frames.push(Some(ticket), frame.ok_or(request)?);
                Ok(())
            }
        }
    }

    #[inline]
    fn submit_channel(&mut self, now: Instant, ticket: Ticket, ask: Ask) -> Result<(), Ask> {
        let node = ask.node().filter(|node| (1..=NODE_MAX).contains(node)).ok_or(ask)?;
        if !self.channels[usize::from(node)].is_idle() && !self.gives_way(now, node, &ask) {
            return Err(ask);
        }
        let channel = &mut self.channels[usize::from(node)];
        if channel.are_twins() && !matches!(ask.class(), Class::Idempotent | Class::Stop) {
            self.end(ticket, Err(TWINS));
            return Ok(());
        }
        let mut long = None;
        if matches!(ask, Ask::Upload { .. } | Ask::Download { .. }) {
            let free = self.longs.iter().position(Long::is_free).ok_or(ask)?;
            self.longs[free].begin(ticket, node, &ask);
            long = Some(free as u8);
        }
        channel.begin(ticket, ask, long);
        self.unsent.insert(node);
        Ok(())
    }

    /// Ends what a node does not answer, for a stop: at once where it was not sent, else after a
    /// moment, which nearly always suffices for its answer.
    fn gives_way(&mut self, now: Instant, node: u8, ask: &Ask) -> bool {
        let channel = &mut self.channels[usize::from(node)];
        if !ask.is_stop() || channel.is_stop() {
            return false;
        }
        if self.unsent.contains(node) {
            self.ended(node, Err(Failure::Cancelled));
            return true;
        }
        let patience = channel.deadline.0.saturating_sub(self.timeout_ns);
        let patience = Instant(patience).plus_ms(PATIENCE_MS);
        // In the midst of a block no answer is owed.
        if now < patience && !self.blocks.contains(node) {
            self.urge = earliest(self.urge, Some(patience));
            return false;
        }
        let failure = channel.overtaken();
        self.follow(node, Step::Abort(Abort::TIMEOUT, Err(failure)));
        true
    }

    /// The long transfer under `ticket`, if it goes that way.
    fn long_of(&mut self, ticket: Ticket, writes: bool) -> Option<(usize, u8)> {
        let at = self.longs.iter().position(|long| long.is_of(ticket) && long.writes == writes)?;
        Some((at, self.longs[at].node))
    }

    /// The user took or gave bytes: a transfer that waits for that goes on.
    fn stirred(&mut self, at: usize, node: u8) {
        let step = self.channels[usize::from(node)].stirred(&self.longs[at]);
        self.follow(node, step);
    }
}

impl Timed for Host {
    fn handle_timeout(&mut self, now: Instant) {
        self.urge = self.urge.filter(|urge| *urge > now);
        for node in self.waiting.without(self.blocks).iter() {
            if self.channels[usize::from(node)].deadline <= now {
                self.silent(node);
            }
        }
        if let Some((ticket, result)) = self.lss.handle_timeout(now) {
            self.counters.silent += u64::from(result.is_err());
            self.end(ticket, result);
        }
        while let Some(node) = self.network.lost(now) {
            self.tell(node, Answer::Lost);
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let waiting = self.waiting.without(self.blocks);
        let channels = waiting.iter().map(|n| self.channels[usize::from(n)].deadline).min();
        let channels = earliest(earliest(channels, self.blocks_due()), self.urge);
        earliest(channels, earliest(self.lss.deadline(), self.network.deadline()))
    }
}

impl Station<Can> for Host {
    #[inline]
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        if frame.extended || frame.id > 0x7FF {
            return;
        }
        // What happens most, ahead of everything else.
        let node = frame.id as u8 & NODE_MAX;
        if frame.id as u16 & !u16::from(NODE_MAX) == cob::SDO_REPLY && !frame.remote && node != 0 {
            if frame.len < SDO_BYTES {
                self.counters.corrupt += 1;
                return;
            }
            return self.replied(now, node, frame);
        }
        match Cob::of(frame.id as u16) {
            Cob::Tpdo(number, node) if !frame.remote => {
                let data = u64::from_le_bytes(frame.data);
                self.tell(node, Answer::Process(number, data, frame.len));
            }
            Cob::Heartbeat(node) if !frame.remote => self.beat(now, node, frame.bytes()),
            Cob::Emcy(node) if !frame.remote => {
                match super::emcy::Emergency::parse(frame.bytes()) {
                    Ok(emergency) => self.tell(node, Answer::Emergency(emergency)),
                    Err(_) => self.counters.corrupt += 1,
                }
            }
            Cob::LssReply => match lss::Reply::parse(frame.bytes()) {
                Ok(reply) => match self.lss.reply(now, reply) {
                    Some((ticket, result)) => {
                        self.counters.answered += 1;
                        self.end(ticket, result);
                    }
                    None if self.lss.is_idle() => self.counters.late += 1,
                    None => {}
                },
                Err(_) => self.counters.corrupt += 1,
            },
            _ => {}
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        match event {
            LineEvent::Down | LineEvent::BusOff => self.end_all(Failure::LinkDown),
            LineEvent::Up => self.network.forget(),
            LineEvent::Break => {}
        }
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        if let Some((ticket, frame)) = self.frames.pop() {
            *out = frame;
            self.counters.sent += 1;
            if let Some(ticket) = ticket {
                self.end(ticket, Ok(Answer::Sent));
            }
            return Some(1);
        }
        if let Some(node) = self.aborts.first() {
            self.aborts.remove(node);
            *out = self.channels[usize::from(node)].abort_frame().emit(node);
            return Some(1);
        }
        if let Some(node) = self.unsent.first() {
            return self.transmit(now, node, out);
        }
        if let Some(frame) = self.lss.transmit(now, self.timeout_ns) {
            self.counters.sent += 1;
            *out = frame;
            if let Some((ticket, result)) = self.lss.unanswered() {
                self.end(ticket, result);
            }
            return Some(1);
        }
        if let Some(frame) = self.network.transmit(now) {
            *out = frame;
            return Some(1);
        }
        let node = self.blocks.first()?;
        let free = self.ahead < now.plus_ns(AHEAD_MAX * self.segment_ns);
        if free { self.transmit_on(now, node, out) } else { None }
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl Host {
    #[inline]
    fn transmit(&mut self, now: Instant, node: u8, out: &mut Frame) -> Option<usize> {
        let deadline = now.plus_ns(self.timeout_ns);
        let Some(bytes) = self.channels[usize::from(node)].emit_first(deadline) else {
            return self.transmit_on(now, node, out);
        };
        *out = sdo_frame(node, bytes);
        self.counters.sent += 1;
        self.unsent.remove(node);
        self.waiting.insert(node);
        Some(1)
    }

    /// A frame that is not a request alone.
    fn transmit_on(&mut self, now: Instant, node: u8, out: &mut Frame) -> Option<usize> {
        let deadline = now.plus_ns(self.timeout_ns);
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.long.and_then(|at| self.longs.get_mut(usize::from(at)));
        let (bytes, more) = channel.emit(deadline, long);
        *out = sdo_frame(node, bytes);
        if channel.guards() {
            *out = guard(node);
        }
        self.counters.sent += 1;
        self.unsent.remove(node);
        self.blocks.remove(node);
        if more {
            self.blocks.insert(node);
            self.ahead = self.ahead.max(now).plus_ns(self.segment_ns);
        }
        self.waiting.insert(node);
        Some(1)
    }

    /// When more segments of blocks are to be sent: half of those ahead at once, lest each wakes
    /// somebody.
    fn blocks_due(&self) -> Option<Instant> {
        let half = AHEAD_MAX / 2 * self.segment_ns;
        self.blocks.first().map(|_| Instant(self.ahead.0.saturating_sub(half)))
    }
}

#[inline]
fn sdo_frame(node: u8, data: [u8; 8]) -> Frame {
    let id = u32::from(cob::SDO_REQUEST | u16::from(node));
    Frame { id, extended: false, remote: false, len: 8, data }
}

impl station::Host<Can> for Host {
    type Request = Ask;
    type Answer = Answer;
    const PARALLEL: bool = true;

    #[inline]
    fn submit(&mut self, now: Instant, ticket: Ticket, request: Ask) -> Result<(), Ask> {
        self.network.renew(now);
        // What is asked most goes ahead of everything else.
        let Ask::Read { node: node @ 1..=NODE_MAX, object } = request else {
            return self.submit_any(now, ticket, request);
        };
        let channel = &mut self.channels[usize::from(node)];
        if !channel.is_idle() {
            return Err(request);
        }
        channel.read(ticket, node, object);
        self.unsent.insert(node);
        Ok(())
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.events.next()
    }

    fn emit(&self, request: &Ask, out: &mut Frame) -> usize {
        let frame = match (request.node(), *request) {
            (Some(node), Ask::Guard { .. }) => Some(guard(node)),
            (Some(node), Ask::Watch { ms, .. }) => {
                channel::first(&self.network.watched(node, ms)).map(|first| first.emit(node))
            }
            (Some(node), ask) => channel::first(&ask).map(|first| first.emit(node)),
            (None, Ask::Lss(lss)) => Some(lss.emit()),
            (None, Ask::FastScan) => Some(fast_scan::BEGIN.emit()),
            (None, ask) => Self::frame_of(&ask),
        };
        let count = usize::from(frame.is_some());
        *out = frame.unwrap_or_default();
        count
    }

    fn keeps_alive(&self) -> bool {
        self.network.keeps_alive()
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    #[inline]
    fn say(&mut self, now: Instant, request: &Ask, out: &mut Frame) -> usize {
        self.network.renew(now);
        let Some(frame) = Self::frame_of(request) else { return 0 };
        *out = frame;
        self.counters.sent += 1;
        1
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        let (at, node) = self.long_of(ticket, false)?;
        let taken = self.longs[at].take(out);
        self.stirred(at, node);
        Some(taken)
    }

    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        let (at, node) = self.long_of(ticket, true)?;
        let taken = self.longs[at].give(bytes);
        self.stirred(at, node);
        Some(taken)
    }
}

/// The node that sent a frame: its heartbeat, its service data, its emergency.
pub(super) fn sender(_options: &HostOptions, frame: &Frame) -> Option<u32> {
    if frame.extended || frame.remote {
        return None;
    }
    match Cob::of(u16::try_from(frame.id).ok()?) {
        Cob::Heartbeat(node) if frame.len == 1 => Some(node.into()),
        Cob::SdoReply(node) if frame.len == 8 => Some(node.into()),
        Cob::Emcy(node) if matches!(frame.len, 2 | 8) => Some(node.into()),
        _ => None,
    }
}
