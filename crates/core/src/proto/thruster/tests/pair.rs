//! Host and device on one virtual bus: what happens when frames are lost, late, doubled or refused.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use crate::error::Failure;
use crate::medium::{Can, Frame};
use crate::proto::HostOptions;
use crate::proto::thruster::device::{CanEndpoint, Firmware, Quirks, Response, TelemetryValues};
use crate::proto::thruster::fault;
use crate::proto::thruster::host::CanHost;
use crate::proto::thruster::interpretation::Interpretation;
use crate::proto::thruster::rules::class_of;
use crate::proto::thruster::session::{Answer, HostRequest};
use crate::proto::thruster::wire::{CommandWord, REFUSED, Reply, Request};
use crate::station::{EventSubject, Host, LineEvent, RequestClass, Station, Ticket, Timed};
use crate::time::{Instant, earliest};

/// Fault of a wire for the n-th frame of its direction: times of arrival, ms, one for each copy.
type FrameFault = Box<dyn Fn(u32) -> Option<Vec<u32>>>;

fn no_fault() -> FrameFault {
    Box::new(|_| None)
}

fn fault_on(nth: u32, what: &'static [u32]) -> FrameFault {
    Box::new(move |n| (n == nth).then(|| what.to_vec()))
}

/// A drive that records its requests and has a number for every query.
#[derive(Default)]
struct RecordingDrive {
    id: u8,
    done: Vec<Request>,
    faults: u16,
    refuses: bool,
}

impl Firmware for RecordingDrive {
    fn id(&self) -> u8 {
        self.id
    }
    fn bit_rate(&self) -> u32 {
        500_000
    }
    fn report_settings(&self) -> (u8, u16) {
        (0, 0)
    }
    fn note_request(&mut self, _now: Instant, request: &Request) {
        self.done.push(*request);
    }
    fn execute(&mut self, _now: Instant, request: &Request) -> Response {
        match request.command {
            CommandWord::EF => Response::Value(self.faults.into()),
            CommandWord::QV => Response::Value(self.done.len() as u32),
            CommandWord::QP => Response::Value(480),
            CommandWord::QC | CommandWord::QT | CommandWord::EQ => Response::Value(7),
            _ if self.refuses => Response::Refused,
            _ => Response::Done,
        }
    }
    fn telemetry(&self) -> TelemetryValues {
        TelemetryValues {
            rpm: 499,
            decivolt: 466,
            faults: self.faults,
            ..TelemetryValues::default()
        }
    }
}

struct TestWire {
    now: Instant,
    host: CanHost,
    ends: Vec<(CanEndpoint, RecordingDrive)>,
    to_host: Vec<(Instant, Frame)>,
    to_drive: Vec<(Instant, Frame)>,
    requests: FrameFault,
    replies: FrameFault,
    counts: [u32; 2],
    tickets: u32,
    unsolicited: Vec<(u32, Answer)>,
}

impl TestWire {
    fn new() -> Self {
        let end = |id| {
            let notes = RecordingDrive { id, ..RecordingDrive::default() };
            (CanEndpoint::new(Quirks::default(), &notes), notes)
        };
        Self {
            now: Instant::ZERO.plus_ms(1),
            host: CanHost::new(&HostOptions::new(0)),
            ends: Vec::from([end(11), end(12)]),
            to_host: Vec::new(),
            to_drive: Vec::new(),
            requests: no_fault(),
            replies: no_fault(),
            counts: [0; 2],
            tickets: 0,
            unsolicited: Vec::new(),
        }
    }

    fn transmit(&mut self) {
        let mut frame = Frame::default();
        while self.host.poll_transmit(self.now, &mut frame).is_some() {
            self.counts[0] += 1;
            for ms in (self.requests)(self.counts[0]).unwrap_or_else(|| Vec::from([0])) {
                self.to_drive.push((self.now.plus_ns(200_000).plus_ms(ms), frame));
            }
        }
        for (end, _) in &mut self.ends {
            while let Some(frame) = end.poll_transmit() {
                self.counts[1] += 1;
                for ms in (self.replies)(self.counts[1]).unwrap_or_else(|| Vec::from([0])) {
                    self.to_host.push((self.now.plus_ns(200_000).plus_ms(ms), frame));
                }
            }
        }
        self.to_host.sort_by_key(|(at, _)| *at);
        self.to_drive.sort_by_key(|(at, _)| *at);
    }

    fn step(&mut self, until: Instant) {
        self.transmit();
        let first = |queue: &[(Instant, Frame)]| queue.first().map(|(at, _)| *at);
        let queued = earliest(first(&self.to_host), first(&self.to_drive));
        let next = earliest(queued, self.host.poll_timeout()).unwrap_or(until);
        self.now = next.clamp(self.now, until.max(self.now));
        while first(&self.to_host).is_some_and(|at| at <= self.now) {
            let (_, frame) = self.to_host.remove(0);
            self.host.handle_input(self.now, &frame);
        }
        while first(&self.to_drive).is_some_and(|at| at <= self.now) {
            let (_, frame) = self.to_drive.remove(0);
            for (end, notes) in &mut self.ends {
                end.handle_input(self.now, &frame, notes);
            }
        }
        self.host.handle_timeout(self.now);
        self.transmit();
    }

    fn rest(&mut self, ms: u32) {
        let until = self.now.plus_ms(ms);
        while self.now < until {
            self.step(until);
        }
    }

    fn submit(&mut self, request: HostRequest) -> Ticket {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        let limit = self.now.plus_ms(2_000);
        while self.host.submit(self.now, ticket, request).is_err() {
            assert!(self.now < limit, "never taken: {:?}", self.host);
            let until = self.now.plus_ms(1);
            self.step(until);
        }
        ticket
    }

    fn end(&mut self, ticket: Ticket) -> Result<Answer, Failure> {
        let limit = self.now.plus_ms(2_000);
        loop {
            while let Some((to, result)) = self.host.poll_event() {
                match (*to, *result) {
                    (EventSubject::Request(ended), result) if ended == ticket => return result,
                    (EventSubject::Unsolicited(address), Ok(answer)) => {
                        self.unsolicited.push((address, answer))
                    }
                    other => panic!("{other:?}"),
                }
            }
            assert!(self.now < limit, "no end: {:?}", self.host);
            self.step(limit);
        }
    }

    fn request(&mut self, host_request: HostRequest) -> Result<Answer, Failure> {
        let ticket = self.submit(host_request);
        self.end(ticket)
    }

    fn done(&self, command: CommandWord) -> usize {
        self.ends[0].1.done.iter().filter(|request| request.command == command).count()
    }

    fn notes(&mut self) -> &mut RecordingDrive {
        &mut self.ends[0].1
    }
}

fn host_request(request: Request) -> HostRequest {
    HostRequest {
        id: 11,
        class: class_of(&request),
        request,
        interpretation: Interpretation::default(),
    }
}

fn plain(command: CommandWord) -> HostRequest {
    host_request(Request::without_value(command))
}

fn with(command: CommandWord, value: i16) -> HostRequest {
    host_request(Request::with_value(command, value.cast_unsigned()))
}

fn lr() -> HostRequest {
    host_request(Request { command: CommandWord::LR, sub: 30, data: Some(100) })
}

fn value(answer: Result<Answer, Failure>) -> u32 {
    match answer {
        Ok(Answer::Reply(reply)) => reply.data,
        other => panic!("{other:?}"),
    }
}

#[test]
fn requests_have_the_class_that_fits_them() {
    for (request, class) in [
        (plain(CommandWord::QP), RequestClass::Idempotent),
        (with(CommandWord::TC, 0), RequestClass::Stop),
        (with(CommandWord::VC, 0), RequestClass::Stop),
        (plain(CommandWord::LS), RequestClass::Stop),
        (with(CommandWord::TC, 5), RequestClass::NoRetry),
        (with(CommandWord::VC, -500), RequestClass::NoRetry),
        (lr(), RequestClass::NoRetry),
        (with(CommandWord::VM, 0x100), RequestClass::ReadBack),
        (plain(CommandWord::CF), RequestClass::ReadBack),
        (with(CommandWord::CI, 5), RequestClass::NoRetry),
        (plain(CommandWord::AZ), RequestClass::NoRetry),
    ] {
        assert_eq!(request.class, class, "{request:?}");
    }
}

#[test]
fn a_lost_or_late_reply_gives_no_wrong_value_and_no_error() {
    type Disturbed = fn() -> FrameFault;
    let all: [(&str, Disturbed, Disturbed); 6] = [
        ("sound", no_fault, no_fault),
        ("request lost", || fault_on(3, &[]), no_fault),
        ("reply lost", no_fault, || fault_on(3, &[])),
        ("reply late", no_fault, || fault_on(3, &[70])),
        ("reply very late", no_fault, || fault_on(3, &[120])),
        ("reply doubled", no_fault, || fault_on(3, &[0, 5])),
    ];
    for (name, requests, replies) in all {
        let mut wire = TestWire::new();
        (wire.requests, wire.replies) = (requests(), replies());
        for n in 0..20 {
            let command =
                [CommandWord::QP, CommandWord::QT, CommandWord::QV, CommandWord::EQ][n % 4];
            let before = wire.ends[0].1.done.len() as u32;
            let reported = value(wire.request(plain(command)));
            match command {
                CommandWord::QP => assert_eq!(reported, 480, "{name}"),
                // QV counts the queries before it: an older answer would be smaller.
                CommandWord::QV => assert!(reported > before, "{name}: {reported} after {before}"),
                _ => assert_eq!(reported, 7, "{name}"),
            }
            wire.rest(10);
        }
        assert_eq!(wire.host.counters().silent, 0, "{name}");
    }
}

#[test]
fn a_late_answer_is_not_taken_for_the_next() {
    let mut wire = TestWire::new();
    assert_eq!(value(wire.request(plain(CommandWord::QV))), 1);
    // All three tries are answered, but late.
    wire.replies = Box::new(|n| (2..=4).contains(&n).then(|| Vec::from([140])));
    let first = wire.request(plain(CommandWord::QV));
    assert!(first.is_err() || first.is_ok_and(|a| matches!(a, Answer::Reply(r) if r.data >= 2)));
    wire.replies = no_fault();
    let before = wire.ends[0].1.done.len() as u32;
    assert!(value(wire.request(plain(CommandWord::QV))) > before);
}

#[test]
fn a_relative_move_is_never_sent_twice() {
    for (requests, replies) in [
        (fault_on(2, &[]), no_fault()),
        (no_fault(), fault_on(2, &[])),
        (no_fault(), fault_on(2, &[200])),
    ] {
        let mut wire = TestWire::new();
        (wire.requests, wire.replies) = (requests, replies);
        assert_eq!(value(wire.request(plain(CommandWord::QP))), 480);
        assert_eq!(wire.request(lr()), Err(Failure::Silent));
        wire.rest(500);
        assert!(wire.done(CommandWord::LR) <= 1);
        assert_eq!(value(wire.request(plain(CommandWord::QP))), 480);
    }
    // A doubled reply ends one move, not two.
    let mut wire = TestWire::new();
    wire.replies = fault_on(1, &[0, 1]);
    assert!(wire.request(lr()).is_ok());
    wire.rest(5);
    wire.requests = fault_on(2, &[]);
    assert_eq!(wire.request(lr()), Err(Failure::Silent));
    assert_eq!(wire.host.counters().late, 1);
}

#[test]
fn a_refusal_behind_a_damaged_reply_leaves_it_open_what_was_done() {
    let mut wire = TestWire::new();
    // The bus doubles the request; the drive executes the first and refuses the second.
    wire.requests = fault_on(1, &[0, 10]);
    wire.replies = fault_on(1, &[]);
    let ticket = wire.submit(lr());
    wire.rest(5);
    assert_eq!(wire.done(CommandWord::LR), 1);
    let mut short = Reply { command: CommandWord::LR, sub: 30, data: 100 }.frame(11);
    short.len = 3;
    wire.host.handle_input(wire.now, &short);
    wire.notes().refuses = true;
    assert_eq!(wire.end(ticket), Err(Failure::Misbehaved), "swarm seed can:21007327");
}

#[test]
fn a_refusal_is_explained_by_the_fault_word() {
    let mut wire = TestWire::new();
    wire.notes().refuses = true;
    wire.notes().faults = fault::STALL;
    let code = u32::from(fault::STALL);
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Err(Failure::Faulted { code }));
    assert_eq!((wire.done(CommandWord::TC), wire.done(CommandWord::EF)), (1, 1));
    assert!(matches!(wire.unsolicited[..], [(11, Answer::Reply(Reply { data: 0x40, .. }))]));
    // A stop is refused because there is no output.
    let off = Answer::OutputOff { faults: fault::STALL };
    assert_eq!(wire.request(with(CommandWord::TC, 0)), Ok(off));
    // No fault, or one that only reports: it was the value.
    for faults in [0, fault::UNDER_VOLTAGE] {
        wire.notes().faults = faults;
        assert_eq!(wire.request(with(CommandWord::CI, 5)), Err(Failure::Refused { code: REFUSED }));
    }
    assert_eq!(wire.request(plain(CommandWord::QA)), Err(Failure::Refused { code: REFUSED }));
}

#[test]
fn a_value_echoed_changed_was_not_accepted() {
    let mut wire = TestWire::new();
    let ticket = wire.submit(with(CommandWord::TC, 5));
    wire.transmit();
    wire.to_drive.clear();
    wire.notes().faults = fault::OVER_CURRENT;
    let stopped = Reply { command: CommandWord::TC, sub: 0, data: 0 };
    wire.to_host.push((wire.now, stopped.frame(11)));
    let code = u32::from(fault::OVER_CURRENT);
    assert_eq!(wire.end(ticket), Err(Failure::Faulted { code }));
}

#[test]
fn the_forms_of_vm_are_all_understood() {
    let mut wire = TestWire::new();
    let vm = |value: i16| with(CommandWord::VM, value);
    assert!(wire.request(vm(0x0100)).is_ok());
    assert!(
        matches!(wire.request(with(CommandWord::VC, 500)), Ok(Answer::Headerless(bare)) if bare.rpm == 499)
    );
    assert!(wire.request(vm(0x0007)).is_ok());
    wire.unsolicited.clear();
    let result = wire.request(with(CommandWord::TC, 5));
    assert!(matches!(result, Ok(Answer::Report(report)) if report.part == 3), "{result:?}");
    assert_eq!(wire.unsolicited.len(), 3, "each report is told");
    // The status in it has no output.
    assert!(wire.request(vm(0x0002)).is_ok());
    wire.notes().faults = fault::ZERO_POINT;
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Err(Failure::Faulted { code: 0x0400 }));
    wire.notes().faults = 0;
    // Silence is no loss: a fault word behind the request proves that it arrived.
    assert!(wire.request(vm(0x0200)).is_ok());
    let before = wire.done(CommandWord::EF);
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Ok(Answer::Proven));
    assert_eq!(wire.done(CommandWord::EF), before + 1);
    wire.notes().faults = fault::STALL;
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Err(Failure::Faulted { code: 0x40 }));
    let off = Answer::OutputOff { faults: fault::STALL };
    assert_eq!(wire.request(with(CommandWord::TC, 0)), Ok(off));
    assert_eq!((wire.done(CommandWord::TC), wire.host.counters().silent), (5, 0));
    // A host that does not know of the form takes a report for an answer, too.
    let mut wire = TestWire::new();
    assert!(wire.request(vm(0x0100)).is_ok());
    wire.host = CanHost::new(&HostOptions::new(0));
    assert!(matches!(wire.request(with(CommandWord::VC, 500)), Ok(Answer::Headerless(_))));
}

#[test]
fn replies_that_another_host_switched_off_are_recognized() {
    let mut wire = TestWire::new();
    assert!(wire.request(with(CommandWord::VM, 0x0200)).is_ok());
    wire.host = CanHost::new(&HostOptions::new(0));
    // A command that is sent once may be lost: nothing proves that it was executed.
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Err(Failure::Silent));
    assert_eq!(wire.done(CommandWord::EF), 0);
    assert_eq!(wire.request(with(CommandWord::TC, 0)), Ok(Answer::Proven));
    let asked = wire.done(CommandWord::EF);
    assert!(asked >= 1, "{asked}");
    // From then on each is proven at once.
    let sent = wire.done(CommandWord::TC);
    assert_eq!(wire.request(with(CommandWord::TC, 5)), Ok(Answer::Proven));
    assert_eq!((wire.done(CommandWord::TC), wire.done(CommandWord::EF)), (sent + 1, asked + 1));
    // The other host switches them on again: the first reply shows it.
    let silent = core::mem::replace(&mut wire.host, CanHost::new(&HostOptions::new(0)));
    assert!(wire.request(with(CommandWord::VM, 0)).is_ok());
    wire.host = silent;
    assert!(wire.request(with(CommandWord::TC, 5)).is_ok());
    assert!(matches!(wire.request(with(CommandWord::TC, 6)), Ok(Answer::Reply(_))));
}

#[test]
fn a_swapped_reply_to_vm_is_accepted() {
    let mut wire = TestWire::new();
    let quirks = Quirks { swaps_vm: true, ..Quirks::default() };
    let notes = RecordingDrive { id: 11, ..RecordingDrive::default() };
    wire.ends[0] = (CanEndpoint::new(quirks, &notes), notes);
    assert!(wire.request(with(CommandWord::VM, 0x0100)).is_ok());
    assert!(matches!(wire.request(with(CommandWord::VC, 500)), Ok(Answer::Headerless(_))));
}

#[test]
fn drives_do_not_wait_for_each_other() {
    let mut wire = TestWire::new();
    let twelve = HostRequest { id: 12, ..plain(CommandWord::QP) };
    let absent = HostRequest { id: 13, ..plain(CommandWord::QP) };
    let first = wire.submit(absent);
    assert_eq!(value(wire.request(twelve)), 480);
    assert!(wire.now < Instant::ZERO.plus_ms(5));
    assert_eq!(wire.end(first), Err(Failure::Silent));
    // One at a time of one drive.
    wire.submit(plain(CommandWord::QP));
    assert!(wire.host.submit(wire.now, Ticket(99), plain(CommandWord::QT)).is_err());
    assert!(wire.host.submit(wire.now, Ticket(99), twelve).is_ok());
}

#[test]
fn a_stop_is_let_in_at_any_time() {
    let mut wire = TestWire::new();
    assert_eq!(value(wire.request(plain(CommandWord::QP))), 480);
    wire.replies = Box::new(|n| (2..40).contains(&n).then(Vec::new));
    // While something is out: at once, and the other one ends as it does.
    let first = wire.submit(with(CommandWord::TC, 50));
    wire.rest(1);
    let stop = wire.submit(with(CommandWord::TC, 0));
    wire.rest(1);
    assert_eq!(wire.done(CommandWord::TC), 2);
    assert_eq!(wire.end(first), Err(Failure::Silent));
    assert_eq!(wire.end(stop), Err(Failure::Silent));
    assert_eq!(wire.done(CommandWord::TC), 4, "the stop was sent three times, the start once");
    // In doubt: nothing else.
    let query = plain(CommandWord::QP);
    assert_eq!(wire.host.submit(wire.now, Ticket(99), query), Err(query));
    let stop = wire.submit(plain(CommandWord::LS));
    wire.replies = no_fault();
    assert!(wire.end(stop).is_ok());
    assert_eq!(value(wire.request(query)), 480);
}

/// Swarm can:11986: on a full bus the reply to a query came late, and a stop had taken its second
/// chance from it.
#[test]
fn a_query_that_a_stop_cuts_short_ends_as_that() {
    let mut wire = TestWire::new();
    assert_eq!(value(wire.request(plain(CommandWord::QP))), 480);
    wire.replies = fault_on(2, &[]);
    let query = wire.submit(plain(CommandWord::QP));
    wire.rest(1);
    let stop = wire.submit(with(CommandWord::TC, 0));
    assert!(wire.end(stop).is_ok());
    assert_eq!(wire.end(query), Err(Failure::Cancelled));
    assert_eq!(wire.done(CommandWord::QP), 2, "not asked again");
}

#[test]
fn the_late_echo_of_a_start_is_not_the_answer_to_a_stop() {
    let mut wire = TestWire::new();
    // The echo of TC 50 comes behind its timeout, when the stop is out; the stop is lost once.
    wire.replies = fault_on(1, &[60]);
    assert_eq!(wire.request(with(CommandWord::TC, 50)), Err(Failure::Silent));
    wire.requests = fault_on(2, &[]);
    assert!(wire.request(with(CommandWord::TC, 0)).is_ok());
    let last = wire.ends[0].1.done.iter().rfind(|request| request.command == CommandWord::TC);
    assert_eq!(last.and_then(|request| request.data), Some(0), "it was sent again");
}

#[test]
fn a_dead_link_ends_everything_and_feeds_no_watchdog() {
    let mut wire = TestWire::new();
    assert!(wire.request(with(CommandWord::ST, 300)).is_ok());
    wire.rest(350);
    assert!(wire.done(CommandWord::EF) >= 3, "fed three times in its time");
    let open = wire.submit(with(CommandWord::TC, 5));
    wire.host.handle_line(wire.now, LineEvent::Down);
    assert_eq!(wire.end(open), Err(Failure::LinkDown));
    assert_eq!(wire.request(plain(CommandWord::QP)), Err(Failure::LinkDown));
    wire.host.handle_line(wire.now, LineEvent::Up);
    let fed = wire.done(CommandWord::EF);
    wire.rest(1000);
    assert_eq!(wire.done(CommandWord::EF), fed);
}

#[test]
fn foreign_frames_are_passed_over() {
    let mut wire = TestWire::new();
    let ticket = wire.submit(plain(CommandWord::QP));
    wire.transmit();
    for (id, bytes) in [
        (0x28Cu16, &b"QP\0\0\0\0\0\x01"[..]),
        (0x28B, b"QT\0\0\0\0\0\x01"),
        (0x28B, b"QP\0\x01\0\0\0\x01"),
        (0x28B, b"QP\0\0"),
        (0x28B, b"\0\x37\0\0\0\0\0\0"),
        (0x30B, b"QP\0\0\0\0\0\x01"),
    ] {
        let frame = Frame::standard(id, bytes);
        Station::<Can>::handle_input(&mut wire.host, wire.now, &frame);
    }
    assert_eq!(value(wire.end(ticket)), 480);
    let counters = wire.host.counters();
    assert!(counters.foreign >= 2 && counters.late >= 2, "{counters:?}");
}

/// A reply that is disturbed in its last bit is received twice, the second time before the next request
/// can have left (swarm seed can:187).
#[test]
fn a_copy_that_comes_too_soon_is_no_answer() {
    let mut wire = TestWire::new();
    wire.host = CanHost::new(&HostOptions::new(500_000));
    let ticket = wire.submit(plain(CommandWord::QP));
    wire.transmit();
    wire.to_drive.clear();
    let copy = Reply { command: CommandWord::QP, sub: 0, data: 1 };
    wire.host.handle_input(wire.now.plus_ns(240_000), &copy.frame(11));
    assert!(wire.host.poll_event().is_none());
    wire.to_host.push((wire.now.plus_ms(1), Reply { data: 480, ..copy }.frame(11)));
    let answer = wire.end(ticket);
    assert!(matches!(answer, Ok(Answer::Reply(Reply { data: 480, .. }))), "{answer:?}");
}
