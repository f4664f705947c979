//! Writes captures in the formats that are read, compressed or not.

mod asc;
mod blf;
mod csv;
mod pcap;
mod pcapng;
mod text;
mod trc;

use core::fmt;
use std::io::{self, Write};

use crate::format::{CaptureFormat, Compression};
use crate::record::Record;

/// Bytes that are gathered before they are passed on.
const BUFFER_BYTES: usize = 1 << 16;

/// Reason why a record cannot be written.
#[derive(Debug)]
pub enum WriteError {
    /// The file cannot be written.
    Io(io::Error),
    /// The format has no place for such a record.
    UnsupportedRecord(&'static str),
    /// The format is not one that records are written in.
    UnsupportedFormat(CaptureFormat),
}

impl fmt::Display for WriteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::UnsupportedRecord(what) => f.write_str(what),
            Self::UnsupportedFormat(format) => {
                write!(f, "captures are not written as {format}")
            }
        }
    }
}

impl std::error::Error for WriteError {}

impl From<io::Error> for WriteError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Writes one format.
trait FormatWriter: fmt::Debug + Send {
    /// Appends a record. Nothing is appended where it does not fit.
    fn append_record(&mut self, record: &Record<'_>, out: &mut Vec<u8>)
    -> Result<(), &'static str>;
    /// Appends the part of the records so far that is held back.
    fn append_pending(&mut self, _out: &mut Vec<u8>) {}
    /// Appends the end of the file.
    fn append_end(&mut self, _out: &mut Vec<u8>) {}
}

/// Writes records to a file.
pub struct CaptureWriter<W: Write> {
    sink: Box<dyn FormatWriter>,
    buffer: Vec<u8>,
    out: OutputStream<W>,
}

#[cfg_attr(
    not(feature = "zstd"),
    expect(clippy::large_enum_variant, reason = "there is one for each file that is written")
)]
enum OutputStream<W: Write> {
    Plain(W),
    Gzip(flate2::write::GzEncoder<W>),
    #[cfg(feature = "zstd")]
    Zstd(zstd::stream::write::Encoder<'static, W>),
}

impl<W: Write> fmt::Debug for CaptureWriter<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Writer").field("sink", &self.sink).finish_non_exhaustive()
    }
}

impl<W: Write> CaptureWriter<W> {
    /// A writer of that format, compressed by `packing`.
    ///
    /// # Errors
    /// [`WriteError::UnsupportedFormat`] for JSONL, which is made by decoding.
    pub fn new(
        format: CaptureFormat,
        packing: Option<Compression>,
        out: W,
    ) -> Result<Self, WriteError> {
        let sink: Box<dyn FormatWriter> = match format {
            CaptureFormat::Text => Box::new(text::TextLogWriter),
            CaptureFormat::Pcap => Box::new(pcap::PcapWriter::default()),
            CaptureFormat::Pcapng => Box::new(pcapng::PcapngWriter::default()),
            CaptureFormat::Asc => Box::new(asc::AscWriter::default()),
            CaptureFormat::Trc => Box::new(trc::TrcWriter::default()),
            CaptureFormat::Blf => Box::new(blf::BlfWriter::default()),
            CaptureFormat::Csv => Box::new(csv::CsvWriter::default()),
            CaptureFormat::Jsonl
            | CaptureFormat::Busmaster
            | CaptureFormat::Crtd
            | CaptureFormat::Sqlite => {
                return Err(WriteError::UnsupportedFormat(format));
            }
        };
        let out = match packing {
            None => OutputStream::Plain(out),
            Some(Compression::Gzip) => OutputStream::Gzip(flate2::write::GzEncoder::new(
                out,
                flate2::Compression::default(),
            )),
            #[cfg(feature = "zstd")]
            Some(Compression::Zstd) => {
                OutputStream::Zstd(zstd::stream::write::Encoder::new(out, 3)?)
            }
            #[cfg(not(feature = "zstd"))]
            Some(Compression::Zstd) => {
                let why = "this program was built without Zstandard (feature `zstd`)";
                return Err(io::Error::new(io::ErrorKind::Unsupported, why).into());
            }
        };
        Ok(Self { sink, buffer: Vec::with_capacity(2 * BUFFER_BYTES), out })
    }

    /// Writes a record.
    ///
    /// # Errors
    /// [`WriteError::UnsupportedRecord`] where the format has no place for it, and nothing is written;
    /// [`WriteError::Io`].
    pub fn write(&mut self, record: &Record<'_>) -> Result<(), WriteError> {
        self.sink.append_record(record, &mut self.buffer).map_err(WriteError::UnsupportedRecord)?;
        if self.buffer.len() >= BUFFER_BYTES { Ok(self.flush_buffer()?) } else { Ok(()) }
    }

    /// Passes on all records so far, so that a file which is never finished can be read to here.
    /// Compressed files grow by it: once a second is often enough.
    ///
    /// # Errors
    /// [`WriteError::Io`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.sink.append_pending(&mut self.buffer);
        self.flush_buffer()?;
        match &mut self.out {
            OutputStream::Plain(out) => out.flush()?,
            OutputStream::Gzip(out) => out.flush()?,
            #[cfg(feature = "zstd")]
            OutputStream::Zstd(out) => out.flush()?,
        }
        Ok(())
    }

    /// Passes on the buffered bytes, compressed or not.
    fn flush_buffer(&mut self) -> io::Result<()> {
        let out: &mut dyn Write = match &mut self.out {
            OutputStream::Plain(out) => out,
            OutputStream::Gzip(out) => out,
            #[cfg(feature = "zstd")]
            OutputStream::Zstd(out) => out,
        };
        out.write_all(&self.buffer)?;
        self.buffer.clear();
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`WriteError::Io`].
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.sink.append_end(&mut self.buffer);
        self.flush_buffer()?;
        Ok(match self.out {
            OutputStream::Plain(out) => out,
            OutputStream::Gzip(out) => out.finish()?,
            #[cfg(feature = "zstd")]
            OutputStream::Zstd(out) => out.finish()?,
        })
    }
}

/// Numbers for the names of links, for formats that count channels: the number at the end of the
/// name, or else the first that is free.
#[derive(Debug, Default)]
struct ChannelNumbers(Vec<(String, u32)>);

/// Limit of links that one file can distinguish by numbers.
const CHANNELS_MAX: usize = 256;

impl ChannelNumbers {
    /// The link's number, from 0.
    fn number_for(&mut self, link: &str) -> Result<u32, &'static str> {
        if let Some((_, number)) = self.0.iter().find(|(name, _)| name == link) {
            return Ok(*number);
        }
        if self.0.len() >= CHANNELS_MAX {
            return Err("more links than this format counts");
        }
        let digits = link.bytes().rev().take_while(u8::is_ascii_digit).count();
        let reported = link[link.len() - digits..].parse::<u32>().ok().filter(|n| *n < 255);
        let free = |number: &u32| !self.0.iter().any(|(_, other)| other == number);
        let number = reported.filter(free).or_else(|| (0..).find(free)).unwrap_or(0);
        self.0.push((link.to_owned(), number));
        Ok(number)
    }
}

const NO_SERIAL: &str =
    "this format holds CAN frames alone: write a serial capture as log or pcapng";

#[cfg(test)]
mod tests;
