//! `polepair --server URL VERB`: the real binary joins the real server.
#![cfg(unix)]

use crate::run;
use crate::run::screen;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

use polepair_test_support::wait_until;
use run::{Held, Ran, Served, Server, command, polepair, signal};
use screen::Screen;

#[test]
fn a_server_shows_its_axes_as_a_link_does() {
    let server = Server::new(&["sim:tmcl?axes=2&baud=115200"]);
    let scan = server.ok(&["scan"]);
    assert_eq!(scan.lines().count(), 3, "{scan}");
    assert!(scan.starts_with("axis  link  name  drive"), "{scan}");
    let csv = server.ok(&["scan", "--format", "csv"]);
    assert!(csv.contains("\n3,0,,tmcm-171,"), "{csv}");
    let info = server.info();
    let watchdog = "watchdog off: the motor continues its last command (`serial heartbeat`)";
    for line in ["axis 1: ", "position 0 deg", "controlled by no client", watchdog, "faults none"] {
        assert!(info.contains(line), "{line}: {info}");
    }
    let get = server.ok(&["get", "all", "max current"]);
    assert_eq!(get, "#1 max current = 10 A\n#3 max current = 10 A\n");
    let line = server.ok(&["get", "0#3", "AP 6", "--format", "jsonl"]);
    let json: serde_json::Value = serde_json::from_str(&line).expect("JSON");
    assert_eq!((&json["axis"], &json["raw"]), (&3.into(), &100.into()), "{line}");
    assert_eq!(json["link"], 0, "{line}");
    let csv = server.ok(&["get", "3", "max current", "--format", "csv"]);
    assert!(csv.starts_with("axis,link,name,symbol,raw,value,unit\n3,0,max current,"), "{csv}");
    assert!(server.ok(&["get", "1", "all"]).lines().count() > 50);
    let watched =
        server.ok(&["watch", "1", "position", "--rate", "50", "--for", "200ms", "--format", "csv"]);
    assert!(watched.starts_with("time [s],position [deg]\n0.000000,0"), "{watched}");
}

/// One command line, wherever the wire is: the same words on stdout and stderr, and the same exit code.
#[test]
fn verbs_print_the_same_on_a_link_and_on_a_server() {
    let (near, far) = (Served::new("tmcl:1"), Served::new("tmcl:1"));
    let server = Server::new(&[&far.url]);
    let verbs: &[&[&str]] = &[
        &["enable"],
        // First: on a busy machine the timed motions end beyond the switch.
        &["home", "--timeout", "60s"],
        &["set", "stop switch enable=0"],
        &["move", "90deg", "--vel", "300rpm", "--timeout", "60s"],
        &["move", "--rel", "--", "-90deg"],
        &["spin", "300rpm", "--for", "300ms"],
        &["jog", "--for", "300ms"],
        &["torque", "0.5A", "--for", "300ms"],
        &["disable"],
        &["clear"],
        &["watchdog"],
        &["watchdog", "2s"],
        &["watchdog", "off"],
        &["spin", "60furlong"],
        &["spin", "60rpm", "--dec", "5rpm/s"],
        &["move", "90deg", "--s-curve", "50ms"],
        &["get", "max current", "AP 6", "serial address"],
        &["get", "max current", "--raw"],
        &["set", "max current=1.2A"],
        &["set", "max current=2A", "--dry-run"],
        &["set", "AP 6=12", "--dry-run"],
        &["set", "AP 6=13"],
        // Refused before the first is written.
        &["set", "max current=1A", "max current=99A"],
        &["set", "max current=1A", "no such name=3"],
        &["set", "max current=1A", "AP 6=1furlong"],
        &["set", "max current=1A", "supply voltage=3V"],
        &["get", "max current"],
    ];
    // Frames and writes are counted on one's own link alone; how far a short motion came is a measurement.
    let counted = ["writes to the drive's permanent memory", "axis 1 reached ", "too short to"];
    let is_count = |line: &&str| counted.iter().any(|part| line.contains(part));
    let served_url = format!("{}#1", server.url.trim_end_matches('/'));
    let words = |text: &str| {
        let lines = text.lines().filter(|line| !is_count(line)).map(|line| {
            match line.split_once(" It was not sent. ") {
                Some((line, _)) => format!("{line} Nothing was sent."),
                None if line.starts_with("  It was not sent. ") => "  Nothing was sent.".to_owned(),
                None => line.to_owned(),
            }
        });
        lines
            .map(|line| match line.split_once(" = ") {
                Some((name @ ("position" | "velocity reached" | "current reached"), _)) => {
                    name.into()
                }
                _ => line,
            })
            .map(|line| line.replace(&near.url, "URL").replace(&served_url, "URL"))
            .collect::<Vec<String>>()
    };
    for verb in verbs {
        let [word, rest @ ..] = verb else { continue };
        let local = polepair(&[&[*word, &near.url], rest].concat());
        let served = server.run(&[&[*word, "1"], rest].concat());
        assert_eq!(local.code, served.code, "{verb:?}: {}\n{}", local.err, served.err);
        assert_eq!(words(&local.out), words(&served.out), "{verb:?}");
        assert_eq!(words(&local.err), words(&served.err), "{verb:?}");
    }
}

/// A cut wire ends a motion alike, with the same statement on the motor.
#[test]
fn a_wire_that_is_cut_ends_a_motion_alike() {
    let (near, far) = (Served::new("tmcl:1"), Served::new("tmcl:1"));
    let server = Server::new(&[&far.url]);
    let started = "running; Ctrl-C stops it";
    let held =
        [Held::new(&["spin", &near.url, "300rpm"], started), server.held(&["spin", "1", "300rpm"])];
    wait_until("the motor turns", || server.velocity("1") > 100.0);
    drop((near, far));
    for ended in held.map(Held::ended) {
        assert_eq!(ended.code, 3, "{}", ended.err);
        assert!(ended.err.contains("error[E313]"), "{}", ended.err);
        assert!(ended.err.contains("The motor may still turn: cut its supply."), "{}", ended.err);
    }
}

/// Values of a silent drive are shown as old, and the verb ends with an error.
#[test]
fn a_silent_drive_and_a_lost_link_are_reported_with_what_is_known_of_them() {
    run::expect_silence();
    let drive = Served::new("tmcl:1");
    let server = Server::new(&[&drive.url]);
    server.ok(&["info"]);
    signal("STOP", drive.id());
    wait_until("the link is lost", || server.run(&["info"]).code != 0);
    let ran = server.run(&["info"]);
    assert_eq!(ran.code, 4, "{}{}", ran.out, ran.err);
    assert!(ran.err.contains("axis 1 has not answered for "), "{}", ran.err);
    assert!(ran.out.contains(" s old)"), "{}", ran.out);
    let ran = server.run(&["stop", "1"]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    let ran = server.run(&["info"]);
    assert!(ran.out.contains("MAY BE TURNING"), "{}", ran.out);
    signal("CONT", drive.id());
    drop(drive);
    wait_until("link 0 is lost", || server.run(&["info"]).err.contains("LINK 0 IS LOST"));
}

/// Users in a hurry write options in any order.
#[test]
fn the_server_may_be_named_behind_the_verb() {
    let server = Server::new(&["sim:tmcl"]);
    let tokens = server.tokens();
    for words in [
        ["stop", "--server", &server.url, "--token-file", &tokens],
        ["--token-file", &tokens, "stop", "--server", &server.url],
    ] {
        let ran = polepair(&words);
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(ran.err.contains("axis 1 is stopped"), "{}", ran.err);
    }
    for (words, needs) in [
        (["stop", "sim:tmcl", "--token-file", &tokens], "--token-file needs --server URL"),
        (["--client-key", &tokens, "stop", "sim:tmcl"], "--client-key needs --server URL"),
    ] {
        let ran = polepair(&words);
        assert_eq!((ran.code, ran.err.contains(needs)), (2, true), "{}", ran.err);
    }
    let ran = polepair(&["ports", "--server", &server.url]);
    assert!(ran.err.contains("`ports` is not supported on a server"), "{}", ran.err);
    assert!(!polepair(&["ports", "--help"]).out.contains("--server"));
    assert!(polepair(&["stop", "--help"]).out.contains("--server"));
}

#[test]
fn the_meaning_of_a_value_for_one_of_several_axes_names_that_axis() {
    let server = Server::new(&["sim:tmcl?axes=2"]);
    let ran = server.run(&["spin", "all", "20mm/s", "--for", "1s"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    assert!(ran.err.contains("]: axis 1: "), "{}", ran.err);
    let ran = polepair(&["spin", "sim:tmcl?axes=2", "20mm/s", "--for", "1s"]);
    assert!(ran.err.contains("]: axis 1: "), "{}", ran.err);
}

#[test]
fn a_server_looks_for_drives_and_takes_them_in() {
    let server = Server::new(&["sim:tmcl?axes=3#1"]);
    let look = server.ok(&["scan", "--look", "--ids", "1-5", "--format", "jsonl"]);
    let reports: Vec<serde_json::Value> =
        look.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let axes: Vec<_> = reports.iter().map(|one| one["axis"].as_u64()).collect();
    assert_eq!(axes, [Some(3), Some(4)], "{look}");
    assert_eq!(
        (&reports[0]["link"], &reports[0]["drive"]),
        (&0.into(), &"tmcm-171".into()),
        "{look}"
    );
    assert_eq!(server.ok(&["scan"]).lines().count(), 2, "nothing is taken in unasked");
    let text = server.ok(&["scan", "--take", "--ids", "3-4"]);
    assert!(text.starts_with("axis  link  drive"), "{text}");
    assert_eq!(server.ok(&["scan"]).lines().count(), 4);
    assert!(server.ok(&["get", "4", "max current"]).contains("10 A"));
    let alone = server.ok(&["scan", "--look", "--ids", "1-2", "--format", "csv"]);
    assert_eq!(alone.lines().count(), 1, "{alone}");
}

/// A client with the token of the server here moves the motors here.
#[test]
fn the_token_of_ones_own_server_goes_to_no_other_host() {
    let name = format!("polepair-own-{}", std::process::id());
    let home = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&home).expect("a folder");
    let server = Server::within(home.join("polepair"), &["sim:tmcl"]);
    let own = |words: &[&str]| {
        let mut own = command(words);
        own.env("XDG_STATE_HOME", &home).env_remove("POLEPAIR_TOKEN");
        run::ran(own.output().expect("it ends"))
    };
    let here = own(&["--server", &server.url, "scan"]);
    assert_eq!(here.code, 0, "{}", here.err);
    let print = "ab".repeat(32);
    let refused = |host: &str, token: &[&str]| {
        let url = format!("https://{host}");
        let words = ["--server", &url, "--certificate", &print];
        own(&[&words, token, &["scan"]].concat())
    };
    for host in ["127.0.0.1.example:7365", "nobody.invalid"] {
        let ran = refused(host, &[]);
        assert_eq!((ran.code, &*ran.out), (2, ""), "{}", ran.err);
        let matches =
            ran.err.contains("error[E256]") && ran.err.contains("not sent to another host");
        assert!(matches, "{}", ran.err);
        // With a token that is meant for it, it is looked for, and is not there.
        let ran = refused(host, &["--token-file", &server.tokens()]);
        assert!(ran.code == 3 && ran.err.contains("error[E315]"), "{}", ran.err);
    }
    // Nor to who listens here: a stranger, or a tunnel, though it leads to our own server and asks it.
    let at = server.url.trim_start_matches("http://").trim_end_matches('/');
    for relayed in [None, Some(at.to_owned())] {
        let (url, received) = stranger(relayed);
        let ran = own(&["--server", &url, "scan"]);
        assert_eq!((ran.code, &*ran.out), (2, ""), "{}", ran.err);
        assert!(ran.err.contains("error[E256]") && ran.err.contains("prove"), "{}", ran.err);
        let output = String::from_utf8_lossy(&received.lock().expect("heard")).into_owned();
        assert!(output.starts_with("GET /api/v1/proof/"), "{output}");
        assert!(!output.to_ascii_lowercase().contains("authorization"), "{output}");
    }
    drop(server);
    std::fs::remove_dir_all(home).expect("removed");
}

/// Another program on a port of this machine, which replies to everything with nothing, or passes it on by the
/// name to which it belongs; and the bytes that it received.
fn stranger(relayed: Option<String>) -> (String, Arc<Mutex<Vec<u8>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let here = listener.local_addr().expect("an address").to_string();
    let received = Arc::<Mutex<Vec<u8>>>::default();
    let (url, heard_there) = (format!("http://{here}"), Arc::clone(&received));
    std::thread::spawn(move || {
        let (mut client, _) = listener.accept().expect("a client");
        let mut bytes = [0; 8192];
        while let Ok(count @ 1..) = client.read(&mut bytes) {
            heard_there.lock().expect("heard").extend_from_slice(&bytes[..count]);
            let mut answer = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}".to_vec();
            if let Some(server) = &relayed {
                let mut far = TcpStream::connect(server).expect("the server");
                let text = String::from_utf8_lossy(&bytes[..count]).replace(&here, server);
                far.write_all(text.as_bytes()).expect("passed on");
                answer.resize(8192, 0);
                let count = far.read(&mut answer).expect("an answer");
                answer.truncate(count);
                assert!(answer.starts_with(b"HTTP/1.1 200"), "the server answers");
            }
            let _ = client.write_all(&answer);
        }
    });
    (url, received)
}

#[test]
fn axes_and_frames_are_monitored() {
    let server = Server::new(&["sim:tmcl?axes=2", "sim:tmcl"]);
    let once = server.ok(&["monitor", "--once"]);
    assert!(once.starts_with("axis  drive "), "{once}");
    assert_eq!(once.lines().filter(|line| line.contains("tmcm-171")).count(), 3, "{once}");
    assert!(once.ends_with("0 frames\n"), "{once}");
    let held = server.held(&["spin", "0#1", "300rpm"]);
    wait_until("the motor turns", || server.velocity("0#1") > 100.0);
    let lines = server.ok(&["monitor", "0#1", "--format", "jsonl", "--for", "1s"]);
    let reports: Vec<serde_json::Value> =
        lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let axes: Vec<_> = reports.iter().filter(|line| line["signals"].is_object()).collect();
    assert!(axes.len() > 2 && axes.iter().all(|axis| axis["axis"] == 1), "{lines}");
    assert!(axes.iter().any(|axis| axis["state"] == "turns"), "{lines}");
    let velocity = &axes.last().expect("an axis")["signals"]["velocity"];
    assert_eq!(velocity["unit"], "rpm", "{lines}");
    let frames =
        reports.iter().filter(|line| line["protocol"] == "tmcl" && line["bytes"].is_string());
    assert!(frames.clone().count() > 2, "{lines}");
    assert!(frames.clone().any(|frame| frame["direction"] == "tx" && frame["ok"] == true));
    assert!(reports.last().is_some_and(|last| last["frames"].as_u64() > Some(2)), "{lines}");
    drop(held.interrupt());
    let wrong = server.run(&["monitor", "--listen"]);
    assert!(wrong.code == 2 && wrong.err.contains("error[E257]"), "{}", wrong.err);
}

#[test]
fn axes_and_frames_fill_a_screen_and_esc_stops_all() {
    let mut server = Server::new(&["sim:tmcl?axes=2", "sim:tmcl"]);
    let held = server.held(&["spin", "0#1", "300rpm"]);
    let mut screen = Screen::of(&server.words(&server.tokens(), &["monitor"]));
    screen.until("turns");
    // The second reading is drawn over the first.
    screen.until("300.0 rpm");
    screen.until("controlled by");
    for wanted in ["STOP ALL: Esc", "0#3", "1#1", "position", "age", "── frames", "q exit", "GAP"]
    {
        // Axes and frames are two streams: either may be drawn before the other has begun.
        screen.until(wanted);
    }
    screen.press(b"\x1b");
    screen.until("standing still");
    screen.until("LOCKED: ");
    println!("{}", screen.text());
    drop(held);
    server.child.kill().expect("it runs");
    screen.until("SERVER GONE for");
    screen.press(b"\x1b");
    screen.until("STOP NOT CONFIRMED");
    println!("{}", screen.text());
    screen.press(b"q");
    assert_eq!(screen.ended(), Some(0));
}

#[test]
fn esc_stops_the_axes_of_the_view_alone_where_some_are_named() {
    let server = Server::new(&["sim:tmcl?axes=2"]);
    let mut screen = Screen::of(&server.words(&server.tokens(), &["monitor", "3"]));
    screen.until("0#3");
    assert!(!screen.text().contains("0#1"), "{}", screen.text());
    screen.press(b"\x1b");
    screen.until("standing still");
    screen.press(b"q");
    assert_eq!(screen.ended(), Some(0));
    assert!(server.held(&["spin", "1", "300rpm"]).interrupt().code == 130, "nothing is locked");
}

#[test]
fn settings_are_planned_and_written() {
    let server = Server::new(&["sim:tmcl"]);
    let plan = server.ok(&["set", "1", "max current=1.2A", "--dry-run"]);
    assert_eq!(plan, "max current: 10 A (100) -> 1.2 A (12)\n");
    assert_eq!(server.ok(&["get", "1", "max current"]), "max current = 10 A\n");
    assert_eq!(server.ok(&["set", "1", "max current=1.2A"]), "max current = 1.2 A (12)\n");
    let wrong = server.run(&["set", "1", "max current=99A"]);
    assert!(wrong.code == 2 && wrong.err.contains("error[E216]"), "{}", wrong.err);
}

#[test]
fn a_drives_own_watchdog_is_shown_and_set() {
    let server = Server::new(&["sim:tmcl", "sim:cia402:5?heartbeat=100", "sim:modbus-rtu"]);
    // The server has the drive watch its heartbeat, soon after the link was opened.
    let armed = "on, the drive stops after 300 ms of silence (`consumer heartbeat`)";
    wait_until(armed, || server.ok(&["watchdog"]).contains(armed));
    let all = server.ok(&["watchdog"]);
    let lines: Vec<&str> = all.lines().collect();
    assert!(lines[0].contains("off") && lines[0].ends_with("(`serial heartbeat`)"), "{all}");
    assert!(lines[1].ends_with(armed), "{all}");
    assert!(lines[2].contains("none: the motor continues"), "{all}");
    for axis in ["0#1", "1#5"] {
        let ran = server.run(&["watchdog", axis, "700ms"]);
        assert!(ran.out.contains("on, the drive stops after 700 ms of silence"), "{ran:?}");
        let warned = if axis == "0#1" { "permanent memory" } else { "heartbeat=100" };
        assert!(ran.code == 0 && ran.err.contains(warned), "{ran:?}");
        assert_eq!(server.ok(&["watchdog", axis]), ran.out);
        assert!(server.ok(&["watchdog", axis, "off"]).contains("off: the motor continues"));
    }
    let ran = server.run(&["watchdog", "2#1", "700ms"]);
    assert!(ran.code == 2 && ran.err.contains("E218"), "{ran:?}");
    let ran = server.run(&["watchdog", "0#1", "700"]);
    assert!(ran.code == 2 && ran.err.contains("E217"), "{ran:?}");
    // The axis was given back each time.
    assert!(server.ok(&["set", "0#1", "max current=1A"]).contains("max current"));
}

#[test]
fn a_motor_moves_and_is_given_back() {
    let server = Server::new(&["sim:tmcl"]);
    let moved = server.ok(&["move", "1", "90deg", "--vel", "300rpm", "--timeout", "60s"]);
    let at: f64 = moved
        .strip_prefix("position = ")
        .and_then(|rest| rest.strip_suffix(" deg\n"))
        .and_then(|number| number.parse().ok())
        .unwrap_or_else(|| panic!("{moved}"));
    assert!((at - 90.0).abs() < 3.0, "{moved}");
    let info = server.info();
    assert!(info.contains("armed no") && info.contains("controlled by no client"), "{info}");
    server.ok(&["enable", "1"]);
    server.ok(&["disable", "1"]);
    server.ok(&["clear", "1"]);
}

#[test]
fn ctrl_c_stops_what_it_started() {
    let server = Server::new(&["sim:tmcl"]);
    let held = server.held(&["spin", "1", "300rpm"]);
    wait_until("the motor turns", || server.velocity("1") > 100.0);
    let ran = held.interrupt();
    assert_eq!(ran.code, 130, "{}", ran.err);
    assert!(ran.err.ends_with("interrupted: the motion was stopped\n"), "{}", ran.err);
    wait_until("the motor stands", || server.velocity("1").abs() < 2.0);
    assert!(server.info().contains("controlled by no client"));
}

#[test]
fn the_second_client_gets_the_name_of_the_first_and_either_may_stop() {
    let server = Server::new(&["sim:tmcl?axes=2"]);
    let held = server.held(&["spin", "1", "300rpm"]);
    let second = server.run(&["move", "1", "90deg"]);
    assert_eq!(second.code, 6, "{}", second.err);
    assert!(second.err.contains("error[gateway.lease]: operator "), "{}", second.err);
    assert!(second.err.contains(" controls this axis"), "{}", second.err);
    server.ok(&["move", "3", "10deg", "--timeout", "60s"]);
    let stopped = server.run(&["stop"]);
    assert_eq!(stopped.code, 0, "{}", stopped.err);
    assert!(stopped.err.contains("axis 1 is stopped\n"), "{}", stopped.err);
    let ended = held.ended();
    assert_eq!(ended.code, 6, "{}", ended.err);
    assert!(ended.err.contains("error[gateway.lease]: the lease ended"), "{}", ended.err);
    assert!(stopped.err.contains("motion is locked until it is released"), "{}", stopped.err);
    let locked = server.run(&["move", "3", "10deg"]);
    assert!(locked.code == 6 && locked.err.contains("error[gateway.locked]"), "{}", locked.err);
}

/// Nothing is asked before everything stops: asking takes time, and a right of its own.
#[test]
fn a_client_that_may_only_stop_stops_everything() {
    use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
    let folder = std::env::temp_dir().join(format!("polepair-may-stop-{}", std::process::id()));
    std::fs::DirBuilder::new().mode(0o700).create(&folder).expect("a folder");
    let mut tokens = std::fs::OpenOptions::new();
    let mut tokens = tokens.write(true).create_new(true).mode(0o600).open(folder.join("tokens"));
    let tokens = tokens.as_mut().expect("a file");
    writeln!(tokens, "{} stop guard", "5a".repeat(32)).expect("written");
    let server = Server::within(folder, &["sim:tmcl"]);
    let stopped = server.run(&["stop"]);
    assert_eq!(stopped.code, 0, "{}", stopped.err);
    assert!(stopped.err.contains("the server's axis 0 is stopped\n"), "{}", stopped.err);
    let ran = server.run(&["stop", "1"]);
    assert!(ran.code == 2 && ran.err.contains("error[gateway.scope]"), "{}", ran.err);
}

#[test]
fn old_values_of_a_silent_drive_are_not_shown_as_new() {
    run::expect_silence();
    let drive = Served::new("tmcl");
    let server = Server::new(&[&drive.url]);
    let tokens = server.tokens();
    let verb = ["watch", "all", "position", "--rate", "50", "--format", "jsonl"];
    let mut watch = command(&server.words(&tokens, &verb)).spawn().expect("starts");
    let mut lines = BufReader::new(watch.stdout.take().expect("a pipe")).lines();
    let mut shown = |what: &str| {
        let is = |line: &std::io::Result<String>| line.as_ref().is_ok_and(|l| l.contains(what));
        lines.find(is).unwrap_or_else(|| panic!("never {what}"))
    };
    let line = shown("\"position\":0").expect("text");
    assert!(line.contains(",\"axis\":1,\"link\":0,"), "{line}");
    signal("STOP", drive.id());
    shown("\"position\":null").expect("text");
    signal("KILL", drive.id());
    let ended = run::ran(watch.wait_with_output().expect("ends"));
    assert_eq!(ended.code, 3, "{}", ended.err);
    assert!(ended.err.contains("error[E313]: the link of axis 1 "), "{}", ended.err);
}

#[test]
fn a_motor_whose_drive_falls_silent_is_not_held_for_ever() {
    run::expect_silence();
    let drive = Served::new("tmcl");
    let server = Server::new(&[&drive.url]);
    let held = server.held(&["spin", "1", "300rpm"]);
    wait_until("the motor turns", || server.velocity("1") > 100.0);
    signal("STOP", drive.id());
    let ended = held.ended();
    signal("CONT", drive.id());
    assert_eq!(ended.code, 4, "{}", ended.err);
    let reported = ended.err.contains("axis 1 may still turn: cut its supply")
        && ended.err.contains("error[E401]: axis 1 has not answered for ")
        && ended.err.contains("The motor may still turn: cut its supply.");
    assert!(reported, "{}", ended.err);
}

#[test]
fn a_server_that_leaves_a_motor_unseen_does_not_end_well() {
    run::expect_silence();
    let drive = Served::new("tmcl");
    let mut server = Server::new(&[&drive.url]);
    let held = server.held(&["spin", "1", "300rpm"]);
    signal("STOP", drive.id());
    signal("TERM", server.child.id());
    let ended = server.child.wait().expect("ends");
    signal("CONT", drive.id());
    assert_eq!(ended.code(), Some(7));
    let held = held.ended();
    assert_ne!(held.code, 0);
    assert!(held.err.contains("The motor may still turn: cut its supply."), "{}", held.err);
}

/// A client whose axis was stopped by another client gets no warning that the motor may turn.
#[test]
fn a_client_stopped_by_others_reads_that_the_axis_was_left_at_standstill() {
    let drive = Served::new("tmcl:1");
    let mut server = Server::new(&[&drive.url]);
    let all_well = |ran: &Ran| !ran.err.contains("may still turn") && ran.code != 0;
    for stop in [&["stop", "1"][..], &["stop"]] {
        let held = server.held(&["spin", "1", "300rpm"]);
        wait_until("the motor turns", || server.velocity("1") > 100.0);
        server.ok(stop);
        let ended = held.ended();
        assert!(all_well(&ended), "{stop:?}: {}", ended.err);
        server.ok(&["release"]);
        std::thread::scope(|scope| {
            let moves = scope.spawn(|| server.run(&["move", "1", "3000turn", "--vel", "300rpm"]));
            wait_until("the motor turns", || server.velocity("1") > 100.0);
            server.ok(stop);
            let ended = moves.join().expect("ends");
            assert!(all_well(&ended), "{stop:?}: {}", ended.err);
        });
        server.ok(&["release"]);
    }
    let held = server.held(&["spin", "1", "300rpm"]);
    wait_until("the motor turns", || server.velocity("1") > 100.0);
    signal("TERM", server.child.id());
    assert_eq!(server.child.wait().expect("ends").code(), Some(0));
    let ended = held.ended();
    assert!(all_well(&ended) && ended.code == 3, "{}", ended.err);
    assert!(ended.err.contains("standstill is confirmed"), "{}", ended.err);
}

/// A hanging server sends nothing about its drives: none of them is blamed.
#[test]
fn a_server_that_hangs_is_not_reported_as_a_silent_drive() {
    run::expect_silence();
    let drive = Served::new("tmcl:1");
    let server = Server::new(&[&drive.url]);
    let held = server.held(&["spin", "1", "300rpm"]);
    wait_until("the motor turns", || server.velocity("1") > 100.0);
    signal("STOP", server.child.id());
    let ended = held.ended();
    signal("CONT", server.child.id());
    assert_eq!(ended.code, 3, "{}", ended.err);
    assert!(!ended.err.contains("has not answered"), "{}", ended.err);
    assert!(ended.err.contains("The motor may still turn: cut its supply."), "{}", ended.err);
}

/// A missing axis does not keep others from being stopped, and it is reported.
#[test]
fn a_stop_names_the_axes_that_are_not_there_and_stops_the_others() {
    run::expect_silence();
    let drive = Served::new("tmcl:1,3");
    let server = Server::new(&[&drive.url.replace("#1,3", "#1,3,9")]);
    let turns = || server.held(&["spin", "0#1,0#3", "300rpm"]);
    for (words, code) in [(&["stop"][..], 7), (&["stop", "1,9,3,1"], 7), (&["stop", "0#1,0#3"], 0)]
    {
        server.ok(&["release"]);
        let held = turns();
        let stopped = server.run(words);
        assert_eq!(stopped.code, code, "{words:?}: {}", stopped.err);
        for axis in ["axis 1 is stopped", "axis 3 is stopped"] {
            assert_eq!(stopped.err.matches(axis).count(), 1, "{words:?}: {}", stopped.err);
        }
        let named = stopped.err.contains("axis 9 of link 0 ");
        assert_eq!(named, code == 7, "{words:?}: {}", stopped.err);
        held.ended();
    }
    let stopped = server.run(&["stop", "9"]);
    assert_eq!(stopped.code, 4, "{}", stopped.err);
    let reported = stopped
        .err
        .contains("error[E401]: axis 9 of link 0 is missing, and no stop was sent to it")
        && stopped.err.contains("cut its supply");
    assert!(reported, "{}", stopped.err);
}

#[test]
fn a_server_that_is_killed_leaves_no_client_waiting() {
    let drive = Served::new("tmcl:1");
    let mut server = Server::new(&[&drive.url]);
    let held = server.held(&["spin", "1", "300rpm"]);
    let words = server.words(&server.tokens(), &["watch", "1"]).join("\n");
    let words: Vec<&str> = words.split('\n').collect();
    let mut watch = command(&words).spawn().expect("starts");
    let mut lines = BufReader::new(watch.stdout.take().expect("a pipe")).lines();
    lines.nth(1).expect("a line").expect("text");
    signal("KILL", server.child.id());
    let _ = server.child.wait();
    let ended = held.ended();
    assert_eq!(ended.code, 3, "{}", ended.err);
    assert!(ended.err.contains("error[E313]: the server went away"), "{}", ended.err);
    assert!(ended.err.contains("it may have been executed"), "{}", ended.err);
    assert!(ended.err.contains("The motor may still turn: cut its supply."), "{}", ended.err);
    // The very words that were printed stop it.
    let stop = ended.err.lines().find_map(|line| line.strip_prefix("  try: `polepair stop "));
    let stop = stop.and_then(|stop| stop.split('`').next()).expect("a link's URL");
    assert_eq!(stop, drive.url);
    assert_eq!(polepair(&["stop", stop]).code, 0);
    // Who only looked had nothing done.
    let watched = run::ran(watch.wait_with_output().expect("ends"));
    assert_eq!(watched.code, 3, "{}", watched.err);
    assert!(!watched.err.contains("executed") && !watched.err.contains("lease"), "{}", watched.err);
    let after = server.run(&["info"]);
    assert!(after.code == 3 && after.err.contains("error[E314]"), "{}", after.err);
}

#[test]
fn a_verb_that_a_server_does_not_have_is_refused_and_opens_no_link() {
    let server = Server::new(&["sim:tmcl", "sim:tmcl"]);
    let cases: &[(&[&str], &str)] = &[
        (&["record", "sim:tmcl", "-o", "/nowhere/x"], "E257"),
        (&["ports"], "E257"),
        (&["spin", "0#1", "60rpm", "--detach"], "E257"),
        (&["spin", "0#1", "60rpm", "--dry-run"], "E257"),
        (&["info", "0#1", "-v"], "E257"),
        (&["spin", "0#1", "60"], "E217"),
        (&["move", "0#1,1", "90deg", "--rel"], "E210"),
        (&["info", "9"], "E212"),
        // Both links have an axis 1.
        (&["info", "1"], "E212"),
        (&["info", "7#1"], "E212"),
        (&["info", "0#1,7#1"], "E212"),
        (&["info", "0#1,1#1,0#1"], "E210"),
        (&["get", "0#1", "max curent"], "E213"),
    ];
    let ran = server.run(&["move", "0#1", "90"]);
    assert!(ran.err.contains("try: write 90deg or 90turn\n"), "{}", ran.err);
    for (verb, code) in cases {
        let ran = server.run(verb);
        assert_eq!((ran.code, &*ran.out), (2, ""), "{verb:?}: {}", ran.err);
        assert!(ran.err.contains(&format!("error[{code}]: ")), "{verb:?}: {}", ran.err);
    }
}

#[test]
fn stored_paths_are_loaded_and_run() {
    let server = Server::new(&["sim:syntron-ts?fn00=14"]);
    let file = std::env::temp_dir().join(format!("polepair-paths-{}.toml", std::process::id()));
    let path = "kind = \"single\"\nend = \"absolute\"\nposition = \"90 deg\"\nspeed = \"300 rpm\"\n\
                acceleration = \"200 ms\"\ndeceleration = \"200 ms\"\n";
    let text = format!("version = 1\ntravel = \"360 deg\"\n[paths.1]\n{path}");
    std::fs::write(&file, text).expect("written");
    let name = file.to_str().expect("UTF-8");
    let differ = server.run(&["paths", "diff", "1", name]);
    assert!(differ.code == 1 && differ.out.contains("90 deg"), "{}{}", differ.out, differ.err);
    let unasked = server.run(&["paths", "load", "1", name]);
    assert!(unasked.code == 2 && unasked.err.contains("error[E247]"), "{}", unasked.err);
    server.ok(&["paths", "load", "1", name, "--yes"]);
    assert_eq!(server.run(&["paths", "diff", "1", name]).code, 0);
    let ran = server.run(&["paths", "run", "1", "1"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let at = ran.out.trim().trim_start_matches("position = ").trim_end_matches(" deg");
    assert!((at.parse::<f64>().expect("a position") - 90.0).abs() < 1.0, "{}", ran.out);
    let empty = server.run(&["paths", "run", "1", "2"]);
    assert!(empty.code == 2 && empty.err.contains("path 2 is empty"), "{}", empty.err);
    // A chain that turns on is stopped after its time.
    let turning = std::fs::read_to_string(&file).expect("read").replace("single", "speed");
    std::fs::write(&file, turning).expect("written");
    let held = server.run(&["paths", "run", "1", "1", "--load", name, "--for", "1s"]);
    assert_eq!(held.code, 0, "{}", held.err);
    wait_until("the motor stands", || server.ok(&["get", "1", "motor speed"]).contains("= 0 rpm"));
    std::fs::remove_file(&file).expect("removed");
}
