//! `polepair watchdog URL [TIME|off]`

use std::time::Duration;

use clap::Args;
use polepair::LocalAxis;
use polepair::axis::WatchdogState;
use polepair::doctor::{ABSENT_TEXT, read_watchdog};
use polepair_client::message::{SetWatchdog, WatchdogView};
use polepair_core::profile::Watchdog as Kind;

use crate::outcome::{self, to_sentence};
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, RemoteSession};
use crate::target::DriveArgs;
use crate::terminal::{DataOutput, print_note, print_warning};
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
    pub fn run(self) -> Result {
        let wanted = self.time.as_deref().map(parse_time).transpose()?;
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            let state = match wanted {
                None => read_watchdog(axis),
                Some(_) if axis.watchdog_parameter().is_none() => {
                    return Err(no_watchdog_problem(&axis.label(), &axis.watchdog_rule()));
                }
                // Not told apart from a wrong value by its refusal alone.
                Some(_) if read_watchdog(axis) == Ok(WatchdogState::None) => {
                    return Err(no_watchdog_problem(
                        &axis.label(),
                        &WatchdogState::None.to_string(),
                    ));
                }
                Some(after) => {
                    if let Some(caution) = axis.watchdog_caution(after.is_none()) {
                        print_note(&format!("{}: {caution}", axis.label()));
                    }
                    axis.set_watchdog(after)
                }
            };
            let state = state.map_err(outcome::to_problem)?;
            out.write_line(&format!("{}: {}", axis.label(), watchdog_text(axis, state)));
            if let (WatchdogState::On(after), Some(period)) = (state, axis.heartbeat())
                && matches!(axis.profile().watchdog, Kind::Heartbeat { .. })
                && after <= period
            {
                print_warning(&format!(
                    "warning: {}: its watchdog ends before the next heartbeat of this connection \
                     ({} ms): the drive stops although this host is active",
                    axis.label(),
                    period.as_millis()
                ));
            }
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// By a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        let wanted = self.time.as_deref().map(parse_time).transpose()?;
        let mut out = DataOutput::stdout();
        for axis in server.axes_of(&self.target)? {
            let watchdog = server.gateway.watchdog(axis.id).map_err(remote::refusal_problem)?;
            let watchdog = match wanted {
                None => watchdog,
                Some(_) if watchdog.parameter.is_none() => {
                    return Err(no_watchdog_problem(&axis.label, &watchdog.text));
                }
                Some(after) => {
                    if !watchdog.caution.is_empty() {
                        print_note(&format!("{}: {}", axis.label, watchdog.caution));
                    }
                    set_remote(server, axis.id, after)?
                }
            };
            let parameter =
                watchdog.parameter.map_or_else(String::new, |name| format!(" ({name})"));
            out.write_line(&format!("{}: {}{parameter}", axis.label, watchdog.text));
        }
        out.flush()?;
        Ok(Exit::Ok)
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

/// Sets it under a lease of its own.
fn set_remote(server: &RemoteSession, axis: u16, after: Option<Duration>) -> Result<WatchdogView> {
    let live = server.gateway.live().map_err(remote::refusal_problem)?;
    let lease = live.acquire_lease(axis).map_err(remote::refusal_problem)?;
    let after_ms = after.map(|after| after.as_secs_f64() * 1e3);
    let set = SetWatchdog { after_ms, epoch: lease.epoch() };
    let watchdog = server.gateway.set_watchdog(axis, &set).map_err(remote::refusal_problem)?;
    lease.release().map_err(remote::refusal_problem)?;
    Ok(watchdog)
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
    Ok(Some(span).filter(|span| !span.is_zero()))
}

/// How a drive's watchdog is set, with the parameter that sets it.
pub fn watchdog_text(axis: &LocalAxis, state: WatchdogState) -> String {
    let id = axis.watchdog_parameter();
    match (id.and_then(|id| axis.parameter(id)), state) {
        (Some(parameter), WatchdogState::None) => {
            let does = "the motor continues its last command";
            format!("{ABSENT_TEXT} (`{}`): {does}", parameter.name)
        }
        (Some(parameter), _) => {
            format!("{} (`{}`)", axis.describe_watchdog(state), parameter.name)
        }
        (None, _) => axis.describe_watchdog(state),
    }
}
