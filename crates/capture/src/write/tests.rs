//! Every format written and read back, whole, in pieces, compressed, and damaged.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::{CaptureWriter, WriteError};
use crate::{
    CanErrorFrame, CaptureFormat, CaptureReader, Compression, FdFrame, Record, RecordData,
    Timestamp,
};

const FORMATS: [CaptureFormat; 7] = [
    CaptureFormat::Text,
    CaptureFormat::Pcap,
    CaptureFormat::Pcapng,
    CaptureFormat::Asc,
    CaptureFormat::Trc,
    CaptureFormat::Blf,
    CaptureFormat::Csv,
];
const BEGIN: u64 = 1_700_000_000_123_456_000;

/// A record that outlives what it was read from.
#[derive(Clone, PartialEq, Eq, Debug)]
struct OwnedRecord {
    time: Option<u64>,
    link: String,
    direction: Option<Direction>,
    data: String,
}

impl OwnedRecord {
    fn from_record(record: &Record<'_>) -> Self {
        let time = record.time.map(|stamp| stamp.0);
        let link = record.link.to_owned();
        Self { time, link, direction: record.direction, data: format!("{:?}", record.data) }
    }
}

/// The part of a record that a format stores.
fn as_stored(format: CaptureFormat, mut record: OwnedRecord) -> OwnedRecord {
    let reported = match format {
        CaptureFormat::Csv | CaptureFormat::Pcap => false,
        CaptureFormat::Asc | CaptureFormat::Trc | CaptureFormat::Blf => {
            !record.data.starts_with("Error")
        }
        _ => true,
    };
    let unit = if format == CaptureFormat::Trc { 1000 } else { 1 };
    record.time = record.time.map(|time| time / unit);
    record.direction = if reported { record.direction } else { None };
    if matches!(format, CaptureFormat::Asc | CaptureFormat::Trc)
        && reported
        && record.direction.is_none()
    {
        record.direction = Some(Direction::ToHost);
    }
    if matches!(format, CaptureFormat::Blf) && reported {
        record.direction.get_or_insert(Direction::ToHost);
    }
    if matches!(format, CaptureFormat::Asc | CaptureFormat::Trc | CaptureFormat::Blf) && !reported {
        record.data = "Error".to_owned();
    }
    if format == CaptureFormat::Csv && record.data.starts_with("Fd") {
        record.data = record.data.replace("flags: 3", "flags: 0");
    }
    record
}

/// Frames of every kind on one bus.
fn frames(count: u64) -> Vec<(Timestamp, Option<Direction>, Frame)> {
    let ways = [None, Some(Direction::ToDrive), Some(Direction::ToHost)];
    (0..count)
        .map(|n| {
            let extended = n % 3 == 0;
            let id = if extended { 0x0400_A05E + n as u32 } else { (0x181 + n as u32) & 0x7FF };
            let remote = n % 7 == 6;
            let len = (n % 9) as u8;
            let mut data = [0; 8];
            if !remote {
                (0..len).for_each(|at| data[usize::from(at)] = (n * 31 + u64::from(at)) as u8);
            }
            let frame = Frame { id, extended, remote, len, data };
            (Timestamp(BEGIN + n * 1_234_567_000), ways[n as usize % 3], frame)
        })
        .collect()
}

fn written(
    format: CaptureFormat,
    packing: Option<Compression>,
    count: u64,
) -> (Vec<u8>, Vec<OwnedRecord>) {
    let mut writer = CaptureWriter::new(format, packing, Vec::new()).expect("a format to write");
    let mut expected = Vec::new();
    let mut write = |record: &Record<'_>| {
        writer.write(record).expect("fits");
        expected.push(as_stored(format, OwnedRecord::from_record(record)));
    };
    let link = "can0";
    for (time, direction, frame) in frames(count) {
        write(&Record {
            time: Some(time),
            link,
            direction,
            data: RecordData::Frame(frame),
            offset: 0,
        });
    }
    let last = Some(Timestamp(BEGIN + count * 1_234_567_000));
    let bytes = [0xA5; 24];
    let fd = FdFrame { id: 0x77, extended: false, flags: 3, bytes: &bytes };
    write(&Record { time: last, link, direction: None, data: RecordData::Fd(fd), offset: 0 });
    let error = CanErrorFrame { class: 0x44, data: [0, 0x30, 0, 0, 0, 0, 0, 0] };
    write(&Record { time: last, link, direction: None, data: RecordData::Error(error), offset: 0 });
    (writer.finish().expect("written"), expected)
}

fn read(format: CaptureFormat, file: &[u8], size: usize) -> (Vec<OwnedRecord>, Vec<String>) {
    let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
    let mut keep =
        |record: &Record<'_>| found.push(as_stored(format, OwnedRecord::from_record(record)));
    file.chunks(size).for_each(|piece| reader.feed(piece, &mut keep));
    reader.finish(&mut keep);
    assert_eq!(reader.format(), Some(format));
    assert_eq!(reader.statistics().records, found.len() as u64);
    (found, reader.statistics().damage.iter().map(ToString::to_string).collect())
}

#[test]
fn written_data_is_read_in_pieces_of_any_size() {
    for format in FORMATS {
        for packing in [None, Some(Compression::Gzip), Some(Compression::Zstd)] {
            let (file, expected) = written(format, packing, 300);
            for size in [1, 7, 64, 4096, file.len()] {
                let (found, damage) = read(format, &file, size);
                assert_eq!(damage, [] as [&str; 0], "{format} {packing:?} in pieces of {size}");
                assert_eq!(found.len(), expected.len(), "{format} {packing:?} in pieces of {size}");
                for (n, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    assert_eq!(found, expected, "{format} {packing:?} record {n}");
                }
            }
        }
    }
}

/// A file that others look at while it is written.
#[derive(Clone, Default)]
struct SharedFile(Rc<RefCell<Vec<u8>>>);

impl io::Write for SharedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn flushed_data_is_read_from_an_unfinished_file() {
    for format in FORMATS {
        for packing in [None, Some(Compression::Gzip), Some(Compression::Zstd)] {
            let file = SharedFile::default();
            let mut writer =
                CaptureWriter::new(format, packing, file.clone()).expect("a format to write");
            for (n, (time, direction, frame)) in frames(300).into_iter().enumerate() {
                let (time, data) = (Some(time), RecordData::Frame(frame));
                writer
                    .write(&Record { time, link: "can0", direction, data, offset: 0 })
                    .expect("fits");
                if n % 100 == 99 {
                    writer.flush().expect("written");
                    let (found, _) = read(format, &file.0.borrow(), 4096);
                    assert_eq!(found.len(), n + 1, "{format} {packing:?}");
                }
            }
        }
    }
}

#[test]
fn serial_bytes_are_kept_where_there_is_a_place_for_them() {
    let record = |direction, link| Record {
        time: Some(Timestamp(BEGIN)),
        link,
        direction,
        data: RecordData::Bytes(&[1, 0xFF, 0]),
        offset: 0,
    };
    let records = [
        record(Some(Direction::ToDrive), "ttyUSB0"),
        record(Some(Direction::ToHost), "ttyUSB0"),
        record(None, "ttyUSB1"),
    ];
    for format in [CaptureFormat::Text, CaptureFormat::Pcapng] {
        let mut writer = CaptureWriter::new(format, None, Vec::new()).expect("a format to write");
        records.iter().for_each(|record| writer.write(record).expect("fits"));
        let (found, damage) = read(format, &writer.finish().expect("written"), 5);
        assert_eq!(damage, [] as [&str; 0]);
        assert_eq!(found, records.each_ref().map(OwnedRecord::from_record), "{format}");
    }
    for format in [CaptureFormat::Asc, CaptureFormat::Trc, CaptureFormat::Blf, CaptureFormat::Csv] {
        let mut writer = CaptureWriter::new(format, None, Vec::new()).expect("a format to write");
        assert!(
            matches!(writer.write(&records[0]), Err(WriteError::UnsupportedRecord(_))),
            "{format}"
        );
    }
    let mut writer =
        CaptureWriter::new(CaptureFormat::Pcap, None, Vec::new()).expect("a format to write");
    writer.write(&records[0]).expect("fits");
    assert!(
        matches!(writer.write(&records[2]), Err(WriteError::UnsupportedRecord(_))),
        "another link"
    );
}

#[test]
fn a_file_that_is_cut_off_is_read_to_the_cut() {
    for format in FORMATS {
        let (file, expected) = written(format, None, 3000);
        let (found, damage) = read(format, &file[..file.len() * 2 / 3], 4096);
        assert!(damage.len() <= 2, "{format}: {damage:?}");
        assert!(found.len() * 3 > expected.len(), "{format}: {} records", found.len());
        let same = found.iter().zip(&expected).filter(|(a, b)| a == b).count();
        assert!(same + 1 >= found.len(), "{format}: {same} of {}", found.len());
    }
}

#[test]
fn data_after_damage_is_read() {
    for format in FORMATS {
        let (mut file, expected) = written(format, None, 30_000);
        let middle = file.len() / 2;
        file[middle..middle + 40].fill(0x99);
        let (found, damage) = read(format, &file, 4096);
        assert!(!damage.is_empty() && damage.len() < 12, "{format}: {damage:?}");
        let last = expected.last();
        assert_eq!(found.last(), last, "{format}: {damage:?}");
        assert!(found.len() * 10 > expected.len() * 7, "{format}: {} records", found.len());
    }
}

/// Bytes changed, taken out, put in twice, and cut off: everything ends, and nothing grows.
#[test]
fn mutated_files_are_read_to_their_end() {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut next = |limit: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % limit.max(1)
    };
    for round in 0..2_000 {
        let format = FORMATS[round % FORMATS.len()];
        let packing = [None, None, Some(Compression::Gzip), Some(Compression::Zstd)][next(4)];
        let (mut file, expected) = written(format, packing, 40);
        for _ in 0..=next(4) {
            let at = next(file.len());
            match next(4) {
                0 => file[at] = next(256) as u8,
                1 => drop(file.drain(at..(at + next(20)).min(file.len()))),
                2 => file.truncate(at + 1),
                _ => {
                    let again = file[at..(at + next(60)).min(file.len())].to_vec();
                    file.splice(at..at, again);
                }
            }
        }
        let mut found = 0;
        let mut reader = CaptureReader::default();
        let size = 1 + next(200);
        file.chunks(size).for_each(|piece| reader.feed(piece, &mut |_| found += 1));
        reader.finish(&mut |_| found += 1);
        assert!(found <= 40 * expected.len(), "{format} {packing:?} round {round}: {found}");
    }
}
