//! Makes a simulated device from a data sheet.

use super::object_types::DataType;
use super::{Eds, EdsEntry, EdsObject, Literal, ObjectType};
use crate::error::Error;
use crate::toml_file::FileError;
use polepair_sim::data_sheet::{DataSheet, DataSheetEntry, ENTRIES_MAX, FactoryValue};
use std::collections::HashSet;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Different sheets in one process at most: each lives as long as it.
const SHEETS_MAX: usize = 256;
/// Objects below are types, not values.
const TYPES_END: u16 = 0x1000;
/// The identity, its entries, and what `[DeviceInfo]` calls them.
const IDENTITY: (u16, [&str; 3]) = (0x1018, ["VendorNumber", "ProductNumber", "RevisionNumber"]);
/// The device's name.
const DEVICE_NAME: u16 = 0x1008;
/// Services whose identifiers contain the node-ID: the object's first and last index, sub-index, and
/// the identifier of node 0 with the distance to the next object's.
const SERVICES: [(u16, u16, u8, i64, i64); 5] = [
    (0x1014, 0x1014, 0, 0x80, 0),
    (0x1200, 0x1200, 1, 0x600, 0),
    (0x1200, 0x1200, 2, 0x580, 0),
    (0x1400, 0x1403, 1, 0x200, 0x100),
    (0x1800, 0x1803, 1, 0x180, 0x100),
];
/// Bits of a COB-ID that are the identifier.
const IDENTIFIER_MASK: i64 = 0x1FFF_FFFF;

/// The sheet of a file for simulated devices, and the file.
///
/// # Errors
/// [`FileError`] with line and reason.
pub(crate) fn load_sheet(path: &Path) -> Result<(Arc<DataSheet>, Eds), Error> {
    let eds = super::load(path)?;
    let sheet = cached_sheet(list_entries(&eds), has_lss(&eds))
        .map_err(|reason| FileError::for_file(path.display().to_string(), reason))?;
    Ok((sheet, eds))
}

/// Cached sheet of the same entries.
fn cached_sheet(listed: Vec<DataSheetEntry>, has_lss: bool) -> Result<Arc<DataSheet>, String> {
    type CachedSheet = (Vec<DataSheetEntry>, bool, Arc<DataSheet>);
    static SHEET_CACHE: Mutex<Vec<CachedSheet>> = Mutex::new(Vec::new());
    if listed.len() > ENTRIES_MAX {
        let count = listed.len();
        return Err(format!("{count} entries; a simulated device has {ENTRIES_MAX} at most"));
    }
    let mut stored = SHEET_CACHE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((.., sheet)) = stored.iter().find(|(l, lss, _)| (l, *lss) == (&listed, has_lss)) {
        return Ok(Arc::clone(sheet));
    }
    if stored.len() == SHEETS_MAX {
        return Err(format!("more than {SHEETS_MAX} sheets in one process"));
    }
    let sheet = Arc::new(DataSheet::new(&listed, has_lss));
    stored.push((listed, has_lss, Arc::clone(&sheet)));
    Ok(sheet)
}

/// Returns whether the device has LSS; true unless the sheet denies it.
fn has_lss(eds: &Eds) -> bool {
    eds.device_info("LSS_Supported").is_none_or(|word| word != "0")
}

/// Every entry of every object with values.
fn list_entries(eds: &Eds) -> Vec<DataSheetEntry> {
    let (sent, received) = (mapped_entries(eds, 0x1A00), mapped_entries(eds, 0x1600));
    let mut all = Vec::new();
    for object in eds.objects.iter().filter(|object| object.index >= TYPES_END) {
        for entry in object.entries.iter().filter(|_| object.kind != ObjectType::Null) {
            let at = (object.index, entry.sub);
            let writes = entry.access.is_writable();
            let (to, from) = entry.access.pdo_directions();
            all.push(DataSheetEntry {
                index: object.index,
                sub: entry.sub,
                data_type: type_code(entry.data_type),
                name: entry_name(object, entry),
                readable: entry.access.is_readable(),
                writable: writes,
                tpdo_mappable: (entry.mappable && to) || sent.contains(&at),
                rpdo_mappable: (entry.mappable && from) || received.contains(&at),
                limits: entry_limits(entry),
                default: default_value(eds, object, entry),
            });
        }
    }
    all.sort_by_key(|one| (one.index, one.sub));
    debug_assert!(all.is_sorted_by_key(|one| (one.index, one.sub)));
    // Some sheets list an object in two sections; the first one counts.
    all.dedup_by_key(|one| (one.index, one.sub));
    all
}

/// Objects that are mapped in the sheet; they can be mapped, independent of their `PDOMapping`.
fn mapped_entries(eds: &Eds, base: u16) -> HashSet<(u16, u8)> {
    let mappings = eds.objects.iter().filter(|object| (base..base + 0x200).contains(&object.index));
    let entries = mappings.flat_map(|object| object.entries.iter().filter(|entry| entry.sub > 0));
    let values = entries.filter_map(|entry| entry.effective_value()?.integer(0));
    values.map(|raw| ((raw >> 16) as u16, (raw >> 8) as u8)).collect()
}

/// Types of the file's own, and those of a length that no number has, are bytes.
fn type_code(data_type: DataType) -> u8 {
    match u8::try_from(data_type.0) {
        // A maker's own type is a number of bytes to everybody else.
        Ok(code) if data_type.name().is_some() => code,
        _ => DataType::BYTES.0 as u8,
    }
}

fn entry_name(object: &EdsObject, entry: &EdsEntry) -> String {
    if object.kind.has_subs() {
        format!("{} {}", object.name, entry.name)
    } else {
        object.name.clone()
    }
}

fn entry_limits(entry: &EdsEntry) -> (i64, i64) {
    match (literal_integer(&entry.low), literal_integer(&entry.high)) {
        // Limits that leave no value are none: files have 0 and 0 in unused fields.
        (Some(low), Some(high)) if low >= high => (i64::MIN, i64::MAX),
        (low, high) => (low.unwrap_or(i64::MIN), high.unwrap_or(i64::MAX)),
    }
}

fn literal_integer(literal: &Option<Literal>) -> Option<i64> {
    literal.as_ref().and_then(|it| it.integer(0))
}

fn default_value(eds: &Eds, object: &EdsObject, entry: &EdsEntry) -> FactoryValue {
    let factory_value =
        eds.value_of_any_node(entry).map(|value| literal_value(value, entry.data_type));
    let at = (object.index, entry.sub);
    match factory_value {
        Some(FactoryValue::Number(number)) if lacks_node(at, number) => {
            FactoryValue::PlusNodeId(number)
        }
        Some(factory_value) => factory_value,
        None if at.1 == 0 && object.kind.has_subs() => highest_sub_index(object),
        None => device_info_value(eds, at).unwrap_or(match entry.data_type.bits() {
            Some(_) => FactoryValue::Unset,
            None => FactoryValue::Bytes(Vec::new()),
        }),
    }
}

/// An identifier that only node 0 could have: the node-ID was forgotten.
fn lacks_node(at: (u16, u8), value: i64) -> bool {
    let (index, sub) = at;

    SERVICES.iter().any(|(first, last, at, base, step)| {
        let is_it = (*first..=*last).contains(&index) && sub == *at;
        is_it && value & IDENTIFIER_MASK == base + step * i64::from(index - first)
    })
}

/// Default of sub-index 0 without a value: the number of mapped objects of a PDO, or the highest sub-index.
fn highest_sub_index(object: &EdsObject) -> FactoryValue {
    let is_mapping = matches!(object.index, 0x1600..=0x17FF | 0x1A00..=0x1BFF);
    // Its sub-index 0 counts the errors so far, of which there are none (CiA 301, 1003h).
    let is_history = object.index == 0x1003;
    let last = object
        .entries
        .iter()
        .filter(|entry| {
            entry.sub > 0
                && (!is_mapping || entry.effective_value().is_some_and(|v| v.integer(0) != Some(0)))
        })
        .map(|entry| entry.sub)
        .max()
        .unwrap_or(0);
    FactoryValue::Number(if is_history { 0 } else { last.into() })
}

/// Values from `[DeviceInfo]`: name and numbers of the device.
fn device_info_value(eds: &Eds, at: (u16, u8)) -> Option<FactoryValue> {
    let (index, sub) = at;

    if (index, sub) == (DEVICE_NAME, 0) {
        return Some(FactoryValue::Bytes(latin1(eds.device_info("ProductName")?)));
    }
    let key = IDENTITY.1.get(usize::from(sub).checked_sub(1)?)?;
    let number = super::value::parse_integer(eds.device_info(key)?)?.value;
    (index == IDENTITY.0).then_some(FactoryValue::Number(number))
}

fn literal_value(literal: &Literal, data_type: DataType) -> FactoryValue {
    match literal {
        Literal::Integer { value, plus_node: true, .. } => FactoryValue::PlusNodeId(*value),
        Literal::Integer { value, .. } => FactoryValue::Number(*value),
        Literal::Text(text) => text_value(text, data_type),
    }
}

fn text_value(text: &str, data_type: DataType) -> FactoryValue {
    match data_type {
        DataType::F32 => {
            FactoryValue::Number(text.parse::<f32>().map_or(0, |real| real.to_bits().into()))
        }
        DataType::F64 => {
            FactoryValue::Number(text.parse::<f64>().map_or(0, |real| real.to_bits().cast_signed()))
        }
        DataType::UNICODE => {
            FactoryValue::Bytes(text.encode_utf16().flat_map(u16::to_le_bytes).collect())
        }
        DataType::BYTES => {
            FactoryValue::Bytes(parse_hex_bytes(text).unwrap_or_else(|| latin1(text)))
        }
        // What a domain holds from the factory is a file's name, which stays the vendor's.
        DataType::DOMAIN => FactoryValue::Bytes(Vec::new()),
        _ if data_type.bits().is_some() => super::value::parse_integer(text)
            .map_or(FactoryValue::Unset, |number| FactoryValue::Number(number.value)),
        _ => FactoryValue::Bytes(latin1(text)),
    }
}

/// Bytes as pairs of hexadecimal digits, apart or together.
fn parse_hex_bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u32> = text
        .chars()
        .filter(|c| !c.is_whitespace())
        .map(|c| c.to_digit(16))
        .collect::<Option<_>>()?;
    let pairs = digits.chunks(2).map(|pair| Some((pair[0] << 4 | pair.get(1)?) as u8));
    pairs.collect()
}

/// One byte for each character, as visible strings have them.
fn latin1(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')).collect()
}
