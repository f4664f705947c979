//! `polepair get URL NAME…`

use std::path::{Path, PathBuf};

use clap::Args;
use polepair::LocalAxis;
use polepair::axis::ParameterValue;
use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_client::message::{AxisInfo, ParameterReading};
use polepair_core::profile::{Access, Encoding, Parameter, ParameterId};

use crate::cmd::params::no_such_parameter;
use crate::cmd::record::plural;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::{self, RemoteSession};
use crate::session::LocalSession;
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{DataOutput, csv_line, print_note, print_warning};

/// The columns after the axis.
const CSV_HEADER: &str = "name,symbol,raw,value,unit";

/// Reads parameters by name or number, with units. On several axes, the values of each drive are printed.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair get tmcl+serial:///dev/ttyUSB0#1 \"max current\" \"actual velocity\"
  polepair get sim:tmcl --raw \"AP 6\"
  polepair get sim:modbus-rtu all
  polepair get canopen+socketcan://can0#5 0x1018:1 2030h:1:u16 1008h
  polepair get canopen+socketcan://can0#5 0x1F50:1 -o firmware.bin

Numbers: 0x2030:1:u16 (CANopen), 0x33 or \"R 51\" (Modbus), \"AP 6\", \"GP 66\" (TMCL),
@0x0228:i32 (TML), \"SP 12\" (thruster); see docs/reference/addresses.md")]
pub struct Get {
    #[command(flatten)]
    target: DriveArgs,
    /// Parameters by name, manual symbol or number; `all` reads every parameter
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Print raw values, as they are on the wire
    #[arg(long)]
    raw: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
    /// File for the bytes of one parameter
    #[arg(long, short = 'o', value_name = "FILE", conflicts_with_all = ["raw", "format"])]
    output: Option<PathBuf>,
}

impl Get {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        if let Some(file) = &self.output {
            return self.save_data(&session, file);
        }
        let mut out = DataOutput::stdout();
        if self.format == OutputFormat::Csv {
            out.write_line(&format!("axis,{CSV_HEADER}"));
        }
        let mut tally = ReadTally::default();
        for axis in session.axes() {
            for id in requested_parameters(axis, &self.names)? {
                let read = tally.collect(read_each_value(axis, id), &mut out)?;
                for (number, value) in read.iter().flatten() {
                    self.print_value(&session, (axis, *number), id, value, &mut out);
                }
            }
        }
        tally.finish(&mut out)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        let axes = server.axes_named(self.target.remote_axes()?)?;
        let mut out = DataOutput::stdout();
        if self.format == OutputFormat::Csv {
            out.write_line(&format!("axis,link,{CSV_HEADER}"));
        }
        let mut tally = ReadTally::default();
        for axis in &axes {
            for name in requested_names(server, axis, &self.names)? {
                let read =
                    server.gateway.parameter(axis.id, &name).map_err(remote::refusal_problem);
                if let Some(read) = tally.collect(read, &mut out)? {
                    let who = server.axis_prefix(&axes, axis);
                    self.print_row(&who, &remote_row(axis, &read), &mut out);
                }
            }
        }
        tally.finish(&mut out)
    }

    /// Saves the bytes of one parameter, block by block where the drive can.
    fn save_data(&self, session: &LocalSession, file: &Path) -> Result {
        let ([axis], [name]) = (session.axes(), &self.names[..]) else {
            let what = "-o saves one parameter of one axis.";
            return Err(Problem::usage("E242", what).hint("polepair get URL#1 0x1F50:1 -o FILE"));
        };
        let id = find_parameter(axis, name)?;
        let progress = Progress::of_transfer("read");
        let data = axis.read_data(id, true, &mut |count| progress.set(count));
        let data = data.map_err(outcome::to_problem)?;
        drop(progress);
        let mut out = DataOutput::to_path(Some(file))?;
        out.buffer().extend_from_slice(&data);
        out.flush()?;
        print_note(&format!("{} saved in {}", plural(data.len() as u64, "byte"), file.display()));
        Ok(Exit::Ok)
    }

    fn print_value(
        &self,
        session: &LocalSession,
        (axis, number): (&LocalAxis, u32),
        id: ParameterId,
        read: &ParameterValue,
        out: &mut DataOutput,
    ) {
        let Some(Parameter { name, symbol, .. }) = axis.parameter(id) else { return };
        let who = match number == axis.number() {
            true => session.axis_prefix(axis),
            false => format!("#{number} "),
        };
        if !self.raw {
            outcome::note_missing_unit(axis, id);
        }
        let (value, link, text) = (read.number(), None, read.to_string());
        let raw = value.map(polepair::Value::raw_text);
        let unit = value.map_or("", |value| value.unit.symbol());
        let value = value.map(|value| value.value);
        self.print_row(&who, &ReadRow { number, link, name, symbol, raw, value, unit, text }, out);
    }

    fn print_row(&self, who: &str, read: &ReadRow<'_>, out: &mut DataOutput) {
        match self.format {
            OutputFormat::Jsonl => write_json(read, out.buffer()),
            OutputFormat::Csv => out.write_line(&csv_row(read)),
            OutputFormat::Text => {
                let raw = read.raw.as_ref().filter(|_| self.raw);
                out.write_line(&format!("{who}{} = {}", read.name, raw.unwrap_or(&read.text)));
            }
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
    /// None for text and bytes.
    raw: Option<String>,
    /// None for text and bytes.
    value: Option<f64>,
    unit: &'a str,
    text: String,
}

fn remote_row<'a>(axis: &AxisInfo, read: &'a ParameterReading) -> ReadRow<'a> {
    let number_shown = read.value.map(|value| remote::format_value(value, &read.unit));
    let raw_shown = read.raw.map(|raw| format!("{raw} raw"));
    let text = read.word.clone().or(number_shown).or(raw_shown).unwrap_or(read.text.clone());
    let ParameterReading { name, symbol, unit, .. } = read;
    let value = read.raw.map(|_| read.value.unwrap_or(f64::NAN));
    let raw = read.raw.map(|raw| raw.to_string());
    let (number, link) = (axis.number, Some(axis.link));
    ReadRow { number, link, name, symbol, raw, value, unit, text }
}

/// The names that are meant.
fn requested_names(
    server: &RemoteSession,
    axis: &AxisInfo,
    names: &[String],
) -> Result<Vec<String>> {
    if !matches!(names, [all] if all == "all") {
        return Ok(names.to_vec());
    }
    let has = server.gateway.parameters(axis.id).map_err(remote::refusal_problem)?;
    Ok(has.into_iter().filter(|its| its.readable).map(|its| its.name).collect())
}

/// The value of each drive that an axis stands for, with the drive's number.
fn read_each_value(axis: &LocalAxis, id: ParameterId) -> Result<Vec<(u32, ParameterValue)>> {
    if !AxisNumber(axis.number()).is_group() {
        let read = axis.read_any(id).map_err(outcome::to_problem)?;
        return Ok(vec![(axis.number(), read)]);
    }
    let with_unit = |(number, raw)| Ok((number, ParameterValue::Number(axis.value(id, raw)?)));
    let parts = axis.read_each(id).and_then(|parts| parts.into_iter().map(with_unit).collect());
    parts.map_err(outcome::to_problem)
}

fn csv_row(read: &ReadRow<'_>) -> String {
    let axis = match read.link {
        Some(link) => format!("{},{link}", AxisNumber(read.number)),
        None => AxisNumber(read.number).to_string(),
    };
    let raw = read.raw.as_deref().unwrap_or("");
    let value = read.value.map_or_else(|| read.text.clone(), |value| value.to_string());
    format!("{axis},{}", csv_line([read.name, read.symbol, raw, &value, read.unit]))
}

fn write_json(read: &ReadRow<'_>, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{{\"axis\":{},", AxisNumber(read.number).json()).as_bytes());
    if let Some(link) = read.link {
        out.extend_from_slice(format!("\"link\":{link},").as_bytes());
    }
    out.extend_from_slice(b"\"name\":");
    jsonl::write_string(out, read.name);
    out.extend_from_slice(b",\"symbol\":");
    jsonl::write_string(out, read.symbol);
    let raw = read.raw.as_deref().unwrap_or("null");
    out.extend_from_slice(format!(",\"raw\":{raw},\"value\":").as_bytes());
    match read.value {
        Some(value) => jsonl::write_real(out, value),
        None => jsonl::write_string(out, &read.text),
    }
    out.extend_from_slice(b",\"unit\":");
    jsonl::write_string(out, read.unit);
    out.extend_from_slice(b"}\n");
}

/// The parameters that are meant on an axis.
fn requested_parameters(axis: &LocalAxis, names: &[String]) -> Result<Vec<ParameterId>> {
    if names.len() == 1 && names[0] == "all" {
        // A domain may be a whole firmware: it is read where somebody names it.
        let readable = |(_, p): &(usize, &Parameter)| {
            p.access != Access::Write && p.encoding != Encoding::Bytes
        };
        let every = axis.profile().parameters.iter().enumerate().filter(readable);
        return Ok(every.filter_map(|(at, _)| u16::try_from(at).ok().map(ParameterId)).collect());
    }
    names.iter().map(|name| find_parameter(axis, name)).collect()
}

/// The parameter of that name, or at that address.
pub fn find_parameter(axis: &LocalAxis, name: &str) -> Result<ParameterId> {
    if let Some(id) = axis.profile().find_parameter(name) {
        return Ok(id);
    }
    let addressed = axis.find_address(name).map_err(outcome::to_problem)?;
    addressed.ok_or_else(|| {
        let example = axis.address_example();
        let problem = no_such_parameter(axis.profile(), name);
        problem.hint(format!("{example:?} is an example of a number"))
    })
}

/// What became of several requests of which some were refused.
pub fn partial_result(mut failed: Vec<Problem>, done: usize) -> Result {
    match (failed.len(), done) {
        (0, _) => Ok(Exit::Ok),
        (1, 0) => Err(failed.remove(0)),
        (count, _) => {
            failed.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
            let what = format!("{count} of {} were refused.", count + done);
            Err(Problem::new(Exit::Partial, "E701", what).why("The others were executed."))
        }
    }
}
