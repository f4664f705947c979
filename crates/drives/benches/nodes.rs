//! CANopen where it is many or often: an exchange of service data at either end, and a thousand
//! drives on a bus.
//!
//! Each figure is the best of many short runs in a bare loop, because on a busy machine the least
//! disturbed run is the one that repeats. `cargo bench --bench nodes -- NAME ROUNDS` makes this number of
//! rounds of one case and measures nothing: run twice under `valgrind --tool=callgrind`, the
//! difference is the instructions of a round.

use std::hint::black_box;
use std::time::{Duration, Instant as Wall};

use polepair_core::medium::{Can, Frame};
use polepair_core::proto::HostOptions;
use polepair_core::proto::canopen::od::ObjectEntry;
use polepair_core::proto::canopen::sdo::{ExpeditedData, ObjectIndex, SdoReply, SdoRequest};
use polepair_core::proto::canopen::{self, HostRequest};
use polepair_core::station::{Host as _, Station, Ticket};
use polepair_core::time::Instant;
use polepair_drives::cia402::device::Device;
use polepair_drives::cia402::drive::Drive;
use polepair_drives::cia402::{self, faults::FaultCode};
use polepair_drives::syntron_ts::SyntronTs;
use polepair_drives::{DeviceOptions, Family};

const NODE: u8 = 5;
const POSITION: ObjectIndex = ObjectIndex::new(0x6064, 0);
/// Time for which each case is measured.
const SPAN: Duration = Duration::from_secs(2);
/// Rounds of a short run.
const ROUNDS: u64 = 5000;

/// Arguments of the command line: one case, and its number of rounds.
struct Arguments {
    name: Option<String>,
    rounds: Option<u64>,
}

impl Arguments {
    fn parse() -> Self {
        let mut words = std::env::args().skip(1).filter(|word| !word.starts_with("--"));
        let name = words.next();
        Self { name, rounds: words.next().and_then(|word| word.parse().ok()) }
    }

    /// Runs this many rounds at a time and prints the best.
    fn case(&self, name: &str, rounds: u64, mut run: impl FnMut(u64)) {
        if self.name.as_ref().is_some_and(|wanted| wanted != name) {
            return;
        }
        if let Some(rounds) = self.rounds {
            return run(rounds);
        }
        let (mut best, started_at, mut runs) = (Duration::MAX, Wall::now(), 0);
        while started_at.elapsed() < SPAN {
            let start = Wall::now();
            run(rounds);
            best = best.min(start.elapsed());
            runs += 1;
        }
        println!("{name:16} {:7.1} ns, best of {runs}", best.as_nanos() as f64 / rounds as f64);
    }
}

/// A read through the client's session: request made and sent, and the reply taken as an event.
fn client(arguments: &Arguments) {
    let mut host = canopen::CanHost::new(&HostOptions::new(0));
    let host_request = HostRequest::Read { node: NODE, object: POSITION };
    let reply = Frame::standard(0x585, &[0x43, 0x64, 0x60, 0, 0x15, 0xCD, 0x5B, 7]);
    let (mut out, mut now) = (Frame::default(), Instant::ZERO);
    arguments.case("client", ROUNDS, |rounds| {
        for _ in 0..rounds {
            now = now.plus_ms(1);
            host.submit(now, Ticket(1), black_box(host_request)).unwrap();
            black_box(host.poll_transmit(now, &mut out));
            host.handle_input(now, black_box(&reply));
            assert!(black_box(host.poll_event()).is_some());
        }
    });
}

/// Reads of `objects` in turn, answered by a whole simulated drive.
fn server(
    arguments: &Arguments,
    name: &str,
    device: &mut impl Station<Can>,
    objects: &[ObjectIndex],
) {
    let mut out = Frame::default();
    while device.poll_transmit(Instant::ZERO, &mut out).is_some() {}
    let requests: Vec<Frame> = objects.iter().map(|o| SdoRequest::Read(*o).emit(NODE)).collect();
    let mut turn = requests.iter().cycle();
    arguments.case(name, ROUNDS, |rounds| {
        for request in turn.by_ref().take(rounds as usize) {
            device.handle_input(Instant::ZERO, black_box(request));
            device.poll_transmit(Instant::ZERO, &mut out).expect("a reply");
            black_box(&out);
        }
    });
}

fn servers(arguments: &Arguments) {
    let short = |entry: &&ObjectEntry| entry.kind.bytes().is_some_and(|bytes| bytes <= 4);
    let object = |entry: &ObjectEntry| ObjectIndex::new(entry.index(), entry.sub());
    let all = cia402::objects::DICTIONARY.entries().iter();
    let all: Vec<_> = all.filter(|e| e.access.is_readable() && e.index() != 0x1003).collect();
    let all: Vec<_> = all.into_iter().filter(short).map(object).collect();
    server(arguments, "server-234", &mut node(), &[POSITION]);
    server(arguments, "server-234-turns", &mut node(), &all);
    let options = DeviceOptions {
        address: Some(NODE.into()),
        wires: &["canopen"],
        standard: None,
        untimed: true,
        seed: 0,
        extra: &[("fn00", "20")],
    };
    let make =
        || SyntronTs::create_device(SyntronTs::profiles()[0], &options).expect("it is known");
    // 768 and 331 have no common divisor.
    let registers: Vec<_> =
        (0..768_u32).map(|n| ObjectIndex::new(0x2000 + (n * 331 % 768) as u16, 0)).collect();
    server(arguments, "server-980", &mut make(), &[POSITION]);
    server(arguments, "server-980-turns", &mut make(), &registers);
}

fn write(device: &mut impl Station<Can>, index: u16, sub: u8, value: u32, len: u8) {
    let request =
        SdoRequest::Write(ObjectIndex::new(index, sub), ExpeditedData { bits: value, len });
    device.handle_input(Instant::ZERO, &request.emit(NODE));
    let mut out = Frame::default();
    let mut written = false;
    while device.poll_transmit(Instant::ZERO, &mut out).is_some() {
        written |= matches!(SdoReply::of(out.data), SdoReply::Written(..));
    }
    assert!(written, "{index:04X}:{sub}");
}

/// A node in cyclic synchronous position mode, powered: RPDO3 is controlword and target, TPDO3 statusword
/// and position with each SYNC.
fn node() -> Device {
    let mut device = Device::new(Drive::new(NODE, 1, 1_000_000));
    let mut out = Frame::default();
    while device.poll_transmit(Instant::ZERO, &mut out).is_some() {}
    write(&mut device, 0x1802, 2, 1, 1);
    write(&mut device, 0x1800, 1, 1 << 31 | 0x185, 4);
    write(&mut device, 0x1802, 1, 0x385, 4);
    write(&mut device, 0x1402, 1, 0x405, 4);
    write(&mut device, 0x6060, 0, 8, 1);
    for word in [6, 7, 15] {
        write(&mut device, 0x6040, 0, word, 2);
    }
    device.handle_input(Instant::ZERO, &Frame::standard(0, &[1, NODE]));
    device
}

/// A millisecond of the bus. Returns how many PDOs the nodes sent.
fn tick(nodes: &mut [Device], now: Instant, target: i32) -> u64 {
    let sync = Frame::standard(0x80, &[]);
    let [a, b, c, d] = target.to_le_bytes();
    let point = Frame::standard(0x405, &[15, 0, a, b, c, d]);
    let (mut out, mut sent) = (Frame::default(), 0);
    for node in nodes {
        node.handle_input(now, black_box(&point));
        node.handle_input(now, black_box(&sync));
        while node.poll_transmit(now, &mut out).is_some() {
            black_box(&out);
            sent += 1;
        }
    }
    sent
}

/// Drives on their way back and forth, four turns each way, at up to 360 rpm: a set-point and SYNC in,
/// statusword and position out, a tick of loops and motor, for each node and millisecond.
fn nodes(arguments: &Arguments, name: &str, count: usize) {
    let mut nodes: Vec<Device> = (0..count).map(|_| node()).collect();
    let locate = |n: u32| 40_000.0 * (f64::from(n) / 4096.0 * std::f64::consts::TAU).sin();
    let way: Vec<i32> = (0..4096).map(|n| locate(n) as i32).collect();
    let (mut now, mut turn) = (Instant(1_000_000), way.iter().cycle());
    arguments.case(name, (count as u64).max(1000), |rounds| {
        for target in turn.by_ref().take(rounds as usize / count) {
            now = now.plus_ms(1);
            assert_eq!(tick(&mut nodes, now, *target), count as u64);
        }
    });
    let well = |node: &Device| node.drive().fault() == FaultCode::NONE;
    assert!(nodes.iter().all(|node| well(node) && node.drive().shaft().is_powered()));
}

fn main() {
    let arguments = Arguments::parse();
    client(&arguments);
    servers(&arguments);
    nodes(&arguments, "nodes-1", 1);
    nodes(&arguments, "nodes-1000", 1000);
    println!("a node has {} bytes", size_of::<Device>());
}
