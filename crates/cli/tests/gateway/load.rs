//! How soon commands and stops are on the wire while many watch, sockets idle and somebody floods.
//!
//! A few seconds unless told otherwise: `POLEPAIR_LOAD_STOPS`, `POLEPAIR_LOAD_COMMANDS`,
//! `POLEPAIR_LOAD_IDLE`, `POLEPAIR_LOAD_VIEWERS` and `POLEPAIR_LOAD_RUNS` say how many. Times are
//! printed and not judged: they are the machine's as much as ours.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::{clock, tcp::TcpServer};
use serde_json::json;

use crate::site::{Folder, Live, Site};
use crate::wire::{Drive, Log, Passed};

/// What an idle viewer says so that it is not taken for one that is gone: an empty pong.
const PONG: [u8; 6] = [0x8A, 0x80, 0, 0, 0, 0];
/// Between two pongs, and between two looks at idle sockets.
const PULSE: Duration = Duration::from_secs(1);
/// How often viewers take what came: they share this machine's processors with the server.
const READ_EVERY: Duration = Duration::from_millis(20);

fn told(name: &str, usual: usize) -> usize {
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

    /// Reads all that comes, and looks at nothing; says now and then that it is there.
    fn drain(&mut self, mut streams: Vec<TcpStream>) {
        streams.iter().for_each(|stream| stream.set_nonblocking(true).unwrap());
        self.go_on(move |over| {
            let (mut buffer, mut said) = (vec![0; 1 << 16], clock::now());
            while !over.load(Ordering::Relaxed) {
                for stream in &mut streams {
                    while stream.read(&mut buffer).is_ok_and(|count| count > 0) {}
                }
                if clock::now().since(said) > PULSE {
                    said = clock::now();
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
            live.tell(&json!({ "type": "subscribe", "channel": 1, "axis": axis,
                "signal": "velocity", "hz": 50 }));
            live.tell(&json!({ "type": "frames", "on": true }));
            live.next("frames");
            streams.push(live.socket.get_ref().try_clone().unwrap());
        }
        self.drain(streams);
    }

    /// Sockets that say nothing, opened again when they are closed.
    fn idle(&mut self, site: &Site, count: usize) {
        let address = site.address;
        let open = move || {
            let stream = TcpStream::connect(address).ok()?;
            stream.set_nonblocking(true).ok()?;
            Some(stream)
        };
        let mut sockets: Vec<Option<TcpStream>> = (0..count).map(|_| open()).collect();
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

    /// One who asks without end, and hears the answers.
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

/// Milliseconds, in order.
struct Times(Vec<f64>);

impl Times {
    fn new(mut all: Vec<f64>) -> Self {
        all.sort_by(f64::total_cmp);
        Self(all)
    }

    fn at(&self, share: f64) -> f64 {
        let last = self.0.len() - 1;
        self.0[((last as f64 * share).ceil() as usize).min(last)]
    }
}

impl std::fmt::Display for Times {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [half, most, nearly, worst] = [0.5, 0.99, 0.999, 1.0].map(|share| self.at(share));
        write!(f, "p50 {half:.2}, p99 {most:.2}, p99.9 {nearly:.2}, worst {worst:.2} ms")?;
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

/// Whether a request stops the motor: TMCL's MST, or the first write.
fn stops(axis: usize, passed: &Passed) -> bool {
    passed.is(if axis == 0 { &[3] } else { &[6, 16] })
}

/// When a stop that was said at `since` was on the wire, and how much later that is than it could have
/// been for what passed before, ms.
fn on_wire(axis: usize, since: Instant, passed: &[Passed]) -> Option<(f64, f64)> {
    let sent = passed.iter().position(|p| p.at >= since && stops(axis, p))?;
    let ms = |at: Instant| at.since(since).as_secs_f64() * 1e3;
    // A question was on its way when it was said: the wire was free after its answer and a pause.
    let before = passed[..sent].iter().rposition(|p| p.to_drive && p.at < since);
    let free = before.map_or(since, |question| {
        let answer = passed[question..sent].iter().find(|p| !p.to_drive);
        answer.map_or(since, |answer| answer.at + Duration::from_secs_f64(PAUSE_MS[axis] / 1e3))
    });
    let took = ms(passed[sent].at);
    Some((took, took - ms(free.max(since))))
}

/// Says something over and over, and tells when it was on the wire.
fn measure(
    bench: &Bench,
    live: &mut Live,
    axis: usize,
    count: usize,
    mut say: impl FnMut(&mut Live),
) -> [Times; 2] {
    let (mut took, mut more) = (Vec::new(), Vec::new());
    // Thrown out: it would wait for the drive before it in the list.
    let mut random = 1_u64;
    while took.len() < count {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        std::thread::sleep(Duration::from_micros(1000 + (random >> 48) / 4));
        // The last exchange before it may be needed.
        let mut passed = bench.logs[axis].take();
        passed.drain(..passed.len().saturating_sub(4));
        let since = clock::now();
        say(live);
        passed.extend(bench.logs[axis].take());
        let (on_wire, later) = on_wire(axis, since, &passed).expect("it is on the wire");
        took.push(on_wire);
        more.push(later);
    }
    [Times::new(took), Times::new(more)]
}

fn stop(axis: usize) -> impl FnMut(&mut Live) {
    move |live| {
        live.tell(&json!({ "type": "stop", "axes": [axis], "reason": "measured" }));
        live.until("stopped", |told| {
            told["axes"][0]["id"] == axis && told["axes"][0]["class"] == "standing"
        });
    }
}

#[test]
fn commands_and_stops_are_soon_on_the_wire_whatever_else_goes_on() {
    let commands = told("POLEPAIR_LOAD_COMMANDS", 100);
    let stops = told("POLEPAIR_LOAD_STOPS", 100);
    let (viewers, idle) = (told("POLEPAIR_LOAD_VIEWERS", 100), told("POLEPAIR_LOAD_IDLE", 1000));
    for run in 0..told("POLEPAIR_LOAD_RUNS", 1) {
        let bench = Bench::new();
        let mut live = bench.site.live();
        let mut beside = Beside::new();
        println!("run {run}");
        let command = |live: &mut Live| {
            let outcome = live.command(0, "stop", None);
            assert_eq!(outcome["outcome"], "done", "{outcome}");
            live.lease(0, "renew");
        };
        live.lease(0, "take");
        let [took, _] = measure(&bench, &mut live, 0, commands, command);
        println!("command, alone: {took}");
        beside.viewers(&bench.site, viewers);
        live.lease(0, "take");
        let [took, _] = measure(&bench, &mut live, 0, commands, command);
        println!("command, {viewers} viewers: {took}");
        for axis in 0..2 {
            let [took, more] = measure(&bench, &mut live, axis, stops, stop(axis));
            println!("stop of axis {axis}, {viewers} viewers: {took}; beyond the wire {more}");
        }
        drop(beside);
        let mut beside = Beside::new();
        let before = bench.site.memory_kb("VmRSS");
        beside.idle(&bench.site, idle);
        println!("{idle} idle sockets: {before} kB, then {} kB", bench.site.memory_kb("VmRSS"));
        beside.flood(&bench.site);
        for axis in 0..2 {
            let [took, more] = measure(&bench, &mut live, axis, stops, stop(axis));
            println!("stop of axis {axis}, {idle} idle, a flood: {took}; beyond the wire {more}");
        }
        println!("{} kB at most", bench.site.memory_kb("VmHWM"));
        drop(beside);
    }
}
