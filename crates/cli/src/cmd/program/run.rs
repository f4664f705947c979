//! Programs that run: started, called, ended.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use polepair::Axis;
use polepair::axis::OWED_MAX;
use polepair::program::Program;
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;

use super::{address, only};
use crate::interrupt;
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{Session, signal, verb_if_any};
use crate::target::Target;
use crate::terminal::say;
use crate::value;

/// How often a routine is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// How long a routine may take unless the user says otherwise, s.
const CALL_MAX_S: f64 = 600.0;

/// A place in a program.
#[derive(Args, Debug)]
struct Where {
    /// The text whose labels WHERE may be
    #[arg(long, value_name = "FILE")]
    source: Option<PathBuf>,
    /// Where that text's first word lies in the drive
    #[arg(long, value_name = "ADDRESS", value_parser = address, requires = "source")]
    at: Option<u16>,
}

impl Where {
    /// The address that a word means.
    fn address(&self, axis: &Axis, word: &str) -> Result<u16> {
        let Some(path) = &self.source else {
            return address(word).map_err(|expected| {
                Problem::usage("E242", format!("{word:?} is no address."))
                    .why(format!("{}.", outcome::sentence(&expected).trim_end_matches('.')))
                    .hint("for a label: --source FILE names the text that has it")
            });
        };
        let rules = axis.language().map_err(outcome::error)?.rules();
        let source = axis.source(self.at.unwrap_or(*rules.volatile.start()));
        let source = source.map_err(outcome::error)?;
        let program = Program::read(path, &source).map_err(|e| outcome::error(e.into()))?;
        let found = program.label(word).or_else(|| address(word).ok());
        found.ok_or_else(|| {
            let names: Vec<&str> = program.labels().map(|(name, _)| name).collect();
            Problem::usage("E242", format!("{} has no label {word:?}.", path.display()))
                .why(format!("It has {}.", crate::problem::list(&names)))
        })
    }
}

/// Has a drive go on at an address of its program, whatever runs there now.
///
/// A program may power the motor and move it. It runs until Ctrl-C, or for so long; then the program
/// is ended, the motor stopped, and the power taken off that was put on meanwhile. Whether a program
/// has come to its end a drive does not tell.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 0x8270 --for 5s
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 main --source moves.tml
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 --detach     from where it starts by itself")]
pub struct Run {
    #[command(flatten)]
    target: Target,
    /// An address, or with --source a label; else where the drive starts by itself
    #[arg(value_name = "WHERE")]
    start: Option<String>,
    #[command(flatten)]
    place: Where,
    /// End it after so long: 5s, 300ms
    #[arg(long = "for", value_name = "TIME", value_parser = value::span)]
    seconds: Option<f64>,
    /// Leave it running
    #[arg(long, conflicts_with = "seconds")]
    detach: bool,
}

/// Has a drive call a routine of its program, and waits until it returns.
///
/// The routine may power the motor and move it. On Ctrl-C it is ended, and the motor stopped.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair program call tml+serial:///dev/ttyUSB0:9600#1 move --source moves.tml")]
pub struct Call {
    #[command(flatten)]
    target: Target,
    /// An address, or with --source a label
    #[arg(value_name = "WHERE")]
    start: String,
    #[command(flatten)]
    place: Where,
    /// How long it may take: 5s, 2min
    #[arg(long, value_name = "TIME", value_parser = value::span)]
    timeout: Option<f64>,
    /// Leave it running
    #[arg(long, conflicts_with = "timeout")]
    detach: bool,
}

/// Ends whatever program a drive runs, and its motion. The motor keeps its power.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair program abort tml+serial:///dev/ttyUSB0:9600#1")]
pub struct Abort {
    #[command(flatten)]
    target: Target,
}

impl Run {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        let start = match &self.start {
            Some(word) => self.place.address(axis, word)?,
            None => axis.language().map_err(outcome::error)?.rules().autorun.0,
        };
        let seconds = self.seconds;
        started(
            &session,
            axis,
            self.detach,
            || axis.go_to(start),
            || motion::hold(&session, &[(axis.clone(), Command::new(Verb::Reached))], seconds),
        )
    }
}

impl Call {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        let start = self.place.address(axis, &self.start)?;
        let within = Duration::from_secs_f64(self.timeout.unwrap_or(CALL_MAX_S));
        let returned = || {
            let end = axis.connection().now() + within;
            while axis.is_calling().map_err(outcome::error)? {
                wait(axis, end)?;
            }
            say("the routine has returned");
            Ok(())
        };
        started(&session, axis, self.detach, || axis.call(start), returned)
    }
}

/// Lets some time pass while a routine runs.
fn wait(axis: &Axis, end: Instant) -> Result<()> {
    if interrupt::came() {
        return Err(Problem::interrupted());
    }
    if axis.connection().now() >= end {
        let what = "the routine did not return in time; it was ended.";
        return Err(Problem::new(Exit::Negative, "E101", what));
    }
    motion::check_fault(axis)?;
    axis.sleep(LOOK);
    Ok(())
}

/// Starts a program, waits, and ends what it does: also when waiting went wrong.
fn started(
    session: &Session,
    axis: &Axis,
    detach: bool,
    start: impl FnOnce() -> std::result::Result<(), polepair::Error>,
    wait: impl FnOnce() -> Result<()>,
) -> Result {
    motion::caution(session);
    session.listen();
    let powered = signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0);
    let _holding = interrupt::hold(&session.words);
    axis.arm(true);
    let begun = start().map_err(outcome::error);
    if detach && begun.is_ok() {
        say(&format!("left running; this ends it: polepair program abort {}", session.words));
        return Ok(Exit::Ok);
    }
    let ended = begun.and_then(|()| wait());
    let quiet = finish(axis, powered);
    axis.arm(false);
    motion::over(ended, quiet, "the program was ended and the motor stopped")
}

/// Ends the program and the motion, and takes the power off that was put on.
fn finish(axis: &Axis, powered: bool) -> Result<()> {
    let mut owed = motion::Owed::new();
    let ended = axis.abort_owed(OWED_MAX, |axis, _| owed.again(axis, "still turn"));
    let ended = owed.told(axis, ended);
    let rested = if ended.is_ok() { motion::rest(axis) } else { Ok(()) };
    let off = if powered { Ok(None) } else { verb_if_any(axis, Verb::Disable) };
    if ended.is_err() && (powered || off.is_err()) {
        say(&format!("{} may still turn: cut its supply", axis.label()));
    }
    ended.and(rested).and(off.map(drop))
}

impl Abort {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = only(&session)?;
        session.listen();
        axis.abort().map_err(outcome::error)?;
        say(&format!("{}: its program is ended and its motor stopped", axis.label()));
        Ok(Exit::Ok)
    }
}
