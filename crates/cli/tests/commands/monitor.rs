//! `polepair monitor` as lines, and as a listener beside another program.

use crate::run;

use std::io::{BufRead as _, BufReader};
use std::process::Child;

use run::{Served, command, ok, polepair};
use serde_json::Value;

fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).expect(line)).collect()
}

#[test]
fn once_queries_each_axis_and_prints_its_reply() {
    let out = ok(&["monitor", "sim:tmcl?axes=2&time=virtual", "--once"]);
    let line = |word: &str| out.lines().find(|line| line.starts_with(word)).expect(word).to_owned();
    assert!(line("axis ").contains("velocity") && line("3 ").contains("tmcm-171"), "{out}");
    assert!(out.contains("actual position = 0"), "{out}");
}

#[test]
fn programs_get_frames_axes_and_the_link() {
    let url = "sim:tmcl?time=virtual";
    let all = objects(&ok(&["monitor", url, "--format", "jsonl", "--for", "2s", "--rate", "2"]));
    let axes: Vec<_> = all.iter().filter(|one| one["signals"].is_object()).collect();
    assert!(axes.len() >= 3, "{} rounds", axes.len());
    let velocity = &axes[0]["signals"]["velocity"];
    assert_eq!((&velocity["value"], &velocity["unit"]), (&Value::from(0), &Value::from("rpm")));
    assert!(velocity["age"].as_f64().expect("an age") < 1.0);
    assert!(all.iter().any(|one| one["kind"] == "GAP" && one["direction"] == "tx"));
    let link = all.last().expect("the link");
    assert_eq!((&link["url"], &link["wrong"]), (&Value::from(url), &Value::from(0)));
    assert!(link["load"]["tmcl:1"].as_f64().expect("9600 baud") > 0.1, "{link}");
}

/// Modules on one line have different profiles: 150 is another parameter in each.
#[test]
fn each_module_of_a_line_is_named_by_its_own_profile() {
    let rack = "[[link]]\nprotocol = \"tmcl\"\n\
        [[link.drive]]\nprofile = \"tmcm-6110\"\naddress = 1\n\
        [[link.drive]]\nprofile = \"tmcm-171\"\naddress = 3\n";
    let file = std::env::temp_dir().join(format!("polepair-monitor-{}.toml", std::process::id()));
    std::fs::write(&file, rack).expect("a file");
    let url = format!("sim:{}", file.display());
    let ran = polepair(&["monitor", &url, "--once"]);
    let verbose = polepair(&["get", &format!("{url}?time=virtual#1,3"), "AP 150", "-v"]);
    std::fs::remove_file(&file).expect("the file");
    assert_eq!(ran.code, 0, "{}", ran.err);
    let (axes, frames): (Vec<&str>, Vec<&str>) =
        ran.out.lines().partition(|line| !line.starts_with(' '));
    for label in ["1 ", "1.1", "1.5", "3 "] {
        assert!(axes.iter().any(|line| line.starts_with(label)), "{label}: {axes:?}");
    }
    let about = |word: &str, module: &str| {
        frames.iter().any(|line| line.contains(word) && line.contains(module))
    };
    assert!(about("\"actual current\"", "> tmcl  03 06 96"), "{frames:?}");
    assert!(about("\"driver status flags\"", "> tmcl  01 06 D0 05"), "{frames:?}");
    assert!(!ran.out.contains("end switch power down"), "{frames:?}");
    for (module, word) in
        [("01 06 96", "\"end switch power down\""), ("03 06 96", "\"actual current\"")]
    {
        let line = verbose.err.lines().find(|line| line.contains(&format!("> tmcl  {module}")));
        assert!(line.is_some_and(|line| line.contains(word)), "{module}: {}", verbose.err);
    }
}

#[test]
fn impossible_options_are_refused_before_anything_is_opened() {
    assert_eq!(polepair(&["monitor", "sim:tmcl", "--rate", "0"]).code, 2);
    assert_eq!(polepair(&["monitor", "sim:tmcl", "--as", "tmlc"]).code, 2);
    assert_eq!(polepair(&["monitor", "sim:tmcl", "--listen", "--once"]).code, 2);
}

/// A run that ends with its owner.
struct Held(Child);

impl Held {
    fn new(arguments: &[&str]) -> Self {
        Self(command(arguments).spawn().expect("starts"))
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(unix)]
#[test]
fn a_listener_hears_both_ends_and_says_nothing() {
    let drive = Served::with(&["canopen:2", "--udp", "239.74.163.19:43119"]);
    let mut listener = Held::new(&["monitor", drive.link(), "--listen", "--format", "jsonl"]);
    let talker = Held::new(&["watch", &drive.url, "velocity", "--for", "300s"]);
    let lines = BufReader::new(listener.0.stdout.take().expect("a pipe")).lines();
    let (mut requested, mut answered) = (false, false);
    for line in lines {
        let one: Value = serde_json::from_str(&line.expect("text")).expect("JSON");
        assert!(one["direction"].is_null(), "{one}");
        requested |= one["kind"] == "SDO read" && one["axis"] == 2;
        answered |= one["kind"] == "SDO value" && one["axis"] == 2;
        if requested && answered {
            break;
        }
    }
    assert!(requested && answered);
    drop((talker, listener));
    drive.end();
}
