//! `polepair stop URL`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::stop::{Event, Stopped};
use polepair_client::Gateway;
use polepair_client::message::{AxisStopped, StopClass, StopOrder};
use polepair_core::axis::{Command, Verb};

use crate::joined::{self, Join, Joined};
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::target::Target;
use crate::terminal::say;

/// Brings motors to rest.
///
/// Without #AXES in the URL everybody on the link is told at once, where the protocol has a word for
/// that, then every axis that answers is stopped.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair stop tmcl+serial:///dev/ttyUSB0        every axis on the link
  polepair stop tmcl+serial:///dev/ttyUSB0#1")]
pub struct Stop {
    #[command(flatten)]
    target: Target,
    /// As fast as the drive can
    #[arg(long)]
    quick: bool,
    /// Print the frames and send nothing
    #[arg(long)]
    dry_run: bool,
}

impl Stop {
    pub fn run(self) -> Result {
        let wanted = if self.quick { Verb::QuickStop } else { Verb::Stop };
        if self.dry_run {
            return self.target.rehearse(|_| Ok(Command::new(wanted)));
        }
        let live = std::io::stderr().is_terminal();
        let clear = if live { "\r\x1b[K" } else { "" };
        let connector = self.target.connector()?;
        let mut hear = |event: Event<'_>| match event {
            Event::Asking(at) if live => {
                eprint!("{clear}asking address {} ({} of {})", at.number, at.done + 1, at.of);
            }
            Event::Asking(_) => {}
            Event::Told(axis) => say(&format!("{clear}{} is told to stop", axis.label())),
        };
        let stopped = polepair::stop::stop(&connector, &self.target.url, wanted, &mut hear);
        eprint!("{clear}");
        report(&self.target.url, stopped.map_err(outcome::error)?)
    }
}

impl Stop {
    /// The same by a server: it stops whoever commands the axes.
    pub fn joined(self, join: Join) -> Result {
        joined::no_dry_run(self.dry_run)?;
        if self.quick {
            return Err(joined::cannot("--quick", "Its stop is the one that is always safe."));
        }
        match self.target.axes()? {
            joined::ALL => all(&join.gateway()?),
            _ => some(&Joined::new(join.gateway()?)?, &self.target),
        }
    }
}

/// Stops everything. Nothing is asked before, and only names are asked after: neither a right to look
/// nor a slow answer stands in its way.
fn all(gateway: &Gateway) -> Result {
    let stopped = stop(gateway, None)?;
    say("motion is locked until it is released: on the server's page, or POST /api/v1/release");
    let named = Joined::new(gateway.clone()).map(|joined| joined.bench.axes).unwrap_or_default();
    let label = |id| named.iter().find(|axis| axis.id == id).map(|axis| axis.label.clone());
    let number = |id| format!("the server's axis {id}");
    let told =
        stopped.into_iter().map(|how| (label(how.id).unwrap_or_else(|| number(how.id)), Some(how)));
    tell(told.collect())
}

/// Stops axes that are named.
fn some(server: &Joined, target: &Target) -> Result {
    let axes = server.pick(target)?;
    let mut stopped = stop(&server.gateway, Some(axes.iter().map(|axis| axis.id).collect()))?;
    let told = axes.into_iter().map(|axis| {
        let at = stopped.iter().position(|stopped| stopped.id == axis.id);
        (axis.label, at.map(|at| stopped.swap_remove(at)))
    });
    tell(told.collect())
}

fn stop(gateway: &Gateway, axes: Option<Vec<u16>>) -> Result<Vec<AxisStopped>> {
    let order = StopOrder { axes, reason: "polepair stop".to_owned() };
    gateway.stop(&order).map(|stopped| stopped.axes).map_err(joined::refused)
}

/// Says how far the stop of each axis came.
fn tell(told: Vec<(String, Option<AxisStopped>)>) -> Result {
    let of = told.len();
    let mut failed: Vec<Problem> = Vec::new();
    for (label, how) in told {
        match how.map(|how| (how.class, how.error)) {
            Some((StopClass::Standing, _)) => say(&format!("{label} is stopped")),
            Some((StopClass::Acknowledged, _)) => {
                say(&format!("{label} is told to stop; nobody saw it stand"));
            }
            Some((_, Some(error))) => failed.push(joined::refused(error)),
            _ => failed.push(unconfirmed(&label)),
        }
    }
    match failed.len() {
        0 => Ok(Exit::Ok),
        _ => stops_failed(failed, of),
    }
}

fn unconfirmed(label: &str) -> Problem {
    Problem::new(Exit::NoReply, "E401", format!("{label} did not confirm its stop."))
        .hint("say it again; if it still turns, cut its power")
}

fn stops_failed(mut failed: Vec<Problem>, of: usize) -> Result {
    if (failed.len(), of) == (1, 1) {
        return Err(failed.remove(0));
    }
    failed.iter().for_each(|problem| say(problem.render(false).trim_end()));
    let what = format!("{} stops of {of} are not confirmed.", failed.len());
    Err(Problem::new(Exit::Partial, "E702", what).hint("cut the power of these drives"))
}

/// Says what was stopped, and what was not reached.
pub fn report(url: &str, stopped: Stopped) -> Result {
    let link = url.split('#').next().unwrap_or(url);
    let mut failed: Vec<Problem> = Vec::new();
    let mut at_rest = 0;
    for (label, ended) in stopped.axes {
        match ended {
            Ok(()) => {
                at_rest += 1;
                say(&format!("{label} is stopped"));
            }
            Err(error) => failed.push(outcome::error(error)),
        }
    }
    if let Some(patience) = stopped.patience {
        let told = if stopped.everybody { "everybody was told to stop, unconfirmed; " } else { "" };
        say(&format!(
            "{told}asked {} addresses for {} ms each; a drive that answers later, or has another \
             address, is stopped by its number: polepair stop {link}#N",
            stopped.asked,
            patience.as_millis()
        ));
    }
    if let Some((first, last)) = stopped.left {
        let what = format!("addresses {first} to {last} were not asked: there was no time left.");
        match stopped.everybody {
            true => say(&what),
            false => failed.push(Problem::new(Exit::Partial, "E703", what)),
        }
    }
    match (failed.len(), at_rest) {
        (0, 0) => Err(nobody(stopped.everybody)),
        (0, _) => Ok(Exit::Ok),
        (count, _) => stops_failed(failed, count + at_rest),
    }
}

fn nobody(everybody: bool) -> Problem {
    let problem = Problem::new(Exit::NoReply, "E403", "no drive answered.");
    let problem = match everybody {
        true => problem.why("Everybody was told to stop, and nobody confirmed it."),
        false => problem.why("Every address that was tried stayed silent; nothing was stopped."),
    };
    problem
        .hint("cut the power if something turns")
        .hint("power, wiring (A and B may be swapped), and the baud rate in the URL")
}
