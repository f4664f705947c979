//! `polepair doctor` on served drives.

use crate::run;
use polepair_test_support::wait_until;

use run::{Served, ok, polepair};
#[cfg(unix)]
use std::{
    io::{Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::Arc,
    sync::atomic::{AtomicBool, Ordering::SeqCst},
    time::Duration,
};

#[test]
fn a_served_drive_is_sound() {
    let served = Served::new("tmcl:1");
    let found = ok(&["doctor", &served.url]);
    assert!(found.lines().all(|line| line.starts_with("ok ") || line.starts_with("look ")));
    assert!(found.contains("axis 1: no faults"), "{found}");
    served.end();
}

#[test]
fn the_hosts_own_address_is_no_anomaly() {
    run::expect_silence();
    let served = Served::new("tmcl:1");
    let found = ok(&["doctor", served.link()]);
    assert!(found.contains("axis 1: answers") && !found.contains("axis 2"), "{found}");
    served.end();
}

#[test]
fn a_missing_drive_is_reported_with_the_exit_code() {
    let served = Served::new("tmcl:1");
    let ran = polepair(&["doctor", &format!("{}#5", served.link()), "--format", "jsonl"]);
    assert_eq!(ran.code, 4, "{}{}", ran.out, ran.err);
    let last = ran.out.lines().find(|line| line.contains("axis 5")).expect("a check");
    let check: serde_json::Value = serde_json::from_str(last).expect("JSON");
    assert_eq!((check["grade"].as_str(), check["exit"].as_i64()), (Some("wrong"), Some(4)));
    served.end();
}

#[test]
fn a_machine_is_looked_at() {
    let ran = polepair(&["doctor"]);
    assert!(ran.out.contains("configuration: "), "{}{}", ran.out, ran.err);
}

/// A TCP connection to a served TMCL drive that can be cut. It reports when the motor got its command to turn.
#[cfg(unix)]
struct Relay {
    url: String,
    turns: Arc<AtomicBool>,
    is_cut: Arc<AtomicBool>,
}

#[cfg(unix)]
impl Relay {
    fn to(served: &Served) -> Self {
        let at = served.link().strip_prefix("tmcl+tcp://").expect("on TCP").to_owned();
        let server = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("tmcl+tcp://{}#1", server.local_addr().expect("an address"));
        let (turns, is_cut) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let (its, cut) = (Arc::clone(&turns), Arc::clone(&is_cut));
        std::thread::spawn(move || {
            for mut near in server.incoming().flatten() {
                let mut far = TcpStream::connect(&at).expect("the drive");
                let (mut asks, mut stream) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                std::thread::spawn(move || drop(std::io::copy(&mut stream, &mut near)));
                let (its, cut) = (Arc::clone(&its), Arc::clone(&cut));
                std::thread::spawn(move || {
                    let mut request = [0; 9];
                    while asks.read_exact(&mut request).is_ok() {
                        if !cut.load(SeqCst) && far.write_all(&request).is_err() {
                            break;
                        }
                        // ROR.
                        its.fetch_or(request[..2] == [1, 1], SeqCst);
                    }
                    let _ = far.shutdown(std::net::Shutdown::Both);
                });
            }
        });
        Self { url, turns, is_cut }
    }

    /// A proof that turns the motor.
    fn proof(&self) -> std::process::Child {
        let proof = ["doctor", &self.url, "--prove-watchdog=500ms", "--yes"];
        let child = run::command(&proof).spawn().expect("starts");
        wait_until("the motor turns", || self.turns.load(SeqCst));
        std::thread::sleep(Duration::from_millis(500));
        child
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_proof_stops_the_motor_and_restores_the_watchdog() {
    let served = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    for name in ["INT", "TERM"] {
        let proof = Relay::to(&served).proof();
        run::signal(name, proof.id());
        let ran = run::ran(proof.wait_with_output().expect("ends"));
        assert_eq!(ran.code, 130, "{name}: {}", ran.err);
        assert!(ran.err.starts_with("interrupted: the motor was stopped\n"), "{}", ran.err);
        assert!(ran.out.contains("its watchdog is restored"), "{}", ran.out);
        let proven = ["its watchdog works", "did not stop it", "did not turn"];
        assert!(!proven.iter().any(|text| ran.out.contains(text)), "{}", ran.out);
        assert_eq!(ok(&["get", &served.url, "actual velocity"]), "actual velocity = 0 rpm\n");
        assert_eq!(ok(&["get", &served.url, "driver enable"]), "driver enable = off\n");
        assert!(ok(&["watchdog", &served.url]).contains("off"));
    }
    served.end();
}

/// A TMCL module that refuses a parameter as missing (status 4, 3 or 6).
#[cfg(unix)]
#[test]
fn a_firmware_without_a_watchdog_is_reported_so_and_is_not_wrong() {
    for refusal in [3, 4, 6] {
        let request = |arguments: &[&str]| {
            let (url, module) = crate::stop::module(move |opcode, _| match opcode {
                136 => Some((100, 0x17DE_0112)),
                9 | 10 => Some((refusal, 0)),
                _ => Some((100, 0)),
            });
            let url = url.replace('#', "?profile=tmcm-171#");
            let (verb, rest) = arguments.split_first().expect("a verb");
            let ran = polepair(&[&[verb, url.as_str()], rest].concat());
            module.join().expect("a module");
            ran
        };
        let ran = request(&["info"]);
        assert_eq!(ran.code, 0, "{}{}", ran.out, ran.err);
        let row = ran.out.lines().find(|line| line.trim().starts_with("watchdog")).expect("a row");
        assert!(row.contains("none in this firmware (`serial heartbeat`)"), "{row}");
        assert!(row.contains("continues its last command"), "{row}");
        let ran = request(&["doctor"]);
        assert!(ran.out.contains("no watchdog: the motor continues"), "{}", ran.out);
        assert!(!ran.out.contains("E601") && !ran.out.contains("heartbeat"), "{}", ran.out);
        let ran = request(&["watchdog"]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(
            ran.out.contains("axis 1: none in this firmware (`serial heartbeat`)"),
            "{}",
            ran.out
        );
        let ran = request(&["watchdog", "500ms"]);
        assert_eq!(ran.code, 2, "{}", ran.err);
        assert!(ran.err.contains("error[E218]: axis 1 has no watchdog that can be set."));
    }
}

#[test]
fn a_family_without_a_watchdog_is_reported_so_by_who_sets_it() {
    for url in ["sim:tml", "sim:modbus-rtu", "sim:technocan:5"] {
        for time in ["500ms", "off"] {
            let ran = polepair(&["watchdog", url, time]);
            assert_eq!(ran.code, 2, "{}", ran.err);
            for text in [
                "error[E218]: axis ",
                " has no watchdog that can be set.",
                "Its reaction to a silent host: none: the motor continues its last command.",
            ] {
                assert!(ran.err.contains(text), "{url}: {text}: {}", ran.err);
            }
            assert!(!ran.err.contains("it can enable"), "{url}: {}", ran.err);
        }
    }
}

/// One that was set by a host that spoke more often.
#[test]
fn a_watchdog_that_ends_before_the_next_heartbeat_is_warned_of() {
    let served = Served::with(&["canopen:5", "--tcp", "127.0.0.1:0"]);
    let url = |ms: u32| served.url.replace('#', &format!("?heartbeat={ms}#"));
    assert!(!ok(&["watchdog", &url(100), "300ms"]).is_empty());
    for (ms, warned) in [(100, false), (299, false), (300, true), (500, true)] {
        let ran = polepair(&["watchdog", &url(ms)]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        let text =
            "warning: axis 5: its watchdog ends before the next heartbeat of this connection";
        assert_eq!(ran.err.contains(text), warned, "{ms}: {}", ran.err);
    }
    served.end();
}

#[cfg(unix)]
#[test]
fn a_motor_that_a_proof_lost_is_reported_as_turning() {
    run::expect_silence();
    let served = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let relay = Relay::to(&served);
    let proof = relay.proof();
    relay.is_cut.store(true, SeqCst);
    let ran = run::ran(proof.wait_with_output().expect("ends"));
    assert_eq!(ran.code, 4, "{}", ran.err);
    let stops = format!("`polepair stop {}`, once its drive answers again", relay.url);
    for text in
        ["axis 1 may still turn: cut its supply. Its stop was not confirmed", "error[E401]", &stops]
    {
        assert!(ran.err.contains(text), "{text}: {}", ran.err);
    }
    assert!(ran.out.contains("its watchdog stays set"), "{}", ran.out);
    served.end();
}

#[test]
fn no_time_is_no_watchdog_and_no_time_limit() {
    for time in ["0s", "0ms", "0"] {
        let ran = polepair(&["watchdog", "sim:tmcl", time]);
        assert_eq!(ran.code, 2, "{}{}", ran.out, ran.err);
        assert!(ran.err.contains("`off` switches the watchdog off"), "{}", ran.err);
    }
    for verb in ["info", "stop", "scan"] {
        for url in ["sim:tmcl?timeout=0", "sim:cia402?timeout=0ms", "sim:tml?timeout=0s"] {
            let ran = polepair(&[verb, url]);
            assert_eq!(ran.code, 2, "{verb} {url}: {}{}", ran.out, ran.err);
            assert!(ran.err.contains("leaves drives no time to answer"), "{verb}: {}", ran.err);
        }
    }
}
