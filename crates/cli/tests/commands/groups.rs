//! Groups of TML drives: a line for each reply, and what cannot be confirmed.
#![cfg(unix)]

use crate::run;

use polepair_test_support::wait_for;
use run::Server;
use run::{Served, ok, polepair};
use serde_json::Value;

#[test]
fn each_drive_of_a_group_has_its_line() {
    let asked = ["send", "sim:tmlcan:1,5,9?time=virtual#g1", "??POSERR", "PING 255"];
    let lines: Vec<String> = ok(&asked).lines().map(str::to_owned).collect();
    let value = |axis: u32| format!("POSERR = 0, from axis {axis} to axis 254");
    let version = |axis: u32| format!("firmware F514L, from axis {axis} to axis 254");
    let expected: Vec<String> =
        [1, 5, 9].map(value).into_iter().chain([1, 5, 9].map(version)).collect();
    assert_eq!(lines, expected);
    let shown = ok(&[&asked[..3], &["--format", "jsonl"]].concat());
    let replies: Vec<Value> =
        shown.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let axes: Vec<_> = replies.iter().map(|reply| (&reply["axis"], &reply["value"])).collect();
    assert_eq!(axes, [(&1.into(), &0.into()), (&5.into(), &0.into()), (&9.into(), &0.into())]);
    // On RS-485 the answers would collide.
    let ran = polepair(&["send", "sim:tml:1,2?time=virtual#g1", "??POSERR"]);
    assert_eq!((ran.code, ran.err.contains("error[E222]")), (2, true), "{}", ran.err);
}

#[test]
fn a_group_on_rs485_is_commanded_without_a_claim() {
    let sim = Served::new("tml:1,2");
    let group = sim.url.replace("#1,2", "#1,g1");
    assert_ne!(group, sim.url, "{}", sim.url);
    let ran = polepair(&["enable", &group]);
    assert_eq!(ran.code, 9, "{}", ran.err);
    assert!(ran.err.contains("axis 1 is powered\n"), "{}", ran.err);
    let sent = "error[E901]: axes g1: enable: nothing on this wire confirms it; it may have been executed.";
    assert!(ran.err.contains(sent), "{}", ran.err);
    assert!(!ran.err.contains("axes g1 is powered"), "{}", ran.err);
    // The scale of axis 1 is that of its group; axis 2 is in it too.
    let ran = polepair(&["spin", &group, "120rpm", "--detach"]);
    assert_eq!(ran.code, 9, "{}", ran.err);
    assert!(
        ran.err.contains("error[E901]: axes g1: velocity: nothing on this wire confirms it"),
        "{}",
        ran.err
    );
    let second = sim.url.replace("#1,2", "#2");
    wait_for("axis 2 to turn", || {
        let speed = ok(&["get", &second, "actual speed"]);
        let mut numbers = speed.split_whitespace().filter_map(|word| word.parse::<f64>().ok());
        if numbers.any(|rpm| rpm > 110.0) { Ok(()) } else { Err(speed) }
    });
    let ran = polepair(&["stop", &sim.url]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    // Without a named axis the scale is not known.
    let ran = polepair(&[
        "spin",
        &sim.url.replace("?", "?profile=technosoft-f514l&").replace("#1,2", "#g1"),
        "10rpm",
    ]);
    assert_eq!((ran.code, ran.err.contains("Nothing was sent.")), (2, true), "{}", ran.err);
    sim.end();
}

#[test]
fn a_group_on_a_server_is_commanded_without_a_claim() {
    let sim = Served::new("tml:1,2");
    let server = Server::new(&[&sim.url.replace("#1,2", "#1,g1")]);
    for (verb, name) in [("enable", "enable:"), ("clear", "clear:"), ("disable", "the command")] {
        let ran = server.run(&[verb, "g1"]);
        assert_eq!(ran.code, 9, "{verb}: {}", ran.err);
        assert!(ran.err.contains(&format!("error[E901]: axes g1: {name}")), "{}", ran.err);
    }
    let ran = server.run(&["stop", "g1"]);
    assert_eq!(ran.code, 9, "{}", ran.err);
    assert!(ran.err.contains("axes g1: the stop was sent; nothing confirms it"), "{}", ran.err);
    sim.end();
}
