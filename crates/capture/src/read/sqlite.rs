//! SQLite databases of python-can: a table with the columns `ts`, `arbitration_id`, `extended`, `remote`,
//! `error`, `dlc` and `data`, a frame a row.
//!
//! SQLite needs the whole file, so records come at the end of the capture. The database is opened in memory
//! and read-only. A file may be hostile: only plain tables without generated columns are read, values have a
//! bounded length, and the number of rows is bounded by the length of the file.

use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row};

use super::csv::build_python_can_frame;
use super::{CapturePosition, Damage, FormatReader, ReadError, RecordSink};
use crate::record::Record;
use crate::timestamp::Timestamp;

/// Bytes that a database may have at most: SQLite's own limit for databases in memory.
const DATABASE_MAX: usize = 1 << 30;
/// Bytes that a value may have at most.
const VALUE_MAX: i32 = 1 << 16;
/// Bytes that a row takes at least: its cell and the pointer to it.
const ROW_MIN: u64 = 8;
/// The bytes that state how a database is written and read, and their value if it has a write-ahead log.
const WAL_BYTES: core::ops::Range<usize> = 18..20;
const HAS_WAL: u8 = 2;

/// Tables with all columns of python-can, none of which is computed.
const TABLES: &str = "SELECT name FROM pragma_table_list WHERE schema = 'main' AND type = 'table' AND 7 = \
    (SELECT count(*) FROM pragma_table_xinfo(pragma_table_list.name) AS columns \
     WHERE columns.hidden = 0 AND columns.name IN \
     ('ts', 'arbitration_id', 'extended', 'remote', 'error', 'dlc', 'data'))";

const TOO_LONG: ReadError = ReadError("the database has more than 1 GiB: export it in parts");
const WRITE_AHEAD: ReadError = ReadError(
    "the database has a write-ahead log: run `sqlite3 FILE 'PRAGMA journal_mode = DELETE'` beside its -wal file",
);
const NO_TABLE: ReadError =
    ReadError("the database has no table with the columns of python-can (ts, arbitration_id, …)");
const MALFORMED: ReadError = ReadError("the database is malformed");

/// The reader of such a database.
#[derive(Debug, Default)]
pub(super) struct SqliteReader {
    database: Vec<u8>,
    is_refused: bool,
}

impl FormatReader for SqliteReader {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn RecordSink) -> usize {
        if self.is_refused {
            return bytes.len();
        }
        self.database.extend_from_slice(bytes);
        let read = if self.database.len() > DATABASE_MAX {
            Err(TOO_LONG)
        } else if ended {
            read_database(&core::mem::take(&mut self.database), taker)
        } else {
            return bytes.len();
        };
        self.is_refused = true;
        self.database = Vec::new();
        if let Err(reason) = read {
            taker.handle_damage(Damage { position: CapturePosition::Byte(0), reason });
        }
        bytes.len()
    }
}

/// Reads every table of frames in a database.
fn read_database(database: &[u8], taker: &mut dyn RecordSink) -> Result<(), ReadError> {
    if database.get(WAL_BYTES).is_some_and(|bytes| bytes.contains(&HAS_WAL)) {
        return Err(WRITE_AHEAD);
    }
    let connection = open(database).map_err(|_| MALFORMED)?;
    let names = || -> rusqlite::Result<Vec<String>> {
        connection.prepare(TABLES)?.query_map([], |row| row.get(0))?.collect()
    };
    let names = names().map_err(|_| MALFORMED)?;
    if names.is_empty() {
        return Err(NO_TABLE);
    }
    let rows_max = database.len() as u64 / ROW_MIN;
    let mut row_number = 0;
    for name in names {
        read_table(&connection, &name, rows_max, &mut row_number, taker)?;
    }
    Ok(())
}

fn open(database: &[u8]) -> rusqlite::Result<Connection> {
    let mut connection = Connection::open_in_memory()?;
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, VALUE_MAX)?;
    connection.deserialize_read_exact("main", database, database.len(), true)?;
    connection.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON;")?;
    Ok(connection)
}

/// Reads the rows of a table in the order in which they were written.
fn read_table(
    connection: &Connection,
    name: &str,
    rows_max: u64,
    row_number: &mut u64,
    taker: &mut dyn RecordSink,
) -> Result<(), ReadError> {
    let query = format!(
        "SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM main.\"{}\"",
        name.replace('"', "\"\"")
    );
    let mut statement = connection.prepare(&query).map_err(|_| MALFORMED)?;
    let mut rows = statement.query([]).map_err(|_| MALFORMED)?;
    let mut bytes = Vec::new();
    while let Some(row) = rows.next().map_err(|_| MALFORMED)? {
        *row_number += 1;
        if *row_number > rows_max {
            return Err(MALFORMED);
        }
        if let Err(reason) = read_row(row, &mut bytes, taker) {
            taker.handle_damage(Damage { position: CapturePosition::Row(*row_number), reason });
        }
    }
    Ok(())
}

fn read_row(
    row: &Row<'_>,
    bytes: &mut Vec<u8>,
    taker: &mut dyn RecordSink,
) -> Result<(), ReadError> {
    let seconds: f64 = row.get(0).map_err(|_| ReadError("expected seconds"))?;
    // The shortest decimal number is what was written: a product with 10⁹ has digits of chance.
    let time = Timestamp::parse(seconds.to_string().as_bytes());
    let time = time.ok_or(ReadError("expected seconds"))?;
    let id: u32 = row.get(1).map_err(|_| ReadError("expected an identifier"))?;
    let dlc: u8 = row.get(5).map_err(|_| ReadError("expected a length"))?;
    bytes.clear();
    match row.get_ref(6) {
        Ok(ValueRef::Blob(data)) => bytes.extend_from_slice(data),
        Ok(ValueRef::Null) => {}
        _ => return Err(ReadError("expected bytes")),
    }
    let (extended, remote, error) =
        (is_column_set(2, row), is_column_set(3, row), is_column_set(4, row));
    let shape = build_python_can_frame(id, extended, remote, error, dlc, bytes)?;
    let (time, data) = (Some(time), shape.with_bytes(bytes));
    taker.handle_record(&Record { time, link: "can0", direction: None, data, offset: 0 });
    Ok(())
}

fn is_column_set(column: usize, row: &Row<'_>) -> bool {
    matches!(row.get_ref(column), Ok(ValueRef::Integer(value)) if value != 0)
}

#[cfg(test)]
mod tests;
