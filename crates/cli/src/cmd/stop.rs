//! `polepair stop URL`

use polepair::url::{Url, shell_word, without_axes};
use std::io::IsTerminal as _;
use std::ops::ControlFlow;

use clap::Args;
use polepair::Error;
use polepair::axis::Standstill;
use polepair::no_reply::{NoReplyDetails, Wiring};
use polepair::stop::{self as stopping, DrivePrograms, StopEvent, StopOptions};
use polepair_client::message::{
    AxisInfo, AxisStopReport, StopClass, StopReport, StopRequest, UnreachedTarget,
};
use polepair_client::{Gateway, GatewayError, select_each};

use crate::interrupt;
use crate::motion;
use crate::outcome::{self, to_sentence};
use crate::problem::{Exit, Problem, Result, join_list};
use crate::remote::{self, RemoteSession, ServerArgs};
use crate::target::{DriveArgs, warn_ignored_files};
use crate::terminal::{self, print_note, print_warning};

/// Stops motors.
///
/// Without #AXES in the URL, the command first sends a broadcast stop, if the protocol has one, and then
/// stops each axis that replies.
///
/// A program in the drive (TMCL, TML) could move the motor again, so it is ended first.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair stop tmcl+serial:///dev/ttyUSB0        all axes of the link
  polepair stop tmcl+serial:///dev/ttyUSB0#1")]
pub struct StopCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Stop with the drive's fastest deceleration
    #[arg(long)]
    quick: bool,
    /// Keep the program in the drive (TMCL, TML) running; it may move the motor again
    #[arg(long)]
    keep_program: bool,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

const KEPT_PROGRAM: &str =
    "caution: programs in drives were not ended, and may move the motors again";

impl StopCommand {
    /// Stops the motors of a link, or of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if server.is_given() { self.stop_on_server(server) } else { self.stop_on_link() }
    }

    fn stop_on_link(self) -> Result {
        let how =
            StopOptions { quick: self.quick, keep_program: self.keep_program, power_off: false };
        let target = self.target.for_stop();
        if self.dry_run {
            return target.rehearse(|_| Ok(how.command()));
        }
        let live = std::io::stderr().is_terminal();
        let clear = if live { "\r\x1b[K" } else { "" };
        debug_assert!(!self.dry_run);
        let connector = target.connector()?;
        // From here on Ctrl-C waits for the stop: it must not be cut off between two frames.
        let interrupts = StopInterrupts::listen(&target.url);
        let (mut is_sent, mut tries_rates) = (false, false);
        let mut on_event = |event: StopEvent<'_>| {
            match event {
                StopEvent::Querying(at) if live => {
                    terminal::draw(&format!(
                        "{clear}asking address {} ({} of {})",
                        at.number,
                        at.done + 1,
                        at.of
                    ));
                }
                StopEvent::Querying(_) | StopEvent::Waiting => {}
                StopEvent::TryingRate(rate) if live => {
                    terminal::draw(&format!("{clear}no reply: trying {rate} baud"));
                }
                StopEvent::TryingRate(_) if !tries_rates => {
                    tries_rates = true;
                    print_note("no reply: trying the other baud rates");
                }
                StopEvent::TryingRate(_) => {}
                StopEvent::StopSent(axis) => {
                    is_sent = true;
                    terminal::draw(clear);
                    print_note(&format!("{} is being stopped", axis.label()));
                }
            }
            if interrupt::was_interrupted() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        let stopped = stopping::stop(&connector, &target.url, how, &mut on_event);
        terminal::draw(clear);
        warn_ignored_files(&connector);
        if self.keep_program {
            print_note(KEPT_PROGRAM);
        }
        let stopped = stopped
            .map_err(|error| outcome::to_problem(error).hint("cut the power if a motor turns"));
        is_sent |= stopped.as_ref().is_ok_and(|report| {
            let may_be_sent = |ended: &std::result::Result<Standstill, Error>| match ended {
                Ok(_) => true,
                Err(error) => error.executed() != Some(false),
            };
            report.broadcast || report.axes.iter().any(|(_, ended)| may_be_sent(ended))
        });
        interrupts
            .conclude(Some(is_sent), stopped.and_then(|report| report_stops(&target.url, report)))
    }
}

/// Signals during a stop. The first waits until its frames are out; the second exits at once.
struct StopInterrupts(interrupt::HoldGuard);

impl StopInterrupts {
    fn listen(url: &str) -> Self {
        interrupt::listen(|| {
            print_warning(
                "interrupted: waiting until the stop is sent; Ctrl-C again exits without it",
            );
        });
        Self(interrupt::hold_motion(url))
    }

    /// The result of the command: a stop that was interrupted and is not confirmed has exit code 130.
    fn conclude(self, is_sent: Option<bool>, result: Result) -> Result {
        // From here on Ctrl-C ends the program while it prints.
        drop(self.0);
        let Err(problem) = result else { return result };
        if !interrupt::was_interrupted() {
            return Err(problem);
        }
        print_warning(problem.render(false).trim_end());
        let what = match is_sent {
            Some(true) => {
                "the stop was sent; standstill is not confirmed, and a motor may still turn"
            }
            Some(false) => "no stop was sent; the motor may turn",
            None => "whether the server got the stop is not known; a motor may still turn",
        };
        print_warning(&format!("interrupted: {what}"));
        Err(Problem::interrupted())
    }
}

impl StopCommand {
    /// A server stops axes of any client, repeats the stop, and ends the programs of drives.
    fn stop_on_server(self, server: ServerArgs) -> Result {
        if self.dry_run {
            server.refuse_dry_run()?;
        }
        if self.quick {
            return Err(remote::unsupported_problem(
                "--quick",
                "A server stops with the normal deceleration only.",
            ));
        }
        if self.keep_program {
            return Err(remote::unsupported_problem(
                "--keep-program",
                "The stop of a server always ends the programs of drives.",
            ));
        }
        let interrupts = StopInterrupts::listen(&self.target.url);
        let result = match self.target.remote_axes()? {
            remote::ALL => stop_everything(&server.gateway()?),
            _ => stop_named(&server.open()?, &self.target),
        };
        interrupts.conclude(None, result)
    }
}

/// Stops everything. Nothing is read before, and only names after: neither a missing scope nor a slow reply delays it.
fn stop_everything(gateway: &Gateway) -> Result {
    let StopReport { axes, unreached, refused } = send_stop(gateway, None)?;
    print_note(
        "motion is locked until it is released: on the server's page, or by `polepair --server \
         URL release`",
    );
    let named =
        RemoteSession::new(gateway.clone()).map(|joined| joined.bench.axes).unwrap_or_default();
    let reports = axes.into_iter().map(|how| {
        (axis_label(how.id, &named).unwrap_or_else(|| axis_number_text(how.id)), Some(how))
    });
    let mut failed: Vec<Problem> = unreached.into_iter().map(unreached_problem).collect();
    failed.extend(refused.into_iter().map(remote::refusal_problem));
    report_remote(reports.collect(), failed)
}

fn axis_number_text(id: u16) -> String {
    format!("the server's axis {id}")
}

fn axis_label(id: u16, named: &[AxisInfo]) -> Option<String> {
    named.iter().find(|axis| axis.id == id).map(|axis| axis.label.clone())
}

/// Stops axes that are named. One that is not there keeps none of the others from it.
fn stop_named(server: &RemoteSession, target: &DriveArgs) -> Result {
    let named =
        select_each(&server.bench, target.remote_axes()?).map_err(remote::refusal_problem)?;
    let (mut axes, mut failed) = (Vec::<AxisInfo>::new(), Vec::new());
    for named in named {
        match named {
            Ok(axis) if axes.iter().any(|its| its.id == axis.id) => {}
            Ok(axis) => axes.push(axis),
            Err(error) => failed.push(remote::refusal_problem(error)),
        }
    }
    let mut stopped = Vec::new();
    if !axes.is_empty() {
        let ids = axes.iter().map(|axis| axis.id).collect();
        let report = send_stop(&server.gateway, Some(ids))?;
        failed.extend(report.refused.into_iter().map(remote::refusal_problem));
        stopped = report.axes;
    }
    let reports = axes.into_iter().map(|axis| {
        let at = stopped.iter().position(|stopped| stopped.id == axis.id);
        (axis.label, at.map(|at| stopped.swap_remove(at)))
    });
    report_remote(reports.collect(), failed)
}

fn send_stop(gateway: &Gateway, axes: Option<Vec<u16>>) -> Result<StopReport> {
    let request =
        StopRequest { axes, reason: "polepair stop".to_owned(), ..StopRequest::default() };
    gateway.stop(&request).map_err(remote::refusal_problem)
}

/// Prints the progress of each axis' stop, and the targets that were not reached.
fn report_remote(reports: Vec<(String, Option<AxisStopReport>)>, failed: Vec<Problem>) -> Result {
    let mut tally = StopTally { confirmed: 0, failed };
    for (label, how) in reports {
        if how.as_ref().is_some_and(|how| how.quick) {
            print_warning(&motion::quick_stop_text(&label));
        }
        let ended = match how.map(|how| (how.class, how.error)) {
            Some((StopClass::Standing, _)) => Ok(Standstill::Observed),
            Some((StopClass::Acknowledged, _)) => Ok(Standstill::Unobservable),
            Some((StopClass::Sent, None)) => Ok(Standstill::Unconfirmed),
            Some((StopClass::Pending, error)) => Err(pending_problem(&label, error)),
            Some((_, Some(error))) => Err(remote::refusal_problem(error)),
            _ => Err(unconfirmed_problem(&label)),
        };
        tally.record(&label, ended);
    }
    tally.conclude()
}

/// The stops of a command, on a wire or on a server: how many were confirmed, and why the others were not.
#[derive(Default)]
struct StopTally {
    confirmed: usize,
    failed: Vec<Problem>,
}

impl StopTally {
    /// Prints the end of one axis' stop.
    fn record(&mut self, label: &str, ended: Result<Standstill>) {
        let is_confirmed = matches!(ended, Ok(Standstill::Observed | Standstill::Unobservable));
        self.confirmed += usize::from(is_confirmed);
        match ended {
            Ok(Standstill::Observed) => print_note(&format!("{label} is stopped")),
            Ok(Standstill::Unobservable) => print_warning(&format!(
                "{label} acknowledged the stop; it does not report whether its motor is at \
                 standstill"
            )),
            Ok(Standstill::Unconfirmed) => {
                self.failed.push(motion::unconfirmed_problem(label, "the stop"));
            }
            Err(problem) => self.failed.push(problem),
        }
    }

    /// The result of the command. A single problem is its own; several are listed.
    fn conclude(mut self) -> Result {
        let (failed, of) = (self.failed.len(), self.failed.len() + self.confirmed);
        if failed == 0 {
            return Ok(Exit::Ok);
        }
        if of == 1 {
            return Err(self.failed.remove(0));
        }
        // Every axis by itself: one line "3 stops failed" does not show which supply to cut.
        self.failed.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
        let what = match failed {
            1 => format!("one stop of {of} is not confirmed."),
            _ => format!("{failed} stops of {of} are not confirmed."),
        };
        Err(Problem::new(Exit::Partial, "E702", what).hint("cut the power of these drives"))
    }
}

/// Problem of an absent axis, or of a link that is not open, whose number of motors is unknown.
fn unreached_problem(UnreachedTarget { link, url, number, error }: UnreachedTarget) -> Problem {
    let (what, hint) = match number {
        Some(number) => (
            format!("axis {number} of link {link} received no stop: it is missing."),
            "cut its supply if it turns; the stop is sent as soon as the drive replies",
        ),
        None => (
            format!("no motor of link {link} received a stop: {url} is not open."),
            "cut the supply of motors that turn there; the stop is sent as soon as the link is \
             open",
        ),
    };
    Problem::new(error.exit(), error.code, what).why(to_sentence(&error.message)).hint(hint)
}

/// Problem of an axis without measured standstill; the server continues its stop.
fn pending_problem(label: &str, error: Option<GatewayError>) -> Problem {
    let exit = error.as_ref().map_or(Exit::NoReply, GatewayError::exit);
    let code = error.as_ref().map_or("E401".into(), |error| error.code.clone());
    Problem::new(exit, code, format!("{label} standstill is not confirmed."))
        .why(error.map_or_else(String::new, |error| to_sentence(&error.message)))
        .hint("the server repeats the stop until then; if it still turns, cut its power")
}

fn unconfirmed_problem(label: &str) -> Problem {
    Problem::new(Exit::NoReply, "E401", format!("{label} did not confirm its stop."))
        .hint("repeat the stop; if it still turns, cut its power")
}

/// Motors behind one address by their numbers.
fn motors_text(motors: &[u8]) -> String {
    let numbers: Vec<String> = motors.iter().map(u8::to_string).collect();
    let numbers: Vec<&str> = numbers.iter().map(String::as_str).collect();
    let word = if motors.len() == 1 { "motor" } else { "motors" };
    format!("{word} {}", join_list(&numbers))
}

/// Prints the stopped drives, and those that were not reached.
pub fn report_stops(url: &str, stopped: stopping::LinkStopReport) -> Result {
    let link = without_axes(url);
    let (mut tally, mut unasked) = (StopTally::default(), None);
    for (label, ended) in stopped.axes {
        if ended.is_err() {
            print_warning(&format!("{label} may still turn: cut its supply"));
        }
        tally.record(&label, ended.map_err(outcome::to_problem));
    }
    if let Some(rate) = stopped.other_rate {
        let at_rate = url.parse::<Url>().ok().and_then(|url| url.with_baud(rate));
        let hint = at_rate.map(|url| format!(": use {url}")).unwrap_or_default();
        print_warning(&format!("the drive is at {rate} baud{hint}"));
    }
    for label in stopped.quick_stops {
        print_warning(&motion::quick_stop_text(&label));
    }
    for (label, found) in stopped.programs {
        print_warning(&match found {
            DrivePrograms::Ended => format!("{label}: its program ran and was ended"),
            DrivePrograms::StillReported => format!(
                "{label}: its program ran and was ended, twice; the drive still reports it as \
                 running: \
                 watch the motor"
            ),
            DrivePrograms::Incomplete => format!(
                "{label}: the module was in download mode, which was ended; its program is incomplete"
            ),
            DrivePrograms::MayHaveRun => format!(
                "{label}: its program was ended, if one was running; the drive does not report it"
            ),
        });
    }
    for motors in stopped.motors {
        let number = motors.number;
        if !motors.confirmed.is_empty() {
            let which = motors_text(&motors.confirmed);
            print_warning(&format!(
                "module {number}: {which} acknowledged the stop too; their standstill was not \
                 checked"
            ));
        }
        if !motors.unconfirmed.is_empty() {
            let which = motors_text(&motors.unconfirmed);
            print_warning(&format!(
                "module {number}: {which} did not confirm the stop and may still turn: cut the \
                 supply"
            ));
        }
        tally.failed.extend(motors.result.err().map(outcome::to_problem));
    }
    if let Some(patience) = stopped.reply_timeout {
        let output = if stopped.broadcast {
            "a broadcast stop was sent, without confirmation; "
        } else {
            ""
        };
        let asked = if stopped.asked_at_once {
            "asked all addresses at once".to_owned()
        } else {
            format!("asked {} addresses for {} ms each", stopped.queried, patience.as_millis())
        };
        print_note(&format!(
            "{output}{asked}; a drive that replies later, or has another address, must be stopped \
             by its number: polepair stop {}",
            shell_word(&format!("{link}#N"))
        ));
    }
    if stopped.broadcast && stopped.reply_timeout.is_none() {
        print_note("a broadcast stop was sent first; no drive answers it");
    }
    if let Some((first, last)) = stopped.not_queried {
        let what = format!("addresses {first} to {last} were not tried: the time was over.");
        if stopped.broadcast {
            print_warning(&what)
        } else {
            unasked = Some(Problem::new(Exit::Partial, "E703", what));
        }
    }
    if tally.failed.is_empty() {
        return match unasked {
            // No one knows if a drive is at an address that was not asked, so it does not count as
            // a stop.
            Some(unasked) => Err(unasked),
            None if tally.confirmed == 0 => {
                Err(nobody_problem(stopped.broadcast, stopped.wiring, &stopped.received))
            }
            None => Ok(Exit::Ok),
        };
    }
    unasked.iter().for_each(|unasked| print_warning(unasked.render(false).trim_end()));
    tally.conclude()
}

fn nobody_problem(everybody: bool, wiring: Wiring, details: &NoReplyDetails) -> Problem {
    let output = if everybody {
        "A broadcast stop was sent, and no drive confirmed it."
    } else {
        "No stop was sent."
    };
    let problem = Problem::new(Exit::NoReply, "E403", "no drive answered.")
        .why(format!("{} {output}", outcome::unanswered_text(details)))
        .hint("cut the power if a motor turns");
    if details.is_nothing() { problem.hint(wiring.hint()) } else { problem.hint(details.hint()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(label: &str) -> (String, std::result::Result<Standstill, Error>) {
        (label.to_owned(), Ok(Standstill::Observed))
    }

    /// Addresses that were not asked may be empty: no stop of theirs is counted.
    #[test]
    fn stops_are_counted_of_drives_alone() {
        let unasked = |axes| stopping::LinkStopReport {
            axes,
            not_queried: Some((9, 32)),
            ..Default::default()
        };
        let one =
            report_stops("tmcl+serial:///dev/null", unasked(vec![seen("axis 1")])).unwrap_err();
        assert_eq!((one.code.as_ref(), one.exit), ("E703", Exit::Partial));
        let lost = Error::Interrupted { what: "axis 2".to_owned() };
        let two = vec![seen("axis 1"), ("axis 2".to_owned(), Err(lost))];
        let two = report_stops("tmcl+serial:///dev/null", unasked(two)).unwrap_err();
        assert_eq!(two.code.as_ref(), "E702");
        assert_eq!(two.what, "one stop of 2 is not confirmed.");
    }
}
