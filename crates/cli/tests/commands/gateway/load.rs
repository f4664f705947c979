//! Time from commands and stops to the wire, beside viewers, idle sockets and a flood of messages.
//!
//! The test needs an idle machine, so it runs in `make soak` alone. `POLEPAIR_LOAD_STOPS`,
//! `POLEPAIR_LOAD_COMMANDS`, `POLEPAIR_LOAD_IDLE`, `POLEPAIR_LOAD_VIEWERS` and `POLEPAIR_LOAD_RUNS` set the
//! numbers; the default is a few of each. Times are printed and not judged: they depend on the machine as well.
//! The lateness of a thread that only sleeps is printed beside them: it shows the load of the machine
//! meanwhile.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::{clock, tcp::TcpServer};
use serde_json::json;

use super::site::{Folder, Live, Site};
use super::wire::{Drive, Log, Passed};

/// An empty pong, which an idle viewer sends so that the server does not take it for disconnected.
const PONG: [u8; 6] = [0x8A, 0x80, 0, 0, 0, 0];
/// Between two pongs, and between two looks at idle sockets.
const PULSE: Duration = Duration::from_secs(1);
/// Sleep of the thread that measures the machine's lateness.
const FLOOR_EVERY: Duration = Duration::from_millis(1);
/// Messages that a client sends just before its own stop.
const OWN_BEFORE: usize = 150;
/// Interval at which viewers read: they share this machine's processors with the server.
const READ_EVERY: Duration = Duration::from_millis(20);

fn env_count(name: &str, usual: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// Threads that go on until this is dropped.
struct Beside {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Beside {
    fn new() -> Self {
        Self { over: Arc::default(), threads: Vec::new() }
    }

    fn go_on(&mut self, work: impl FnOnce(&AtomicBool) + Send + 'static) {
        let over = Arc::clone(&self.over);
        self.threads.push(std::thread::spawn(move || work(&over)));
    }

    /// Reads all messages and ignores them; sends a pong now and then.
    fn drain(&mut self, mut streams: Vec<TcpStream>) {
        streams.iter().for_each(|stream| stream.set_nonblocking(true).unwrap());
        self.go_on(move |over| {
            let (mut buffer, mut sent_at) = (vec![0; 1 << 16], clock::now());
            while !over.load(Ordering::Relaxed) {
                for stream in &mut streams {
                    while stream.read(&mut buffer).is_ok_and(|count| count > 0) {}
                }
                if clock::now().since(sent_at) > PULSE {
                    sent_at = clock::now();
                    streams.iter_mut().for_each(|stream| drop(stream.write(&PONG)));
                }
                std::thread::sleep(READ_EVERY);
            }
        });
    }

    /// Viewers of everything that passes and of a value.
    fn viewers(&mut self, site: &Site, count: usize) {
        let mut streams = Vec::new();
        for n in 0..count {
            let mut live = site.live();
            let axis = n % 2;
            live.send(&json!({ "type": "subscribe", "channel": 1, "axis": axis,
                "signal": "velocity", "hz": 50 }));
            live.send(&json!({ "type": "frames", "on": true }));
            live.next("frames");
            streams.push(live.socket.get_ref().try_clone().unwrap());
        }
        self.drain(streams);
    }

    /// Silent sockets, opened again when they are closed: the server waits five seconds for
    /// a request's head, so a fifth of them are new each second.
    fn idle(&mut self, site: &Site, count: usize) {
        let address = site.address;
        let open = move || {
            let stream = TcpStream::connect(address).ok()?;
            stream.set_nonblocking(true).ok()?;
            Some(stream)
        };
        let mut sockets: Vec<Option<TcpStream>> = (0..count).map(|_| open()).collect();
        let are_open = sockets.iter().flatten().count();
        assert_eq!(are_open, count, "the system lets this process open no more (`ulimit -n`)");
        self.go_on(move |over| {
            while !over.load(Ordering::Relaxed) {
                for socket in &mut sockets {
                    let closed = match socket {
                        Some(stream) => !matches!(stream.peek(&mut [0]),
                            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock),
                        None => true,
                    };
                    if closed {
                        *socket = open();
                    }
                }
                std::thread::sleep(PULSE);
            }
        });
    }

    /// A client that sends without end, and reads the replies.
    fn flood(&mut self, site: &Site) {
        let live = site.live();
        let mut stream = live.socket.get_ref().try_clone().unwrap();
        self.drain(vec![stream.try_clone().unwrap()]);
        let text = br#"{"type":"ping","client_ms":1}"#;
        let head = [0x81, 0x80 | text.len() as u8, 0, 0, 0, 0];
        let many = [&head[..], text].concat().repeat(200);
        self.go_on(move |over| {
            let mut sent = 0;
            while !over.load(Ordering::Relaxed) {
                // In the middle of a message it goes on where it was; a full socket is tried again.
                match stream.write(&many[sent..]) {
                    Ok(count) => sent = (sent + count) % many.len(),
                    Err(_) => std::thread::sleep(Duration::from_millis(1)),
                }
            }
        });
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Lateness of a thread that only sleeps.
struct Floor {
    late: Arc<Mutex<Vec<f64>>>,
    _thread: Beside,
}

impl Floor {
    fn new() -> Self {
        let (late, mut thread) = (Arc::<Mutex<Vec<f64>>>::default(), Beside::new());
        let its = Arc::clone(&late);
        thread.go_on(move |over| {
            while !over.load(Ordering::Relaxed) {
                let since = clock::now();
                std::thread::sleep(FLOOR_EVERY);
                let more = clock::now().since(since).saturating_sub(FLOOR_EVERY);
                its.lock().unwrap().push(more.as_secs_f64() * 1e3);
            }
        });
        Self { late, _thread: thread }
    }

    /// Since this was last asked.
    fn take_times(&self) -> Times {
        Times::new(std::mem::take(&mut *self.late.lock().unwrap()))
    }
}

/// Milliseconds, in order.
struct Times(Vec<f64>);

impl Times {
    fn new(mut all: Vec<f64>) -> Self {
        all.sort_by(f64::total_cmp);
        Self(all)
    }

    /// The value at a share of all values (nearest rank).
    fn at(&self, share: f64) -> f64 {
        let rank = (self.0.len() as f64 * share).ceil() as usize;
        self.0.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
    }
}

impl std::fmt::Display for Times {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [half, max, nearly, worst] = [0.5, 0.99, 0.999, 1.0].map(|share| self.at(share));
        write!(f, "p50 {half:.2}, p99 {max:.2}, p99.9 {nearly:.2}, worst {worst:.2} ms")?;
        write!(f, " of {}", self.0.len())
    }
}

/// A bench of two drives: TMCL, whose wire waits for an answer alone, and TS RTU, whose frames need
/// 10 ms of silence before them.
struct Bench {
    site: Site,
    logs: [Log; 2],
    _drives: [Drive; 2],
    _folder: Folder,
}

/// Silence before a frame, ms, by axis.
const PAUSE_MS: [f64; 2] = [0.0, 10.0];

impl Bench {
    fn new() -> Self {
        // As serial servers have it. What is written to a pseudo-terminal waits for a thread of the
        // kernel, which on a busy machine would be measured as well.
        let ends = [TcpServer::bind(":0").unwrap(), TcpServer::bind(":0").unwrap()];
        let urls = [
            format!("tmcl+tcp://{}#1", ends[0].address()),
            format!("modbus-rtu+tcp://{}?gap=10#1", ends[1].address()),
        ];
        let [tmcl, modbus] = ends;
        let drives =
            [Drive::on(Box::new(tmcl), "tmcl:1"), Drive::on(Box::new(modbus), "modbus-rtu:1")];
        let folder = Folder::new();
        let site = Site::new(&folder, &[&urls[0], &urls[1]]);
        let logs = [drives[0].log.clone(), drives[1].log.clone()];
        Self { site, logs, _drives: drives, _folder: folder }
    }
}

/// Returns whether a request stops the motor: TMCL's MST, or the first write.
fn stops(axis: usize, passed: &Passed) -> bool {
    passed.is(if axis == 0 { &[3] } else { &[6, 16] })
}

/// Returns when the stop that was requested at `since` was on the wire, and how much later that is than the
/// frames before it allowed, in ms.
fn on_wire(axis: usize, since: Instant, passed: &[Passed]) -> Option<(f64, f64)> {
    let sent = passed.iter().position(|p| p.at >= since && stops(axis, p))?;
    let ms = |at: Instant| at.since(since).as_secs_f64() * 1e3;
    // A query was in flight at that time: the wire was free after its reply and a pause.
    let before = passed[..sent].iter().rposition(|p| p.to_drive && p.at < since);
    let free = before.map_or(since, |question| {
        let answer = passed[question..sent].iter().find(|p| !p.to_drive);
        answer.map_or(since, |answer| answer.at + Duration::from_secs_f64(PAUSE_MS[axis] / 1e3))
    });
    let took = ms(passed[sent].at);
    Some((took, took - ms(free.max(since))))
}

/// Sends a message repeatedly, and measures its time on the wire from the instant that the closure returns.
fn measure(
    bench: &Bench,
    live: &mut Live,
    axis: usize,
    (count, own_before): (usize, usize),
    mut say: impl FnMut(&mut Live) -> Instant,
) -> [Times; 2] {
    let (mut took, mut more) = (Vec::new(), Vec::new());
    // Thrown out: it would wait for the drive before it in the list.
    let mut random = 1_u64;
    for _ in 0..2 * count {
        if took.len() == count {
            break;
        }
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        std::thread::sleep(Duration::from_micros(1000 + (random >> 48) / 4));
        if own_before > 0 {
            // A burst, and not a flood without end, which waits in its own socket.
            std::thread::sleep(Duration::from_millis(150));
        }
        // The last exchange before it may be needed.
        let mut passed = bench.logs[axis].drain();
        passed.drain(..passed.len().saturating_sub(4));
        // They stay in a buffer until the next message is sent.
        for client_ms in 0..own_before {
            live.write(&json!({ "type": "ping", "client_ms": client_ms }));
        }
        let since = say(live);
        passed.extend(bench.logs[axis].drain());
        // A command that came too late for its lease is not.
        let Some((on_wire, later)) = on_wire(axis, since, &passed) else { continue };
        took.push(on_wire);
        more.push(later);
    }
    assert_eq!(took.len(), count, "the others are not on the wire");
    [Times::new(took), Times::new(more)]
}

fn stop(axis: usize) -> impl FnMut(&mut Live) -> Instant {
    move |live| {
        let since = clock::now();
        live.send(&json!({ "type": "stop", "axes": [axis], "reason": "measured" }));
        live.until("stopped", |value| {
            value["axes"][0]["id"] == axis && value["axes"][0]["class"] == "standing"
        });
        since
    }
}

/// A command. Its lease is acquired first: after a suspension of the machine that is longer than a
/// lease the old one is over.
fn command(live: &mut Live) -> Instant {
    live.lease(0, "take");
    let since = clock::now();
    let outcome = live.command(0, "stop", None);
    let code = outcome["error"]["code"].as_str().unwrap_or_default();
    let slow = ["gateway.lease", "gateway.expired"].contains(&code);
    assert!(outcome["outcome"] == "done" || slow, "{outcome}");
    since
}

#[test]
#[ignore = "it needs a machine that does nothing else: `make soak`"]
fn commands_and_stops_are_soon_on_the_wire_whatever_else_goes_on() {
    let commands = env_count("POLEPAIR_LOAD_COMMANDS", 10);
    let stops = env_count("POLEPAIR_LOAD_STOPS", 10);
    let (viewers, idle) =
        (env_count("POLEPAIR_LOAD_VIEWERS", 20), env_count("POLEPAIR_LOAD_IDLE", 100));
    let _ = polepair_link::raise_file_limit();
    for run in 0..env_count("POLEPAIR_LOAD_RUNS", 1) {
        let bench = Bench::new();
        let mut live = bench.site.live();
        let mut beside = Beside::new();
        let floor = Floor::new();
        println!("run {run}");
        let [took, _] = measure(&bench, &mut live, 0, (commands, 0), command);
        println!("command, alone: {took}; a sleeper {}", floor.take_times());
        drop(live);
        beside.viewers(&bench.site, viewers);
        // What reads nothing for five seconds is closed: who measures comes when all others are there.
        let mut live = bench.site.live();
        floor.take_times();
        let [took, _] = measure(&bench, &mut live, 0, (commands, 0), command);
        println!("command, {viewers} viewers: {took}; a sleeper {}", floor.take_times());
        let measure_stops = |live: &mut Live, what: &str| {
            for (axis, own) in [(0, 0), (1, 0), (0, OWN_BEFORE)] {
                let count = if own == 0 { stops } else { stops / 10 };
                let [took, more] = measure(&bench, live, axis, (count, own), stop(axis));
                let behind = if own == 0 { "" } else { " behind its sender's own messages" };
                println!("stop of axis {axis}{behind}, {what}: {took}");
                println!("    beyond the wire {more}; a sleeper {}", floor.take_times());
            }
        };
        measure_stops(&mut live, &format!("{viewers} viewers"));
        drop((beside, live));
        let mut beside = Beside::new();
        let before = bench.site.memory_kb("VmRSS");
        beside.idle(&bench.site, idle);
        println!("{idle} idle sockets: {before} kB, then {} kB", bench.site.memory_kb("VmRSS"));
        beside.flood(&bench.site);
        let mut live = bench.site.live();
        floor.take_times();
        measure_stops(&mut live, &format!("{idle} idle, a flood"));
        println!("{} kB at most", bench.site.memory_kb("VmHWM"));
        drop(beside);
    }
}
