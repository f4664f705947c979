//! `polepair stop URL`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::axis::Standing;
use polepair::heard::Heard;
use polepair::stop::{self as stopping, Event};
use polepair::url::shell_word;
use polepair_client::message::{AxisInfo, AxisStopped, StopClass, StopOrder, Stopped, Unreached};
use polepair_client::{Gateway, Refused, pick_each};
use polepair_core::axis::{Command, Verb};

use crate::joined::{self, Join, Joined};
use crate::outcome::{self, sentence};
use crate::problem::{Exit, Problem, Result, list};
use crate::target::{Target, warn_of};
use crate::terminal::{self, say};

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
        let target = self.target.for_stop();
        if self.dry_run {
            return target.rehearse(|_| Ok(Command::new(wanted)));
        }
        let live = std::io::stderr().is_terminal();
        let clear = if live { "\r\x1b[K" } else { "" };
        let connector = target.connector()?;
        let mut hear = |event: Event<'_>| match event {
            Event::Asking(at) if live => {
                terminal::draw(&format!(
                    "{clear}asking address {} ({} of {})",
                    at.number,
                    at.done + 1,
                    at.of
                ));
            }
            Event::Asking(_) => {}
            Event::Told(axis) => say(&format!("{clear}{} is told to stop", axis.label())),
        };
        let stopped = stopping::stop(&connector, &target.url, wanted, &mut hear);
        terminal::draw(clear);
        warn_of(&connector);
        let lost = |error| outcome::error(error).hint("cut the power if something turns");
        report(&target.url, stopped.map_err(lost)?)
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
    let Stopped { axes: stopped, unreached } = stop(gateway, None)?;
    say(
        "motion is locked until it is released: on the server's page, or by `polepair --server URL release`",
    );
    let named = Joined::new(gateway.clone()).map(|joined| joined.bench.axes).unwrap_or_default();
    let label = |id| named.iter().find(|axis| axis.id == id).map(|axis| axis.label.clone());
    let number = |id| format!("the server's axis {id}");
    let told =
        stopped.into_iter().map(|how| (label(how.id).unwrap_or_else(|| number(how.id)), Some(how)));
    tell(told.collect(), unreached.into_iter().map(not_reached).collect())
}

/// Stops axes that are named. One that is not there keeps none of the others from it.
fn some(server: &Joined, target: &Target) -> Result {
    let named = pick_each(&server.bench, target.axes()?).map_err(joined::refused)?;
    let (mut axes, mut failed) = (Vec::<AxisInfo>::new(), Vec::new());
    for named in named {
        match named {
            Ok(axis) if axes.iter().any(|its| its.id == axis.id) => {}
            Ok(axis) => axes.push(axis),
            Err(error) => failed.push(joined::refused(error)),
        }
    }
    let mut stopped = Vec::new();
    if !axes.is_empty() {
        stopped = stop(&server.gateway, Some(axes.iter().map(|axis| axis.id).collect()))?.axes;
    }
    let told = axes.into_iter().map(|axis| {
        let at = stopped.iter().position(|stopped| stopped.id == axis.id);
        (axis.label, at.map(|at| stopped.swap_remove(at)))
    });
    tell(told.collect(), failed)
}

fn stop(gateway: &Gateway, axes: Option<Vec<u16>>) -> Result<Stopped> {
    let order = StopOrder { axes, reason: "polepair stop".to_owned() };
    gateway.stop(&order).map_err(joined::refused)
}

/// Says how far the stop of each axis came, beside what was not reached.
fn tell(told: Vec<(String, Option<AxisStopped>)>, mut failed: Vec<Problem>) -> Result {
    let of = told.len() + failed.len();
    for (label, how) in told {
        match how.map(|how| (how.class, how.error)) {
            Some((StopClass::Standing, _)) => say(&format!("{label} is stopped")),
            Some((StopClass::Acknowledged, _)) => {
                say(&format!("{label} took the stop; standing not known: it tells no speed"));
            }
            Some((StopClass::Owed, error)) => failed.push(owed(&label, error)),
            Some((_, Some(error))) => failed.push(joined::refused(error)),
            _ => failed.push(unconfirmed(&label)),
        }
    }
    match failed.len() {
        0 => Ok(Exit::Ok),
        _ => stops_failed(failed, of),
    }
}

/// An axis that is not there, or a link that is not open: nobody knows how many motors that has.
fn not_reached(Unreached { link, url, number, error }: Unreached) -> Problem {
    let (what, hint) = match number {
        Some(number) => (
            format!("axis {number} of link {link} was not told to stop: it is not there."),
            "cut its supply if it turns; it is told to stop as soon as it answers",
        ),
        None => (
            format!("no motor of link {link} was told to stop: {url} is not open."),
            "cut the supply of what turns there; it is told to stop as soon as the link is open",
        ),
    };
    Problem::new(error.exit(), error.code, what).why(sentence(&error.message)).hint(hint)
}

/// It was not seen standing; the server goes on with it.
fn owed(label: &str, error: Option<Refused>) -> Problem {
    let exit = error.as_ref().map_or(Exit::NoReply, Refused::exit);
    let code = error.as_ref().map_or("E401".into(), |error| error.code.clone());
    Problem::new(exit, code, format!("{label} was not seen standing."))
        .why(error.map_or_else(String::new, |error| sentence(&error.message)))
        .hint("the server says the stop again until it is; if it still turns, cut its power")
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
    let what = match failed.len() {
        1 => format!("one stop of {of} is not confirmed."),
        count => format!("{count} stops of {of} are not confirmed."),
    };
    Err(Problem::new(Exit::Partial, "E702", what).hint("cut the power of these drives"))
}

/// Motors behind one address by their numbers.
fn which(motors: &[u8]) -> String {
    let numbers: Vec<String> = motors.iter().map(u8::to_string).collect();
    let numbers: Vec<&str> = numbers.iter().map(String::as_str).collect();
    let word = if motors.len() == 1 { "motor" } else { "motors" };
    format!("{word} {}", list(&numbers))
}

/// Says what was stopped, and what was not reached.
pub fn report(url: &str, stopped: stopping::Stopped) -> Result {
    let link = url.split('#').next().unwrap_or(url);
    let (mut failed, mut unasked): (Vec<Problem>, _) = (Vec::new(), None);
    let mut obeyed = 0;
    for (label, ended) in stopped.axes {
        match ended {
            Ok(Standing::Seen) => {
                obeyed += 1;
                say(&format!("{label} is stopped"));
            }
            Ok(Standing::Untold) => {
                obeyed += 1;
                say(&format!("{label} took the stop; it does not tell whether its motor stands"));
            }
            Err(error) => {
                say(&format!("{label} may still turn: cut its supply"));
                failed.push(outcome::error(error));
            }
        }
    }
    for motors in stopped.motors {
        let number = motors.number;
        if !motors.told.is_empty() {
            let which = which(&motors.told);
            say(&format!("module {number}: {which} took the stop too; standing not looked at"));
        }
        if !motors.silent.is_empty() {
            let which = which(&motors.silent);
            say(&format!(
                "module {number}: {which} did not confirm the stop and may still turn: cut the supply"
            ));
        }
        failed.extend(motors.ended.err().map(outcome::error));
    }
    if let Some(patience) = stopped.patience {
        let told = if stopped.everybody { "everybody was told to stop, unconfirmed; " } else { "" };
        say(&format!(
            "{told}asked {} addresses for {} ms each; a drive that answers later, or has another \
             address, is stopped by its number: polepair stop {}",
            stopped.asked,
            patience.as_millis(),
            shell_word(&format!("{link}#N"))
        ));
    }
    if let Some((first, last)) = stopped.left {
        let what = format!("addresses {first} to {last} were not asked: there was no time left.");
        match stopped.everybody {
            true => say(&what),
            false => unasked = Some(Problem::new(Exit::Partial, "E703", what)),
        }
    }
    match (failed.len(), unasked) {
        (0, None) if obeyed == 0 => Err(nobody(stopped.everybody, &stopped.heard)),
        (0, None) => Ok(Exit::Ok),
        // Of addresses that were not asked nobody knows whether a drive is there: they are no stops.
        (0, Some(unasked)) => Err(unasked),
        (count, unasked) => {
            unasked.into_iter().for_each(|unasked| say(unasked.render(false).trim_end()));
            stops_failed(failed, count + obeyed)
        }
    }
}

fn nobody(everybody: bool, heard: &Heard) -> Problem {
    let told = match everybody {
        true => "Everybody was told to stop, and nobody confirmed it.",
        false => "No stop was sent.",
    };
    let problem = Problem::new(Exit::NoReply, "E403", "no drive answered.")
        .why(format!("{} {told}", outcome::unanswered(heard)))
        .hint("cut the power if something turns");
    match heard.is_nothing() {
        true => {
            problem.hint("power, wiring (A and B may be swapped), and the baud rate in the URL")
        }
        false => problem.hint(heard.hint()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use polepair::Error;

    fn seen(label: &str) -> (String, std::result::Result<Standing, Error>) {
        (label.to_owned(), Ok(Standing::Seen))
    }

    /// Behind addresses that were not asked there may be nobody: no stop of theirs is counted.
    #[test]
    fn stops_are_counted_of_drives_alone() {
        let unasked = |axes| stopping::Stopped { axes, left: Some((9, 32)), ..Default::default() };
        let one = report("tmcl+serial:///dev/null", unasked(vec![seen("axis 1")])).unwrap_err();
        assert_eq!((one.code.as_ref(), one.exit), ("E703", Exit::Partial));
        let lost = Error::Interrupted { what: "axis 2".to_owned() };
        let two = vec![seen("axis 1"), ("axis 2".to_owned(), Err(lost))];
        let two = report("tmcl+serial:///dev/null", unasked(two)).unwrap_err();
        assert_eq!(two.code.as_ref(), "E702");
        assert_eq!(two.what, "one stop of 2 is not confirmed.");
    }
}
