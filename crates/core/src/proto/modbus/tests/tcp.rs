//! Modbus TCP: several requests at once, a stop that waits for nothing, and what a server may do wrong.

extern crate std;

use std::collections::BTreeMap;
use std::vec;
use std::vec::Vec;

use super::codec::Random;
use super::world::RegisterDrive;
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::modbus::TcpHost;
use crate::proto::modbus::device::{Framing, SerialEndpoint};
use crate::proto::modbus::host_request::{HostRequest, RequestBody};
use crate::proto::modbus::tcp::{self, Header};
use crate::proto::modbus::wire::{Function, Space, WireFormat};
use crate::station::{
    EventSubject, Host as _, LineEvent, RequestClass, Station as _, Ticket, Timed as _,
};
use crate::time::Instant;

const START: Instant = Instant(1_000_000_000);
const LATER: Instant = Instant(3_500_000_000);

fn read(unit: u8, start: u16) -> HostRequest {
    let body = RequestBody::Read { space: Space::Holding, start, count: 1 };
    HostRequest { unit, body, class: RequestClass::Idempotent }
}

fn write(unit: u8, class: RequestClass) -> HostRequest {
    HostRequest { unit, body: RequestBody::WriteRegister { address: 7, value: 9 }, class }
}

/// All frames that the host sends now.
fn sent(host: &mut TcpHost, now: Instant) -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    let mut out = [0; 520];
    while let Some(len) = host.poll_transmit(now, &mut out) {
        frames.push(out[..len].to_vec());
    }
    frames
}

/// Ticket and value of all ends, or the failure.
fn ends(host: &mut TcpHost) -> Vec<(u32, Result<i64, Failure>)> {
    let mut found = Vec::new();
    while let Some((EventSubject::Request(ticket), result)) = host.poll_event() {
        found.push((ticket.0, result.map(|answer| answer.raw())));
    }
    found
}

fn answer(request: &[u8], pdu: &[u8]) -> Vec<u8> {
    let (header, _) = tcp::decode(request).unwrap();
    let mut out = [0; 300];
    let len = tcp::emit(header, &mut out, |out| {
        out[..pdu.len()].copy_from_slice(pdu);
        pdu.len()
    });
    out[..len].to_vec()
}

#[test]
fn answers_find_their_requests_in_any_order_and_any_pieces() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    for unit in 1..=3 {
        host.submit(START, Ticket(u32::from(unit)), read(unit, 0)).unwrap();
    }
    assert!(host.submit(START, Ticket(9), read(2, 5)).is_err(), "one at a time to each unit");
    let frames = sent(&mut host, START);
    assert_eq!(frames.len(), 3);
    let mut stream: Vec<u8> = Vec::new();
    for (n, frame) in frames.iter().enumerate().rev() {
        stream.extend(answer(frame, &[3, 2, 0, n as u8]));
    }
    for byte in stream {
        host.handle_input(START, &[byte]);
    }
    assert_eq!(ends(&mut host), [(3, Ok(2)), (2, Ok(1)), (1, Ok(0))]);
    assert_eq!(host.poll_timeout(), None);
}

#[test]
fn a_stop_goes_out_beside_a_request_that_has_no_answer_yet() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    host.submit(START, Ticket(1), write(1, RequestClass::NoRetry)).unwrap();
    assert_eq!(sent(&mut host, START).len(), 1);
    host.submit(START, Ticket(2), write(1, RequestClass::Stop)).unwrap();
    let stop = sent(&mut host, START);
    assert_eq!(stop.len(), 1);
    host.handle_input(START, &answer(&stop[0], &[6, 0, 7, 0, 9]));
    assert_eq!(ends(&mut host), [(2, Ok(9))]);
    // Before others that are not sent yet, too.
    host.submit(START, Ticket(3), read(2, 0)).unwrap();
    host.submit(START, Ticket(4), write(3, RequestClass::Stop)).unwrap();
    let both = sent(&mut host, START);
    assert_eq!((both[0][6], both[1][6]), (3, 2));
}

#[test]
fn places_for_stops_are_kept() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    let taken = (1..=40)
        .filter(|unit| host.submit(START, Ticket(u32::from(*unit)), read(*unit, 0)).is_ok());
    assert_eq!(taken.count(), 12);
    for unit in 1..=4 {
        host.submit(START, Ticket(100 + u32::from(unit)), write(unit, RequestClass::Stop)).unwrap();
    }
    assert_eq!(host.recall(&write(5, RequestClass::Stop)), Some(Ticket(5)));
    host.submit(START, Ticket(105), write(5, RequestClass::Stop)).unwrap();
}

#[test]
fn a_read_is_repeated_once_and_its_late_answer_counts_and_a_write_never() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    host.submit(START, Ticket(1), read(1, 0)).unwrap();
    host.submit(START, Ticket(2), write(2, RequestClass::NoRetry)).unwrap();
    let first = sent(&mut host, START);
    host.handle_timeout(START.plus_ms(1000));
    assert_eq!(ends(&mut host), [(2, Err(Failure::Silent))]);
    let again = sent(&mut host, START.plus_ms(1000));
    assert_eq!(again.len(), 1);
    assert_ne!(again[0][..2], first[0][..2], "another transaction");
    host.handle_input(START.plus_ms(1010), &answer(&first[0], &[3, 2, 0, 42]));
    assert_eq!(ends(&mut host), [(1, Ok(42))]);
    host.handle_input(START.plus_ms(1020), &answer(&again[0], &[3, 2, 0, 43]));
    host.handle_input(START.plus_ms(1030), &answer(&first[1], &[6, 0, 7, 0, 9]));
    assert_eq!((ends(&mut host), host.counters().late), (vec![], 2));
    host.submit(LATER, Ticket(3), read(1, 0)).unwrap();
    for attempt in 0..2 {
        assert_eq!(sent(&mut host, LATER).len(), 1, "{attempt}");
        host.handle_timeout(LATER.plus_ms(1000 * (attempt + 1)));
    }
    assert_eq!(ends(&mut host), [(3, Err(Failure::Silent))]);
}

#[test]
fn a_gateway_that_reports_silence_is_no_drive_that_refuses() {
    let mut host = TcpHost::new(&HostOptions { scanning: true, ..HostOptions::new(0) });
    host.submit(START, Ticket(1), read(5, 0)).unwrap();
    let asked = sent(&mut host, START);
    host.handle_input(START, &answer(&asked[0], &[0x83, 0x0B]));
    assert_eq!(ends(&mut host), [(1, Err(Failure::Silent))]);
    assert_eq!(host.counters().relayed, 1);
    for (scanning, code, expected) in [
        (true, 2, Failure::Refused { code: 2 }),
        (true, 4, Failure::Silent),
        (false, 4, Failure::Refused { code: 4 }),
    ] {
        let mut host = TcpHost::new(&HostOptions { scanning, ..HostOptions::new(0) });
        host.submit(START, Ticket(2), read(5, 0)).unwrap();
        let asked = sent(&mut host, START);
        host.handle_input(START, &answer(&asked[0], &[0x83, code]));
        assert_eq!(ends(&mut host), [(2, Err(expected))], "{scanning} {code}");
    }
}

#[test]
fn what_is_no_answer_is_not_taken_for_one() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    host.submit(START, Ticket(1), read(5, 0)).unwrap();
    let asked = sent(&mut host, START).remove(0);
    let good = answer(&asked, &[3, 2, 0, 42]);
    let mut other_unit = good.clone();
    other_unit[6] = 9;
    let mut other_transaction = good.clone();
    other_transaction[1] ^= 0x55;
    let wrong = [
        other_unit,
        other_transaction,
        answer(&asked, &[3, 4, 0, 42, 0, 43]),
        answer(&asked, &[4, 2, 0, 42]),
        answer(&asked, &[3, 2, 0]),
        b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec(),
    ];
    for frame in wrong {
        host.handle_input(START, &frame);
        assert_eq!(ends(&mut host), [], "{frame:02X?}");
    }
    host.handle_line(START, LineEvent::Up);
    host.handle_input(START, &good);
    assert_eq!(ends(&mut host), [(1, Ok(42))]);
    let counters = host.counters();
    assert_eq!(counters.other_address, Some(9));
    assert!(counters.late == 1 && counters.foreign == 3 && counters.skipped > 0, "{counters:?}");
}

#[test]
fn a_lost_connection_ends_every_request() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    host.submit(START, Ticket(1), read(1, 0)).unwrap();
    host.submit(START, Ticket(2), write(2, RequestClass::NoRetry)).unwrap();
    sent(&mut host, START);
    host.handle_line(START, LineEvent::Down);
    let lost = Err(Failure::LinkDown);
    assert_eq!(ends(&mut host), [(1, lost), (2, lost)]);
}

#[test]
fn a_device_answers_all_that_waits_in_order() {
    let mut end = SerialEndpoint::new(Framing::Length);
    let mut drive = RegisterDrive::new(1, WireFormat::Tcp, 0);
    let mut stream = Vec::new();
    for n in 0..100_u16 {
        let mut out = [0; 300];
        let unit = if n % 2 == 0 { 1 } else { tcp::DEVICE_UNIT };
        let len = tcp::emit(Header { transaction: n, unit }, &mut out, |out| {
            out[..5].copy_from_slice(&[3, 0, n as u8, 0, 1]);
            5
        });
        stream.extend_from_slice(&out[..len]);
    }
    let (mut answers, mut out) = (Vec::new(), [0; 520]);
    for piece in stream.chunks(17) {
        end.handle_input(START, piece, &mut drive);
        while let Some(len) = end.poll_transmit(START, &mut out) {
            let (header, pdu) = tcp::decode(&out[..len]).unwrap();
            answers.push((header.transaction, pdu.to_vec()));
            end.handle_timeout(START, &mut drive);
        }
    }
    let expected = |n: u16| (n, [&[3, 2][..], &n.wrapping_mul(257).to_be_bytes()].concat());
    assert_eq!(answers, (0..100).map(expected).collect::<Vec<_>>());
    assert_eq!(end.counters().executed, 100);
    // Another unit, and a frame whose connection ended in its middle.
    end.handle_input(START, &[0, 1, 0, 0, 0, 6, 2, 3, 0, 0, 0, 1, 0, 2, 0], &mut drive);
    end.handle_input(LATER, &[0, 3, 0, 0, 0, 6, 1, 3, 0, 5, 0, 1], &mut drive);
    let len = end.poll_transmit(LATER, &mut out).unwrap();
    assert_eq!(out[..len], [0, 3, 0, 0, 0, 5, 1, 3, 2, 5, 5]);
    assert_eq!((end.counters().foreign, end.counters().skipped), (1, 3));
}

#[test]
fn a_single_write_goes_out_as_function_16_to_a_station_without_function_6() {
    let mut host = TcpHost::new(&HostOptions::new(0));
    let mut end = SerialEndpoint::new(Framing::Length);
    let mut drive = RegisterDrive::new(1, WireFormat::Tcp, 0);
    drive.lacks = Some(Function::WriteRegister);
    host.submit(START, Ticket(1), write(1, RequestClass::NoRetry)).unwrap();
    let mut out = [0; 520];
    for _ in 0..2 {
        for frame in sent(&mut host, START) {
            end.handle_input(START, &frame, &mut drive);
        }
        let len = end.poll_transmit(START, &mut out).unwrap();
        host.handle_input(START, &out[..len]);
    }
    assert_eq!(drive.writes, [(7, vec![9])]);
    assert!(matches!(ends(&mut host)[..], [(1, Ok(_))]));
}

/// A server that loses, delays, mixes up and repeats answers: whatever comes of a request is its own.
#[test]
fn no_request_gets_the_answer_of_another() {
    let (mut answered, mut silent) = (0, 0);
    for seed in 0..200 {
        let mut random = Random(seed);
        let mut host = TcpHost::new(&HostOptions::new(0));
        let mut asked: BTreeMap<u32, (u8, u16)> = BTreeMap::new();
        let (mut now, mut tickets) = (START, 0);
        let mut under_way: Vec<(Instant, Vec<u8>)> = Vec::new();
        for _ in 0..200 {
            now = now.plus_ns(random.below(150_000_000));
            let (unit, start) = (1 + random.below(20) as u8, random.below(1000) as u16);
            tickets += 1;
            if host.submit(now, Ticket(tickets), read(unit, start)).is_ok() {
                asked.insert(tickets, (unit, start));
            }
            for frame in sent(&mut host, now) {
                // The value names the request.
                let pdu = [3, 2, frame[6], frame[9].wrapping_mul(31).wrapping_add(frame[8])];
                let copies = [0, 1, 1, 1, 1, 1, 2][random.below(7) as usize];
                for _ in 0..copies {
                    let at = now.plus_ns(random.below(1_500_000_000));
                    under_way.push((at, answer(&frame, &pdu)));
                }
            }
            under_way.sort_by_key(|(at, _)| *at);
            let due = under_way.partition_point(|(at, _)| *at <= now);
            let stream: Vec<u8> = under_way.drain(..due).flat_map(|(_, frame)| frame).collect();
            let cut = random.below(stream.len() as u64 + 1) as usize;
            host.handle_input(now, &stream[..cut]);
            host.handle_input(now, &stream[cut..]);
            host.handle_timeout(now);
            for (ticket, result) in ends(&mut host) {
                let (unit, start) = asked.remove(&ticket).expect("one end of each");
                let [high, low] = start.to_be_bytes();
                let low = low.wrapping_mul(31).wrapping_add(high);
                match result {
                    Ok(raw) => assert_eq!(raw, i64::from(u16::from_be_bytes([unit, low]))),
                    Err(failure) => assert_eq!(failure, Failure::Silent),
                }
                (answered, silent) =
                    (answered + u32::from(result.is_ok()), silent + u32::from(result.is_err()));
            }
        }
        assert!(asked.len() <= 12, "none is forgotten");
    }
    assert!(answered > 10_000 && silent > 1_000, "{answered} {silent}");
}
