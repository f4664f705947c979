//! `polepair-swarm --seeds N --from S --jobs J`, `polepair-swarm --replay S`; `cargo xtask swarm --on
//! gateway` calls it.
#![forbid(unsafe_code)]

use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use polepair_link::clock;
use polepair_swarm::{GatewayReport, replay, run};

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match run_arguments(&words) {
        Ok(()) => ExitCode::SUCCESS,
        Err(what) => {
            eprintln!("{what}");
            ExitCode::FAILURE
        }
    }
}

fn run_arguments(words: &[&str]) -> Result<(), String> {
    if let ["--replay", seed] = words {
        let seed = seed.parse().map_err(|_| format!("--replay {seed}: not a number"))?;
        let report = replay(seed, |line| println!("{line}"));
        println!("history {:016x}", report.history);
        return report_broken(&[report], 1);
    }
    let (mut seeds, mut from) = (1000, 1);
    let mut jobs = std::thread::available_parallelism().map_or(1, |n| n.get() as u64);
    for pair in words.chunks(2) {
        let [key, value] = pair else { return Err(format!("{} needs a number", pair[0])) };
        let number = value.parse::<u64>().map_err(|_| format!("{key} {value}: not a number"))?;
        match *key {
            "--seeds" => seeds = number,
            "--from" => from = number,
            "--jobs" => jobs = number.max(1),
            _ => {
                return Err(format!("{key}: unknown; there are --seeds, --from, --jobs, --replay"));
            }
        }
    }
    let started_at = clock::now();
    let next = AtomicU64::new(0);
    let sum = Mutex::new((GatewayReport::default(), Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                loop {
                    let n = next.fetch_add(1, Ordering::Relaxed);
                    if n >= seeds {
                        break;
                    }
                    let report = run(from + n);
                    let mut sum = sum.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                    sum.0.add(&report);
                    if !report.violations.is_empty() {
                        // As they break, for those who wait long.
                        for violation in &report.violations {
                            println!("seed gateway:{} {violation}", report.seed);
                        }
                        sum.1.push(report);
                    }
                }
            });
        }
    });
    let (total, mut broken) = sum.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    broken.sort_by_key(|report| report.seed);
    println!("seeds                 {seeds:>12}  from {from}");
    for (name, count) in &total.counts {
        println!("{name:<21} {count:>12}");
    }
    for (name, count) in &total.excused {
        println!("excused               {count:>12}  {name}");
    }
    println!("violations            {:>12}", total.violations.len());
    let (lived, took) =
        (total.world_time.0 as f64 / 1e9, clock::now().since(started_at).as_secs_f64());
    let (worlds, rate) = (seeds as f64 / took, lived / took);
    println!("lived                 {lived:>12.0} s in {took:.1} s, {jobs} jobs");
    println!("                      {worlds:>12.0} worlds a second, {rate:.0} x real time");
    report_broken(&broken, seeds)
}

fn report_broken(broken: &[GatewayReport], seeds: u64) -> Result<(), String> {
    let broken: Vec<&GatewayReport> = broken.iter().filter(|r| !r.violations.is_empty()).collect();
    if broken.is_empty() {
        return Ok(());
    }
    let mut reports = Vec::new();
    for report in broken.iter().take(20) {
        reports.extend(report.violations.iter().map(|violation| format!("  {violation}")));
        reports.push(format!("  replay: cargo xtask swarm --replay gateway:{}", report.seed));
    }
    reports.push(format!("{} of {seeds} seeds on gateway broke an invariant", broken.len()));
    Err(reports.join("\n"))
}
