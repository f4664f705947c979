//! The world with tiny stations: a caller that asks and an answerer that repeats.

use polepair_core::medium::{MediumKind, Parity, SerialLine, Stream};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

use crate::fault::Faults;
use crate::node::Lone;
use crate::random::{Ppm, Random};
use crate::serial_line::Serial;
use crate::sim_link::SimLink;
use crate::swarm::{self, Report};
use crate::uart;
use crate::world::World;

/// Answers every run of bytes with the same bytes, each one more, after a millisecond.
#[derive(Debug)]
struct Answerer {
    baud: u32,
    pending: Option<(Instant, Vec<u8>)>,
    breaks: u32,
}

impl Answerer {
    const fn new(baud: u32) -> Self {
        Self { baud, pending: None, breaks: 0 }
    }
}

impl Timed for Answerer {
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_timeout(&self) -> Option<Instant> {
        self.pending.as_ref().map(|(at, _)| *at)
    }
}

impl Station<Stream> for Answerer {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        let (_, mut bytes) = self.pending.take().unwrap_or_default();
        bytes.extend(unit.iter().map(|byte| byte.wrapping_add(1)));
        self.pending = Some((now.plus_ms(1), bytes));
    }
    fn handle_line(&mut self, _: Instant, event: LineEvent) {
        self.breaks += u32::from(event == LineEvent::Break);
    }
    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let (_, bytes) = self.pending.take_if(|(at, _)| *at <= now)?;
        out[..bytes.len()].copy_from_slice(&bytes);
        Some(bytes.len())
    }
    fn line(&self) -> SerialLine {
        SerialLine::n81(self.baud)
    }
}

fn link(set: Serial, baud: u32, seed: u64) -> SimLink {
    let mut world = World::new(seed);
    let wire = world.serial(set);
    let node = world.add(Box::new(Lone(Answerer::new(baud))));
    world.plug_drive(wire, node, 0);
    let mut link = SimLink::new(world, wire);
    link.set_line(SerialLine::n81(9600));
    link
}

fn ask(link: &mut SimLink, bytes: &[u8]) -> (Instant, Vec<u8>) {
    let now = link.now();
    link.send(now, bytes);
    link.advance_to(now.plus_ms(100));
    let mut buffer = [0; 64];
    let (at, count) = link.receive(&mut buffer).unwrap_or((link.now(), 0));
    (at, buffer[..count].to_vec())
}

/// Swarm serial:3523, 7838, 15278: lateness added up, so that a drive answered for seconds what was
/// asked before the wire was well again.
#[test]
fn no_late_reply_is_later_than_the_latest() {
    let mut world = World::new(3);
    let wire = world.serial(Serial::RS232);
    let node = world.add(Box::new(Lone(Answerer::new(9600))));
    world.plug_drive(wire, node, 0);
    let mut link = SimLink::new(world, wire);
    link.set_line(SerialLine::n81(9600));
    let faults = Faults { late: Ppm::ALWAYS, latest_ms: 200, patience_ms: 100, ..Faults::NONE };
    *link.world().faults(wire).expect("a serial wire") = faults;
    for at in (0..1_000).step_by(10) {
        link.send(Instant::ZERO.plus_ms(at), &[at as u8]);
    }
    link.world().run_until(Instant::ZERO.plus_ms(1_300));
    let (mut buffer, mut last, mut count) = ([0; 64], Instant::ZERO, 0);
    while let Some((at, bytes)) = link.receive(&mut buffer) {
        (last, count) = (at, count + bytes);
    }
    assert_eq!(count, 100);
    assert!(last <= Instant::ZERO.plus_ms(990 + 200 + 10), "{last:?}");
}

#[test]
fn bytes_take_their_time() {
    let (at, bytes) = ask(&mut link(Serial::RS232, 9600, 1), &[1, 2, 3]);
    assert_eq!(bytes, [2, 3, 4]);
    // Three characters of ten bits each way, and the answerer's millisecond.
    assert_eq!(at.0, 2 * 3 * SerialLine::n81(9600).characters_ns(1) + 1_000_000);
}

#[test]
fn an_untimed_wire_has_no_timing_and_no_baud_rate() {
    let (at, bytes) = ask(&mut link(Serial::UNTIMED, 115_200, 1), &[1, 2, 3]);
    assert_eq!((at, bytes), (Instant::ZERO.plus_ms(1), vec![2, 3, 4]));
}

#[test]
fn an_echoing_adapter_hears_itself() {
    let mut link = link(Serial { echo: true, ..Serial::RS485 }, 9600, 1);
    assert_eq!(ask(&mut link, &[7, 8]).1, [7, 8]);
    link.advance_to(Instant::ZERO.plus_ms(50));
    let mut buffer = [0; 8];
    assert_eq!(link.receive(&mut buffer).map(|(_, n)| buffer[..n].to_vec()), Some(vec![8, 9]));
}

#[test]
fn who_talks_on_half_duplex_hears_nothing_and_garbles_the_other() {
    let mut link = link(Serial::RS485, 9600, 1);
    let character = SerialLine::n81(9600).characters_ns(1);
    link.send(Instant::ZERO, &[1, 2, 3, 4]);
    // The reply begins after 4 characters and 1 ms; talk into its second half.
    let begin = Instant(4 * character + 1_000_000);
    link.send(begin.plus_ns(2 * character), &[0x55; 4]);
    let mut buffer = [0; 8];
    link.advance_to(begin.plus_ns(4 * character));
    assert_eq!(link.receive(&mut buffer), Some((begin.plus_ns(4 * character), 2)));
    assert_eq!(buffer[..2], [2, 3]);
}

#[test]
fn a_wrong_baud_rate_gives_garbage() {
    let (_, bytes) = ask(&mut link(Serial::RS232, 19_200, 1), &[0x55, 0xAA, 0x01, 0x5E]);
    assert_ne!(bytes, [0x56, 0xAB, 0x02, 0x5F]);
}

#[test]
fn a_receiver_with_the_same_bits_reads_the_same_bytes() {
    let bytes: Vec<u8> = (0..=255).collect();
    for parity in [Parity::None, Parity::Even, Parity::Odd] {
        let line = SerialLine { parity, ..SerialLine::n81(115_200) };
        let mut heard = Vec::new();
        assert!(!uart::resample(&bytes, line, line, &mut heard));
        assert_eq!(heard, bytes);
        let slower = SerialLine { baud: 113_000, ..line };
        heard.clear();
        uart::resample(&bytes, line, slower, &mut heard);
        assert!(uart::compatible(line, slower) && heard == bytes);
    }
    let mut heard = Vec::new();
    let odd = SerialLine { parity: Parity::Odd, ..SerialLine::n81(9600) };
    let even = SerialLine { parity: Parity::Even, ..odd };
    assert!(uart::resample(&[1], odd, even, &mut heard) && heard.is_empty());
}

#[test]
fn each_fault_does_what_it_says() {
    let always = Ppm::ALWAYS;
    let with = |faults: Faults| {
        let mut link = link(Serial::RS232, 9600, 5);
        let wire = link.wire();
        *link.world().faults(wire).expect("serial") = faults;
        let (at, bytes) = ask(&mut link, &[0xFF; 8]);
        (at, bytes, link.world().made(wire))
    };
    let (clean, ..) = with(Faults::NONE);
    assert_eq!(with(Faults { lose_request: always, ..Faults::NONE }).2.requests_lost, 1);
    assert_eq!(with(Faults { lose_reply: always, ..Faults::NONE }).1, []);
    assert_eq!(with(Faults { lose: always, ..Faults::NONE }).1, []);
    assert_eq!(with(Faults { flip: always, ..Faults::NONE }).2.bytes, 16);
    assert_eq!(with(Faults { insert: always, ..Faults::NONE }).1.len(), 32);
    assert_eq!(with(Faults { truncate: always, ..Faults::NONE }).2.truncated, 2);
    assert_eq!(with(Faults { duplicate: always, ..Faults::NONE }).2.duplicated, 1);
    assert!(with(Faults { latency_ms: 16, ..Faults::NONE }).0.0 % 16_000_000 == 0);
    let (late, ..) = with(Faults { late: always, patience_ms: 20, latest_ms: 60, ..Faults::NONE });
    assert!(late > clean && late <= clean.plus_ms(60));
    assert_ne!(with(Faults { host_baud: 4800, ..Faults::NONE }).1, vec![0x00; 8]);
    assert_ne!(with(Faults { collide: always, ..Faults::NONE }).1, vec![0x00; 8]);
    let burst = Faults { burst: always, burst_max: 4, ..Faults::NONE };
    assert_eq!(with(burst).1.len(), 8);
}

#[test]
fn pieces_are_the_same_bytes_later() {
    let mut link = link(Serial::RS232, 9600, 3);
    let wire = link.wire();
    *link.world().faults(wire).expect("serial") =
        Faults { chunk: Ppm::ALWAYS, chunk_gap_us: 500, ..Faults::NONE };
    link.send(Instant::ZERO, &[10, 20, 30, 40, 50, 60]);
    let (mut all, mut buffer) = (Vec::new(), [0; 64]);
    while link.advance_to(Instant::ZERO.plus_ms(100)) < Instant::ZERO.plus_ms(100) {
        let (_, count) = link.receive(&mut buffer).expect("mail");
        all.extend_from_slice(&buffer[..count]);
    }
    assert_eq!(all, [11, 21, 31, 41, 51, 61]);
}

#[test]
fn labels_tell_what_answers_what() {
    let mut world = World::new(1);
    let wire = world.serial(Serial::RS232);
    let node = world.add(Box::new(Lone(Answerer::new(9600))));
    world.plug_drive(wire, node, 0);
    let end = world.open(wire);
    world.set_line(end, SerialLine::n81(9600));
    world.send(end, Instant::ZERO, &[1]);
    while world.step().is_some() {}
    let known = world.knowledge(wire, node);
    assert_eq!((known.heard.tag, known.sent.answers), (1, 1));
    assert_eq!(known.sent.question, known.heard.content);
    assert!(!known.sent.tainted);
}

#[test]
fn equal_seeds_give_equal_histories() {
    let run = |seed| {
        let mut link = link(Serial::RS485, 9600, seed);
        let wire = link.wire();
        *link.world().faults(wire).expect("serial") =
            Faults { flip: Ppm(100_000), chunk: Ppm(500_000), ..Faults::NONE };
        (0..50).for_each(|n| drop(ask(&mut link, &[n; 5])));
        link.world().history()
    };
    // Pinned: another platform, another build or another day must give this very history.
    assert_eq!(run(1), 0xE2FE_D7E0_F6D7_9E9D);
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn random_numbers_are_the_published_ones() {
    // SplitMix64 of seed 0 begins with E220A8397B1DCDAF; xoshiro256++ as its authors' C code.
    let mut random = Random::new(0);
    assert_eq!(random.word(), 0x5317_5D61_490B_23DF);
    assert!((0..1000).all(|_| (-3..=3).contains(&random.between(-3, 3))));
    assert!((0..1000).all(|_| !random.chance(Ppm::NEVER) && random.chance(Ppm::ALWAYS)));
}

/// The swarm's seeds that every test run lives through; `cargo xtask swarm` goes on from there.
const SEEDS: u64 = 500;
const CAN_SEEDS: u64 = 300;

/// Lives through so many seeds; what breaks an invariant is named with its seed.
fn lived(medium: MediumKind, seeds: u64) -> Report {
    let (mut total, mut told) = (Report::default(), Vec::new());
    for seed in 1..=seeds {
        let report = swarm::run(medium, seed);
        told.extend(report.violations.iter().map(|broken| format!("{medium:?} {seed}: {broken}")));
        total.add(&report);
    }
    assert!(told.is_empty(), "{}", told.join("\n"));
    total
}

#[test]
fn seeded_worlds_keep_every_invariant() {
    let total = lived(MediumKind::Serial, SEEDS);
    assert!(total.requests > 100 * SEEDS && total.made.bytes > SEEDS, "{total:?}");
}

#[test]
fn seeded_buses_keep_every_invariant() {
    let total = lived(MediumKind::Can, CAN_SEEDS);
    assert!(total.requests > 100 * CAN_SEEDS && total.made_on_can.errors > CAN_SEEDS, "{total:?}");
}

/// Seeds beyond those that once broke an invariant: a request cut short that was taken as whole, the
/// copy of a reply that came before its request had left, and what the judges had wrong of a stop
/// that overtakes and of a frame that is taken twice.
const ONCE_BROKEN: [u64; 6] = [1615, 1648, 2445, 2604, 2885, 2968];

#[test]
fn buses_that_once_broke_an_invariant_keep_it() {
    for seed in ONCE_BROKEN {
        assert_eq!(swarm::run(MediumKind::Can, seed).violations, [], "seed {seed}");
    }
}

#[test]
fn a_seed_has_one_history() {
    for seed in [3, 8, 44] {
        for medium in [MediumKind::Serial, MediumKind::Can] {
            assert_eq!(swarm::run(medium, seed), swarm::run(medium, seed));
        }
    }
}
