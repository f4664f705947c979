//! `polepair monitor URL`: axes, frames and faults of a link, live.

mod draw;
mod local;
mod model;
mod monitored_axis;
mod printer;
mod remote;
mod screen;
mod source;
mod traffic;
mod view;

use std::io::IsTerminal as _;
use std::time::Duration;

use clap::{Args, ValueEnum};
use polepair_capture::Rules;

use crate::outcome;
use crate::problem::{self, Problem, Result};
use crate::remote::{ALL, RemoteSession, ServerArgs, unsupported_problem};
use crate::tap_queue::TapQueue;
use crate::trace::TraceArgs;
use crate::{terminal, value};
use local::{LocalSource, Polling};
use model::Monitor;
use printer::PrintStyle;
use remote::{RemoteSource, RemoteView};

/// Time for which the screen shows the values of a lost server.
const LOST_SHOWN_MAX: Duration = Duration::from_secs(10);

/// Shows axes, faults and frames of a link live.
///
/// The monitor reads, and writes nothing. Esc stops all axes that it shows. If stdout is not a terminal, or
/// with --once or --format jsonl, it prints lines instead of a screen.
#[derive(Args, Debug)]
#[command(after_help = "\
Keys: Esc stops every axis, q exits without a stop, ? shows all keys.

Examples:
  polepair monitor tmcl+serial:///dev/ttyUSB0#1
  polepair monitor sim:docs/examples/one-bus.toml
  polepair monitor canopen+socketcan://can0 --listen --as canopen@2,thruster@11
  polepair monitor sim:tmcl --once
  polepair monitor sim:tmcl --format jsonl --for 2s")]
pub struct MonitorOptions {
    /// Link and axes: tmcl+serial:///dev/ttyUSB0:9600#1, sim:tmcl, @name
    #[arg(value_name = "URL")]
    url: String,
    /// Send nothing; show the frames of other hosts and of the drives
    #[arg(long, conflicts_with = "once")]
    listen: bool,
    /// Protocol of the link, or PROTO@AXIS for a part of it; separate several by commas
    #[arg(long = "as", value_name = "PROTO[@ID],…")]
    rules: Option<String>,
    /// Polls of each axis per second
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    rate: f64,
    /// Poll each axis once, print the result, and exit
    #[arg(long)]
    once: bool,
    /// Exit after this time
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Output format [default: a screen on a terminal, else text]
    #[arg(long, value_enum)]
    format: Option<MonitorFormat>,
    #[command(flatten)]
    trace: TraceArgs,
    #[command(flatten)]
    profiles: crate::profile_args::ProfileFile,
}

/// Output formats of `monitor`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum MonitorFormat {
    /// Tables and aligned lines
    Text,
    /// One JSON object for each frame, axis and link
    Jsonl,
}

impl MonitorOptions {
    /// Shows a link of this program, or a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if !(self.rate > 0.0 && self.rate <= 1000.0) {
            return Err(Problem::usage("E245", "--rate is more than 0 and at most 1000."));
        }
        if server.is_given() {
            let mut monitor = self.open_remote(&server.open()?)?;
            self.show(&mut monitor)
        } else {
            let mut monitor = self.open_local()?;
            self.show(&mut monitor)
        }
    }

    fn show(&self, monitor: &mut Monitor) -> Result {
        let span = self.seconds.map(Duration::from_secs_f64);
        if self.is_screen() {
            return screen::run(monitor, span);
        }
        let jsonl = self.format == Some(MonitorFormat::Jsonl);
        let style = PrintStyle { jsonl, once: self.once, period: self.period() };
        printer::run(monitor, style, span)
    }

    fn is_screen(&self) -> bool {
        let there = terminal::is_screen() && std::io::stdin().is_terminal();
        self.format.is_none() && !self.once && there
    }

    fn period(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.rate)
    }

    /// A monitor of the frames of all links of a server, and of the selected axes.
    fn open_remote(&self, server: &RemoteSession) -> Result<Monitor<RemoteSource>> {
        let links_alone = self.listen || self.rules.is_some() || self.trace.path().is_some();
        if links_alone || self.profiles.is_given() {
            let what = "monitor with --listen, --as, --trace or --profile";
            return Err(unsupported_problem(what, "The server records and decodes frames itself."));
        }
        let view = RemoteView {
            axes: server.axes_named(&self.url)?,
            all_axes: self.url == ALL,
            frames: !self.once,
            period: self.period(),
            lost_max: if self.is_screen() { LOST_SHOWN_MAX } else { Duration::ZERO },
        };
        Monitor::with_server(server, view)
    }

    fn open_local(&self) -> Result<Monitor<LocalSource>> {
        let rules = self.rules.as_deref().map(Rules::parse).transpose();
        let rules = rules.map_err(|error| problem::no_such_protocol(&error.word))?;
        let trace = self.trace.create(&self.url)?;
        let tap_queue = TapQueue::with_trace(trace);
        let taps = tap_queue.clone();
        let connector = self.profiles.connector()?.with_taps(move |wire| taps.tap(wire));
        if self.listen {
            let listening = connector.listen(&self.url).map_err(outcome::to_problem)?;
            return Ok(Monitor::with_listener(listening, &self.url, rules, tap_queue));
        }
        let link = connector.connect_local(&self.url).map_err(outcome::to_problem)?;
        let polling = Polling { period: self.period(), completes_rounds: !self.is_screen() };
        Monitor::with_link(link, &self.url, rules, tap_queue, polling)
    }
}

#[cfg(all(test, unix))]
mod tests;
