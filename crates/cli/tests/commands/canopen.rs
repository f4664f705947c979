//! CANopen from the command line: frames both ways, and a bus that it shares.

use crate::run;

use run::{hex, ok, polepair, polepair_with, text, vectors};
use serde_json::Value;

fn decode(capture: &str, arguments: &[&str]) -> (Vec<Value>, String) {
    let arguments = [&["decode", "-", "--format", "jsonl"], arguments].concat();
    let ran = polepair_with(&arguments, capture);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let frames = ran.out.lines().map(|line| serde_json::from_str(line).expect("an object"));
    (frames.collect(), ran.err)
}

fn protocols(frames: &[Value]) -> Vec<&str> {
    frames.iter().map(|frame| text(frame, "protocol")).collect()
}

#[test]
fn every_vector_decodes_and_encodes() {
    let all = vectors("canopen");
    let data = |v: &Value| if v["rtr"] == true { format!("R{}", v["dlc"]) } else { hex(v) };
    let frame = |v: &Value| format!("{}#{}", &text(v, "can_id")[2..], data(v));
    let capture: String = all.iter().map(|v| format!("(1.0) can0 {}\n", frame(v))).collect();
    let (frames, _) = decode(&capture, &["--as", "canopen"]);
    assert_eq!(frames.len(), all.len());
    // Each text once: the manual prints the same frame several times.
    let mut tried = std::collections::BTreeSet::new();
    for (v, found) in all.iter().zip(&frames) {
        let (name, output) = (text(v, "name"), text(found, "text"));
        assert!(found["ok"] == true && found["protocol"] == "canopen", "{name}: {found}");
        let axis = found["axis"].as_u64().map(|axis| axis.to_string());
        if !tried.insert((output.to_owned(), axis.clone())) {
            continue;
        }
        let mut arguments = vec!["encode", "canopen", output];
        arguments.extend(axis.iter().flat_map(|axis| ["--axis", axis]));
        assert_eq!(ok(&arguments), format!("{}\n", frame(v)), "{name}: {output}");
    }
    assert!(tried.len() >= 60, "only {}", tried.len());
}

#[test]
fn identifiers_go_to_the_protocols_that_are_named() {
    let capture = "\
(1.000) can0 302#5443000000000005
(1.001) can0 30B#5443000000000005
(1.002) can0 28B#5443000000000005
(1.003) can0 602#4041600000000000
(1.004) can0 582#4B41600037000000
(1.005) can0 080#
(1.006) can0 702#R1
(1.007) can0 703#05
";
    let (frames, _) = decode(capture, &["--as", "canopen@2,thruster@11"]);
    let expected =
        ["canopen", "thruster", "thruster", "canopen", "canopen", "canopen", "canopen", ""];
    assert_eq!(protocols(&frames), expected);
    let (frames, _) = decode(capture, &["--as", "canopen", "--profile", "syntron-ts-canopen"]);
    assert!(text(&frames[4], "text").contains("operation enabled"), "{}", frames[4]);
}

#[test]
fn a_nodes_other_traffic_decides_the_protocol_of_its_pdo2() {
    // Node 2 boots, node 12 sends nothing else: 11 and 12 stay open, and are reported.
    let capture = "\
(1.000) can0 702#00
(1.001) can0 302#5443000000000005
(1.002) can0 30B#5443000000000005
(1.003) can0 28B#5443000000000005
(1.004) can0 602#4041600000000000
(1.005) can0 28C#0102030405060708
(1.006) can0 003#01000000000001
(1.007) can0 002#03640100000001
";
    let (frames, stderr) = decode(capture, &[]);
    assert_eq!(protocols(&frames), ["canopen", "canopen", "", "", "canopen", "", "tmcl", "tmcl"]);
    assert!(stderr.contains("can0: canopen and tmcl, "), "{stderr}");
    assert!(stderr.contains("--as canopen,tmcl,thruster@11"), "{stderr}");
    assert!(!stderr.contains("thruster@2") && stderr.contains("or canopen's"), "{stderr}");
    // Process data alone may be anybody's; a state of the node is evidence.
    let process_data = "(1.0) can0 202#0F00\n(1.1) can0 302#0102030405060708\n";
    let (frames, stderr) = decode(process_data, &[]);
    assert_eq!(protocols(&frames), ["", ""], "{stderr}");
    let (frames, stderr) = decode(&format!("{process_data}(1.2) can0 702#05\n"), &[]);
    assert_eq!(protocols(&frames), ["canopen", "canopen", "canopen"], "{stderr}");
    // On another link the same identifiers prove nothing.
    let two = "(1.0) can0 702#05\n(1.1) can0 302#0102\n(1.2) can1 302#0102\n(1.3) can1 080#\n";
    let (frames, stderr) = decode(two, &[]);
    assert_eq!(protocols(&frames), ["canopen", "canopen", "", "canopen"], "{stderr}");
}

#[test]
fn codes_words_and_frames_are_explained() {
    assert!(ok(&["explain", "canopen", "0x06020000"]).contains("object does not exist"));
    assert!(ok(&["explain", "canopen", "0x0237"]).contains("operation enabled"));
    let word = ok(&["explain", "canopen", "statusword", "0x0237"]);
    assert!(word.starts_with("statusword: operation enabled\n"), "{word}");
    assert!(ok(&["explain", "canopen", "0x8130"]).contains("communication"));
    assert!(ok(&["explain", "syntron-ts-canopen", "0x160C"]).contains("oc"));
    let shown = ok(&["explain", "canopen", "602#2B4060000F000000"]);
    assert!(shown.contains("SDO write, axis 2: write 0x6040:0 u16 0x000F (controlword"), "{shown}");
    let json =
        ok(&["encode", "canopen", "write 0x6040:0 u16 15", "--axis", "2", "--format", "json"]);
    let json: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!((&json["answer"]["bytes"], &json["axis"]), (&8.into(), &2.into()));
    let named = ["encode", "canopen", "write controlword 15", "--axis", "2"];
    assert_eq!(polepair(&named).code, 2);
    let named = [&named[..], &["--profile", "cia402"]].concat();
    assert_eq!(ok(&named), "602#2B4060000F000000\n");
}

/// A file that is gone with the test.
struct Path(std::path::PathBuf);

impl Path {
    fn with(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("polepair-{}-{name}", std::process::id()));
        std::fs::write(&path, text).expect("a file");
        Self(path)
    }

    fn name(&self) -> &str {
        self.0.to_str().expect("a name")
    }
}

impl Drop for Path {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn paths_of_several_axes_go_out_on_sync() {
    let url = "sim:cia402:1,2?time=virtual";
    let line = |k: f64| {
        let angle = 90.0 * (1.0 - (k * std::f64::consts::TAU / 100.0).cos());
        format!("{},{angle},{}\n", k * 0.01, -angle)
    };
    let smooth: String = (0..=100).map(|k| line(f64::from(k))).collect();
    let file = Path::with("circle.csv", &format!("time s, 2 deg, 1 deg\n{smooth}"));
    let ran = polepair(&["stream", url, file.name()]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("101 cycles of 10 ms, axes: 2"), "{}", ran.err);
    assert!(ran.err.contains("missed cycles: 0; late replies: 0"), "{}", ran.err);
    assert!(ran.err.contains("min/median/max"), "{}", ran.err);
}

/// The path of one axis with a buffer: each time counts from the line before.
#[test]
fn a_line_that_is_no_point_is_reported_with_its_time() {
    let url = "sim:technosoft-f514l?time=virtual";
    for time in ["0", "-0.5"] {
        let file = Path::with(&format!("time{time}.csv"), &format!("0,0,0.2\n# one\n1,0,{time}\n"));
        let ran = polepair(&["stream", url, file.name()]);
        assert_eq!(ran.code, 2, "{}", ran.err);
        let what = format!("error[E210]: {}:3: the time {time} s is not valid.", file.name());
        for text in
            [&*what, "seconds since the line before: more than 0", "Time 0 is the actual position"]
        {
            assert!(ran.err.contains(text), "{text}: {}", ran.err);
        }
    }
    for time in ["0.0004", "0.512", "3"] {
        let file = Path::with(&format!("loops{time}.csv"), &format!("0,0,0.2\n0,0,{time}\n"));
        let ran = polepair(&["stream", url, file.name()]);
        assert_eq!(ran.code, 2, "{}", ran.err);
        let output = format!("{}:2 has {time} s; where the slow loop is 1 ms", file.name());
        assert!(ran.err.contains("error[E222]") && ran.err.contains(&output), "{}", ran.err);
    }
    let file = Path::with("short.csv", "0,0.2\n");
    let ran = polepair(&["stream", url, file.name()]);
    assert!(ran.err.contains(":1: `0,0.2` is not a point."), "{}", ran.err);
    assert_eq!(polepair(&["stream", url, file.name(), "--pt"]).code, 0);
}

#[test]
fn a_path_that_is_not_there_is_reported_as_a_rack_that_is_not() {
    let missing = std::env::temp_dir().join(format!("polepair-none-{}.csv", std::process::id()));
    let missing = missing.to_str().expect("a name");
    for more in [&[][..], &["--period", "2ms"]] {
        let ran = polepair(&[&["stream", "sim:tml", missing], more].concat());
        assert_eq!(ran.code, 2, "{}", ran.err);
        let what = format!("error[E230]: cannot read {missing}.");
        assert!(ran.err.contains(&what), "{}", ran.err);
        assert!(ran.err.contains("There is no such file. Nothing was sent."), "{}", ran.err);
    }
}

/// A drive that does not report its mode has a note in its row.
#[test]
fn an_object_that_a_drive_lacks_is_reported_in_its_row() {
    let folder = Path(std::env::temp_dir().join(format!("polepair-lacks-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).expect("a folder");
    let text = include_str!("../../../../interop/sheets/motor.eds");
    let mut sheet = polepair::eds::parse("motor.eds", text).expect("a sheet");
    sheet.objects.retain(|object| object.index != 0x6061);
    std::fs::write(folder.0.join("drive.eds"), sheet.to_string()).expect("a sheet");
    // Known by what it answers alone: the profile is the generic one.
    let rack = "[[link]]\nbitrate = 500000\n[[link.drive]]\nprofile = \"canopen\"\naddress = 5\n\
                eds = \"drive.eds\"\n";
    std::fs::write(folder.0.join("rack.toml"), rack).expect("a rack");
    let url = format!("sim:{}/rack.toml?time=virtual", folder.name());
    let (info, doctor) = (polepair(&["info", &url]), polepair(&["doctor", &url]));
    std::fs::remove_dir_all(&folder.0).expect("a folder");
    assert_eq!(info.code, 0, "{}{}", info.out, info.err);
    let row = info.out.lines().find(|line| line.trim().starts_with("mode")).expect("a row");
    assert!(row.ends_with(" this firmware has none"), "{row}");
    assert_eq!(doctor.code, 0, "{}{}", doctor.out, doctor.err);
}

#[test]
fn paths_that_cannot_be_followed_move_nothing() {
    let refused = |url: &str, text: &str, more: &[&str], reason: &str| {
        let file = Path::with(&format!("{}.csv", reason.len()), text);
        let ran = polepair(&[&["stream", url, file.name()], more].concat());
        assert!(ran.code != 0 && ran.err.contains(reason), "{reason}: {} {}", ran.code, ran.err);
        assert!(!ran.err.contains("cycles of"), "{}", ran.err);
    };
    let two = "sim:cia402:1,2?time=virtual";
    let still = "time s, 1 rad, 2 rad\n0,0,0\n0.02,0,0\n";
    refused(two, "time s, 1 rad, 2 rad\n0,0,0\n0.01,90,0\n", &[], "faster than the drive may be");
    refused(two, "time s, 1 rad/s, 2 rad/s\n0,0,0\n0.1,1,1\n", &[], "does not end at rest");
    refused(two, "time s, 1 deg, 3 deg\n0,0,0\n1,0,0\n", &[], "no column is named");
    refused(two, "time s, 1 deg, 2 Nm\n0,0,0\n1,0,0\n", &[], "does not fit");
    refused(two, "time s, 1 deg, 2 deg\n0,0,0\n1,0\n", &[], "columns, not 3");
    refused(two, still, &["--period", "1500us"], "1.5 ms is none");
    let ts = "sim:syntron-ts-canopen:1,2?time=virtual";
    refused(ts, still, &["--period", "10ms"], "does not support this");
}

#[test]
fn moves_begin_on_one_sync() {
    let ran = polepair(&["move", "sim:cia402:1,2?time=virtual", "90deg", "--sync"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.out.contains("#1 position") && ran.out.contains("#2 position"), "{}", ran.out);
    let ran = polepair(&["move", "sim:tmcl:1?time=virtual", "90deg", "--sync"]);
    assert!(ran.code != 0 && ran.err.contains("does not support this"), "{}", ran.err);
}

/// TS manual V2 §3.6.2: node 2, 60000 pulses of 10000 a turn, relative.
#[cfg(unix)]
#[test]
fn the_recipe_of_the_ts_manual_runs_from_a_file() {
    let sim = run::Served::with(&["syntron-ts-canopen:2?fn00=20", "--socketcand", "127.0.0.1:0"]);
    let recipe =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/ts-profile-position.log");
    let ran = polepair(&["replay", recipe, &sim.url, "--arm", "--detach"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(!ran.err.contains("could not be read"), "{}", ran.err);
    polepair_test_support::wait_for("the motor to arrive", || {
        let place = ok(&["get", &sim.url, "6064h"]);
        if place.trim() == "position actual = 2160 deg" { Ok(()) } else { Err(place) }
    });
    assert_eq!(polepair(&["stop", &sim.url]).code, 0);
}
