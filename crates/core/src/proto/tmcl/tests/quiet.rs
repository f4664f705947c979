//! Modules that count to nine, know no pause, and have lost count.

extern crate std;

use core::cell::Cell;
use std::boxed::Box;
use std::rc::Rc;
use std::vec::Vec;

use super::pair::{TestWire, request, sixty_reads};
use crate::proto::HostOptions;
use crate::proto::tmcl::device::{ChecksumErrorReply, Quirks};
use crate::proto::tmcl::wire::{DATAGRAM, Request, checksum};
use crate::proto::tmcl::{Answer, HostRequest, Opcode, SerialHost};
use crate::station::Host;
use crate::time::Instant;

/// Time in which a module in step answers after its wire is well, ms. If it received everything, and only the
/// answers were lost, it may have lost count.
const SOON_MS: [u128; 2] = [2_500, 1_400];

const BAD_SUMS: [ChecksumErrorReply; 3] =
    [ChecksumErrorReply::Always, ChecksumErrorReply::IfAddressed, ChecksumErrorReply::Never];

fn counting(baud: u32, bad_sum: ChecksumErrorReply) -> TestWire {
    TestWire::new(
        baud,
        Quirks { checksum_error_reply: bad_sum, byte_timeout_ms: None, ..Quirks::default() },
    )
}

fn stop(wire: &mut TestWire) -> bool {
    matches!(wire.request(HostRequest::of(request(Opcode::Mst, 0, 0))), Ok(Answer::Reply(_)))
}

/// A stop arrives at once at a module of which nothing is known yet; and the module
/// is in step again soon.
#[test]
fn a_stop_reaches_a_module_that_lost_count() {
    for bad_sum in BAD_SUMS {
        for extra in 1..DATAGRAM {
            for (baud, doubt) in [(9600, None), (9600, Some(5)), (0, Some(5))] {
                let mut wire = counting(baud, bad_sum);
                wire.host =
                    SerialHost::new(&HostOptions { probe_seed: doubt, ..HostOptions::new(baud) });
                wire.end.handle_input(wire.now, &[0x55; 9][..extra], &mut wire.firmware);
                let start = wire.now;
                assert!(stop(&mut wire), "{bad_sum:?} {extra} {baud}: {:?}", wire.host);
                let took = wire.now.since(start).as_millis();
                assert!(took < 700, "{bad_sum:?} {extra} {baud}: {took} ms");
                let mut errors = 0;
                while wire.read(9) != Ok(9007) {
                    errors += 1;
                    assert!(errors < 8, "{bad_sum:?} {extra} {baud}: {:?}", wire.host);
                }
                assert_eq!(sixty_reads(&mut wire, 0), (0, 0), "{bad_sum:?} {extra} {baud}");
            }
        }
    }
}

/// A module that is only late keeps its count: no byte is put between requests to it.
#[test]
fn a_module_that_is_late_stays_in_step() {
    for late_ms in [110, 150, 190, 230, 270] {
        for stops in [false, true] {
            let mut wire = counting(9600, ChecksumErrorReply::IfAddressed);
            assert_eq!(wire.read(4), Ok(4007));
            wire.replies = Box::new(move |_, r| Some(Vec::from([(late_ms, r.to_vec())])));
            let until = wire.now.plus_ms(1_300);
            while wire.now < until {
                // It may be answered, and need not.
                let _ = if stops { stop(&mut wire) } else { wire.read(9).is_ok() };
            }
            wire.replies = super::pair::no_fault();
            wire.rest(400);
            assert!(stop(&mut wire), "{late_ms}");
            assert_eq!(sixty_reads(&mut wire, 0), (0, 0), "{late_ms}: {:?}", wire.host);
        }
    }
}

/// On two wires nothing is received from a module while the host sends: the stop alone that follows is
/// answered.
#[test]
fn a_stop_whose_answer_was_lost_is_answered_on_two_wires() {
    for quirks in [Quirks::default(), Quirks { byte_timeout_ms: None, ..Quirks::default() }] {
        let mut wire = TestWire::new(9600, quirks);
        assert_eq!(wire.read(4), Ok(4007));
        let sends = Rc::new(Cell::new(false));
        let long = Rc::clone(&sends);
        wire.requests = Box::new(move |_, bytes| {
            long.set(bytes.len() > DATAGRAM);
            None
        });
        wire.replies = Box::new(move |n, _| (n == 2 || sends.get()).then(Vec::new));
        let start = wire.now;
        while !stop(&mut wire) {
            assert!(wire.now.since(start).as_millis() < 1000, "{:?}", wire.host);
        }
        assert_eq!(sixty_reads(&mut wire, 0), (0, 0), "{:?}", wire.host);
    }
}

/// A module that drops incomplete requests after a pause is received soon after its answers come through again,
/// however long they were lost, and whatever host stopped it meanwhile.
#[test]
fn a_module_that_pauses_is_received_when_its_replies_come_again() {
    for pause_ms in [5, 20, 40, 60, 80, 99] {
        for (baud, lost_ms) in [(9600, 700), (9600, 2000), (0, 2000), (0, 2600), (115_200, 4100)] {
            for stops in [1, 2, 5, 100] {
                let quirks = Quirks { byte_timeout_ms: Some(pause_ms), ..Quirks::default() };
                let mut wire = TestWire::new(
                    baud,
                    Quirks { checksum_error_reply: ChecksumErrorReply::Never, ..quirks },
                );
                wire.host =
                    SerialHost::new(&HostOptions { probe_seed: Some(5), ..HostOptions::new(baud) });
                assert_eq!(wire.read(4), Ok(4007));
                wire.replies = Box::new(|_, _| Some(Vec::new()));
                let (until, mut requested) = (wire.now.plus_ms(lost_ms), 0);
                while wire.now < until {
                    requested += 1;
                    let _ =
                        if requested % stops == 0 { stop(&mut wire) } else { wire.read(9).is_ok() };
                }
                wire.replies = super::pair::no_fault();
                let start = wire.now;
                while wire.read(9) != Ok(9007) {
                    let took = wire.now.since(start).as_millis();
                    assert!(took < 1_500, "{pause_ms} {baud} {lost_ms} {stops}: {:?}", wire.host);
                    let _ = stop(&mut wire);
                }
            }
        }
    }
}

/// A motor that is silent puts its module out of step for no other motor.
#[test]
fn a_motor_that_is_silent_leaves_its_module_in_step() {
    for (baud, doubt) in [(9600, None), (9600, Some(5)), (0, Some(5))] {
        let mut wire = counting(baud, ChecksumErrorReply::Never);
        wire.host = SerialHost::new(&HostOptions { probe_seed: doubt, ..HostOptions::new(baud) });
        wire.firmware.silent = Some(2);
        for round in 0..4 {
            for motor in 0..6 {
                let start = wire.now;
                let stop = Request { motor, ..request(Opcode::Mst, 0, 0) };
                let ended = wire.request(HostRequest::of(stop));
                assert_eq!(ended.is_ok(), motor != 2, "{baud} {round} {motor}: {:?}", wire.host);
                let took = wire.now.since(start).as_millis();
                assert!(motor == 2 || took < 250, "{baud} {round} {motor}: {took} ms");
            }
        }
        assert_eq!(wire.read(9), Ok(9007), "{baud}: {:?}", wire.host);
    }
}

/// A missing module puts none out of step that answers, however many stops it gets.
#[test]
fn a_module_that_is_gone_leaves_the_others_in_step() {
    for (baud, doubt) in [(9600, None), (9600, Some(5)), (0, Some(5))] {
        let mut wire = counting(baud, ChecksumErrorReply::IfAddressed);
        wire.host = SerialHost::new(&HostOptions { probe_seed: doubt, ..HostOptions::new(baud) });
        let gone = |opcode| HostRequest::of(Request { address: 3, ..request(opcode, 4, 0) });
        wire.firmware.address = 3;
        assert!(wire.request(gone(Opcode::Gap)).is_ok());
        wire.firmware.address = 1;
        assert_eq!(wire.read(9), Ok(9007));
        for round in 0..20 {
            let opcode = if round % 3 == 2 { Opcode::Gap } else { Opcode::Mst };
            assert!(wire.request(gone(opcode)).is_err());
            let start = wire.now;
            assert!(stop(&mut wire), "{baud} {round}");
            let took = wire.now.since(start).as_millis();
            assert!(took < 50, "{baud} {round}: {took} ms");
            assert_eq!(wire.read(9), Ok(9007), "{baud} {round}: {:?}", wire.host);
        }
        assert_eq!(wire.host.counters().silent, 20);
    }
}

/// A program that was killed may have left it so: the next one must reach it by its first question.
#[test]
fn a_new_session_reaches_a_module_that_lost_count() {
    let doubt = |seed| HostOptions { probe_seed: Some(seed), ..HostOptions::new(9600) };
    for bad_sum in BAD_SUMS {
        for extra in 1..DATAGRAM {
            let mut wire = counting(9600, bad_sum);
            wire.host = SerialHost::new(&doubt(extra as u32));
            wire.end.handle_input(wire.now, &[0x55; 9][..extra], &mut wire.firmware);
            let start = wire.now;
            assert_eq!(wire.read(9), Ok(9007), "{bad_sum:?} {extra}: {:?}", wire.host);
            let took = wire.now.since(start).as_millis();
            assert!(took < 2_000, "{bad_sum:?} {extra}: {took} ms");
        }
    }
    // Asking one that is not there leaves the others in step.
    let mut wire = counting(9600, ChecksumErrorReply::IfAddressed);
    wire.host = SerialHost::new(&doubt(3));
    let gone = HostRequest::of(Request { address: 3, ..request(Opcode::Gap, 4, 0) });
    let start = wire.now;
    assert!(wire.request(gone).is_err());
    assert!(wire.now.since(start).as_millis() < 2_000);
    wire.host = SerialHost::new(&doubt(4));
    let start = wire.now;
    assert_eq!(wire.read(9), Ok(9007));
    assert!(wire.now.since(start).as_millis() < 150, "{:?}", wire.host);
}

/// A module that is not in step must not read a request in the bytes that it gets.
#[test]
fn a_stop_that_is_shifted_is_no_other_request() {
    for address in 1..=u8::MAX {
        for motor in 0..6 {
            let stop = Request { address, opcode: Opcode::Mst, kind: 0, motor, value: 0 };
            let datagram = stop.emit();
            let mut bytes: Vec<u8> = Vec::new();
            (0..DATAGRAM).for_each(|_| bytes.extend(datagram.iter().chain(&[0])));
            for window in bytes.windows(DATAGRAM).filter(|window| *window != datagram) {
                let window: &[u8; DATAGRAM] = window.try_into().expect("nine");
                let is_whole = checksum(window) == window[DATAGRAM - 1];
                let idle = window[0] == 0 || window[1] == 0;
                assert!(!is_whole || idle, "{address} {motor}: {window:?}");
            }
        }
    }
}

/// Silence of a wire: until when, and what of it is lost meanwhile.
fn mute(wire: &mut TestWire, silence_ms: u32, both: bool) -> Instant {
    let until = wire.now.plus_ms(silence_ms);
    let clock = Rc::new(Cell::new(wire.now));
    let (down, up) = (Rc::clone(&clock), Rc::clone(&clock));
    wire.clock = Some(clock);
    wire.replies = Box::new(move |_, _| (down.get() < until).then(Vec::new));
    wire.requests = Box::new(move |_, _| (both && up.get() < until).then(Vec::new));
    until
}

/// Acts of the program during silence: reads, stops, or a stop and then reads of standstill.
#[derive(Clone, Copy, PartialEq, Debug)]
enum HostActivity {
    Reads,
    Stops,
    Both,
    /// Pauses between requests, as the command line has after Ctrl-C.
    Pauses,
}

impl HostActivity {
    const ALL: [Self; 4] = [Self::Reads, Self::Stops, Self::Both, Self::Pauses];

    /// Does the nth thing. True where a module in step has answered.
    fn run_once(self, wire: &mut TestWire, nth: u32) -> bool {
        let stops = match self {
            Self::Reads => false,
            Self::Stops => true,
            Self::Both | Self::Pauses => nth.is_multiple_of(3),
        };
        if self == Self::Pauses && stops && nth > 0 {
            wire.rest(350);
        }
        if stops { stop(wire) && self == Self::Stops } else { wire.read(9) == Ok(9007) }
    }
}

/// A module in step whose wire was silent answers soon after its wire is well, whatever pause it knows; and
/// an acknowledged stop is taken for that.
#[test]
fn a_module_in_step_is_received_soon_after_a_silence() {
    let pauses = [None, Some(5), Some(30), Some(40), Some(99), Some(130), Some(200), Some(500)];
    let silences = (1..30).map(|n| n * 97).chain([4003, 10_007]);
    let mut slow = Vec::new();
    for silence_ms in silences {
        for byte_timeout_ms in pauses {
            for (baud, both) in [(0, true), (9600, true), (0, false), (9600, false)] {
                for doing in HostActivity::ALL {
                    let bad_sum = BAD_SUMS[silence_ms as usize % 3];
                    let quirks = Quirks {
                        checksum_error_reply: bad_sum,
                        byte_timeout_ms,
                        ..Quirks::default()
                    };
                    let mut wire = TestWire::new(baud, quirks);
                    wire.host = SerialHost::new(&HostOptions {
                        probe_seed: Some(5),
                        ..HostOptions::new(baud)
                    });
                    assert_eq!(wire.read(4), Ok(4007));
                    let until = mute(&mut wire, silence_ms, both);
                    let mut nth = 0;
                    while !(doing.run_once(&mut wire, nth) && wire.now >= until) {
                        nth += 1;
                        if wire.now > until.plus_ms(10_000) {
                            break;
                        }
                    }
                    let took = wire.now.since(until).as_millis();
                    if took > SOON_MS[usize::from(both)] {
                        slow.push((took, silence_ms, byte_timeout_ms, baud, both, doing));
                    }
                }
            }
        }
    }
    slow.sort_by_key(|case| core::cmp::Reverse(case.0));
    assert!(slow.is_empty(), "{}: {:?}", slow.len(), &slow[..slow.len().min(12)]);
}

/// On two wires nothing is received of requests to all positions: a module that lost count is brought back
/// all the same, by reads or by stops.
#[test]
fn a_module_that_lost_count_on_two_wires_is_brought_back() {
    for extra in 1..DATAGRAM {
        for doing in [HostActivity::Reads, HostActivity::Stops] {
            let mut wire = counting(9600, ChecksumErrorReply::Never);
            assert_eq!(wire.read(4), Ok(4007));
            wire.end.handle_input(wire.now, &[0x55; 9][..extra], &mut wire.firmware);
            let sends = Rc::new(Cell::new(false));
            let long = Rc::clone(&sends);
            wire.requests = Box::new(move |_, bytes| {
                long.set(bytes.len() > DATAGRAM);
                None
            });
            wire.replies = Box::new(move |_, _| sends.get().then(Vec::new));
            let start = wire.now;
            while !doing.run_once(&mut wire, 0) {
                let took = wire.now.since(start).as_millis();
                assert!(took < 10_000, "{extra} {doing:?}: {:?}", wire.host);
            }
        }
    }
}
