//! What the checks of both formats cannot see: changed replies that pass them, and those of them
//! that the host takes for an answer.

extern crate std;

use std::println;
use std::vec::Vec;

use super::world::UNTIMED;
use crate::proto::modbus::request::{Ask, Request};
use crate::proto::modbus::wire::{Format, ReplyPdu, Space};
use crate::proto::modbus::{Host, ascii, rtu};
use crate::station::{Class, Host as _, Station as _, Ticket};
use crate::time::Instant;

/// Address and PDU of a reply to a read of one register, and that register.
const BODY: [u8; 5] = [1, 3, 2, 0x03, 0xEF];
const VALUE: u16 = 0x03EF;

/// It as a frame.
fn reply(format: Format) -> Vec<u8> {
    let mut out = [0; 32];
    let put = |out: &mut [u8]| ReplyPdu::Read { space: Space::Holding, data: &BODY[3..] }.emit(out);
    let len = match format {
        Format::Rtu => rtu::emit(1, &mut out, put),
        Format::Ascii => ascii::emit(1, &mut out, put),
    };
    out[..len].to_vec()
}

/// How many there are, how many the check lets through, how many the host takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Count {
    changed: usize,
    passed: usize,
    taken: usize,
}

impl Count {
    fn of(format: Format, frames: impl Iterator<Item = Vec<u8>>) -> Self {
        let good = reply(format);
        let mut count = Self { changed: 0, passed: 0, taken: 0 };
        for frame in frames.filter(|frame| *frame != good) {
            count.changed += 1;
            count.passed += usize::from(passes(format, &frame));
            count.taken += usize::from(takes(format, &frame));
        }
        count
    }

    fn told(self, what: &str, format: Format) -> Self {
        let Self { changed, passed, taken } = self;
        println!("{format:?} {what}: {passed} of {changed} pass the check, {taken} the host");
        self
    }
}

/// Whether some frame in it passes its check and holds other bytes than the good reply. A small
/// letter for a capital is no other byte.
fn passes(format: Format, frame: &[u8]) -> bool {
    if format == Format::Rtu {
        return rtu::open(frame).is_ok();
    }
    let mut collector = ascii::Collector::default();
    frame.iter().any(|&character| {
        let ended = collector.feed(character) == ascii::Fed::Ended;
        let bytes = collector.bytes();
        ended && ascii::open(bytes).is_ok() && bytes[..bytes.len() - 1] != BODY
    })
}

/// Whether the host answers its caller with another value.
fn takes(format: Format, frame: &[u8]) -> bool {
    let mut host = Host::new(format, &UNTIMED);
    let ask = Ask::Read { space: Space::Holding, start: 3, count: 1 };
    let request = Request { unit: 1, ask, class: Class::Idempotent };
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
fn sweep(format: Format) -> [Count; 3] {
    let good = reply(format);
    let (bits, bytes) = (8 * good.len(), good.len());
    let single = (0..bits).map(|bit| flipped(&good, &[bit]));
    let double = pairs(bits).map(|(a, b)| flipped(&good, &[a, b]));
    let swaps = pairs(bytes).map(|(a, b)| swapped(&good, a, b));
    [
        Count::of(format, single).told("one-bit errors", format),
        Count::of(format, double).told("two-bit errors", format),
        Count::of(format, swaps).told("swaps of two bytes", format),
    ]
}

#[test]
fn what_the_checks_cannot_see() {
    let none = |changed| Count { changed, passed: 0, taken: 0 };
    // Two bytes of the seven are alike.
    assert_eq!(sweep(Format::Rtu), [none(56), none(1540), none(20)]);
    let [single, double, swaps] = sweep(Format::Ascii);
    assert_eq!(single, none(120));
    assert_eq!(double, Count { changed: 7140, passed: 35, taken: 7 });
    assert_eq!(swaps, Count { changed: 94, passed: 19, taken: 5 });
}
