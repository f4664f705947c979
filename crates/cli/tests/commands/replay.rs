//! `polepair replay`: what is sent, what is refused, what comes back.

use crate::run;
use polepair_test_support::wait_until;

use run::{ok, polepair};

/// A capture of this test run's own; its name.
fn written(name: &str, text: &str) -> String {
    let folder = std::env::temp_dir().join(format!("polepair-replay-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(name);
    std::fs::write(&path, text).expect("a file");
    path.display().to_string()
}

/// A host that reads a position, and the reply. The lines have no direction.
const READS: &str = "\
(1700000000.000000) can0 602#4064600000000000
(1700000000.001000) can0 582#4364600039300000
(1700000000.010000) can0 602#4041600000000000
(1700000000.011000) can0 582#4B41600037020000
";
/// The same, and it switches on.
const MOVES: &str = "\
(1700000000.000000) can0 602#4064600000000000
(1700000000.010000) can0 602#2B4060000F000000
";
/// The same, and it keeps its settings.
const KEEPS: &str = "\
(1700000000.000000) can0 602#4064600000000000
(1700000000.010000) can0 602#2310100173617665
";

#[test]
fn simulated_drives_answer_what_the_host_asked() {
    let capture = written("reads.log", READS);
    for how in [["--speed", "2"], ["--loop", "1"]] {
        let trace = written("answers.log", "");
        let order =
            ["replay", capture.as_str(), "sim:canopen:2", "--trace", trace.as_str(), "--force"];
        let ran = polepair(&[&order[..], &how].concat());
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(
            ran.err.contains("2 frames of 0.0 s for sim:canopen:2: 2 ask or stop"),
            "{}",
            ran.err
        );
        assert!(ran.err.contains("2 frames sent") && ran.err.contains("late by"), "{}", ran.err);
        let explained = ok(&["decode", &trace, "--as", "canopen", "--format", "jsonl"]);
        let count = |part: &str| explained.lines().filter(|line| line.contains(part)).count();
        let (requested, answered) =
            (count("\"kind\":\"SDO read\""), count("\"kind\":\"SDO value\""));
        assert_eq!((requested, answered), (2, 2), "{explained}");
        assert_eq!(count("\"direction\":\"tx\""), 2, "{explained}");
    }
}

#[test]
fn motion_and_permanent_memory_need_leave() {
    let (moves, stores) = (written("moves.log", MOVES), written("keeps.log", KEEPS));
    let unarmed = polepair(&["replay", &moves, "sim:canopen:2"]);
    assert_eq!(unarmed.code, 2);
    assert!(unarmed.err.contains("error[E219]: 1 frame may move motors"), "{}", unarmed.err);
    assert!(
        unarmed.err.contains("controlword") && unarmed.err.contains("--arm"),
        "{}",
        unarmed.err
    );
    let unstored = polepair(&["replay", &stores, "sim:canopen:2", "--arm"]);
    assert_eq!(unstored.code, 2);
    assert!(unstored.err.contains("error[E251]") && unstored.err.contains("--store"));
    assert_eq!(polepair(&["replay", &stores, "sim:canopen:2", "--store"]).code, 0);
    // What was set in motion is stopped at the end.
    let armed = polepair(&["replay", &moves, "sim:canopen:2", "--arm"]);
    assert!(armed.code == 0 && armed.err.contains("is stopped"), "{}", armed.err);
    let left = polepair(&["replay", &moves, "sim:canopen:2", "--arm", "--detach"]);
    assert!(left.code == 0 && !left.err.contains("is stopped"), "{}", left.err);
}

#[test]
fn a_rehearsal_shows_what_would_be_sent() {
    let capture = written("shown.log", MOVES);
    let ran = polepair(&["replay", &capture, "canopen+socketcan://can9", "--dry-run"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let words: Vec<_> = ran.out.lines().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(words, ["asks", "moves"], "{}", ran.out);
    assert!(ran.err.contains("none of this was sent"), "{}", ran.err);
}

/// A value that the usual table calls harmless may move another drive: axis parameter 4 is its top speed.
#[test]
fn a_table_vouches_for_the_drive_that_was_named_alone() {
    let capture = written("sets.log", "(1700000000.000000) ttyUSB0 > 01 05 04 00 00 00 00 64 6E\n");
    let word = |more: &[&str]| {
        let order = ["replay", capture.as_str(), "sim:tmcl", "--dry-run"];
        ok(&[&order, more].concat()).split(' ').next().map(str::to_owned)
    };
    assert_eq!(word(&[]).as_deref(), Some("?"));
    assert_eq!(word(&["--profile", "tmcm-171"]).as_deref(), Some("sets"));
}

#[test]
fn simulated_drives_are_printed_with_their_ports() {
    let capture = written("both.log", READS);
    let rows = |more: &[&str]| {
        let order = ["replay", capture.as_str(), "canopen+socketcan://can9", "--dry-run"];
        polepair(&[&order, more].concat()).out.lines().count()
    };
    assert_eq!(
        (rows(&[]), rows(&["--direction", "rx"]), rows(&["--direction", "both"])),
        (2, 2, 4)
    );
    assert_eq!((rows(&["--filter", "time < 5ms"]), rows(&["--link", "can0"])), (1, 2));
    let code = |more: &[&str]| polepair(&[&["replay", capture.as_str()], more].concat()).code;
    assert_eq!(code(&["sim:canopen:2", "--link", "can7"]), 2, "no such link");
    assert_eq!(code(&["sim:canopen:2", "sim:tmcl"]), 2, "which link is for which");
    assert_eq!(code(&["sim:tmcl"]), 2, "a bus is not a serial line");
    assert_eq!(code(&["sim:canopen:2", "--speed", "0"]), 2);
    assert_eq!(code(&[]), 2, "nowhere to play");
    assert_eq!(code(&["--to", "sim:canopen:2"]), 0);
}

/// Half-duplex: each request goes out when the one before is answered.
#[test]
fn as_fast_as_the_drive_answers_and_again_and_again() {
    let line = |ms: u32| format!("(1700000000.{ms:03}000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n");
    let capture = written("fast.log", &(0..10).map(|n| line(n * 90)).collect::<String>());
    let trace = written("fast-answers.log", "");
    let order =
        ["replay", &capture, "sim:tmcl", "--fast", "--loop", "3", "--trace", &trace, "--force"];
    let ran = polepair(&order);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("30 frames sent"), "{}", ran.err);
    let explained = ok(&["decode", &trace, "--as", "tmcl", "--format", "jsonl"]);
    let answers = explained.lines().filter(|line| line.contains("\"direction\":\"rx\"")).count();
    assert_eq!(answers, 30, "{explained}");
}

#[test]
fn remote_requests_ask_for_as_many_bytes_as_they_did() {
    run::expect_silence();
    let text = "(1700000000.000000) can0 702#R1\n(1700000000.010000) can0 00000123#R8\n\
        (1700000000.020000) can0 123#R\n";
    let capture = written("remote.log", text);
    let lines = ok(&["decode", &capture, "--as", "canopen", "--format", "jsonl"]);
    for (name, text) in [("remote-again.log", text), ("remote.jsonl", &lines)] {
        let (capture, trace) = (written(name, text), written("remote-trace.log", ""));
        let both = ["--direction", "both", "--arm", "--trace", &trace, "--force"];
        let ran = polepair(&[&["replay", &capture, "sim:canopen:2"][..], &both].concat());
        assert_eq!(ran.code, 0, "{}", ran.err);
        let sent = std::fs::read_to_string(&trace).expect("a trace");
        for frame in ["702#R1", "00000123#R8", "123#R "] {
            assert!(sent.contains(&format!(" {frame}")), "{name}: {frame} is not in {sent}");
        }
    }
}

/// Served drives of every kind of end that answer what is played to them.
#[cfg(unix)]
#[test]
fn onto_each_kind_of_link_a_capture_is_played() {
    let line = |ms: u32| format!("(1700000000.{ms:03}000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n");
    let bytes = written("line.log", &(0..10).map(|n| line(n * 90)).collect::<String>());
    let frames = written("bus.log", READS);
    let port = std::env::temp_dir().join(format!("polepair-replay-pty-{}", std::process::id()));
    let port = port.to_str().expect("text");
    let ends: [(&[&str], _, _, _); 5] = [
        (&["tmcl:1", "--pty", port], &bytes, "tmcl", 10),
        (&["tmcl:1", "--tcp", "127.0.0.1:0"], &bytes, "tmcl", 10),
        (&["canopen:2", "--pty", port], &frames, "canopen", 2),
        (&["canopen:2", "--tcp", "127.0.0.1:0"], &frames, "canopen", 2),
        (&["canopen:2", "--socketcand", "127.0.0.1:0"], &frames, "canopen", 2),
    ];
    for (end, capture, protocol, requested) in ends {
        let drive = run::Served::with(end);
        let trace = written("ends-trace.log", "");
        let ran =
            polepair(&["replay", capture, drive.link(), "--fast", "--trace", &trace, "--force"]);
        assert_eq!(ran.code, 0, "{end:?}: {}", ran.err);
        assert!(ran.err.contains(&format!("{requested} frames sent")), "{end:?}: {}", ran.err);
        let explained = ok(&["decode", &trace, "--as", protocol, "--format", "jsonl"]);
        let kinds = ["\"kind\":\"SDO value\"", "\"kind\":\"GAP\""];
        let answers = explained.lines().filter(|line| line.contains("\"direction\":\"rx\""));
        let answers = answers.filter(|line| kinds.iter().any(|kind| line.contains(kind)));
        assert_eq!(answers.count(), requested, "{end:?}: {explained}");
        drive.end();
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_replay_stops_what_it_moved() {
    let later = "(1700000060.000000) can0 602#4064600000000000\n";
    let capture = written("long.log", &format!("{MOVES}{later}"));
    let trace = written("long-answers.log", "");
    let drive = run::Served::with(&["canopen:2", "--udp", "239.74.163.21:43122"]);
    let output = format!(
        "{capture}: 3 frames of 60.0 s for {}: 2 ask or stop, 1 may move motors",
        drive.link()
    );
    let order = ["replay", &capture, drive.link(), "--arm", "--trace", &trace, "--force"];
    let held = run::Held::new(&order, &output);
    let is_sent =
        || std::fs::read_to_string(&trace).is_ok_and(|text| text.contains("602#2B4060000F"));
    wait_until("the motion is sent", is_sent);
    let ran = held.interrupt();
    assert_eq!(ran.code, 130, "{}", ran.err);
    assert!(ran.err.contains("is stopped"), "{}", ran.err);
    drive.end();
}
