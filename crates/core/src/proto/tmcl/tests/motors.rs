//! Several motors behind one address: the reply to a stop does not name its motor.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use super::pair::{MODULE, TestWire, WireFault, request};
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::tmcl::device::Quirks;
use crate::proto::tmcl::{Answer, HostRequest, Opcode, Reply, Request, SerialHost, Status};
use crate::station::{Host, Ticket};

const INVALID_VALUE: Failure = Failure::Refused { code: 4 };

fn stop(motor: u8) -> HostRequest {
    HostRequest::of(Request { motor, ..request(Opcode::Mst, 0, 0) })
}

fn wire(motors: u8, doubt: Option<u32>, replies: WireFault) -> TestWire {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: doubt, ..HostOptions::new(9600) });
    wire.firmware.motors = motors;
    wire.replies = replies;
    wire
}

/// Stops motor after motor, as `polepair stop` does, several times; each outcome is true.
fn stops_are_true(wire: &mut TestWire, context: &str, answered: bool) {
    let motors = wire.firmware.motors;
    for round in 0..8 {
        for motor in (0..=motors).chain([0]) {
            let ended = wire.request(stop(motor));
            let own = if motor < motors {
                matches!(ended, Ok(Answer::Reply(_)))
            } else {
                ended == Err(INVALID_VALUE)
            };
            let unknown = !answered && ended == Err(Failure::Silent);
            assert!(own || unknown, "{context}, round {round}, motor {motor}: {ended:?}");
        }
    }
}

#[test]
fn a_reply_that_comes_twice_counts_for_its_own_motor() {
    for copy_ms in [0, 1, 5, 12, 20, 30] {
        for motors in [0, 1, 2, 3] {
            for doubt in [None, Some(1), Some(77)] {
                let twice =
                    move |_, r: &[u8]| Some(Vec::from([(0, r.to_vec()), (copy_ms, r.to_vec())]));
                let wire = &mut wire(motors, doubt, Box::new(twice));
                let context = std::format!("{motors} motors, again after {copy_ms} ms, {doubt:?}");
                stops_are_true(wire, &context, true);
            }
        }
    }
}

#[test]
fn a_late_reply_counts_for_no_other_motor() {
    for late_ms in [60, 90, 110, 150, 200, 250, 290] {
        for motors in [1, 2, 3] {
            for doubt in [None, Some(1), Some(77)] {
                let late = move |_, r: &[u8]| Some(Vec::from([(late_ms, r.to_vec())]));
                let wire = &mut wire(motors, doubt, Box::new(late));
                // The first stop of motor 0 belongs to no other request; later ones are checked for refusals.
                let context = std::format!("{motors} motors, late by {late_ms} ms, {doubt:?}");
                stops_are_true(wire, &context, false);
            }
        }
    }
}

/// Replies to an earlier program count for no motor either.
#[test]
fn a_reply_to_an_earlier_program_counts_for_no_motor() {
    for seed in 0..40 {
        for at_ms in [20, 30, 60] {
            for (motor, status, own) in
                [(1, Status::Ok, Err(INVALID_VALUE)), (0, Status::InvalidValue, Ok(()))]
            {
                let mut wire = wire(1, Some(seed), super::pair::no_fault());
                let opcode = Opcode::Mst;
                let reply = Reply { host: 2, module: MODULE, status, opcode, value: 0 };
                wire.to_host.push((wire.now.plus_ms(at_ms), reply.emit().to_vec()));
                wire.firmware.pause = 40;
                let ended = wire.request(stop(motor)).map(drop);
                assert_eq!(ended, own, "seed {seed}, {at_ms} ms, motor {motor}");
            }
        }
    }
}

/// Whatever is in doubt, the stop of each motor goes out at once.
#[test]
fn a_stop_of_any_motor_waits_for_no_probe() {
    let mut wire = wire(4, Some(3), super::pair::no_fault());
    for motor in 0..4 {
        let already = wire.firmware.done.len();
        assert_eq!(wire.host.submit(wire.now, Ticket(90), stop(motor)), Ok(()));
        wire.rest(15);
        let done = wire.firmware.done[already..].first();
        assert_eq!(done.map(|request| request.motor), Some(motor));
        wire.rest(500);
        while wire.host.poll_event().is_some() {}
    }
}
