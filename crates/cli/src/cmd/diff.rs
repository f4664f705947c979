//! `polepair diff A B [--as PROTO[@ID],…] [--tolerance PERCENT] [--format text|json]`

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use polepair_capture::diff::{Difference, diff};
use polepair_capture::jsonl;
use polepair_capture::summary::Summary;

use super::summary::Gathered;
use crate::capture::{Stated, report};
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, Output, Table, say};

/// Tells what differs between two captures in behaviour, not in bytes.
///
/// Axes, kinds of frames and their rates, states reached, faults, oddities, values, and how long
/// answers took. Exits with 1 where something differs.
#[derive(Args, Debug)]
#[command(after_help = "\
Rates, and ranges of values that move, may differ by the tolerance; a latency's median by 2.5 times
as much and its 99th percentile by five times; oddities may be twice as frequent. Values that stand
still have to be the same. Links may have other names where each capture has only one.

Examples:
  polepair diff good.log bad.log
  polepair diff monday.blf friday.blf --as canopen --tolerance 5")]
pub struct Options {
    /// The first capture
    #[arg(value_name = "A")]
    a: PathBuf,
    /// The second
    #[arg(value_name = "B")]
    b: PathBuf,
    #[command(flatten)]
    stated: Stated,
    /// By how much rates and ranges may differ, in percent
    #[arg(long, value_name = "PERCENT", default_value_t = 20.0)]
    tolerance: f64,
    /// How it is written
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// How differences are written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// A table
    Text,
    /// One JSON object a difference
    Jsonl,
}

impl Options {
    pub fn run(self) -> Result {
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return Err(Problem::usage("E242", "--tolerance is 0 percent or more."));
        }
        let (a, b) = (self.summary(&self.a)?, self.summary(&self.b)?);
        let found = diff(&a, &b, self.tolerance / 100.0);
        let mut out = Output::stdout();
        match self.format {
            Format::Text => out.buffer().extend(table(&found).bytes()),
            Format::Jsonl => found.iter().for_each(|one| object(one, out.buffer())),
        }
        out.flush()?;
        say(&format!(
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
        Ok(if found.is_empty() { Exit::Ok } else { Exit::Negative })
    }

    fn summary(&self, path: &Path) -> Result<Summary> {
        let mut gathered = Gathered::default();
        report(&self.stated.source()?.read(path, &mut gathered)?)?;
        Ok(gathered.summary)
    }
}

fn table(found: &[Difference]) -> String {
    if found.is_empty() {
        return String::new();
    }
    let mut table = Table::with_heads(&["differs", "of", "a", "b"]);
    for Difference { what, of, a, b } in found {
        table.row([(*what).to_owned(), of.clone(), a.clone(), b.clone()]);
    }
    table.render(terminal::colour_out())
}

fn object(one: &Difference, out: &mut Vec<u8>) {
    let words = [("what", one.what), ("of", &one.of), ("a", &one.a), ("b", &one.b)];
    for (n, (key, word)) in words.into_iter().enumerate() {
        out.push(if n == 0 { b'{' } else { b',' });
        jsonl::string(out, key);
        out.push(b':');
        jsonl::string(out, word);
    }
    out.extend_from_slice(b"}\n");
}
