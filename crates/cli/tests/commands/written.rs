//! Files that verbs write: what was there before is lost to no error, no signal and no full disk.
#![cfg(unix)]

use std::io::Write as _;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use polepair_test_support::wait_until;

use crate::run;
use run::{Ran, command, ended, environment, ok, polepair, program, signal};

const CAPTURE: &str = "(1700000000.000500) ttyUSB0 > 01 06 01 00 00 00 00 00 08\n\
                       (1700000000.020500) ttyUSB0 < 02 01 64 06 00 00 02 C7 36\n";
/// Contents of a target file before the command runs.
const OLD: &str = "what was there before\n";

/// A folder of a test's own, which goes with it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("polepair-written-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// A file with this content.
    fn file(&self, name: &str, content: &str) -> String {
        std::fs::write(self.0.join(name), content).expect("written");
        self.path(name)
    }

    fn names(&self) -> Vec<String> {
        let found = std::fs::read_dir(&self.0).expect("a folder");
        let name = |entry: std::io::Result<std::fs::DirEntry>| {
            entry.expect("an entry").file_name().to_string_lossy().into_owned()
        };
        let mut names: Vec<String> = found.map(name).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The verbs that make a file of a capture, with the names of their outputs.
const OF_CAPTURES: [(&[&str], &str); 8] = [
    (&["convert", "IN", "OUT"], "x.log"),
    (&["convert", "IN", "OUT", "--to", "pcapng"], "x.gz"),
    (&["convert", "IN", "OUT", "--to", "log"], "x.zst"),
    (&["decode", "IN", "--as", "tmcl", "-o", "OUT"], "x.txt"),
    (&["decode", "IN", "--as", "tmcl", "--filter", "ok", "-o", "OUT"], "x.jsonl"),
    (
        &["decode", "IN", "--as", "tmcl", "--profile", "tmcm-170", "--plot", "*", "-o", "OUT"],
        "x.svg",
    ),
    (&["summary", "IN", "--as", "tmcl", "-o", "OUT"], "x.txt"),
    (&["summary", "IN", "--as", "tmcl", "--format", "json", "-o", "OUT"], "x.json"),
];

fn words<'a>(verb: &[&'a str], input: &'a str, output: &'a str) -> Vec<&'a str> {
    let word = |word: &&'a str| match *word {
        "IN" => input,
        "OUT" => output,
        word => word,
    };
    verb.iter().map(word).collect()
}

fn content(path: &str) -> String {
    String::from_utf8_lossy(&std::fs::read(path).expect("a file")).into_owned()
}

/// Runs the program where no file may become larger than nothing.
fn on_a_full_disk(arguments: &[&str]) -> Ran {
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -f 0; exec \"$0\" \"$@\""]).arg(program()).args(arguments);
    shell.envs(environment()).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    ended(shell.spawn().expect("a shell"), arguments)
}

#[test]
fn an_output_that_is_the_input_is_refused() {
    let folder = Folder::new("same");
    let input = folder.file("in.log", CAPTURE);
    symlink(&input, folder.path("soft")).expect("a link");
    std::fs::hard_link(&input, folder.path("hard")).expect("a link");
    let same = ["in.log", "./in.log", "soft", "hard"].map(|name| folder.path(name));
    for (verb, _) in OF_CAPTURES {
        for output in &same {
            let mut order = words(verb, &input, output);
            if verb[0] == "convert" && !verb.contains(&"--to") {
                order.extend(["--to", "log"]);
            }
            let ran = polepair(&order);
            assert_eq!(
                (ran.code, content(&input).as_str()),
                (2, CAPTURE),
                "{order:?}: {}",
                ran.err
            );
            assert!(ran.err.contains("E258"), "{order:?}: {}", ran.err);
        }
    }
    let replay = ["replay", &input, "sim:tmcl", "--fast", "--trace", &same[2], "--force"];
    let ran = polepair(&replay);
    // The link has no ending that names a format, but even so it is the input.
    assert!(ran.code == 2 && content(&input) == CAPTURE, "{}", ran.err);
    assert_eq!(folder.names(), ["hard", "in.log", "soft"]);
}

#[test]
fn an_error_leaves_the_target_as_it_was() {
    let folder = Folder::new("errors");
    let good = folder.file("in.log", CAPTURE);
    let other = folder.file("other.txt", "no capture at all\nin two lines\n");
    let missing = folder.path("missing.log");
    let empty = folder.file("empty.log", "");
    for (verb, name) in OF_CAPTURES {
        let target = folder.file(name, OLD);
        let tried: [(&str, Ran); 4] = [
            ("a missing input", polepair(&words(verb, &missing, &target))),
            ("no capture", polepair(&words(verb, &other, &target))),
            ("a full disk", on_a_full_disk(&words(verb, &good, &target))),
            (
                "an unknown protocol",
                polepair(&[&words(verb, &good, &target)[..], &["--as", "x"]].concat()),
            ),
        ];
        for (what, ran) in tried {
            assert_ne!(ran.code, 0, "{verb:?} with {what}: {}", ran.err);
            assert_eq!(content(&target), OLD, "{verb:?} with {what}");
        }
        if verb[0] != "decode" {
            let ran = polepair(&words(verb, &empty, &target));
            assert!(ran.code == 1 && ran.err.contains("E115"), "{verb:?}: {}", ran.err);
            assert_eq!(content(&target), OLD, "{verb:?} with nothing");
        }
        let ran = polepair(&words(verb, &good, &target));
        assert!(ran.code <= 1 && content(&target) != OLD, "{verb:?}: {}", ran.err);
        std::fs::remove_file(&target).expect("removed");
    }
    assert_eq!(folder.names(), ["empty.log", "in.log", "other.txt"]);
}

/// Records that the format has no place for are no reason to replace a file by nothing.
#[test]
fn a_conversion_that_keeps_nothing_replaces_nothing() {
    let folder = Folder::new("unfit");
    let serial = folder.file("in.log", CAPTURE);
    let target = folder.file("out.asc", OLD);
    let ran = polepair(&["convert", &serial, &target]);
    assert!(ran.code == 1 && ran.err.contains("E115"), "{}", ran.err);
    assert_eq!(content(&target), OLD);
}

#[test]
fn links_and_permissions_of_a_target_stay() {
    let folder = Folder::new("links");
    let input = folder.file("in.log", CAPTURE);
    let real = folder.file("real.jsonl", OLD);
    std::fs::set_permissions(&real, std::fs::Permissions::from_mode(0o640)).expect("permissions");
    symlink("real.jsonl", folder.path("link.jsonl")).expect("a link");
    ok(&["decode", &input, "--as", "tmcl", "-o", &folder.path("link.jsonl")]);
    assert!(Path::new(&folder.path("link.jsonl")).is_symlink());
    assert!(content(&real).contains("\"GAP\""), "{}", content(&real));
    let mode = std::fs::metadata(&real).expect("a file").permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    ok(&["decode", &input, "--as", "tmcl", "-o", "/dev/null"]);
    assert_eq!(folder.names(), ["in.log", "link.jsonl", "real.jsonl"]);
}

/// Interrupts a program once it writes into the folder.
fn interrupted_in(folder: &Folder, arguments: &[&str], name: &str, input: &[u8]) -> Ran {
    let mut child = command(arguments).stdin(Stdio::piped()).spawn().expect("starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    stdin.write_all(input).expect("read");
    let prefix = format!(".{name}.");
    wait_until("a file under way", || folder.names().iter().any(|it| it.starts_with(&prefix)));
    signal("INT", child.id());
    let ran = ended(child, arguments);
    drop(stdin);
    ran
}

#[test]
fn an_interrupted_verb_leaves_the_target_as_it_was() {
    let folder = Folder::new("interrupted");
    for (verb, name) in OF_CAPTURES
        .into_iter()
        .filter(|(verb, _)| !verb.contains(&"--plot") && verb[0] != "summary")
    {
        let target = folder.file(name, OLD);
        let mut order = words(verb, "-", &target);
        if verb[0] == "convert" && !verb.contains(&"--to") {
            order.extend(["--to", "log"]);
        }
        let ran = interrupted_in(&folder, &order, name, CAPTURE.as_bytes());
        assert_eq!((ran.code, content(&target).as_str()), (130, OLD), "{order:?}: {}", ran.err);
        assert_eq!(folder.names(), [name], "{order:?}");
        std::fs::remove_file(&target).expect("removed");
    }
    // A capture that takes long.
    let line = "(1700000000.000500) can0 181#0102030405060708\n";
    let large = folder.file("large.log", &line.repeat(400_000));
    let target = folder.file("x.jsonl", OLD);
    let order = ["decode", &large, "--as", "canopen", "-o", &target];
    let ran = interrupted_in(&folder, &order, "x.jsonl", b"");
    assert_eq!((ran.code, content(&target).as_str()), (130, OLD), "{}", ran.err);
    assert!(ran.err.contains("a file that was there before is unchanged"), "{}", ran.err);
    assert_eq!(folder.names(), ["large.log", "x.jsonl"]);
}

#[test]
fn a_new_file_behind_a_stream_is_read_while_it_grows() {
    let folder = Folder::new("stream");
    let target = folder.path("x.jsonl");
    let order = ["decode", "-", "--as", "tmcl", "-o", &target];
    let mut child = command(&order).stdin(Stdio::piped()).spawn().expect("starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    stdin.write_all(CAPTURE.as_bytes()).expect("read");
    wait_until("lines in the file", || {
        std::fs::read_to_string(&target).unwrap_or_default().contains("\"GAP\"")
    });
    drop(stdin);
    assert_eq!(ended(child, &order).code, 0);
}

#[test]
fn settings_values_and_programs_leave_their_targets_too() {
    let folder = Folder::new("drives");
    let source = folder.file("a.tmc", "ROR 0, 100\nSTOP\n");
    let verbs: [(&[&str], &str); 3] = [
        (&["config", "save", "sim:tmcl", "OUT"], "good.toml"),
        (&["get", "sim:cia402", "0x1008", "-o", "OUT"], "name.bin"),
        (&["program", "assemble", "IN", "-o", "OUT"], "a.bin"),
    ];
    for (verb, name) in verbs {
        let target = folder.file(name, OLD);
        let ran = on_a_full_disk(&words(verb, &source, &target));
        assert_eq!((ran.code, content(&target).as_str()), (3, OLD), "{verb:?}: {}", ran.err);
        let ran = polepair(&words(verb, &source, &target));
        assert_eq!(ran.code, 0, "{verb:?}: {}", ran.err);
        assert_ne!(content(&target), OLD, "{verb:?}");
    }
    let ran = polepair(&["program", "assemble", &source, "-o", &source]);
    assert!(ran.code == 2 && ran.err.contains("E258"), "{}", ran.err);
    let ran = polepair(&["config", "save", "tcp://127.0.0.1:1", &folder.path("good.toml")]);
    assert_ne!(ran.code, 0);
    assert_ne!(content(&folder.path("good.toml")), "");
    assert_eq!(folder.names(), ["a.bin", "a.tmc", "good.toml", "name.bin"]);
}

#[test]
fn a_recording_and_a_trace_overwrite_nothing_unasked() {
    let folder = Folder::new("growing");
    let target = folder.file("bus.log", "(1700000000.000500) can0 181#01");
    let before = content(&target);
    let link = "canopen+udp://239.74.163.31:43124";
    let record = ["record", link, "-o", &target, "--for", "1ms"];
    let get = ["get", "sim:tmcl", "max current", "--trace", &target];
    for order in [&record[..], &get] {
        let ran = polepair(order);
        assert!(ran.code == 2 && ran.err.contains("E259"), "{order:?}: {}", ran.err);
        assert_eq!(content(&target), before, "{order:?}");
    }
    ok(&[&get[..], &["--append"]].concat());
    let appended = content(&target);
    assert!(
        appended.starts_with(&format!("{before}\n")) && appended.lines().count() > 2,
        "{appended}"
    );
    ok(&[&get[..], &["--force"]].concat());
    assert!(!content(&target).contains("181#01"));
    // A stop does not wait for a file.
    let ran = polepair(&["stop", "sim:tmcl", "--trace", &target]);
    assert!(ran.code == 0 && ran.err.contains("No frame is recorded"), "{}", ran.err);
    let ran = polepair(&["record", link, "-o", &folder.path("a.blf"), "--append", "--for", "1ms"]);
    assert!(ran.code == 2 && ran.err.contains("E248"), "{}", ran.err);
    // A recorder that begins again goes on counting.
    folder.file("night-0001.log", OLD);
    ok(&["record", link, "-o", &folder.path("night.log"), "--rotate", "1h", "--for", "1ms"]);
    assert_eq!(folder.names(), ["bus.log", "night-0001.log", "night-0002.log"]);
    assert_eq!(content(&folder.path("night-0001.log")), OLD);
}
