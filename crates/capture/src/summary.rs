//! Summary of a capture: axes, activity, faults. Its memory depends on the number of different items, not
//! on the length of the capture.
//!
//! Why: CAP-5.

mod anomaly_log;
mod axes;
mod histogram;
mod indexed_map;
mod json;
mod load;
mod summary_text;

use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use crate::batch::{CompactFrame, FrameBatch, FrameRun, FrameTemplate, TemplateContent};
use crate::decoder::DecodedFrame;
use crate::session::{AnomalyKind, ExchangeOutcome, InternedName, SessionNotice, intern};
use crate::timestamp::Timestamp;

pub use anomaly_log::{AnomalyBurst, AnomalyLog};
pub use axes::{AxisSummary, FaultSummary, RequestSummary, StateHistory, ValueSummary};
pub use histogram::Histogram;
pub use indexed_map::IndexedMap;
pub use json::to_json;
pub use load::BusLoad;
pub use summary_text::{SummaryStyle, axis_label, render_text};

/// Limit of distinguished axes of a capture.
const AXES_MAX: usize = 1024;
/// Limit of distinguished kinds of frames.
const KINDS_MAX: usize = 4096;
/// Limit of distinguished operations.
const REQUESTS_MAX: usize = 1024;
/// Limit of distinguished values.
const VALUES_MAX: usize = 8192;
/// Limit of distinguished faults.
const FAULTS_MAX: usize = 512;

/// An axis of a link, in its protocol; without a number the link itself, or everybody on it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct AxisKey {
    /// The link's name.
    pub link: InternedName,
    /// Protocol; empty if unknown.
    pub protocol: InternedName,
    /// The axis, node or station.
    pub axis: Option<u32>,
}

/// Summary of a link.
#[derive(Clone, Debug, Default)]
pub struct LinkSummary {
    /// Number of its frames.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Frames with a CAN identifier.
    pub can: bool,
    /// Load of the bus.
    pub load: BusLoad,
    /// Frames of each protocol; `?` for those of none.
    pub protocols: BTreeMap<InternedName, u64>,
}

/// Frames of one kind of one axis.
#[derive(Clone, Debug)]
pub struct FrameKind {
    /// Axis.
    pub who: AxisKey,
    /// The protocol's word.
    pub kind: InternedName,
    /// CAN identifier, and whether it has 29 bits.
    pub id: Option<(u32, bool)>,
    /// Count.
    pub count: u64,
    /// Nanoseconds between them.
    pub gaps: Histogram,
    last: Option<Timestamp>,
}

/// Gaps that a kind must have to be called regular.
const REGULAR_MIN: u64 = 10;

impl FrameKind {
    /// Returns whether it comes at a steady rate: nine gaps of ten are within a quarter of the median.
    #[must_use]
    pub fn is_regular(&self) -> bool {
        let median = self.gaps.median();
        let (early, late) = (self.gaps.quantile(0.05), self.gaps.quantile(0.95));
        self.gaps.count() >= REGULAR_MIN
            && early >= median / 4 * 3
            && late <= median.saturating_add(median / 4)
    }
}

/// Summary of a whole capture.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// The first and the last time.
    pub span: Option<(Timestamp, Timestamp)>,
    /// All frames.
    pub frames: u64,
    /// Frames that break their protocol, stray bytes counted as one each time.
    pub defective: u64,
    /// Links by name.
    pub links: IndexedMap<InternedName, LinkSummary>,
    /// Axes of the capture.
    pub axes: IndexedMap<AxisKey, AxisSummary>,
    /// Frames by kind.
    kinds: Vec<FrameKind>,
    /// Numbers of kinds, by the hash of their key.
    kind_numbers: HashMap<u64, usize>,
    /// Requests by their subject and axis.
    pub requests: IndexedMap<(AxisKey, InternedName), RequestSummary>,
    /// Values by name.
    pub values: IndexedMap<(AxisKey, InternedName), ValueSummary>,
    /// Faults by code.
    pub faults: IndexedMap<(AxisKey, u32), FaultSummary>,
    /// Anomalies of the capture.
    pub anomalies: AnomalyLog,
    /// Number of notices without room: there were more different ones than are distinguished.
    pub dropped: u64,
    /// The link that the last frame came on, and its number.
    current_link: (InternedName, usize),
}

/// Frame of a notice.
#[derive(Clone, Copy)]
struct NoticeOrigin {
    link: InternedName,
    protocol: InternedName,
    number: u64,
    time: Option<Timestamp>,
}

/// Place at which a frame is counted.
#[derive(Clone, Copy, Debug)]
struct FramePlace {
    link: usize,
    axis: Option<usize>,
    kind: Option<usize>,
}

/// Place at which the frames of a template are counted.
#[derive(Debug)]
struct TemplatePlace {
    frame: FramePlace,
    link: InternedName,
    protocol: InternedName,
    on_can: bool,
    frames: u64,
    /// Index of each value of process data; `None` without room for it.
    values: Vec<Option<usize>>,
    /// Bits on the wire of frames that are all the same.
    bits: Option<u64>,
    /// Indices of the notices of answers, by their order.
    notices: Vec<NoticePlace>,
}

/// Place at which a notice is counted: a template's answers mostly have the same ones.
#[derive(Clone, Copy, Debug)]
struct NoticePlace {
    name: InternedName,
    axis: Option<u32>,
    number: usize,
}

impl TemplatePlace {
    /// The number of the notice at `at`, or the one that `find` gives, which is kept.
    fn notice_number(
        &mut self,
        at: usize,
        name: InternedName,
        axis: Option<u32>,
        find: impl FnOnce() -> Option<usize>,
    ) -> Option<usize> {
        let known = self.notices.get(at);
        if let Some(known) = known.filter(|it| core::ptr::eq(it.name, name) && it.axis == axis) {
            return Some(known.number);
        }
        let place = NoticePlace { name, axis, number: find()? };
        if at < self.notices.len() {
            self.notices[at] = place;
        } else if at == self.notices.len() {
            self.notices.push(place);
        }
        Some(place.number)
    }
}

impl Summary {
    /// Adds a frame, and the notices of its conversation.
    pub fn add_frame(&mut self, event: &DecodedFrame<'_>) {
        let place = self.place_frame(event);
        self.defective += u64::from(event.defect.is_some());
        let (protocol, link) = (event.protocol, self.links.value_mut(place.link));
        link.can |= event.id.is_some();
        *link.protocols.entry(protocol.unwrap_or("?")).or_default() += 1;
        let (bytes, bits) = (event.bytes.len(), load::frame_bits(event));
        self.count_frame(place, event.time, bytes, bits, event.id.is_some());
        let (protocol, link) = (protocol.unwrap_or(""), self.current_link.0);
        let origin = NoticeOrigin { link, protocol, number: event.number, time: event.time };
        event.notices.iter().for_each(|notice| self.add_notice(notice, origin));
    }

    /// Takes the frames of a batch, as [`add_frame`](Self::add_frame) does one by one.
    pub fn add_batch(&mut self, batch: &FrameBatch) {
        let mut places: Vec<Option<TemplatePlace>> = Vec::new();
        places.resize_with(batch.templates().len(), || None);
        for run in batch.runs() {
            match run {
                FrameRun::Compact(frames) => {
                    for frame in frames {
                        let number = usize::from(frame.template);
                        let template = &batch.templates()[number];
                        let place = &mut places[number];
                        let place =
                            place.get_or_insert_with(|| self.place_template(template, frame));
                        self.add_compact(template, frame, place);
                    }
                }
                FrameRun::Answer(answer) => {
                    let frame = &answer.frame;
                    let number = usize::from(frame.template);
                    let template = &batch.templates()[number];
                    let place =
                        places[number].get_or_insert_with(|| self.place_template(template, frame));
                    self.add_compact(template, frame, place);
                    let (protocol, link) = (place.protocol, place.link);
                    let (number, time) = (frame.number, Some(frame.time));
                    let origin = NoticeOrigin { link, protocol, number, time };
                    for (at, notice) in batch.notices(answer).iter().enumerate() {
                        self.add_answer_notice(at, notice, origin, place);
                    }
                }
                FrameRun::Stored(at) => batch.with_stored(at, |event| self.add_frame(event)),
            }
        }
        for place in places.into_iter().flatten() {
            let link = self.links.value_mut(place.frame.link);
            link.can |= place.on_can;
            *link.protocols.entry(place.protocol).or_default() += place.frames;
        }
    }

    /// Place at which the frames of a template are counted; it is the same for all of them.
    fn place_template(&mut self, template: &FrameTemplate, frame: &CompactFrame) -> TemplatePlace {
        let mut place = FramePlace { link: 0, axis: None, kind: None };
        template.expand(frame, &mut |event| place = self.place_frame(event));
        let (link, protocol) = (self.current_link.0, template.protocol);
        let mut values = Vec::new();
        if let Some(process) = template.process_data() {
            let who = AxisKey { link, protocol, axis: Some(process.axis()) };
            let mapped = process.mapping().mapped_values().iter();
            values.extend(mapped.map(|mapped| self.values.number((who, mapped.name), VALUES_MAX)));
        }
        let is_constant = matches!(template.content, TemplateContent::Constant(_));
        TemplatePlace {
            frame: place,
            link,
            protocol,
            on_can: template.id.is_some(),
            frames: 0,
            values,
            bits: is_constant.then(|| load::compact_bits(template, frame)),
            notices: Vec::new(),
        }
    }

    fn add_compact(
        &mut self,
        template: &FrameTemplate,
        frame: &CompactFrame,
        place: &mut TemplatePlace,
    ) {
        place.frames += 1;
        let bits = place.bits.unwrap_or_else(|| load::compact_bits(template, frame));
        let bytes = template.len.into();
        self.count_frame(place.frame, Some(frame.time), bytes, bits, place.on_can);
        let Some(process) = template.process_data() else { return };
        let (quality, mut at) = (process.quality(), 0);
        process.mapping().for_each_signal(frame.data, |mapped, exact, value| {
            match place.values[at] {
                Some(number) => {
                    let values = self.values.value_mut(number);
                    values.add(value, Some(exact), mapped.unit, quality);
                }
                None => self.dropped += 1,
            }
            at += 1;
        });
    }

    /// Place at which a frame is counted. Its link is the current one from now on.
    fn place_frame(&mut self, event: &DecodedFrame<'_>) -> FramePlace {
        if self.current_link.0 != event.link || self.links.is_empty() {
            let name = intern(event.link);
            self.current_link =
                (name, self.links.number(name, usize::MAX).expect("room for every link"));
        }
        let (link, number) = self.current_link;
        // The address in a damaged serial frame belongs to no axis.
        let damaged = event.id.is_none() && event.defect.is_some();
        let axis = event.explanation.axis.filter(|_| !damaged);
        let who = AxisKey { link, protocol: event.protocol_name(), axis };
        let axis = axis.and_then(|_| self.axes.number(who, AXES_MAX));
        FramePlace { link: number, axis, kind: self.kind_number(who, event) }
    }

    #[inline]
    fn count_frame(
        &mut self,
        place: FramePlace,
        time: Option<Timestamp>,
        bytes: usize,
        bits: u64,
        is_can: bool,
    ) {
        self.frames += 1;
        if let Some(time) = time {
            let (first, last) = self.span.get_or_insert((time, time));
            (*first, *last) = ((*first).min(time), (*last).max(time));
        }
        let link = self.links.value_mut(place.link);
        link.frames += 1;
        link.bytes += bytes as u64;
        link.load.add_frame(time, bits, is_can);
        if let Some(axis) = place.axis {
            self.axes.value_mut(axis).add_frame(time);
        }
        let Some(kind) = place.kind.map(|kind| &mut self.kinds[kind]) else { return };
        kind.count += 1;
        if let (Some(last), Some(time)) = (kind.last, time) {
            kind.gaps.add(time.since(last));
        }
        kind.last = time.or(kind.last);
    }

    /// Takes what conversations leave open, which is no frame.
    pub fn add_open_notices(&mut self, event: &DecodedFrame<'_>) {
        let (link, protocol) = (intern(event.link), event.protocol_name());
        let origin = NoticeOrigin { link, protocol, number: 0, time: None };
        event.notices.iter().for_each(|notice| self.add_notice(notice, origin));
    }

    /// Kinds of frames, in order.
    #[must_use]
    pub fn kinds(&self) -> Vec<&FrameKind> {
        let mut kinds: Vec<&FrameKind> = self.kinds.iter().collect();
        kinds.sort_by_key(|kind| (kind.who, kind.id, kind.kind));
        kinds
    }

    /// Returns whether there were no anomalies and no faults.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.faults.is_empty() && self.anomalies.counts().len() == 0
    }

    /// From the first to the last frame, ns.
    #[must_use]
    pub fn length_ns(&self) -> u64 {
        self.span.map_or(0, |(first, last)| last.since(first))
    }

    fn kind_number(&mut self, who: AxisKey, event: &DecodedFrame<'_>) -> Option<usize> {
        let mut key = DefaultHasher::new();
        let direction = event.direction.map(|direction| direction as u8);
        (who.link, event.id, event.extended, direction, who.axis).hash(&mut key);
        event.explanation.kind.hash(&mut key);
        let key = key.finish();
        if let Some(number) = self.kind_numbers.get(&key) {
            return Some(*number);
        }
        (self.kinds.len() < KINDS_MAX).then(|| {
            self.kinds.push(FrameKind {
                who,
                kind: intern(&event.explanation.kind),
                id: event.id.map(|id| (id, event.extended)),
                count: 0,
                gaps: Histogram::default(),
                last: None,
            });
            self.kind_numbers.insert(key, self.kinds.len() - 1);
            self.kinds.len() - 1
        })
    }

    /// Takes the notice at `at` of an answer that has a template.
    fn add_answer_notice(
        &mut self,
        at: usize,
        notice: &SessionNotice,
        origin: NoticeOrigin,
        place: &mut TemplatePlace,
    ) {
        let (axis, NoticeOrigin { link, protocol, number, .. }) = (notice.axis(), origin);
        let who = AxisKey { link, protocol, axis };
        match notice {
            SessionNotice::Signal(signal) => {
                let find = || self.values.number((who, signal.name), VALUES_MAX);
                match place.notice_number(at, signal.name, axis, find) {
                    Some(number) => {
                        let values = self.values.value_mut(number);
                        values.add(signal.value, signal.exact, signal.unit, signal.quality);
                    }
                    None => self.dropped += 1,
                }
            }
            SessionNotice::Exchange(exchange) => {
                let find = || self.requests.number((who, exchange.op), REQUESTS_MAX);
                match place.notice_number(at, exchange.op, axis, find) {
                    Some(at) => self.requests.value_mut(at).add(exchange, number),
                    None => self.dropped += 1,
                }
            }
            _ => self.add_notice(notice, origin),
        }
    }

    fn add_notice(&mut self, notice: &SessionNotice, origin: NoticeOrigin) {
        let NoticeOrigin { link, protocol, number, time } = origin;
        let who = AxisKey { link, protocol, axis: notice.axis() };
        match notice {
            SessionNotice::Signal(signal) => {
                let values = self.values.entry((who, signal.name), VALUES_MAX);
                let Some(values) = values else { return self.dropped += 1 };
                values.add(signal.value, signal.exact, signal.unit, signal.quality);
            }
            SessionNotice::Exchange(exchange) => {
                let requests = self.requests.entry((who, exchange.op), REQUESTS_MAX);
                let Some(requests) = requests else { return self.dropped += 1 };
                requests.add(exchange, number);
            }
            SessionNotice::Change(change) => {
                let Some(axis) = self.axes.entry(who, AXES_MAX) else {
                    return self.dropped += 1;
                };
                axis.add_change(change, time);
            }
            SessionNotice::Fault(fault) => {
                let seen = self.faults.entry((who, fault.code), FAULTS_MAX);
                let Some(seen) = seen else { return self.dropped += 1 };
                seen.add(fault, number, time);
                if !fault.gone {
                    let text = format!("fault 0x{:X}: {}", fault.code, fault.text);
                    self.add_anomaly(AnomalyKind::Fault, who, origin, text);
                }
            }
            // The fault itself is reported separately.
            SessionNotice::Anomaly(anomaly)
                if anomaly.kind == AnomalyKind::Fault && !self.faults.is_empty() => {}
            SessionNotice::Anomaly(anomaly) => {
                let origin = NoticeOrigin { time: anomaly.time.or(time), ..origin };
                self.add_anomaly(anomaly.kind, who, origin, anomaly.text.clone());
            }
        }
    }

    fn add_anomaly(&mut self, kind: AnomalyKind, who: AxisKey, origin: NoticeOrigin, text: String) {
        let NoticeOrigin { number, time, .. } = origin;
        self.anomalies.add(AnomalyBurst { kind, who, number, time, last: time, count: 1, text });
    }
}

/// All ways in which a request ends, the good one first.
const OUTCOMES: [ExchangeOutcome; 6] = [
    ExchangeOutcome::Done,
    ExchangeOutcome::Refused,
    ExchangeOutcome::Unknown,
    ExchangeOutcome::Late,
    ExchangeOutcome::Unanswered,
    ExchangeOutcome::BadCheck,
];

#[cfg(test)]
mod tests;
