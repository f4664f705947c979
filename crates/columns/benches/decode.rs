//! What a frame of a candump log costs: read, decoded into columns in memory, decoded into text.
//!
//! Sixteen CANopen drives at 1 kHz whose mappings stand at the head of the log: SYNC, RPDO1, TPDO1 and
//! TPDO2 in every cycle, heartbeats and reads of objects between. Targets on one core: 20, 30 and 60 ns.

mod work;

use std::hint::black_box;
use std::io::Cursor;
use std::sync::Arc;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use polepair_capture::summary::Summary;
use polepair_capture::{CaptureDecoder, FrameBatch, ReadOptions};
use work::{columns, log, parse, stated, text, text_by};

const FRAMES: usize = 100_000;
const PIECE: usize = 1 << 18;

/// A decoder that detects the protocol.
fn detecting(log: &Arc<[u8]>) -> CaptureDecoder {
    let source = Box::new(Cursor::new(Arc::clone(log)));
    CaptureDecoder::detect(source, ReadOptions::default()).expect("memory can be read")
}

/// Summarises a log.
fn summary(log: &str, decoder: CaptureDecoder) -> u64 {
    let (mut summary, mut decoder) = (Summary::default(), decoder.without_text());
    let mut batch = FrameBatch::default();
    for piece in log.as_bytes().chunks(PIECE) {
        decoder.decode_batch(piece, &mut batch, &mut |batch| summary.add_batch(batch));
        summary.add_batch(&batch);
    }
    decoder.finish_batch(&mut batch, &mut |batch| summary.add_batch(batch));
    summary.add_batch(&batch);
    summary.frames
}

fn decode(c: &mut Criterion) {
    let log = log(FRAMES);
    let bytes: Arc<[u8]> = Arc::from(log.as_bytes());
    let frames = log.lines().count() as u64;
    let mut group = c.benchmark_group("candump log, per frame");
    group.throughput(Throughput::Elements(frames));
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    group.bench_function("read", |b| b.iter(|| black_box(parse(black_box(&log)))));
    type Decoded = fn(&str, CaptureDecoder) -> u64;
    let outputs: [(&str, Decoded); 3] = [
        ("columns", |log, decoder| columns(log, decoder) as u64),
        ("text", |log, decoder| text(log, decoder) as u64),
        ("summary", summary),
    ];
    for (name, output) in outputs {
        group.bench_function(name, |b| b.iter(|| output(black_box(&log), stated())));
        group.bench_function(format!("{name}, detected"), |b| {
            b.iter(|| output(black_box(&log), detecting(&bytes)));
        });
    }
    for jobs in [1, 2] {
        let name = format!("text, threads: {jobs}");
        group.bench_function(name, |b| b.iter(|| black_box(text_by(black_box(&log), jobs))));
    }
    group.finish();
}

criterion_group!(benches, decode);
criterion_main!(benches);
