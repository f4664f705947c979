//! Rows of batches are those of events, whoever builds them.

use arrow_array::Array as _;
use arrow_array::cast::AsArray as _;
use arrow_array::types::Int32Type;
use polepair_capture::{Batch, Decoder, Rules};
use polepair_columns::{Numbering, Origin, RecordBatch, Table, Tables};

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

fn tables() -> Tables {
    let origin = Origin { source: "cell-3".to_owned(), file: "a.log".to_owned() };
    Tables::new(&Table::ALL, &origin)
}

fn flush(tables: &mut Tables) -> Vec<(Table, RecordBatch)> {
    let mut all = Vec::new();
    let keep = &mut |table, batch| {
        all.push((table, batch));
        Ok(())
    };
    tables.flush(keep).expect("batches");
    all
}

fn decoder() -> Decoder {
    Decoder::new(Rules::parse("canopen").expect("rules")).without_words()
}

/// The rows of a bus, event by event.
fn plain() -> Vec<(Table, RecordBatch)> {
    let (mut decoder, mut tables) = (decoder(), tables());
    decoder.feed(bus().as_bytes(), &mut |event| tables.take(event));
    decoder.finish(&mut |event| tables.take(event));
    decoder.ending(&mut |event| tables.ending(event.link, event.notices));
    flush(&mut tables)
}

#[test]
fn rows_of_batches_are_those_of_events() {
    let plain = plain();
    assert!(plain.iter().any(|(table, rows)| *table == Table::Signals && rows.num_rows() > 1200));
    for piece in [100, 1 << 20] {
        let (mut decoder, mut tables, mut batch) = (decoder(), tables(), Batch::default());
        for piece in bus().as_bytes().chunks(piece) {
            decoder.gather(piece, &mut batch, &mut |batch| tables.take_batch(batch));
            tables.take_batch(&batch);
        }
        decoder.gather_rest(&mut batch, &mut |batch| tables.take_batch(batch));
        tables.take_batch(&batch);
        decoder.ending(&mut |event| tables.ending(event.link, event.notices));
        // Words are compared, whatever their numbers are.
        assert!(flush(&mut tables) == plain, "pieces of {piece}");
    }
}

/// Two who build by turns give their words the same numbers, and so does one.
#[test]
fn words_of_several_builders_have_one_number() {
    let built = |count: usize| {
        let mut builders: Vec<Tables> = (0..count).map(|_| tables()).collect();
        let (mut decoder, mut batch) = (decoder(), Batch::default());
        let (mut numbering, mut all) = (Numbering::default(), Vec::new());
        for (at, piece) in bus().as_bytes().chunks(4000).enumerate() {
            let builder = &mut builders[at % count];
            decoder.gather(piece, &mut batch, &mut |batch| builder.take_batch(batch));
            builder.take_batch(&batch);
            for (table, rows) in flush(builder) {
                all.push((table, numbering.number(table, rows).expect("a batch")));
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
