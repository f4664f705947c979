//! Batches into files: Parquet, or Arrow's own file format.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use arrow_ipc::writer::{DictionaryHandling, FileWriter, IpcWriteOptions};
use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

use crate::encode::Parquet;
use crate::schema::Table;

/// How columns are stored.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stored {
    /// Parquet, compressed.
    Parquet,
    /// Arrow's file format (Feather 2), as it lies in memory.
    Arrow,
}

impl Stored {
    /// How its files end.
    #[must_use]
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Arrow => "arrow",
        }
    }
}

/// By what a decode can be repeated: stands in every file's metadata.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Provenance {
    /// The capture's file name.
    pub file: String,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
    /// Protocols that were stated or found, as `--as` takes them.
    pub rules: String,
    /// The drive whose names were stated; empty for usual ones.
    pub profile: String,
}

/// The version of the decoder that wrote a file.
pub const DECODER: &str = env!("CARGO_PKG_VERSION");

impl Provenance {
    /// Keys and values of the metadata.
    #[must_use]
    pub fn pairs(&self) -> [(&'static str, &str); 5] {
        [
            ("polepair.decoder", DECODER),
            ("polepair.source.file", &self.file),
            ("polepair.source.blake3", &self.blake3),
            ("polepair.rules", &self.rules),
            ("polepair.profile", &self.profile),
        ]
    }
}

/// What can go wrong with a file of columns.
#[derive(Debug)]
pub enum StoreError {
    /// The operating system.
    Io(std::io::Error),
    /// Arrow or Parquet.
    Columns(Box<dyn std::error::Error + Send + Sync>),
}

impl core::fmt::Display for StoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Columns(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for StoreError {}

impl From<std::io::Error> for StoreError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<ArrowError> for StoreError {
    fn from(error: ArrowError) -> Self {
        match error {
            ArrowError::IoError(_, error) => Self::Io(error),
            error => Self::Columns(Box::new(error)),
        }
    }
}

impl From<ParquetError> for StoreError {
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

/// One file under way. It has a temporary name until it is [closed](Self::close): a file with its own
/// name is whole.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    writer: Writer,
}

enum Writer {
    Parquet(Box<Parquet>),
    Arrow(Box<FileWriter<BufWriter<File>>>),
}

impl core::fmt::Debug for Writer {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Parquet(_) => "Parquet",
            Self::Arrow(_) => "Arrow",
        })
    }
}

impl Store {
    /// Begins a file, whose columns so many threads encode.
    ///
    /// # Errors
    /// [`StoreError`] when it cannot be created.
    pub fn create(
        path: &Path,
        table: Table,
        stored: Stored,
        jobs: usize,
    ) -> Result<Self, StoreError> {
        let file = BufWriter::new(File::create(temporary(path))?);
        let schema = table.schema();
        let writer = match stored {
            Stored::Parquet => Writer::Parquet(Box::new(Parquet::create(file, table, jobs)?)),
            Stored::Arrow => {
                // Words are added as they come: later batches have more of them than the first.
                let options =
                    IpcWriteOptions::default().with_dictionary_handling(DictionaryHandling::Delta);
                let writer = FileWriter::try_new_with_options(file, &schema, options)?;
                Writer::Arrow(Box::new(writer))
            }
        };
        Ok(Self { path: path.to_owned(), writer })
    }

    /// Adds rows.
    ///
    /// # Errors
    /// [`StoreError`] when they cannot be written.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), StoreError> {
        match &mut self.writer {
            Writer::Parquet(writer) => writer.write(batch)?,
            Writer::Arrow(writer) => writer.write(batch)?,
        }
        Ok(())
    }

    /// Writes what is gathered in memory.
    ///
    /// # Errors
    /// [`StoreError`] when it cannot be written.
    pub fn flush(&mut self) -> Result<(), StoreError> {
        match &mut self.writer {
            Writer::Parquet(writer) => Ok(writer.flush()?),
            Writer::Arrow(_) => Ok(()),
        }
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// [`StoreError`] when it cannot be written.
    pub fn close(self, provenance: &Provenance) -> Result<(), StoreError> {
        let Self { path, writer } = self;
        let file = match writer {
            Writer::Parquet(writer) => writer.close(provenance)?,
            Writer::Arrow(mut writer) => {
                for (key, value) in provenance.pairs() {
                    writer.write_metadata(key, value);
                }
                writer.finish()?;
                writer.into_inner()?
            }
        };
        let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        file.sync_all()?;
        Ok(std::fs::rename(temporary(&path), path)?)
    }
}

/// The files of one decoded capture, a table each, in one folder: `frames.parquet` and so on.
#[derive(Debug)]
pub struct Files {
    stores: Vec<(Table, Store)>,
}

impl Files {
    /// Begins a file for each table, so that each is there even without a row; so many threads encode
    /// its columns.
    ///
    /// # Errors
    /// [`StoreError`] when the folder or a file cannot be created.
    pub fn create(
        folder: &Path,
        tables: &[Table],
        stored: Stored,
        jobs: usize,
    ) -> Result<Self, StoreError> {
        std::fs::create_dir_all(folder)?;
        let store = |table: &Table| {
            let path = folder.join(table.name()).with_extension(stored.ending());
            Ok((*table, Store::create(&path, *table, stored, jobs)?))
        };
        Ok(Self { stores: tables.iter().map(store).collect::<Result<_, StoreError>>()? })
    }
}

/// Takes the batches of one capture.
pub trait Keep: Send {
    /// Takes some rows of a table.
    ///
    /// # Errors
    /// [`StoreError`] when they cannot be written.
    fn batch(&mut self, table: Table, batch: &RecordBatch) -> Result<(), StoreError>;

    /// Ends the files and gives them their names.
    ///
    /// # Errors
    /// [`StoreError`] when they cannot be written.
    fn close(self: Box<Self>, provenance: &Provenance) -> Result<(), StoreError>;
}

/// BLAKE3 of a file, hexadecimal.
///
/// # Errors
/// Those of the operating system.
pub fn fingerprint(path: &Path) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    std::io::copy(&mut File::open(path)?, &mut hasher)?;
    Ok(hasher.finalize().to_hex().to_string())
}

impl Keep for Files {
    fn batch(&mut self, table: Table, batch: &RecordBatch) -> Result<(), StoreError> {
        let mut stores = self.stores.iter_mut();
        stores.find(|(of, _)| *of == table).map_or(Ok(()), |(_, store)| store.write(batch))
    }

    fn close(self: Box<Self>, provenance: &Provenance) -> Result<(), StoreError> {
        self.stores.into_iter().try_for_each(|(_, store)| store.close(provenance))
    }
}

/// The name of a file that is not whole yet. Readers of data sets pass over names with a dot first.
fn temporary(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.part"))
}
