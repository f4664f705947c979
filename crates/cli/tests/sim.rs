//! Simulated drives on real pseudo-terminals, and the verbs against them.
#![cfg(unix)]

mod run;

use std::io::{BufRead as _, BufReader};
use std::process::Child;

use run::polepair;

/// A served drive, ended with SIGTERM as a supervisor would.
struct Served {
    child: Child,
    url: String,
}

impl Served {
    fn new(drive: &str) -> Self {
        let mut child = run::command(&["sim", drive]).spawn().expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let line = lines.next().expect("a line").expect("text");
        let url = line.strip_prefix("ready ").expect("ready").to_owned();
        Self { child, url }
    }

    fn end(mut self) {
        let pid = self.child.id().to_string();
        std::process::Command::new("kill").arg(&pid).status().expect("kill");
        assert_eq!(self.child.wait().expect("ends").code(), Some(0));
    }
}

fn ok(arguments: &[&str]) -> String {
    let ran = polepair(arguments);
    assert_eq!(ran.code, 0, "{arguments:?}: {}{}", ran.out, ran.err);
    ran.out
}

#[test]
fn parameters_are_set_and_read_back() {
    let sim = Served::new("tmcl:1");
    assert_eq!(ok(&["set", &sim.url, "max current=1A"]), "max current = 1 A\n");
    assert_eq!(ok(&["get", &sim.url, "--raw", "AP 6"]), "max current = 10\n");
    let refused = polepair(&["set", &sim.url, "max current=99A"]);
    assert_eq!(refused.code, 2);
    let expected = "error[E216]: 99A is out of range for \"max current\".\n  It takes 0 A to 25 A; nothing was sent.\n";
    assert!(refused.err.starts_with(expected), "{}", refused.err);
    assert!(ok(&["info", &sim.url]).contains("faults           none"));
    sim.end();
}

#[test]
fn a_scan_passes_addresses_where_nobody_is() {
    // Address 2 is the host's own: no module can have it.
    let sim = Served::new("tmcl:1,3");
    let link = sim.url.split('#').next().expect("a link");
    let found = ok(&["scan", link, "--ids", "1-4", "--format", "jsonl"]);
    assert_eq!(found.lines().count(), 2, "{found}");
    sim.end();
}

#[test]
fn nobody_at_an_address_is_exit_code_4() {
    let sim = Served::new("modbus-rtu:1");
    let link = sim.url.split('#').next().expect("a link");
    let ran = polepair(&["get", &format!("{link}?profile=syntron-ts#7"), "motor speed"]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.starts_with("error[E401]: ") && ran.err.contains("executed"), "{}", ran.err);
    sim.end();
}

#[test]
fn a_spin_ends_with_the_motor_stopped() {
    let sim = Served::new("tmcl:1");
    ok(&["spin", &sim.url, "300rpm", "--for", "300ms"]);
    assert_eq!(ok(&["get", &sim.url, "target velocity"]), "target velocity = 0 rpm\n");
    let moved = ok(&["move", &sim.url, "90deg"]);
    assert!(moved.starts_with("position = "), "{moved}");
    sim.end();
}

#[test]
fn a_dry_run_sends_nothing_of_it() {
    let sim = Served::new("tmcl:1");
    let shown = ok(&["spin", &sim.url, "200rpm", "--dry-run"]);
    assert!(shown.starts_with("01 01 00 00 00 00 00 C8 CA"), "{shown}");
    assert_eq!(ok(&["get", &sim.url, "target velocity"]), "target velocity = 0 rpm\n");
    sim.end();
}

#[test]
fn what_is_traced_can_be_decoded() {
    let sim = Served::new("modbus-rtu:1");
    let trace = std::env::temp_dir().join(format!("polepair-trace-{}.log", std::process::id()));
    let path = trace.to_str().expect("text");
    ok(&["get", &sim.url, "motor speed", "--trace", path]);
    let shown = ok(&["decode", path, "--as", "modbus-rtu"]);
    std::fs::remove_file(&trace).expect("a trace");
    assert!(shown.lines().count() >= 2 && !shown.contains('!'), "{shown}");
    sim.end();
}

#[test]
fn the_demo_plays_without_errors() {
    let shown = ok(&["demo", "--headless"]);
    assert!(shown.starts_with("Found 2 drives of two makers by a scan."), "{shown}");
    assert_eq!(shown.matches("14 of 14").count(), 2, "{shown}");
}
