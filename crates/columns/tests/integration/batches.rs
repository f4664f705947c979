//! Rows of batches are those of events, for every builder.

use arrow_array::Array as _;
use arrow_array::cast::AsArray as _;
use arrow_array::types::Int32Type;
use polepair_capture::{CaptureDecoder, FrameBatch, Rules};
use polepair_columns::{CaptureOrigin, DictionaryMerger, RecordBatch, TableKind, TablesBuilder};

/// A bus of two drives, one of which is configured, with what does not go its usual way between.
fn bus() -> String {
    let mut log = String::new();
    let mut line = |frame: &str| {
        let us = 500 * log.lines().count();
        log.push_str(&format!("(1700000000.{us:06}) can0 {frame}\n"));
    };
    for frame in [
        "603#2F001A0000000000",
        "583#60001A0000000000",
        "603#23001A0110004160",
        "583#60001A0100000000",
        "603#23001A0220006460",
        "583#60001A0200000000",
        "603#2F001A0002000000",
        "583#60001A0000000000",
    ] {
        line(frame);
    }
    for n in 0..600 {
        line(&format!("183#3716{:04X}0000", n * 77 % 0xFFFF));
        line(&format!("281#{n:04X}"));
        match n % 100 {
            40 => line("183#3716"),
            60 => line("183#181601020304"),
            80 => line("703#05"),
            90 => line("no frame"),
            _ => line("183#R"),
        }
    }
    log
}

fn tables() -> TablesBuilder {
    let origin = CaptureOrigin { source: "cell-3".to_owned(), file: "a.log".to_owned() };
    TablesBuilder::new(&TableKind::ALL, &origin)
}

fn flush(tables: &mut TablesBuilder) -> Vec<(TableKind, RecordBatch)> {
    let mut all = Vec::new();
    let keep = &mut |table, batch| {
        all.push((table, batch));
        Ok(())
    };
    tables.flush(keep).expect("batches");
    all
}

fn decoder() -> CaptureDecoder {
    CaptureDecoder::new(Rules::parse("canopen").expect("rules")).without_text()
}

/// The rows of a bus, event by event.
fn plain() -> Vec<(TableKind, RecordBatch)> {
    let (mut decoder, mut tables) = (decoder(), tables());
    decoder.feed(bus().as_bytes(), &mut |event| tables.add_event(event));
    decoder.finish(&mut |event| tables.add_event(event));
    decoder.finish_sessions(&mut |event| tables.add_final_notices(event.link, event.notices));
    flush(&mut tables)
}

#[test]
fn rows_of_batches_are_those_of_events() {
    let plain = plain();
    assert!(
        plain.iter().any(|(table, rows)| *table == TableKind::Signals && rows.num_rows() > 1200)
    );
    for piece in [100, 1 << 20] {
        let (mut decoder, mut tables, mut batch) = (decoder(), tables(), FrameBatch::default());
        for piece in bus().as_bytes().chunks(piece) {
            decoder.decode_batch(piece, &mut batch, &mut |batch| tables.add_batch(batch));
            tables.add_batch(&batch);
        }
        decoder.finish_batch(&mut batch, &mut |batch| tables.add_batch(batch));
        tables.add_batch(&batch);
        decoder.finish_sessions(&mut |event| tables.add_final_notices(event.link, event.notices));
        // Words are compared, whatever their numbers are.
        assert!(flush(&mut tables) == plain, "pieces of {piece}");
    }
}

/// Two who build by turns give their words the same numbers, and so does one.
#[test]
fn words_of_several_builders_have_one_number() {
    let built = |count: usize| {
        let mut builders: Vec<TablesBuilder> = (0..count).map(|_| tables()).collect();
        let (mut decoder, mut batch) = (decoder(), FrameBatch::default());
        let (mut numbering, mut all) = (DictionaryMerger::default(), Vec::new());
        for (at, piece) in bus().as_bytes().chunks(4000).enumerate() {
            let builder = &mut builders[at % count];
            decoder.decode_batch(piece, &mut batch, &mut |batch| builder.add_batch(batch));
            builder.add_batch(&batch);
            for (table, rows) in flush(builder) {
                all.push((table, numbering.renumber(table, rows).expect("a batch")));
            }
        }
        all
    };
    let (one, two) = (built(1), built(2));
    assert!(one == two && one.len() > 20);
    for ((_, one), (_, two)) in one.iter().zip(&two) {
        for (one, two) in one.columns().iter().zip(two.columns()) {
            let number = |column: &arrow_array::ArrayRef| {
                let words = column.as_dictionary_opt::<Int32Type>()?;
                Some((words.keys().clone(), words.values().len()))
            };
            assert_eq!(number(one), number(two));
        }
    }
}
