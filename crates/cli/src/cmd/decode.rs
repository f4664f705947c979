//! `polepair decode FILE|- [--as PROTO[@ID],…] [--from FORMAT] [--filter EXPR] [--format text|jsonl]
//! [-o OUT]`

mod filtered;
mod lines;
mod plot;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use polepair_capture::Filter;
use polepair_capture::text::{Notices, Style};

use crate::capture::{Sink, Stated, report};
use crate::problem::{Problem, Result};
use filtered::Filtered;
use lines::Lines;
use plot::Drawing;

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
  polepair decode machine.blf --filter 'axis = 2 and not ok'
  polepair decode bus.log --plot '*/Actual/Position' -o position.svg
  polepair decode bus.log --as canopen@2,thruster@11 --profile syntron-ts-canopen
  tail -f bus.log | polepair decode - --as modbus-rtu@ttyUSB0,tmcl@ttyUSB1")]
pub struct Decode {
    /// The capture; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    #[command(flatten)]
    stated: Stated,
    /// Only frames of which this is true: 'axis = 2 and not ok', 'odd', 'signal Actual/* > 5'
    #[arg(long, value_name = "EXPR")]
    filter: Option<String>,
    /// How frames are written [default: text, or jsonl if OUT ends so]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// What is told below the frames: nothing, what is odd, faults and states, or values too
    #[arg(long, value_enum, default_value_t = Told::Events)]
    notices: Told,
    /// Mark bytes that changed since the last frame of their kind where there is no colour
    #[arg(long)]
    changes: bool,
    /// Draw signals instead of the frames: Actual/Position, '2/Setpoint/*'; with -o FILE.svg, there
    #[arg(long, value_name = "SIGNAL", num_args = 1.., conflicts_with = "format")]
    plot: Vec<String>,
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

/// What is told of conversations.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Told {
    /// Frames alone
    None,
    /// What is odd, faults, changes of states
    Events,
    /// Values too
    All,
}

impl Decode {
    pub fn run(self) -> Result {
        let source = self.stated.source()?;
        let filter = self.filter.as_deref().map(filter).transpose()?;
        let mut sink = self.sink(self.out.as_deref())?;
        if let Some(filter) = filter {
            sink = Box::new(Filtered::new(filter, sink));
        }
        let decoder = source.read(&self.source, &mut *sink)?;
        report(&decoder)
    }

    fn sink(&self, out: Option<&Path>) -> Result<Box<dyn Sink>> {
        if !self.plot.is_empty() {
            return Ok(Box::new(Drawing::new(&self.plot, out)));
        }
        Ok(match self.format() {
            Format::Text => Box::new(Lines::text(out, self.style())?),
            Format::Jsonl => Box::new(Lines::jsonl(out)?),
        })
    }

    fn style(&self) -> Style {
        let notices = match self.notices {
            Told::None => Notices::None,
            Told::Events => Notices::Events,
            Told::All => Notices::All,
        };
        Style { marks: self.changes, notices, ..Style::default() }
    }

    fn format(&self) -> Format {
        let jsonl = |out: &PathBuf| out.extension().is_some_and(|end| end == "jsonl");
        let by_name = self.out.as_ref().filter(|out| jsonl(out)).map(|_| Format::Jsonl);
        self.format.or(by_name).unwrap_or(Format::Text)
    }
}

/// Reads a filter, or shows where it is wrong.
fn filter(text: &str) -> Result<Filter> {
    Filter::parse(text).map_err(|error| {
        let nearest = error.nearest.as_ref().map(|word| format!("{word} (the nearest)"));
        Problem::usage("E249", "this is no filter.")
            .why(error.to_string())
            .hint_if(nearest)
            .hint("polepair decode FILE --filter 'axis = 2 and not ok'; docs/reference/filter.md")
    })
}
