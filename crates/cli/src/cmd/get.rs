//! `polepair get URL NAME…`

use clap::Args;
use polepair::{Axis, Value};
use polepair_capture::jsonl;
use polepair_client::message::{AxisInfo, ParameterInfo, ParameterReading};
use polepair_core::profile::{Access, Parameter, ParameterId};

use crate::cmd::params::no_such_parameter;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession};
use crate::session::Session;
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{DataOutput, csv_line, print_note};

/// The columns after the axis.
const CSV_HEADER: &str = "name,symbol,raw,value,unit";

/// Reads parameters by name, with their units. A group answers drive by drive.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair get tmcl+serial:///dev/ttyUSB0#1 \"max current\" \"actual velocity\"
  polepair get sim:tmcl --raw \"AP 6\"
  polepair get sim:modbus-rtu all")]
pub struct Get {
    #[command(flatten)]
    target: DriveArgs,
    /// Parameters, by name or by the manual's symbol; `all` reads every one
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Print the numbers as they are on the wire
    #[arg(long)]
    raw: bool,
    /// How they are printed
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
}

impl Get {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        if self.format == OutputFormat::Csv {
            out.write_line(&format!("axis,{CSV_HEADER}"));
        }
        let mut tally = ReadTally::default();
        for axis in session.axes() {
            for id in requested_parameters(axis, &self.names)? {
                for (number, value) in
                    tally.collect(read_each_value(axis, id), &mut out)?.iter().flatten()
                {
                    self.print_value(&session, (axis, *number), id, value, &mut out);
                }
            }
        }
        tally.finish(&mut out)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        let axes = server.axes_of(&self.target)?;
        let mut out = DataOutput::stdout();
        if self.format == OutputFormat::Csv {
            out.write_line(&format!("axis,link,{CSV_HEADER}"));
        }
        let mut tally = ReadTally::default();
        for axis in &axes {
            let has = server.gateway.parameters(axis.id).map_err(remote::refusal_problem)?;
            for name in requested_names(&has, &self.names) {
                let read =
                    server.gateway.parameter(axis.id, &name).map_err(remote::refusal_problem);
                if let Some(read) = tally.collect(read, &mut out)? {
                    let who = server.axis_prefix(&axes, axis);
                    let symbol = has.iter().find(|its| its.name == read.name);
                    let symbol = symbol.map_or("", |its| &its.symbol);
                    self.print_row(&who, &remote_row(axis, symbol, &read), &mut out);
                }
            }
        }
        tally.finish(&mut out)
    }

    fn print_value(
        &self,
        session: &Session,
        (axis, number): (&Axis, u32),
        id: ParameterId,
        value: &Value,
        out: &mut DataOutput,
    ) {
        let Some(Parameter { name, symbol, .. }) = axis.profile().parameter(id) else { return };
        let who = match number == axis.number() {
            true => session.axis_prefix(axis),
            false => format!("#{number} "),
        };
        if !self.raw {
            outcome::note_missing_unit(axis, id);
        }
        let (raw, text, unit) = (value.raw, value.to_string(), value.unit.symbol());
        let (value, link) = (value.value, None);
        self.print_row(&who, &ReadRow { number, link, name, symbol, raw, value, unit, text }, out);
    }

    fn print_row(&self, who: &str, read: &ReadRow<'_>, out: &mut DataOutput) {
        match self.format {
            OutputFormat::Jsonl => write_json(read, out.buffer()),
            OutputFormat::Csv => out.write_line(&csv_row(read)),
            OutputFormat::Text if self.raw => {
                out.write_line(&format!("{who}{} = {}", read.name, read.raw))
            }
            OutputFormat::Text => out.write_line(&format!("{who}{} = {}", read.name, read.text)),
        }
    }
}

/// What became of the reads so far: what a drive refuses ends none of the others.
#[derive(Default)]
struct ReadTally {
    failed: Vec<Problem>,
    shown: usize,
}

impl ReadTally {
    /// What was read, or nothing where it was refused. Anything else ends all, after what was read.
    fn collect<T>(&mut self, read: Result<T>, out: &mut DataOutput) -> Result<Option<T>> {
        match read {
            Ok(read) => {
                self.shown += 1;
                Ok(Some(read))
            }
            Err(problem) if problem.exit == Exit::Refused => {
                self.failed.push(problem);
                Ok(None)
            }
            Err(problem) => {
                out.flush()?;
                Err(problem)
            }
        }
    }

    fn finish(self, out: &mut DataOutput) -> Result {
        out.flush()?;
        partial_result(self.failed, self.shown)
    }
}

/// What was read, as it is printed.
struct ReadRow<'a> {
    number: u32,
    /// Of a server: it has several, each with its own numbers.
    link: Option<u16>,
    name: &'a str,
    symbol: &'a str,
    raw: i64,
    value: f64,
    unit: &'a str,
    text: String,
}

fn remote_row<'a>(axis: &AxisInfo, symbol: &'a str, read: &'a ParameterReading) -> ReadRow<'a> {
    let value = read.value.unwrap_or(f64::NAN);
    let number_shown = read.value.map(|value| remote::format_value(value, &read.unit));
    let text = read.word.clone().or(number_shown).unwrap_or_else(|| format!("{} raw", read.raw));
    let ParameterReading { name, raw, unit, .. } = read;
    let (number, link) = (axis.number, Some(axis.link));
    ReadRow { number, link, name, symbol, raw: *raw, value, unit, text }
}

/// The names that are meant.
fn requested_names(has: &[ParameterInfo], names: &[String]) -> Vec<String> {
    match names {
        [all] if all == "all" => {
            has.iter().filter(|its| its.readable).map(|its| its.name.clone()).collect()
        }
        _ => names.to_vec(),
    }
}

/// The value of each drive that an axis stands for, with the drive's number.
fn read_each_value(axis: &Axis, id: ParameterId) -> Result<Vec<(u32, Value)>> {
    let with_unit = |(number, raw)| Ok((number, axis.value(id, raw)?));
    let parts = axis.read_each(id).and_then(|parts| parts.into_iter().map(with_unit).collect());
    parts.map_err(outcome::to_problem)
}

fn csv_row(read: &ReadRow<'_>) -> String {
    let axis = match read.link {
        Some(link) => format!("{},{link}", read.number),
        None => read.number.to_string(),
    };
    let (raw, value) = (read.raw.to_string(), read.value.to_string());
    format!("{axis},{}", csv_line([read.name, read.symbol, &raw, &value, read.unit]))
}

fn write_json(read: &ReadRow<'_>, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{{\"axis\":{},", read.number).as_bytes());
    if let Some(link) = read.link {
        out.extend_from_slice(format!("\"link\":{link},").as_bytes());
    }
    out.extend_from_slice(b"\"name\":");
    jsonl::write_string(out, read.name);
    out.extend_from_slice(b",\"symbol\":");
    jsonl::write_string(out, read.symbol);
    out.extend_from_slice(format!(",\"raw\":{},\"value\":", read.raw).as_bytes());
    jsonl::write_real(out, read.value);
    out.extend_from_slice(b",\"unit\":");
    jsonl::write_string(out, read.unit);
    out.extend_from_slice(b"}\n");
}

/// The parameters that are meant on an axis.
fn requested_parameters(axis: &Axis, names: &[String]) -> Result<Vec<ParameterId>> {
    if names.len() == 1 && names[0] == "all" {
        let readable = |(_, p): &(usize, &Parameter)| p.access != Access::Write;
        let every = axis.profile().parameters.iter().enumerate().filter(readable);
        return Ok(every.filter_map(|(at, _)| u16::try_from(at).ok().map(ParameterId)).collect());
    }
    names.iter().map(|name| find_parameter(axis, name)).collect()
}

/// The parameter of that name.
pub fn find_parameter(axis: &Axis, name: &str) -> Result<ParameterId> {
    axis.profile().find_parameter(name).ok_or_else(|| no_such_parameter(axis.profile(), name))
}

/// What became of several requests of which some were refused.
pub fn partial_result(mut failed: Vec<Problem>, done: usize) -> Result {
    match (failed.len(), done) {
        (0, _) => Ok(Exit::Ok),
        (1, 0) => Err(failed.remove(0)),
        (count, _) => {
            failed.iter().for_each(|problem| print_note(problem.render(false).trim_end()));
            let what = format!("{count} of {} were refused.", count + done);
            Err(Problem::new(Exit::Partial, "E701", what).why("The others were carried out."))
        }
    }
}
