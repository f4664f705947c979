//! Uploaded captures: a few are stored, and decoded page by page.
//!
//! Why: GW-22.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use polepair_capture::summary::{Summary, SummaryStyle, render_text};
use polepair_capture::{
    CaptureDecoder, DecodedFrame, FrameFilter, ProtocolDetector, Remark, unpack_bounded,
};

use super::Bench;
use super::frame_view::{explained_fields, frame_item};
use super::frames::parse_filter;
use super::lock::lock_unpoisoned;
use crate::message::{CapturePage, ExplainedField, FrameItem, GatewayError, OpenedCapture};

/// Captures that are kept; the oldest goes when there are more.
const CAPTURES_MAX: usize = 4;
/// Bytes of one, as it comes and unpacked.
pub const CAPTURE_MAX: usize = 64 << 20;
/// Frames whose fields are kept.
const SHOWN_MAX: usize = 4000;
/// Frames of a page.
const PAGE_MAX: usize = 1000;
/// Bytes that are explained at once.
const PIECE: usize = 4096;

/// The captures of a bench.
#[derive(Default)]
pub(super) struct Captures {
    stored: Mutex<VecDeque<Arc<Capture>>>,
    count: Mutex<u64>,
}

/// A capture.
struct Capture {
    id: String,
    bytes: Vec<u8>,
    links: Vec<String>,
    total: u64,
    /// Position behind the last page: the next page need not start at the beginning.
    cursor: Mutex<Option<Cursor>>,
    /// The fields of frames that were shown last.
    recent_fields: Mutex<VecDeque<FrameFields>>,
}

/// A frame's number and fields.
type FrameFields = (u64, Vec<ExplainedField>);

/// A capture that was explained so far.
struct Cursor {
    decoder: CaptureDecoder,
    filter: Option<(String, FrameFilter)>,
    /// Bytes that were explained; more than there are once it is at its end.
    consumed: usize,
    /// Frames that were explained and not shown yet, with those that were passed over counted.
    ready: VecDeque<(FrameItem, Vec<ExplainedField>)>,
    /// The number of the next frame.
    next: u64,
    first_ns: Option<u64>,
}

impl Bench {
    /// Opens a capture, and returns its summary and its first frames. It takes a while.
    ///
    /// # Errors
    /// `gateway.size` for one that is too long, `E510` for a text that is no capture.
    pub fn open_capture(&self, name: &str, bytes: Vec<u8>) -> Result<OpenedCapture, GatewayError> {
        // Unpacked once and for all: a page of what is packed can be larger than there is memory.
        let bytes = unpack_bounded(bytes, CAPTURE_MAX).ok_or_else(|| {
            let what = format!("a capture has at most {} MiB here, unpacked", CAPTURE_MAX >> 20);
            GatewayError::new("gateway.size", what).hint("`polepair summary` takes any length")
        })?;
        let (mut summary, mut links, mut total) = (Summary::default(), Vec::new(), 0);
        let mut decoder = detect_decoder(&bytes);
        let mut take = |event: &DecodedFrame<'_>| {
            // A list keeps the order of their first frames.
            if !links.iter().any(|link| link == event.link) {
                links.push(event.link.to_owned());
            }
            total += 1;
            summary.add_frame(event);
        };
        decoder.feed(&bytes, &mut take);
        decoder.finish(&mut take);
        decoder.finish_sessions(&mut |event| summary.add_open_notices(event));
        if let Some(file) = decoder.statistics().unsupported {
            let what = format!("this is {}. Files of this kind are not read", file.name);
            return Err(GatewayError::new("E510", what).hint(file.hint));
        }
        if decoder.statistics().records == 0 {
            return Err(GatewayError::new(
                "E510",
                "this is not a capture: nothing of it can be read",
            )
            .hint("`polepair decode --help` lists the formats"));
        }
        let remarks = Remark::of_decoder(&decoder);
        let remarks = remarks.iter().map(|remark| remark.text().to_owned()).collect();
        let format = decoder.format().map_or("", |format| format.name()).to_owned();
        let manner = SummaryStyle { colour: false, rates: Vec::new(), product: None };
        let id = self.0.captures.store(bytes, links.clone(), total);
        // Stored before the first page, which is read from the store like any other.
        let page = self.capture_page(&id, 0, PAGE_MAX, None)?;
        let summary = render_text(&summary, &manner);
        Ok(OpenedCapture { id, name: name.to_owned(), format, links, summary, remarks, page })
    }

    /// Some frames of a capture from the one of that number on: those that a filter wants.
    ///
    /// # Errors
    /// `gateway.missing` for one that is kept no more, `gateway.request` for a text that is no filter.
    pub fn capture_page(
        &self,
        id: &str,
        from: u64,
        count: usize,
        filter: Option<&str>,
    ) -> Result<CapturePage, GatewayError> {
        let capture = self.0.captures.find(id)?;
        capture.page(from, count.clamp(1, PAGE_MAX), filter)
    }

    /// The fields of a capture's frame. At once for those that were shown last, else it takes a while.
    ///
    /// # Errors
    /// `gateway.missing` for a capture that is kept no more, or a frame that it does not have.
    pub fn explain_captured(&self, id: &str, n: u64) -> Result<Vec<ExplainedField>, GatewayError> {
        self.0.captures.find(id)?.explain(n)
    }
}

fn detect_decoder(bytes: &[u8]) -> CaptureDecoder {
    let mut judge = ProtocolDetector::new();
    judge.feed(bytes);
    judge.decide().1
}

impl Captures {
    fn find(&self, id: &str) -> Result<Arc<Capture>, GatewayError> {
        let capture = lock_unpoisoned(&self.stored).iter().find(|held| held.id == id).cloned();
        capture.ok_or_else(|| {
            GatewayError::new("gateway.missing", format!("capture `{id}` is no longer stored"))
                .hint("open the file again")
        })
    }

    fn store(&self, bytes: Vec<u8>, links: Vec<String>, total: u64) -> String {
        let id = {
            let mut count = lock_unpoisoned(&self.count);
            *count += 1;
            format!("capture-{count}")
        };
        let (cursor, shown) = (Mutex::default(), Mutex::default());
        let capture = Capture { id: id.clone(), bytes, links, total, cursor, recent_fields: shown };
        let mut all = lock_unpoisoned(&self.stored);
        if all.len() == CAPTURES_MAX {
            // The oldest goes: a page that was left open asks for the file again, which is on its disk.
            all.pop_front();
        }
        all.push_back(Arc::new(capture));
        id
    }
}

impl Capture {
    fn page(
        &self,
        from: u64,
        count: usize,
        filter: Option<&str>,
    ) -> Result<CapturePage, GatewayError> {
        let filter = filter.filter(|text| !text.trim().is_empty());
        let mut cursor = lock_unpoisoned(&self.cursor);
        // Pages are read one after another: only a jump decodes the file from its beginning.
        let recorded = cursor
            .take()
            .filter(|cursor| {
                cursor.next_unread() == from
                    && cursor.filter.as_ref().map(|(text, _)| &**text) == filter
            })
            .map_or_else(|| Cursor::new(detect_decoder(&self.bytes), filter), Ok);
        let cursor = cursor.insert(recorded?);
        let mut items = Vec::new();
        while items.len() < count {
            match cursor.ready.pop_front() {
                Some((item, _)) if item.n < from => {}
                Some((item, fields)) => {
                    self.store_fields(item.n, fields);
                    items.push(item);
                }
                // One beyond the end means that the decoder was finished, and has given what it had left.
                None if cursor.consumed > self.bytes.len() => break,
                None => cursor.decode_chunk(&self.bytes, &self.links),
            }
        }
        let next = Some(cursor.next_unread()).filter(|next| *next < self.total);
        let (id, total) = (self.id.clone(), self.total);
        Ok(CapturePage { id, from, next, total, items })
    }

    fn store_fields(&self, n: u64, fields: Vec<ExplainedField>) {
        let mut shown = lock_unpoisoned(&self.recent_fields);
        if shown.len() == SHOWN_MAX {
            shown.pop_front();
        }
        shown.push_back((n, fields));
    }

    fn explain(&self, n: u64) -> Result<Vec<ExplainedField>, GatewayError> {
        if let Some((_, fields)) =
            lock_unpoisoned(&self.recent_fields).iter().find(|(shown, _)| *shown == n)
        {
            return Ok(fields.clone());
        }
        let (mut found, mut next) = (None, 0);
        let mut take = |event: &DecodedFrame<'_>| {
            found = found.take().or_else(|| (next == n).then(|| explained_fields(event)));
            next += 1;
        };
        let mut decoder = detect_decoder(&self.bytes);
        if n < self.total {
            self.bytes.chunks(PIECE).for_each(|piece| decoder.feed(piece, &mut take));
            decoder.finish(&mut take);
        }
        found.ok_or_else(|| {
            let what = format!("capture `{}` has no frame {n}", self.id);
            GatewayError::new("gateway.missing", what).hint("frames count from 0")
        })
    }
}

impl Cursor {
    fn new(decoder: CaptureDecoder, filter: Option<&str>) -> Result<Self, GatewayError> {
        let filter = filter.map(read_filter).transpose()?;
        Ok(Self { decoder, filter, consumed: 0, ready: VecDeque::new(), next: 0, first_ns: None })
    }

    /// The number of the first frame that no page looked at.
    fn next_unread(&self) -> u64 {
        self.ready.front().map_or(self.next, |(item, _)| item.n)
    }

    /// Explains a piece more.
    fn decode_chunk(&mut self, bytes: &[u8], links: &[String]) {
        let Self { decoder, filter, consumed, ready, next, first_ns } = self;
        let mut take = |event: &DecodedFrame<'_>| {
            let n = *next;
            *next += 1;
            let ns = event.time.map(|time| time.0);
            // Before the filter, so that times do not depend on what is shown.
            *first_ns = first_ns.or(ns);
            if !filter.as_mut().is_none_or(|(_, filter)| filter.matches(event)) {
                return;
            }
            let link = links.iter().position(|link| link == event.link).unwrap_or(0) as u16;
            let since = ns.zip(*first_ns).map_or(0, |(ns, first)| ns.saturating_sub(first));
            let t_us = since as f64 / 1e3;
            ready.push_back((
                FrameItem { t_us, ..frame_item(n, link, event) },
                explained_fields(event),
            ));
        };
        if *consumed >= bytes.len() {
            decoder.finish(&mut take);
            *consumed = bytes.len() + 1;
            return;
        }
        let end = (*consumed + PIECE).min(bytes.len());
        decoder.feed(&bytes[*consumed..end], &mut take);
        *consumed = end;
    }
}

fn read_filter(text: &str) -> Result<(String, FrameFilter), GatewayError> {
    parse_filter(text).map(|filter| (text.to_owned(), filter))
}
