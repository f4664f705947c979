//! The notes of a data set: which captures are decoded, and which parts each of them has.
//!
//! | folder | a note for each | its lines |
//! |---|---|---|
//! | `_done` | capture that is decoded, by content | what the rows depend on; then the parts |
//! | `_begun` | the same, while its parts take their places | the parts |
//! | `_sources` | name of a capture | the contents that it had, as far as they are in the data set |
//!
//! Notes are read and written under a lock, so that programs that decode at the same time replace each other's parts
//! one after the other. A note in `_begun` outlives its writer only if that was killed.

use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::path::{Component, Path, PathBuf};

use polepair_files::write_atomic;

use crate::capture_file::CaptureContent;

pub(super) const DONE: &str = "_done";
const BEGUN: &str = "_begun";
const SOURCES: &str = "_sources";

/// Keeps other programs from publishing parts in a data set until it is dropped.
#[derive(Debug)]
pub struct DatasetLock(#[expect(dead_code, reason = "the lock ends with the file")] File);

impl DatasetLock {
    /// Waits for other programs. Makes the folder if it is missing.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn acquire(root: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(root)?;
        let file = open_lock(root)?;
        match file.lock() {
            // Some network file systems have no locks: one program at a time then.
            Err(error) if error.kind() != io::ErrorKind::Unsupported => Err(error),
            _ => Ok(Self(file)),
        }
    }
}

/// Opens the file to lock: the folder itself, so that no file is left in the data set.
#[cfg(unix)]
fn open_lock(root: &Path) -> io::Result<File> {
    File::open(root)
}

/// Folders cannot be locked here.
#[cfg(not(unix))]
fn open_lock(root: &Path) -> io::Result<File> {
    std::fs::OpenOptions::new().append(true).create(true).open(root.join("_lock"))
}

/// The notes below one folder.
#[derive(Debug)]
pub(super) struct DatasetNotes<'a> {
    root: &'a Path,
    _lock: DatasetLock,
}

impl<'a> DatasetNotes<'a> {
    /// Waits for other programs, and keeps them from the notes.
    pub fn lock(root: &'a Path) -> io::Result<Self> {
        let lock = DatasetLock::acquire(root)?;
        std::fs::create_dir_all(root.join(DONE))?;
        Ok(Self { root, _lock: lock })
    }

    /// The parts of a capture, also of one whose decoding was cut off.
    ///
    /// # Errors
    /// A note that cannot be read.
    pub fn parts(&self, blake3: &str) -> io::Result<BTreeSet<PathBuf>> {
        let done = read_lines(&self.root.join(DONE).join(blake3))?.into_iter().skip(1);
        let begun = read_lines(&self.root.join(BEGUN).join(blake3))?;
        // A note that was tampered with reaches nothing outside.
        let is_inside =
            |part: &PathBuf| part.components().all(|it| matches!(it, Component::Normal(_)));
        Ok(done.chain(begun).map(PathBuf::from).filter(is_inside).collect())
    }

    /// Notes that these parts are about to take their places.
    pub fn begin(&self, blake3: &str, parts: &BTreeSet<PathBuf>) -> io::Result<()> {
        std::fs::create_dir_all(self.root.join(BEGUN))?;
        // Parts that an earlier program began stay listed, so that they are found and removed.
        let all: BTreeSet<_> = parts.union(&self.parts(blake3)?).cloned().collect();
        write_atomic(&self.root.join(BEGUN).join(blake3), part_lines(&all).as_bytes())
    }

    /// Notes that a capture is decoded.
    pub fn finish(&self, blake3: &str, inputs: &str, parts: &BTreeSet<PathBuf>) -> io::Result<()> {
        let note = format!("{inputs}\n{}", part_lines(parts));
        write_atomic(&self.root.join(DONE).join(blake3), note.as_bytes())?;
        remove(&self.root.join(BEGUN).join(blake3))
    }

    /// Removes parts, but for those that are still wanted.
    pub fn remove_parts(
        &self,
        parts: &BTreeSet<PathBuf>,
        wanted: &BTreeSet<PathBuf>,
    ) -> io::Result<()> {
        parts.difference(wanted).try_for_each(|part| remove(&self.root.join(part)))
    }

    /// Removes the notes of a capture whose parts are gone.
    pub fn forget(&self, blake3: &str) -> io::Result<()> {
        remove(&self.root.join(DONE).join(blake3))?;
        remove(&self.root.join(BEGUN).join(blake3))
    }

    /// The contents that the capture of that name had.
    ///
    /// # Errors
    /// A note that cannot be read.
    pub fn contents(&self, name: &str) -> io::Result<Vec<CaptureContent>> {
        let lines = read_lines(&self.source_path(name))?;
        Ok(lines.iter().filter_map(|line| CaptureContent::from_line(line)).collect())
    }

    /// Returns whether another capture has this content too.
    pub fn is_shared(&self, blake3: &str, name: &str) -> io::Result<bool> {
        let own = self.source_path(name);
        for entry in std::fs::read_dir(self.root.join(SOURCES))? {
            let path = entry?.path();
            let mut lines = read_lines(&path)?.into_iter();
            if path != own && lines.any(|line| line.starts_with(blake3)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Notes the contents that the capture of that name has.
    pub fn write_contents(&self, name: &str, contents: &[CaptureContent]) -> io::Result<()> {
        std::fs::create_dir_all(self.root.join(SOURCES))?;
        let note: String = contents.iter().map(|it| it.to_line() + "\n").collect();
        write_atomic(&self.source_path(name), note.as_bytes())
    }

    fn source_path(&self, name: &str) -> PathBuf {
        self.root.join(SOURCES).join(text_hash(name))
    }
}

/// BLAKE3 of a text, hexadecimal: the name of a capture's note in `_sources`.
#[must_use]
pub fn text_hash(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

fn part_lines(parts: &BTreeSet<PathBuf>) -> String {
    parts.iter().map(|part| format!("{}\n", part.display())).collect()
}

/// Lines of a note; none where it was never written.
fn read_lines(path: &Path) -> io::Result<Vec<String>> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(text.lines().map(str::to_owned).collect()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        // Taken for empty, it would have parts removed that another capture needs.
        Err(error) => Err(error),
    }
}

/// Removes a file that may be gone already.
fn remove(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
