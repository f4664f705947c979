//! Rows of small captures.

use arrow_array::cast::AsArray;
use arrow_array::types::{Int32Type, Int64Type};
use arrow_array::{Array, RecordBatch};
use polepair_capture::{CaptureDecoder, Rules};

use super::{CaptureOrigin, TablesBuilder};
use crate::schema::TableKind;

/// All rows of a capture, decoded by `rules`.
fn tables(rules: &str, capture: &str) -> Vec<(TableKind, RecordBatch)> {
    let origin = CaptureOrigin { source: "cell-3".to_owned(), file: "a.log".to_owned() };
    let mut tables = TablesBuilder::new(&TableKind::ALL, &origin);
    let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
    decoder.feed(capture.as_bytes(), &mut |event| tables.add_event(event));
    decoder.finish(&mut |event| tables.add_event(event));
    decoder.finish_sessions(&mut |event| tables.add_final_notices(event.link, event.notices));
    let mut all = Vec::new();
    let keep = &mut |table, batch| {
        all.push((table, batch));
        Ok(())
    };
    tables.flush(keep).expect("batches");
    all
}

fn words(batch: &RecordBatch, column: &str) -> Vec<Option<String>> {
    let column = batch.column_by_name(column).expect("a column").as_dictionary::<Int32Type>();
    let typed = column.downcast_dict::<arrow_array::StringArray>().expect("words");
    typed.into_iter().map(|word| word.map(str::to_owned)).collect()
}

#[test]
fn frames_keep_what_was_on_the_wire() {
    let capture = "(1700000000.000500) can0 123#0102\n\
                   (1700000000.000400) can1 0400A05E#R\n\
                   can0 123##10102030405060708090A0B0C\n\
                   (1700000000.000600) can0 20000004#0004000000000000 T\n";
    let all = tables("canopen", capture);
    let (table, frames) = &all[0];
    assert_eq!((*table, frames.num_rows()), (TableKind::Frames, 4));
    let numbers = |name: &str| {
        let column = frames.column_by_name(name).expect("a column").as_primitive::<Int64Type>();
        column.iter().collect::<Vec<_>>()
    };
    // In the order of time; what has none comes first.
    assert_eq!(numbers("seq"), [Some(3), Some(2), Some(1), Some(4)]);
    assert_eq!(numbers("file_pos"), [Some(70), Some(34), Some(0), Some(106)]);
    let time = 1_700_000_000_000_000_000;
    let times = [None, Some(time + 400_000), Some(time + 500_000), Some(time + 600_000)];
    assert_eq!(numbers("t_ns"), times);
    let flags = frames.column_by_name("flags").expect("flags").as_primitive::<Int32Type>();
    // 123h is no identifier of CANopen's.
    assert_eq!(flags.values().to_vec(), [128, 3, 256, 4]);
    let ids = frames.column_by_name("can_id").expect("ids").as_primitive::<Int32Type>();
    assert_eq!(ids.values().to_vec(), [0x123, 0x0400_A05E, 0x123, 4]);
    let data = frames.column_by_name("data").expect("data").as_binary::<i32>();
    assert_eq!((data.value(0).len(), data.value(1), data.value(2)), (12, &[][..], &[1, 2][..]));
    assert_eq!(words(frames, "bus")[1].as_deref(), Some("can1"));
    assert!(words(frames, "source").iter().all(|word| word.as_deref() == Some("cell-3")));
    assert!(words(frames, "file").iter().all(|word| word.as_deref() == Some("a.log")));
}

#[test]
fn a_request_and_its_answer_are_a_transaction() {
    let capture = "(1.000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n\
                   (1.003) ttyUSB0 < 02 01 64 06 00 00 00 07 74\n\
                   (2.000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n\
                   (9.000) ttyUSB0 > 01 06 03 00 00 00 00 00 0A\n";
    let all = tables("tmcl", capture);
    let find = |table| all.iter().find(|(found, _)| *found == table).map(|(_, batch)| batch);
    let transactions = find(TableKind::Transactions).expect("transactions");
    let outcomes: Vec<_> = words(transactions, "outcome").into_iter().flatten().collect();
    // The last request may have been answered after the capture's end.
    assert_eq!(outcomes, ["done", "timeout", "unknown"]);
    let column = transactions.column_by_name("rtt_us").expect("rtt").as_primitive::<Int64Type>();
    assert_eq!((column.value(0), column.is_null(1)), (3000, true));
    assert_eq!(
        words(find(TableKind::Frames).expect("frames"), "protocol")[0].as_deref(),
        Some("tmcl")
    );
}

#[test]
fn the_rows_of_a_table_have_its_schema() {
    for table in TableKind::ALL {
        assert_eq!(TableKind::from_name(table.name()), Some(table));
        assert!(table.schema().index_of(table.time_column()).is_ok());
        assert!(table.axis_column().is_none_or(|axis| table.schema().index_of(axis).is_ok()));
    }
}
