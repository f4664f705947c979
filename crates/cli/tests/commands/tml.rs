//! Every golden vector of TML through `polepair decode -` and back through `polepair encode`, and
//! captures as drives and serial servers make them.

use crate::run;

use std::collections::BTreeMap;

use polepair_test_support::wait_for;
use run::{Served, ok, polepair, polepair_with, text, vectors};
use serde_json::Value;

/// A frame as it appears in a capture, and its text for `encode`.
struct Vector {
    name: String,
    wire: &'static str,
    frame: String,
}

/// The manuals' examples and what the vendor's viewer printed, single bytes apart.
fn all() -> Vec<Vector> {
    let wire = |word: &str| match word {
        "tmlcan" => "tmlcan",
        "technocan" => "technocan",
        _ => "serial",
    };
    let mut all = Vec::new();
    for v in vectors("tml").iter().filter(|v| v["kind"] != "serial-byte") {
        let wire = wire(text(v, "kind"));
        let bytes = text(v, "bytes").to_owned();
        let frame = match v["can_id"].as_str() {
            Some(id) => format!("{id}#{}", bytes.replace(' ', "")),
            None => bytes,
        };
        all.push(Vector { name: text(v, "name").to_owned(), wire, frame });
    }
    let viewer = include_str!("../../../../vectors/tml_viewer.json");
    let viewer: Value = serde_json::from_str(viewer).expect("JSON");
    for v in viewer["vectors"].as_array().into_iter().flatten() {
        let frame = v["frame"].as_str().unwrap_or_else(|| text(v, "bytes")).to_owned();
        all.push(Vector { name: text(v, "name").to_owned(), wire: wire(text(v, "via")), frame });
    }
    all
}

fn decode(capture: &str, arguments: &[&str]) -> Vec<Value> {
    let arguments = [&["decode", "-", "--format", "jsonl"], arguments].concat();
    let ran = polepair_with(&arguments, capture);
    assert_eq!(ran.code, 0, "{}", ran.err);
    ran.out.lines().map(|line| serde_json::from_str(line).expect("one object a line")).collect()
}

/// Receiver of a frame, as for `--axis`; `None` if no host can send it.
fn axis(frame: &Value) -> Option<String> {
    let to = text(&frame["fields"], "to");
    match to.split_once(' ') {
        Some(("axis", id)) => Some(id.to_owned()),
        Some(("group" | "groups", numbers)) => Some(format!("g{numbers}")),
        _ => (to == "everybody").then(|| "g*".to_owned()),
    }
}

#[test]
fn every_vector_decodes_and_encodes() {
    let all = all();
    for (protocol, wire) in [("tml", "serial"), ("tmlcan", "tmlcan"), ("technocan", "technocan")] {
        let vectors: Vec<&Vector> = all.iter().filter(|v| v.wire == wire).collect();
        let line = |v: &&Vector| format!("(1.0) {} {}\n", v.name, v.frame);
        let capture: String = vectors.iter().map(line).collect();
        let frames = decode(&capture, &["--as", protocol]);
        let frames: BTreeMap<&str, &Value> = frames.iter().map(|f| (text(f, "link"), f)).collect();
        let mut sequence = 0;
        for v in vectors {
            let frame = frames[v.name.as_str()];
            assert!(frame["ok"] == true && frame["protocol"] == protocol, "{}: {frame}", v.name);
            let Some(axis) = axis(frame) else { continue };
            let tml = text(&frame["fields"], "tml");
            let ran = polepair(&["encode", "tml", tml, "--axis", &axis, "--via", wire]);
            let is_request = text(frame, "kind").contains("GiveMeData");
            if is_request && ran.out.trim() != v.frame {
                // Its answer goes to another host than the usual one.
                let host = text(&frame["fields"], "sender").rsplit(' ').next().expect("an ID");
                let arguments = ["encode", "tml", tml, "--axis", &axis, "--via", wire];
                let ran = polepair(&[&arguments[..], &["--host", host]].concat());
                let rs485 = polepair(&["encode", "tml", tml, "--axis", &axis, "--via", "rs485"]);
                let found = [ran.out.trim(), rs485.out.trim()];
                assert!(found.contains(&v.frame.as_str()), "{}: {tml}: {ran:?}", v.name);
            } else if !text(frame, "kind").starts_with("Take") {
                assert_eq!(ran.out.trim(), v.frame, "{}: {tml}: {}", v.name, ran.err);
            }
            sequence += 1;
        }
        assert!(sequence > 5, "{protocol}: {sequence}");
    }
}

#[test]
fn the_judge_tells_the_three_wires_apart() {
    let capture = "\
(1.00) a > 06 0F F0 20 5E 00 05 88
(1.01) a < 4F
(1.02) a > 08 0F F0 B0 04 0F F1 02 5E 1B
(1.03) a < 4F 0A 0F F1 B4 04 0F F0 02 5E 01 20 42
(1.00) b 0400A05E#3412
(1.01) b 16602004#30002A02
(1.02) b 1A806005#2A020200
(1.00) c 125#5E203412
(1.01) c 125#04B030002A02
(1.02) c 163#04282A020200
(1.03) c 705#05
";
    let ran = polepair_with(&["decode", "-", "--format", "jsonl"], capture);
    for verdict in ["a: tml, ", "b: tmlcan, ", "c: technocan and canopen, "] {
        assert!(ran.err.contains(verdict), "{}", ran.err);
    }
    let heartbeat = ran.out.lines().find(|line| line.contains(r#""id":1797"#)).expect("a line");
    assert!(heartbeat.contains(r#""protocol":"canopen""#), "{heartbeat}");
}

#[test]
fn a_drive_being_synchronised_and_a_server_that_invents_bytes() {
    let capture = "\
(1.00) a > FF
(1.01) a < 0D
(1.02) a > 06 00 10 D8 01
(1.03) a > 00 11 00
(1.04) a < 4F
(1.05) a < 00 0A 08 00 11 D8 01 35 31 34 4C D8
(1.06) a > 04 00 10 00 02 16
(1.07) a < 4E
";
    let frames = decode(capture, &["--as", "tml"]);
    let kinds: Vec<&str> = frames.iter().map(|frame| text(frame, "kind")).collect();
    assert_eq!(
        kinds,
        [
            "synchronisation byte",
            "synchronisation byte",
            "GETVERSION",
            "ack",
            "TML",
            "TML",
            "TakeVersion",
            "control",
            "TML"
        ]
    );
    assert!(frames[4]["ok"] == false && frames[5]["ok"] == false, "{frames:?}");
    assert_eq!((text(&frames[6]["fields"], "firmware"), &frames[6]["axis"]), ("F514L", &1.into()));
    assert_eq!(text(&frames[8], "error"), "byte 0: impossible count 78", "a damaged ack");
}

#[test]
fn the_binary_code_viewer_prints_a_line_an_instruction() {
    let viewer = |arguments: &[&str]| {
        let ran = polepair(&[&["encode", "tml"], arguments].concat());
        assert_eq!(ran.code, 0, "{}", ran.err);
        ran.out
    };
    assert_eq!(viewer(&["KPP=0x1234", "--axis", "5", "--via", "tmlcan"]), "0400A05E#3412\n");
    let both = viewer(&["MODE PP; // profile\nUPD", "--axis", "g1+2", "--via", "rs485"]);
    assert_eq!(both, "08 10 30 59 09 BF C1 87 01 B2\n04 10 30 01 08 4D\n");
    let relayed = viewer(&["?KPP", "--axis", "1", "--host", "255"]);
    assert_eq!(relayed, "08 00 10 B0 04 0F F1 02 5E 2C\n");
    let json = viewer(&["?KPP", "--format", "json"]);
    let json: Value = serde_json::from_str(&json).expect("an object");
    assert_eq!(json["answer"]["kind"], "TakeData");
    assert_eq!(json["answer"]["fields"]["frame"], "0A 0F F1 B4 04 0F F0 02 5E ?? ?? ??");
    let json = viewer(&["KPP=5", "--via", "technocan", "--format", "json"]);
    let json: Value = serde_json::from_str(&json).expect("an object");
    assert_eq!((&json["answer"], &json["id"]), (&Value::Null, &0x13F.into()));
}

#[test]
fn rules_of_the_wires_are_reported_before_a_byte_is_printed() {
    let refused = |arguments: &[&str]| {
        let ran = polepair(&[&["encode", "tml"], arguments].concat());
        assert_eq!((ran.code, ran.out.as_str()), (2, ""), "{arguments:?}");
        ran.err
    };
    let groups = refused(&["??POSERR", "--axis", "g1", "--via", "rs485"]);
    assert!(groups.contains("E222") && groups.contains("answers would collide"), "{groups}");
    assert!(refused(&["?POSERR", "--axis", "g1"]).contains("GiveMeData2"));
    let axis = refused(&["UPD", "--axis", "32", "--via", "technocan"]);
    assert!(axis.contains("multiple of 32"), "{axis}");
    let above = polepair(&["encode", "tml", "UPD", "--axis", "33", "--via", "technocan"]);
    assert_eq!((above.code, above.out.as_str()), (0, "121#0801\n"));
    assert!(above.err.contains("modulo 32"), "{}", above.err);
    assert!(refused(&["UPD", "--axis", "g6", "--via", "technocan"]).contains("groups 1 to 5"));
    assert!(refused(&["UPD", "--via", "can"]).contains("tmlcan or technocan"));
    assert!(refused(&["UPD", "--via", "canopen"]).contains("Wires are serial, rs485"));
    assert!(refused(&["UPD", "--axis", "g9"]).contains("groups are 1 to 8"));
    let second = refused(&["UPD; KPP=0x12345"]);
    assert!(second.contains("UPD; KPP=0x12345\n           ^ expected"), "{second}");
    let modbus = polepair(&["encode", "modbus-rtu", "read 0", "--axis", "g1"]);
    assert!(modbus.code == 2 && modbus.err.contains("no groups"), "{modbus:?}");
}

/// A host on a serial line, a relay, and two drives behind it, of which one is at the host's command.
const RELAY: &str = "[[link]]\nname = \"host\"\nprotocol = \"tml\"\nbaud = 115200\n\
    [[link.drive]]\nname = \"relay\"\nprofile = \"technosoft-f514l\"\naddress = 255\n\
    on = [\"host\", \"bus\"]\n\
    [[link]]\nname = \"bus\"\nprotocol = \"tmlcan\"\n\
    [[link.drive]]\nname = \"x\"\nprofile = \"technosoft-f514l\"\naddress = 1\n\
    [[link.drive]]\nname = \"y\"\nprofile = \"technosoft-f514l\"\naddress = 2\n";

#[test]
fn one_axis_behind_a_relay_is_commanded_alone() {
    let folder = std::env::temp_dir().join(format!("polepair-through-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let rack = folder.join("relay.toml");
    std::fs::write(&rack, RELAY).expect("written");
    let rack = rack.to_str().expect("text");
    let pty = folder.join("host").display().to_string();
    let served = Served::with(&[rack, "--pty", &pty, "--udp", "239.74.163.35:43135"]);
    let (line, _) = served.url.split_once('#').expect("axes");
    let through = |axes: &str| format!("{line}?through=255{axes}");
    let turns = |axis: &str| {
        let shown = ok(&["get", &format!("{line}#255,1,2"), "actual position", "--format", "csv"]);
        let row = shown.lines().find(|row| row.starts_with(axis)).expect("a row").to_owned();
        row.split(',')
            .find_map(|cell| cell.parse::<f64>().ok().filter(|_| cell != axis))
            .expect("a number")
    };
    let found = ok(&["scan", &through(""), "--ids", "1-3"]);
    assert!(found.lines().count() == 3 && !found.contains("255"), "{found}");
    let moved = ok(&["move", &through("#2"), "1turn"]);
    assert!(moved.starts_with("position = 1 turn"), "{moved}");
    let named = ok(&["move", &format!("sim:{rack}?time=virtual#x"), "1turn"]);
    assert!(named.starts_with("position = 1 turn"), "{named}");
    assert!(
        turns("255").abs() < 0.01 && turns("1").abs() < 0.01,
        "the others stand where they were"
    );
    ok(&["spin", &through("#1"), "60rpm", "--detach"]);
    run::expect_silence();
    // Each address has 30 ms to reply in, which a busy machine may exceed.
    wait_for("axes 1, 2 and 255 are stopped by one command", || {
        let stopped = polepair(&["stop", &through("")]);
        let told = |axis: &u8| stopped.err.contains(&format!("axis {axis} is stopped"));
        if [1, 2, 255].iter().all(told) { Ok(()) } else { Err(stopped.out + &stopped.err) }
    });
    let path = folder.join("path.csv");
    std::fs::write(&path, "6.5,0,0.2\n6.6,0,0.2\n").expect("written");
    let streamed = polepair(&["stream", &through("#2"), path.to_str().expect("text")]);
    assert_eq!(streamed.code, 0, "{}", streamed.err);
    assert!(ok(&["send", &through("#g1"), "STOP", "--arm"]).contains("to group 1"));
    let silent = polepair(&["info", &through("#7")]);
    assert!(silent.err.contains("relay 255 acknowledges, axis 7 is silent"), "{}", silent.err);
    let nearby = polepair(&["info", &format!("{line}#7")]);
    assert!(nearby.err.contains("?through=ID"), "{}", nearby.err);
    let wrong = polepair(&["info", &through("#1").replace("255", "256")]);
    assert!(wrong.code == 2 && wrong.err.contains("E210"), "{}", wrong.err);
    served.end();
    std::fs::remove_dir_all(folder).expect("removed");
}

/// On TechnoCAN a relay sends only five bits of a number, so axis 1 replies to requests for 33, 65 and so on.
#[test]
fn axes_behind_a_technocan_relay_are_found_once() {
    let folder = std::env::temp_dir().join(format!("polepair-alias-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let rack = folder.join("relay.toml");
    std::fs::write(&rack, RELAY.replace("tmlcan", "technocan").replace("255", "5"))
        .expect("written");
    let rack = rack.to_str().expect("text");
    let pty = folder.join("host").display().to_string();
    let served = Served::with(&[rack, "--pty", &pty, "--udp", "239.74.163.36:43136"]);
    let (line, _) = served.url.split_once('#').expect("axes");
    let through = |axes: &str| format!("{line}?through=5{axes}");
    let found = ok(&["scan", &through(""), "--ids", "1-34"]);
    let axes: Vec<&str> =
        found.lines().skip(1).filter_map(|row| row.split_whitespace().next()).collect();
    assert_eq!(axes, ["1", "2", "5"], "{found}");
    run::expect_silence();
    let stopped = polepair(&["stop", &through("")]);
    assert!(!stopped.err.contains("axis 33"), "{}", stopped.err);
    let alias = polepair(&["info", &through("#33")]);
    assert!(alias.code == 2 && alias.err.contains("`relay=technocan`"), "{}", alias.err);
    served.end();
    std::fs::remove_dir_all(folder).expect("removed");
}

/// TML communication manual, chapter 5: drives with TechnoCAN have firmware F2xxY.
#[test]
fn a_technocan_drive_reports_its_own_firmware() {
    let info = ok(&["info", "sim:technocan:5"]);
    assert!(info.contains("technosoft-f2xx (technocan)"), "{info}");
    assert!(info.contains("firmware 214A"), "{info}");
    let moved = ok(&["move", "sim:technocan:5?time=virtual", "1turn"]);
    assert!(moved.starts_with("position = 1 turn"), "{moved}");
    let language = ok(&["get", "sim:technosoft-fa00g+can:3", "POSERR"]);
    assert_eq!(language.trim(), "position error = 0 turn");
}

#[test]
fn unknown_firmware_names_profile_and_setup() {
    let folder = std::env::temp_dir().join(format!("polepair-firmware-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    for protocol in ["technocan", "tmlcan", "tml"] {
        let path = folder.join(format!("{protocol}.toml"));
        let text = format!(
            "[[link]]\nname = \"a\"\nprotocol = \"{protocol}\"\n[[link.drive]]\n\
             profile = \"technosoft-f514l\"\naddress = 5\noptions = {{ firmware = \"F314A\" }}\n"
        );
        std::fs::write(&path, text).expect("written");
        let url = format!("sim:{}#5", path.display());
        for verb in [&["enable", &url][..], &["move", &url, "1turn", "--rel"]] {
            let refused = polepair(verb);
            assert_eq!(refused.code, 2, "{refused:?}");
            assert!(refused.err.contains("`?profile=`") && refused.err.contains("`?setup=`"));
        }
        ok(&["enable", &url.replace("#5", "?profile=technosoft-f2xx#5")]);
    }
    std::fs::remove_dir_all(folder).expect("removed");
}
