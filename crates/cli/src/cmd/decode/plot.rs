//! Signals of a capture, drawn: in the terminal, or into an SVG file.

use std::path::{Path, PathBuf};

use polepair_capture::plot::Plot;
use polepair_capture::{Event, Glob};

use crate::capture::Sink;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, Output, say};

/// Signals that are named when none of those wanted is there.
const NAMED_MAX: usize = 12;

/// Gathers signals, and draws them at the end of the capture.
pub struct Drawing {
    plot: Plot,
    out: Option<PathBuf>,
}

impl Drawing {
    /// Of signals such as `*/Actual/Position`.
    pub fn new(signals: &[String], out: Option<&Path>) -> Self {
        let globs = signals.iter().flat_map(|list| list.split(',')).map(Glob::new);
        Self { plot: Plot::new(globs.collect()), out: out.map(Path::to_owned) }
    }
}

impl Sink for Drawing {
    fn take(&mut self, event: &Event<'_>) {
        self.plot.take(event);
    }

    fn skip(&mut self, event: &Event<'_>) {
        self.plot.pass(event);
    }

    fn finish(&mut self) -> Result<()> {
        let (plot, path) = (&self.plot, self.out.as_deref());
        if plot.is_empty() {
            return Err(nothing(plot));
        }
        if plot.left_out > 0 {
            say(&format!("{} values of further signals are left out", plot.left_out));
        }
        let mut out = Output::to(path)?;
        let picture = match path {
            Some(_) => plot.svg(),
            None => plot.terminal(terminal::width(), terminal::colour_out()),
        };
        out.buffer().extend(picture.bytes());
        out.flush()
    }
}

fn nothing(plot: &Plot) -> Problem {
    let others: Vec<String> = plot.others().take(NAMED_MAX).collect();
    let told = match others.is_empty() {
        true => "It tells no values at all, as far as its protocol is understood.".to_owned(),
        false => format!("It has {}.", others.join(", ")),
    };
    Problem::new(Exit::Negative, "E113", "the capture has no such signal.")
        .why(told)
        .hint("--plot '*/Actual/*' takes whatever drives tell of themselves")
        .hint("--profile NAME names parameters as a drive's manual does")
}
