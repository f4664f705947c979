//! The host against frames laid out by hand: the frames it sends, and its reading of those it receives.

extern crate std;

mod transfer;

use std::string::String;
use std::vec::Vec;

use crate::error::Failure;
use crate::medium::{Can, Frame};
use crate::proto::HostOptions;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::nmt::{NmtCommand, NmtMessage, NmtState};
use crate::proto::canopen::sdo::{AbortCode, ObjectIndex};
use crate::proto::canopen::{Answer, CanHost, HostRequest, lss};
use crate::station::{EventSubject, Host as _, LineEvent, RequestClass, Station, Ticket, Timed};
use crate::time::Instant;

const STATUS: ObjectIndex = ObjectIndex::new(0x6041, 0);
const CONTROL: ObjectIndex = ObjectIndex::new(0x6040, 0);
const T_MS: u32 = 200;

/// A host, its time, and the frames that it sent.
struct HostFixture {
    host: CanHost,
    now: Instant,
}

type Ended = Vec<(EventSubject, Result<Answer, Failure>)>;

impl HostFixture {
    fn new() -> Self {
        Self::with(HostOptions::new(0))
    }

    fn with(options: HostOptions) -> Self {
        Self { host: CanHost::new(&options), now: Instant::ZERO }
    }

    fn submit(&mut self, n: u32, request: HostRequest) {
        self.host.submit(self.now, Ticket(n), request).expect("taken");
    }

    /// All frames that it sends now, as in candump's log.
    fn sent_frames(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        let mut frame = Frame::default();
        while Station::<Can>::poll_transmit(&mut self.host, self.now, &mut frame).is_some() {
            lines.push(std::format!("{frame}"));
            assert!(lines.len() < 1000);
        }
        lines
    }

    fn receive(&mut self, text: &str) {
        let (id, data) = text.split_once('#').unwrap();
        let id = u16::from_str_radix(id, 16).unwrap();
        let byte = |at| u8::from_str_radix(&data[at..at + 2], 16).unwrap();
        let data: Vec<u8> = (0..data.len()).step_by(2).map(byte).collect();
        self.host.handle_input(self.now, &Frame::standard(id, &data));
    }

    fn wait(&mut self, ms: u32) {
        self.now = self.now.plus_ms(ms);
        self.host.handle_timeout(self.now);
    }

    fn events(&mut self) -> Ended {
        core::iter::from_fn(|| self.host.poll_event().copied()).collect()
    }

    fn one(&mut self) -> Result<Answer, Failure> {
        let events = self.events();
        assert_eq!(events.len(), 1, "{events:?}");
        events[0].1
    }
}

const fn read(node: u8, object: ObjectIndex) -> HostRequest {
    HostRequest::Read { node, object }
}

const fn write(object: ObjectIndex, bits: u64, len: u8, class: RequestClass) -> HostRequest {
    HostRequest::Write { node: 2, object, bits, len, class }
}

#[test]
fn nodes_are_asked_at_once_and_each_one_thing_at_a_time() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.submit(2, read(3, STATUS));
    assert!(b.host.submit(b.now, Ticket(3), read(2, CONTROL)).is_err());
    assert_eq!(b.sent_frames(), ["602#4041600000000000", "603#4041600000000000"]);
    b.receive("583#4B41600037000000");
    b.receive("582#4B41600050000000");
    let value = |bits| Ok(Answer::Value { object: STATUS, bits, len: 2 });
    assert_eq!(
        b.events(),
        [
            (EventSubject::Request(Ticket(2)), value(0x37)),
            (EventSubject::Request(Ticket(1)), value(0x50))
        ]
    );
    assert_eq!((b.host.counters().sent, b.host.counters().answered), (2, 2));
}

#[test]
fn an_answer_to_something_else_is_none() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    // Another object, another node, another service, a remote request, 29 bits.
    for foreign in ["582#4B40600037000000", "585#4B41600037000000", "582#6041600000000000"] {
        b.receive(foreign);
    }
    let remote = Frame { remote: true, ..Frame::standard(0x582, &[]) };
    b.host.handle_input(b.now, &remote);
    let wide = Frame { extended: true, ..Frame::standard(0x582, b"\x4B\x41\x60\0\x37\0\0\0") };
    b.host.handle_input(b.now, &wide);
    assert_eq!(b.events(), []);
    b.receive("582#4B41600037000000");
    assert!(b.one().is_ok());
    b.receive("582#4B41600037000000");
    assert_eq!(b.events(), [], "a second copy");
}

#[test]
fn a_drive_says_no_with_its_code() {
    let mut b = HostFixture::new();
    b.submit(1, write(STATUS, 1, 2, RequestClass::ReadBack));
    assert_eq!(b.sent_frames(), ["602#2B41600001000000"]);
    b.receive("582#8040600000000106");
    assert_eq!(b.events(), [], "of another object");
    b.receive("582#8041600002000106");
    assert_eq!(b.one(), Err(Failure::Refused { code: AbortCode::READ_ONLY.0 }));
}

#[test]
fn after_silence_another_object_is_asked_before_the_same_again() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    b.wait(T_MS);
    assert_eq!(b.sent_frames(), ["602#8041600000000405", "602#4000100000000000"]);
    b.receive("582#4B41600050000000");
    assert_eq!(b.events(), [], "late: it may be the first question's");
    b.receive("582#4300100092010200");
    assert_eq!(b.sent_frames(), ["602#4041600000000000"]);
    b.receive("582#4B41600037000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x37, len: 2 }));
    assert_eq!((b.host.counters().late, b.host.counters().resent), (1, 1));
}

#[test]
fn a_write_is_never_sent_twice() {
    let mut b = HostFixture::new();
    b.submit(1, write(CONTROL, 0x0F, 2, RequestClass::NoRetry));
    b.sent_frames();
    b.wait(T_MS);
    assert_eq!(b.one(), Err(Failure::Silent));
    assert_eq!(b.sent_frames(), ["602#8040600000000405"], "an abort, and nothing more");
    // The next write to the same object waits until nothing older can come.
    b.submit(2, write(CONTROL, 6, 2, RequestClass::NoRetry));
    assert_eq!(b.sent_frames(), ["602#4000100000000000"]);
    b.receive("582#6040600000000000");
    assert_eq!(b.events(), [], "the first one's late answer");
    b.receive("582#8000100000000206");
    assert_eq!(b.sent_frames(), ["602#2B40600006000000"], "a refusal is as good a sign");
    b.receive("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 6 }));
}

#[test]
fn another_object_needs_no_probe() {
    let mut b = HostFixture::new();
    b.submit(1, write(CONTROL, 0x0F, 2, RequestClass::NoRetry));
    b.sent_frames();
    b.wait(T_MS);
    b.events();
    b.sent_frames();
    b.submit(2, read(2, STATUS));
    assert_eq!(b.sent_frames(), ["602#4041600000000000"]);
    b.receive("582#4B41600037000000");
    assert!(b.one().is_ok());
    b.submit(3, write(CONTROL, 6, 2, RequestClass::NoRetry));
    assert_eq!(
        b.sent_frames(),
        ["602#2B40600006000000"],
        "its answer came behind whatever was older"
    );
}

#[test]
fn a_stop_goes_ahead_of_the_probe_and_again_behind_it() {
    let mut b = HostFixture::new();
    b.submit(1, write(CONTROL, 0x0F, 2, RequestClass::NoRetry));
    b.sent_frames();
    b.wait(T_MS);
    b.events();
    b.sent_frames();
    b.submit(2, write(CONTROL, 2, 2, RequestClass::Stop));
    assert_eq!(b.sent_frames(), ["602#2B40600002000000"], "at once");
    b.receive("582#6040600000000000");
    assert_eq!(b.events(), [], "whose answer is it?");
    assert_eq!(b.sent_frames(), ["602#4000100000000000"]);
    b.receive("582#4300100092010200");
    assert_eq!(b.sent_frames(), ["602#2B40600002000000"]);
    b.receive("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 2 }));
}

/// A cut frame has less than it claims (swarm seed can:86), and one that is received before the request
/// can have left is the second copy of an older one (can:178).
#[test]
fn a_short_answer_and_one_too_soon_are_none() {
    let mut b = HostFixture::with(HostOptions::new(500_000));
    b.now = Instant::ZERO.plus_ms(1);
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    b.now = b.now.plus_ns(244_000);
    b.receive("582#4B41600037000000");
    b.now = b.now.plus_ms(1);
    b.receive("582#4B416000");
    assert_eq!(b.events(), []);
    assert_eq!((b.host.counters().late, b.host.counters().corrupt), (1, 1));
    b.receive("582#4B41600050000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x50, len: 2 }));
}

/// The layer above has forgotten every request then, so none may end later.
#[test]
fn bus_off_ends_every_request_at_once() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    b.submit(2, read(3, STATUS));
    b.host.handle_line(b.now, LineEvent::BusOff);
    let lost = |n| (EventSubject::Request(Ticket(n)), Err(Failure::LinkDown));
    assert_eq!(b.events(), [lost(1), lost(2)]);
    assert_eq!(b.host.poll_timeout(), None);
}

#[test]
fn a_dead_node_ends_every_request() {
    for request in [
        read(2, STATUS),
        read(2, ObjectIndex::new(0x1000, 0)),
        write(CONTROL, 2, 2, RequestClass::Stop),
        write(CONTROL, 6, 2, RequestClass::ReadBack),
        HostRequest::Guard { node: 2 },
        HostRequest::Upload { node: 2, object: STATUS, block: true, max: 0 },
        HostRequest::Download { node: 2, object: STATUS, block: false, size: 9 },
    ] {
        let mut b = HostFixture::new();
        for round in 0..3 {
            b.submit(round, request);
            let (mut events, mut waits) = (Vec::new(), 0);
            while events.is_empty() {
                b.sent_frames();
                let due = b.host.poll_timeout().expect("something is waited for");
                b.now = due;
                b.host.handle_timeout(due);
                events = b.events();
                waits += 1;
                assert!(waits <= 8, "{request:?}");
            }
            assert_eq!(
                events,
                [(EventSubject::Request(Ticket(round)), Err(Failure::Silent))],
                "{request:?}"
            );
        }
    }
}

#[test]
fn a_request_without_a_reply_is_done_when_it_is_sent() {
    let mut b = HostFixture::new();
    b.submit(1, HostRequest::Nmt(NmtMessage { command: NmtCommand::Start, node: 6 }));
    assert_eq!(b.events(), []);
    assert_eq!(b.sent_frames(), ["000#0106"]);
    assert_eq!(b.one(), Ok(Answer::Sent));
    b.submit(2, HostRequest::Sync(None));
    b.submit(
        3,
        HostRequest::Process { cob: crate::proto::canopen::Cob::Rpdo(1, 2), data: 0x5F, len: 2 },
    );
    assert_eq!(b.sent_frames(), ["080#", "202#5F00"]);
}

#[test]
fn nodes_tell_of_themselves() {
    let mut b = HostFixture::new();
    for frame in ["702#00", "702#7F", "702#7F", "702#05", "081#0C16", "702#00"] {
        b.receive(frame);
    }
    let from = |node, answer| (EventSubject::Unsolicited(node), Ok(answer));
    assert_eq!(
        b.events(),
        [
            from(2, Answer::State(NmtState::BootUp)),
            from(2, Answer::State(NmtState::PreOperational)),
            from(2, Answer::State(NmtState::Operational)),
            from(1, Answer::Emergency(Emergency { code: 0x160C, ..Emergency::default() })),
            from(2, Answer::State(NmtState::BootUp)),
        ]
    );
    assert_eq!(b.host.state(2), Some(NmtState::BootUp));
    b.receive("282#0102");
    assert_eq!(b.events(), [from(2, Answer::Process(2, 0x0201, 2))]);
}

#[test]
fn a_heartbeat_is_missed_when_its_period_is_known() {
    let mut b = HostFixture::new();
    b.receive("702#05");
    b.events();
    b.wait(60_000);
    assert_eq!(b.events(), [], "who knows how often it comes");
    b.submit(1, write(ObjectIndex::new(0x1017, 0), 100, 2, RequestClass::ReadBack));
    b.sent_frames();
    b.receive("582#6017100000000000");
    b.events();
    for _ in 0..5 {
        b.receive("702#05");
        b.wait(100);
        assert_eq!(b.events(), []);
    }
    b.wait(100);
    assert_eq!(b.events(), [(EventSubject::Unsolicited(2), Ok(Answer::HeartbeatLost))]);
    b.wait(1_000);
    assert_eq!(b.events(), [], "told once");
    assert_eq!(b.host.state(2), None);
}

#[test]
fn a_storm_of_emergencies_loses_no_answer() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    for _ in 0..10_000 {
        b.receive("082#3081110000000000");
    }
    b.receive("582#4B41600037000000");
    let events = b.events();
    assert!(events.len() < 1000);
    assert_eq!(events.last().unwrap().0, EventSubject::Request(Ticket(1)));
}

#[test]
fn guarding_answers_alternate() {
    let mut b = HostFixture::new();
    for (n, beat) in ["702#05", "702#85", "702#05"].into_iter().enumerate() {
        b.submit(n as u32, HostRequest::Guard { node: 2 });
        assert_eq!(b.sent_frames(), ["702#R1"]);
        b.receive(beat);
        assert_eq!(b.one(), Ok(Answer::State(NmtState::Operational)));
    }
    b.submit(9, HostRequest::Guard { node: 2 });
    b.sent_frames();
    b.receive("702#05");
    assert_eq!(b.one(), Err(Failure::Misbehaved), "the same toggle twice");
}

#[test]
fn our_own_heartbeat_ends_with_the_lease() {
    let mut b = HostFixture::with(HostOptions { heartbeat_ms: Some(100), ..HostOptions::new(0) });
    assert_eq!(b.sent_frames(), [""; 0]);
    b.submit(1, read(2, STATUS));
    let mut beats = 0;
    for _ in 0..100 {
        beats += b.sent_frames().iter().filter(|text| *text == "77F#05").count();
        b.wait(50);
    }
    assert!((9..=12).contains(&beats), "{beats}");
    b.events();
    b.submit(2, read(3, STATUS));
    assert!(b.sent_frames().contains(&String::from("77F#05")), "it goes on with the application");
}

#[test]
fn a_node_that_begins_to_watch_gets_a_heartbeat_at_once() {
    let mut b = HostFixture::with(HostOptions { heartbeat_ms: Some(300), ..HostOptions::new(0) });
    b.submit(1, read(2, STATUS));
    assert!(b.sent_frames().contains(&String::from("77F#05")));
    b.receive("582#4B41600000000000");
    b.wait(20);
    b.submit(2, HostRequest::WatchHeartbeat { node: 2, ms: 900 });
    assert!(!b.sent_frames().contains(&String::from("77F#05")), "the node does not watch yet");
    b.receive("582#6016100100000000");
    assert_eq!(b.sent_frames(), ["77F#05"]);
    b.wait(299);
    assert_eq!(b.sent_frames(), [""; 0], "the period begins anew");
    b.wait(1);
    assert_eq!(b.sent_frames(), ["77F#05"]);
}

#[test]
fn sync_keeps_its_beat() {
    let mut b = HostFixture::new();
    b.submit(1, HostRequest::SyncEvery(10_000));
    let mut count = 0;
    for _ in 0..100 {
        count += b.sent_frames().len();
        b.wait(3);
    }
    assert_eq!(count, 30);
    b.submit(2, HostRequest::SyncEvery(0));
    b.wait(100);
    assert_eq!(b.sent_frames(), [""; 0]);
}

#[test]
fn a_fast_scan_finds_the_four_numbers() {
    let mut b = HostFixture::new();
    let own = [0x0000_0319, 0x1234_5678, 0x0001_0002, 0x8000_0001];
    b.submit(1, HostRequest::FastScan);
    let mut at = 0;
    loop {
        let mut frame = Frame::default();
        let sequence = b.host.poll_transmit(b.now, &mut frame);
        if sequence.is_some() {
            let lss::LssRequest::FastScan { number, bit, sub, next } =
                lss::LssRequest::parse(frame.bytes()).unwrap()
            else {
                panic!("{frame}")
            };
            let agrees = bit == 128 || number >> bit == own[at] >> bit && sub as usize == at;
            if agrees {
                b.host.handle_input(b.now, &lss::LssReply::Identified.emit());
            }
            if agrees && bit == 0 && next != sub {
                at = next as usize;
            }
        }
        b.wait(25);
        if let Some((_, result)) = b.events().pop() {
            assert_eq!(result, Ok(Answer::Identity(own)));
            break;
        }
    }
    b.submit(2, HostRequest::FastScan);
    b.sent_frames();
    b.wait(25);
    assert_eq!(b.one(), Err(Failure::Silent), "nobody is without node-ID");
}

#[test]
fn a_late_reply_to_a_fast_scan_confirms_no_number() {
    let mut b = HostFixture::new();
    let vendor = 0x55;
    b.submit(1, HostRequest::FastScan);
    let mut late = false;
    let mut frame = Frame::default();
    let failure = loop {
        if b.host.poll_transmit(b.now, &mut frame).is_some() {
            let lss::LssRequest::FastScan { number, bit, sub, .. } =
                lss::LssRequest::parse(frame.bytes()).unwrap()
            else {
                panic!("{frame}")
            };
            assert_eq!(sub, lss::IdentityNumber::Vendor);
            // The reply about bit 1 comes when the whole number is asked, two questions later.
            let agrees = bit == 128 || number >> bit == vendor >> bit;
            if agrees && bit == 1 {
                late = true;
            } else if agrees || late && number == vendor | 2 {
                b.host.handle_input(b.now, &lss::LssReply::Identified.emit());
                late &= number != vendor | 2;
            }
        }
        b.wait(25);
        if let Some((_, result)) = b.events().pop() {
            break result;
        }
    };
    assert!(!late, "the late reply was received");
    assert_eq!(failure, Err(Failure::Misbehaved));
}

#[test]
fn layer_setting_is_answered_or_done() {
    let mut b = HostFixture::new();
    b.submit(1, HostRequest::Lss(lss::LssRequest::SwitchGlobal(true)));
    assert_eq!(b.sent_frames(), ["7E5#0401000000000000"]);
    assert_eq!(b.one(), Ok(Answer::Sent));
    b.submit(2, HostRequest::Lss(lss::LssRequest::SetNode(5)));
    b.sent_frames();
    b.receive("7E4#1300000000000000");
    assert_eq!(b.events(), []);
    b.receive("7E4#1100000000000000");
    assert_eq!(b.one(), Ok(Answer::Lss(lss::LssReply::SetNode(0, 0))));
}

#[test]
fn a_dead_line_ends_everything() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.submit(2, HostRequest::Nmt(NmtMessage { command: NmtCommand::Start, node: 2 }));
    b.submit(3, HostRequest::FastScan);
    b.submit(4, HostRequest::Upload { node: 4, object: STATUS, block: false, max: 0 });
    b.host.handle_line(b.now, LineEvent::Down);
    let events = b.events();
    assert_eq!(events.len(), 4);
    assert!(events.iter().all(|(_, result)| *result == Err(Failure::LinkDown)));
    assert_eq!(b.sent_frames(), [""; 0]);
    assert_eq!(b.host.poll_timeout(), None);
}

#[test]
fn a_stop_does_not_wait_for_an_answer_that_never_comes() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.sent_frames();
    let stop = write(CONTROL, 2, 2, RequestClass::Stop);
    assert!(b.host.submit(b.now, Ticket(2), stop).is_err(), "a moment for the answer");
    let due = b.host.poll_timeout().expect("wakes for the stop");
    assert_eq!(due, b.now.plus_ms(10));
    b.now = due;
    b.host.handle_timeout(due);
    b.submit(2, stop);
    assert_eq!(b.one(), Err(Failure::Cancelled));
    assert_eq!(b.sent_frames(), ["602#8041600000000405", "602#2B40600002000000"]);
    b.receive("582#4B41600037000000");
    assert_eq!(b.events(), []);
    b.receive("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 2 }));
}

#[test]
fn bytes_before_the_query_is_out_are_no_reply() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, STATUS));
    b.receive("582#4B41600037000000");
    assert_eq!((b.events(), b.host.counters().late), (Vec::new(), 1));
    assert_eq!(b.sent_frames(), ["602#4041600000000000"]);
    b.receive("582#4B41600050000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x50, len: 2 }));
}
