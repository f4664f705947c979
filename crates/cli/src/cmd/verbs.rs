//! `polepair enable|disable|clear URL`

use clap::Args;
use polepair_core::axis::{Command, Verb};

use crate::motion;
use crate::problem::{Exit, Result};
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
