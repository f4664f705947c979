//! `polepair info URL`

use clap::Args;
use polepair::Axis;
use polepair_client::message::{AxisInfo, AxisState};
use polepair_core::profile::{Severity, Signal};

use crate::joined::{self, Joined};
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Result};
use crate::session::signal;
use crate::target::Target;
use crate::terminal::{Output, Table};

/// Shows who a drive is, what it does, and its faults in words.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair info tmcl+serial:///dev/ttyUSB0:9600#1
  polepair info sim:modbus-rtu")]
pub struct Info {
    #[command(flatten)]
    target: Target,
}

impl Info {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        session.listen();
        let mut out = Output::stdout();
        for axis in session.axes() {
            out.buffer().extend_from_slice(describe(axis)?.as_bytes());
        }
        out.flush()?;
        Ok(Exit::Ok)
    }
}

impl Info {
    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        let mut out = Output::stdout();
        for axis in server.pick(&self.target)? {
            let state = joined::state(server, &axis)?;
            out.buffer().extend_from_slice(served(&axis, &state).as_bytes());
        }
        out.flush()?;
        Ok(Exit::Ok)
    }
}

/// What is older than this is shown with its age.
const OLD_MS: f64 = 1500.0;

/// What a server knows of an axis.
fn served(axis: &AxisInfo, state: &AxisState) -> String {
    let mut table = Table::default();
    let mut row = |word: &str, value: String| table.row([format!("  {word}"), value]);
    row("profile", format!("{} ({})", axis.profile, axis.protocol));
    for read in state.signals.iter().filter(|read| read.signal != Signal::Fault.name()) {
        let flag = [Signal::Enabled, Signal::Moving, Signal::Reached];
        let shown = match read.value {
            None => "not known".to_owned(),
            Some(value) if flag.iter().any(|flag| flag.name() == read.signal) => {
                if value != 0.0 { "yes" } else { "no" }.to_owned()
            }
            Some(_) if read.signal == Signal::Mode.name() => state.mode.clone().unwrap_or_default(),
            Some(value) => joined::shown(value, &read.unit),
        };
        let age = match read.age_ms > OLD_MS {
            true => format!(" ({:.1} s old)", read.age_ms / 1e3),
            false => String::new(),
        };
        row(&read.signal, shown + &age);
    }
    row("armed", if state.armed { "yes" } else { "no" }.to_owned());
    let owner = state.lease.as_ref().map_or("nobody", |lease| &lease.owner);
    row("commanded by", owner.to_owned());
    row("watchdog", axis.watchdog.clone());
    if state.faults.is_empty() {
        row("faults", "none".to_owned());
    }
    let mut text = format!("{}: {}\n{}", axis.label, axis.drive, table.render(false));
    for fault in &state.faults {
        text.push_str(&format!("  FAULT {}\n", fault.name));
        text.push_str(&reasons(&fault.cause, &fault.remedy));
    }
    text
}

fn describe(axis: &Axis) -> Result<String> {
    let profile = axis.profile();
    let mut table = Table::default();
    let mut row = |word: &str, value: String| table.row([format!("  {word}"), value]);
    row("profile", format!("{} ({})", profile.name, axis.protocol()));
    row("known", axis.identified().to_string());
    for signal in Signal::ALL {
        if signal != Signal::Fault
            && let Some(shown) = shown(axis, signal)?
        {
            row(signal.name(), shown);
        }
    }
    row("watchdog", motion::watchdog(profile));
    let faults = faults(axis)?;
    if faults.is_empty() {
        row("faults", "none".to_owned());
    }
    Ok(format!("{}: {}\n{}{faults}", axis.label(), profile.title, table.render(false)))
}

/// A signal's value in words or in its unit.
pub fn shown(axis: &Axis, wanted: Signal) -> Result<Option<String>> {
    let flag = axis.profile().signal(wanted).is_some_and(|source| source.equals.is_some());
    let value = signal(axis, wanted)?;
    Ok(value.map(|value| match flag {
        true => if value.raw != 0 { "yes" } else { "no" }.to_owned(),
        false => value.to_string(),
    }))
}

/// Faults and warnings with cause and remedy; empty without any.
fn faults(axis: &Axis) -> Result<String> {
    let Some(value) = signal(axis, Signal::Fault)? else { return Ok(String::new()) };
    let code = u32::try_from(value.raw).unwrap_or(0);
    let known = outcome::faults(axis.profile(), code);
    if code != 0 && known.is_empty() {
        return Ok(format!("  FAULT code {code}: not known to this profile\n"));
    }
    let mut text = String::new();
    for fault in known {
        let word = match fault.severity {
            Severity::Fault => "FAULT",
            Severity::Warning => "warning",
            Severity::Note => continue,
        };
        text.push_str(&format!("  {word} {}: {}\n", fault.name, fault.text));
        text.push_str(&reasons(fault.cause, fault.remedy));
    }
    Ok(text)
}

fn reasons(cause: &str, remedy: &str) -> String {
    let both = [("cause", cause), ("remedy", remedy)].into_iter();
    let told = both.filter(|(_, sentence)| !sentence.is_empty());
    told.map(|(word, sentence)| format!("    {word:<7} {sentence}\n")).collect()
}
