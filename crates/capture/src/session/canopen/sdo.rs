//! Transfers of service data: one at a time on each channel, in a single frame, in segments or in
//! blocks (CiA 301, 7.2.4). What was asked before the capture began accuses nobody.

mod block;
mod reply;
mod request;

use polepair_core::proto::canopen::explain::say;
use polepair_core::proto::canopen::sdo::{Abort, Object, SEGMENT, crc};

use super::odd;
use crate::session::{Exchange, Notice, Odd, Oddity, Outcome};
use crate::stamp::Stamp;
use block::Block;

/// How long a node may take for an answer, and a client for its next frame, ns.
pub(super) const TIMEOUT_NS: u64 = 1_000_000_000;
/// The same where flash is written: store, restore, programs.
pub(super) const FLASH_TIMEOUT_NS: u64 = 10_000_000_000;
/// An answer that was given up is waited for as many times as long: late is not lost.
const LATE: u64 = 3;
/// What is written has its effect within this, ns.
const MOMENT_NS: u64 = 100_000_000;
/// Bytes of a value that are kept: the head of what may be megabytes.
pub(super) const HEAD_MAX: usize = 1024;
/// So many requests one behind the other answered twice, and two nodes have the number.
const TWICE_MAX: u8 = 3;

/// Number and time of a frame.
pub(super) type At = (u64, Option<Stamp>);

/// Reading or writing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Op {
    Read,
    Write,
}

impl Op {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "SDO read",
            Self::Write => "SDO write",
        }
    }
}

/// What a frame is in its transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Part {
    /// Nothing that its own words do not say.
    Plain,
    /// One of several.
    Segment(u32),
    /// A segment of a block, which has no words of its own.
    BlockSegment(u32),
    /// The last: the value is there.
    Whole,
}

/// A value that was read or written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settled {
    pub op: Op,
    pub object: Object,
    /// Up to eight bytes, the first lowest, and how many; 0 where the frame does not say.
    pub bits: u64,
    pub len: u8,
    /// The frame that asked.
    pub asked: u64,
}

/// Whose turn it is, and for what.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// The node answers the first frame.
    First,
    /// The client sends a segment, or asks for one.
    Client,
    /// The node takes a segment, or sends one.
    Node,
    /// The client sends a block.
    BlockDown,
    /// The node says how much of it arrived.
    BlockDownAck,
    /// The client says that this was all.
    BlockDownEnd,
    /// The node has checked everything.
    BlockDownDone,
    /// The client wants the first block.
    BlockUpStart,
    /// The node sends a block.
    BlockUp,
    /// The client says how much of it arrived.
    BlockUpAck,
    /// The node says that this was all.
    BlockUpEnd,
    /// The client has checked everything.
    BlockUpDone,
}

impl Phase {
    const fn is_nodes(self) -> bool {
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
enum State {
    /// In the middle of something, until a transfer begins.
    Adrift,
    Idle,
    Open,
}

/// One transfer, also after its end.
#[derive(Debug)]
struct Transfer {
    op: Op,
    object: Object,
    asked: At,
    answered: Option<At>,
    retries: u16,
    /// The client's last frame.
    request: [u8; 8],
    phase: Phase,
    toggle: bool,
    last: bool,
    size: Option<u32>,
    got: u32,
    segments: u32,
    head: Vec<u8>,
    /// The frame that had the value did not say how many bytes count.
    sizeless: bool,
    crc: u16,
    checked: bool,
    block: Block,
    /// It was said what is odd with it.
    accused: bool,
    /// It may be the middle of one that began before the capture.
    doubtful: bool,
    /// When it last went on.
    moved: Option<Stamp>,
}

/// A request that is waited for no more, and may be answered yet.
#[derive(Debug)]
struct GivenUp {
    op: Op,
    object: Object,
    asked: At,
    /// When an answer is not to be expected any longer.
    until: Option<Stamp>,
    /// That it was not answered, which is told when no answer came by then.
    held: Vec<Notice>,
}

/// A channel between a client and a node.
#[derive(Debug)]
pub(super) struct Channel {
    pub node: u8,
    state: State,
    transfer: Transfer,
    /// What was given up, and may be answered yet.
    given_up: Option<GivenUp>,
    /// The node's last frame.
    reply: [u8; 8],
    /// Answers that earlier, repeated requests may still get.
    owed: u16,
    /// Requests in a row that were answered twice.
    twice: u8,
    /// The last one was.
    doubled: bool,
    /// Since when nobody knows what is going on.
    adrift: Option<Stamp>,
    settled: Option<Settled>,
}

impl Channel {
    /// A channel of which nothing was heard up to the beginning of the capture, `since`.
    pub fn new(node: u8, since: Option<Stamp>) -> Self {
        Self {
            node,
            state: State::Adrift,
            transfer: Transfer::new(),
            given_up: None,
            reply: [0xFF; 8],
            owed: 0,
            twice: 0,
            doubled: false,
            adrift: since,
            settled: None,
        }
    }

    /// The capture begins.
    pub const fn since(&mut self, began: Option<Stamp>) {
        self.adrift = began;
    }

    /// The object that a transfer under way is about, or was.
    pub fn object(&self) -> Object {
        self.transfer.object
    }

    /// An object is being written, or was a moment ago.
    pub fn is_setting(&self, object: Object, now: Option<Stamp>) -> bool {
        let t = &self.transfer;
        let since = t.moved.zip(now).map_or(0, |(moved, now)| now.since(moved));
        (t.op, t.object) == (Op::Write, object) && since < MOMENT_NS
    }

    /// What the last transfer brought: the head of the value, how long it is, in how many segments.
    pub fn value(&self) -> (&[u8], u32, u32) {
        (&self.transfer.head, self.transfer.got, self.transfer.segments)
    }

    /// Segments that the whole has, if its size was told.
    pub fn segments_in_all(&self) -> Option<u32> {
        Some(self.transfer.size?.div_ceil(SEGMENT as u32))
    }

    /// What was read or written, once.
    pub fn settled(&mut self) -> Option<Settled> {
        self.settled.take()
    }

    /// Both answered the same requests, time and again.
    pub fn is_answered_by_two(&self) -> bool {
        self.twice >= TWICE_MAX
    }

    /// When something is to be told if nothing comes.
    pub fn due(&self) -> Option<Stamp> {
        let held = self.given_up.as_ref().filter(|given_up| !given_up.held.is_empty());
        let until = held.and_then(|given_up| given_up.until);
        self.transfer_due().into_iter().chain(until).min()
    }

    /// When the transfer under way is given up if nothing comes.
    fn transfer_due(&self) -> Option<Stamp> {
        let moved = self.transfer.moved.filter(|_| self.state == State::Open)?;
        Some(moved.plus(self.transfer.patience()))
    }

    /// Time went on to `now`.
    pub fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        if self.transfer_due().is_some_and(|due| due < now) {
            let ms = self.transfer.patience() / 1_000_000;
            self.give_up(&format!(" within {ms} ms"), notices);
        }
        let until = self.given_up.as_ref().and_then(|given_up| given_up.until);
        if until.is_some_and(|until| until < now) {
            self.tell_held(notices);
        }
    }

    /// Keeps back that a request was not answered, as it was told from `before` on: should the answer
    /// still come, then it is late, and nothing else.
    pub fn hold(&mut self, before: usize, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let Some(given_up) = self.given_up.as_mut().filter(|it| it.until.is_some()) else { return };
        let mut at = before;
        while at < notices.len() {
            let mine = match &mut notices[at] {
                Notice::Odd(odd) if is_unanswered(odd) => {
                    odd.time = now;
                    true
                }
                Notice::Exchange(exchange) => exchange.asked == given_up.asked,
                _ => false,
            };
            match mine {
                true => given_up.held.push(notices.remove(at)),
                false => at += 1,
            }
        }
    }

    /// No answer came.
    fn tell_held(&mut self, notices: &mut Vec<Notice>) {
        notices.extend(self.given_up.iter_mut().flat_map(|given_up| given_up.held.drain(..)));
    }

    /// What may be answered yet is the transfer that ends now.
    fn given_up(&mut self, notices: &mut Vec<Notice>) {
        self.tell_held(notices);
        let t = &self.transfer;
        let moved = t.moved.filter(|_| t.phase == Phase::First);
        let until = moved.map(|moved| moved.plus(LATE * t.patience()));
        let (op, object, asked) = (t.op, t.object, t.asked);
        self.given_up = Some(GivenUp { op, object, asked, until, held: Vec::new() });
    }

    /// The capture ends. Who was not given the time to answer is not accused.
    pub fn end(&mut self, notices: &mut Vec<Notice>) {
        self.tell_held(notices);
        if self.state == State::Open && !self.transfer.doubtful {
            self.close(Outcome::Unknown, None, notices);
        }
    }

    /// The node starts again: what is under way ends without an answer. What was asked a moment ago
    /// may have met the boot-up on its way, or was written down before it: its answer may yet come.
    pub fn reset(&mut self, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        if self.state == State::Open {
            let since = self.transfer.moved.zip(now).map_or(0, |(moved, now)| now.since(moved));
            if self.transfer.phase == Phase::First && since < MOMENT_NS {
                return;
            }
            self.give_up(" before the node started again", notices);
        }
        self.tell_held(notices);
        (self.given_up, self.owed) = (None, 0);
    }

    /// Nobody goes on with the transfer under way.
    fn give_up(&mut self, why: &str, notices: &mut Vec<Notice>) {
        self.given_up(notices);
        let t = &self.transfer;
        let spelled = t.spelled();
        let (kind, text) = match t.phase {
            Phase::First => (Oddity::Unanswered, format!("{spelled} was not answered{why}")),
            phase => {
                let who = if phase.is_nodes() { "the node" } else { "the client" };
                let how = format!("{who} did not go on after {}{why}", t.progress());
                (Oddity::Incomplete, format!("{spelled} was broken off: {how}"))
            }
        };
        self.accuse(kind, text, notices);
        let outcome = self.transfer.left_outcome();
        self.close(outcome, None, notices);
    }

    /// Tells what is odd with the transfer, once.
    fn accuse(&mut self, kind: Oddity, text: String, notices: &mut Vec<Notice>) {
        if !core::mem::replace(&mut self.transfer.accused, true) {
            notices.push(odd(kind, self.node, text));
        }
    }

    /// The transfer ends.
    fn close(&mut self, outcome: Outcome, answered: Option<At>, notices: &mut Vec<Notice>) {
        let t = &self.transfer;
        self.state = State::Idle;
        self.owed = t.retries;
        notices.push(Notice::Exchange(Exchange {
            axis: Some(self.node.into()),
            op: t.op.name(),
            asked: t.asked,
            answered: answered.or(t.answered),
            outcome,
            retries: t.retries,
        }));
    }

    /// The transfer is done.
    fn done(&mut self, at: At, notices: &mut Vec<Notice>) -> Part {
        let t = &self.transfer;
        if let Some(size) = t.size.filter(|size| *size != t.got) {
            let text = format!("{} announced {size} bytes and had {}", t.spelled(), t.got);
            self.accuse(Oddity::Length, text, notices);
        }
        let t = &self.transfer;
        self.settled = t.settled();
        let answered = t.answered.unwrap_or(at);
        self.close(Outcome::Done, Some(answered), notices);
        Part::Whole
    }

    /// The node gives the transfer up.
    fn refused(&mut self, abort: Abort, at: At, notices: &mut Vec<Notice>) {
        let text = format!("{} was refused: {}", self.transfer.spelled(), say::abort(abort));
        self.accuse(Oddity::Refused, text, notices);
        self.close(Outcome::Refused, Some(at), notices);
    }
}

impl Transfer {
    fn new() -> Self {
        Self {
            op: Op::Read,
            object: Object::default(),
            asked: (0, None),
            answered: None,
            retries: 0,
            request: [0; 8],
            phase: Phase::First,
            toggle: false,
            last: false,
            size: None,
            got: 0,
            segments: 0,
            head: Vec::new(),
            sizeless: false,
            crc: 0,
            checked: false,
            block: Block::default(),
            accused: false,
            doubtful: false,
            moved: None,
        }
    }

    /// Begins anew, in the same buffers.
    fn begin(&mut self, op: Op, object: Object, request: [u8; 8], at: At) {
        let (head, block) = (core::mem::take(&mut self.head), core::mem::take(&mut self.block));
        *self = Self { op, object, request, asked: at, moved: at.1, head, block, ..Self::new() };
        self.head.clear();
        self.block.clear();
    }

    /// Takes bytes of the value.
    fn take(&mut self, bytes: &[u8]) {
        self.got = self.got.saturating_add(bytes.len() as u32);
        self.crc = crc(self.crc, bytes);
        let room = HEAD_MAX.saturating_sub(self.head.len());
        self.head.extend_from_slice(&bytes[..bytes.len().min(room)]);
    }

    /// The value, where it is short enough to be a number.
    fn settled(&self) -> Option<Settled> {
        let len = u8::try_from(self.got).ok().filter(|len| *len <= 8 && !self.head.is_empty())?;
        let bits = super::word(&self.head);
        let len = if self.sizeless { 0 } else { len };
        Some(Settled { op: self.op, object: self.object, bits, len, asked: self.asked.0 })
    }

    fn patience(&self) -> u64 {
        match self.object.index {
            0x1010 | 0x1011 | 0x1F50 | 0x1F51 => FLASH_TIMEOUT_NS,
            _ => TIMEOUT_NS,
        }
    }

    /// How it ends when nobody goes on: what was written in part may count or not.
    const fn left_outcome(&self) -> Outcome {
        match (self.op, self.phase) {
            (_, Phase::First) | (Op::Read, _) => Outcome::Unanswered,
            (Op::Write, _) => Outcome::Unknown,
        }
    }

    fn spelled(&self) -> String {
        let Object { index, sub } = self.object;
        let verb = if self.op == Op::Read { "reading" } else { "writing" };
        format!("{verb} 0x{index:04X}:{sub}")
    }

    fn progress(&self) -> String {
        match (self.segments, self.size) {
            (0, _) => "the first frame".to_owned(),
            (n, Some(size)) => format!("{} of {size} bytes, {n} segments", self.got),
            (n, None) => format!("{} bytes, {n} segments", self.got),
        }
    }
}

/// Told just now: what was kept back has its own time.
pub(super) fn is_unanswered(odd: &Odd) -> bool {
    odd.kind == Oddity::Unanswered && odd.time.is_none()
}
