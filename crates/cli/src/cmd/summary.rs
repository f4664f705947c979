//! `polepair summary FILE|- [--as PROTO[@ID],…] [--from FORMAT] [--format text|json]`

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use polepair_capture::Event;
use polepair_capture::summary::{Manner, Summary, json, text};

use crate::capture::{Sink, Stated, report};
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, Output};

/// Tells what a capture holds: who was there, what they did, what went wrong.
///
/// Links and their load, axes and their states, requests and how long answers took, what came
/// regularly, faults with cause and remedy, and the ten oddest moments with the frame that told each.
/// Exits with 1 where there was a fault or something odd.
#[derive(Args, Debug)]
#[command(after_help = "\
Bit rates are estimated by how close frames came (~500 kbit/s), where that tells. The load counts
stuff bits; its peak is over 100 ms. Latencies and periods are right to 3 %.

Examples:
  polepair summary bus.log
  polepair summary bus.blf --as canopen@2,thruster@11 --bitrate 500000
  polepair summary bus.log --format json | jq .moments")]
pub struct Options {
    /// The capture; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    #[command(flatten)]
    stated: Stated,
    /// Bit rate of all links, or of some: 500000, can0=500000,ttyUSB0=9600
    #[arg(long, value_name = "[LINK=]N,…")]
    bitrate: Option<String>,
    /// How it is written
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Write to a file instead of stdout
    #[arg(short, long = "out", value_name = "OUT")]
    out: Option<PathBuf>,
}

/// How a summary is written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// For people
    Text,
    /// One JSON object
    Json,
}

impl Options {
    pub fn run(self) -> Result {
        let source = self.stated.source()?;
        let manner = Manner {
            colour: self.out.is_none() && terminal::colour_out(),
            rates: self.bitrate.as_deref().map_or(Ok(Vec::new()), rates)?,
            product: source.profile,
        };
        let mut gathered = Gathered::default();
        let decoder = source.read(&self.source, &mut gathered)?;
        report(&decoder)?;
        let mut out = Output::to(self.out.as_deref())?;
        match self.format {
            Format::Text => out.buffer().extend(text(&gathered.summary, &manner).bytes()),
            Format::Json => out.line(&json(&gathered.summary, &manner).to_string()),
        }
        out.flush()?;
        Ok(if gathered.summary.is_clean() { Exit::Ok } else { Exit::Negative })
    }
}

/// A summary that is being made.
#[derive(Default)]
pub struct Gathered {
    /// What was told so far.
    pub summary: Summary,
}

impl Sink for Gathered {
    fn take(&mut self, event: &Event<'_>) {
        self.summary.take(event);
    }

    fn ending(&mut self, event: &Event<'_>) {
        self.summary.ending(event);
    }
}

/// Reads `500000` or `can0=500000,ttyUSB0=9600`.
fn rates(text: &str) -> Result<Vec<(String, u32)>> {
    let rate = |part: &str| {
        let (link, rate) = part.split_once('=').unwrap_or(("", part));
        let rate = rate.trim().parse().ok().filter(|rate| *rate > 0);
        rate.map(|rate| (link.trim().to_owned(), rate)).ok_or_else(|| {
            Problem::usage("E242", format!("{part:?} is no bit rate."))
                .hint("--bitrate 500000, or --bitrate can0=500000,ttyUSB0=9600")
        })
    };
    text.split(',').map(rate).collect()
}
