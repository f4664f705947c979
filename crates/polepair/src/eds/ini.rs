//! Parses the syntax of EDS files: sections, keys and values with their lines.

use crate::toml_file::{FileError, FileLocation};
use std::sync::Arc;

/// One `key=value`.
#[derive(Clone, Debug)]
pub(super) struct IniLine {
    pub(super) key: String,
    pub(super) value: String,
    pub(super) location: FileLocation,
}

/// One `[section]`.
#[derive(Clone, Debug)]
pub(super) struct IniSection {
    pub(super) name: String,
    pub(super) location: FileLocation,
    pub(super) lines: Vec<IniLine>,
}

impl IniSection {
    /// The value of a key, case-insensitive; `None` for an empty value too.
    pub(super) fn get(&self, key: &str) -> Option<&IniLine> {
        let found = self.lines.iter().find(|line| line.key.eq_ignore_ascii_case(key));
        found.filter(|line| !line.value.is_empty())
    }

    /// All keys and values, unchanged.
    pub(super) fn pairs(&self) -> Vec<(String, String)> {
        self.lines.iter().map(|line| (line.key.clone(), line.value.clone())).collect()
    }

    /// Keys and values other than those of `known`.
    pub(super) fn others(&self, known: &[&str]) -> Vec<(String, String)> {
        let is_other =
            |line: &&IniLine| !known.iter().any(|key| line.key.eq_ignore_ascii_case(key));
        let other = self.lines.iter().filter(is_other);
        other.map(|line| (line.key.clone(), line.value.clone())).collect()
    }
}

/// The sections of a text; lines that make no sense go to `warn`.
pub(super) fn parse_sections(
    file: &str,
    text: &str,
    warn: &mut impl FnMut(FileError),
) -> Vec<IniSection> {
    let file: Arc<str> = file.into();
    let mut sections: Vec<IniSection> = Vec::new();
    for (at, line) in text.trim_start_matches('\u{FEFF}').lines().enumerate() {
        let position = FileLocation::line_start(&file, at + 1);
        let line = line.trim();
        if line.is_empty() || line.starts_with([';', '#']) {
            continue;
        }
        if let Some(name) = line.strip_prefix('[') {
            // Editors of old left out the bracket; the section is clear all the same.
            let name = name.split(']').next().unwrap_or(name).trim().to_owned();
            sections.push(IniSection { name, location: position, lines: Vec::new() });
            continue;
        }
        match (line.split_once('='), sections.last_mut()) {
            (Some((key, value)), Some(section)) => {
                let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
                section.lines.push(IniLine { key, value, location: position });
            }
            _ => warn(position.error(format!("`{line}` is no `key=value` of a section: left out"))),
        }
    }
    sections
}
