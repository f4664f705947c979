//! Which records are weighed: of a long capture enough, not all.

use std::collections::HashMap;

use crate::record::{Data, Record};

/// Records of a link that are weighed one by one.
const FIRST: u64 = 20_000;
/// Records in a row that are weighed later on, so that frames in them are whole …
const BLOCK: u64 = 256;
/// … and of how many blocks one is.
const BLOCKS: u64 = 64;
/// Frames of a CAN identifier that are weighed wherever they come.
const OF_ID: u8 = 64;
/// Identifiers that are counted one by one.
const IDS_MAX: usize = 4096;
/// Links that are counted one by one.
const LINKS_MAX: usize = 256;

/// Chooses records.
#[derive(Debug, Default)]
pub(super) struct Sample {
    links: Vec<Link>,
}

#[derive(Debug, Default)]
struct Link {
    name: String,
    records: u64,
    left: u64,
    ids: HashMap<u32, u8>,
}

impl Sample {
    /// Whether a record is weighed.
    pub fn takes(&mut self, record: &Record<'_>) -> bool {
        let at = self.links.iter().position(|link| link.name == record.link);
        let at = at.unwrap_or_else(|| {
            let link = Link { name: record.link.to_owned(), ..Link::default() };
            self.links.push(link);
            self.links.len() - 1
        });
        if at >= LINKS_MAX {
            self.links.truncate(LINKS_MAX);
            return false;
        }
        let link = &mut self.links[at];
        let taken = link.takes(&record.data);
        link.left += u64::from(!taken);
        taken
    }

    /// True when records of a link were left out.
    pub fn left_out(&self, name: &str) -> bool {
        self.links.iter().any(|link| link.name == name && link.left > 0)
    }
}

impl Link {
    fn takes(&mut self, data: &Data<'_>) -> bool {
        let number = self.records;
        self.records += 1;
        let fresh = match data {
            // The top bit is free in both kinds of identifier.
            Data::Frame(frame) => self.is_fresh(frame.id | u32::from(frame.extended) << 31),
            _ => false,
        };
        fresh || number < FIRST || (number / BLOCK).is_multiple_of(BLOCKS)
    }

    fn is_fresh(&mut self, id: u32) -> bool {
        let room = self.ids.len() < IDS_MAX;
        match self.ids.get_mut(&id) {
            Some(count) => {
                *count = count.saturating_add(1);
                *count <= OF_ID
            }
            None if room => {
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

    use super::{BLOCK, BLOCKS, FIRST, OF_ID, Sample};
    use crate::record::{Data, Record};

    fn record(id: u16) -> Record<'static> {
        let data = Data::Frame(Frame::standard(id, &[1]));
        Record { time: None, link: "can0", direction: None, data, at: 0 }
    }

    #[test]
    fn a_long_capture_is_weighed_in_part_and_new_identifiers_wherever_they_come() {
        let mut sample = Sample::default();
        assert!((0..FIRST).all(|_| sample.takes(&record(1))));
        assert!(!sample.left_out("can0"));
        let rest = 20 * BLOCK * BLOCKS;
        let taken = (0..rest).filter(|_| sample.takes(&record(1))).count() as u64;
        assert!((19 * BLOCK..=21 * BLOCK).contains(&taken), "{taken}");
        assert!(sample.left_out("can0"));
        let fresh = (0..1000).filter(|_| sample.takes(&record(2))).count();
        assert!((usize::from(OF_ID)..usize::from(OF_ID) + 300).contains(&fresh), "{fresh}");
    }
}
