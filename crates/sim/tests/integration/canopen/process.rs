//! Process data of the wrong length, and storms of emergencies.

use super::*;

const RPDO_1: u16 = 0x202;
/// Target velocity in an RPDO.
const TARGET: i64 = 0x60FF_0020;
const SHORT: i64 = 0x8210;
const LONG: i64 = 0x8220;

/// A drive in profile velocity mode, enabled, its speed commanded by RPDO 1 of that type.
fn commanded_by_pdo(seed: u64, kind: i64) -> Bench {
    let mut bench = Bench::new(seed, &[cia402()]);
    let off = 1 << 31 | i64::from(RPDO_1);
    bench.set(0, &[("rpdo 1 identifier", off), ("rpdo 1 entries", 0)]);
    bench.set(0, &[("rpdo 1 entry 1", TARGET), ("rpdo 1 entries", 1)]);
    bench.set(0, &[("rpdo 1 transmission", kind), ("rpdo 1 identifier", RPDO_1.into())]);
    bench.spin(0, 0.0);
    bench
}

fn sync(bench: &mut Bench) {
    bench.say(0x080, &[]);
    bench.pass(500);
}

/// Converts rad/s to increments a second.
fn target(rad_per_s: f64) -> [u8; 4] {
    let increments = rad_per_s / std::f64::consts::TAU * cia402::objects::INCREMENTS as f64;
    (increments.round() as i32).to_le_bytes()
}

#[test]
fn a_pdo_too_short_moves_nothing_and_is_reported() {
    for kind in [255, 1] {
        seeds(|seed| {
            let mut bench = commanded_by_pdo(seed, kind);
            bench.say(RPDO_1, &target(10.0));
            sync(&mut bench);
            bench.turns(0, 10.0);
            let len = bench.random.below(4) as usize;
            bench.say(RPDO_1, &target(300.0)[..len]);
            sync(&mut bench);
            bench.turns(0, 10.0);
            assert_eq!(bench.fault(0), SHORT, "{len} bytes");
            let starts = bench.truth(0).starts;
            bench.say(RPDO_1, &[]);
            sync(&mut bench);
            assert_eq!(bench.truth(0).starts, starts);
            // What has its length is obeyed again.
            bench.say(RPDO_1, &target(-10.0));
            sync(&mut bench);
            bench.turns(0, -10.0);
        });
    }
}

/// CiA 301 has its first bytes count; what is behind them moves nothing.
#[test]
fn a_pdo_too_long_is_reported_and_its_first_bytes_count() {
    for kind in [255, 1] {
        seeds(|seed| {
            let mut bench = commanded_by_pdo(seed, kind);
            let len = 5 + bench.random.below(4) as usize;
            let mut data = [0xFF; 8];
            data[..4].copy_from_slice(&target(10.0));
            bench.say(RPDO_1, &data[..len]);
            sync(&mut bench);
            bench.turns(0, 10.0);
            assert_eq!(bench.fault(0), LONG, "{len} bytes");
            done(bench.verb(0, Verb::Stop));
            bench.rests(0);
        });
    }
}

/// The TS reports nothing, and takes the values that are whole.
#[test]
fn a_ts_takes_of_a_short_pdo_what_is_whole() {
    let mut bench = Bench::new(1, &[ts()]);
    bench.set(0, &[("rpdo 1 entries", 0), ("rpdo 1 entry 1", TARGET)]);
    bench.set(0, &[("rpdo 1 entries", 1), ("rpdo 1 transmission", 255)]);
    bench.spin(0, 0.0);
    let starts = bench.truth(0).starts;
    for len in 0..4 {
        bench.say(RPDO_1, &1_000_i32.to_le_bytes()[..len]);
        bench.pass(300);
        bench.rests(0);
    }
    assert_eq!((bench.truth(0).starts, bench.fault(0)), (starts, 0));
    // In 0.1 rpm: 100 rpm are 10.5 rad/s.
    bench.say(RPDO_1, &1_000_i32.to_le_bytes());
    bench.pass(500);
    bench.turns(0, 10.5);
}

/// Emergencies of a node as fast as the bus takes them, and faster than their inhibit time is.
#[test]
fn a_storm_of_emergencies_blocks_no_request() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        bench.spin(1, 20.0);
        let code = 0x2310 + bench.random.below(8) as u16;
        let mut frame = Frame::standard(0x082, &[0; 8]);
        frame.data[..2].copy_from_slice(&code.to_le_bytes());
        frame.data[2] = 2;
        // A frame takes 0.26 ms: from 65 % of the bus up to all but what fits between.
        let every_us = 280 + bench.random.below(120);
        bench.flood(frame, 5_000, every_us);
        bench.pass(10);
        let started_at = bench.world.now();
        assert_eq!(bench.fault(0), i64::from(code));
        for axis in [0, 1] {
            for _ in 0..10 {
                done(bench.read(axis, "statusword"));
            }
        }
        done(bench.verb(1, Verb::Stop));
        bench.rests(1);
        let took = bench.world.now().since(started_at).as_millis();
        assert!(took < 1_000, "{took} ms");
        // The drive itself has no fault, so it can be enabled.
        done(bench.verb(0, Verb::Enable));
        bench.pass(3_000);
        bench.spin(0, 20.0);
        let counters = bench.counters();
        assert_eq!((counters.silent, counters.corrupt), (0, 0), "{counters:?}");
    });
}

/// A host that takes no events loses unrequested messages, which are counted; replies are kept.
#[test]
fn a_storm_without_a_listener_is_bounded_and_counted() {
    seeds(|seed| {
        let mut world = World::new(seed);
        let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
        let bare = Bare::new();
        let host = world.add_node(Box::new(CanStationNode(bare.clone())));
        world.plug_host(wire, host, 0);
        drive(cia402(), 2).build(&mut world, wire, false).unwrap();
        let mut random = Random::new(seed);
        let times = 1_000 + random.below(2_000) as u32;
        let frame = Frame::standard(0x083, &[0x10, 0x23, 2, 0, 0, 0, 0, 0]);
        let storm = world.add_node(Box::new(CanStationNode(Talker::new(frame, times, 300))));
        world.plug_intruder(wire, storm);
        world.run_until(Instant::ZERO.plus_ms(random.below(500) as u32));
        let request = HostRequest::Read { node: 2, object: ObjectIndex::new(0x1000, 0) };
        world.with_node(host, |_, now| bare.host().submit(now, Ticket(1), request)).unwrap();
        world.run_until(Instant::ZERO.plus_ms(3_000));
        let mut host = bare.host();
        let events: Vec<_> = std::iter::from_fn(|| host.poll_event().copied()).collect();
        assert!(
            events.iter().any(|(to, end)| *to == EventSubject::Request(Ticket(1)) && end.is_ok())
        );
        let reported =
            events.iter().filter(|(to, _)| *to == EventSubject::Unsolicited(3)).count() as u64;
        assert!((1..u64::from(times)).contains(&reported), "{reported} of {times}");
        assert_eq!(reported + host.counters().late, u64::from(times), "none is lost uncounted");
    });
}
