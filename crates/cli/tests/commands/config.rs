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

#[test]
fn a_drive_is_cloned_with_the_registers_that_no_source_names() {
    let (first, second) = (Served::new("syntron-ts:1"), Served::new("syntron-ts:1"));
    // The drive keeps every write: one for each register, and its mode of memory is as it was.
    let stored =
        polepair(&["set", &first.url, "Fn_06=77", "Fn_1A=3", "homing delay=5ms", "--store"]);
    assert_eq!(stored.code, 0, "{}", stored.err);
    assert!(stored.err.contains("permanent memory: 3"), "{}", stored.err);
    assert_eq!(ok(&["get", &first.url, "write target"]), "write target = flash\n");
    let file = Temporary::new("backup", "");
    let saved = polepair(&["config", "save", &first.url, file.path()]);
    assert!(
        saved.err.contains("left out, as they may move the motor: internal speed"),
        "{}",
        saved.err
    );
    assert!(saved.err.contains("449 of them without a name"), "{}", saved.err);
    let text = file.text();
    assert!(text.contains("\nFn_06 = 77\n") && text.contains("[axis.1.unnamed]"), "{text}");

    let named = polepair(&["config", "apply", &second.url, file.path(), "--yes"]);
    assert_eq!(named.code, 0, "{}", named.err);
    assert!(named.err.contains("no source names them: 2 registers"), "{}", named.err);
    // Its memory's mode was changed for the writes, and put back.
    assert_eq!(ok(&["get", &second.url, "write target"]), "write target = flash\n");
    assert!(!named.err.contains("puts it back"), "{}", named.err);
    let differ = polepair(&["config", "diff", &second.url, file.path()]);
    assert_eq!((differ.code, differ.err.trim()), (1, "2 settings differ"), "{}", differ.out);
    for _ in 0..2 {
        ok(&["config", "apply", &second.url, file.path(), "--all", "--yes", "--store"]);
        assert_eq!(polepair(&["config", "diff", &second.url, file.path()]).code, 0);
        assert_eq!(ok(&["config", "save", &second.url, "-"]), text);
    }
    // A powered drive gets no register that no source names.
    ok(&["set", &second.url, "control mode=1", "--arm"]);
    ok(&["enable", &second.url]);
    let powered = polepair(&["config", "apply", &second.url, file.path(), "--all", "--yes"]);
    assert!(powered.code == 2 && powered.err.contains("E246"), "{}", powered.err);
    let both = polepair(&["config", "apply", &second.url, file.path(), "--all", "--powered"]);
    assert_eq!(both.code, 2, "{}", both.err);
    first.end();
    second.end();
}

#[test]
fn a_changed_mode_of_memory_is_told() {
    let served = Served::new("syntron-ts:1");
    let set = polepair(&["set", &served.url, "homing delay=5ms"]);
    assert!(set.err.contains("permanent memory: 1"), "{}", set.err);
    assert!(set.err.contains("Fn_99 (write target) was 0 and stays 1"), "{}", set.err);
    let again = polepair(&["set", &served.url, "homing delay=6ms"]);
    assert!(!again.err.contains("Fn_99") && !again.err.contains("permanent"), "{}", again.err);
    // Both ways through flash, and the register itself.
    let stored = polepair(&["set", &served.url, "homing delay=7ms", "--store"]);
    assert!(stored.err.contains("permanent memory: 3"), "{}", stored.err);
    let back = polepair(&["set", &served.url, "Fn_99=0"]);
    assert!(!back.err.contains("puts it back"), "{}", back.err);
    served.end();
}
