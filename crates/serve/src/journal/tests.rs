use super::*;
use serde_json::json;

/// A file of its own for each test.
fn temp_path(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("polepair-{name}-{}.jsonl", std::process::id()));
    let _ = std::fs::remove_file(&path);
    path
}

fn write_journal(name: &str, count: u16) -> PathBuf {
    let path = temp_path(name);
    let (journal, cut) = JournalFile::open(&path).unwrap();
    assert_eq!(cut, 0);
    for axis in 0..count {
        journal
            .write("ann", JournalAction::Command, Some(axis), &json!({ "verb": "enable" }))
            .unwrap();
    }
    path
}

#[test]
fn a_written_journal_is_verified_and_read_again() {
    let path = write_journal("whole", 600);
    let verified = verify(&path).unwrap().unwrap();
    assert_eq!((verified.records, verified.truncated_bytes), (600, 0));
    let (journal, _) = JournalFile::open(&path).unwrap();
    let n = journal
        .write("bob", JournalAction::Stop, None, &json!({ "hash": ",\"hash\":\"" }))
        .unwrap();
    assert_eq!(n, 600);
    assert_eq!(verify(&path).unwrap().unwrap().records, 601);
    let some = journal.records(Some(298), 3).unwrap();
    let numbers: Vec<u64> = some.iter().map(|record| record.n).collect();
    assert_eq!(numbers, [299, 300, 301]);
    assert_eq!(some[0].axis, Some(299));
    assert!(journal.records(Some(600), 3).unwrap().is_empty());
    assert!(journal.records(Some(u64::MAX), 3).unwrap().is_empty());
    std::fs::remove_file(path).unwrap();
}

#[test]
fn any_byte_that_is_flipped_names_its_record() {
    let path = write_journal("flipped", 5);
    let whole = std::fs::read(&path).unwrap();
    let ends: Vec<usize> =
        whole.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(at, _)| at).collect();
    for at in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[at] ^= 1;
        let record = ends.iter().position(|end| at <= *end).unwrap() as u64;
        let read = verify::read(&flipped[..], &mut |_, _| {}).unwrap();
        match read {
            Err(broken) => assert_eq!(broken.record, record, "byte {at}"),
            // Its end is gone: the last record looks like one that was cut.
            Ok(verified) => assert!(at == whole.len() - 1 && verified.records == 4, "byte {at}"),
        }
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_record_that_is_taken_out_is_missed() {
    let path = write_journal("out", 4);
    let text = std::fs::read_to_string(&path).unwrap();
    let without: String = text
        .split_inclusive('\n')
        .enumerate()
        .filter(|(n, _)| *n != 1)
        .map(|(_, line)| line)
        .collect();
    let broken = verify::read(without.as_bytes(), &mut |_, _| {}).unwrap().unwrap_err();
    assert_eq!(broken.record, 1);
    std::fs::write(&path, without).unwrap();
    assert_eq!(JournalFile::open(&path).unwrap_err().code, "E253");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_last_line_cut_anywhere_is_reported_and_the_chain_goes_on() {
    let path = write_journal("cut", 2);
    let whole = std::fs::read(&path).unwrap();
    let first = whole.iter().position(|b| *b == b'\n').unwrap() + 1;
    for length in first + 1..whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        let verified = verify(&path).unwrap().unwrap();
        assert_eq!((verified.records, verified.truncated_bytes), (1, (length - first) as u64));
        let (journal, cut) = JournalFile::open(&path).unwrap();
        assert_eq!(cut, verified.truncated_bytes);
        journal.write("ann", JournalAction::Stop, None, &Value::Null).unwrap();
        assert_eq!(verify(&path).unwrap().unwrap().records, 2);
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn two_servers_do_not_write_one_journal() {
    let path = write_journal("two", 1);
    let (_first, _) = JournalFile::open(&path).unwrap();
    assert_eq!(JournalFile::open(&path).unwrap_err().code, "E312");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_broken_journal_names_the_axes_with_pending_stops() {
    let path = write_journal("owing", 2);
    let (journal, _) = JournalFile::open(&path).unwrap();
    let pending = |number: u32| json!({ "link": "tmcl:///dev/ttyUSB0#1,3", "number": number });
    journal.write("server", JournalAction::StopPending, Some(0), &pending(1)).unwrap();
    journal.write("server", JournalAction::StopPending, Some(1), &pending(3)).unwrap();
    journal.write("server", JournalAction::StopEnded, Some(0), &pending(1)).unwrap();
    drop(journal);
    let mut bytes = std::fs::read(&path).unwrap();
    // A text without an author.
    bytes[20] = 0xFF;
    std::fs::write(&path, bytes).unwrap();
    let refusal = JournalFile::open(&path).unwrap_err();
    assert_eq!(refusal.code, "E253");
    assert!(refusal.why.contains("`polepair stop tmcl:///dev/ttyUSB0#3`"), "{refusal:?}");
    assert!(!refusal.why.contains("#1"), "{refusal:?}");
    std::fs::remove_file(path).unwrap();
}

/// A line without what differs each time: the time and the hash.
fn timeless(line: &str) -> String {
    let (n, rest) = line.split_once(",\"ms\":").unwrap();
    let (_, rest) = rest.split_once(",\"who\":").unwrap();
    let (rest, _) = rest.rsplit_once(",\"hash\":\"").unwrap();
    format!("{n},\"who\":{rest}")
}

/// A journal with a record of each kind, written by version 0.1, is verified, read, and written as it was.
#[test]
fn the_format_of_records_is_pinned() {
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/journal.jsonl");
    let path = temp_path("pinned");
    if std::env::var_os("POLEPAIR_GOLDEN").is_none() {
        std::fs::copy(golden, &path).unwrap();
        assert_eq!(verify(&path).unwrap().unwrap().truncated_bytes, 0);
    }
    let text = std::fs::read_to_string(golden).unwrap();
    let _ = std::fs::remove_file(&path);
    let (journal, _) = JournalFile::open(&path).unwrap();
    for line in text.lines() {
        let record: JournalRecord = serde_json::from_str(line).unwrap();
        assert_eq!(timeless(&serde_json::to_string(&record).unwrap()), timeless(line));
        journal.write(&record.who, record.deed, record.axis, &record.detail).unwrap();
    }
    let again = std::fs::read_to_string(&path).unwrap();
    if std::env::var_os("POLEPAIR_GOLDEN").is_some() {
        std::fs::write(golden, &again).unwrap();
    }
    let lines = |text: &str| text.lines().map(timeless).collect::<Vec<_>>();
    assert_eq!(lines(&again), lines(&text));
    assert!(text.lines().count() > 15);
    std::fs::remove_file(path).unwrap();
}
