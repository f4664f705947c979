//! One world: it is built from its seed, lives, and is watched.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use polepair::Connector;
use polepair::simulate::Simulation;
use polepair_core::time::Instant;
use polepair_serve::bench::{Bench, Options};
use polepair_sim::random::{History, Ppm, Random};

use crate::drives::Rack;
use crate::live::Live;
use crate::schedule;
use crate::wire::{self, AnyPort};
use crate::{Report, Tell, Violation};

/// How long things fail, and how long they are watched after that, ms.
const STORM_MS: (i64, i64) = (3_000, 9_000);
const CALM_MS: u32 = 9_500;
/// Clients act so long after the last calamity.
const AFTER_MS: u32 = 1_500;

/// Wires of a bench, as they are opened.
type Ports = Arc<Mutex<Vec<Arc<dyn AnyPort>>>>;

/// How a world ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum End {
    /// Nobody says anything any more: leases end.
    Silence,
    /// Somebody stops everything.
    Stop,
    /// The server ends.
    Shutdown,
}

/// Lives through the world of a seed.
pub fn live(seed: u64, tell: Option<Tell>) -> Report {
    let mut random = Random::new(seed);
    let rack = Rack::random(&mut random);
    let ports: Ports = Ports::default();
    let bench = match open(&rack, seed, &ports) {
        Ok(bench) => bench,
        Err(what) => {
            let violation = Violation { invariant: "G12", at: Instant::ZERO, what };
            return Report { seed, violations: vec![violation], ..Report::default() };
        }
    };
    let simulation = bench.simulation(0).expect("every wire is simulated");
    let begin = simulation.now();
    let calm = begin.plus_ms(random.between(STORM_MS.0, STORM_MS.1) as u32);
    let quiet = calm.plus_ms(random.below(u64::from(AFTER_MS)) as u32);
    let end = quiet.plus_ms(CALM_MS);
    let how = random.pick(&[End::Silence, End::Silence, End::Stop, End::Shutdown]);
    let step = random.pick(&[1, 2, 3, 5]);
    let calamities = schedule::calamities(&mut random, rack.wires, begin, calm);
    let ports = ports.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let report = Report { seed, ..Report::default() };
    let mut live =
        Live::new(&rack, random, &bench, ports, (begin, quiet), calamities, report, tell);
    live.say(|| format!("seed {seed}: {how:?} at {:.3} s, steps of {step} ms", at(quiet)));
    for (n, (kind, wire)) in rack.axes.iter().enumerate() {
        live.say(|| format!("axis {n}: {} on wire {wire}", kind.name));
    }
    let live = Rc::new(RefCell::new(live));
    let (its, of) = (Rc::clone(&live), bench.clone());
    wire::set_tick(Some(Rc::new(move || its.borrow_mut().turn(&of, true))));
    pass_until(&bench, &simulation, &live, quiet, step);
    match how {
        End::Silence => {}
        End::Stop => live.borrow_mut().stop_all(&bench),
        End::Shutdown => {
            live.borrow_mut().say(|| "the server ends".to_owned());
            live.borrow_mut().shuts_down();
            let left = bench.shutdown();
            live.borrow_mut().is_shut(&bench, &left);
        }
    }
    if how != End::Shutdown {
        pass_until(&bench, &simulation, &live, end, step);
    }
    wire::set_tick(None);
    let mut live = Rc::try_unwrap(live).ok().expect("nobody ticks any more").into_inner();
    live.report.lived = Instant(simulation.now().since(begin).as_nanos() as u64);
    live.ended()
}

/// Lets a world live until then.
fn pass_until(
    bench: &Bench,
    simulation: &Simulation,
    live: &Rc<RefCell<Live>>,
    end: Instant,
    step: u64,
) {
    while simulation.now() < end {
        // What is asked here waits, and lets time pass: others have their turn by the tick.
        bench.pass(Duration::ZERO);
        live.borrow_mut().turn(bench, false);
        simulation.pass(Duration::from_millis(step));
    }
}

/// Opens the bench of a rack, its wires in order.
fn open(rack: &Rack, seed: u64, ports: &Ports) -> Result<Bench, String> {
    let thread = format!("{:?}", std::thread::current().id());
    let thread: String = thread.chars().filter(char::is_ascii_digit).collect();
    let name = format!("polepair-swarm-{}-{thread}.toml", std::process::id());
    let file = std::env::temp_dir().join(name);
    std::fs::write(&file, &rack.text).map_err(|error| error.to_string())?;
    let its = Arc::clone(ports);
    let connector = Connector::default().with_links(move |_, link, _| {
        let (link, port) = wire::faulty(link);
        its.lock().unwrap_or_else(PoisonError::into_inner).push(port);
        link
    });
    let url = format!("sim:{}?time=virtual&seed={}", file.display(), seed % (1 << 40));
    let opened = Bench::open(&[url], Options { connector, ..Options::default() });
    // It may be gone already; the next seed of this thread writes its own.
    let _ = std::fs::remove_file(&file);
    opened.map_err(|refused| format!("{}\n{}", refused.message, rack.text))
}

/// Seconds.
pub fn at(instant: Instant) -> f64 {
    instant.0 as f64 / 1e9
}

/// Draws a speed for a kind of drive, rad/s: both directions.
pub fn speed(kind: &crate::drives::Kind, random: &mut Random) -> f64 {
    let (least, most) = kind.speeds;
    let speed = random.between(i64::from(least), i64::from(most)) as f64;
    if random.chance(Ppm(500_000)) { speed } else { -speed }
}

/// The hash of a word.
pub fn note(history: &mut History, word: &str) {
    history.note_bytes(word.as_bytes());
}
