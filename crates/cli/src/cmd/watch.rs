//! `polepair watch URL SIGNAL… [--rate HZ] [--format table|jsonl|csv]`

mod reports;

use std::time::Duration;

use clap::{Args, ValueEnum};
use polepair::url::AxisNumber;
use polepair::{LocalAxis, Value};
use polepair_capture::jsonl;
use polepair_client::LiveConnection;
use polepair_client::message::AxisInfo;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession};
use crate::session::{LocalSession, read_parameter, read_signal as signal_of};
use crate::target::DriveArgs;
use crate::terminal::{self, DataOutput};
use crate::value;

/// Longest wait between two checks for Ctrl-C, ms.
const POLL_MS: u32 = 50;
/// Time limit of a server's first samples, and the interval of checking for them.
const FIRST_MAX: Duration = Duration::from_secs(2);
const FIRST_POLL_MS: u32 = 2;

/// Periods, and least time, for which a server's sample is shown: a drive may be slower than the requested rate.
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
  polepair watch thruster+socketcan://can0#11 velocity current --reports=100ms")]
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
    /// Print what the drive sends by itself, without polling; with TIME, set it to send at this interval
    /// (thruster family: SR; switched off at the end)
    #[arg(long, value_name = "INTERVAL", num_args = 0..=1, require_equals = true,
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
    pub fn run(self) -> Result {
        self.check_rate()?;
        let session = self.target.open()?;
        session.listen_for_interrupts();
        match self.reports {
            None => self.print_rows(&self.local_columns(&session)?, clock::sleep_until),
            Some(interval) => self.print_reports(&session, interval),
        }
    }

    /// Runs the verb on a server, which reads for all viewers.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        self.check_rate()?;
        if self.reports.is_some() {
            return Err(remote::unsupported_problem(
                "watch --reports",
                "A server polls at its own rate.",
            ));
        }
        let axes = server.axes_named(self.target.remote_axes()?)?;
        let live = server.gateway.live().map_err(remote::refusal_problem)?;
        let mut columns = Vec::new();
        for axis in &axes {
            for name in self.signal_names() {
                let who = server.axis_prefix(&axes, axis);
                columns.push(self.remote_column(&live, axis, &who, name)?);
            }
        }
        interrupt::listen(|| {});
        let end = clock::now() + clock::scale_timeout(FIRST_MAX);
        for column in &columns {
            // Without it the first row of a server would be empty.
            while (column.read)()?.is_nan() && clock::now() < end && !interrupt::was_interrupted() {
                clock::sleep_until(clock::now().plus_ms(FIRST_POLL_MS));
            }
        }
        self.print_rows(&columns, clock::sleep_until)
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

    fn remote_column(
        &self,
        live: &LiveConnection,
        axis: &AxisInfo,
        who: &str,
        name: &str,
    ) -> Result<WatchColumn> {
        let name = normalize_name(name);
        let signal = axis.signals.iter().any(|signal| signal.signal == name);
        let (signal, parameter) = if signal { (Some(&*name), None) } else { (None, Some(&*name)) };
        let watched = live
            .subscribe(axis.id, signal, parameter, self.rate)
            .map_err(remote::refusal_problem)?;
        let shown = signal.and_then(|signal| remote::signal_unit(axis, signal, watched.unit()));
        let (unit, one) = match shown {
            Some(unit) => (unit.symbol().to_owned(), unit.si_factor()),
            None => (watched.unit().to_owned(), 1.0),
        };
        let periods =
            Duration::try_from_secs_f64(FRESH_PERIODS / self.rate).unwrap_or(Duration::MAX);
        let fresh = clock::scale_timeout(FRESH_MIN).max(periods);
        let (number, link, name) = (axis.number, Some(axis.link), format!("{who}{name}"));
        Ok(WatchColumn {
            number,
            link,
            name,
            unit,
            read: Box::new(move || {
                let last = watched.last(fresh).map_err(remote::refusal_problem)?;
                Ok(last.map_or(f64::NAN, |sample| sample.value / one))
            }),
        })
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

    fn local_columns(&self, session: &LocalSession) -> Result<Vec<WatchColumn>> {
        let mut columns = Vec::new();
        for axis in session.axes() {
            for name in self.signal_names() {
                let signal = Signal::ALL.into_iter().find(|signal| signal.name() == name);
                // A signal that this drive lacks was not requested by name.
                let absent = match signal.filter(|_| self.signals.is_empty()) {
                    Some(signal) => !axis.provides_signal(signal).map_err(outcome::to_problem)?,
                    None => false,
                };
                if !absent {
                    columns.push(local_column(session, axis, name)?);
                }
            }
        }
        Ok(columns)
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

fn local_column(session: &LocalSession, axis: &LocalAxis, name: &str) -> Result<WatchColumn> {
    let signal = Signal::ALL.into_iter().find(|signal| signal.name() == normalize_name(name));
    let source = signal.and_then(|signal| Some((signal, axis.profile().signal(signal)?)));
    let (id, flag) = match source {
        Some((_, source)) => (source.parameter, source.equals.is_some()),
        None => (axis.find(name).map_err(outcome::to_problem)?, false),
    };
    // Reads what the unit depends on. What cannot be read shows with the first value.
    let _ = axis.value(id, 0);
    outcome::note_missing_unit(axis, id);
    let unit = if flag { "" } else { axis.unit(id).symbol() }.to_owned();
    let (number, its) = (axis.number(), axis.clone());
    let read: Box<dyn Fn() -> Result<f64>> = match source {
        Some((wanted, _)) => {
            Box::new(move || Ok(signal_of(&its, wanted)?.map_or(f64::NAN, finite_value)))
        }
        None => Box::new(move || read_parameter(&its, id).map(finite_value)),
    };
    let name = format!("{}{}", session.axis_prefix(axis), normalize_name(name));
    Ok(WatchColumn { number, link: None, name, unit, read })
}

fn finite_value(value: Value) -> f64 {
    // Raw where its scale is not known.
    if value.value.is_finite() { value.value } else { value.raw as f64 }
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
