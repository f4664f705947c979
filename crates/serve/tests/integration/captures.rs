//! A capture that a page opens, on a real server.

use crate::site;

use std::io::Write as _;

use flate2::Compression;
use flate2::write::GzEncoder;
use polepair_serve::bench::{Bench, BenchOptions, CAPTURE_MAX};
use serde_json::Value;
use site::Site;

#[test]
fn a_capture_is_opened_and_read_page_by_page() {
    let site = Site::new();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/feeder.log");
    let capture = std::fs::read_to_string(file).unwrap();
    let heads =
        site.bearer("viewer") + "Content-Type: application/octet-stream\r\nX-Polepair: 1\r\n";
    let opened = site.send("POST /api/v1/captures?name=feeder.log", &heads, &capture);
    assert_eq!(opened.status, 200, "{opened:?}");
    let opened = opened.json();
    assert_eq!(opened["name"], "feeder.log");
    let total = opened["page"]["total"].as_u64().unwrap();
    let page = |query: &str| {
        let path = format!("/api/v1/captures/{}?{query}", opened["id"].as_str().unwrap());
        site.get(&path, &site.bearer("viewer"))
    };
    let (mut from, mut seen) = (Some(0), 0);
    while let Some(next) = from {
        let page: Value = page(&format!("from={next}&count=7")).json();
        seen += page["items"].as_array().unwrap().len() as u64;
        from = page["next"].as_u64();
    }
    assert_eq!(seen, total);
    assert_eq!(page("filter=axis+%3D+%3D+2").status, 400);
    assert_eq!(site.get("/api/v1/captures/capture-9", &site.bearer("viewer")).status, 404);
    let nothing = site.send("POST /api/v1/captures?name=x", &heads, "");
    assert_eq!((nothing.status, nothing.code().as_str()), (422, "E510"));
    site.end();
}

/// Threat 12: a few kilobytes can hold more than there is memory.
#[test]
fn t12_a_capture_is_bounded_by_what_it_unpacks_to() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default()).unwrap();
    let line = b"(1.000000) can0 123#1122334455667788\n";
    let packed = |lines: usize| {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
        (0..lines).for_each(|_| gzip.write_all(line).unwrap());
        gzip.finish().unwrap()
    };
    let opened = bench.open_capture("small.log.gz", packed(1000)).unwrap();
    assert_eq!(opened.page.total, 1000);
    let bomb = packed(CAPTURE_MAX / line.len() + 1);
    assert!(bomb.len() < CAPTURE_MAX / 20, "{} bytes", bomb.len());
    let refused = bench.open_capture("bomb.log.gz", bomb).unwrap_err();
    assert_eq!(refused.code, "gateway.size", "{refused}");
}

/// Threat 12: what is packed twice is no capture, however much is in it.
#[test]
fn t12_what_is_packed_twice_is_not_unpacked_twice() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default()).unwrap();
    let packed = |bytes: &[u8]| {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
        gzip.write_all(bytes).unwrap();
        gzip.finish().unwrap()
    };
    let capture = packed(b"(1.000000) can0 123#1122334455667788\n");
    assert_eq!(bench.open_capture("once.gz", capture.clone()).unwrap().page.total, 1);
    // Zstandard: blocks of 128 KiB of one byte, four bytes each.
    let mut bomb = vec![0x28, 0xB5, 0x2F, 0xFD, 0, 0x38];
    (0..CAPTURE_MAX >> 16).for_each(|_| bomb.extend([0x02, 0x00, 0x10, b'\n']));
    bomb.extend([0x01, 0x00, 0x00]);
    assert_eq!(bench.open_capture("bomb", bomb.clone()).unwrap_err().code, "gateway.size");
    for twice in [packed(&capture), packed(&bomb)] {
        let refused = bench.open_capture("twice.gz", twice).unwrap_err();
        assert_eq!(refused.code, "E510", "{refused}");
    }
}

/// Threat 12: what is packed within a capture counts as what it unpacks to.
#[test]
fn t12_containers_of_a_blf_count_unpacked() {
    const OBJECTS: usize = 8 << 20;
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default()).unwrap();
    // One frame, and then nothing that is an object; each container states its unpacked size.
    let mut frame = b"LOBJ".to_vec();
    frame.extend([16, 0, 1, 0, 48, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    frame.extend([0; 12]);
    frame.extend([1, 0, 0, 8, 0x23, 1, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8]);
    let container = |says: usize| {
        let mut zlib = flate2::write::ZlibEncoder::new(Vec::new(), Compression::best());
        zlib.write_all(&frame).unwrap();
        zlib.write_all(&vec![0; OBJECTS - frame.len()]).unwrap();
        let packed = zlib.finish().unwrap();
        let mut object = b"LOBJ\x10\0\x01\0".to_vec();
        object.extend((32 + packed.len() as u32).to_le_bytes());
        object.extend([10, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
        object.extend((says as u32).to_le_bytes());
        object.extend([0; 4]);
        object.extend(packed);
        object
    };
    let file = |count: usize, says: usize| {
        let mut file = b"LOGG\x90\0\0\0".to_vec();
        file.resize(144, 0);
        (0..count).for_each(|_| file.extend(container(says)));
        file
    };
    let opened = bench.open_capture("small.blf", file(2, OBJECTS)).unwrap();
    assert_eq!(opened.page.total, 2);
    let bomb = file(9, OBJECTS);
    assert!(bomb.len() < 100_000, "{} bytes", bomb.len());
    let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
    gzip.write_all(&bomb).unwrap();
    for bomb in [bomb, gzip.finish().unwrap()] {
        let refused = bench.open_capture("bomb.blf", bomb).unwrap_err();
        assert_eq!(refused.code, "gateway.size", "{refused}");
    }
    // A container that understates its size gives no more than that, also after one that made room.
    let small = [file(1, OBJECTS), container(frame.len()), container(0)].concat();
    let opened = bench.open_capture("less.blf", small).unwrap();
    assert_eq!(opened.page.total, 2, "{}", opened.summary);
    // What no such bytes can unpack to is not unpacked, nor is room made for it.
    let nothing = bench.open_capture("more.blf", file(3, u32::MAX as usize)).unwrap_err();
    assert_eq!(nothing.code, "E510");
}
