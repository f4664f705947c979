//! What a capture tells as a whole: who was there, what they did, what went wrong. Its memory is
//! bounded by how many different things there are, whatever the capture's length.
//!
//! Why: CAP-5.

mod axes;
mod json;
mod load;
mod moments;
mod show;
mod spread;

use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use crate::decoder::Event;
use crate::session::{Name, Notice, Oddity, Outcome, name};
use crate::stamp::Stamp;

pub use axes::{Axis, FaultSeen, Requests, States, Values};
pub use json::json;
pub use load::Load;
pub use moments::{Moment, Moments};
pub use show::{Manner, named, text};
pub use spread::Spread;

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
pub struct Who {
    /// The link's name.
    pub link: Name,
    /// The protocol; empty where nobody knows.
    pub protocol: Name,
    /// The axis, node or station.
    pub axis: Option<u32>,
}

/// What a link carried.
#[derive(Clone, Debug, Default)]
pub struct Link {
    /// Its frames.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Frames with a CAN identifier.
    pub can: bool,
    /// How busy it was.
    pub load: Load,
    /// Frames of each protocol; `?` for those of none.
    pub protocols: BTreeMap<Name, u64>,
}

/// Frames of one kind of one axis.
#[derive(Clone, Debug)]
pub struct Kind {
    /// Whose.
    pub who: Who,
    /// The protocol's word.
    pub kind: Name,
    /// CAN identifier, and whether it has 29 bits.
    pub id: Option<(u32, bool)>,
    /// How many.
    pub count: u64,
    /// Nanoseconds between them.
    pub gaps: Spread,
    last: Option<Stamp>,
}

/// Gaps that a kind must have to be called regular.
const REGULAR_MIN: u64 = 10;

impl Kind {
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
    pub span: Option<(Stamp, Stamp)>,
    /// All frames.
    pub frames: u64,
    /// Frames that break their protocol, stray bytes counted as one each time.
    pub wrong: u64,
    /// Links by name.
    pub links: BTreeMap<Name, Link>,
    /// Who was there.
    pub axes: BTreeMap<Who, Axis>,
    /// Frames by kind.
    kinds: HashMap<u64, Kind>,
    /// Requests by what was asked of whom.
    pub requests: BTreeMap<(Who, Name), Requests>,
    /// Values by name.
    pub values: BTreeMap<(Who, Name), Values>,
    /// Faults by code.
    pub faults: BTreeMap<(Who, u32), FaultSeen>,
    /// What was odd.
    pub moments: Moments,
    /// Notices that found no place: there were more different things than are told apart.
    pub beyond: u64,
    /// The link that the last frame came on.
    link: Name,
}

/// Where a notice was told.
#[derive(Clone, Copy)]
struct Place {
    link: Name,
    protocol: Name,
    number: u64,
    time: Option<Stamp>,
}

impl Summary {
    /// Takes a frame, and what its conversation tells.
    pub fn take(&mut self, event: &Event<'_>) {
        self.frames += 1;
        self.wrong += u64::from(event.wrong.is_some());
        if let Some(time) = event.time {
            let (first, last) = self.span.get_or_insert((time, time));
            (*first, *last) = ((*first).min(time), (*last).max(time));
        }
        if self.link != event.link {
            self.link = name(event.link);
        }
        let link = self.links.entry(self.link).or_default();
        link.frames += 1;
        link.bytes += event.bytes.len() as u64;
        link.can |= event.id.is_some();
        link.load.take(event);
        *link.protocols.entry(event.protocol.unwrap_or("?")).or_default() += 1;
        let protocol = event.protocol.unwrap_or("");
        // What stands where an address should be in a damaged serial frame is nobody.
        let damaged = event.id.is_none() && event.wrong.is_some();
        let axis = event.explained.axis.filter(|_| !damaged);
        let who = Who { link: self.link, protocol, axis };
        self.count(who, event);
        let place = Place { link: self.link, protocol, number: event.number, time: event.time };
        event.notices.iter().for_each(|notice| self.notice(notice, place));
    }

    /// Takes what conversations leave open, which is no frame.
    pub fn ending(&mut self, event: &Event<'_>) {
        let (link, protocol) = (name(event.link), event.protocol.unwrap_or(""));
        let place = Place { link, protocol, number: 0, time: None };
        event.notices.iter().for_each(|notice| self.notice(notice, place));
    }

    /// Kinds of frames, in order.
    #[must_use]
    pub fn kinds(&self) -> Vec<&Kind> {
        let mut kinds: Vec<&Kind> = self.kinds.values().collect();
        kinds.sort_by_key(|kind| (kind.who, kind.id, kind.kind));
        kinds
    }

    /// Whether nothing was odd and no fault was told.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.faults.is_empty() && self.moments.counts().len() == 0
    }

    /// From the first to the last frame, ns.
    #[must_use]
    pub fn length_ns(&self) -> u64 {
        self.span.map_or(0, |(first, last)| last.since(first))
    }

    fn count(&mut self, who: Who, event: &Event<'_>) {
        if who.axis.is_some() && (self.axes.len() < AXES_MAX || self.axes.contains_key(&who)) {
            self.axes.entry(who).or_default().frame(event);
        }
        let mut key = DefaultHasher::new();
        let direction = event.direction.map(|direction| direction as u8);
        (who.link, event.id, event.extended, direction, who.axis).hash(&mut key);
        event.explained.kind.hash(&mut key);
        let (key, full) = (key.finish(), self.kinds.len() == KINDS_MAX);
        if full && !self.kinds.contains_key(&key) {
            return;
        }
        let kind = self.kinds.entry(key).or_insert_with(|| Kind {
            who,
            kind: name(&event.explained.kind),
            id: event.id.map(|id| (id, event.extended)),
            count: 0,
            gaps: Spread::default(),
            last: None,
        });
        kind.count += 1;
        if let (Some(last), Some(time)) = (kind.last, event.time) {
            kind.gaps.take(time.since(last));
        }
        kind.last = event.time.or(kind.last);
    }

    fn notice(&mut self, notice: &Notice, place: Place) {
        let Place { link, protocol, number, time } = place;
        let who = Who { link, protocol, axis: notice.axis() };
        match notice {
            Notice::Signal(signal) => {
                let values = room(&mut self.values, (who, signal.name), VALUES_MAX);
                let Some(values) = values else { return self.beyond += 1 };
                values.take(signal);
            }
            Notice::Exchange(exchange) => {
                let requests = room(&mut self.requests, (who, exchange.op), REQUESTS_MAX);
                let Some(requests) = requests else { return self.beyond += 1 };
                requests.take(exchange, number);
            }
            Notice::Change(change) => {
                let Some(axis) = room(&mut self.axes, who, AXES_MAX) else {
                    return self.beyond += 1;
                };
                axis.change(change, time);
            }
            Notice::Fault(fault) => {
                let seen = room(&mut self.faults, (who, fault.code), FAULTS_MAX);
                let Some(seen) = seen else { return self.beyond += 1 };
                seen.take(fault, number, time);
                if !fault.gone {
                    let text = format!("fault 0x{:X}: {}", fault.code, fault.text);
                    self.odd(Oddity::Fault, who, place, text);
                }
            }
            // The fault itself is told besides.
            Notice::Odd(odd) if odd.kind == Oddity::Fault && !self.faults.is_empty() => {}
            Notice::Odd(odd) => {
                let place = Place { time: odd.time.or(time), ..place };
                self.odd(odd.kind, who, place, odd.text.clone());
            }
        }
    }

    fn odd(&mut self, kind: Oddity, who: Who, place: Place, text: String) {
        let Place { number, time, .. } = place;
        self.moments.take(Moment { kind, who, number, time, last: time, count: 1, text });
    }
}

/// The entry of a key, unless there is no room for another.
fn room<K: Ord, V: Default>(map: &mut BTreeMap<K, V>, key: K, most: usize) -> Option<&mut V> {
    let full = map.len() >= most && !map.contains_key(&key);
    (!full).then(|| map.entry(key).or_default())
}

/// All ways in which a request ends, the good one first.
const OUTCOMES: [Outcome; 6] = [
    Outcome::Done,
    Outcome::Refused,
    Outcome::Unknown,
    Outcome::Late,
    Outcome::Unanswered,
    Outcome::Broken,
];

#[cfg(test)]
mod tests;
