//! Files that verbs write: whether they may replace others, and when.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom, Write};
use std::path::Path;

use polepair_capture::Compression;
use polepair_files::{AtomicFile, ExistingFile, create_growing, is_same_file};

use crate::interrupt;
use crate::problem::{self, Problem, Result};
use crate::terminal::print_note;

/// Treatment of an existing file by the options --force and --append.
pub const fn existing_file(force: bool, append: bool) -> ExistingFile {
    match (force, append) {
        (true, _) => ExistingFile::Replace,
        (_, true) => ExistingFile::Append,
        _ => ExistingFile::Refuse,
    }
}

/// Refuses an output that is one of the inputs, whatever name it has: the output would replace it.
///
/// # Errors
/// `E258`.
pub fn refuse_input<'a>(
    out: Option<&Path>,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> Result<()> {
    let Some(out) = out else { return Ok(()) };
    match inputs.into_iter().find(|input| is_same_file(input, out)) {
        None => Ok(()),
        Some(input) => {
            let what = format!("{} is the input.", out.display());
            let is_link = input != out;
            let same = format!("{} and {} are the same file.", input.display(), out.display());
            Err(Problem::usage("E258", what)
                .why(if is_link { same } else { "Nothing was written.".to_owned() })
                .hint("write to another file; a capture cannot be made again"))
        }
    }
}

/// Target of a verb's result.
pub enum OutputFile {
    /// Read while it is written: stdout, or a new file behind an input that may never end.
    Stream(Box<dyn Write + Send>),
    /// Appears in [`commit`](Self::commit).
    File(Box<AtomicFile>),
}

impl OutputFile {
    /// stdout.
    pub fn stdout() -> Self {
        Self::Stream(if cfg!(test) { Box::new(io::sink()) } else { Box::new(io::stdout()) })
    }

    /// A file that replaces another one when it is complete.
    ///
    /// # Errors
    /// `E301` to `E303` where it cannot be made.
    pub fn create(path: &Path) -> Result<Self> {
        interrupt::remove_files_at_end();
        let file = AtomicFile::create(path).map_err(|error| write_problem(path, &error))?;
        Ok(Self::File(Box::new(file)))
    }

    /// A file that is read while it grows. One that is there already is not lost before the new one is complete.
    ///
    /// # Errors
    /// As for [`create`](Self::create).
    pub fn create_followed(path: &Path) -> Result<Self> {
        match create_growing(path, ExistingFile::Refuse) {
            Ok(file) => Ok(Self::Stream(Box::new(file))),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                print_note(&format!("{} is replaced when the input ends", path.display()));
                Self::create(path)
            }
            Err(error) => Err(write_problem(path, &error)),
        }
    }

    /// Gives a file its name. Without this call it is not there.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn commit(self) -> io::Result<()> {
        match self {
            Self::Stream(mut out) => out.flush(),
            Self::File(file) => file.commit(),
        }
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Stream(out) => out.write(bytes),
            Self::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Stream(out) => out.flush(),
            Self::File(file) => file.flush(),
        }
    }
}

/// Opens a file that grows while it is written.
///
/// # Errors
/// `E259` where it is there and may not be touched, `E301` to `E303` where it cannot be made.
pub fn create_recording(path: &Path, existing: ExistingFile) -> Result<File> {
    let mut file = create_growing(path, existing).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => existing_problem(path),
        _ => write_problem(path, &error),
    })?;
    if existing == ExistingFile::Append && ends_within_line(path) {
        // A recorder that was killed left it; the next record must not become a part of it.
        file.write_all(b"\n").map_err(|error| write_problem(path, &error))?;
    }
    Ok(file)
}

/// Returns whether the last line of a text log has no end. Compressed logs are whole frames that end anywhere.
fn ends_within_line(path: &Path) -> bool {
    Compression::from_path(path).is_none() && read_last_byte(path).is_ok_and(|byte| byte != b'\n')
}

fn read_last_byte(path: &Path) -> std::result::Result<u8, io::Error> {
    let (mut file, mut last) = (File::open(path)?, [0]);
    file.seek(SeekFrom::End(-1))?;
    file.read_exact(&mut last)?;
    io::Result::Ok(last[0])
}

/// Refuses a file that is there and may not be touched, before a link is opened.
///
/// # Errors
/// `E259`.
pub fn check_recording(path: &Path, existing: ExistingFile) -> Result<()> {
    if existing == ExistingFile::Refuse && is_regular_file(path) {
        Err(existing_problem(path))
    } else {
        Ok(())
    }
}

fn is_regular_file(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| found.is_file())
}

fn existing_problem(path: &Path) -> Problem {
    Problem::usage("E259", format!("{} exists.", path.display()))
        .why("It was left as it is.")
        .hint("--append writes behind its content, --force replaces it")
}

fn write_problem(path: &Path, error: &io::Error) -> Problem {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        // A missing directory is another fault than a missing file, which is about to be made.
        Some(folder) if error.kind() == io::ErrorKind::NotFound && !folder.exists() => {
            Problem::new(
                problem::Exit::Adapter,
                "E301",
                format!("cannot write {}.", path.display()),
            )
            .why(format!("There is no folder {}.", folder.display()))
        }
        _ => problem::file_problem(path, "write", error),
    }
}
