//! A TMCL module on CAN.

use super::{
    Answer, CanEndpoint, CanHost, Frame, HostOptions, HostRequest, Instant, Opcode, Quirks,
    Request, Status, TestFirmware, Ticket, Vec, request,
};
use crate::error::Failure;
use crate::proto::tmcl::wire::Reply;
use crate::station::{Host as _, Station as _, Timed as _};

#[test]
fn the_same_module_on_can() {
    let options = HostOptions::new(250_000);
    for eight in [false, true] {
        let mut host = CanHost::new(&options);
        if eight {
            host = host.with_eight_bytes();
        }
        let mut firmware = TestFirmware::default();
        let quirks = Quirks { eight_bytes: eight, ..Quirks::default() };
        let mut end = CanEndpoint::new(quirks, &firmware);
        let mut now = Instant(1);
        let mut send_request = |request| {
            host.submit(now, Ticket(1), HostRequest::of(request)).unwrap();
            let mut frame = Frame::default();
            host.poll_transmit(now, &mut frame).unwrap();
            assert_eq!((frame.id, frame.len), (1, if eight { 8 } else { 7 }));
            end.handle_input(now, &frame, &mut firmware);
            now = now.plus_ms(1);
            while let Some(frame) = end.poll_transmit(now, &mut firmware) {
                assert_eq!(frame.id, 2);
                host.handle_input(now, &frame);
            }
            host.poll_event().map(|(_, answer)| *answer)
        };
        let gap = send_request(request(Opcode::Gap, 1, 0));
        assert!(matches!(gap, Some(Ok(Answer::Reply(r))) if r.value == 1007), "{gap:?}");
        let version = send_request(request(Opcode::Version, 0, 0));
        assert!(matches!(version, Some(Ok(Answer::Text(v))) if v.text == *b"170V1.14"));
        let stored = send_request(request(Opcode::ReadMemory, 0, 3));
        assert!(matches!(stored, Some(Ok(Answer::Instruction(i))) if i.value == 3));
    }
}

/// Asks a module on CAN for its actual position.
pub(super) fn ask_position(host: &mut CanHost, now: Instant) {
    host.submit(now, Ticket(1), HostRequest::of(request(Opcode::Gap, 1, 0))).unwrap();
    host.poll_transmit(now, &mut Frame::default()).unwrap();
}

/// Frame of its reply.
pub(super) fn position(value: u8) -> Frame {
    Frame::standard(2, &[1, 100, 6, 0, 0, 0, value])
}

/// A reply disturbed in its last bit is received twice, the second time before the next request can
/// have left (swarm seed can:9).
#[test]
fn a_copy_on_can_that_comes_too_soon_is_no_answer() {
    let mut host = CanHost::new(&HostOptions::new(250_000));
    ask_position(&mut host, Instant(1));
    host.handle_input(Instant(1).plus_ms(1), &position(5));
    assert!(host.poll_event().is_some());
    let now = Instant(1).plus_ms(1);
    ask_position(&mut host, now);
    // 130 bits: an error frame and the reply again.
    host.handle_input(now.plus_ns(130 * 4_000), &position(5));
    assert!(host.poll_event().is_none());
    host.handle_input(now.plus_ns(250 * 4_000), &position(9));
    let answer = host.poll_event().map(|(_, answer)| *answer);
    assert!(matches!(answer, Some(Ok(Answer::Reply(r))) if r.value == 9), "{answer:?}");
}

/// Lives on, with a module that answers 1 ms after each request, until the ticket ends; what was asked, by
/// opcode, and the result. A parameter is `value`.
fn answered(
    host: &mut CanHost,
    now: &mut Instant,
    value: u8,
    mut behind_first: Option<Frame>,
) -> (Vec<u8>, Option<i32>) {
    let mut asked = Vec::new();
    host.submit(*now, Ticket(1), HostRequest::of(request(Opcode::Gap, 1, 0))).unwrap();
    for _ in 0..1_000 {
        let mut frame = Frame::default();
        if host.poll_transmit(*now, &mut frame).is_some() {
            let opcode = frame.data[0];
            asked.push(opcode);
            if let Some(late) = behind_first.take() {
                host.handle_input(now.plus_ns(60_000), &late);
            }
            *now = now.plus_ms(1);
            host.handle_input(*now, &Frame::standard(2, &[1, 100, opcode, 0, 0, 0, value]));
        }
        if let Some((_, answer)) = host.poll_event().copied() {
            let value = match answer {
                Ok(Answer::Reply(reply)) => Some(reply.value),
                _ => None,
            };
            return (asked, value);
        }
        *now = now.plus_ms(1);
        host.handle_timeout(*now);
    }
    (asked, None)
}

/// A request disturbed in its last bit is executed several times, so that as many replies come too many. After
/// the first of them the module is proven again: by a question that the next of them does not answer (swarm
/// seed can:7001069).
#[test]
fn a_module_that_replied_too_often_is_asked_for_something_else() {
    for seed in 0..64 {
        let mut now = Instant(1);
        let options = HostOptions { probe_seed: Some(seed), ..HostOptions::new(250_000) };
        let mut host = CanHost::new(&options);
        assert_eq!(answered(&mut host, &mut now, 5, None).1, Some(5), "{seed}");
        now = now.plus_ms(1);
        host.handle_input(now, &position(5));
        let (asked, value) = answered(&mut host, &mut now, 9, Some(position(5)));
        let (probes, gap) = (&asked[..asked.len() - 1], asked.last());
        assert_eq!((value, gap), (Some(9), Some(&6)), "{seed}: {asked:?}");
        assert!(!probes.is_empty() && probes[0] != 6, "{seed}: {asked:?}");
    }
}

/// Plays a module that answers in order and is asked by another host with the same reply identifier. The other host's
/// requests are sent when `other` returns one. Returns the answer to a read of parameter 208, and
/// the number of frames sent for it.
fn read_beside(mut other: impl FnMut(usize) -> Option<Request>) -> (Result<i32, Failure>, usize) {
    let mut host = CanHost::new(&HostOptions::new(250_000));
    let mut now = Instant(1);
    host.submit(now, Ticket(1), HostRequest::of(request(Opcode::Gap, 208, 0))).unwrap();
    for sent in 0..200 {
        let mut frame = Frame::default();
        let own = host.poll_transmit(now, &mut frame).map(|_| {
            assert_eq!(frame.id, 1);
            Request::parse_can(frame.bytes(), 1).expect("a request")
        });
        let others = own.and_then(|_| other(sent));
        // The other host's frame was on the bus first, although this one sees it when its own is sent.
        if let Some(asked) = others {
            host.handle_input(now, &asked.emit_can(1, false));
        }
        for asked in others.into_iter().chain(own) {
            now = now.plus_ms(2);
            let value = i32::from(asked.kind) * 1000;
            let reply =
                Reply { host: 2, module: 1, status: Status::Ok, opcode: asked.opcode, value };
            host.handle_input(now, &reply.emit_can(2, false));
        }
        match host.poll_event() {
            Some((_, Ok(Answer::Reply(reply)))) => return (Ok(reply.value), sent + 1),
            Some((_, Err(failure))) => return (Err(*failure), sent + 1),
            Some(event) => panic!("{event:?}"),
            None => now = now.plus_ms(1),
        }
        host.handle_timeout(now);
    }
    panic!("no end");
}

/// A reply names neither parameter nor host: the mode (2) that another host read was a driver's temperature.
#[test]
fn the_answer_to_another_host_with_the_same_reply_identifier_is_not_taken() {
    let position = request(Opcode::Gap, 1, 0);
    assert_eq!(read_beside(|_| None), (Ok(208_000), 1));
    assert_eq!(read_beside(|sent| (sent == 0).then_some(position)), (Ok(208_000), 3));
    // Another opcode cannot be confused, and the same question has the same answer.
    let coordinate = request(Opcode::Gco, 0, 0);
    assert_eq!(read_beside(|_| Some(coordinate)), (Ok(208_000), 1));
    assert_eq!(read_beside(|_| Some(request(Opcode::Gap, 208, 0))), (Ok(208_000), 1));
}

#[test]
fn a_read_that_is_always_contested_ends_with_an_error() {
    let position = request(Opcode::Gap, 1, 0);
    let (answer, sent) = read_beside(|_| Some(position));
    assert_eq!(answer, Err(Failure::Misbehaved));
    assert_eq!(sent, 31, "each of sixteen reads behind a probe, but the first");
}

/// The other host's request was seen just before this one's was sent, so its reply is still to come.
#[test]
fn a_request_behind_another_hosts_is_contested_until_that_is_answered() {
    let mut host = CanHost::new(&HostOptions::new(250_000));
    let mut now = Instant(1);
    ask_position(&mut host, now);
    now = now.plus_ms(1);
    host.handle_input(now, &position(5));
    assert!(host.poll_event().is_some());
    let speed = request(Opcode::Gap, 3, 0).emit_can(1, false);
    host.handle_input(now, &speed);
    ask_position(&mut host, now);
    host.handle_input(now.plus_ms(2), &position(77));
    assert!(host.poll_event().is_none(), "it may be the speed");

    let mut host = CanHost::new(&HostOptions::new(250_000));
    ask_position(&mut host, Instant(1));
    host.handle_input(now, &position(5));
    assert!(host.poll_event().is_some());
    host.handle_input(now, &speed);
    now = now.plus_ms(2);
    host.handle_input(now, &position(77));
    assert!(host.poll_event().is_none());
    ask_position(&mut host, now);
    host.handle_input(now.plus_ms(2), &position(6));
    assert!(matches!(host.poll_event(), Some((_, Ok(Answer::Reply(r)))) if r.value == 6));
}
