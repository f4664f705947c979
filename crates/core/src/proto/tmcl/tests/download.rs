//! Download mode on a wire that loses replies: a module stores whatever it gets between 132 and 133.

extern crate std;

use core::cell::RefCell;
use std::boxed::Box;
use std::rc::Rc;
use std::vec::Vec;

use super::pair::{TestWire, request};
use crate::error::{Failure, Unsupported};
use crate::proto::HostOptions;
use crate::proto::tmcl::device::Quirks;
use crate::proto::tmcl::host_request::Storing;
use crate::proto::tmcl::{Answer, HostRequest, Opcode, Request, SerialHost, Status};
use crate::station::RequestClass;

const STORED: Failure = Failure::Refused { code: Status::Loaded.number() as u32 };

fn instruction(opcode: Opcode, motor: u8) -> HostRequest {
    HostRequest {
        class: RequestClass::NoRetry,
        storing: Storing::Required,
        ..HostRequest::of(Request { motor, ..request(opcode, 0, 0) })
    }
}

fn reading() -> HostRequest {
    HostRequest { storing: Storing::Never, ..HostRequest::of(request(Opcode::Gap, 1, 0)) }
}

/// A wire that loses the replies of those numbers, and the opcodes of the requests that passed.
fn wire(lost: &'static [u32]) -> (TestWire, Rc<RefCell<Vec<u8>>>) {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: Some(5), ..HostOptions::new(9600) });
    let opcodes = Rc::new(RefCell::new(Vec::new()));
    let seen = opcodes.clone();
    wire.requests = Box::new(move |_, bytes| {
        seen.borrow_mut().push(bytes[1]);
        None
    });
    wire.replies = Box::new(move |n, _| lost.contains(&n).then(Vec::new));
    (wire, opcodes)
}

fn begin(wire: &mut TestWire) {
    // Its address is proven before 132 is sent.
    wire.read(1).expect("a reply");
    wire.request(HostRequest::of(request(Opcode::DownloadStart, 0, 0))).expect("download mode");
}

/// Requests of which nothing is stored are not sent, whatever was lost before.
#[test]
fn a_lost_reply_brings_no_probe_into_the_program() {
    for lost in [&[][..], &[6], &[7], &[6, 8]] {
        let (mut wire, opcodes) = wire(lost);
        begin(&mut wire);
        let from = opcodes.borrow().len();
        let mut answered = 0;
        for motor in [0, 1, 2, 0] {
            let ended = wire.request(instruction(Opcode::Mst, motor));
            answered += usize::from(matches!(ended, Ok(Answer::Reply(_))));
            assert_eq!(wire.request(reading()), Err(STORED));
            // Time for probes, were there any.
            wire.rest(50);
        }
        let stored = wire.firmware.program.clone().expect("download mode");
        let motors: Vec<u8> = stored.iter().map(|stored| stored.motor).collect();
        assert_eq!(motors, [0, 1, 2, 0], "{lost:?}");
        assert_eq!(opcodes.borrow()[from..], [Opcode::Mst.number(); 4], "{lost:?}");
        assert!(answered + lost.len() >= 4, "{lost:?}: {answered}");
        wire.request(HostRequest::of(request(Opcode::DownloadEnd, 0, 0))).expect("it ended");
        assert_eq!(wire.read(1), Ok(1007), "{lost:?}");
        assert_eq!(wire.firmware.done, [], "{lost:?}: nothing was executed");
    }
}

/// Instructions that a request with the same opcode would be waited for differently: 136 has a text, 242 no reply.
#[test]
fn a_stored_request_is_answered_as_any_other() {
    let (mut wire, _) = wire(&[]);
    begin(&mut wire);
    for opcode in
        [Opcode::Version, Opcode::Boot, Opcode::ReadMemory, Opcode::PositionReached, Opcode::Mst]
    {
        let answer = wire.request(instruction(opcode, 3));
        let Ok(Answer::Reply(reply)) = answer else { panic!("{opcode:?}: {answer:?}") };
        assert_eq!((reply.status, reply.opcode), (Status::Loaded, opcode));
    }
}

#[test]
fn an_instruction_is_not_sent_to_a_module_that_would_execute_it() {
    let (mut wire, opcodes) = wire(&[]);
    let forbidden = |ended| matches!(ended, Err(Failure::Impossible(Unsupported::Forbidden(_))));
    assert!(forbidden(wire.request(instruction(Opcode::Ror, 0))));
    begin(&mut wire);
    wire.request(instruction(Opcode::Ror, 0)).expect("stored");
    // Another host ends the mode: the next instruction is executed, and no further one is sent.
    wire.firmware.program = None;
    wire.request(instruction(Opcode::Mst, 0)).expect("executed");
    let sent = opcodes.borrow().len();
    assert!(forbidden(wire.request(instruction(Opcode::Ror, 0))));
    assert_eq!(opcodes.borrow().len(), sent);
}

/// Without a reply to 133 the module is taken for one that executes, so that stops are sent.
#[test]
fn a_stop_is_sent_after_133_was_not_answered() {
    let (mut wire, opcodes) = wire(&[7, 8, 9]);
    begin(&mut wire);
    wire.request(instruction(Opcode::Ror, 0)).expect("stored");
    let stop =
        HostRequest { storing: Storing::Never, ..HostRequest::of(request(Opcode::Mst, 0, 0)) };
    assert_eq!(wire.request(stop), Err(STORED), "133 comes first");
    let end = HostRequest {
        class: RequestClass::Stop,
        ..HostRequest::of(request(Opcode::DownloadEnd, 0, 0))
    };
    let ended = wire.request(end);
    let from = opcodes.borrow().len();
    let stopped = wire.request(stop);
    assert!(opcodes.borrow()[from..].contains(&Opcode::Mst.number()), "{ended:?} {stopped:?}");
}
