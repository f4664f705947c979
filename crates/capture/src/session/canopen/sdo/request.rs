//! Frames of the client.

use polepair_core::proto::canopen::sdo::{
    AbortCode, BlockSegment, ExpeditedData, ObjectIndex, SdoRequest, Segment,
};

use super::{
    ChannelState, DOUBLE_ANSWERS_MAX, FrameRef, SdoChannel, SdoOperation, TransferPart,
    TransferPhase,
};
use crate::session::{AnomalyKind, ExchangeOutcome, SessionNotice};

impl SdoChannel {
    /// Takes eight bytes from the client.
    pub fn handle_request(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        // The capture began in the middle of a block download, whose segments may look like any command.
        if self.is_earlier_block(bytes) {
            return self.lose_sync(at);
        }
        if self.state == ChannelState::Open && self.is_block_segment(bytes) {
            return self.handle_block_down(bytes, at, notices);
        }
        let open = self.state == ChannelState::Open;
        match SdoRequest::of(bytes) {
            SdoRequest::Abort(object, abort) => {
                self.handle_client_abort(object, abort, at, notices)
            }
            // Ahead of a new beginning: the same bytes without a reply in between are a repetition.
            _ if open && self.is_retry(bytes) => self.count_retry(at, notices),
            SdoRequest::Read(object) => {
                self.begin_transfer(SdoOperation::Read, object, bytes, at, notices)
            }
            SdoRequest::Write(object, short) => {
                self.begin_expedited(object, short, bytes, at, notices)
            }
            SdoRequest::WriteLong(object, size) => {
                self.begin_transfer(SdoOperation::Write, object, bytes, at, notices);
                self.transfer.size = size;
                TransferPart::Plain
            }
            SdoRequest::WriteBlock { object, crc, size } => {
                self.begin_transfer(SdoOperation::Write, object, bytes, at, notices);
                (self.transfer.size, self.transfer.crc_agreed) = (size, crc);
                TransferPart::Plain
            }
            SdoRequest::ReadBlock { object, crc, segments, .. } => {
                self.begin_transfer(SdoOperation::Read, object, bytes, at, notices);
                (self.transfer.block.segments_max, self.transfer.crc_agreed) = (segments, crc);
                TransferPart::Plain
            }
            _ if !open => self.handle_unexpected(at, notices),
            _ if self.transfer.doubtful && self.transfer.phase == TransferPhase::First => {
                self.lose_sync(at)
            }
            request => self.continue_transfer(request, bytes, at, notices),
        }
    }

    /// A block may look like a beginning: its segments count on, commands do not.
    fn is_earlier_block(&self, bytes: [u8; 8]) -> bool {
        let t = &self.transfer;
        let open =
            self.state == ChannelState::Open && t.doubtful && t.phase == TransferPhase::First;
        open && bytes[0] == t.request[0].wrapping_add(1)
    }

    /// Returns whether it is a segment: in a block all frames are, except an abort, and a read request where another
    /// segment was due.
    fn is_block_segment(&self, bytes: [u8; 8]) -> bool {
        let t = &self.transfer;
        let reads = bytes[0] == 0x40 && bytes[4..] == [0; 4] && t.block.count + 1 != 0x40;
        t.phase == TransferPhase::BlockDown && bytes[0] != 0x80 && !reads
    }

    pub(super) fn lose_sync(&mut self, at: FrameRef) -> TransferPart {
        (self.state, self.unsynced_since) = (ChannelState::Unsynced, at.1);
        TransferPart::Plain
    }

    /// Returns whether it repeats a request that has no reply yet.
    fn is_retry(&self, bytes: [u8; 8]) -> bool {
        self.transfer.phase.is_node_turn()
            && self.transfer.phase != TransferPhase::BlockUp
            && self.transfer.request == bytes
    }

    fn count_retry(&mut self, at: FrameRef, notices: &mut Vec<SessionNotice>) -> TransferPart {
        self.transfer.retries = self.transfer.retries.saturating_add(1);
        self.transfer.last_progress = at.1;
        let text = format!("{} was asked again, unanswered", self.transfer.description());
        notices.push(super::anomaly(AnomalyKind::Retry, self.node, text));
        TransferPart::Plain
    }

    fn begin_transfer(
        &mut self,
        op: SdoOperation,
        object: ObjectIndex,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        match self.state {
            ChannelState::Open
                if self.transfer.doubtful && self.transfer.phase == TransferPhase::First => {}
            ChannelState::Open => self.give_up_transfer(" before the client went on", notices),
            _ => {}
        }
        // Once two nodes are known to have the number, that stays.
        if !core::mem::take(&mut self.last_doubled) && self.double_answers < DOUBLE_ANSWERS_MAX {
            self.double_answers = 0;
        }
        // Before the state is set: the first transfer of a capture may be the middle of an earlier one.
        let doubtful = self.state == ChannelState::Unsynced;
        self.transfer.begin(op, object, bytes, at);
        self.transfer.doubtful = doubtful;
        self.state = ChannelState::Open;
        TransferPart::Plain
    }

    fn begin_expedited(
        &mut self,
        object: ObjectIndex,
        short: ExpeditedData,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        self.begin_transfer(SdoOperation::Write, object, bytes, at, notices);
        let (data, len) = short.bytes();
        self.transfer.append_bytes(&data[..len]);
        (self.transfer.last_segment, self.transfer.size_unknown) = (true, short.len == 0);
        TransferPart::Plain
    }

    /// Handles a frame that continues no known transfer.
    fn handle_unexpected(
        &mut self,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        if self.state == ChannelState::Idle {
            let text = "the client went on with a transfer that had ended".to_owned();
            notices.push(super::anomaly(AnomalyKind::Sequence, self.node, text));
        }
        self.lose_sync(at)
    }

    fn continue_transfer(
        &mut self,
        request: SdoRequest,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        (t.request, t.last_progress) = (bytes, at.1);
        match (request, t.phase, t.op) {
            (SdoRequest::WriteSegment(segment), TransferPhase::Client, SdoOperation::Write) => {
                self.handle_write_segment(&segment, notices)
            }
            (SdoRequest::ReadSegment(toggle), TransferPhase::Client, SdoOperation::Read) => {
                t.phase = TransferPhase::Node;
                let wrong = toggle != t.toggle;
                if wrong {
                    let text = format!("{}: the client's toggle did not change", t.description());
                    self.report_once(AnomalyKind::Sequence, text, notices);
                }
                TransferPart::Segment(self.transfer.segments + 1)
            }
            (SdoRequest::WriteBlockEnd { unused, crc }, TransferPhase::BlockDownEnd, _) => {
                t.phase = TransferPhase::BlockDownDone;
                self.finish_block(unused, crc, notices);
                TransferPart::Plain
            }
            (SdoRequest::ReadBlockStart, TransferPhase::BlockUpStart, _) => {
                t.phase = TransferPhase::BlockUp;
                TransferPart::Plain
            }
            // A client may acknowledge less than a whole block, where it missed a segment.
            (
                SdoRequest::ReadBlockAck { arrived, segments },
                TransferPhase::BlockUpAck | TransferPhase::BlockUp,
                _,
            ) => self.acknowledge_block(arrived, segments, notices),
            (SdoRequest::ReadBlockEnd, TransferPhase::BlockUpDone, _) => {
                self.complete_transfer(at, notices)
            }
            _ => {
                let text = format!("{}: a frame out of turn from the client", t.description());
                self.report_once(AnomalyKind::Sequence, text, notices);
                TransferPart::Plain
            }
        }
    }

    fn handle_write_segment(
        &mut self,
        segment: &Segment,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let wrong = segment.toggle != t.toggle;
        t.append_bytes(segment.bytes());
        (t.phase, t.last_segment, t.segments) = (TransferPhase::Node, segment.last, t.segments + 1);
        if wrong {
            let n = t.segments;
            let text =
                format!("{}: segment {n} from the client has a wrong toggle", t.description());
            self.report_once(AnomalyKind::Sequence, text, notices);
        }
        TransferPart::Segment(self.transfer.segments)
    }

    fn handle_block_down(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        (t.request, t.last_progress) = (bytes, at.1);
        let part = self.add_block_segment(&BlockSegment::of(bytes), notices);
        if self.transfer.block.is_full() {
            self.transfer.phase = TransferPhase::BlockDownAck;
        }
        part
    }

    fn handle_client_abort(
        &mut self,
        object: ObjectIndex,
        abort: AbortCode,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let mine = object == self.transfer.object || object == ObjectIndex::default();
        if self.state != ChannelState::Open || !mine {
            return if self.state == ChannelState::Unsynced {
                self.lose_sync(at)
            } else {
                TransferPart::Plain
            };
        }
        let t = &self.transfer;
        let (spelled, first) = (t.description(), t.phase == TransferPhase::First);
        let why = polepair_core::proto::canopen::explain::meanings::abort_text(abort);
        let (kind, outcome, what) = if first {
            (AnomalyKind::Unanswered, ExchangeOutcome::Unanswered, "before an answer")
        } else {
            (AnomalyKind::Incomplete, t.abandoned_outcome(), "in the middle")
        };
        let text = format!("the client gave up {spelled} {what}: {why}");
        self.abandon_transfer(notices);
        // A reader of numbers drops the bytes behind them.
        if abort != AbortCode::MEMORY || first {
            self.report_once(kind, text, notices);
        }
        self.close_transfer(outcome, None, notices);
        TransferPart::Plain
    }
}
