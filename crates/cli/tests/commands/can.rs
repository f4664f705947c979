//! Simulated drives on CAN links, and the verbs against them.
#![cfg(unix)]

use crate::run;

use std::io::{BufRead as _, BufReader};
use std::process::Child;

use run::polepair;

/// Served drives, ended with SIGTERM as a supervisor would.
struct Served {
    child: Child,
    urls: Vec<String>,
}

impl Served {
    fn new(arguments: &[&str], links: usize) -> Self {
        let arguments = [&["sim"], arguments].concat();
        let mut child = run::command(&arguments).spawn().expect("starts");
        let lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let ready = |line: std::io::Result<String>| {
            let line = line.expect("text");
            line.strip_prefix("ready ").expect("ready").to_owned()
        };
        let urls = lines.take(links).map(ready).collect();
        Self { child, urls }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let pid = self.child.id().to_string();
        std::process::Command::new("kill").arg(&pid).status().expect("kill");
        let code = self.child.wait().expect("ends").code();
        if !std::thread::panicking() {
            assert_eq!(code, Some(0));
        }
    }
}

fn ok(arguments: &[&str]) -> String {
    let ran = polepair(arguments);
    assert_eq!(ran.code, 0, "{arguments:?}: {}{}", ran.out, ran.err);
    ran.out
}

fn temporary(name: &str) -> String {
    let file = format!("polepair-can-{}-{name}", std::process::id());
    std::env::temp_dir().join(file).display().to_string()
}

/// Everything that a verb does, on one link.
fn is_whole(sim: &Served) {
    let url = &sim.urls[0];
    let link = url.split('#').next().expect("a link");
    let found = ok(&["scan", link, "--ids", "1-4", "--format", "jsonl"]);
    assert_eq!(found.lines().count(), 2, "{found}");
    assert_eq!(ok(&["set", &format!("{link}#3"), "max current=1A"]), "max current = 1 A (10)\n");
    ok(&["spin", &format!("{link}#1"), "300rpm", "--for", "300ms"]);
    let read = ok(&["get", url, "max current", "target velocity", "--format", "jsonl"]);
    assert!(read.contains(r#""axis":3,"name":"max current","symbol":"AP 6","raw":10"#), "{read}");
}

#[test]
fn a_bus_is_behind_a_serial_adapter() {
    let pty = temporary("adapter");
    let sim = Served::new(&["tmcl+can:1,3", "--pty", &pty], 1);
    assert_eq!(sim.urls[0], format!("tmcl+slcan://{pty}#1,3"));
    is_whole(&sim);
}

#[test]
fn a_bus_is_behind_adapters_on_tcp() {
    let sim = Served::new(&["tmcl+can:1,3", "--tcp", "127.0.0.1:0"], 1);
    assert!(sim.urls[0].starts_with("tmcl+slcan://127.0.0.1:"), "{:?}", sim.urls);
    is_whole(&sim);
}

#[test]
fn a_bus_is_shared_as_socketcand_does() {
    let sim = Served::new(&["tmcl:1,3", "--socketcand", "127.0.0.1:0"], 1);
    assert!(sim.urls[0].ends_with("/can0#1,3"), "{:?}", sim.urls);
    is_whole(&sim);
}

#[test]
fn frames_are_shown_kept_and_decoded() {
    let trace = temporary("trace");
    let url = "sim:tmcl+can?time=virtual";
    let ran = polepair(&["get", url, "AP 6", "--raw", "-v", "--trace", &trace]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("001#06 06 00 00 00 00 00    GAP 6, 0"), "{}", ran.err);
    let text = std::fs::read_to_string(&trace).expect("a trace");
    assert!(text.lines().any(|line| line.ends_with(" 001#06060000000000 T")), "{text}");
    let decoded = ok(&["decode", &trace, "--as", "tmcl", "--format", "jsonl"]);
    assert!(decoded.contains(r#""direction":"rx","protocol":"tmcl""#), "{decoded}");
    std::fs::remove_file(&trace).expect("removed");

    let shown = ok(&["stop", url, "--dry-run"]);
    assert!(shown.contains("001#03000000000000 "), "{shown}");
}

#[test]
fn a_relay_is_one_drive_on_two_real_wires() {
    let rack = temporary("relay.toml");
    let text = "[[link]]\nname = \"host\"\nprotocol = \"tml\"\n\
        [[link.drive]]\nname = \"relay\"\nprofile = \"technosoft-f514l\"\naddress = 255\n\
        on = [\"host\", \"bus\"]\n\
        [[link]]\nname = \"bus\"\nprotocol = \"tmlcan\"\n\
        [[link.drive]]\nname = \"x\"\nprofile = \"technosoft-f514l\"\naddress = 1\n";
    std::fs::write(&rack, text).expect("written");
    let sim = Served::new(&[&rack, "--tcp", "127.0.0.1:0", "--socketcand", "127.0.0.1:0"], 2);
    let [host, bus] = &sim.urls[..] else { panic!("{:?}", sim.urls) };
    assert!(host.starts_with("tml+tcp://") && host.ends_with("#255,1"), "{host}");
    assert!(bus.starts_with("tmlcan+socketcand://") && bus.ends_with("#1"), "{bus}");
    // Both ways lead to the same drive.
    let set = |url: &str| ok(&["set", &profiled(url), "KPP=17"]);
    assert!(set(host).lines().count() == 2);
    let read = ok(&["get", &profiled(bus), "KPP", "--raw"]);
    assert!(read.ends_with("= 17\n"), "{read}");
    std::fs::remove_file(&rack).expect("removed");
}

/// Adds the drives' profile to the connection string, so that it is not queried.
fn profiled(url: &str) -> String {
    let (link, axes) = url.split_once('#').expect("axes");
    format!("{link}?profile=technosoft-f514l#{axes}")
}

#[test]
fn mistakes_are_refused_with_what_to_try() {
    for (arguments, code, text) in [
        (&["sim", "modbus-rtu:1", "--udp", "239.74.163.2:43199"][..], 2, "without a link"),
        (&["get", "modbus-rtu+socketcan://can0#1", "x"], 2, "is not used on CAN"),
        (&["stop", "sim:tmcl+can#g1"], 2, "this protocol has no groups"),
        (&["get", "tmcl+socketcan://nocan0#1", "x"], 3, "nocan0"),
    ] {
        let ran = polepair(arguments);
        assert_eq!(ran.code, code, "{arguments:?}: {}", ran.err);
        assert!(ran.err.contains(text), "{}", ran.err);
    }
}
