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

#[test]
fn a_modbus_broadcast_is_sent_and_each_station_is_asked() {
    for url in
        ["sim:syntron-ts?axes=3#0", "sim:syntron-ts?axes=3#g*", "sim:syntron-ds102?axes=3#0,3,1,2"]
    {
        let ran = polepair(&["disable", url]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        let (sent, asked) = ran.err.split_once('\n').expect("lines");
        assert_eq!(
            sent,
            "axes g* sent to every station; no drive answers a broadcast, so each is asked"
        );
        for axis in 1..=3 {
            assert!(asked.contains(&format!("axis {axis} is not powered now")), "{}", ran.err);
        }
    }
    let ran = polepair(&["stop", "sim:syntron-ts?axes=2#0"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    for text in [
        "axis 1 is stopped",
        "axis 2 is stopped",
        "a broadcast stop was sent first; no drive answers it",
    ] {
        assert!(ran.err.contains(text), "{}", ran.err);
    }
    let asked =
        ["send", "sim:syntron-ts?axes=2#0", "write Fn_3E 5", "write registers 0x100 1053 7"];
    let shown = ok(&[&asked[..], &["--arm"]].concat());
    let expected = [
        "#g* write Fn_3E 5: sent; no reply",
        "#g* write registers 0x100 1053 7: sent; no reply",
        "#1 Fn_3E unnamed Fn_3E = 5",
        "#1 Fn_100 path 1 definition 1 = 1053, Fn_101 path 1 position = 7",
        "#2 Fn_3E unnamed Fn_3E = 5",
        "#2 Fn_100 path 1 definition 1 = 1053, Fn_101 path 1 position = 7",
    ];
    assert_eq!(shown.lines().collect::<Vec<_>>(), expected);
}

#[test]
fn a_modbus_broadcast_refuses_what_has_to_read() {
    for asked in [
        &["get", "sim:syntron-ts#0", "Fn_33"][..],
        &["enable", "sim:syntron-ts#0"],
        &["spin", "sim:syntron-ts?fn00=1#0,1", "100rpm", "--for", "1s"],
        &["send", "sim:syntron-ts#0,1", "read 3"],
    ] {
        let ran = polepair(asked);
        assert_eq!(ran.code, 2, "{}", ran.err);
        assert!(ran.err.contains("a broadcast brings no answer: it cannot read"), "{}", ran.err);
    }
    let ran = polepair(&["send", "sim:syntron-ts#0,1", "write Fn_33 100"]);
    assert!(ran.code == 2 && ran.err.contains("error[E219]"), "{}", ran.err);
    // Other protocols keep their own meaning of 0.
    let ran = polepair(&["disable", "canopen+udp://239.74.163.99:43199#0"]);
    assert!(ran.code == 2 && ran.err.contains("error[E212]"), "{}", ran.err);
}

#[test]
fn a_modbus_broadcast_reaches_the_stations_that_a_search_finds() {
    let sim = Served::new("modbus-rtu:3,9");
    // All 127 addresses are asked, so each for a short time, four times over.
    let all = sim.url.replace("#3,9", "?timeout=10#0");
    assert_ne!(all, sim.url, "{}", sim.url);
    let shown = ok(&["send", &all, "write Fn_3E 6"]);
    let expected = [
        "#g* write Fn_3E 6: sent; no reply",
        "#3 Fn_3E unnamed Fn_3E = 6",
        "#9 Fn_3E unnamed Fn_3E = 6",
    ];
    assert_eq!(shown.lines().collect::<Vec<_>>(), expected);
    let ran = polepair(&["stop", &all]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(
        ran.err.contains("axis 3 is stopped") && ran.err.contains("axis 9 is stopped"),
        "{}",
        ran.err
    );
    drop(sim);
}
