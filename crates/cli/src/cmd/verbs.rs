//! `polepair enable|disable|stop|clear URL`

use clap::Args;
use polepair_core::axis::{Command, Verb};

use crate::motion;
use crate::problem::{Exit, Problem, Result};
use crate::session::verb;
use crate::target::Target;
use crate::terminal::say;

/// Powers the motor, holding it where it stands.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair enable tmcl+serial:///dev/ttyUSB0#1")]
pub struct Enable {
    #[command(flatten)]
    target: Target,
    /// Print the frames and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Takes power off the motor.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair disable tmcl+serial:///dev/ttyUSB0#1")]
pub struct Disable {
    #[command(flatten)]
    target: Target,
    /// Print the frames and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Brings motors to rest.
///
/// Without #AXES in the URL every axis that answers on the link is stopped.
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

/// Clears faults.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair clear modbus-rtu+serial:///dev/ttyUSB0#1")]
pub struct Clear {
    #[command(flatten)]
    target: Target,
    /// Print the frames and send nothing
    #[arg(long)]
    dry_run: bool,
}

impl Enable {
    pub fn run(self) -> Result {
        if self.dry_run {
            return self.target.rehearse(|_| Ok(Command::new(Verb::Enable)));
        }
        let session = self.target.open()?;
        session.listen();
        motion::caution(&session);
        for axis in session.axes() {
            axis.arm(true);
            verb(axis, Verb::Enable)?;
            say(&format!("{} is powered and holds its position", axis.label()));
        }
        Ok(Exit::Ok)
    }
}

impl Disable {
    pub fn run(self) -> Result {
        simple(&self.target, Verb::Disable, self.dry_run, "has no power now")
    }
}

impl Clear {
    pub fn run(self) -> Result {
        simple(&self.target, Verb::Clear, self.dry_run, "has its faults cleared")
    }
}

impl Stop {
    pub fn run(self) -> Result {
        let wanted = if self.quick { Verb::QuickStop } else { Verb::Stop };
        if self.dry_run {
            return self.target.rehearse(|_| Ok(Command::new(wanted)));
        }
        // One that fails must not keep the others turning.
        let mut failed: Vec<Problem> = Vec::new();
        let mut stopped = 0;
        self.target.each(&mut |axis| match verb(axis, wanted) {
            Ok(_) => {
                stopped += 1;
                say(&format!("{} is stopped", axis.label()));
            }
            Err(problem) => failed.push(problem),
        })?;
        match (failed.len(), stopped) {
            (0, _) => Ok(Exit::Ok),
            (_, 0) => Err(failed.remove(0)),
            (count, _) => {
                failed.iter().for_each(|problem| say(problem.render(false).trim_end()));
                let what = format!("{count} of {} axes were not stopped.", count + stopped);
                Err(Problem::new(Exit::Partial, "E702", what).hint("cut the power of these drives"))
            }
        }
    }
}

fn simple(target: &Target, wanted: Verb, dry_run: bool, done: &str) -> Result {
    if dry_run {
        return target.rehearse(|_| Ok(Command::new(wanted)));
    }
    let session = target.open()?;
    session.listen();
    for axis in session.axes() {
        verb(axis, wanted)?;
        say(&format!("{} {done}", axis.label()));
    }
    Ok(Exit::Ok)
}
