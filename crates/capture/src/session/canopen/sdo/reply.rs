//! What the node sends, and what both do with blocks.

use polepair_core::proto::canopen::sdo::{Abort, BlockSegment, Object, Reply, Segment, Short};

use super::{At, Channel, GivenUp, Op, Part, Phase, State, TIMEOUT_NS, TWICE_MAX};
use crate::session::{Exchange, Notice, Oddity, Outcome};

impl Channel {
    /// Takes eight bytes from the node. `followed` says that requests are heard on this bus.
    pub fn reply(
        &mut self,
        bytes: [u8; 8],
        at: At,
        followed: bool,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let before = core::mem::replace(&mut self.reply, bytes);
        match self.state {
            State::Adrift => self.reply_adrift(bytes, at, followed, notices),
            State::Idle => self.unasked(bytes, before, at, notices),
            State::Open => {
                let block = self.transfer.phase == Phase::BlockUp && bytes[0] != 0x80;
                self.transfer.moved = at.1.or(self.transfer.moved);
                match block {
                    true => self.block_up(bytes, at, notices),
                    false => self.answer(bytes, before, at, notices),
                }
            }
        }
    }

    /// It may go on with what began before the capture.
    fn reply_adrift(
        &mut self,
        bytes: [u8; 8],
        at: At,
        followed: bool,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let waited = at.1.zip(self.adrift).map_or(0, |(now, since)| now.since(since));
        if waited <= TIMEOUT_NS || !followed {
            self.adrift = at.1;
        } else {
            self.foreign(bytes, "nobody asked for", notices);
            self.state = State::Idle;
        }
        Part::Plain
    }

    /// An answer while nothing is asked.
    fn unasked(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        if self.owed > 0 {
            self.owed -= 1;
            return Part::Plain;
        }
        if self.is_late(bytes, at, notices) {
            return Part::Plain;
        }
        let soon = at.1.zip(self.transfer.moved).is_none_or(|(now, at)| now.since(at) < TIMEOUT_NS);
        let same = Reply::of(bytes).object() == Some(self.transfer.object);
        if soon && (bytes == before || same) {
            self.double(bytes, before, notices);
        } else {
            self.foreign(bytes, "nobody asked for", notices);
        }
        Part::Plain
    }

    /// The same request answered twice: by one node once, by two always. What tells products apart
    /// is never two things.
    fn double(&mut self, bytes: [u8; 8], before: [u8; 8], notices: &mut Vec<Notice>) {
        let object = Reply::of(bytes).object().map(|object| object.index);
        let differs = bytes != before && matches!(object, Some(0x1000 | 0x1008..=0x100A | 0x1018));
        self.doubled = true;
        self.twice = if differs { TWICE_MAX } else { self.twice.saturating_add(1) };
        if self.twice == 1 {
            let how = if bytes == before { "" } else { ", with two values" };
            let text = format!("a request was answered twice{how}");
            notices.push(super::odd(Oddity::DuplicateReply, self.node, text));
        }
    }

    /// It answers what had been given up.
    fn is_late(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) -> bool {
        let Some(GivenUp { op, object, asked, .. }) = self.given_up else { return false };
        let reply = Reply::of(bytes);
        let fits = match (reply, op) {
            (Reply::Abort(told, _), _) => told == object,
            (Reply::Written(told, _), Op::Write) | (Reply::Value(told, _), Op::Read) => {
                told == object
            }
            (Reply::ValueLong(told, _) | Reply::ReadBlockReady { object: told, .. }, Op::Read) => {
                told == object
            }
            _ => false,
        };
        if fits {
            // Both sides gave up.
            if matches!(reply, Reply::Abort(_, Abort::TIMEOUT)) {
                self.tell_held(notices);
                self.given_up = None;
                return true;
            }
            let held = self.given_up.take().map_or_else(Vec::new, |given_up| given_up.held);
            notices.extend(held.into_iter().filter_map(|notice| answered_late(notice, at)));
            let ms = at.1.zip(asked.1).map_or(0, |(now, asked)| now.since(asked) / 1_000_000);
            let Object { index, sub } = object;
            let text = format!("the answer for 0x{index:04X}:{sub} came {ms} ms after its request");
            notices.push(super::odd(Oddity::LateReply, self.node, text));
        }
        fits
    }

    fn foreign(&mut self, bytes: [u8; 8], why: &str, notices: &mut Vec<Notice>) {
        let what = match Reply::of(bytes).object() {
            Some(Object { index, sub }) => format!("an answer for 0x{index:04X}:{sub}"),
            None => "an answer".to_owned(),
        };
        notices.push(super::odd(Oddity::ForeignReply, self.node, format!("{what} that {why}")));
    }

    fn answer(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let t = &mut self.transfer;
        let reply = Reply::of(bytes);
        let mine = reply.object().is_none_or(|object| object == t.object);
        match (reply, t.phase, t.op) {
            (Reply::Abort(object, abort), ..) => self.abort(object, abort, bytes, at, notices),
            (Reply::Value(_, short), Phase::First, Op::Read) if mine => {
                self.short(short, at, notices)
            }
            (Reply::ValueLong(_, size), Phase::First, Op::Read) if mine => {
                (t.size, t.phase) = (size, Phase::Client);
                self.first()
            }
            (Reply::Written(..), Phase::First, Op::Write) if mine && t.last => {
                self.done(at, notices)
            }
            (Reply::Written(..), Phase::First, Op::Write) if mine => {
                t.phase = Phase::Client;
                self.first()
            }
            (Reply::ValueSegment(segment), Phase::Node, Op::Read) => {
                self.value_segment(&segment, at, notices)
            }
            (Reply::WrittenSegment(toggle), Phase::Node, Op::Write) => {
                self.written_segment(toggle, at, notices)
            }
            (Reply::ReadBlockReady { crc, size, .. }, Phase::First, Op::Read) if mine => {
                (t.size, t.phase, t.checked) = (size, Phase::BlockUpStart, t.checked && crc);
                self.first()
            }
            (Reply::WriteBlockReady { crc, segments, .. }, Phase::First, Op::Write) if mine => {
                (t.phase, t.checked, t.block.room) = (Phase::BlockDown, t.checked && crc, segments);
                self.first()
            }
            // A node may acknowledge before the block is full, where it missed a segment.
            (
                Reply::WriteBlockAck { arrived, segments },
                Phase::BlockDownAck | Phase::BlockDown,
                _,
            ) => self.block_arrived(arrived, segments, notices),
            (Reply::WriteBlockDone, Phase::BlockDownDone, _) => self.done(at, notices),
            (Reply::ReadBlockEnd { unused, crc }, Phase::BlockUpEnd, _) => {
                (t.phase, t.answered) = (Phase::BlockUpDone, Some(at));
                self.block_end(unused, crc, notices);
                Part::Plain
            }
            _ => self.misfit(bytes, before, at, notices),
        }
    }

    /// The transfer began: it is none of before the capture.
    fn first(&mut self) -> Part {
        self.transfer.doubtful = false;
        Part::Plain
    }

    fn short(&mut self, short: Short, at: At, notices: &mut Vec<Notice>) -> Part {
        let (data, len) = short.bytes();
        self.transfer.take(&data[..len]);
        self.transfer.sizeless = short.len == 0;
        self.done(at, notices)
    }

    fn value_segment(&mut self, segment: &Segment, at: At, notices: &mut Vec<Notice>) -> Part {
        let t = &mut self.transfer;
        let wrong = segment.toggle != t.toggle;
        t.take(segment.bytes());
        (t.phase, t.toggle, t.segments) = (Phase::Client, !t.toggle, t.segments + 1);
        let n = t.segments;
        if wrong {
            let text = format!("{}: segment {n} from the node has a wrong toggle", t.spelled());
            self.accuse(Oddity::Sequence, text, notices);
        }
        if segment.last { self.done(at, notices) } else { Part::Segment(n) }
    }

    fn written_segment(&mut self, toggle: bool, at: At, notices: &mut Vec<Notice>) -> Part {
        let t = &mut self.transfer;
        let wrong = toggle != t.toggle;
        (t.phase, t.toggle) = (Phase::Client, !t.toggle);
        let (n, last) = (t.segments, t.last);
        if wrong {
            let text = format!("{}: segment {n} was taken with a wrong toggle", t.spelled());
            self.accuse(Oddity::Sequence, text, notices);
        }
        if last { self.done(at, notices) } else { Part::Segment(n) }
    }

    fn abort(
        &mut self,
        object: Object,
        abort: Abort,
        bytes: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let mine = object == self.transfer.object || object == Object::default();
        if !mine && self.is_late(bytes, at, notices) {
            return Part::Plain;
        }
        self.transfer.doubtful = false;
        self.refused(abort, at, notices);
        Part::Plain
    }

    /// An answer that the transfer has no place for.
    fn misfit(
        &mut self,
        bytes: [u8; 8],
        before: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        if self.transfer.doubtful {
            return self.drift(at);
        }
        if self.owed > 0 {
            self.owed -= 1;
        } else if bytes[..4] == before[..4] && bytes[0] >> 5 != 0 {
            self.double(bytes, before, notices);
        } else if !self.is_late(bytes, at, notices) {
            let Object { index, sub } = self.transfer.object;
            let why = format!("does not belong to 0x{index:04X}:{sub}, which was asked");
            self.foreign(bytes, &why, notices);
        }
        Part::Plain
    }

    fn block_up(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) -> Part {
        self.transfer.answered = Some(at);
        let part = self.block_segment(&BlockSegment::of(bytes), notices);
        if self.transfer.block.is_full() {
            self.transfer.phase = Phase::BlockUpAck;
        }
        part
    }

    /// Takes a segment of a block in either direction.
    pub(super) fn block_segment(
        &mut self,
        segment: &BlockSegment,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let t = &mut self.transfer;
        let before = t.block.count;
        let n = t.segments + u32::from(segment.number);
        if !t.block.push(segment) {
            let found = segment.number;
            let text = format!("{}: segment {found} of a block came after {before}", t.spelled());
            self.accuse(Oddity::Sequence, text, notices);
        }
        Part::BlockSegment(n)
    }

    /// So many segments of the block arrived; the others come again.
    pub(super) fn block_arrived(
        &mut self,
        arrived: u8,
        room: u8,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let t = &mut self.transfer;
        let sent = t.block.count;
        let mut block = core::mem::take(&mut t.block);
        block.arrived(arrived, room, |bytes| t.take(bytes));
        (t.segments, t.block) = (t.segments + u32::from(arrived.min(sent)), block);
        t.phase = match (t.op, t.block.last) {
            (Op::Write, true) => Phase::BlockDownEnd,
            (Op::Write, false) => Phase::BlockDown,
            (Op::Read, true) => Phase::BlockUpEnd,
            (Op::Read, false) => Phase::BlockUp,
        };
        if arrived < sent {
            t.retries = t.retries.saturating_add(1);
            let text = format!(
                "{}: {arrived} of {sent} segments of a block arrived, the others go again",
                t.spelled()
            );
            notices.push(super::odd(Oddity::Retry, self.node, text));
        }
        Part::Plain
    }

    /// All blocks are there: the last segment's end, and the check.
    pub(super) fn block_end(&mut self, unused: u8, crc: u16, notices: &mut Vec<Notice>) {
        let t = &mut self.transfer;
        if let Some((tail, len)) = t.block.tail(unused) {
            t.take(&tail[..len]);
        }
        if t.checked && t.crc != crc {
            let text =
                format!("{}: the check is {crc:04X}, of the bytes {:04X}", t.spelled(), t.crc);
            self.accuse(Oddity::BadCheck, text, notices);
        }
    }
}

/// What is left of a request that was held to be unanswered, and was not.
fn answered_late(notice: Notice, at: At) -> Option<Notice> {
    let Notice::Exchange(exchange) = notice else { return None };
    let (answered, outcome) = (Some(at), Outcome::Late);
    Some(Notice::Exchange(Exchange { answered, outcome, ..exchange }))
}
