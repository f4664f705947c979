//! The table of an electronic cam: a follower's positions at equal distances of its master's.

/// Words before the first point.
pub const HEAD_WORDS: u16 = 5;
/// Points of a table at most.
pub const POINTS_MAX: u16 = 8192;
/// The largest power of two between points.
pub const STEP_POWER_MAX: u32 = 7;

/// A table as it lies in a drive's memory.
///
/// Source: the maker's help pages on cam tables (32-bit points at equal distances of a power of two, at most
/// 8192). \[I\] The first word has the distance's power in bits 15 to 13 and the number of points less one in
/// bits 12 to 0; the first master position and a reserved long follow, then the points, then the sum of all
/// words. No public text has this layout.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CamTable<'a> {
    /// Master's position at the first point, counts.
    pub first_master: i32,
    /// Binary logarithm of the master's counts from one point to the next.
    pub step_power: u32,
    /// Follower's positions, counts.
    pub points: &'a [i32],
}

impl CamTable<'_> {
    /// Words of a table with that many points, its sum included.
    #[must_use]
    pub const fn len_for(points: usize) -> usize {
        HEAD_WORDS as usize + 2 * points + 1
    }

    /// The words in the order of their addresses.
    pub fn words(&self) -> impl Iterator<Item = u16> {
        let head = (self.step_power << 13) as u16 | (self.points.len() - 1) as u16;
        let longs = [self.first_master, 0].into_iter().chain(self.points.iter().copied());
        let words = move || core::iter::once(head).chain(longs.clone().flat_map(halves));
        let sum = words().fold(0, u16::wrapping_add);
        words().chain(core::iter::once(sum))
    }
}

/// The halves of a long, the low one first.
const fn halves(long: i32) -> [u16; 2] {
    let bits = long.cast_unsigned();
    [bits as u16, (bits >> 16) as u16]
}

#[cfg(test)]
mod tests {
    use super::CamTable;
    use alloc::vec::Vec;

    #[test]
    fn a_table_ends_with_the_sum_of_its_words() {
        let table = CamTable { first_master: -1, step_power: 3, points: &[0, 0x0001_0002] };
        let words: Vec<u16> = table.words().collect();
        assert_eq!(words.len(), CamTable::len_for(2));
        assert_eq!(words[..9], [0x6001, 0xFFFF, 0xFFFF, 0, 0, 0, 0, 2, 1]);
        assert_eq!(words[9], words[..9].iter().fold(0, |sum: u16, word| sum.wrapping_add(*word)));
    }
}
