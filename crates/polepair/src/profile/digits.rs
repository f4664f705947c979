//! Values that are words of decimal digits, each with a meaning of its own.

use super::draft::{DraftDigits, own_words};
use super::resolve::leak_words;
use crate::toml_file::{FileError, TomlTable, parse_number};
use polepair_core::profile::DigitField;

/// Most digits of a field: more do not fit into 32 bits.
const PLACES_MAX: i64 = 9;

/// Reads the fields of a parameter, the rightmost first.
pub(super) fn read(table: &TomlTable<'_, '_>) -> Result<Vec<DraftDigits>, FileError> {
    let fields = table.tables("digits", &["name", "places", "max", "values"])?;
    fields.iter().map(read_field).collect()
}

fn read_field(node: &TomlTable<'_, '_>) -> Result<DraftDigits, FileError> {
    let name = node.required_text("name")?.value;
    let places = node.integer_between("places", 1, PLACES_MAX)?.unwrap_or(1) as u32;
    let values = read_values(node)?;
    let limit = 10_i64.pow(places) - 1;
    let greatest = values.last().map_or(limit, |(raw, _)| *raw);
    let max = node.integer_between("max", 1, limit)?.unwrap_or(greatest);
    if let Some((raw, word)) = values.iter().find(|(raw, _)| !(0..=max).contains(raw)) {
        let reason = format!("value {raw} (`{word}`) of `{name}` is not within 0 to {max}");
        return Err(node.location().error(reason));
    }
    Ok(DraftDigits { name, places, max, values })
}

/// Reads names of raw values.
pub(super) fn read_values(table: &TomlTable<'_, '_>) -> Result<Vec<(i64, String)>, FileError> {
    let Some(node) = table.table("values", &[])? else { return Ok(Vec::new()) };
    let mut values = Vec::new();
    for key in node.keys() {
        let word = node.required_text(key.value)?.value;
        let raw = key.try_map(|key| {
            parse_number(key).ok_or_else(|| format!("`{key}` is not a whole number, decimal or 0x"))
        })?;
        values.push((raw, word));
    }
    // TOML tables have no order, and two runs must make the same file.
    values.sort();
    Ok(values)
}

pub(super) fn copy(field: &DigitField) -> DraftDigits {
    let DigitField { name, places, max, values } = *field;
    DraftDigits { name: name.into(), places, max, values: own_words(values) }
}

pub(super) fn leak(digits: &[DraftDigits]) -> &'static [DigitField] {
    let fields = digits.iter().map(|field| {
        let DraftDigits { name, places, max, values } = field;
        DigitField {
            name: String::leak(name.clone()),
            places: *places,
            max: *max,
            values: leak_words(values),
        }
    });
    fields.collect::<Vec<_>>().leak()
}
