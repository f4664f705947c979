//! Output of results: stdout, or a file that is there when it is complete.

use std::io::{self, Write as _};
use std::path::Path;

use crate::output_file::OutputFile;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{colour_out, escape_controls};

/// Bytes that are gathered before they are written.
const BUFFER_SIZE: usize = 1 << 16;

/// Output of data: stdout or a file.
pub struct DataOutput {
    sink: OutputFile,
    name: String,
    buffer: Vec<u8>,
    /// True for text for people, whose control characters are escaped.
    is_text: bool,
}

impl DataOutput {
    /// stdout, for text that people read: control characters of devices, files and names are escaped.
    pub fn stdout() -> Self {
        Self { is_text: true, ..Self::new(OutputFile::stdout(), "stdout") }
    }

    fn new(sink: OutputFile, name: &str) -> Self {
        Self { sink, name: name.to_owned(), buffer: Vec::new(), is_text: false }
    }

    /// Sets whether control characters are escaped. JSON, CSV and files of other formats have the text itself.
    pub fn with_text(self, is_text: bool) -> Self {
        Self { is_text, ..self }
    }

    /// A file, which is there after [`finish`](Self::finish). A file that it replaces is left alone until then.
    pub fn file(path: &Path) -> Result<Self> {
        Ok(Self::new(OutputFile::create(path)?, &path.display().to_string()))
    }

    /// stdout, or the file if there is one; `-` is stdout, as for other programs.
    pub fn to_path(path: Option<&Path>) -> Result<Self> {
        path.filter(|path| path.as_os_str() != "-")
            .map_or_else(|| Ok(Self::stdout().with_text(false)), Self::file)
    }

    /// [`to_path`](Self::to_path) for an input that may never end: a new file can be read while it grows.
    pub fn follow_to_path(path: Option<&Path>) -> Result<Self> {
        match path.filter(|path| path.as_os_str() != "-") {
            None => Self::to_path(None),
            Some(path) => {
                Ok(Self::new(OutputFile::create_followed(path)?, &path.display().to_string()))
            }
        }
    }

    /// Buffer of the next output.
    pub fn buffer(&mut self) -> &mut Vec<u8> {
        &mut self.buffer
    }

    /// Adds a line.
    pub fn write_line(&mut self, text: &str) {
        self.buffer.extend_from_slice(text.as_bytes());
        self.buffer.push(b'\n');
    }

    /// Writes if enough was gathered.
    pub fn flush_if_full(&mut self) -> Result<()> {
        if self.buffer.len() < BUFFER_SIZE { Ok(()) } else { self.flush() }
    }

    /// Writes everything now.
    pub fn flush(&mut self) -> Result<()> {
        if self.is_text {
            escape_controls(&mut self.buffer, colour_out());
        }
        let written = self.sink.write_all(&self.buffer).and_then(|()| self.sink.flush());
        self.buffer.clear();
        written.map_err(|error| self.write_problem(&error))
    }

    /// Writes everything, and gives a file its name. Without this call a file is not there.
    pub fn finish(&mut self) -> Result<()> {
        self.flush()?;
        let sink = std::mem::replace(&mut self.sink, OutputFile::stdout());
        sink.commit().map_err(|error| self.write_problem(&error))
    }

    /// A reader that went away (`| head`) wants no message.
    fn write_problem(&self, error: &io::Error) -> Problem {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Problem::new(Exit::Ok, "", "");
        }
        Problem::new(Exit::Adapter, "E304", format!("cannot write to {}.", self.name))
            .why(format!("The system says: {error}."))
    }
}
