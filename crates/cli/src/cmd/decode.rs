//! `polepair decode FILE|- [--as PROTO[@ID],…] [--from FORMAT] [--format text|jsonl] [-o OUT]`

mod lines;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use crate::capture::{Sink, Stated, report};
use crate::problem::Result;
use lines::Lines;

/// Explains every frame of a capture.
///
/// Reads candump and serial logs, pcap, pcapng, Vector ASC and BLF, PEAK TRC, python-can's CSV and its
/// own JSONL, also as .gz and .zst, from a file or from stdin. Without --as the whole capture is weighed
/// against every protocol, and the verdict goes to stderr.
#[derive(Args, Debug)]
#[command(after_help = "\
A log has one line for each CAN frame, or for each run of serial bytes:
  (1700000000.000500) can0 30B#5443000000000005
  (1700000000.000500) ttyUSB0 > 01 01 00 00 00 00 01 5E 61     > host to drive, < drive to host

Examples:
  polepair decode capture.log
  polepair decode capture.log --as tmcl --format jsonl -o frames.jsonl
  polepair decode machine.blf
  polepair decode bus.log --as canopen@2,thruster@11 --profile syntron-ts-canopen
  tail -f bus.log | polepair decode - --as modbus-rtu@ttyUSB0,tmcl@ttyUSB1")]
pub struct Decode {
    /// The capture; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    #[command(flatten)]
    stated: Stated,
    /// How frames are written [default: text, or jsonl if OUT ends so]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write to a file instead of stdout
    #[arg(short, long = "out", value_name = "OUT")]
    out: Option<PathBuf>,
}

/// How frames are written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// One aligned line a frame
    Text,
    /// One JSON object a frame
    Jsonl,
}

impl Decode {
    pub fn run(self) -> Result {
        let source = self.stated.source()?;
        let mut sink = self.sink(self.out.as_deref())?;
        let decoder = source.read(&self.source, &mut *sink)?;
        report(&decoder)
    }

    fn sink(&self, out: Option<&Path>) -> Result<Box<dyn Sink>> {
        Ok(match self.format() {
            Format::Text => Box::new(Lines::text(out)?),
            Format::Jsonl => Box::new(Lines::jsonl(out)?),
        })
    }

    fn format(&self) -> Format {
        let jsonl = |out: &PathBuf| out.extension().is_some_and(|end| end == "jsonl");
        let by_name = self.out.as_ref().filter(|out| jsonl(out)).map(|_| Format::Jsonl);
        self.format.or(by_name).unwrap_or(Format::Text)
    }
}
