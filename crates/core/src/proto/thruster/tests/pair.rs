//! Host and device on one virtual bus: what happens when frames are lost, late, doubled or refused.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use crate::error::Failure;
use crate::medium::{Can, Frame};
use crate::proto::HostOptions;
use crate::proto::thruster::device::{CanEnd, Firmware, Quirks, Response, Telemetry};
use crate::proto::thruster::fault;
use crate::proto::thruster::host::CanHost;
use crate::proto::thruster::readings::Readings;
use crate::proto::thruster::rules::class_of;
use crate::proto::thruster::session::{Answer, Ask};
use crate::proto::thruster::wire::{Command, REFUSED, Reply, Request};
use crate::station::{Class, Host, LineEvent, Station, Ticket, Timed, To};
use crate::time::{Instant, earliest};

/// What a fault makes of the n-th frame of its way: when it arrives, ms, as often as listed.
type Fault = Box<dyn Fn(u32) -> Option<Vec<u32>>>;

fn sound() -> Fault {
    Box::new(|_| None)
}

fn on(nth: u32, what: &'static [u32]) -> Fault {
    Box::new(move |n| (n == nth).then(|| what.to_vec()))
}

/// A drive that notes what it is told and has a number for every question.
#[derive(Default)]
struct Notes {
    id: u8,
    done: Vec<Request>,
    faults: u16,
    refuses: bool,
}

impl Firmware for Notes {
    fn id(&self) -> u8 {
        self.id
    }
    fn bit_rate(&self) -> u32 {
        500_000
    }
    fn reports(&self) -> (u8, u16) {
        (0, 0)
    }
    fn heard(&mut self, _now: Instant, request: &Request) {
        self.done.push(*request);
    }
    fn execute(&mut self, _now: Instant, request: &Request) -> Response {
        match request.command {
            Command::EF => Response::Value(self.faults.into()),
            Command::QV => Response::Value(self.done.len() as u32),
            Command::QP => Response::Value(480),
            Command::QC | Command::QT | Command::EQ => Response::Value(7),
            _ if self.refuses => Response::Refused,
            _ => Response::Done,
        }
    }
    fn telemetry(&self) -> Telemetry {
        Telemetry { rpm: 499, decivolt: 466, faults: self.faults, ..Telemetry::default() }
    }
}

struct Wire {
    now: Instant,
    host: CanHost,
    ends: Vec<(CanEnd, Notes)>,
    to_host: Vec<(Instant, Frame)>,
    to_drive: Vec<(Instant, Frame)>,
    requests: Fault,
    replies: Fault,
    counts: [u32; 2],
    tickets: u32,
    told: Vec<(u32, Answer)>,
}

impl Wire {
    fn new() -> Self {
        let end = |id| {
            let notes = Notes { id, ..Notes::default() };
            (CanEnd::new(Quirks::default(), &notes), notes)
        };
        Self {
            now: Instant::ZERO.plus_ms(1),
            host: CanHost::new(&HostOptions::new(0)),
            ends: Vec::from([end(11), end(12)]),
            to_host: Vec::new(),
            to_drive: Vec::new(),
            requests: sound(),
            replies: sound(),
            counts: [0; 2],
            tickets: 0,
            told: Vec::new(),
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

    fn submit(&mut self, ask: Ask) -> Ticket {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        let limit = self.now.plus_ms(2_000);
        while self.host.submit(self.now, ticket, ask).is_err() {
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
                    (To::Ticket(ended), result) if ended == ticket => return result,
                    (To::Address(address), Ok(answer)) => self.told.push((address, answer)),
                    other => panic!("{other:?}"),
                }
            }
            assert!(self.now < limit, "no end: {:?}", self.host);
            self.step(limit);
        }
    }

    fn ask(&mut self, ask: Ask) -> Result<Answer, Failure> {
        let ticket = self.submit(ask);
        self.end(ticket)
    }

    fn done(&self, command: Command) -> usize {
        self.ends[0].1.done.iter().filter(|request| request.command == command).count()
    }

    fn notes(&mut self) -> &mut Notes {
        &mut self.ends[0].1
    }
}

fn ask(request: Request) -> Ask {
    Ask { id: 11, class: class_of(&request), request, readings: Readings::default() }
}

fn plain(command: Command) -> Ask {
    ask(Request::plain(command))
}

fn with(command: Command, value: i16) -> Ask {
    ask(Request::with(command, value.cast_unsigned()))
}

fn lr() -> Ask {
    ask(Request { command: Command::LR, sub: 30, data: Some(100) })
}

fn value(answer: Result<Answer, Failure>) -> u32 {
    match answer {
        Ok(Answer::Reply(reply)) => reply.data,
        other => panic!("{other:?}"),
    }
}

#[test]
fn requests_have_the_class_that_fits_them() {
    for (asked, class) in [
        (plain(Command::QP), Class::Idempotent),
        (with(Command::TC, 0), Class::Stop),
        (with(Command::VC, 0), Class::Stop),
        (plain(Command::LS), Class::Stop),
        (with(Command::TC, 5), Class::Never),
        (with(Command::VC, -500), Class::Never),
        (lr(), Class::Never),
        (with(Command::VM, 0x100), Class::Confirm),
        (plain(Command::CF), Class::Confirm),
        (with(Command::CI, 5), Class::Never),
        (plain(Command::AZ), Class::Never),
    ] {
        assert_eq!(asked.class, class, "{asked:?}");
    }
}

#[test]
fn a_lost_or_late_reply_gives_no_wrong_value_and_no_error() {
    type Disturbed = fn() -> Fault;
    let all: [(&str, Disturbed, Disturbed); 6] = [
        ("sound", sound, sound),
        ("request lost", || on(3, &[]), sound),
        ("reply lost", sound, || on(3, &[])),
        ("reply late", sound, || on(3, &[70])),
        ("reply very late", sound, || on(3, &[120])),
        ("reply doubled", sound, || on(3, &[0, 5])),
    ];
    for (name, requests, replies) in all {
        let mut wire = Wire::new();
        (wire.requests, wire.replies) = (requests(), replies());
        for n in 0..20 {
            let command = [Command::QP, Command::QT, Command::QV, Command::EQ][n % 4];
            let before = wire.ends[0].1.done.len() as u32;
            let told = value(wire.ask(plain(command)));
            match command {
                Command::QP => assert_eq!(told, 480, "{name}"),
                // QV tells how much was asked before: an older answer would be smaller.
                Command::QV => assert!(told > before, "{name}: {told} after {before}"),
                _ => assert_eq!(told, 7, "{name}"),
            }
            wire.rest(10);
        }
        assert_eq!(wire.host.counters().silent, 0, "{name}");
    }
}

#[test]
fn a_late_answer_is_not_taken_for_the_next() {
    let mut wire = Wire::new();
    assert_eq!(value(wire.ask(plain(Command::QV))), 1);
    // All three tries are answered, but late.
    wire.replies = Box::new(|n| (2..=4).contains(&n).then(|| Vec::from([140])));
    let first = wire.ask(plain(Command::QV));
    assert!(first.is_err() || first.is_ok_and(|a| matches!(a, Answer::Reply(r) if r.data >= 2)));
    wire.replies = sound();
    let before = wire.ends[0].1.done.len() as u32;
    assert!(value(wire.ask(plain(Command::QV))) > before);
}

#[test]
fn a_relative_move_is_never_sent_twice() {
    for (requests, replies) in
        [(on(2, &[]), sound()), (sound(), on(2, &[])), (sound(), on(2, &[200]))]
    {
        let mut wire = Wire::new();
        (wire.requests, wire.replies) = (requests, replies);
        assert_eq!(value(wire.ask(plain(Command::QP))), 480);
        assert_eq!(wire.ask(lr()), Err(Failure::Silent));
        wire.rest(500);
        assert!(wire.done(Command::LR) <= 1);
        assert_eq!(value(wire.ask(plain(Command::QP))), 480);
    }
    // A doubled reply ends one move, not two.
    let mut wire = Wire::new();
    wire.replies = on(1, &[0, 1]);
    assert!(wire.ask(lr()).is_ok());
    wire.rest(5);
    wire.requests = on(2, &[]);
    assert_eq!(wire.ask(lr()), Err(Failure::Silent));
    assert_eq!(wire.host.counters().late, 1);
}

#[test]
fn a_refusal_is_explained_by_the_fault_word() {
    let mut wire = Wire::new();
    wire.notes().refuses = true;
    wire.notes().faults = fault::STALL;
    let code = u32::from(fault::STALL);
    assert_eq!(wire.ask(with(Command::TC, 5)), Err(Failure::Faulted { code }));
    assert_eq!((wire.done(Command::TC), wire.done(Command::EF)), (1, 1));
    assert!(matches!(wire.told[..], [(11, Answer::Reply(Reply { data: 0x40, .. }))]));
    // A stop is refused because there is no output.
    let off = Answer::Off { faults: fault::STALL };
    assert_eq!(wire.ask(with(Command::TC, 0)), Ok(off));
    // No fault, or one that only reports: it was the value.
    for faults in [0, fault::UNDER_VOLTAGE] {
        wire.notes().faults = faults;
        assert_eq!(wire.ask(with(Command::CI, 5)), Err(Failure::Refused { code: REFUSED }));
    }
    assert_eq!(wire.ask(plain(Command::QA)), Err(Failure::Refused { code: REFUSED }));
}

#[test]
fn what_comes_back_changed_was_not_accepted() {
    let mut wire = Wire::new();
    let ticket = wire.submit(with(Command::TC, 5));
    wire.transmit();
    wire.to_drive.clear();
    wire.notes().faults = fault::OVER_CURRENT;
    let stopped = Reply { command: Command::TC, sub: 0, data: 0 };
    wire.to_host.push((wire.now, stopped.frame(11)));
    let code = u32::from(fault::OVER_CURRENT);
    assert_eq!(wire.end(ticket), Err(Failure::Faulted { code }));
}

#[test]
fn the_forms_of_vm_are_all_understood() {
    let mut wire = Wire::new();
    let vm = |value: i16| with(Command::VM, value);
    assert!(wire.ask(vm(0x0100)).is_ok());
    assert!(matches!(wire.ask(with(Command::VC, 500)), Ok(Answer::Bare(bare)) if bare.rpm == 499));
    assert!(wire.ask(vm(0x0007)).is_ok());
    wire.told.clear();
    let told = wire.ask(with(Command::TC, 5));
    assert!(matches!(told, Ok(Answer::Report(report)) if report.part == 3), "{told:?}");
    assert_eq!(wire.told.len(), 3, "each report is told");
    // The status in it says that there is no output.
    assert!(wire.ask(vm(0x0002)).is_ok());
    wire.notes().faults = fault::ZERO_POINT;
    assert_eq!(wire.ask(with(Command::TC, 5)), Err(Failure::Faulted { code: 0x0400 }));
    wire.notes().faults = 0;
    // Silence is no loss: a fault word behind the request proves that it arrived.
    assert!(wire.ask(vm(0x0200)).is_ok());
    let before = wire.done(Command::EF);
    assert_eq!(wire.ask(with(Command::TC, 5)), Ok(Answer::Proven));
    assert_eq!(wire.done(Command::EF), before + 1);
    wire.notes().faults = fault::STALL;
    assert_eq!(wire.ask(with(Command::TC, 5)), Err(Failure::Faulted { code: 0x40 }));
    let off = Answer::Off { faults: fault::STALL };
    assert_eq!(wire.ask(with(Command::TC, 0)), Ok(off));
    assert_eq!((wire.done(Command::TC), wire.host.counters().silent), (5, 0));
    // A host that does not know of the form takes a report for an answer, too.
    let mut wire = Wire::new();
    assert!(wire.ask(vm(0x0100)).is_ok());
    wire.host = CanHost::new(&HostOptions::new(0));
    assert!(matches!(wire.ask(with(Command::VC, 500)), Ok(Answer::Bare(_))));
}

#[test]
fn a_swapped_reply_to_vm_is_accepted() {
    let mut wire = Wire::new();
    let quirks = Quirks { swaps_vm: true, ..Quirks::default() };
    let notes = Notes { id: 11, ..Notes::default() };
    wire.ends[0] = (CanEnd::new(quirks, &notes), notes);
    assert!(wire.ask(with(Command::VM, 0x0100)).is_ok());
    assert!(matches!(wire.ask(with(Command::VC, 500)), Ok(Answer::Bare(_))));
}

#[test]
fn drives_do_not_wait_for_each_other() {
    let mut wire = Wire::new();
    let twelve = Ask { id: 12, ..plain(Command::QP) };
    let absent = Ask { id: 13, ..plain(Command::QP) };
    let first = wire.submit(absent);
    assert_eq!(value(wire.ask(twelve)), 480);
    assert!(wire.now < Instant::ZERO.plus_ms(5));
    assert_eq!(wire.end(first), Err(Failure::Silent));
    // One at a time of one drive.
    wire.submit(plain(Command::QP));
    assert!(wire.host.submit(wire.now, Ticket(99), plain(Command::QT)).is_err());
    assert!(wire.host.submit(wire.now, Ticket(99), twelve).is_ok());
}

#[test]
fn a_stop_is_let_in_at_any_time() {
    let mut wire = Wire::new();
    assert_eq!(value(wire.ask(plain(Command::QP))), 480);
    wire.replies = Box::new(|n| (2..40).contains(&n).then(Vec::new));
    // While something is out: at once, and the other one ends as it does.
    let first = wire.submit(with(Command::TC, 50));
    wire.rest(1);
    let stop = wire.submit(with(Command::TC, 0));
    wire.rest(1);
    assert_eq!(wire.done(Command::TC), 2);
    assert_eq!(wire.end(first), Err(Failure::Silent));
    assert_eq!(wire.end(stop), Err(Failure::Silent));
    assert_eq!(wire.done(Command::TC), 4, "the stop was sent three times, the start once");
    // In doubt: nothing else.
    let query = plain(Command::QP);
    assert_eq!(wire.host.submit(wire.now, Ticket(99), query), Err(query));
    let stop = wire.submit(plain(Command::LS));
    wire.replies = sound();
    assert!(wire.end(stop).is_ok());
    assert_eq!(value(wire.ask(query)), 480);
}

/// Swarm can:11986: on a full bus the reply to a query came late, and a stop had taken its second
/// chance from it.
#[test]
fn a_query_that_a_stop_cuts_short_ends_as_that() {
    let mut wire = Wire::new();
    assert_eq!(value(wire.ask(plain(Command::QP))), 480);
    wire.replies = on(2, &[]);
    let query = wire.submit(plain(Command::QP));
    wire.rest(1);
    let stop = wire.submit(with(Command::TC, 0));
    assert!(wire.end(stop).is_ok());
    assert_eq!(wire.end(query), Err(Failure::Cancelled));
    assert_eq!(wire.done(Command::QP), 2, "not asked again");
}

#[test]
fn the_late_echo_of_a_start_is_not_the_answer_to_a_stop() {
    let mut wire = Wire::new();
    // The echo of TC 50 comes behind its timeout, when the stop is out; the stop is lost once.
    wire.replies = on(1, &[60]);
    assert_eq!(wire.ask(with(Command::TC, 50)), Err(Failure::Silent));
    wire.requests = on(2, &[]);
    assert!(wire.ask(with(Command::TC, 0)).is_ok());
    let last = wire.ends[0].1.done.iter().rfind(|request| request.command == Command::TC);
    assert_eq!(last.and_then(|request| request.data), Some(0), "it was sent again");
}

#[test]
fn a_dead_link_ends_everything_and_feeds_nobody() {
    let mut wire = Wire::new();
    assert!(wire.ask(with(Command::ST, 300)).is_ok());
    wire.rest(350);
    assert!(wire.done(Command::EF) >= 3, "fed three times in its time");
    let open = wire.submit(with(Command::TC, 5));
    wire.host.handle_line(wire.now, LineEvent::Down);
    assert_eq!(wire.end(open), Err(Failure::LinkDown));
    assert_eq!(wire.ask(plain(Command::QP)), Err(Failure::LinkDown));
    wire.host.handle_line(wire.now, LineEvent::Up);
    let fed = wire.done(Command::EF);
    wire.rest(1000);
    assert_eq!(wire.done(Command::EF), fed);
}

#[test]
fn foreign_frames_are_passed_over() {
    let mut wire = Wire::new();
    let ticket = wire.submit(plain(Command::QP));
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

/// A reply that is disturbed in its last bit is heard twice, the second time before the next request
/// can have left (swarm seed can:187).
#[test]
fn a_copy_that_comes_too_soon_is_no_answer() {
    let mut wire = Wire::new();
    wire.host = CanHost::new(&HostOptions::new(500_000));
    let ticket = wire.submit(plain(Command::QP));
    wire.transmit();
    wire.to_drive.clear();
    let copy = Reply { command: Command::QP, sub: 0, data: 1 };
    wire.host.handle_input(wire.now.plus_ns(240_000), &copy.frame(11));
    assert!(wire.host.poll_event().is_none());
    wire.to_host.push((wire.now.plus_ms(1), Reply { data: 480, ..copy }.frame(11)));
    let answer = wire.end(ticket);
    assert!(matches!(answer, Ok(Answer::Reply(Reply { data: 480, .. }))), "{answer:?}");
}
