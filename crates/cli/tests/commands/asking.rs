//! Questions to a capture of a machine that misbehaved: filter, summary, diff, plot.

use crate::run;

use run::{polepair, polepair_with};
use serde_json::Value;

const CLEAN: &str = "(1700000000.000000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n\
    (1700000000.010000) ttyUSB0 < 02 01 64 06 00 00 02 C7 36\n";

/// The capture that the guide is about.
fn feeder() -> String {
    format!("{}/../../docs/examples/feeder.log", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_filter_shows_what_it_wants_and_times_count_from_the_begin() {
    let capture = feeder();
    let all = polepair(&["decode", &capture, "--as", "canopen", "--notices", "none"]);
    let some = polepair(&[
        "decode",
        &capture,
        "--as",
        "canopen",
        "--notices",
        "none",
        "--filter",
        "id = 0x082",
    ]);
    assert_eq!((all.code, some.code), (0, 0), "{}", some.err);
    assert_eq!(some.out.lines().count(), 1, "{}", some.out);
    assert!(all.out.contains(&some.out), "the same line, at the same time: {}", some.out);
    let wrong = polepair(&["decode", &capture, "--filter", "ok and axs = 2"]);
    assert_eq!(wrong.code, 2);
    assert!(wrong.err.contains("\n  ok and axs = 2\n         ^^^ "), "{}", wrong.err);
    assert!(wrong.err.contains("try: axis (the nearest)"), "{}", wrong.err);
}

#[test]
fn a_summary_names_the_fault_and_tells_it_by_its_exit_code() {
    let ran = polepair(&["summary", &feeder(), "--as", "canopen", "--format", "json"]);
    assert_eq!(ran.code, 1, "{}", ran.err);
    let value: Value = serde_json::from_str(&ran.out).expect("JSON");
    assert_eq!(value["frames"], 134);
    let faults = value["faults"].as_array().expect("a list");
    assert!(faults.iter().any(|fault| fault["axis"] == 2), "{faults:?}");
    let text = polepair(&["summary", &feeder(), "--as", "canopen"]);
    assert!(text.out.contains("oddest moments"), "{}", text.out);
}

#[test]
fn a_clean_capture_has_a_clean_summary() {
    let ran = polepair_with(&["summary", "-", "--as", "tmcl"], CLEAN);
    assert_eq!(ran.code, 0, "{}{}", ran.out, ran.err);
    assert!(ran.out.ends_with("nothing odd\n"), "{}", ran.out);
    assert!(ran.out.contains("10.0 ms"), "{}", ran.out);
    let wrong = polepair_with(&["summary", "-", "--bitrate", "fast"], CLEAN);
    assert_eq!(wrong.code, 2, "{}", wrong.err);
}

#[test]
fn a_capture_does_not_differ_from_itself() {
    let capture = feeder();
    let same = polepair(&["diff", &capture, &capture, "--as", "canopen"]);
    assert_eq!((same.code, same.out.as_str()), (0, ""), "{}", same.err);
    let clean = std::env::temp_dir().join(format!("pp-clean-{}.log", std::process::id()));
    std::fs::write(&clean, CLEAN).expect("written");
    let other = polepair(&["diff", &capture, clean.to_str().expect("UTF-8"), "--format", "jsonl"]);
    // What is left over lies in the system's temporary folder.
    let _ = std::fs::remove_file(&clean);
    assert_eq!(other.code, 1, "{}", other.err);
    let first: Value =
        serde_json::from_str(other.out.lines().next().expect("a line")).expect("JSON");
    assert_eq!(first["kind"], "axis");
}

#[test]
fn a_signal_is_drawn() {
    let (capture, signal) = (feeder(), "2/*");
    let drawn = polepair(&["decode", &capture, "--as", "canopen", "--plot", signal]);
    assert_eq!(drawn.code, 0, "{}", drawn.err);
    assert!(drawn.out.contains("time [s]"), "{}", drawn.out);
    let none = polepair(&["decode", &capture, "--as", "canopen", "--plot", "9/Temp/Motor"]);
    assert_eq!(none.code, 1, "{}", none.err);
    assert!(none.err.contains("E113") && none.err.contains("It has 1/"), "{}", none.err);
}
