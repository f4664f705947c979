//! `polepair set URL NAME=VALUE…`

mod data_write;
mod readdress;

use std::collections::BTreeMap;

use clap::Args;
use polepair::axis::PendingWrites;
use polepair::{Amount, LocalAxis};
use polepair_client::message::{ParameterChange, ParameterInput, WriteParameters};
use polepair_core::profile::{Access, Parameter, ParameterId, Persistence};

use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession};
use crate::session::{LocalSession, read_parameter};
use crate::target::DriveArgs;
use crate::terminal::{DataOutput, print_note};
use crate::value;
use data_write::DataWrite;
use polepair_serve::message::ParameterInfo;
use readdress::AddressChange;

/// Writes parameters by name or number, with units. Values are checked against their limits first.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair set tmcl+serial:///dev/ttyUSB0#1 \"max current=1.2A\"
  polepair set sim:tmcl \"AP 6=12\" --store
  polepair set sim:modbus-rtu \"internal speed=200rpm\" --arm
  polepair set canopen+socketcan://can0#5 0x2030:1:u16=5 --arm
  polepair set canopen+socketcan://can0#5 0x1F50:1=@firmware.bin

Behind a name, a number without a unit is in the parameter's unit. Behind the maker's own symbol or number
(AP 6, CSPD, 0x6083) it is the drive's own number: 12 is 1.2 A for AP 6. The reply shows both.

An object that no table describes needs --arm, because its effect is unknown.")]
pub struct Set {
    #[command(flatten)]
    target: DriveArgs,
    /// NAME=VALUE; VALUE is a number with or without unit, a value name, or @FILE for bytes
    #[arg(required = true, value_name = "NAME=VALUE")]
    settings: Vec<String>,
    /// Values are raw numbers, as on the wire
    #[arg(long)]
    raw: bool,
    /// Save the settings to the drive's permanent memory
    #[arg(long)]
    store: bool,
    /// Allow writes that may start or change motion
    #[arg(long)]
    arm: bool,
    /// Print what would change, and write nothing
    #[arg(long)]
    dry_run: bool,
}

impl Set {
    /// Runs the verb on a server, which checks all values before it writes the first.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        if self.arm {
            let why = "A server writes nothing that may move the motor.";
            return Err(remote::unsupported_problem("--arm", why));
        }
        let mut values = BTreeMap::new();
        for setting in &self.settings {
            let (name, value) = split_assignment(setting)?;
            let input = if self.raw {
                // A server of an older version takes raw values as numbers alone.
                ParameterInput::Number(parse_raw(value)? as f64)
            } else {
                ParameterInput::Text(value.to_owned())
            };
            values.insert(name.to_owned(), input);
        }
        let live = server.gateway.live().map_err(remote::refusal_problem)?;
        let axes = server.axes_named(self.target.remote_axes()?)?;
        let mut out = DataOutput::stdout();
        for axis in &axes {
            let who = server.axis_prefix(&axes, axis);
            let (values, dry_run) = (values.clone(), self.dry_run);
            let write =
                WriteParameters { values, keep: self.store, dry_run, raw: self.raw, epoch: 0 };
            if self.dry_run {
                let plan = server
                    .gateway
                    .write_parameters(axis.id, &write)
                    .map_err(remote::refusal_problem)?;
                plan.iter().for_each(|change| {
                    out.write_line(&format!("{who}{}", remote_planned_change(change)))
                });
                continue;
            }
            let has = server.gateway.parameters(axis.id).map_err(remote::refusal_problem)?;
            // After everything was read: other clients wait while it is held.
            let lease = live.acquire_lease(axis.id).map_err(remote::refusal_problem)?;
            let write = WriteParameters { epoch: lease.epoch(), ..write };
            for change in
                server.gateway.write_parameters(axis.id, &write).map_err(remote::refusal_problem)?
            {
                if is_readable(&change.name, &has) {
                    self.read_back(server, axis.id, &who, &change, &mut out)?
                } else {
                    out.write_line(&format!("{who}{}", written_text(&change)))
                }
                out.flush()?;
            }
            lease.release().map_err(remote::refusal_problem)?;
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// Reads back what a server wrote.
    fn read_back(
        &self,
        server: &RemoteSession,
        axis: u16,
        who: &str,
        change: &ParameterChange,
        out: &mut DataOutput,
    ) -> Result<()> {
        let name = &change.name;
        let shown = |value| remote::format_value(value, &change.unit);
        let read = match server.gateway.parameter(axis, name) {
            Ok(read) => read,
            Err(error) => {
                let problem = remote::refusal_problem(error);
                print_note(&not_read_back_text(who.trim_end(), name, &problem));
                out.write_line(&format!("{who}{} (written, not read back)", written_text(change)));
                return Ok(());
            }
        };
        let now = read.value.map_or(read.text, shown);
        let now = match read.raw.filter(|_| self.raw) {
            Some(raw) => raw.to_string(),
            None if read.value == Some(change.to) => new_value_text(change),
            None => read.word.unwrap_or(now),
        };
        out.write_line(&format!("{who}{name} = {now}"));
        if read.value == Some(change.to) {
            return Ok(());
        }
        let what = format!("{name:?} did not keep what was written.");
        Err(Problem::new(Exit::Negative, "E111", what)
            .why(format!("{} was written and accepted.", shown(change.to))))
    }

    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        let mut changes = Vec::new();
        for axis in session.axes() {
            // All are checked before the first is written. What scales others goes first, and they are
            // what they mean by it.
            let (mut wanted, mut data_writes) = (Vec::new(), Vec::new());
            for setting in &self.settings {
                let (name, value) = split_assignment(setting)?;
                let id = axis.find(name).map_err(outcome::to_problem)?;
                match DataWrite::for_setting(axis, id, value)? {
                    Some(write) => data_writes.push(write),
                    None => wanted.push((id, name, value)),
                }
            }
            wanted.sort_by_key(|(id, ..)| !axis.scales(*id));
            let (mut writes, mut pending) = (Vec::new(), PendingWrites::default());
            for (id, name, value) in wanted {
                let raw = self.raw_value(axis, id, name, value, &pending)?;
                pending.insert(id, raw);
                match AddressChange::for_setting(axis, id, raw)? {
                    Some(change) if !self.dry_run => changes.push(change),
                    _ => writes.push((id, raw)),
                }
            }
            AddressChange::check(&session, &changes)?;
            if self.dry_run {
                for (id, raw) in writes {
                    let planned = planned_change(axis, id, raw, &pending)?;
                    out.write_line(&format!("{}{planned}", session.axis_prefix(axis)));
                }
                for write in &data_writes {
                    out.write_line(&format!("{}{}", session.axis_prefix(axis), write.planned()));
                }
                continue;
            }
            if self.arm {
                axis.arm(true);
            }
            for (id, raw) in writes {
                self.write_one(&session, axis, id, raw, &mut out)?;
                out.flush()?;
            }
            for write in &data_writes {
                let written = write.apply(axis)?;
                out.write_line(&format!("{}{written}", session.axis_prefix(axis)));
                out.flush()?;
            }
            // Also where nothing moved: the next program must not find it armed.
            axis.arm(false);
        }
        debug_assert!(changes.len() <= 1, "checked with the first axis");
        // Last, because afterwards the drive no longer answers at this address.
        if let Some(change) = changes.pop() {
            change.apply(&self.target, session, self.store, &mut out)?;
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// The raw value that `text` means once what is pending was written, within the limits.
    fn raw_value(
        &self,
        axis: &LocalAxis,
        id: ParameterId,
        name: &str,
        text: &str,
        pending: &PendingWrites,
    ) -> Result<i64> {
        let Some(parameter) = axis.parameter(id) else { return Ok(0) };
        if self.raw {
            return parse_raw(text);
        }
        if let Some(raw) = parse_switch(parameter, text) {
            return Ok(raw);
        }
        let amount = axis.amount_for_name(name, id, Amount::from(text));
        let raw = amount.and_then(|amount| axis.raw_of_after(id, &amount, pending));
        let raw = raw.map_err(outcome::to_problem)?;
        if !parameter.allows(raw) {
            return Err(out_of_range(axis, id, parameter, text));
        }
        Ok(raw)
    }

    fn write_one(
        &self,
        session: &LocalSession,
        axis: &LocalAxis,
        id: ParameterId,
        raw: i64,
        out: &mut DataOutput,
    ) -> Result<()> {
        let Some(parameter) = axis.parameter(id) else { return Ok(()) };
        axis.write(id, raw, self.store).map_err(outcome::to_problem)?;
        let value = match parameter.access {
            Access::Write => axis.value(id, raw).map_err(outcome::to_problem)?,
            _ => match read_parameter(axis, id) {
                Ok(value) => value,
                // The outcome of a write is the write's.
                Err(problem) => {
                    let shown = if self.raw {
                        raw.to_string()
                    } else {
                        axis.value(id, raw).map_or(raw.to_string(), |v| v.text_with_own())
                    };
                    print_note(&not_read_back_text(&axis.label(), parameter.name, &problem));
                    out.write_line(&format!(
                        "{}{} = {shown} (written, not read back)",
                        session.axis_prefix(axis),
                        parameter.name
                    ));
                    return Ok(());
                }
            },
        };
        let shown = if self.raw { value.raw.to_string() } else { value.text_with_own() };
        out.write_line(&format!("{}{} = {shown}", session.axis_prefix(axis), parameter.name));
        if value.raw == raw {
            if axis.profile().link_settings.contains(&id) {
                let stored = parameter.persistence == Persistence::Storable && !self.store;
                let lost = if stored { " It is lost at power-off: --store keeps it." } else { "" };
                print_note(&format!(
                    "{} is addressed by its {}: change the connection string too when it takes \
                     effect. {}{lost}",
                    axis.label(),
                    parameter.name,
                    parameter.about
                ));
            }
            return Ok(());
        }
        let what = format!("{:?} did not keep what was written.", parameter.name);
        Err(Problem::new(Exit::Negative, "E111", what)
            .why(format!("{raw} raw was written and accepted, {} raw is read back.", value.raw)))
    }
}

fn is_readable(name: &str, has: &[ParameterInfo]) -> bool {
    has.iter().any(|its| its.name == name && its.readable)
}

/// Why a value that was written is not shown as it was read.
fn not_read_back_text(label: &str, name: &str, problem: &Problem) -> String {
    let label = if label.is_empty() { String::new() } else { format!("{label}: ") };
    format!("{label}`{name}` was written; it could not be read back: {}", problem.what)
}

/// Change of a planned write: the value is read, and nothing is written.
fn planned_change(
    axis: &LocalAxis,
    id: ParameterId,
    raw: i64,
    pending: &PendingWrites,
) -> Result<String> {
    let Some(parameter) = axis.parameter(id) else { return Ok(String::new()) };
    let to = axis.value_after(id, raw, pending).map_err(outcome::to_problem)?;
    let from = match parameter.access {
        Access::Write => None,
        _ => Some(read_parameter(axis, id)?.text_with_own()),
    };
    Ok(change_text(parameter.name, from, &to.text_with_own()))
}

/// Planned change by a server.
fn remote_planned_change(change: &ParameterChange) -> String {
    let (name, to) = (&change.name, new_value_text(change));
    let from = change.from.map(|from| {
        if change.from_text.is_empty() {
            remote::format_value(from, &change.unit)
        } else {
            change.from_text.clone()
        }
    });
    match from {
        Some(_) if !change.changed => format!("{name} = {to}, as it is"),
        from => change_text(name, from, &to),
    }
}

/// New value of a parameter, with the drive's own number if the server gives it.
fn new_value_text(change: &ParameterChange) -> String {
    if change.to_text.is_empty() {
        remote::format_value(change.to, &change.unit)
    } else {
        change.to_text.clone()
    }
}

fn change_text(name: &str, from: Option<String>, to: &str) -> String {
    match from {
        Some(from) if from == to => format!("{name} = {to}, as it is"),
        Some(from) => format!("{name}: {from} -> {to}"),
        None => format!("{name}: -> {to}"),
    }
}

/// Line for a written value that cannot be read back.
fn written_text(change: &ParameterChange) -> String {
    format!("{} = {}", change.name, new_value_text(change))
}

fn split_assignment(setting: &str) -> Result<(&str, &str)> {
    setting.split_once('=').map(|(name, value)| (name.trim(), value.trim())).ok_or_else(|| {
        Problem::usage("E242", format!("{setting:?} is not NAME=VALUE."))
            .why(outcome::sent_so_far())
            .hint(format!("polepair get URL {setting:?} reads it"))
    })
}

/// A raw number, as on the wire.
fn parse_raw(text: &str) -> Result<i64> {
    value::parse_whole(text).ok_or_else(|| {
        let what = format!("{text:?} is not a whole number.");
        Problem::usage("E217", what).why(outcome::sent_so_far())
    })
}

/// `on` and `off` for what is a bit and has no words of its own.
fn parse_switch(parameter: &Parameter, text: &str) -> Option<i64> {
    let bit = (parameter.min, parameter.max) == (0, 1) && parameter.values.is_empty();
    match text {
        "on" | "true" | "yes" if bit => Some(1),
        "off" | "false" | "no" if bit => Some(0),
        _ => None,
    }
}

fn out_of_range(axis: &LocalAxis, id: ParameterId, parameter: &Parameter, text: &str) -> Problem {
    let (min, max) = (value_text(parameter.min, id, axis), value_text(parameter.max, id, axis));
    Problem::usage("E216", format!("{text} is out of range for {:?}.", parameter.name))
        .why(format!("It takes {min} to {max}. {}", outcome::sent_so_far()))
        .hint(format!("polepair params {} {:?}", axis.profile().name, parameter.name))
}

fn value_text(raw: i64, id: ParameterId, axis: &LocalAxis) -> String {
    axis.value(id, raw).map_or_else(|_| raw.to_string(), |v| v.to_string())
}
