//! `polepair summary FILE|- [--as PROTO[@ID],…] [--from FORMAT] [--format text|json]`

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use polepair_capture::parallel::BatchConsumer;
use polepair_capture::summary::{Summary, SummaryStyle, render_text, to_json};
use polepair_capture::{CaptureDecoder, DecodedFrame, FrameBatch};

use crate::capture::{CaptureArgs, CaptureSource, EventSink, is_stream, report_left_out};
use crate::data_output::DataOutput;
use crate::output_file;
use crate::problem::{Exit, Problem, Result};
use crate::terminal;

/// Summarises a capture: axes, states, response times, faults.
///
/// The summary shows links and bus load, axes and their states, requests and response times, periodic
/// frames, faults with cause and remedy, and the ten most unusual moments. The exit code is 1 if the
/// capture has a fault or an anomaly.
#[derive(Args, Debug)]
#[command(after_help = "\
Without --bitrate, the bit rate is estimated from the shortest distance between frames (~500 kbit/s).
The bus load includes stuff bits; its peak is measured over 100 ms. Response times and periods are
exact to 3 %.

Examples:
  polepair summary bus.log
  polepair summary bus.blf --as canopen@2,thruster@11 --bitrate 500000
  polepair summary bus.log --format json | jq .moments")]
pub struct SummaryOptions {
    /// Capture to read; - for stdin
    #[arg(value_name = "FILE|-")]
    source: PathBuf,
    #[command(flatten)]
    stated: CaptureArgs,
    /// Bit rate of all links, or of each: 500000, can0=500000,ttyUSB0=9600
    #[arg(long, value_name = "[LINK=]N,…")]
    bitrate: Option<String>,
    /// Output format
    #[arg(long, value_enum, default_value_t = SummaryFormat::Text)]
    format: SummaryFormat,
    /// File to write instead of stdout
    #[arg(short, long = "out", value_name = "OUT")]
    out: Option<PathBuf>,
}

/// Output formats of `summary`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum SummaryFormat {
    /// Text
    Text,
    /// One JSON object
    Json,
}

impl SummaryOptions {
    pub fn run(self) -> Result {
        let source = self.stated.source()?;
        let inputs = [self.source.as_path(), Path::new(self.stated.profile_word())];
        output_file::refuse_input(self.out.as_deref(), inputs)?;
        let manner = SummaryStyle {
            colour: self.out.is_none() && terminal::colour_out(),
            rates: self.bitrate.as_deref().map_or(Ok(Vec::new()), parse_rates)?,
            product: source.profile,
        };
        let (summary, decoder) = summarize(source, &self.source)?;
        let read = require_frames(&decoder, &self.source)?;
        let is_text = self.format == SummaryFormat::Text;
        let mut out = DataOutput::to_path(self.out.as_deref())?.with_text(is_text);
        match self.format {
            SummaryFormat::Text => out.buffer().extend(render_text(&summary, &manner).bytes()),
            SummaryFormat::Json => {
                out.write_line(&to_json(&summary, &manner, decoder.statistics()).to_string())
            }
        }
        out.finish()?;
        Ok(if summary.is_clean() { read } else { Exit::Negative })
    }
}

/// Prints the parts of a capture that were left out, and refuses one without frames.
///
/// # Errors
/// `E115`; `E510` for a file that is no capture.
pub fn require_frames(decoder: &CaptureDecoder, path: &Path) -> Result {
    let read = report_left_out(decoder)?;
    match decoder.statistics().records {
        0 => Err(Problem::new(Exit::Negative, "E115", "there are no frames.")
            .why(format!("{} has no records.", path.display()))),
        _ => Ok(read),
    }
}

/// Summarises a capture.
pub fn summarize(source: CaptureSource, path: &Path) -> Result<(Summary, CaptureDecoder)> {
    let (source, mut sink) = (source.without_words(), SummarySink::default());
    if is_stream(path) {
        let decoder = source.decode(path, &mut sink)?;
        return Ok((sink.summary, decoder));
    }
    let sinks = core::slice::from_mut(&mut sink);
    let mut decoder = source.decode_parallel(path, sinks, &mut |_| Ok(()))?;
    decoder.finish_sessions(&mut |event| sink.handle_final(event));
    Ok((sink.summary, decoder))
}

/// A summary that is being made.
#[derive(Default)]
struct SummarySink {
    summary: Summary,
}

impl BatchConsumer for SummarySink {
    fn consume(&mut self, batch: &FrameBatch) {
        self.summary.add_batch(batch);
    }
}

impl EventSink for SummarySink {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        self.summary.add_frame(event);
    }

    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        self.summary.add_open_notices(event);
    }
}

/// Reads `500000` or `can0=500000,ttyUSB0=9600`.
fn parse_rates(text: &str) -> Result<Vec<(String, u32)>> {
    text.split(',')
        .map(|part| {
            let (link, rate) = part.split_once('=').unwrap_or(("", part));
            let rate = rate.trim().parse().ok().filter(|rate| *rate > 0);
            rate.map(|rate| (link.trim().to_owned(), rate)).ok_or_else(|| {
                Problem::usage("E242", format!("{part:?} is not a bit rate."))
                    .hint("--bitrate 500000, or --bitrate can0=500000,ttyUSB0=9600")
            })
        })
        .collect()
}
