//! Decoded captures as columns: Arrow tables for whoever computes with them, and files of them.
//!
//! ```text
//!   capture   events and what their conversations tell
//!    └ Tables rows into batches of four tables       (Arrow; no file)
//!       └ Store  batches into a file                 (Parquet, or Arrow's file format)
//! ```
//! The tables' columns are described in `docs/reference/columns.md`; [`schema`] is where they are
//! stated.
#![forbid(unsafe_code)]

mod column;
pub mod schema;
mod store;
mod tables;

pub use schema::{SCHEMA_ID, Table};
pub use store::{DECODER, Provenance, Store, StoreError, Stored};
pub use tables::{Origin, ROWS_MAX, Tables};
