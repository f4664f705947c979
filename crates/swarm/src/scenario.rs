//! One world: it is built from its seed, lives, and is watched.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use polepair::Connector;
use polepair::simulate::Simulation;
use polepair_core::time::Instant;
use polepair_serve::bench::{Bench, BenchOptions};
use polepair_sim::random::Random;

use crate::drives::RandomRack;
use crate::history::seconds;
use crate::runner::WorldRunner;
use crate::schedule;
use crate::wire::{self, AnyPort};
use crate::{GatewayReport, HistorySink, Violation};

/// Time of the faults, and of the watch after them, ms.
const FAULTS_MS: (i64, i64) = (3_000, 9_000);
const FAULT_FREE_MS: u32 = 9_500;
/// Time for which clients act after the last calamity.
const CLIENTS_LINGER_MS: u32 = 1_500;

/// Wires of a bench, as they are opened.
type SharedPorts = Arc<Mutex<Vec<Arc<dyn AnyPort>>>>;

/// End of a world.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum WorldEnd {
    /// No client sends anything any more: leases end.
    Silence,
    /// A client stops everything.
    Stop,
    /// The server ends.
    Shutdown,
}

/// Lives through the world of a seed.
pub fn run_world(seed: u64, report_line: Option<HistorySink>) -> GatewayReport {
    let mut random = Random::new(seed);
    let rack = RandomRack::random(&mut random);
    let ports: SharedPorts = SharedPorts::default();
    let bench = match open_bench(&rack, seed, &ports) {
        Ok(bench) => bench,
        Err(what) => {
            let violation = Violation { invariant: "G12", at: Instant::ZERO, what };
            return GatewayReport { seed, violations: vec![violation], ..GatewayReport::default() };
        }
    };
    let simulation = bench.simulation(0).expect("every wire is simulated");
    let begin = simulation.now();
    let calm = begin.plus_ms(random.between(FAULTS_MS.0, FAULTS_MS.1) as u32);
    let quiet = calm.plus_ms(random.below(u64::from(CLIENTS_LINGER_MS)) as u32);
    let end = quiet.plus_ms(FAULT_FREE_MS);
    let how =
        random.pick(&[WorldEnd::Silence, WorldEnd::Silence, WorldEnd::Stop, WorldEnd::Shutdown]);
    let step = random.pick(&[1, 2, 3, 5]);
    let calamities = schedule::plan_disturbances(&mut random, rack.wires, begin, calm);
    let drive_events = schedule::plan_drive_events(&mut random, rack.axes.len(), begin, calm);
    let ports = ports.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let report = GatewayReport { seed, ..GatewayReport::default() };
    let mut live = WorldRunner::new(
        &rack,
        random,
        &bench,
        ports,
        begin,
        quiet,
        calamities,
        drive_events,
        report,
        report_line,
    );
    live.log(|| format!("seed {seed}: {how:?} at {:.3} s, steps of {step} ms", seconds(quiet)));
    for (n, (kind, wire)) in rack.axes.iter().enumerate() {
        live.log(|| format!("axis {n}: {} on wire {wire}", kind.name));
    }
    let live = Rc::new(RefCell::new(live));
    let (its, of) = (Rc::clone(&live), bench.clone());
    wire::set_wait_hook(Some(Rc::new(move || its.borrow_mut().step(&of, true))));
    run_until(&bench, &simulation, &live, quiet, step);
    match how {
        WorldEnd::Silence => {}
        WorldEnd::Stop => live.borrow_mut().stop_all(&bench),
        WorldEnd::Shutdown => {
            live.borrow_mut().log(|| "the server ends".to_owned());
            live.borrow_mut().begin_shutdown();
            let left = bench.shutdown();
            live.borrow_mut().check_shutdown(&bench, &left);
        }
    }
    if how != WorldEnd::Shutdown {
        run_until(&bench, &simulation, &live, end, step);
    }
    wire::set_wait_hook(None);
    let mut live = Rc::try_unwrap(live).ok().expect("nobody ticks any more").into_inner();
    live.report.world_time = Instant(simulation.now().since(begin).as_nanos() as u64);
    live.into_report()
}

/// Lets a world live until then.
fn run_until(
    bench: &Bench,
    simulation: &Simulation,
    live: &Rc<RefCell<WorldRunner>>,
    end: Instant,
    step: u64,
) {
    while simulation.now() < end {
        // A request here waits and lets time pass: others have their turn by the tick.
        bench.advance_time(Duration::ZERO);
        live.borrow_mut().step(bench, false);
        simulation.advance(Duration::from_millis(step));
    }
}

/// Opens the bench of a rack, its wires in order.
fn open_bench(rack: &RandomRack, seed: u64, ports: &SharedPorts) -> Result<Bench, String> {
    let thread = format!("{:?}", std::thread::current().id());
    let thread: String = thread.chars().filter(char::is_ascii_digit).collect();
    let name = format!("polepair-swarm-{}-{thread}.toml", std::process::id());
    let file = std::env::temp_dir().join(name);
    polepair_files::write_atomic(&file, rack.text.as_bytes()).map_err(|error| error.to_string())?;
    let its = Arc::clone(ports);
    let connector = Connector::default().with_link_wrapper(move |_, link, _| {
        let (link, port) = wire::wrap_link(link);
        its.lock().unwrap_or_else(PoisonError::into_inner).push(port);
        link
    });
    let url = format!("sim:{}?time=virtual&seed={}", file.display(), seed % (1 << 40));
    let opened = Bench::open(&[url], BenchOptions { connector, ..BenchOptions::default() });
    // It may be gone already; the next seed of this thread writes its own.
    let _ = std::fs::remove_file(&file);
    opened.map_err(|refused| format!("{}\n{}", refused.message, rack.text))
}
