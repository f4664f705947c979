//! The SDO server: expedited, in segments and in blocks, one transfer at a time. A new request ends
//! the one before, as the standard has it.

use super::{CanEnd, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::od::{Entry, OWN, Worth};
use crate::proto::canopen::sdo::{
    Abort, BLOCK_MAX, BlockSegment, Object, Reply, Request, SEGMENT, Segment, Short, crc,
};
use crate::time::Instant;

/// What the server is in.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
enum Mode {
    #[default]
    Idle,
    /// Segments are asked for.
    Reading,
    /// Segments come.
    Writing,
    /// A block was asked for, and the client has not begun.
    Offering,
    /// Segments of a block are sent.
    Sending,
    /// All is sent and acknowledged.
    Sent,
    /// Segments of a block come.
    Receiving,
    /// All has come.
    Received,
}

/// The transfer under way.
#[derive(Clone, Debug, Default)]
#[repr(C)]
pub(super) struct Server {
    object: Object,
    entry: Option<&'static Entry>,
    /// Bytes that are done: sent and acknowledged, or taken.
    done: u32,
    /// All bytes, where known.
    size: Option<u32>,
    /// A value of fixed length.
    value: [u8; 8],
    toggle: bool,
    /// Whether a check is made, and what it is so far.
    checks: bool,
    check: u16,
    /// Segments of this block: as agreed, and sent or taken in order.
    segments: u8,
    count: u8,
    /// The latest segment, whose length only the end tells.
    held: Option<[u8; SEGMENT]>,
    /// Last, beside what each cycle needs.
    mode: Mode,
}

impl Server {
    /// Nothing is under way.
    pub(super) const fn end(&mut self) {
        self.mode = Mode::Idle;
    }
}

impl<const N: usize> CanEnd<N> {
    /// A request came.
    #[inline]
    pub(super) fn request(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        if frame.len != 8 && !self.is_whole(frame, firmware) {
            return;
        }
        if self.server.mode == Mode::Receiving && frame.data[0] & 0x7F != 0 {
            return self.block_segment(BlockSegment::of(frame.data), firmware);
        }
        let request = Request::of(frame.data);
        let reply = match request {
            Request::Read(object) => self.read(object, firmware),
            Request::Write(object, short) => self.write(now, object, short, firmware).bytes(),
            Request::Abort(..) => {
                self.mail.drop_sdo();
                return self.server.end();
            }
            _ if !self.options.segments => self.refuse(request, Abort::SPECIFIER).bytes(),
            _ => match self.longer(now, request, firmware) {
                Ok(None) => return,
                Ok(Some(reply)) => reply.bytes(),
                Err(abort) => self.refuse(request, abort).bytes(),
            },
        };
        self.mail.sdo(reply);
    }

    /// \[I\] A request shorter than the standard's eight bytes has zeros behind it where all that it
    /// names is there, as in what the TS manual prints; else it is not heard.
    #[cold]
    fn is_whole(&self, frame: &Frame, firmware: &impl Firmware) -> bool {
        let head = 4;
        self.options.lenient
            && match Request::of(frame.data) {
                Request::Read(_) => frame.len >= head,
                Request::Write(object, short) => {
                    let entry = firmware.dictionary().find(object.index, object.sub);
                    let width = entry.and_then(|entry| entry.kind.bytes()).unwrap_or(0);
                    frame.len >= head + (short.bytes().1 as u8).max(width)
                }
                _ => false,
            }
    }

    #[cold]
    fn refuse(&mut self, request: Request, abort: Abort) -> Reply {
        let running =
            if self.server.mode == Mode::Idle { Object::default() } else { self.server.object };
        self.server.end();
        Reply::Abort(request.object().unwrap_or(running), abort)
    }

    fn entry(&self, object: Object, firmware: &impl Firmware) -> Result<&'static Entry, Abort> {
        let dictionary = firmware.dictionary();
        dictionary.find(object.index, object.sub).ok_or_else(|| {
            let object_is_there = !dictionary.object(object.index).is_empty();
            if object_is_there { Abort::NO_SUB } else { Abort::NO_OBJECT }
        })
    }

    /// What nearly every request asks for, a number of up to four bytes, goes ahead of the rest.
    #[inline]
    fn read(&mut self, object: Object, firmware: &mut impl Firmware) -> [u8; 8] {
        self.server.end();
        if let Some(entry) = firmware.dictionary().find(object.index, object.sub)
            && let Some(len @ 1..=4) = entry.kind.bytes()
            && entry.access.reads()
        {
            let ones = u32::MAX >> (32 - 8 * u32::from(len));
            return match self.value(entry, firmware) {
                Ok(value) => Reply::Value(object, Short { bits: value as u32 & ones, len }).bytes(),
                Err(abort) => Reply::Abort(object, abort).bytes(),
            };
        }
        self.read_any(object, firmware).bytes()
    }

    fn read_any(&mut self, object: Object, firmware: &mut impl Firmware) -> Reply {
        let opened =
            self.entry(object, firmware).and_then(|entry| self.open(object, entry, firmware));
        match opened.map(|()| self.short(firmware)) {
            Ok(Some(short)) => Reply::Value(object, short),
            Ok(None) if !self.options.segments => Reply::Abort(object, Abort::MEMORY),
            Ok(None) => {
                self.server.mode = Mode::Reading;
                Reply::ValueLong(object, self.server.size)
            }
            Err(abort) => Reply::Abort(object, abort),
        }
    }

    /// The value that was opened, if it fits into one frame.
    fn short(&mut self, firmware: &mut impl Firmware) -> Option<Short> {
        let len = self.server.size.filter(|size| (1..=4).contains(size))?;
        let mut bytes = [0; 4];
        self.fetch(0, &mut bytes[..len as usize], firmware);
        Some(Short { bits: u32::from_le_bytes(bytes), len: len as u8 })
    }

    /// Begins to read an object.
    fn open(
        &mut self,
        object: Object,
        entry: &'static Entry,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        if !entry.access.reads() {
            return Err(Abort::WRITE_ONLY);
        }
        self.server = Server { object, entry: Some(entry), ..Server::default() };
        let size = match (entry.kind.bytes(), entry.worth) {
            (Some(bytes), _) => {
                self.server.value = self.value(entry, firmware)?.to_le_bytes();
                u32::from(bytes)
            }
            (None, Worth::Text(text)) if entry.tag == OWN => text.len() as u32,
            (None, _) => firmware.length(entry.tag),
        };
        self.server.size = Some(size);
        Ok(())
    }

    /// Bytes of the object that is read, from `offset` on, within its length.
    fn fetch(&self, offset: u32, out: &mut [u8], firmware: &mut impl Firmware) {
        let Some(entry) = self.server.entry else { return };
        let from = |all: &[u8], out: &mut [u8]| {
            let start = (offset as usize).min(all.len());
            let len = out.len().min(all.len() - start);
            out[..len].copy_from_slice(&all[start..start + len]);
        };
        match (entry.kind.bytes(), entry.worth) {
            (Some(_), _) => from(&self.server.value, out),
            (None, Worth::Text(text)) if entry.tag == OWN => from(text.as_bytes(), out),
            (None, _) => firmware.read(entry.tag, offset, out),
        }
    }

    #[inline]
    fn write(
        &mut self,
        now: Instant,
        object: Object,
        short: Short,
        firmware: &mut impl Firmware,
    ) -> Reply {
        self.server.end();
        let done = match self.entry(object, firmware) {
            Ok(entry) if !entry.access.writes() => Err(Abort::READ_ONLY),
            Ok(entry) => match entry.kind.bytes() {
                // Who is lenient takes the width from the object.
                Some(1..=4) if self.options.lenient || short.len == 0 => {
                    self.set_value(now, entry, short.bits.into(), firmware)
                }
                Some(bytes) if bytes != short.len => Err(Abort::LENGTH),
                Some(_) => self.set_value(now, entry, short.bits.into(), firmware),
                None => self.write_whole(now, object, entry, short, firmware),
            },
            Err(abort) => Err(abort),
        };
        match done {
            Ok(()) => {
                self.look(now, firmware);
                Reply::Written(object, if self.options.echoes { short.bits } else { 0 })
            }
            Err(abort) => Reply::Abort(object, abort),
        }
    }

    /// An object of any length, all of it in one frame.
    fn write_whole(
        &mut self,
        now: Instant,
        object: Object,
        entry: &'static Entry,
        short: Short,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        let (bytes, len) = short.bytes();
        self.accept(object, entry, Some(len as u32), firmware)?;
        self.put(&bytes[..len], firmware)?;
        self.finish(now, firmware)
    }

    /// Begins to write an object.
    fn accept(
        &mut self,
        object: Object,
        entry: &'static Entry,
        size: Option<u32>,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        if !entry.access.writes() {
            return Err(Abort::READ_ONLY);
        }
        match (entry.kind.bytes().map(u32::from), size) {
            (Some(bytes), Some(size)) if size > bytes => return Err(Abort::TOO_LONG),
            (Some(bytes), Some(size)) if size < bytes => return Err(Abort::TOO_SHORT),
            (Some(_), _) => {}
            (None, _) if entry.tag == OWN => return Err(Abort::ACCESS),
            (None, size) => firmware.begin(entry.tag, size)?,
        }
        self.server = Server { object, entry: Some(entry), size, ..Server::default() };
        Ok(())
    }

    /// The next bytes of what is written.
    fn put(&mut self, data: &[u8], firmware: &mut impl Firmware) -> Result<(), Abort> {
        let server = &mut self.server;
        let entry = server.entry.ok_or(Abort::SPECIFIER)?;
        let end = server.done.checked_add(data.len() as u32).ok_or(Abort::TOO_LONG)?;
        if server.size.is_some_and(|size| end > size) {
            return Err(Abort::TOO_LONG);
        }
        match entry.kind.bytes() {
            Some(bytes) if end > u32::from(bytes) => return Err(Abort::TOO_LONG),
            Some(_) => {
                server.value[server.done as usize..end as usize].copy_from_slice(data);
            }
            None => firmware.write(entry.tag, server.done, data)?,
        }
        if server.checks {
            server.check = crc(server.check, data);
        }
        server.done = end;
        Ok(())
    }

    /// All that is written has come.
    fn finish(&mut self, now: Instant, firmware: &mut impl Firmware) -> Result<(), Abort> {
        let server = &mut self.server;
        let entry = server.entry.ok_or(Abort::SPECIFIER)?;
        let (done, value) = (server.done, u64::from_le_bytes(server.value));
        let whole = server.size.or(entry.kind.bytes().map(u32::from)).unwrap_or(done);
        server.end();
        if done < whole {
            return Err(Abort::TOO_SHORT);
        }
        match entry.kind.bytes() {
            Some(_) => self.set_value(now, entry, value, firmware)?,
            None => firmware.finish(now, entry.tag, done)?,
        }
        self.look(now, firmware);
        Ok(())
    }

    /// Everything but what fits into one frame.
    fn longer(
        &mut self,
        now: Instant,
        request: Request,
        firmware: &mut impl Firmware,
    ) -> Result<Option<Reply>, Abort> {
        let mode = self.server.mode;
        Ok(Some(match (request, mode) {
            (Request::WriteLong(object, size), _) => {
                self.server.end();
                let entry = self.entry(object, firmware)?;
                self.accept(object, entry, size, firmware)?;
                self.server.mode = Mode::Writing;
                Reply::Written(object, 0)
            }
            (Request::WriteSegment(segment), Mode::Writing) => {
                self.take_segment(now, &segment, firmware)?
            }
            (Request::ReadSegment(toggle), Mode::Reading) => self.give_segment(toggle, firmware)?,
            (Request::ReadBlock { object, crc, segments, threshold }, _) => {
                self.server.end();
                self.offer(object, crc, segments, threshold, firmware)?
            }
            (Request::ReadBlockStart, Mode::Offering) => {
                self.server.mode = Mode::Sending;
                self.mail.segments(true);
                return Ok(None);
            }
            (Request::ReadBlockAck { arrived, segments }, Mode::Sending) => {
                return self.acknowledged(arrived, segments, firmware);
            }
            (Request::ReadBlockEnd, Mode::Sent) => {
                self.server.end();
                return Ok(None);
            }
            (Request::WriteBlock { object, crc, size }, _) => {
                self.server.end();
                let entry = self.entry(object, firmware)?;
                self.accept(object, entry, size, firmware)?;
                self.server.mode = Mode::Receiving;
                (self.server.checks, self.server.segments) = (crc, BLOCK_MAX);
                Reply::WriteBlockReady { object, crc: true, segments: BLOCK_MAX }
            }
            (Request::WriteBlockEnd { unused, crc }, Mode::Received) => {
                self.end_block(now, unused, crc, firmware)?
            }
            _ => return Err(Abort::SPECIFIER),
        }))
    }

    fn take_segment(
        &mut self,
        now: Instant,
        segment: &Segment,
        firmware: &mut impl Firmware,
    ) -> Result<Reply, Abort> {
        if segment.toggle != self.server.toggle {
            return Err(Abort::TOGGLE);
        }
        self.server.toggle = !segment.toggle;
        self.put(segment.bytes(), firmware)?;
        if segment.last {
            self.finish(now, firmware)?;
        }
        Ok(Reply::WrittenSegment(segment.toggle))
    }

    fn give_segment(&mut self, toggle: bool, firmware: &mut impl Firmware) -> Result<Reply, Abort> {
        if toggle != self.server.toggle {
            return Err(Abort::TOGGLE);
        }
        let (at, size) = (self.server.done, self.server.size.unwrap_or(0));
        let len = (size - at).min(SEGMENT as u32);
        let mut data = [0; SEGMENT];
        self.fetch(at, &mut data[..len as usize], firmware);
        self.server.done += len;
        self.server.toggle = !toggle;
        let last = self.server.done == size;
        if last {
            self.server.end();
        }
        Ok(Reply::ValueSegment(Segment { toggle, last, len: len as u8, data }))
    }

    fn offer(
        &mut self,
        object: Object,
        checks: bool,
        segments: u8,
        threshold: u8,
        firmware: &mut impl Firmware,
    ) -> Result<Reply, Abort> {
        if !(1..=BLOCK_MAX).contains(&segments) {
            return Err(Abort::BLOCK_SIZE);
        }
        let entry = self.entry(object, firmware)?;
        self.open(object, entry, firmware)?;
        let size = self.server.size;
        if threshold > 0 && size.is_some_and(|size| size <= threshold.into()) {
            // So few bytes go the ordinary way.
            return Ok(self.read_any(object, firmware));
        }
        self.server.mode = Mode::Offering;
        (self.server.checks, self.server.segments) = (checks, segments);
        Ok(Reply::ReadBlockReady { object, crc: true, size })
    }

    /// The next segment of a block, as fast as the bus takes them.
    #[inline]
    pub(super) fn next_segment(&mut self, firmware: &mut impl Firmware) -> Option<[u8; 8]> {
        let Server { mode, done, size, count, segments, .. } = self.server;
        self.mail.segments(mode == Mode::Sending);
        let at = done + u32::from(count) * SEGMENT as u32;
        let size = size.unwrap_or(0);
        if mode != Mode::Sending || count == segments || (count > 0 && at >= size) {
            return None;
        }
        let len = (size - at).min(SEGMENT as u32);
        let mut data = [0; SEGMENT];
        self.fetch(at, &mut data[..len as usize], firmware);
        self.server.count += 1;
        let last = at + len == size;
        Some(BlockSegment { number: count + 1, last, data }.bytes())
    }

    /// So many segments of the block arrived; the others are sent again.
    fn acknowledged(
        &mut self,
        arrived: u8,
        segments: u8,
        firmware: &mut impl Firmware,
    ) -> Result<Option<Reply>, Abort> {
        if arrived > self.server.count {
            return Err(Abort::SEQUENCE);
        }
        if !(1..=BLOCK_MAX).contains(&segments) {
            return Err(Abort::BLOCK_SIZE);
        }
        let size = self.server.size.unwrap_or(0);
        for _ in 0..arrived {
            let len = (size - self.server.done).min(SEGMENT as u32);
            let mut data = [0; SEGMENT];
            self.fetch(self.server.done, &mut data[..len as usize], firmware);
            self.server.check = crc(self.server.check, &data[..len as usize]);
            self.server.done += len;
        }
        (self.server.count, self.server.segments) = (0, segments);
        if self.server.done < size || arrived == 0 {
            return Ok(None);
        }
        self.server.mode = Mode::Sent;
        let crc = if self.server.checks { self.server.check } else { 0 };
        Ok(Some(Reply::ReadBlockEnd { unused: unused(size), crc }))
    }

    /// A segment of a block came. What comes after a gap is dropped, and sent again once the block
    /// is acknowledged.
    fn block_segment(&mut self, segment: BlockSegment, firmware: &mut impl Firmware) {
        let in_order = segment.number == self.server.count + 1;
        if in_order {
            if let Some(data) = self.server.held.replace(segment.data)
                && let Err(abort) = self.put(&data, firmware)
            {
                let object = self.server.object;
                self.server.end();
                self.mail.sdo(Reply::Abort(object, abort).bytes());
                return;
            }
            self.server.count += 1;
        }
        if segment.number < self.server.segments && !segment.last {
            return;
        }
        let arrived = core::mem::take(&mut self.server.count);
        if in_order && segment.last {
            self.server.mode = Mode::Received;
        }
        let reply = Reply::WriteBlockAck { arrived, segments: self.server.segments };
        self.mail.sdo(reply.bytes());
    }

    fn end_block(
        &mut self,
        now: Instant,
        unused: u8,
        check: u16,
        firmware: &mut impl Firmware,
    ) -> Result<Reply, Abort> {
        let data = self.server.held.take().unwrap_or_default();
        self.put(&data[..SEGMENT - usize::from(unused).min(SEGMENT)], firmware)?;
        if self.server.checks && self.server.check != check {
            return Err(Abort::CRC);
        }
        self.finish(now, firmware)?;
        Ok(Reply::WriteBlockDone)
    }
}

/// Bytes of the last segment that do not count.
const fn unused(size: u32) -> u8 {
    match (size % SEGMENT as u32) as u8 {
        0 if size > 0 => 0,
        rest => SEGMENT as u8 - rest,
    }
}
