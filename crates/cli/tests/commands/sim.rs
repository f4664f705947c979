//! Simulated drives on real pseudo-terminals, and the verbs against them.
#![cfg(unix)]

use crate::run;

use std::io::{BufRead as _, BufReader};

use run::{Served, ok, polepair};

#[test]
fn parameters_are_set_and_read_back() {
    let sim = Served::new("tmcl:1");
    assert_eq!(ok(&["set", &sim.url, "max current=1A"]), "max current = 1 A (10)\n");
    assert_eq!(ok(&["get", &sim.url, "--raw", "AP 6"]), "max current = 10\n");
    let refused = polepair(&["set", &sim.url, "max current=99A"]);
    assert_eq!(refused.code, 2);
    let expected = "error[E216]: `max current` takes 0 A to 25 A, not 99A.\n  It was not sent. ";
    assert!(refused.err.starts_with(expected), "{}", refused.err);
    assert!(ok(&["info", &sim.url]).contains("faults           none"));
    sim.end();
}

#[test]
fn a_scan_passes_addresses_without_a_drive() {
    // Address 2 is the host's own: no module can have it.
    let sim = Served::new("tmcl:1,3");
    let link = sim.url.split('#').next().expect("a link");
    let found = ok(&["scan", link, "--ids", "1-4", "--format", "jsonl"]);
    assert_eq!(found.lines().count(), 2, "{found}");
    sim.end();
}

#[test]
fn an_address_without_a_reply_is_exit_code_4() {
    let sim = Served::new("modbus-rtu:1");
    let link = sim.url.split('#').next().expect("a link");
    let ran = polepair(&["get", &format!("{link}?profile=syntron-ts#7"), "motor speed"]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.starts_with("error[E401]: ") && ran.err.contains("no answer"), "{}", ran.err);
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
    // What powers the module comes first, reads included.
    let lines: Vec<&str> = shown.lines().collect();
    assert!(lines[0].ends_with("  read status flags"), "{shown}");
    assert!(lines.iter().any(|line| line.ends_with("  write driver enable = 1 raw")), "{shown}");
    let last = "01 01 00 00 00 00 00 C8 CA  send ROR 0, 200: rotate right";
    assert_eq!(lines.last(), Some(&last), "{shown}");
    assert_eq!(ok(&["get", &sim.url, "target velocity"]), "target velocity = 0 rpm\n");
    // Degrees depend on the encoder's resolution, which is read first.
    let shown = ok(&["move", &sim.url, "90deg", "--dry-run"]);
    assert!(shown.contains("send MVP ABS, 0, 1024"), "{shown}");
    sim.end();
}

#[test]
fn a_trace_can_be_decoded() {
    let sim = Served::new("modbus-rtu:1");
    let trace = std::env::temp_dir().join(format!("polepair-trace-{}.log", std::process::id()));
    let path = trace.to_str().expect("text");
    ok(&["get", &sim.url, "motor speed", "--trace", path]);
    let shown = ok(&["decode", path, "--as", "modbus-rtu"]);
    std::fs::remove_file(&trace).expect("a trace");
    // A session begins in doubt: it reads what the drive may refuse.
    let is_probe = |line: &str| line.ends_with("the drive does not know this function code");
    let strange = shown.lines().find(|line| line.contains('!') && !is_probe(line));
    assert!(shown.contains("motor speed = ") && strange.is_none(), "{shown}");
    sim.end();
}

#[test]
fn the_demo_plays_without_errors() {
    let shown = ok(&["demo", "--headless"]);
    assert!(shown.starts_with("Found 2 drives of two makers by a scan."), "{shown}");
    assert_eq!(shown.matches("14 of 14").count(), 2, "{shown}");
}

#[test]
fn homing_works_out_of_the_box_and_gives_up_in_time() {
    let sim = Served::new("tmcl:1");
    assert_eq!(ok(&["home", &sim.url, "--timeout", "20s"]), "position = 0 deg\n");
    sim.end();
    // Without its switch the module would search for a minute.
    let sim = Served::new("tmcl:1");
    let ran = polepair(&["home", &sim.url, "--timeout", "300ms"]);
    assert_eq!(ran.code, 1, "{}", ran.err);
    assert!(
        ran.err.contains("error[E101]") && ran.err.contains("home did not end in time"),
        "{}",
        ran.err
    );
    assert_eq!(ok(&["get", &sim.url, "target velocity"]), "target velocity = 0 rpm\n");
    sim.end();
}

#[test]
fn a_tml_axis_homes_moves_along_an_s_curve_and_pushes() {
    const RACK: &str = "[[link]]\nprotocol = \"tml\"\nbaud = 115200\n[[link.drive]]\n\
        profile = \"technosoft-f514l\"\nlimit_high = 3.0\n";
    let file = std::env::temp_dir().join(format!("polepair-tml-{}.toml", std::process::id()));
    std::fs::write(&file, RACK).expect("a file");
    let sim = Served::new(file.to_str().expect("text"));
    std::fs::remove_file(&file).expect("a file");
    assert_eq!(
        ok(&["home", &sim.url, "--vel", "60rpm", "--timeout", "20s"]),
        "position = 0 turn\n"
    );
    let refused = polepair(&["home", &sim.url]);
    assert!(refused.err.contains("move the axis off it first"), "{}", refused.err);
    let curve = ["move", &sim.url, "--s-curve", "50ms", "--", "-180deg"];
    assert!(ok(&curve).starts_with("position = -0."));
    let on = ["move", &sim.url, "--rel", "--additive", "--", "-90deg"];
    let there = ok(&on);
    let turns = there.trim().strip_prefix("position = ").and_then(|t| t.strip_suffix(" turn"));
    let turns: f64 = turns.and_then(|t| t.parse().ok()).expect(&there);
    assert!((turns + 0.75).abs() < 0.01, "{there}");
    ok(&["torque", &sim.url, "--for", "200ms", "--", "-2%"]);
    let ampere = polepair(&["torque", &sim.url, "0.5A"]);
    assert_eq!(ampere.code, 2);
    assert!(ampere.err.contains("which it does not tell"), "{}", ampere.err);
    sim.end();
}

#[test]
fn a_path_goes_over_tcp() {
    let sim = Served::with(&["tml:1", "--tcp", "127.0.0.1:0"]);
    assert!(sim.url.starts_with("tml+tcp://"), "{}", sim.url);
    let path: String = (1..=100)
        .map(|n| {
            let phase = f64::from(n) / 100.0 * std::f64::consts::TAU;
            format!("{}, {}, 0.02\n", 1.0 - phase.cos(), phase.sin() * std::f64::consts::PI)
        })
        .collect();
    let file = std::env::temp_dir().join(format!("polepair-path-{}.csv", std::process::id()));
    std::fs::write(&file, path).expect("a file");
    let ran = polepair(&["stream", &sim.url, file.to_str().expect("text")]);
    std::fs::remove_file(&file).expect("a file");
    assert_eq!(ran.code, 0, "{}{}", ran.out, ran.err);
    sim.end();
}

#[test]
fn modules_may_have_the_address_that_hosts_have_from_the_factory() {
    let sim = Served::new("tmcl:1,2");
    assert!(sim.url.ends_with("?host=255#1,2"), "{}", sim.url);
    assert_eq!(ok(&["get", &sim.url, "max current"]).lines().count(), 2);
    // The host gives way by itself where the axes show that it must.
    let plain = sim.url.replace("?host=255", "");
    assert_eq!(ok(&["get", &plain, "max current"]).lines().count(), 2);
    sim.end();
    assert!(ok(&["info", "sim:tmcl?axes=3"]).contains("axis 3: "));
    for wrong in ["sim:tmcl#256", "tmcl+tcp://127.0.0.1:1#256", "modbus-rtu+tcp://127.0.0.1:1#248"]
    {
        assert_eq!(polepair(&["info", wrong]).code, 2, "{wrong}");
    }
}

#[test]
fn a_racks_faults_happen_in_real_time_too() {
    let rack = std::env::temp_dir().join(format!("polepair-faults-{}.toml", std::process::id()));
    let path = rack.to_str().expect("text");
    let text = "[[link]]\nfaults = { lose_reply = 1.0 }\n[[link.drive]]\nprofile = \"tmcm-171\"\n";
    std::fs::write(&rack, text).expect("a rack");
    let sim = Served::new(path);
    assert_eq!(polepair(&["info", &sim.url]).code, 4);
    sim.end();
    std::fs::write(&rack, text.replace("lose_reply = 1.0", "chunk = 1.0")).expect("a rack");
    let sim = Served::new(path);
    ok(&["spin", &sim.url, "300rpm", "--for", "300ms"]);
    sim.end();
    std::fs::remove_file(&rack).expect("a rack");
}

#[test]
fn a_path_that_is_served_is_not_taken_over() {
    let alias = std::env::temp_dir().join(format!("polepair-taken-{}", std::process::id()));
    let path = alias.to_str().expect("text");
    let mut first = run::command(&["sim", "tmcl", "--pty", path]).spawn().expect("starts");
    let mut lines = BufReader::new(first.stdout.take().expect("a pipe")).lines();
    lines.next().expect("a line").expect("text");
    let second = polepair(&["sim", "tmcl", "--pty", path]);
    assert_eq!(second.code, 3, "{}", second.err);
    assert!(
        second.err.contains("error[E312]") && second.err.contains("In use by"),
        "{}",
        second.err
    );
    // What a killed one leaves behind is replaced.
    first.kill().expect("ends");
    first.wait().expect("ends");
    let mut third = run::command(&["sim", "tmcl", "--pty", path]).spawn().expect("starts");
    let mut lines = BufReader::new(third.stdout.take().expect("a pipe")).lines();
    assert!(lines.next().expect("a line").expect("text").starts_with("ready "));
    third.kill().expect("ends");
    third.wait().expect("ends");
    std::fs::remove_file(&alias).expect("a link");
}

#[test]
fn frames_are_named_by_the_drives_profile() {
    let sim = Served::new("modbus-rtu:1");
    let ran = polepair(&["get", &sim.url, "internal speed", "-v"]);
    assert!(ran.err.contains("read Fn_33 internal speed"), "{}", ran.err);
    ok(&["set", &sim.url, "control mode=1"]);
    let shown = ok(&["spin", &sim.url, "200rpm", "--dry-run"]);
    assert!(shown.contains("01 06 00 33 00 C8 78 53"), "{shown}");
    sim.end();
}

/// `polepair act`: a fault on demand, by the URL that the simulation printed, or by its control socket.
#[test]
fn acts_are_done_to_a_simulation_that_runs() {
    let socket = std::env::temp_dir().join(format!("polepair-act-{}.sock", std::process::id()));
    let socket = socket.to_str().expect("a path");
    let sim = Served::with(&["tmcl:1,3", "--control", socket]);
    let link = sim.url.split('#').next().expect("a link").to_owned();
    let done = polepair(&["act", &format!("{socket}#3"), "supply=7 V"]);
    assert_eq!((done.code, done.err.as_str()), (0, "done: supply=7 V\n"));
    let info = polepair(&["info", &format!("{link}#3")]);
    assert!(info.out.contains("FAULT UNDERVOLT"), "{}{}", info.out, info.err);
    assert!(ok(&["info", &format!("{link}#1")]).contains("faults           none"));
    let unknown = polepair(&["act", &format!("{socket}#3"), "supply=7 V", "bogus"]);
    assert!(unknown.code == 2 && unknown.err.contains("`bogus` is nothing"), "{}", unknown.err);
    let refused = polepair(&["act", &format!("{socket}#3"), "sto"]);
    assert!(refused.code == 2 && refused.err.contains("nothing for `sto`"), "{}", refused.err);
    let missing = polepair(&["act", &format!("{socket}#9"), "jam"]);
    assert!(missing.code == 2 && missing.err.contains("no drive `9`"), "{}", missing.err);
    sim.end();
    assert!(!std::path::Path::new(socket).exists(), "the socket is gone with its simulation");
    let gone = polepair(&["act", &format!("{link}#3"), "jam"]);
    assert!(gone.code == 2 && gone.err.contains("no simulation on this machine"), "{}", gone.err);
    assert!(ok(&["act"]).contains("jam"));
}

/// A simulation by the URL of a link.
#[test]
fn an_act_finds_its_simulation_by_the_url() {
    let sim = Served::new("thruster-servo:11");
    let done = polepair(&["act", &sim.url, "temperature=130 degC"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let info = polepair(&["info", &sim.url]);
    assert!(info.out.contains("motor over-temperature"), "{}{}", info.out, info.err);
    sim.end();
}
