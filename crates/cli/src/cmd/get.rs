//! `polepair get URL NAME…`

use clap::Args;
use polepair::{Axis, Value};
use polepair_capture::jsonl;
use polepair_core::profile::{Access, Parameter, ParameterId};

use crate::cmd::params::no_such_parameter;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::Session;
use crate::target::{Format, Target};
use crate::terminal::{Output, csv, say};

/// Reads parameters by name, with their units. A group answers drive by drive.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair get tmcl+serial:///dev/ttyUSB0#1 \"max current\" \"actual velocity\"
  polepair get sim:tmcl --raw \"AP 6\"
  polepair get sim:modbus-rtu all")]
pub struct Get {
    #[command(flatten)]
    target: Target,
    /// Parameters, by name or by the manual's symbol; `all` reads every one
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Print the numbers as they are on the wire
    #[arg(long)]
    raw: bool,
    /// How they are printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

impl Get {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen();
        let mut out = Output::stdout();
        if self.format == Format::Csv {
            out.line("axis,name,symbol,raw,value,unit");
        }
        let mut failed: Vec<Problem> = Vec::new();
        let mut shown = 0;
        for axis in session.axes() {
            for id in wanted(axis, &self.names)? {
                match each(axis, id) {
                    Ok(values) => {
                        shown += 1;
                        for (number, value) in &values {
                            self.show(&session, (axis, *number), id, value, &mut out);
                        }
                    }
                    Err(problem) if problem.exit == Exit::Refused => failed.push(problem),
                    Err(problem) => {
                        out.flush()?;
                        return Err(problem);
                    }
                }
            }
        }
        out.flush()?;
        partial(failed, shown)
    }

    fn show(
        &self,
        session: &Session,
        (axis, number): (&Axis, u32),
        id: ParameterId,
        value: &Value,
        out: &mut Output,
    ) {
        let Some(parameter) = axis.profile().parameter(id) else { return };
        match self.format {
            Format::Jsonl => object(number, parameter, value, out.buffer()),
            Format::Csv => out.line(&row(number, parameter, value)),
            Format::Text => {
                let shown = if self.raw { value.raw.to_string() } else { value.to_string() };
                let who = match number == axis.number() {
                    true => session.who(axis),
                    false => format!("#{number} "),
                };
                out.line(&format!("{who}{} = {shown}", parameter.name));
            }
        }
    }
}

/// The value of each drive that an axis stands for, with the drive's number.
fn each(axis: &Axis, id: ParameterId) -> Result<Vec<(u32, Value)>> {
    let with_unit = |(number, raw)| Ok((number, axis.value(id, raw)?));
    let parts = axis.read_each(id).and_then(|parts| parts.into_iter().map(with_unit).collect());
    parts.map_err(outcome::error)
}

fn row(number: u32, parameter: &Parameter, value: &Value) -> String {
    let number = number.to_string();
    let (raw, shown) = (value.raw.to_string(), value.value.to_string());
    csv([&number, parameter.name, parameter.symbol, &raw, &shown, value.unit.symbol()])
}

fn object(number: u32, parameter: &Parameter, value: &Value, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{{\"axis\":{number},\"name\":").as_bytes());
    jsonl::string(out, parameter.name);
    out.extend_from_slice(b",\"symbol\":");
    jsonl::string(out, parameter.symbol);
    out.extend_from_slice(format!(",\"raw\":{},\"value\":", value.raw).as_bytes());
    jsonl::real(out, value.value);
    out.extend_from_slice(b",\"unit\":");
    jsonl::string(out, value.unit.symbol());
    out.extend_from_slice(b"}\n");
}

/// The parameters that are meant on an axis.
fn wanted(axis: &Axis, names: &[String]) -> Result<Vec<ParameterId>> {
    if names.len() == 1 && names[0] == "all" {
        let readable = |(_, p): &(usize, &Parameter)| p.access != Access::Write;
        let every = axis.profile().parameters.iter().enumerate().filter(readable);
        return Ok(every.filter_map(|(at, _)| u16::try_from(at).ok().map(ParameterId)).collect());
    }
    names.iter().map(|name| named(axis, name)).collect()
}

/// The parameter of that name.
pub fn named(axis: &Axis, name: &str) -> Result<ParameterId> {
    axis.profile().find(name).ok_or_else(|| no_such_parameter(axis.profile(), name))
}

/// What became of several requests of which some were refused.
pub fn partial(mut failed: Vec<Problem>, done: usize) -> Result {
    match (failed.len(), done) {
        (0, _) => Ok(Exit::Ok),
        (1, 0) => Err(failed.remove(0)),
        (count, _) => {
            failed.iter().for_each(|problem| say(problem.render(false).trim_end()));
            let what = format!("{count} of {} were refused.", count + done);
            Err(Problem::new(Exit::Partial, "E701", what).why("The others were carried out."))
        }
    }
}
