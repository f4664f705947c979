//! Cost of a message on the wire's side: encode a request, decode its reply.
//!
//! Targets (SPEED-6): Modbus RTU, ten registers, at most 22 ns; TMCL at most 10 ns; TML on a
//! serial line at most 20 ns each way, on CAN at most 8 ns; CANopen's service data at most 6 ns (with
//! its session: bench `nodes`), process data at most 4 ns.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use polepair_core::proto::canopen::pdo::{MappingEntry, PdoMapping};
use polepair_core::proto::canopen::sdo::{self, ObjectIndex};
use polepair_core::proto::modbus::wire::{ReplyPdu, RequestPdu, Space};
use polepair_core::proto::modbus::{rtu, wire};
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::{Reply, Request};
use polepair_core::proto::tml::serial::{self, Deframer, RecoveryPolicy};
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::proto::tml::{technocan, tmlcan};

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
            let (unit, pdu) = rtu::decode(black_box(reply)).unwrap();
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

/// The frames of a read: GiveMeData with a 32-bit TakeData, which is the longest but for PVTP.
fn tml(c: &mut Criterion) {
    let request =
        Message { to: IdCode::axis(5), instruction: Instruction::of(0xB005, [0x0030, 0x0228]) };
    let answer = Message {
        to: IdCode::axis(3),
        instruction: Instruction::of(0xB405, [0x0050, 0x0228, 0x5678, 0x1234]),
    };
    let mut frame = [0; serial::FRAME_MAX];
    let len = serial::encode(&answer, &mut frame);
    let frame = &frame[..len];
    let mut out = [0; serial::FRAME_MAX];
    c.bench_function("tml: encode request", |b| {
        b.iter(|| serial::encode(black_box(&request), black_box(&mut out)));
    });
    c.bench_function("tml: decode reply", |b| b.iter(|| serial::decode(black_box(frame))));
    let mut deframer = Deframer::new(RecoveryPolicy::Search);
    c.bench_function("tml: deframe reply, byte by byte", |b| {
        b.iter(|| {
            let mut found = None;
            for byte in black_box(frame) {
                deframer.push(*byte);
                found = deframer.next_piece();
            }
            found
        });
    });
    let long = tmlcan::encode(&answer);
    c.bench_function("tmlcan: encode request", |b| {
        b.iter(|| tmlcan::encode(black_box(&request)));
    });
    c.bench_function("tmlcan: decode reply", |b| b.iter(|| tmlcan::decode(black_box(&long))));
    let short = technocan::encode(&answer).expect("TakeData fits");
    c.bench_function("technocan: encode request", |b| {
        b.iter(|| technocan::encode(black_box(&request)));
    });
    c.bench_function("technocan: decode reply", |b| {
        b.iter(|| technocan::decode(black_box(&short)));
    });
    let point = Message {
        to: IdCode::axis(5),
        instruction: Instruction::of(0x1805, [0xFC18, 0xFF00, 0xFFF6, 0x01F4]),
    };
    let packed = technocan::encode(&point).expect("PVTP has a class of its own");
    c.bench_function("technocan: encode PVT point", |b| {
        b.iter(|| technocan::encode(black_box(&point)));
    });
    c.bench_function("technocan: decode PVT point", |b| {
        b.iter(|| technocan::decode(black_box(&packed)));
    });
}

/// A read of four bytes, and process data.
fn canopen(c: &mut Criterion) {
    let reply = [0x43, 0x64, 0x60, 0, 0x15, 0xCD, 0x5B, 7];
    c.bench_function("canopen: encode request, decode reply", |b| {
        b.iter(|| {
            black_box(sdo::SdoRequest::Read(black_box(ObjectIndex::new(0x6064, 0))).bytes());
            black_box(sdo::SdoReply::of(black_box(reply)))
        });
    });
    let map: PdoMapping =
        PdoMapping::new([0x6041_0010, 0x6064_0020, 0x6077_0010].map(MappingEntry::from))
            .expect("64 bits");
    let data = u64::from_le_bytes([0x37, 6, 1, 2, 3, 4, 0xFE, 0xFF]);
    c.bench_function("canopen: unpack three values", |b| {
        b.iter(|| {
            let data = black_box(data);
            black_box(&map).fields().fold(0, |sum, (_, field)| sum + field.signed(data))
        });
    });
}

criterion_group!(benches, modbus, tmcl, tml, canopen);
criterion_main!(benches);
