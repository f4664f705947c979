//! The file that `--trace` writes. A file that takes nothing stands in no motion's way: it is told.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use polepair_link::tap::Log;

use crate::problem::{self, Result};
use crate::target::link_name;
use crate::terminal::say;

/// Frames as a capture that `polepair decode` reads.
pub type Trace = Log<TraceFile>;

/// Makes the file, for the frames of a link.
///
/// # Errors
/// `E301` to `E303` where it cannot be made.
pub fn create(path: &Path, url: &str) -> Result<Trace> {
    let file = File::create(path).map_err(|error| problem::file(path, "write", &error))?;
    let name = path.display().to_string();
    let file = TraceFile { to: BufWriter::new(file), name, is_short: false };
    Ok(Log::new(file, &link_name(url)))
}

/// A file that says once that it could not be written.
#[derive(Debug)]
pub struct TraceFile {
    to: BufWriter<File>,
    name: String,
    is_short: bool,
}

impl TraceFile {
    /// Says of the first write that failed that frames are missing.
    fn note<T>(&mut self, written: io::Result<T>) -> io::Result<T> {
        if let Err(error) = &written
            && !self.is_short
        {
            self.is_short = true;
            say(&format!("warning: {}: {error}; frames are missing in it", self.name));
        }
        written
    }
}

impl Write for TraceFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.to.write(bytes);
        self.note(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let written = self.to.flush();
        self.note(written)
    }
}

impl Drop for TraceFile {
    fn drop(&mut self) {
        // It was said, and nobody is left to be told.
        let _ = self.flush();
    }
}
