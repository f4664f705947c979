//! A data set of many captures: `TABLE/site=…/date=YYYY-MM-DD/bus=…/part-….parquet`.
//!
//! The name of a part is the BLAKE3 hash of its capture, so decoding it again replaces the part. A capture
//! is complete when its note in `_done` is written, which is the last step. The next run overwrites
//! incomplete parts.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::{Int32Type, Int64Type};
use arrow_array::{Array, BooleanArray, RecordBatch};
use arrow_schema::ArrowError;

use crate::schema::{SCHEMA_ID, TableKind};
use crate::table_file::{BatchSink, ColumnFormat, DECODER, Provenance, TableFile, TableFileError};

/// Parts that are written at once; each holds a row group in memory.
const OPEN_MAX: usize = 24;
const DAY_NS: i64 = 86_400_000_000_000;
/// What rows without a time have as their date: readers of partitions take it for null.
const NO_DATE: &str = "__HIVE_DEFAULT_PARTITION__";
/// The folder of notes about what is done. Readers of data sets pass over names with this dash first.
const RECORDS_FOLDER: &str = "_done";

/// Where a data set is, and whose captures go there.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DatasetSite {
    /// The data set's folder.
    pub root: PathBuf,
    /// The plant, cell or machine, as the partition has it.
    pub name: String,
}

/// That a capture is decoded, and by what.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DecodeRecord {
    /// BLAKE3 of the capture, hexadecimal.
    pub blake3: String,
    /// All that what is decoded depends on beside the capture.
    pub inputs: String,
}

impl DecodeRecord {
    /// A capture, and what was stated for its decoding.
    #[must_use]
    pub fn new(site: &DatasetSite, blake3: &str, stated: &str, tables: &[TableKind]) -> Self {
        let tables: Vec<&str> = tables.iter().map(|table| table.name()).collect();
        let tables = tables.join(",");
        let by = format!("{SCHEMA_ID} {DECODER} site={} tables={tables} {stated}", site.name);
        Self { blake3: blake3.to_owned(), inputs: by.replace('\n', " ") }
    }

    fn path(&self, site: &DatasetSite) -> PathBuf {
        site.root.join(RECORDS_FOLDER).join(&self.blake3)
    }

    /// Whether the data set has this capture, decoded so.
    #[must_use]
    pub fn exists(&self, site: &DatasetSite) -> bool {
        let note = std::fs::read_to_string(self.path(site)).unwrap_or_default();
        note.lines().next() == Some(self.inputs.as_str())
    }
}

/// The parts of one capture.
#[derive(Debug)]
pub struct DatasetWriter {
    site: DatasetSite,
    record: DecodeRecord,
    /// Threads that encode columns.
    jobs: usize,
    open: BTreeMap<PathBuf, TableFile>,
    /// All parts, from the data set's folder on.
    written: Vec<PathBuf>,
    /// Parts that were ended before the capture did, because there were too many.
    closed: Vec<TableFile>,
}

impl DatasetWriter {
    /// Begins the parts of a capture, whose columns so many threads encode.
    #[must_use]
    pub fn new(site: DatasetSite, record: DecodeRecord, jobs: usize) -> Self {
        Self { site, record, jobs, open: BTreeMap::new(), written: Vec::new(), closed: Vec::new() }
    }

    fn part_file(
        &mut self,
        table: TableKind,
        date: &str,
        bus: &str,
    ) -> Result<&mut TableFile, TableFileError> {
        let folder = Path::new(table.name())
            .join(format!("site={}", escape(&self.site.name)))
            .join(format!("date={date}"))
            .join(format!("bus={}", escape(bus)));
        if !self.open.contains_key(&folder) {
            self.make_room()?;
            let same = self.written.iter().filter(|part| part.parent() == Some(&folder)).count();
            let key = self.record.blake3.get(..16).unwrap_or(&self.record.blake3);
            let part = folder.join(format!("part-{key}-{same}.parquet"));
            std::fs::create_dir_all(self.site.root.join(&folder))?;
            let store = TableFile::create(
                &self.site.root.join(&part),
                table,
                ColumnFormat::Parquet,
                self.jobs,
            )?;
            self.written.push(part);
            self.open.insert(folder.clone(), store);
        }
        self.open
            .get_mut(&folder)
            .ok_or_else(|| std::io::ErrorKind::NotFound.into())
            .map_err(|error: std::io::Error| error.into())
    }

    fn make_room(&mut self) -> Result<(), TableFileError> {
        if self.open.len() >= OPEN_MAX
            && let Some((_, mut store)) = self.open.pop_first()
        {
            store.flush()?;
            self.closed.push(store);
        }
        Ok(())
    }

    /// Takes away what an earlier decode of this capture gave and this one does not.
    fn remove_stale_parts(&self) {
        let note = std::fs::read_to_string(self.record.path(&self.site)).unwrap_or_default();
        let earlier = note.lines().skip(1).map(Path::new);
        for part in earlier.filter(|part| !self.written.iter().any(|new| new == part)) {
            let inside = part.components().all(|c| matches!(c, std::path::Component::Normal(_)));
            if inside {
                let _ = std::fs::remove_file(self.site.root.join(part));
            }
        }
    }

    fn write_record(&self) -> std::io::Result<()> {
        let path = self.record.path(&self.site);
        let mut note = format!("{}\n", self.record.inputs);
        for part in &self.written {
            let _ = writeln!(note, "{}", part.display());
        }
        std::fs::create_dir_all(self.site.root.join(RECORDS_FOLDER))?;
        let temporary = path.with_extension("part");
        std::fs::write(&temporary, note)?;
        std::fs::rename(temporary, path)
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
        let open = core::mem::take(&mut self.open).into_values();
        let all = core::mem::take(&mut self.closed).into_iter().chain(open);
        all.into_iter().try_for_each(|store| store.close(provenance))?;
        self.remove_stale_parts();
        Ok(self.write_record()?)
    }
}

/// The rows of each day; they are in the order of time, those without a time first.
fn split_by_date(table: TableKind, batch: &RecordBatch) -> Vec<(String, RecordBatch)> {
    let Some(times) = batch.column_by_name(table.time_column()) else { return Vec::new() };
    let times = times.as_primitive::<Int64Type>();
    let day = |row: usize| times.is_valid(row).then(|| times.value(row).div_euclid(DAY_NS));
    let (mut days, mut from) = (Vec::new(), 0);
    while from < batch.num_rows() {
        let here = day(from);
        let same = (from..batch.num_rows()).take_while(|row| day(*row) == here).count();
        days.push((here.map_or(NO_DATE.to_owned(), format_date), batch.slice(from, same)));
        from += same;
    }
    days
}

/// The rows of each bus.
fn split_by_bus(batch: &RecordBatch) -> Result<Vec<(String, RecordBatch)>, ArrowError> {
    let missing = || ArrowError::SchemaError("no column bus".to_owned());
    let column = batch.column_by_name("bus").ok_or_else(missing)?.as_dictionary::<Int32Type>();
    let (keys, names) = (column.keys(), column.values().as_string::<i32>());
    let mut there: Vec<i32> = keys.values().to_vec();
    there.sort_unstable();
    there.dedup();
    let name = |key: i32| names.value(key as usize).to_owned();
    if let [only] = there[..] {
        return Ok(vec![(name(only), batch.clone())]);
    }
    let rows = |key: i32| {
        let mask: BooleanArray = keys.values().iter().map(|other| Some(*other == key)).collect();
        Ok((name(key), arrow_select::filter::filter_record_batch(batch, &mask)?))
    };
    there.into_iter().map(rows).collect()
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

/// A word as part of a path, other signs than letters, digits, `-`, `_` and `.` by their bytes: `%2F`.
fn escape(word: &str) -> String {
    let mut out = String::new();
    for byte in word.bytes() {
        let plain = byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        match plain {
            true => out.push(byte.into()),
            false => _ = write!(out, "%{byte:02X}"),
        }
    }
    if out.is_empty() { NO_DATE.to_owned() } else { out }
}

#[cfg(test)]
mod tests;
