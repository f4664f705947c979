//! Lowest cost of a frame of one of the bench's logs: the least disturbed of many short runs. The first argument is
//! the name of the log. With a number as the second: that many frames of it, to stdout, for what the program itself
//! costs. With `text` or `summary` as the third, these frames are decoded so, once.

#[path = "../benches/work/mod.rs"]
mod work;

use std::hint::black_box;
use std::time::Instant;

use work::{KINDS, columns, parse, stated, summary, text};

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
    let mut args = std::env::args().skip(1);
    let kind = match args.next() {
        None => KINDS[0],
        Some(name) => {
            let names = KINDS.map(|kind| kind.name).join(", ");
            let mut kinds = KINDS.into_iter();
            kinds.find(|kind| kind.name == name).unwrap_or_else(|| panic!("one of {names}"))
        }
    };
    if let Some(frames) = args.next().and_then(|frames| frames.parse().ok()) {
        let log = kind.log(frames);
        return match args.next().as_deref() {
            None => print!("{log}"),
            Some("text") => println!("{}", text(&log, stated(kind), 1)),
            Some("summary") => println!("{}", summary(&log, stated(kind))),
            Some(_) => println!("{}", log.len()),
        };
    }
    let (short, long) = (kind.log(SHORT), kind.log(LONG));
    best("read", &short, 400, parse);
    best("text", &short, 400, |log| text(log, stated(kind), 1) as u64);
    best("columns", &short, 400, |log| columns(log, stated(kind), 1) as u64);
    best("summary", &short, 400, |log| summary(log, stated(kind)));
    for jobs in [1, 2] {
        let name = format!("text, {jobs} threads");
        best(&name, &long, 20, |log| text(log, stated(kind), jobs) as u64);
        let name = format!("columns, {jobs} threads");
        best(&name, &long, 20, |log| columns(log, stated(kind), jobs) as u64);
    }
}
