//! A Parquet file whose columns are encoded and compressed in parallel. Each column is encoded separately
//! in the order of its rows, so the bytes do not depend on the number of threads.

use std::sync::{Arc, Mutex, PoisonError};

use arrow_array::RecordBatch;
use arrow_schema::{DataType, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::{
    ArrowColumnChunk, ArrowColumnWriter, ArrowLeafColumn, ArrowRowGroupWriterFactory,
    compute_leaves,
};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterPropertiesBuilder};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;
use polepair_files::AtomicFile;

use crate::provenance::{DECODER, Provenance};
use crate::schema::TableKind;

/// Rows of a row group.
const GROUP_ROWS: usize = 1 << 20;
const ZSTD_LEVEL: i32 = 3;
/// Rows that are worth a thread.
const ROWS_MIN: usize = 1 << 11;

/// A file under way.
pub(crate) struct ParquetFile {
    file: SerializedFileWriter<AtomicFile>,
    factory: ArrowRowGroupWriterFactory,
    schema: SchemaRef,
    /// The columns of the row group under way.
    columns: Vec<ArrowColumnWriter>,
    rows: usize,
    jobs: usize,
}

impl ParquetFile {
    /// Begins a file of a table, whose columns are encoded by `jobs` threads.
    pub fn create(file: AtomicFile, table: TableKind, jobs: usize) -> Result<Self, ParquetError> {
        let schema = table.schema();
        let writer =
            ArrowWriter::try_new(file, Arc::clone(&schema), Some(writer_properties(table)))?;
        let (file, factory) = writer.into_serialized_writer()?;
        Ok(Self { file, factory, schema, columns: Vec::new(), rows: 0, jobs })
    }

    /// Adds rows.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), ParquetError> {
        let (mut from, all) = (0, batch.num_rows());
        while from < all {
            let count = (all - from).min(GROUP_ROWS - self.rows);
            self.add_rows(&batch.slice(from, count))?;
            from += count;
            if self.rows == GROUP_ROWS {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn add_rows(&mut self, batch: &RecordBatch) -> Result<(), ParquetError> {
        if self.columns.is_empty() {
            let group = self.file.flushed_row_groups().len();
            self.columns = self.factory.create_column_writers(group)?;
        }
        let fields = self.schema.fields().iter().zip(batch.columns());
        let leaves = fields.map(|(field, column)| compute_leaves(field, column));
        let leaves: Vec<ArrowLeafColumn> =
            leaves.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
        let jobs = if batch.num_rows() < ROWS_MIN { 1 } else { self.jobs };
        let work = self.columns.iter_mut().zip(leaves).collect();
        run_parallel(jobs, work, |(column, leaf)| column.write(&leaf))?;
        self.rows += batch.num_rows();
        Ok(())
    }

    /// Ends the row group under way, and closes the file until the next rows.
    pub fn park(&mut self) -> Result<(), ParquetError> {
        self.flush()?;
        Ok(self.file.inner_mut().park()?)
    }

    /// Ends the row group under way.
    fn flush(&mut self) -> Result<(), ParquetError> {
        let columns = core::mem::take(&mut self.columns);
        if columns.is_empty() {
            return Ok(());
        }
        self.rows = 0;
        let chunks = run_parallel(self.jobs, columns, ArrowColumnWriter::close)?;
        let mut group = self.file.next_row_group()?;
        let mut chunks = chunks.into_iter();
        chunks.try_for_each(|chunk: ArrowColumnChunk| chunk.append_to_row_group(&mut group))?;
        group.close()?;
        Ok(())
    }

    /// Ends the file.
    pub fn close(mut self, provenance: &Provenance) -> Result<AtomicFile, ParquetError> {
        self.flush()?;
        for (key, value) in provenance.pairs() {
            let pair = KeyValue::new(key.to_owned(), value.to_owned());
            self.file.append_key_value_metadata(pair);
        }
        self.file.into_inner()
    }
}

/// Does work on each of some things, on several threads; the results are in the order of the things.
fn run_parallel<T: Send, R: Send>(
    jobs: usize,
    things: Vec<T>,
    work: impl Fn(T) -> Result<R, ParquetError> + Sync,
) -> Result<Vec<R>, ParquetError> {
    let jobs = jobs.min(things.len());
    if jobs < 2 {
        return things.into_iter().map(work).collect();
    }
    let waiting = Mutex::new(things.into_iter().enumerate());
    let next = || waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
    let some = || {
        let mut done = Vec::new();
        while let Some((at, thing)) = next() {
            done.push((at, work(thing)));
        }
        done
    };
    let mut done = std::thread::scope(|scope| {
        let others: Vec<_> = (1..jobs).map(|_| scope.spawn(some)).collect();
        let mut done = some();
        for other in others {
            match other.join() {
                Ok(more) => done.extend(more),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        done
    });
    done.sort_unstable_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

fn writer_properties(table: TableKind) -> WriterProperties {
    let level = ZstdLevel::try_new(ZSTD_LEVEL).unwrap_or_default();
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(level))
        .set_created_by(format!("polepair {DECODER}"));
    for field in table.schema().fields() {
        let column = ColumnPath::from(field.name().as_str());
        properties = set_encoding(properties, column, field.name(), field.data_type());
    }
    if let Some(axis) = table.axis_column() {
        // Axes are few: so is what their filter takes.
        properties = properties
            .set_column_bloom_filter_enabled(ColumnPath::from(axis), true)
            .set_column_bloom_filter_max_ndv(ColumnPath::from(axis), 1 << 10);
    }
    properties.build()
}

/// Sets the encoding of a column. Dictionaries are for words: numbers that go on from row to row are shorter as
/// differences, and values and bytes of frames are mostly as many as there are rows.
fn set_encoding(
    properties: WriterPropertiesBuilder,
    column: ColumnPath,
    name: &str,
    kind: &DataType,
) -> WriterPropertiesBuilder {
    match kind {
        DataType::Float64 => without_dictionary(properties, Encoding::PLAIN, &column),
        DataType::Binary => {
            without_dictionary(properties, Encoding::DELTA_LENGTH_BYTE_ARRAY, &column)
                .set_column_statistics_enabled(column, EnabledStatistics::None)
        }
        kind if kind.is_integer() || matches!(kind, DataType::Timestamp(..)) => {
            without_dictionary(properties, Encoding::DELTA_BINARY_PACKED, &column)
        }
        // Minimum and maximum of these are of no use in a query.
        _ if matches!(name, "signal" | "unit" | "protocol") => {
            properties.set_column_statistics_enabled(column, EnabledStatistics::None)
        }
        _ => properties,
    }
}

fn without_dictionary(
    properties: WriterPropertiesBuilder,
    encoding: Encoding,
    column: &ColumnPath,
) -> WriterPropertiesBuilder {
    properties
        .set_column_dictionary_enabled(column.clone(), false)
        .set_column_encoding(column.clone(), encoding)
}
