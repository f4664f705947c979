//! `polepair watchdog URL [TIME|off]`

use std::time::Duration;

use clap::Args;
use polepair::interface::{WatchdogKind, WatchdogReport};
use polepair::{Axis, LocalAxis};

use crate::data_output::DataOutput;
use crate::outcome::{self, to_sentence};
use crate::problem::{Exit, Problem, Result};
use crate::remote::ServerArgs;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Shows or sets the reaction of drives to a silent host.
///
/// The command itself moves no motor. With the watchdog on, a drive stops its motor as soon as the host is
/// silent for TIME. A drive that monitors a heartbeat (CANopen) needs one: add heartbeat=100 to the
/// connection string.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair watchdog tmcl+serial:///dev/ttyUSB0#1
  polepair watchdog sim:tmcl 500ms
  polepair watchdog sim:tmcl off")]
pub struct WatchdogCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Time without a message after which the drive stops its motor: 500ms; `off` switches the watchdog off
    #[arg(value_name = "TIME|off")]
    time: Option<String>,
}

impl WatchdogCommand {
    pub fn run(self, server: ServerArgs) -> Result {
        let wanted = self.time.as_deref().map(parse_time).transpose()?;
        let session = self.target.connect(server)?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            let mut report = axis.watchdog().map_err(outcome::to_problem)?;
            if let Some(after) = wanted {
                if report.parameter.is_none() {
                    return Err(no_watchdog_problem(axis.label(), &report.text));
                }
                // Switching it off needs no heartbeat.
                let is_moot = after.is_none() && has_heartbeat(axis);
                if !report.caution.is_empty() && !is_moot {
                    print_note(&format!("{}: {}", axis.label(), report.caution));
                }
                report = axis.set_watchdog(after).map_err(outcome::to_problem)?;
            }
            out.write_line(&format!("{}: {}", axis.label(), watchdog_text(&report)));
            warn_short_watchdog(axis, &report);
        }
        out.flush()?;
        Ok(Exit::Ok)
    }
}

fn has_heartbeat(axis: &Axis) -> bool {
    matches!(axis.facts().watchdog, WatchdogKind::Heartbeat(_))
}

/// Warns of a watchdog that ends before the next heartbeat of this connection.
fn warn_short_watchdog(axis: &Axis, report: &WatchdogReport) {
    let period = axis.local().and_then(LocalAxis::heartbeat);
    if let (Some(after), Some(period)) = (report.after, period)
        && has_heartbeat(axis)
        && after <= period
    {
        print_warning(&format!(
            "warning: {}: its watchdog ends before the next heartbeat of this connection ({} ms): \
             the drive stops although this host is active",
            axis.label(),
            period.as_millis()
        ));
    }
}

/// A drive that has none that can be set.
fn no_watchdog_problem(label: &str, does: &str) -> Problem {
    Problem::usage("E218", format!("{label} has no watchdog that can be set."))
        .why(format!("Its reaction to a silent host: {does}. {}", outcome::sent_so_far()))
        .hint(
            "install an emergency stop that works without a computer; for a speed, `--for TIME` \
         or a move",
        )
}

/// A time with its unit; nothing for `off`.
pub fn parse_time(text: &str) -> Result<Option<Duration>> {
    if text == "off" {
        return Ok(None);
    }
    let wrong = |why: String| {
        Problem::usage("E217", format!("{text:?} is not a time."))
            .why(to_sentence(&why))
            .hint("`off` switches the watchdog off")
    };
    let span = Duration::from_secs_f64(value::parse_span(text).map_err(wrong)?);
    if span.is_zero() {
        return Err(wrong("after no time at all a drive would always stop".to_owned()));
    }
    Ok(Some(span))
}

/// Setting of a drive's watchdog, with its parameter.
pub fn watchdog_text(report: &WatchdogReport) -> String {
    match &report.parameter {
        Some(name) => format!("{} (`{name}`)", report.text),
        None => report.text.clone(),
    }
}
