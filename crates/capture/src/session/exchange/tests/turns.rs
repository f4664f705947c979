//! Lost and late answers to hosts that take turns, and to hosts that do not wait.

use super::*;
use crate::session::Quality;

/// Lost and late answers of a drive, in thousandths.
#[derive(Clone, Copy, Debug)]
struct AnswerFaults {
    lost: u64,
    late: u64,
}

/// A host that reads three parameters in turn, one every 20 ms, and a drive that answers one request after the other.
/// Values of parameter `kind` begin with that digit.
fn turns_with_faults(faults: AnswerFaults, on_can: bool, mut seed: u64) -> SerialLog {
    const KINDS: [u8; 3] = [1, 4, 3];
    let mut random = |below: u64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % below
    };
    // Time of each frame, µs, and its parameter; a value for answers.
    let mut frames: Vec<(u64, u8, Option<i32>)> = Vec::new();
    let mut drive_is_free = 0;
    for n in 0..960 {
        let (now, kind) = (20_000 * n, KINDS[n as usize % 3]);
        frames.push((now, kind, None));
        let chance = random(1000);
        if chance < faults.lost {
            continue;
        }
        let late = chance < faults.lost + faults.late;
        let work = if late { 20_100 + random(15_000) } else { 2000 + random(2000) };
        drive_is_free = now.max(drive_is_free) + work;
        let value = i32::from(kind) * 1000 + i32::try_from(random(1000)).unwrap();
        frames.push((drive_is_free, kind, Some(value)));
    }
    frames.sort_by_key(|(time, ..)| *time);
    let mut tape = SerialLog::default();
    for (time, kind, value) in frames {
        tape.micros = time;
        let request = Request { address: 1, opcode: Opcode::Gap, kind, motor: 0, value: 0 };
        let answer = |value| {
            let (status, opcode) = (Status::Ok, Opcode::Gap);
            Reply { host: 2, module: 1, status, opcode, value }
        };
        match value {
            None if on_can => tape.can(&request.emit_can(1, false)),
            None => tape.request(&request.emit()),
            Some(value) if on_can => tape.can(&answer(value).emit_can(2, false)),
            Some(value) => tape.reply(&answer(value).emit()),
        };
    }
    tape
}

/// Values of a parameter that the log gives to another without a doubt, those that it doubts, and all.
fn misread(log: &SerialLog) -> (usize, usize, usize) {
    let (mut wrong, mut doubted, mut all) = (0, 0, 0);
    log.decode("tmcl", |notices| {
        for notice in notices {
            let SessionNotice::Signal(signal) = notice else { continue };
            let kind = match signal.name {
                "Actual/Position" => 1,
                "Actual/Velocity" => 3,
                "max positioning velocity" => 4,
                other => panic!("{other}"),
            };
            all += 1;
            let is_right = signal.exact.is_some_and(|value| value / 1000 == kind);
            match signal.quality {
                Quality::Stale => doubted += 1,
                _ => wrong += usize::from(!is_right),
            }
        }
    });
    (wrong, doubted, all)
}

/// Lost answers do not shift the others, and an answer that comes after the host went on is doubted.
#[test]
fn answers_of_a_host_that_takes_turns_belong_to_their_requests() {
    for (lost, late) in [(0, 0), (10, 0), (100, 0), (300, 0), (0, 10), (0, 50), (50, 50)] {
        for (on_can, seed) in [(false, 1), (true, 1), (false, 2), (true, 2)] {
            let faults = AnswerFaults { lost, late };
            let (wrong, doubted, all) = misread(&turns_with_faults(faults, on_can, seed));
            // Late, and in the usual time after a third request, an answer looks like the one to that.
            let wrong_max = if lost + late > 10 && late > 0 { 5 } else { 0 };
            assert!(wrong <= wrong_max, "{faults:?}: {wrong} of {all}");
            assert!(doubted <= 3 * 960 * (lost + late) as usize / 1000, "{faults:?}: {doubted}");
        }
    }
}

/// Requests that are sent without a wait are answered in their order.
#[test]
fn answers_to_several_requests_at_once_belong_to_them_in_order() {
    let mut tape = SerialLog::default();
    for n in 0..40 {
        tape.after(30);
        for kind in [1, 4, 3] {
            let request = Request { address: 1, opcode: Opcode::Gap, kind, motor: 0, value: 0 };
            tape.can(&request.emit_can(1, false));
        }
        tape.after(6);
        for kind in [1, 4, 3] {
            let (status, opcode, value) = (Status::Ok, Opcode::Gap, kind * 1000 + n);
            tape.can(&Reply { host: 2, module: 1, status, opcode, value }.emit_can(2, false));
        }
    }
    assert_eq!(misread(&tape), (0, 0, 120));
}
