//! Databases as python-can writes them, and databases that are not.

use rusqlite::Connection;

use crate::{CaptureFormat, CaptureReader, Record};

const COLUMNS: &str = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, \
                       error INTEGER, dlc INTEGER, data BLOB";

/// A database that these statements make.
fn database(statements: &str) -> Vec<u8> {
    let mut connection = Connection::open_in_memory().expect("in memory");
    connection.execute_batch(statements).expect("valid statements");
    connection.serialize("main").expect("serialized").to_vec()
}

/// The frames as lines of a log, and the damage.
fn read(file: &[u8]) -> (Vec<String>, Vec<String>) {
    let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
    let mut keep = |record: &Record<'_>| {
        let mut writer =
            crate::CaptureWriter::new(CaptureFormat::Text, None, Vec::new()).expect("text");
        writer.write(record).expect("fits");
        let text = String::from_utf8(writer.finish().expect("written")).expect("text");
        found.push(text.trim_end().to_owned());
    };
    for piece in file.chunks(7) {
        reader.feed(piece, &mut keep);
    }
    reader.finish(&mut keep);
    assert_eq!(reader.format(), Some(CaptureFormat::Sqlite));
    (found, reader.statistics().damage.iter().map(ToString::to_string).collect())
}

#[test]
fn each_row_is_a_frame() {
    let file = database(&format!(
        "CREATE TABLE other (name TEXT);
         CREATE TABLE \"my \"\"messages\" ({COLUMNS});
         INSERT INTO \"my \"\"messages\" VALUES
             (1700000000.123457, 1409, 0, 0, 0, 8, x'4B41600037020000'),
             (1700000000.5, 67149918, 1, 0, 0, 2, x'3412'),
             (1700000001, 291, 0, 1, 0, 3, NULL),
             (1700000002, 4096, 0, 0, 0, 1, x'00'),
             (1700000003, 291, 0, 0, 0, 4, x'0102'),
             (-1.5, 291, 0, 0, 0, 0, x''),
             (1700000004, 291, 0, 0, 0, 1, 'text'),
             (1700000005, 132, 0, 0, 1, 8, x'0004000000000000'),
             (1700000006, 291, 0, 0, 0, 12, x'000102030405060708090A0B');"
    ));
    let (found, damage) = read(&file);
    let expected = [
        "(1700000000.123457) can0 581#4B41600037020000",
        "(1700000000.500000) can0 0400A05E#3412",
        "(1700000001.000000) can0 123#R3",
        "(1700000005.000000) can0 20000084#0004000000000000",
        "(1700000006.000000) can0 123##0000102030405060708090A0B",
    ];
    assert_eq!(found, expected);
    let expected = [
        "row 4: the identifier is too great",
        "row 5: it has fewer bytes than its length says",
        "row 6: expected seconds",
        "row 7: expected bytes",
    ];
    assert_eq!(damage, expected);
}

#[test]
fn other_databases_are_refused() {
    let other =
        database("CREATE TABLE other (ts REAL, data BLOB); INSERT INTO other VALUES (1, x'00');");
    let view = database(
        "CREATE TABLE other (name TEXT);
         CREATE VIEW messages AS WITH RECURSIVE n(ts) AS (SELECT 1 UNION ALL SELECT ts + 1 FROM n)
         SELECT ts, ts AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 0 AS dlc, x'' AS data FROM n;",
    );
    let computed = COLUMNS.replace("BLOB", "BLOB GENERATED ALWAYS AS (zeroblob(dlc * 100000000))");
    let computed = database(&format!("CREATE TABLE messages ({computed});"));
    for file in [other, view, computed] {
        let (found, damage) = read(&file);
        assert_eq!(found, [] as [&str; 0]);
        let [damage] = &damage[..] else { panic!("{damage:?}") };
        assert!(damage.contains("no table with the columns of python-can"), "{damage}");
    }
}

#[test]
fn damaged_databases_are_named() {
    let rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1000)
                INSERT INTO messages SELECT i, 291, 0, 0, 0, 8, x'0001020304050607' FROM n;";
    let whole = database(&format!("CREATE TABLE messages ({COLUMNS}); {rows}"));
    let (found, damage) = read(&whole);
    assert_eq!((found.len(), &damage[..]), (1000, &[][..]));
    let (found, damage) = read(&whole[..whole.len() / 2]);
    assert!(found.len() < 1000);
    assert_eq!(damage, ["byte 0: the database is malformed"]);
    let mut with_log = whole;
    with_log[18..20].fill(2);
    let (found, damage) = read(&with_log);
    assert_eq!(found, [] as [&str; 0]);
    assert!(damage[0].contains("write-ahead log"), "{damage:?}");
}
