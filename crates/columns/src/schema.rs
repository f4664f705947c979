//! The four tables, version 1. Names, types and meanings are constant; columns may be added.
//!
//! Integers are signed, and times exist twice: in microseconds as time stamp, and in nanoseconds as number.
//! Spark supports neither unsigned integers nor time stamps in nanoseconds.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};

/// Schema name in the metadata of every file.
pub const SCHEMA_ID: &str = "polepair-columns/1";

/// One of the tables of a decoded capture.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum TableKind {
    /// A row for each frame, with its bytes.
    Frames,
    /// A row for each value of a frame.
    Signals,
    /// A row for each request and how it ended.
    Transactions,
    /// A row for each fault, change of state, and thing that a healthy bus does not do.
    Events,
}

impl TableKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Frames, Self::Signals, Self::Transactions, Self::Events];

    /// Name of the table, and of its files.
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
    pub fn from_name(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|table| table.name() == word)
    }

    /// Schema of the table, with the schema's name in the metadata.
    #[must_use]
    pub fn schema(self) -> SchemaRef {
        let fields: Vec<Field> = match self {
            Self::Frames => frame_fields(),
            Self::Signals => signal_fields(),
            Self::Transactions => transaction_fields(),
            Self::Events => event_fields(),
        };
        let lines = [("polepair.schema", SCHEMA_ID), ("polepair.table", self.name())];
        let metadata: HashMap<String, String> =
            lines.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
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

fn required(name: &str, kind: DataType) -> Field {
    Field::new(name, kind, false)
}

fn nullable(name: &str, kind: DataType) -> Field {
    Field::new(name, kind, true)
}

/// Strings by number, and the number's width that every reader takes.
fn word_type() -> DataType {
    DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8))
}

fn timestamp_type() -> DataType {
    DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()))
}

fn frame_fields() -> Vec<Field> {
    vec![
        nullable("t", timestamp_type()),
        nullable("t_ns", DataType::Int64),
        required("source", word_type()),
        required("bus", word_type()),
        nullable("dir", DataType::Int8),
        nullable("protocol", word_type()),
        nullable("can_id", DataType::Int32),
        required("flags", DataType::Int32),
        required("data", DataType::Binary),
        required("file", word_type()),
        required("file_pos", DataType::Int64),
        required("seq", DataType::Int64),
    ]
}

fn signal_fields() -> Vec<Field> {
    vec![
        nullable("t", timestamp_type()),
        nullable("t_ns", DataType::Int64),
        required("source", word_type()),
        required("bus", word_type()),
        required("axis", DataType::Int32),
        required("signal", word_type()),
        required("value", DataType::Float64),
        nullable("value_i", DataType::Int64),
        required("unit", word_type()),
        required("quality", DataType::Int16),
        nullable("req_id", DataType::Int64),
        required("frame_seq", DataType::Int64),
    ]
}

fn transaction_fields() -> Vec<Field> {
    vec![
        nullable("t_req_ns", DataType::Int64),
        nullable("t_rep_ns", DataType::Int64),
        nullable("rtt_us", DataType::Int64),
        nullable("axis", DataType::Int32),
        required("op", word_type()),
        required("outcome", word_type()),
        required("retries", DataType::Int16),
        required("source", word_type()),
        required("bus", word_type()),
    ]
}

fn event_fields() -> Vec<Field> {
    vec![
        nullable("t", timestamp_type()),
        nullable("t_ns", DataType::Int64),
        required("source", word_type()),
        required("bus", word_type()),
        nullable("axis", DataType::Int32),
        required("event", word_type()),
        required("name", word_type()),
        nullable("code", DataType::Int64),
        required("text", DataType::Utf8),
        required("cause", word_type()),
        required("remedy", word_type()),
        nullable("frame_seq", DataType::Int64),
    ]
}
