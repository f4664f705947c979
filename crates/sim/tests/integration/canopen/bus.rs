//! A bus under full load, controllers that leave it, and two nodes with one number.

use std::collections::VecDeque;

use polepair_drives::surroundings;
use polepair_sim::node::{CAN_PORT, SimNode};

use super::*;

/// An identifier that wins arbitration against every node, and belongs to none.
const FOREMOST: u16 = 0x001;

#[test]
fn a_babbling_node_makes_commands_fail_and_repeats_none() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        for axis in [0, 1] {
            done(bench.verb(axis, Verb::Enable));
        }
        let before = [0, 1].map(|axis| bench.truth(axis));
        // From a moment to longer than every deadline, without a pause.
        let ms = 20 + bench.random.below(1_500) as u32;
        let noise = Frame::standard(FOREMOST, &bench.random.next_u64().to_le_bytes());
        let pause = bench.random.below(30) as u32;
        let by = Command { target: Some(1.0), ..Command::new(Verb::MoveBy) };
        let tickets = [0, 1].map(|axis| bench.commanded(axis, by));
        bench.pass(pause);
        bench.flood(noise, ms * 4, 0);
        for (axis, ticket) in tickets.into_iter().enumerate() {
            let outcome = bench.end(ticket);
            let clear = matches!(
                outcome,
                Outcome::Done(_)
                    | Outcome::NotDone(Failure::Silent | Failure::NotReached)
                    | Outcome::Unknown(Failure::Silent | Failure::NotReached)
                    | Outcome::Partly(Failure::Silent | Failure::NotReached, _)
            );
            assert!(clear, "{outcome:?}");
            let executed = bench.truth(axis as u8).unrepeatable - before[axis].unrepeatable;
            assert!(executed <= 1, "{executed} times, {outcome:?}");
            assert!(executed == 1 || !matches!(outcome, Outcome::Done(_)), "{outcome:?}");
        }
        // When the bus is free again, everything works, and nothing is made up for.
        bench.pass(ms + 2_500);
        for axis in 0..2 {
            let executed = bench.truth(axis).unrepeatable - before[usize::from(axis)].unrepeatable;
            assert!(executed <= 1, "{executed} times");
            done(bench.read(axis, "statusword"));
            let from = bench.truth(axis).position;
            done(bench.command(axis, by));
            done(bench.verb(axis, Verb::Reached));
            let way = bench.truth(axis).position - from;
            assert!((way - 1.0).abs() < 0.05, "{way} rad");
        }
    });
}

#[test]
fn a_stop_gets_through_as_soon_as_the_bus_lets_it() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402()]);
        bench.spin(0, 20.0);
        let ms = 20 + bench.random.below(100) as u32;
        bench.flood(Frame::standard(FOREMOST, &[0x55; 8]), ms * 4, 0);
        let ticket = bench.commanded(0, Command::new(Verb::Stop));
        done(bench.end(ticket));
        bench.rests(0);
    });
}

#[test]
fn a_host_off_the_bus_ends_what_runs_and_disarms() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        bench.spin(1, 20.0);
        done(bench.verb(0, Verb::Enable));
        let before = bench.truth(0).unrepeatable;
        let by = Command { target: Some(1.0), ..Command::new(Verb::MoveBy) };
        let ticket = bench.commanded(0, by);
        let pause = bench.random.below(5_000);
        let at = bench.world.now().plus_ns(pause * 1_000);
        bench.world.run_until(at);
        let (wire, host) = (bench.wire, bench.host);
        bench.world.force_bus_off(wire, host);
        let outcome = bench.end(ticket);
        let executed = bench.truth(0).unrepeatable - before;
        match outcome {
            Outcome::Done(_) => assert_eq!(executed, 1),
            Outcome::NotDone(Failure::LinkDown) => assert_eq!(executed, 0),
            Outcome::Unknown(Failure::LinkDown) | Outcome::Partly(Failure::LinkDown, _) => {}
            outcome => panic!("{outcome:?}"),
        }
        assert!(!bench.is_armed(0) && !bench.is_armed(1));
        let refused = bench.axes(|axes, now| axes.command(now, Ticket(9_000), AxisIndex(0), by));
        assert_eq!(refused, Err(Unsupported::NotArmed));
        bench.pass(100);
        done(bench.read(0, "statusword"));
        done(bench.verb(1, Verb::Stop));
        bench.rests(1);
        assert!(bench.truth(0).unrepeatable - before <= 1);
    });
}

#[test]
fn a_node_off_the_bus_stops_as_configured_and_tells_when_it_is_back() {
    seeds(|seed| {
        for option in 0..4 {
            let mut bench = Bench::new(seed, &[cia402(), cia402()]);
            bench.set(0, &[("lost connection option", option)]);
            bench.spin(0, 20.0);
            bench.spin(1, 20.0);
            let pause = bench.random.below(50) as u32;
            bench.pass(pause);
            let (wire, node) = (bench.wire, bench.drives[0]);
            bench.world.force_bus_off(wire, node);
            bench.pass(3_000);
            bench.turns(1, 20.0);
            match option {
                0 => bench.turns(0, 20.0),
                _ => bench.rests(0),
            }
            let known = bench.fault(0);
            let expected = if option == 1 { [0x8130, 0x8140] } else { [0x8140; 2] };
            assert!(expected.contains(&known), "{option}: {known:#x}");
            done(bench.read(0, "statusword"));
            done(bench.verb(0, Verb::Clear));
            bench.spin(0, 20.0);
        }
    });
}

/// A second drive of node 2, plugged in; where it differs from the first, their frames do.
fn twin(bench: &mut Bench) -> NodeId {
    let mut spec = drive(cia402(), 2);
    spec.extra.push(("serial".to_owned(), "77".to_owned()));
    spec.build(&mut bench.world, bench.wire, false).unwrap()
}

fn starts(bench: &mut Bench, drive: NodeId) -> u64 {
    bench.world.inspect(drive, |node, now| node.surroundings().unwrap().ground_truth(now)).starts
}

/// Both answer in the same bit: frames that differ destroy each other until both are off the bus.
#[test]
fn two_nodes_of_one_number_that_answer_at_once_are_silent_and_move_nothing() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        let twin = twin(&mut bench);
        // The second one's shaft is elsewhere.
        let turn = |bench: &mut Bench, torque: f64| {
            let act = Act::Load(torque);
            bench.world.with_node(twin, |node, now| node.surroundings().unwrap().act(now, act));
        };
        turn(&mut bench, 0.5);
        let pause = 50 + bench.random.below(100) as u32;
        bench.pass(pause);
        turn(&mut bench, 0.0);
        bench.pass(10_000);
        let elsewhere = bench
            .world
            .inspect(twin, |node, now| node.surroundings().unwrap().ground_truth(now))
            .position;
        assert!(elsewhere > 0.1, "{elsewhere} rad");
        assert_eq!(bench.read(0, "serial number"), Outcome::NotDone(Failure::Silent));
        // The fault states the reason: both had to leave the bus.
        bench.pass(20);
        assert!([0x8130, 0x8140].contains(&bench.fault(0)), "{:#x}", bench.fault(0));
        // To be enabled takes a reading of the position, which they do not share.
        let outcome = bench.verb(0, Verb::Enable);
        assert!(!matches!(outcome, Outcome::Done(_)), "{outcome:?}");
        assert_eq!((bench.truth(0).starts, starts(&mut bench, twin)), (0, 0));
        // Their neighbour is not concerned.
        bench.spin(1, 20.0);
    });
}

/// One node replies a moment after the other: every reply comes twice, and that is reported.
#[test]
fn two_nodes_of_one_number_that_answer_in_turn_are_reported_and_not_moved() {
    seeds(|seed| {
        let mut bench = Bench::new(seed, &[cia402(), cia402()]);
        let late_us = 50 + bench.random.below(150);
        let twin = bench.world.add_node(Box::new(Late::new(drive(cia402(), 2), late_us)));
        bench.world.plug_drive(bench.wire, twin, CAN_PORT);
        bench.pass(10);
        for _ in 0..4 {
            done(bench.read(0, "statusword"));
            bench.pass(2);
        }
        for verb in [Verb::Enable, Verb::Clear] {
            let outcome = bench.verb(0, verb);
            let reported = matches!(
                outcome.failure(),
                Some(Failure::NotReady { hint }) if hint.contains("two nodes answer")
            );
            assert!(reported || verb == Verb::Clear, "{outcome:?}");
        }
        let outcome = bench.write(0, "profile velocity", 5_000);
        assert!(matches!(outcome, Outcome::NotDone(Failure::NotReady { .. })), "{outcome:?}");
        assert_eq!((bench.truth(0).starts, starts(&mut bench, twin)), (0, 0));
        bench.spin(1, 20.0);
        // A stop goes out whichever node replies.
        done(bench.verb(0, Verb::Disable));
        // Once one of them is gone, the other obeys.
        bench.world.set_unplugged(bench.wire, twin, true);
        done(bench.read(0, "statusword"));
        done(bench.read(0, "statusword"));
        bench.spin(0, 20.0);
    });
}

/// A drive whose frames come a moment later than they could.
struct Late {
    drive: Box<dyn SimNode>,
    late_us: u64,
    held: VecDeque<(Instant, Frame)>,
}

impl Late {
    fn new(spec: RackDrive, late_us: u64) -> Self {
        let drive = spec.device(false).unwrap();
        Self { drive, late_us, held: VecDeque::new() }
    }

    /// Takes the frames that the drive sends.
    fn hold(&mut self, now: Instant) {
        let mut frame = Frame::default();
        while let Some(end) = self.drive.can(CAN_PORT)
            && end.poll_transmit(now, &mut frame).is_some()
        {
            self.held.push_back((now.plus_ns(self.late_us * 1_000), frame));
        }
    }
}

impl Timed for Late {
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.handle_timeout(now);
        self.hold(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let held = self.held.front().map(|(at, _)| *at);
        [held, self.drive.poll_timeout()].into_iter().flatten().min()
    }
}

impl Station<Can> for Late {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        let end = self.drive.can(CAN_PORT);
        end.into_iter().for_each(|end| end.handle_input(now, unit));
        self.hold(now);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        let end = self.drive.can(CAN_PORT);
        end.into_iter().for_each(|end| end.handle_line(now, event));
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.hold(now);
        self.held.front().filter(|(at, _)| *at <= now)?;
        let (_, frame) = self.held.pop_front()?;
        *out = frame;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: BIT_RATE }
    }
}

impl SimNode for Late {
    fn can(&mut self, port: u8) -> Option<&mut dyn Station<Can>> {
        (port == CAN_PORT).then_some(self as _)
    }

    fn surroundings(&mut self) -> Option<&mut dyn surroundings::SurroundingsControl> {
        self.drive.surroundings()
    }
}
