//! Decoded captures as columns: Arrow tables for programs that compute with them, and files of them.
//!
//! ```text
//!   capture   events and the results of their conversations
//!    └ TablesBuilder rows into batches of four tables       (Arrow; no file)
//!       ├ BatchBuilder    the same on each of several threads
//!       ├ DictionaryMerger  several builders' batches as one's
//!       ├ TableFiles  batches into four files             (Parquet, or Arrow's file format)
//!       └ DatasetWriter  batches into a partitioned data set (Parquet)
//! ```
//! The tables' columns are described in `docs/reference/columns.md`; [`schema`] is where they are
//! stated.
#![forbid(unsafe_code)]

mod batch_builder;
#[cfg(feature = "files")]
mod capture_file;
mod column;
#[cfg(feature = "files")]
mod dataset;
mod dictionary_merger;
#[cfg(feature = "files")]
mod parquet_file;
#[cfg(feature = "files")]
mod path_word;
mod provenance;
pub mod schema;
mod table_file;
mod tables;

pub use arrow_array::RecordBatch;
pub use arrow_schema::ArrowError;
pub use batch_builder::{BatchBuilder, BuiltBatches};
#[cfg(feature = "files")]
pub use capture_file::{CaptureContent, CaptureFile};
#[cfg(feature = "files")]
pub use dataset::{DatasetLock, DatasetSite, DatasetWriter, DecodeRecord, note_copy, text_hash};
pub use dictionary_merger::DictionaryMerger;
#[cfg(feature = "files")]
pub use provenance::{DECODER, Provenance};
pub use schema::{SCHEMA_ID, TableKind};
pub use table_file::{BatchSink, ColumnFormat, TableFile, TableFileError, TableFiles};
pub use tables::{CaptureOrigin, ROWS_MAX, TablesBuilder};
