//! Words in which bits, or groups of bits, have names of their own: statuswords, error registers.

/// A name of a pattern of bits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BitName {
    /// Bits that count.
    pub mask: i64,
    /// Pattern of these bits.
    pub value: i64,
    /// Name of the pattern.
    pub name: &'static str,
}

impl BitName {
    /// Number of the bit, if it is one bit that is set.
    #[must_use]
    pub const fn bit(&self) -> Option<u32> {
        if self.mask == self.value && self.mask.count_ones() == 1 {
            Some(self.mask.trailing_zeros())
        } else {
            None
        }
    }
}

/// Names of the patterns in a raw value, in the order of the profile.
pub fn bit_names(bits: &'static [BitName], raw: i64) -> impl Iterator<Item = &'static str> {
    let found = bits.iter().filter(move |known| raw & known.mask == known.value);
    found.map(|known| known.name)
}

#[cfg(test)]
mod tests {
    use super::BitName;

    #[test]
    fn one_bit_has_a_number() {
        let named = |mask, value| BitName { mask, value, name: "" };
        assert_eq!(named(0x400, 0x400).bit(), Some(10));
        assert_eq!((named(0x400, 0).bit(), named(0x6F, 0x27).bit()), (None, None));
    }
}
