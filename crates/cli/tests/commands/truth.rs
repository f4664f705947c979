//! Printed results agree with the frames on the wire.
#![cfg(unix)]

use crate::run;

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::PathBuf;
use std::thread;

use run::{Held, Served, ok, polepair, signal};

const HOLDING: &str = "running; Ctrl-C stops it";
const TURNS: &str = "The motor may still turn: cut its supply.";

fn file(name: &str, text: &str) -> PathBuf {
    let name = format!("polepair-truth-{}-{name}", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, text).expect("a file");
    path
}

/// A drive behind a wire that is cut when the host has sent this many bytes.
fn cut_after(served: &Served, bytes: usize) -> String {
    let to = served.link().rsplit("//").next().expect("an address").to_owned();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    thread::spawn(move || {
        let (mut host, _) = listener.accept().expect("a host");
        drop(listener);
        let mut drive = TcpStream::connect(to).expect("the drive");
        let (mut answers, mut back) = (drive.try_clone().unwrap(), host.try_clone().unwrap());
        thread::spawn(move || {
            let mut buffer = [0; 256];
            while let Ok(len) = answers.read(&mut buffer)
                && len > 0
                && back.write_all(&buffer[..len]).is_ok()
            {}
        });
        let (mut buffer, mut passed) = ([0; 256], 0);
        while let Ok(len) = host.read(&mut buffer)
            && len > 0
        {
            passed += len;
            if passed > bytes {
                break;
            }
            drive.write_all(&buffer[..len]).expect("the drive takes it");
        }
        let _ = host.shutdown(Shutdown::Both);
        let _ = drive.shutdown(Shutdown::Both);
    });
    format!("tmcl+tcp://{address}")
}

#[test]
fn a_path_that_begins_elsewhere_powers_nothing() {
    // The nearest ones are within what the drive could do in one cycle.
    for (degrees, turns) in [("36000", "100"), ("90", "0.25"), ("45", "0.125"), ("3.6", "0.01")] {
        powers_nothing(degrees, turns);
    }
}

fn powers_nothing(degrees: &str, turns: &str) {
    let rows = ["0", "0.1", "0.2"].map(|time| format!("{time}, {degrees}, 0\n")).concat();
    let path = file("away.csv", &format!("time s, 1 deg, 2 deg\n{rows}"));
    let trace = file("away.log", "");
    let (path, trace) = (path.display().to_string(), trace.display().to_string());
    let ran = polepair(&["stream", "sim:cia402:1,2", &path, "--trace", &trace, "--force"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    let says = format!("error[E222]: axis 1 is at 0 turn, but the path begins at {turns} turn.");
    assert!(ran.err.contains(&says), "{}", ran.err);
    assert!(!ran.err.contains("Nothing was sent"), "{}", ran.err);
    assert!(ran.err.contains("frames were sent before it."), "{}", ran.err);
    let frames = std::fs::read_to_string(&trace).expect("a trace");
    // An SDO that writes two bytes to 6040h.
    assert!(frames.contains("#40") && !frames.contains("#2B4060"), "{frames}");
}

#[test]
fn points_that_begin_elsewhere_power_nothing() {
    let path = file("points.csv", "6.2, 0.5, 0.01\n6.3, 0.5, 0.2\n6.4, 0, 0.2\n");
    let path = path.display().to_string();
    let ran = polepair(&["stream", "sim:technosoft-f514l", &path, "-v"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    assert!(ran.err.contains("is at 0 turn, but the path begins at 0.987 turn."), "{}", ran.err);
    assert!(!ran.err.contains("AXISON"), "{}", ran.err);
}

#[test]
fn a_refusal_before_the_link_is_open_states_that_nothing_was_sent() {
    let ran = polepair(&["spin", "sim:tmcl?no=1", "1rpm"]);
    assert!(ran.code == 2 && ran.err.contains("Nothing was sent."), "{}", ran.err);
    let ran = polepair(&["spin", "sim:tmcl", "1e6rpm"]);
    assert!(ran.code == 2 && ran.err.contains("It was not sent. "), "{}", ran.err);
}

#[test]
fn a_scan_whose_wire_dies_says_who_answered_and_how_many_were_not_asked() {
    run::expect_silence();
    let served = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let url = cut_after(&served, 400);
    let ran = polepair(&["scan", &url, "--ids", "1-64"]);
    assert_eq!(ran.code, 3, "{}{}", ran.out, ran.err);
    assert!(ran.err.contains("error[E313]"), "{}", ran.err);
    assert!(ran.out.contains("tmcm"), "who answered before is shown: {}", ran.out);
    assert!(ran.err.contains("Drives that replied: 1; addresses not tried: "), "{}", ran.err);
}

#[test]
fn an_adapter_unplugged_while_a_motor_turns() {
    run::expect_silence();
    let served = Served::new("tmcl:1");
    let held = Held::new(&["spin", &served.url, "60rpm"], HOLDING);
    signal("KILL", served.id());
    let ran = held.ended();
    assert_eq!(ran.code, 3, "{}", ran.err);
    assert!(ran.err.contains(TURNS), "{}", ran.err);
    assert!(!ran.err.contains("may have been executed"), "no question was: {}", ran.err);
}

#[test]
fn a_wire_cut_while_a_motor_turns() {
    run::expect_silence();
    let served = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let url = cut_after(&served, 1500);
    let ran = polepair(&["spin", &format!("{url}#1"), "60rpm", "--for", "60s"]);
    assert_eq!(ran.code, 3, "{}", ran.err);
    assert!(ran.err.contains("error[E313]") && ran.err.contains(TURNS), "{}", ran.err);
}

#[test]
fn a_motion_that_was_stopped_in_time_does_not_turn() {
    let ran = polepair(&["move", "sim:tmcl", "1000turn", "--timeout", "300ms"]);
    assert_eq!(ran.code, 1, "{}", ran.err);
    assert!(!ran.err.contains(TURNS), "{}", ran.err);
}

#[test]
fn axes_that_answer_are_shown_though_one_is_dead() {
    run::expect_silence();
    let served = Served::with(&["tmcl:1,3", "--tcp", "127.0.0.1:0"]);
    let ran = polepair(&["info", &format!("{}#1,7,3", served.link())]);
    assert_eq!(ran.code, 7, "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("axis 1:") && ran.out.contains("axis 3:"), "{}", ran.out);
    assert!(ran.err.contains("axis 7 does not answer"), "{}", ran.err);
    assert!(ran.err.contains("error[E704]: 1 of 3 axes could not be read."), "{}", ran.err);
}

/// Profile of a drive without units.
const UNITLESS: &str = "\
name = \"unitless\"
protocol = \"tmcl\"
title = \"numbers without a unit\"
source = \"a test\"
axis = \"rotary\"

[[parameter]]
name = \"target position\"
space = \"axis\"
index = 0
moves = true
section = \"a test\"

[plans.move-to]
source = \"a test\"
steps = [\"write target position = {target}\"]

[plans.stop]
source = \"a test\"
steps = [\"send 3 0 0\"]
";

#[test]
fn a_number_without_a_scale_moves_nothing() {
    let profile = file("unitless.toml", UNITLESS).display().to_string();
    let on = |words: &[&str]| {
        let url = "sim:tmcl?profile=unitless";
        polepair(&[&["move", url], words, &["--profile", &profile]].concat())
    };
    for number in ["4096", "90deg"] {
        let ran = on(&[number]);
        assert_eq!(ran.code, 2, "{}", ran.err);
        assert!(ran.err.contains("error[E217]") && ran.err.contains("--raw"), "{}", ran.err);
    }
    let ran = on(&["4096", "--raw", "--dry-run"]);
    assert!(ran.code == 0 && ran.out.contains("00 00 10 00"), "{}{}", ran.out, ran.err);
    let known = ok(&["spin", "sim:tmcl", "100", "--dry-run"]);
    assert_eq!(known, ok(&["spin", "sim:tmcl", "100rpm", "--dry-run"]), "its profile says rpm");
}

/// A fault word is its bits, whatever the type of the parameter that has them: the highest one too.
#[cfg(unix)]
#[test]
fn a_fault_in_the_highest_bit_is_a_fault() {
    let profile = std::env::temp_dir().join(format!("polepair-fault-{}.toml", std::process::id()));
    let path = profile.to_str().expect("text");
    for (code, word, shown) in [
        ("0x80000000", i32::MIN, "OVERHEAT"),
        ("0x80000000", -1, "OVERHEAT"),
        ("5", 5, "OVERHEAT"),
        ("0x80000000", 0x4000_0000, "code 0x40000000"),
    ] {
        let text = format!(
            "name = \"mine\"\nextends = \"tmcm-170\"\n[signals]\nfault = \"target position\"\n\
             [[fault]]\ncode = {code}\nname = \"OVERHEAT\"\ntext = \"too hot\"\n"
        );
        std::fs::write(&profile, text).expect("a profile");
        let run = |verb: &str| {
            let (url, module) = crate::stop::module(move |opcode, _| match opcode {
                136 => Some((100, 0x00AA_0112)),
                // Every axis parameter has it.
                6 => Some((100, word)),
                _ => Some((100, 0)),
            });
            let ran = polepair(&[verb, &url.replace('#', "?profile=mine#"), "--profile", path]);
            module.join().expect("a module");
            ran
        };
        for verb in ["info", "doctor"] {
            let ran = run(verb);
            assert!(ran.out.contains(shown), "{verb} {word}: {}{}", ran.out, ran.err);
            assert!(!ran.out.contains("no faults"), "{verb} {word}: {}", ran.out);
        }
    }
    std::fs::remove_file(&profile).expect("a profile");
}
