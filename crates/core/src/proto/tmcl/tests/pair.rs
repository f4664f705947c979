//! Host and device on one hand-made wire, with every kind of single fault.

extern crate std;

mod can;

use core::cell::Cell;
use std::boxed::Box;
use std::rc::Rc;
use std::vec::Vec;

use super::Random;
use crate::error::{Failure, Unsupported};
use crate::medium::{Frame, Stream};
use crate::proto::HostOptions;
use crate::proto::tmcl::device::{
    CanEndpoint, ChecksumErrorReply, DeferredEvent, Firmware, Quirks, Response, SerialEndpoint,
};
use crate::proto::tmcl::{
    Answer, CanHost, HostRequest, Instruction, Opcode, Request, SerialHost, Status,
};
use crate::station::{EventSubject, Host, RequestClass, Station, Ticket, Timed};
use crate::time::{Instant, earliest};
use can::{ask_position, position};

pub const MODULE: u8 = 1;

/// A module with as much behind it as the tests look at.
#[derive(Debug)]
pub struct TestFirmware {
    pub address: u8,
    pub pause: u8,
    pub baud: u32,
    pub ascii: Option<crate::proto::tmcl::device::AsciiEcho>,
    pub done: Vec<Request>,
    /// Number of motors; it refuses the stop of any other.
    pub motors: u8,
    /// A motor whose stop it does not answer.
    pub silent: Option<u8>,
    pub event: Option<i32>,
    /// Instructions stored since 132, in download mode.
    pub program: Option<Vec<Request>>,
}

impl Default for TestFirmware {
    fn default() -> Self {
        let done = Vec::new();
        let (address, motors, baud) = (MODULE, u8::MAX, 9600);
        let (ascii, silent, event, program) = (None, None, None, None);
        Self { address, pause: 0, baud, ascii, done, motors, silent, event, program }
    }
}

impl Firmware for TestFirmware {
    fn address(&self) -> u8 {
        self.address
    }
    fn host_address(&self) -> u8 {
        2
    }
    fn reply_pause_ms(&self) -> u8 {
        self.pause
    }
    fn baud(&self) -> u32 {
        self.baud
    }
    fn can_id(&self) -> u16 {
        self.address.into()
    }
    fn can_reply_id(&self) -> u16 {
        2
    }
    fn can_bit_rate(&self) -> u32 {
        250_000
    }
    fn ascii(&self) -> Option<crate::proto::tmcl::device::AsciiEcho> {
        self.ascii
    }
    fn set_ascii(&mut self, on: bool) {
        self.ascii = on.then_some(crate::proto::tmcl::device::AsciiEcho::None);
    }
    fn execute(&mut self, _: Instant, request: &Request) -> Response {
        let unknown = Response::refused(Status::InvalidCommand, request);
        match (&mut self.program, request.opcode) {
            (None, Opcode::DownloadStart) => {
                self.program = Some(Vec::new());
                return Response::ok(request.value);
            }
            (Some(_), Opcode::DownloadEnd) => {
                self.program = None;
                return Response::ok(request.value);
            }
            (Some(program), _) => {
                program.push(*request);
                return Response::Reply { status: Status::Loaded, value: request.value };
            }
            (None, _) => {}
        }
        if !request.opcode.only_reads() {
            self.done.push(*request);
        }
        match (request.opcode, request.kind) {
            (Opcode::Gap, 200..) => Response::refused(Status::WrongType, request),
            (Opcode::Gap, kind) => Response::ok(i32::from(kind) * 1000 + 7),
            (Opcode::Ggp, kind) => Response::ok(i32::from(kind) * 1000 + 9),
            (Opcode::Sgp, 66) => {
                self.address = request.value as u8;
                Response::ok(request.value)
            }
            (Opcode::Sgp, 65) => {
                self.baud = 115_200;
                Response::ok(request.value)
            }
            (Opcode::Version, 0) => Response::Text(*b"170V1.14"),
            (Opcode::Version, 1) => Response::ok(0x00AA_010E),
            (Opcode::ReadMemory, _) => Response::Instruction(Instruction {
                opcode: 5,
                kind: 4,
                motor: 0,
                value: request.value,
            }),
            (Opcode::Boot, _) => Response::Silent,
            (Opcode::Mst, _) if self.silent == Some(request.motor) => Response::Silent,
            (Opcode::Mst, _) if request.motor >= self.motors => {
                Response::refused(Status::InvalidValue, request)
            }
            (Opcode::Ror | Opcode::Rol | Opcode::Mst | Opcode::Mvp | Opcode::Sap, _)
            | (Opcode::PositionReached | Opcode::EnterAscii, _) => Response::ok(request.value),
            _ => unknown,
        }
    }
    fn poll_deferred_event(&mut self, _: Instant) -> Option<DeferredEvent> {
        let value = self.event.take()?;
        Some(DeferredEvent { opcode: Opcode::PositionReached, value })
    }
}

/// Result of a faulty wire for a run of bytes: these bytes, this many ms later.
pub type WireFault = Box<dyn FnMut(u32, &[u8]) -> Option<Vec<(u32, Vec<u8>)>>>;

pub fn no_fault() -> WireFault {
    Box::new(|_, _| None)
}

pub struct TestWire {
    pub now: Instant,
    pub host: SerialHost,
    pub end: SerialEndpoint,
    pub firmware: TestFirmware,
    pub baud: u32,
    echo: bool,
    pub to_host: Vec<(Instant, Vec<u8>)>,
    to_drive: Vec<(Instant, Vec<u8>)>,
    pub replies: WireFault,
    pub requests: WireFault,
    /// Follows the time, for faults that end.
    pub clock: Option<Rc<Cell<Instant>>>,
    counts: [u32; 2],
    tickets: u32,
}

impl TestWire {
    pub fn new(baud: u32, quirks: Quirks) -> Self {
        let firmware = TestFirmware::default();
        let options = HostOptions::new(baud);
        Self {
            now: Instant(1_000_000_000),
            host: SerialHost::new(&options),
            end: SerialEndpoint::new(quirks, &firmware),
            firmware,
            baud,
            echo: false,
            to_host: Vec::new(),
            to_drive: Vec::new(),
            replies: no_fault(),
            requests: no_fault(),
            clock: None,
            counts: [0; 2],
            tickets: 0,
        }
    }

    fn on_wire_ns(&self, bytes: usize) -> u64 {
        crate::medium::SerialLine::new_8n1(self.baud).characters_ns(bytes as u32)
    }

    fn transmit(&mut self) {
        self.clock.iter().for_each(|clock| clock.set(self.now));
        let mut out = [0; 128];
        while let Some(len) = self.host.poll_transmit(self.now, &mut out) {
            let bytes = out[..len].to_vec();
            if self.echo {
                self.to_host.push((self.now.plus_ns(self.on_wire_ns(len)), bytes.clone()));
            }
            self.counts[0] += 1;
            let parts = (self.requests)(self.counts[0], &bytes);
            for (ms, bytes) in parts.unwrap_or_else(|| Vec::from([(0, bytes)])) {
                let at = self.now.plus_ms(ms).plus_ns(self.on_wire_ns(bytes.len()));
                self.to_drive.push((at, bytes));
            }
        }
        while let Some(len) = self.end.poll_transmit(self.now, &mut out, &mut self.firmware) {
            let bytes = out[..len].to_vec();
            self.counts[1] += 1;
            let parts = (self.replies)(self.counts[1], &bytes);
            // A drive answers in order: nothing overtakes what is already on its way.
            let mut last = self.to_host.iter().map(|(at, _)| *at).max().unwrap_or(self.now);
            for (ms, bytes) in parts.unwrap_or_else(|| Vec::from([(0, bytes)])) {
                let at = self.now.plus_ms(ms).plus_ns(self.on_wire_ns(bytes.len()));
                last = last.max(at);
                self.to_host.push((last, bytes));
            }
        }
        self.to_host.sort_by_key(|(at, _)| *at);
        self.to_drive.sort_by_key(|(at, _)| *at);
    }

    /// Goes on to the next thing that happens, but not beyond `until`.
    pub fn step(&mut self, until: Instant) {
        self.transmit();
        let queued = earliest(
            self.to_host.first().map(|(at, _)| *at),
            self.to_drive.first().map(|(at, _)| *at),
        );
        let timers = earliest(self.host.poll_timeout(), self.end.poll_timeout());
        let next = earliest(queued, timers).unwrap_or(until).clamp(self.now, until);
        self.now = next.max(self.now);
        while self.to_host.first().is_some_and(|(at, _)| *at <= self.now) {
            let (_, bytes) = self.to_host.remove(0);
            self.host.handle_input(self.now, &bytes);
        }
        while self.to_drive.first().is_some_and(|(at, _)| *at <= self.now) {
            let (_, bytes) = self.to_drive.remove(0);
            self.end.handle_input(self.now, &bytes, &mut self.firmware);
        }
        self.host.handle_timeout(self.now);
        self.transmit();
        if next == until {
            self.now = until;
        }
    }

    /// Asks and waits for the end, which must come within five seconds.
    pub fn request(&mut self, host_request: HostRequest) -> Result<Answer, Failure> {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        let limit = self.now.plus_ms(5_000);
        while self.host.submit(self.now, ticket, host_request).is_err() {
            assert!(self.now < limit, "the line never opened again: {:?}", self.host);
            self.step(limit);
        }
        loop {
            while let Some((to, result)) = self.host.poll_event() {
                if *to == EventSubject::Request(ticket) {
                    return *result;
                }
            }
            assert!(self.now < limit, "no end: {:?}", self.host);
            self.step(limit);
        }
    }

    pub fn rest(&mut self, ms: u32) {
        let until = self.now.plus_ms(ms);
        while self.now < until {
            self.step(until);
        }
    }

    pub fn read(&mut self, parameter: u8) -> Result<i32, Failure> {
        match self.request(HostRequest::of(request(Opcode::Gap, parameter, 0)))? {
            Answer::Reply(reply) => Ok(reply.value),
            other => panic!("{other:?}"),
        }
    }
}

pub fn request(opcode: Opcode, kind: u8, value: i32) -> Request {
    Request { address: MODULE, opcode, kind, motor: 0, value }
}

/// Sixty reads of six parameters, as the peers are measured: wrong values and errors.
pub fn sixty_reads(wire: &mut TestWire, rest_ms: u32) -> (u32, u32) {
    let (mut wrong, mut errors) = (0, 0);
    let mut random = Random(7);
    for _ in 0..60 {
        let parameter = [1, 4, 5, 7, 9, 11][random.below(6) as usize];
        match wire.read(parameter) {
            Ok(value) => wrong += u32::from(value != i32::from(parameter) * 1000 + 7),
            Err(_) => errors += 1,
        }
        wire.rest(rest_ms);
    }
    (wrong, errors)
}

fn fault_on(nth: u32, what: impl Fn(&[u8]) -> Vec<(u32, Vec<u8>)> + 'static) -> WireFault {
    Box::new(move |n, bytes| (n == nth).then(|| what(bytes)))
}

#[test]
fn one_fault_gives_no_wrong_value_and_no_error() {
    let cut = |bytes: &[u8], n: usize| bytes[..bytes.len() - n].to_vec();
    let faults: Vec<(&str, WireFault, WireFault)> = Vec::from([
        ("none", no_fault(), no_fault()),
        ("late by 50 ms", fault_on(5, |r| Vec::from([(150, r.to_vec())])), no_fault()),
        ("lost", fault_on(5, |_| Vec::new()), no_fault()),
        ("noise before", fault_on(5, |r| Vec::from([(0, [&[0x55], r].concat())])), no_fault()),
        ("noise after", fault_on(5, |r| Vec::from([(0, [r, &[0x55]].concat())])), no_fault()),
        ("byte lost", fault_on(5, move |r| Vec::from([(0, cut(r, 1))])), no_fault()),
        ("first byte lost", fault_on(5, |r| Vec::from([(0, r[1..].to_vec())])), no_fault()),
        ("duplicated", fault_on(5, |r| Vec::from([(0, [r, r].concat())])), no_fault()),
        (
            "split",
            fault_on(5, |r| Vec::from([(0, r[..4].to_vec()), (30, r[4..].to_vec())])),
            no_fault(),
        ),
        ("request lost", no_fault(), fault_on(5, |_| Vec::new())),
        (
            "request with noise",
            no_fault(),
            fault_on(5, |r| Vec::from([(0, [&[0x55], r].concat())])),
        ),
        ("request cut", no_fault(), fault_on(5, move |r| Vec::from([(0, cut(r, 1))]))),
        (
            "request flipped",
            no_fault(),
            fault_on(5, |r| {
                let mut r = r.to_vec();
                r[2] ^= 4;
                Vec::from([(0, r)])
            }),
        ),
        (
            "four late",
            Box::new(|n, r| (5..9).contains(&n).then(|| Vec::from([(150, r.to_vec())]))),
            no_fault(),
        ),
    ]);
    let mut faults = faults;
    for (name, replies, requests) in faults.drain(..) {
        let wire = &mut TestWire::new(9600, Quirks::default());
        (wire.replies, wire.requests) = (replies, requests);
        assert_eq!(sixty_reads(wire, 5), (0, 0), "{name} {:?}", wire.host.counters());
    }
}

#[test]
fn the_same_on_a_wire_without_timing_and_with_echo() {
    for baud in [0, 115_200] {
        for echo in [false, true] {
            let late: WireFault =
                Box::new(|n, r| (n % 7 == 5).then(|| Vec::from([(150, r.to_vec())])));
            let twice = fault_on(5, |r| Vec::from([(0, [r, r].concat())]));
            for fault in [no_fault(), late, twice] {
                let mut wire = TestWire::new(baud, Quirks::default());
                (wire.echo, wire.replies) = (echo, fault);
                assert_eq!(sixty_reads(&mut wire, 5), (0, 0), "{baud} {echo}");
                let (echoed, skipped) = (wire.host.counters().echoed, wire.host.counters().skipped);
                let good = if echo { echoed >= 60 && skipped == 0 } else { echoed == 0 };
                assert!(good, "{echoed}");
            }
        }
    }
}

#[test]
fn a_read_that_a_stop_cuts_short_ends_as_that() {
    let mut wire = TestWire::new(9600, Quirks::default());
    assert_eq!(wire.read(1), Ok(1007));
    wire.replies = fault_on(2, |_| Vec::new());
    let (read, stop) = (Ticket(98), Ticket(99));
    let host_request = HostRequest::of(request(Opcode::Gap, 1, 0));
    assert_eq!(wire.host.submit(wire.now, read, host_request), Ok(()));
    wire.rest(1);
    let halt = HostRequest::of(request(Opcode::Mst, 0, 0));
    assert_eq!(wire.host.submit(wire.now, stop, halt), Ok(()));
    wire.rest(500);
    let ends: Vec<_> = std::iter::from_fn(|| wire.host.poll_event().copied()).collect();
    let of = |ticket| {
        ends.iter().find(|(to, _)| *to == EventSubject::Request(ticket)).map(|(_, end)| *end)
    };
    assert_eq!(of(read), Some(Err(Failure::Cancelled)));
    assert!(matches!(of(stop), Some(Ok(_))), "{ends:?}");
}

#[test]
fn always_just_too_late_is_never_wrong() {
    let mut wire = TestWire::new(0, Quirks::default());
    wire.replies = Box::new(|n, r| (n >= 5).then(|| Vec::from([(102, r.to_vec())])));
    let (wrong, _) = sixty_reads(&mut wire, 0);
    assert_eq!(wrong, 0);
}

#[test]
fn a_module_that_only_counts_bytes_is_brought_back() {
    for bad_sum in
        [ChecksumErrorReply::Always, ChecksumErrorReply::IfAddressed, ChecksumErrorReply::Never]
    {
        for extra in 1..9 {
            let quirks = Quirks {
                checksum_error_reply: bad_sum,
                byte_timeout_ms: None,
                ..Quirks::default()
            };
            let mut wire = TestWire::new(9600, quirks);
            assert_eq!(wire.read(4), Ok(4007));
            let junk = [0x55; 9];
            wire.end.handle_input(wire.now, &junk[..extra], &mut wire.firmware);
            let start = wire.now;
            let mut errors = 0;
            while wire.read(9) != Ok(9007) {
                errors += 1;
                assert!(errors < 8, "{bad_sum:?} {extra}: {:?}", wire.host);
            }
            let took = wire.now.since(start).as_millis();
            assert!(took < 5_000, "{bad_sum:?} {extra}: {took} ms, {errors} errors");
        }
    }
}

#[test]
fn a_relative_move_is_never_sent_twice() {
    for (replies, requests) in
        [(fault_on(2, |_| Vec::new()), no_fault()), (no_fault(), fault_on(2, |_| Vec::new()))]
    {
        let mut wire = TestWire::new(9600, Quirks::default());
        (wire.replies, wire.requests) = (replies, requests);
        assert_eq!(wire.read(1), Ok(1007));
        let mvp = HostRequest::of(request(Opcode::Mvp, 1, 500));
        assert_eq!(mvp.class, RequestClass::NoRetry);
        assert_eq!(wire.request(mvp), Err(Failure::Silent));
        assert_eq!(wire.read(4), Ok(4007));
        assert!(wire.firmware.done.len() <= 1, "{:?}", wire.firmware.done);
        assert_eq!(wire.host.counters().silent, 1);
    }
}

#[test]
fn nothing_but_a_stop_is_let_into_quarantine() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.replies = Box::new(|n, _| (2..20).contains(&n).then(Vec::new));
    assert_eq!(wire.read(1), Ok(1007));
    let ror = request(Opcode::Ror, 0, 350);
    assert_eq!(wire.request(HostRequest::of(ror)), Err(Failure::Silent));
    let read = HostRequest::of(request(Opcode::Gap, 1, 0));
    assert_eq!(wire.host.submit(wire.now, Ticket(900), read), Err(read));
    let mst = HostRequest::of(request(Opcode::Mst, 0, 0));
    assert_eq!(wire.request(mst), Err(Failure::Silent), "nobody answers the stop either");
    assert!(wire.firmware.done.iter().filter(|r| r.opcode == Opcode::Mst).count() >= 2);
    wire.replies = no_fault();
    assert!(matches!(wire.request(mst), Ok(Answer::Reply(reply)) if reply.opcode == Opcode::Mst));
    assert_eq!(wire.read(5), Ok(5007));
}

#[test]
fn a_stop_by_the_lost_opcode_is_not_answered_by_the_lost_reply() {
    let mut wire = TestWire::new(0, Quirks::default());
    // The reply to ROR 350 comes 30 ms after its timeout, when the stop ROR 0 is out.
    wire.replies = fault_on(1, |r| Vec::from([(130, r.to_vec())]));
    assert_eq!(wire.request(HostRequest::of(request(Opcode::Ror, 0, 350))), Err(Failure::Silent));
    wire.requests = fault_on(2, |_| Vec::new());
    let stop = HostRequest::of(request(Opcode::Ror, 0, 0));
    assert_eq!(stop.class, RequestClass::Stop);
    wire.counts[0] = 1;
    let answer = wire.request(stop);
    let executed = wire.firmware.done.iter().any(|r| r.value == 0);
    assert!(answer.is_err() || executed, "{answer:?}");
}

#[test]
fn special_replies() {
    let mut wire = TestWire::new(9600, Quirks::default());
    let text = wire.request(HostRequest::of(request(Opcode::Version, 0, 0)));
    assert!(matches!(text, Ok(Answer::Text(v)) if v.text == *b"170V1.14"), "{text:?}");
    let binary = wire.request(HostRequest::of(request(Opcode::Version, 1, 0)));
    assert!(matches!(binary, Ok(Answer::Reply(r)) if r.value == 0x00AA_010E), "{binary:?}");
    let stored = wire.request(HostRequest::of(request(Opcode::ReadMemory, 0, 17)));
    let expected = Instruction { opcode: 5, kind: 4, motor: 0, value: 17 };
    assert_eq!(stored, Ok(Answer::Instruction(expected)));
    let boot = wire.request(HostRequest::of(request(Opcode::Boot, 0x81, 0)));
    assert_eq!(boot, Ok(Answer::NoReply));
    let wrong = wire.request(HostRequest::of(request(Opcode::Gap, 253, 0)));
    assert_eq!(wrong, Err(Failure::Refused { code: 3 }));
    assert_eq!(wire.host.counters().silent, 0);
}

#[test]
fn the_position_event_comes_unasked() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.firmware.event = Some(1);
    assert_eq!(wire.read(1), Ok(1007), "nobody ordered the event");
    wire.rest(50);
    assert_eq!(wire.firmware.event, Some(1));
    wire.request(HostRequest::of(request(Opcode::PositionReached, 0, 1))).unwrap();
    wire.rest(50);
    let event = wire.host.poll_event().copied();
    let Some((EventSubject::Unsolicited(1), Ok(Answer::Event(reply)))) = event else {
        panic!("{event:?}")
    };
    assert_eq!((reply.status, reply.value), (Status::Event, 1));
}

#[test]
fn a_change_of_address_or_baud_answers_from_the_old_one() {
    let mut wire = TestWire::new(9600, Quirks::default());
    assert!(wire.request(HostRequest::of(request(Opcode::Sgp, 65, 7))).is_ok());
    assert_eq!(wire.end.line().baud, 115_200);
    assert!(wire.request(HostRequest::of(request(Opcode::Sgp, 66, 9))).is_ok());
    assert_eq!(wire.read(1), Err(Failure::Silent));
    let read = Request { address: 9, ..request(Opcode::Gap, 1, 0) };
    assert!(wire.request(HostRequest::of(read)).is_ok());
    let after = Quirks { settings_before_reply: true, ..Quirks::default() };
    let mut wire = TestWire::new(9600, after);
    assert_eq!(wire.request(HostRequest::of(request(Opcode::Sgp, 66, 9))), Err(Failure::Silent));
}

#[test]
fn telegram_pause_and_foreign_modules() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.firmware.pause = 20;
    let start = wire.now;
    assert_eq!(wire.read(1), Ok(1007));
    assert!(wire.now.since(start).as_millis() >= 38, "18 characters and the pause");
    let other = Request { address: 7, ..request(Opcode::Gap, 1, 0) };
    assert_eq!(wire.request(HostRequest::of(other)), Err(Failure::Silent));
    assert_eq!(wire.read(4), Ok(4007));
    let host = Request { address: 2, ..other };
    let outcome = wire.request(HostRequest::of(host));
    assert!(matches!(outcome, Err(Failure::Impossible(Unsupported::Forbidden(_)))), "{outcome:?}");
}

#[test]
fn ascii_mode_on_the_wire() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.request(HostRequest::of(request(Opcode::EnterAscii, 0, 0))).unwrap();
    let mut say = |line: &[u8]| {
        wire.end.handle_input(wire.now, line, &mut wire.firmware);
        let mut out = [0; 128];
        let len = wire.end.poll_transmit(wire.now, &mut out, &mut wire.firmware).unwrap_or(0);
        out[..len].to_vec()
    };
    assert_eq!(say(b"AGAP 3, 0\r"), b"BA 100 3007\r");
    assert_eq!(say(b"A MVP ABS, 0, -5000\r"), b"BA 100 -5000\r");
    assert_eq!(say(b"AFLY\r"), b"BA 2 0\r");
    assert_eq!(say(b"CGAP 3\r"), b"");
    assert_eq!(say(b"ABIN\r"), b"BA 100 0\r");
    assert_eq!(wire.read(4), Ok(4007));
    wire.request(HostRequest::of(request(Opcode::EnterAscii, 0, 0))).unwrap();
    let mut out = [0; 128];
    wire.end.handle_input(wire.now, b"BIN\r", &mut wire.firmware);
    let len = wire.end.poll_transmit(wire.now, &mut out, &mut wire.firmware).unwrap_or(0);
    assert_eq!(&out[..len], b"BA 100 0\r");
    assert_eq!(wire.read(4), Ok(4007));
}

/// Requests of an intruder in the program's name are answered before the program's own request can have left, or
/// a module at last replies to queries from before others kept the bus for seconds: once the bit rate was taken
/// for fiction, and each answer for the next question's (swarm seeds can:1011309, can:1084928).
#[test]
fn an_answer_that_comes_too_soon_is_no_answer_where_others_took_their_time() {
    let mut host = CanHost::new(&HostOptions::new(250_000));
    let answer = |host: &mut CanHost| match host.poll_event() {
        Some((_, Ok(Answer::Reply(reply)))) => Some(reply.value),
        Some(other) => panic!("{other:?}"),
        None => None,
    };
    let mut now = Instant(1);
    for n in 0..16 {
        ask_position(&mut host, now);
        now = now.plus_ms(1);
        host.handle_input(now, &position(n));
        assert_eq!(answer(&mut host), Some(n.into()));
    }
    // Long enough after any earlier request that none of them could own it.
    now = now.plus_ms(2_000);
    ask_position(&mut host, now);
    host.handle_input(now.plus_ns(110 * 4_000), &position(200));
    assert_eq!(answer(&mut host), None);
    now = now.plus_ns(330 * 4_000);
    host.handle_input(now, &position(20));
    assert_eq!(answer(&mut host), Some(20));
    ask_position(&mut host, now);
    host.handle_input(now.plus_ns(250 * 4_000), &position(21));
    assert_eq!(answer(&mut host), Some(21));
    assert_eq!(host.counters().early, 1);
}

/// A copy of a reply came when an answer could, and each answer then is the one to the question before: once
/// a wrong scale was read twice in this way (swarm seed can:1020091). A probe of another opcode ends that.
#[test]
fn nothing_older_is_taken_from_a_module_that_is_mistrusted() {
    let mut host = CanHost::new(&HostOptions::new(250_000));
    let mut frame = Frame::default();
    let gap = HostRequest::of(request(Opcode::Gap, 250, 0));
    let reply = |opcode, value| Frame::standard(2, &[1, 100, opcode, 0, 0, 0, value]);
    let mut now = Instant(1);
    host.submit(now, Ticket(1), gap).unwrap();
    host.poll_transmit(now, &mut frame).unwrap();
    now = now.plus_ms(1);
    host.handle_input(now, &reply(6, 167));
    assert!(host.poll_event().is_some(), "the copy is taken");
    host.quarantine_drive(now, 1);
    assert_eq!(host.submit(now, Ticket(2), gap), Err(gap));
    host.poll_transmit(now, &mut frame).unwrap();
    assert_eq!((frame.data[0], frame.data[1]), (Opcode::Version.number(), 1));
    now = now.plus_ms(1);
    host.handle_input(now, &reply(6, 99));
    assert_eq!(host.submit(now, Ticket(2), gap), Err(gap));
    host.handle_input(now.plus_ms(1), &reply(Opcode::Version.number(), 7));
    assert!(host.poll_event().is_none(), "neither is anybody's answer");
    now = now.plus_ms(2);
    assert_eq!(host.submit(now, Ticket(2), gap), Ok(()));
    host.poll_transmit(now, &mut frame).unwrap();
    assert_eq!((frame.data[0], frame.data[1]), (6, 250));
}

/// Loss, delay and repetition without corruption: then no value may ever be wrong. With corruption
/// a wrong one must have passed every check of the wire.
#[test]
fn chaos_is_never_wrong_without_corruption() {
    let (mut requested, mut failed) = (0, 0);
    for seed in 1..=150 {
        let baud = if seed % 2 == 0 { 9600 } else { 115_200 };
        let mut wire = TestWire::new(baud, Quirks::default());
        let mut random = Random(seed);
        let untimed = wire.baud == 0;
        wire.replies = Box::new(move |_, bytes| match random.below(20) {
            0 => Some(Vec::new()),
            1 => Some(Vec::from([(random.below(280) as u32, bytes.to_vec())])),
            2 if !untimed => Some(Vec::from([(0, [bytes, bytes].concat())])),
            _ => None,
        });
        let mut random = Random(seed + 1000);
        wire.requests = Box::new(move |_, _| (random.below(20) == 0).then(Vec::new));
        let mut random = Random(seed + 2000);
        for _ in 0..60 {
            let parameter = random.below(20) as u8;
            requested += 1;
            match wire.read(parameter) {
                Ok(value) => assert_eq!(value, i32::from(parameter) * 1000 + 7, "seed {seed}"),
                Err(_) => failed += 1,
            }
        }
    }
    assert!(failed * 20 < requested, "{failed} of {requested} failed");
}

#[test]
fn nothing_runs_twice_in_chaos() {
    for seed in 1..=100 {
        let mut wire = TestWire::new(115_200, Quirks::default());
        let mut random = Random(seed);
        wire.replies = Box::new(move |_, bytes| match random.below(8) {
            0 => Some(Vec::new()),
            1 => Some(Vec::from([(random.below(250) as u32, bytes.to_vec())])),
            _ => None,
        });
        for n in 0..30 {
            let answer = wire.request(HostRequest::of(request(Opcode::Mvp, 1, n)));
            let times = wire.firmware.done.iter().filter(|r| r.value == n).count();
            assert_eq!(times, 1, "seed {seed}, move {n}: {answer:?}");
        }
    }
}

#[test]
fn unplugged_ends_what_is_out() {
    let mut wire = TestWire::new(9600, Quirks::default());
    let read = HostRequest::of(request(Opcode::Gap, 1, 0));
    wire.host.submit(wire.now, Ticket(1), read).unwrap();
    wire.transmit();
    Station::<Stream>::handle_line(&mut wire.host, wire.now, crate::station::LineEvent::Down);
    assert_eq!(
        wire.host.poll_event(),
        Some(&(EventSubject::Request(Ticket(1)), Err(Failure::LinkDown)))
    );
    assert_eq!(wire.request(read), Err(Failure::LinkDown));
    Station::<Stream>::handle_line(&mut wire.host, wire.now, crate::station::LineEvent::Up);
    assert_eq!(wire.read(4), Ok(4007));
}
