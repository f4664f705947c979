//! Collects frames in batches. Three kinds of frames are not explained, to save time: process data with a
//! known mapping that change no state, frames with the same bytes as an earlier one, and answers that differ from
//! an earlier answer to the same request in their numbers.
//!
//! Why: DEC-3, DEC-6.

use std::sync::Arc;

use polepair_core::explain::{Direction, Dissector, FrameBoundary, RawFrame};
use polepair_core::medium::Frame;

use super::answer_cache::AnswerKey;
use super::repeat_cache::{RepeatedFrame, can_key, serial_key};
use super::{CaptureDecoder, DecodedFrame, LinkDecoder};
use crate::batch::{ContentRef, FrameBatch, TemplateSource};
use crate::explanation::Explanation;
use crate::line_layout::LineLayout;
use crate::read::LineScan;
use crate::record::{Record, RecordData};
use crate::rules::{Rule, RuleScope};
use crate::session::{LinkSession, ObservedFrame, SessionNotice};
use crate::stream::SerialFlow;

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
        let is_taken = match (&record.data, wire) {
            (RecordData::Frame(frame), Some(at)) => {
                self.batch_process_data(at, record, frame, batch)
                    || self.batch_repeat(at, record, frame, batch)
                    || self.batch_can_answer(at, record, frame, batch)
            }
            (RecordData::Bytes(bytes), Some(at)) => match record.direction {
                Some(Direction::ToDrive) => self.batch_serial_repeat(at, record, bytes, batch),
                Some(Direction::ToHost) => self.batch_serial_answer(at, record, bytes, batch),
                None => false,
            },
            _ => false,
        };
        if is_taken {
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
        let source = TemplateSource {
            content: ContentRef::ProcessData(process),
            link: name,
            protocol: lane.dissector.name(),
            id: Some(frame.id),
            bytes: frame.bytes(),
        };
        let added = batch.push_compact(record, self.frame_count + 1, &mut lane.template, source);
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
        if !session.is_repeatable(known.route.dissector, frame) {
            return false;
        }
        self.frame_count += 1;
        let raw = super::raw_frame(frame);
        if known.is_request {
            // Its reply may need it, although the request itself changed nothing.
            conversation.push_request(&raw);
        }
        let observed = known.route.observe_raw(self.frame_count, record, raw);
        let buffers = (&mut self.explanation, &mut self.notices);
        SameFrame { known, link: name, observed }.put_into(
            record,
            session,
            buffers,
            &mut self.layout,
            batch,
        );
        true
    }

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
        if is_cut(flows) || record.time.is_none() {
            return false;
        }
        let key = serial_key(bytes);
        let Some(known) = key.and_then(|key| serial_repeats.find(&key)) else { return false };
        self.frame_count += 1;
        let raw = RawFrame { bytes, ..RawFrame::default() };
        conversation.push_request(&raw);
        let observed = known.route.observe_raw(self.frame_count, record, raw);
        let buffers = (&mut self.explanation, &mut self.notices);
        SameFrame { known, link: name, observed }.put_into(
            record,
            session,
            buffers,
            &mut self.layout,
            batch,
        );
        true
    }

    /// Returns whether a CAN frame differs from an earlier answer to the same request in its numbers alone; then its
    /// conversation takes it, and it is put into the batch.
    fn batch_can_answer(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        batch: &mut FrameBatch,
    ) -> bool {
        if frame.extended || frame.remote {
            return false;
        }
        let raw = super::raw_frame(frame);
        let dissector = self.links[at].answers.dissector_of(frame.id);
        dissector.is_some_and(|dissector| self.batch_answer(at, record, &raw, dissector, batch))
    }

    /// Does the same for the bytes of a serial line.
    fn batch_serial_answer(
        &mut self,
        at: usize,
        record: &Record<'_>,
        bytes: &[u8],
        batch: &mut FrameBatch,
    ) -> bool {
        let LinkDecoder { rules, flows, .. } = &self.links[at];
        let [Rule { dissector, scope: RuleScope::Anywhere | RuleScope::Link(_) }] = rules[..]
        else {
            return false;
        };
        let raw = RawFrame { bytes, ..RawFrame::default() };
        !is_cut(flows)
            && dissector.find_frame(bytes, record.direction, false)
                == FrameBoundary::Frame(bytes.len())
            && self.batch_answer(at, record, &raw, dissector, batch)
    }

    fn batch_answer(
        &mut self,
        at: usize,
        record: &Record<'_>,
        raw: &RawFrame<'_>,
        dissector: &'static dyn Dissector,
        batch: &mut FrameBatch,
    ) -> bool {
        let LinkDecoder { name, answers, conversation, session, .. } = &mut self.links[at];
        if record.time.is_none() || !session.keeps_explanation(dissector, raw) {
            return false;
        }
        let request = session.awaited_request(dissector, raw, record.time);
        let request = request.or_else(|| conversation.find_request(dissector, raw));
        // Bytes that repeat their request may be its echo.
        let request = request.filter(|request| raw.id.is_some() || request.bytes != raw.bytes);
        let key = request.and_then(|request| AnswerKey::new(&request, raw, record.direction));
        let Some(known) = key.and_then(|key| answers.find(&key, raw.bytes)) else { return false };
        if !self.explanation.restate_values(&known.explanation, raw.bytes) {
            return false;
        }
        if raw.id.is_none() {
            conversation.detect_echo(dissector, raw, false);
        }
        self.frame_count += 1;
        self.notices.clear();
        let observed = known.route.observe_raw(self.frame_count, record, *raw);
        session.handle_frame(&observed, &mut self.explanation, &mut self.notices);
        let is_plain = |notice: &SessionNotice| {
            matches!(notice, SessionNotice::Signal(_) | SessionNotice::Exchange(_))
        };
        let source = TemplateSource {
            content: ContentRef::Answer(&known.explanation),
            link: name,
            protocol: dissector.name(),
            id: raw.id,
            bytes: raw.bytes,
        };
        if self.notices.iter().all(is_plain)
            && batch.push_answer(
                record,
                self.frame_count,
                &mut known.template,
                source,
                &mut self.notices,
            )
        {
            return true;
        }
        self.explanation.restate_text(&known.explanation, raw.bytes);
        let content = (&self.explanation, &*self.notices);
        store_observed(&observed, record, name, content, &mut self.layout, batch);
        true
    }
}

/// A frame with the same bytes as an earlier one.
struct SameFrame<'a> {
    known: &'a mut RepeatedFrame,
    link: &'a Arc<str>,
    observed: ObservedFrame<'a>,
}

impl SameFrame<'_> {
    /// Lets the conversation take the frame, and puts it into the batch.
    fn put_into(
        self,
        record: &Record<'_>,
        session: &mut LinkSession,
        buffers: (&mut Explanation, &mut Vec<SessionNotice>),
        layout: &mut LineLayout,
        batch: &mut FrameBatch,
    ) {
        let (scratch, notices) = buffers;
        let RepeatedFrame { route, explanation, template, .. } = self.known;
        let raw = self.observed.raw;
        let keeps = session.keeps_explanation(route.dissector, &raw);
        if keeps {
            scratch.restate_values(explanation, raw.bytes);
        } else {
            scratch.copy_from(explanation);
        }
        notices.clear();
        session.handle_frame(&self.observed, scratch, notices);
        // The conversation takes every frame: whether the explanation stays the same is decided after it.
        let is_same = keeps || scratch.is_same_as(explanation);
        if is_same && notices.is_empty() {
            let source = TemplateSource {
                content: ContentRef::Constant(explanation),
                link: self.link,
                protocol: route.dissector.name(),
                id: raw.id,
                bytes: raw.bytes,
            };
            if batch.push_compact(record, self.observed.number, template, source) {
                return;
            }
        }
        let explanation = if is_same { &**explanation } else { scratch };
        store_observed(&self.observed, record, self.link, (explanation, notices), layout, batch);
    }
}

/// Puts a frame without a defect into the batch as it is.
fn store_observed(
    observed: &ObservedFrame<'_>,
    record: &Record<'_>,
    link: &str,
    content: (&Explanation, &[SessionNotice]),
    layout: &mut LineLayout,
    batch: &mut FrameBatch,
) {
    let (explanation, notices) = content;
    let event = DecodedFrame {
        number: observed.number,
        time: record.time,
        direction: record.direction,
        protocol: Some(observed.dissector.name()),
        bytes: observed.raw.bytes,
        id: observed.raw.id,
        notices,
        offset: record.offset,
        ..DecodedFrame::empty(link, explanation)
    };
    layout.include(event.time, event.link, event.protocol);
    batch.push_stored(&event);
}

/// Returns whether bytes of a serial line wait for more: then the next ones do not stand alone.
fn is_cut(flows: &[SerialFlow]) -> bool {
    flows.iter().any(|flow| !flow.pending().is_empty())
}

fn store_frame(
    event: &DecodedFrame<'_>,
    head: &mut LineLayout,
    batch: &mut FrameBatch,
    full: BatchCallback<'_>,
) {
    head.include(event.time, event.link, event.protocol);
    batch.push_stored(event);
    if batch.is_full() {
        flush_batch(*head, batch, full);
    }
}

fn flush_batch(head: LineLayout, batch: &mut FrameBatch, full: BatchCallback<'_>) {
    full(batch);
    batch.reset(head);
}
