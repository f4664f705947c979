//! Settings saved, compared and written back, with simulated drives.
#![cfg(unix)]

use crate::run;

use run::{Served, ok, polepair};
use std::path::PathBuf;

/// A file that goes when the test ends.
struct Temporary(PathBuf);

impl Temporary {
    fn new(name: &str, text: &str) -> Self {
        let name = format!("polepair-config-{}-{name}.toml", std::process::id());
        let file = Self(std::env::temp_dir().join(name));
        std::fs::write(&file.0, text).expect("writes");
        file
    }

    fn path(&self) -> &str {
        self.0.to_str().expect("UTF-8")
    }

    fn text(&self) -> String {
        std::fs::read_to_string(&self.0).expect("reads")
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn settings_go_from_one_drive_to_another_and_leave_its_address_alone() {
    let (first, second) = (Served::new("tmcl:1"), Served::new("tmcl:7"));
    ok(&["set", &first.url, "max current=1.25A", "motor poles=4"]);
    let file = Temporary::new("copy", "");
    let saved = polepair(&["config", "save", &first.url, file.path()]);
    assert_eq!(saved.code, 0, "{}", saved.err);
    let text = file.text();
    assert_eq!(ok(&["config", "save", &first.url, "-"]), text);
    let names = text.lines().filter_map(|line| line.split_once(" = ")).map(|(name, _)| name);
    let names: Vec<&str> = names.skip(4).map(|name| name.trim_matches('"')).collect();
    assert!(names.is_sorted() && names.len() > 30, "{text}");
    let current = ok(&["get", &first.url, "max current"]);
    let shown = current.trim().trim_start_matches("max current = ");
    assert!(text.contains(&format!("\"max current\" = \"{shown}\"")), "{text}");

    let differ = polepair(&["config", "diff", &second.url, file.path()]);
    assert_eq!((differ.code, differ.err.trim()), (1, "4 settings differ"), "{}", differ.out);
    assert!(differ.out.contains("max current"), "{}", differ.out);
    let dry = polepair(&["config", "apply", &second.url, file.path(), "--dry-run"]);
    assert_eq!(dry.code, 0, "{}", dry.err);
    assert!(dry.err.contains("none of this was written"), "{}", dry.err);
    let unasked = polepair(&["config", "apply", &second.url, file.path()]);
    assert_eq!(unasked.code, 2);
    assert!(unasked.err.contains("E247") && unasked.err.contains("--yes"), "{}", unasked.err);

    let applied = polepair(&["config", "apply", &second.url, file.path(), "--yes"]);
    assert_eq!(applied.code, 0, "{}", applied.err);
    assert!(applied.err.contains("not written") && applied.err.contains("module address"));
    assert!(!applied.out.contains("module address"), "{}", applied.out);
    assert!(applied.err.contains("2 settings written and read back"), "{}", applied.err);
    assert_eq!(ok(&["get", &second.url, "max current"]), current);
    let again = polepair(&["config", "apply", &second.url, file.path(), "--yes"]);
    assert!(again.err.contains("nothing to write"), "{}", again.err);
    first.end();
    second.end();
}

#[test]
fn a_powered_motor_is_left_alone() {
    let served = Served::new("modbus-rtu:1");
    ok(&["set", &served.url, "control mode=1", "--arm"]);
    let text =
        "[axis.1]\nprofile = \"syntron-ts\"\n[axis.1.settings]\n\"homing delay\" = \"5 ms\"\n";
    let file = Temporary::new("powered", text);
    ok(&["enable", &served.url]);
    let refused = polepair(&["config", "apply", &served.url, file.path(), "--yes"]);
    assert_eq!(refused.code, 2, "{}", refused.err);
    assert!(refused.err.contains("E246") && refused.err.contains("is powered"), "{}", refused.err);
    ok(&["disable", &served.url]);
    ok(&["config", "apply", &served.url, file.path(), "--yes"]);
    served.end();
}

#[test]
fn a_wrong_file_is_refused_with_its_place() {
    for (settings, wanted) in [
        ("\"max curent\" = 1", ":4:1: tmcm-171 has no parameter `max curent`; did you mean"),
        ("\"max current\" = \"900 A\"", ":4:1: `max current` takes 0"),
        ("\"max current\" = \"2 rpm\"", ":4:1: "),
        ("velocity = 5", ":4:1: "),
        ("\"max current\" = { row = 1 }", "unknown key `row`"),
    ] {
        let text = format!("[axis.1]\nprofile = \"tmcm-171\"\n[axis.1.settings]\n{settings}\n");
        let file = Temporary::new("wrong", &text);
        let ran = polepair(&["config", "diff", "sim:tmcl", file.path()]);
        assert_eq!(ran.code, 2, "{settings}: {}", ran.err);
        assert!(ran.err.contains("E230") && ran.err.contains(wanted), "{settings}: {}", ran.err);
    }
    // What was saved and cut off, at any line.
    let saved = ok(&["config", "save", "sim:tmcl"]);
    let lines: Vec<&str> = saved.split_inclusive('\n').collect();
    for kept in 1..lines.len() {
        let file = Temporary::new("cut", &lines[..kept].concat());
        let ran = polepair(&["config", "diff", "sim:tmcl", file.path()]);
        assert!(ran.code == 2 && ran.err.contains("E230"), "{kept} lines: {}", ran.err);
    }
    let other = Temporary::new("other", "[axis.1]\nprofile = \"syntron-ts\"\n");
    let ran = polepair(&["config", "apply", "sim:tmcl", other.path(), "--yes"]);
    assert!(ran.err.contains("settings of syntron-ts, this is tmcm-171"), "{}", ran.err);
    assert_eq!(polepair(&["config", "diff", "sim:tmcl", "/nowhere.toml"]).code, 3);
}

#[test]
fn the_factory_is_something_to_compare_with() {
    let ran = polepair(&["config", "diff", "sim:tmcl", "--default", "--format", "jsonl"]);
    assert_eq!((ran.code, ran.out.as_str()), (0, ""), "{}", ran.err);
    let served = Served::new("tmcl:1");
    ok(&["set", &served.url, "motor poles=4"]);
    let ran = polepair(&["config", "diff", &served.url, "--default", "--format", "jsonl"]);
    assert_eq!(ran.code, 1);
    let line: serde_json::Value = serde_json::from_str(ran.out.trim()).expect("one object");
    assert_eq!((&line["setting"], &line["now_raw"]), (&"motor poles".into(), &4.into()));
    served.end();
}
