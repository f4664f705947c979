//! The drive's own watchdog: which parameter it is, what it is set to, and whether it works.

use polepair::axis::WatchdogState;
use polepair::doctor::{CheckResult, Grade, ProofObserver, prove_watchdog};
use polepair::{Error, LocalAxis, LocalLink};
use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::time::Duration;

const HALF: Duration = Duration::from_millis(500);

fn open(url: &str) -> LocalLink {
    polepair::connect_local(&format!("{url}time=virtual")).unwrap_or_else(|e| panic!("{url}: {e}"))
}

fn name(axis: &LocalAxis) -> &'static str {
    let id = axis.watchdog_parameter();
    id.and_then(|id| axis.profile().parameter(id)).map_or("", |parameter| parameter.name)
}

/// Returns the result of the watchdog's proof, and the check of the setting made for it.
fn proven(axis: &LocalAxis, after: Option<Duration>) -> (CheckResult, Option<CheckResult>) {
    let mut checks = Vec::new();
    prove_watchdog(axis, after, &mut |check| checks.push(check)).unwrap();
    assert_eq!(checks.len(), 1 + usize::from(after.is_some()), "{checks:#?}");
    let last = after.and_then(|_| checks.pop());
    (checks.remove(0), last)
}

#[test]
fn a_module_has_one_for_each_medium() {
    for (url, own, other) in [
        ("sim:tmcl?", "serial heartbeat", "can heartbeat"),
        ("sim:tmcl+can:3?", "can heartbeat", "serial heartbeat"),
    ] {
        let link = open(url);
        let axis = &link.axes()[0];
        assert_eq!((name(axis), axis.watchdog().unwrap()), (own, WatchdogState::Off), "{url}");
        axis.set_raw(other, 500).unwrap();
        assert_eq!(axis.watchdog().unwrap(), WatchdogState::Off, "{url}: the other wire's");
        assert_eq!(axis.set_watchdog(Some(HALF)).unwrap(), WatchdogState::On(HALF), "{url}");
        assert_eq!(axis.get_raw(own).unwrap(), 500);
        assert_eq!(axis.set_watchdog(None).unwrap(), WatchdogState::Off, "{url}");
    }
}

#[test]
fn each_that_there_is_stops_the_motor_when_its_host_falls_silent() {
    for url in [
        "sim:tmcl?",
        "sim:tmcl+can:3?",
        "sim:thruster?",
        "sim:cia402:5?heartbeat=100&",
        "sim:syntron-ts-canopen:5?heartbeat=100&fn00=20&",
    ] {
        let link = open(url);
        let axis = &link.axes()[0];
        let before = axis.watchdog().unwrap();
        let (check, last) = proven(axis, Some(HALF));
        assert_eq!(check.grade, Grade::Ok, "{url}: {check:#?}");
        let last = last.unwrap().found;
        match before {
            WatchdogState::Unknown => assert!(last.contains("stays set"), "{url}: {last}"),
            _ => {
                assert_eq!(axis.watchdog().unwrap(), before, "{url}");
                assert!(last.contains("is restored") && last.contains("off"), "{url}: {last}");
            }
        }
        let stored = last.contains("in its permanent memory");
        assert_eq!(stored, url.starts_with("sim:tmcl"), "{url}: {last}");
        assert!(check.found.contains("of silence"), "{url}: {check:#?}");
        let speed = link.simulation().unwrap().truth(0, 0).unwrap().velocity;
        assert!(speed.abs() < 0.1, "{url}: {speed}");
    }
}

#[test]
fn nothing_moves_where_there_is_nothing_to_prove() {
    for (url, text) in [
        ("sim:tmcl?", "off"),
        ("sim:thruster?", "does not report"),
        ("sim:modbus-rtu?fn00=1&", "none"),
        ("sim:cia402:5?heartbeat=100&", "off"),
        ("sim:syntron-ts-canopen:5?heartbeat=100&fn00=20&", "off"),
    ] {
        let link = open(url);
        let (check, _) = proven(&link.axes()[0], None);
        assert_eq!(check.grade, Grade::Wrong, "{url}: {check:#?}");
        assert!(check.found.contains(text), "{url}: {check:#?}");
        assert!(link.simulation().unwrap().truth(0, 0).unwrap().position.abs() < 0.1, "{url}");
    }
}

#[test]
fn a_drive_is_had_to_watch_the_hosts_heartbeat_unless_it_watches_somebody() {
    use WatchdogState::{NoReaction, Off, On, OtherNode};
    let ms = Duration::from_millis;
    let link = open("sim:cia402:5?heartbeat=100&");
    let axis = &link.axes()[0];
    assert_eq!(axis.watch_host().unwrap(), Some([Off, On(ms(300))]));
    assert_eq!(axis.get_raw("consumer heartbeat").unwrap(), 127 << 16 | 300);
    assert_ne!(axis.get_raw("lost connection option").unwrap(), 0);
    // What watches this host already is left alone, with its own time and reaction.
    axis.set_raw("consumer heartbeat", 127 << 16 | 500).unwrap();
    axis.set_raw("lost connection option", 2).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([On(HALF), On(HALF)]));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 2);
    axis.set_raw("lost connection option", 0).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([NoReaction(HALF), On(HALF)]));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 3, "quick stop");
    axis.set_raw("consumer heartbeat", 3 << 16 | 500).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([OtherNode { node: 3 }; 2]));
    // Nothing is set for a host that sends none, nor where none is watched.
    let silent = open("sim:cia402:5?");
    assert_eq!(silent.axes()[0].watch_host().unwrap(), None);
    assert_eq!(silent.axes()[0].watchdog().unwrap(), Off);
    assert_eq!(open("sim:tmcl+can:3?").axes()[0].watch_host().unwrap(), None);
}

#[test]
fn a_heartbeat_that_is_watched_has_to_lead_to_something() {
    let link = open("sim:cia402:5?");
    let axis = &link.axes()[0];
    axis.set_raw("lost connection option", 0).unwrap();
    axis.set_raw("consumer heartbeat", 127 << 16 | 500).unwrap();
    assert_eq!(axis.watchdog().unwrap(), WatchdogState::NoReaction(HALF));
    axis.set_raw("consumer heartbeat", 3 << 16 | 500).unwrap();
    assert_eq!(axis.watchdog().unwrap(), WatchdogState::OtherNode { node: 3 });
    assert_eq!(axis.set_watchdog(Some(HALF)).unwrap(), WatchdogState::On(HALF));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 3, "quick stop");
    let (check, _) = proven(axis, None);
    assert!(check.found.contains("sends none"), "{check:#?}");
    // The request that it watches is not sent by this host: its state states that.
    let text = axis.describe_watchdog(axis.watchdog().unwrap());
    assert!(
        text.contains("watches node 127") && text.contains("this connection sends none"),
        "{text}"
    );
    assert!(axis.watchdog_caution(false).is_some() && axis.watchdog_caution(true).is_none());
    let sends = open("sim:cia402:5?heartbeat=100&");
    let axis = &sends.axes()[0];
    let text = axis.describe_watchdog(axis.set_watchdog(Some(HALF)).unwrap());
    assert_eq!(text, "on, the drive stops after 500 ms of silence");
}

/// Ends a proof as soon as the motor turns.
struct Ends<'a> {
    link: &'a LocalLink,
    found: Vec<String>,
}

impl ProofObserver for Ends<'_> {
    fn report_check(&mut self, check: CheckResult) {
        self.found.push(check.found);
    }

    fn is_cancelled(&self) -> bool {
        speed(self.link) > 0.5
    }
}

fn speed(link: &LocalLink) -> f64 {
    link.simulation().unwrap().truth(0, 0).unwrap().velocity.abs()
}

#[test]
fn an_interrupted_proof_stops_the_motor_and_restores_the_watchdog() {
    for url in ["sim:tmcl?", "sim:tmcl+can:3?", "sim:cia402:5?heartbeat=100&"] {
        let link = open(url);
        let axis = &link.axes()[0];
        let before = axis.watchdog().unwrap();
        let mut ends = Ends { link: &link, found: Vec::new() };
        let unproven = prove_watchdog(axis, Some(HALF), &mut ends).unwrap_err();
        assert!(matches!(*unproven.error, Error::Interrupted { .. }), "{url}: {unproven:?}");
        assert!(unproven.moved && !unproven.may_turn, "{url}: {unproven:?}");
        assert!(!unproven.to_string().contains("may still turn"), "{url}: {unproven}");
        // The watchdog was not needed: the motor was stopped.
        assert!(speed(&link) < 0.1, "{url}: {}", speed(&link));
        assert_eq!(axis.watchdog().unwrap(), before, "{url}");
        let [last] = &ends.found[..] else { panic!("{url}: {:?}", ends.found) };
        assert!(last.contains("is restored"), "{url}: {last}");
        axis.armed().unwrap().release().unwrap_or_else(|error| panic!("{url}: {error}"));
    }
}

/// A TMCL module made from the protocol's manual. It turns on request, and stops replying after
/// this number of speed readings. Returns its address.
fn module_that_falls_silent(after: u32) -> String {
    module(after, 100)
}

/// The same, which answers with this status to who asks for its heartbeat, and sets it.
fn module(after: u32, status: u8) -> String {
    let server = TcpListener::bind("127.0.0.1:0").expect("a port");
    let at = server.local_addr().expect("an address");
    std::thread::spawn(move || {
        let (mut wire, _) = server.accept().expect("a host");
        let (mut request, mut speed, mut reported, mut heartbeat) = ([0; 9], 0, 0, 0);
        while wire.read_exact(&mut request).is_ok() {
            let given = i32::from_be_bytes([request[4], request[5], request[6], request[7]]);
            let value = match (request[1], request[2]) {
                // ROR and MST; the serial heartbeat is SGP and GGP 68.
                (1, _) => std::mem::replace(&mut speed, given),
                (3, _) => 0,
                (9, 68) => std::mem::replace(&mut heartbeat, given),
                (10, 68) => heartbeat,
                (6, 3) => speed,
                (6, 210 | 250) => 4000,
                _ => 0,
            };
            reported += u32::from(speed != 0 && (request[1], request[2]) == (6, 3));
            if reported > after {
                continue;
            }
            let status = if matches!(request[1], 9 | 10) { status } else { 100 };
            let mut reply = [2, 1, status, request[1], 0, 0, 0, 0, 0];
            reply[4..8].copy_from_slice(&value.to_be_bytes());
            reply[8] = reply[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
            if wire.write_all(&reply).is_err() {
                return;
            }
        }
    });
    format!("tmcl+tcp://{at}?profile=tmcm-170&timeout=100#1")
}

#[test]
fn a_firmware_that_has_none_has_nothing_proven_and_does_not_move() {
    for after in [None, Some(HALF)] {
        let link = polepair::connect_local(&module(u32::MAX, 3)).expect("a module");
        let axis = &link.axes()[0];
        let mut checks = Vec::new();
        prove_watchdog(axis, after, &mut |check| checks.push(check)).expect("nothing is wrong");
        let [check] = &checks[..] else { panic!("{checks:#?}") };
        assert_eq!(check.grade, Grade::Wrong, "{check:#?}");
        assert!(
            check.found.contains("none") && check.found.contains("nothing moved"),
            "{check:#?}"
        );
        assert!(check.remedy.contains("works without a computer"), "{check:#?}");
    }
}

/// Records the findings, and repeats a lost stop this many times.
struct Patient {
    left: u32,
    turns: bool,
    found: Vec<String>,
}

impl ProofObserver for Patient {
    fn report_check(&mut self, check: CheckResult) {
        self.found.push(check.found);
    }

    fn retry_stop(&mut self, _: &LocalAxis, turns: bool) -> bool {
        self.turns |= turns;
        self.left = self.left.saturating_sub(1);
        self.left > 0
    }
}

#[test]
fn a_motor_whose_wire_falls_silent_for_good_may_turn() {
    // While it is looked for whether it turns, and while its watch begins.
    for after in [0, 2] {
        let link = polepair::connect_local(&module_that_falls_silent(after)).expect("a module");
        let axis = &link.axes()[0];
        let mut patient = Patient { left: 2, turns: false, found: Vec::new() };
        let unproven = prove_watchdog(axis, Some(HALF), &mut patient).unwrap_err();
        assert!(unproven.moved && unproven.may_turn, "{unproven:?}");
        assert_eq!(unproven.error.code(), "E401", "{unproven:?}");
        let text = unproven.to_string();
        assert!(text.contains("the motor may still turn: cut its supply"), "{text}");
        assert_eq!(text.matches("may still turn").count(), 1, "{text}");
        assert_eq!((patient.left, patient.turns), (0, true));
        // What may stop the motor is not taken away.
        let [last] = &patient.found[..] else { panic!("{:?}", patient.found) };
        assert!(last.contains("its watchdog stays set"), "{last}");
    }
}
