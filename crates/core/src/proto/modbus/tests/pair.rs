//! Host and device on one wire, with and without faults.

extern crate std;

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use super::world::{TestWorld, UNTIMED};
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::modbus::device::Framing;
use crate::proto::modbus::host_request::{HostRequest, RequestBody, WORDS_MAX};
use crate::proto::modbus::wire::{Function, Space, WireFormat};
use crate::station::{
    EventSubject, Host as _, LineEvent, RequestClass, Station as _, Ticket, Timed as _,
};

const MS: u64 = 1_000_000;

fn formats() -> [WireFormat; 2] {
    [WireFormat::Rtu, WireFormat::Ascii]
}

#[test]
fn every_function_round_trips() {
    for format in formats() {
        for piece in [1, 2, 3, 1000] {
            let mut world = TestWorld::plain(format);
            world.piece = piece;
            assert_eq!(world.read(3, 2).unwrap().words[..2], [771, 1028]);
            assert_eq!(world.write(5, 0xFF38).unwrap().words[0], 0xFF38);
            assert_eq!(world.drive.registers[&5], 0xFF38);
            let mut words = [0; WORDS_MAX];
            words[..3].copy_from_slice(&[7, 8, 9]);
            let request = RequestBody::WriteRegisters { start: 0x30, count: 3, words };
            assert_eq!(world.request(1, request, RequestClass::NoRetry).unwrap().count, 3);
            assert_eq!(world.drive.writes.last().unwrap(), &(0x30, vec![7, 8, 9]));
            let coil = RequestBody::WriteCoil { address: 3, on: true };
            assert_eq!(world.request(1, coil, RequestClass::ReadBack).unwrap().words[0], 1);
            let mut bits = [0; 32];
            bits[0] = 0b10;
            let coils = RequestBody::WriteCoils { start: 4, count: 2, bits };
            assert_eq!(world.request(1, coils, RequestClass::ReadBack).unwrap().count, 2);
            for space in [Space::Coil, Space::Discrete] {
                let read = RequestBody::Read { space, start: 0, count: 10 };
                let answer = world.request(1, read, RequestClass::Idempotent).unwrap();
                assert_eq!(answer.words[0], 0b10_1101);
                assert_eq!(answer.raw(), 0b10_1101);
            }
            let input = RequestBody::Read { space: Space::Input, start: 1, count: 4 };
            assert_eq!(
                world.request(1, input, RequestClass::Idempotent).unwrap().raw(),
                0x101_0202_0303_0404
            );
            let counters = world.host.counters();
            assert_eq!((counters.late, counters.foreign, counters.corrupt), (0, 0, 0));
        }
    }
}

#[test]
fn the_longest_frames_round_trip() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    let answer = world.read(0, 125).unwrap();
    assert_eq!(answer.count, 125);
    assert_eq!(world.host.payload().len(), 250);
    assert_eq!(world.host.payload()[248..], (124_u16 * 257).to_be_bytes());
}

#[test]
fn exceptions_are_the_drives_own_words() {
    for format in formats() {
        let mut world = TestWorld::plain(format);
        assert_eq!(world.read(0x4000, 1), Err(Failure::Refused { code: 2 }));
        assert_eq!(world.read(0, 0), Err(Failure::Refused { code: 3 }));
        assert_eq!(world.read(0, 126), Err(Failure::Refused { code: 3 }));
        assert_eq!(world.read(0xFFFF, 2), Err(Failure::Refused { code: 2 }));
        let max = if format == WireFormat::Ascii { 12 } else { 125 };
        assert!(world.read(0, max).is_ok());
        assert_eq!(world.read(0, max + 1), Err(Failure::Refused { code: 3 }));
    }
}

#[test]
fn a_read_of_one_output_brings_them_all() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    world.drive.whole_byte = true;
    let read = RequestBody::Read { space: Space::Coil, start: 0, count: 1 };
    let answer = world.request(1, read, RequestClass::Idempotent).unwrap();
    assert_eq!(answer.words[0], 0b0101);
}

#[test]
fn silence_alone_ends_a_frame_of_the_true_drive() {
    let options = HostOptions { baud: 115_200, ..UNTIMED };
    let mut world = TestWorld::new(WireFormat::Rtu, Framing::TS, &options);
    let before = world.now;
    assert_eq!(world.read(3, 1).unwrap().words[0], 771);
    assert!(world.now.since(before).as_nanos() > 10_000_000);
    assert_eq!(world.write(3, 1).unwrap().words[0], 1);

    let mut world = TestWorld::new(WireFormat::Rtu, Framing::TS, &options);
    let frame = [0x01, 0x06, 0x00, 0x33, 0x00, 0xC8, 0x78, 0x53];
    world.inject_to_drive(&frame);
    world.now = world.now.plus_ms(9);
    world.inject_to_drive(&frame);
    world.rest();
    assert_eq!(world.drive.writes.len(), 0, "two requests within 10 ms are one bad frame");
    assert_eq!(world.end.counters().corrupt, 1);
    world.inject_to_drive(&frame);
    world.rest();
    assert_eq!(world.drive.writes.len(), 1);
}

#[test]
fn a_broadcast_is_obeyed_in_silence_and_followed_by_a_pause() {
    for (format, framing, baud) in [
        (WireFormat::Rtu, Framing::TS, 115_200),
        (WireFormat::Rtu, Framing::Length, 0),
        (WireFormat::Ascii, Framing::Length, 9600),
    ] {
        let mut world = TestWorld::new(format, framing, &HostOptions { baud, ..UNTIMED });
        let request = RequestBody::WriteRegister { address: 7, value: 70 };
        world.request(0, request, RequestClass::NoRetry).unwrap();
        assert_eq!(world.read(7, 1).unwrap().words[0], 70, "{format:?} {framing:?} {baud}");
        assert_eq!(world.drive.writes.len(), 1);
        assert_eq!(world.replies, 1);
        assert_eq!(world.host.counters().resent, 0);
    }
}

/// Runs sixty reads of six registers and every tenth a write with a fault on reply `at`; never a
/// wrong value, nothing executed twice, at most one error.
fn single_fault(mut world: TestWorld, at: usize, (name, fault): Case) -> usize {
    world.fault = Box::new(move |n, bytes| if n == at { fault(bytes) } else { vec![(0, bytes)] });
    let mut errors = 0;
    for n in 0..60_u16 {
        let start = n % 6 * 3;
        match world.read(start, 2) {
            Ok(answer) => {
                assert_eq!(answer.words[0], start * 257, "{name}: wrong value as good, read {n}");
            }
            Err(_) => errors += 1,
        }
        if n % 10 == 3 {
            let writes = world.drive.writes.len();
            errors += usize::from(world.write(0x100, n).is_err());
            assert!(world.drive.writes.len() <= writes + 1, "{name}: executed twice");
        }
    }
    assert!(errors <= 1, "{name}: {errors} errors");
    errors
}

type Case = (&'static str, fn(Vec<u8>) -> Vec<(u64, Vec<u8>)>);

const CASES: [Case; 11] = [
    ("none", |bytes| vec![(0, bytes)]),
    ("late by 50 ms past the timeout", |bytes| vec![(150 * MS, bytes)]),
    ("late by 2 ms past the timeout", |bytes| vec![(102 * MS, bytes)]),
    ("late by 250 ms", |bytes| vec![(250 * MS, bytes)]),
    ("lost", |_| vec![]),
    ("noise byte before", |bytes| vec![(0, [vec![0x55], bytes].concat())]),
    ("noise that looks like a head", |bytes| vec![(0, [vec![0x01, 0x03, 0x40], bytes].concat())]),
    ("duplicated", |bytes| vec![(0, [bytes.clone(), bytes].concat())]),
    ("duplicated in two pieces", |bytes| vec![(0, bytes.clone()), (2000, bytes)]),
    ("flipped bit", |mut bytes| {
        bytes[4] ^= 0x10;
        vec![(0, bytes)]
    }),
    ("cut short", |bytes| vec![(0, bytes[..bytes.len() - 1].to_vec())]),
];

#[test]
fn one_fault_costs_at_most_one_error() {
    for format in formats() {
        for case in CASES {
            for (baud, at) in [(0, 5), (0, 6), (115_200, 5), (115_200, 6)] {
                let options = HostOptions { baud, ..UNTIMED };
                let world = TestWorld::new(format, Framing::Length, &options);
                single_fault(world, at, case);
                let world = TestWorld::new(format, Framing::TS, &options);
                single_fault(world, at, case);
            }
        }
    }
}

#[test]
fn a_read_survives_every_single_fault() {
    for case in CASES {
        assert_eq!(single_fault(TestWorld::plain(WireFormat::Rtu), 6, case), 0, "{}", case.0);
    }
}

#[test]
fn an_echo_is_never_the_reply() {
    for format in formats() {
        for (baud, known) in [(0, true), (0, false), (115_200, true), (115_200, false)] {
            let options = HostOptions { baud, echo: known, ..UNTIMED };
            let mut world = TestWorld::new(format, Framing::Length, &options);
            world.echo = true;
            for n in 0..20 {
                assert_eq!(world.read(n, 2).unwrap().words[0], n * 257, "{format:?} {baud}");
                assert_eq!(world.write(0x100 + n, n).unwrap().words[0], n);
            }
            assert!(world.host.counters().echoed >= 40, "{:?}", world.host.counters());
            // The drive is gone: its host receives only its own frames.
            world.drive.address = 99;
            let writes = world.drive.writes.len();
            assert_eq!(world.write(1, 1), Err(Failure::Silent), "{format:?} {baud} {known}");
            assert_eq!(world.read(1, 1), Err(Failure::Silent));
            assert_eq!(world.drive.writes.len(), writes);
        }
    }
}

#[test]
fn an_echo_behind_other_bytes_is_not_the_reply() {
    // Half a reply to the question before, or noise that looks like the echo's first byte.
    for (format, other) in [(WireFormat::Rtu, &b"\x01"[..]), (WireFormat::Ascii, b":0103020012E8")]
    {
        let options = HostOptions { baud: 115_200, echo: true, ..UNTIMED };
        let mut world = TestWorld::new(format, Framing::Length, &options);
        world.drive.address = 99;
        let query = RequestBody::WriteRegister { address: 0x209, value: 0 };
        let request =
            crate::proto::modbus::HostRequest { unit: 1, body: query, class: RequestClass::Stop };
        world.host.submit(world.now, crate::station::Ticket(1), request).unwrap();
        let mut out = [0; 520];
        let len = world.host.poll_transmit(world.now, &mut out).unwrap();
        world.host.handle_input(world.now.plus_ms(1), other);
        // Late enough to pass for the reply: an adapter kept it.
        world.host.handle_input(world.now.plus_ms(16), &out[..len]);
        assert_eq!(world.host.poll_event(), None, "{format:?}");
        assert_eq!(world.host.counters().echoed, 1);
    }
}

#[test]
fn a_reply_to_what_was_asked_before_a_cut_answers_nothing_after_it() {
    for format in formats() {
        let mut world = TestWorld::plain(format);
        world.fault = Box::new(|n, bytes| vec![(if n == 1 { 150 * MS } else { 0 }, bytes)]);
        let read = RequestBody::Read { space: Space::Holding, start: 3, count: 1 };
        let request = crate::proto::modbus::HostRequest {
            unit: 1,
            body: read,
            class: RequestClass::Idempotent,
        };
        let (ticket, start) = (crate::station::Ticket(90), world.now);
        world.host.submit(start, ticket, request).unwrap();
        while world.replies == 0 {
            world.step();
        }
        world.host.handle_line(world.now, LineEvent::Down);
        assert_eq!(world.host.poll_event().unwrap().1, Err(Failure::LinkDown));
        world.host.handle_line(world.now, LineEvent::Up);
        assert_eq!(world.read(5, 1).unwrap().words[0], 5 * 257, "{format:?}");
    }
}

#[test]
fn a_late_reply_prolongs_the_quarantine() {
    // The read's answer comes late, the probe's later still: it must not answer what is asked next.
    for format in formats() {
        let mut world = TestWorld::plain(format);
        let lateness = |n| [250 * MS, 400 * MS].get(n - 1).copied().unwrap_or(0);
        world.fault = Box::new(move |n, bytes| vec![(lateness(n), bytes)]);
        let before = world.now;
        assert_eq!(world.read(3, 1).unwrap().words[0], 771);
        let coil = RequestBody::Read { space: Space::Coil, start: 1, count: 1 };
        assert_eq!(
            world.request(1, coil, RequestClass::Idempotent).unwrap().words[0],
            0,
            "{format:?}"
        );
        assert!(world.now >= before.plus_ms(500), "asked before the probe was answered");
        assert_eq!(world.replies, 3);
    }
}

#[test]
fn a_stop_is_let_into_the_quarantine() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    world.fault = Box::new(|n, bytes| vec![(if n == 1 { 250 * MS } else { 0 }, bytes)]);
    let read = RequestBody::Read { space: Space::Holding, start: 3, count: 1 };
    let request = |query, class| crate::proto::modbus::HostRequest { unit: 1, body: query, class };
    world
        .host
        .submit(world.now, crate::station::Ticket(90), request(read, RequestClass::Idempotent))
        .unwrap();
    let start = world.now;
    let stop = request(RequestBody::WriteRegister { address: 0x38, value: 0 }, RequestClass::Stop);
    assert!(world.host.submit(start, crate::station::Ticket(91), stop).is_err(), "one in flight");
    while world.now < start.plus_ms(100) {
        world.step();
    }
    world.host.submit(world.now, crate::station::Ticket(91), stop).unwrap();
    let mut ended = Vec::new();
    for _ in 0..100 {
        while let Some((to, result)) = world.host.poll_event() {
            ended.push((*to, result.map(|answer| answer.words[0])));
        }
        world.step();
    }
    use crate::station::{EventSubject, Ticket};
    assert_eq!(ended[0], (EventSubject::Request(Ticket(90)), Err(Failure::Cancelled)));
    assert_eq!(ended[1], (EventSubject::Request(Ticket(91)), Ok(0)));
    assert_eq!(ended.len(), 2);
    assert_eq!(world.read(5, 1).unwrap().words[0], 5 * 257);
}

#[test]
fn only_what_is_harmless_is_sent_again() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    assert!(world.read(0, 1).is_ok());
    world.fault = Box::new(|_, _| vec![]);
    let before = world.host.counters();
    assert_eq!(world.write(0x10, 7), Err(Failure::Silent));
    assert_eq!(world.drive.writes.len(), 1, "executed once though three replies were lost");
    assert_eq!(world.host.counters().resent, before.resent);
}

#[test]
fn a_station_without_function_06_is_written_by_function_16() {
    for format in formats() {
        let mut world = TestWorld::plain(format);
        world.drive.lacks = Some(Function::WriteRegister);
        for value in [70, 71] {
            let request = RequestBody::WriteRegister { address: 7, value };
            world.request(1, request, RequestClass::NoRetry).unwrap();
        }
        assert_eq!(world.read(7, 1).unwrap().words[0], 71, "{format:?}");
        assert_eq!(world.drive.writes.len(), 2, "{format:?}: each once");
        let counters = world.host.counters();
        assert_eq!((counters.resent, counters.sent), (0, counters.answered), "{format:?}");
        // It may lack both.
        world.drive.lacks = Some(Function::WriteRegisters);
        let request = RequestBody::WriteRegister { address: 7, value: 1 };
        let refused = world.request(1, request, RequestClass::NoRetry);
        assert_eq!(refused, Err(Failure::Refused { code: 1 }), "{format:?}");
    }
}

/// The TS takes 10 ms of silence for the end of a frame, so a host waits that long before each.
#[test]
fn a_read_that_waits_for_silence_is_recalled_for_a_stop_and_one_on_the_wire_is_not() {
    let options = HostOptions { baud: 115_200, gap_us: Some(10_000), ..UNTIMED };
    let mut world = TestWorld::new(WireFormat::Rtu, Framing::TS, &options);
    assert_eq!(world.read(3, 1).unwrap().words[0], 771);
    let received_at = world.now;
    let read = RequestBody::Read { space: Space::Holding, start: 4, count: 1 };
    let read = HostRequest { unit: 1, body: read, class: RequestClass::Idempotent };
    let write = RequestBody::WriteRegister { address: 5, value: 0 };
    let stop = HostRequest { unit: 1, body: write, class: RequestClass::Stop };
    assert_eq!(world.host.recall(&stop), None, "nothing waits");
    world.now = world.now.plus_ms(4);
    world.host.submit(world.now, Ticket(900), read).unwrap();
    assert_eq!(world.host.poll_transmit(world.now, &mut [0; 256]), None, "it has to be silent");
    assert!(world.host.submit(world.now, Ticket(901), stop).is_err());
    assert_eq!(world.host.recall(&stop), Some(Ticket(900)));
    world.host.submit(world.now, Ticket(901), stop).unwrap();
    assert_eq!(world.host.recall(&stop), None, "a stop makes way for none");
    let sent = world.host.poll_timeout().unwrap();
    assert_eq!(sent.since(received_at).as_millis(), 10, "no later than the read would have been");
    while world.host.counters().answered < 2 {
        assert!(world.step());
    }
    assert_eq!(
        world.host.poll_event().map(|(to, _)| *to),
        Some(EventSubject::Request(Ticket(901)))
    );
    assert_eq!(world.drive.writes, [(5, vec![0])]);
    world.host.submit(world.now, Ticket(902), read).unwrap();
    let before = world.host.counters().sent;
    while world.host.counters().sent == before {
        assert!(world.step());
    }
    assert_eq!(world.host.recall(&stop), None, "it is on the wire");
    while world.host.counters().answered < 3 {
        assert!(world.step());
    }
    let answer = world.host.poll_event().map(|(_, answer)| answer.unwrap().words[0]);
    assert_eq!(answer, Some(4 * 257));
}
