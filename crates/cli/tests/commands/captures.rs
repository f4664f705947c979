//! Captures and logs as users have them: each input with the right result.

use std::fmt::Write as _;

use crate::run::{polepair, polepair_with};

/// The output of a verb for a capture on stdin.
fn read(arguments: &[&str], capture: &str) -> (i32, String, String) {
    let ran = polepair_with(arguments, capture);
    (ran.code, ran.out, ran.err)
}

/// The decoded text of a capture.
fn decoded(capture: &str, arguments: &[&str]) -> String {
    let (code, out, err) = read(&[&["decode", "-"], arguments].concat(), capture);
    assert_eq!(code, 0, "{capture}\n{err}");
    out
}

/// C1: an adapter that echoes, and a logger that sees requests and replies of another host.
#[test]
fn an_echo_and_the_requests_of_others_are_requests() {
    let echoed = "(1.0) p > 01 04 00 00 00 02 71 CB\n(1.002) p < 01 04 00 00 00 02 71 CB\n\
                  (1.01) p < 01 04 04 00 01 00 02 2B 85\n";
    for arguments in [&["--as", "modbus-rtu"][..], &[]] {
        let out = decoded(echoed, arguments);
        assert!(out.contains("echo: read input register 0x0000, 2 registers"), "{out}");
        assert!(out.contains("input register 0x0000 = 1, input register 0x0001 = 2"), "{out}");
        assert!(!out.contains("stray") && !out.contains('!'), "{out}");
    }
    let (_, heard) = echoed.split_once('\n').expect("three lines");
    let out = decoded(heard, &["--as", "modbus-rtu"]);
    assert!(out.contains("> modbus-rtu  01 04 00 00 00 02 71 CB"), "{out}");
    assert!(out.contains("input register 0x0001 = 2  (8.00 ms)"), "{out}");
    assert!(!out.contains("echo") && !out.contains('!'), "{out}");
}

/// A pipe by its path, as `<(zcat capture.gz)` in a shell, is read once.
#[cfg(unix)]
#[test]
fn a_pipe_is_read_as_stdin_is() {
    let capture = "(1.0) can0 601#4064600000000000\n(1.001) can0 581#4364600010000000\n\
                   (2.0) can0 701#05\n";
    for verb in ["decode", "summary"] {
        for arguments in [&["--as", "canopen"][..], &[]] {
            let by_path = read(&[&[verb, "/dev/stdin"], arguments].concat(), capture);
            assert_eq!(by_path, read(&[&[verb, "-"], arguments].concat(), capture));
            assert!(by_path.1.contains("can0") && by_path.0 == 0, "{by_path:?}");
        }
    }
}

/// C4: times that are differences, and times that go back.
#[test]
fn differences_of_times_are_added_up() {
    let capture = " (000.000000)  can0  701   [1]  05\n (000.095000)  can0  701   [1]  05\n \
                   (000.005000)  can0  701   [1]  05\n";
    let (code, out, err) = read(&["decode", "-", "--as", "canopen"], capture);
    assert_eq!(code, 0, "{err}");
    assert!(out.lines().last().is_some_and(|line| line.starts_with("   0.100000")), "{out}");
    assert!(err.contains("the times are differences to the line before"), "{err}");
    let absolute = ["decode", "-", "--as", "canopen", "--times", "absolute"];
    let (_, out, err) = read(&absolute, capture);
    assert!(out.lines().last().is_some_and(|line| line.starts_with("   0.005000")), "{out}");
    assert!(err.contains("the time goes back from 0.095 s to 0.005 s"), "{err}");
    let (_, summary, _) = read(&["summary", "-", "--as", "canopen"], capture);
    assert!(summary.contains("nothing odd"), "{summary}");
    let (_, converted, err) = read(&["convert", "-", "-", "--to", "log"], capture);
    assert!(converted.ends_with("(0000000000.100000) can0 701#05\n"), "{converted}");
    assert!(err.contains("differences"), "{err}");
}

/// C5, C6: what other programs print.
#[test]
fn lines_of_other_programs_are_read() {
    for (capture, protocol, meaning) in [
        ("  can0  701   [1]  00000101\n", "canopen", "heartbeat operational"),
        ("  can0  701   {1}  05\n", "canopen", "heartbeat operational"),
        ("\u{1B}[31m  can0  \u{1B}[1m701   [1]  05\u{1B}[0m\n", "canopen", "heartbeat operational"),
        (" (2026-11-27 12:34:56.123456)  can0  701   [1]  05\n", "canopen", "heartbeat"),
        (
            "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n\
             1000,00000601,false,Tx,0,8,40,41,60,00,00,00,00,00,\n",
            "canopen",
            "read 0x6041:0 (statusword)",
        ),
        (
            "***BUSMASTER Ver 3.2.2***\n12:34:56:7890 Rx 1 0x601 s 8 40 41 60 00 00 00 00 00\n",
            "canopen",
            "read 0x6041:0 (statusword)",
        ),
        ("1542473901.020305 1T11 601 40 41 60 00 00 00 00 00\n", "canopen", "read 0x6041:0"),
        ("60C  40 02 65 00 00 00 00 00\n", "canopen", "read 0x6502:0 (supported modes)"),
        ("81#1023010000000000\n", "canopen", "0x2310"),
        ("SEND: 0x1 0x3 0x0 0x33 0x0 0x1 0x74 0x5\n", "modbus-rtu", "read register 0x0033"),
        ("[01][03][00][33][00][01][74][05]\n", "modbus-rtu", "read register 0x0033"),
        ("<01><03><02><00><05><78><47>\n", "modbus-rtu", "values 5"),
        ("Tx: 01 03 00 33 00 01 74 05\n", "modbus-rtu", "read register 0x0033"),
        ("0x01 0x03 0x00 0x33 0x00 0x01 0x74 0x05\n", "modbus-rtu", "read register 0x0033"),
        (
            "MinimalModbus debug mode. Will write to instrument (expecting 7 bytes back): 01 03 00 33 \
             00 01 74 05 (8 bytes)\n",
            "modbus-rtu",
            "read register 0x0033",
        ),
        ("TMCL_Request: 01,06,01,00,00000000,08\n", "tmcl", "GAP 1, 0"),
        (
            "Time [s],Value,Parity Error,Framing Error\n0.0001,0x01,,\n0.0002,0x06,,\n0.0003,0x01,,\n\
             0.0004,0x00,,\n0.0005,0x00,,\n0.0006,0x00,,\n0.0007,0x00,,\n0.0008,0x00,,\n0.0009,0x08,,\n",
            "tmcl",
            "GAP 1, 0",
        ),
    ] {
        let out = decoded(capture, &["--as", protocol]);
        assert!(out.contains(meaning), "{capture}\n{out}");
        assert!(!out.contains("stray") && !out.contains("length:"), "{capture}\n{out}");
    }
}

/// C6: what is recognised and not read is named, with a way out.
#[test]
fn files_of_other_kinds_are_named() {
    for (head, name, hint) in [
        ("MDF     4.10", "this is an MDF file (MF4)", "asammdf"),
        ("PK\u{3}\u{4}rest", "this is a zip archive", "unpack it"),
    ] {
        let (code, out, err) = read(&["decode", "-"], head);
        assert_eq!((code, &*out), (5, ""), "{err}");
        assert!(err.contains("E510") && err.contains(name) && err.contains(hint), "{err}");
    }
    let (code, _, err) = read(&["decode", "-"], "a letter\nto nobody\n");
    assert_eq!(code, 5, "{err}");
    assert!(err.contains("skipped lines of text: 2") && err.contains("not a capture"), "{err}");
}

/// C7: a passive logger receives everything, and formats without an unknown direction write so.
#[test]
fn a_passive_loggers_capture_is_replayed() {
    let folder = std::env::temp_dir().join(format!("polepair-logger-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (log, asc) = (folder.join("bus.log"), folder.join("bus.asc"));
    let lines = "(1.0) can0 601#4041600000000000 R\n(1.001) can0 581#4B41600037020000 R\n";
    std::fs::write(&log, lines).expect("written");
    let (log, asc) = (log.to_str().expect("text"), asc.to_str().expect("text"));
    assert_eq!(polepair(&["convert", log, asc]).code, 0);
    for file in [log, asc] {
        let out = decoded(&std::fs::read_to_string(file).expect("read"), &["--as", "canopen"]);
        assert!(out.contains("read 0x6041:0 (statusword)"), "{out}");
        assert!(out.contains("operation enabled"), "{out}");
        let dry = polepair(&["replay", file, "sim:syntron-ts-canopen", "--dry-run"]);
        assert_eq!(dry.code, 0, "{}", dry.err);
        assert!(dry.out.contains("601#40 41 60 00"), "{}", dry.out);
        assert!(dry.err.contains("1 frame not sent: from drives"), "{}", dry.err);
    }
    std::fs::remove_dir_all(&folder).expect("removed");
}

/// C8, C9 with BLF are read in the unit tests of the readers.
#[test]
fn states_of_a_controller_are_shown_and_kept() {
    let capture = ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n\
                   \x20 1 10.0 DT 1 0701 Rx - 1 05\n\
                   \x20 2 20.0 ST 1 - Rx - 4 00 00 00 10\n";
    let out = decoded(capture, &["--as", "canopen"]);
    assert!(out.contains("bus-off"), "{out}");
    let (_, converted, _) = read(&["convert", "-", "-", "--to", "log"], capture);
    assert!(converted.contains("20000040#"), "{converted}");
    let asc = "date Mon Jan 1 00:00:01 1970\nbase hex  timestamps absolute\n\
               \x20 0.010000 CAN 1 Status:chip status bus off\n\
               \x20 0.020000 1  Statistic: D 1 R 1 XD 0 XR 0 E 0 O 0 B 0.02%\n";
    let (code, out, err) = read(&["decode", "-", "--as", "canopen"], asc);
    assert!(code == 0 && out.contains("bus-off"), "{out}");
    assert!(err.contains("skipped bus statistics: 1"), "{err}");
}

/// C10: a request without a reply at the end adds nothing to the output.
#[test]
fn an_open_request_prints_no_empty_notice() {
    let out = decoded("(1.000000) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n", &[]);
    assert!(out.ends_with('\n') && out.lines().count() == 1, "{out:?}");
}

/// C11: `explain` takes what `decode` prints, and the notations of other programs.
#[test]
fn explain_takes_frames_in_all_notations() {
    for words in [
        &["583#4B 41 60 00 18 02 00 00"][..],
        &["583#4B,41,60,00,18,02,00,00"],
        &["0x583#0x4B", "0x41", "0x60", "0x00", "0x18", "0x02", "0x00", "0x00"],
        &["583", "4B", "41", "60", "00", "18", "02", "00", "00"],
        &["   0.001000  can0   canopen  583#4B 41 60 00 18 02 00 00  value 0x6041:0 u16 0x0218"],
        &["583   [8]  4B 41 60 00 18 02 00 00"],
    ] {
        let ran = polepair(&[&["explain", "canopen"][..], words].concat());
        assert_eq!(ran.code, 0, "{words:?}: {}", ran.err);
        assert!(ran.out.contains("value 0x6041:0 u16 0x0218"), "{}", ran.out);
    }
    let line =
        "   0.000000  ttyUSB0 > tmcl  01 06 01 00 00 00 00 00 08  GAP 1, 0: read axis parameter";
    let ran = polepair(&["explain", "tmcl", line]);
    assert!(ran.code == 0 && ran.out.contains("GAP"), "{}{}", ran.out, ran.err);
}

/// Lines that cannot be read are counted, with the first places.
#[test]
fn a_summary_counts_the_lines_that_were_left_out() {
    let capture =
        "(1.0) can0 601#4041600000000000\n(1.1) can0 581#4B4160003702000\nnonsense 1#2#3\n";
    let (code, out, err) = read(&["summary", "-", "--format", "json"], capture);
    let json: serde_json::Value = serde_json::from_str(&out).expect(&err);
    assert_eq!((code, json["left_out"].as_u64()), (0, Some(2)), "{out}{err}");
    assert!(json["damage"][0].as_str().is_some_and(|text| text.starts_with("line 2: ")), "{out}");
}

/// A file without a readable line names lines that are, and the program that wrote it.
#[test]
fn an_unread_log_names_its_program_and_lines_that_are_read() {
    let (code, out, err) = read(&["decode", "-"], "Vehicle Spy 3 data\nA;B;C\n");
    assert!(code == 65 || code > 1, "{code} {out}");
    assert!(err.contains("Vehicle Spy") && err.contains("12:34:56.789 TX 01 03 00 33"), "{err}");
}

/// C2: identifiers alone prove nothing.
#[test]
fn motors_of_another_maker_are_none_of_ours() {
    let mut capture = String::new();
    for n in 0..50 {
        let _ = writeln!(capture, "(1.{n:02}0000) can0 141#A200000010270000");
        let _ = writeln!(capture, "(1.{n:02}0500) can0 241#A2323200F4010000");
    }
    let (code, out, err) = read(&["decode", "-"], &capture);
    assert_eq!(code, 0, "{err}");
    assert!(err.contains("can0: none of the protocols that polepair knows"), "{err}");
    assert!(out.lines().all(|line| line.contains("not a frame of any known protocol")), "{out}");
}

/// C3: TMCL on CAN with eight bytes, the last of which is the check sum of the serial form.
#[test]
fn tmcl_with_eight_bytes_is_tmcl() {
    let capture = "  can0  001   [8]  06 01 00 00 00 00 00 08\n\
                   \x20 can0  002   [8]  01 64 06 00 00 02 C7 00\n";
    let (_, out, err) = read(&["decode", "-"], capture);
    let (name, sure) = err.trim().split_once(": tmcl, ").expect(&err);
    let percent: u32 = sure.split(' ').next().and_then(|n| n.parse().ok()).expect(&err);
    assert!(name == "can0" && percent > 90, "{err}");
    assert!(out.contains("GAP 1, 0") && out.contains("= 711"), "{out}");
}
