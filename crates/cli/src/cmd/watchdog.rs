//! `polepair watchdog URL [TIME|off]`

use std::time::Duration;

use clap::Args;
use polepair::Axis;
use polepair::axis::WatchdogState;
use polepair::doctor::{ABSENT, watchdog_if_any};
use polepair_client::message::{SetWatchdog, WatchdogTold};
use polepair_core::profile::Watchdog as Kind;

use crate::joined::{self, Joined};
use crate::outcome::{self, sentence};
use crate::problem::{Exit, Problem, Result};
use crate::target::Target;
use crate::terminal::{Output, say};
use crate::value;

/// Shows what drives do by themselves when their host falls silent, or sets it.
///
/// Nothing moves by it; a motor that turns is stopped by it once nobody speaks. A drive that watches a
/// heartbeat (CANopen) needs one: open it with heartbeat=100.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair watchdog tmcl+serial:///dev/ttyUSB0#1
  polepair watchdog sim:tmcl 500ms
  polepair watchdog sim:tmcl off")]
pub struct Watchdog {
    #[command(flatten)]
    target: Target,
    /// Stop after so long without a word of the host, with its unit; `off` is never
    #[arg(value_name = "TIME|off")]
    time: Option<String>,
}

impl Watchdog {
    pub fn run(self) -> Result {
        let wanted = self.time.as_deref().map(span).transpose()?;
        let session = self.target.open()?;
        session.listen();
        let mut out = Output::stdout();
        for axis in session.axes() {
            let state = match wanted {
                None => watchdog_if_any(axis),
                Some(_) if axis.watchdog_parameter().is_none() => {
                    return Err(none(&axis.label(), &axis.watchdog_rule()));
                }
                // Not told apart from a wrong value by its refusal alone.
                Some(_) if watchdog_if_any(axis) == Ok(WatchdogState::None) => {
                    return Err(none(&axis.label(), &WatchdogState::None.to_string()));
                }
                Some(after) => {
                    if let Some(caution) = axis.watchdog_caution(after.is_none()) {
                        say(&format!("{}: {caution}", axis.label()));
                    }
                    axis.set_watchdog(after)
                }
            };
            let state = state.map_err(outcome::error)?;
            out.line(&format!("{}: {}", axis.label(), shown(axis, state)));
            if let (WatchdogState::On(after), Some(period)) = (state, axis.heartbeat())
                && matches!(axis.profile().watchdog, Kind::Heartbeat { .. })
                && after <= period
            {
                say(&format!(
                    "warning: {}: its watchdog ends before the next heartbeat of this connection \
                     ({} ms): the drive stops though this host speaks",
                    axis.label(),
                    period.as_millis()
                ));
            }
        }
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// By a server.
    pub fn joined(self, server: &Joined) -> Result {
        let wanted = self.time.as_deref().map(span).transpose()?;
        let mut out = Output::stdout();
        for axis in server.pick(&self.target)? {
            let told = server.gateway.watchdog(axis.id).map_err(joined::refused)?;
            let told = match wanted {
                None => told,
                Some(_) if told.parameter.is_none() => {
                    return Err(none(&axis.label, &told.text));
                }
                Some(after) => {
                    if !told.caution.is_empty() {
                        say(&format!("{}: {}", axis.label, told.caution));
                    }
                    set(server, axis.id, after)?
                }
            };
            let parameter = told.parameter.map_or_else(String::new, |name| format!(" ({name})"));
            out.line(&format!("{}: {}{parameter}", axis.label, told.text));
        }
        out.flush()?;
        Ok(Exit::Ok)
    }
}

/// A drive that has none that can be set.
fn none(label: &str, does: &str) -> Problem {
    Problem::usage("E218", format!("{label} has no watchdog that can be set."))
        .why(format!("What it does in silence: {does}. {}", outcome::unsent()))
        .hint("an emergency stop that needs no computer; for a speed, `--for TIME` or a move")
}

/// Sets it under a lease of its own.
fn set(server: &Joined, axis: u16, after: Option<Duration>) -> Result<WatchdogTold> {
    let live = server.gateway.live().map_err(joined::refused)?;
    let lease = live.take(axis).map_err(joined::refused)?;
    let after_ms = after.map(|after| after.as_secs_f64() * 1e3);
    let set = SetWatchdog { after_ms, epoch: lease.epoch() };
    let told = server.gateway.set_watchdog(axis, &set).map_err(joined::refused)?;
    lease.give_back().map_err(joined::refused)?;
    Ok(told)
}

/// A time with its unit; nothing for `off`.
pub fn span(text: &str) -> Result<Option<Duration>> {
    if text == "off" {
        return Ok(None);
    }
    let wrong = |why: String| {
        Problem::usage("E217", format!("{text:?} is no time."))
            .why(sentence(&why))
            .hint("`off` has it stop nothing")
    };
    let span = Duration::from_secs_f64(value::span(text).map_err(wrong)?);
    Ok(Some(span).filter(|span| !span.is_zero()))
}

/// How a drive's watchdog is set, with the parameter that sets it.
pub fn shown(axis: &Axis, state: WatchdogState) -> String {
    let id = axis.watchdog_parameter();
    match (id.and_then(|id| axis.profile().parameter(id)), state) {
        (Some(parameter), WatchdogState::None) => {
            let does = "the motor keeps doing what it was last told";
            format!("{ABSENT} (`{}`): {does}", parameter.name)
        }
        (Some(parameter), _) => {
            format!("{} (`{}`)", axis.watchdog_in_words(state), parameter.name)
        }
        (None, _) => axis.watchdog_in_words(state),
    }
}
