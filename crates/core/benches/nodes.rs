//! A thousand CANopen drives on a bus, each a station of its own with its whole dictionary and its
//! motor: SYNC and a set-point in, statusword and position out, a tick of the plant, all per node
//! and millisecond. And one exchange with an SDO server, from a small dictionary and a large one.

use std::hint::black_box;
use std::time::{Duration, Instant as Wall};

use criterion::{Criterion, criterion_group, criterion_main};
use polepair_core::drives::cia402::device::Device;
use polepair_core::drives::cia402::drive::Drive;
use polepair_core::drives::syntron_ts::SyntronTs;
use polepair_core::drives::{DeviceOptions, Family};
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::canopen::sdo::{Object, Reply, Request, Short};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;

const NODES: usize = 1000;
const NODE: u8 = 5;

fn write(device: &mut impl Station<Can>, index: u16, sub: u8, value: u32, len: u8) {
    let request = Request::Write(Object::new(index, sub), Short { bits: value, len });
    device.handle_input(Instant::ZERO, &request.emit(NODE));
    let mut out = Frame::default();
    let mut written = false;
    while device.poll_transmit(Instant::ZERO, &mut out).is_some() {
        written |= matches!(Reply::of(out.data), Reply::Written(..));
    }
    assert!(written, "{index:04X}:{sub}");
}

/// In cyclic synchronous position mode, powered: RPDO3 is controlword and target, TPDO3 statusword
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

fn tick(nodes: &mut [Device], now: Instant, target: i32) -> u64 {
    let sync = Frame::standard(0x80, &[]);
    let [a, b, c, d] = target.to_le_bytes();
    let point = Frame::standard(0x405, &[15, 0, a, b, c, d]);
    let (mut out, mut sent) = (Frame::default(), 0);
    for node in nodes {
        node.handle_input(now, &point);
        node.handle_input(now, &sync);
        while node.poll_transmit(now, &mut out).is_some() {
            sent += u64::from(out.data[2]) + 1;
        }
    }
    sent
}

fn cycle(c: &mut Criterion) {
    let mut nodes: Vec<Device> = (0..NODES).map(|_| node()).collect();
    let (mut now, mut n) = (Instant(1_000_000), 0_i32);
    c.bench_function("a node and tick of 1000", |b| {
        b.iter_custom(|rounds| {
            let begun = Wall::now();
            for _ in 0..rounds.div_ceil(NODES as u64) {
                (now, n) = (now.plus_ms(1), n + 1);
                black_box(tick(&mut nodes, now, n % 100_000));
            }
            let ticks = rounds.div_ceil(NODES as u64) * NODES as u64;
            let scaled = begun.elapsed().as_nanos() * u128::from(rounds) / u128::from(ticks);
            Duration::from_nanos(scaled as u64)
        });
    });
    println!("bytes of a node: {}", size_of::<Device>());
}

fn exchange(c: &mut Criterion, name: &str, device: &mut impl Station<Can>, objects: &[Object]) {
    let mut out = Frame::default();
    while device.poll_transmit(Instant::ZERO, &mut out).is_some() {}
    let requests: Vec<Frame> = objects.iter().map(|o| Request::Read(*o).emit(NODE)).collect();
    let mut at = 0;
    c.bench_function(name, |b| {
        b.iter(|| {
            at = (at + 1) % requests.len();
            device.handle_input(Instant::ZERO, black_box(&requests[at]));
            device.poll_transmit(Instant::ZERO, &mut out);
            black_box(out.data[4])
        });
    });
}

fn server(c: &mut Criterion) {
    let position = [Object::new(0x6064, 0)];
    exchange(c, "SDO server, 234 entries", &mut node(), &position);
    let options = DeviceOptions {
        address: Some(NODE.into()),
        wires: &["canopen"],
        standard: None,
        untimed: true,
        seed: 0,
        extra: &[],
    };
    let make = || SyntronTs::device(SyntronTs::profiles()[0], &options).expect("it is known");
    exchange(c, "SDO server, 980 entries", &mut make(), &position);
    let many: Vec<_> = (0..997).map(|n| Object::new(0x2000 + n * 331 % 0x300, 0)).collect();
    exchange(c, "SDO server, 980 entries in turn", &mut make(), &many);
    make().handle_timeout(Instant::ZERO);
}

criterion_group!(benches, cycle, server);
criterion_main!(benches);
