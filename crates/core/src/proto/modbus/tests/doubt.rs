//! A session that begins in doubt: replies to an earlier program may be outstanding.

extern crate std;

use std::boxed::Box;
use std::collections::VecDeque;
use std::vec;
use std::vec::Vec;

use super::world::TestWorld;
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::modbus::device::Framing;
use crate::proto::modbus::host_request::{HostRequest, RequestBody};
use crate::proto::modbus::rtu;
use crate::proto::modbus::wire::{Space, WireFormat};
use crate::station::{EventSubject, Host as _, RequestClass, Ticket};

const MS: u64 = 1_000_000;

fn in_doubt(format: WireFormat, baud: u32, seed: u32) -> TestWorld {
    let options = HostOptions {
        probe_seed: Some(seed),
        reply_timeout_ms: Some(100),
        ..HostOptions::new(baud)
    };
    TestWorld::new(format, Framing::Length, &options)
}

/// The reply to an older read of this many registers, all of them `word`.
fn owed_read(count: u8, word: u16) -> Vec<u8> {
    let mut adu = vec![1, 3, 2 * count];
    (0..count).for_each(|_| adu.extend(word.to_be_bytes()));
    adu.extend(rtu::crc16(&adu).to_le_bytes());
    adu
}

/// Every reply comes as late, those to an earlier program first.
fn with_owed_replies(world: &mut TestWorld, every_ms: u64, pending: Vec<Vec<u8>>) {
    let mut outstanding = VecDeque::from(pending);
    world.fault = Box::new(move |_, bytes| {
        let mut all: Vec<_> = outstanding.drain(..).map(|old| (every_ms * MS, old)).collect();
        all.push((every_ms * MS, bytes));
        all
    });
}

#[test]
fn the_reply_to_an_earlier_program_is_not_taken() {
    for baud in [0, 9600] {
        for seed in 0..40 {
            for every_ms in [1, 25, 60, 90] {
                let mut world = in_doubt(WireFormat::Rtu, baud, seed);
                with_owed_replies(
                    &mut world,
                    every_ms,
                    vec![owed_read(1, 4711), owed_read(2, 4712)],
                );
                for n in [7, 8, 9] {
                    let read = world.read(n, 1);
                    let raw = read.map(|answer| answer.raw());
                    assert!(
                        raw == Ok(i64::from(n) * 257) || raw == Err(Failure::Silent),
                        "baud {baud}, seed {seed}, {every_ms} ms: {raw:?}"
                    );
                    assert!(every_ms > 25 || raw.is_ok(), "seed {seed}, {every_ms} ms");
                }
            }
        }
    }
}

#[test]
fn without_doubt_it_would_be_taken() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    with_owed_replies(&mut world, 1, vec![owed_read(1, 4711)]);
    assert_eq!(world.read(7, 1).map(|answer| answer.raw()), Ok(4711));
}

#[test]
fn a_stop_passes_before_anything_is_proven() {
    for format in [WireFormat::Rtu, WireFormat::Ascii] {
        let mut world = in_doubt(format, 9600, 3);
        let request = RequestBody::Read { space: Space::Holding, start: 7, count: 1 };
        let read = HostRequest { unit: 1, body: request, class: RequestClass::Idempotent };
        assert_eq!(world.host.submit(world.now, Ticket(98), read), Ok(()));
        assert!(world.step());
        let request = RequestBody::WriteRegister { address: 5, value: 0 };
        let stop = HostRequest { unit: 1, body: request, class: RequestClass::Stop };
        let back = world.host.submit(world.now, Ticket(99), stop);
        if let Err(stop) = back {
            assert_eq!(world.host.recall(&stop), Some(Ticket(98)), "nothing of it was sent");
            assert_eq!(world.host.submit(world.now, Ticket(99), stop), Ok(()));
        }
        world.rest();
        assert_eq!(world.drive.writes, [(5, vec![0])]);
        let (to, end) = *world.host.poll_event().expect("an end");
        assert_eq!((to, end.is_ok()), (EventSubject::Request(Ticket(99)), true));
        assert_eq!(world.read(7, 1).map(|answer| answer.raw()), Ok(7 * 257));
    }
}

/// Some drives leave unknown function codes unanswered: registers are read then.
#[test]
fn a_drive_that_answers_reads_of_registers_alone_is_proven_by_them() {
    for seed in 0..20 {
        let mut world = in_doubt(WireFormat::Rtu, 9600, seed);
        world.fault = Box::new(|_, bytes| match bytes[1] {
            3 | 6 => vec![(0, bytes)],
            _ => vec![],
        });
        assert_eq!(world.read(7, 1).map(|answer| answer.raw()), Ok(7 * 257), "seed {seed}");
        let sent = world.host.counters().sent;
        assert_eq!(world.write(5, 9).map(|answer| answer.raw()), Ok(9));
        assert_eq!(world.host.counters().sent, sent + 1, "it is proven once");
    }
}

#[test]
fn silence_ends_what_waits_for_a_proof() {
    let mut world = in_doubt(WireFormat::Rtu, 9600, 9);
    world.fault = Box::new(|_, _| vec![]);
    assert_eq!(world.write(5, 9), Err(Failure::Silent));
    assert_eq!(world.drive.writes, [], "what is not proven is not sent");
    world.rest();
    world.fault = Box::new(|_, bytes| vec![(0, bytes)]);
    assert_eq!(world.read(7, 1).map(|answer| answer.raw()), Ok(7 * 257));
}

/// A line with a delay of seconds, and a client that sends STOP again and again: more replies may come than
/// are kept in mind, and the last stop ends nevertheless.
#[test]
fn more_stops_than_replies_that_are_kept_in_mind_all_end() {
    for format in [WireFormat::Rtu, WireFormat::Ascii] {
        for (stops, delay_ms) in [(4, 400), (9, 400), (30, 400), (30, 150)] {
            let mut world = TestWorld::plain(format);
            world.fault = Box::new(move |_, bytes| vec![(delay_ms * MS, bytes)]);
            let mut ended = 0;
            for number in 0..stops {
                // Two requests of a stop, in turn.
                let address = 5 + number as u16 % 2;
                let request = RequestBody::WriteRegister { address, value: 0 };
                let stop = HostRequest { unit: 1, body: request, class: RequestClass::Stop };
                let until = world.now.plus_ns(2_000 * MS);
                while world.host.submit(world.now, Ticket(number), stop).is_err() {
                    assert!(world.now < until && world.step(), "{format:?}: stop {number} waits");
                    ended += core::iter::from_fn(|| world.host.poll_event().copied()).count();
                }
                assert!(world.step(), "it is sent");
                ended += core::iter::from_fn(|| world.host.poll_event().copied()).count();
            }
            world.rest();
            ended += core::iter::from_fn(|| world.host.poll_event().copied()).count();
            assert_eq!(ended, stops as usize, "{format:?}, {stops} stops");
            world.fault = Box::new(|_, bytes| vec![(0, bytes)]);
            assert_eq!(world.read(7, 1).map(|answer| answer.raw()), Ok(7 * 257));
        }
    }
}
