//! Object dictionaries: which objects a node has, of what type, and how they may be used.
//!
//! A [`Dictionary`] is a table that all nodes of a kind share; the values are each node's own. An
//! entry is found in constant time, whatever the size of the table: its key is hashed into a table
//! of places that is made once, at compile time for drives that are built in.
//!
//! ```
//! use polepair_core::proto::canopen::od::{ObjectAccess, Dictionary, ObjectEntry, ValueType};
//! static ENTRIES: [ObjectEntry; 2] = [
//!     ObjectEntry::new(0x1000, 0, ValueType::U32, ObjectAccess::RO, 0, "device type").with_default(0x20192),
//!     ObjectEntry::new(0x6040, 0, ValueType::U16, ObjectAccess::RW.mappable(), 1, "controlword"),
//! ];
//! static PLACES: [u16; 4] = Dictionary::hash_slots(&ENTRIES);
//! static DICTIONARY: Dictionary = Dictionary::new(&ENTRIES, &PLACES);
//! assert_eq!(DICTIONARY.find(0x6040, 0).map(|entry| entry.name), Some("controlword"));
//! assert!(DICTIONARY.find(0x6040, 1).is_none());
//! ```

/// A data type by its number (CiA 301, data type definitions).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ValueType(pub u8);

impl ValueType {
    /// One bit.
    pub const BOOLEAN: Self = Self(0x01);
    /// Signed, 8 bits.
    pub const I8: Self = Self(0x02);
    /// Signed, 16 bits.
    pub const I16: Self = Self(0x03);
    /// Signed, 32 bits.
    pub const I32: Self = Self(0x04);
    /// Unsigned, 8 bits.
    pub const U8: Self = Self(0x05);
    /// Unsigned, 16 bits.
    pub const U16: Self = Self(0x06);
    /// Unsigned, 32 bits.
    pub const U32: Self = Self(0x07);
    /// IEEE 754, 32 bits.
    pub const F32: Self = Self(0x08);
    /// Text of visible characters.
    pub const TEXT: Self = Self(0x09);
    /// Bytes.
    pub const OCTETS: Self = Self(0x0A);
    /// Text of 16-bit characters.
    pub const UNICODE: Self = Self(0x0B);
    /// Milliseconds after midnight and days since 1984, 48 bits.
    pub const TIME_OF_DAY: Self = Self(0x0C);
    /// Milliseconds and days, 48 bits.
    pub const TIME_DIFFERENCE: Self = Self(0x0D);
    /// Anything: a program, a file.
    pub const DOMAIN: Self = Self(0x0F);
    /// IEEE 754, 64 bits.
    pub const F64: Self = Self(0x11);
    /// Signed, 64 bits.
    pub const I64: Self = Self(0x15);
    /// Unsigned, 64 bits.
    pub const U64: Self = Self(0x1B);

    /// Bytes of a value; `None` for types of any length and those that are not known.
    #[inline]
    #[must_use]
    pub const fn bytes(self) -> Option<u8> {
        Some(match self.0 {
            0x01 | 0x02 | 0x05 => 1,
            0x03 | 0x06 => 2,
            0x10 | 0x16 => 3,
            0x04 | 0x07 | 0x08 => 4,
            0x12 | 0x18 => 5,
            0x0C | 0x0D | 0x13 | 0x19 => 6,
            0x14 | 0x1A => 7,
            0x11 | 0x15 | 0x1B => 8,
            _ => return None,
        })
    }

    /// Bits that a value takes in a PDO.
    #[must_use]
    pub const fn bits(self) -> Option<u8> {
        match self.bytes() {
            _ if self.0 == Self::BOOLEAN.0 => Some(1),
            Some(bytes) => Some(8 * bytes),
            None => None,
        }
    }

    /// Returns whether values are signed.
    #[must_use]
    pub const fn is_signed(self) -> bool {
        matches!(self.0, 0x02..=0x04 | 0x10 | 0x12..=0x15)
    }

    /// `raw`, the bytes of such a value with the first one lowest, as a number.
    #[inline]
    #[must_use]
    pub const fn number(self, raw: u64) -> i64 {
        let Some(bytes) = self.bytes() else { return raw as i64 };
        let spare = 64 - 8 * bytes as u32;
        if self.is_signed() {
            ((raw << spare) as i64) >> spare
        } else {
            (raw << spare >> spare) as i64
        }
    }
}

/// Access to an entry.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ObjectAccess(u8);

impl ObjectAccess {
    const READ: u8 = 1;
    const WRITE: u8 = 2;
    const TPDO: u8 = 4;
    const RPDO: u8 = 8;

    /// Read only.
    pub const RO: Self = Self(Self::READ);
    /// Written only.
    pub const WO: Self = Self(Self::WRITE);
    /// Read and written.
    pub const RW: Self = Self(Self::READ | Self::WRITE);

    /// The access, with mapping into PDOs of the permitted directions.
    #[must_use]
    pub const fn mappable(self) -> Self {
        Self(self.0 | self.0 << 2)
    }

    /// The access, with mapping into PDOs that the node sends only.
    #[must_use]
    pub const fn sendable(self) -> Self {
        Self(self.0 | Self::TPDO)
    }

    /// The access, with mapping into PDOs that the node receives only.
    #[must_use]
    pub const fn receivable(self) -> Self {
        Self(self.0 | Self::RPDO)
    }

    /// Returns whether it may be read.
    #[inline]
    #[must_use]
    pub const fn is_readable(self) -> bool {
        self.0 & Self::READ != 0
    }

    /// Returns whether it may be written.
    #[inline]
    #[must_use]
    pub const fn is_writable(self) -> bool {
        self.0 & Self::WRITE != 0
    }

    /// Returns whether it may be mapped into a PDO that the node sends.
    #[must_use]
    pub const fn is_sendable(self) -> bool {
        self.0 & Self::TPDO != 0
    }

    /// Returns whether it may be mapped into a PDO that the node receives.
    #[must_use]
    pub const fn is_receivable(self) -> bool {
        self.0 & Self::RPDO != 0
    }
}

/// Value from the factory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DefaultValue {
    /// A number.
    Number(i64),
    /// A number to which the node-ID is added: `$NODEID+0x600`.
    PlusNode(i64),
    /// A text.
    Text(&'static str),
}

/// One sub-index of one object.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ObjectEntry {
    key: u32,
    /// Data type.
    pub kind: ValueType,
    /// Access.
    pub access: ObjectAccess,
    /// The firmware's own number for it, or [`PROTOCOL_TAG`] for the protocol's objects.
    pub tag: u16,
    /// Name; empty for none.
    pub name: &'static str,
    /// Value from the factory.
    pub default: DefaultValue,
    /// Least and greatest value that may be written.
    pub limits: (i64, i64),
}

/// [`ObjectEntry::tag`] of objects that the protocol itself keeps, 1000h to 1FFFh.
pub const PROTOCOL_TAG: u16 = u16::MAX;

impl ObjectEntry {
    /// An entry with factory value 0 and no limits.
    #[must_use]
    pub const fn new(
        index: u16,
        sub: u8,
        kind: ValueType,
        access: ObjectAccess,
        tag: u16,
        name: &'static str,
    ) -> Self {
        let (default, limits) = (DefaultValue::Number(0), (i64::MIN, i64::MAX));
        Self { key: key(index, sub), kind, access, tag, name, default, limits }
    }

    /// The entry with a factory number.
    #[must_use]
    pub const fn with_default(mut self, number: i64) -> Self {
        self.default = DefaultValue::Number(number);
        self
    }

    /// The entry with a factory value.
    #[must_use]
    pub const fn with_default_value(mut self, worth: DefaultValue) -> Self {
        self.default = worth;
        self
    }

    /// The entry with limits.
    #[must_use]
    pub const fn with_limits(mut self, min: i64, greatest: i64) -> Self {
        self.limits = (min, greatest);
        self
    }

    /// Index of the object.
    #[must_use]
    pub const fn index(&self) -> u16 {
        (self.key >> 8) as u16
    }

    /// Sub-index of the object.
    #[must_use]
    pub const fn sub(&self) -> u8 {
        self.key as u8
    }

    /// Index and sub-index in one number.
    #[must_use]
    pub const fn key(&self) -> u32 {
        self.key
    }

    /// Factory value as the bytes of its type, the first lowest; 0 for a text.
    #[must_use]
    pub const fn default_bits(&self, node: u8) -> u64 {
        match self.default {
            DefaultValue::Number(number) => number as u64,
            DefaultValue::PlusNode(number) => number as u64 + node as u64,
            DefaultValue::Text(_) => 0,
        }
    }
}

/// Index and sub-index in one number.
#[inline]
#[must_use]
pub const fn key(index: u16, sub: u8) -> u32 {
    (index as u32) << 8 | sub as u32
}

/// The entries of a kind of node.
#[derive(Clone, Copy, Debug)]
pub struct Dictionary {
    entries: &'static [ObjectEntry],
    slots: &'static [u16],
}

/// A place that no entry has.
const EMPTY_SLOT: u16 = u16::MAX;

impl Dictionary {
    /// A dictionary of entries in ascending order, with what [`hash_slots`](Self::hash_slots) or
    /// [`fill_slots`](Self::fill_slots) made of them.
    ///
    /// # Panics
    /// When the entries are not in order: at compile time where it is a constant.
    #[must_use]
    pub const fn new(entries: &'static [ObjectEntry], slots: &'static [u16]) -> Self {
        let mut at = 1;
        while at < entries.len() {
            assert!(entries[at - 1].key < entries[at].key, "entries are not in order");
            at += 1;
        }
        assert!(slots.len().is_power_of_two() && slots.len() > entries.len());
        Self { entries, slots }
    }

    /// Hash table of `entries`: `N` is a power of two, at least twice their number.
    #[must_use]
    pub const fn hash_slots<const N: usize>(entries: &[ObjectEntry]) -> [u16; N] {
        let mut places = [EMPTY_SLOT; N];
        Self::fill_slots(entries, &mut places);
        places
    }

    /// Fills a slice with the [`hash_slots`](Self::hash_slots) of `entries`.
    ///
    /// # Panics
    /// When its length is no power of two, or less than twice the number of entries.
    pub const fn fill_slots(entries: &[ObjectEntry], places: &mut [u16]) {
        assert!(places.len().is_power_of_two() && places.len() >= 2 * entries.len());
        let mut at = 0;
        while at < places.len() {
            places[at] = EMPTY_SLOT;
            at += 1;
        }
        let mut entry = 0;
        while entry < entries.len() {
            let mut index = hash(entries[entry].key) & (places.len() - 1);
            while places[index] != EMPTY_SLOT {
                index = (index + 1) & (places.len() - 1);
            }
            places[index] = entry as u16;
            entry += 1;
        }
    }

    /// All entries, in ascending order of index and sub-index.
    #[must_use]
    pub const fn entries(&self) -> &'static [ObjectEntry] {
        self.entries
    }

    /// The entry of that index and sub-index.
    #[inline]
    #[must_use]
    pub fn find(&self, index: u16, sub: u8) -> Option<&'static ObjectEntry> {
        let (wanted, mask) = (key(index, sub), self.slots.len() - 1);
        let mut position = hash(wanted) & mask;
        loop {
            let entry = self.entries.get(usize::from(*self.slots.get(position)?))?;
            if entry.key == wanted {
                return Some(entry);
            }
            position = (position + 1) & mask;
        }
    }

    /// The entries of one object.
    #[must_use]
    pub fn object(&self, index: u16) -> &'static [ObjectEntry] {
        let start = self.entries.partition_point(|entry| entry.index() < index);
        let end = self.entries.partition_point(|entry| entry.index() <= index);
        &self.entries[start..end]
    }
}

/// Neighbouring keys land apart: multiplied by 2^32 divided by the golden ratio.
#[inline]
const fn hash(key: u32) -> usize {
    (key.wrapping_mul(0x9E37_79B1) >> 16) as usize
}

/// Two tables, each in order, as one.
///
/// # Panics
/// When `N` is not the sum of their lengths: at compile time where it is a constant.
#[must_use]
pub const fn merge<const N: usize>(
    first: &[ObjectEntry],
    second: &[ObjectEntry],
) -> [ObjectEntry; N] {
    assert!(first.len() + second.len() == N, "N is not the number of entries");
    let mut all = [ObjectEntry::new(0, 0, ValueType::U8, ObjectAccess::RO, PROTOCOL_TAG, ""); N];
    let (mut one, mut other) = (0, 0);
    while one + other < N {
        let ended = other == second.len();
        let is_first = ended || (one < first.len() && first[one].key < second[other].key);
        all[one + other] = if is_first { first[one] } else { second[other] };
        (one, other) = if is_first { (one + 1, other) } else { (one, other + 1) };
    }
    all
}
