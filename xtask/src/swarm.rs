//! Seeded worlds of serial wires and of CAN buses, as many as wanted: what they lived through, and
//! what broke.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use polepair_core::medium::MediumKind;
use polepair_sim::swarm::{self, WorldReport};

/// Text of `swarm --help`.
pub const HELP: &str = "\
usage: cargo xtask swarm [--on serial|can|gateway] [--seeds N] [--from S] [--jobs J]
       cargo xtask swarm --replay serial:S | can:S | gateway:S
       cargo xtask swarm --debug ...

Lives through seeded worlds in virtual time. A seed decides everything that happens in its world, so the
same seed gives the same history each time. After every event the invariants are checked; a seed that
breaks one is named, with what broke and how to see it again.

  --on serial    hosts and drives of every protocol on serial wires: bytes damaged, lost, late, doubled,
                 wrong baud rates, pulled cables, drives that restart
  --on can       the same on CAN buses: frames lost, repeated, late, bus-off, strangers
                 (without --on: serial, then CAN)
  --on gateway   a server's bench with several clients that take leases, move, stop, vanish, hang and come
                 back, drives of every family, and wires that are cut, refused, dropped, silent and slow
  --seeds N      how many worlds; 8000 (gateway: 1000)
  --from S       the first seed; 1
  --jobs J       how many at once; one for each processor
  --replay M:S   one seed again, and everything that happens in it: who says what, every frame, what each
                 was told, what is true of each motor
  --debug        without a release build first: slower worlds, sooner begun

Invariants on serial and CAN are explained in crates/sim/src/swarm.rs and crates/sim/src/check.rs, those on
the gateway in crates/swarm/src/lib.rs. `excused` counts what looks like a violation and of which it is
proven on the wire that no host could know better; it is no violation.

Exit code 0: no invariant was broken. 1: some were, or a word is not understood.";

/// Seeds that are named at most when they break something.
const NAMED_MAX: usize = 20;

/// `--seeds N --from S --jobs J --on serial|can`, on both if it is left out; `--replay can:S` prints the whole history
/// of one seed.
#[derive(Clone, Copy, Debug)]
struct SwarmOptions {
    seeds: u64,
    from: u64,
    jobs: u64,
    on: Option<MediumKind>,
}

const MEDIA: [(MediumKind, &str); 2] = [(MediumKind::Serial, "serial"), (MediumKind::Can, "can")];

/// Runs the seeds and prints totals.
///
/// # Errors
/// A word that is not understood, or the seeds that broke an invariant.
pub fn run(words: &[&str]) -> Result<(), String> {
    if let ["--replay", which] = words {
        return replay(which);
    }
    let options = parse_options(words)?;
    let mut reports = Vec::new();
    for (medium, name) in MEDIA.into_iter().filter(|(m, _)| options.on.is_none_or(|on| on == *m)) {
        let started_at = Instant::now();
        let (total, broken) = run_seeds(options, medium);
        let took = started_at.elapsed().as_secs_f64();
        print_totals(&total, options, medium, took);
        let lines = broken.iter().take(NAMED_MAX).map(|report| {
            let reports: Vec<_> = report.violations.iter().map(|v| format!("  {v}")).collect();
            let again = format!("replay: cargo xtask swarm --replay {name}:{}", report.seed);
            format!("seed {name}:{}\n{}\n  {again}", report.seed, reports.join("\n"))
        });
        reports.extend(lines);
        if !broken.is_empty() {
            let (broken, seeds) = (broken.len(), options.seeds);
            reports.push(format!("{broken} of {seeds} seeds on {name} broke an invariant"));
        }
    }
    if reports.is_empty() { Ok(()) } else { Err(reports.join("\n")) }
}

fn replay(which: &str) -> Result<(), String> {
    let named = MEDIA.iter().find_map(|(medium, name)| {
        Some((*medium, which.strip_prefix(name)?.strip_prefix(':')?.parse().ok()?))
    });
    let (medium, seed) =
        named.ok_or_else(|| format!("--replay {which}: write serial:7, or can:7"))?;
    let report = swarm::replay(medium, seed, &mut |line| println!("{line}"));
    let reports: Vec<_> = report.violations.iter().map(|v| v.to_string()).collect();
    if reports.is_empty() { Ok(()) } else { Err(reports.join("\n")) }
}

fn parse_options(words: &[&str]) -> Result<SwarmOptions, String> {
    let jobs = std::thread::available_parallelism().map_or(1, |n| n.get() as u64);
    let mut options = SwarmOptions { seeds: 8_000, from: 1, jobs, on: None };
    for pair in words.chunks(2) {
        let [key, value] = pair else { return Err(format!("{} needs a number", pair[0])) };
        if *key == "--on" {
            let found = MEDIA.iter().find(|(_, name)| name == value);
            let (medium, _) = found.ok_or_else(|| format!("--on {value}: serial or can"))?;
            options.on = Some(*medium);
            continue;
        }
        let number = value.parse().map_err(|_| format!("{key} {value}: not a number"))?;
        match *key {
            "--seeds" => options.seeds = number,
            "--from" => options.from = number,
            "--jobs" => options.jobs = number.max(1),
            _ => return Err(format!("{key}: unknown; there are --seeds, --from, --jobs, --on")),
        }
    }
    Ok(options)
}

fn run_seeds(options: SwarmOptions, medium: MediumKind) -> (WorldReport, Vec<WorldReport>) {
    let next = AtomicU64::new(0);
    let sum = Mutex::new((WorldReport::default(), Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..options.jobs {
            scope.spawn(|| {
                loop {
                    let n = next.fetch_add(1, Ordering::Relaxed);
                    if n >= options.seeds {
                        break;
                    }
                    let report = swarm::run(medium, options.from + n);
                    let mut sum = sum.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                    sum.0.add(&report);
                    if !report.violations.is_empty() {
                        sum.1.push(report);
                    }
                }
            });
        }
    });
    let (total, mut broken) = sum.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    broken.sort_by_key(|report| report.seed);
    (total, broken)
}

fn print_totals(total: &WorldReport, options: SwarmOptions, medium: MediumKind, took: f64) {
    let lived = total.world_time.0 as f64 / 1e9;
    println!("seeds            {:>12}  from {}", options.seeds, options.from);
    println!("events           {:>12}", total.events);
    println!("requests         {:>12}", total.requests);
    println!("motions started  {:>12}", total.starts);
    println!("tickets done     {:>12}", total.done);
    println!("        not done {:>12}", total.not_done);
    println!("        unknown  {:>12}", total.unknown);
    match medium {
        MediumKind::Serial => print_serial(total),
        MediumKind::Can => print_can(total),
    }
    println!("  drive resets   {:>12}", total.resets);
    println!("  acts on drives {:>12}", total.acts);
    println!("  cables pulled  {:>12}", total.cable_pulls);
    println!(
        "wire collisions  {:>12}  wrong values that passed every check",
        total.wire_collisions
    );
    println!("  and requests   {:>12}  changed on the way, and answered", total.requests_collided);
    println!(
        "copies taken     {:>12}  second copies of a reply taken for the next answer",
        total.copies_taken
    );
    println!("violations       {:>12}", total.violations.len());
    let rate = lived / took.max(1e-9);
    let (jobs, a_core) = (options.jobs, rate / options.jobs as f64);
    println!(
        "lived            {lived:>12.0} s in {took:.1} s: {rate:.0} x real time, {a_core:.0} x a core ({jobs} jobs)"
    );
}

fn print_serial(total: &WorldReport) {
    let faults = total.injected;
    println!("faults: bytes    {:>12}", faults.bytes);
    println!("  truncated      {:>12}", faults.truncated);
    println!("  in pieces      {:>12}", faults.chunked);
    println!("  duplicated     {:>12}", faults.duplicated);
    println!("  late           {:>12}", faults.late);
    println!("  requests lost  {:>12}", faults.requests_lost);
    println!("  replies lost   {:>12}", faults.replies_lost);
    println!("  collisions     {:>12}", faults.collided);
}

fn print_can(total: &WorldReport) {
    let faults = total.injected_on_can;
    println!("faults: errors   {:>12}", faults.errors);
    println!("  lost           {:>12}", faults.lost);
    println!("  taken twice    {:>12}", faults.taken_twice);
    println!("  late           {:>12}", faults.late);
    println!("  cut short      {:>12}", faults.cut);
    println!("  one identifier {:>12}", faults.collided);
    println!("  bus-off        {:>12}", faults.bus_off);
    println!("  of strangers   {:>12}", faults.intruder_frames);
    println!(
        "verbs repeated   {:>12}  executed twice: their frame was taken twice",
        total.repeated
    );
    println!(
        "excused          {:>12}  link lost: two programs said NMT at once, 32 times running",
        total.clashes
    );
    for (protocol, verbs) in &total.unreported_on {
        println!(
            "verbs untold     {verbs:>12}  done for the host, missed by the drive, on {protocol}"
        );
    }
    for (protocol, copies) in &total.copies_on {
        println!("copies taken     {copies:>12}  on {protocol}");
    }
}
