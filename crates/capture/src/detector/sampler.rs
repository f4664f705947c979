//! Selects the records that the detector reads: a sample of a long capture.

use std::collections::HashMap;

use crate::record::{Record, RecordData};

/// Records of a link that are weighed one by one.
const FULL_RECORDS: u64 = 20_000;
/// Records in a row that are weighed later on, so that frames in them are whole …
const BLOCK_RECORDS: u64 = 256;
/// … and of how many blocks one is.
const BLOCK_PERIOD: u64 = 64;
/// Frames of a CAN identifier that are weighed wherever they come.
const FRAMES_PER_ID: u8 = 64;
/// Identifiers that are counted one by one.
const IDS_MAX: usize = 4096;
/// Links that are counted one by one.
const LINKS_MAX: usize = 256;

/// Chooses records.
#[derive(Debug, Default)]
pub(super) struct RecordSampler {
    links: Vec<SampledLink>,
}

#[derive(Debug, Default)]
struct SampledLink {
    name: String,
    records: u64,
    skipped: u64,
    ids: HashMap<u32, u8>,
}

impl RecordSampler {
    /// Whether a record is weighed.
    pub fn select(&mut self, record: &Record<'_>) -> bool {
        let at = self.links.iter().position(|link| link.name == record.link);
        let at = at.unwrap_or_else(|| {
            let link = SampledLink { name: record.link.to_owned(), ..SampledLink::default() };
            self.links.push(link);
            self.links.len() - 1
        });
        if at >= LINKS_MAX {
            self.links.truncate(LINKS_MAX);
            return false;
        }
        let link = &mut self.links[at];
        let accepted = link.select(&record.data);
        link.skipped += u64::from(!accepted);
        accepted
    }

    /// True when records of a link were left out.
    pub fn has_skipped(&self, name: &str) -> bool {
        self.links.iter().any(|link| link.name == name && link.skipped > 0)
    }
}

impl SampledLink {
    fn select(&mut self, data: &RecordData<'_>) -> bool {
        let number = self.records;
        self.records += 1;
        let fresh = match data {
            // The top bit is free in both kinds of identifier.
            RecordData::Frame(frame) => self.admit_id(frame.id | u32::from(frame.extended) << 31),
            _ => false,
        };
        fresh || number < FULL_RECORDS || (number / BLOCK_RECORDS).is_multiple_of(BLOCK_PERIOD)
    }

    fn admit_id(&mut self, id: u32) -> bool {
        let has_room = self.ids.len() < IDS_MAX;
        match self.ids.get_mut(&id) {
            Some(count) => {
                *count = count.saturating_add(1);
                *count <= FRAMES_PER_ID
            }
            None if has_room => {
                self.ids.insert(id, 1);
                true
            }
            None => false,
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
