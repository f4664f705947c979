//! Electronic data sheets of CANopen devices (EDS) and configurations of nodes (DCF), CiA 306-1.
//!
//! Vendors' files often break the standard. An unambiguous mistake is corrected with a warning that names the
//! line. An ambiguous one is an error.
//!
//! ```
//! let text = "[DeviceInfo]\nProductName=Feeder\n\
//!             [MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n\
//!             [1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\n\
//!             AccessType=ro\nDefaultValue=0x00020192\n";
//! let eds = polepair::eds::parse("feeder.eds", text)?;
//! let kind = eds.entry(0x1000, 0).unwrap();
//! assert_eq!((kind.name.as_str(), kind.default_at(5)), ("Device type", Some(0x0002_0192)));
//! assert_eq!(polepair::eds::parse("again.eds", &eds.to_string())?.objects, eds.objects);
//! # Ok::<(), polepair::FileError>(())
//! ```

mod device;
mod drive;
mod ini;
mod object_types;
mod profile;
mod read;
#[cfg(test)]
mod tests;
mod value;
mod write;

pub use drive::SheetValues;
pub use object_types::{DataType, ObjectAccess, ObjectType};
pub use value::Literal;

pub(crate) use device::load_sheet;
pub(crate) use profile::{accepts_sheet, draft_profile, encoding, raw_value, symbol};

use crate::toml_file::{FileError, read_limited};
use std::path::Path;

/// Objects of one file at most.
pub const OBJECTS_MAX: usize = 16_384;
/// Entries of one file at most, sub-indices counted each.
pub const ENTRIES_MAX: usize = 65_536;
/// Maximum number of warnings; the last one states how many more there were.
pub const WARNINGS_MAX: usize = 100;

/// A parsed data sheet.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Eds {
    /// `[FileInfo]`, unchanged.
    pub file: Vec<(String, String)>,
    /// `[DeviceInfo]`, unchanged.
    pub device: Vec<(String, String)>,
    /// `[DeviceComissioning]`, as the standard spells it; empty in an EDS.
    pub commissioning: Vec<(String, String)>,
    /// The lines of `[Comments]`.
    pub comments: Vec<String>,
    /// The objects, by index.
    pub objects: Vec<EdsObject>,
    /// Sections that describe no object, as they stand.
    pub others: Vec<(String, Vec<(String, String)>)>,
    /// Accepted deviations from the standard.
    pub warnings: Vec<FileError>,
}

/// One object.
#[derive(Clone, PartialEq, Debug)]
pub struct EdsObject {
    /// Index, 0x0001 to 0xFFFF.
    pub index: u16,
    /// Name of the object.
    pub name: String,
    /// Type of the object.
    pub kind: ObjectType,
    /// `ObjFlags`: bit 0 refuses to be written by a download of the whole file, bit 1 refuses to be
    /// read by a scan.
    pub flags: u32,
    /// Entries by sub-index; a variable or domain has sub-index 0 alone.
    pub entries: Vec<EdsEntry>,
    /// Other keys of its section.
    pub others: Vec<(String, String)>,
}

/// One entry of the object dictionary.
#[derive(Clone, PartialEq, Debug)]
pub struct EdsEntry {
    /// Sub-index.
    pub sub: u8,
    /// Name of the entry; the object's for a variable.
    pub name: String,
    /// Type of the value on the wire.
    pub data_type: DataType,
    /// Access by SDO and PDO.
    pub access: ObjectAccess,
    /// True if a PDO may carry it.
    pub mappable: bool,
    /// Least value.
    pub low: Option<Literal>,
    /// Greatest value.
    pub high: Option<Literal>,
    /// Value from the factory.
    pub default: Option<Literal>,
    /// Value of this node (DCF).
    pub value: Option<Literal>,
    /// Other keys of its section; empty for a variable, whose section is that of the object.
    pub others: Vec<(String, String)>,
}

impl EdsEntry {
    /// The value that a device of the file has: this node's, else the factory's.
    #[must_use]
    pub const fn effective_value(&self) -> Option<&Literal> {
        match &self.value {
            Some(value) => Some(value),
            None => self.default.as_ref(),
        }
    }

    /// Returns whether its value is one node's although the factory's adds the node-ID: of node `configured`, or of one
    /// that the file does not name. Another node would have the identifiers of that one.
    fn pins_node(&self, configured: Option<u8>) -> bool {
        let (
            Some(Literal::Integer { value, plus_node: false, .. }),
            Some(Literal::Integer { value: base, plus_node: true, .. }),
        ) = (&self.value, &self.default)
        else {
            return false;
        };
        configured.is_none_or(|node| *value == base + i64::from(node))
    }

    /// The value from the factory of the node of that id, where it is a whole number.
    #[must_use]
    pub fn default_at(&self, node: u8) -> Option<i64> {
        self.default.as_ref()?.integer(node)
    }
}

impl Eds {
    /// The object of that index.
    #[must_use]
    pub fn object(&self, index: u16) -> Option<&EdsObject> {
        let at = self.objects.binary_search_by_key(&index, |object| object.index).ok()?;
        Some(&self.objects[at])
    }

    /// The entry at that index and sub-index.
    #[must_use]
    pub fn entry(&self, index: u16, sub: u8) -> Option<&EdsEntry> {
        self.object(index)?.entries.iter().find(|entry| entry.sub == sub)
    }

    /// A line of `[DeviceInfo]`, letter case ignored.
    #[must_use]
    pub fn device_info(&self, key: &str) -> Option<&str> {
        find_value(&self.device, key)
    }

    /// The value of an entry that any node of the file has.
    #[must_use]
    pub fn value_of_any_node<'a>(&self, entry: &'a EdsEntry) -> Option<&'a Literal> {
        if entry.pins_node(self.node_id()) {
            entry.default.as_ref()
        } else {
            entry.effective_value()
        }
    }

    /// The node-ID that a DCF gives.
    #[must_use]
    pub fn node_id(&self) -> Option<u8> {
        let text = find_value(&self.commissioning, "NodeID")?;
        let id = value::parse_integer(text)?.value;
        u8::try_from(id).ok().filter(|id| (1..=127).contains(id))
    }
}

fn find_value<'a>(lines: &'a [(String, String)], key: &str) -> Option<&'a str> {
    let found = lines.iter().find(|(known, _)| known.eq_ignore_ascii_case(key));
    found.map(|(_, value)| value.as_str()).filter(|value| !value.is_empty())
}

/// Reads an EDS or DCF from text; `file` is its name in complaints.
///
/// # Errors
/// [`FileError`] with line and reason, when no object can be made of it.
pub fn parse(file: &str, text: &str) -> Result<Eds, FileError> {
    read::parse_eds(file, text)
}

/// Reads an EDS or DCF file in UTF-8, or in UTF-16 with a byte order mark. Other bytes are taken for
/// Latin-1, in which most are written.
///
/// # Errors
/// [`FileError`], also for a file that cannot be read.
pub fn load(path: &Path) -> Result<Eds, FileError> {
    let name = path.display().to_string();
    let bytes =
        read_limited(path, FILE_MAX).map_err(|reason| FileError::for_file(&name, reason))?;
    let text = match utf16_text(&bytes) {
        Some(text) => text,
        None => String::from_utf8(bytes)
            .unwrap_or_else(|error| error.into_bytes().into_iter().map(char::from).collect()),
    };
    parse(&name, &text)
}

/// The text of bytes that begin with the byte order mark of UTF-16.
fn utf16_text(bytes: &[u8]) -> Option<String> {
    let (decode, rest): (fn([u8; 2]) -> u16, _) = match bytes {
        [0xFF, 0xFE, rest @ ..] => (u16::from_le_bytes, rest),
        [0xFE, 0xFF, rest @ ..] => (u16::from_be_bytes, rest),
        _ => return None,
    };
    let (units, _) = rest.as_chunks::<2>();
    let units: Vec<u16> = units.iter().map(|unit| decode(*unit)).collect();
    Some(String::from_utf16_lossy(&units))
}

/// Peculiarities of a data sheet, and its entries that become no parameters: nothing for a file that is none, or that
/// cannot be read.
pub(crate) fn sheet_warnings(path: &Path) -> Vec<FileError> {
    let Some(eds) = is_eds_file(path).then(|| load(path).ok()).flatten() else {
        return Vec::new();
    };
    let left_out = profile::left_out_entries(&path.display().to_string(), &eds);
    eds.warnings.into_iter().chain(left_out).collect()
}

/// The largest file, bytes.
const FILE_MAX: u64 = 16 << 20;

/// Returns whether a file is an EDS or DCF, by its name.
#[must_use]
pub fn is_eds_file(path: &Path) -> bool {
    let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
    extension.is_some_and(|extension| extension == "eds" || extension == "dcf")
}
