//! The layout of a node's process data, by the mapping that was read or written.

use super::address::axis_index;
use super::pdo::{BITS_MAX, BitField, MappingEntry};
use crate::axis::{DriveReport, REPORTS_MAX};
use crate::profile::{ParameterId, Profile};

/// Objects of one mapping that are kept.
const ENTRIES_MAX: usize = super::pdo::MAPPED_MAX;

/// One PDO as far as it is known.
#[derive(Clone, Copy, Debug)]
pub struct KnownPdo {
    /// True if it is enabled, as far as is known.
    pub enabled: bool,
    entries: [Option<MappingEntry>; ENTRIES_MAX],
    /// Parameters in it; none until the whole mapping is known.
    fields: [Option<(ParameterId, BitField, bool)>; REPORTS_MAX],
    /// Bytes that it has.
    bytes: u8,
}

impl KnownPdo {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self {
        enabled: false,
        entries: [None; ENTRIES_MAX],
        fields: [None; REPORTS_MAX],
        bytes: 0,
    };

    /// Takes what sub-index `sub` of the mapping holds; 0 is how many count.
    /// Objects of the axis lie `offset` above those of the profile.
    pub fn learn(&mut self, sub: u8, raw: u32, profile: &'static Profile, offset: u16) {
        let index = usize::from(sub).wrapping_sub(1);
        // Reading back an entry changes nothing, so the layout stays known.
        if self.entries.get(index).is_some_and(|known| *known == Some(MappingEntry::from(raw))) {
            return;
        }
        (self.fields, self.bytes) = ([None; REPORTS_MAX], 0);
        if sub == 0 {
            self.lay_out(raw as usize, profile, offset);
        } else if let Some(entry) = self.entries.get_mut(index) {
            *entry = Some(MappingEntry::from(raw));
        }
    }

    /// Places the first `count` entries one behind the other; leaves all unknown if one of them is.
    fn lay_out(&mut self, count: usize, profile: &'static Profile, offset: u16) {
        let Some(entries) = self.entries.get(..count) else { return };
        let (mut at, mut places) = (0, self.fields.iter_mut());
        for entry in entries {
            let Some(MappingEntry { object, bits: bits @ 1..=BITS_MAX }) = *entry else { return };
            if at + bits > BITS_MAX {
                return;
            }
            if let Some(id) = profile
                .parameters
                .iter()
                .position(|p| (axis_index(p.index, offset), p.space) == (object.index, object.sub))
                && let Some(position) = places.next()
            {
                let (_, signed) = super::driver::encoding_width(profile.parameters[id].encoding);
                *position = Some((ParameterId(id as u16), BitField { start: at, bits }, signed));
            }
            at += bits;
        }
        self.bytes = at.div_ceil(8);
    }

    /// Position of a parameter.
    pub fn field(&self, wanted: ParameterId) -> Option<BitField> {
        let known = self.fields.iter().flatten();
        known.clone().find(|(id, ..)| *id == wanted).map(|(_, field, _)| *field)
    }

    /// Bytes of its frame; 0 while that is not known.
    pub const fn bytes(&self) -> u8 {
        self.bytes
    }

    /// Values in `len` bytes; none if they are fewer than the mapping has.
    pub fn decode_values(&self, data: u64, len: u8) -> [Option<DriveReport>; REPORTS_MAX] {
        if self.bytes == 0 || len < self.bytes {
            return [None; REPORTS_MAX];
        }
        self.fields.map(|field| {
            let (id, field, signed) = field?;
            let raw = if signed { field.signed(data) } else { field.unsigned(data).cast_signed() };
            Some(DriveReport::Parameter(id, raw))
        })
    }
}
