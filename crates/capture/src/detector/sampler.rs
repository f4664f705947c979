//! Selects the records that the detector reads: a sample of a long capture.

use std::collections::HashMap;

use polepair_core::medium::Frame;

use crate::record::{Record, RecordData};

/// Records of a link that are weighed one by one at most, where nothing is certain.
const FULL_RECORDS: u64 = 20_000;
/// Records in a row that are weighed later on, so that frames in them are whole …
const BLOCK_RECORDS: u64 = 256;
/// … and of how many blocks one is.
const BLOCK_PERIOD: u64 = 64;
/// Frames of a CAN identifier that are weighed wherever they come.
const FRAMES_PER_ID: u8 = 64;
/// Records after which the result is first looked at, and after each new identifier or link. It is
/// looked at again each time that twice as many have come.
const WINDOW_RECORDS: u64 = 256;
/// Identifiers that are counted one by one.
const IDS_MAX: usize = 4096;
/// Links that are counted one by one.
const LINKS_MAX: usize = 256;

/// Chooses records.
#[derive(Debug)]
pub(super) struct RecordSampler {
    links: Vec<SampledLink>,
    /// Records of all links.
    records: u64,
    /// The records in which something new came.
    window: Window,
    /// True if the result was certain so far.
    certain: bool,
}

/// Records since the first of some new identifiers or links.
#[derive(Debug)]
struct Window {
    start: u64,
    len: u64,
    /// The record with the last new one.
    last_new: u64,
}

#[derive(Debug, Default)]
struct SampledLink {
    name: String,
    records: u64,
    skipped: u64,
    ids: HashMap<u32, u8>,
}

/// The top bit is free in both kinds of identifier.
const fn id_key(id: u32, extended: bool) -> u32 {
    id | (extended as u32) << 31
}

impl Default for RecordSampler {
    fn default() -> Self {
        let window = Window { start: 0, len: WINDOW_RECORDS, last_new: 0 };
        Self { links: Vec::new(), records: 0, window, certain: false }
    }
}

impl RecordSampler {
    /// Returns whether a record is weighed.
    pub fn select(&mut self, record: &Record<'_>) -> bool {
        self.records += 1;
        let at = self.links.iter().position(|link| link.name == record.link);
        let at = match at {
            Some(at) => at,
            None if self.links.len() == LINKS_MAX => return false,
            None => {
                self.note_new();
                let link = SampledLink { name: record.link.to_owned(), ..SampledLink::default() };
                self.links.push(link);
                self.links.len() - 1
            }
        };
        let link = &mut self.links[at];
        let frames_before = match &record.data {
            RecordData::Frame(frame) => link.count_frame(id_key(frame.id, frame.extended)),
            _ => None,
        };
        if frames_before == Some(0) {
            self.note_new();
        }
        // The first frames of each identifier are always weighed, however late they come.
        let fresh = frames_before.is_some_and(|count| count < FRAMES_PER_ID);
        let accepted = self.links[at].select(fresh, self.certain);
        self.links[at].skipped += u64::from(!accepted);
        accepted
    }

    /// An identifier or a link comes for the first time.
    fn note_new(&mut self) {
        self.window.last_new = self.records;
        // Something new reopens the question.
        if self.certain {
            self.certain = false;
            self.window.start = self.records;
            self.window.len = WINDOW_RECORDS;
        }
    }

    /// Returns whether the result is due: after records without anything new. [`end_window`](Self::end_window) gets its
    /// outcome.
    pub fn is_checkpoint(&mut self) -> bool {
        let Window { start, len, last_new } = self.window;
        if self.certain || self.records < start + len {
            return false;
        }
        let settled = last_new <= start + len / 2;
        if !settled {
            self.window.len *= 2;
        }
        settled
    }

    /// Ends the records after which the result was looked at.
    pub const fn end_window(&mut self, certain: bool) {
        self.certain = certain;
        self.window.len *= 2;
    }

    /// Returns whether the result was certain for all that came so far.
    pub const fn is_certain(&self) -> bool {
        self.certain
    }

    /// True when records of a link were left out.
    pub fn has_skipped(&self, name: &str) -> bool {
        self.link(name).is_some_and(|link| link.skipped > 0)
    }

    /// Returns whether a link came, and the identifier on it.
    pub fn has_seen(&self, name: &str, frame: Option<&Frame>) -> bool {
        let Some(link) = self.link(name) else { return self.links.len() == LINKS_MAX };
        frame.is_none_or(|frame| {
            link.ids.contains_key(&id_key(frame.id, frame.extended)) || link.ids.len() == IDS_MAX
        })
    }

    /// A frame for each identifier of a link.
    pub fn ids_of(&self, name: &str) -> impl Iterator<Item = Frame> {
        self.link(name).into_iter().flat_map(move |link| link.ids.keys().map(key_frame))
    }

    fn link(&self, name: &str) -> Option<&SampledLink> {
        self.links.iter().find(|link| link.name == name)
    }
}

fn key_frame(key: &u32) -> Frame {
    const EXTENDED: u32 = id_key(0, true);
    Frame { id: key & !EXTENDED, extended: key & EXTENDED != 0, ..Frame::default() }
}

impl SampledLink {
    fn select(&mut self, fresh: bool, certain: bool) -> bool {
        let number = self.records;
        self.records += 1;
        let first = number < FULL_RECORDS && !certain;
        first || fresh || (number / BLOCK_RECORDS).is_multiple_of(BLOCK_PERIOD)
    }

    /// Number of earlier frames with the identifier; `None` if they are not counted.
    fn count_frame(&mut self, key: u32) -> Option<u8> {
        let has_room = self.ids.len() < IDS_MAX;
        match self.ids.get_mut(&key) {
            Some(count) => {
                let before = *count;
                *count = before.saturating_add(1);
                Some(before)
            }
            None => has_room.then(|| {
                self.ids.insert(key, 1);
                0
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use polepair_core::medium::Frame;

    use super::{BLOCK_PERIOD, BLOCK_RECORDS, FRAMES_PER_ID, FULL_RECORDS, RecordSampler};
    use crate::record::{Record, RecordData};

    fn record(id: u16) -> Record<'static> {
        let data = RecordData::Frame(Frame::standard(id, &[1]));
        Record { time: None, link: "can0", direction: None, data, offset: 0 }
    }

    #[test]
    fn a_long_capture_is_weighed_in_part_and_new_identifiers_wherever_they_come() {
        let mut sample = RecordSampler::default();
        assert!((0..FULL_RECORDS).all(|_| sample.select(&record(1))));
        assert!(!sample.has_skipped("can0"));
        let rest = 20 * BLOCK_RECORDS * BLOCK_PERIOD;
        let consumed = (0..rest).filter(|_| sample.select(&record(1))).count() as u64;
        assert!((19 * BLOCK_RECORDS..=21 * BLOCK_RECORDS).contains(&consumed), "{consumed}");
        assert!(sample.has_skipped("can0"));
        let fresh = (0..1000).filter(|_| sample.select(&record(2))).count();
        assert!(
            (usize::from(FRAMES_PER_ID)..usize::from(FRAMES_PER_ID) + 300).contains(&fresh),
            "{fresh}"
        );
    }
}
