//! Links that go while a motor turns, viewers that fall asleep, and two who want the same axis.

use std::time::{Duration, Instant};

use polepair_link::pty::Pty;
use polepair_test_support::{Deadline, wait_for};
use serde_json::json;

use super::site::{Folder, Live, Site, speed};
use super::wire::Drive;
use crate::run::{self, Served};

/// The state of the only link, in a `bench` message.
fn is_link(state: &'static str) -> impl Fn(&serde_json::Value) -> bool {
    move |bench| bench["links"][0]["state"] == state
}

/// Takes a drive's process away and brings it back, with a motor that turns.
fn unplugged(folder: &Folder, arguments: &[&str], url: &str) {
    let drive = Served::with(arguments);
    let site = Site::new(folder, &[url]);
    let (mut live, mut other) = (site.live(), site.live());
    live.spin(0, 20.0);
    // A suspended process accepts bytes and replies to none; then it is gone.
    run::signal("STOP", drive.id());
    let order = live.order(0, "velocity", Some(30.0));
    live.send(&order);
    std::thread::sleep(Duration::from_millis(50));
    drop(drive);
    let outcome = live.until("outcome", |outcome| outcome["id"] == order["id"]);
    assert_ne!(outcome["outcome"], "done", "{outcome}");
    let value = other.until("bench", is_link("lost"));
    assert!(!value["links"][0]["error"]["message"].as_str().unwrap().is_empty(), "{value}");
    let state = other.until("axis", |state| state["lease"].is_null());
    assert_eq!(state["armed"], false, "{state}");
    let epoch = live.epoch;
    live.send(&json!({ "type": "lease", "axis": 0, "act": "renew", "epoch": epoch }));
    live.until("error", |error| error["error"]["code"] == "E313");
    let drive = Served::with(arguments);
    other.until("bench", is_link("open"));
    // The drive was without supply: its motor is at standstill and stays there.
    other.until("axis", |state| speed(state).is_some_and(|speed| speed.abs() < 0.1));
    other.until("axis", |state| state["pending_stop"].is_null());
    live.lease(0, "take");
    let refused = live.command(0, "velocity", Some(20.0));
    assert_eq!(refused["error"]["code"], "E219", "it has to be armed anew: {refused}");
    live.spin(0, 20.0);
    let reasons = folder.journal();
    let lost = reasons.iter().find(|record| record["deed"] == "lease_ended").unwrap();
    assert_eq!(lost["detail"]["reason"], "the link is lost", "{lost}");
    drop((site, drive));
}

#[test]
fn a_line_that_is_unplugged_is_reported_and_opened_again_and_nothing_moves_by_itself() {
    run::expect_silence();
    let folder = Folder::new();
    let path = folder.path("line");
    unplugged(&folder, &["tmcl:1", "--pty", &path], &format!("tmcl+serial://{path}#1"));
}

#[test]
fn a_tcp_connection_that_breaks_is_reported_and_opened_again_and_nothing_moves_by_itself() {
    run::expect_silence();
    let folder = Folder::new();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let address = free.to_string();
    unplugged(&folder, &["tmcl:1", "--tcp", &address], &format!("tmcl+tcp://{address}#1"));
}

/// A drive in this process, and a server of it.
fn bench() -> (Drive, Folder, Site) {
    let end = Pty::open(None).unwrap();
    let url = format!("tmcl+serial://{}#1", end.path());
    let drive = Drive::on(Box::new(end), "tmcl:1");
    let folder = Folder::new();
    let site = Site::new(&folder, &[&url]);
    (drive, folder, site)
}

fn watch(live: &mut Live) {
    live.send(&json!({ "type": "subscribe", "channel": 1, "axis": 0, "signal": "velocity",
        "hz": 100 }));
    live.send(&json!({ "type": "frames", "on": true }));
    live.next("subscribed");
}

#[test]
fn a_sleeping_viewer_releases_its_motor_and_blocks_no_other() {
    run::expect_silence();
    let (drive, folder, site) = bench();
    let (mut asleep, mut awake) = (site.live(), site.live());
    watch(&mut awake);
    watch(&mut asleep);
    asleep.spin(0, 20.0);
    let slept = Instant::now();
    let deadline = Deadline::new("the viewer that sleeps is closed");
    let viewers = || {
        let text = site.get("/metrics");
        let line = text.lines().find_map(|line| line.strip_prefix("polepair_viewers "));
        line.unwrap_or_else(|| panic!("{text}")).parse::<u32>().unwrap()
    };
    // The client reads and sends nothing from now on, and its socket stays open.
    let (mut stood, mut longest, mut last) = (None, Duration::ZERO, Instant::now());
    while viewers() > 1 {
        deadline.check(|| "it is still there".to_owned());
        if drive.truth().velocity.abs() < 0.1 {
            stood.get_or_insert_with(|| slept.elapsed());
        }
        awake.next("frames");
        longest = longest.max(last.elapsed());
        last = Instant::now();
        awake.send(&json!({ "type": "ping", "client_ms": 1 }));
        awake.next("pong");
    }
    let closed = slept.elapsed();
    println!("it stood after {stood:?}, was closed after {closed:?}; others waited {longest:?}");
    assert!(stood.is_some_and(|stood| stood < closed), "its motor stops before it is closed");
    let records = folder.journal();
    let ended = records.iter().find(|record| record["deed"] == "lease_ended").unwrap();
    assert_eq!(ended["detail"]["reason"], "not renewed", "{ended}");
    drop(asleep);
}

#[test]
fn a_takeover_gets_a_motor_at_standstill() {
    let (drive, folder, site) = bench();
    let (mut ann, mut bob) = (site.live(), site.live());
    ann.spin(0, 20.0);
    bob.send(&json!({ "type": "lease", "axis": 0, "act": "take" }));
    bob.until("error", |error| error["error"]["code"] == "gateway.lease");
    drive.log.drain();
    bob.lease(0, "take_over");
    assert!(bob.epoch > ann.epoch);
    // Her commands meanwhile are not executed.
    let refused = ann.command(0, "velocity", Some(30.0));
    assert_eq!(refused["error"]["code"], "gateway.lease", "{refused}");
    bob.until("stopped", |value| value["axes"][0]["class"] == "standing");
    drive.wait_standstill();
    let passed = drive.log.drain();
    assert!(passed.iter().any(|p| p.is(&[3])) && !passed.iter().any(|p| p.is(&[1, 2, 4])));
    bob.lease(0, "take_over");
    let refused = bob.command(0, "velocity", Some(20.0));
    assert_eq!(refused["error"]["code"], "E219", "he arms it himself: {refused}");
    bob.spin(0, -20.0);
    ann.send(&json!({ "type": "stop", "axes": [0] }));
    drive.wait_standstill();
    assert!(folder.journal().iter().any(|record| record["deed"] == "take_over"));
}

/// Late replies belong to this server's own requests, so they are no evidence of another master.
#[test]
fn a_drive_that_stalls_again_and_again_is_no_other_master() {
    run::expect_silence();
    for drive in ["tmcl:1", "tml:1", "modbus-rtu:1", "cia402:5", "thruster:1"] {
        let drive = Served::new(drive);
        let site = Site::new(&Folder::new(), &[&drive.url]);
        let bench =
            || serde_json::from_str::<serde_json::Value>(&site.get("/api/v1/bench")).unwrap();
        wait_for("an open link", || Some(bench()).filter(is_link("open")).ok_or(String::new()));
        let end = Instant::now() + Duration::from_secs(5);
        while Instant::now() < end {
            run::signal("STOP", drive.id());
            std::thread::sleep(Duration::from_millis(350));
            run::signal("CONT", drive.id());
            assert_eq!(bench()["clashes"], json!([]), "{}", drive.url);
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}
