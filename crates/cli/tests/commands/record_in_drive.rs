//! The recorder in the drive.

use crate::run;

use run::{Served, ok, polepair};

/// The columns of a CSV, without its head.
fn columns(csv: &str) -> Vec<Vec<f64>> {
    let rows = csv.lines().skip(1);
    let row = |row: &str| row.split(',').map(|cell| cell.parse().expect("a number")).collect();
    rows.map(row).collect()
}

#[test]
fn a_move_is_recorded_in_the_drives_loop() {
    for drive in
        ["sim:tml?time=virtual", "sim:tmlcan:5?time=virtual", "sim:technocan:5?time=virtual"]
    {
        let csv = ok(&[
            "record-in-drive",
            drive,
            "POSERR",
            "APOS",
            "ASPD",
            "--move",
            "0.5turn",
            "--for",
            "250ms",
            "--on",
            "ASPD > 20rpm",
            "--inferred",
        ]);
        let head = "time [s],position error [turn],actual position [turn],actual speed [rpm]";
        assert_eq!(csv.lines().next(), Some(head), "{drive}");
        let rows = columns(&csv);
        assert_eq!(rows.len(), 250, "{drive}");
        assert!(rows[0][3] > 20.0, "{drive}: {:?}", rows[0]);
        // All values of a point are of one instant: position and speed belong together.
        for pair in rows.windows(2).take(40) {
            let speed = (pair[1][2] - pair[0][2]) / 1e-3 * 60.0;
            assert!((speed - pair[1][3]).abs() < 40.0, "{drive}: {pair:?}");
        }
        assert!((rows[249][2] - 0.5).abs() < 0.02, "{drive}: {:?}", rows[249]);
    }
}

#[test]
fn what_does_not_fit_is_refused_before_anything_is_written() {
    let drive = "sim:tml?time=virtual";
    for (words, code, hint) in [
        (&["APOS"][..], "E222", "--inferred"),
        (&["APOS", "--inferred", "--for", "1s"][..], "E216", "--buffer"),
        (&["APOS", "--inferred", "--rate", "3kHz"][..], "E216", "0.1 ms (fast loop)"),
        (&["APOS", "--inferred", "--buffer", "0x8271-0x87FF"][..], "E216", "a multiple of 8"),
        (&["APOS", "--inferred", "--on", "fast"][..], "E217", "actual position > 1 turn"),
    ] {
        let ran = polepair(&[&["record-in-drive", drive], words].concat());
        assert_eq!(ran.code, 2, "{words:?}: {}", ran.err);
        assert!(ran.err.contains(code) && ran.err.contains(hint), "{words:?}: {}", ran.err);
    }
    let ran =
        polepair(&["record-in-drive", "sim:tmcl?time=virtual", "actual position", "--inferred"]);
    assert!(ran.code == 2 && ran.err.contains("E218"), "{}", ran.err);
    let more = ["--for", "1s", "--buffer", "0x8270-0xBFFF", "--inferred"];
    let csv = ok(&[&["record-in-drive", drive, "APOS"], &more[..]].concat());
    assert_eq!(csv.lines().count(), 1001);
}

#[test]
fn the_fast_loop_takes_ten_points_a_millisecond() {
    let json = ok(&[
        "record-in-drive",
        "sim:tml?time=virtual",
        "absolute time,@0x022C:u16",
        "--rate",
        "10kHz",
        "--for",
        "20ms",
        "--inferred",
        "--format",
        "jsonl",
    ]);
    let rows: Vec<serde_json::Value> =
        json.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(rows.len(), 200);
    let time = |row: &serde_json::Value| row["absolute time"].as_f64().expect("a number");
    let span = time(&rows[199]) - time(&rows[0]);
    assert!((0.018..=0.021).contains(&span), "{span}");
}

#[cfg(unix)]
#[test]
fn a_running_logger_is_left_alone() {
    let sim = Served::new("tml");
    // The head states that 60 000 points are to come, one each 0x7FFF loops.
    ok(&[
        "send",
        &sim.url,
        "VAR_U1 = 0x8270",
        "(VAR_U1+),dm = 60000",
        "(VAR_U1+),dm = 32767",
        "--arm",
    ]);
    ok(&["send", &sim.url, "LOG_PTR = 0x8270", "STARTLOG 1"]);
    let ran = polepair(&["record-in-drive", &sim.url, "APOS", "--inferred"]);
    assert_eq!(ran.code, 6, "{}", ran.err);
    assert!(ran.err.contains("error[E602]: axis 1: the drive's logger is running"), "{}", ran.err);
    ok(&["send", &sim.url, "STOPLOG"]);
    ok(&["record-in-drive", &sim.url, "APOS", "--for", "10ms", "--inferred"]);
    // A routine that calls itself for ever, where the buffer would be.
    let program = ["VAR_U1 = 0x8270", "(VAR_U1+),pm = 29696", "(VAR_U1),pm = 33392"];
    ok(&[&["send", &sim.url], &program[..], &["CALLS 0x8270", "--arm"]].concat());
    let ran = polepair(&["record-in-drive", &sim.url, "APOS", "--for", "10ms", "--inferred"]);
    assert_eq!(ran.code, 6, "{}", ran.err);
    assert!(ran.err.contains("a routine of its program runs"), "{}", ran.err);
    ok(&["program", "stop", &sim.url]);
    ok(&["record-in-drive", &sim.url, "APOS", "--for", "10ms", "--inferred"]);
    sim.end();
}
