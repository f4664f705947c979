//! Writes batches to files: Parquet, or Arrow's file format.

use std::path::Path;

use arrow_array::RecordBatch;
use arrow_ipc::writer::{DictionaryHandling, FileWriter, IpcWriteOptions};
use arrow_schema::ArrowError;
use parquet::errors::ParquetError;
use polepair_files::{AtomicFile, SealedFile};

use crate::parquet_file::ParquetFile;
use crate::provenance::Provenance;
use crate::schema::TableKind;

/// File format of columns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ColumnFormat {
    /// Parquet, compressed.
    Parquet,
    /// Arrow's file format (Feather 2), as it lies in memory.
    Arrow,
}

impl ColumnFormat {
    /// File name extension.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Arrow => "arrow",
        }
    }
}

/// Errors of a file of columns.
#[derive(Debug)]
pub enum TableFileError {
    /// The operating system.
    Io(std::io::Error),
    /// Arrow or Parquet.
    Columns(Box<dyn std::error::Error + Send + Sync>),
    /// The capture was written to while it was read, so nothing is known of its content.
    Changed,
    /// The capture has more days and buses than one capture can have.
    TooManyParts,
}

impl core::fmt::Display for TableFileError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Columns(error) => error.fmt(f),
            Self::Changed => f.write_str("the capture changed while it was read"),
            Self::TooManyParts => f.write_str("the capture has too many days or buses"),
        }
    }
}

impl std::error::Error for TableFileError {}

impl From<std::io::Error> for TableFileError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<ArrowError> for TableFileError {
    fn from(error: ArrowError) -> Self {
        match error {
            ArrowError::IoError(_, error) => Self::Io(error),
            error => Self::Columns(Box::new(error)),
        }
    }
}

impl From<ParquetError> for TableFileError {
    fn from(error: ParquetError) -> Self {
        match error {
            ParquetError::External(error) => match error.downcast::<std::io::Error>() {
                Ok(error) => Self::Io(*error),
                Err(error) => Self::Columns(error),
            },
            error => Self::Columns(Box::new(error)),
        }
    }
}

/// One file under way. It has a temporary name until what [`seal`](Self::seal) returns is published: a file with
/// its own name is whole.
#[derive(Debug)]
pub struct TableFile {
    writer: TableFileWriter,
}

enum TableFileWriter {
    Parquet(Box<ParquetFile>),
    Arrow(Box<FileWriter<AtomicFile>>),
}

impl core::fmt::Debug for TableFileWriter {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Parquet(_) => "Parquet",
            Self::Arrow(_) => "Arrow",
        })
    }
}

impl TableFile {
    /// Begins a file, whose columns are encoded by `jobs` threads.
    ///
    /// # Errors
    /// [`TableFileError`] when it cannot be created.
    pub fn create(
        path: &Path,
        table: TableKind,
        stored: ColumnFormat,
        jobs: usize,
    ) -> Result<Self, TableFileError> {
        let file = AtomicFile::create(path)?;
        let schema = table.schema();
        let writer = match stored {
            ColumnFormat::Parquet => {
                TableFileWriter::Parquet(Box::new(ParquetFile::create(file, table, jobs)?))
            }
            ColumnFormat::Arrow => {
                // Words are added as they come: later batches have more of them than the first.
                let options =
                    IpcWriteOptions::default().with_dictionary_handling(DictionaryHandling::Delta);
                let writer = FileWriter::try_new_with_options(file, &schema, options)?;
                TableFileWriter::Arrow(Box::new(writer))
            }
        };
        Ok(Self { writer })
    }

    /// Adds rows.
    ///
    /// # Errors
    /// [`TableFileError`] when they cannot be written.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), TableFileError> {
        match &mut self.writer {
            TableFileWriter::Parquet(writer) => writer.write(batch)?,
            TableFileWriter::Arrow(writer) => writer.write(batch)?,
        }
        Ok(())
    }

    /// Writes the rows in memory, and closes the file until the next rows.
    ///
    /// # Errors
    /// [`TableFileError`] when it cannot be written.
    pub fn park(&mut self) -> Result<(), TableFileError> {
        match &mut self.writer {
            TableFileWriter::Parquet(writer) => Ok(writer.park()?),
            TableFileWriter::Arrow(writer) => Ok(writer.get_mut().park()?),
        }
    }

    /// Ends the file without giving it its name.
    ///
    /// # Errors
    /// [`TableFileError`] when it cannot be written.
    pub fn seal(self, provenance: &Provenance) -> Result<SealedFile, TableFileError> {
        let file = match self.writer {
            TableFileWriter::Parquet(writer) => writer.close(provenance)?,
            TableFileWriter::Arrow(mut writer) => {
                for (key, value) in provenance.pairs() {
                    writer.write_metadata(key, value);
                }
                writer.finish()?;
                writer.into_inner()?
            }
        };
        Ok(file.seal()?)
    }
}

/// The files of one decoded capture, a table each, in one folder: `frames.parquet` and so on.
#[derive(Debug)]
pub struct TableFiles {
    stores: Vec<(TableKind, TableFile)>,
}

impl TableFiles {
    /// Begins a file for each table, so that each exists even without a row; `jobs` threads encode its columns.
    ///
    /// # Errors
    /// [`TableFileError`] when the folder or a file cannot be created.
    pub fn create(
        folder: &Path,
        tables: &[TableKind],
        stored: ColumnFormat,
        jobs: usize,
    ) -> Result<Self, TableFileError> {
        std::fs::create_dir_all(folder)?;
        Ok(Self {
            stores: tables
                .iter()
                .map(|table| {
                    let path = folder.join(table.name()).with_extension(stored.extension());
                    Ok((*table, TableFile::create(&path, *table, stored, jobs)?))
                })
                .collect::<Result<_, TableFileError>>()?,
        })
    }
}

/// Takes the batches of one capture.
pub trait BatchSink: Send {
    /// Takes some rows of a table.
    ///
    /// # Errors
    /// [`TableFileError`] when they cannot be written.
    fn write_batch(&mut self, table: TableKind, batch: &RecordBatch) -> Result<(), TableFileError>;

    /// Ends the files and gives them their names.
    ///
    /// # Errors
    /// [`TableFileError`] when they cannot be written.
    fn close(self: Box<Self>, provenance: &Provenance) -> Result<(), TableFileError>;
}

impl BatchSink for TableFiles {
    fn write_batch(&mut self, table: TableKind, batch: &RecordBatch) -> Result<(), TableFileError> {
        let mut stores = self.stores.iter_mut();
        stores.find(|(of, _)| *of == table).map_or(Ok(()), |(_, store)| store.write(batch))
    }

    fn close(self: Box<Self>, provenance: &Provenance) -> Result<(), TableFileError> {
        // All are complete before the first replaces an older one: tables of two captures do not mix.
        let sealed = self.stores.into_iter().map(|(_, store)| store.seal(provenance));
        let sealed: Vec<SealedFile> = sealed.collect::<Result<_, _>>()?;
        Ok(sealed.into_iter().try_for_each(SealedFile::publish)?)
    }
}
