//! A data set of many captures: `TABLE/site=…/date=YYYY-MM-DD/bus=…/part-….parquet`.
//!
//! The name of a part is the BLAKE3 hash of its capture, so decoding it again replaces the part. A capture
//! is complete when its note in `_done` is written, which is the last step. A capture that has grown since replaces
//! the parts of its earlier state.

mod notes;

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::{GenericStringType, Int32Type, Int64Type};
use arrow_array::{Array, BooleanArray, GenericByteArray, PrimitiveArray, RecordBatch};
use arrow_schema::ArrowError;

use polepair_files::SealedFile;

use crate::capture_file::CaptureFile;
use crate::path_word::{NO_DATE, escape};
use crate::provenance::{DECODER, Provenance};
use crate::schema::{SCHEMA_ID, TableKind};
use crate::table_file::{BatchSink, ColumnFormat, TableFile, TableFileError};
use notes::{DONE, DatasetNotes};
pub use notes::{DatasetLock, text_hash};

/// Parts that are written at once; each holds a row group in memory, and a descriptor.
const OPEN_MAX: usize = 24;
/// Parts of one capture. More have times that are no times: each row would have a file of its own.
const PARTS_MAX: usize = 1 << 15;
/// Characters of a site or a link in the name of a folder, which a file system limits to 255.
const NAME_MAX: usize = 200;
const DAY_NS: i64 = 86_400_000_000_000;

/// Location of a data set, and the site and gateway of the captures.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DatasetSite {
    /// The data set's folder.
    pub root: PathBuf,
    /// The plant, cell or machine, as the partition has it.
    pub name: String,
}

/// Record of a decoded capture, with the decoder's version.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DecodeRecord {
    /// BLAKE3 of the capture, hexadecimal.
    pub blake3: String,
    /// All inputs of the decoder beside the capture.
    pub inputs: String,
}

impl DecodeRecord {
    /// A capture, and the statements for its decoding.
    #[must_use]
    pub fn new(site: &DatasetSite, blake3: &str, stated: &str, tables: &[TableKind]) -> Self {
        let tables: Vec<&str> = tables.iter().map(|table| table.name()).collect();
        let tables = tables.join(",");
        let by = format!("{SCHEMA_ID} {DECODER} site={} tables={tables} {stated}", site.name);
        Self { blake3: blake3.to_owned(), inputs: by.replace('\n', " ") }
    }

    fn path(&self, site: &DatasetSite) -> PathBuf {
        site.root.join(DONE).join(&self.blake3)
    }

    /// Returns whether the data set has this capture, decoded so.
    #[must_use]
    pub fn exists(&self, site: &DatasetSite) -> bool {
        let note = std::fs::read_to_string(self.path(site));
        note.is_ok_and(|note| note.lines().next() == Some(self.inputs.as_str()))
    }
}

/// The parts of one capture.
#[derive(Debug)]
pub struct DatasetWriter {
    site: DatasetSite,
    record: DecodeRecord,
    capture: CaptureFile,
    /// Threads that encode columns.
    jobs: usize,
    parts: BTreeMap<PathBuf, TableFile>,
    /// Folders of the parts that hold a descriptor, and when each was written to last.
    open: BTreeMap<PathBuf, u64>,
    writes: u64,
}

impl DatasetWriter {
    /// Begins the parts of a capture, whose columns are encoded by `jobs` threads.
    #[must_use]
    pub fn new(site: DatasetSite, record: DecodeRecord, capture: CaptureFile, jobs: usize) -> Self {
        let (parts, open) = (BTreeMap::new(), BTreeMap::new());
        Self { site, record, capture, jobs, parts, open, writes: 0 }
    }

    fn part_file(
        &mut self,
        table: TableKind,
        date: &str,
        bus: &str,
    ) -> Result<&mut TableFile, TableFileError> {
        let folder = Path::new(table.name())
            .join(format!("site={}", escape_name(&self.site.name)))
            .join(format!("date={date}"))
            .join(format!("bus={}", escape_name(bus)));
        self.writes += 1;
        // Many buses and days would otherwise hold more files open than the system permits.
        if self.open.insert(folder.clone(), self.writes).is_none() {
            self.make_room()?;
        }
        let key = self.record.blake3.get(..16).unwrap_or(&self.record.blake3);
        let part = folder.join(format!("part-{key}-0.parquet"));
        if !self.parts.contains_key(&part) && self.parts.len() >= PARTS_MAX {
            return Err(TableFileError::TooManyParts);
        }
        match self.parts.entry(part) {
            Entry::Occupied(entry) => Ok(entry.into_mut()),
            Entry::Vacant(entry) => {
                std::fs::create_dir_all(self.site.root.join(&folder))?;
                let path = self.site.root.join(entry.key());
                Ok(entry.insert(TableFile::create(&path, table, ColumnFormat::Parquet, self.jobs)?))
            }
        }
    }

    /// Closes the part that was not written to for longest, if there are too many.
    fn make_room(&mut self) -> Result<(), TableFileError> {
        if self.open.len() <= OPEN_MAX {
            return Ok(());
        }
        let oldest = self.open.iter().min_by_key(|(_, written_at)| **written_at);
        let Some(folder) = oldest.map(|(folder, _)| folder.clone()) else { return Ok(()) };
        self.open.remove(&folder);
        let mut parts = self.parts.range_mut(folder.clone()..);
        match parts.next().filter(|(part, _)| part.parent() == Some(&folder)) {
            Some((_, part)) => part.park(),
            None => Ok(()),
        }
    }

    /// Gives the parts their names. Replaced parts are removed: those of an earlier decode, and those of the
    /// capture before it grew.
    fn publish(
        &self,
        sealed: Vec<SealedFile>,
        parts: &BTreeSet<PathBuf>,
    ) -> Result<(), TableFileError> {
        let notes = DatasetNotes::lock(&self.site.root)?;
        // Under the lock, right before the files appear: a capture that grew meanwhile is decoded again.
        if !self.capture.is_unchanged() {
            return Err(TableFileError::Changed);
        }
        let (name, content) = (self.capture.name(), self.capture.content());
        let mut contents = notes.contents(name)?;
        let grown_from = self.capture.grown_from(&contents)?;
        contents.retain(|other| other.blake3 != content.blake3);
        contents.push(content.clone());
        // From here on a program that goes on after this one was killed knows what to remove.
        notes.write_contents(name, &contents)?;
        let earlier = notes.parts(&content.blake3)?;
        notes.begin(&content.blake3, parts)?;
        // After all are complete: a reader sees the data set with the whole capture, or without it.
        sealed.into_iter().try_for_each(SealedFile::publish)?;
        notes.remove_parts(&earlier, parts)?;
        for old in &grown_from {
            if !notes.is_shared(&old.blake3, name)? {
                notes.remove_parts(&notes.parts(&old.blake3)?, parts)?;
                notes.forget(&old.blake3)?;
            }
        }
        // Last: only a capture with this note counts as decoded.
        notes.finish(&content.blake3, &self.record.inputs, parts)?;
        contents.retain(|other| !grown_from.contains(other));
        Ok(notes.write_contents(name, &contents)?)
    }
}

impl BatchSink for DatasetWriter {
    fn write_batch(&mut self, table: TableKind, batch: &RecordBatch) -> Result<(), TableFileError> {
        for (date, of_day) in split_by_date(table, batch) {
            for (bus, rows) in split_by_bus(&of_day)? {
                self.part_file(table, &date, &bus)?.write(&rows)?;
            }
        }
        Ok(())
    }

    fn close(mut self: Box<Self>, provenance: &Provenance) -> Result<(), TableFileError> {
        let (mut sealed, mut parts) = (Vec::new(), BTreeSet::new());
        for (part, file) in core::mem::take(&mut self.parts) {
            sealed.push(file.seal(provenance)?);
            parts.insert(part);
        }
        self.publish(sealed, &parts)
    }
}

/// Notes a capture whose content the data set has under another name: it keeps the rows if that one grows.
///
/// # Errors
/// Those of the operating system.
pub fn note_copy(site: &DatasetSite, capture: &CaptureFile) -> std::io::Result<()> {
    let notes = DatasetNotes::lock(&site.root)?;
    let (mut contents, content) = (notes.contents(capture.name())?, capture.content());
    if contents.iter().any(|known| known.blake3 == content.blake3) {
        return Ok(());
    }
    contents.push(content.clone());
    notes.write_contents(capture.name(), &contents)
}

/// The rows of each day; they are in the order of time, those without a time first.
fn split_by_date(table: TableKind, batch: &RecordBatch) -> Vec<(String, RecordBatch)> {
    let Some(times) = batch.column_by_name(table.time_column()) else { return Vec::new() };
    let times = times.as_primitive::<Int64Type>();
    let (mut days, mut from) = (Vec::new(), 0);
    while from < batch.num_rows() {
        let here = row_day(from, times);
        let same = (from..batch.num_rows()).take_while(|row| row_day(*row, times) == here).count();
        days.push((here.map_or(NO_DATE.to_owned(), format_date), batch.slice(from, same)));
        from += same;
    }
    days
}

fn row_day(row: usize, times: &PrimitiveArray<Int64Type>) -> Option<i64> {
    times.is_valid(row).then(|| times.value(row).div_euclid(DAY_NS))
}

/// The rows of each bus.
fn split_by_bus(batch: &RecordBatch) -> Result<Vec<(String, RecordBatch)>, ArrowError> {
    let column = batch
        .column_by_name("bus")
        .ok_or_else(|| ArrowError::SchemaError("no column bus".to_owned()))?
        .as_dictionary::<Int32Type>();
    let (keys, names) = (column.keys(), column.values().as_string::<i32>());
    let mut there: Vec<i32> = keys.values().to_vec();
    there.sort_unstable();
    there.dedup();
    // Most batches are of one bus, and need no copy.
    if let [only] = there[..] {
        return Ok(vec![(key_name(only, names), batch.clone())]);
    }
    there
        .into_iter()
        .map(|key| {
            let mask: BooleanArray =
                keys.values().iter().map(|other| Some(*other == key)).collect();
            Ok((key_name(key, names), arrow_select::filter::filter_record_batch(batch, &mask)?))
        })
        .collect()
}

fn key_name(key: i32, names: &GenericByteArray<GenericStringType<i32>>) -> String {
    names.value(key as usize).to_owned()
}

/// The date of a day since 1970, after Howard Hinnant's `civil_from_days`.
fn format_date(day: i64) -> String {
    let z = day + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{:02}", doy - (153 * mp + 2) / 5 + 1)
}

/// A word as the name of a folder. A long one is cut, and gets its hash as a suffix.
fn escape_name(word: &str) -> String {
    let name = escape(word);
    if name.len() <= NAME_MAX {
        return name;
    }
    let hash = blake3::hash(word.as_bytes()).to_hex();
    format!("{}~{}", &name[..NAME_MAX], &hash[..16])
}

#[cfg(test)]
mod tests;
