//! `polepair stop URL`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::stop::{Event, Stopped};
use polepair_client::message::{StopClass, StopOrder};
use polepair_core::axis::{Command, Verb};

use crate::joined::{self, Joined};
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
    pub fn joined(self, server: &Joined) -> Result {
        joined::no_dry_run(self.dry_run)?;
        if self.quick {
            return Err(joined::cannot("--quick", "Its stop is the one that is always safe."));
        }
        let axes = server.pick(&self.target)?;
        let ids = axes.iter().map(|axis| axis.id).collect();
        let order = StopOrder { axes: Some(ids), reason: "polepair stop".to_owned() };
        let stopped = server.gateway.stop(&order).map_err(joined::refused)?;
        let mut failed: Vec<Problem> = Vec::new();
        for axis in &axes {
            let how = stopped.axes.iter().find(|stopped| stopped.id == axis.id);
            match how.map(|how| (how.class, how.error.clone())) {
                Some((StopClass::Standing, _)) => say(&format!("{} is stopped", axis.label)),
                Some((StopClass::Acknowledged, _)) => {
                    say(&format!("{} is told to stop; nobody saw it stand", axis.label));
                }
                Some((_, Some(error))) => failed.push(joined::refused(error)),
                _ => failed.push(unconfirmed(&axis.label)),
            }
        }
        match failed.len() {
            0 => Ok(Exit::Ok),
            _ => stops_failed(failed, axes.len()),
        }
    }
}

fn unconfirmed(label: &str) -> Problem {
    Problem::new(Exit::NoReply, "E401", format!("{label} did not confirm its stop."))
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
