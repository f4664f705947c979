//! The SDO server: expedited, segmented and block transfers, one at a time. A new request ends the one
//! before, as in the standard.

use super::{CanEndpoint, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::od::{DefaultValue, ObjectEntry, PROTOCOL_TAG};
use crate::proto::canopen::sdo::{
    AbortCode, BLOCK_MAX, BlockSegment, ExpeditedData, ObjectIndex, SEGMENT, SdoReply, SdoRequest,
    Segment, crc,
};
use crate::time::Instant;

/// State of the server.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
enum ServerState {
    #[default]
    Idle,
    /// A segmented read.
    Reading,
    /// Segments come.
    Writing,
    /// A block read that the client has not started.
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
pub(super) struct SdoServer {
    object: ObjectIndex,
    entry: Option<&'static ObjectEntry>,
    /// Bytes that are done: sent and acknowledged, or taken.
    bytes_done: u32,
    /// All bytes, where known.
    size: Option<u32>,
    /// A value of fixed length.
    value: [u8; 8],
    toggle: bool,
    /// True if a check is made; its value so far is kept.
    uses_crc: bool,
    crc: u16,
    /// Segments of this block: as agreed, and sent or taken in order.
    segments: u8,
    count: u8,
    /// The latest segment, whose length is known only at the end.
    held_segment: Option<[u8; SEGMENT]>,
    /// Last, beside what each cycle needs.
    state: ServerState,
}

impl SdoServer {
    /// Length of the transfer, bytes; 0 where none was stated.
    const fn stated_size(&self) -> u32 {
        match self.size {
            Some(size) => size,
            None => 0,
        }
    }

    /// Nothing is under way.
    pub(super) const fn end(&mut self) {
        self.state = ServerState::Idle;
    }
}

impl<const N: usize> CanEndpoint<N> {
    /// A request came.
    #[inline]
    pub(super) fn handle_sdo_request(
        &mut self,
        now: Instant,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        if frame.len != 8 && !self.is_complete_request(frame, firmware) {
            return;
        }
        if self.sdo_server.state == ServerState::Receiving && frame.data[0] & 0x7F != 0 {
            return self.receive_block_segment(BlockSegment::of(frame.data), firmware);
        }
        let request = SdoRequest::of(frame.data);
        let reply = match request {
            SdoRequest::Read(object) => self.read_object(object, firmware),
            SdoRequest::Write(object, short) => {
                self.write_object(now, object, short, firmware).bytes()
            }
            SdoRequest::Abort(..) => {
                self.send_slots.drop_sdo();
                return self.sdo_server.end();
            }
            _ if !self.quirks.segmented_sdo => {
                self.refuse_request(request, AbortCode::SPECIFIER).bytes()
            }
            _ => match self.handle_long_transfer(now, request, firmware) {
                Ok(None) => return,
                Ok(Some(reply)) => reply.bytes(),
                Err(abort) => self.refuse_request(request, abort).bytes(),
            },
        };
        self.send_slots.set_sdo(reply);
    }

    /// [I\] A request shorter than the standard's eight bytes is padded with zeros if all named bytes are present,
    /// as in examples of the TS manual; otherwise it is ignored.
    #[cold]
    fn is_complete_request(&self, frame: &Frame, firmware: &impl Firmware) -> bool {
        let head = 4;
        self.quirks.lenient
            && match SdoRequest::of(frame.data) {
                SdoRequest::Read(_) => frame.len >= head,
                SdoRequest::Write(object, short) => {
                    let entry = firmware.dictionary().find(object.index, object.sub);
                    let width = entry.and_then(|entry| entry.kind.bytes()).unwrap_or(0);
                    frame.len >= head + (short.bytes().1 as u8).max(width)
                }
                _ => false,
            }
    }

    #[cold]
    fn refuse_request(&mut self, request: SdoRequest, abort: AbortCode) -> SdoReply {
        let running = if self.sdo_server.state == ServerState::Idle {
            ObjectIndex::default()
        } else {
            self.sdo_server.object
        };
        self.sdo_server.end();
        SdoReply::Abort(request.object().unwrap_or(running), abort)
    }

    fn find_entry(
        &self,
        object: ObjectIndex,
        firmware: &impl Firmware,
    ) -> Result<&'static ObjectEntry, AbortCode> {
        let dictionary = firmware.dictionary();
        dictionary.find(object.index, object.sub).ok_or_else(|| {
            let object_is_there = !dictionary.object(object.index).is_empty();
            if object_is_there { AbortCode::NO_SUB } else { AbortCode::NO_OBJECT }
        })
    }

    /// Reads an object of up to four bytes, as nearly every request does.
    #[inline]
    fn read_object(&mut self, object: ObjectIndex, firmware: &mut impl Firmware) -> [u8; 8] {
        self.sdo_server.end();
        if let Some(entry) = firmware.dictionary().find(object.index, object.sub)
            && let Some(len @ 1..=4) = entry.kind.bytes()
            && entry.access.is_readable()
        {
            let ones = u32::MAX >> (32 - 8 * u32::from(len));
            return match self.value(entry, firmware) {
                Ok(value) => {
                    SdoReply::Value(object, ExpeditedData { bits: value as u32 & ones, len })
                        .bytes()
                }
                Err(abort) => SdoReply::Abort(object, abort).bytes(),
            };
        }
        self.read_object_slow_path(object, firmware).bytes()
    }

    fn read_object_slow_path(
        &mut self,
        object: ObjectIndex,
        firmware: &mut impl Firmware,
    ) -> SdoReply {
        let opened = self
            .find_entry(object, firmware)
            .and_then(|entry| self.begin_read(object, entry, firmware));
        match opened.map(|()| self.expedited_value(firmware)) {
            Ok(Some(short)) => SdoReply::Value(object, short),
            Ok(None) if !self.quirks.segmented_sdo => SdoReply::Abort(object, AbortCode::MEMORY),
            Ok(None) => {
                self.sdo_server.state = ServerState::Reading;
                SdoReply::ValueLong(object, self.sdo_server.size)
            }
            Err(abort) => SdoReply::Abort(object, abort),
        }
    }

    /// The value that was opened, if it fits into one frame.
    fn expedited_value(&mut self, firmware: &mut impl Firmware) -> Option<ExpeditedData> {
        let len = self.sdo_server.size.filter(|size| (1..=4).contains(size))?;
        let mut bytes = [0; 4];
        self.fetch_bytes(0, &mut bytes[..len as usize], firmware);
        Some(ExpeditedData { bits: u32::from_le_bytes(bytes), len: len as u8 })
    }

    /// Begins to read an object.
    fn begin_read(
        &mut self,
        object: ObjectIndex,
        entry: &'static ObjectEntry,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        if !entry.access.is_readable() {
            return Err(AbortCode::WRITE_ONLY);
        }
        self.sdo_server = SdoServer { object, entry: Some(entry), ..SdoServer::default() };
        let size = match (entry.kind.bytes(), entry.default) {
            (Some(bytes), _) => {
                self.sdo_server.value = self.value(entry, firmware)?.to_le_bytes();
                u32::from(bytes)
            }
            (None, DefaultValue::Text(text)) if entry.tag == PROTOCOL_TAG => text.len() as u32,
            (None, _) => firmware.length(entry.tag),
        };
        self.sdo_server.size = Some(size);
        Ok(())
    }

    /// Bytes of the object that is read, from `offset` on, within its length.
    fn fetch_bytes(&self, offset: u32, out: &mut [u8], firmware: &mut impl Firmware) {
        let Some(entry) = self.sdo_server.entry else { return };
        match (entry.kind.bytes(), entry.default) {
            (Some(_), _) => copy_from_offset(&self.sdo_server.value, out, offset),
            (None, DefaultValue::Text(text)) if entry.tag == PROTOCOL_TAG => {
                copy_from_offset(text.as_bytes(), out, offset)
            }
            (None, _) => firmware.read(entry.tag, offset, out),
        }
    }

    #[inline]
    fn write_object(
        &mut self,
        now: Instant,
        object: ObjectIndex,
        short: ExpeditedData,
        firmware: &mut impl Firmware,
    ) -> SdoReply {
        self.sdo_server.end();
        let done = match self.find_entry(object, firmware) {
            Ok(entry) if !entry.access.is_writable() => Err(AbortCode::READ_ONLY),
            Ok(entry) => match entry.kind.bytes() {
                // A lenient drive takes the width from the object.
                Some(1..=4) if self.quirks.lenient || short.len == 0 => {
                    self.set_value(now, entry, short.bits.into(), firmware)
                }
                Some(bytes) if bytes != short.len => Err(AbortCode::LENGTH),
                Some(_) => self.set_value(now, entry, short.bits.into(), firmware),
                None => self.write_whole_object(now, object, entry, short, firmware),
            },
            Err(abort) => Err(abort),
        };
        match done {
            Ok(()) => {
                self.check_changes(now, firmware);
                SdoReply::Written(object, if self.quirks.echoes_writes { short.bits } else { 0 })
            }
            Err(abort) => SdoReply::Abort(object, abort),
        }
    }

    /// An object of any length, all of it in one frame.
    fn write_whole_object(
        &mut self,
        now: Instant,
        object: ObjectIndex,
        entry: &'static ObjectEntry,
        short: ExpeditedData,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        let (bytes, len) = short.bytes();
        self.begin_write(object, entry, Some(len as u32), firmware)?;
        self.write_bytes(&bytes[..len], firmware)?;
        self.finish_write(now, firmware)
    }

    /// Begins to write an object.
    fn begin_write(
        &mut self,
        object: ObjectIndex,
        entry: &'static ObjectEntry,
        size: Option<u32>,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        if !entry.access.is_writable() {
            return Err(AbortCode::READ_ONLY);
        }
        match (entry.kind.bytes().map(u32::from), size) {
            (Some(bytes), Some(size)) if size > bytes => return Err(AbortCode::TOO_LONG),
            (Some(bytes), Some(size)) if size < bytes => return Err(AbortCode::TOO_SHORT),
            (Some(_), _) => {}
            (None, _) if entry.tag == PROTOCOL_TAG => return Err(AbortCode::ACCESS),
            (None, size) => firmware.begin_write(entry.tag, size)?,
        }
        self.sdo_server = SdoServer { object, entry: Some(entry), size, ..SdoServer::default() };
        Ok(())
    }

    /// Takes the next bytes of a write.
    fn write_bytes(&mut self, data: &[u8], firmware: &mut impl Firmware) -> Result<(), AbortCode> {
        let server = &mut self.sdo_server;
        let entry = server.entry.ok_or(AbortCode::SPECIFIER)?;
        let end = server.bytes_done.checked_add(data.len() as u32).ok_or(AbortCode::TOO_LONG)?;
        if server.size.is_some_and(|size| end > size) {
            return Err(AbortCode::TOO_LONG);
        }
        match entry.kind.bytes() {
            Some(bytes) if end > u32::from(bytes) => return Err(AbortCode::TOO_LONG),
            Some(_) => {
                server.value[server.bytes_done as usize..end as usize].copy_from_slice(data);
            }
            None => firmware.write(entry.tag, server.bytes_done, data)?,
        }
        if server.uses_crc {
            server.crc = crc(server.crc, data);
        }
        server.bytes_done = end;
        Ok(())
    }

    /// All that is written has come.
    fn finish_write(
        &mut self,
        now: Instant,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        let server = &mut self.sdo_server;
        let entry = server.entry.ok_or(AbortCode::SPECIFIER)?;
        let (done, value) = (server.bytes_done, u64::from_le_bytes(server.value));
        let whole = server.size.or(entry.kind.bytes().map(u32::from)).unwrap_or(done);
        server.end();
        if done < whole {
            return Err(AbortCode::TOO_SHORT);
        }
        match entry.kind.bytes() {
            Some(_) => self.set_value(now, entry, value, firmware)?,
            None => firmware.finish_write(now, entry.tag, done)?,
        }
        self.check_changes(now, firmware);
        Ok(())
    }

    /// Everything but what fits into one frame.
    fn handle_long_transfer(
        &mut self,
        now: Instant,
        request: SdoRequest,
        firmware: &mut impl Firmware,
    ) -> Result<Option<SdoReply>, AbortCode> {
        let mode = self.sdo_server.state;
        Ok(Some(match (request, mode) {
            (SdoRequest::WriteLong(object, size), _) => {
                self.sdo_server.end();
                let entry = self.find_entry(object, firmware)?;
                self.begin_write(object, entry, size, firmware)?;
                self.sdo_server.state = ServerState::Writing;
                SdoReply::Written(object, 0)
            }
            (SdoRequest::WriteSegment(segment), ServerState::Writing) => {
                self.receive_segment(now, &segment, firmware)?
            }
            (SdoRequest::ReadSegment(toggle), ServerState::Reading) => {
                self.send_segment(toggle, firmware)?
            }
            (SdoRequest::ReadBlock { object, crc, segments, threshold }, _) => {
                self.sdo_server.end();
                self.offer_block(object, crc, segments, threshold, firmware)?
            }
            (SdoRequest::ReadBlockStart, ServerState::Offering) => {
                self.sdo_server.state = ServerState::Sending;
                self.send_slots.set_segments(true);
                return Ok(None);
            }
            (SdoRequest::ReadBlockAck { arrived, segments }, ServerState::Sending) => {
                return self.handle_block_ack(arrived, segments, firmware);
            }
            (SdoRequest::ReadBlockEnd, ServerState::Sent) => {
                self.sdo_server.end();
                return Ok(None);
            }
            (SdoRequest::WriteBlock { object, crc, size }, _) => {
                self.sdo_server.end();
                let entry = self.find_entry(object, firmware)?;
                self.begin_write(object, entry, size, firmware)?;
                self.sdo_server.state = ServerState::Receiving;
                (self.sdo_server.uses_crc, self.sdo_server.segments) = (crc, BLOCK_MAX);
                SdoReply::WriteBlockReady { object, crc: true, segments: BLOCK_MAX }
            }
            (SdoRequest::WriteBlockEnd { unused, crc }, ServerState::Received) => {
                self.end_block(now, unused, crc, firmware)?
            }
            _ => return Err(AbortCode::SPECIFIER),
        }))
    }

    fn receive_segment(
        &mut self,
        now: Instant,
        segment: &Segment,
        firmware: &mut impl Firmware,
    ) -> Result<SdoReply, AbortCode> {
        if segment.toggle != self.sdo_server.toggle {
            return Err(AbortCode::TOGGLE);
        }
        self.sdo_server.toggle = !segment.toggle;
        self.write_bytes(segment.bytes(), firmware)?;
        if segment.last {
            self.finish_write(now, firmware)?;
        }
        Ok(SdoReply::WrittenSegment(segment.toggle))
    }

    fn send_segment(
        &mut self,
        toggle: bool,
        firmware: &mut impl Firmware,
    ) -> Result<SdoReply, AbortCode> {
        if toggle != self.sdo_server.toggle {
            return Err(AbortCode::TOGGLE);
        }
        let (at, size) = (self.sdo_server.bytes_done, self.sdo_server.stated_size());
        let len = (size - at).min(SEGMENT as u32);
        let mut data = [0; SEGMENT];
        self.fetch_bytes(at, &mut data[..len as usize], firmware);
        self.sdo_server.bytes_done += len;
        self.sdo_server.toggle = !toggle;
        let last = self.sdo_server.bytes_done == size;
        if last {
            self.sdo_server.end();
        }
        Ok(SdoReply::ValueSegment(Segment { toggle, last, len: len as u8, data }))
    }

    fn offer_block(
        &mut self,
        object: ObjectIndex,
        checks: bool,
        segments: u8,
        threshold: u8,
        firmware: &mut impl Firmware,
    ) -> Result<SdoReply, AbortCode> {
        if !(1..=BLOCK_MAX).contains(&segments) {
            return Err(AbortCode::BLOCK_SIZE);
        }
        let entry = self.find_entry(object, firmware)?;
        self.begin_read(object, entry, firmware)?;
        let size = self.sdo_server.size;
        if threshold > 0 && size.is_some_and(|size| size <= threshold.into()) {
            // A short value takes the ordinary transfer.
            return Ok(self.read_object_slow_path(object, firmware));
        }
        self.sdo_server.state = ServerState::Offering;
        (self.sdo_server.uses_crc, self.sdo_server.segments) = (checks, segments);
        Ok(SdoReply::ReadBlockReady { object, crc: true, size })
    }

    /// The next segment of a block, as fast as the bus takes them.
    #[inline]
    pub(super) fn next_segment(&mut self, firmware: &mut impl Firmware) -> Option<[u8; 8]> {
        let SdoServer { state, bytes_done, count, segments, .. } = self.sdo_server;
        self.send_slots.set_segments(state == ServerState::Sending);
        let at = bytes_done + u32::from(count) * SEGMENT as u32;
        let size = self.sdo_server.stated_size();
        if state != ServerState::Sending || count == segments || (count > 0 && at >= size) {
            return None;
        }
        let len = (size - at).min(SEGMENT as u32);
        let mut data = [0; SEGMENT];
        self.fetch_bytes(at, &mut data[..len as usize], firmware);
        self.sdo_server.count += 1;
        let last = at + len == size;
        Some(BlockSegment { number: count + 1, last, data }.bytes())
    }

    /// Handles the receipt of `count` segments of the block; the others are sent again.
    fn handle_block_ack(
        &mut self,
        arrived: u8,
        segments: u8,
        firmware: &mut impl Firmware,
    ) -> Result<Option<SdoReply>, AbortCode> {
        if arrived > self.sdo_server.count {
            return Err(AbortCode::SEQUENCE);
        }
        if !(1..=BLOCK_MAX).contains(&segments) {
            return Err(AbortCode::BLOCK_SIZE);
        }
        let size = self.sdo_server.stated_size();
        for _ in 0..arrived {
            let len = (size - self.sdo_server.bytes_done).min(SEGMENT as u32);
            let mut data = [0; SEGMENT];
            self.fetch_bytes(self.sdo_server.bytes_done, &mut data[..len as usize], firmware);
            self.sdo_server.crc = crc(self.sdo_server.crc, &data[..len as usize]);
            self.sdo_server.bytes_done += len;
        }
        (self.sdo_server.count, self.sdo_server.segments) = (0, segments);
        if self.sdo_server.bytes_done < size || arrived == 0 {
            return Ok(None);
        }
        self.sdo_server.state = ServerState::Sent;
        let crc = if self.sdo_server.uses_crc { self.sdo_server.crc } else { 0 };
        Ok(Some(SdoReply::ReadBlockEnd { unused: unused_bytes(size), crc }))
    }

    /// Takes a segment of a block. Segments after a gap are dropped, and sent again after the block is
    /// acknowledged.
    fn receive_block_segment(&mut self, segment: BlockSegment, firmware: &mut impl Firmware) {
        let in_order = segment.number == self.sdo_server.count + 1;
        if in_order {
            if let Some(data) = self.sdo_server.held_segment.replace(segment.data)
                && let Err(abort) = self.write_bytes(&data, firmware)
            {
                let object = self.sdo_server.object;
                self.sdo_server.end();
                self.send_slots.set_sdo(SdoReply::Abort(object, abort).bytes());
                return;
            }
            self.sdo_server.count += 1;
        }
        if segment.number < self.sdo_server.segments && !segment.last {
            return;
        }
        let arrived = core::mem::take(&mut self.sdo_server.count);
        if in_order && segment.last {
            self.sdo_server.state = ServerState::Received;
        }
        let reply = SdoReply::WriteBlockAck { arrived, segments: self.sdo_server.segments };
        self.send_slots.set_sdo(reply.bytes());
    }

    fn end_block(
        &mut self,
        now: Instant,
        unused: u8,
        check: u16,
        firmware: &mut impl Firmware,
    ) -> Result<SdoReply, AbortCode> {
        let data = self.sdo_server.held_segment.take().unwrap_or_default();
        self.write_bytes(&data[..SEGMENT - usize::from(unused).min(SEGMENT)], firmware)?;
        if self.sdo_server.uses_crc && self.sdo_server.crc != check {
            return Err(AbortCode::CRC);
        }
        self.finish_write(now, firmware)?;
        Ok(SdoReply::WriteBlockDone)
    }
}

fn copy_from_offset(all: &[u8], out: &mut [u8], offset: u32) {
    let start = (offset as usize).min(all.len());
    let len = out.len().min(all.len() - start);
    out[..len].copy_from_slice(&all[start..start + len]);
}

/// Bytes of the last segment that do not count.
const fn unused_bytes(size: u32) -> u8 {
    match (size % SEGMENT as u32) as u8 {
        0 if size > 0 => 0,
        rest => SEGMENT as u8 - rest,
    }
}
