//! Makes a profile from a data sheet: named objects, and the verbs of CiA 402 for a drive.

use super::object_types::DataType;
use super::{Eds, EdsEntry, EdsObject, Literal};
use crate::profile::draft::{Draft, DraftIdentity, DraftParameter};
use crate::profile::{name_from_path, remove_missing};
use crate::spelling::fold;
use crate::toml_file::{FileError, FileLocation, Located};
use polepair_core::profile::{Access, Certainty, Encoding, Persistence, Profile};
use polepair_core::units::Unit;
use std::collections::HashSet;
use std::path::Path;

/// Base profile of a device.
const DEVICE_PROFILE: &str = "canopen";
/// Base profile of a drive.
const DRIVE_PROFILE: &str = "cia402";
/// Base profile of a drive that has the velocity mode, and no other for speeds.
const INVERTER_PROFILE: &str = "cia402-vl";
/// The parameter that identifies the product.
const PRODUCT_CODE: &str = "product code";

/// The draft of the device that a file describes.
pub(crate) fn draft_profile(path: &Path) -> Result<Draft, FileError> {
    let eds = super::load(path)?;
    let position = FileLocation::built_in(&path.display().to_string());
    let base = base_profile(&eds)
        .ok_or_else(|| position.error("no profile of CANopen devices to build on"))?;
    let mut draft = Draft::from_profile(base);
    draft.name = name_from_path(path);
    let words = [eds.device_info("VendorName"), eds.device_info("ProductName")];
    let title: Vec<&str> = words.into_iter().flatten().collect();
    draft.title = if title.is_empty() { draft.name.clone() } else { title.join(" ") };
    draft.source = position.file().to_owned();
    let known = std::mem::take(&mut draft.parameters);
    let mut names = HashSet::new();
    for (object, entry, encoding) in typed_entries(&eds) {
        let mut parameter = match known
            .iter()
            .find(|p| (p.index, p.space) == (object.index, entry.sub))
        {
            Some(parameter) => DraftParameter { location: position.clone(), ..parameter.clone() },
            None => sheet_parameter(object, entry, &position),
        };
        // Vendors use one name for many entries, such as "Reserved".
        if !names.insert(fold(&parameter.name)) {
            parameter.name = format!("{} ({})", parameter.name, symbol(object.index, entry.sub));
        }
        apply_entry(&mut parameter, entry, encoding);
        draft.parameters.push(parameter);
    }
    draft.identity = identity(&eds, &draft, &position);
    draft.location = position;
    remove_missing(&mut draft);
    Ok(draft)
}

/// Returns whether simulated drives of a profile can be what a sheet lists: those that have nothing of their own.
pub(crate) fn accepts_sheet(profile: &Profile) -> bool {
    [DEVICE_PROFILE, DRIVE_PROFILE].contains(&profile.name)
}

/// The base profile of the device type in the sheet.
fn base_profile(eds: &Eds) -> Option<&'static Profile> {
    // Without a device type the controlword shows a drive.
    let kind = eds.entry(0x1000, 0).and_then(|entry| entry.default_at(1)).unwrap_or(0);
    let is_drive = kind & 0xFFFF == 402 || (kind == 0 && eds.object(0x6040).is_some());
    let has = |index| eds.object(index).is_some();
    let is_inverter = has(0x6042) && !has(0x60FF) && !has(0x607A);
    let name = match (is_drive, is_inverter) {
        (true, true) => INVERTER_PROFILE,
        (true, false) => DRIVE_PROFILE,
        (false, _) => DEVICE_PROFILE,
    };
    let generic = crate::registry::protocols().into_iter().map(|protocol| protocol.generic);
    let mut all = polepair_drives::profiles().iter().copied().chain(generic);
    all.find(|profile| profile.name == name)
}

/// Entries of a type that parameters have; others are read by their address.
fn typed_entries(eds: &Eds) -> impl Iterator<Item = (&EdsObject, &EdsEntry, Encoding)> {
    let entries =
        eds.objects.iter().flat_map(|object| object.entries.iter().map(move |e| (object, e)));
    entries.filter_map(|(object, entry)| Some((object, entry, encoding(entry.data_type)?)))
}

/// Encoding of a data type on the wire; `None` for types that parameters do not have.
pub(crate) fn encoding(kind: DataType) -> Option<Encoding> {
    Some(match kind.0 {
        0x01 | 0x05 => Encoding::U8,
        0x02 => Encoding::I8,
        0x03 => Encoding::I16,
        0x04 => Encoding::I32,
        0x06 => Encoding::U16,
        0x07 => Encoding::U32,
        0x08 => Encoding::F32,
        0x09 => Encoding::Text,
        0x0A | 0x0B | 0x0F => Encoding::Bytes,
        0x11 => Encoding::F64,
        0x15 => Encoding::I64,
        0x1B => Encoding::U64,
        _ => return None,
    })
}

/// The entries of which no parameter is made, and why.
pub(super) fn left_out_entries(file: &str, eds: &Eds) -> Vec<FileError> {
    let entries =
        eds.objects.iter().flat_map(|object| object.entries.iter().map(move |e| (object, e)));
    let unknown = entries.filter(|(_, entry)| encoding(entry.data_type).is_none());
    unknown
        .map(|(object, entry)| {
            let at = symbol(object.index, entry.sub);
            let kind = match entry.data_type.name() {
                Some(name) => format!("the type {name}"),
                None => format!("a type of its own, 0x{:04X}", entry.data_type.0),
            };
            let reason = format!("{at} ({}) has {kind}: left out; `{at}` reads it", entry.name);
            FileError::for_file(file, reason)
        })
        .collect()
}

/// An object that only the sheet describes. An object that a PDO may write is treated as motion.
fn sheet_parameter(
    object: &EdsObject,
    entry: &EdsEntry,
    position: &FileLocation,
) -> DraftParameter {
    let name = if object.kind.has_subs() {
        format!("{} {}", object.name, entry.name)
    } else {
        object.name.clone()
    };
    let process = entry.access.is_writable() && entry.mappable;
    let is_setting =
        entry.access.is_writable() && !process && !(0x1400..0x1C00).contains(&object.index);
    let (min, max) = Encoding::U32.raw_range();
    DraftParameter {
        location: position.clone(),
        name,
        symbol: symbol(object.index, entry.sub),
        about: String::new(),
        space: entry.sub,
        index: object.index,
        encoding: Encoding::U32,
        unit: Unit::None,
        factor: 1.0,
        negative: None,
        times: None,
        over: None,
        rule: None,
        min,
        max,
        default: None,
        access: Access::ReadWrite,
        persistence: if is_setting { Persistence::Storable } else { Persistence::Volatile },
        certainty: Certainty::Documented,
        moves: process,
        section: String::new(),
        values: Vec::new(),
        digits: Vec::new(),
        bits: Vec::new(),
    }
}

/// `6040h`, `1018h:1`.
pub(crate) fn symbol(index: u16, sub: u8) -> String {
    if sub == 0 { format!("{index:04X}h") } else { format!("{index:04X}h:{sub:X}") }
}

/// Type, limits, default and access as the sheet has them.
fn apply_entry(parameter: &mut DraftParameter, entry: &EdsEntry, encoding: Encoding) {
    if parameter.encoding != encoding {
        parameter.encoding = encoding;
        (parameter.min, parameter.max) = encoding.raw_range();
    }
    if let (Some(low), Some(high)) =
        (raw_literal(&entry.low, encoding), raw_literal(&entry.high, encoding))
        && encoding.number(low) < encoding.number(high)
    {
        (parameter.min, parameter.max) = (low, high);
    }
    // What process data are is as this node is configured, where the sheet is one node's.
    let process = (0x1400..0x1C00).contains(&parameter.index);
    let default = if process { entry.effective_value() } else { entry.default.as_ref() };
    // A value that depends on the node-ID is none of the product.
    let default = default.filter(|it| it.integer(0) == it.integer(1));
    parameter.default = default.and_then(|it| raw_value(encoding, it, 0));
    parameter.default = parameter
        .default
        .filter(|default| encoding.is_between(*default, parameter.min, parameter.max));
    parameter.access = match (entry.access.is_readable(), entry.access.is_writable()) {
        (true, false) => Access::Read,
        (false, _) => Access::Write,
        (true, true) => Access::ReadWrite,
    };
}

fn raw_literal(literal: &Option<Literal>, encoding: Encoding) -> Option<i64> {
    // Limits that depend on the node are not limits of the product.
    raw_value(encoding, literal.as_ref()?, 0)
}

/// The raw value that a literal means for an encoding; `None` for text and bytes.
pub(crate) fn raw_value(encoding: Encoding, literal: &Literal, node: u8) -> Option<i64> {
    match literal {
        Literal::Text(text) if encoding.is_real() => encoding.raw(text.parse().ok()?),
        other if encoding.is_number() => other.integer(node),
        _ => None,
    }
}

/// The product number, where the sheet has one and the device can be asked.
fn identity(eds: &Eds, draft: &Draft, position: &FileLocation) -> Option<DraftIdentity> {
    let number = super::value::parse_integer(eds.device_info("ProductNumber")?)?.value;
    let known = draft.parameters.iter().any(|p| p.name == PRODUCT_CODE);
    let parameter = Located { value: PRODUCT_CODE.to_owned(), location: position.clone() };
    // Zero means "not filled in" in many sheets, and would fit any such device.
    (known && number != 0).then(|| DraftIdentity {
        parameter: Some(parameter),
        text: String::new(),
        mask: 0xFFFF_FFFF,
        equals: number & 0xFFFF_FFFF,
        firmware: 0,
    })
}
