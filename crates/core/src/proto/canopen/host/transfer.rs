//! Processes the replies of a node in its transfer.

use super::channel::{ChannelStage, ChannelStep, NodeChannel, ReplyKind, StaleAnswers};
use super::transfer_buffer::TransferBuffer;
use crate::error::Failure;
use crate::proto::canopen::host_request::{Answer, HostRequest};
use crate::proto::canopen::sdo::{
    AbortCode, BlockSegment, ObjectIndex, SEGMENT, SdoReply, Segment,
};
use crate::time::Instant;

/// Bytes of a value that go into an outcome.
const VALUE_BYTES_MAX: u32 = 8;

impl NodeChannel {
    /// Handles a reply; `deadline` is the time of the next one.
    pub fn handle_reply(
        &mut self,
        deadline: Instant,
        data: [u8; 8],
        long: Option<&mut TransferBuffer>,
    ) -> (ChannelStep, ReplyKind) {
        // In a block every frame is a segment, whatever its first byte, except an abort (CiA 301).
        if let ChannelStage::BlockReading(arrived) = self.stage
            && data[0] != 0x80
        {
            self.deadline = deadline;
            return (
                self.handle_block_segment(BlockSegment::of(data), arrived, long),
                ReplyKind::Expected,
            );
        }
        // A reply to a stop that was sent before the probe may belong to an earlier request.
        let sure = self.stage != ChannelStage::StopFirst;
        match self.step_for_reply(deadline, SdoReply::of(data), long) {
            Some(step) => (step, if sure { ReplyKind::Expected } else { ReplyKind::Late }),
            None => (ChannelStep::Wait, ReplyKind::Late),
        }
    }

    /// The step after a reply; `None` for an unexpected one.
    fn step_for_reply(
        &mut self,
        deadline: Instant,
        reply: SdoReply,
        long: Option<&mut TransferBuffer>,
    ) -> Option<ChannelStep> {
        let object = self.object();
        match (self.stage, reply) {
            (ChannelStage::Idle | ChannelStage::Guard | ChannelStage::Drain, _) => None,
            (ChannelStage::Probe, SdoReply::Abort(named, _))
            | (ChannelStage::Probe, SdoReply::Value(named, _) | SdoReply::ValueLong(named, _))
                if named == self.probe_object() =>
            {
                self.stale_answers = StaleAnswers::None;
                self.stage = ChannelStage::Request;
                Some(ChannelStep::Send)
            }
            (ChannelStage::StopFirst, SdoReply::Written(named, _) | SdoReply::Abort(named, _))
                if named == object =>
            {
                self.stage = ChannelStage::Probe;
                Some(ChannelStep::Send)
            }
            (ChannelStage::Probe | ChannelStage::StopFirst, _) => None,
            (stage, SdoReply::Abort(named, abort))
                if named == object
                    || stage != ChannelStage::Request && named == ObjectIndex::default() =>
            {
                self.stale_answers = StaleAnswers::None;
                Some(ChannelStep::End(Err(Failure::Refused { code: abort.0 })))
            }
            // Some nodes without blocks refuse with the object of an earlier request.
            (ChannelStage::Request, SdoReply::Abort(_, AbortCode::SPECIFIER))
                if matches!(self.host_request, HostRequest::Download { block: true, .. }) =>
            {
                self.stale_answers = StaleAnswers::None;
                let code = AbortCode::SPECIFIER.0;
                Some(ChannelStep::End(Err(Failure::Refused { code })))
            }
            (ChannelStage::Request, reply) if reply.object() == Some(object) => {
                let step = self.handle_begun(reply, long)?;
                self.stale_answers = StaleAnswers::None;
                Some(step)
            }
            (ChannelStage::Reading, SdoReply::ValueSegment(segment)) => {
                Some(self.handle_segment(deadline, segment, long))
            }
            (ChannelStage::Writing, SdoReply::WrittenSegment(toggle)) => {
                Some(self.handle_segment_ack(deadline, toggle, long))
            }
            (ChannelStage::BlockReadEnd, SdoReply::ReadBlockEnd { unused, crc }) => {
                Some(self.handle_block_end(unused, crc, long?))
            }
            (ChannelStage::BlockWriting(sent), SdoReply::WriteBlockAck { arrived, segments }) => {
                Some(self.handle_block_ack(deadline, sent, arrived, segments, long?))
            }
            (ChannelStage::BlockWriteEnd, SdoReply::WriteBlockDone) => Some(self.finish_write()),
            _ => None,
        }
    }

    /// The node took the request, and a longer transfer begins.
    fn handle_begun(
        &mut self,
        reply: SdoReply,
        long: Option<&mut TransferBuffer>,
    ) -> Option<ChannelStep> {
        self.stage = match (reply, self.host_request) {
            // A node without blocks may answer a request for blocks in segments.
            (
                SdoReply::ValueLong(_, size),
                HostRequest::Read { .. } | HostRequest::Upload { .. },
            ) => {
                self.size = size;
                ChannelStage::Reading
            }
            // Short after all.
            (SdoReply::Value(_, short), HostRequest::Upload { .. }) => {
                let (bytes, len) = short.bytes();
                self.bytes_done = len as u32;
                long?.push_segment(&bytes[..len]);
                return Some(self.begin_drain());
            }
            (SdoReply::Written(object, _), HostRequest::Write { bits, len: 0..=4, .. }) => {
                return Some(ChannelStep::End(Ok(Answer::Written { object, bits })));
            }
            (SdoReply::Written(..), HostRequest::Write { .. }) => ChannelStage::Writing,
            (SdoReply::Written(..), HostRequest::Download { block: false, .. }) => {
                self.stage = ChannelStage::Writing;
                return Some(self.resume(long?));
            }
            (SdoReply::ReadBlockReady { crc, .. }, HostRequest::Upload { block: true, .. }) => {
                self.uses_crc = crc;
                ChannelStage::BlockStart
            }
            (
                SdoReply::WriteBlockReady { crc, segments, .. },
                HostRequest::Download { block: true, .. },
            ) => {
                if !(1..=TransferBuffer::SEGMENTS).contains(&segments) {
                    return Some(self.abort_broken(AbortCode::BLOCK_SIZE));
                }
                (self.uses_crc, self.segments) = (crc, segments);
                self.stage = ChannelStage::BlockWriting(0);
                return Some(self.resume(long?));
            }
            _ => return None,
        };
        Some(ChannelStep::Send)
    }

    /// Handles a segment.
    fn handle_segment(
        &mut self,
        deadline: Instant,
        segment: Segment,
        long: Option<&mut TransferBuffer>,
    ) -> ChannelStep {
        if segment.toggle != self.toggle {
            return self.handle_duplicate(deadline);
        }
        let bytes = segment.bytes();
        for byte in bytes {
            if self.bytes_done < VALUE_BYTES_MAX {
                debug_assert!(self.bytes_done < VALUE_BYTES_MAX);
                self.bits |= u64::from(*byte) << (8 * self.bytes_done);
            }
            self.bytes_done += 1;
        }
        (self.toggle, self.duplicate_seen) = (!self.toggle, false);
        let is_too_long = matches!(self.host_request, HostRequest::Upload { max: max @ 1.., .. }
            if self.bytes_done > max.into());
        // A segment without bytes that is not the last may be followed by more of its kind for ever.
        if is_too_long || bytes.is_empty() && !segment.last {
            return self.abort_broken(AbortCode::LENGTH);
        }
        if let Some(long) = long {
            long.push_segment(bytes);
            return if segment.last { self.begin_drain() } else { self.resume(long) };
        }
        match (segment.last, self.size.is_some_and(|size| size != self.bytes_done)) {
            (true, true) => self.abort_broken(AbortCode::LENGTH),
            (true, false) => ChannelStep::End(Ok(self.value_answer(self.bytes_done))),
            // The outcome has room for no more.
            (false, _) if self.bytes_done >= VALUE_BYTES_MAX => {
                let len = self.size.unwrap_or(self.bytes_done).max(self.bytes_done);
                ChannelStep::Abort(AbortCode::MEMORY, Ok(self.value_answer(len)))
            }
            (false, _) => ChannelStep::Send,
        }
    }

    fn value_answer(&self, len: u32) -> Answer {
        Answer::Value { object: self.object(), bits: self.bits, len }
    }

    /// A segment was taken.
    fn handle_segment_ack(
        &mut self,
        deadline: Instant,
        toggle: bool,
        long: Option<&mut TransferBuffer>,
    ) -> ChannelStep {
        if toggle != self.toggle {
            return self.handle_duplicate(deadline);
        }
        (self.toggle, self.duplicate_seen) = (!self.toggle, false);
        match (long, self.host_request) {
            (Some(long), HostRequest::Download { size, .. }) => {
                self.bytes_done = size;
                if long.acknowledge_segments(1) { self.finish_write() } else { self.resume(long) }
            }
            (_, HostRequest::Write { object, bits, len, .. }) => {
                self.bytes_done += SEGMENT as u32;
                if self.bytes_done < len.into() {
                    ChannelStep::Send
                } else {
                    ChannelStep::End(Ok(Answer::Written { object, bits }))
                }
            }
            _ => ChannelStep::Wait,
        }
    }

    /// A segment with the other's toggle: once it may be a copy of the one before.
    fn handle_duplicate(&mut self, deadline: Instant) -> ChannelStep {
        // Once it may be the copy that a bus error makes; twice it is another transfer.
        if core::mem::replace(&mut self.duplicate_seen, true) {
            return self.abort_broken(AbortCode::TOGGLE);
        }
        self.deadline = deadline;
        ChannelStep::Wait
    }

    /// Handles a segment of a block. Segments after a gap do not count; they are sent again.
    fn handle_block_segment(
        &mut self,
        segment: BlockSegment,
        arrived: u8,
        long: Option<&mut TransferBuffer>,
    ) -> ChannelStep {
        let Some(long) = long else { return self.abort_broken(AbortCode::INTERNAL) };
        let BlockSegment { number, last, data } = segment;
        let wanted = number == arrived + 1;
        if wanted {
            self.stage = ChannelStage::BlockReading(number);
            self.attempts = 0;
            self.bytes_done += SEGMENT as u32;
            long.push_block_segment(data, last);
        }
        if last || number >= self.segments { self.resume(long) } else { ChannelStep::Wait }
    }

    fn handle_block_end(&mut self, unused: u8, crc: u16, long: &mut TransferBuffer) -> ChannelStep {
        let computed = long.finish_blocks(unused);
        self.bytes_done = self.bytes_done.saturating_sub(unused.into());
        // The node keeps what it has: nothing is lost by reading it again, so it is the caller who decides.
        if self.uses_crc && computed != crc {
            return self.abort_broken(AbortCode::CRC);
        }
        self.stage = ChannelStage::BlockReadDone;
        ChannelStep::Send
    }

    /// The node received `count` segments of a block, and the next one has `next`.
    fn handle_block_ack(
        &mut self,
        deadline: Instant,
        sent: u8,
        arrived: u8,
        segments: u8,
        long: &mut TransferBuffer,
    ) -> ChannelStep {
        if arrived > sent {
            return self.abort_broken(AbortCode::SEQUENCE);
        }
        if !(1..=TransferBuffer::SEGMENTS).contains(&segments) {
            return self.abort_broken(AbortCode::BLOCK_SIZE);
        }
        // A node that takes nothing of a block several times in a row will not take it at all.
        self.attempts = if arrived == 0 { self.attempts + 1 } else { 0 };
        if self.attempts > Self::BLOCKS_LOST_MAX {
            return self.abort_broken(AbortCode::SEQUENCE);
        }
        self.deadline = deadline;
        self.segments = segments;
        if long.acknowledge_segments(arrived) {
            self.stage = ChannelStage::BlockWriteEnd;
            return ChannelStep::Send;
        }
        self.stage = ChannelStage::BlockWriting(0);
        self.resume(long)
    }

    /// The node breaks the protocol.
    fn abort_broken(&mut self, abort: AbortCode) -> ChannelStep {
        self.stale_answers.insert(self.object());
        ChannelStep::Abort(abort, Err(Failure::Misbehaved))
    }

    /// Everything was written.
    fn finish_write(&self) -> ChannelStep {
        let HostRequest::Download { size, .. } = self.host_request else {
            return ChannelStep::Wait;
        };
        ChannelStep::End(Ok(Answer::Transferred(size)))
    }

    /// All bytes have arrived; the transfer ends when they are read.
    fn begin_drain(&mut self) -> ChannelStep {
        self.stage = ChannelStage::Drain;
        self.stalled = true;
        ChannelStep::Wait
    }

    /// Goes on with a long transfer if there are bytes, or room for them.
    fn resume(&mut self, long: &TransferBuffer) -> ChannelStep {
        let able = match self.stage {
            ChannelStage::Reading => long.free_segments() > 0,
            ChannelStage::BlockReading(_) => long.has_last() || long.free_segments() > 0,
            ChannelStage::Writing => long.segment(0).is_some(),
            ChannelStage::BlockWriting(sent) => long.segment(sent).is_some(),
            _ => true,
        };
        self.stalled = !able;
        if able { ChannelStep::Send } else { ChannelStep::Wait }
    }

    /// Continues after bytes were read or fed.
    pub fn resume_stalled(&mut self, long: &TransferBuffer) -> ChannelStep {
        match self.stage {
            ChannelStage::Drain if long.is_empty() => {
                ChannelStep::End(Ok(Answer::Transferred(self.bytes_done)))
            }
            ChannelStage::Drain => ChannelStep::Wait,
            _ if self.stalled => self.resume(long),
            _ => ChannelStep::Wait,
        }
    }
}
