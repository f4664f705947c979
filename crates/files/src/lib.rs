//! Files that are written: whole or not at all, and never over something that is still needed.
//!
//! | file | type |
//! |---|---|
//! | a result: a table, a plot, settings, a converted capture | [`AtomicFile`] |
//! | one that grows while it is written: a recording, a trace | [`create_growing`] |
//!
//! Nothing else in the workspace creates files; a rule of `cargo xtask tidy` holds that.
//!
//! ```
//! use std::io::Write as _;
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("table.csv");
//! let mut file = polepair_files::AtomicFile::create(&path)?;
//! file.write_all(b"1,2\n")?;
//! assert!(!path.exists(), "nothing is seen of it before it is complete");
//! file.commit()?;
//! assert_eq!(std::fs::read(&path)?, b"1,2\n");
//! # Ok::<(), std::io::Error>(())
//! ```
#![forbid(unsafe_code)]

mod atomic;
mod growing;
mod unfinished;

pub use atomic::{AtomicFile, SealedFile, write_atomic, write_private};
pub use growing::{ExistingFile, create_growing};
pub use unfinished::remove_unfinished;

use std::path::Path;

/// Returns whether two paths lead to one file: by device and inode, so links do not hide it. False where either is
/// missing, and for devices and pipes, which are no files that could be lost.
#[must_use]
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    is_regular_file(one)
        && is_regular_file(other)
        && same_file::is_same_file(one, other).unwrap_or(false)
}

fn is_regular_file(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| found.is_file())
}

#[cfg(test)]
mod tests;
