//! `polepair diff A B [--as PROTO[@ID],…] [--tolerance PERCENT] [--format text|json]`

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use polepair_capture::diff::{Difference, diff};
use polepair_capture::jsonl;
use polepair_capture::summary::Summary;

use super::summary::{require_frames, summarize};
use crate::capture::CaptureArgs;
use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, TextTable, print_note};

/// Compares the behaviour of two captures, not their bytes.
///
/// Axes, frame types and rates, states, faults, anomalies, values, and response times are compared. The exit code is 1
/// if anything differs.
#[derive(Args, Debug)]
#[command(after_help = "\
Rates, and ranges of changing values, may differ by the tolerance. The median of response times may
differ by 2.5 times the tolerance, the 99th percentile by 5 times. Anomalies may be twice as frequent.
Constant values must be equal. If each capture has one link only, their names may differ.

Examples:
  polepair diff good.log bad.log
  polepair diff monday.blf friday.blf --as canopen --tolerance 5")]
pub struct DiffOptions {
    /// First capture
    #[arg(value_name = "A")]
    a: PathBuf,
    /// Second capture
    #[arg(value_name = "B")]
    b: PathBuf,
    #[command(flatten)]
    stated: CaptureArgs,
    /// Tolerance for rates and ranges, in percent
    #[arg(long, value_name = "PERCENT", default_value_t = 20.0)]
    tolerance: f64,
    /// Output format
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    format: DiffFormat,
}

/// Output formats of `diff`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum DiffFormat {
    /// Table
    Text,
    /// One JSON object for each difference
    Jsonl,
}

impl DiffOptions {
    pub fn run(self) -> Result {
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return Err(Problem::usage("E242", "--tolerance is 0 percent or more."));
        }
        let ((a, read_a), (b, read_b)) = (self.summarize(&self.a)?, self.summarize(&self.b)?);
        let found = diff(&a, &b, self.tolerance / 100.0);
        let mut out = DataOutput::stdout().with_text(self.format == DiffFormat::Text);
        match self.format {
            DiffFormat::Text => out.buffer().extend(differences_table(&found).bytes()),
            DiffFormat::Jsonl => found.iter().for_each(|one| write_json(one, out.buffer())),
        }
        out.flush()?;
        print_note(&format!(
            "{} frames and {} frames, tolerance {} %: {}",
            a.frames,
            b.frames,
            self.tolerance,
            match found.len() {
                0 => "no difference in behaviour".to_owned(),
                1 => "1 difference".to_owned(),
                count => format!("{count} differences"),
            }
        ));
        Ok(if !found.is_empty() {
            Exit::Negative
        } else if read_a == Exit::Ok {
            // The parts that were left out may differ.
            read_b
        } else {
            read_a
        })
    }

    /// A summary, and whether it is of all frames.
    fn summarize(&self, path: &Path) -> Result<(Summary, Exit)> {
        let (summary, decoder) = summarize(self.stated.source()?, path)?;
        let read = require_frames(&decoder, path)?;
        Ok((summary, read))
    }
}

fn differences_table(found: &[Difference]) -> String {
    if found.is_empty() {
        return String::new();
    }
    let mut table = TextTable::with_heads(&["differs", "of", "a", "b"]);
    for Difference { kind, subject, a, b } in found {
        table.add_row([(*kind).to_owned(), subject.clone(), a.clone(), b.clone()]);
    }
    table.render(terminal::colour_out())
}

fn write_json(one: &Difference, out: &mut Vec<u8>) {
    let words = [("kind", one.kind), ("subject", &one.subject), ("a", &one.a), ("b", &one.b)];
    for (n, (key, word)) in words.into_iter().enumerate() {
        out.push(if n == 0 { b'{' } else { b',' });
        jsonl::write_string(out, key);
        out.push(b':');
        jsonl::write_string(out, word);
    }
    out.extend_from_slice(b"}\n");
}
