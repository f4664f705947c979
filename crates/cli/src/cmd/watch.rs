//! `polepair watch URL SIGNAL… [--rate HZ] [--format table|jsonl|csv]`

mod reports;

use std::time::Duration;

use clap::{Args, ValueEnum};
use polepair::Axis;
use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use crate::data_output::DataOutput;
use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::session::Session;
use crate::target::DriveArgs;
use crate::terminal;
use crate::value;

/// Longest wait between two checks for Ctrl-C, ms.
const POLL_MS: u32 = 50;
/// Time limit of a server's first samples, and the interval of checking for them.
const FIRST_MAX: Duration = Duration::from_secs(2);
const FIRST_POLL_MS: u32 = 2;

/// Periods, and least time, for which a report of a drive is shown: it may send more rarely than asked.
const FRESH_PERIODS: f64 = 3.0;
const FRESH_MIN: Duration = Duration::from_secs(1);

/// Prints signals or parameters periodically, until Ctrl-C or --for.
#[derive(Args, Debug)]
#[command(after_help = "\
Signals: position, velocity, torque, current, voltage, temperature, target position,
target velocity, fault, enabled, moving, reached, mode; or any parameter by its name.

Examples:
  polepair watch tmcl+serial:///dev/ttyUSB0#1 position velocity
  polepair watch sim:tmcl velocity current --rate 50 --format csv --for 2s
  polepair watch thruster+socketcan://can0#11 velocity current --reports=100ms
  polepair watch canopen+socketcan://can0#5 position torque statusword --pdo=10ms")]
pub struct WatchCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Signals or parameters [default: position velocity]
    #[arg(value_name = "SIGNAL")]
    signals: Vec<String>,
    /// Readings per second
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    rate: f64,
    /// Output format
    #[arg(long, value_enum, default_value_t = WatchFormat::Table)]
    format: WatchFormat,
    /// Exit after this time
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Print what the drive sends by itself, without polling; with TIME, set it to send at this interval until the end
    /// (thruster family: SR; CANopen: free TPDOs are mapped)
    #[arg(long, visible_alias = "pdo", value_name = "INTERVAL", num_args = 0..=1, require_equals = true,
        value_parser = value::parse_span)]
    reports: Option<Option<f64>>,
}

/// Output formats of `watch`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum WatchFormat {
    /// Aligned columns
    Table,
    /// One JSON object for each reading
    Jsonl,
    /// Comma-separated, with a header
    Csv,
}

/// One column.
struct WatchColumn {
    number: u32,
    /// Link of a server, which has several, each with its own numbers.
    link: Option<u16>,
    name: String,
    /// Empty for flags and what has none.
    unit: String,
    read: Box<dyn Fn() -> Result<f64>>,
}

impl WatchCommand {
    /// Shows values of a link of this program, or of a server, which reads for all viewers.
    pub fn run(self, server: ServerArgs) -> Result {
        self.check_rate()?;
        if let Some(interval) = self.reports {
            if server.is_given() {
                let why = "A server polls at its own rate.";
                return Err(remote::unsupported_problem("watch --reports", why));
            }
            let session = self.target.open()?;
            session.listen_for_interrupts();
            return self.print_reports(&session, interval);
        }
        let session = self.target.connect(server)?;
        session.listen_for_interrupts();
        let columns = self.columns(&session)?;
        if session.link.remote().is_some() {
            wait_for_samples(&columns)?;
        }
        self.print_rows(&columns, clock::sleep_until)
    }

    fn columns(&self, session: &Session) -> Result<Vec<WatchColumn>> {
        let mut columns = Vec::new();
        for axis in session.axes() {
            for name in self.signal_names() {
                let signal = Signal::from_name(name);
                // A signal that this drive lacks was not requested by name.
                let is_provided = match (signal.filter(|_| self.signals.is_empty()), axis.local()) {
                    (Some(signal), Some(axis)) => {
                        axis.provides_signal(signal).map_err(outcome::to_problem)?
                    }
                    (Some(signal), None) => axis.has_signal(signal),
                    (None, _) => true,
                };
                if is_provided {
                    columns.push(self.column(session, axis, name)?);
                }
            }
        }
        Ok(columns)
    }

    fn column(&self, session: &Session, axis: &Axis, name: &str) -> Result<WatchColumn> {
        let latest = axis.interface().latest_value(name, self.rate).map_err(outcome::to_problem)?;
        if let Some(axis) = axis.local() {
            let found = axis.find_signal_or_parameter(name);
            found.iter().for_each(|(id, _)| outcome::note_missing_unit(axis, *id));
        }
        Ok(WatchColumn {
            number: axis.number(),
            link: axis.remote().map(|axis| axis.info().link),
            name: format!("{}{}", session.axis_prefix(axis), normalize_name(name)),
            unit: latest.unit().to_owned(),
            read: Box::new(move || latest.read().map_err(outcome::to_problem)),
        })
    }

    fn check_rate(&self) -> Result<()> {
        if self.rate > 0.0 && self.rate <= 10_000.0 {
            Ok(())
        } else {
            Err(Problem::usage("E245", "--rate is more than 0 and at most 10000."))
        }
    }

    fn signal_names(&self) -> Vec<&str> {
        if self.signals.is_empty() {
            vec!["position", "velocity"]
        } else {
            self.signals.iter().flat_map(|name| name.split(',')).collect()
        }
    }

    fn print_rows(&self, columns: &[WatchColumn], sleep_until: impl Fn(Instant)) -> Result {
        let mut out = DataOutput::stdout().with_text(self.format == WatchFormat::Table);
        self.print_head(columns, &mut out);
        let started_at = clock::now();
        let end = self.seconds.map(|seconds| started_at.plus_ns((seconds * 1e9) as u64));
        let period = (1e9 / self.rate) as u64;
        let mut next = started_at;
        loop {
            self.print_row(columns, next.since(started_at).as_secs_f64(), &mut out)?;
            out.flush()?;
            // Readings that the drive was too slow for are left out, not caught up with.
            debug_assert!(self.rate > 0.0);
            next = next.plus_ns(period).max(clock::now());
            if end.is_some_and(|end| next > end) {
                return Ok(Exit::Ok);
            }
            while clock::now() < next {
                if interrupt::was_interrupted() {
                    return Err(Problem::interrupted());
                }
                sleep_until(next.min(clock::now().plus_ms(POLL_MS)));
            }
            if interrupt::was_interrupted() {
                return Err(Problem::interrupted());
            }
        }
    }

    fn print_head(&self, columns: &[WatchColumn], out: &mut DataOutput) {
        let heads: Vec<String> = columns.iter().map(WatchColumn::head).collect();
        match self.format {
            WatchFormat::Table => {
                let cells = heads
                    .iter()
                    .zip(columns)
                    .map(|(head, c)| format!("{head:>width$}", width = c.width()));
                let line: String = std::iter::once(format!("{:>9}", "s")).chain(cells).collect();
                let colour = terminal::colour_out();
                out.write_line(&if colour { format!("\x1b[2m{line}\x1b[0m") } else { line });
            }
            WatchFormat::Csv => {
                let cells = heads.iter().map(|head| format!(",{head}"));
                out.write_line(
                    &std::iter::once("time [s]".to_owned()).chain(cells).collect::<String>(),
                );
            }
            WatchFormat::Jsonl => {}
        }
    }

    fn print_row(&self, columns: &[WatchColumn], time: f64, out: &mut DataOutput) -> Result<()> {
        let mut cells = Vec::with_capacity(columns.len());
        for column in columns {
            cells.push((column.read)()?);
        }
        match self.format {
            WatchFormat::Table => {
                let cells = cells.iter().zip(columns);
                let cells = cells
                    .map(|(value, c)| format!("{:>1$}", value::format_number(*value), c.width()));
                out.write_line(
                    &std::iter::once(format!("{time:>9.3}")).chain(cells).collect::<String>(),
                );
            }
            WatchFormat::Csv => {
                let cells = cells.iter().map(|value| format!(",{value}"));
                out.write_line(
                    &std::iter::once(format!("{time:.6}")).chain(cells).collect::<String>(),
                );
            }
            WatchFormat::Jsonl => {
                write_json(columns, &cells, time, out.buffer());
            }
        }
        Ok(())
    }
}

fn write_json(columns: &[WatchColumn], cells: &[f64], time: f64, out: &mut Vec<u8>) {
    let mut axis = None;
    out.extend_from_slice(format!("{{\"time\":{time:.6}").as_bytes());
    for (column, value) in columns.iter().zip(cells) {
        if axis != Some((column.link, column.number)) {
            if axis.is_some() {
                out.extend_from_slice(format!("}}\n{{\"time\":{time:.6}").as_bytes());
            }
            axis = Some((column.link, column.number));
            out.extend_from_slice(
                format!(",\"axis\":{}", AxisNumber(column.number).json()).as_bytes(),
            );
            if let Some(link) = column.link {
                out.extend_from_slice(format!(",\"link\":{link}").as_bytes());
            }
        }
        out.push(b',');
        jsonl::write_string(out, &column.name);
        // JSON has no NaN.
        let value = if value.is_finite() { value.to_string() } else { "null".to_owned() };
        out.extend_from_slice(format!(":{value}").as_bytes());
    }
    out.extend_from_slice(b"}\n");
}

fn normalize_name(name: &str) -> String {
    name.to_ascii_lowercase().replace(['-', '_'], " ")
}

/// Waits for the first sample of each column, without which the first row of a server would be empty.
fn wait_for_samples(columns: &[WatchColumn]) -> Result<()> {
    let end = clock::now() + clock::scale_timeout(FIRST_MAX);
    for column in columns {
        while (column.read)()?.is_nan() && clock::now() < end && !interrupt::was_interrupted() {
            clock::sleep_until(clock::now().plus_ms(FIRST_POLL_MS));
        }
    }
    Ok(())
}

impl WatchColumn {
    fn head(&self) -> String {
        match &*self.unit {
            "" => self.name.clone(),
            symbol => format!("{} [{symbol}]", self.name),
        }
    }

    /// Width in a table: two more than its head if that is long.
    fn width(&self) -> usize {
        const USUAL: usize = 18;
        USUAL.max(self.head().chars().count() + 2)
    }
}
