//! A server that is killed or held up, with a motor that turns: the motor does what its drive's own
//! watchdog does, no earlier command is carried out afterwards, and the journal is whole.

use std::time::Duration;

use polepair_link::pty::Pty;
use polepair_test_support::wait_until;
use serde_json::{Value, json};

use super::site::{Folder, Site};
use super::wire::Drive;
use crate::run;

/// TMCL's commands that start motion: ROR, ROL, MVP.
const STARTS: [u8; 3] = [1, 2, 4];
/// Instruction number of TMCL's motor stop.
const MST: u8 = 3;
/// Longer than a lease, a command's time and a heartbeat.
const AWAY: Duration = Duration::from_secs(4);

/// A drive in this process, and a server of its link.
struct Bench {
    drive: Drive,
    url: String,
    folder: Folder,
}

impl Bench {
    fn new() -> Self {
        let end = Pty::open(None).unwrap();
        let url = format!("tmcl+serial://{}#1", end.path());
        Self { drive: Drive::on(Box::new(end), "tmcl:1"), url, folder: Folder::new() }
    }

    fn serve(&self) -> Site {
        Site::new(&self.folder, &[&self.url])
    }

    fn turns(&self) -> bool {
        self.drive.truth().velocity.abs() > 1.0
    }

    /// Verifies the journal with `polepair journal verify`, and returns the output.
    fn verified(&self) -> String {
        run::ok(&["journal", "verify", &self.folder.path("state/journal.jsonl")])
    }
}

#[test]
fn a_killed_server_leaves_the_motor_to_the_drives_watchdog() {
    run::expect_silence();
    for heartbeat in ["0", "2000"] {
        let bench = Bench::new();
        run::ok(&["set", &bench.url, &format!("serial heartbeat={heartbeat} ms")]);
        let mut site = bench.serve();
        let mut live = site.live();
        let text = live.bench["axes"][0]["watchdog"].as_str().unwrap().to_owned();
        assert!(text.contains("`serial heartbeat`") && text.contains("off while"), "{text}");
        live.spin(0, 20.0);
        assert!(bench.turns());
        let (before, last) = (live.epoch, live.order(0, "velocity", Some(30.0)));
        site.signal("KILL");
        std::thread::sleep(AWAY);
        assert_eq!(bench.turns(), heartbeat == "0", "as it is told: {text}");
        let starts = bench.drive.truth().starts;
        let site = bench.serve();
        let mut live = site.live();
        let state = live.until("axis", |state| state["moving"].is_boolean());
        assert_eq!(state["moving"], heartbeat == "0", "it is seen to move, or not: {state}");
        assert_eq!((&state["armed"], &state["lease"]), (&json!(false), &Value::Null));
        live.send(&last);
        assert_eq!(live.next("outcome")["outcome"], "not_done", "it was said to another server");
        live.lease(0, "take");
        assert!(live.epoch > before, "an epoch is never given twice");
        let refused = live.command(0, "velocity", Some(30.0));
        assert_eq!(refused["error"]["code"], "E219", "not armed: {refused}");
        assert_eq!(bench.drive.truth().starts, starts, "nothing moves again by itself");
        live.send(&json!({ "type": "stop", "axes": [0] }));
        bench.drive.wait_standstill();
        drop(site);
        assert!(bench.verified().contains("records"), "{}", bench.verified());
    }
}

#[test]
fn a_record_that_a_kill_cut_off_is_taken_out_and_reported() {
    let bench = Bench::new();
    let mut site = bench.serve();
    site.signal("KILL");
    let file = bench.folder.0.join("state/journal.jsonl");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, [&whole[..], b"{\"n\":1,\"ms\":17"].concat()).unwrap();
    let mut site = bench.serve();
    let started = bench.folder.journal().pop().unwrap();
    assert_eq!((&started["deed"], &started["detail"]["cut"]), (&json!("started"), &json!(14)));
    assert_eq!(site.signal("TERM"), Some(0));
    bench.verified();
}

#[test]
fn a_server_that_was_held_up_stops_what_moved_and_carries_out_nothing_old() {
    run::expect_silence();
    let bench = Bench::new();
    let site = bench.serve();
    let mut live = site.live();
    live.spin(0, 20.0);
    run::signal("STOP", site.id());
    // All of it lies in the socket when the server wakes.
    let late = live.order(0, "velocity", Some(30.0));
    live.send(&late);
    let epoch = live.epoch;
    live.send(&json!({ "type": "lease", "axis": 0, "act": "renew", "epoch": epoch }));
    std::thread::sleep(AWAY);
    assert!(bench.turns(), "nobody stops it meanwhile: it has no heartbeat");
    bench.drive.log.drain();
    run::signal("CONT", site.id());
    let outcome = live.until("outcome", |outcome| outcome["id"] == late["id"]);
    assert_eq!(outcome["outcome"], "not_done", "{outcome}");
    let code = outcome["error"]["code"].as_str().unwrap();
    // Where it slept with a record in its hand, what waited for the journal is too old for that.
    let late = ["gateway.lease", "gateway.expired", "gateway.journal"];
    assert!(late.contains(&code), "{outcome}");
    bench.drive.wait_standstill();
    let state = live.until("axis", |state| state["lease"].is_null());
    assert_eq!(state["armed"], false, "{state}");
    let passed = bench.drive.log.drain();
    assert!(passed.iter().any(|p| p.is(&[MST])), "it was stopped");
    assert!(!passed.iter().any(|p| p.is(&STARTS)), "{passed:?}");
    let ended = |record: &Value| record["deed"] == "lease_ended";
    wait_until("the lease's end is written", || bench.folder.journal().iter().any(ended));
    bench.verified();
}

#[test]
fn an_order_to_end_stops_what_moves_first() {
    let bench = Bench::new();
    let mut site = bench.serve();
    let mut live = site.live();
    live.spin(0, 20.0);
    assert_eq!(site.signal("TERM"), Some(0));
    assert!(!bench.turns(), "{:?}", bench.drive.truth());
    let last = bench.folder.journal().pop().unwrap();
    assert_eq!(last["deed"], "ended", "{last}");
    bench.verified();
}
