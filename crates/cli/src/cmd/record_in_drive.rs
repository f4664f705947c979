//! `polepair record-in-drive URL VARIABLE… [--rate HZ] [--for TIME] [--on CONDITION]`

use std::ops::{ControlFlow, RangeInclusive};
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use polepair::{DriveLog, DriveLogPlan, DriveLogRequest, DriveLogStage, LocalAxis, LoggedVariable};
use polepair_capture::jsonl;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;

use crate::data_output::DataOutput;
use crate::interrupt;
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::session::Session;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Records variables in the drive's own memory, all at one instant, and reads them afterwards.
///
/// The drive samples in its control loop, up to 10 000 times a second: faster than any line could. Its memory
/// limits the number of points. Nothing is set in motion, except by --move.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair record-in-drive tml+serial:///dev/ttyUSB0#1 POSERR IQ APOS --rate 1kHz --for 0.3s --inferred
  polepair record-in-drive sim:tml POSERR IQ APOS --move 0.1turn --inferred -o step.csv
  polepair record-in-drive sim:tml POSERR IQ --rate 10kHz --for 20ms --inferred
  polepair record-in-drive tml+serial:///dev/ttyUSB0#1 ASPD --move 2turn --on \"ASPD > 10rpm\" \\
    --rate 500Hz --for 1s --inferred -o start.csv")]
pub struct RecordInDrive {
    #[command(flatten)]
    target: DriveArgs,
    /// Variables of the drive, by name, symbol or number
    #[arg(value_name = "VARIABLE", required = true)]
    variables: Vec<String>,
    /// Points per second, such as 500Hz or 10kHz
    #[arg(long, value_name = "HZ", default_value = "1kHz", value_parser = parse_rate)]
    rate: f64,
    /// Length of the recording
    #[arg(long = "for", value_name = "TIME", default_value = "0.2s", value_parser = value::parse_span)]
    span: f64,
    /// Start when this is true, such as \"APOS > 1turn\"; the value is read over the line until then
    #[arg(long, value_name = "CONDITION")]
    on: Option<String>,
    /// Move to this position as soon as the recording runs, and before --on is true: 90deg, 2turn
    #[arg(long = "move", value_name = "POSITION", allow_hyphen_values = true)]
    target_position: Option<String>,
    /// Move relative to the actual position
    #[arg(long, requires = "target_position")]
    rel: bool,
    /// Memory of the drive that nothing else uses
    #[arg(long, value_name = "FIRST-LAST", value_parser = value::parse_memory)]
    buffer: Option<RangeInclusive<u16>>,
    /// Use a layout of the drive's buffer that no public source states
    #[arg(long)]
    inferred: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = LogFormat::Csv)]
    format: LogFormat,
    /// Write to this file
    #[arg(long, short = 'o', value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Output formats.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum LogFormat {
    /// Comma-separated, with a header
    Csv,
    /// One JSON object for each point
    Jsonl,
}

impl RecordInDrive {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let [axis] = session.axes() else {
            return Err(Problem::usage("E212", "one drive is recorded at a time.")
                .hint("name one axis in the connection string: #1"));
        };
        let plan = self.plan(axis)?;
        let out = DataOutput::to_path(self.output.as_deref())?;
        if let Some(on) = &self.on {
            print_note(&format!("waiting for: {on}; Ctrl-C ends it"));
        }
        let Some(position) = &self.target_position else {
            return self.print_log(&plan, &record(axis, &plan, &mut || Ok(()))?, out);
        };
        let axis = axis.clone();
        let session = Session::from(session);
        let verb = if self.rel { Verb::MoveBy } else { Verb::MoveTo };
        let commands: Vec<_> = session
            .axes()
            .iter()
            .map(|axis| {
                let target = motion::parse_argument(axis, verb, Argument::Target, position, false)?;
                Ok((axis.clone(), Command { target: Some(target), ..Command::new(verb) }))
            })
            .collect::<Result<_>>()?;
        let mut log = None;
        let moved = motion::run_recorded(&session, &commands, |start| {
            log = Some(record(&axis, &plan, start)?);
            Ok(())
        });
        // The points were taken, however the move ended.
        let printed = log.map(|log| self.print_log(&plan, &log, out)).transpose();
        moved.and(printed.map(|exit| exit.unwrap_or(Exit::Ok)))
    }

    fn print_log(&self, plan: &DriveLogPlan, log: &DriveLog, mut out: DataOutput) -> Result {
        let points = log.variables.first().map_or(0, |variable| variable.values.len());
        write_log(log, points, self.format, &mut out);
        out.finish()?;
        let (wanted, buffer) = (plan.points(), plan.buffer());
        let notes = format!(
            "{points} points in the drive's {} loop, every {} ms; buffer 0x{:04X} to 0x{:04X}",
            plan.loop_name(),
            plan.interval().as_secs_f64() * 1e3,
            buffer.start(),
            buffer.end()
        );
        print_note(&notes);
        if points < wanted.into() {
            print_warning(&format!("interrupted: {points} of {wanted} points were recorded"));
            return Err(Problem::interrupted());
        }
        Ok(Exit::Ok)
    }

    fn plan(&self, axis: &LocalAxis) -> Result<DriveLogPlan> {
        let names = self.variables.iter().flat_map(|names| names.split(','));
        let variables = names.map(|name| axis.find(name)).collect::<std::result::Result<_, _>>();
        let on = self.on.as_ref().map(|text| axis.parse_log_condition(text)).transpose();
        let variables = variables.map_err(outcome::to_problem)?;
        let request = DriveLogRequest::at_rate(variables, self.rate, self.span);
        let request = DriveLogRequest {
            start_when: on.map_err(outcome::to_problem)?,
            memory: self.buffer.clone(),
            accept_inferred: self.inferred,
            ..request.map_err(outcome::to_problem)?
        };
        axis.plan_drive_log(&request).map_err(outcome::to_problem)
    }
}

/// Records, and calls `start` once: as soon as the drive takes points, or the condition is waited for.
fn record(
    axis: &LocalAxis,
    plan: &DriveLogPlan,
    start: &mut dyn FnMut() -> Result<()>,
) -> Result<DriveLog> {
    let meter = Progress::of_count(0, "points");
    let mut started = None;
    let recorded = axis.record_in_drive(plan, |progress| {
        if progress.stage != DriveLogStage::Waiting {
            meter.set_of(progress.done, progress.total);
        }
        // While the condition is waited for, too: the motion may be what makes it true.
        if started.get_or_insert_with(&mut *start).is_err() {
            return ControlFlow::Break(());
        }
        if interrupt::was_interrupted() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    drop(meter);
    started.unwrap_or(Ok(()))?;
    recorded.map_err(outcome::to_problem)
}

fn write_log(log: &DriveLog, points: usize, format: LogFormat, out: &mut DataOutput) {
    if format == LogFormat::Csv {
        let heads: String = log.variables.iter().map(|it| format!(",{}", head(it))).collect();
        out.write_line(&format!("time [s]{heads}"));
    }
    for point in 0..points {
        let time = log.interval.as_secs_f64() * point as f64;
        let values = log.variables.iter().map(|variable| (variable.name, variable.values[point]));
        match format {
            LogFormat::Csv => {
                let cells: String = values.map(|(_, value)| format!(",{value}")).collect();
                out.write_line(&format!("{time:.6}{cells}"));
            }
            LogFormat::Jsonl => {
                let buffer = out.buffer();
                buffer.extend_from_slice(format!("{{\"time\":{time:.6}").as_bytes());
                for (name, value) in values {
                    buffer.push(b',');
                    jsonl::write_string(buffer, name);
                    // JSON has no NaN.
                    let value =
                        if value.is_finite() { value.to_string() } else { "null".to_owned() };
                    buffer.extend_from_slice(format!(":{value}").as_bytes());
                }
                buffer.extend_from_slice(b"}\n");
            }
        }
    }
}

fn head(variable: &LoggedVariable) -> String {
    match variable.unit.symbol() {
        "" => variable.name.to_owned(),
        _ if variable.is_raw => variable.name.to_owned(),
        symbol => format!("{} [{symbol}]", variable.name),
    }
}

/// Parses a rate: a number, with or without Hz or kHz.
fn parse_rate(text: &str) -> std::result::Result<f64, String> {
    let lower = text.trim().to_ascii_lowercase();
    let (number, factor) = match (lower.strip_suffix("khz"), lower.strip_suffix("hz")) {
        (Some(number), _) => (number, 1e3),
        (None, Some(number)) => (number, 1.0),
        (None, None) => (lower.as_str(), 1.0),
    };
    let rate = number.trim().parse::<f64>().ok().map(|number| number * factor);
    let rate = rate.filter(|rate| *rate > 0.0 && *rate <= 1e6);
    rate.ok_or_else(|| "a rate is a number with Hz or kHz: 500Hz, 1kHz".to_owned())
}

#[cfg(test)]
mod tests {
    use super::parse_rate;

    #[test]
    fn rates_are_read_as_people_write_them() {
        assert_eq!(parse_rate("1kHz"), Ok(1000.0));
        assert_eq!(parse_rate("500 Hz"), Ok(500.0));
        assert_eq!(parse_rate("250"), Ok(250.0));
        assert!(parse_rate("0Hz").is_err() && parse_rate("fast").is_err());
    }
}
