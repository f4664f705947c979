//! `polepair record`, and captures as tests: `decode --expect`.

use crate::run;
use polepair_test_support::wait_until;

use std::path::PathBuf;

use run::{ok, polepair};
use serde_json::{Value, json};

/// A file of this test run's own.
fn scratch(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("polepair-record-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name)
}

/// Writes a file with this text, and returns its name.
fn written(name: &str, text: &str) -> String {
    let path = scratch(name);
    std::fs::write(&path, text).expect("a file");
    path.display().to_string()
}

#[cfg(unix)]
#[test]
fn frames_are_stored_as_they_pass_and_complete_at_the_end() {
    let drive = run::Served::with(&["canopen:2", "--udp", "239.74.163.20:43120"]);
    for name in ["bus.log", "bus.pcapng.zst", "bus.blf"] {
        let file = scratch(name).display().to_string();
        let line = format!("recording to {file}; Ctrl-C ends");
        let recorder = run::Held::new(&["record", drive.link(), "-o", &file, "-v"], &line);
        let decode = ["decode", file.as_str(), "--as", "canopen", "--format", "jsonl"];
        // The file is brought up to date while it grows: it is waited for by reading it.
        wait_until("an answer is in the file", || {
            ok(&["get", &drive.url, "velocity demand"]);
            polepair(&decode).out.contains("\"kind\":\"SDO value\"")
        });
        let ran = recorder.interrupt();
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(ran.err.contains(" 0 dropped"), "{}", ran.err);
        assert!(ran.out.contains("read 0x606B:0"), "shown as decode does: {}", ran.out);
        let whole = ok(&decode);
        assert!(whole.contains("\"kind\":\"SDO read\"") && whole.contains("\"direction\":"));
    }
    drive.end();
}

#[cfg(unix)]
#[test]
fn a_suspended_pager_blocks_no_recording() {
    let drive = run::Served::with(&["canopen:2", "--udp", "239.74.163.20:43121"]);
    let file = scratch("paged.log").display().to_string();
    let recorder = run::command(&["record", drive.link(), "-o", &file, "-v"]).spawn();
    let recorder = recorder.expect("starts");
    // Writes more lines than a pipe holds (64 KiB) without a reader.
    let is_stored = || std::fs::read_to_string(&file).map_or(0, |text| text.lines().count());
    wait_until("3000 frames are stored", || {
        ok(&["get", &drive.url, "velocity demand"]);
        is_stored() >= 3000
    });
    run::signal("INT", recorder.id());
    let output = run::ran(recorder.wait_with_output().expect("ends"));
    assert_eq!(output.code, 0, "{}", output.err);
    assert!(output.err.contains(" 0 dropped") && output.out.lines().count() >= 3000);
    drive.end();
}

#[test]
fn a_recording_that_is_impossible_is_refused_before_anything_is_opened() {
    let code = |arguments: &[&str]| polepair(&[&["record", "sim:tmcl"], arguments].concat()).code;
    assert_eq!(code(&[]), 2, "nowhere to put it");
    assert_eq!(code(&["-o", "bus.dat"]), 2, "no format");
    assert_eq!(code(&["-o", "bus.log", "--rotate", "5 rpm"]), 2);
    assert_eq!(code(&["-o", "bus.log", "-v", "--as", "tmlc"]), 2);
}

const CAPTURE: &str = "\
(1700000000.000500) ttyUSB0 > 01 06 01 00 00 00 00 00 08
(1700000000.020500) ttyUSB0 < 02 01 64 06 00 00 02 c7 36
";

/// Output of `decode` for the capture, one value a frame.
fn explained(capture: &str) -> Vec<Value> {
    let lines = ok(&["decode", capture, "--as", "tmcl", "--format", "jsonl"]);
    lines.lines().map(|line| serde_json::from_str(line).expect(line)).collect()
}

#[test]
fn a_capture_is_a_test() {
    let capture = written("good.log", CAPTURE);
    let frames = explained(&capture);
    let test = |name: &str, lines: &[Value], more: &[&str]| {
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        let expected = written(name, &text);
        let order = ["decode", capture.as_str(), "--as", "tmcl", "--expect", expected.as_str()];
        polepair(&[&order, more].concat())
    };
    let whole = test("whole.jsonl", &frames, &["--within", "0s"]);
    assert_eq!((whole.code, whole.out.as_str()), (0, ""), "{}", whole.err);
    // A part of each, a year later, 3 ms apart from what it was.
    let part = |frame: &Value, late: f64| {
        let time = frame["time"].as_f64().expect("a time") + 3e7 + late;
        json!({ "bytes": frame["bytes"], "time": time })
    };
    let parts = [part(&frames[0], 0.0), part(&frames[1], 0.003)];
    assert_eq!(test("parts.jsonl", &parts, &["--within", "5ms"]).code, 0);
    assert_eq!(test("parts.jsonl", &parts, &[]).code, 0, "times do not matter unless told");
    let off = test("parts.jsonl", &parts, &["--within", "1ms"]);
    assert_eq!(off.code, 1);
    assert!(off.out.starts_with("! line 2: time is off by -0.003"), "{}", off.out);
    // One too many, one too few, one that differs.
    let few = test("few.jsonl", &frames[1..], &[]);
    assert_eq!((few.code, few.out.lines().count()), (1, 1), "{}", few.out);
    assert!(few.out.starts_with("+ frame "), "{}", few.out);
    let many =
        test("many.jsonl", &[frames[0].clone(), json!({"ok": false}), frames[1].clone()], &[]);
    assert_eq!((many.code, many.out.trim()), (1, "- line 2: {\"ok\":false}"));
    let mut other = frames.clone();
    other[1]["ok"] = json!(false);
    let other = test("other.jsonl", &other, &["--filter", "ok or not ok"]);
    assert!(other.out.starts_with("! line 2: ok is true, not false\n- line 2: {"), "{}", other.out);
    assert_eq!(polepair(&["decode", &capture, "--expect", &capture]).code, 2, "no JSON");
}
