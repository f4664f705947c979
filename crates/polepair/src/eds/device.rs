//! A simulated device out of a data sheet.

use super::kind::DataType;
use super::{Eds, Entry, Literal, Object, ObjectType};
use crate::error::Error;
use crate::file::FileError;
use polepair_sim::sheet::{ENTRIES_MAX, Holds, Listed, Sheet};
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
const NAME: u16 = 0x1008;
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
const IDENTIFIER: i64 = 0x1FFF_FFFF;

/// The sheet of a file for simulated devices, and the file.
///
/// # Errors
/// [`FileError`] with line and reason.
pub(crate) fn sheet(path: &Path) -> Result<(Arc<Sheet>, Eds), Error> {
    let eds = super::load(path)?;
    let sheet = kept(listed(&eds), has_lss(&eds))
        .map_err(|reason| FileError::whole(path.display().to_string(), reason))?;
    Ok((sheet, eds))
}

/// The same sheet again for the same entries.
fn kept(listed: Vec<Listed>, has_lss: bool) -> Result<Arc<Sheet>, String> {
    type Known = (Vec<Listed>, bool, Arc<Sheet>);
    static KEPT: Mutex<Vec<Known>> = Mutex::new(Vec::new());
    if listed.len() > ENTRIES_MAX {
        let count = listed.len();
        return Err(format!("{count} entries; a simulated device has {ENTRIES_MAX} at most"));
    }
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((.., sheet)) = kept.iter().find(|(l, lss, _)| (l, *lss) == (&listed, has_lss)) {
        return Ok(Arc::clone(sheet));
    }
    if kept.len() == SHEETS_MAX {
        return Err(format!("more than {SHEETS_MAX} sheets in one process"));
    }
    let sheet = Arc::new(Sheet::new(&listed, has_lss));
    kept.push((listed, has_lss, Arc::clone(&sheet)));
    Ok(sheet)
}

/// Unless the sheet says that it has none.
fn has_lss(eds: &Eds) -> bool {
    eds.device_info("LSS_Supported").is_none_or(|word| word != "0")
}

/// Every entry of every object with values.
fn listed(eds: &Eds) -> Vec<Listed> {
    let (sent, received) = (mapped(eds, 0x1A00), mapped(eds, 0x1600));
    let mut all = Vec::new();
    for object in eds.objects.iter().filter(|object| object.index >= TYPES_END) {
        for entry in object.entries.iter().filter(|_| object.kind != ObjectType::Null) {
            let at = (object.index, entry.sub);
            let writes = entry.access.writes();
            let (to, from) = entry.access.directions();
            all.push(Listed {
                index: object.index,
                sub: entry.sub,
                kind: kind(entry.data_type),
                name: name(object, entry),
                reads: entry.access.reads(),
                writes,
                sends: (entry.mappable && to) || sent.contains(&at),
                receives: (entry.mappable && from) || received.contains(&at),
                limits: limits(entry),
                worth: worth(eds, object, entry),
            });
        }
    }
    all.sort_by_key(|one| (one.index, one.sub));
    all.dedup_by_key(|one| (one.index, one.sub));
    all
}

/// What the PDOs map from the factory: that can be mapped, whatever its entry says.
fn mapped(eds: &Eds, base: u16) -> HashSet<(u16, u8)> {
    let mappings = eds.objects.iter().filter(|object| (base..base + 0x200).contains(&object.index));
    let entries = mappings.flat_map(|object| object.entries.iter().filter(|entry| entry.sub > 0));
    let values = entries.filter_map(|entry| entry.first_value()?.integer(0));
    values.map(|raw| ((raw >> 16) as u16, (raw >> 8) as u8)).collect()
}

/// Types of the file's own, and those of a length that no number has, are bytes.
fn kind(data_type: DataType) -> u8 {
    match u8::try_from(data_type.0) {
        Ok(code) if data_type.name().is_some() => code,
        _ => DataType::BYTES.0 as u8,
    }
}

fn name(object: &Object, entry: &Entry) -> String {
    match object.kind.has_subs() {
        true => format!("{} {}", object.name, entry.name),
        false => object.name.clone(),
    }
}

fn limits(entry: &Entry) -> (i64, i64) {
    let whole = |literal: &Option<Literal>| literal.as_ref().and_then(|it| it.integer(0));
    match (whole(&entry.low), whole(&entry.high)) {
        // Limits that leave nothing are none: files have 0 and 0 where nobody filled them in.
        (Some(low), Some(high)) if low >= high => (i64::MIN, i64::MAX),
        (low, high) => (low.unwrap_or(i64::MIN), high.unwrap_or(i64::MAX)),
    }
}

fn worth(eds: &Eds, object: &Object, entry: &Entry) -> Holds {
    let told = entry.first_value().map(|value| holds(value, entry.data_type));
    let at = (object.index, entry.sub);
    match told {
        Some(Holds::Number(number)) if lacks_node(at, number) => Holds::PlusNode(number),
        Some(told) => told,
        None if at.1 == 0 && object.kind.has_subs() => highest(object),
        None => of_device(eds, at).unwrap_or(match entry.data_type.bits() {
            Some(_) => Holds::Nothing,
            None => Holds::Bytes(Vec::new()),
        }),
    }
}

/// An identifier that only node 0 could have: the node-ID was forgotten.
fn lacks_node((index, sub): (u16, u8), value: i64) -> bool {
    SERVICES.iter().any(|(first, last, at, base, step)| {
        let is_it = (*first..=*last).contains(&index) && sub == *at;
        is_it && value & IDENTIFIER == base + step * i64::from(index - first)
    })
}

/// Sub-index 0 of which no value is told: how many objects a PDO maps, or the highest sub-index.
fn highest(object: &Object) -> Holds {
    let is_mapping = matches!(object.index, 0x1600..=0x17FF | 0x1A00..=0x1BFF);
    let is_history = object.index == 0x1003;
    let counts = |entry: &&Entry| {
        entry.sub > 0
            && (!is_mapping || entry.first_value().is_some_and(|v| v.integer(0) != Some(0)))
    };
    let last = object.entries.iter().filter(counts).map(|entry| entry.sub).max().unwrap_or(0);
    Holds::Number(if is_history { 0 } else { last.into() })
}

/// What `[DeviceInfo]` tells of the device's name and numbers.
fn of_device(eds: &Eds, (index, sub): (u16, u8)) -> Option<Holds> {
    if (index, sub) == (NAME, 0) {
        return Some(Holds::Bytes(latin1(eds.device_info("ProductName")?)));
    }
    let key = IDENTITY.1.get(usize::from(sub).checked_sub(1)?)?;
    let number = super::value::number(eds.device_info(key)?)?.value;
    (index == IDENTITY.0).then_some(Holds::Number(number))
}

fn holds(literal: &Literal, data_type: DataType) -> Holds {
    match literal {
        Literal::Integer { value, plus_node: true, .. } => Holds::PlusNode(*value),
        Literal::Integer { value, .. } => Holds::Number(*value),
        Literal::Text(text) => of_text(text, data_type),
    }
}

fn of_text(text: &str, data_type: DataType) -> Holds {
    match data_type {
        DataType::F32 => Holds::Number(text.parse::<f32>().map_or(0, |real| real.to_bits().into())),
        DataType::F64 => {
            Holds::Number(text.parse::<f64>().map_or(0, |real| real.to_bits().cast_signed()))
        }
        DataType::UNICODE => Holds::Bytes(text.encode_utf16().flat_map(u16::to_le_bytes).collect()),
        DataType::BYTES => Holds::Bytes(bytes(text).unwrap_or_else(|| latin1(text))),
        // What a domain holds from the factory is a file's name, which stays the vendor's.
        DataType::DOMAIN => Holds::Bytes(Vec::new()),
        _ if data_type.bits().is_some() => {
            super::value::number(text).map_or(Holds::Nothing, |number| Holds::Number(number.value))
        }
        _ => Holds::Bytes(latin1(text)),
    }
}

/// Bytes as pairs of hexadecimal digits, apart or together.
fn bytes(text: &str) -> Option<Vec<u8>> {
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
