//! Names of bits, and of patterns of several, in a word.

use super::draft::DraftBits;
use crate::toml_file::{FileError, TomlTable};
use polepair_core::profile::BitName;

/// Most significant bit that a profile can name.
const BIT_MAX: i64 = 62;

/// Reads the names of a parameter: `{ bit = 10, name = "…" }`, or `{ mask = 0x6F, equals = 0x27, name = "…" }`.
pub(super) fn read(table: &TomlTable<'_, '_>) -> Result<Vec<DraftBits>, FileError> {
    let names = table.tables("bits", &["bit", "mask", "equals", "name"])?;
    names.iter().map(read_name).collect()
}

fn read_name(node: &TomlTable<'_, '_>) -> Result<DraftBits, FileError> {
    let name = node.required_text("name")?.value;
    let bit = node.integer_between("bit", 0, BIT_MAX)?;
    let mask = node.integer_between("mask", 1, i64::MAX)?;
    let equals = node.integer_between("equals", 0, i64::MAX)?;
    match (bit, mask, equals) {
        (Some(bit), None, None) => Ok(DraftBits { mask: 1 << bit, value: 1 << bit, name }),
        (None, Some(mask), Some(value)) if value & !mask == 0 => {
            Ok(DraftBits { mask, value, name })
        }
        (None, Some(mask), Some(value)) => {
            let reason = format!("`{name}`: 0x{value:X} has bits that the mask 0x{mask:X} has not");
            Err(node.location().error(reason))
        }
        _ => {
            let reason = format!("`{name}` needs `bit`, or `mask` and `equals`");
            Err(node.location().error(reason))
        }
    }
}

pub(super) fn copy(known: &BitName) -> DraftBits {
    DraftBits { mask: known.mask, value: known.value, name: known.name.into() }
}

pub(super) fn leak(bits: &[DraftBits]) -> &'static [BitName] {
    let names = bits.iter().map(|known| {
        let DraftBits { mask, value, name } = known;
        BitName { mask: *mask, value: *value, name: String::leak(name.clone()) }
    });
    names.collect::<Vec<_>>().leak()
}
