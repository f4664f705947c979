//! What a frame of a candump log costs: read, decoded into columns in memory, decoded into text.
//!
//! Sixteen CANopen drives at 1 kHz whose mappings stand at the head of the log: SYNC, RPDO1, TPDO1 and
//! TPDO2 in every cycle, heartbeats and reads of objects between. Targets on one core: 20, 30 and 60 ns.

mod work;

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use polepair_capture::ProtocolDetector;
use work::{columns, log, parse, text, text_by};

const FRAMES: usize = 100_000;
const PIECE: usize = 1 << 18;

/// Detects the protocol of a log.
fn detect(log: &str) -> usize {
    let mut detector = ProtocolDetector::new();
    log.as_bytes().chunks(PIECE).for_each(|piece| detector.feed(piece));
    detector.decide().0.len()
}

fn decode(c: &mut Criterion) {
    let log = log(FRAMES);
    let frames = log.lines().count() as u64;
    let mut group = c.benchmark_group("candump log, per frame");
    group.throughput(Throughput::Elements(frames));
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    group.bench_function("read", |b| b.iter(|| black_box(parse(black_box(&log)))));
    group.bench_function("detect", |b| b.iter(|| black_box(detect(black_box(&log)))));
    group.bench_function("columns", |b| b.iter(|| black_box(columns(black_box(&log)))));
    group.bench_function("text", |b| b.iter(|| black_box(text(black_box(&log)))));
    for jobs in [1, 2] {
        let name = format!("text, threads: {jobs}");
        group.bench_function(name, |b| b.iter(|| black_box(text_by(black_box(&log), jobs))));
    }
    group.finish();
}

criterion_group!(benches, decode);
criterion_main!(benches);
