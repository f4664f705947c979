//! The SDO channel of one node: one transfer at a time, from its first frame to its end.
//!
//! Why: CANOPEN-1, SPEED-5.

use super::transfer_buffer::{OutgoingSegment, TransferBuffer};
use crate::error::{Failure, Unsupported};
use crate::proto::canopen::host_request::{Answer, HostRequest};
use crate::proto::canopen::sdo::{
    AbortCode, BlockSegment, ExpeditedData, ObjectIndex, SEGMENT, SdoReply, SdoRequest, Segment,
    read_answer,
};
use crate::station::{RequestClass, Ticket};
use crate::time::Instant;

/// The caller of a long transfer neither took nor gave bytes, so it was ended.
const IDLE_CALLER: Failure = Failure::Impossible(Unsupported::Forbidden(
    "the program that asked for this transfer moved no bytes of it in time, so it was ended",
));

/// Times that a read or a stop is sent in all.
const ATTEMPTS_MAX: u8 = 3;
/// Duplicated replies in a row that prove two nodes.
const REPEATED_MAX: u8 = 3;
/// Objects of probes: every node has one, and replies with any value.
const PROBES: [ObjectIndex; 2] = [ObjectIndex::new(0x1000, 0), ObjectIndex::new(0x1001, 0)];

/// Stage of a transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ChannelStage {
    Idle,
    /// A stop goes ahead of the probe.
    StopFirst,
    /// Reads another object, so that older replies arrive first.
    Probe,
    Request,
    Guard,
    /// Segments come.
    Reading,
    /// Segments go.
    Writing,
    /// The blocks may begin.
    BlockStart,
    /// Segments of a block are received; number so far.
    BlockReading(u8),
    /// All data has arrived; only the end is missing.
    BlockReadEnd,
    /// The end is to be confirmed.
    BlockReadDone,
    /// The transfer has ended, except for reading its bytes.
    Drain,
    /// Segments of a block are sent; number so far.
    BlockWriting(u8),
    /// All are sent, and acknowledged.
    BlockWriteEnd,
}

/// Next step.
#[derive(Clone, Copy, Debug)]
pub enum ChannelStep {
    /// Nothing to do until a frame arrives.
    Wait,
    /// A frame is to be sent.
    Send,
    /// The transfer has ended.
    End(Result<Answer, Failure>),
    /// The transfer has ended, and the node receives an abort.
    Abort(AbortCode, Result<Answer, Failure>),
}

/// Kind of a reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ReplyKind {
    /// The one waited for.
    Expected,
    /// One that nothing waits for.
    Late,
}

/// Objects whose replies may still arrive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StaleAnswers {
    None,
    One(ObjectIndex),
    /// Several: any may be one.
    All,
}

impl StaleAnswers {
    #[inline]
    pub fn contains(self, object: ObjectIndex) -> bool {
        match self {
            Self::None => false,
            Self::One(other) => other == object,
            Self::All => true,
        }
    }

    pub fn insert(&mut self, object: ObjectIndex) {
        *self = match *self {
            Self::One(other) if other != object => Self::All,
            Self::All => Self::All,
            _ => Self::One(object),
        };
    }
}

#[derive(Clone, Copy, Debug)]
pub struct NodeChannel {
    pub ticket: Ticket,
    pub deadline: Instant,
    /// Place of its bytes, if it is a long transfer.
    pub buffer: Option<u8>,
    /// Code with which the last transfer was aborted.
    pub abort: AbortCode,
    pub(super) stage: ChannelStage,
    pub(super) host_request: HostRequest,
    /// First frame of the transfer.
    first_frame: [u8; 8],
    pub(super) toggle: bool,
    /// One segment had the other's toggle: a copy.
    pub(super) duplicate_seen: bool,
    pub(super) stalled: bool,
    /// Both can compute the check.
    pub(super) uses_crc: bool,
    pub(super) attempts: u8,
    /// Segments of a block.
    pub(super) segments: u8,
    /// Bytes that went over.
    pub(super) bytes_done: u32,
    /// Size in bytes by the node, if stated.
    pub(super) size: Option<u32>,
    /// The first eight of them.
    pub(super) bits: u64,
    pub(super) stale_answers: StaleAnswers,
    /// Last requested object, to which an abort refers.
    last_object: ObjectIndex,
    /// The answer to it came again, and how many answers in a row did.
    repeated: bool,
    repeated_streak: u8,
}

const NO_OBJECT: ObjectIndex = ObjectIndex::new(0, 0);

/// First frame of a request.
#[inline]
pub fn first_request(request: &HostRequest) -> Option<SdoRequest> {
    Some(match *request {
        HostRequest::Read { object, .. } | HostRequest::Upload { object, block: false, .. } => {
            SdoRequest::Read(object)
        }
        HostRequest::Upload { object, block: true, .. } => SdoRequest::ReadBlock {
            object,
            crc: true,
            segments: TransferBuffer::SEGMENTS,
            threshold: 0,
        },
        HostRequest::Write { object, bits, len: len @ 0..=4, .. } => {
            SdoRequest::Write(object, ExpeditedData { bits: bits as u32, len })
        }
        HostRequest::Write { object, len, .. } => SdoRequest::WriteLong(object, Some(len.into())),
        HostRequest::Download { object, block: false, size, .. } => {
            SdoRequest::WriteLong(object, Some(size))
        }
        HostRequest::Download { object, block: true, size, .. } => {
            SdoRequest::WriteBlock { object, crc: true, size: Some(size) }
        }
        _ => return None,
    })
}

impl NodeChannel {
    /// Blocks in a row of which nothing arrived.
    pub(super) const BLOCKS_LOST_MAX: u8 = 3;
    pub const IDLE: Self = Self {
        ticket: Ticket(0),
        deadline: Instant::ZERO,
        buffer: None,
        abort: AbortCode::TIMEOUT,
        stage: ChannelStage::Idle,
        host_request: HostRequest::Sync(None),
        first_frame: [0; 8],
        toggle: false,
        duplicate_seen: false,
        stalled: false,
        uses_crc: false,
        attempts: 0,
        segments: 0,
        bytes_done: 0,
        size: None,
        bits: 0,
        stale_answers: StaleAnswers::None,
        last_object: NO_OBJECT,
        repeated: false,
        repeated_streak: 0,
    };

    #[inline]
    pub fn is_idle(&self) -> bool {
        self.stage == ChannelStage::Idle
    }

    /// Returns whether it is at, or before, its first frame.
    pub fn is_beginning(&self) -> bool {
        matches!(self.stage, ChannelStage::StopFirst | ChannelStage::Probe | ChannelStage::Request)
    }

    /// Returns whether it is beyond its first frame: only its node can continue it.
    pub fn is_mid_transfer(&self) -> bool {
        !matches!(self.stage, ChannelStage::Idle | ChannelStage::Guard | ChannelStage::Drain)
            && !self.is_beginning()
    }

    /// Returns whether it sends a guarding request.
    #[inline]
    pub fn sends_guard(&self) -> bool {
        self.stage == ChannelStage::Guard
    }

    /// Returns whether it waits for a node's state.
    pub fn awaits_guard(&self) -> bool {
        self.sends_guard() && self.attempts > 0
    }

    #[inline]
    pub fn object(&self) -> ObjectIndex {
        self.host_request.object().unwrap_or(NO_OBJECT)
    }

    pub fn is_stop(&self) -> bool {
        matches!(self.host_request, HostRequest::Write { class: RequestClass::Stop, .. })
    }

    pub fn begin(&mut self, ticket: Ticket, request: HostRequest, long: Option<u8>) {
        self.buffer = long;
        let stage = match request {
            HostRequest::Guard { .. } => ChannelStage::Guard,
            _ => self.first_stage(&request),
        };
        self.start(
            ticket,
            request,
            first_request(&request).map_or([0; 8], SdoRequest::bytes),
            stage,
        );
    }

    /// Begins to read.
    #[inline]
    pub fn begin_read(&mut self, ticket: Ticket, node: u8, object: ObjectIndex) {
        let stage = if self.stale_answers.contains(object) {
            ChannelStage::Probe
        } else {
            ChannelStage::Request
        };
        self.start(
            ticket,
            HostRequest::Read { node, object },
            SdoRequest::Read(object).bytes(),
            stage,
        );
    }

    #[inline]
    fn start(&mut self, ticket: Ticket, request: HostRequest, first: [u8; 8], stage: ChannelStage) {
        self.ticket = ticket;
        self.host_request = request;
        self.first_frame = first;
        self.stage = stage;
    }

    /// First stage: the request, or another one where an older reply to the same request may still arrive.
    fn first_stage(&self, request: &HostRequest) -> ChannelStage {
        match request {
            _ if !self.stale_answers.contains(request.object().unwrap_or(NO_OBJECT)) => {
                ChannelStage::Request
            }
            HostRequest::Write { class: RequestClass::Stop, .. } => ChannelStage::StopFirst,
            _ => ChannelStage::Probe,
        }
    }

    /// Resets the progress to before the first frame.
    fn reset_progress(&mut self) {
        (self.toggle, self.duplicate_seen, self.stalled) = (false, false, false);
        (self.bytes_done, self.size, self.bits) = (0, None, 0);
    }

    /// Ends the transfer and returns the place of its bytes. Its state is cleared here, so that what ends
    /// [at once](Self::finish_expedited) has nothing to clear.
    pub fn finish(&mut self) -> Option<usize> {
        self.reset_progress();
        self.record_end(self.object());
        self.buffer.take().map(usize::from)
    }

    #[inline]
    fn record_end(&mut self, object: ObjectIndex) {
        self.last_object = object;
        self.repeated_streak *= u8::from(self.repeated);
        self.repeated = false;
        self.attempts = 0;
        self.stage = ChannelStage::Idle;
    }

    /// Notes an unexpected reply: after an answered request it may be a second reply to it.
    #[cold]
    pub fn note_repeated_reply(&mut self, data: [u8; 8]) {
        // Late copies after silence are usual; without silence a second answer is a second node (CANOPEN-4).
        let again = self.stale_answers == StaleAnswers::None
            && SdoReply::of(data).object() == Some(self.last_object);
        if again && !core::mem::replace(&mut self.repeated, true) {
            self.repeated_streak = self.repeated_streak.saturating_add(1);
        }
    }

    /// Two nodes have this number.
    #[inline]
    pub fn has_duplicate_node(&self) -> bool {
        self.repeated_streak >= REPEATED_MAX
    }

    /// Ends a read with a reply of one frame.
    #[inline]
    pub fn finish_expedited(&mut self, reply: [u8; 8]) -> Option<Answer> {
        if self.stage != ChannelStage::Request || self.buffer.is_some() {
            return None;
        }
        debug_assert_eq!(self.stage, ChannelStage::Request);
        let (object, ExpeditedData { bits, len }) = read_answer(self.first_frame, reply)?;
        self.stale_answers = StaleAnswers::None;
        self.record_end(object);
        Some(Answer::Value { object, bits: bits.into(), len: len.into() })
    }

    /// The abort frame for the last transfer.
    pub fn abort_frame(&mut self) -> SdoRequest {
        SdoRequest::Abort(self.last_object, core::mem::replace(&mut self.abort, AbortCode::TIMEOUT))
    }

    pub fn probe_object(&self) -> ObjectIndex {
        PROBES[usize::from(self.object() == PROBES[0])]
    }

    /// The request, where it goes first and is all that goes.
    #[inline]
    pub fn emit_first(&mut self, deadline: Instant) -> Option<[u8; 8]> {
        (self.stage == ChannelStage::Request).then(|| {
            self.deadline = deadline;
            self.first_frame
        })
    }

    /// The next frame, and whether another one follows it at once.
    pub fn emit(
        &mut self,
        deadline: Instant,
        long: Option<&mut TransferBuffer>,
    ) -> ([u8; 8], bool) {
        self.deadline = deadline;
        match self.stage {
            ChannelStage::Request | ChannelStage::StopFirst => (self.first_frame, false),
            ChannelStage::Probe => (SdoRequest::Read(self.probe_object()).bytes(), false),
            _ => self.emit_later(long),
        }
    }

    fn emit_later(&mut self, long: Option<&mut TransferBuffer>) -> ([u8; 8], bool) {
        let request = match (self.stage, long) {
            (ChannelStage::Reading, _) => SdoRequest::ReadSegment(self.toggle),
            (ChannelStage::Writing, long) => SdoRequest::WriteSegment(self.next_segment(long)),
            (ChannelStage::BlockStart, _) => {
                self.stage = ChannelStage::BlockReading(0);
                self.segments = TransferBuffer::SEGMENTS;
                SdoRequest::ReadBlockStart
            }
            (ChannelStage::BlockReading(arrived), Some(long)) => {
                self.segments = long.free_segments();
                self.stage = if long.has_last() {
                    ChannelStage::BlockReadEnd
                } else {
                    ChannelStage::BlockReading(0)
                };
                SdoRequest::ReadBlockAck { arrived, segments: self.segments.max(1) }
            }
            (ChannelStage::BlockReadDone, _) => {
                self.stage = ChannelStage::Drain;
                self.stalled = true;
                SdoRequest::ReadBlockEnd
            }
            (ChannelStage::BlockWriting(sent), Some(long)) => {
                return self.next_block_segment(sent, long);
            }
            (ChannelStage::BlockWriteEnd, Some(long)) => {
                let (unused, crc) = long.block_end();
                SdoRequest::WriteBlockEnd { unused, crc: if self.uses_crc { crc } else { 0 } }
            }
            (ChannelStage::Guard, _) => {
                self.attempts = 1;
                SdoRequest::Other(0)
            }
            _ => SdoRequest::Abort(self.object(), AbortCode::INTERNAL),
        };
        (request.bytes(), false)
    }

    fn next_segment(&mut self, long: Option<&mut TransferBuffer>) -> Segment {
        let mut segment = Segment { toggle: self.toggle, ..Segment::default() };
        match (long, self.host_request) {
            (Some(long), _) => {
                let OutgoingSegment { data, len, last } = long.segment(0).unwrap_or_default();
                (segment.data, segment.len, segment.last) = (data, len, last);
            }
            (None, HostRequest::Write { bits, len, .. }) => {
                let left = bits.to_le_bytes();
                let left = left.get(self.bytes_done as usize..usize::from(len)).unwrap_or(&[]);
                let count = left.len().min(SEGMENT);
                segment.data[..count].copy_from_slice(&left[..count]);
                (segment.len, segment.last) = (count as u8, left.len() <= SEGMENT);
            }
            _ => {}
        }
        segment
    }

    fn next_block_segment(&mut self, sent: u8, long: &TransferBuffer) -> ([u8; 8], bool) {
        let OutgoingSegment { data, last, .. } = long.segment(sent).unwrap_or_default();
        let number = sent + 1;
        self.stage = ChannelStage::BlockWriting(number);
        debug_assert!(number <= self.segments, "a block is as long as the node wants it");
        let more = !last && number < self.segments && long.segment(number).is_some();
        self.stalled = !last && number < self.segments && !more;
        (BlockSegment { number, last, data }.bytes(), more)
    }

    /// Handles a time-out. Returns the next step, and whether it repeats a frame.
    pub fn handle_silence(&mut self, long: Option<&mut TransferBuffer>) -> (ChannelStep, bool) {
        self.last_object = self.object();
        let again = self.attempts + 1 < ATTEMPTS_MAX;
        let over = Err(if self.stalled { IDLE_CALLER } else { Failure::Silent });
        match (self.stage, long) {
            (ChannelStage::BlockReading(arrived), Some(_))
                if again && !self.stalled && arrived > 0 =>
            {
                // The end of the block was lost: the received part is acknowledged.
                self.attempts += 1;
                (ChannelStep::Send, true)
            }
            // A read changes nothing. Its answers are distinguished by a probe of another object (CANOPEN-2).
            (ChannelStage::Request, None) if again && self.may_repeat() => {
                self.attempts += 1;
                self.stale_answers.insert(self.object());
                self.stage = ChannelStage::Probe;
                self.reset_progress();
                (ChannelStep::Send, true)
            }
            // A stop is sent with any state of the probe.
            (ChannelStage::StopFirst, _) => {
                self.stage = ChannelStage::Probe;
                (ChannelStep::Send, false)
            }
            (ChannelStage::Probe, _) if again && self.is_stop() => {
                self.attempts += 1;
                self.stage = ChannelStage::StopFirst;
                (ChannelStep::Send, true)
            }
            (ChannelStage::Guard, _) => (ChannelStep::End(over), false),
            // The node is through; only the caller takes no bytes, so there is nothing to abort.
            (ChannelStage::Drain, _) => (ChannelStep::End(over), false),
            (stage, _) => {
                if stage != ChannelStage::Probe {
                    self.stale_answers.insert(self.object());
                }
                (ChannelStep::Abort(AbortCode::TIMEOUT, over), false)
            }
        }
    }

    /// Ends the wait for a reply, which may still come: a stop goes first, or the link is down. Returns the failure:
    /// execution may be unknown.
    pub fn preempt(&mut self) -> Failure {
        self.stale_answers.insert(self.object());
        match self.host_request {
            // A write that was cut short may be in effect; a read is simply cancelled.
            HostRequest::Write { .. } | HostRequest::Download { .. } => Failure::Silent,
            _ => Failure::Cancelled,
        }
    }

    fn may_repeat(&self) -> bool {
        matches!(self.host_request, HostRequest::Read { .. }) || self.is_stop()
    }
}
