//! Collects frames in batches. Two kinds of frames are not explained, to save time: process data with a
//! known mapping that change no state, and frames with the same bytes as an earlier one.
//!
//! Why: DEC-3, DEC-6.

use polepair_core::explain::{Direction, RawFrame};
use polepair_core::medium::Frame;

use super::repeat_cache::{can_key, serial_key};
use super::{CaptureDecoder, DecodedFrame, LinkDecoder};
use crate::batch::{ContentRef, FrameBatch};
use crate::read::LineScan;
use crate::record::{Record, RecordData};

/// Takes a full batch; the decoder then reuses it for the next frames.
type BatchCallback<'a> = &'a mut dyn FnMut(&mut FrameBatch);

impl CaptureDecoder {
    /// Takes a piece of the capture, cut anywhere. Its frames are put into `batch`, which `full` is
    /// given as often as it has as many as it should.
    pub fn decode_batch(&mut self, piece: &[u8], batch: &mut FrameBatch, full: BatchCallback<'_>) {
        batch.begin_chunk(self.layout);
        let mut reader = core::mem::take(&mut self.reader);
        reader.feed(piece, &mut |record| {
            self.batch_record(record, self.known_link(record), batch, full)
        });
        self.reader = reader;
    }

    /// Decodes a piece that begins at a line, and was scanned.
    pub fn decode_scanned(
        &mut self,
        piece: &[u8],
        scan: &LineScan,
        batch: &mut FrameBatch,
        full: BatchCallback<'_>,
    ) {
        if scan.lines().is_empty() || !self.reader.skip_lines(0, 0) {
            return self.decode_batch(piece, batch, full);
        }
        batch.begin_chunk(self.layout);
        let mut reader = core::mem::take(&mut self.reader);
        debug_assert!(scan.lines().windows(2).all(|pair| pair[0].end <= pair[1].start));
        let before = reader.received_bytes();
        // Lines do not depend on the lines before: the reader gets their number later.
        let (mut from, mut at, mut lines) = (0, 0, 0);
        // Whether lines of serial lines are taken as they are, once that was asked.
        let mut takes_serial = None;
        // Where each link of the piece is, once it is known.
        let mut wires = [None; LineScan::LINKS_MAX];
        for line in scan.lines() {
            if batch.is_stopped() {
                break;
            }
            if line.start > at {
                reader.skip_lines(lines, (at - from) as u64);
                let between = &piece[at..line.start];
                reader.feed(between, &mut |record| {
                    self.batch_record(record, self.known_link(record), batch, full);
                });
                (from, at, lines, takes_serial) = (line.start, line.start, 0, None);
            }
            if line.is_serial() && !*takes_serial.get_or_insert_with(|| reader.begin_serial_lines())
            {
                // The reader gets it with the lines that follow.
                continue;
            }
            let (record, wire) =
                (scan.line_record(line, before), &mut wires[usize::from(line.link)]);
            *wire = wire.or_else(|| self.known_link(&record));
            self.batch_record(&record, *wire, batch, full);
            (at, lines) = (line.end, lines + 1);
        }
        reader.skip_lines(lines, (at - from) as u64);
        reader.feed(&piece[at..], &mut |record| {
            self.batch_record(record, self.known_link(record), batch, full)
        });
        self.reader = reader;
    }

    /// Ends the capture: what waits for more is put into `batch` as it is.
    pub fn finish_batch(&mut self, batch: &mut FrameBatch, full: BatchCallback<'_>) {
        batch.begin_chunk(self.layout);
        let mut head = self.layout;
        self.finish(&mut |event| store_frame(event, &mut head, batch, full));
        self.layout = head;
    }

    /// Index of a record's link, if an earlier record was of that link.
    #[inline]
    fn known_link(&self, record: &Record<'_>) -> Option<usize> {
        let is_link = |wire: &LinkDecoder| *wire.name == *record.link;
        // Most frames are of the link of the frame before.
        match self.links.get(self.last_link) {
            Some(last) if is_link(last) => Some(self.last_link),
            _ => self.links.iter().position(is_link),
        }
    }

    /// Takes a record of that link, if one of it came before.
    #[inline]
    fn batch_record(
        &mut self,
        record: &Record<'_>,
        wire: Option<usize>,
        batch: &mut FrameBatch,
        full: BatchCallback<'_>,
    ) {
        if batch.is_stopped() {
            return;
        }
        let wire = wire.or_else(|| self.link_index(record.link));
        let (undirected, mut record) = (&mut None, record);
        if let Some(at) = wire {
            self.last_link = at;
            self.check_time(at, record);
            if !self.trusts_direction(at, record) {
                record = undirected.insert(Record { direction: None, ..*record });
            }
        }
        if let RecordData::Frame(frame) = &record.data
            && let Some(at) = wire
            && (self.batch_process_data(at, record, frame, batch)
                || self.batch_repeat(at, record, frame, batch))
        {
            if batch.is_full() {
                flush_batch(self.layout, batch, full);
            }
            return;
        }
        if let RecordData::Bytes(bytes) = record.data
            && let Some(at) = wire
            && self.batch_serial_repeat(at, record, bytes, batch)
        {
            if batch.is_full() {
                flush_batch(self.layout, batch, full);
            }
            return;
        }
        let mut head = self.layout;
        self.decode_record(record, &mut |event| store_frame(event, &mut head, batch, full));
        self.layout = head;
    }

    /// Returns whether a frame changes nothing; then it is put into the batch.
    #[inline]
    fn batch_process_data(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        batch: &mut FrameBatch,
    ) -> bool {
        let Some(now) = record.time.filter(|_| self.tracks_sessions) else { return false };
        let LinkDecoder { name, routes, session, .. } = &mut self.links[at];
        let Some(lane) = routes.deferred_mut(frame) else { return false };
        let Some(process) = session.unchanged_process_data(frame, now) else { return false };
        let whose = (ContentRef::ProcessData(process), &*name, lane.dissector.name());
        let added =
            batch.push_compact(record, self.frame_count + 1, frame, &mut lane.template, whose);
        // A frame that does not fit the batch is decoded, and counted, on the slow path.
        self.frame_count += u64::from(added);
        added
    }

    /// Returns whether a frame repeats the content of an earlier one; then its conversation takes it, and it is put
    /// into the batch.
    fn batch_repeat(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        batch: &mut FrameBatch,
    ) -> bool {
        let LinkDecoder { name, repeats, conversation, session, .. } = &mut self.links[at];
        let key = can_key(frame, record.direction);
        let Some(known) = key.and_then(|key| repeats.find(&key)) else { return false };
        let protocol = known.route.dissector.name();
        if !session.is_repeatable(known.route.dissector, frame) {
            return false;
        }
        self.frame_count += 1;
        self.explanation.copy_from(&known.explanation);
        self.notices.clear();
        if known.is_request {
            // Its reply may need it, although the request itself changed nothing.
            conversation.push_request(&super::raw_frame(frame));
        }
        let observed = known.route.observe(self.frame_count, record, frame, None);
        // The conversation takes every frame: whether the explanation stays the same is decided after it.
        session.handle_frame(&observed, &mut self.explanation, &mut self.notices);
        if self.notices.is_empty() && self.explanation.is_same_as(&known.explanation) {
            let whose = (ContentRef::Constant(&known.explanation), &*name, protocol);
            if batch.push_compact(record, self.frame_count, frame, &mut known.template, whose) {
                return true;
            }
        }
        let statement = (&self.explanation, &*self.notices);
        let event = DecodedFrame::from_frame(
            record,
            self.frame_count,
            frame,
            name,
            Some(protocol),
            statement,
        );
        self.layout.include(event.time, event.link, event.protocol);
        batch.push_stored(&event);
        true
    }
}

impl CaptureDecoder {
    /// Returns whether the bytes of a serial line are a request that came before in the same bytes; then its
    /// conversation takes it, and it is put into the batch.
    fn batch_serial_repeat(
        &mut self,
        at: usize,
        record: &Record<'_>,
        bytes: &[u8],
        batch: &mut FrameBatch,
    ) -> bool {
        let LinkDecoder { name, flows, serial_repeats, conversation, session, .. } =
            &mut self.links[at];
        // Bytes that wait for more, and a record without a time, end frames elsewhere.
        let is_cut = flows.iter().any(|flow| !flow.pending().is_empty());
        if is_cut || record.time.is_none() || record.direction != Some(Direction::ToDrive) {
            return false;
        }
        let key = serial_key(bytes);
        let Some(known) = key.and_then(|key| serial_repeats.find(&key)) else { return false };
        let protocol = known.route.dissector.name();
        self.frame_count += 1;
        self.explanation.copy_from(&known.explanation);
        self.notices.clear();
        let raw = RawFrame { bytes, ..RawFrame::default() };
        conversation.push_request(&raw);
        let observed = known.route.observe_raw(self.frame_count, record, raw);
        session.handle_frame(&observed, &mut self.explanation, &mut self.notices);
        if self.notices.is_empty() && self.explanation.is_same_as(&known.explanation) {
            let whose = (&known.explanation, &*name, protocol);
            if batch.push_serial(record, self.frame_count, bytes, &mut known.template, whose) {
                return true;
            }
        }
        let event = DecodedFrame {
            number: self.frame_count,
            time: record.time,
            direction: record.direction,
            protocol: Some(protocol),
            bytes,
            notices: &self.notices,
            offset: record.offset,
            ..DecodedFrame::empty(name, &self.explanation)
        };
        self.layout.include(event.time, event.link, event.protocol);
        batch.push_stored(&event);
        true
    }
}

fn store_frame(
    event: &DecodedFrame<'_>,
    head: &mut crate::line_layout::LineLayout,
    batch: &mut FrameBatch,
    full: BatchCallback<'_>,
) {
    head.include(event.time, event.link, event.protocol);
    batch.push_stored(event);
    if batch.is_full() {
        flush_batch(*head, batch, full);
    }
}

fn flush_batch(
    head: crate::line_layout::LineLayout,
    batch: &mut FrameBatch,
    full: BatchCallback<'_>,
) {
    full(batch);
    batch.reset(head);
}
