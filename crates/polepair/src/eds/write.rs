//! Writes a data sheet in the order of the standard.

use super::object_types::{ObjectAccess, ObjectType};
use super::{Eds, EdsEntry, EdsObject};
use std::fmt;

/// Objects that every device has (CiA 301 §7.5.1).
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];

impl fmt::Display for Eds {
    /// Formats it as a file: an EDS, or a DCF if values or a node-ID are given. Lines end as the standard has it, with
    /// CR and LF.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_section(f, "FileInfo", &self.file)?;
        write_section(f, "DeviceInfo", &self.device)?;
        write_section(f, "DeviceComissioning", &self.commissioning)?;
        if !self.comments.is_empty() {
            write!(f, "[Comments]\r\nLines={}\r\n", self.comments.len())?;
            for (n, line) in self.comments.iter().enumerate() {
                write!(f, "Line{}={line}\r\n", n + 1)?;
            }
            f.write_str("\r\n")?;
        }
        for (name, lines) in &self.others {
            write_section(f, name, lines)?;
        }
        self.write_list(f, "MandatoryObjects", |index| MANDATORY.contains(&index))?;
        self.write_list(f, "OptionalObjects", |i| !MANDATORY.contains(&i) && !is_vendor_index(i))?;
        self.write_list(f, "ManufacturerObjects", is_vendor_index)?;
        self.objects.iter().try_for_each(|object| write_object(f, object))
    }
}

fn is_vendor_index(index: u16) -> bool {
    (0x2000..0x6000).contains(&index)
}

impl Eds {
    fn write_list(
        &self,
        f: &mut fmt::Formatter<'_>,
        name: &str,
        belongs: impl Fn(u16) -> bool,
    ) -> fmt::Result {
        let indices = || self.objects.iter().map(|object| object.index).filter(|i| belongs(*i));
        write!(f, "[{name}]\r\nSupportedObjects={}\r\n", indices().count())?;
        for (n, index) in indices().enumerate() {
            write!(f, "{}=0x{index:04X}\r\n", n + 1)?;
        }
        f.write_str("\r\n")
    }
}

fn write_section(
    f: &mut fmt::Formatter<'_>,
    name: &str,
    lines: &[(String, String)],
) -> fmt::Result {
    if lines.is_empty() {
        return Ok(());
    }
    write!(f, "[{name}]\r\n")?;
    write_pairs(f, lines)?;
    f.write_str("\r\n")
}

fn write_pairs(f: &mut fmt::Formatter<'_>, lines: &[(String, String)]) -> fmt::Result {
    lines.iter().try_for_each(|(key, value)| write!(f, "{key}={value}\r\n"))
}

fn write_object(f: &mut fmt::Formatter<'_>, object: &EdsObject) -> fmt::Result {
    let EdsObject { index, name, kind, .. } = object;
    // With the line ends of Windows, as the tools of vendors write and expect them.
    write!(f, "[{index:04X}]\r\nParameterName={name}\r\nObjectType=0x{:X}\r\n", kind.code())?;
    if object.flags != 0 {
        write!(f, "ObjFlags=0x{:X}\r\n", object.flags)?;
    }
    if kind.has_subs() {
        write!(f, "SubNumber={}\r\n", object.entries.len())?;
    } else if let Some(entry) = object.entries.first() {
        write_value(f, entry)?;
    }
    write_pairs(f, &object.others)?;
    f.write_str("\r\n")?;
    if !kind.has_subs() {
        return Ok(());
    }
    for entry in &object.entries {
        write!(f, "[{index:04X}sub{:X}]\r\nParameterName={}\r\n", entry.sub, entry.name)?;
        write!(f, "ObjectType=0x{:X}\r\n", ObjectType::Variable.code())?;
        write_value(f, entry)?;
        write_pairs(f, &entry.others)?;
        f.write_str("\r\n")?;
    }
    Ok(())
}

fn write_value(f: &mut fmt::Formatter<'_>, entry: &EdsEntry) -> fmt::Result {
    let EdsEntry { data_type, access, .. } = entry;
    write!(f, "DataType=0x{:04X}\r\nAccessType={}\r\n", data_type.0, ObjectAccess::word(*access))?;
    write!(f, "PDOMapping={}\r\n", u8::from(entry.mappable))?;
    let values = [
        ("LowLimit", &entry.low),
        ("HighLimit", &entry.high),
        ("DefaultValue", &entry.default),
        ("ParameterValue", &entry.value),
    ];
    for (key, value) in values {
        if let Some(value) = value {
            write!(f, "{key}={value}\r\n")?;
        }
    }
    Ok(())
}
