//! Data sets, written into a folder of the test's own.

use std::path::{Path, PathBuf};

use parquet::file::reader::{FileReader as _, SerializedFileReader};
use polepair_capture::{CaptureDecoder, Rules};

use super::{DatasetSite, DatasetWriter, DecodeRecord, escape, format_date};
use crate::schema::TableKind;
use crate::table_file::{BatchSink, Provenance};
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
    let done = DecodeRecord::new(site, "0123456789abcdef0123", stated, tables);
    let mut keep: Box<dyn BatchSink> = Box::new(DatasetWriter::new(site.clone(), done.clone(), 2));
    let origin = CaptureOrigin { source: "s".to_owned(), file: "a.log".to_owned() };
    let mut rows = TablesBuilder::new(tables, &origin);
    let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
    decoder.feed(CAPTURE.as_bytes(), &mut |event| rows.add_event(event));
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
    keep.close(&provenance).expect("closed");
    done
}

fn files(root: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in
        std::fs::read_dir(root).expect("a folder").map(|entry| entry.expect("entry").path())
    {
        match entry.is_dir() {
            true => found.extend(files(&entry)),
            false => found.push(entry.display().to_string()),
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
    let part = "part-0123456789abcdef-0.parquet";
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

/// Rows of a row group need not be in the order of time, and readers believe what a file says.
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

#[test]
fn dates_and_words_in_paths() {
    let dates = [0, -1, 59, 19_723, 19_782].map(format_date);
    assert_eq!(dates, ["1970-01-01", "1969-12-31", "1970-03-01", "2024-01-01", "2024-02-29"]);
    assert_eq!(escape("../x=ü"), "..%2Fx%3D%C3%BC");
}
