//! Files that are looked at while they grow.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::Path;

/// Treatment of an existing file.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ExistingFile {
    /// The file is kept, and the call fails.
    #[default]
    Refuse,
    /// The content of the file is lost.
    Replace,
    /// The new content is written behind it.
    Append,
}

/// Opens a file that is written piece by piece, under its own name from the beginning. Devices and pipes are opened
/// with any value of `existing`.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] where a file is there and may not be touched; others of the operating system.
pub fn create_growing(path: &Path, existing: ExistingFile) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let is_device = std::fs::metadata(path).is_ok_and(|found| !found.is_file());
    match existing {
        _ if is_device => options.write(true),
        ExistingFile::Refuse => options.write(true).create_new(true),
        ExistingFile::Replace => options.write(true).create(true).truncate(true),
        ExistingFile::Append => options.append(true).create(true),
    };
    options.open(path)
}
