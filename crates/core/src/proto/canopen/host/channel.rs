//! One node's service data: one transfer at a time, from its first frame to its end.
//!
//! Why: CANOPEN-1, SPEED-5.

use super::long::{Long, Sent};
use crate::error::Failure;
use crate::proto::canopen::ask::{Answer, Ask};
use crate::proto::canopen::sdo::{
    Abort, BlockSegment, Object, Reply, Request, SEGMENT, Segment, Short, answer,
};
use crate::station::{Class, Ticket};
use crate::time::Instant;

/// Times that a read or a stop is sent in all.
const ATTEMPTS_MAX: u8 = 3;
/// So many answers in a row that came twice are of two nodes.
const DOUBLED_MAX: u8 = 3;
/// What is asked in between: every node has one, and answers it whatever it says.
const PROBES: [Object; 2] = [Object::new(0x1000, 0), Object::new(0x1001, 0)];

/// Where a transfer is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    Idle,
    /// A stop goes ahead of the probe.
    Ahead,
    /// Another object is asked, so that what is older comes first.
    Probe,
    Begin,
    Guard,
    /// Segments come.
    Reading,
    /// Segments go.
    Writing,
    /// The blocks may begin.
    BlockStart,
    /// Segments of a block come; so many did.
    BlockReading(u8),
    /// All came that will; what is left is the end.
    BlockReadEnd,
    /// The end is to be confirmed.
    BlockReadDone,
    /// Everything is over but for who takes the bytes.
    Drain,
    /// Segments of a block go; so many went.
    BlockWriting(u8),
    /// All are sent, and acknowledged.
    BlockWriteEnd,
}

/// What comes next.
#[derive(Clone, Copy, Debug)]
pub enum Step {
    /// Nothing.
    Wait,
    /// A frame is to be sent.
    Send,
    /// It is over.
    End(Result<Answer, Failure>),
    /// It is over, and the node is to be told why.
    Abort(Abort, Result<Answer, Failure>),
}

/// What a reply was.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sort {
    /// The one waited for.
    Answer,
    /// One that nothing waits for.
    Late,
}

/// The objects whose answers may still come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Doubt {
    None,
    Of(Object),
    /// Several: any may be one.
    All,
}

impl Doubt {
    #[inline]
    pub fn concerns(self, object: Object) -> bool {
        match self {
            Self::None => false,
            Self::Of(other) => other == object,
            Self::All => true,
        }
    }

    pub fn add(&mut self, object: Object) {
        *self = match *self {
            Self::Of(other) if other != object => Self::All,
            Self::All => Self::All,
            _ => Self::Of(object),
        };
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Channel {
    pub ticket: Ticket,
    pub deadline: Instant,
    /// Place of its bytes, if it is a long transfer.
    pub long: Option<u8>,
    /// Why the last transfer was aborted.
    pub abort: Abort,
    pub(super) stage: Stage,
    pub(super) ask: Ask,
    /// Its first frame.
    first: [u8; 8],
    pub(super) toggle: bool,
    /// One segment had the other's toggle: a copy.
    pub(super) copied: bool,
    pub(super) stalled: bool,
    /// Both can compute the check.
    pub(super) checked: bool,
    pub(super) attempts: u8,
    /// Segments of a block.
    pub(super) segments: u8,
    /// Bytes that went over.
    pub(super) done: u32,
    /// How many there are, as the node says.
    pub(super) size: Option<u32>,
    /// The first eight of them.
    pub(super) bits: u64,
    pub(super) doubt: Doubt,
    /// What was asked last: that is what an abort is about.
    ended: Object,
    /// The answer to it came again, and how many answers in a row did.
    again: bool,
    doubled: u8,
}

const NOTHING: Object = Object::new(0, 0);

/// The frame that begins what is asked.
#[inline]
pub fn first(ask: &Ask) -> Option<Request> {
    Some(match *ask {
        Ask::Read { object, .. } | Ask::Upload { object, block: false, .. } => {
            Request::Read(object)
        }
        Ask::Upload { object, block: true, .. } => {
            Request::ReadBlock { object, crc: true, segments: Long::SEGMENTS, threshold: 0 }
        }
        Ask::Write { object, bits, len: len @ 0..=4, .. } => {
            Request::Write(object, Short { bits: bits as u32, len })
        }
        Ask::Write { object, len, .. } => Request::WriteLong(object, Some(len.into())),
        Ask::Download { object, block: false, size, .. } => Request::WriteLong(object, Some(size)),
        Ask::Download { object, block: true, size, .. } => {
            Request::WriteBlock { object, crc: true, size: Some(size) }
        }
        _ => return None,
    })
}

impl Channel {
    /// Blocks in a row of which nothing arrived.
    pub(super) const BLOCKS_LOST_MAX: u8 = 3;
    pub const IDLE: Self = Self {
        ticket: Ticket(0),
        deadline: Instant::ZERO,
        long: None,
        abort: Abort::TIMEOUT,
        stage: Stage::Idle,
        ask: Ask::Sync(None),
        first: [0; 8],
        toggle: false,
        copied: false,
        stalled: false,
        checked: false,
        attempts: 0,
        segments: 0,
        done: 0,
        size: None,
        bits: 0,
        doubt: Doubt::None,
        ended: NOTHING,
        again: false,
        doubled: 0,
    };

    #[inline]
    pub fn is_idle(&self) -> bool {
        self.stage == Stage::Idle
    }

    /// It is at, or before, its first frame.
    pub fn is_beginning(&self) -> bool {
        matches!(self.stage, Stage::Ahead | Stage::Probe | Stage::Begin)
    }

    /// It is beyond its first frame: only its node can go on with it.
    pub fn is_amid(&self) -> bool {
        !matches!(self.stage, Stage::Idle | Stage::Guard | Stage::Drain) && !self.is_beginning()
    }

    /// What it sends is a guarding request.
    #[inline]
    pub fn guards(&self) -> bool {
        self.stage == Stage::Guard
    }

    /// It waits for a node's state.
    pub fn guarded(&self) -> bool {
        self.guards() && self.attempts > 0
    }

    #[inline]
    pub fn object(&self) -> Object {
        self.ask.object().unwrap_or(NOTHING)
    }

    pub fn is_stop(&self) -> bool {
        matches!(self.ask, Ask::Write { class: Class::Stop, .. })
    }

    pub fn begin(&mut self, ticket: Ticket, ask: Ask, long: Option<u8>) {
        self.long = long;
        let stage = match ask {
            Ask::Guard { .. } => Stage::Guard,
            _ => self.opening(&ask),
        };
        self.start(ticket, ask, first(&ask).map_or([0; 8], Request::bytes), stage);
    }

    /// Begins to read.
    #[inline]
    pub fn read(&mut self, ticket: Ticket, node: u8, object: Object) {
        let stage = if self.doubt.concerns(object) { Stage::Probe } else { Stage::Begin };
        self.start(ticket, Ask::Read { node, object }, Request::Read(object).bytes(), stage);
    }

    #[inline]
    fn start(&mut self, ticket: Ticket, ask: Ask, first: [u8; 8], stage: Stage) {
        self.ticket = ticket;
        self.ask = ask;
        self.first = first;
        self.stage = stage;
    }

    /// What goes first: the request, or where an older answer to the same may come, something else.
    fn opening(&self, ask: &Ask) -> Stage {
        match ask {
            _ if !self.doubt.concerns(ask.object().unwrap_or(NOTHING)) => Stage::Begin,
            Ask::Write { class: Class::Stop, .. } => Stage::Ahead,
            _ => Stage::Probe,
        }
    }

    /// As before the first frame.
    fn anew(&mut self) {
        (self.toggle, self.copied, self.stalled) = (false, false, false);
        (self.done, self.size, self.bits) = (0, None, 0);
    }

    /// It is over; gives the place of its bytes. What it left is cleared here, so that what ends
    /// [at once](Self::at_once) has nothing to clear.
    pub fn end(&mut self) -> Option<usize> {
        self.anew();
        self.ended_with(self.object());
        self.long.take().map(usize::from)
    }

    #[inline]
    fn ended_with(&mut self, object: Object) {
        self.ended = object;
        self.doubled *= u8::from(self.again);
        self.again = false;
        self.attempts = 0;
        self.stage = Stage::Idle;
    }

    /// A reply came that nothing waits for: where the last question is answered, it may be a second
    /// one to that.
    #[cold]
    pub fn spoke_again(&mut self, data: [u8; 8]) {
        let again = self.doubt == Doubt::None && Reply::of(data).object() == Some(self.ended);
        if again && !core::mem::replace(&mut self.again, true) {
            self.doubled = self.doubled.saturating_add(1);
        }
    }

    /// Two nodes have this number.
    #[inline]
    pub fn are_twins(&self) -> bool {
        self.doubled >= DOUBLED_MAX
    }

    /// A reply of one frame is all there is to what was read.
    #[inline]
    pub fn at_once(&mut self, reply: [u8; 8]) -> Option<Answer> {
        if self.stage != Stage::Begin || self.long.is_some() {
            return None;
        }
        let (object, Short { bits, len }) = answer(self.first, reply)?;
        self.doubt = Doubt::None;
        self.ended_with(object);
        Some(Answer::Value { object, bits: bits.into(), len: len.into() })
    }

    /// What tells the node that the last transfer is over.
    pub fn abort_frame(&mut self) -> Request {
        Request::Abort(self.ended, core::mem::replace(&mut self.abort, Abort::TIMEOUT))
    }

    pub fn probe(&self) -> Object {
        PROBES[usize::from(self.object() == PROBES[0])]
    }

    /// The request, where it goes first and is all that goes.
    #[inline]
    pub fn emit_first(&mut self, deadline: Instant) -> Option<[u8; 8]> {
        (self.stage == Stage::Begin).then(|| {
            self.deadline = deadline;
            self.first
        })
    }

    /// The next frame, and whether another one follows it at once.
    pub fn emit(&mut self, deadline: Instant, long: Option<&mut Long>) -> ([u8; 8], bool) {
        self.deadline = deadline;
        match self.stage {
            Stage::Begin | Stage::Ahead => (self.first, false),
            Stage::Probe => (Request::Read(self.probe()).bytes(), false),
            _ => self.emit_on(long),
        }
    }

    fn emit_on(&mut self, long: Option<&mut Long>) -> ([u8; 8], bool) {
        let request = match (self.stage, long) {
            (Stage::Reading, _) => Request::ReadSegment(self.toggle),
            (Stage::Writing, long) => Request::WriteSegment(self.segment(long)),
            (Stage::BlockStart, _) => {
                self.stage = Stage::BlockReading(0);
                self.segments = Long::SEGMENTS;
                Request::ReadBlockStart
            }
            (Stage::BlockReading(arrived), Some(long)) => {
                self.segments = long.segments();
                self.stage = match long.has_last() {
                    true => Stage::BlockReadEnd,
                    false => Stage::BlockReading(0),
                };
                Request::ReadBlockAck { arrived, segments: self.segments.max(1) }
            }
            (Stage::BlockReadDone, _) => {
                self.stage = Stage::Drain;
                self.stalled = true;
                Request::ReadBlockEnd
            }
            (Stage::BlockWriting(sent), Some(long)) => return self.block_segment(sent, long),
            (Stage::BlockWriteEnd, Some(long)) => {
                let (unused, crc) = long.written();
                Request::WriteBlockEnd { unused, crc: if self.checked { crc } else { 0 } }
            }
            (Stage::Guard, _) => {
                self.attempts = 1;
                Request::Other(0)
            }
            _ => Request::Abort(self.object(), Abort::INTERNAL),
        };
        (request.bytes(), false)
    }

    fn segment(&mut self, long: Option<&mut Long>) -> Segment {
        let mut segment = Segment { toggle: self.toggle, ..Segment::default() };
        match (long, self.ask) {
            (Some(long), _) => {
                let Sent { data, len, last } = long.segment(0).unwrap_or_default();
                (segment.data, segment.len, segment.last) = (data, len, last);
            }
            (None, Ask::Write { bits, len, .. }) => {
                let left = bits.to_le_bytes();
                let left = left.get(self.done as usize..usize::from(len)).unwrap_or(&[]);
                let count = left.len().min(SEGMENT);
                segment.data[..count].copy_from_slice(&left[..count]);
                (segment.len, segment.last) = (count as u8, left.len() <= SEGMENT);
            }
            _ => {}
        }
        segment
    }

    fn block_segment(&mut self, sent: u8, long: &Long) -> ([u8; 8], bool) {
        let Sent { data, last, .. } = long.segment(sent).unwrap_or_default();
        let number = sent + 1;
        self.stage = Stage::BlockWriting(number);
        let more = !last && number < self.segments && long.segment(number).is_some();
        self.stalled = !last && number < self.segments && !more;
        (BlockSegment { number, last, data }.bytes(), more)
    }

    /// Nothing came in time. Gives what comes next, and whether that says something again.
    pub fn silent(&mut self, long: Option<&mut Long>) -> (Step, bool) {
        self.ended = self.object();
        let again = self.attempts + 1 < ATTEMPTS_MAX;
        let over = Err(if self.stalled { Failure::Cancelled } else { Failure::Silent });
        match (self.stage, long) {
            (Stage::BlockReading(arrived), Some(_)) if again && !self.stalled && arrived > 0 => {
                // The end of the block was lost: what came of it is acknowledged.
                self.attempts += 1;
                (Step::Send, true)
            }
            (Stage::Begin, None) if again && self.may_repeat() => {
                self.attempts += 1;
                self.doubt.add(self.object());
                self.stage = Stage::Probe;
                self.anew();
                (Step::Send, true)
            }
            // A stop is sent whatever the probe says.
            (Stage::Ahead, _) => {
                self.stage = Stage::Probe;
                (Step::Send, false)
            }
            (Stage::Probe, _) if again && self.is_stop() => {
                self.attempts += 1;
                self.stage = Stage::Ahead;
                (Step::Send, true)
            }
            (Stage::Guard, _) => (Step::End(over), false),
            (Stage::Drain, _) => (Step::End(over), false),
            (stage, _) => {
                if stage != Stage::Probe {
                    self.doubt.add(self.object());
                }
                (Step::Abort(Abort::TIMEOUT, over), false)
            }
        }
    }

    /// Its answer is waited for no more, and may still come: a stop comes first, or the link is
    /// down. Gives how this ends: what may have been executed is not known.
    pub fn overtaken(&mut self) -> Failure {
        self.doubt.add(self.object());
        match self.ask {
            Ask::Write { .. } | Ask::Download { .. } => Failure::Silent,
            _ => Failure::Cancelled,
        }
    }

    fn may_repeat(&self) -> bool {
        matches!(self.ask, Ask::Read { .. }) || self.is_stop()
    }
}
