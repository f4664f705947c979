//! Captures that somebody opened: kept as they came, a few of them, and explained page by page.
//!
//! Why: GW-22.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use polepair_capture::summary::{Manner, Summary, text};
use polepair_capture::{Decoder, Event, Filter, Judge, unpacked};

use super::Bench;
use super::explained::{fields, item};
use super::frames::parsed;
use super::shared::held;
use crate::message::{CaptureOpened, CapturePage, ExplainedField, FrameItem, Refused};

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
    held: Mutex<VecDeque<Arc<Capture>>>,
    count: Mutex<u64>,
}

/// A capture.
struct Capture {
    id: String,
    bytes: Vec<u8>,
    links: Vec<String>,
    total: u64,
    /// Where the last page ended: who reads on need not begin anew.
    cursor: Mutex<Option<Cursor>>,
    /// The fields of frames that were shown last.
    shown: Mutex<VecDeque<Fields>>,
}

/// A frame's number and fields.
type Fields = (u64, Vec<ExplainedField>);

/// A capture that was explained so far.
struct Cursor {
    decoder: Decoder,
    filter: Option<(String, Filter)>,
    /// Bytes that were explained; more than there are once it is at its end.
    fed: usize,
    /// Frames that were explained and not shown yet, with those that were passed over counted.
    ready: VecDeque<(FrameItem, Vec<ExplainedField>)>,
    /// The number of the next frame.
    next: u64,
    first_ns: Option<u64>,
}

impl Bench {
    /// Takes a capture in, tells what it holds, and shows its first frames. It takes a while.
    ///
    /// # Errors
    /// `gateway.size` for one that is too long, `E510` for what is no capture.
    pub fn open_capture(&self, name: &str, bytes: Vec<u8>) -> Result<CaptureOpened, Refused> {
        // Unpacked once and for all: a page of what is packed can be larger than there is memory.
        let bytes = unpacked(bytes, CAPTURE_MAX).ok_or_else(|| {
            let what = format!("a capture has at most {} MiB here, unpacked", CAPTURE_MAX >> 20);
            Refused::new("gateway.size", what).hint("`polepair summary` takes any length")
        })?;
        let (mut summary, mut links, mut total) = (Summary::default(), Vec::new(), 0);
        let mut decoder = judged(&bytes);
        let mut take = |event: &Event<'_>| {
            if !links.iter().any(|link| link == event.link) {
                links.push(event.link.to_owned());
            }
            total += 1;
            summary.take(event);
        };
        decoder.feed(&bytes, &mut take);
        decoder.finish(&mut take);
        decoder.ending(&mut |event| summary.ending(event));
        if decoder.tally().records == 0 {
            return Err(Refused::new("E510", "this is not a capture: nothing of it can be read")
                .hint("`polepair decode --help` shows what is read"));
        }
        let format = decoder.format().map_or("", |format| format.name()).to_owned();
        let manner = Manner { colour: false, rates: Vec::new(), product: None };
        let id = self.0.captures.keep(bytes, links.clone(), total);
        let page = self.capture_page(&id, 0, PAGE_MAX, None)?;
        let summary = text(&summary, &manner);
        Ok(CaptureOpened { id, name: name.to_owned(), format, links, summary, page })
    }

    /// Some frames of a capture from the one of that number on: those that a filter wants.
    ///
    /// # Errors
    /// `gateway.missing` for one that is kept no more, `gateway.request` for what is no filter.
    pub fn capture_page(
        &self,
        id: &str,
        from: u64,
        count: usize,
        filter: Option<&str>,
    ) -> Result<CapturePage, Refused> {
        let capture = self.0.captures.find(id)?;
        capture.page(from, count.clamp(1, PAGE_MAX), filter)
    }

    /// The fields of a capture's frame. At once for those that were shown last, else it takes a while.
    ///
    /// # Errors
    /// `gateway.missing` for a capture that is kept no more, or a frame that it does not have.
    pub fn explain_captured(&self, id: &str, n: u64) -> Result<Vec<ExplainedField>, Refused> {
        self.0.captures.find(id)?.explain(n)
    }
}

fn judged(bytes: &[u8]) -> Decoder {
    let mut judge = Judge::new();
    judge.feed(bytes);
    judge.decide().1
}

impl Captures {
    fn find(&self, id: &str) -> Result<Arc<Capture>, Refused> {
        let capture = held(&self.held).iter().find(|held| held.id == id).cloned();
        capture.ok_or_else(|| {
            Refused::new("gateway.missing", format!("capture `{id}` is kept no more"))
                .hint("open the file again")
        })
    }

    fn keep(&self, bytes: Vec<u8>, links: Vec<String>, total: u64) -> String {
        let id = {
            let mut count = held(&self.count);
            *count += 1;
            format!("capture-{count}")
        };
        let (cursor, shown) = (Mutex::default(), Mutex::default());
        let capture = Capture { id: id.clone(), bytes, links, total, cursor, shown };
        let mut all = held(&self.held);
        if all.len() == CAPTURES_MAX {
            all.pop_front();
        }
        all.push_back(Arc::new(capture));
        id
    }
}

impl Capture {
    fn page(&self, from: u64, count: usize, filter: Option<&str>) -> Result<CapturePage, Refused> {
        let filter = filter.filter(|text| !text.trim().is_empty());
        let mut cursor = held(&self.cursor);
        let goes_on = |cursor: &Cursor| {
            cursor.shown_to() == from && cursor.filter.as_ref().map(|(text, _)| &**text) == filter
        };
        let kept = cursor
            .take()
            .filter(goes_on)
            .map_or_else(|| Cursor::new(judged(&self.bytes), filter), Ok);
        let cursor = cursor.insert(kept?);
        let mut items = Vec::new();
        while items.len() < count {
            match cursor.ready.pop_front() {
                Some((item, _)) if item.n < from => {}
                Some((item, fields)) => {
                    self.keep(item.n, fields);
                    items.push(item);
                }
                None if cursor.fed > self.bytes.len() => break,
                None => cursor.go_on(&self.bytes, &self.links),
            }
        }
        let next = Some(cursor.shown_to()).filter(|next| *next < self.total);
        let (id, total) = (self.id.clone(), self.total);
        Ok(CapturePage { id, from, next, total, items })
    }

    fn keep(&self, n: u64, fields: Vec<ExplainedField>) {
        let mut shown = held(&self.shown);
        if shown.len() == SHOWN_MAX {
            shown.pop_front();
        }
        shown.push_back((n, fields));
    }

    fn explain(&self, n: u64) -> Result<Vec<ExplainedField>, Refused> {
        if let Some((_, fields)) = held(&self.shown).iter().find(|(shown, _)| *shown == n) {
            return Ok(fields.clone());
        }
        let (mut found, mut next) = (None, 0);
        let mut take = |event: &Event<'_>| {
            found = found.take().or_else(|| (next == n).then(|| fields(event)));
            next += 1;
        };
        let mut decoder = judged(&self.bytes);
        if n < self.total {
            self.bytes.chunks(PIECE).for_each(|piece| decoder.feed(piece, &mut take));
            decoder.finish(&mut take);
        }
        found.ok_or_else(|| {
            let what = format!("capture `{}` has no frame {n}", self.id);
            Refused::new("gateway.missing", what).hint("frames count from 0")
        })
    }
}

impl Cursor {
    fn new(decoder: Decoder, filter: Option<&str>) -> Result<Self, Refused> {
        let read = |text: &str| parsed(text).map(|filter| (text.to_owned(), filter));
        let filter = filter.map(read).transpose()?;
        Ok(Self { decoder, filter, fed: 0, ready: VecDeque::new(), next: 0, first_ns: None })
    }

    /// The number of the first frame that no page looked at.
    fn shown_to(&self) -> u64 {
        self.ready.front().map_or(self.next, |(item, _)| item.n)
    }

    /// Explains a piece more.
    fn go_on(&mut self, bytes: &[u8], links: &[String]) {
        let Self { decoder, filter, fed, ready, next, first_ns } = self;
        let mut take = |event: &Event<'_>| {
            let n = *next;
            *next += 1;
            let ns = event.time.map(|time| time.0);
            *first_ns = first_ns.or(ns);
            if !filter.as_mut().is_none_or(|(_, filter)| filter.wants(event)) {
                return;
            }
            let link = links.iter().position(|link| link == event.link).unwrap_or(0) as u16;
            let since = ns.zip(*first_ns).map_or(0, |(ns, first)| ns.saturating_sub(first));
            let t_us = since as f64 / 1e3;
            ready.push_back((FrameItem { t_us, ..item(n, link, event) }, fields(event)));
        };
        if *fed >= bytes.len() {
            decoder.finish(&mut take);
            *fed = bytes.len() + 1;
            return;
        }
        let end = (*fed + PIECE).min(bytes.len());
        decoder.feed(&bytes[*fed..end], &mut take);
        *fed = end;
    }
}
