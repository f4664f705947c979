//! Cost of a frame of a candump log: read, decoded into columns in memory, decoded into text.
//!
//! The log of mapped process data has all outputs, each other log text and summary. Targets on one core: 20, 30 and
//! 60 ns for mapped process data.

mod work;

use std::hint::black_box;
use std::io::Cursor;
use std::sync::Arc;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use polepair_capture::{CaptureDecoder, ReadOptions};
use work::{KINDS, LogKind, columns, parse, stated, summary, text};

const FRAMES: usize = 100_000;

/// A decoder that detects the protocol.
fn detecting(log: &Arc<[u8]>) -> CaptureDecoder {
    let source = Box::new(Cursor::new(Arc::clone(log)));
    CaptureDecoder::detect(source, ReadOptions::default()).expect("memory can be read")
}

fn decode(c: &mut Criterion) {
    let [mapped, others @ ..] = KINDS;
    let log = mapped.log(FRAMES);
    let bytes: Arc<[u8]> = Arc::from(log.as_bytes());
    let frames = log.lines().count() as u64;
    let mut group = c.benchmark_group("candump log, per frame");
    group.throughput(Throughput::Elements(frames));
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    group.bench_function("read", |b| b.iter(|| black_box(parse(black_box(&log)))));
    type Output = fn(&str, CaptureDecoder) -> usize;
    let outputs: [(&str, Output); 3] = [
        ("columns", |log, decoder| columns(log, decoder, 1)),
        ("text", |log, decoder| text(log, decoder, 1)),
        ("summary", |log, decoder| summary(log, decoder) as usize),
    ];
    for (name, output) in outputs {
        group.bench_function(name, |b| b.iter(|| output(black_box(&log), stated(mapped))));
        group.bench_function(format!("{name}, detected"), |b| {
            b.iter(|| output(black_box(&log), detecting(&bytes)));
        });
    }
    group.bench_function("columns, two threads", |b| {
        b.iter(|| columns(black_box(&log), stated(mapped), 2))
    });
    group.bench_function("text, two threads", |b| {
        b.iter(|| text(black_box(&log), stated(mapped), 2))
    });
    group.finish();
    for kind in others {
        decode_other(c, kind);
    }
}

/// Text and summary of a log.
fn decode_other(c: &mut Criterion, kind: LogKind) {
    let log = kind.log(FRAMES);
    let mut group = c.benchmark_group(format!("log {:?}, per frame", kind.name));
    group.throughput(Throughput::Elements(log.lines().count() as u64));
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    group.bench_function("text", |b| b.iter(|| text(black_box(&log), stated(kind), 1)));
    group.bench_function("summary", |b| b.iter(|| summary(black_box(&log), stated(kind))));
    group.finish();
}

criterion_group!(benches, decode);
criterion_main!(benches);
