//! Lowest cost of a frame of the bench's log: the least disturbed of many short runs. With a
//! number: that many frames of the log, to stdout, for what the program itself costs.

#[path = "../benches/work/mod.rs"]
mod work;

use std::hint::black_box;
use std::time::Instant;

use work::{columns, log, parse, stated, summary, text};

/// Frames of a short run, and of one that is worth several threads.
const SHORT: usize = 4_000;
const LONG: usize = 400_000;

fn best(name: &str, log: &str, runs: usize, mut run: impl FnMut(&str) -> u64) {
    let frames = log.lines().count() as f64;
    let times = (0..runs).map(|_| {
        let began = Instant::now();
        black_box(run(black_box(log)));
        began.elapsed().as_secs_f64()
    });
    let min_value = times.fold(f64::INFINITY, f64::min);
    println!("{name:20} {:7.1} ns a frame", min_value * 1e9 / frames);
}

fn main() {
    if let Some(frames) = std::env::args().nth(1).and_then(|frames| frames.parse().ok()) {
        return print!("{}", log(frames));
    }
    let (short, long) = (log(SHORT), log(LONG));
    best("read", &short, 400, parse);
    best("text", &short, 400, |log| text(log, stated(), 1) as u64);
    best("columns", &short, 400, |log| columns(log, stated(), 1) as u64);
    best("summary", &short, 400, |log| summary(log, stated()));
    for jobs in [1, 2] {
        let name = format!("text, {jobs} threads");
        best(&name, &long, 20, |log| text(log, stated(), jobs) as u64);
        let name = format!("columns, {jobs} threads");
        best(&name, &long, 20, |log| columns(log, stated(), jobs) as u64);
    }
}
