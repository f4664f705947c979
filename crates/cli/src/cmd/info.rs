//! `polepair info URL`

use clap::Args;
use polepair::Axis;
use polepair_core::profile::{Severity, Signal};

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
        for (word, sentence) in [("cause", fault.cause), ("remedy", fault.remedy)] {
            if !sentence.is_empty() {
                text.push_str(&format!("    {word:<7} {sentence}\n"));
            }
        }
    }
    Ok(text)
}
