//! Recorders in drives: variables sampled in the drive's own control loop, all at one instant, into a buffer
//! of its memory. The host reads the buffer when it is full.

use core::ops::RangeInclusive;

/// A control loop that samples are taken in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LoggerLoop {
    /// Name of the loop: `slow`.
    pub name: &'static str,
    /// Period of the loop, µs. The usual set-up's; another one scales all times.
    pub period_us: u32,
    /// Bits of the pointer that start the logger in this loop.
    pub bits: u16,
}

/// Facts about the data logger of a protocol's drives.
#[derive(Debug)]
pub struct DataLogger {
    /// Symbol of the variable with the start of the buffer, and in its lowest bits the loop: zero is off.
    pub pointer: &'static str,
    /// Address of that variable, for a profile without the symbol.
    pub pointer_address: &'static str,
    /// The bits of the loop.
    pub loop_bits: u16,
    /// Loops, the slowest first.
    pub loops: &'static [LoggerLoop],
    /// Memory that the buffer may lie in, where nothing else is known of the drive.
    pub memory: RangeInclusive<u16>,
    /// The buffer starts at a multiple of this.
    pub alignment: u16,
    /// True if no public source has the layout of the buffer's head.
    pub is_layout_inferred: bool,
}

/// The head of a log buffer. The points follow it, each with its words in the order of the addresses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LogHead<'a> {
    /// Points to take.
    pub points: u16,
    /// Loops from one point to the next.
    pub period: u16,
    /// Addresses of the words of a point.
    pub addresses: &'a [u16],
}

impl LogHead<'_> {
    /// Place of the number of points that are still to come.
    pub const POINTS_LEFT: u16 = 0;
    /// Place of the loops from one point to the next.
    pub const PERIOD: u16 = 1;
    /// Place of the number of words of a point.
    pub const WORDS: u16 = 2;
    /// Place of the first word's address.
    pub const ADDRESSES: u16 = 3;

    /// Words of a head with that many addresses.
    #[must_use]
    pub const fn len_for(addresses: u16) -> u16 {
        Self::ADDRESSES.saturating_add(addresses)
    }

    /// The words of the head, in the order of their places.
    pub fn words(&self) -> impl Iterator<Item = u16> {
        let count = self.addresses.len() as u16;
        [self.points, self.period, count].into_iter().chain(self.addresses.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::LogHead;
    use alloc::vec::Vec;

    #[test]
    fn a_head_has_its_words_at_their_places() {
        let head = LogHead { points: 300, period: 2, addresses: &[0x022A, 0x0228, 0x0229] };
        let words: Vec<u16> = head.words().collect();
        let at = |place: u16| words[usize::from(place)];
        assert_eq!(words.len(), usize::from(LogHead::len_for(3)));
        assert_eq!(
            (at(LogHead::POINTS_LEFT), at(LogHead::PERIOD), at(LogHead::WORDS)),
            (300, 2, 3)
        );
        assert_eq!(at(LogHead::ADDRESSES + 2), 0x0229);
    }
}
