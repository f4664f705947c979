//! The file of `--trace`. A write error is reported, and must not prevent motion or stops.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use polepair_files::ExistingFile;
use polepair_link::tap::TraceWriter;

use crate::output_file::{create_recording, existing_file};
use crate::problem::Result;
use crate::terminal::print_warning;

/// Frames as a capture that `polepair decode` reads.
pub type FrameTrace = TraceWriter<TraceFile>;

/// Option --trace, and the treatment of an existing file.
#[derive(Args, Debug)]
pub struct TraceArgs {
    /// File for the frames, in a format that `decode` reads; an existing one is not overwritten
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Replace the file of --trace if it exists
    #[arg(long, requires = "trace")]
    force: bool,
    /// Write behind the content of the file of --trace if it exists
    #[arg(long, requires = "trace", conflicts_with = "force")]
    append: bool,
}

impl TraceArgs {
    /// The file, if there is to be one.
    pub fn path(&self) -> Option<&Path> {
        self.trace.as_deref()
    }

    /// Treatment of an existing file.
    pub const fn existing(&self) -> ExistingFile {
        existing_file(self.force, self.append)
    }

    /// Makes the file, for the frames of a link.
    ///
    /// # Errors
    /// As for [`create_recording`].
    pub fn create(&self, url: &str) -> Result<Option<FrameTrace>> {
        self.path().map(|path| create_trace(path, self.existing(), url)).transpose()
    }
}

/// Makes the file, for the frames of a link.
fn create_trace(path: &Path, existing: ExistingFile, url: &str) -> Result<FrameTrace> {
    let file = create_recording(path, existing)?;
    let name = path.display().to_string();
    let file = TraceFile { file: BufWriter::new(file), name, has_failed: false };
    Ok(TraceWriter::new(file, &link_name(url)))
}

/// A file that reports its first failed write.
#[derive(Debug)]
pub struct TraceFile {
    file: BufWriter<File>,
    name: String,
    has_failed: bool,
}

impl TraceFile {
    /// Reports at the first failed write that frames are missing.
    fn report_failure<T>(&mut self, written: io::Result<T>) -> io::Result<T> {
        if let Err(error) = &written
            && !self.has_failed
        {
            self.has_failed = true;
            print_warning(&format!(
                "warning: {}: {error}; frames are missing in the file",
                self.name
            ));
        }
        written
    }
}

impl Write for TraceFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes);
        self.report_failure(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let written = self.file.flush();
        self.report_failure(written)
    }
}

impl Drop for TraceFile {
    fn drop(&mut self) {
        // The failure was reported before.
        let _ = self.flush();
    }
}

/// The last part of the link's address, as captures name links.
pub fn link_name(url: &str) -> String {
    let link = url.split(['?', '#']).next().unwrap_or(url);
    let name = link.rsplit('/').next().unwrap_or(link);
    name.split(':').find(|part| !part.is_empty()).unwrap_or("link").to_owned()
}
