//! NMT, heartbeat, guarding, emergencies.

use super::*;

const BEAT: u16 = 0x700 | NODE as u16;

#[test]
fn a_node_comes_up_and_works() {
    let mut bus = Bus::default();
    bus.say(BEAT, &[0]).heartbeats(0x7F, 100, 5).say(0x000, &[1, 0]).heartbeats(5, 100, 20);
    let told = bus.told();
    told.clean();
    let states =
        [("", "boot-up"), ("boot-up", "pre-operational"), ("pre-operational", "operational")];
    assert_eq!(told.changes("nmt"), states);
    assert_eq!(told.changes("presence"), [("", "present")]);
}

#[test]
fn without_a_heartbeat_the_order_is_the_state() {
    let mut bus = Bus::default();
    bus.say(BEAT, &[0]).say(0x000, &[1, NODE]).say(0x000, &[2, 0]);
    let told = bus.told();
    told.clean();
    let states = [("", "boot-up"), ("boot-up", "operational"), ("operational", "stopped")];
    assert_eq!(told.changes("nmt"), states);
}

#[test]
fn a_start_in_use_is_told() {
    let mut bus = Bus::default();
    bus.heartbeats(5, 100, 10).say(BEAT, &[0]).heartbeats(0x7F, 100, 10);
    bus.told().planted(Oddity::Restart);
    let mut bus = Bus::default();
    bus.heartbeats(5, 100, 10).say(0x000, &[0x81, 0]).wait(500).say(BEAT, &[0]);
    bus.heartbeats(0x7F, 100, 10).told().clean();
}

#[test]
fn a_request_that_meets_the_boot_up_is_answered_by_one_node() {
    let kind = Object::new(0x1000, 0);
    let reply = || Reply::Value(kind, Short { bits: 0x20192, len: 4 });
    let mut bus = Bus::default();
    bus.read(kind, 0x20192, 4).say(0x000, &[0x81, 0]).wait(300).ask(Request::Read(kind));
    bus.now -= 1_000_000;
    bus.say(BEAT, &[0]).answer(reply()).read(kind, 0x20192, 4).told().clean();
    // What is asked long before is lost.
    let mut bus = Bus::default();
    bus.read(kind, 0x20192, 4).ask(Request::Read(kind)).wait(300).say(BEAT, &[0]);
    assert_eq!(bus.told().odds(), [Oddity::Restart, Oddity::Unanswered]);
}

#[test]
fn a_heartbeat_that_stays_out_is_told_once() {
    let mut bus = Bus::default();
    bus.heartbeats(5, 100, 10);
    (0..50).for_each(|_| {
        bus.wait(20).say(0x80, &[]);
    });
    let told = bus.told();
    told.planted(Oddity::Silent);
    assert_eq!(told.texts(), ["no heartbeat for 267 ms, which came every 100 ms"]);
    let told = bus.heartbeats(5, 100, 10).told();
    told.planted(Oddity::Silent);
    let presence = [("", "present"), ("present", "silent"), ("silent", "present")];
    assert_eq!(told.changes("presence"), presence);
}

#[test]
fn a_configured_heartbeat_is_missed_from_its_first() {
    let mut bus = Bus::default();
    bus.write(Object::new(0x1017, 0), 200, 2).heartbeats(5, 200, 1);
    (0..50).for_each(|_| {
        bus.wait(20).say(0x80, &[]);
    });
    bus.told().planted(Oddity::Silent);
    let mut bus = Bus::default();
    bus.heartbeats(5, 100, 10).write(Object::new(0x1017, 0), 0, 2);
    bus.wait(5000).say(0x80, &[]).told().clean();
}

#[test]
fn a_capture_that_pauses_accuses_no_node() {
    let mut bus = Bus::default();
    for part in 0..2 {
        for _ in 0..10 {
            bus.say(0x703, &[5]).say(0x704, &[5]).wait(98);
        }
        bus.wait(if part == 0 { 60_000 } else { 0 });
    }
    bus.told().planted(Oddity::Silent);
}

#[test]
fn two_heartbeats_of_one_number_are_two_nodes() {
    // The second one joins.
    let mut bus = Bus::default();
    bus.heartbeats(5, 100, 10);
    for _ in 0..10 {
        bus.say(BEAT, &[5]).wait(29).say(BEAT, &[5]).wait(69);
    }
    bus.told().planted(Oddity::DuplicateAddress);
    // Both from the start.
    let mut bus = Bus::default();
    for _ in 0..10 {
        bus.say(BEAT, &[5]).wait(29).say(BEAT, &[5]).wait(69);
    }
    bus.told().planted(Oddity::DuplicateAddress);
    // In states that contradict one another.
    let mut bus = Bus::default();
    for _ in 0..10 {
        bus.say(BEAT, &[5]).wait(49).say(BEAT, &[0x7F]).wait(49);
    }
    bus.told().planted(Oddity::DuplicateAddress);
}

#[test]
fn two_that_start_at_once_are_two() {
    let mut bus = Bus::default();
    bus.say(0x000, &[0x81, 0]).say(BEAT, &[0]).wait(3).say(BEAT, &[0]);
    bus.told().planted(Oddity::DuplicateAddress);
}

#[test]
fn a_node_may_say_0_until_it_is_started() {
    let mut bus = Bus::default();
    bus.say(BEAT, &[0]).read(WORD, 0, 2).write(Object::new(0x1017, 0), 100, 2);
    bus.heartbeats(0, 100, 5).read(WORD, 0, 2).heartbeats(0, 100, 5).say(0x000, &[1, 0]);
    bus.heartbeats(5, 100, 5).say(0x000, &[0x81, 0]).heartbeats(0, 100, 8).told().clean();
    // Set where nobody hears it.
    let mut bus = Bus::default();
    bus.say(BEAT, &[0]).say(BEAT, &[0]).wait(99).read(WORD, 0, 2).wait(97);
    bus.heartbeats(0, 100, 5).told().clean();
    // Without a pace it is a start.
    let mut bus = Bus::default();
    bus.say(BEAT, &[0]).read(WORD, 0, 2).wait(3000).say(BEAT, &[0]).read(WORD, 0, 2);
    bus.told().planted(Oddity::Restart);
}

#[test]
fn a_heartbeat_that_trembles_is_one_node_s() {
    let mut bus = Bus::default();
    for n in 0_u64..300 {
        bus.say(BEAT, &[5]).wait(80 + (n * 7919) % 41);
    }
    bus.told().clean();
}

#[test]
fn process_data_before_the_start_break_the_rules() {
    let mut bus = Bus::default();
    bus.heartbeats(0x7F, 100, 4).say(0x185, &[1, 2]).heartbeats(0x7F, 100, 4);
    bus.say(0x185, &[1, 2]).heartbeats(0x7F, 100, 4);
    bus.told().planted(Oddity::Malformed);
    let mut bus = Bus::default();
    bus.heartbeats(0x7F, 100, 4).say(0, &[1, 5]).say(0x185, &[1, 2]).heartbeats(5, 100, 4);
    bus.told().clean();
}

#[test]
fn guarding_alternates() {
    let guard = |bus: &mut Bus| {
        let id = u32::from(BEAT);
        bus.frame(Frame { id, remote: true, len: 1, ..Frame::default() });
    };
    let mut bus = Bus::default();
    for n in 0..10 {
        guard(&mut bus);
        bus.say(BEAT, &[5 | (n % 2) << 7]).wait(100);
    }
    let told = bus.told();
    told.clean();
    assert_eq!(told.exchanges().len(), 10);
    guard(&mut bus);
    bus.say(BEAT, &[0x85]).told().planted(Oddity::Sequence);
    for _ in 0..3 {
        guard(&mut bus);
        bus.wait(100);
    }
    assert_eq!(bus.told().odds(), [Oddity::Sequence, Oddity::Unanswered]);
    // Who looks who is there accuses none.
    let mut bus = Bus::default();
    guard(&mut bus);
    bus.wait(3000).say(0x80, &[]).told().clean();
}

#[test]
fn an_emergency_is_a_fault_until_it_is_gone() {
    let mut bus = Bus::default();
    bus.say(0x085, &[0x10, 0x23, 2, 0, 0, 0, 0, 0]).say(0x085, &[0; 8]);
    let told = bus.told();
    told.clean();
    let faults: Vec<_> = told.faults().iter().map(|f| (f.code, f.text, f.gone)).collect();
    let text = "current, output side";
    assert_eq!(faults, [(0x2310, text, false), (0x2310, text, true)]);
}

#[test]
fn two_bytes_are_a_ts_drive_s() {
    let mut bus = Bus::default();
    let told = bus.say(0x085, &[0x0C, 0x16]).told();
    told.clean();
    let [fault] = told.faults()[..] else { panic!("{told:?}") };
    assert_eq!((fault.code, fault.text), (0x160C, "Over-current in the power stage."));
    assert!(!fault.cause.is_empty() && !fault.remedy.is_empty());
    assert!(told.lines[0].ends_with("(inferred: Over-current in the power stage)"), "{told:?}");
}

#[test]
fn a_storm_is_told_once() {
    let mut bus = Bus::default();
    (0..50).for_each(|n: u8| {
        bus.say(0x085, &[n % 3, 0x10, 1, 0, 0, 0, 0, 0]);
    });
    bus.told().planted(Oddity::Storm);
    bus.wait(5000);
    (0..50).for_each(|n: u8| {
        bus.say(0x085, &[n % 3, 0x10, 1, 0, 0, 0, 0, 0]);
    });
    assert_eq!(bus.told().odds(), [Oddity::Storm, Oddity::Storm]);
}
