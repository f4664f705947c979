//! Reads TOML files, with file, line, column and reason in every error.

use crate::spelling;
use polepair_core::convert::saturating;
use std::borrow::Cow;
use std::io::Read as _;
use std::iter;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// Version of racks, profiles and configuration files: their key `version`.
pub(crate) const FILE_VERSION: i64 = 1;

/// Error in a file, with its place.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FileError {
    /// The file, as it was named.
    pub file: String,
    /// Line, counted from 1; 0 when the file as a whole is meant.
    pub line: u32,
    /// Column in characters, counted from 1; 0 when the file as a whole is meant.
    pub column: u32,
    /// Reason, and the nearest known word if there is one.
    pub reason: String,
}

impl FileError {
    /// A complaint about a file as a whole.
    pub(crate) fn for_file(file: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { file: file.into(), line: 0, column: 0, reason: reason.into() }
    }
}

impl std::fmt::Display for FileError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { file, line, column, reason } = self;
        match line {
            0 => write!(f, "{file}: {reason}"),
            _ => write!(f, "{file}:{line}:{column}: {reason}"),
        }
    }
}

impl std::error::Error for FileError {}

/// Reads a file of at most `max` bytes. Only regular files are read: a pipe would delay a stop, and some
/// devices never end.
pub(crate) fn read_limited(path: &Path, max: u64) -> Result<Vec<u8>, String> {
    let meta = std::fs::metadata(path).map_err(|error| error.to_string())?;
    // A pipe would block, and a device such as /dev/zero never ends.
    if !meta.is_file() {
        return Err("not a file, but a folder, a pipe or a device".to_owned());
    }
    let file = std::fs::File::open(path).map_err(|error| error.to_string())?;
    let mut bytes = Vec::new();
    // The size that the system reports may be outdated by the time of reading.
    file.take(max + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() as u64 > max { Err(format!("larger than {max} bytes")) } else { Ok(bytes) }
}

/// A place in a file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct FileLocation {
    file: Arc<str>,
    line: u32,
    column: u32,
}

impl FileLocation {
    /// The location of a compiled-in drive.
    pub(crate) fn built_in(name: &str) -> Self {
        Self { file: name.into(), line: 0, column: 0 }
    }

    /// The file, as it was named.
    pub(crate) fn file(&self) -> &str {
        &self.file
    }

    /// The beginning of a line, counted from 1.
    pub(crate) fn line_start(file: &Arc<str>, line: usize) -> Self {
        Self { file: Arc::clone(file), line: saturating(line), column: 1 }
    }

    /// The location some characters further on the line.
    pub(crate) fn shifted(&self, characters: usize) -> Self {
        let more = saturating::<u32>(characters);
        Self { column: self.column + more, ..self.clone() }
    }

    /// A complaint about this place.
    pub(crate) fn error(&self, reason: impl Into<String>) -> FileError {
        FileError {
            file: self.file.to_string(),
            line: self.line,
            column: self.column,
            reason: reason.into(),
        }
    }
}

impl std::fmt::Display for FileLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}:{}", self.file, self.line, self.column)
    }
}

/// A file's text, for turning byte offsets into places.
#[derive(Clone, Debug)]
pub(crate) struct SourceText<'a> {
    file: Arc<str>,
    text: &'a str,
    /// The offset of each line's first byte.
    line_starts: Vec<usize>,
}

impl<'a> SourceText<'a> {
    pub(crate) fn new(file: &str, text: &'a str) -> Self {
        let breaks = text.match_indices('\n').map(|(at, _)| at + 1);
        Self { file: file.into(), text, line_starts: iter::once(0).chain(breaks).collect() }
    }

    /// Parses the text as TOML and gives its outermost table to `read`.
    pub(crate) fn parse<T>(
        &self,
        known: &[&str],
        read: impl FnOnce(TomlTable<'_, 'a>) -> Result<T, FileError>,
    ) -> Result<T, FileError> {
        self.parse_versions(known, FILE_VERSION, |table, _| read(table))
    }

    /// Parses the text as TOML and gives its outermost table and its version, up to `newest`, to `read`.
    pub(crate) fn parse_versions<T>(
        &self,
        known: &[&str],
        newest: i64,
        read: impl FnOnce(TomlTable<'_, 'a>, Option<i64>) -> Result<T, FileError>,
    ) -> Result<T, FileError> {
        let parsed = DeTable::parse(self.text).map_err(|error| {
            let location = self.location_at(error.span().map_or(0, |span| span.start));
            location.error(error.message().lines().collect::<Vec<_>>().join("; "))
        })?;
        let table = parsed.get_ref();
        // Before the keys: a newer file may have keys that this program does not know.
        let version = TomlTable { text: self, table, start: 0 }.integer("version")?;
        if let Some(version) = version.as_ref().filter(|found| !(1..=newest).contains(&found.value))
        {
            let reason = format!(
                "the file has version {}; this program reads version {newest}: use a newer polepair",
                version.value
            );
            return Err(version.location.error(reason));
        }
        let version = version.map(|found| found.value);
        read(TomlTable::new(self, table, 0, &[known, &["version"]].concat())?, version)
    }

    fn location_at(&self, offset: usize) -> FileLocation {
        let offset = if self.text.is_char_boundary(offset) { offset } else { self.text.len() };
        let line = self.line_starts.partition_point(|&start| start <= offset);
        let column = self.text[self.line_starts[line - 1]..offset].chars().count() + 1;
        FileLocation {
            file: Arc::clone(&self.file),
            line: u32_or_max(line),
            column: u32_or_max(column),
        }
    }
}

fn u32_or_max(n: usize) -> u32 {
    saturating(n)
}

/// A value with its location.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Located<T> {
    pub(crate) value: T,
    pub(crate) location: FileLocation,
}

impl<T> Located<T> {
    /// Refuses the value with a reason, or goes on with what became of it.
    pub(crate) fn try_map<U>(
        self,
        make: impl FnOnce(T) -> Result<U, String>,
    ) -> Result<U, FileError> {
        let location = self.location;
        make(self.value).map_err(|reason| location.error(reason))
    }
}

/// A table of a file whose keys are known words.
#[derive(Clone, Debug)]
pub(crate) struct TomlTable<'t, 'a> {
    text: &'t SourceText<'a>,
    table: &'t DeTable<'a>,
    start: usize,
}

type TomlEntry<'t, 'a> = (&'t str, Range<usize>, &'t Spanned<DeValue<'a>>);

impl<'t, 'a> TomlTable<'t, 'a> {
    fn new(
        text: &'t SourceText<'a>,
        table: &'t DeTable<'a>,
        start: usize,
        known: &[&str],
    ) -> Result<Self, FileError> {
        let node = Self { text, table, start };
        for (key, span, _) in node.entries() {
            if !known.is_empty() && !known.contains(&key) {
                let hint = spelling::suggestion(key, known.iter().copied());
                return Err(text
                    .location_at(span.start)
                    .error(format!("unknown key `{key}`{hint}")));
            }
        }
        Ok(node)
    }

    /// Location of the table.
    pub(crate) fn location(&self) -> FileLocation {
        self.text.location_at(self.start)
    }

    pub(crate) fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    fn entries(&self) -> impl Iterator<Item = TomlEntry<'t, 'a>> + use<'t, 'a> {
        let table = self.table;
        table.iter().map(|(key, value)| {
            let name: &'t Cow<'a, str> = key.get_ref();
            (name.as_ref(), key.span(), value)
        })
    }

    /// Every key of the table, with its place.
    pub(crate) fn keys(&self) -> Vec<Located<&'t str>> {
        self.entries()
            .map(|(value, at, _)| Located { value, location: self.location_of(at.start) })
            .collect()
    }

    fn location_of(&self, start: usize) -> FileLocation {
        self.text.location_at(start)
    }

    fn get(&self, key: &str) -> Option<&'t Spanned<DeValue<'a>>> {
        self.table.get(key)
    }

    fn type_error(&self, key: &str, value: &Spanned<DeValue<'a>>, wanted: &str) -> FileError {
        let found = value.get_ref().type_str();
        let article = if found.starts_with(['a', 'i']) { "an" } else { "a" };
        self.text
            .location_at(value.span().start)
            .error(format!("`{key}` is {article} {found}; it must be {wanted}"))
    }

    pub(crate) fn text(&self, key: &str) -> Result<Option<Located<String>>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let text = value.get_ref().as_str().ok_or_else(|| self.type_error(key, value, "a text"))?;
        Ok(Some(self.located(text.to_owned(), value)))
    }

    pub(crate) fn required_text(&self, key: &str) -> Result<Located<String>, FileError> {
        self.text(key)?.ok_or_else(|| self.location().error(format!("`{key}` is missing")))
    }

    pub(crate) fn integer(&self, key: &str) -> Result<Option<Located<i64>>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let number = toml_integer(value.get_ref())
            .ok_or_else(|| self.type_error(key, value, "a whole number of 64 bits"))?;
        Ok(Some(self.located(number, value)))
    }

    pub(crate) fn required_integer(&self, key: &str) -> Result<Located<i64>, FileError> {
        self.integer(key)?.ok_or_else(|| self.location().error(format!("`{key}` is missing")))
    }

    /// A number between `least` and `most`.
    pub(crate) fn integer_between(
        &self,
        key: &str,
        min: i64,
        max: i64,
    ) -> Result<Option<i64>, FileError> {
        let Some(found) = self.integer(key)? else { return Ok(None) };
        if !(min..=max).contains(&found.value) {
            let reason = format!("`{key}` is {}; it must be {min} to {max}", found.value);
            return Err(found.location.error(reason));
        }
        Ok(Some(found.value))
    }

    pub(crate) fn float(&self, key: &str) -> Result<Option<Located<f64>>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let number = match value.get_ref() {
            DeValue::Float(float) => float.as_str().replace('_', "").parse::<f64>().ok(),
            #[allow(clippy::cast_precision_loss, reason = "a scale or a probability")]
            other => toml_integer(other).map(|n| n as f64),
        };
        let number = number.filter(|n| n.is_finite());
        let number = number.ok_or_else(|| self.type_error(key, value, "a finite number"))?;
        Ok(Some(self.located(number, value)))
    }

    pub(crate) fn boolean(&self, key: &str) -> Result<bool, FileError> {
        let Some(value) = self.get(key) else { return Ok(false) };
        value.get_ref().as_bool().ok_or_else(|| self.type_error(key, value, "true or false"))
    }

    pub(crate) fn texts(&self, key: &str) -> Result<Vec<Located<String>>, FileError> {
        let Some((value, array)) = self.array(key)? else { return Ok(Vec::new()) };
        array
            .iter()
            .map(|item| match item.get_ref().as_str() {
                Some(text) => Ok(self.located(text.to_owned(), item)),
                None => Err(self.type_error(key, value, "a list of texts")),
            })
            .collect()
    }

    fn array(
        &self,
        key: &str,
    ) -> Result<Option<(&'t Spanned<DeValue<'a>>, &'t DeArray<'a>)>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match value.get_ref().as_array() {
            Some(array) => Ok(Some((value, array))),
            None => Err(self.type_error(key, value, "a list")),
        }
    }

    /// A table whose keys are `known`; any keys when `known` is empty.
    /// Whole numbers from 0 to `most`; none without the key.
    pub(crate) fn whole_numbers(&self, key: &str, max: u32) -> Result<Vec<u32>, FileError> {
        let Some((value, array)) = self.array(key)? else { return Ok(Vec::new()) };
        array
            .iter()
            .map(|item| {
                let number = toml_integer(item.get_ref()).and_then(|n| u32::try_from(n).ok());
                let wanted = format!("a list of whole numbers from 0 to {max}");
                number.filter(|n| *n <= max).ok_or_else(|| self.type_error(key, value, &wanted))
            })
            .collect()
    }

    pub(crate) fn table(
        &self,
        key: &str,
        known: &[&str],
    ) -> Result<Option<TomlTable<'t, 'a>>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let table =
            value.get_ref().as_table().ok_or_else(|| self.type_error(key, value, "a table"))?;
        TomlTable::new(self.text, table, value.span().start, known).map(Some)
    }

    /// The tables of `[[key]]`.
    pub(crate) fn tables(
        &self,
        key: &str,
        known: &[&str],
    ) -> Result<Vec<TomlTable<'t, 'a>>, FileError> {
        let Some((value, array)) = self.array(key)? else { return Ok(Vec::new()) };
        array
            .iter()
            .map(|item| match item.get_ref().as_table() {
                Some(table) => TomlTable::new(self.text, table, item.span().start, known),
                None => Err(self.type_error(key, value, "a list of tables")),
            })
            .collect()
    }

    /// True when `key` holds a table rather than a plain value.
    pub(crate) fn is_list(&self, key: &str) -> bool {
        self.get(key).is_some_and(|value| value.get_ref().is_array())
    }

    pub(crate) fn is_table(&self, key: &str) -> bool {
        self.get(key).is_some_and(|value| value.get_ref().is_table())
    }

    /// A scalar as text, whatever its type.
    pub(crate) fn scalar_text(&self, key: &str) -> Result<Option<Located<String>>, FileError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let text = match value.get_ref() {
            DeValue::String(text) => text.to_string(),
            DeValue::Float(float) => float.as_str().to_owned(),
            DeValue::Boolean(flag) => flag.to_string(),
            other => match toml_integer(other) {
                Some(number) => number.to_string(),
                None => {
                    return Err(self.type_error(key, value, "a text, a number or true or false"));
                }
            },
        };
        Ok(Some(self.located(text, value)))
    }

    fn located<T>(&self, value: T, at: &Spanned<DeValue<'a>>) -> Located<T> {
        Located { value, location: self.text.location_at(at.span().start) }
    }
}

fn toml_integer(value: &DeValue<'_>) -> Option<i64> {
    let number = value.as_integer()?;
    i64::from_str_radix(number.as_str(), number.radix()).ok()
}

/// A number as people write it in files and commands: decimal or 0x, signed.
pub(crate) fn parse_number(text: &str) -> Option<i64> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text),
    };
    let magnitude = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => u64::from_str_radix(hex, 16).ok()?,
        None if digits.starts_with('+') => return None,
        None => digits.parse::<u64>().ok()?,
    };
    i64::try_from(i128::from(magnitude) * sign).ok()
}
