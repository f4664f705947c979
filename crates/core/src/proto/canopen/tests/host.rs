//! The host against frames laid out by hand: what it says, and what it makes of what comes.

extern crate std;

use std::string::String;
use std::vec::Vec;

use crate::error::Failure;
use crate::medium::{Can, Frame};
use crate::proto::HostOptions;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::nmt::{Command, Order, State};
use crate::proto::canopen::sdo::{self, Abort, Object};
use crate::proto::canopen::{Answer, Ask, Host, lss};
use crate::station::{Class, Host as _, LineEvent, Station, Ticket, Timed, To};
use crate::time::Instant;

const STATUS: Object = Object::new(0x6041, 0);
const CONTROL: Object = Object::new(0x6040, 0);
const T_MS: u32 = 200;

/// A host, its time, and what it said.
struct Bench {
    host: Host,
    now: Instant,
}

type Ended = Vec<(To, Result<Answer, Failure>)>;

impl Bench {
    fn new() -> Self {
        Self::with(HostOptions::new(0))
    }

    fn with(options: HostOptions) -> Self {
        Self { host: Host::new(&options), now: Instant::ZERO }
    }

    fn ask(&mut self, n: u32, ask: Ask) {
        self.host.submit(self.now, Ticket(n), ask).expect("taken");
    }

    /// Everything that it has to say, as candump's log has it.
    fn said(&mut self) -> Vec<String> {
        let mut said = Vec::new();
        let mut frame = Frame::default();
        while Station::<Can>::poll_transmit(&mut self.host, self.now, &mut frame).is_some() {
            said.push(std::format!("{frame}"));
            assert!(said.len() < 1000);
        }
        said
    }

    fn hear(&mut self, text: &str) {
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

const fn read(node: u8, object: Object) -> Ask {
    Ask::Read { node, object }
}

const fn write(object: Object, bits: u64, len: u8, class: Class) -> Ask {
    Ask::Write { node: 2, object, bits, len, class }
}

#[test]
fn nodes_are_asked_at_once_and_each_one_thing_at_a_time() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.ask(2, read(3, STATUS));
    assert!(b.host.submit(b.now, Ticket(3), read(2, CONTROL)).is_err());
    assert_eq!(b.said(), ["602#4041600000000000", "603#4041600000000000"]);
    b.hear("583#4B41600037000000");
    b.hear("582#4B41600050000000");
    let value = |bits| Ok(Answer::Value { object: STATUS, bits, len: 2 });
    assert_eq!(
        b.events(),
        [(To::Ticket(Ticket(2)), value(0x37)), (To::Ticket(Ticket(1)), value(0x50))]
    );
    assert_eq!((b.host.counters().sent, b.host.counters().answered), (2, 2));
}

#[test]
fn an_answer_to_something_else_is_none() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.said();
    // Another object, another node, another service, a remote request, 29 bits.
    for foreign in ["582#4B40600037000000", "585#4B41600037000000", "582#6041600000000000"] {
        b.hear(foreign);
    }
    let remote = Frame { remote: true, ..Frame::standard(0x582, &[]) };
    b.host.handle_input(b.now, &remote);
    let wide = Frame { extended: true, ..Frame::standard(0x582, b"\x4B\x41\x60\0\x37\0\0\0") };
    b.host.handle_input(b.now, &wide);
    assert_eq!(b.events(), []);
    b.hear("582#4B41600037000000");
    assert!(b.one().is_ok());
    b.hear("582#4B41600037000000");
    assert_eq!(b.events(), [], "a second copy");
}

#[test]
fn a_drive_says_no_with_its_code() {
    let mut b = Bench::new();
    b.ask(1, write(STATUS, 1, 2, Class::Confirm));
    assert_eq!(b.said(), ["602#2B41600001000000"]);
    b.hear("582#8040600000000106");
    assert_eq!(b.events(), [], "of another object");
    b.hear("582#8041600002000106");
    assert_eq!(b.one(), Err(Failure::Refused { code: Abort::READ_ONLY.0 }));
}

#[test]
fn after_silence_another_object_is_asked_before_the_same_again() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.said();
    b.wait(T_MS);
    assert_eq!(b.said(), ["602#8041600000000405", "602#4000100000000000"]);
    b.hear("582#4B41600050000000");
    assert_eq!(b.events(), [], "late: it may be the first question's");
    b.hear("582#4300100092010200");
    assert_eq!(b.said(), ["602#4041600000000000"]);
    b.hear("582#4B41600037000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x37, len: 2 }));
    assert_eq!((b.host.counters().late, b.host.counters().resent), (1, 1));
}

#[test]
fn a_write_is_never_sent_twice() {
    let mut b = Bench::new();
    b.ask(1, write(CONTROL, 0x0F, 2, Class::Never));
    b.said();
    b.wait(T_MS);
    assert_eq!(b.one(), Err(Failure::Silent));
    assert_eq!(b.said(), ["602#8040600000000405"], "an abort, and nothing more");
    // The next write to the same object waits until nothing older can come.
    b.ask(2, write(CONTROL, 6, 2, Class::Never));
    assert_eq!(b.said(), ["602#4000100000000000"]);
    b.hear("582#6040600000000000");
    assert_eq!(b.events(), [], "the first one's late answer");
    b.hear("582#8000100000000206");
    assert_eq!(b.said(), ["602#2B40600006000000"], "a refusal is as good a sign");
    b.hear("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 6 }));
}

#[test]
fn another_object_needs_no_probe() {
    let mut b = Bench::new();
    b.ask(1, write(CONTROL, 0x0F, 2, Class::Never));
    b.said();
    b.wait(T_MS);
    b.events();
    b.said();
    b.ask(2, read(2, STATUS));
    assert_eq!(b.said(), ["602#4041600000000000"]);
    b.hear("582#4B41600037000000");
    assert!(b.one().is_ok());
    b.ask(3, write(CONTROL, 6, 2, Class::Never));
    assert_eq!(b.said(), ["602#2B40600006000000"], "its answer came behind whatever was older");
}

#[test]
fn a_stop_goes_ahead_of_the_probe_and_again_behind_it() {
    let mut b = Bench::new();
    b.ask(1, write(CONTROL, 0x0F, 2, Class::Never));
    b.said();
    b.wait(T_MS);
    b.events();
    b.said();
    b.ask(2, write(CONTROL, 2, 2, Class::Stop));
    assert_eq!(b.said(), ["602#2B40600002000000"], "at once");
    b.hear("582#6040600000000000");
    assert_eq!(b.events(), [], "whose answer is it?");
    assert_eq!(b.said(), ["602#4000100000000000"]);
    b.hear("582#4300100092010200");
    assert_eq!(b.said(), ["602#2B40600002000000"]);
    b.hear("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 2 }));
}

/// A cut frame says less than it claims (swarm seed can:86), and one that is heard before the request
/// can have left is the second copy of an older one (can:178).
#[test]
fn a_short_answer_and_one_too_soon_are_none() {
    let mut b = Bench::with(HostOptions::new(500_000));
    b.now = Instant::ZERO.plus_ms(1);
    b.ask(1, read(2, STATUS));
    b.said();
    b.now = b.now.plus_ns(244_000);
    b.hear("582#4B41600037000000");
    b.now = b.now.plus_ms(1);
    b.hear("582#4B416000");
    assert_eq!(b.events(), []);
    assert_eq!((b.host.counters().late, b.host.counters().corrupt), (1, 1));
    b.hear("582#4B41600050000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x50, len: 2 }));
}

/// What is above has forgotten every request then, so none may end later.
#[test]
fn bus_off_ends_every_request_at_once() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.said();
    b.ask(2, read(3, STATUS));
    b.host.handle_line(b.now, LineEvent::BusOff);
    let lost = |n| (To::Ticket(Ticket(n)), Err(Failure::LinkDown));
    assert_eq!(b.events(), [lost(1), lost(2)]);
    assert_eq!(b.host.poll_timeout(), None);
}

#[test]
fn a_dead_node_ends_every_request() {
    for ask in [
        read(2, STATUS),
        read(2, Object::new(0x1000, 0)),
        write(CONTROL, 2, 2, Class::Stop),
        write(CONTROL, 6, 2, Class::Confirm),
        Ask::Guard { node: 2 },
        Ask::Upload { node: 2, object: STATUS, block: true },
        Ask::Download { node: 2, object: STATUS, block: false, size: 9 },
    ] {
        let mut b = Bench::new();
        for round in 0..3 {
            b.ask(round, ask);
            let (mut events, mut waits) = (Vec::new(), 0);
            while events.is_empty() {
                b.said();
                let due = b.host.poll_timeout().expect("something is waited for");
                b.now = due;
                b.host.handle_timeout(due);
                events = b.events();
                waits += 1;
                assert!(waits <= 8, "{ask:?}");
            }
            assert_eq!(events, [(To::Ticket(Ticket(round)), Err(Failure::Silent))], "{ask:?}");
        }
    }
}

#[test]
fn longer_values_come_in_segments() {
    let mut b = Bench::new();
    let name = Object::new(0x1008, 0);
    b.ask(1, read(2, name));
    b.said();
    b.hear("582#4108100008000000");
    assert_eq!(b.said(), ["602#6000000000000000"]);
    b.hear("582#0054532073657276");
    assert_eq!(b.said(), ["602#7000000000000000"]);
    // A copy of the segment before is passed over.
    b.hear("582#0054532073657276");
    assert_eq!((b.said().len(), b.events().len()), (0, 0));
    b.hear("582#1D6F000000000000");
    let bits = u64::from_le_bytes(*b"TS servo");
    assert_eq!(b.one(), Ok(Answer::Value { object: name, bits, len: 8 }));
}

#[test]
fn of_a_string_the_first_eight_bytes_are_enough() {
    let mut b = Bench::new();
    let name = Object::new(0x1008, 0);
    b.ask(1, read(2, name));
    b.said();
    b.hear("582#4108100027000000");
    b.said();
    b.hear("582#0054532073657276");
    b.said();
    b.hear("582#106F206472697665");
    let bits = u64::from_le_bytes(*b"TS servo");
    assert_eq!(b.one(), Ok(Answer::Value { object: name, bits, len: 39 }));
    assert_eq!(b.said(), ["602#8008100005000405"], "the rest is let go");
}

#[test]
fn a_wrong_toggle_ends_a_transfer() {
    let mut b = Bench::new();
    b.ask(1, read(2, Object::new(0x1008, 0)));
    b.said();
    b.hear("582#4108100008000000");
    b.said();
    b.hear("582#1054532073657276");
    assert_eq!(b.events(), []);
    b.hear("582#1054532073657276");
    assert_eq!(b.one(), Err(Failure::Misbehaved));
    assert_eq!(b.said(), ["602#8008100000000305"]);
}

#[test]
fn a_node_lost_in_the_middle_is_told_so() {
    let mut b = Bench::new();
    b.ask(1, read(2, Object::new(0x1008, 0)));
    b.said();
    b.hear("582#4108100027000000");
    b.said();
    b.wait(T_MS);
    assert_eq!(b.one(), Err(Failure::Silent));
    assert_eq!(b.said(), ["602#8008100000000405"]);
    // A segment that comes now belongs to nothing.
    b.hear("582#0054532073657276");
    b.ask(2, read(2, STATUS));
    b.said();
    b.hear("582#0054532073657276");
    assert_eq!(b.events(), []);
    b.hear("582#4B41600037000000");
    assert!(b.one().is_ok());
}

#[test]
fn eight_bytes_are_written_in_two_segments() {
    let mut b = Bench::new();
    let object = Object::new(0x2100, 1);
    b.ask(1, write(object, u64::from_le_bytes(*b"polepair"), 8, Class::Confirm));
    assert_eq!(b.said(), ["602#2100210108000000"]);
    b.hear("582#6000210100000000");
    assert_eq!(b.said(), ["602#00706F6C65706169"]);
    b.hear("582#2000000000000000");
    assert_eq!(b.said(), ["602#1D72000000000000"]);
    b.hear("582#3000000000000000");
    assert!(matches!(b.one(), Ok(Answer::Written { .. })));
}

#[test]
fn an_upload_in_segments_waits_for_whoever_takes_it() {
    let mut b = Bench::new();
    b.ask(1, Ask::Upload { node: 2, object: Object::new(0x1F50, 1), block: false });
    b.said();
    b.hear("582#41501F01DC050000");
    let (mut toggle, mut asked) = (0u8, 0);
    while !b.said().is_empty() {
        b.hear(&std::format!("582#{toggle:02X}41424344454647"));
        toggle ^= 0x10;
        asked += 1;
    }
    assert_eq!(asked, 127, "as much as it holds");
    let mut out = [0; 1000];
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(889));
    assert_eq!(&out[..9], b"ABCDEFGAB");
    assert_eq!(b.said().len(), 1);
    b.hear(&std::format!("582#{:02X}41424300000000", toggle | 9));
    assert_eq!(b.events(), [], "not before the rest is taken");
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(3));
    assert_eq!(b.one(), Ok(Answer::Transferred(892)));
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), None);
}

#[test]
fn blocks_are_read_and_what_was_lost_is_asked_again() {
    let mut b = Bench::new();
    b.ask(1, Ask::Upload { node: 2, object: Object::new(0x1008, 0), block: true });
    assert_eq!(b.said(), ["602#A40810007F000000"]);
    b.hear("582#C608100011000000");
    assert_eq!(b.said(), ["602#A300000000000000"]);
    b.hear("582#0154696E79204E6F");
    // The second one is lost; the last one alone does not count.
    b.hear("582#8321210000000000");
    assert_eq!(b.said(), ["602#A2017E0000000000"]);
    b.hear("582#016465202D204D65");
    b.hear("582#8267617300000000");
    assert_eq!(b.said(), ["602#A2027C0000000000"]);
    let text = b"Tiny Node - Megas";
    let crc = sdo::crc(0, text);
    b.hear(&std::format!("582#D1{:02X}{:02X}0000000000", crc & 0xFF, crc >> 8));
    assert_eq!(b.said(), ["602#A100000000000000"]);
    let mut out = [0; 64];
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(17));
    assert_eq!(&out[..17], text);
    assert_eq!(b.one(), Ok(Answer::Transferred(17)));
}

#[test]
fn a_wrong_check_over_blocks_is_told() {
    let mut b = Bench::new();
    b.ask(1, Ask::Upload { node: 2, object: Object::new(0x1008, 0), block: true });
    b.said();
    b.hear("582#C608100003000000");
    b.said();
    b.hear("582#8141424300000000");
    b.said();
    b.hear("582#D100000000000000");
    assert_eq!(b.one(), Err(Failure::Misbehaved));
    assert_eq!(b.said(), ["602#8008100004000405"]);
}

#[test]
fn blocks_are_written_and_what_was_lost_goes_again() {
    let mut b = Bench::new();
    let object = Object::new(0x1F50, 1);
    b.ask(1, Ask::Download { node: 2, object, block: true, size: 17 });
    assert_eq!(b.said(), ["602#C6501F0111000000"]);
    b.hear("582#A4501F0102000000");
    assert_eq!(b.said(), [""; 0], "nobody gave a byte yet");
    let text = b"Tiny Node - Megas";
    assert_eq!(b.host.feed_bytes(Ticket(1), text), Some(17));
    assert_eq!(b.said(), ["602#0154696E79204E6F", "602#026465202D204D65"]);
    b.hear("582#A201050000000000");
    assert_eq!(b.said(), ["602#016465202D204D65", "602#8267617300000000"]);
    b.hear("582#A202050000000000");
    let crc = sdo::crc(0, text);
    assert_eq!(b.said(), [std::format!("602#D1{:02X}{:02X}0000000000", crc & 0xFF, crc >> 8)]);
    b.hear("582#A100000000000000");
    assert_eq!(b.one(), Ok(Answer::Transferred(17)));
}

/// A block of 127 segments that begins.
fn block() -> Bench {
    let mut b = Bench::with(HostOptions { bit_rate: 1_000_000, ..HostOptions::new(0) });
    b.ask(1, Ask::Download { node: 2, object: Object::new(0x1F50, 1), block: true, size: 889 });
    b.said();
    b.hear("582#A4501F017F000000");
    assert_eq!(b.host.feed_bytes(Ticket(1), &[0x55; 889]), Some(889));
    b
}

#[test]
fn a_block_goes_no_faster_than_the_wire_and_behind_all_else() {
    let mut b = block();
    let mut sent = b.said().len();
    assert_eq!(sent, 8, "a few ahead");
    b.ask(2, read(3, STATUS));
    assert_eq!(b.said(), ["603#4041600000000000"]);
    b.ask(3, read(4, STATUS));
    while sent < 127 {
        b.now = b.host.poll_timeout().unwrap();
        b.host.handle_timeout(b.now);
        let said = b.said();
        let first = usize::from(said[0].starts_with("604"));
        assert_eq!(said.len() - first, 4.min(127 - sent), "half of them at once");
        assert_eq!(first == 1, sent == 8, "what was asked goes first");
        sent += said.len() - first;
    }
    // 111 us for each, and not a moment more than the wire takes.
    assert!((118 * 111..127 * 111).contains(&(b.now.0 / 1000)), "{:?}", b.now);
    b.hear("582#A27F7F0000000000");
    assert!(b.said()[0].starts_with("602#C1"));
}

#[test]
fn a_stop_of_a_node_ends_the_block_that_is_sent_to_it() {
    let mut b = block();
    b.said();
    b.ask(2, write(CONTROL, 0, 2, Class::Stop));
    assert_eq!(b.said(), ["602#80501F0100000405", "602#2B40600000000000"]);
    assert_eq!(b.one(), Err(Failure::Silent), "perhaps written");
    b.wait(1);
    b.hear("582#6040600000000000");
    assert!(b.one().is_ok());
}

#[test]
fn a_download_waits_for_bytes() {
    let mut b = Bench::new();
    b.ask(1, Ask::Download { node: 2, object: Object::new(0x1F50, 1), block: false, size: 10 });
    b.said();
    b.hear("582#60501F0100000000");
    assert_eq!(b.said(), [""; 0]);
    assert_eq!(b.host.feed_bytes(Ticket(1), b"012345"), Some(6));
    assert_eq!(b.said(), [""; 0], "less than a segment");
    assert_eq!(b.host.feed_bytes(Ticket(1), b"6789abc"), Some(4), "no more than it said");
    assert_eq!(b.said(), ["602#0030313233343536"]);
    b.hear("582#2000000000000000");
    assert_eq!(b.said(), ["602#1937383900000000"]);
    b.hear("582#3000000000000000");
    assert_eq!(b.one(), Ok(Answer::Transferred(10)));
}

#[test]
fn what_nobody_answers_is_done_when_it_is_sent() {
    let mut b = Bench::new();
    b.ask(1, Ask::Order(Order { command: Command::Start, node: 6 }));
    assert_eq!(b.events(), []);
    assert_eq!(b.said(), ["000#0106"]);
    assert_eq!(b.one(), Ok(Answer::Sent));
    b.ask(2, Ask::Sync(None));
    b.ask(3, Ask::Process { cob: crate::proto::canopen::Cob::Rpdo(1, 2), data: 0x5F, len: 2 });
    assert_eq!(b.said(), ["080#", "202#5F00"]);
}

#[test]
fn nodes_tell_of_themselves() {
    let mut b = Bench::new();
    for frame in ["702#00", "702#7F", "702#7F", "702#05", "081#0C16", "702#00"] {
        b.hear(frame);
    }
    let from = |node, answer| (To::Address(node), Ok(answer));
    assert_eq!(
        b.events(),
        [
            from(2, Answer::State(State::BootUp)),
            from(2, Answer::State(State::PreOperational)),
            from(2, Answer::State(State::Operational)),
            from(1, Answer::Emergency(Emergency { code: 0x160C, ..Emergency::default() })),
            from(2, Answer::State(State::BootUp)),
        ]
    );
    assert_eq!(b.host.state(2), Some(State::BootUp));
    b.hear("282#0102");
    assert_eq!(b.events(), [from(2, Answer::Process(2, 0x0201, 2))]);
}

#[test]
fn a_heartbeat_is_missed_when_its_period_is_known() {
    let mut b = Bench::new();
    b.hear("702#05");
    b.events();
    b.wait(60_000);
    assert_eq!(b.events(), [], "who knows how often it comes");
    b.ask(1, write(Object::new(0x1017, 0), 100, 2, Class::Confirm));
    b.said();
    b.hear("582#6017100000000000");
    b.events();
    for _ in 0..5 {
        b.hear("702#05");
        b.wait(100);
        assert_eq!(b.events(), []);
    }
    b.wait(100);
    assert_eq!(b.events(), [(To::Address(2), Ok(Answer::Lost))]);
    b.wait(1_000);
    assert_eq!(b.events(), [], "told once");
    assert_eq!(b.host.state(2), None);
}

#[test]
fn a_storm_of_emergencies_loses_no_answer() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.said();
    for _ in 0..10_000 {
        b.hear("082#3081110000000000");
    }
    b.hear("582#4B41600037000000");
    let events = b.events();
    assert!(events.len() < 1000);
    assert_eq!(events.last().unwrap().0, To::Ticket(Ticket(1)));
}

#[test]
fn guarding_answers_alternate() {
    let mut b = Bench::new();
    for (n, beat) in ["702#05", "702#85", "702#05"].into_iter().enumerate() {
        b.ask(n as u32, Ask::Guard { node: 2 });
        assert_eq!(b.said(), ["702#R1"]);
        b.hear(beat);
        assert_eq!(b.one(), Ok(Answer::State(State::Operational)));
    }
    b.ask(9, Ask::Guard { node: 2 });
    b.said();
    b.hear("702#05");
    assert_eq!(b.one(), Err(Failure::Misbehaved), "the same toggle twice");
}

#[test]
fn our_own_heartbeat_ends_with_the_lease() {
    let mut b = Bench::with(HostOptions { heartbeat_ms: Some(100), ..HostOptions::new(0) });
    assert_eq!(b.said(), [""; 0]);
    b.ask(1, read(2, STATUS));
    let mut beats = 0;
    for _ in 0..100 {
        beats += b.said().iter().filter(|said| *said == "77F#05").count();
        b.wait(50);
    }
    assert!((9..=12).contains(&beats), "{beats}");
    b.events();
    b.ask(2, read(3, STATUS));
    assert!(b.said().contains(&String::from("77F#05")), "it goes on with the application");
}

#[test]
fn sync_keeps_its_beat() {
    let mut b = Bench::new();
    b.ask(1, Ask::SyncEvery(10_000));
    let mut count = 0;
    for _ in 0..100 {
        count += b.said().len();
        b.wait(3);
    }
    assert_eq!(count, 30);
    b.ask(2, Ask::SyncEvery(0));
    b.wait(100);
    assert_eq!(b.said(), [""; 0]);
}

#[test]
fn a_fast_scan_finds_the_four_numbers() {
    let mut b = Bench::new();
    let own = [0x0000_0319, 0x1234_5678, 0x0001_0002, 0x8000_0001];
    b.ask(1, Ask::FastScan);
    let mut at = 0;
    loop {
        let mut frame = Frame::default();
        let said = b.host.poll_transmit(b.now, &mut frame);
        if said.is_some() {
            let lss::Request::FastScan { number, bit, sub, next } =
                lss::Request::parse(frame.bytes()).unwrap()
            else {
                panic!("{frame}")
            };
            let agrees = bit == 128 || number >> bit == own[at] >> bit && sub as usize == at;
            if agrees {
                b.host.handle_input(b.now, &lss::Reply::Identified.emit());
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
    b.ask(2, Ask::FastScan);
    b.said();
    b.wait(25);
    assert_eq!(b.one(), Err(Failure::Silent), "nobody is without node-ID");
}

#[test]
fn layer_setting_is_answered_or_done() {
    let mut b = Bench::new();
    b.ask(1, Ask::Lss(lss::Request::SwitchGlobal(true)));
    assert_eq!(b.said(), ["7E5#0401000000000000"]);
    assert_eq!(b.one(), Ok(Answer::Sent));
    b.ask(2, Ask::Lss(lss::Request::SetNode(5)));
    b.said();
    b.hear("7E4#1300000000000000");
    assert_eq!(b.events(), []);
    b.hear("7E4#1100000000000000");
    assert_eq!(b.one(), Ok(Answer::Lss(lss::Reply::SetNode(0, 0))));
}

#[test]
fn a_dead_line_ends_everything() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.ask(2, Ask::Order(Order { command: Command::Start, node: 2 }));
    b.ask(3, Ask::FastScan);
    b.ask(4, Ask::Upload { node: 4, object: STATUS, block: false });
    b.host.handle_line(b.now, LineEvent::Down);
    let events = b.events();
    assert_eq!(events.len(), 4);
    assert!(events.iter().all(|(_, result)| *result == Err(Failure::LinkDown)));
    assert_eq!(b.said(), [""; 0]);
    assert_eq!(b.host.poll_timeout(), None);
}

#[test]
fn a_stop_does_not_wait_for_an_answer_that_never_comes() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.said();
    let stop = write(CONTROL, 2, 2, Class::Stop);
    assert!(b.host.submit(b.now, Ticket(2), stop).is_err(), "a moment for the answer");
    let due = b.host.poll_timeout().expect("wakes for the stop");
    assert_eq!(due, b.now.plus_ms(10));
    b.now = due;
    b.host.handle_timeout(due);
    b.ask(2, stop);
    assert_eq!(b.one(), Err(Failure::Cancelled));
    assert_eq!(b.said(), ["602#8041600000000405", "602#2B40600002000000"]);
    b.hear("582#4B41600037000000");
    assert_eq!(b.events(), []);
    b.hear("582#6040600000000000");
    assert_eq!(b.one(), Ok(Answer::Written { object: CONTROL, bits: 2 }));
}

#[test]
fn what_comes_before_the_question_is_out_is_no_answer() {
    let mut b = Bench::new();
    b.ask(1, read(2, STATUS));
    b.hear("582#4B41600037000000");
    assert_eq!((b.events(), b.host.counters().late), (Vec::new(), 1));
    assert_eq!(b.said(), ["602#4041600000000000"]);
    b.hear("582#4B41600050000000");
    assert_eq!(b.one(), Ok(Answer::Value { object: STATUS, bits: 0x50, len: 2 }));
}
