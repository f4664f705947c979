//! `polepair get URL NAME…`

use std::path::{Path, PathBuf};

use clap::Args;
use polepair::Axis;
use polepair::interface::ReadValue;
use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_core::profile::ParameterId;

use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::ServerArgs;
use crate::session::Session;
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{csv_line, print_note, print_warning};
use crate::value::plural;

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
    pub fn run(self, server: ServerArgs) -> Result {
        let session = self.target.connect(server)?;
        session.listen_for_interrupts();
        if let Some(file) = &self.output {
            return self.save_data(&session, file);
        }
        let mut out = DataOutput::stdout().with_text(self.format == OutputFormat::Text);
        if self.format == OutputFormat::Csv {
            let link = if session.link.remote().is_some() { "link," } else { "" };
            out.write_line(&format!("axis,{link}{CSV_HEADER}"));
        }
        let mut tally = ReadTally::default();
        for axis in session.axes() {
            for id in requested_parameters(axis, &self.names)? {
                let read = axis.interface().read_each(id).map_err(outcome::to_problem);
                for (number, value) in tally.collect(read, &mut out)?.iter().flatten() {
                    if !self.raw {
                        axis.local().inspect(|axis| outcome::note_missing_unit(axis, id));
                    }
                    self.print_value(&session, axis, *number, value, &mut out);
                }
            }
        }
        tally.finish(&mut out)
    }

    /// Saves the bytes of one parameter, block by block where the drive can.
    fn save_data(&self, session: &Session, file: &Path) -> Result {
        let ([axis], [name]) = (session.axes(), &self.names[..]) else {
            let what = "-o saves one parameter of one axis.";
            return Err(Problem::usage("E242", what).hint("polepair get URL#1 0x1F50:1 -o FILE"));
        };
        let id = axis.find(name).map_err(outcome::to_problem)?;
        let data = match axis.local() {
            None => axis.interface().read_data(id),
            Some(axis) => {
                let progress = Progress::of_transfer("read");
                axis.read_data(id, true, &mut |count| progress.set(count))
            }
        };
        let data = data.map_err(outcome::to_problem)?;
        let mut out = DataOutput::to_path(Some(file))?;
        out.buffer().extend_from_slice(&data);
        out.finish()?;
        print_note(&format!("{} saved in {}", plural(data.len() as u64, "byte"), file.display()));
        Ok(Exit::Ok)
    }

    fn print_value(
        &self,
        session: &Session,
        axis: &Axis,
        number: u32,
        read: &ReadValue,
        out: &mut DataOutput,
    ) {
        let link = axis.remote().map(|axis| axis.info().link);
        match self.format {
            OutputFormat::Jsonl => write_json(number, link, read, out.buffer()),
            OutputFormat::Csv => out.write_line(&csv_row((number, link), read)),
            OutputFormat::Text => {
                let who = if number == axis.number() {
                    session.axis_prefix(axis)
                } else {
                    format!("#{number} ")
                };
                let raw = read.raw_text().filter(|_| self.raw);
                out.write_line(&format!(
                    "{who}{} = {}",
                    read.name,
                    raw.unwrap_or_else(|| read.to_string())
                ));
            }
        }
    }
}

/// Tally of the reads so far: a refusal by a drive ends none of the others.
#[derive(Default)]
struct ReadTally {
    failed: Vec<Problem>,
    shown: usize,
}

impl ReadTally {
    /// The read value, or nothing for a refusal. Any other error ends all, after the values read so far.
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

fn csv_row(axis: (u32, Option<u16>), read: &ReadValue) -> String {
    let (number, link) = axis;

    let axis = match link {
        Some(link) => format!("{},{link}", AxisNumber(number)),
        None => AxisNumber(number).to_string(),
    };
    let raw = read.raw_text().unwrap_or_default();
    let value = read.raw.map_or_else(|| read.text.clone(), |_| read.value.to_string());
    format!("{axis},{}", csv_line([&*read.name, &read.symbol, &raw, &value, &read.unit]))
}

fn write_json(number: u32, link: Option<u16>, read: &ReadValue, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{{\"axis\":{},", AxisNumber(number).json()).as_bytes());
    if let Some(link) = link {
        out.extend_from_slice(format!("\"link\":{link},").as_bytes());
    }
    out.extend_from_slice(b"\"name\":");
    jsonl::write_string(out, &read.name);
    out.extend_from_slice(b",\"symbol\":");
    jsonl::write_string(out, &read.symbol);
    let raw = read.raw_text().unwrap_or_else(|| "null".to_owned());
    out.extend_from_slice(format!(",\"raw\":{raw},\"value\":").as_bytes());
    match read.raw {
        Some(_) => jsonl::write_real(out, read.value),
        None => jsonl::write_string(out, &read.text),
    }
    out.extend_from_slice(b",\"unit\":");
    jsonl::write_string(out, &read.unit);
    out.extend_from_slice(b"}\n");
}

/// The parameters that are meant on an axis.
fn requested_parameters(axis: &Axis, names: &[String]) -> Result<Vec<ParameterId>> {
    if names.len() == 1 && names[0] == "all" {
        // A domain may be a whole firmware: it is read only by its name.
        let every = axis.parameters().map_err(outcome::to_problem)?;
        let listed = every.iter().filter(|its| its.readable && its.kind != "bytes");
        return listed.map(|its| axis.find(&its.name).map_err(outcome::to_problem)).collect();
    }
    let find = |name: &String| axis.find(name).or_else(|why| value_signal(axis, name).ok_or(why));
    names.iter().map(find).collect::<std::result::Result<_, _>>().map_err(outcome::to_problem)
}

/// The parameter whose whole value is the signal of that name: `position`, `velocity`.
fn value_signal(axis: &Axis, name: &str) -> Option<ParameterId> {
    let local = axis.local()?;
    let (id, signal) = local.find_signal_or_parameter(name).ok()?;
    let source = local.profile().signal(signal?)?;
    (source.mask == -1 && !source.is_flag()).then_some(id)
}

/// Result of several requests of which some were refused.
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
