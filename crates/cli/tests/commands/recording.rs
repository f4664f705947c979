//! Contents of a recording that is killed, and of one that continues in another file.
#![cfg(unix)]

use crate::run;

use std::path::{Path, PathBuf};

use run::{Held, Served, ok, polepair};

/// An empty folder of this test run's own.
fn folder(name: &str) -> PathBuf {
    let name = format!("polepair-recording-{name}-{}", std::process::id());
    let folder = std::env::temp_dir().join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Starts to record.
fn recording(link: &str, file: &Path, more: &[&str]) -> Held {
    let file = file.display().to_string();
    let line = format!("recording to {file}; Ctrl-C ends");
    Held::new(&[&["record", link, "-o", file.as_str()], more].concat(), &line)
}

/// The frames of a capture, without their times.
fn frames(file: &Path) -> Vec<String> {
    let file = file.display().to_string();
    let ran = polepair(&["convert", &file, "-", "--to", "log"]);
    ran.out.lines().filter_map(|line| Some(line.split(' ').nth(2)?.to_owned())).collect()
}

#[test]
fn a_killed_recording_can_be_read_up_to_its_last_write() {
    let drive = Served::with(&["canopen:2", "--udp", "239.74.163.22:43123"]);
    let folder = folder("killed");
    let names = [
        "a.log",
        "a.log.gz",
        "a.log.zst",
        "a.pcap",
        "a.pcapng",
        "a.pcapng.zst",
        "a.asc",
        "a.trc",
        "a.blf",
        "a.csv",
    ];
    let files: Vec<PathBuf> = names.iter().map(|name| folder.join(name)).collect();
    let killed: Vec<Held> = files.iter().map(|file| recording(drive.link(), file, &[])).collect();
    let whole = folder.join("whole.log");
    let ended = recording(drive.link(), &whole, &[]);
    for _ in 0..3 {
        ok(&["get", &drive.url, "velocity demand"]);
    }
    // Brought up to date by itself: the last frame that was sent is waited for.
    while frames(&whole).iter().filter(|frame| frame.starts_with("602#406B60")).count() < 3 {}
    assert_eq!(ended.interrupt().code, 0);
    let expected = frames(&whole);
    for (file, recorder) in files.iter().zip(killed) {
        while frames(file).len() < expected.len() {}
        run::signal("KILL", recorder.id());
        assert_eq!(recorder.ended().code, -1, "killed");
        assert_eq!(frames(file), expected, "{}", file.display());
    }
    drive.end();
}

#[test]
fn a_recording_in_several_files_has_no_gap_between_them() {
    let drive = Served::with(&["canopen:2", "--udp", "239.74.163.23:43124"]);
    for (how, name) in [("1kB", "size.log"), ("1s", "time.log"), ("1kB", "size.blf")] {
        let folder = folder(&format!("{name}-{how}"));
        let turned = recording(drive.link(), &folder.join(name), &["--rotate", how]);
        let whole = folder.join("whole.log");
        let straight = recording(drive.link(), &whole, &[]);
        let count = || std::fs::read_dir(&folder).expect("a folder").count();
        // The whole one, and three of the others.
        while count() < 4 {
            ok(&["get", &drive.url, "velocity demand"]);
        }
        let ran = turned.interrupt();
        assert!(ran.code == 0 && ran.err.contains(" files in "), "{}", ran.err);
        assert_eq!(straight.interrupt().code, 0);
        let (stem, end) = name.split_once('.').expect("an end");
        let numbered = |n: usize| folder.join(format!("{stem}-{n:04}.{end}"));
        let mut parts = Vec::new();
        for file in (1..).map(numbered).take_while(|file| file.exists()) {
            let name = file.display().to_string();
            let read = polepair(&["convert", &name, "-", "--to", "log"]);
            assert_eq!(read.err.lines().count(), 1, "{name} is whole: {}", read.err);
            parts.extend(frames(&file));
        }
        assert_eq!(parts, frames(&whole), "{name} by {how}");
    }
    drive.end();
}
