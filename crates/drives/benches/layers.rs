//! Cost of the erased layers on top of a codec: submit a read through `dyn`, take its outcome.
//!
//! Target (SPEED-6): at most 25 ns more than encoding the request and decoding the reply.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use polepair_core::axis::{AnyLane, RequestEncoder};
use polepair_core::lane::Lane;
use polepair_core::medium::Stream;
use polepair_core::profile::ParameterId;
use polepair_core::proto::modbus::wire::{ReplyPdu, Space};
use polepair_core::proto::modbus::{Rtu, rtu};
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::{Reply, Request};
use polepair_core::proto::tmcl::{Tmcl, TmclDriver};
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, Host, Station, Ticket};
use polepair_core::time::Instant;
use polepair_drives::syntron_ts::profile::SYNTRON_TS;

const OPTIONS: HostOptions = HostOptions { gap_us: Some(0), ..HostOptions::new(0) };
const REPLY: Reply =
    Reply { host: 2, module: 1, status: Status::Ok, opcode: Opcode::Gap, value: 123_456 };

fn codec(c: &mut Criterion) {
    let reply = REPLY.emit();
    c.bench_function("codec alone", |b| {
        b.iter(|| {
            let (address, opcode) = (black_box(1), Opcode::Gap);
            let request = Request { address, opcode, kind: 1, motor: 0, value: 0 };
            black_box(request.emit());
            black_box(Reply::parse(black_box(&reply)).unwrap())
        });
    });
}

fn host(c: &mut Criterion) {
    let reply = REPLY.emit();
    let mut host = Tmcl::create_host(&OPTIONS, &[1]);
    let profile = Tmcl::generic_profile();
    let driver = TmclDriver::new(profile, 1);
    let request = driver.read_request(&profile.parameters[1]).unwrap();
    let (mut out, mut now) = ([0; 520], 0);
    c.bench_function("submit to event, host alone", |b| {
        b.iter(|| {
            now += 1_000_000;
            let now = Instant(now);
            host.submit(now, Ticket(1), black_box(request)).unwrap();
            black_box(host.poll_transmit(now, &mut out));
            host.handle_input(now, black_box(&reply));
            assert!(black_box(host.poll_event()).is_some());
        });
    });
}

fn lanes(c: &mut Criterion) {
    let driver = Box::new(Tmcl::create_driver(Tmcl::generic_profile(), 1));
    let lane = Lane::new(Tmcl::create_host(&OPTIONS, &[1]), [driver as Box<_>]);
    lane_of(c, "submit to outcome, through the erased lane", Box::new(lane), &REPLY.emit());
    let driver = Box::new(Rtu::create_driver(&SYNTRON_TS, 1));
    let lane = Lane::new(Rtu::create_host(&OPTIONS, &[1]), [driver as Box<_>]);
    let mut reply = [0; 16];
    let answer = ReplyPdu::Read { space: Space::Holding, data: &[0x12, 0x34] };
    let len = rtu::emit(1, &mut reply, |out| answer.emit(out));
    lane_of(c, "the same, Modbus RTU", Box::new(lane), &reply[..len]);
}

fn lane_of(c: &mut Criterion, name: &str, mut lane: Box<dyn AnyLane<Stream>>, reply: &[u8]) {
    let (mut out, mut now) = ([0; 520], 0);
    c.bench_function(name, |b| {
        b.iter(|| {
            now += 1_000_000;
            let now = Instant(now);
            lane.read_parameter(now, Ticket(7), AxisIndex(0), black_box(ParameterId(1))).unwrap();
            black_box(lane.poll_transmit(now, &mut out));
            lane.handle_input(now, black_box(reply));
            black_box(lane.poll_outcome().unwrap())
        });
    });
}

criterion_group!(benches, codec, host, lanes);
criterion_main!(benches);
