//! `polepair watch URL SIGNAL… [--rate HZ] [--format table|jsonl|csv]`

use clap::{Args, ValueEnum};
use polepair::Axis;
use polepair_capture::jsonl;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::units::Unit;
use polepair_link::clock;

use crate::cmd::get::named;
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::session::{Session, read, signal};
use crate::target::Target;
use crate::terminal::{self, Output};
use crate::value;

/// How long a wait may last before Ctrl-C is looked for.
const LOOK_MS: u32 = 50;

/// Shows signals or parameters again and again, until Ctrl-C or --for.
#[derive(Args, Debug)]
#[command(after_help = "\
Signals: position, velocity, torque, current, voltage, temperature, target position,
target velocity, fault, enabled, moving, reached, mode; or any parameter by its name.

Examples:
  polepair watch tmcl+serial:///dev/ttyUSB0#1 position velocity
  polepair watch sim:tmcl velocity current --rate 50 --format csv --for 2s")]
pub struct Watch {
    #[command(flatten)]
    target: Target,
    /// Signals or parameters [default: position velocity]
    #[arg(value_name = "SIGNAL")]
    signals: Vec<String>,
    /// Readings a second
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    rate: f64,
    /// How they are printed
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// End after this time instead of at Ctrl-C
    #[arg(long = "for", value_name = "TIME", value_parser = value::span)]
    seconds: Option<f64>,
}

/// How readings are printed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// Aligned columns
    Table,
    /// One JSON object a reading
    Jsonl,
    /// Comma-separated, with a head
    Csv,
}

/// One column.
struct Column {
    axis: Axis,
    name: String,
    unit: Unit,
    source: Source,
}

enum Source {
    Signal(Signal),
    Parameter(ParameterId),
}

impl Watch {
    pub fn run(self) -> Result {
        if !(self.rate > 0.0 && self.rate <= 10_000.0) {
            return Err(Problem::usage("E245", "--rate is more than 0 and at most 10000."));
        }
        let session = self.target.open()?;
        let columns = self.columns(&session)?;
        session.listen();
        let mut out = Output::stdout();
        self.head(&columns, &mut out);
        let begun = clock::now();
        let end = self.seconds.map(|seconds| begun.plus_ns((seconds * 1e9) as u64));
        let period = (1e9 / self.rate) as u64;
        let mut next = begun;
        loop {
            self.row(&columns, next.since(begun).as_secs_f64(), &mut out)?;
            out.flush()?;
            // Readings that the drive was too slow for are left out, not caught up with.
            next = next.plus_ns(period).max(clock::now());
            if end.is_some_and(|end| next > end) {
                return Ok(Exit::Ok);
            }
            while clock::now() < next {
                if interrupt::came() {
                    return Err(Problem::interrupted());
                }
                clock::sleep_until(next.min(clock::now().plus_ms(LOOK_MS)));
            }
            if interrupt::came() {
                return Err(Problem::interrupted());
            }
        }
    }

    fn columns(&self, session: &Session) -> Result<Vec<Column>> {
        let default = ["position".to_owned(), "velocity".to_owned()];
        let names: &[String] = if self.signals.is_empty() { &default } else { &self.signals };
        let mut columns = Vec::new();
        for axis in session.axes() {
            for name in names.iter().flat_map(|name| name.split(',')) {
                columns.push(column(session, axis, name)?);
            }
        }
        Ok(columns)
    }

    fn head(&self, columns: &[Column], out: &mut Output) {
        let heads: Vec<String> = columns.iter().map(Column::head).collect();
        match self.format {
            Format::Table => {
                let cells = heads
                    .iter()
                    .zip(columns)
                    .map(|(head, c)| format!("{head:>width$}", width = c.width()));
                let line: String = std::iter::once(format!("{:>9}", "s")).chain(cells).collect();
                let colour = terminal::colour_out();
                out.line(&if colour { format!("\x1b[2m{line}\x1b[0m") } else { line });
            }
            Format::Csv => {
                let cells = heads.iter().map(|head| format!(",{head}"));
                out.line(&std::iter::once("time [s]".to_owned()).chain(cells).collect::<String>());
            }
            Format::Jsonl => {}
        }
    }

    fn row(&self, columns: &[Column], time: f64, out: &mut Output) -> Result<()> {
        let mut cells = Vec::with_capacity(columns.len());
        for column in columns {
            cells.push(column.read()?);
        }
        match self.format {
            Format::Table => {
                let cells = cells.iter().zip(columns);
                let cells =
                    cells.map(|(value, c)| format!("{:>1$}", value::number(*value), c.width()));
                out.line(&std::iter::once(format!("{time:>9.3}")).chain(cells).collect::<String>());
            }
            Format::Csv => {
                let cells = cells.iter().map(|value| format!(",{value}"));
                out.line(&std::iter::once(format!("{time:.6}")).chain(cells).collect::<String>());
            }
            Format::Jsonl => {
                object(columns, &cells, time, out.buffer());
            }
        }
        Ok(())
    }
}

fn object(columns: &[Column], cells: &[f64], time: f64, out: &mut Vec<u8>) {
    let mut axis = None;
    out.extend_from_slice(format!("{{\"time\":{time:.6}").as_bytes());
    for (column, value) in columns.iter().zip(cells) {
        if axis != Some(column.axis.number()) {
            if axis.is_some() {
                out.extend_from_slice(format!("}}\n{{\"time\":{time:.6}").as_bytes());
            }
            axis = Some(column.axis.number());
            out.extend_from_slice(format!(",\"axis\":{}", column.axis.number()).as_bytes());
        }
        out.push(b',');
        jsonl::string(out, &column.name);
        let value = if value.is_finite() { value.to_string() } else { "null".to_owned() };
        out.extend_from_slice(format!(":{value}").as_bytes());
    }
    out.extend_from_slice(b"}\n");
}

fn column(session: &Session, axis: &Axis, name: &str) -> Result<Column> {
    let plain = |text: &str| text.to_ascii_lowercase().replace(['-', '_'], " ");
    let signal = Signal::ALL.into_iter().find(|signal| signal.name() == plain(name));
    let source = signal.and_then(|signal| Some((signal, axis.profile().signal(signal)?)));
    let (source, id) = match source {
        Some((signal, source)) => (Source::Signal(signal), source.parameter),
        None => {
            let id = named(axis, name)?;
            (Source::Parameter(id), id)
        }
    };
    let name = format!("{}{}", session.who(axis), plain(name));
    Ok(Column { axis: axis.clone(), name, unit: axis.unit(id), source })
}

impl Column {
    fn head(&self) -> String {
        match self.unit.symbol() {
            "" => self.name.clone(),
            _ if self.is_flag() => self.name.clone(),
            symbol => format!("{} [{symbol}]", self.name),
        }
    }

    /// How wide it is in a table: two more than its head where that is long.
    fn width(&self) -> usize {
        const USUAL: usize = 18;
        USUAL.max(self.head().chars().count() + 2)
    }

    fn is_flag(&self) -> bool {
        let Source::Signal(signal) = self.source else { return false };
        self.axis.profile().signal(signal).is_some_and(|source| source.equals.is_some())
    }

    /// The value in its unit; raw where its scale is not known.
    fn read(&self) -> Result<f64> {
        let value = match self.source {
            Source::Signal(wanted) => signal(&self.axis, wanted)?,
            Source::Parameter(id) => Some(read(&self.axis, id)?),
        };
        let Some(value) = value else { return Ok(f64::NAN) };
        Ok(if value.value.is_finite() { value.value } else { value.raw as f64 })
    }
}
