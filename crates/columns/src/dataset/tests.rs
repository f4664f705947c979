//! Data sets, written into a folder of the test's own.

use std::path::{Path, PathBuf};

use parquet::file::reader::{FileReader as _, SerializedFileReader};
use polepair_capture::{CaptureDecoder, Rules};

use super::{
    DatasetSite, DatasetWriter, DecodeRecord, escape, escape_name, format_date, note_copy,
};
use crate::capture_file::CaptureFile;
use crate::provenance::Provenance;
use crate::schema::TableKind;
use crate::table_file::{BatchSink, TableFileError};
use crate::tables::{CaptureOrigin, TablesBuilder};

/// A folder that goes with the test.
struct TestFolder(PathBuf);

impl TestFolder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("polepair-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }
}

impl Drop for TestFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Two buses, two days, and a frame without a time.
const CAPTURE: &str = "(1700006399.000000) can0 181#0102\n\
                       (1700006400.000000) can0 181#0304\n\
                       (1700006401.000000) vcan/1 181#05\n\
                       can0 181#06\n";

fn decode(site: &DatasetSite, stated: &str, tables: &[TableKind]) -> DecodeRecord {
    decode_text(site, CAPTURE, stated, tables).expect("decoded")
}

/// Decodes a capture with this text, in a file beside the data set.
fn decode_text(
    site: &DatasetSite,
    text: &str,
    stated: &str,
    tables: &[TableKind],
) -> Result<DecodeRecord, TableFileError> {
    let path = site.root.with_extension("log");
    std::fs::write(&path, text).expect("written");
    let capture = CaptureFile::read(&path, "a.log").expect("read");
    decode_capture(site, capture, stated, tables)
}

fn decode_capture(
    site: &DatasetSite,
    capture: CaptureFile,
    stated: &str,
    tables: &[TableKind],
) -> Result<DecodeRecord, TableFileError> {
    let text = std::fs::read_to_string(site.root.with_extension("log")).expect("read");
    let done = DecodeRecord::new(site, &capture.content().blake3, stated, tables);
    let mut keep: Box<dyn BatchSink> =
        Box::new(DatasetWriter::new(site.clone(), done.clone(), capture, 2));
    let origin = CaptureOrigin { source: "s".to_owned(), file: "a.log".to_owned() };
    let mut rows = TablesBuilder::new(tables, &origin);
    let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
    decoder.feed(text.as_bytes(), &mut |event| rows.add_event(event));
    decoder.finish(&mut |event| rows.add_event(event));
    let each = &mut |table, batch| {
        keep.write_batch(table, &batch).expect("written");
        Ok(())
    };
    rows.flush(each).expect("batches");
    let provenance = Provenance {
        file: "a.log".to_owned(),
        blake3: done.blake3.clone(),
        rules: "canopen".to_owned(),
        profile: String::new(),
    };
    keep.close(&provenance)?;
    Ok(done)
}

/// Rows of all frames in the data set.
fn rows(site: &DatasetSite) -> i64 {
    let rows_of = |part: &String| {
        let file = std::fs::File::open(part).expect("a part");
        SerializedFileReader::new(file).expect("Parquet").metadata().file_metadata().num_rows()
    };
    files(&site.root.join("frames")).iter().map(rows_of).sum()
}

fn files(root: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in
        std::fs::read_dir(root).expect("a folder").map(|entry| entry.expect("entry").path())
    {
        if entry.is_dir() {
            found.extend(files(&entry))
        } else {
            found.push(entry.display().to_string())
        }
    }
    found.sort();
    found
}

#[test]
fn parts_by_table_site_date_and_bus() {
    let folder = TestFolder::new("parts");
    let site = DatasetSite { root: folder.0.clone(), name: "plant a".to_owned() };
    let done = decode(&site, "as=canopen", &[TableKind::Frames]);
    assert!(done.exists(&site));
    assert!(!DecodeRecord::new(&site, &done.blake3, "as=tmcl", &[TableKind::Frames]).exists(&site));
    let part = format!("part-{}-0.parquet", &done.blake3[..16]);
    let frames = folder.0.join("frames").join("site=plant%20a");
    let mut expected = [
        format!("date=2023-11-14/bus=can0/{part}"),
        format!("date=2023-11-15/bus=can0/{part}"),
        format!("date=2023-11-15/bus=vcan%2F1/{part}"),
        format!("date=__HIVE_DEFAULT_PARTITION__/bus=can0/{part}"),
    ]
    .map(|path| frames.join(path).display().to_string());
    expected.sort();
    assert_eq!(files(&folder.0.join("frames")), expected);
}

/// Rows of a row group need not be in the order of time, and readers trust the statistics of a file.
#[test]
fn files_promise_no_order_of_their_rows() {
    let folder = TestFolder::new("order");
    decode(&DatasetSite { root: folder.0.clone(), name: "a".to_owned() }, "", &TableKind::ALL);
    let parts = files(&folder.0.join("frames"));
    for part in &parts {
        let file = std::fs::File::open(part).expect("a part");
        let read = SerializedFileReader::new(file).expect("Parquet");
        let groups = read.metadata().row_groups();
        assert!(!groups.is_empty() && groups.iter().all(|group| group.sorting_columns().is_none()));
    }
    assert_eq!(parts.len(), 4);
}

#[test]
fn another_decode_replaces_the_first() {
    let folder = TestFolder::new("again");
    let site = DatasetSite { root: folder.0.clone(), name: "a".to_owned() };
    let first = decode(&site, "as=canopen", &[TableKind::Frames]);
    assert_eq!(files(&folder.0.join("frames")).len(), 4);
    let second = decode(&site, "as=canopen", &[TableKind::Signals]);
    assert_eq!(files(&folder.0.join("frames")).len(), 0);
    assert!(second.exists(&site) && !first.exists(&site));
    // A note that names what lies elsewhere takes nothing away.
    let outside = folder.0.join("outside");
    std::fs::write(&outside, "mine").expect("written");
    let inner = DatasetSite { root: folder.0.join("set"), name: "a".to_owned() };
    std::fs::create_dir_all(inner.root.join("_done")).expect("a folder");
    let note = inner.root.join("_done").join(&second.blake3);
    std::fs::write(note, "old\n../outside\n").expect("written");
    decode(&inner, "as=canopen", &[TableKind::Frames]);
    assert!(outside.exists());
}

fn site_in(folder: &TestFolder) -> DatasetSite {
    DatasetSite { root: folder.0.join("set"), name: "a".to_owned() }
}

#[test]
fn a_capture_that_has_grown_replaces_what_it_was() {
    let folder = TestFolder::new("grown");
    let site = site_in(&folder);
    let decode = |text: &str| decode_text(&site, text, "", &[TableKind::Frames]).expect("decoded");
    let first = decode(CAPTURE);
    assert_eq!(rows(&site), 4);
    let grown = format!("{CAPTURE}(1700006402.000000) can0 181#07\n");
    let second = decode(&grown);
    assert_eq!(rows(&site), 5);
    assert!(second.exists(&site) && !first.exists(&site));
    // Another capture with this name is no growth: both stay.
    decode("(1700006402.000000) can0 181#07\n");
    assert_eq!(rows(&site), 6);
    decode(&format!("{grown}(1700006403.000000) can0 181#08\n"));
    assert_eq!(rows(&site), 7);
}

#[test]
fn a_copy_keeps_its_rows_when_the_other_one_grows() {
    let folder = TestFolder::new("copy");
    let site = site_in(&folder);
    let first = decode(&site, "", &[TableKind::Frames]);
    let copy = folder.0.join("copy.log");
    std::fs::write(&copy, CAPTURE).expect("written");
    let copy = CaptureFile::read(&copy, "copy.log").expect("read");
    assert_eq!(copy.content().blake3, first.blake3);
    note_copy(&site, &copy).expect("noted");
    let grown = format!("{CAPTURE}(1700006402.000000) can0 181#07\n");
    decode_text(&site, &grown, "", &[TableKind::Frames]).expect("decoded");
    assert_eq!(rows(&site), 9);
}

#[test]
fn a_capture_that_changes_while_it_is_read_is_not_stored() {
    let folder = TestFolder::new("changed");
    let site = site_in(&folder);
    let path = site.root.with_extension("log");
    std::fs::write(&path, CAPTURE).expect("written");
    let capture = CaptureFile::read(&path, "live.log").expect("read");
    std::fs::write(&path, format!("{CAPTURE}(1700006402.000000) can0 181#07\n")).expect("written");
    let ended = decode_capture(&site, capture, "", &[TableKind::Frames]);
    assert!(matches!(ended, Err(TableFileError::Changed)), "{ended:?}");
    assert_eq!(rows(&site), 0);
}

/// A program that was killed while its parts took their places left a note in `_begun`, and some of them.
#[test]
fn the_file_of_a_killed_program_is_replaced() {
    let folder = TestFolder::new("killed");
    let site = site_in(&folder);
    let first = decode(&site, "", &[TableKind::Frames]);
    let [done, begun] = ["_done", "_begun"].map(|name| site.root.join(name).join(&first.blake3));
    let note = std::fs::read_to_string(&done).expect("a note");
    let parts: Vec<&str> = note.lines().skip(1).collect();
    std::fs::write(&begun, parts.join("\n")).expect("written");
    std::fs::remove_file(&done).expect("removed");
    std::fs::remove_file(site.root.join(parts[0])).expect("removed");
    let grown = format!("{CAPTURE}(1700006402.000000) can0 181#07\n");
    decode_text(&site, &grown, "", &[TableKind::Frames]).expect("decoded");
    assert_eq!(rows(&site), 5);
    assert!(!begun.exists());
}

#[test]
fn parts_that_were_closed_go_on() {
    let folder = TestFolder::new("days");
    let site = site_in(&folder);
    let day = |n: u32| format!("({}.000000) can0 181#01\n", 1_700_006_400 + n * 86_400);
    // There and back, so that parts are opened again.
    let text: String = (0..400).chain((0..400).rev()).map(day).collect();
    decode_text(&site, &text, "", &[TableKind::Frames]).expect("decoded");
    assert_eq!((rows(&site), files(&site.root.join("frames")).len()), (800, 400));
}

#[test]
fn names_of_links_fit_a_file_system() {
    let long = "ü".repeat(300);
    assert!(escape_name(&long).len() <= 255);
    assert_ne!(escape_name(&long), escape_name(&format!("{long}x")));
    assert_eq!(escape_name("can0"), "can0");
}

#[test]
fn dates_and_words_in_paths() {
    let dates = [0, -1, 59, 19_723, 19_782].map(format_date);
    assert_eq!(dates, ["1970-01-01", "1969-12-31", "1970-03-01", "2024-01-01", "2024-02-29"]);
    assert_eq!(escape("../x=ü"), "..%2Fx%3D%C3%BC");
}
