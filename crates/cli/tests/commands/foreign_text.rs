//! Names that files give: a terminal shows them with their control characters escaped, data have them as they are.

use crate::run;
use run::{Ran, polepair};

/// A link that clears the screen, sets the title, rings and hides what follows.
const LINK: &str = "c\u{1b}[2J\u{1b}]0;x\u{7}\u{9b}8m";
const SHOWN: &str = r"c\x1b[2J\x1b]0;x\x07\x9b8m";

fn capture(name: &str) -> String {
    let line = |n: u32, frame: &str| format!("(1700000000.{:06}) {LINK} {frame}\n", n * 1000);
    let lines = [
        line(0, "705#00"),
        line(1, "605#4064600000000000"),
        line(2, "585#4364600010000000"),
        line(3, "085#1043010000000000"),
        line(4, "185#3704"),
    ];
    let file = std::env::temp_dir().join(format!("polepair-{}-{name}.log", std::process::id()));
    std::fs::write(&file, lines.concat()).expect("written");
    file.display().to_string()
}

fn is_clean(ran: &Ran) -> bool {
    let is_harmless = |c: char| !c.is_control() || c == '\n' || c == '\t';
    ran.out.chars().all(is_harmless) && ran.err.chars().all(is_harmless)
}

#[test]
fn a_link_of_a_capture_reaches_no_terminal() {
    let file = capture("link");
    let other = file.replace(".log", "-new.svg");
    let verbs: [&[&str]; 9] = [
        &["decode", &file],
        &["decode", &file, "--as", "canopen", "--changes", "--notices", "all"],
        &["decode", &file, "--filter", "axis = 5"],
        &["summary", &file],
        &["diff", &file, &file],
        &["decode", &file, "--as", "canopen", "--plot", "*"],
        &["convert", &file, "-", "--to", "asc"],
        &["replay", &file, "sim:canopen:5", "--dry-run"],
        &["decode", &file, "--as", "canopen@nothere"],
    ];
    for verb in verbs {
        let ran = polepair(verb);
        assert!(is_clean(&ran), "{verb:?}: {:?} {:?}", ran.out, ran.err);
    }
    assert!(polepair(&["decode", &file]).out.contains(SHOWN));
    assert!(polepair(&["summary", &file]).out.contains(SHOWN));
    let json = polepair(&["decode", &file, "--format", "jsonl"]);
    let first: serde_json::Value =
        serde_json::from_str(json.out.lines().next().expect("a line")).expect("JSON");
    assert_eq!(first["link"], LINK);
    let summary = polepair(&["summary", &file, "--format", "json"]);
    assert!(summary.out.contains(r"\u001b[2J"), "{}", summary.out);
    let plotted = polepair(&["decode", &file, "--as", "canopen", "--plot", "*", "-o", &other]);
    let svg = std::fs::read_to_string(&other).unwrap_or_default();
    assert!(!svg.contains('\u{1b}') && (plotted.code != 0 || svg.starts_with("<svg")), "{svg}");
    let _ = std::fs::remove_file(file);
    let _ = std::fs::remove_file(other);
}

/// Foreign text in the interface names of a capture of another format.
#[test]
fn an_interface_of_a_pcapng_file_reaches_no_terminal() {
    let log = capture("interface");
    let file = log.replace(".log", ".pcapng");
    assert_eq!(polepair(&["convert", &log, &file]).code, 0);
    for verb in [&["decode", &file][..], &["summary", &file]] {
        let ran = polepair(verb);
        assert!(is_clean(&ran) && ran.out.contains(SHOWN), "{verb:?}: {:?}", ran.out);
    }
    let _ = std::fs::remove_file(log);
    let _ = std::fs::remove_file(file);
}

#[test]
fn names_on_the_command_line_reach_no_terminal() {
    let odd = "no\u{1b}[31m\u{7}";
    let missing = format!("/tmp/{odd}.log");
    let sheet = std::env::temp_dir().join(format!("polepair-{}-odd.eds", std::process::id()));
    let text = format!(
        "[DeviceInfo]\nProductName={odd}\n[2000]\nParameterName=gain{odd}\nObjectType=0x7\n\
         DataType=0x0006\nAccessType=rw\nPDOMapping=0\nDefaultValue=5\n"
    );
    std::fs::write(&sheet, text).expect("written");
    let sheet = sheet.display().to_string();
    let url = format!("sim:cia402?eds={sheet}");
    let verbs: [&[&str]; 12] = [
        &["decode", &missing],
        &["convert", &missing, "x.blf"],
        &["summary", &missing],
        &["get", "sim:tmcl", odd],
        &["info", odd],
        &["info", &format!("@{odd}")],
        &["move", "sim:tmcl", odd],
        &["explain", odd, "1"],
        &["params", odd],
        &["config", "diff", "sim:tmcl", &missing],
        &["get", &url, "0x2000"],
        &["info", &url],
    ];
    for verb in verbs {
        let ran = polepair(verb);
        assert!(is_clean(&ran), "{verb:?}: {:?} {:?}", ran.out, ran.err);
    }
    let _ = std::fs::remove_file(sheet);
}
