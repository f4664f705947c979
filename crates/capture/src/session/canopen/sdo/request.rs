//! What the client sends.

use polepair_core::proto::canopen::sdo::{Abort, BlockSegment, Object, Request, Segment, Short};

use super::{At, Channel, Op, Part, Phase, State, TWICE_MAX};
use crate::session::{Notice, Oddity, Outcome};

impl Channel {
    /// Takes eight bytes from the client.
    pub fn request(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) -> Part {
        if self.is_block_before_the_capture(bytes) {
            return self.drift(at);
        }
        if self.state == State::Open && self.is_block_segment(bytes) {
            return self.block_down(bytes, at, notices);
        }
        let open = self.state == State::Open;
        match Request::of(bytes) {
            Request::Abort(object, abort) => self.client_abort(object, abort, at, notices),
            _ if open && self.is_retry(bytes) => self.again(at, notices),
            Request::Read(object) => self.begin(Op::Read, object, bytes, at, notices),
            Request::Write(object, short) => self.begin_short(object, short, bytes, at, notices),
            Request::WriteLong(object, size) => {
                self.begin(Op::Write, object, bytes, at, notices);
                self.transfer.size = size;
                Part::Plain
            }
            Request::WriteBlock { object, crc, size } => {
                self.begin(Op::Write, object, bytes, at, notices);
                (self.transfer.size, self.transfer.checked) = (size, crc);
                Part::Plain
            }
            Request::ReadBlock { object, crc, segments, .. } => {
                self.begin(Op::Read, object, bytes, at, notices);
                (self.transfer.block.room, self.transfer.checked) = (segments, crc);
                Part::Plain
            }
            _ if !open => self.out_of_nothing(at, notices),
            _ if self.transfer.doubtful && self.transfer.phase == Phase::First => self.drift(at),
            request => self.go_on(request, bytes, at, notices),
        }
    }

    /// A block may look like a beginning: its segments count on, commands do not.
    fn is_block_before_the_capture(&self, bytes: [u8; 8]) -> bool {
        let t = &self.transfer;
        let open = self.state == State::Open && t.doubtful && t.phase == Phase::First;
        open && bytes[0] == t.request[0].wrapping_add(1)
    }

    /// In a block nearly everything is a segment, but an abort, and a request to read where another
    /// segment was due.
    fn is_block_segment(&self, bytes: [u8; 8]) -> bool {
        let t = &self.transfer;
        let reads = bytes[0] == 0x40 && bytes[4..] == [0; 4] && t.block.count + 1 != 0x40;
        t.phase == Phase::BlockDown && bytes[0] != 0x80 && !reads
    }

    pub(super) fn drift(&mut self, at: At) -> Part {
        (self.state, self.adrift) = (State::Adrift, at.1);
        Part::Plain
    }

    /// The node owes an answer to these very bytes.
    fn is_retry(&self, bytes: [u8; 8]) -> bool {
        self.transfer.phase.is_nodes()
            && self.transfer.phase != Phase::BlockUp
            && self.transfer.request == bytes
    }

    fn again(&mut self, at: At, notices: &mut Vec<Notice>) -> Part {
        self.transfer.retries = self.transfer.retries.saturating_add(1);
        self.transfer.moved = at.1;
        let text = format!("{} was asked again, unanswered", self.transfer.spelled());
        notices.push(super::odd(Oddity::Retry, self.node, text));
        Part::Plain
    }

    fn begin(
        &mut self,
        op: Op,
        object: Object,
        bytes: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        match self.state {
            State::Open if self.transfer.doubtful && self.transfer.phase == Phase::First => {}
            State::Open => self.give_up(" before the client went on", notices),
            _ => {}
        }
        // Once two nodes are known to have the number, that stays.
        if !core::mem::take(&mut self.doubled) && self.twice < TWICE_MAX {
            self.twice = 0;
        }
        let doubtful = self.state == State::Adrift;
        self.transfer.begin(op, object, bytes, at);
        self.transfer.doubtful = doubtful;
        self.state = State::Open;
        Part::Plain
    }

    fn begin_short(
        &mut self,
        object: Object,
        short: Short,
        bytes: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        self.begin(Op::Write, object, bytes, at, notices);
        let (data, len) = short.bytes();
        self.transfer.take(&data[..len]);
        (self.transfer.last, self.transfer.sizeless) = (true, short.len == 0);
        Part::Plain
    }

    /// A frame that goes on with what nobody began.
    fn out_of_nothing(&mut self, at: At, notices: &mut Vec<Notice>) -> Part {
        if self.state == State::Idle {
            let text = "the client went on with a transfer that had ended".to_owned();
            notices.push(super::odd(Oddity::Sequence, self.node, text));
        }
        self.drift(at)
    }

    fn go_on(
        &mut self,
        request: Request,
        bytes: [u8; 8],
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let t = &mut self.transfer;
        (t.request, t.moved) = (bytes, at.1);
        match (request, t.phase, t.op) {
            (Request::WriteSegment(segment), Phase::Client, Op::Write) => {
                self.write_segment(&segment, notices)
            }
            (Request::ReadSegment(toggle), Phase::Client, Op::Read) => {
                t.phase = Phase::Node;
                let wrong = toggle != t.toggle;
                if wrong {
                    let text = format!("{}: the client's toggle did not change", t.spelled());
                    self.accuse(Oddity::Sequence, text, notices);
                }
                Part::Segment(self.transfer.segments + 1)
            }
            (Request::WriteBlockEnd { unused, crc }, Phase::BlockDownEnd, _) => {
                t.phase = Phase::BlockDownDone;
                self.block_end(unused, crc, notices);
                Part::Plain
            }
            (Request::ReadBlockStart, Phase::BlockUpStart, _) => {
                t.phase = Phase::BlockUp;
                Part::Plain
            }
            // A client may acknowledge less than a whole block, where it missed a segment.
            (
                Request::ReadBlockAck { arrived, segments },
                Phase::BlockUpAck | Phase::BlockUp,
                _,
            ) => self.block_arrived(arrived, segments, notices),
            (Request::ReadBlockEnd, Phase::BlockUpDone, _) => self.done(at, notices),
            _ => {
                let text = format!("{}: a frame out of turn from the client", t.spelled());
                self.accuse(Oddity::Sequence, text, notices);
                Part::Plain
            }
        }
    }

    fn write_segment(&mut self, segment: &Segment, notices: &mut Vec<Notice>) -> Part {
        let t = &mut self.transfer;
        let wrong = segment.toggle != t.toggle;
        t.take(segment.bytes());
        (t.phase, t.last, t.segments) = (Phase::Node, segment.last, t.segments + 1);
        if wrong {
            let n = t.segments;
            let text = format!("{}: segment {n} from the client has a wrong toggle", t.spelled());
            self.accuse(Oddity::Sequence, text, notices);
        }
        Part::Segment(self.transfer.segments)
    }

    fn block_down(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) -> Part {
        let t = &mut self.transfer;
        (t.request, t.moved) = (bytes, at.1);
        let part = self.block_segment(&BlockSegment::of(bytes), notices);
        if self.transfer.block.is_full() {
            self.transfer.phase = Phase::BlockDownAck;
        }
        part
    }

    fn client_abort(
        &mut self,
        object: Object,
        abort: Abort,
        at: At,
        notices: &mut Vec<Notice>,
    ) -> Part {
        let mine = object == self.transfer.object || object == Object::default();
        if self.state != State::Open || !mine {
            return if self.state == State::Adrift { self.drift(at) } else { Part::Plain };
        }
        let t = &self.transfer;
        let (spelled, first) = (t.spelled(), t.phase == Phase::First);
        let why = polepair_core::proto::canopen::explain::say::abort(abort);
        let (kind, outcome, what) = match first {
            true => (Oddity::Unanswered, Outcome::Unanswered, "before an answer"),
            false => (Oddity::Incomplete, t.left_outcome(), "in the middle"),
        };
        let text = format!("the client gave up {spelled} {what}: {why}");
        self.given_up(notices);
        // Who wants no more of a value than a number's bytes lets the rest go.
        if abort != Abort::MEMORY || first {
            self.accuse(kind, text, notices);
        }
        self.close(outcome, None, notices);
        Part::Plain
    }
}
