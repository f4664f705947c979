//! `program run`, `call` and `stop`.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use polepair::LocalAxis;
use polepair::program::Program;
use polepair_core::axis::{Command, Verb};
use polepair_core::time::Instant;

use super::ending::{end_program, is_powered};
use super::{instructions, module_axis, parse_address, single_axis};
use crate::interrupt;
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::LocalSession;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Interval of checking a routine.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Default time limit of a routine, s.
const CALL_MAX_S: f64 = 600.0;

/// Start point of a program.
#[derive(Args, Debug)]
struct ProgramEntry {
    /// Program text with the labels
    #[arg(long, value_name = "FILE")]
    source: Option<PathBuf>,
    /// Address of the first word of that text in the drive
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address, requires = "source")]
    at: Option<u16>,
}

impl ProgramEntry {
    /// The address that a word means.
    fn address(&self, axis: &LocalAxis, word: &str) -> Result<u16> {
        let Some(path) = &self.source else {
            return parse_address(word).map_err(|expected| {
                Problem::usage("E242", format!("{word:?} is not an address."))
                    .why(format!("{}.", outcome::to_sentence(&expected).trim_end_matches('.')))
                    .hint("for a label: --source FILE names the text that has it")
            });
        };
        let rules = axis.language().map_err(outcome::to_problem)?.memory_rules();
        let source = axis.assembly_context(self.at.unwrap_or(*rules.volatile.start()));
        let source = source.map_err(outcome::to_problem)?;
        let program = Program::read(path, &source).map_err(|e| outcome::to_problem(e.into()))?;
        let found = program.label(word).or_else(|| parse_address(word).ok());
        found.ok_or_else(|| {
            let names: Vec<&str> = program.labels().map(|(name, _)| name).collect();
            Problem::usage("E242", format!("{} has no label {word:?}.", path.display()))
                .why(format!("It has {}.", crate::problem::join_list(&names)))
        })
    }
}

/// Runs a program of the drive from an address.
///
/// The program may power the motor and move it. It runs until Ctrl-C, or until --for. Then the program is
/// ended, the motor is stopped, and power that the program switched on is removed. A TMCL module reports
/// the end of its program, and the command exits then; other drives do not report it.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 0x8270 --for 5s
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 main --source moves.tml
  polepair program run tml+serial:///dev/ttyUSB0:9600#1 --detach     from its start address
  polepair program run tmcl+serial:///dev/ttyUSB0:9600#1             from its first instruction
  polepair program run tmcl+serial:///dev/ttyUSB0:9600#1 Loop --source moves.tmc")]
pub struct ProgramRun {
    #[command(flatten)]
    target: DriveArgs,
    /// Address, or label with --source [default: where the drive starts programs by itself]
    #[arg(value_name = "WHERE")]
    start: Option<String>,
    #[command(flatten)]
    place: ProgramEntry,
    /// Continue at the actual instruction of a TMCL module
    #[arg(long, conflicts_with = "start")]
    here: bool,
    /// End the program after this time: 5s, 300ms
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Leave the program running
    #[arg(long, conflicts_with = "seconds")]
    detach: bool,
}

/// Calls a routine of the drive's program, and waits until it returns.
///
/// The routine may power the motor and move it. On Ctrl-C, the routine is ended and the motor is stopped.
#[derive(Args, Debug)]
#[command(after_help = "\
Example:
  polepair program call tml+serial:///dev/ttyUSB0:9600#1 move --source moves.tml")]
pub struct ProgramCall {
    #[command(flatten)]
    target: DriveArgs,
    /// Address, or label with --source
    #[arg(value_name = "WHERE")]
    start: String,
    #[command(flatten)]
    place: ProgramEntry,
    /// Time limit: 5s, 2min
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Leave the routine running
    #[arg(long, conflicts_with = "timeout")]
    detach: bool,
}

/// Ends the running program of a drive, and its motion. The motor stays powered.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair program stop tml+serial:///dev/ttyUSB0:9600#1")]
pub struct ProgramStop {
    #[command(flatten)]
    target: DriveArgs,
}

impl ProgramRun {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        if instructions::is_module(axis) {
            let start = instructions::ProgramStart {
                place: self.start.as_deref(),
                source: self.place.source.as_deref(),
                here: self.here,
            };
            return instructions::run(&session, axis, start, self.detach, self.seconds);
        }
        let start = match &self.start {
            Some(word) => self.place.address(axis, word)?,
            None => axis.language().map_err(outcome::to_problem)?.memory_rules().autorun.0,
        };
        let seconds = self.seconds;
        run_program(
            &session,
            axis,
            self.detach,
            || axis.jump_to(start),
            || motion::hold_motion(&[(axis.clone().into(), Command::new(Verb::Reached))], seconds),
        )
    }
}

impl ProgramCall {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = single_axis(&session)?;
        let start = self.place.address(axis, &self.start)?;
        let within = Duration::from_secs_f64(self.timeout.unwrap_or(CALL_MAX_S));
        run_program(
            &session,
            axis,
            self.detach,
            || axis.call(start),
            || {
                let end = axis.connection().now() + within;
                while axis.is_routine_running().map_err(outcome::to_problem)? {
                    wait_routine(axis, end)?;
                }
                print_note("the routine has returned");
                Ok(())
            },
        )
    }
}

/// Lets some time pass while a routine runs.
fn wait_routine(axis: &LocalAxis, end: Instant) -> Result<()> {
    if interrupt::was_interrupted() {
        return Err(Problem::interrupted());
    }
    if axis.connection().now() >= end {
        let what = "the routine did not return in time; it was ended.";
        return Err(Problem::new(Exit::Negative, "E101", what));
    }
    motion::check_fault(axis)?;
    axis.sleep(POLL_INTERVAL);
    Ok(())
}

/// Starts a program, waits, and ends its motion: also after an error.
fn run_program(
    session: &LocalSession,
    axis: &LocalAxis,
    detach: bool,
    start: impl FnOnce() -> std::result::Result<(), polepair::Error>,
    wait: impl FnOnce() -> Result<()>,
) -> Result {
    motion::print_program_note(session, detach);
    session.listen_for_interrupts();
    let powered = is_powered(axis)?;
    let _holding = interrupt::hold_motion(&session.arguments);
    axis.arm(true);
    let started = start().map_err(outcome::to_problem);
    if detach && started.is_ok() {
        print_warning(&format!(
            "left running; to end it: polepair program stop {}",
            session.arguments
        ));
        return Ok(Exit::Ok);
    }
    let ended = started.and_then(|()| wait());
    let quiet = end_program(axis, powered);
    axis.arm(false);
    motion::conclude(ended, quiet, "the program was ended and the motor stopped")
}

impl ProgramStop {
    pub fn run(self) -> Result {
        let session = self.target.open()?;
        let axis = module_axis(&session)?;
        session.listen_for_interrupts();
        axis.abort().map_err(outcome::to_problem)?;
        if instructions::is_module(axis) {
            instructions::stop_others(axis)?;
        }
        print_note(&format!("{}: its program is ended and its motor stopped", axis.label()));
        Ok(Exit::Ok)
    }
}
