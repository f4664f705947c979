//! Frames of the node, and block frames of both sides.

use polepair_core::proto::canopen::sdo::{
    AbortCode, BlockSegment, ExpeditedData, ObjectIndex, SdoReply, Segment,
};

use super::{
    AbandonedRequest, ChannelState, DOUBLE_ANSWERS_MAX, FrameRef, SdoChannel, SdoOperation,
    TIMEOUT_NS, TransferPart, TransferPhase,
};
use crate::session::{AnomalyKind, ExchangeNotice, ExchangeOutcome, SessionNotice};

impl SdoChannel {
    /// Handles eight bytes from the node. `followed` is true if requests are in the capture of this bus.
    pub fn handle_reply(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        followed: bool,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let before = core::mem::replace(&mut self.last_reply, bytes);
        match self.state {
            ChannelState::Unsynced => self.reply_unsynced(bytes, at, followed, notices),
            ChannelState::Idle => self.handle_unsolicited(bytes, before, at, notices),
            ChannelState::Open => {
                let block = self.transfer.phase == TransferPhase::BlockUp && bytes[0] != 0x80;
                self.transfer.last_progress = at.1.or(self.transfer.last_progress);
                if block {
                    self.handle_block_up(bytes, at, notices)
                } else {
                    self.match_reply(bytes, before, at, notices)
                }
            }
        }
    }

    /// Handles a reply that may continue a transfer from before the capture.
    fn reply_unsynced(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        followed: bool,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let waited = at.1.zip(self.unsynced_since).map_or(0, |(now, since)| now.since(since));
        if waited <= TIMEOUT_NS || !followed {
            // A transfer that began before the capture goes on as long as its frames come in time.
            self.unsynced_since = at.1;
        } else {
            self.report_foreign(bytes, "belongs to no request", notices);
            self.state = ChannelState::Idle;
        }
        TransferPart::Plain
    }

    /// An answer while nothing is asked.
    fn handle_unsolicited(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        if self.extra_replies > 0 {
            self.extra_replies -= 1;
            return TransferPart::Plain;
        }
        if self.handle_late_reply(bytes, at, notices) {
            return TransferPart::Plain;
        }
        let soon =
            at.1.zip(self.transfer.last_progress)
                .is_none_or(|(now, at)| now.since(at) < TIMEOUT_NS);
        let same = SdoReply::of(bytes).object() == Some(self.transfer.object);
        if soon && (bytes == before || same) {
            self.report_double(bytes, before, notices);
        } else {
            self.report_foreign(bytes, "belongs to no request", notices);
        }
        TransferPart::Plain
    }

    /// Handles a duplicated reply: one node sends it once, two always. A value that distinguishes products is never one
    /// of two.
    fn report_double(&mut self, bytes: [u8; 8], before: [u8; 8], notices: &mut Vec<SessionNotice>) {
        let object = SdoReply::of(bytes).object().map(|object| object.index);
        let differs = bytes != before && matches!(object, Some(0x1000 | 0x1008..=0x100A | 0x1018));
        self.last_doubled = true;
        self.double_answers =
            // Two values of an identity are proof at once; the same reply twice may be a tap that doubles frames.
            if differs { DOUBLE_ANSWERS_MAX } else { self.double_answers.saturating_add(1) };
        if self.double_answers == 1 {
            let how = if bytes == before { "" } else { ", with two values" };
            let text = format!("a request was answered twice{how}");
            notices.push(super::anomaly(AnomalyKind::DuplicateReply, self.node, text));
        }
    }

    /// Handles the reply to a request that had been given up.
    fn handle_late_reply(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> bool {
        let Some(AbandonedRequest { op, object, requested, .. }) = self.abandoned else {
            return false;
        };
        let reply = SdoReply::of(bytes);
        let fits = match (reply, op) {
            (SdoReply::Abort(report, _), _) => report == object,
            (SdoReply::Written(report, _), SdoOperation::Write)
            | (SdoReply::Value(report, _), SdoOperation::Read) => report == object,
            (
                SdoReply::ValueLong(report, _) | SdoReply::ReadBlockReady { object: report, .. },
                SdoOperation::Read,
            ) => report == object,
            _ => false,
        };
        if fits {
            // Both sides gave up.
            if matches!(reply, SdoReply::Abort(_, AbortCode::TIMEOUT)) {
                self.release_held(notices);
                self.abandoned = None;
                return true;
            }
            let held =
                self.abandoned.take().map_or_else(Vec::new, |given_up| given_up.held_notices);
            notices.extend(held.into_iter().filter_map(|notice| late_exchange(notice, at)));
            let ObjectIndex { index, sub } = object;
            let when = match at.1.zip(requested.1) {
                Some((now, then)) => {
                    format!("{} ms after its request", now.since(then) / 1_000_000)
                }
                None => "after its request was given up".to_owned(),
            };
            let text = format!("the answer for 0x{index:04X}:{sub} came {when}");
            notices.push(super::anomaly(AnomalyKind::LateReply, self.node, text));
        }
        fits
    }

    fn report_foreign(&mut self, bytes: [u8; 8], why: &str, notices: &mut Vec<SessionNotice>) {
        let what = match SdoReply::of(bytes).object() {
            Some(ObjectIndex { index, sub }) => format!("an answer for 0x{index:04X}:{sub}"),
            None => "an answer".to_owned(),
        };
        notices.push(super::anomaly(
            AnomalyKind::ForeignReply,
            self.node,
            format!("{what} that {why}"),
        ));
    }

    fn match_reply(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let reply = SdoReply::of(bytes);
        let mine = reply.object().is_none_or(|object| object == t.object);
        match (reply, t.phase, t.op) {
            (SdoReply::Abort(object, abort), ..) => {
                self.handle_abort(object, abort, bytes, at, notices)
            }
            (SdoReply::Value(_, short), TransferPhase::First, SdoOperation::Read) if mine => {
                self.finish_expedited(short, at, notices)
            }
            (SdoReply::ValueLong(_, size), TransferPhase::First, SdoOperation::Read) if mine => {
                (t.size, t.phase) = (size, TransferPhase::Client);
                self.confirm_first()
            }
            (SdoReply::Written(..), TransferPhase::First, SdoOperation::Write)
                if mine && t.last_segment =>
            {
                self.complete_transfer(at, notices)
            }
            (SdoReply::Written(..), TransferPhase::First, SdoOperation::Write) if mine => {
                t.phase = TransferPhase::Client;
                self.confirm_first()
            }
            (SdoReply::ValueSegment(segment), TransferPhase::Node, SdoOperation::Read) => {
                self.handle_value_segment(&segment, at, notices)
            }
            (SdoReply::WrittenSegment(toggle), TransferPhase::Node, SdoOperation::Write) => {
                self.handle_written_segment(toggle, at, notices)
            }
            (
                SdoReply::ReadBlockReady { crc, size, .. },
                TransferPhase::First,
                SdoOperation::Read,
            ) if mine => {
                (t.size, t.phase, t.crc_agreed) =
                    (size, TransferPhase::BlockUpStart, t.crc_agreed && crc);
                self.confirm_first()
            }
            (
                SdoReply::WriteBlockReady { crc, segments, .. },
                TransferPhase::First,
                SdoOperation::Write,
            ) if mine => {
                (t.phase, t.crc_agreed, t.block.segments_max) =
                    (TransferPhase::BlockDown, t.crc_agreed && crc, segments);
                self.confirm_first()
            }
            // A node may acknowledge before the block is full, where it missed a segment.
            (
                SdoReply::WriteBlockAck { arrived, segments },
                TransferPhase::BlockDownAck | TransferPhase::BlockDown,
                _,
            ) => self.acknowledge_block(arrived, segments, notices),
            (SdoReply::WriteBlockDone, TransferPhase::BlockDownDone, _) => {
                self.complete_transfer(at, notices)
            }
            (SdoReply::ReadBlockEnd { unused, crc }, TransferPhase::BlockUpEnd, _) => {
                (t.phase, t.answered) = (TransferPhase::BlockUpDone, Some(at));
                self.finish_block(unused, crc, notices);
                TransferPart::Plain
            }
            _ => self.handle_misfit(bytes, before, at, notices),
        }
    }

    /// The transfer began: it is none of before the capture.
    fn confirm_first(&mut self) -> TransferPart {
        self.transfer.doubtful = false;
        TransferPart::Plain
    }

    fn finish_expedited(
        &mut self,
        short: ExpeditedData,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let (data, len) = short.bytes();
        self.transfer.append_bytes(&data[..len]);
        self.transfer.size_unknown = short.len == 0;
        self.complete_transfer(at, notices)
    }

    fn handle_value_segment(
        &mut self,
        segment: &Segment,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let wrong = segment.toggle != t.toggle;
        t.append_bytes(segment.bytes());
        (t.phase, t.toggle, t.segments) = (TransferPhase::Client, !t.toggle, t.segments + 1);
        let n = t.segments;
        if wrong {
            let text = format!("{}: segment {n} from the node has a wrong toggle", t.description());
            self.report_once(AnomalyKind::Sequence, text, notices);
        }
        if segment.last { self.complete_transfer(at, notices) } else { TransferPart::Segment(n) }
    }

    fn handle_written_segment(
        &mut self,
        toggle: bool,
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let wrong = toggle != t.toggle;
        (t.phase, t.toggle) = (TransferPhase::Client, !t.toggle);
        let (n, last) = (t.segments, t.last_segment);
        if wrong {
            let text = format!("{}: segment {n} was taken with a wrong toggle", t.description());
            self.report_once(AnomalyKind::Sequence, text, notices);
        }
        if last { self.complete_transfer(at, notices) } else { TransferPart::Segment(n) }
    }

    fn handle_abort(
        &mut self,
        object: ObjectIndex,
        abort: AbortCode,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let mine = object == self.transfer.object || object == ObjectIndex::default();
        if !mine && self.handle_late_reply(bytes, at, notices) {
            return TransferPart::Plain;
        }
        self.transfer.doubtful = false;
        self.refuse_transfer(abort, at, notices);
        TransferPart::Plain
    }

    /// An answer that the transfer has no place for.
    fn handle_misfit(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        if self.transfer.doubtful {
            return self.lose_sync(at);
        }
        if self.extra_replies > 0 {
            self.extra_replies -= 1;
        // Segments carry no index, so that two in a row may well begin alike.
        } else if bytes[..4] == before[..4] && bytes[0] >> 5 != 0 {
            self.report_double(bytes, before, notices);
        } else if !self.handle_late_reply(bytes, at, notices) {
            let ObjectIndex { index, sub } = self.transfer.object;
            let why = format!("does not belong to 0x{index:04X}:{sub}, which was asked");
            self.report_foreign(bytes, &why, notices);
        }
        TransferPart::Plain
    }

    fn handle_block_up(
        &mut self,
        bytes: [u8; 8],
        at: FrameRef,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        self.transfer.answered = Some(at);
        let part = self.add_block_segment(&BlockSegment::of(bytes), notices);
        if self.transfer.block.is_full() {
            self.transfer.phase = TransferPhase::BlockUpAck;
        }
        part
    }

    /// Takes a segment of a block in either direction.
    pub(super) fn add_block_segment(
        &mut self,
        segment: &BlockSegment,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let before = t.block.count;
        let n = t.segments + u32::from(segment.number);
        if !t.block.push(segment) {
            let found = segment.number;
            let text =
                format!("{}: segment {found} of a block came after {before}", t.description());
            self.report_once(AnomalyKind::Sequence, text, notices);
        }
        TransferPart::BlockSegment(n)
    }

    /// Handles the acknowledgement of `arrived` segments of the block; the others are sent again.
    pub(super) fn acknowledge_block(
        &mut self,
        arrived: u8,
        capacity: u8,
        notices: &mut Vec<SessionNotice>,
    ) -> TransferPart {
        let t = &mut self.transfer;
        let sent = t.block.count;
        // Taken out, because its bytes go into the same transfer.
        let mut block = core::mem::take(&mut t.block);
        block.acknowledge(arrived, capacity, |bytes| t.append_bytes(bytes));
        (t.segments, t.block) = (t.segments + u32::from(arrived.min(sent)), block);
        t.phase = match (t.op, t.block.last) {
            (SdoOperation::Write, true) => TransferPhase::BlockDownEnd,
            (SdoOperation::Write, false) => TransferPhase::BlockDown,
            (SdoOperation::Read, true) => TransferPhase::BlockUpEnd,
            (SdoOperation::Read, false) => TransferPhase::BlockUp,
        };
        if arrived < sent {
            t.retries = t.retries.saturating_add(1);
            let text = format!(
                "{}: {arrived} of {sent} segments of a block arrived, the others go again",
                t.description()
            );
            notices.push(super::anomaly(AnomalyKind::Retry, self.node, text));
        }
        TransferPart::Plain
    }

    /// All blocks are there: the last segment's end, and the check.
    pub(super) fn finish_block(&mut self, unused: u8, crc: u16, notices: &mut Vec<SessionNotice>) {
        let t = &mut self.transfer;
        if let Some((tail, len)) = t.block.take_tail(unused) {
            t.append_bytes(&tail[..len]);
        }
        if t.crc_agreed && t.crc != crc {
            let text =
                format!("{}: the check is {crc:04X}, of the bytes {:04X}", t.description(), t.crc);
            self.report_once(AnomalyKind::BadCheck, text, notices);
        }
    }
}

/// The exchange of a request whose reply was missing and came late.
fn late_exchange(notice: SessionNotice, at: FrameRef) -> Option<SessionNotice> {
    let SessionNotice::Exchange(exchange) = notice else { return None };
    let (answered, outcome) = (Some(at), ExchangeOutcome::Late);
    Some(SessionNotice::Exchange(ExchangeNotice { answered, outcome, ..exchange }))
}
