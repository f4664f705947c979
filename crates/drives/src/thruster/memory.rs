//! Settings that a drive keeps over its restarts (protocol manual, sections 2.2, 2.5, 4.1).

use polepair_core::proto::thruster::wire::{ID_MAX, POSITION_MAX};

/// Settings that are kept. Those of the wire hold from the next start on.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Memory {
    /// Id (CI).
    pub id: u8,
    /// Bit rate (CB), kbit/s as the manual writes it.
    pub kbit_s: u16,
    /// Reports by itself (SR): frames as a mask.
    pub frames: u8,
    /// Their interval, ms.
    pub interval_ms: u16,
    /// Safe range of positions (SPLA), tenths of a degree.
    pub range: (i16, i16),
    /// Shaft positions of both zeros, rad. \[I\] RZ's is kept as AZ's is.
    pub absolute_zero: f64,
    /// See there.
    pub relative_zero: f64,
}

impl Memory {
    /// Factory settings. \[I\] No automatic reports, the whole range.
    pub fn new(id: u8) -> Self {
        let max = POSITION_MAX as i16;
        Self {
            id: id & ID_MAX,
            kbit_s: 500,
            frames: 0,
            interval_ms: 0,
            range: (-max, max),
            absolute_zero: 0.0,
            relative_zero: 0.0,
        }
    }

    /// The bit rate in bit/s. \[I\] 666, 333, 83, 66 and 33 have a third or two behind the point.
    pub fn bit_rate(&self) -> u32 {
        let rate = u32::from(self.kbit_s);
        match rate {
            666 | 66 => rate * 1000 + 667,
            333 | 83 | 33 => rate * 1000 + 333,
            _ => rate * 1000,
        }
    }
}
