//! Process data: up to eight bytes with the values of mapped objects (CiA 301, 7.2.2).

use super::sdo::ObjectIndex;

/// Default number of objects in a [`PdoMapping`]: one per byte.
pub const MAPPED_MAX: usize = 8;
/// Bits of a frame.
pub const BITS_MAX: u8 = 64;

/// When a PDO is sent, or when its values take effect (sub-index 2 of 1400h and 1800h on).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Transmission {
    /// With the SYNC after a change.
    OnChange,
    /// Triggered by SYNC, one of this many, 1 to 240.
    Cyclic(u8),
    /// Sampled at SYNC, sent on a remote request.
    SampledOnRequest,
    /// Sent on a remote request.
    OnRequest,
    /// Triggered by events of the manufacturer; with an event timer, by time.
    Manufacturer,
    /// Triggered by events of the device profile; with an event timer, by time too.
    Profile,
    /// Reserved numbers, 241 to 251.
    Reserved(u8),
}

impl From<u8> for Transmission {
    fn from(number: u8) -> Self {
        match number {
            0 => Self::OnChange,
            1..=240 => Self::Cyclic(number),
            241..=251 => Self::Reserved(number),
            252 => Self::SampledOnRequest,
            253 => Self::OnRequest,
            254 => Self::Manufacturer,
            255 => Self::Profile,
        }
    }
}

impl From<Transmission> for u8 {
    fn from(transmission: Transmission) -> Self {
        match transmission {
            Transmission::OnChange => 0,
            Transmission::Cyclic(number) | Transmission::Reserved(number) => number,
            Transmission::SampledOnRequest => 252,
            Transmission::OnRequest => 253,
            Transmission::Manufacturer => 254,
            Transmission::Profile => 255,
        }
    }
}

impl Transmission {
    /// Returns whether it depends on SYNC.
    #[must_use]
    pub const fn is_synchronous(self) -> bool {
        matches!(self, Self::OnChange | Self::Cyclic(_) | Self::SampledOnRequest)
    }
}

/// An identifier as objects hold it, with its flags.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct CobId(pub u32);

impl CobId {
    /// Bit 31: the PDO does not exist, the EMCY is not sent.
    pub const INVALID: u32 = 1 << 31;
    /// Bit 30 of a PDO's: no remote requests. Of SYNC's and TIME's: the device produces it.
    pub const FLAG: u32 = 1 << 30;
    /// Bit 29: 29 bits of identifier.
    pub const EXTENDED: u32 = 1 << 29;

    /// The identifier alone.
    #[must_use]
    pub const fn id(self) -> u32 {
        self.0 & if self.is_extended() { 0x1FFF_FFFF } else { 0x7FF }
    }

    /// The thing exists.
    #[must_use]
    pub const fn is_valid(self) -> bool {
        self.0 & Self::INVALID == 0
    }

    /// Returns whether it has 29 bits.
    #[must_use]
    pub const fn is_extended(self) -> bool {
        self.0 & Self::EXTENDED != 0
    }
}

/// The communication parameters of a PDO (objects 1400h and 1800h on).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PdoParameters {
    /// Sub-index 1.
    pub cob: CobId,
    /// Sub-index 2.
    pub transmission: Transmission,
    /// Sub-index 3: least time between two, 0.1 ms.
    pub inhibit: u16,
    /// Sub-index 5: time after which it is sent anyway, ms; of an RPDO, after which it is missed.
    pub event: u16,
    /// Sub-index 6: the SYNC counter with which it begins to count; 0 without.
    pub sync_start: u8,
}

/// One entry of a mapping (objects 1600h and 1A00h on): an object and how many bits of it.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct MappingEntry {
    /// Mapped object. Indices 1 to 7 are gaps of that data type's length.
    pub object: ObjectIndex,
    /// Length in bits.
    pub bits: u8,
}

impl From<u32> for MappingEntry {
    fn from(raw: u32) -> Self {
        let object = ObjectIndex { index: (raw >> 16) as u16, sub: (raw >> 8) as u8 };
        Self { object, bits: raw as u8 }
    }
}

impl From<MappingEntry> for u32 {
    fn from(MappingEntry { object, bits }: MappingEntry) -> Self {
        Self::from(object.index) << 16 | Self::from(object.sub) << 8 | Self::from(bits)
    }
}

impl MappingEntry {
    /// Returns whether it is a gap: bits that are skipped.
    #[must_use]
    pub const fn is_gap(self) -> bool {
        self.object.index < 8
    }
}

/// Bits of a standard frame with `bytes` bytes at most: with every possible stuff bit, and the pause behind it (ISO
/// 11898-1).
#[must_use]
pub const fn max_frame_bits(bytes: u8) -> u32 {
    let stuffed = 34 + 8 * bytes as u32;
    stuffed + 13 + (stuffed - 1) / 4
}

/// Position of a value in the 64 bits of a frame, byte 0 lowest.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct BitField {
    /// Lowest bit.
    pub start: u8,
    /// Length in bits, 1 to 64.
    pub bits: u8,
}

impl BitField {
    /// Value without sign.
    #[inline]
    #[must_use]
    pub const fn unsigned(self, data: u64) -> u64 {
        data << self.bits_above() >> self.unused_bits()
    }

    /// Value with the uppermost bit as sign.
    #[inline]
    #[must_use]
    pub const fn signed(self, data: u64) -> i64 {
        (data << self.bits_above()).cast_signed() >> self.unused_bits()
    }

    /// `data` with `value` put there; bits of it that do not fit are cut.
    #[inline]
    #[must_use]
    pub const fn insert(self, data: u64, value: u64) -> u64 {
        let ones = u64::MAX >> self.unused_bits() << (self.start & 63);
        data & !ones | value << (self.start & 63) & ones
    }

    /// Bits of the frame above it. Masked, so that no field whatever panics.
    const fn bits_above(self) -> u32 {
        64u8.wrapping_sub(self.start).wrapping_sub(self.bits) as u32 & 63
    }

    /// Bits that it lacks of 64.
    const fn unused_bits(self) -> u32 {
        64u8.wrapping_sub(self.bits) as u32 & 63
    }
}

/// A mapping worked out: entries and where each lies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PdoMapping<const N: usize = MAPPED_MAX> {
    entries: [MappingEntry; N],
    fields: [BitField; N],
    len: u8,
    bits: u8,
}

impl<const N: usize> Default for PdoMapping<N> {
    fn default() -> Self {
        Self {
            entries: [MappingEntry::default(); N],
            fields: [BitField::default(); N],
            len: 0,
            bits: 0,
        }
    }
}

/// Reason why an entry does not fit into a mapping.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MappingError {
    /// The entry has no bits.
    EmptyEntry,
    /// There would be more than [`BITS_MAX`] bits.
    TooLong,
    /// There would be more entries than places.
    TooMany,
}

impl<const N: usize> PdoMapping<N> {
    /// The mapping of these entries, in order.
    ///
    /// # Errors
    /// [`MappingError`] for the first one that does not fit.
    pub fn new(entries: impl IntoIterator<Item = MappingEntry>) -> Result<Self, MappingError> {
        let mut map = Self::default();
        entries.into_iter().try_for_each(|entry| map.push(entry))?;
        Ok(map)
    }

    /// One more entry, behind the others.
    ///
    /// # Errors
    /// [`MappingError`], and nothing is changed.
    pub fn push(&mut self, entry: MappingEntry) -> Result<(), MappingError> {
        let n = usize::from(self.len);
        if entry.bits == 0 {
            return Err(MappingError::EmptyEntry);
        }
        let bits = self.bits.checked_add(entry.bits).filter(|bits| *bits <= BITS_MAX);
        let bits = bits.ok_or(MappingError::TooLong)?;
        if n == N {
            return Err(MappingError::TooMany);
        }
        self.entries[n] = entry;
        self.fields[n] = BitField { start: self.bits, bits: entry.bits };
        (self.len, self.bits) = (self.len + 1, bits);
        Ok(())
    }

    /// Entries and where each lies.
    #[inline]
    pub fn fields(&self) -> impl ExactSizeIterator<Item = (MappingEntry, BitField)> + '_ {
        let len = usize::from(self.len).min(N);
        self.entries[..len].iter().copied().zip(self.fields[..len].iter().copied())
    }

    /// Bytes of the frame.
    #[must_use]
    pub const fn bytes(&self) -> u8 {
        self.bits.div_ceil(8)
    }

    /// Nothing is mapped.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }
}
