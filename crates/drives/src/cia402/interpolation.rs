//! Records of the interpolated position mode that wait for their cycle (60C1h, 60C4h).

/// Records that wait at most, with the one in force.
pub const RECORDS_MAX: usize = 32;

/// A queue of records, first in, first out (CiA 402-2, 60C4h: buffer organisation 0).
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordBuffer {
    records: [i32; RECORDS_MAX],
    first: usize,
    count: usize,
}

impl RecordBuffer {
    /// Number of records that wait.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.count
    }

    /// Appends a record, or returns false if `size` records wait already.
    pub fn push(&mut self, record: i32, size: usize) -> bool {
        if self.count >= size.min(RECORDS_MAX) {
            return false;
        }
        self.records[(self.first + self.count) % RECORDS_MAX] = record;
        self.count += 1;
        true
    }

    /// Takes the oldest record.
    pub fn pop(&mut self) -> Option<i32> {
        let record = (self.count > 0).then(|| self.records[self.first])?;
        self.first = (self.first + 1) % RECORDS_MAX;
        self.count -= 1;
        Some(record)
    }

    /// Drops all records.
    pub const fn clear(&mut self) {
        self.count = 0;
    }
}
