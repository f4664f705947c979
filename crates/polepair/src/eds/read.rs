//! Converts sections to objects, and corrects unambiguous mistakes of vendors.

use super::ini::{self, IniLine, IniSection};
use super::object_types::{DataType, ObjectAccess, ObjectType};
use super::value::{self, Literal};
use super::{ENTRIES_MAX, Eds, EdsEntry, EdsObject, OBJECTS_MAX, WARNINGS_MAX};
use crate::spelling;
use crate::toml_file::{FileError, FileLocation};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Sections that list objects.
const LIST_SECTIONS: [&str; 3] = ["mandatoryobjects", "optionalobjects", "manufacturerobjects"];

/// The history of errors.
const ERROR_HISTORY: u16 = 0x1003;

/// Keys of an object that are understood.
const OBJECT_KEYS: [&str; 13] = [
    "ParameterName",
    "ObjectType",
    "SubNumber",
    "CompactSubObj",
    "ObjFlags",
    "DataType",
    "AccessType",
    "PDOMapping",
    "LowLimit",
    "HighLimit",
    "DefaultValue",
    "ParameterValue",
    "Value",
];

/// Reads a file.
pub(super) fn parse_eds(file: &str, text: &str) -> Result<Eds, FileError> {
    let mut reader = EdsReader::default();
    let sections = ini::parse_sections(file, text, &mut |warning| reader.warn(warning));
    let mut eds = Eds::default();
    for section in sections {
        match SectionKind::from_name(&section.name) {
            SectionKind::FileInfo => eds.file = section.pairs(),
            SectionKind::DeviceInfo => eds.device = section.pairs(),
            SectionKind::Commissioning => eds.commissioning = section.pairs(),
            SectionKind::Comments => eds.comments = comment_lines(&section),
            SectionKind::List => reader.read_list(&section),
            SectionKind::Object(index) => reader.store_object(index, section),
            SectionKind::Sub(index, sub) => {
                reader.subs.entry(index).or_default().insert(sub, section);
            }
            SectionKind::Names(index) => {
                reader.names.insert(index, section);
            }
            SectionKind::Values(index) => {
                reader.values.insert(index, section);
            }
            SectionKind::Other => eds.others.push((section.name.clone(), section.pairs())),
        }
    }
    eds.objects = reader.build_objects();
    if eds.objects.is_empty() {
        let reason = "no object in it: an EDS has sections such as [1000]";
        return Err(FileError::for_file(file, reason));
    }
    if eds.node_id().is_none() {
        for (object, entry) in
            eds.objects.iter().flat_map(|o| o.entries.iter().map(move |e| (o, e)))
        {
            if let (true, Some(value), Some(default)) =
                (entry.pins_node(None), &entry.value, &entry.default)
            {
                let at = format!("{:04X}h:{:X}", object.index, entry.sub);
                let reason = format!("{at}: {value} is one node's value: {default} is used");
                reader.warn(FileError::for_file(file, reason));
            }
        }
    }
    // Last, since building the objects adds to them.
    eds.warnings = reader.warnings(file);
    Ok(eds)
}

/// A value without the remark that some write behind it: `0x0006 ; u16`.
fn without_remark(value: &str) -> &str {
    value.split(';').next().unwrap_or(value).trim_end()
}

/// Kind of a section.
enum SectionKind {
    FileInfo,
    DeviceInfo,
    Commissioning,
    Comments,
    List,
    Object(u16),
    Sub(u16, u8),
    Names(u16),
    Values(u16),
    Other,
}

impl SectionKind {
    fn from_name(name: &str) -> Self {
        let name = name.to_ascii_lowercase();
        match name.as_str() {
            "fileinfo" => return Self::FileInfo,
            "deviceinfo" => return Self::DeviceInfo,
            "devicecomissioning" | "devicecommissioning" => return Self::Commissioning,
            "comments" => return Self::Comments,
            list if LIST_SECTIONS.contains(&list) => return Self::List,
            _ => {}
        }
        // Four at most: names of other sections may begin with more such letters.
        let digits = name.bytes().take_while(u8::is_ascii_hexdigit).count().min(4);
        let Ok(index) = u16::from_str_radix(&name[..digits], 16) else { return Self::Other };
        match &name[digits..] {
            "" => Self::Object(index),
            "name" => Self::Names(index),
            "value" => Self::Values(index),
            rest => {
                let sub = rest.strip_prefix("sub").and_then(|sub| u8::from_str_radix(sub, 16).ok());
                sub.map_or(Self::Other, |sub| Self::Sub(index, sub))
            }
        }
    }
}

fn comment_lines(section: &IniSection) -> Vec<String> {
    section
        .lines
        .iter()
        .filter(|line| {
            let key = line.key.to_ascii_lowercase();
            key.strip_prefix("line").is_some_and(|n| n.parse::<u32>().is_ok())
        })
        .map(|line| line.value.clone())
        .collect()
}

/// Sections by their subject, and their faults.
#[derive(Default)]
struct EdsReader {
    listed: HashMap<u16, FileLocation>,
    sections: BTreeMap<u16, IniSection>,
    subs: HashMap<u16, BTreeMap<u8, IniSection>>,
    names: HashMap<u16, IniSection>,
    values: HashMap<u16, IniSection>,
    entries: usize,
    warnings: Vec<FileError>,
    suppressed: usize,
}

impl EdsReader {
    fn warn(&mut self, warning: FileError) {
        if self.warnings.len() < WARNINGS_MAX - 1 {
            self.warnings.push(warning);
        } else {
            self.suppressed += 1;
        }
    }

    fn warnings(self, file: &str) -> Vec<FileError> {
        let mut warnings = self.warnings;
        warnings.sort_by_key(|warning| warning.line);
        if self.suppressed > 0 {
            warnings.push(FileError::for_file(file, format!("{} more warnings", self.suppressed)));
        }
        warnings
    }

    fn read_list(&mut self, section: &IniSection) {
        for line in section.lines.iter().filter(|line| line.key.parse::<u32>().is_ok()) {
            let index = value::parse_integer(&line.value).and_then(|n| u16::try_from(n.value).ok());
            match index {
                Some(index) if self.listed.len() < OBJECTS_MAX => {
                    self.listed.insert(index, line.location.clone());
                }
                Some(_) => {}
                None => self.warn(line.location.error(format!("`{}` is no index", line.value))),
            }
        }
    }

    fn store_object(&mut self, index: u16, section: IniSection) {
        if self.sections.len() >= OBJECTS_MAX && !self.sections.contains_key(&index) {
            let reason = format!("more than {OBJECTS_MAX} objects: left out");
            return self.warn(section.location.error(reason));
        }
        let location = section.location.clone();
        if self.sections.insert(index, section).is_some() {
            self.warn(location.error(format!(
                "[{index:04X}] is defined twice: the last definition is \
                 used"
            )));
        }
    }

    fn build_objects(&mut self) -> Vec<EdsObject> {
        let sections = std::mem::take(&mut self.sections);
        let mut objects = Vec::with_capacity(sections.len());
        for (index, section) in &sections {
            objects.extend(self.build_object(*index, section));
        }
        let lost: HashSet<u16> = sections.keys().copied().collect();
        let mut listed: Vec<_> = std::mem::take(&mut self.listed).into_iter().collect();
        // A map has no order, and the warnings of two runs must be the same.
        listed.sort_by_key(|(index, _)| *index);
        for (index, location) in listed.iter().filter(|(index, _)| !lost.contains(index)) {
            self.warn(location.error(format!("object 0x{index:04X} is listed and has no section")));
        }
        objects
    }

    fn build_object(&mut self, index: u16, section: &IniSection) -> Option<EdsObject> {
        let subs = self.subs.remove(&index).unwrap_or_default();
        // The entries of an array may be stated once (CiA 306, CompactSubObj).
        let compact = self.read_u8(section, "CompactSubObj").filter(|count| *count > 0);
        let kind = self.object_type(section, !subs.is_empty() || compact.is_some());
        let name = section.get("ParameterName").map(|line| line.value.clone());
        let name = name.unwrap_or_else(|| format!("object 0x{index:04X}"));
        let mut object = EdsObject {
            index,
            kind,
            flags: self.read_number(section, "ObjFlags").unwrap_or(0) as u32,
            entries: Vec::new(),
            others: section.others(&OBJECT_KEYS),
            name,
        };
        match (kind.has_subs(), compact) {
            (false, _) => {
                let entry = self.build_entry(0, section, &object.name, kind)?;
                object.entries.push(EdsEntry { others: Vec::new(), ..entry });
            }
            (true, Some(count)) if subs.is_empty() => {
                self.expand_compact(&mut object, section, count)
            }
            (true, _) => self.read_subs(&mut object, section, &subs),
        }
        debug_assert!(object.index == index);
        self.entries += object.entries.len();
        if self.entries > ENTRIES_MAX {
            let reason = format!("more than {ENTRIES_MAX} entries: left out");
            self.warn(section.location.error(reason));
            return None;
        }
        Some(object)
    }

    fn object_type(&mut self, section: &IniSection, has_subs: bool) -> ObjectType {
        let usual = if has_subs { ObjectType::Record } else { ObjectType::Variable };
        let Some(code) = self.read_number(section, "ObjectType") else { return usual };
        match u32::try_from(code).ok().and_then(ObjectType::from_code) {
            Some(kind) if kind.has_subs() || !has_subs => kind,
            Some(_) => {
                let reason =
                    "its object type has no sub-indices, but it has some: taken as a record";
                self.warn(section.location.error(reason));
                usual
            }
            None => {
                self.warn(section.location.error(format!("object type {code} is not known")));
                usual
            }
        }
    }

    fn read_subs(
        &mut self,
        object: &mut EdsObject,
        section: &IniSection,
        subs: &BTreeMap<u8, IniSection>,
    ) {
        let sequence = self.read_u8(section, "SubNumber");
        if let Some(sequence) = sequence.filter(|sequence| usize::from(*sequence) != subs.len()) {
            let reason = format!("{sequence} sub-indices are announced, {} are there", subs.len());
            self.warn(section.location.error(reason));
        }
        for (sub, section) in subs {
            let name = section
                .get("ParameterName")
                .map_or_else(|| format!("{} {sub}", object.name), |line| line.value.clone());
            let kind = ObjectType::Variable;
            object.entries.extend(self.build_entry(*sub, section, &name, kind));
        }
    }

    /// An array whose entries are alike and have no sections of their own (CiA 306-1, `CompactSubObj`).
    fn expand_compact(&mut self, object: &mut EdsObject, section: &IniSection, count: u8) {
        let Some(like) = self.build_entry(1, section, &object.name, ObjectType::Variable) else {
            return;
        };
        // Writing 0 clears the history of errors.
        let access =
            if object.index == ERROR_HISTORY { ObjectAccess::Rw } else { ObjectAccess::Ro };
        object.entries.push(EdsEntry {
            sub: 0,
            name: "NrOfObjects".to_owned(),
            data_type: DataType::U8,
            access,
            mappable: false,
            low: None,
            high: None,
            default: Some(Literal::Integer { value: count.into(), plus_node: false, hex: false }),
            value: None,
            others: Vec::new(),
        });
        let (names, values) = (self.names.remove(&object.index), self.values.remove(&object.index));
        for sub in 1..=count {
            let name = section_of(&names, sub).map(|line| line.value);
            let name = name.unwrap_or_else(|| format!("{}{sub}", object.name));
            let own = section_of(&values, sub);
            let value = own.and_then(|line| self.read_literal(&line, like.data_type));
            object.entries.push(EdsEntry {
                sub,
                name,
                value: value.or_else(|| like.value.clone()),
                others: Vec::new(),
                ..like.clone()
            });
        }
    }

    fn build_entry(
        &mut self,
        sub: u8,
        section: &IniSection,
        name: &str,
        kind: ObjectType,
    ) -> Option<EdsEntry> {
        let data_type = match self.read_number(section, "DataType") {
            Some(code) => DataType(u16::try_from(code).ok()?),
            None if kind == ObjectType::Domain => DataType::DOMAIN,
            None => {
                let reason = format!("`{name}` has no data type: left out");
                self.warn(section.location.error(reason));
                return None;
            }
        };
        let mut literal = |key: &str| {
            let line = section.get(key)?;
            self.read_literal(line, data_type)
        };
        let (low, high) = (literal("LowLimit"), literal("HighLimit"));
        let default = literal("DefaultValue");
        let value = literal("ParameterValue").or_else(|| literal("Value"));
        Some(EdsEntry {
            sub,
            name: name.to_owned(),
            data_type,
            access: self.read_access(section),
            mappable: self.read_number(section, "PDOMapping").is_some_and(|flag| flag != 0),
            low,
            high,
            default,
            value,
            others: section.others(&OBJECT_KEYS),
        })
    }

    fn read_literal(&mut self, line: &IniLine, kind: DataType) -> Option<Literal> {
        let mut text = None;
        // A semicolon in a text belongs to it.
        let given = if kind.is_integer() { without_remark(&line.value) } else { &line.value };
        match value::parse_literal(given, kind, &mut |reason| text = Some(reason)) {
            Ok(literal) => {
                if let Some(reason) = text {
                    self.warn(line.location.error(reason));
                }
                Some(literal)
            }
            Err(reason) => {
                self.warn(line.location.error(format!("{}: {reason}: left out", line.key)));
                None
            }
        }
    }

    fn read_access(&mut self, section: &IniSection) -> ObjectAccess {
        let Some(line) = section.get("AccessType") else { return ObjectAccess::Rw };
        ObjectAccess::from_word(without_remark(&line.value)).unwrap_or_else(|| {
            let hint = spelling::suggestion(&line.value, ["const", "ro", "wo", "rw", "rwr", "rww"]);
            self.warn(
                line.location.error(format!("`{}` is no access{hint}: taken as ro", line.value)),
            );
            ObjectAccess::Ro
        })
    }

    fn read_number(&mut self, section: &IniSection, key: &str) -> Option<i64> {
        let line = section.get(key)?;
        let number = value::parse_integer(without_remark(&line.value)).map(|number| number.value);
        if number.is_none() {
            self.warn(
                line.location.error(format!("{key}: `{}` is no number: left out", line.value)),
            );
        }
        number
    }

    fn read_u8(&mut self, section: &IniSection, key: &str) -> Option<u8> {
        self.read_number(section, key).and_then(|number| u8::try_from(number).ok())
    }
}

fn section_of(section: &Option<IniSection>, sub: u8) -> Option<IniLine> {
    section.as_ref()?.get(&sub.to_string()).cloned()
}
