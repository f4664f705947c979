//! Output of `decode` as a chart of signals, in the terminal or as an SVG file.

use std::path::{Path, PathBuf};

use polepair_capture::plot::Plot;
use polepair_capture::{DecodedFrame, Glob};

use crate::capture::EventSink;
use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, print_warning};

/// Signals that are named when none of those wanted is there.
const NAMED_MAX: usize = 12;

/// Gathers signals, and draws them at the end of the capture.
pub struct PlotSink {
    plot: Plot,
    out: Option<PathBuf>,
}

impl PlotSink {
    /// Creates a plot of signals such as `*/Actual/Position`.
    pub fn new(signals: &[String], out: Option<&Path>) -> Self {
        let globs = signals.iter().flat_map(|list| list.split(',')).map(Glob::new);
        Self { plot: Plot::new(globs.collect()), out: out.map(Path::to_owned) }
    }
}

impl EventSink for PlotSink {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        self.plot.add_frame(event);
    }

    fn skip_event(&mut self, event: &DecodedFrame<'_>) {
        self.plot.note_time(event);
    }

    fn finish(&mut self) -> Result<()> {
        let (plot, path) = (&self.plot, self.out.as_deref());
        if plot.is_empty() {
            return Err(no_signal_problem(plot));
        }
        if plot.dropped_values > 0 {
            print_warning(&format!(
                "{} values of further signals are skipped",
                plot.dropped_values
            ));
        }
        let mut out = DataOutput::to_path(path)?.with_text(path.is_none());
        let picture = match path {
            Some(_) => plot.svg(),
            None => plot.terminal(terminal::width(), terminal::colour_out()),
        };
        out.buffer().extend(picture.bytes());
        out.finish()
    }
}

fn no_signal_problem(plot: &Plot) -> Problem {
    let others: Vec<String> = plot.other_signals().take(NAMED_MAX).collect();
    let output = if others.is_empty() {
        "The protocol of the capture gives no signals.".to_owned()
    } else {
        format!("It has {}.", others.join(", "))
    };
    Problem::new(Exit::Negative, "E113", "the capture has no such signal.")
        .why(output)
        .hint("--plot '*/Actual/*' selects all actual values")
        .hint("--profile NAME names parameters as a drive's manual does")
}
