//! Errors that the checks of both formats cannot see: changed replies that pass them, and those of them
//! that the host takes for an answer.

extern crate std;

use std::println;
use std::vec::Vec;

use super::world::UNTIMED;
use crate::proto::modbus::host_request::{HostRequest, RequestBody};
use crate::proto::modbus::wire::{ReplyPdu, Space, WireFormat};
use crate::proto::modbus::{SerialHost, ascii, rtu};
use crate::station::{Host as _, RequestClass, Station as _, Ticket};
use crate::time::Instant;

/// Address and PDU of a reply to a read of one register, and that register.
const BODY: [u8; 5] = [1, 3, 2, 0x03, 0xEF];
const VALUE: u16 = 0x03EF;

/// The reply as a frame.
fn reply(format: WireFormat) -> Vec<u8> {
    let mut out = [0; 32];
    let put = |out: &mut [u8]| ReplyPdu::Read { space: Space::Holding, data: &BODY[3..] }.emit(out);
    let len = match format {
        WireFormat::Rtu => rtu::emit(1, &mut out, put),
        WireFormat::Ascii => ascii::emit(1, &mut out, put),
        WireFormat::Tcp => unreachable!("it has no check"),
    };
    out[..len].to_vec()
}

/// Number of frames, of those that pass the check, and of those that the host accepts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct SweepCount {
    changed: usize,
    passed: usize,
    taken: usize,
}

impl SweepCount {
    fn of(format: WireFormat, frames: impl Iterator<Item = Vec<u8>>) -> Self {
        let good = reply(format);
        let mut count = Self { changed: 0, passed: 0, taken: 0 };
        for frame in frames.filter(|frame| *frame != good) {
            count.changed += 1;
            count.passed += usize::from(passes(format, &frame));
            count.taken += usize::from(takes(format, &frame));
        }
        count
    }

    fn print(self, what: &str, format: WireFormat) -> Self {
        let Self { changed, passed, taken } = self;
        println!("{format:?} {what}: {passed} of {changed} pass the check, {taken} the host");
        self
    }
}

/// Returns whether some frame in it passes its check and holds other bytes than the good reply. A small
/// letter for a capital is no other byte.
fn passes(format: WireFormat, frame: &[u8]) -> bool {
    if format == WireFormat::Rtu {
        return rtu::decode(frame).is_ok();
    }
    let mut collector = ascii::AsciiDeframer::default();
    frame.iter().any(|&character| {
        let ended = collector.feed(character) == ascii::FeedResult::Complete;
        let bytes = collector.bytes();
        ended && ascii::decode(bytes).is_ok() && bytes[..bytes.len() - 1] != BODY
    })
}

/// Returns whether the host returns another value to its caller.
fn takes(format: WireFormat, frame: &[u8]) -> bool {
    let mut host = SerialHost::new(format, &UNTIMED);
    let query = RequestBody::Read { space: Space::Holding, start: 3, count: 1 };
    let request = HostRequest { unit: 1, body: query, class: RequestClass::Idempotent };
    host.submit(Instant(1), Ticket(1), request).unwrap();
    host.poll_transmit(Instant(1), &mut [0; 64]).unwrap();
    host.handle_input(Instant(1).plus_ms(5), frame);
    matches!(host.poll_event(), Some((_, Ok(answer))) if answer.words[0] != VALUE)
}

fn flipped(frame: &[u8], bits: &[usize]) -> Vec<u8> {
    let mut bad = frame.to_vec();
    bits.iter().for_each(|bit| bad[bit / 8] ^= 1 << (bit % 8));
    bad
}

fn pairs(len: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..len).flat_map(move |a| (a + 1..len).map(move |b| (a, b)))
}

fn swapped(frame: &[u8], a: usize, b: usize) -> Vec<u8> {
    let mut bad = frame.to_vec();
    bad.swap(a, b);
    bad
}

/// One-bit errors, two-bit errors and swaps of two bytes of a reply.
fn sweep(format: WireFormat) -> [SweepCount; 3] {
    let good = reply(format);
    let (bits, bytes) = (8 * good.len(), good.len());
    let single = (0..bits).map(|bit| flipped(&good, &[bit]));
    let double = pairs(bits).map(|(a, b)| flipped(&good, &[a, b]));
    let swaps = pairs(bytes).map(|(a, b)| swapped(&good, a, b));
    [
        SweepCount::of(format, single).print("one-bit errors", format),
        SweepCount::of(format, double).print("two-bit errors", format),
        SweepCount::of(format, swaps).print("swaps of two bytes", format),
    ]
}

#[test]
fn what_the_checks_cannot_see() {
    let none = |changed| SweepCount { changed, passed: 0, taken: 0 };
    // Two bytes of the seven are alike.
    assert_eq!(sweep(WireFormat::Rtu), [none(56), none(1540), none(20)]);
    let [single, double, swaps] = sweep(WireFormat::Ascii);
    assert_eq!(single, none(120));
    assert_eq!(double, SweepCount { changed: 7140, passed: 35, taken: 7 });
    assert_eq!(swaps, SweepCount { changed: 94, passed: 19, taken: 5 });
}
