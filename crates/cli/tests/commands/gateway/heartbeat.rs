//! A server that sends a heartbeat has its drives watch it: the motor stops when the server is killed.

use polepair_test_support::{wait_for, wait_until};
use serde_json::{Value, json};

use super::site::{Folder, Site};
use crate::run::{self, Served};

/// The velocity that an observer on the same bus reads.
fn velocity(url: &str) -> f64 {
    let output = run::ok(&["get", url, "velocity actual", "--raw"]);
    let word = output.split('=').nth(1).unwrap_or_else(|| panic!("{output}"));
    word.split_whitespace().next().unwrap().parse().unwrap_or_else(|_| panic!("{output}"))
}

/// The record of the time that a server looked at its drive's watchdog.
fn watched(folder: &Folder, time: usize) -> Value {
    wait_for("the watchdog's record", || {
        let records = folder.journal();
        let mut found = records.iter().filter(|record| record["deed"] == "watchdog");
        found.nth(time - 1).cloned().ok_or_else(|| format!("{records:?}"))
    })
}

#[test]
fn a_motor_stops_when_the_server_that_its_drive_watches_is_killed() {
    let bus = Served::with(&["cia402:5", "--socketcand", "127.0.0.1:0"]);
    let link = bus.link().to_owned();
    let witness = format!("{link}#5");
    let before = run::ok(&["watchdog", &witness]);
    assert!(before.contains("off"), "{before}");
    let folder = Folder::new();
    let mut site = Site::new(&folder, &[&format!("{link}?heartbeat=300#5")]);
    let output = "on, the drive stops after 900 ms of silence";
    let record = watched(&folder, 1);
    assert_eq!((&record["axis"], &record["detail"]["is"]), (&json!(0), &json!(output)), "{record}");
    let mut live = site.live();
    assert!(record["detail"]["was"].as_str().unwrap().starts_with("off"), "{record}");
    live.spin(0, 20.0);
    assert!(velocity(&witness).abs() > 50.0, "the witness sees it turn");
    site.signal("KILL");
    drop(site);
    wait_until("the motor stands", || velocity(&witness).abs() <= 1.0);
    // A server that ends in order leaves no drive that waits for a heartbeat.
    let mut site = Site::new(&folder, &[&format!("{link}?heartbeat=300#5")]);
    watched(&folder, 2);
    assert_eq!(site.signal("TERM"), Some(0));
    let after = run::ok(&["watchdog", &witness]);
    // The setting is older than the server. The observer sends no heartbeat, and prints that.
    let watches = "watches node 127 and stops 900 ms after the last one; without heartbeat= this";
    assert!(after.contains(watches), "{after}");
    assert!(run::ok(&["info", &witness]).contains(watches));
    run::ok(&["watchdog", &witness, "off"]);
    let mut site = Site::new(&folder, &[&format!("{link}?heartbeat=300#5")]);
    assert_eq!(watched(&folder, 3)["detail"]["is"], output);
    assert_eq!(site.signal("TERM"), Some(0));
    let after = run::ok(&["watchdog", &witness]);
    assert!(after.contains("off"), "{after}");
}
