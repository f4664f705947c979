//! What a node's answers make of its transfer.

use super::channel::{Channel, Doubt, Sort, Stage, Step};
use super::long::Long;
use crate::error::Failure;
use crate::proto::canopen::ask::{Answer, Ask};
use crate::proto::canopen::sdo::{Abort, BlockSegment, Object, Reply, SEGMENT, Segment};
use crate::time::Instant;

/// Bytes of a value that go into an outcome.
const SHORT: u32 = 8;

impl Channel {
    /// Takes what the node says; `deadline` is when it must say more.
    pub fn reply(
        &mut self,
        deadline: Instant,
        data: [u8; 8],
        long: Option<&mut Long>,
    ) -> (Step, Sort) {
        if let Stage::BlockReading(arrived) = self.stage
            && data[0] != 0x80
        {
            self.deadline = deadline;
            return (self.block_came(BlockSegment::of(data), arrived, long), Sort::Answer);
        }
        // What is said to a stop ahead of the probe may be said to what was before.
        let sure = self.stage != Stage::Ahead;
        match self.step(deadline, Reply::of(data), long) {
            Some(step) => (step, if sure { Sort::Answer } else { Sort::Late }),
            None => (Step::Wait, Sort::Late),
        }
    }

    /// What a reply leads to; `None` for one that is not waited for.
    fn step(&mut self, deadline: Instant, reply: Reply, long: Option<&mut Long>) -> Option<Step> {
        let object = self.object();
        match (self.stage, reply) {
            (Stage::Idle | Stage::Guard | Stage::Drain, _) => None,
            (Stage::Probe, Reply::Abort(named, _))
            | (Stage::Probe, Reply::Value(named, _) | Reply::ValueLong(named, _))
                if named == self.probe() =>
            {
                self.doubt = Doubt::None;
                self.stage = Stage::Begin;
                Some(Step::Send)
            }
            (Stage::Ahead, Reply::Written(named, _) | Reply::Abort(named, _))
                if named == object =>
            {
                self.stage = Stage::Probe;
                Some(Step::Send)
            }
            (Stage::Probe | Stage::Ahead, _) => None,
            (stage, Reply::Abort(named, abort))
                if named == object || stage != Stage::Begin && named == Object::default() =>
            {
                self.doubt = Doubt::None;
                Some(Step::End(Err(Failure::Refused { code: abort.0 })))
            }
            (Stage::Begin, reply) if reply.object() == Some(object) => {
                let step = self.begun(reply, long)?;
                self.doubt = Doubt::None;
                Some(step)
            }
            (Stage::Reading, Reply::ValueSegment(segment)) => {
                Some(self.came(deadline, segment, long))
            }
            (Stage::Writing, Reply::WrittenSegment(toggle)) => {
                Some(self.went(deadline, toggle, long))
            }
            (Stage::BlockReadEnd, Reply::ReadBlockEnd { unused, crc }) => {
                Some(self.all_came((unused, crc), long?))
            }
            (Stage::BlockWriting(sent), Reply::WriteBlockAck { arrived, segments }) => {
                Some(self.block_went(deadline, sent, (arrived, segments), long?))
            }
            (Stage::BlockWriteEnd, Reply::WriteBlockDone) => Some(self.through()),
            _ => None,
        }
    }

    /// The node took the request, and a longer transfer begins.
    fn begun(&mut self, reply: Reply, long: Option<&mut Long>) -> Option<Step> {
        self.stage = match (reply, self.ask) {
            (Reply::ValueLong(_, size), Ask::Read { .. } | Ask::Upload { block: false, .. }) => {
                self.size = size;
                Stage::Reading
            }
            // Short after all.
            (Reply::Value(_, short), Ask::Upload { .. }) => {
                let (bytes, len) = short.bytes();
                self.done = len as u32;
                long?.came(&bytes[..len]);
                return Some(self.drain());
            }
            (Reply::Written(object, _), Ask::Write { bits, len: 0..=4, .. }) => {
                return Some(Step::End(Ok(Answer::Written { object, bits })));
            }
            (Reply::Written(..), Ask::Write { .. }) => Stage::Writing,
            (Reply::Written(..), Ask::Download { block: false, .. }) => {
                self.stage = Stage::Writing;
                return Some(self.go_on(long?));
            }
            (Reply::ReadBlockReady { crc, .. }, Ask::Upload { block: true, .. }) => {
                self.checked = crc;
                Stage::BlockStart
            }
            (Reply::WriteBlockReady { crc, segments, .. }, Ask::Download { block: true, .. }) => {
                if !(1..=Long::SEGMENTS).contains(&segments) {
                    return Some(self.broken(Abort::BLOCK_SIZE));
                }
                (self.checked, self.segments) = (crc, segments);
                self.stage = Stage::BlockWriting(0);
                return Some(self.go_on(long?));
            }
            _ => return None,
        };
        Some(Step::Send)
    }

    /// A segment came.
    fn came(&mut self, deadline: Instant, segment: Segment, long: Option<&mut Long>) -> Step {
        if segment.toggle != self.toggle {
            return self.copy(deadline);
        }
        let bytes = segment.bytes();
        for byte in bytes {
            if self.done < SHORT {
                self.bits |= u64::from(*byte) << (8 * self.done);
            }
            self.done += 1;
        }
        (self.toggle, self.copied) = (!self.toggle, false);
        if let Some(long) = long {
            long.came(bytes);
            return if segment.last { self.drain() } else { self.go_on(long) };
        }
        let value = |len| Answer::Value { object: self.object(), bits: self.bits, len };
        match (segment.last, self.size.is_some_and(|size| size != self.done)) {
            (true, true) => self.broken(Abort::LENGTH),
            (true, false) => Step::End(Ok(value(self.done))),
            // The outcome has room for no more.
            (false, _) if self.done >= SHORT => {
                let len = self.size.unwrap_or(self.done).max(self.done);
                Step::Abort(Abort::MEMORY, Ok(value(len)))
            }
            (false, _) => Step::Send,
        }
    }

    /// A segment was taken.
    fn went(&mut self, deadline: Instant, toggle: bool, long: Option<&mut Long>) -> Step {
        if toggle != self.toggle {
            return self.copy(deadline);
        }
        (self.toggle, self.copied) = (!self.toggle, false);
        match (long, self.ask) {
            (Some(long), Ask::Download { size, .. }) => {
                self.done = size;
                if long.arrived(1) { self.through() } else { self.go_on(long) }
            }
            (_, Ask::Write { object, bits, len, .. }) => {
                self.done += SEGMENT as u32;
                match self.done < len.into() {
                    true => Step::Send,
                    false => Step::End(Ok(Answer::Written { object, bits })),
                }
            }
            _ => Step::Wait,
        }
    }

    /// A segment with the other's toggle: once it may be a copy of the one before.
    fn copy(&mut self, deadline: Instant) -> Step {
        if core::mem::replace(&mut self.copied, true) {
            return self.broken(Abort::TOGGLE);
        }
        self.deadline = deadline;
        Step::Wait
    }

    /// A segment of a block came. Those behind a gap do not count; they are sent again.
    fn block_came(&mut self, segment: BlockSegment, arrived: u8, long: Option<&mut Long>) -> Step {
        let Some(long) = long else { return self.broken(Abort::INTERNAL) };
        let BlockSegment { number, last, data } = segment;
        let wanted = number == arrived + 1;
        if wanted {
            self.stage = Stage::BlockReading(number);
            self.attempts = 0;
            self.done += SEGMENT as u32;
            long.block_came(data, last);
        }
        match last || number >= self.segments {
            true => self.go_on(long),
            false => Step::Wait,
        }
    }

    fn all_came(&mut self, (unused, crc): (u8, u16), long: &mut Long) -> Step {
        let computed = long.all_came(unused);
        self.done = self.done.saturating_sub(unused.into());
        if self.checked && computed != crc {
            return self.broken(Abort::CRC);
        }
        self.stage = Stage::BlockReadDone;
        Step::Send
    }

    /// The node took so many segments of a block, and the next one has so many.
    fn block_went(
        &mut self,
        deadline: Instant,
        sent: u8,
        (arrived, segments): (u8, u8),
        long: &mut Long,
    ) -> Step {
        if arrived > sent {
            return self.broken(Abort::SEQUENCE);
        }
        if !(1..=Long::SEGMENTS).contains(&segments) {
            return self.broken(Abort::BLOCK_SIZE);
        }
        self.attempts = if arrived == 0 { self.attempts + 1 } else { 0 };
        if self.attempts > Self::BLOCKS_LOST_MAX {
            return self.broken(Abort::SEQUENCE);
        }
        self.deadline = deadline;
        self.segments = segments;
        if long.arrived(arrived) {
            self.stage = Stage::BlockWriteEnd;
            return Step::Send;
        }
        self.stage = Stage::BlockWriting(0);
        self.go_on(long)
    }

    /// The node breaks the protocol.
    fn broken(&mut self, abort: Abort) -> Step {
        self.doubt.add(self.object());
        Step::Abort(abort, Err(Failure::Misbehaved))
    }

    /// Everything was written.
    fn through(&self) -> Step {
        let Ask::Download { size, .. } = self.ask else { return Step::Wait };
        Step::End(Ok(Answer::Transferred(size)))
    }

    /// Everything came; it is over when somebody has taken it.
    fn drain(&mut self) -> Step {
        self.stage = Stage::Drain;
        self.stalled = true;
        Step::Wait
    }

    /// Goes on with a long transfer if there are bytes, or room for them.
    fn go_on(&mut self, long: &Long) -> Step {
        let able = match self.stage {
            Stage::Reading => long.segments() > 0,
            Stage::BlockReading(_) => long.has_last() || long.segments() > 0,
            Stage::Writing => long.segment(0).is_some(),
            Stage::BlockWriting(sent) => long.segment(sent).is_some(),
            _ => true,
        };
        self.stalled = !able;
        if able { Step::Send } else { Step::Wait }
    }

    /// Somebody took or gave bytes.
    pub fn stirred(&mut self, long: &Long) -> Step {
        match self.stage {
            Stage::Drain if long.is_empty() => Step::End(Ok(Answer::Transferred(self.done))),
            Stage::Drain => Step::Wait,
            _ if self.stalled => self.go_on(long),
            _ => Step::Wait,
        }
    }
}
