//! Output files of a recording: one file, or several in rotation.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use polepair_capture::{CaptureFormat, CaptureWriter, Compression, Record, WriteError};
use polepair_core::time::Instant;
use polepair_files::ExistingFile;
use polepair_link::clock;

use crate::capture::write_problem;
use crate::output_file;
use crate::problem::{Problem, Result};
use crate::value;

/// After how much another file begins.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Rotation {
    /// Bytes on the disk.
    Size(u64),
    /// After this time.
    Time(Duration),
}

impl Rotation {
    /// Reads `100MB`, `2GB`, `500kB`, or a span of time.
    ///
    /// # Errors
    /// The fault of the text, in words.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        const UNITS: [(&str, f64); 3] = [("kB", 1e3), ("MB", 1e6), ("GB", 1e9)];
        let size = UNITS.iter().find_map(|(unit, bytes)| {
            Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * bytes)
        });
        match size {
            Some(bytes) if bytes >= 1e3 => Ok(Self::Size(bytes as u64)),
            Some(_) => Err("less than 1 kB".to_owned()),
            None => match value::parse_span(text) {
                Ok(seconds) if seconds >= 1.0 => Ok(Self::Time(Duration::from_secs_f64(seconds))),
                Ok(_) => Err("less than 1 s".to_owned()),
                Err(_) => Err("100MB, 2GB, 30min, 1h".to_owned()),
            },
        }
    }
}

/// The file of a recording, or the files of one with rotation.
#[derive(Debug)]
pub struct RecordingPlace {
    pub path: PathBuf,
    pub format: CaptureFormat,
    pub rotation: Option<Rotation>,
    /// Treatment of an existing file. With rotation it is passed over, because a recording of several days must not end
    /// at a name.
    pub existing: ExistingFile,
}

impl RecordingPlace {
    /// Refuses a file that may not be touched, before a link is opened.
    ///
    /// # Errors
    /// `E259`; `E248` for a format that nothing can be appended to.
    pub fn check(&self) -> Result<()> {
        if self.existing == ExistingFile::Append && self.format != CaptureFormat::Text {
            let what = format!("nothing can be appended to {}.", self.format);
            return Err(Problem::usage("E248", what).hint("--append works for text logs (.log)"));
        }
        match self.rotation {
            Some(_) => Ok(()),
            None => output_file::check_recording(&self.path, self.existing),
        }
    }
}

/// Files of a recording.
pub struct CaptureFiles {
    place: RecordingPlace,
    current: OpenCapture,
    /// The number in the name of the current file, from 1.
    number: u32,
    files: u32,
    records: u64,
}

/// The file that is written.
struct OpenCapture {
    path: PathBuf,
    writer: CaptureWriter<CountingFile>,
    bytes: Rc<Cell<u64>>,
    since: Instant,
}

impl CaptureFiles {
    /// Begins the first file.
    pub fn create(place: RecordingPlace) -> Result<Self> {
        place.check()?;
        let (number, current) = match place.rotation {
            Some(_) => OpenCapture::create_numbered(&place, 1)?,
            None => (1, OpenCapture::create(place.path.clone(), place.existing, place.format)?),
        };
        Ok(Self { place, current, number, files: 1, records: 0 })
    }

    /// Keeps a record.
    pub fn write(&mut self, record: &Record<'_>) -> Result<()> {
        if self.is_due() {
            self.start_next()?;
        }
        self.records += 1;
        let written = self.current.writer.write(record);
        written.map_err(|error| write_problem(&self.current.path, &error))
    }

    /// Brings the file up to date.
    pub fn flush(&mut self) -> Result<()> {
        self.current.writer.flush().map_err(|error| write_problem(&self.current.path, &error))
    }

    /// Completes the last file. Returns how many records there are, and how many files.
    pub fn finish(self) -> Result<(u64, u32)> {
        self.current.finish()?;
        Ok((self.records, self.files))
    }

    fn is_due(&self) -> bool {
        match self.place.rotation {
            None => false,
            Some(Rotation::Size(bytes)) => self.current.bytes.get() >= bytes,
            Some(Rotation::Time(span)) => clock::now().since(self.current.since) >= span,
        }
    }

    fn start_next(&mut self) -> Result<()> {
        let (number, next) = OpenCapture::create_numbered(&self.place, self.number + 1)?;
        (self.number, self.files) = (number, self.files + 1);
        // The next file is open before the last one ends: without room for it the last one goes on.
        std::mem::replace(&mut self.current, next).finish()
    }
}

impl OpenCapture {
    /// The next file of a rotation, and its number. Names of files that are there and may not be replaced are passed
    /// over.
    fn create_numbered(place: &RecordingPlace, mut number: u32) -> Result<(u32, Self)> {
        loop {
            let path = numbered_path(&place.path, number);
            if output_file::check_recording(&path, place.existing).is_ok() {
                return Ok((number, Self::create(path, place.existing, place.format)?));
            }
            debug_assert!(number < u32::MAX);
            number += 1;
        }
    }

    fn create(path: PathBuf, existing: ExistingFile, format: CaptureFormat) -> Result<Self> {
        let file = output_file::create_recording(&path, existing)?;
        let bytes = Rc::new(Cell::new(0));
        let counted = CountingFile { file, bytes: Rc::clone(&bytes) };
        let writer = CaptureWriter::new(format, Compression::from_path(&path), counted);
        let writer = writer.map_err(|error| write_problem(&path, &error))?;
        Ok(Self { path, writer, bytes, since: clock::now() })
    }

    fn finish(self) -> Result<()> {
        let written = self.writer.finish().and_then(|mut file| Ok(file.flush()?));
        written.map_err(|error: WriteError| write_problem(&self.path, &error))
    }
}

/// `bus-0002.log.zst` for `bus.log.zst`.
fn numbered_path(path: &Path, number: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // At the first dot, so that `a.pcapng.zst` keeps both of its endings.
    let (stem, ends) = name.split_at(name.find('.').unwrap_or(name.len()));
    path.with_file_name(format!("{stem}-{number:04}{ends}"))
}

/// A file whose bytes are counted.
struct CountingFile {
    file: File,
    bytes: Rc<Cell<u64>>,
}

impl Write for CountingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.bytes.set(self.bytes.get() + count as u64);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::{Rotation, numbered_path};
    use std::time::Duration;

    #[test]
    fn sizes_and_times() {
        assert_eq!(Rotation::parse("1.5MB"), Ok(Rotation::Size(1_500_000)));
        assert_eq!(Rotation::parse("2min"), Ok(Rotation::Time(Duration::from_secs(120))));
        assert!(Rotation::parse("5").is_err() && Rotation::parse("10 rpm").is_err());
        assert!(Rotation::parse("0.1kB").is_err() && Rotation::parse("1ms").is_err());
    }

    #[test]
    fn numbers_stand_before_the_ends_of_a_name() {
        let name = |path: &str| numbered_path(path.as_ref(), 12).display().to_string();
        assert_eq!(name("/tmp/a.b/bus.log.zst"), "/tmp/a.b/bus-0012.log.zst");
        assert_eq!(name("bus"), "bus-0012");
    }
}
