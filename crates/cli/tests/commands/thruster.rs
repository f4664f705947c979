//! Thrusters, servos and actuators from the command line: frames both ways, a shared bus, verbs.

use crate::run;

use run::{Served, hex, polepair, polepair_with, text, vectors};
use serde_json::Value;

fn decode(capture: &str, arguments: &[&str]) -> Vec<Value> {
    let arguments = [&["decode", "-", "--format", "jsonl"], arguments].concat();
    let ran = polepair_with(&arguments, capture);
    assert_eq!(ran.code, 0, "{}", ran.err);
    ran.out.lines().map(|line| serde_json::from_str(line).expect("one object a line")).collect()
}

fn ok(arguments: &[&str]) -> String {
    let ran = polepair(arguments);
    assert_eq!(ran.code, 0, "{arguments:?}: {}{}", ran.out, ran.err);
    ran.out
}

#[test]
fn every_vector_decodes_and_encodes() {
    let all = vectors("thruster");
    let line =
        |v: &Value| format!("(1.0) {} {}#{}\n", text(v, "name"), &text(v, "can_id")[2..], hex(v));
    let ours = |v: &&Value| text(v, "protocol").is_empty();
    let capture: String = all.iter().filter(ours).map(line).collect();
    let frames = decode(&capture, &["--as", "thruster"]);
    assert!(frames.len() >= 60);
    for (v, frame) in all.iter().filter(ours).zip(&frames) {
        let (name, output) = (text(v, "name"), text(frame, "text"));
        assert!(frame["ok"] == true && frame["protocol"] == "thruster", "{name}: {frame}");
        let axis = frame["axis"].to_string();
        let ran = polepair(&["encode", "thruster", output, "--axis", &axis]);
        if v["invalid"] == true {
            assert_eq!((ran.code, ran.out.as_str()), (2, ""), "{name}: {output}");
            continue;
        }
        let expected = format!("{}#{}\n", &text(v, "can_id")[2..], hex(v));
        assert_eq!(ran.out, expected, "{name}: {output}: {}", ran.err);
    }
}

#[test]
fn the_owner_of_a_pdo2_is_not_guessed() {
    let capture = "\
(1.000) can0 30B#5443000000000005
(1.001) can0 28B#5443000000000005
(1.002) can0 001#01000000000001
(1.0021) can0 002#01640100000001
(1.003) can0 30C#51500000
(1.004) can0 28C#51500000000001E0
";
    let ran = polepair_with(&["decode", "-", "--format", "jsonl"], capture);
    let advice = "--as tmcl,thruster@11,thruster@12";
    assert!(ran.err.contains(advice), "{}", ran.err);
    assert!(!ran.out.contains("\"protocol\":\"thruster\""), "{}", ran.out);
    let frames = decode(capture, &["--as", "tmcl,thruster@11"]);
    let spoken: Vec<&str> = frames.iter().map(|f| text(f, "protocol")).collect();
    assert_eq!(spoken[..2], ["thruster", "thruster"]);
    assert_eq!(spoken[2..4], ["tmcl", "tmcl"]);
    assert!(spoken[4..].iter().all(|p| *p != "thruster"), "{spoken:?}");
    let alone = polepair_with(&["decode", "-"], "(1.0) can0 30B#5443000000000005\n");
    assert!(alone.err.contains("--as thruster@11"), "{}", alone.err);
}

#[test]
fn a_reply_that_repeats_ee_ee_refuses_nothing() {
    let capture = "(1.0) c 30B#4C520000EEEEEEEE\n(1.1) c 28B#4C520000EEEEEEEE\n\
        (1.2) c 30B#564300000000EEEE\n(1.3) c 28B#564300000000EEEE\n\
        (1.4) c 30B#5443000000000005\n(1.5) c 28B#544300000000EEEE\n\
        (1.6) c 30B#5443000000000005\n(1.7) c 28B#5443000000000000\n";
    let frames = decode(capture, &["--as", "thruster"]);
    let lines: Vec<&str> = frames.iter().map(|f| text(f, "text")).collect();
    assert!(lines[3].starts_with("VC -4370 rpm accepted"), "{lines:?}");
    assert_eq!(lines[5], "TC refused");
    assert!(lines[7].contains("stopped"), "{lines:?}");
}

#[test]
fn explain_names_fields_and_faults() {
    let shown = ok(&["explain", "thruster", "30B#5443000000000005"]);
    assert!(shown.contains("TC, axis 11: TC 5 % (signal control)"), "{shown}");
    assert_eq!(
        ok(&["explain", "thruster", "28B#5602000000180010"]),
        "56 02 00 00 00 18 00 10\n\
         VC report, axis 11: VC frame 2: status 0x0000, 24 degC (motor), 16 degC (driver)\n\n\
         bytes  hex    field     value   meaning\n\
         1      02     frame     2\n\
         2-3    00 00  status    0x0000  no fault\n\
         4-5    00 18  motor c   24      motor temperature\n\
         6-7    00 10  driver c  16      driver temperature\n"
    );
    let faults = ok(&["explain", "thruster", "0x0410"]);
    assert!(
        faults.contains("zero-point protection") && faults.contains("under-voltage"),
        "{faults}"
    );
    let elmo = ok(&["explain", "thruster", "301#434C01800000803F"]);
    assert!(elmo.contains("Elmo"), "{elmo}");
    let refused = ok(&["explain", "thruster", "0xEEEE"]);
    assert!(refused.contains("refused"), "{refused}");
}

#[test]
fn verbs_turn_move_and_stop_simulated_drives() {
    let url = "sim:thruster:11?time=virtual";
    let info = ok(&["info", url]);
    assert!(info.contains("Underwater thruster"), "{info}");
    ok(&["spin", url, "600rpm", "--for", "1s"]);
    ok(&["torque", url, "20%", "--for", "1s"]);
    assert!(ok(&["get", url, "voltage"]).contains("48 V"));
    assert_eq!(ok(&["set", url, "command timeout=500ms"]), "command timeout = 500 ms (500)\n");
    let shown = ok(&["spin", url, "600rpm", "--dry-run"]);
    assert!(shown.contains("30B#5643000000000258"), "{shown}");
    let servo = "sim:thruster-servo:11?time=virtual";
    ok(&["move", servo, "90deg", "--vel", "60rpm"]);
    ok(&["move", servo, "--rel", "10deg"]);
    let shown = ok(&["move", servo, "90deg", "--vel", "60rpm", "--dry-run"]);
    assert!(shown.contains("30B#4C41003C00000384"), "{shown}");
    let shown = ok(&["stop", servo, "--dry-run"]);
    assert!(shown.contains("30B#4C53000000000000"), "{shown}");
    let actuator = "sim:thruster-actuator:11?time=virtual&profile=thruster-actuator";
    let shown = ok(&["move", actuator, "25mm", "--dry-run"]);
    assert!(shown.contains("30B#4C41001E000000FA"), "{shown}");
    ok(&["move", actuator, "25mm"]);
    for (arguments, text) in [
        (&["spin", url, "29rpm", "--for", "1s"][..], "30 rpm"),
        (&["spin", url, "9000rpm"], "4000"),
        (&["move", servo, "180deg"], "179.9"),
    ] {
        let ran = polepair(arguments);
        assert_eq!(ran.code, 2, "{arguments:?}: {}", ran.err);
        assert!(ran.err.contains(text), "{}", ran.err);
    }
}

#[test]
fn a_scan_tells_thrusters_from_servos() {
    let found = ok(&["scan", "sim:thruster:11?time=virtual", "--ids", "9-12", "--format", "jsonl"]);
    assert!(found.lines().count() == 1 && found.contains(r#""drive":"thruster""#), "{found}");
    let found =
        ok(&["scan", "sim:thruster-servo:11?time=virtual", "--ids", "11-11", "--format", "jsonl"]);
    assert!(found.contains(r#""drive":"thruster-servo""#), "{found}");
}

/// A node id that another drive answers at is refused before anything is written. One that is free holds
/// from the drive's next start on (protocol manual, section 2.2).
#[test]
fn a_node_id_that_is_taken_is_refused() {
    let sim = Served::with(&["thruster:11,12", "--socketcand", "127.0.0.1:0"]);
    let link = sim.url.split('#').next().expect("a link").to_owned();
    let drive = format!("{link}#11");
    let taken = polepair(&["set", &drive, "node id=12"]);
    assert!(taken.code == 2 && taken.err.contains("already has address 12"), "{}", taken.err);
    let free = polepair(&["set", &drive, "node id=13"]);
    assert_eq!((free.code, free.out.as_str()), (0, "node id = 13\n"), "{}", free.err);
    assert!(free.err.contains("after it is switched off and on"), "{}", free.err);
    assert!(ok(&["get", &drive, "voltage"]).starts_with("voltage = 48"));
    ok(&["act", &drive, "power-cycle"]);
    assert!(ok(&["get", &format!("{link}#13"), "voltage"]).starts_with("voltage = 48"));
    sim.end();
}

/// `watch --reports` shows what the drive sends by itself, and switches it on only where an interval is
/// given, and then off again (protocol manual, section 2.5).
#[test]
fn watch_shows_what_the_drive_sends_by_itself() {
    let sim = Served::with(&["thruster:11", "--socketcand", "127.0.0.1:0"]);
    let watch = |option: &str| {
        polepair(&[
            "watch", &sim.url, "velocity", "voltage", option, "--for", "200ms", "--format", "csv",
        ])
    };
    let subscribed = watch("--reports=50ms");
    assert_eq!(subscribed.code, 0, "{}", subscribed.err);
    assert!(
        subscribed.out.starts_with("time [s],velocity [rpm],voltage [V]\n"),
        "{}",
        subscribed.out
    );
    let rows: Vec<&str> = subscribed.out.lines().skip(1).collect();
    assert!(!rows.is_empty() && rows.iter().all(|row| row.ends_with(",0,48")), "{rows:?}");
    assert!(subscribed.err.contains("permanent memory: 2"), "{}", subscribed.err);
    let silent = watch("--reports");
    assert!(
        silent.code == 4 && silent.err.contains("did not send velocity by itself"),
        "{}",
        silent.err
    );
    assert!(silent.err.contains("--reports=100ms"), "{}", silent.err);
    ok(&["set", &sim.url, "autosend=65586"]);
    let kept = watch("--reports");
    assert_eq!((kept.code, kept.err.as_str()), (0, ""));
    assert!(kept.out.lines().nth(1).is_some_and(|row| row.ends_with(",0,48")), "{}", kept.out);
    let refused = polepair(&["watch", &sim.url, "torque", "--reports=50ms"]);
    assert!(
        refused.code == 2 && refused.err.contains("does not report its torque"),
        "{}",
        refused.err
    );
    sim.end();
}

#[test]
fn a_drive_with_its_replies_switched_off_is_measured() {
    let sim = Served::new("thruster:1");
    ok(&["set", &sim.url, "reply form=0x0200"]);
    let ran = polepair(&["spin", &sim.url, "300rpm", "--detach"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let ran = polepair(&["stop", &sim.url]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("axis 1 is stopped"), "{}", ran.err);
}

#[test]
fn a_limit_that_no_manual_states_is_a_caution_for_raw_values() {
    let servo = "sim:thruster-servo?time=virtual";
    let ran = polepair(&["set", servo, "VC=250", "--raw", "--arm", "--dry-run"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let caution = "caution: `target speed`: 250 raw is beyond -200 rpm to 200 rpm, limits that no \
                   manual states";
    assert!(ran.err.contains(caution), "{}", ran.err);
    for refused in [
        &["set", servo, "VC=250rpm", "--arm"][..],
        &["set", servo, "VC=40000", "--raw", "--arm"],
        &["spin", servo, "250rpm", "--for", "1s"],
        &["set", "sim:thruster?time=virtual", "VC=5000 rpm", "--arm"],
    ] {
        let ran = polepair(refused);
        assert!(ran.code == 2 && ran.err.contains("error[E216]"), "{}", ran.err);
    }
}

#[test]
fn a_safe_range_is_written_by_its_two_ends() {
    let servo = "sim:thruster-servo?time=virtual";
    let ran = polepair(&["set", servo, "safe range=1"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    assert!(ran.err.contains("Written by `reverse end` and `forward end`"), "{}", ran.err);
    let shown = ok(&["set", servo, "reverse end=-90deg", "forward end=45deg"]);
    assert_eq!(shown, "reverse end = -90 deg (-900)\nforward end = 45 deg (450)\n");
}

#[test]
fn a_bit_rate_is_the_number_of_the_manual() {
    let url = "sim:thruster?time=virtual";
    assert_eq!(ok(&["set", url, "bit rate=250"]), "bit rate = 250k (250)\n");
    assert_eq!(ok(&["set", url, "bit rate=333.33k"]), "bit rate = 333.33k (333)\n");
    let ran = polepair(&["set", url, "bit rate=501"]);
    assert!(ran.code == 2 && ran.err.contains("bit rates are 1000, 800"), "{}", ran.err);
}
