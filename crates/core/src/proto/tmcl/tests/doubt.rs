//! A session that begins in doubt, and ports whose baud rate is fiction.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use super::Random;
use super::pair::{MODULE, TestWire, no_fault, request, sixty_reads};
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::tmcl::device::Quirks;
use crate::proto::tmcl::{Answer, HostRequest, Opcode, Reply, SerialHost, Status};
use crate::station::{EventSubject, Host, Ticket};

/// A wire like `/dev/ttyACM0`: a baud rate is set, and the answer is there a millisecond after the request.
fn without_baud_rate(mut wire: TestWire, ms: u32) -> TestWire {
    wire.baud = 0;
    wire.replies = Box::new(move |_, reply| Some(Vec::from([(ms, reply.to_vec())])));
    wire
}

#[test]
fn replies_of_a_port_without_a_real_baud_rate_are_accepted_from_the_first_on() {
    for baud in [9_600, 115_200] {
        for doubt in [None, Some(1), Some(2), Some(77)] {
            let mut wire = without_baud_rate(TestWire::new(baud, Quirks::default()), 1);
            wire.host =
                SerialHost::new(&HostOptions { probe_seed: doubt, ..HostOptions::new(baud) });
            assert_eq!(sixty_reads(&mut wire, 5), (0, 0), "{baud} {doubt:?}");
            let counters = wire.host.counters();
            assert_eq!((counters.resent, counters.silent, counters.late), (0, 0, 0), "{baud}");
        }
    }
}

#[test]
fn a_copy_that_an_earlier_request_owns_is_not_believed_on_a_real_line() {
    let mut wire = TestWire::new(9600, Quirks::default());
    // Right behind the reply, when the next request is just leaving.
    wire.replies = Box::new(|_, r| Some(Vec::from([(0, r.to_vec()), (3, r.to_vec())])));
    assert_eq!(sixty_reads(&mut wire, 0).0, 0);
}

/// Replies to a program that has ended arrive: those of `pending`, one in this many ms.
fn sixty_reads_behind(seed: u32, every_ms: u32, pending: &[(Opcode, i32)]) -> (u32, u32) {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: Some(seed), ..HostOptions::new(9600) });
    for (n, (opcode, value)) in pending.iter().enumerate() {
        let status = Status::Ok;
        let reply = Reply { host: 2, module: MODULE, status, opcode: *opcode, value: *value };
        let at = wire.now.plus_ms(20 + every_ms * n as u32);
        wire.to_host.push((at, reply.emit().to_vec()));
    }
    sixty_reads(&mut wire, 0)
}

#[test]
fn the_reply_to_an_earlier_program_is_not_taken() {
    for seed in 0..40 {
        for every_ms in [1, 25, 60, 110, 250] {
            let gap = [(Opcode::Gap, 4_711); 3];
            assert_eq!(sixty_reads_behind(seed, every_ms, &gap).0, 0, "seed {seed}, {every_ms} ms");
        }
    }
}

/// The remaining risk: replies of just the opcodes that are drawn, in their order.
#[test]
fn only_replies_in_the_order_that_is_drawn_pass_the_probes() {
    let pending =
        [(Opcode::Version, 1), (Opcode::Ggp, 2), (Opcode::Gap, 4_711), (Opcode::Gap, 4_711)];
    let fooled = (0..200).filter(|seed| sixty_reads_behind(*seed, 25, &pending).0 > 0).count();
    assert!(fooled < 40, "{fooled} of 200");
}

#[test]
fn a_stop_passes_before_anything_is_proven() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: Some(3), ..HostOptions::new(9600) });
    let read = HostRequest::of(request(Opcode::Gap, 1, 0));
    assert_eq!(wire.host.submit(wire.now, Ticket(98), read), Ok(()));
    wire.rest(1);
    let halt = HostRequest::of(request(Opcode::Mst, 0, 0));
    assert_eq!(wire.host.submit(wire.now, Ticket(99), halt), Ok(()));
    wire.rest(15);
    assert!(wire.firmware.done.iter().any(|done| done.opcode == Opcode::Mst), "it is out at once");
    wire.rest(500);
    let ends: Vec<_> = std::iter::from_fn(|| wire.host.poll_event().copied()).collect();
    assert!(
        ends.iter().any(|(to, end)| *to == EventSubject::Request(Ticket(99)) && end.is_ok()),
        "{ends:?}"
    );
    let value = ends.iter().find_map(|(to, end)| match (to, end) {
        (EventSubject::Request(Ticket(98)), Ok(Answer::Reply(reply))) => Some(reply.value),
        _ => None,
    });
    assert_eq!(value, Some(1007), "{ends:?}");
}

#[test]
fn silence_ends_what_waits_for_a_proof() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: Some(9), ..HostOptions::new(9600) });
    wire.requests = Box::new(|_, _| Some(Vec::new()));
    assert_eq!(wire.read(1), Err(Failure::Silent));
    wire.requests = no_fault();
    assert_eq!(wire.read(1), Ok(1007));
}

/// Replies to several earlier programs come in one burst: to their probes, and to a query.
#[test]
fn a_backlog_of_earlier_programs_is_not_taken() {
    let probes = [Opcode::Version, Opcode::Ggp, Opcode::Gap, Opcode::ProgramStatus, Opcode::Gio];
    let mut fooled = 0;
    for seed in 0..1_000 {
        let mut random = Random(u64::from(seed) * 7_919 + 1);
        let mut pending = Vec::new();
        for _ in 0..4 {
            let probe = |random: &mut Random| probes[random.below(probes.len() as u64) as usize];
            pending.extend((0..3).map(|_| (probe(&mut random), 1)));
            pending.push((Opcode::Gap, 4_711));
        }
        fooled += u32::from(sixty_reads_behind(seed, 0, &pending).0 > 0);
    }
    assert!(fooled <= 20, "{fooled} of 1000");
}

/// The reply that a second module with the same address gives.
fn reply_of_twin(reply: &[u8]) -> Vec<u8> {
    let mut other = Reply::parse(reply).unwrap();
    other.value = other.value.wrapping_add(1_000_000);
    other.emit().to_vec()
}

#[test]
fn two_modules_with_one_address_give_no_value() {
    for seed in 1..40 {
        for delay_ms in [0, 1, 4, 17, 45] {
            let mut wire = TestWire::new(9600, Quirks::default());
            let doubt = HostOptions { probe_seed: Some(seed), ..HostOptions::new(9600) };
            wire.host = SerialHost::new(&doubt);
            wire.replies = Box::new(move |_, reply| {
                Some(Vec::from([(0, reply.to_vec()), (delay_ms, reply_of_twin(reply))]))
            });
            for kind in [1, 3, 1, 9] {
                assert_eq!(wire.read(kind), Err(Failure::AnsweredTwice), "{seed}, {delay_ms} ms");
            }
            let stop = HostRequest::of(request(Opcode::Mst, 0, 0));
            assert!(wire.request(stop).is_ok(), "{seed}, {delay_ms} ms");
        }
    }
}

/// An adapter that repeats a reply now and then is no second module.
#[test]
fn a_reply_that_is_repeated_now_and_then_is_believed() {
    for seed in 1..40 {
        let mut wire = TestWire::new(9600, Quirks::default());
        wire.host =
            SerialHost::new(&HostOptions { probe_seed: Some(seed), ..HostOptions::new(9600) });
        let mut count = 0_u32;
        wire.replies = Box::new(move |_, reply| {
            count += 1;
            let again = count.is_multiple_of(2).then(|| (2, reply.to_vec()));
            Some([(0, reply.to_vec())].into_iter().chain(again).collect())
        });
        assert_eq!(wire.read(1), Ok(1007), "{seed}");
    }
}
