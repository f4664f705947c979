//! The host end: network master and SDO client.
//!
//! Each node has one open request, and many nodes can have one at once. A reply is accepted only if its
//! node has a request, and it names this object or continues this transfer. After a missing reply, no reply
//! about the same object is accepted until another object was answered, because a node replies in order
//! (CiA 301, 7.2.4.2 aborts the transfer meanwhile).

mod channel;
mod lss_master;
mod network;
mod node_set;
mod transfer;
mod transfer_buffer;

use super::cob::{self, Cob};
use super::heartbeat::{Heartbeat, guarding_request};
use super::host_request::{Answer, HostRequest};
use super::nmt;
use super::sdo::AbortCode;
use super::sync::SyncMessage;
use super::{NODE_MAX, lss};
use crate::error::Failure;
use crate::medium::bits::bit_time_ns;
use crate::medium::{Can, CanLine, Frame};
use crate::proto::HostOptions;
use crate::proto::early_bytes::with_clock_tolerance;
use crate::proto::event_ring::EventRing;
use crate::station::{
    self, Counters, EventSubject, HostEvent, LineEvent, Request as _, RequestClass, Station,
    Ticket, Timed,
};
use crate::time::{Instant, earliest};
use channel::{ChannelStep, NodeChannel, ReplyKind};
use lss_master::LssMaster;
use network::Network;
use node_set::NodeSet;
use transfer_buffer::TransferBuffer;

/// Default time-out of a reply, ms.
pub const REPLY_TIMEOUT_MS: u32 = 200;
/// The host's node-ID: the last one.
pub const HOST_ID: u8 = NODE_MAX;
/// Time that a stop waits for an outstanding reply of its node, ms.
const STOP_PATIENCE_MS: u32 = 10;
/// Long transfers at once.
pub const LONG_TRANSFERS_MAX: usize = 4;
/// Frames without answer that wait to be sent.
// Orders are not answered, so a caller who sends more than these at once waits for the bus.
const FRAMES_MAX: usize = 16;
/// Room for the end of every request, and as much again for unsolicited messages.
const EVENTS_MAX: usize = 512;
/// Part of that which unsolicited messages leave free: every channel, LSS, and frames.
const END_EVENTS_MAX: usize = NODES + FRAMES_MAX + 1;
const NODES: usize = NODE_MAX as usize + 1;
/// Segments of blocks that are sent ahead of the wire: whatever comes after them waits for no more.
const SEGMENTS_AHEAD_MAX: u64 = 8;
/// Assumed bit rate of a wire that reports none.
// The fastest, so that a bus of unknown rate is never flooded less than it can take: segments keep
// their pace.
const ASSUMED_BIT_RATE: u32 = 1_000_000;
/// Bits of a segment without a single stuff bit, with the pause behind it: fewer than it takes, so that
/// the wire is never left idle.
const SEGMENT_BITS: u64 = 47 + 8 * SDO_BYTES as u64;

/// The host on CAN.
#[derive(Debug)]
pub struct CanHost {
    channels: [NodeChannel; NODES],
    /// Nodes whose channel has a frame to send.
    unsent: NodeSet,
    /// Nodes whose channel has more segments of a block to send, when nothing else is.
    block_senders: NodeSet,
    /// Time at which the frames that were sent have left the wire.
    sent_until: Instant,
    /// Time of one segment, ns.
    segment_ns: u64,
    /// Nodes whose transfer is to be aborted.
    aborts: NodeSet,
    /// Nodes whose channel waits for an answer.
    waiting: NodeSet,
    buffers: [TransferBuffer; LONG_TRANSFERS_MAX],
    unanswered_frames: UnansweredFrames,
    lss: LssMaster,
    network: Network,
    events: EventRing<Answer, EVENTS_MAX>,
    counters: Counters,
    timeout_ns: u64,
    /// Shortest time of a request and its reply. An earlier reply is the second copy of an
    /// older reply, which a disturbed last bit makes its sender repeat.
    min_exchange_ns: u64,
    /// When a stop that waits for a node's answer waits no more.
    stop_deadline: Option<Instant>,
    bit_rate: u32,
}

/// Every answer came twice.
const DUPLICATE_NODE: Failure = Failure::NotReady {
    hint: "two nodes answer with this node-ID: disconnect one, give the other a node-ID of its own, \
           and connect again",
};

/// Length of an SDO, always eight bytes (CiA 301, 7.2.4.3).
const SDO_BYTES: u8 = 8;

/// Bits of a request and its reply without a single stuff bit, less the pause behind the last.
const EXCHANGE_BITS: u64 = 2 * (47 + 8 * SDO_BYTES as u64) - 3;

/// A queue of frames without a reply.
#[derive(Debug, Default)]
struct UnansweredFrames {
    ring: [(Option<Ticket>, Frame); FRAMES_MAX],
    popped: usize,
    pushed: usize,
}

impl UnansweredFrames {
    const fn is_full(&self) -> bool {
        self.pushed - self.popped == FRAMES_MAX
    }

    fn push(&mut self, ticket: Option<Ticket>, frame: Frame) {
        debug_assert!(!self.is_full(), "a frame that is taken has room");
        self.ring[self.pushed % FRAMES_MAX] = (ticket, frame);
        self.pushed += 1;
    }

    fn pop(&mut self) -> Option<(Option<Ticket>, Frame)> {
        (self.popped < self.pushed).then(|| {
            self.popped += 1;
            self.ring[(self.popped - 1) % FRAMES_MAX]
        })
    }
}

impl CanHost {
    /// Creates a host with `options`.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let timeout = options.reply_timeout_ms(REPLY_TIMEOUT_MS);
        let id = options.host_address.and_then(|id| u8::try_from(id).ok()).unwrap_or(HOST_ID);
        let bit_rate = if options.bit_rate == 0 { ASSUMED_BIT_RATE } else { options.bit_rate };
        Self {
            channels: [NodeChannel::IDLE; NODES],
            unsent: NodeSet::EMPTY,
            block_senders: NodeSet::EMPTY,
            sent_until: Instant::ZERO,
            segment_ns: SEGMENT_BITS * 1_000_000_000 / u64::from(bit_rate),
            aborts: NodeSet::EMPTY,
            waiting: NodeSet::EMPTY,
            buffers: [TransferBuffer::FREE; LONG_TRANSFERS_MAX],
            unanswered_frames: UnansweredFrames::default(),
            lss: LssMaster::new(options.timeout_scale),
            network: Network::new(id, options.heartbeat_ms),
            events: EventRing::new(),
            counters: Counters::default(),
            timeout_ns: u64::from(timeout) * 1_000_000,
            min_exchange_ns: with_clock_tolerance(bit_time_ns(EXCHANGE_BITS, options.bit_rate)),
            stop_deadline: None,
            bit_rate: options.bit_rate,
        }
    }

    /// The last reported state of a node.
    #[must_use]
    pub fn state(&self, node: u8) -> Option<nmt::NmtState> {
        self.network.state(node)
    }

    fn finish_ticket(&mut self, ticket: Ticket, result: Result<Answer, Failure>) {
        self.events.push(EventSubject::Request(ticket), result);
    }

    /// Queues a message that a node sent by itself. A full queue only counts it.
    fn push_unsolicited(&mut self, node: u8, answer: Answer) {
        // Reports never take the places of ends: a flood of PDOs must not lose an outcome.
        if self.events.room() > END_EVENTS_MAX {
            self.events.push(EventSubject::Unsolicited(node.into()), Ok(answer));
        } else {
            self.counters.late += 1;
        }
    }

    /// Executes a step of a node's transfer.
    #[inline]
    fn apply_step(&mut self, node: u8, step: ChannelStep) {
        match step {
            ChannelStep::Wait => {}
            ChannelStep::Send => {
                self.waiting.remove(node);
                self.block_senders.remove(node);
                self.unsent.insert(node);
            }
            ChannelStep::End(result) => self.finish_transfer(node, result),
            ChannelStep::Abort(abort, result) => {
                // A node that waits for the rest of a transfer takes no other until an abort ends this one.
                self.channels[usize::from(node)].abort = abort;
                self.aborts.insert(node);
                self.finish_transfer(node, result);
            }
        }
    }

    #[inline]
    fn finish_transfer(&mut self, node: u8, result: Result<Answer, Failure>) {
        let channel = &mut self.channels[usize::from(node)];
        self.unsent.remove(node);
        self.block_senders.remove(node);
        self.waiting.remove(node);
        if let Some(long) = channel.finish().and_then(|at| self.buffers.get_mut(at)) {
            debug_assert!(!long.is_free(), "a transfer ends once");
            long.end();
        }
        let ticket = channel.ticket;
        if let Ok(answer) = &result {
            self.network.learn_heartbeat_time(node, answer);
        }
        self.finish_ticket(ticket, result);
    }

    #[inline]
    fn handle_sdo_reply(&mut self, now: Instant, node: u8, frame: &Frame) {
        // A frame that arrives before the request is sent answers an older one.
        let channel = &mut self.channels[usize::from(node)];
        // The deadline was set when the request left. Nothing can answer within less than both frames take
        // (REQ-5).
        let sent = channel.deadline.0.saturating_sub(self.timeout_ns);
        let soon = now.0 < sent + self.min_exchange_ns && channel.buffer.is_none();
        if !self.waiting.contains(node) || soon {
            channel.note_repeated_reply(frame.data);
            self.counters.late += 1;
            return;
        }
        if let Some(answer) = channel.finish_expedited(frame.data) {
            let ticket = channel.ticket;
            self.waiting.remove(node);
            self.counters.answered += 1;
            self.network.learn_heartbeat_time(node, &answer);
            debug_assert!(self.events.room() > 0, "ends have places of their own");
            self.events.push(EventSubject::Request(ticket), Ok(answer));
            return;
        }
        self.continue_transfer(now, node, frame);
    }

    /// A reply that is not all there is to it.
    fn continue_transfer(&mut self, now: Instant, node: u8, frame: &Frame) {
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.buffer.and_then(|at| self.buffers.get_mut(usize::from(at)));
        let deadline = now.plus_ns(self.timeout_ns);
        let (step, sort) = channel.handle_reply(deadline, frame.data, long);
        match sort {
            ReplyKind::Expected => self.counters.answered += 1,
            ReplyKind::Late => self.counters.late += 1,
        }
        self.apply_step(node, step);
    }

    fn handle_heartbeat(&mut self, now: Instant, node: u8, data: &[u8]) {
        let Ok(beat) = Heartbeat::parse(data) else {
            self.counters.corrupt += 1;
            return;
        };
        let channel = &mut self.channels[usize::from(node)];
        if channel.awaits_guard() {
            self.counters.answered += 1;
            // A toggle bit that does not change is an old frame, or another node of that number (CiA 301,
            // 7.2.8.3.2.1).
            let result = if self.network.note_guarding(node, beat) {
                Ok(Answer::State(beat.state))
            } else {
                Err(Failure::Misbehaved)
            };
            return self.finish_transfer(node, result);
        }
        if beat.state == nmt::NmtState::BootUp && channel.is_mid_transfer() {
            // It restarted, and what it is sent now would begin something else.
            self.counters.silent += 1;
            self.finish_transfer(node, Err(Failure::Silent));
        }
        if self.network.note_state(now, node, beat.state) {
            self.push_unsolicited(node, Answer::State(beat.state));
        }
    }

    /// Everything that is under way ends so.
    fn fail_all(&mut self, failure: Failure) {
        for node in self.waiting.iter() {
            self.channels[usize::from(node)].preempt();
        }
        for node in self.unsent.union(self.waiting).iter() {
            self.finish_transfer(node, Err(failure));
        }
        // They reach no node, and after the cable is back they would end other transfers.
        self.aborts = NodeSet::EMPTY;
        while let Some((ticket, _)) = self.unanswered_frames.pop() {
            if let Some(ticket) = ticket {
                self.finish_ticket(ticket, Err(failure));
            }
        }
        if let Some((ticket, _)) = self.lss.cancel() {
            self.finish_ticket(ticket, Err(failure));
        }
    }

    fn handle_silence(&mut self, node: u8) {
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.buffer.and_then(|at| self.buffers.get_mut(usize::from(at)));
        let (step, resent) = channel.handle_silence(long);
        self.counters.resent += u64::from(resent);
        if matches!(step, ChannelStep::End(_) | ChannelStep::Abort(..)) {
            self.counters.silent += 1;
        } else if channel.is_beginning() {
            // A transfer that brought nothing is ended at the node as well.
            self.aborts.insert(node);
        }
        self.apply_step(node, step);
    }

    fn encode_frame(request: &HostRequest) -> Option<Frame> {
        Some(match *request {
            HostRequest::Nmt(message) => message.emit(),
            HostRequest::Process { cob, data, len } => {
                let mut frame = Frame::standard(cob.id(), &data.to_le_bytes());
                frame.len = len.min(8);
                frame.data[usize::from(frame.len)..].fill(0);
                frame
            }
            HostRequest::Sync(counter) => SyncMessage { counter }.emit(),
            HostRequest::Time(time) => time.emit(),
            _ => return None,
        })
    }

    /// Submits any request except the usual ones. Never inlined: it would turn all of them into one jump
    /// table.
    #[inline(never)]
    fn submit_slow_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        match request {
            HostRequest::Read { .. }
            | HostRequest::Write { .. }
            | HostRequest::Upload { .. }
            | HostRequest::Download { .. }
            | HostRequest::Guard { .. } => self.submit_channel(now, ticket, request),
            HostRequest::WatchHeartbeat { node, ms } => {
                let written =
                    self.submit_channel(now, ticket, self.network.watch_request(node, ms));
                written.map_err(|_| request)?;
                self.network.set_watch_time(now, node, ms);
                Ok(())
            }
            HostRequest::Lss(lss) => self.lss.submit(ticket, Some(lss)).map_err(|()| request),
            HostRequest::FastScan => self.lss.submit(ticket, None).map_err(|()| request),
            HostRequest::LastScanned(number) => {
                self.finish_ticket(ticket, self.lss.last_scanned(number));
                Ok(())
            }
            HostRequest::SyncEvery(us) => {
                self.network.set_sync_period(now, us);
                self.finish_ticket(ticket, Ok(Answer::Sent));
                Ok(())
            }
            _ => {
                let frame =
                    Self::encode_frame(&request).filter(|_| !self.unanswered_frames.is_full());
                self.unanswered_frames.push(Some(ticket), frame.ok_or(request)?);
                Ok(())
            }
        }
    }

    #[inline]
    fn submit_channel(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        let node = request.node().filter(|node| (1..=NODE_MAX).contains(node)).ok_or(request)?;
        if !self.channels[usize::from(node)].is_idle()
            && !self.preempt_for_stop(now, node, &request)
        {
            return Err(request);
        }
        let channel = &mut self.channels[usize::from(node)];
        if channel.has_duplicate_node()
            && !matches!(request.class(), RequestClass::Idempotent | RequestClass::Stop)
        {
            self.finish_ticket(ticket, Err(DUPLICATE_NODE));
            return Ok(());
        }
        let mut long = None;
        if matches!(request, HostRequest::Upload { .. } | HostRequest::Download { .. }) {
            let free = self.buffers.iter().position(TransferBuffer::is_free).ok_or(request)?;
            self.buffers[free].begin(ticket, node, &request);
            long = Some(free as u8);
        }
        channel.begin(ticket, request, long);
        self.unsent.insert(node);
        Ok(())
    }

    /// Ends a request that a node does not answer, to make room for a stop: at once if it was not sent,
    /// otherwise after a moment that is nearly always long enough for its reply.
    fn preempt_for_stop(&mut self, now: Instant, node: u8, request: &HostRequest) -> bool {
        let channel = &mut self.channels[usize::from(node)];
        // Axes of one node share its channel; the stop of one does not cut short the stop of another.
        let other_axis = channel.host_request.is_of_other_axis(request);
        if !request.is_stop() || channel.is_stop() || other_axis {
            return false;
        }
        if self.unsent.contains(node) {
            self.finish_transfer(node, Err(Failure::Cancelled));
            return true;
        }
        let patience = channel.deadline.0.saturating_sub(self.timeout_ns);
        let patience = Instant(patience).plus_ms(STOP_PATIENCE_MS);
        // In the midst of a block no reply is outstanding.
        if now < patience && !self.block_senders.contains(node) {
            self.stop_deadline = earliest(self.stop_deadline, Some(patience));
            return false;
        }
        debug_assert!(request.is_stop(), "only a stop cuts a transfer short");
        let failure = channel.preempt();
        self.apply_step(node, ChannelStep::Abort(AbortCode::TIMEOUT, Err(failure)));
        true
    }

    /// The long transfer under `ticket`, if it goes that way.
    fn find_buffer(&mut self, ticket: Ticket, writes: bool) -> Option<(usize, u8)> {
        let at = self
            .buffers
            .iter()
            .position(|long| long.belongs_to(ticket) && long.writes == writes)?;
        Some((at, self.buffers[at].node))
    }

    /// The user took or gave bytes: a transfer that waits for that goes on.
    fn resume_transfer(&mut self, at: usize, node: u8) {
        let step = self.channels[usize::from(node)].resume_stalled(&self.buffers[at]);
        self.apply_step(node, step);
    }
}

impl Timed for CanHost {
    fn handle_timeout(&mut self, now: Instant) {
        self.stop_deadline = self.stop_deadline.filter(|urge| *urge > now);
        for node in self.waiting.difference(self.block_senders).iter() {
            if self.channels[usize::from(node)].deadline <= now {
                self.handle_silence(node);
            }
        }
        if let Some((ticket, result)) = self.lss.handle_timeout(now) {
            self.counters.silent += u64::from(result.is_err());
            self.finish_ticket(ticket, result);
        }
        while let Some(node) = self.network.next_lost(now) {
            self.push_unsolicited(node, Answer::HeartbeatLost);
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let waiting = self.waiting.difference(self.block_senders);
        let channels = waiting.iter().map(|n| self.channels[usize::from(n)].deadline).min();
        let channels = earliest(earliest(channels, self.blocks_due()), self.stop_deadline);
        earliest(channels, earliest(self.lss.deadline(), self.network.deadline()))
    }
}

impl Station<Can> for CanHost {
    #[inline]
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        if frame.extended || frame.id > 0x7FF {
            return;
        }
        // The most frequent case is checked first.
        let node = frame.id as u8 & NODE_MAX;
        if frame.id as u16 & !u16::from(NODE_MAX) == cob::SDO_REPLY && !frame.remote && node != 0 {
            if frame.len < SDO_BYTES {
                self.counters.corrupt += 1;
                return;
            }
            return self.handle_sdo_reply(now, node, frame);
        }
        match Cob::of(frame.id as u16) {
            Cob::Tpdo(number, node) if !frame.remote => {
                let data = u64::from_le_bytes(frame.data);
                self.push_unsolicited(node, Answer::Process(number, data, frame.len));
            }
            Cob::Heartbeat(node) if !frame.remote => {
                self.handle_heartbeat(now, node, frame.bytes())
            }
            Cob::Emcy(node) if !frame.remote => {
                match super::emcy::Emergency::parse(frame.bytes()) {
                    Ok(emergency) => self.push_unsolicited(node, Answer::Emergency(emergency)),
                    Err(_) => self.counters.corrupt += 1,
                }
            }
            Cob::LssReply => match lss::LssReply::parse(frame.bytes()) {
                Ok(reply) => match self.lss.handle_reply(now, reply) {
                    Some((ticket, result)) => {
                        self.counters.answered += 1;
                        self.finish_ticket(ticket, result);
                    }
                    None if !self.lss.is_scanning() => self.counters.late += 1,
                    None => {}
                },
                Err(_) => self.counters.corrupt += 1,
            },
            _ => {}
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        match event {
            LineEvent::Down | LineEvent::BusOff => self.fail_all(Failure::LinkDown),
            // Whatever was plugged in since: states are learnt anew.
            LineEvent::Up => self.network.reset(),
            LineEvent::Break | LineEvent::Rate(_) => {}
        }
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        // NMT, SYNC and set-points first: they are due now, and cost no turn-around.
        if let Some((ticket, frame)) = self.unanswered_frames.pop() {
            *out = frame;
            self.counters.sent += 1;
            if let Some(ticket) = ticket {
                self.finish_ticket(ticket, Ok(Answer::Sent));
            }
            return Some(1);
        }
        // Before new requests: one that meets an unfinished transfer is refused.
        if let Some(node) = self.aborts.first() {
            self.aborts.remove(node);
            *out = self.channels[usize::from(node)].abort_frame().emit(node);
            return Some(1);
        }
        if let Some(node) = self.unsent.first() {
            return self.transmit_node(now, node, out);
        }
        if let Some(frame) = self.lss.transmit(now, self.timeout_ns) {
            self.counters.sent += 1;
            *out = frame;
            if let Some((ticket, result)) = self.lss.finish_unanswered() {
                self.finish_ticket(ticket, result);
            }
            return Some(1);
        }
        if let Some(frame) = self.network.transmit(now) {
            *out = frame;
            return Some(1);
        }
        let node = self.block_senders.first()?;
        // Segments come last and keep pace with the wire, so that a stop never waits behind a block
        // (CANOPEN-13).
        let free = self.sent_until < now.plus_ns(SEGMENTS_AHEAD_MAX * self.segment_ns);
        if free { self.transmit_slow_path(now, node, out) } else { None }
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl CanHost {
    #[inline]
    fn transmit_node(&mut self, now: Instant, node: u8, out: &mut Frame) -> Option<usize> {
        let deadline = now.plus_ns(self.timeout_ns);
        let Some(bytes) = self.channels[usize::from(node)].emit_first(deadline) else {
            return self.transmit_slow_path(now, node, out);
        };
        *out = sdo_frame(node, bytes);
        self.counters.sent += 1;
        self.unsent.remove(node);
        self.waiting.insert(node);
        Some(1)
    }

    /// A frame that is not a request alone.
    fn transmit_slow_path(&mut self, now: Instant, node: u8, out: &mut Frame) -> Option<usize> {
        let deadline = now.plus_ns(self.timeout_ns);
        let channel = &mut self.channels[usize::from(node)];
        let long = channel.buffer.and_then(|at| self.buffers.get_mut(usize::from(at)));
        let (bytes, more) = channel.emit(deadline, long);
        *out = sdo_frame(node, bytes);
        if channel.sends_guard() {
            *out = guarding_request(node);
        }
        self.counters.sent += 1;
        self.unsent.remove(node);
        self.block_senders.remove(node);
        if more {
            self.block_senders.insert(node);
            self.sent_until = self.sent_until.max(now).plus_ns(self.segment_ns);
        }
        self.waiting.insert(node);
        Some(1)
    }

    /// Time of the next block segments: half of the pending ones together, to avoid a wake-up for each.
    fn blocks_due(&self) -> Option<Instant> {
        // Woken at half of what is ahead, so that the wire never runs empty in between.
        let half = SEGMENTS_AHEAD_MAX / 2 * self.segment_ns;
        self.block_senders.first().map(|_| Instant(self.sent_until.0.saturating_sub(half)))
    }
}

#[inline]
fn sdo_frame(node: u8, data: [u8; 8]) -> Frame {
    let id = u32::from(cob::SDO_REQUEST | u16::from(node));
    Frame { id, extended: false, remote: false, len: 8, data }
}

impl station::HostWire for CanHost {
    fn sends_keepalive(&self) -> bool {
        self.network.sends_keepalive()
    }
}

impl station::HostData for CanHost {
    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        let (at, node) = self.find_buffer(ticket, false)?;
        let consumed = self.buffers[at].read_bytes(out);
        self.resume_transfer(at, node);
        Some(consumed)
    }

    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        let (at, node) = self.find_buffer(ticket, true)?;
        let consumed = self.buffers[at].write_bytes(bytes);
        self.resume_transfer(at, node);
        Some(consumed)
    }
}

impl station::Host<Can> for CanHost {
    type Request = HostRequest;

    type Answer = Answer;

    const PARALLEL: bool = true;

    #[inline]
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        self.network.renew_lease(now);
        // The most frequent request is checked first.
        let HostRequest::Read { node: node @ 1..=NODE_MAX, object } = request else {
            return self.submit_slow_path(now, ticket, request);
        };
        let channel = &mut self.channels[usize::from(node)];
        if !channel.is_idle() {
            return Err(request);
        }
        channel.begin_read(ticket, node, object);
        self.unsent.insert(node);
        Ok(())
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.events.next()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut Frame) -> usize {
        let frame = match (request.node(), *request) {
            (Some(node), HostRequest::Guard { .. }) => Some(guarding_request(node)),
            (Some(node), HostRequest::WatchHeartbeat { ms, .. }) => {
                channel::first_request(&self.network.watch_request(node, ms))
                    .map(|first| first.emit(node))
            }
            (Some(node), host_request) => {
                channel::first_request(&host_request).map(|first| first.emit(node))
            }
            (None, HostRequest::Lss(lss)) => Some(lss.emit()),
            (None, HostRequest::FastScan) => Some(lss_master::BEGIN_REQUEST.emit()),
            (None, host_request) => Self::encode_frame(&host_request),
        };
        let Some(frame) = frame else { return 0 };
        *out = frame;
        1
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    #[inline]
    fn transmit_now(&mut self, now: Instant, request: &HostRequest, out: &mut Frame) -> usize {
        self.network.renew_lease(now);
        let Some(frame) = Self::encode_frame(request) else { return 0 };
        *out = frame;
        self.counters.sent += 1;
        1
    }

    fn bit_rate(&self) -> u32 {
        self.bit_rate
    }
}

/// The node that sent a frame: its heartbeat, its service data, its emergency.
pub(super) fn frame_sender(_options: &HostOptions, frame: &Frame) -> Option<u32> {
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
