//! Summary of a capture: axes, activity, faults. Its memory depends on the number of different items, not
//! on the length of the capture.
//!
//! Why: CAP-5.

mod anomaly_log;
mod axes;
mod histogram;
mod json;
mod load;
mod summary_text;

use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use crate::decoder::DecodedFrame;
use crate::session::{AnomalyKind, ExchangeOutcome, InternedName, SessionNotice, intern};
use crate::timestamp::Timestamp;

pub use anomaly_log::{AnomalyBurst, AnomalyLog};
pub use axes::{AxisSummary, FaultSummary, RequestSummary, StateHistory, ValueSummary};
pub use histogram::Histogram;
pub use json::to_json;
pub use load::BusLoad;
pub use summary_text::{SummaryStyle, axis_label, render_text};

/// Axes of a capture that are told apart.
const AXES_MAX: usize = 1024;
/// Kinds of frames that are told apart.
const KINDS_MAX: usize = 4096;
/// Operations that are told apart.
const REQUESTS_MAX: usize = 1024;
/// Values that are told apart.
const VALUES_MAX: usize = 8192;
/// Faults that are told apart.
const FAULTS_MAX: usize = 512;

/// An axis of a link, in its protocol; without a number the link itself, or everybody on it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct AxisKey {
    /// The link's name.
    pub link: InternedName,
    /// The protocol; empty where nobody knows.
    pub protocol: InternedName,
    /// The axis, node or station.
    pub axis: Option<u32>,
}

/// What a link carried.
#[derive(Clone, Debug, Default)]
pub struct LinkSummary {
    /// Its frames.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Frames with a CAN identifier.
    pub can: bool,
    /// How busy it was.
    pub load: BusLoad,
    /// Frames of each protocol; `?` for those of none.
    pub protocols: BTreeMap<InternedName, u64>,
}

/// Frames of one kind of one axis.
#[derive(Clone, Debug)]
pub struct FrameKind {
    /// Whose.
    pub who: AxisKey,
    /// The protocol's word.
    pub kind: InternedName,
    /// CAN identifier, and whether it has 29 bits.
    pub id: Option<(u32, bool)>,
    /// How many.
    pub count: u64,
    /// Nanoseconds between them.
    pub gaps: Histogram,
    last: Option<Timestamp>,
}

/// Gaps that a kind must have to be called regular.
const REGULAR_MIN: u64 = 10;

impl FrameKind {
    /// Whether it comes at a steady rate: nine gaps of ten are within a quarter of the median.
    #[must_use]
    pub fn is_regular(&self) -> bool {
        let median = self.gaps.median();
        let (early, late) = (self.gaps.quantile(0.05), self.gaps.quantile(0.95));
        self.gaps.count() >= REGULAR_MIN
            && early >= median / 4 * 3
            && late <= median.saturating_add(median / 4)
    }
}

/// What a capture tells as a whole.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// The first and the last time.
    pub span: Option<(Timestamp, Timestamp)>,
    /// All frames.
    pub frames: u64,
    /// Frames that break their protocol, stray bytes counted as one each time.
    pub defective: u64,
    /// Links by name.
    pub links: BTreeMap<InternedName, LinkSummary>,
    /// Who was there.
    pub axes: BTreeMap<AxisKey, AxisSummary>,
    /// Frames by kind.
    kinds: HashMap<u64, FrameKind>,
    /// Requests by what was asked of whom.
    pub requests: BTreeMap<(AxisKey, InternedName), RequestSummary>,
    /// Values by name.
    pub values: BTreeMap<(AxisKey, InternedName), ValueSummary>,
    /// Faults by code.
    pub faults: BTreeMap<(AxisKey, u32), FaultSummary>,
    /// What was odd.
    pub anomalies: AnomalyLog,
    /// Notices that found no place: there were more different things than are told apart.
    pub dropped: u64,
    /// The link that the last frame came on.
    current_link: InternedName,
}

/// Where a notice was told.
#[derive(Clone, Copy)]
struct NoticeOrigin {
    link: InternedName,
    protocol: InternedName,
    number: u64,
    time: Option<Timestamp>,
}

impl Summary {
    /// Takes a frame, and what its conversation tells.
    pub fn add_frame(&mut self, event: &DecodedFrame<'_>) {
        self.frames += 1;
        self.defective += u64::from(event.defect.is_some());
        if let Some(time) = event.time {
            let (first, last) = self.span.get_or_insert((time, time));
            (*first, *last) = ((*first).min(time), (*last).max(time));
        }
        if self.current_link != event.link {
            self.current_link = intern(event.link);
        }
        let link = self.links.entry(self.current_link).or_default();
        link.frames += 1;
        link.bytes += event.bytes.len() as u64;
        link.can |= event.id.is_some();
        link.load.add_frame(event);
        *link.protocols.entry(event.protocol.unwrap_or("?")).or_default() += 1;
        let protocol = event.protocol.unwrap_or("");
        // What stands where an address should be in a damaged serial frame is nobody.
        let damaged = event.id.is_none() && event.defect.is_some();
        let axis = event.explanation.axis.filter(|_| !damaged);
        let who = AxisKey { link: self.current_link, protocol, axis };
        self.count_frame(who, event);
        let origin = NoticeOrigin {
            link: self.current_link,
            protocol,
            number: event.number,
            time: event.time,
        };
        event.notices.iter().for_each(|notice| self.add_notice(notice, origin));
    }

    /// Takes what conversations leave open, which is no frame.
    pub fn add_open_notices(&mut self, event: &DecodedFrame<'_>) {
        let (link, protocol) = (intern(event.link), event.protocol.unwrap_or(""));
        let origin = NoticeOrigin { link, protocol, number: 0, time: None };
        event.notices.iter().for_each(|notice| self.add_notice(notice, origin));
    }

    /// Kinds of frames, in order.
    #[must_use]
    pub fn kinds(&self) -> Vec<&FrameKind> {
        let mut kinds: Vec<&FrameKind> = self.kinds.values().collect();
        kinds.sort_by_key(|kind| (kind.who, kind.id, kind.kind));
        kinds
    }

    /// Whether nothing was odd and no fault was told.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.faults.is_empty() && self.anomalies.counts().len() == 0
    }

    /// From the first to the last frame, ns.
    #[must_use]
    pub fn length_ns(&self) -> u64 {
        self.span.map_or(0, |(first, last)| last.since(first))
    }

    fn count_frame(&mut self, who: AxisKey, event: &DecodedFrame<'_>) {
        if who.axis.is_some() && (self.axes.len() < AXES_MAX || self.axes.contains_key(&who)) {
            self.axes.entry(who).or_default().add_frame(event);
        }
        let mut key = DefaultHasher::new();
        let direction = event.direction.map(|direction| direction as u8);
        (who.link, event.id, event.extended, direction, who.axis).hash(&mut key);
        event.explanation.kind.hash(&mut key);
        let (key, full) = (key.finish(), self.kinds.len() == KINDS_MAX);
        if full && !self.kinds.contains_key(&key) {
            return;
        }
        let kind = self.kinds.entry(key).or_insert_with(|| FrameKind {
            who,
            kind: intern(&event.explanation.kind),
            id: event.id.map(|id| (id, event.extended)),
            count: 0,
            gaps: Histogram::default(),
            last: None,
        });
        kind.count += 1;
        if let (Some(last), Some(time)) = (kind.last, event.time) {
            kind.gaps.add(time.since(last));
        }
        kind.last = event.time.or(kind.last);
    }

    fn add_notice(&mut self, notice: &SessionNotice, origin: NoticeOrigin) {
        let NoticeOrigin { link, protocol, number, time } = origin;
        let who = AxisKey { link, protocol, axis: notice.axis() };
        match notice {
            SessionNotice::Signal(signal) => {
                let values = bounded_entry(&mut self.values, (who, signal.name), VALUES_MAX);
                let Some(values) = values else { return self.dropped += 1 };
                values.add(signal);
            }
            SessionNotice::Exchange(exchange) => {
                let requests = bounded_entry(&mut self.requests, (who, exchange.op), REQUESTS_MAX);
                let Some(requests) = requests else { return self.dropped += 1 };
                requests.add(exchange, number);
            }
            SessionNotice::Change(change) => {
                let Some(axis) = bounded_entry(&mut self.axes, who, AXES_MAX) else {
                    return self.dropped += 1;
                };
                axis.add_change(change, time);
            }
            SessionNotice::Fault(fault) => {
                let seen = bounded_entry(&mut self.faults, (who, fault.code), FAULTS_MAX);
                let Some(seen) = seen else { return self.dropped += 1 };
                seen.add(fault, number, time);
                if !fault.gone {
                    let text = format!("fault 0x{:X}: {}", fault.code, fault.text);
                    self.add_anomaly(AnomalyKind::Fault, who, origin, text);
                }
            }
            // The fault itself is told besides.
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

/// The entry of a key, unless there is no room for another.
fn bounded_entry<K: Ord, V: Default>(
    map: &mut BTreeMap<K, V>,
    key: K,
    max: usize,
) -> Option<&mut V> {
    let full = map.len() >= max && !map.contains_key(&key);
    (!full).then(|| map.entry(key).or_default())
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
