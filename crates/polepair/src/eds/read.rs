//! From sections to objects: what a vendor meant, and what the standard would have said.

use super::ini::{self, Line, Section};
use super::kind::{Access, DataType, ObjectType};
use super::value::{self, Literal};
use super::{ENTRIES_MAX, Eds, Entry, OBJECTS_MAX, Object, WARNINGS_MAX};
use crate::file::{FileError, Place};
use crate::words;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Sections that list objects.
const LISTS: [&str; 3] = ["mandatoryobjects", "optionalobjects", "manufacturerobjects"];

/// The history of errors.
const HISTORY: u16 = 0x1003;

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
pub(super) fn eds(file: &str, text: &str) -> Result<Eds, FileError> {
    let mut reader = Reader::default();
    let sections = ini::sections(file, text, &mut |warning| reader.warn(warning));
    let mut eds = Eds::default();
    for section in sections {
        match Role::of(&section.name) {
            Role::FileInfo => eds.file = section.pairs(),
            Role::DeviceInfo => eds.device = section.pairs(),
            Role::Commissioning => eds.commissioning = section.pairs(),
            Role::Comments => eds.comments = comments(&section),
            Role::List => reader.list(&section),
            Role::Object(index) => reader.keep(index, section),
            Role::Sub(index, sub) => {
                reader.subs.entry(index).or_default().insert(sub, section);
            }
            Role::Names(index) => {
                reader.names.insert(index, section);
            }
            Role::Values(index) => {
                reader.values.insert(index, section);
            }
            Role::Other => eds.others.push((section.name.clone(), section.pairs())),
        }
    }
    eds.objects = reader.objects();
    if eds.objects.is_empty() {
        let reason = "no object in it: an EDS has sections such as [1000]";
        return Err(FileError::whole(file, reason));
    }
    eds.warnings = reader.warnings(file);
    Ok(eds)
}

/// What a section is about.
enum Role {
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

impl Role {
    fn of(name: &str) -> Self {
        let name = name.to_ascii_lowercase();
        match name.as_str() {
            "fileinfo" => return Self::FileInfo,
            "deviceinfo" => return Self::DeviceInfo,
            "devicecomissioning" | "devicecommissioning" => return Self::Commissioning,
            "comments" => return Self::Comments,
            list if LISTS.contains(&list) => return Self::List,
            _ => {}
        }
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

fn comments(section: &Section) -> Vec<String> {
    let is_line = |line: &&Line| {
        let key = line.key.to_ascii_lowercase();
        key.strip_prefix("line").is_some_and(|n| n.parse::<u32>().is_ok())
    };
    section.lines.iter().filter(is_line).map(|line| line.value.clone()).collect()
}

/// Sections by what they are about, and what is odd about them.
#[derive(Default)]
struct Reader {
    listed: HashMap<u16, Place>,
    sections: BTreeMap<u16, Section>,
    subs: HashMap<u16, BTreeMap<u8, Section>>,
    names: HashMap<u16, Section>,
    values: HashMap<u16, Section>,
    entries: usize,
    warned: Vec<FileError>,
    untold: usize,
}

impl Reader {
    fn warn(&mut self, warning: FileError) {
        if self.warned.len() < WARNINGS_MAX - 1 {
            self.warned.push(warning);
        } else {
            self.untold += 1;
        }
    }

    fn warnings(self, file: &str) -> Vec<FileError> {
        let mut warnings = self.warned;
        warnings.sort_by_key(|warning| warning.line);
        if self.untold > 0 {
            warnings.push(FileError::whole(file, format!("{} more warnings", self.untold)));
        }
        warnings
    }

    fn list(&mut self, section: &Section) {
        for line in section.lines.iter().filter(|line| line.key.parse::<u32>().is_ok()) {
            let index = value::number(&line.value).and_then(|n| u16::try_from(n.value).ok());
            match index {
                Some(index) if self.listed.len() < OBJECTS_MAX => {
                    self.listed.insert(index, line.place.clone());
                }
                Some(_) => {}
                None => self.warn(line.place.error(format!("`{}` is no index", line.value))),
            }
        }
    }

    fn keep(&mut self, index: u16, section: Section) {
        if self.sections.len() >= OBJECTS_MAX && !self.sections.contains_key(&index) {
            let reason = format!("more than {OBJECTS_MAX} objects: left out");
            return self.warn(section.place.error(reason));
        }
        let place = section.place.clone();
        if self.sections.insert(index, section).is_some() {
            self.warn(place.error(format!("[{index:04X}] stands here again: the last one holds")));
        }
    }

    fn objects(&mut self) -> Vec<Object> {
        let sections = std::mem::take(&mut self.sections);
        let mut objects = Vec::with_capacity(sections.len());
        for (index, section) in &sections {
            objects.extend(self.object(*index, section));
        }
        let lost: HashSet<u16> = sections.keys().copied().collect();
        let mut listed: Vec<_> = std::mem::take(&mut self.listed).into_iter().collect();
        listed.sort_by_key(|(index, _)| *index);
        for (index, place) in listed.iter().filter(|(index, _)| !lost.contains(index)) {
            self.warn(place.error(format!("object 0x{index:04X} is listed and has no section")));
        }
        objects
    }

    fn object(&mut self, index: u16, section: &Section) -> Option<Object> {
        let subs = self.subs.remove(&index).unwrap_or_default();
        let compact = self.small(section, "CompactSubObj").filter(|count| *count > 0);
        let kind = self.kind(section, !subs.is_empty() || compact.is_some());
        let name = section.get("ParameterName").map(|line| line.value.clone());
        let name = name.unwrap_or_else(|| format!("object 0x{index:04X}"));
        let mut object = Object {
            index,
            kind,
            flags: self.number(section, "ObjFlags").unwrap_or(0) as u32,
            entries: Vec::new(),
            others: section.others(&OBJECT_KEYS),
            name,
        };
        match (kind.has_subs(), compact) {
            (false, _) => {
                let entry = self.entry(0, section, &object.name, kind)?;
                object.entries.push(Entry { others: Vec::new(), ..entry });
            }
            (true, Some(count)) if subs.is_empty() => self.compact(&mut object, section, count),
            (true, _) => self.subs(&mut object, section, &subs),
        }
        self.entries += object.entries.len();
        if self.entries > ENTRIES_MAX {
            let reason = format!("more than {ENTRIES_MAX} entries: left out");
            self.warn(section.place.error(reason));
            return None;
        }
        Some(object)
    }

    fn kind(&mut self, section: &Section, has_subs: bool) -> ObjectType {
        let usual = if has_subs { ObjectType::Record } else { ObjectType::Variable };
        let Some(code) = self.number(section, "ObjectType") else { return usual };
        match u32::try_from(code).ok().and_then(ObjectType::of_code) {
            Some(kind) if kind.has_subs() || !has_subs => kind,
            Some(_) => {
                let reason =
                    "its object type has no sub-indices, but it has some: taken as a record";
                self.warn(section.place.error(reason));
                usual
            }
            None => {
                self.warn(section.place.error(format!("object type {code} is not known")));
                usual
            }
        }
    }

    fn subs(&mut self, object: &mut Object, section: &Section, subs: &BTreeMap<u8, Section>) {
        let said = self.small(section, "SubNumber");
        if let Some(said) = said.filter(|said| usize::from(*said) != subs.len()) {
            let reason = format!("{said} sub-indices are announced, {} are there", subs.len());
            self.warn(section.place.error(reason));
        }
        for (sub, section) in subs {
            let name = section
                .get("ParameterName")
                .map_or_else(|| format!("{} {sub}", object.name), |line| line.value.clone());
            let kind = ObjectType::Variable;
            object.entries.extend(self.entry(*sub, section, &name, kind));
        }
    }

    /// An array whose entries are alike and have no sections of their own (CiA 306-1, `CompactSubObj`).
    fn compact(&mut self, object: &mut Object, section: &Section, count: u8) {
        let Some(like) = self.entry(1, section, &object.name, ObjectType::Variable) else { return };
        // Writing 0 clears the history of errors.
        let access = if object.index == HISTORY { Access::Rw } else { Access::Ro };
        object.entries.push(Entry {
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
        let of =
            |section: &Option<Section>, sub: u8| section.as_ref()?.get(&sub.to_string()).cloned();
        for sub in 1..=count {
            let name = of(&names, sub).map(|line| line.value);
            let name = name.unwrap_or_else(|| format!("{}{sub}", object.name));
            let own = of(&values, sub);
            let value = own.and_then(|line| self.literal(&line, like.data_type));
            object.entries.push(Entry {
                sub,
                name,
                value: value.or_else(|| like.value.clone()),
                others: Vec::new(),
                ..like.clone()
            });
        }
    }

    fn entry(&mut self, sub: u8, section: &Section, name: &str, kind: ObjectType) -> Option<Entry> {
        let data_type = match self.number(section, "DataType") {
            Some(code) => DataType(u16::try_from(code).ok()?),
            None if kind == ObjectType::Domain => DataType::DOMAIN,
            None => {
                let reason = format!("`{name}` has no data type: left out");
                self.warn(section.place.error(reason));
                return None;
            }
        };
        let mut literal = |key: &str| {
            let line = section.get(key)?;
            self.literal(line, data_type)
        };
        let (low, high) = (literal("LowLimit"), literal("HighLimit"));
        let default = literal("DefaultValue");
        let value = literal("ParameterValue").or_else(|| literal("Value"));
        Some(Entry {
            sub,
            name: name.to_owned(),
            data_type,
            access: self.access(section),
            mappable: self.number(section, "PDOMapping").is_some_and(|flag| flag != 0),
            low,
            high,
            default,
            value,
            others: section.others(&OBJECT_KEYS),
        })
    }

    fn literal(&mut self, line: &Line, kind: DataType) -> Option<Literal> {
        let mut said = None;
        match value::literal(&line.value, kind, &mut |reason| said = Some(reason)) {
            Ok(literal) => {
                if let Some(reason) = said {
                    self.warn(line.place.error(reason));
                }
                Some(literal)
            }
            Err(reason) => {
                self.warn(line.place.error(format!("{}: {reason}: left out", line.key)));
                None
            }
        }
    }

    fn access(&mut self, section: &Section) -> Access {
        let Some(line) = section.get("AccessType") else { return Access::Rw };
        Access::of_word(&line.value).unwrap_or_else(|| {
            let hint = words::hint(&line.value, ["const", "ro", "wo", "rw", "rwr", "rww"]);
            self.warn(
                line.place.error(format!("`{}` is no access{hint}: taken as ro", line.value)),
            );
            Access::Ro
        })
    }

    fn number(&mut self, section: &Section, key: &str) -> Option<i64> {
        let line = section.get(key)?;
        let number = value::number(&line.value).map(|number| number.value);
        if number.is_none() {
            self.warn(line.place.error(format!("{key}: `{}` is no number: left out", line.value)));
        }
        number
    }

    fn small(&mut self, section: &Section, key: &str) -> Option<u8> {
        self.number(section, key).and_then(|number| u8::try_from(number).ok())
    }
}
