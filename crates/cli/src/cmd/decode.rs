//! `polepair decode FILE|-|DIR [--as PROTO[@ID],…] [--from FORMAT] [--filter EXPR]
//! [--format text|jsonl|parquet|arrow] [--tables TABLE,…] [-o OUT]`

mod expect;
mod filtered_sink;
mod line_sink;
mod plot_sink;
#[cfg(not(feature = "tables"))]
#[path = "decode/tables_left_out.rs"]
mod tables;
#[cfg(feature = "tables")]
pub mod tables;

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use polepair_capture::FrameFilter;
use polepair_capture::text::{NoticeLevel, TextStyle};

use crate::capture::{CaptureArgs, EventSink, is_stream, job_count, report_left_out};
use crate::data_output::DataOutput;
use crate::output_file;
use crate::problem::{Problem, Result};
use crate::terminal;
use crate::value;
use expect::Expectation;
use filtered_sink::FilteredSink;
use line_sink::LineSink;
use plot_sink::PlotSink;

/// Decodes every frame of a capture and explains its fields.
///
/// Reads candump and serial logs, pcap, pcapng, Vector ASC and BLF, PEAK TRC, the CSV of python-can, and
/// its own JSONL. Files may be compressed (.gz, .zst); stdin works too. Without --as, the command detects
/// the protocol and prints the result on stderr.
///
/// With --format parquet or arrow, OUT is a folder with four tables: frames, signals, transactions, events.
/// If the input is a folder of captures, OUT becomes a data set partitioned by site, date and bus. Captures
/// that the data set already contains are skipped.
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
  polepair decode capture.log --format parquet --tables frames,signals -o columns
  polepair decode capture.log -o columns.parquet             # a folder with all tables
  polepair decode captures --site plant-2 -o dataset
  polepair decode capture.log --expect good.jsonl --within 5ms   # compares with expected lines
  tail -f bus.log | polepair decode - --as modbus-rtu@ttyUSB0,tmcl@ttyUSB1")]
pub struct Decode {
    /// Capture, or folder of captures; - for stdin
    #[arg(value_name = "FILE|-|DIR")]
    source: PathBuf,
    #[command(flatten)]
    stated: CaptureArgs,
    /// Decode only frames that match an expression: 'axis = 2 and not ok', 'odd', 'signal Actual/* > 5'
    #[arg(long, value_name = "EXPR")]
    filter: Option<String>,
    /// Output format [default: from the name of OUT (.jsonl, .parquet, .arrow), else text]
    #[arg(long, value_enum)]
    format: Option<DecodeFormat>,
    /// Notices to print below the frames
    #[arg(long, value_enum, default_value_t = NoticeLevelArg::Events)]
    notices: NoticeLevelArg,
    /// Mark changed bytes even without colour
    #[arg(long)]
    changes: bool,
    /// Plot signals instead of printing frames: Actual/Position, '2/Setpoint/*'; -o FILE.svg writes a
    /// picture
    #[arg(long, value_name = "SIGNAL", num_args = 1.., conflicts_with = "format")]
    plot: Vec<String>,
    /// Tables to write, separated by commas [default: all]
    #[arg(long, value_name = "TABLE,…")]
    tables: Option<String>,
    /// Name of the recording device, for the column `source`
    #[arg(long, value_name = "NAME", default_value = "local")]
    gateway: String,
    /// Name of the site, for the partition of a data set
    #[arg(long, value_name = "NAME", default_value = "local")]
    site: String,
    /// File to write instead of stdout; for tables, a folder
    #[arg(short, long = "out", value_name = "OUT")]
    out: Option<PathBuf>,
    /// Number of decoding threads [default: one for each core]
    #[arg(long, value_name = "N", value_parser = parse_threads)]
    jobs: Option<usize>,
    /// Compare with a file of expected JSONL lines, complete or in part; the exit code is 1 if they differ
    #[arg(long, value_name = "EXPECTED", conflicts_with_all = ["format", "out", "changes", "plot"])]
    expect: Option<PathBuf>,
    /// Time tolerance for --expect, counted from the first line [default: times are not compared]
    #[arg(long, value_name = "TIME", requires = "expect", value_parser = value::parse_span)]
    within: Option<f64>,
}

/// Reads how many threads there shall be.
fn parse_threads(text: &str) -> std::result::Result<usize, String> {
    let count = text.parse().ok().filter(|count| *count > 0);
    count.ok_or_else(|| "a number from 1".to_owned())
}

/// Output formats of `decode`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum DecodeFormat {
    /// One aligned line for each frame
    Text,
    /// One JSON object for each frame
    Jsonl,
    /// Compressed columns
    Parquet,
    /// Columns in Arrow's memory layout
    Arrow,
}

/// Notices that `decode` prints.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum NoticeLevelArg {
    /// No notices
    None,
    /// Anomalies, faults and state changes
    Events,
    /// Events, and values that changed
    All,
}

impl Decode {
    pub fn run(self) -> Result {
        let columns = matches!(self.output_format(), DecodeFormat::Parquet | DecodeFormat::Arrow);
        if self.filter.is_some() && (columns || self.source.is_dir()) {
            let why = "Tables contain all frames; filter them where they are read.";
            return Err(Problem::usage("E250", "tables cannot be filtered.").why(why));
        }
        if self.source.is_dir() {
            self.refuse_single_file_options()?;
            return self.decode_folder();
        }
        if columns {
            return self.decode_columns();
        }
        output_file::refuse_input(self.out.as_deref(), self.inputs())?;
        let elsewhere = self.out.is_some() || !std::io::stdout().is_terminal();
        let source = self.stated.source()?.with_progress(elsewhere);
        let filter = self.filter.as_deref().map(parse_filter).transpose()?;
        if let Some(path) = &self.expect {
            return expect::run_test(
                source,
                &self.source,
                filter,
                Expectation::read(path, self.within)?,
            );
        }
        if filter.is_none() && self.plot.is_empty() && !is_stream(&self.source) {
            let lines = self.open_lines(self.out.as_deref())?;
            return report_left_out(&lines.write_file(
                source,
                &self.source,
                job_count(self.jobs),
            )?);
        }
        let mut sink = self.open_sink(self.out.as_deref())?;
        if let Some(filter) = filter {
            sink = Box::new(FilteredSink::new(filter, sink));
        }
        let decoder = source.decode(&self.source, &mut *sink)?;
        report_left_out(&decoder)
    }

    /// The files that are read.
    fn inputs(&self) -> [&Path; 2] {
        [&self.source, Path::new(self.stated.profile_word())]
    }

    /// Refuses options for a folder that are for one capture.
    fn refuse_single_file_options(&self) -> Result<()> {
        let requests = [
            (self.expect.is_some(), "--expect"),
            (!self.plot.is_empty(), "--plot"),
            (self.changes, "--changes"),
        ];
        let Some((_, option)) = requests.into_iter().find(|(is, _)| *is) else { return Ok(()) };
        Err(Problem::usage("E250", format!("{option} takes one capture, not a folder."))
            .why("A folder of captures becomes a data set of Parquet files.")
            .hint(format!(
                "for f in {}/*; do polepair decode \"$f\" {option} …; done",
                self.source.display()
            )))
    }

    fn open_sink(&self, out: Option<&Path>) -> Result<Box<dyn EventSink>> {
        if !self.plot.is_empty() {
            return Ok(Box::new(PlotSink::new(&self.plot, out)));
        }
        Ok(Box::new(self.open_lines(out)?))
    }

    fn open_lines(&self, path: Option<&Path>) -> Result<LineSink> {
        let out = if is_stream(&self.source) {
            DataOutput::follow_to_path(path)?
        } else {
            DataOutput::to_path(path)?
        };
        Ok(match self.output_format() {
            DecodeFormat::Jsonl => LineSink::jsonl(out),
            _ => LineSink::text(out.with_text(true), self.text_style()),
        })
    }

    fn text_style(&self) -> TextStyle {
        let notices = match self.notices {
            NoticeLevelArg::None => NoticeLevel::None,
            NoticeLevelArg::Events => NoticeLevel::Events,
            NoticeLevelArg::All => NoticeLevel::All,
        };
        let colour = self.out.is_none() && terminal::colour_out();
        TextStyle { marks: self.changes, notices, colour }
    }

    /// The one that is stated, else what OUT ends in; lines of text where that is no format. A drawing
    /// has its own.
    fn output_format(&self) -> DecodeFormat {
        let ending = self.out.as_deref().and_then(Path::extension).and_then(|end| end.to_str());
        let named = ending.and_then(|end| DecodeFormat::from_str(end, true).ok());
        self.format.or(named.filter(|_| self.plot.is_empty())).unwrap_or(DecodeFormat::Text)
    }
}

/// Reads a filter, or shows where it is wrong.
pub fn parse_filter(text: &str) -> Result<FrameFilter> {
    FrameFilter::parse(text).map_err(|error| {
        let nearest = error.nearest.as_ref().map(|word| format!("{word} (the nearest)"));
        Problem::usage("E249", "this is not a valid filter.")
            .why(error.to_string())
            .hint_if(nearest)
            .hint("`polepair decode FILE --filter 'axis = 2 and not ok'`; docs/reference/filter.md")
    })
}
