//! SDO transfers: one at a time on each channel, expedited, segmented or by blocks (CiA 301, 7.2.4).
//! Transfers that began before the capture are not reported as errors.

mod block;
mod reply;
mod request;

use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::sdo::{
    AbortCode, ObjectIndex, SEGMENT, SdoReply, SdoRequest, crc,
};

use super::anomaly;
use crate::session::{AnomalyKind, AnomalyNotice, ExchangeNotice, ExchangeOutcome, SessionNotice};
use crate::timestamp::Timestamp;
use block::BlockBuffer;

/// Time for a node's reply, and for a client's next frame, ns.
pub(super) const TIMEOUT_NS: u64 = 1_000_000_000;
/// Time for a reply after writing flash: store, restore, programs.
pub(super) const FLASH_TIMEOUT_NS: u64 = 10_000_000_000;
/// An answer that was given up is waited for as many times as long: late is not lost.
const LATE_FACTOR: u64 = 3;
/// Time in which a write takes effect, ns.
const RECENT_NS: u64 = 100_000_000;
/// Bytes of a value that are kept: the head of perhaps megabytes.
pub(super) const HEAD_MAX: usize = 1024;
/// Number of requests in a row that are answered twice, which proves two nodes with the number.
const DOUBLE_ANSWERS_MAX: u8 = 3;

/// Number and time of a frame.
pub(super) type FrameRef = (u64, Option<Timestamp>);

/// Reading or writing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum SdoOperation {
    Read,
    Write,
}

impl SdoOperation {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "SDO read",
            Self::Write => "SDO write",
        }
    }
}

/// Role of a frame in its transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum TransferPart {
    /// No role beyond its own text.
    Plain,
    /// One of several.
    Segment(u32),
    /// A segment of a block, which has no words of its own.
    BlockSegment(u32),
    /// The last: the value is there.
    Complete,
}

/// A value that was read or written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct TransferredValue {
    pub op: SdoOperation,
    pub object: ObjectIndex,
    /// Up to eight bytes, the first lowest, and their number; 0 if the frame does not state it.
    pub bits: u64,
    pub len: u8,
    /// The frame that asked.
    pub request_number: u64,
}

/// Phase of a transfer: the next frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum TransferPhase {
    /// The node answers the first frame.
    First,
    /// The client sends a segment, or asks for one.
    Client,
    /// The node takes a segment, or sends one.
    Node,
    /// The client sends a block.
    BlockDown,
    /// Acknowledgement of the node for a block.
    BlockDownAck,
    /// End of the client's data.
    BlockDownEnd,
    /// The node has checked everything.
    BlockDownDone,
    /// The client wants the first block.
    BlockUpStart,
    /// The node sends a block.
    BlockUp,
    /// Acknowledgement of the client for a block.
    BlockUpAck,
    /// End of the node's data.
    BlockUpEnd,
    /// The client has checked everything.
    BlockUpDone,
}

impl TransferPhase {
    const fn is_node_turn(self) -> bool {
        matches!(
            self,
            Self::First
                | Self::Node
                | Self::BlockDownAck
                | Self::BlockDownDone
                | Self::BlockUp
                | Self::BlockUpEnd
        )
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ChannelState {
    /// Middle of a transfer that began before, until the next begins.
    Unsynced,
    Idle,
    Open,
}

/// One transfer, also after its end.
#[derive(Debug)]
struct SdoTransfer {
    op: SdoOperation,
    object: ObjectIndex,
    requested: FrameRef,
    answered: Option<FrameRef>,
    retries: u16,
    /// The client's last frame.
    request: [u8; 8],
    phase: TransferPhase,
    toggle: bool,
    last_segment: bool,
    size: Option<u32>,
    received: u32,
    segments: u32,
    value_head: Vec<u8>,
    /// True if the frame with the value did not state its length.
    size_unknown: bool,
    crc: u16,
    crc_agreed: bool,
    block: BlockBuffer,
    /// True if its anomaly was reported.
    anomaly_reported: bool,
    /// True if it may be the middle of one that began before the capture.
    doubtful: bool,
    /// Time of the last progress.
    last_progress: Option<Timestamp>,
}

/// A request that is waited for no more, and may be answered yet.
#[derive(Debug)]
struct AbandonedRequest {
    op: SdoOperation,
    object: ObjectIndex,
    requested: FrameRef,
    /// Time after which no answer is expected any longer.
    until: Option<Timestamp>,
    /// Notices of a missing reply, given if none comes by then.
    held_notices: Vec<SessionNotice>,
}

/// A channel between a client and a node.
#[derive(Debug)]
pub(super) struct SdoChannel {
    pub node: u8,
    state: ChannelState,
    transfer: SdoTransfer,
    /// Request that was given up, and may still be answered.
    abandoned: Option<AbandonedRequest>,
    /// The node's last frame.
    last_reply: [u8; 8],
    /// Answers that earlier, repeated requests may still get.
    extra_replies: u16,
    /// Requests in a row that were answered twice.
    double_answers: u8,
    /// The last one was.
    last_doubled: bool,
    /// Time since which its state is unknown.
    unsynced_since: Option<Timestamp>,
    transferred: Option<TransferredValue>,
}

impl SdoChannel {
    /// A channel without any frame up to the beginning of the capture, `since`.
    pub fn new(node: u8, since: Option<Timestamp>) -> Self {
        Self {
            node,
            state: ChannelState::Unsynced,
            transfer: SdoTransfer::new(),
            abandoned: None,
            last_reply: [0xFF; 8],
            extra_replies: 0,
            double_answers: 0,
            last_doubled: false,
            unsynced_since: since,
            transferred: None,
        }
    }

    /// The capture begins.
    pub const fn set_start(&mut self, began: Option<Timestamp>) {
        self.unsynced_since = began;
    }

    /// The object that a transfer under way is about, or was.
    pub fn object(&self) -> ObjectIndex {
        self.transfer.object
    }

    /// Returns whether eight bytes to the node are a read that follows no part of a longer transfer.
    pub fn begins_read(&self, bytes: [u8; 8]) -> bool {
        let is_between = match self.state {
            ChannelState::Unsynced => false,
            ChannelState::Idle => true,
            ChannelState::Open => self.transfer.phase == TransferPhase::First,
        };
        is_between && matches!(SdoRequest::of(bytes), SdoRequest::Read(_))
    }

    /// Returns whether eight bytes from the node are the whole value that it was asked for.
    pub fn ends_read(&self, bytes: [u8; 8]) -> bool {
        let t = &self.transfer;
        self.state == ChannelState::Open
            && (t.phase, t.op) == (TransferPhase::First, SdoOperation::Read)
            && matches!(SdoReply::of(bytes), SdoReply::Value(object, _) if object == t.object)
    }

    /// An object is being written, or was a moment ago.
    pub fn is_writing(&self, object: ObjectIndex, now: Option<Timestamp>) -> bool {
        let t = &self.transfer;
        let since = t.last_progress.zip(now).map_or(0, |(moved, now)| now.since(moved));
        (t.op, t.object) == (SdoOperation::Write, object) && since < RECENT_NS
    }

    /// Result of the last transfer: head of the value, its length, and the number of segments.
    pub fn value(&self) -> (&[u8], u32, u32) {
        (&self.transfer.value_head, self.transfer.received, self.transfer.segments)
    }

    /// Number of all segments, if the size was stated.
    pub fn segment_total(&self) -> Option<u32> {
        Some(self.transfer.size?.div_ceil(SEGMENT as u32))
    }

    /// Takes the read or written value.
    pub fn take_transferred(&mut self) -> Option<TransferredValue> {
        self.transferred.take()
    }

    /// Both answered the same requests, time and again.
    pub fn is_answered_by_two(&self) -> bool {
        self.double_answers >= DOUBLE_ANSWERS_MAX
    }

    /// Time at which a notice is due if nothing arrives.
    pub fn due(&self) -> Option<Timestamp> {
        let held = self.abandoned.as_ref().filter(|given_up| !given_up.held_notices.is_empty());
        let until = held.and_then(|given_up| given_up.until);
        self.transfer_due().into_iter().chain(until).min()
    }

    /// Time at which the transfer is given up unless a frame arrives.
    fn transfer_due(&self) -> Option<Timestamp> {
        let moved = self.transfer.last_progress.filter(|_| self.state == ChannelState::Open)?;
        Some(moved.plus(self.transfer.timeout_ns()))
    }

    /// Time went on to `now`.
    pub fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        if self.transfer_due().is_some_and(|due| due < now) {
            let ms = self.transfer.timeout_ns() / 1_000_000;
            self.give_up_transfer(&format!(" within {ms} ms"), notices);
        }
        let until = self.abandoned.as_ref().and_then(|given_up| given_up.until);
        if until.is_some_and(|until| until < now) {
            self.release_held(notices);
        }
    }

    /// Holds the notices of a missing reply, from index `before` on: if the reply still arrives, it is late, and
    /// nothing else.
    pub fn hold_unanswered(
        &mut self,
        before: usize,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Some(given_up) = self.abandoned.as_mut().filter(|it| it.until.is_some()) else {
            return;
        };
        let mut at = before;
        while at < notices.len() {
            let mine = match &mut notices[at] {
                SessionNotice::Anomaly(anomaly) if is_unanswered(anomaly) => {
                    anomaly.time = now;
                    true
                }
                SessionNotice::Exchange(exchange) => exchange.requested == given_up.requested,
                _ => false,
            };
            if mine { given_up.held_notices.push(notices.remove(at)) } else { at += 1 }
        }
    }

    /// No answer came.
    fn release_held(&mut self, notices: &mut Vec<SessionNotice>) {
        notices
            .extend(self.abandoned.iter_mut().flat_map(|given_up| given_up.held_notices.drain(..)));
    }

    /// Abandons the transfer, which may still be answered.
    fn abandon_transfer(&mut self, notices: &mut Vec<SessionNotice>) {
        self.release_held(notices);
        let t = &self.transfer;
        // In the middle of a transfer a late frame would be one of its segments, which no new transfer takes.
        let moved = t.last_progress.filter(|_| t.phase == TransferPhase::First);
        let until = moved.map(|moved| moved.plus(LATE_FACTOR * t.timeout_ns()));
        let (op, object, request) = (t.op, t.object, t.requested);
        self.abandoned = Some(AbandonedRequest {
            op,
            object,
            requested: request,
            until,
            held_notices: Vec::new(),
        });
    }

    /// The capture ends. Who was not given the time to answer is not accused.
    pub fn finish(&mut self, notices: &mut Vec<SessionNotice>) {
        self.release_held(notices);
        if self.state == ChannelState::Open && !self.transfer.doubtful {
            self.close_transfer(ExchangeOutcome::Unknown, None, notices);
        }
    }

    /// The node starts again: open transfers end without an answer. A request of a moment ago
    /// may have met the boot-up on its way, or was written down before it: its answer may yet come.
    pub fn reset(&mut self, now: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        if self.state == ChannelState::Open {
            let since =
                self.transfer.last_progress.zip(now).map_or(0, |(moved, now)| now.since(moved));
            if self.transfer.phase == TransferPhase::First && since < RECENT_NS {
                return;
            }
            self.give_up_transfer(" before the node started again", notices);
        }
        self.extra_replies = 0;
        // An answer to what was given up before may come behind the boot-up, too.
        let may_come =
            self.abandoned.as_ref().is_some_and(|given_up| match (given_up.until, now) {
                (Some(until), Some(now)) => now <= until,
                (_, now) => now.is_none(),
            });
        if !may_come {
            self.release_held(notices);
            self.abandoned = None;
        }
    }

    /// Gives up the running transfer.
    fn give_up_transfer(&mut self, why: &str, notices: &mut Vec<SessionNotice>) {
        self.abandon_transfer(notices);
        let t = &self.transfer;
        let spelled = t.description();
        let (kind, text) = match t.phase {
            TransferPhase::First => {
                (AnomalyKind::Unanswered, format!("{spelled} was not answered{why}"))
            }
            phase => {
                let who = if phase.is_node_turn() { "the node" } else { "the client" };
                let how = format!("{who} did not go on after {}{why}", t.progress_text());
                (AnomalyKind::Incomplete, format!("{spelled} was broken off: {how}"))
            }
        };
        self.report_once(kind, text, notices);
        let outcome = self.transfer.abandoned_outcome();
        self.close_transfer(outcome, None, notices);
    }

    /// Reports the anomaly of the transfer, once.
    fn report_once(&mut self, kind: AnomalyKind, text: String, notices: &mut Vec<SessionNotice>) {
        if !core::mem::replace(&mut self.transfer.anomaly_reported, true) {
            notices.push(anomaly(kind, self.node, text));
        }
    }

    /// The transfer ends.
    fn close_transfer(
        &mut self,
        outcome: ExchangeOutcome,
        answered: Option<FrameRef>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let t = &self.transfer;
        self.state = ChannelState::Idle;
        // Each repetition may still get its own reply.
        self.extra_replies = t.retries;
        notices.push(SessionNotice::Exchange(ExchangeNotice {
            axis: Some(self.node.into()),
            op: t.op.name(),
            requested: t.requested,
            answered: answered.or(t.answered),
            outcome,
            retries: t.retries,
        }));
    }

    /// The transfer is done.
    fn complete_transfer(
        &mut self,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &self.transfer;
        if let Some(size) = t.size.filter(|size| *size != t.received) {
            let text = format!("{} announced {size} bytes and had {}", t.description(), t.received);
            self.report_once(AnomalyKind::Length, text, notices);
        }
        let t = &self.transfer;
        self.transferred = t.transferred_value();
        let answered = t.answered.unwrap_or(at);
        self.close_transfer(ExchangeOutcome::Done, Some(answered), notices);
        TransferPart::Complete
    }

    /// The node gives the transfer up.
    fn refuse_transfer(
        &mut self,
        abort: AbortCode,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) {
        let text =
            format!("{} was refused: {}", self.transfer.description(), meanings::abort_text(abort));
        self.report_once(AnomalyKind::Refused, text, notices);
        self.close_transfer(ExchangeOutcome::Refused, Some(at), notices);
    }
}

impl SdoTransfer {
    fn new() -> Self {
        Self {
            op: SdoOperation::Read,
            object: ObjectIndex::default(),
            requested: (0, None),
            answered: None,
            retries: 0,
            request: [0; 8],
            phase: TransferPhase::First,
            toggle: false,
            last_segment: false,
            size: None,
            received: 0,
            segments: 0,
            value_head: Vec::new(),
            size_unknown: false,
            crc: 0,
            crc_agreed: false,
            block: BlockBuffer::default(),
            anomaly_reported: false,
            doubtful: false,
            last_progress: None,
        }
    }

    /// Begins anew, in the same buffers.
    fn begin(&mut self, op: SdoOperation, object: ObjectIndex, request: [u8; 8], at: FrameRef) {
        let (head, block) =
            (core::mem::take(&mut self.value_head), core::mem::take(&mut self.block));
        *self = Self {
            op,
            object,
            request,
            requested: at,
            last_progress: at.1,
            value_head: head,
            block,
            ..Self::new()
        };
        self.value_head.clear();
        self.block.clear();
    }

    /// Takes bytes of the value.
    fn append_bytes(&mut self, bytes: &[u8]) {
        self.received = self.received.saturating_add(bytes.len() as u32);
        self.crc = crc(self.crc, bytes);
        // The check goes on over all bytes; only the head is kept.
        let capacity = HEAD_MAX.saturating_sub(self.value_head.len());
        self.value_head.extend_from_slice(&bytes[..bytes.len().min(capacity)]);
    }

    /// The value, where it is short enough to be a number.
    fn transferred_value(&self) -> Option<TransferredValue> {
        let len = u8::try_from(self.received)
            .ok()
            .filter(|len| *len <= 8 && !self.value_head.is_empty())?;
        debug_assert!(self.value_head.len() <= 8);
        let bits = super::bytes_to_word(&self.value_head);
        let len = if self.size_unknown { 0 } else { len };
        Some(TransferredValue {
            op: self.op,
            object: self.object,
            bits,
            len,
            request_number: self.requested.0,
        })
    }

    fn timeout_ns(&self) -> u64 {
        match self.object.index {
            // Store, restore, program data and program control (CiA 301, CiA 302-3).
            0x1010 | 0x1011 | 0x1F50 | 0x1F51 => FLASH_TIMEOUT_NS,
            _ => TIMEOUT_NS,
        }
    }

    /// Outcome of an abandoned transfer: a partial write may have had an effect.
    const fn abandoned_outcome(&self) -> ExchangeOutcome {
        match (self.op, self.phase) {
            (_, TransferPhase::First) | (SdoOperation::Read, _) => ExchangeOutcome::Unanswered,
            (SdoOperation::Write, _) => ExchangeOutcome::Unknown,
        }
    }

    fn description(&self) -> String {
        let ObjectIndex { index, sub } = self.object;
        let verb = if self.op == SdoOperation::Read { "reading" } else { "writing" };
        format!("{verb} 0x{index:04X}:{sub}")
    }

    fn progress_text(&self) -> String {
        match (self.segments, self.size) {
            (0, _) => "the first frame".to_owned(),
            (n, Some(size)) => format!("{} of {size} bytes, {n} segments", self.received),
            (n, None) => format!("{} bytes, {n} segments", self.received),
        }
    }
}

/// Returns whether it is a notice given now: a held one has its own time.
pub(super) fn is_unanswered(anomaly: &AnomalyNotice) -> bool {
    anomaly.kind == AnomalyKind::Unanswered && anomaly.time.is_none()
}
