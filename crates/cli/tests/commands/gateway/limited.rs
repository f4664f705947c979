//! A journal at the limit of a file's size, which the kernel reports by SIGXFSZ.

use std::process::Command;

use super::site::{Folder, Site};
use crate::run::{self, Served};

/// Blocks of 512 or 1024 bytes, as the shell counts.
const BLOCKS: u32 = 8;

/// Without a running server nothing can be stopped, so the refusal names another way to stop.
#[test]
fn a_server_that_cannot_write_its_first_record_says_that_it_stops_nothing() {
    let folder = Folder::new();
    let state = folder.path("state");
    // Longer than the limit below.
    let mut site = Site::new(&folder, &["sim:tmcl"]);
    (0..20).for_each(|_| assert_eq!(site.run(&["enable", "1"]).code, 0));
    assert_eq!(site.signal("INT"), Some(0));
    let serve = r#"ulimit -f 1; exec "$0" serve "$@""#;
    let sim = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let ran = Command::new("sh")
        .args(["-c", serve])
        .arg(run::program())
        .arg(&sim.url)
        .args(["--bind", "127.0.0.1:0", "--state", &state])
        .envs(run::environment())
        .output()
        .expect("sh");
    let ran = run::ran(ran);
    assert_eq!(ran.code, 3, "{ran:?}");
    let stops = format!("`polepair stop {}`", sim.link());
    for text in ["error[gateway.journal]", "The server was not started.", "--state", &stops] {
        assert!(ran.err.contains(text), "{text}: {}", ran.err);
    }
    assert!(!ran.err.contains("meanwhile"), "{}", ran.err);
    sim.end();
}

#[test]
fn a_journal_at_its_files_limit_keeps_the_server_and_its_stops() {
    let folder = Folder::new();
    let mut site = Site::limited(&folder, &["sim:tmcl"], &format!("-f {BLOCKS}"));
    let refused = (0..100).map(|_| site.run(&["enable", "1"])).find(|ran| ran.code != 0);
    let refused = refused.expect("a journal that is full");
    assert!(refused.err.contains("gateway.journal"), "{refused:?}");
    let length = std::fs::metadata(folder.path("state/journal.jsonl")).unwrap().len();
    assert!(length <= u64::from(BLOCKS) * 1024, "{length}");
    let stopped = site.run(&["stop", "1"]);
    assert_eq!(stopped.code, 0, "{stopped:?}");
    // Records that could not be written are counted in the last output; the axis is at standstill.
    assert_eq!(site.signal("INT"), Some(0));
    assert!(site.output().contains("journal"), "{}", site.output());
}
