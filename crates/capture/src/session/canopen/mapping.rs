//! Mapping of process data: position and type of each value in the eight bytes, computed when the mapping
//! is learnt.

use polepair_core::profile::Encoding;
use polepair_core::proto::canopen::cia402;
use polepair_core::proto::canopen::pdo::{BITS_MAX, BitField, MappingEntry};
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::meaning::{ObjectLookup, ObjectMeaning};
use crate::session::{InternedName, Quality};

/// Entries of one mapping: one a bit.
pub(super) const ENTRIES_MAX: usize = BITS_MAX as usize;

/// The values of one PDO.
#[derive(Clone, PartialEq, Debug)]
pub struct Mapping {
    values: Vec<MappedValue>,
    /// False for a mapping that is only supposed for the text: its values count for nothing else.
    has_signals: bool,
    entries: Vec<(MappingEntry, BitField)>,
    bytes: u8,
    quality: Quality,
}

/// Position of a number in eight bytes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct NumberBits {
    left_shift: u8,
    right_shift: u8,
    signed: bool,
}

impl NumberBits {
    /// A number of that field.
    pub const fn new(field: BitField, signed: bool) -> Self {
        Self {
            left_shift: BITS_MAX - field.start - field.bits,
            right_shift: BITS_MAX - field.bits,
            signed,
        }
    }

    /// The number that eight bytes, the first lowest, hold there.
    #[inline]
    pub const fn extract(self, data: u64) -> i64 {
        let top = data << (self.left_shift & 63);
        let rest = self.right_shift & 63;
        if self.signed { top.cast_signed() >> rest } else { (top >> rest).cast_signed() }
    }
}

/// One value: its place, and its meaning.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MappedValue {
    pub(super) bits: NumberBits,
    /// Encoding of a floating-point number; `None` for an integer.
    real: Option<Encoding>,
    is_flag: bool,
    tells_state: bool,
    mask: i64,
    equals: i64,
    factor: f64,
    /// The signal's name.
    pub name: InternedName,
    /// Unit; empty if unknown.
    pub unit: InternedName,
    /// The object that it is a value of.
    pub object: ObjectIndex,
}

impl MappedValue {
    fn new(field: BitField, object: ObjectIndex, meaning: &ObjectMeaning) -> Self {
        let ObjectMeaning { name, unit, factor, signed, real, mask, equals } = *meaning;
        Self {
            bits: NumberBits::new(field, signed),
            real,
            is_flag: equals.is_some(),
            tells_state: equals.is_none() && is_state_object(object),
            mask,
            equals: equals.unwrap_or(0),
            factor,
            name,
            unit,
            object,
        }
    }

    /// Returns whether it is the whole number, and no flag in it.
    pub(super) const fn is_number(&self) -> bool {
        !self.is_flag
    }

    /// Returns whether it reports a state.
    pub(super) const fn tells_state(&self) -> bool {
        self.tells_state
    }

    /// The integer that eight bytes, the first lowest, hold for it.
    #[inline]
    #[must_use]
    pub const fn exact(&self, data: u64) -> i64 {
        let masked = self.bits.extract(data) & self.mask;
        if self.is_flag { (masked == self.equals) as i64 } else { masked }
    }

    /// The integer in its unit.
    #[inline]
    #[must_use]
    pub fn value(&self, exact: i64) -> f64 {
        self.real.map_or(exact as f64, |encoding| encoding.number(exact)) * self.factor
    }
}

impl Mapping {
    /// Entries one behind the other; `None` when they are none, or more than a frame has.
    pub(super) fn new(
        entries: &[MappingEntry],
        book: &ObjectLookup<'_>,
        quality: Quality,
    ) -> Option<Self> {
        let mut mapping = Self { quality, has_signals: true, ..Self::empty() };
        let mut at = 0_u8;
        for entry in entries {
            let end = at.checked_add(entry.bits).filter(|end| *end <= BITS_MAX && *end > at)?;
            mapping.push_entry(*entry, BitField { start: at, bits: entry.bits }, book);
            at = end;
        }
        mapping.bytes = at.div_ceil(8);
        (at > 0).then_some(mapping)
    }

    /// Mapping of unknown bytes.
    pub(super) const fn empty() -> Self {
        Self {
            values: Vec::new(),
            has_signals: false,
            entries: Vec::new(),
            bytes: 0,
            quality: Quality::Inferred,
        }
    }

    /// Mapping of frames of `len` bytes whose text supposes these entries, but whose values are not known.
    pub(super) fn supposed(entries: &[MappingEntry], book: &ObjectLookup<'_>, len: u8) -> Self {
        let mapping = Self::new(entries, book, Quality::Inferred).unwrap_or_else(Self::empty);
        Self { has_signals: false, bytes: len, ..mapping }
    }

    fn push_entry(&mut self, entry: MappingEntry, field: BitField, book: &ObjectLookup<'_>) {
        self.entries.push((entry, field));
        if entry.is_gap() {
            return;
        }
        let object = entry.object;
        let meanings = book.meanings(object);
        self.values.extend(meanings.iter().map(|meaning| MappedValue::new(field, object, meaning)));
    }

    /// Gives each value that eight bytes hold, the first lowest: its place, the integer, and that in
    /// its unit.
    #[inline]
    pub fn for_each_signal(&self, data: u64, mut each: impl FnMut(&MappedValue, i64, f64)) {
        for mapped in self.mapped_values() {
            let exact = mapped.exact(data);
            each(mapped, exact, mapped.value(exact));
        }
    }

    /// Returns whether it has no entry that is a value.
    pub(super) fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Bytes of its frame.
    #[must_use]
    pub const fn bytes(&self) -> u8 {
        self.bytes
    }

    /// Quality by the origin of the mapping: stated by the capture, or inferred.
    #[must_use]
    pub const fn quality(&self) -> Quality {
        self.quality
    }

    /// The values, and the flags in them, in order.
    #[must_use]
    pub fn mapped_values(&self) -> &[MappedValue] {
        if self.has_signals { &self.values } else { &[] }
    }

    /// Values that are whole numbers, in order.
    fn numbers(&self) -> impl Iterator<Item = &MappedValue> {
        self.values.iter().filter(|mapped| mapped.is_number())
    }

    /// The entries in order, where each lies, and what eight bytes hold for it.
    pub(super) fn entry_values(
        &self,
        data: u64,
    ) -> impl Iterator<Item = (MappingEntry, BitField, &MappedValue, i64)> {
        let mapped = self.entries.iter().filter(|(entry, _)| !entry.is_gap());
        mapped.zip(self.numbers()).map(move |((entry, field), mapped_value)| {
            (*entry, *field, mapped_value, mapped_value.exact(data))
        })
    }
}

/// Returns whether it is an object with states: error code, statusword and mode.
fn is_state_object(object: ObjectIndex) -> bool {
    let states = [ERROR_CODE, cia402::STATUSWORD, MODE_DISPLAY];
    states.contains(&object)
}

/// The fault of a CiA 402 drive.
pub(super) const ERROR_CODE: ObjectIndex = ObjectIndex::new(0x603F, 0);
/// The mode that it is in.
pub(super) const MODE_DISPLAY: ObjectIndex = ObjectIndex::new(0x6061, 0);
