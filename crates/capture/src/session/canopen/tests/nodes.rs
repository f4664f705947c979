//! NMT, heartbeat, guarding, emergencies.

use super::*;

const BEAT: u16 = 0x700 | NODE as u16;

#[test]
fn a_node_comes_up_and_works() {
    let mut bus = CanopenLog::default();
    bus.send(BEAT, &[0]).heartbeats(0x7F, 100, 5).send(0x000, &[1, 0]).heartbeats(5, 100, 20);
    let report = bus.report();
    report.assert_clean();
    let states =
        [("", "boot-up"), ("boot-up", "pre-operational"), ("pre-operational", "operational")];
    assert_eq!(report.changes("nmt"), states);
    assert_eq!(report.changes("presence"), [("", "present")]);
}

#[test]
fn without_a_heartbeat_the_order_is_the_state() {
    let mut bus = CanopenLog::default();
    bus.send(BEAT, &[0]).send(0x000, &[1, NODE]).send(0x000, &[2, 0]);
    let report = bus.report();
    report.assert_clean();
    let states = [("", "boot-up"), ("boot-up", "operational"), ("operational", "stopped")];
    assert_eq!(report.changes("nmt"), states);
}

#[test]
fn a_start_in_use_is_reported() {
    let mut bus = CanopenLog::default();
    bus.heartbeats(5, 100, 10).send(BEAT, &[0]).heartbeats(0x7F, 100, 10);
    bus.report().assert_only(AnomalyKind::Restart);
    let mut bus = CanopenLog::default();
    bus.heartbeats(5, 100, 10).send(0x000, &[0x81, 0]).wait(500).send(BEAT, &[0]);
    bus.heartbeats(0x7F, 100, 10).report().assert_clean();
}

#[test]
fn a_request_that_meets_the_boot_up_is_answered_by_one_node() {
    let kind = ObjectIndex::new(0x1000, 0);
    let reply = || SdoReply::Value(kind, ExpeditedData { bits: 0x20192, len: 4 });
    let mut bus = CanopenLog::default();
    bus.read(kind, 0x20192, 4).send(0x000, &[0x81, 0]).wait(300).request(SdoRequest::Read(kind));
    bus.now -= 1_000_000;
    bus.send(BEAT, &[0]).reply(reply()).read(kind, 0x20192, 4).report().assert_clean();
    // A request from long before is lost.
    let mut bus = CanopenLog::default();
    bus.read(kind, 0x20192, 4).request(SdoRequest::Read(kind)).wait(300).send(BEAT, &[0]);
    assert_eq!(bus.report().anomalies(), [AnomalyKind::Restart, AnomalyKind::Unanswered]);
}

#[test]
fn a_heartbeat_that_stays_out_is_reported_once() {
    let mut bus = CanopenLog::default();
    bus.heartbeats(5, 100, 10);
    (0..50).for_each(|_| {
        bus.wait(20).send(0x80, &[]);
    });
    let report = bus.report();
    report.assert_only(AnomalyKind::Silent);
    assert_eq!(report.texts(), ["no heartbeat for 267 ms, which came every 100 ms"]);
    let report = bus.heartbeats(5, 100, 10).report();
    report.assert_only(AnomalyKind::Silent);
    let presence = [("", "present"), ("present", "silent"), ("silent", "present")];
    assert_eq!(report.changes("presence"), presence);
}

#[test]
fn a_configured_heartbeat_is_missed_from_its_first() {
    let mut bus = CanopenLog::default();
    bus.write(ObjectIndex::new(0x1017, 0), 200, 2).heartbeats(5, 200, 1);
    (0..50).for_each(|_| {
        bus.wait(20).send(0x80, &[]);
    });
    bus.report().assert_only(AnomalyKind::Silent);
    let mut bus = CanopenLog::default();
    bus.heartbeats(5, 100, 10).write(ObjectIndex::new(0x1017, 0), 0, 2);
    bus.wait(5000).send(0x80, &[]).report().assert_clean();
}

#[test]
fn a_pause_in_a_capture_is_no_anomaly() {
    let mut bus = CanopenLog::default();
    for part in 0..2 {
        for _ in 0..10 {
            bus.send(0x703, &[5]).send(0x704, &[5]).wait(98);
        }
        bus.wait(if part == 0 { 60_000 } else { 0 });
    }
    bus.report().assert_only(AnomalyKind::Silent);
}

#[test]
fn two_heartbeats_of_one_number_are_two_nodes() {
    // The second one joins.
    let mut bus = CanopenLog::default();
    bus.heartbeats(5, 100, 10);
    for _ in 0..10 {
        bus.send(BEAT, &[5]).wait(29).send(BEAT, &[5]).wait(69);
    }
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
    // Both from the start.
    let mut bus = CanopenLog::default();
    for _ in 0..10 {
        bus.send(BEAT, &[5]).wait(29).send(BEAT, &[5]).wait(69);
    }
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
    // In states that contradict one another.
    let mut bus = CanopenLog::default();
    for _ in 0..10 {
        bus.send(BEAT, &[5]).wait(49).send(BEAT, &[0x7F]).wait(49);
    }
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
}

#[test]
fn two_that_start_at_once_are_two() {
    let mut bus = CanopenLog::default();
    bus.send(0x000, &[0x81, 0]).send(BEAT, &[0]).wait(3).send(BEAT, &[0]);
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
}

#[test]
fn a_node_may_say_0_until_it_is_started() {
    let mut bus = CanopenLog::default();
    bus.send(BEAT, &[0]).read(WORD, 0, 2).write(ObjectIndex::new(0x1017, 0), 100, 2);
    bus.heartbeats(0, 100, 5).read(WORD, 0, 2).heartbeats(0, 100, 5).send(0x000, &[1, 0]);
    bus.heartbeats(5, 100, 5).send(0x000, &[0x81, 0]).heartbeats(0, 100, 8).report().assert_clean();
    // Set without a receiver.
    let mut bus = CanopenLog::default();
    bus.send(BEAT, &[0]).send(BEAT, &[0]).wait(99).read(WORD, 0, 2).wait(97);
    bus.heartbeats(0, 100, 5).report().assert_clean();
    // Without a pace it is a start.
    let mut bus = CanopenLog::default();
    bus.send(BEAT, &[0]).read(WORD, 0, 2).wait(3000).send(BEAT, &[0]).read(WORD, 0, 2);
    bus.report().assert_only(AnomalyKind::Restart);
}

#[test]
fn a_heartbeat_that_trembles_is_one_node_s() {
    let mut bus = CanopenLog::default();
    for n in 0_u64..300 {
        bus.send(BEAT, &[5]).wait(80 + (n * 7919) % 41);
    }
    bus.report().assert_clean();
}

#[test]
fn process_data_before_the_start_break_the_rules() {
    let mut bus = CanopenLog::default();
    bus.heartbeats(0x7F, 100, 4).send(0x185, &[1, 2]).heartbeats(0x7F, 100, 4);
    bus.send(0x185, &[1, 2]).heartbeats(0x7F, 100, 4);
    bus.report().assert_only(AnomalyKind::Malformed);
    let mut bus = CanopenLog::default();
    bus.heartbeats(0x7F, 100, 4).send(0, &[1, 5]).send(0x185, &[1, 2]).heartbeats(5, 100, 4);
    bus.report().assert_clean();
}

#[test]
fn guarding_alternates() {
    let guard = |bus: &mut CanopenLog| {
        let id = u32::from(BEAT);
        bus.frame(Frame { id, remote: true, len: 1, ..Frame::default() });
    };
    let mut bus = CanopenLog::default();
    for n in 0..10 {
        guard(&mut bus);
        bus.send(BEAT, &[5 | (n % 2) << 7]).wait(100);
    }
    let report = bus.report();
    report.assert_clean();
    assert_eq!(report.exchanges().len(), 10);
    guard(&mut bus);
    bus.send(BEAT, &[0x85]).report().assert_only(AnomalyKind::Sequence);
    for _ in 0..3 {
        guard(&mut bus);
        bus.wait(100);
    }
    assert_eq!(bus.report().anomalies(), [AnomalyKind::Sequence, AnomalyKind::Unanswered]);
    // A search for nodes accuses none of them.
    let mut bus = CanopenLog::default();
    guard(&mut bus);
    bus.wait(3000).send(0x80, &[]).report().assert_clean();
}

#[test]
fn an_emergency_is_a_fault_until_it_is_gone() {
    let mut bus = CanopenLog::default();
    bus.send(0x085, &[0x10, 0x23, 2, 0, 0, 0, 0, 0]).send(0x085, &[0; 8]);
    let report = bus.report();
    report.assert_clean();
    let faults: Vec<_> = report.faults().iter().map(|f| (f.code, f.text, f.gone)).collect();
    let text = "current, output side";
    assert_eq!(faults, [(0x2310, text, false), (0x2310, text, true)]);
}

#[test]
fn two_bytes_are_a_ts_drive_s() {
    let mut bus = CanopenLog::default();
    let report = bus.send(0x085, &[0x0C, 0x16]).report();
    report.assert_clean();
    let [fault] = report.faults()[..] else { panic!("{report:?}") };
    assert_eq!((fault.code, fault.text), (0x160C, "Over-current in the power stage."));
    assert!(!fault.cause.is_empty() && !fault.remedy.is_empty());
    assert!(report.lines[0].ends_with("(inferred: Over-current in the power stage)"), "{report:?}");
}

#[test]
fn a_storm_is_reported_once() {
    let mut bus = CanopenLog::default();
    (0..50).for_each(|n: u8| {
        bus.send(0x085, &[n % 3, 0x10, 1, 0, 0, 0, 0, 0]);
    });
    bus.report().assert_only(AnomalyKind::Storm);
    bus.wait(5000);
    (0..50).for_each(|n: u8| {
        bus.send(0x085, &[n % 3, 0x10, 1, 0, 0, 0, 0, 0]);
    });
    assert_eq!(bus.report().anomalies(), [AnomalyKind::Storm, AnomalyKind::Storm]);
}
