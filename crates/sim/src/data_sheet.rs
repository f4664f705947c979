//! Devices by their data sheets: a CANopen node with the objects of a file, and with a motor if they are
//! those of a drive.
//!
//! Communication objects work as in the protocol. Objects of a drive control the motor of the generic CiA
//! 402 drive. All other objects store what is written. A [`DataSheet`] is shared by all devices of a file.

mod device;
#[cfg(test)]
mod tests;

pub use device::DataSheetDevice;

use polepair_core::proto::canopen::device::is_protocol_object;
use polepair_core::proto::canopen::od::{
    DefaultValue, Dictionary, ObjectAccess, ObjectEntry, PROTOCOL_TAG, ValueType,
};
use polepair_drives::cia402::objects::{DICTIONARY, Objects};

/// Entries of a sheet at most.
pub const ENTRIES_MAX: usize = 32_000;
/// PDOs each way that live; objects of others keep what is written.
pub const PDOS_MAX: usize = 32;
/// Tag of the first entry that keeps what is written.
const STORED_TAG_FIRST: u16 = 0x1000;
/// Motors of one node, and the tags that the objects of each have (CiA 402-1: up to eight axes).
const AXES_MAX: u16 = 8;
const AXIS_TAGS: u16 = STORED_TAG_FIRST / AXES_MAX;
/// Objects of an axis, and how far those of the next lie above.
const FIRST_AXIS: u16 = 0x6000;
const AXIS_STEP: u16 = 0x800;
/// Objects without which nothing is a drive: controlword and statusword.
const DRIVE: [u16; 2] = [0x6040, 0x6041];
/// Increments of the encoder in a turn, and supported drive modes.
const INCREMENTS: (u16, u8) = (0x608F, 1);
const MODES: (u16, u8) = (0x6502, 0);

/// One entry as a sheet has it.
#[derive(Clone, PartialEq, Debug)]
pub struct DataSheetEntry {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Number of its data type (CiA 301).
    pub data_type: u8,
    /// Name of the object.
    pub name: String,
    /// An SDO may read it.
    pub readable: bool,
    /// An SDO may write it.
    pub writable: bool,
    /// A TPDO may carry it.
    pub tpdo_mappable: bool,
    /// An RPDO may carry it.
    pub rpdo_mappable: bool,
    /// Least and greatest value.
    pub limits: (i64, i64),
    /// Value from the factory.
    pub default: FactoryValue,
}

/// A value from the factory.
#[derive(Clone, PartialEq, Debug)]
pub enum FactoryValue {
    /// The sheet gives no default.
    Unset,
    /// A number, or the bits of one.
    Number(i64),
    /// A number to which the node-ID is added.
    PlusNodeId(i64),
    /// A text, or bytes.
    Bytes(Vec<u8>),
}

/// Data shared by the devices of a sheet.
#[derive(Debug)]
pub struct DataSheet {
    dictionary: &'static Dictionary,
    stored_objects: Vec<StoredObject>,
    /// The axes of the drive, where it is one.
    axes: Vec<DataSheetAxis>,
    has_lss: bool,
}

/// An axis of a drive, as from the factory.
#[derive(Clone, Debug)]
struct DataSheetAxis {
    objects: Objects,
    /// Supported modes, a bit each; 0 if the sheet lists none.
    modes: u32,
}

/// An object that stores a value, with its factory value.
#[derive(Clone, Debug)]
struct StoredObject {
    index: u16,
    default: FactoryValue,
}

impl DataSheet {
    /// The sheet with these entries, at most [`ENTRIES_MAX`], in ascending order. Its dictionary
    /// lives as long as the process.
    #[must_use]
    pub fn new(listed: &[DataSheetEntry], has_lss: bool) -> Self {
        let listed = &listed[..listed.len().min(ENTRIES_MAX)];
        let axes = (0..AXES_MAX)
            .take_while(|axis| {
                let offset = axis * AXIS_STEP;
                DRIVE
                    .iter()
                    .all(|index| listed.iter().any(|one| one.is_drive_object(index + offset)))
            })
            .count() as u16;
        let mut stored_objects = Vec::new();
        let entries: Vec<ObjectEntry> = listed
            .iter()
            .map(|one| one.to_entry(one.assign_tag(axes, &mut stored_objects)))
            .collect();
        let mut places = vec![0; (2 * entries.len()).next_power_of_two().max(2)];
        Dictionary::fill_slots(&entries, &mut places);
        Self {
            axes: (0..axes)
                .map(|axis| {
                    let offset = axis * AXIS_STEP;
                    let turn = listed_number((INCREMENTS.0 + offset, INCREMENTS.1), listed);
                    let turn = turn.and_then(|n| u32::try_from(n).ok()).filter(|n| *n > 0);
                    let turn = turn.unwrap_or(polepair_drives::cia402::objects::INCREMENTS as u32);
                    let values =
                        listed.iter().zip(&entries).filter(|(_, entry)| is_entry_of(entry, axis));
                    let values = values
                        .filter_map(|(one, entry)| Some((entry.tag % AXIS_TAGS, one.number()?)));
                    let modes =
                        listed_number((MODES.0 + offset, MODES.1), listed).unwrap_or(0) as u32;
                    DataSheetAxis { objects: Objects::from_defaults(values, turn), modes }
                })
                .collect(),
            dictionary: Box::leak(Box::new(Dictionary::new(entries.leak(), places.leak()))),
            stored_objects,
            has_lss,
        }
    }

    /// Returns whether there is a motor.
    #[must_use]
    pub const fn is_drive(&self) -> bool {
        !self.axes.is_empty()
    }
}

fn is_entry_of(entry: &ObjectEntry, axis: u16) -> bool {
    entry.tag / AXIS_TAGS == axis
}

fn listed_number(at: (u16, u8), listed: &[DataSheetEntry]) -> Option<i64> {
    listed.iter().find(|one| (one.index, one.sub) == at)?.number()
}

impl DataSheetEntry {
    /// Storage of its value: the protocol, the drive, or a cell of its own.
    fn assign_tag(&self, axes: u16, cells: &mut Vec<StoredObject>) -> u16 {
        if is_protocol_object(self.index, self.sub, PDOS_MAX as u16)
            && ValueType(self.data_type).bytes().is_some()
        {
            return PROTOCOL_TAG;
        }
        // The generic drive's own objects are in the makers' range.
        let place = self.index.checked_sub(FIRST_AXIS);
        let place = place.map(|at| (at / AXIS_STEP, FIRST_AXIS + at % AXIS_STEP));
        if let Some((axis, index)) = place.filter(|(axis, _)| *axis < axes && self.is_integer())
            && let Some(known) = DICTIONARY.find(index, self.sub)
            && known.tag < AXIS_TAGS
            // A sheet has modes of its own, which are not the generic drive's.
            && (index, self.sub) != MODES
        {
            return axis * AXIS_TAGS + known.tag;
        }
        cells.push(StoredObject { index: self.index, default: self.default.clone() });
        STORED_TAG_FIRST + (cells.len() - 1) as u16
    }

    fn to_entry(&self, tag: u16) -> ObjectEntry {
        let access = match (self.readable, self.writable) {
            (true, true) => ObjectAccess::RW,
            (false, true) => ObjectAccess::WO,
            (_, false) => ObjectAccess::RO,
        };
        let access = if self.tpdo_mappable { access.sendable() } else { access };
        let access = if self.rpdo_mappable { access.receivable() } else { access };
        let name: &'static str = self.name.clone().leak();
        let worth = match self.default {
            FactoryValue::PlusNodeId(number) => DefaultValue::PlusNode(number),
            _ => DefaultValue::Number(self.number().unwrap_or(0)),
        };
        ObjectEntry::new(self.index, self.sub, ValueType(self.data_type), access, tag, name)
            .with_default_value(worth)
            .with_limits(self.limits.0, self.limits.1)
    }

    fn number(&self) -> Option<i64> {
        match self.default {
            FactoryValue::Number(number) => Some(number),
            _ => None,
        }
    }

    /// A whole number of 32 bits at most.
    fn is_integer(&self) -> bool {
        matches!(self.data_type, 0x01..=0x07)
    }

    fn is_drive_object(&self, index: u16) -> bool {
        (self.index, self.sub) == (index, 0) && self.is_integer()
    }
}
