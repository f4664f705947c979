//! Decoded captures as columns: Arrow tables for whoever computes with them, and files of them.
//!
//! ```text
//!   capture   events and what their conversations tell
//!    └ Tables rows into batches of four tables       (Arrow; no file)
//!       ├ Builder    the same on each of several threads
//!       ├ Numbering  several builders' batches as one's
//!       ├ Files  batches into four files             (Parquet, or Arrow's file format)
//!       └ Parts  batches into a partitioned data set (Parquet)
//! ```
//! The tables' columns are described in `docs/reference/columns.md`; [`schema`] is where they are
//! stated.
#![forbid(unsafe_code)]

mod build;
mod column;
#[cfg(feature = "files")]
mod encode;
mod numbering;
#[cfg(feature = "files")]
mod parts;
pub mod schema;
#[cfg(feature = "files")]
mod store;
mod tables;

pub use arrow_array::RecordBatch;
pub use arrow_schema::ArrowError;
pub use build::{Builder, Built};
pub use numbering::Numbering;
#[cfg(feature = "files")]
pub use parts::{Done, Parts, Site};
pub use schema::{SCHEMA_ID, Table};
#[cfg(feature = "files")]
pub use store::{DECODER, Files, Keep, Provenance, Store, StoreError, Stored, fingerprint};
pub use tables::{Origin, ROWS_MAX, Tables};
