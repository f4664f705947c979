//! The four tables, version 1. Names, types and meanings stay as they are; columns may be added.
//!
//! Integers are signed and times stand twice, in microseconds as a time stamp and in nanoseconds as
//! a number: Spark reads neither unsigned integers nor nanosecond stamps.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};

/// What the metadata of every file name as its schema.
pub const SCHEMA_ID: &str = "polepair-columns/1";

/// One of the tables of a decoded capture.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Table {
    /// A row for each frame, with its bytes.
    Frames,
    /// A row for each value that a frame told.
    Signals,
    /// A row for each request and how it ended.
    Transactions,
    /// A row for each fault, change of state, and thing that a healthy bus does not do.
    Events,
}

impl Table {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Frames, Self::Signals, Self::Transactions, Self::Events];

    /// Its word, and its files' name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Signals => "signals",
            Self::Transactions => "transactions",
            Self::Events => "events",
        }
    }

    /// The table of that word.
    #[must_use]
    pub fn named(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|table| table.name() == word)
    }

    /// Its columns, with the schema's name in the metadata.
    #[must_use]
    pub fn schema(self) -> SchemaRef {
        let fields: Vec<Field> = match self {
            Self::Frames => frames(),
            Self::Signals => signals(),
            Self::Transactions => transactions(),
            Self::Events => events(),
        };
        let said = [("polepair.schema", SCHEMA_ID), ("polepair.table", self.name())];
        let metadata: HashMap<String, String> =
            said.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
        Arc::new(Schema::new_with_metadata(fields, metadata))
    }

    /// The column by which its rows are in order.
    #[must_use]
    pub const fn time_column(self) -> &'static str {
        match self {
            Self::Transactions => "t_req_ns",
            _ => "t_ns",
        }
    }

    /// The column of an axis, if it has one.
    #[must_use]
    pub const fn axis_column(self) -> Option<&'static str> {
        match self {
            Self::Frames => None,
            _ => Some("axis"),
        }
    }
}

fn need(name: &str, kind: DataType) -> Field {
    Field::new(name, kind, false)
}

fn may(name: &str, kind: DataType) -> Field {
    Field::new(name, kind, true)
}

/// Strings by number, and the number's width that every reader takes.
fn words() -> DataType {
    DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8))
}

fn stamp() -> DataType {
    DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()))
}

fn frames() -> Vec<Field> {
    vec![
        may("t", stamp()),
        may("t_ns", DataType::Int64),
        need("source", words()),
        need("bus", words()),
        may("dir", DataType::Int8),
        may("protocol", words()),
        may("can_id", DataType::Int32),
        need("flags", DataType::Int32),
        need("data", DataType::Binary),
        need("file", words()),
        need("file_pos", DataType::Int64),
        need("seq", DataType::Int64),
    ]
}

fn signals() -> Vec<Field> {
    vec![
        may("t", stamp()),
        may("t_ns", DataType::Int64),
        need("source", words()),
        need("bus", words()),
        need("axis", DataType::Int32),
        need("signal", words()),
        need("value", DataType::Float64),
        may("value_i", DataType::Int64),
        need("unit", words()),
        need("quality", DataType::Int16),
        may("req_id", DataType::Int64),
        need("frame_seq", DataType::Int64),
    ]
}

fn transactions() -> Vec<Field> {
    vec![
        may("t_req_ns", DataType::Int64),
        may("t_rep_ns", DataType::Int64),
        may("rtt_us", DataType::Int64),
        may("axis", DataType::Int32),
        need("op", words()),
        need("outcome", words()),
        need("retries", DataType::Int16),
        need("source", words()),
        need("bus", words()),
    ]
}

fn events() -> Vec<Field> {
    vec![
        may("t", stamp()),
        may("t_ns", DataType::Int64),
        need("source", words()),
        need("bus", words()),
        may("axis", DataType::Int32),
        need("event", words()),
        need("name", words()),
        may("code", DataType::Int64),
        need("text", DataType::Utf8),
        need("cause", words()),
        need("remedy", words()),
        may("frame_seq", DataType::Int64),
    ]
}
