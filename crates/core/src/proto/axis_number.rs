//! Addresses as numbers: a drive, one of its axes, or groups.

use core::fmt;

/// Flag of an address that names groups of drives instead of one. The bits below are a mask: bit
/// n - 1 is group number n. None set is everybody.
pub const GROUP: u32 = 1 << 31;
/// Bits of an address for one of several axes of a drive, as people number them; 0 is the first.
pub const SUB_AXIS: u32 = 0xFF << 16;

/// An address without the [`SUB_AXIS`]: the drive that the axis belongs to.
#[must_use]
pub const fn drive_address(address: u32) -> u32 {
    if address & GROUP == 0 { address & !SUB_AXIS } else { address }
}

/// Which axis of its drive an address means; 0 is the first.
#[must_use]
pub const fn sub_axis(address: u32) -> u8 {
    if address & GROUP == 0 { (address >> 16) as u8 } else { 0 }
}

/// The address of another axis of a drive; 0 is the first.
#[must_use]
pub const fn with_sub_axis(address: u32, sub: u8) -> u32 {
    drive_address(address) | (sub as u32) << 16
}

/// The number of an axis as connection strings write it: an address, with the number of one of several
/// axes of a drive behind it (`5.2`, see [`SUB_AXIS`]), or groups of
/// drives where it has the flag [`GROUP`]: `g3`, `g1+2+4`, and `g*` for all.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct AxisNumber(pub u32);

impl AxisNumber {
    /// Returns whether it addresses several drives, which do not reply.
    #[must_use]
    pub const fn is_group(self) -> bool {
        self.0 & GROUP != 0
    }

    /// Returns whether it is an address alone: no group, and no further axis of a drive.
    #[must_use]
    pub const fn is_plain(self) -> bool {
        self.0 & (GROUP | SUB_AXIS) == 0
    }

    /// Value in JSON: a number, or a string if it is more than an address.
    #[must_use]
    pub const fn json(self) -> JsonAxisNumber {
        JsonAxisNumber(self)
    }

    /// Reads the number of one axis: `5`, `5.2`. `None` for anything else, groups included.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        match text.split_once('.') {
            None => plain_number(text).map(Self),
            Some((drive, sub)) => {
                Some(Self(with_sub_axis(plain_number(drive)?, sub.parse().ok()?)))
            }
        }
    }
}

fn plain_number(text: &str) -> Option<u32> {
    text.parse().ok().filter(|number| AxisNumber(*number).is_plain())
}

/// An [`AxisNumber`] in JSON.
#[derive(Clone, Copy, Debug)]
pub struct JsonAxisNumber(AxisNumber);

impl fmt::Display for JsonAxisNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_plain() { self.0.fmt(f) } else { write!(f, "\"{}\"", self.0) }
    }
}

impl fmt::Display for AxisNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.is_group() {
            let (drive, sub) = (drive_address(self.0), sub_axis(self.0));
            return match sub {
                0 => write!(f, "{drive}"),
                sub => write!(f, "{drive}.{sub}"),
            };
        }
        let mask = self.0 & !GROUP;
        if mask == 0 {
            return f.write_str("g*");
        }
        let mut mark = 'g';
        for group in (1..=31_u32).filter(|group| mask >> (group - 1) & 1 == 1) {
            write!(f, "{mark}{group}")?;
            mark = '+';
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{AxisNumber, GROUP, drive_address, sub_axis};
    use alloc::string::ToString as _;

    #[test]
    fn numbers_are_read_as_they_are_written() {
        for text in ["0", "5", "65535", "5.2", "1.255"] {
            assert_eq!(AxisNumber::parse(text).map(|n| n.to_string()).as_deref(), Some(text));
        }
        for text in ["", "5.", ".2", "5.256", "65536", "g1", "5.2.1", "-1", "131077"] {
            assert_eq!(AxisNumber::parse(text), None, "{text}");
        }
        let second = AxisNumber::parse("5.2").map_or(0, |number| number.0);
        assert_eq!((drive_address(second), sub_axis(second)), (5, 2));
        assert_eq!(drive_address(GROUP | 1 << 20), GROUP | 1 << 20);
        assert_eq!(AxisNumber(GROUP | 0b101).to_string(), "g1+3");
    }
}
