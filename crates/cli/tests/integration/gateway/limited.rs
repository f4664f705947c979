//! A journal that meets the limit of a file's size, which the kernel tells by SIGXFSZ.

use super::site::{Folder, Site};

/// Blocks of 512 or 1024 bytes, as the shell counts.
const BLOCKS: u32 = 8;

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
    // What was not written is said at the end; the axis stands.
    assert_eq!(site.signal("INT"), Some(0));
    assert!(site.said().contains("journal"), "{}", site.said());
}
