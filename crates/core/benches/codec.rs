//! What a message costs on the wire's side: encode a request, decode its reply.
//!
//! Targets (DESIGN.md, Speed): Modbus RTU, ten registers, at most 22 ns; TMCL at most 10 ns.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use polepair_core::proto::modbus::wire::{ReplyPdu, RequestPdu, Space};
use polepair_core::proto::modbus::{rtu, wire};
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::{Reply, Request};

fn modbus(c: &mut Criterion) {
    let mut reply = [0; 64];
    let mut payload = [0; 20];
    for (n, pair) in payload.chunks_exact_mut(2).enumerate() {
        pair.copy_from_slice(&(0x1234 * (n as u16 + 1)).to_be_bytes());
    }
    let answer = ReplyPdu::Read { space: Space::Holding, data: &payload };
    let len = rtu::emit(1, &mut reply, |out| answer.emit(out));
    let reply = &reply[..len];
    let mut out = [0; 256];
    let mut words = [0u16; 16];
    c.bench_function("modbus-rtu: encode request, decode reply, 10 registers", |b| {
        b.iter(|| {
            let request =
                RequestPdu::Read { space: Space::Holding, start: black_box(0x100), count: 10 };
            let len = rtu::emit_request(black_box(1), &request, &mut out);
            black_box(&out[..len]);
            let (unit, pdu) = rtu::open(black_box(reply)).unwrap();
            let ReplyPdu::Read { data, .. } = ReplyPdu::parse(pdu).unwrap() else { panic!() };
            for (word, value) in words.iter_mut().zip(wire::words(data)) {
                *word = value;
            }
            black_box((unit, &words));
        });
    });
}

fn tmcl(c: &mut Criterion) {
    let reply =
        Reply { host: 2, module: 1, status: Status::Ok, opcode: Opcode::Gap, value: 123_456 };
    let reply = reply.emit();
    c.bench_function("tmcl: encode request, decode reply", |b| {
        b.iter(|| {
            let request = Request {
                address: black_box(1),
                opcode: Opcode::Gap,
                kind: 1,
                motor: 0,
                value: black_box(0),
            };
            black_box(request.emit());
            black_box(Reply::parse(black_box(&reply)).unwrap())
        });
    });
}

criterion_group!(benches, modbus, tmcl);
criterion_main!(benches);
