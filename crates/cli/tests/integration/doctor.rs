//! `polepair doctor` on served drives.

use crate::run;

use run::{Served, ok, polepair};

#[test]
fn a_served_drive_is_sound() {
    let served = Served::new("tmcl:1");
    let found = ok(&["doctor", &served.url]);
    assert!(found.lines().all(|line| line.starts_with("ok ") || line.starts_with("look ")));
    assert!(found.contains("axis 1: no faults"), "{found}");
    served.end();
}

#[test]
fn the_hosts_own_address_is_nobodys_fault() {
    let served = Served::new("tmcl:1");
    let found = ok(&["doctor", served.link()]);
    assert!(found.contains("axis 1: answers") && !found.contains("axis 2"), "{found}");
    served.end();
}

#[test]
fn who_is_not_there_is_told_with_the_exit_code() {
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
