//! `polepair set URL NAME=VALUE…`

mod data_write;
mod readdress;

use std::ops::ControlFlow;

use clap::Args;
use polepair::axis::{NamedValue, WriteChange};
use polepair::interface::WriteValue;
use polepair::{Amount, Axis, LocalAxis};
use polepair_core::profile::Persistence;

use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::session::Session;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;
use data_write::DataWrite;
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
    /// Writes parameters of a link of this program, or of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if self.arm && server.is_given() {
            let why = "A server writes nothing that may move the motor.";
            return Err(remote::unsupported_problem("--arm", why));
        }
        let values = self.settings.iter().map(|setting| self.named_value(setting));
        let values = values.collect::<Result<Vec<_>>>()?;
        let session = self.target.connect(server)?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        let mut address_changes = Vec::new();
        for axis in session.axes() {
            let mut writes = AxisWrites { numbers: values.clone(), ..AxisWrites::default() };
            if let Some(local) = axis.local() {
                writes = AxisWrites::of_link(local, &values, self.dry_run)?;
                address_changes.append(&mut writes.addresses);
                AddressChange::check(session.axes().len(), &address_changes)?;
            }
            if self.dry_run {
                self.print_plan(&session, axis, &writes, &mut out)?;
            } else {
                self.write(&session, axis, &writes, &mut out)?;
            }
        }
        debug_assert!(address_changes.len() <= 1, "checked with the first axis");
        // Last, because afterwards the drive no longer answers at this address.
        if let (Some(change), Some(session)) = (address_changes.pop(), session.into_local()) {
            change.apply(&self.target, session, self.store, &mut out)?;
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    fn named_value(&self, setting: &str) -> Result<NamedValue> {
        let (name, value) = split_assignment(setting)?;
        let value = if self.raw {
            WriteValue::Raw(parse_raw(value)?)
        } else {
            WriteValue::Amount(Amount::from(value))
        };
        Ok(NamedValue { name: name.to_owned(), value })
    }

    fn print_plan(
        &self,
        session: &Session,
        axis: &Axis,
        writes: &AxisWrites,
        out: &mut DataOutput,
    ) -> Result<()> {
        let prefix = session.axis_prefix(axis);
        let changes =
            axis.interface().plan_changes(&writes.numbers).map_err(outcome::to_problem)?;
        for change in changes {
            let WriteChange { name, from_text, to_text, .. } = &change;
            let line = match &**from_text {
                "" => format!("{name}: -> {to_text}"),
                _ if !change.is_changed => format!("{name} = {to_text}, as it is"),
                from if from == to_text => format!("{name} = {to_text}, as it is"),
                from => format!("{name}: {from} -> {to_text}"),
            };
            out.write_line(&format!("{prefix}{line}"));
        }
        for write in &writes.data {
            out.write_line(&format!("{prefix}{}", write.planned()));
        }
        Ok(())
    }

    fn write(
        &self,
        session: &Session,
        axis: &Axis,
        writes: &AxisWrites,
        out: &mut DataOutput,
    ) -> Result<()> {
        if let Some(local) = axis.local() {
            local.arm(self.arm);
        }
        let prefix = session.axis_prefix(axis);
        let mut is_kept = Ok(());
        let written = axis.interface().write_all(&writes.numbers, self.store, &mut |change| {
            is_kept = self.read_back(axis, &prefix, change, out).and_then(|()| out.flush());
            if is_kept.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        written.map_err(outcome::to_problem)?;
        is_kept?;
        if let Some(local) = axis.local() {
            for write in &writes.data {
                let written = write.apply(local)?;
                out.write_line(&format!("{prefix}{written}"));
                out.flush()?;
            }
            // Also where nothing moved: the next program must not find it armed.
            local.arm(false);
        }
        Ok(())
    }

    /// Reads a written value back, and prints it.
    fn read_back(
        &self,
        axis: &Axis,
        prefix: &str,
        change: &WriteChange,
        out: &mut DataOutput,
    ) -> Result<()> {
        let WriteChange { name, to_text, .. } = change;
        let wanted = match change.raw.filter(|_| self.raw) {
            Some(raw) => raw.to_string(),
            None => to_text.clone(),
        };
        if !change.is_readable {
            out.write_line(&format!("{prefix}{name} = {wanted}"));
            return Ok(());
        }
        let read = match axis.read(name).map_err(outcome::to_problem) {
            Ok(read) => read,
            // The outcome of a write is the write's.
            Err(problem) => {
                let label =
                    if prefix.is_empty() { String::new() } else { format!("{}: ", axis.label()) };
                print_note(&format!(
                    "{label}`{name}` was written; it could not be read back: {}",
                    problem.what
                ));
                out.write_line(&format!("{prefix}{name} = {wanted} (written, not read back)"));
                return Ok(());
            }
        };
        let is_kept = match change.raw {
            Some(raw) => read.raw == Some(raw),
            None => read.value == change.to,
        };
        let shown = match read.raw_text().filter(|_| self.raw) {
            Some(raw) => raw,
            None if is_kept => to_text.clone(),
            None => match read.raw_text().filter(|raw| *raw != read.text) {
                Some(raw) => format!("{read} ({raw})"),
                None => read.to_string(),
            },
        };
        out.write_line(&format!("{prefix}{name} = {shown}"));
        if is_kept {
            self.note_link_setting(axis, name);
            return Ok(());
        }
        let what = format!("{name:?} did not keep what was written.");
        Err(Problem::new(Exit::Negative, "E111", what)
            .why(format!("{wanted} was written and accepted, {shown} is read back.")))
    }

    /// Notes that the connection string has to be changed for a setting by which the drive is reached.
    fn note_link_setting(&self, axis: &Axis, name: &str) {
        let Some(local) = axis.local() else { return };
        let Ok(id) = local.find(name) else { return };
        let Some(parameter) = local.parameter(id) else { return };
        if !local.profile().link_settings.contains(&id) {
            return;
        }
        if parameter.name.contains("password") {
            let (label, name) = (axis.label(), parameter.name);
            return print_note(&format!(
                "{label}: its {name} decides what can be written: {}",
                parameter.about
            ));
        }
        let stored = parameter.persistence == Persistence::Storable && !self.store;
        let lost = if stored { " It is lost at power-off: --store keeps it." } else { "" };
        print_note(&format!(
            "{} is addressed by its {}: change the connection string too when it takes effect. \
             {}{lost}",
            axis.label(),
            parameter.name,
            parameter.about
        ));
    }
}

/// Writes to one axis.
#[derive(Default)]
struct AxisWrites {
    numbers: Vec<NamedValue>,
    /// Text and bytes.
    data: Vec<DataWrite>,
    /// Settings that change how the drive is reached, which are written last.
    addresses: Vec<AddressChange>,
}

impl AxisWrites {
    /// Sorts values by how they are written on a link of this program. All are checked before the first is written.
    fn of_link(axis: &LocalAxis, values: &[NamedValue], dry_run: bool) -> Result<Self> {
        let mut writes = Self::default();
        for value in values {
            let id = axis.find(&value.name).map_err(outcome::to_problem)?;
            match DataWrite::for_setting(axis, id, &value.value)? {
                Some(write) => writes.data.push(write),
                None => writes.numbers.push(value.clone()),
            }
        }
        let plan = axis.plan_writes(&writes.numbers).map_err(outcome::to_problem)?;
        for caution in plan.writes.iter().filter_map(|write| axis.beyond_limits(write)) {
            print_warning(&format!("{}: caution: {caution}", axis.label()));
        }
        for write in plan.writes.iter().filter(|_| !dry_run) {
            if let Some(change) = AddressChange::for_setting(axis, write.id, write.raw)? {
                writes.numbers.retain(|value| axis.find(&value.name).ok() != Some(write.id));
                writes.addresses.push(change);
            }
        }
        Ok(writes)
    }
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
