//! Logs as other programs write them, and the records in them.

use super::{read_all, read_whole};

/// Logs and tables with the records in them, each as `=== PROGRAM`, its lines, `---`, and the records in our own form.
/// `\r`, `\t` and `\e` are control characters.
const PROGRAM_LOGS: &str = include_str!("program_logs.txt");

/// The program, its log, and the records of each section.
fn program_logs() -> impl Iterator<Item = (&'static str, String, Vec<&'static str>)> {
    PROGRAM_LOGS.split("=== ").skip(1).map(|section| {
        let (program, rest) = section.split_once('\n').expect("a name");
        let (log, records) = rest.split_once("\n---\n").expect("records");
        let log = log.replace("\\r", "\r").replace("\\t", "\t").replace("\\e", "\x1b");
        let end = if log.contains('\r') { "" } else { "\n" };
        (program, log + end, records.lines().collect())
    })
}

#[test]
fn logs_of_other_programs() {
    assert_eq!(program_logs().count(), 35);
    for (program, log, expected) in program_logs() {
        assert_eq!(read_whole(&log), expected, "{program}");
    }
}

/// PowerShell's redirection writes UTF-16.
#[test]
fn logs_in_utf_16() {
    for (program, log, expected) in program_logs() {
        let units = "\u{FEFF}".encode_utf16().chain(log.encode_utf16());
        let file: Vec<u8> = units.flat_map(u16::to_le_bytes).collect();
        assert_eq!(read_all(&file).0, expected, "{program}");
    }
}

/// Lines that look like data and are none, or whose meaning is not certain.
#[test]
fn doubtful_lines_are_not_read() {
    for line in [
        "RX: 12",
        "TX errors 01 03",
        "Tx Rx 01 03",
        "TX (3 bytes): 01 03",
        "[01] Tx",
        "1537 2 40 41",
        "ID: 1537 DLC: 2 Data: 40 41",
        "t6018404160",
        "Sent 10 frames in 12:34:56",
    ] {
        let (found, _) = read_all(format!("{line}\n").as_bytes());
        assert_eq!(found, [] as [&str; 0], "{line}");
    }
}

/// SSCOM writes its arrows in the character set of its country.
#[test]
fn arrows_that_are_not_utf_8() {
    let log = b"[12:34:56.789]\xB7\xA2\xA1\xFA\xA1\xF301 03 00 33 \xA1\xF5\n\
        [12:34:56.812]\xCA\xD5\xA1\xFB\xA1\xF401 03 02 00\n";
    let expected = ["(0000045296.789000) - > 01 03 00 33", "(0000045296.812000) - < 01 03 02 00"];
    assert_eq!(read_all(log).0, expected);
}

/// Cells whose base is not certain are left out with the reason.
#[test]
fn doubtful_cells_are_not_read() {
    for (table, reason) in [
        ("time,id,dlc,data\n1.5,1537,2,40 41\n", "expected an identifier in hexadecimal"),
        ("time,id,dlc,d0,d1\n1.5,601,2,64,5\n", "expected bytes of two hexadecimal digits"),
        ("time,id,dlc,data\n1.5,601,3,40 41\n", "the number of its bytes is not its length"),
    ] {
        let (found, statistics) = read_all(table.as_bytes());
        assert_eq!(found, [] as [&str; 0], "{table}");
        assert!(statistics.damage[0].reason.0.starts_with(reason), "{:?}", statistics.damage);
    }
}
