//! Temporary files of this process, so that it can remove them when a signal ends it.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn lock() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the temporary files of everything that is being written, because the process ends now. Returns how many
/// there were.
pub fn remove_unfinished() -> usize {
    // Stays locked: a file that is begun or completed on another thread waits for the end of the process.
    let unfinished = std::mem::ManuallyDrop::new(lock());
    for path in unfinished.iter() {
        // It has no other name, so nothing of value is lost where it stays.
        let _ = std::fs::remove_file(path);
    }
    unfinished.len()
}

/// The temporary file of that path is being written until this is dropped.
#[derive(Debug)]
pub struct UnfinishedMark(PathBuf);

impl UnfinishedMark {
    pub fn new(path: &Path) -> Self {
        lock().push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for UnfinishedMark {
    fn drop(&mut self) {
        lock().retain(|path| *path != self.0);
    }
}
