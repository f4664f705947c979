//! The data sheet of a drive on a link: its profile's objects, and the identity that it reports.

use std::collections::BTreeMap;

use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{Access, Encoding, Parameter, ParameterId};

use super::object_types::{DataType, ObjectAccess, ObjectType};
use super::value::Literal;
use super::{Eds, EdsEntry, EdsObject};
use crate::axis::LocalAxis;
use crate::error::Error;

/// Identity object: vendor, product, revision, serial number (CiA 301 §7.5.2.21).
const IDENTITY: u16 = 0x1018;
const IDENTITY_NAMES: [&str; 5] =
    ["Number of entries", "Vendor-ID", "Product code", "Revision number", "Serial number"];
/// Objects that every device has, besides the identity.
const DEVICE_TYPE: u16 = 0x1000;
const ERROR_REGISTER: u16 = 0x1001;
/// First object of the device profile.
const DEVICE_PROFILE: u16 = 0x6000;
/// Bit rates of a sheet, kbit/s.
const BIT_RATES: [u32; 8] = [10, 20, 50, 125, 250, 500, 800, 1000];

/// Values of a sheet.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SheetValues {
    /// None: an EDS, which describes all devices of this kind.
    None,
    /// The present values of the drive: a DCF of this node.
    OfDrive,
}

impl Eds {
    /// The data sheet of a drive. `progress` gets the number of objects read, and of all.
    ///
    /// # Errors
    /// [`Error::Usage`] `E248` for a drive on another protocol than CANopen; others by source.
    pub fn of_drive(
        axis: &LocalAxis,
        values: SheetValues,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Self, Error> {
        if axis.protocol() != crate::lss::PROTOCOL {
            let what = format!("{}: a data sheet is of a CANopen drive", axis.label());
            return Err(Error::usage("E248", what, "`polepair params` lists its parameters"));
        }
        let identity = read_identity(axis)?;
        let profile = axis.profile();
        let mut sheet = Self {
            file: pairs(&[
                ("FileName", &format!("{}.{}", profile.name, extension(values))),
                ("FileVersion", "1"),
                ("FileRevision", "0"),
                ("EDSVersion", "4.0"),
                ("Description", profile.title),
                ("CreatedBy", "Polepair"),
            ]),
            comments: vec![
                format!("Written by Polepair from its profile {}:", profile.name),
                "objects that the profile does not name are missing. Bit rates, and which"
                    .to_owned(),
                "objects of the device profile a PDO may carry, are inferred.".to_owned(),
            ],
            ..Self::default()
        };
        let mut objects = BTreeMap::<u16, Vec<EdsEntry>>::new();
        let parameters: Vec<_> = (0..).map(ParameterId).zip(profile.parameters).collect();
        for (n, &(id, parameter)) in parameters.iter().enumerate() {
            progress(n, parameters.len());
            let Some(mut entry) = parameter_entry(parameter) else { continue };
            if values == SheetValues::OfDrive && parameter.access == Access::ReadWrite {
                match read_value(axis, id)? {
                    Some(raw) => entry.value = literal(parameter.encoding, raw),
                    // The drive does not have it.
                    None => continue,
                }
            }
            objects.entry(parameter.index).or_default().push(entry);
        }
        for (index, name, data_type) in
            [(DEVICE_TYPE, "Device type", 0x07), (ERROR_REGISTER, "Error register", 0x05)]
        {
            objects.entry(index).or_insert_with(|| vec![read_only(0, name, DataType(data_type))]);
        }
        objects.insert(IDENTITY, identity_entries(identity));
        sheet.objects =
            objects.into_iter().map(|(index, entries)| object(index, entries)).collect();
        sheet.device = device_section(&sheet, axis, identity);
        if values == SheetValues::OfDrive {
            sheet.commissioning = pairs(&[
                ("NodeID", &axis.number().to_string()),
                ("NodeName", axis.name()),
                ("NetNumber", "1"),
                ("CANopenManager", "0"),
            ]);
        }
        Ok(sheet)
    }
}

const fn extension(values: SheetValues) -> &'static str {
    match values {
        SheetValues::None => "eds",
        SheetValues::OfDrive => "dcf",
    }
}

fn pairs(lines: &[(&str, &str)]) -> Vec<(String, String)> {
    lines.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect()
}

fn device_section(
    sheet: &Eds,
    axis: &LocalAxis,
    identity: [Option<i64>; 4],
) -> Vec<(String, String)> {
    let number =
        |at: usize| identity[at].map_or_else(|| "0".to_owned(), |raw| format!("0x{raw:X}"));
    let count = |first: u16| {
        let last = first + 0x1FF;
        sheet.objects.iter().filter(|it| (first..=last).contains(&it.index)).count().to_string()
    };
    let mut lines = pairs(&[
        ("VendorName", ""),
        ("VendorNumber", &number(0)),
        ("ProductName", axis.profile().title),
        ("ProductNumber", &number(1)),
        ("RevisionNumber", &number(2)),
        ("OrderCode", ""),
    ]);
    let rates = axis.profile().parameters.iter().find(|parameter| parameter.name == "can bit rate");
    lines.extend(BIT_RATES.map(|rate| {
        let has_rate = rates.is_none_or(|limits| limits.allows(rate.into()));
        (format!("BaudRate_{rate}"), u8::from(has_rate).to_string())
    }));
    lines.extend(pairs(&[
        ("SimpleBootUpMaster", "0"),
        ("SimpleBootUpSlave", "1"),
        ("Granularity", "8"),
        ("DynamicChannelsSupported", "0"),
        ("GroupMessaging", "0"),
        ("NrOfRXPDO", &count(0x1400)),
        ("NrOfTXPDO", &count(0x1800)),
        ("LSS_Supported", "0"),
    ]));
    lines
}

/// Reads a value. `None` if the drive refuses it.
fn read_value(axis: &LocalAxis, id: ParameterId) -> Result<Option<i64>, Error> {
    match axis.read(id) {
        Ok(raw) => Ok(Some(raw)),
        Err(Error::Failed { outcome: Outcome::NotDone(Failure::Refused { .. }), .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Reads vendor, product, revision and serial number, as far as the drive has them.
fn read_identity(axis: &LocalAxis) -> Result<[Option<i64>; 4], Error> {
    let mut identity = [None; 4];
    for (sub, slot) in (1..).zip(&mut identity) {
        let id = axis.find(&format!("0x{IDENTITY:04X}:{sub}:u32"))?;
        *slot = read_value(axis, id)?;
    }
    Ok(identity)
}

fn identity_entries(identity: [Option<i64>; 4]) -> Vec<EdsEntry> {
    // The vendor is the entry that no device may lack.
    let last = identity.iter().rposition(Option::is_some).map_or(1, |at| at + 1);
    let mut entries = vec![EdsEntry {
        default: Some(decimal(last as i64)),
        ..read_only(0, IDENTITY_NAMES[0], DataType::U8)
    }];
    for sub in 1..=last {
        let raw = identity[sub - 1].unwrap_or(0);
        let default =
            (sub < 4).then_some(Literal::Integer { value: raw, plus_node: false, hex: true });
        entries.push(EdsEntry {
            default,
            ..read_only(sub as u8, IDENTITY_NAMES[sub], DataType(0x07))
        });
    }
    entries
}

fn read_only(sub: u8, name: &str, data_type: DataType) -> EdsEntry {
    EdsEntry {
        sub,
        name: name.to_owned(),
        data_type,
        access: ObjectAccess::Ro,
        mappable: false,
        low: None,
        high: None,
        default: None,
        value: None,
        others: Vec::new(),
    }
}

/// The entry of a parameter; `None` for a type that no sheet has.
fn parameter_entry(parameter: &Parameter) -> Option<EdsEntry> {
    let data_type = data_type(parameter.encoding)?;
    let access = match parameter.access {
        Access::Read => ObjectAccess::Ro,
        Access::Write => ObjectAccess::Wo,
        Access::ReadWrite => ObjectAccess::Rw,
    };
    let limited = |limit: i64, end: i64| (limit != end).then(|| decimal(limit));
    let (low, high) = data_type.range().map_or((None, None), |(low, high)| {
        (limited(parameter.min, low), limited(parameter.max, high))
    });
    Some(EdsEntry {
        access,
        low,
        high,
        mappable: parameter.index >= DEVICE_PROFILE && data_type.bits().is_some(),
        default: parameter.default.and_then(|raw| literal(parameter.encoding, raw)),
        ..read_only(parameter.space, parameter.name, data_type)
    })
}

const fn decimal(value: i64) -> Literal {
    Literal::Integer { value, plus_node: false, hex: false }
}

fn literal(encoding: Encoding, raw: i64) -> Option<Literal> {
    match encoding {
        Encoding::F32 | Encoding::F64 | Encoding::Text | Encoding::Bytes => None,
        _ => Some(decimal(raw)),
    }
}

fn data_type(encoding: Encoding) -> Option<DataType> {
    Some(DataType(match encoding {
        Encoding::I8 => 0x02,
        Encoding::I16 => 0x03,
        Encoding::I32 => 0x04,
        Encoding::U8 => 0x05,
        Encoding::U16 => 0x06,
        Encoding::U32 => 0x07,
        Encoding::F32 => 0x08,
        Encoding::Text => 0x09,
        Encoding::Bytes => 0x0A,
        Encoding::F64 => 0x11,
        Encoding::I64 => 0x15,
        Encoding::U64 => 0x1B,
        _ => return None,
    }))
}

/// An object of its entries: a variable, or a record whose sub-index 0 counts them.
fn object(index: u16, mut entries: Vec<EdsEntry>) -> EdsObject {
    entries.sort_by_key(|entry| entry.sub);
    let is_variable = entries.len() == 1 && entries[0].sub == 0;
    let name = if is_variable { entries[0].name.clone() } else { record_name(index, &entries) };
    if !is_variable && entries[0].sub != 0 {
        let last = entries.last().map_or(0, |entry| entry.sub);
        let count = read_only(0, "Number of entries", DataType::U8);
        entries.insert(0, EdsEntry { default: Some(decimal(last.into())), ..count });
    }
    let kind = if is_variable { ObjectType::Variable } else { ObjectType::Record };
    EdsObject { index, name, kind, flags: 0, entries, others: Vec::new() }
}

/// Words that the names of the entries have in common, or the index.
fn record_name(index: u16, entries: &[EdsEntry]) -> String {
    if index == IDENTITY {
        return "Identity object".to_owned();
    }
    let first = entries.last().map_or("", |entry| entry.name.as_str());
    let common = entries.iter().fold(first.len(), |length, entry| {
        let same = entry.name.bytes().zip(first.bytes()).take_while(|(a, b)| a == b).count();
        length.min(same)
    });
    // Whole words alone.
    let words =
        first.get(..common).and_then(|same| same.rsplit_once(' ')).map_or("", |(words, _)| words);
    if words.is_empty() || entries.len() == 1 {
        format!("Object {index:04X}h")
    } else {
        words.to_owned()
    }
}
